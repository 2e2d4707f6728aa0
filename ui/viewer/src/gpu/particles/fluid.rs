//! Screen-space fluid surface for one eye: sphere depths, thickness, smoothing, shading.

use std::collections::HashMap;

use super::{
    Order, ParticleCopies, ParticleQuality, ROUNDS, Recipe, group, layout, over, pipeline, scene_depth,
    texels,
};
use crate::gpu::Gpu;
use crate::gpu::targets::{DEPTH, METRES, NUMBERS, target};
use crate::particles::Swarm;

/// Format of optical depths.
const OPTICAL: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Format of lengths.
const WAY: wgpu::TextureFormat = wgpu::TextureFormat::R16Float;
/// Most sizes of pictures kept.
const KEPT_MAX: usize = 4;

/// The picture's format, samples per pixel.
type Kind = (wgpu::TextureFormat, u32);

/// Intermediate pictures of the surface.
struct Pictures {
    size: [u32; 2],
    depth: wgpu::TextureView,
    /// Distances, and a second texture for the smoothing passes.
    distances: [wgpu::TextureView; 2],
    optical: wgpu::TextureView,
    way: wgpu::TextureView,
    /// The entities of the drops; for probes only.
    numbers: Option<(wgpu::TextureView, wgpu::BindGroup)>,
    smooth_groups: [wgpu::BindGroup; 2],
    group: wgpu::BindGroup,
}

/// The scene that the fluid is drawn over.
pub(crate) struct Scene<'a> {
    pub(crate) frame: &'a wgpu::BindGroup,
    pub(crate) color: &'a wgpu::TextureView,
    pub(crate) depth: &'a wgpu::TextureView,
    /// Left, top, width, height \[pixels\].
    pub(crate) pane: [u32; 4],
    /// The part of the pane that may contain fluid.
    pub(crate) bounds: [u32; 4],
    pub(crate) kind: Kind,
    pub(crate) quality: ParticleQuality,
}

/// Draws fluids. Created when a scene first has some.
pub(crate) struct FluidPass {
    smooth_layout: wgpu::BindGroupLayout,
    surface_layout: wgpu::BindGroupLayout,
    probe_layout: wgpu::BindGroupLayout,
    balls: wgpu::RenderPipeline,
    rows: wgpu::RenderPipeline,
    columns: wgpu::RenderPipeline,
    /// By samples per pixel.
    thickness: HashMap<u32, (wgpu::BindGroupLayout, wgpu::RenderPipeline)>,
    /// The scene depth that was last bound for each eye.
    depths: Vec<Option<(wgpu::TextureView, wgpu::BindGroup)>>,
    /// First multiplies the background by the transmittance, then adds light.
    surfaces: HashMap<Kind, [wgpu::RenderPipeline; 2]>,
    probe: Option<[wgpu::RenderPipeline; 2]>,
    pictures: Vec<Pictures>,
    order: Order,
}

const SMOOTH: &str = include_str!("../../shaders/fluid_smooth.wgsl");
const DROPS: &str = include_str!("../../shaders/fluid_drops.wgsl");
const THICKNESS: &str = include_str!("../../shaders/fluid_thickness.wgsl");
const SURFACE: &str = include_str!("../../shaders/fluid.wgsl");
const PROBE: &str = include_str!("../../shaders/fluid_probe.wgsl");

fn written(format: wgpu::TextureFormat) -> Option<wgpu::ColorTargetState> {
    Some(format.into())
}

fn blended(format: wgpu::TextureFormat, blend: wgpu::BlendState) -> Option<wgpu::ColorTargetState> {
    Some(wgpu::ColorTargetState { format, blend: Some(blend), write_mask: wgpu::ColorWrites::ALL })
}

impl FluidPass {
    pub(crate) fn new(gpu: &Gpu, copies: &ParticleCopies, frame_layout: &wgpu::BindGroupLayout) -> Self {
        let float = wgpu::TextureSampleType::Float { filterable: false };
        let smooth_layout = layout(gpu, &[texels(0, float, 1)]);
        let surface_layout = layout(gpu, &[texels(0, float, 1), texels(1, float, 1), texels(2, float, 1)]);
        let probe_layout = layout(gpu, &[texels(0, float, 1), texels(1, wgpu::TextureSampleType::Uint, 1)]);
        let balls = pipeline(
            gpu,
            &Recipe {
                layouts: &[frame_layout, &copies.sight_layout],
                source: DROPS,
                vertex: "drop",
                fragment: "ball",
                each: Some(&copies.order_layout),
                targets: &[written(METRES)],
                depth: Some(true),
                samples: 1,
            },
        );
        let smooth = |fragment| {
            pipeline(
                gpu,
                &Recipe {
                    layouts: &[frame_layout, &copies.sight_layout, &smooth_layout],
                    source: SMOOTH,
                    vertex: "everywhere",
                    fragment,
                    each: None,
                    targets: &[written(METRES)],
                    depth: None,
                    samples: 1,
                },
            )
        };
        let (rows, columns) = (smooth("rows"), smooth("columns"));
        Self {
            smooth_layout,
            surface_layout,
            probe_layout,
            balls,
            rows,
            columns,
            thickness: HashMap::new(),
            depths: Vec::new(),
            surfaces: HashMap::new(),
            probe: None,
            pictures: Vec::new(),
            order: Order::default(),
        }
    }

    /// Uploads the list of drops.
    pub(crate) fn send(&mut self, gpu: &Gpu, copies: &ParticleCopies, swarm: &Swarm) {
        swarm.drops(&mut self.order.list);
        self.order.send(gpu, copies);
    }

    /// Draws for one eye, over a scene of known depth; returns the number of passes.
    pub(crate) fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (copies, frame_layout): (&ParticleCopies, &wgpu::BindGroupLayout),
        eye: usize,
        scene: &Scene<'_>,
    ) -> u64 {
        self.prepare(gpu, (copies, frame_layout), eye, scene);
        let ParticleQuality { pixels, .. } = scene.quality;
        let [_, _, width, height] = scene.pane;
        let place = self.pictures(gpu, [width.div_ceil(pixels), height.div_ceil(pixels)]);
        let own = &self.pictures[place];
        let bounds = coarse(scene.bounds, pixels, own.size);
        let eye_group = copies.eye_group(eye);
        // The last row and column of texels may extend beyond the pane.
        let reach = [width, height].map(|side| side as f32 / pixels as f32);
        self.surface(encoder, (scene.frame, eye_group), own, (bounds, reach), None);
        if let (Some((_, thickness)), Some(Some((_, depth)))) =
            (self.thickness.get(&scene.kind.1), self.depths.get(eye))
        {
            let attachments = [attach(&own.optical, CLEAR), attach(&own.way, CLEAR)];
            let mut pass = begin(encoder, "thickness", &attachments, None);
            let [x, y, width, height] = bounds;
            pass.set_viewport(0.0, 0.0, reach[0], reach[1], 0.0, 1.0);
            pass.set_scissor_rect(x, y, width, height);
            pass.set_pipeline(thickness);
            pass.set_bind_group(0, scene.frame, &[]);
            pass.set_bind_group(1, eye_group, &[]);
            pass.set_bind_group(2, depth, &[]);
            self.order.draw(&mut pass, 3);
        }
        let Some(surfaces) = self.surfaces.get(&scene.kind) else { return 0 };
        let depth = (scene.depth, wgpu::LoadOp::Load);
        let mut pass = begin(encoder, "fluid", &[attach(scene.color, wgpu::LoadOp::Load)], Some(depth));
        let [left, top, width, height] = scene.pane.map(|pixels| pixels as f32);
        pass.set_viewport(left, top, width, height, 0.0, 1.0);
        let [x, y, width, height] = scene.bounds;
        pass.set_scissor_rect(scene.pane[0] + x, scene.pane[1] + y, width, height);
        pass.set_bind_group(0, scene.frame, &[]);
        pass.set_bind_group(1, eye_group, &[]);
        pass.set_bind_group(2, &own.group, &[]);
        for surface in surfaces {
            pass.set_pipeline(surface);
            pass.draw(0..3, 0..1);
        }
        3 + 2 * ROUNDS as u64
    }

    /// Writes distances and numbers into a probe, over a scene of known depth.
    pub(crate) fn measure(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (copies, frame_layout): (&ParticleCopies, &wgpu::BindGroupLayout),
        frame: &wgpu::BindGroup,
        size: [u32; 2],
        [metres, numbers, depth]: [&wgpu::TextureView; 3],
    ) {
        let probe = self.probe.take().unwrap_or_else(|| {
            let drops = Recipe {
                layouts: &[frame_layout, &copies.sight_layout],
                source: DROPS,
                vertex: "drop",
                fragment: "numbered_ball",
                each: Some(&copies.order_layout),
                targets: &[written(METRES), written(NUMBERS)],
                depth: Some(true),
                samples: 1,
            };
            let measure = Recipe {
                layouts: &[frame_layout, &copies.sight_layout, &self.probe_layout],
                source: PROBE,
                vertex: "everywhere",
                fragment: "measure",
                each: None,
                ..drops
            };
            [pipeline(gpu, &drops), pipeline(gpu, &measure)]
        });
        let place = self.pictures(gpu, size);
        if self.pictures[place].numbers.is_none() {
            let view = target(gpu, size, NUMBERS, 1).create_view(&Default::default());
            let resources =
                [&self.pictures[place].distances[0], &view].map(wgpu::BindingResource::TextureView);
            let group = group(gpu, &self.probe_layout, &resources);
            self.pictures[place].numbers = Some((view, group));
        }
        let own = &self.pictures[place];
        let bounds = ([0, 0, size[0], size[1]], size.map(|side| side as f32));
        let eye_group = copies.eye_group(0);
        if let Some((whose, group)) = &own.numbers {
            self.surface(encoder, (frame, eye_group), own, bounds, Some((&probe[0], whose)));
            let load = wgpu::LoadOp::Load;
            let attachments = [attach(metres, load), attach(numbers, load)];
            let mut pass = begin(encoder, "measure", &attachments, Some((depth, wgpu::LoadOp::Load)));
            pass.set_pipeline(&probe[1]);
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(1, eye_group, &[]);
            pass.set_bind_group(2, group, &[]);
            pass.draw(0..3, 0..1);
        }
        self.probe = Some(probe);
    }

    /// Computes the surface's distance into the first of the two textures.
    fn surface(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        (frame, eye_group): (&wgpu::BindGroup, &wgpu::BindGroup),
        own: &Pictures,
        ([x, y, width, height], reach): ([u32; 4], [f32; 2]),
        numbered: Option<(&wgpu::RenderPipeline, &wgpu::TextureView)>,
    ) {
        let numbers = numbered.map(|(_, numbers)| attach(numbers, CLEAR));
        let attachments: &[_] = match numbers {
            Some(numbers) => &[attach(&own.distances[0], CLEAR), numbers],
            None => &[attach(&own.distances[0], CLEAR)],
        };
        {
            let mut pass = begin(encoder, "drops", attachments, Some((&own.depth, wgpu::LoadOp::Clear(1.0))));
            pass.set_viewport(0.0, 0.0, reach[0], reach[1], 0.0, 1.0);
            pass.set_scissor_rect(x, y, width, height);
            pass.set_pipeline(numbered.map_or(&self.balls, |(pipeline, _)| pipeline));
            pass.set_bind_group(0, frame, &[]);
            pass.set_bind_group(1, eye_group, &[]);
            self.order.draw(&mut pass, 3);
        }
        for _ in 0..ROUNDS {
            for (from, into, pipeline) in [(0, 1, &self.rows), (1, 0, &self.columns)] {
                let mut pass = begin(encoder, "smoothing", &[attach(&own.distances[into], CLEAR)], None);
                pass.set_scissor_rect(x, y, width, height);
                pass.set_pipeline(pipeline);
                pass.set_bind_group(0, frame, &[]);
                pass.set_bind_group(1, eye_group, &[]);
                pass.set_bind_group(2, &own.smooth_groups[from], &[]);
                pass.draw(0..3, 0..1);
            }
        }
    }

    fn prepare(
        &mut self,
        gpu: &Gpu,
        (copies, frame_layout): (&ParticleCopies, &wgpu::BindGroupLayout),
        eye: usize,
        scene: &Scene<'_>,
    ) {
        let (format, samples) = scene.kind;
        let (depth_layout, _) = self.thickness.entry(samples).or_insert_with(|| {
            let depth_layout = layout(gpu, &[texels(0, wgpu::TextureSampleType::Depth, samples)]);
            let add = over(wgpu::BlendFactor::One);
            let recipe = Recipe {
                layouts: &[frame_layout, &copies.sight_layout, &depth_layout],
                source: &format!("{}{DROPS}{THICKNESS}", scene_depth(samples)),
                vertex: "drop",
                fragment: "thickness",
                each: Some(&copies.order_layout),
                targets: &[blended(OPTICAL, add), blended(WAY, add)],
                depth: None,
                samples: 1,
            };
            let pipeline = pipeline(gpu, &recipe);
            (depth_layout, pipeline)
        });
        if self.depths.len() <= eye {
            self.depths.resize_with(eye + 1, || None);
        }
        if self.depths[eye].as_ref().is_none_or(|(before, _)| before != scene.depth) {
            let group = group(gpu, depth_layout, &[wgpu::BindingResource::TextureView(scene.depth)]);
            self.depths[eye] = Some((scene.depth.clone(), group));
        }
        let surface_layout = &self.surface_layout;
        self.surfaces.entry(scene.kind).or_insert_with(|| {
            let component = |dst_factor| wgpu::BlendComponent {
                src_factor: wgpu::BlendFactor::Zero,
                dst_factor,
                operation: wgpu::BlendOperation::Add,
            };
            let multiply = wgpu::BlendState {
                color: component(wgpu::BlendFactor::Src),
                alpha: component(wgpu::BlendFactor::One),
            };
            let surface = |fragment, write, blend| {
                pipeline(
                    gpu,
                    &Recipe {
                        layouts: &[frame_layout, &copies.sight_layout, surface_layout],
                        source: SURFACE,
                        vertex: "everywhere",
                        fragment,
                        each: None,
                        targets: &[blended(format, blend)],
                        depth: Some(write),
                        samples,
                    },
                )
            };
            let add = over(wgpu::BlendFactor::One);
            [surface("absorb", false, multiply), surface("shine", true, add)]
        });
    }

    /// Index of the pictures of that size.
    fn pictures(&mut self, gpu: &Gpu, size: [u32; 2]) -> usize {
        if let Some(place) = self.pictures.iter().position(|pictures| pictures.size == size) {
            return place;
        }
        if self.pictures.len() >= KEPT_MAX {
            self.pictures.remove(0);
        }
        let view = |format| target(gpu, size, format, 1).create_view(&Default::default());
        let (distances, optical, way) = ([METRES; 2].map(view), view(OPTICAL), view(WAY));
        let texture = wgpu::BindingResource::TextureView;
        let smooth_groups = [0, 1].map(|from| group(gpu, &self.smooth_layout, &[texture(&distances[from])]));
        let resources = [texture(&distances[0]), texture(&optical), texture(&way)];
        let group = group(gpu, &self.surface_layout, &resources);
        let depth = view(DEPTH);
        self.pictures.push(Pictures {
            size,
            depth,
            distances,
            optical,
            way,
            numbers: None,
            smooth_groups,
            group,
        });
        self.pictures.len() - 1
    }
}

const CLEAR: wgpu::LoadOp<wgpu::Color> = wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT);

fn attach(
    view: &wgpu::TextureView,
    load: wgpu::LoadOp<wgpu::Color>,
) -> Option<wgpu::RenderPassColorAttachment<'_>> {
    let ops = wgpu::Operations { load, store: wgpu::StoreOp::Store };
    Some(wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops })
}

fn begin<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    label: &str,
    color_attachments: &[Option<wgpu::RenderPassColorAttachment<'_>>],
    depth: Option<(&wgpu::TextureView, wgpu::LoadOp<f32>)>,
) -> wgpu::RenderPass<'a> {
    let depth_stencil_attachment = depth.map(|(view, load)| wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load, store: wgpu::StoreOp::Store }),
        stencil_ops: None,
    });
    encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
        label: Some(label),
        color_attachments,
        depth_stencil_attachment,
        ..Default::default()
    })
}

/// The bounds in texels of so many pixels.
fn coarse([x, y, width, height]: [u32; 4], pixels: u32, size: [u32; 2]) -> [u32; 4] {
    let (left, top) = (x / pixels, y / pixels);
    let right = (x + width).div_ceil(pixels).min(size[0]);
    let bottom = (y + height).div_ceil(pixels).min(size[1]);
    [left, top, right.saturating_sub(left).max(1), bottom.saturating_sub(top).max(1)]
}
