//! The renderer: from a snapshot to a frame.

mod culling;
mod frames;
mod items;
mod overlays;
mod particles;
mod probe;
mod scratch;
mod shadows;

use std::path::PathBuf;

use trocar_scene::{Revision, Snapshot, VisualMaterial};

use self::frames::{Frames, Lighting};
use self::items::{Draw, Items, Style};
use self::overlays::{OverlayLayer, SceneBelow};
use self::particles::{ParticleLayer, ParticleTargets};
use self::scratch::Scratches;
use self::shadows::Shadows;
use crate::draw_list::DrawList;
use crate::gpu::Gpu;
use crate::gpu::composite::{Composite, Seen};
use crate::gpu::edits::Edits;
use crate::gpu::materials::Materials;
use crate::gpu::passes::Passes;
use crate::gpu::surfaces::SurfaceCopies;
use crate::gpu::uniforms::GpuItem;
use crate::layout::{Layout, Shot, Weave};
use crate::lights;
use crate::overlay::{Legend, Overlays};
use crate::pacing::Pace;
use crate::quality::Quality;
use crate::view::View;

/// Background colour.
const BACKDROP: wgpu::Color = wgpu::Color { r: 0.012, g: 0.014, b: 0.017, a: 1.0 };

/// The target of an eye's picture.
#[derive(Clone, Copy)]
struct Canvas<'a> {
    into: &'a wgpu::TextureView,
    size: [u32; 2],
    /// Its pane \[pixels\]: left, top, width, height.
    pane: [u32; 4],
    /// Whether the target must be cleared.
    clear: bool,
}

/// Draws scenes. Data on the device is kept from frame to frame; only changes are uploaded.
pub struct Renderer {
    draw_list: DrawList,
    copies: SurfaceCopies,
    materials: Materials,
    edits: Edits,
    passes: Passes,
    composite: Option<Composite>,
    items: Items,
    frames: Frames,
    scratches: Scratches,
    shadows: Shadows,
    particle_layer: ParticleLayer,
    overlay_layer: OverlayLayer,
    /// The overlays.
    pub overlays: Overlays,
    shown: Option<Shown>,
}

/// Everything that a picture depends on.
#[derive(PartialEq)]
struct Shown {
    revision: Revision,
    /// Interpolated bodies differ between frames with the same revision.
    retouches: u64,
    view: View,
    layout: Layout,
    pace: Pace,
    overlays: Overlays,
    target: wgpu::Texture,
}

impl Renderer {
    /// A renderer on this device; `folder` is the scenario's, below which files of textures and shaders are.
    pub fn new(gpu: &Gpu, folder: Option<PathBuf>) -> Self {
        let materials = Materials::new(gpu, folder);
        let passes = Passes::new(gpu, &materials.layout);
        let items = Items::new(gpu, &passes);
        Self {
            draw_list: DrawList::new(),
            copies: SurfaceCopies::default(),
            materials,
            edits: Edits::default(),
            passes,
            composite: None,
            items,
            frames: Frames::default(),
            scratches: Scratches::default(),
            shadows: Shadows::default(),
            particle_layer: ParticleLayer::default(),
            overlay_layer: OverlayLayer::default(),
            overlays: Overlays::default(),
            shown: None,
        }
    }

    /// The drawn items.
    pub fn draw_list(&self) -> &DrawList {
        &self.draw_list
    }

    /// Texels of edit maps uploaded since the start.
    pub fn texels_sent(&self) -> u64 {
        self.edits.texels_sent
    }

    /// Bytes of surfaces uploaded since the start.
    pub fn bytes_sent(&self) -> u64 {
        self.copies.bytes_sent
    }

    /// Bytes of overlays uploaded since the start.
    pub fn overlay_bytes_sent(&self) -> u64 {
        self.overlay_layer.bytes_sent()
    }

    /// Bytes of smoke and fluids uploaded since the start.
    pub fn particle_bytes_sent(&self) -> u64 {
        self.particle_layer.bytes_sent()
    }

    /// Full-picture passes for smoke and fluids since the start.
    pub fn particle_passes(&self) -> u64 {
        self.particle_layer.passes()
    }

    /// The legends of the overlays.
    pub fn legends(&self) -> &[Legend] {
        self.overlay_layer.legends()
    }

    /// Records a snapshot for overlays of the past such as trails; for callers that look more often than they draw.
    pub fn watch(&mut self, scene: &Snapshot) {
        self.overlay_layer.watch(&self.overlays, scene);
    }

    /// Follows the scene to this snapshot and uploads changes.
    pub fn update(&mut self, gpu: &Gpu, scene: &Snapshot) {
        let anew = self.draw_list.update(scene);
        if anew {
            self.send(gpu, scene);
        }
        self.particle_layer.follow(gpu, scene, &self.passes);
        let Self { overlay_layer, overlays, draw_list, copies, passes, .. } = self;
        overlay_layer.follow(gpu, overlays, scene, &SceneBelow { draw_list, copies, passes, anew });
    }

    fn send(&mut self, gpu: &Gpu, scene: &Snapshot) {
        let materials = &self.materials;
        let base = |entity| {
            scene.get::<VisualMaterial>(entity).and_then(|material| materials.edit_picture(material))
        };
        self.edits.update(gpu, scene, base);
        self.items.clear();
        for item in self.draw_list.items() {
            self.copies.send(gpu, &item.surface);
            let edit = self.edits.get(item.entity);
            let number = edit.map(|(number, _)| number);
            let look = self.items.known_look(item, number);
            let look = look.unwrap_or_else(|| self.materials.send(gpu, &item.material, edit));
            self.items.add(item, Draw::new(item, look, number));
        }
        self.copies.sweep();
        self.materials.sweep();
        self.items.send(gpu, &self.passes);
    }

    /// Draws the scene of the last update into `target`, through a view, in a layout. Of `scene` only the lights are
    /// read.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        scene: &Snapshot,
        view: &View,
        layout: &Layout,
        quality: Quality,
        target: &wgpu::Texture,
    ) {
        self.draw_scaled(gpu, scene, view, layout, Pace { quality, scale: 1.0 }, target);
    }

    /// Whether [`Self::draw_scaled`] with the same arguments would change `target`; otherwise it need not be drawn
    /// again.
    pub fn needs_draw(
        &self,
        scene: &Snapshot,
        view: &View,
        layout: &Layout,
        pace: Pace,
        target: &wgpu::Texture,
    ) -> bool {
        self.shown.as_ref() != Some(&self.showing(scene, view, layout, pace, target))
    }

    fn showing(
        &self,
        scene: &Snapshot,
        view: &View,
        layout: &Layout,
        pace: Pace,
        target: &wgpu::Texture,
    ) -> Shown {
        Shown {
            revision: scene.revision(),
            retouches: scene.retouches(),
            view: *view,
            layout: layout.clone(),
            pace,
            overlays: self.overlays.clone(),
            target: target.clone(),
        }
    }

    /// As [`Self::draw`], at a lower resolution than that of `target`, enlarged at the end.
    pub fn draw_scaled(
        &mut self,
        gpu: &Gpu,
        scene: &Snapshot,
        view: &View,
        layout: &Layout,
        pace: Pace,
        target: &wgpu::Texture,
    ) {
        let Pace { quality, scale } = pace;
        self.shown = Some(self.showing(scene, view, layout, pace, target));
        let size = [target.width(), target.height()];
        let format = target.format();
        let into = target.create_view(&Default::default());
        let shots = layout.shots(scene, view, size);
        let throw = quality.shadows && quality.wet;
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        // Directly into the target, unless the lens distorts, two eyes are interleaved, or the picture is enlarged.
        let is_straight = |shot: &Shot| {
            shot.weave == Weave::Panes && shot.centre.distortion == 0.0 && shot.centre.vignette == 0.0
        };
        let straight = shots.iter().all(is_straight) && scale >= 1.0;
        if shots.is_empty() {
            clear(&mut encoder, &into);
        }
        let mut eyes = 0;
        for (index, shot) in shots.iter().enumerate() {
            let pixels = shot.pane.pixels(size);
            let mut lights = lights::shining(scene, &shot.centre);
            let exposure = lights::exposure(&lights, &culling::focus(&self.items.draws, &shot.centre));
            if throw {
                // Lights with shadows first, in the order of their layers.
                lights.sort_by_key(|light| light.shadow.map_or(usize::MAX, |(layer, _)| layer));
            }
            if throw && index == 0 {
                // Only the scene's own lights have shadows: they are the same for every view.
                self.draw_shadows(gpu, &mut encoder, &lights);
            }
            let shadows = lights.iter().filter(|light| throw && light.shadow.is_some()).count() as u32;
            let style = Style { quality, format, lights: lights.len() as u32, shadows };
            let lighting = Lighting { lights: &lights, exposure };
            let mut drawn = Vec::with_capacity(2);
            for eye in &shot.eyes {
                self.frames.set_eye(gpu, &self.passes, eyes, scene, eye, &lighting);
                let own = match straight {
                    true => [pixels[2], pixels[3]],
                    false => [pixels[2], pixels[3]].map(|side| scaled(side, scale)),
                };
                self.overlay_layer.prepare(gpu, eyes, eye, own, (format, quality.samples));
                if straight {
                    let canvas = Canvas { into: &into, size, pane: pixels, clear: index == 0 };
                    self.draw_eye(gpu, &mut encoder, eyes, eye, &style, &canvas);
                } else {
                    let picture = self.scratches.eye(gpu, eyes, own, format);
                    let pane = [0, 0, own[0], own[1]];
                    let canvas = Canvas { into: &picture, size: own, pane, clear: true };
                    self.draw_eye(gpu, &mut encoder, eyes, eye, &style, &canvas);
                    drawn.push(picture);
                }
                eyes += 1;
            }
            if let [first, ..] = drawn.as_slice() {
                if self.composite.as_ref().is_none_or(|composite| !composite.is_for(format)) {
                    self.composite = Some(Composite::new(gpu, format));
                }
                let (view, weave, eyes) = (&shot.centre, shot.weave, [first, drawn.last().unwrap_or(first)]);
                let seen = Seen { pane: pixels, eyes, view, weave, clear: index == 0 };
                if let Some(composite) = &mut self.composite {
                    composite.draw(gpu, &mut encoder, &into, index, &seen);
                }
            }
        }
        self.overlay_layer.annotate(gpu, &mut encoder, &self.overlays, (&into, format), size, &shots);
        gpu.queue.submit([encoder.finish()]);
    }

    fn draw_eye(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        index: usize,
        view: &View,
        style: &Style,
        canvas: &Canvas<'_>,
    ) {
        let Canvas { into, size, pane, clear } = *canvas;
        // Pixels per metre at a depth of a metre.
        let scale = f64::from(pane[3]) / (2.0 * (0.5 * view.lens.field_of_view).tan());
        let mut pipelines = Vec::with_capacity(self.items.draws.len());
        for (index, nearest) in culling::order(&self.items.draws, view) {
            let key = self.items.draws[index].key(style, scale / nearest);
            let materials = &self.materials;
            pipelines.push((index, self.passes.surface(gpu, &key, |shader| materials.source(shader))));
        }
        let scratch = self.scratches.get(gpu, size, style.quality.samples, style.format);
        // A pane beside one that was drawn keeps the other's pixels.
        let load = if clear { wgpu::LoadOp::Clear(BACKDROP) } else { wgpu::LoadOp::Load };
        let (drawn, resolved) = match &scratch.smooth {
            Some(smooth) => (smooth, Some(into)),
            None => (into, None),
        };
        // Smoke and fluids need the depth of solid surfaces, so they have passes of their own, the last of which
        // resolves.
        let over = (!self.particle_layer.is_empty()).then(|| ParticleTargets {
            drawn: drawn.clone(),
            resolved: resolved.cloned(),
            depth: scratch.depth.clone(),
        });
        let attachment = wgpu::RenderPassColorAttachment {
            view: drawn,
            depth_slice: None,
            resolve_target: if over.is_some() { None } else { resolved },
            ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("eye"),
            color_attachments: &[Some(attachment)],
            depth_stencil_attachment: Some(cleared_depth(&scratch.depth)),
            ..Default::default()
        });
        let [x, y, width, height] = pane.map(|pixels| pixels as f32);
        pass.set_viewport(x, y, width, height, 0.0, 1.0);
        pass.set_scissor_rect(pane[0], pane[1], pane[2], pane[3]);
        pass.set_bind_group(0, self.frames.eye(index), &[]);
        for (item, pipeline) in pipelines {
            pass.set_pipeline(&pipeline);
            let mut buffers = 2;
            if style.quality.wet {
                pass.set_bind_group(2, &self.items.draws[item].look.group, &[]);
                buffers = 3;
            }
            self.draw_item(&mut pass, item, buffers);
        }
        if let Some(over) = over {
            drop(pass);
            self.draw_loose(gpu, encoder, (index, view), style, canvas, &over);
            return;
        }
        let kind = (style.format, style.quality.samples);
        self.overlay_layer.draw(&mut pass, index, kind, &self.draw_list, &self.copies, &self.items.group);
    }

    /// Draws an item with the first of its vertex buffers: positions, normals, texture coordinates.
    fn draw_item(&self, pass: &mut wgpu::RenderPass<'_>, index: usize, buffers: usize) {
        let Some(copy) = self.copies.get(self.items.draws[index].surface) else { return };
        pass.set_bind_group(1, &self.items.group, &[(index * size_of::<GpuItem>()) as u32]);
        for (slot, buffer) in
            [&copy.positions, &copy.normals, &copy.uvs].into_iter().take(buffers).enumerate()
        {
            pass.set_vertex_buffer(slot as u32, buffer.slice(..));
        }
        pass.set_index_buffer(copy.indices.slice(..), wgpu::IndexFormat::Uint32);
        pass.draw_indexed(0..copy.index_count, 0, 0..1);
    }
}

/// Clears the target.
fn clear(encoder: &mut wgpu::CommandEncoder, target: &wgpu::TextureView) {
    let ops = wgpu::Operations { load: wgpu::LoadOp::Clear(BACKDROP), store: wgpu::StoreOp::Store };
    let attachment =
        wgpu::RenderPassColorAttachment { view: target, depth_slice: None, resolve_target: None, ops };
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some("nothing"),
        color_attachments: &[Some(attachment)],
        ..Default::default()
    });
}

fn cleared_depth(view: &wgpu::TextureView) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store: wgpu::StoreOp::Store }),
        stencil_ops: None,
    }
}

/// A side of the lower-resolution picture \[pixels\].
fn scaled(side: u32, scale: f64) -> u32 {
    ((f64::from(side) * scale.clamp(0.05, 1.0)).round() as u32).max(1)
}
