//! Smoke and fluids, drawn after solid surfaces and before overlays.

use trocar_scene::{Entity, ParticleKind, Snapshot};

use crate::gpu::Gpu;
use crate::gpu::particles::fluid::{FluidPass, Scene};
use crate::gpu::particles::smoke::SmokePass;
use crate::gpu::particles::{EyeView, ParticleCopies, ParticleQuality, ROUNDS};
use crate::gpu::passes::Passes;
use crate::particles::Swarm;
use crate::quality::Quality;
use crate::renderer::items::Style;
use crate::renderer::{Canvas, Renderer};
use crate::view::View;

/// The render targets for smoke and fluids of one eye.
pub(super) struct ParticleTargets {
    /// The multisampled colour target.
    pub(super) drawn: wgpu::TextureView,
    /// The resolve target, with several samples per pixel.
    pub(super) resolved: Option<wgpu::TextureView>,
    /// Depth of the scene.
    pub(super) depth: wgpu::TextureView,
}

/// Empty until a scene has particles.
#[derive(Default)]
pub(super) struct ParticleLayer {
    swarm: Swarm,
    copies: Option<ParticleCopies>,
    smoke: Option<SmokePass>,
    fluid: Option<FluidPass>,
    /// Passes drawn for particles since the start.
    passes: u64,
}

impl ParticleLayer {
    pub(super) fn passes(&self) -> u64 {
        self.passes
    }

    pub(super) fn bytes_sent(&self) -> u64 {
        self.copies.as_ref().map_or(0, |copies| copies.bytes_sent)
    }

    /// Follows the scene and uploads changes.
    pub(super) fn follow(&mut self, gpu: &Gpu, scene: &Snapshot, passes: &Passes) {
        if !self.swarm.update(scene) || self.is_empty() {
            return;
        }
        let copies = self.copies.get_or_insert_with(|| ParticleCopies::new(gpu));
        copies.send(gpu, &self.swarm);
        if self.swarm.has(ParticleKind::Fluid) {
            let new = || FluidPass::new(gpu, copies, &passes.frame_layout);
            self.fluid.get_or_insert_with(new).send(gpu, copies, &self.swarm);
        }
        if self.swarm.has(ParticleKind::Smoke) {
            self.smoke.get_or_insert_with(|| SmokePass::new(gpu));
        }
    }

    /// Whether there is nothing to draw.
    pub(super) fn is_empty(&self) -> bool {
        !self.swarm.has(ParticleKind::Smoke) && !self.swarm.has(ParticleKind::Fluid)
    }

    /// Writes distances and numbers of fluids into a probe whose eye is set; returns the entities of the numbers from
    /// `first_number` on.
    pub(super) fn measure(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (passes, frame): (&Passes, &wgpu::BindGroup),
        (view, size): (&View, [u32; 2]),
        first_number: u32,
        textures: [&wgpu::TextureView; 3],
    ) -> impl Iterator<Item = Entity> {
        if let (true, Some(copies), Some(fluid)) =
            (self.swarm.has(ParticleKind::Fluid), &mut self.copies, &mut self.fluid)
        {
            let quality = ParticleQuality::of(Quality::FULL);
            let pane = [0, 0, size[0], size[1]];
            let eye_view = EyeView { view, pane, quality, lights: 0, shadows: 0, first_number };
            copies.set_eye(gpu, 0, &self.swarm, &eye_view);
            fluid.measure(gpu, encoder, (copies, &passes.frame_layout), frame, size, textures);
            self.passes += 2 + 2 * ROUNDS as u64;
        }
        self.swarm.clouds().iter().map(|cloud| cloud.entity)
    }
}

impl Renderer {
    /// Draws smoke and fluids over an eye's picture, and the overlays over them.
    pub(super) fn draw_loose(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (eye, view): (usize, &View),
        style: &Style,
        canvas: &Canvas<'_>,
        over: &ParticleTargets,
    ) {
        let (pane, kind) = (canvas.pane, (style.format, style.quality.samples));
        let frame_layout = &self.passes.frame_layout;
        let frame = self.frames.eye(eye);
        let particle_layer = &mut self.particle_layer;
        let Some(copies) = &mut particle_layer.copies else { return };
        let quality = ParticleQuality::of(style.quality);
        let (lights, shadows) = (style.lights, style.shadows);
        let eye_view = EyeView { view, pane, quality, lights, shadows, first_number: 0 };
        copies.set_eye(gpu, eye, &particle_layer.swarm, &eye_view);
        if let (Some(bounds), Some(fluid)) =
            (particle_layer.swarm.fluid_bounds(view, [pane[2], pane[3]]), &mut particle_layer.fluid)
        {
            let (color, depth) = (&over.drawn, &over.depth);
            let scene = Scene { frame, color, depth, pane, bounds, kind, quality };
            particle_layer.passes += fluid.draw(gpu, encoder, (copies, frame_layout), eye, &scene);
        }
        let has_smoke = particle_layer.swarm.has(ParticleKind::Smoke);
        let mut apart = None;
        if let (true, Some(smoke)) = (has_smoke, &mut particle_layer.smoke) {
            let pixels = quality.smoke_pixels;
            let over = (kind, &over.depth, pixels);
            smoke.prepare(gpu, (copies, frame_layout), &particle_layer.swarm, eye, view, over);
            if pixels > 1 {
                let (groups, side) = ((frame, copies.eye_group(eye)), [pane[2], pane[3]]);
                apart = smoke.draw_apart(gpu, encoder, groups, eye, kind.1, (side, pixels));
                particle_layer.passes += 1;
            }
        }
        let attachment = wgpu::RenderPassColorAttachment {
            view: &over.drawn,
            depth_slice: None,
            resolve_target: over.resolved.as_ref(),
            ops: wgpu::Operations { load: wgpu::LoadOp::Load, store: wgpu::StoreOp::Store },
        };
        // Depths are read-only: smoke samples the depth of the surface behind it.
        let depth =
            wgpu::RenderPassDepthStencilAttachment { view: &over.depth, depth_ops: None, stencil_ops: None };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("smoke"),
            color_attachments: &[Some(attachment)],
            depth_stencil_attachment: Some(depth),
            ..Default::default()
        });
        particle_layer.passes += 1;
        let [x, y, width, height] = pane.map(|pixels| pixels as f32);
        pass.set_viewport(x, y, width, height, 0.0, 1.0);
        pass.set_scissor_rect(pane[0], pane[1], pane[2], pane[3]);
        if let (true, Some(smoke)) = (has_smoke, &particle_layer.smoke) {
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(1, copies.eye_group(eye), &[]);
            smoke.draw(&mut pass, eye, kind, apart);
        }
        self.overlay_layer.draw(&mut pass, eye, kind, &self.draw_list, &self.copies, &self.items.group);
    }
}
