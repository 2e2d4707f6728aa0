//! Smoke and fluids on the device: copies of the particles, and the view of each eye.

pub mod fluid;
pub mod smoke;

use bytemuck::{Pod, Zeroable};

use crate::gpu::Gpu;
use crate::gpu::passes::uniform;
use crate::gpu::targets::DEPTH;
use crate::particles::{Particle, Swarm};
use crate::quality::Quality;
use crate::view::View;

/// Common source of all particle shaders.
const COMMON: &str = concat!(
    include_str!("../../shaders/frame.wgsl"),
    include_str!("../../shaders/tone.wgsl"),
    include_str!("../../shaders/particles.wgsl"),
);

/// Smoothing rounds along rows and columns: one alone leaves stripes.
pub(crate) const ROUNDS: usize = 2;

/// Quality of the particles.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ParticleQuality {
    /// Pixels per texel of a fluid's intermediate pictures.
    pub(crate) pixels: u32,
    /// Pixels per texel of the smoke picture.
    pub(crate) smoke_pixels: u32,
    /// Smoothing taps to either side.
    pub(crate) taps: i32,
    /// Whether only the strongest light is used.
    pub(crate) one_light: bool,
    /// Whether puffs have a texture.
    pub(crate) wisps: bool,
}

impl ParticleQuality {
    pub(crate) fn of(quality: Quality) -> Self {
        let Quality { wet, fine, .. } = quality;
        Self {
            pixels: if wet { 1 } else { 2 },
            smoke_pixels: if fine {
                1
            } else if wet {
                2
            } else {
                3
            },
            taps: if fine { 14 } else { 9 },
            one_light: !wet,
            wisps: wet,
        }
    }
}

/// Per-eye uniforms, in the layout of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
struct GpuEye {
    eye_from_world: [[f32; 4]; 4],
    scale: [f32; 2],
    shift: [f32; 2],
    near: f32,
    far: f32,
    texels: f32,
    pixels: f32,
    pane: [f32; 4],
    reach: f32,
    range: f32,
    taps: i32,
    lights: u32,
    shadows: u32,
    wisps: u32,
    first_number: u32,
    smoke_pixels: f32,
}

/// Data shared by the particles of one entity.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
struct GpuCloud {
    world_from_cloud: [[f32; 4]; 4],
    color: [f32; 3],
    unused: u32,
}

/// The view and settings of one eye.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EyeView<'a> {
    pub(crate) view: &'a View,
    /// Pane of the target \[pixels\]: left, top, width, height.
    pub(crate) pane: [u32; 4],
    pub(crate) quality: ParticleQuality,
    pub(crate) lights: u32,
    pub(crate) shadows: u32,
    /// Number of the first entity in a segmentation picture.
    pub(crate) first_number: u32,
}

/// Copies of particles: created once, then only changes are uploaded.
pub(crate) struct ParticleCopies {
    pub(crate) sight_layout: wgpu::BindGroupLayout,
    order_layout: wgpu::BindGroupLayout,
    particles: wgpu::Buffer,
    clouds: wgpu::Buffer,
    list: Vec<GpuCloud>,
    sent: Vec<GpuCloud>,
    eye_groups: Vec<(wgpu::Buffer, wgpu::BindGroup)>,
    /// Bytes of particles uploaded since the start.
    pub(crate) bytes_sent: u64,
}

impl ParticleCopies {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        use wgpu::ShaderStages as Stages;
        let storage = |binding, visibility| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only: true },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            count: None,
        };
        let entries = [
            uniform(Stages::VERTEX_FRAGMENT, false, size_of::<GpuEye>() as u64),
            storage(1, Stages::VERTEX),
            storage(2, Stages::VERTEX_FRAGMENT),
        ];
        let sight_layout = layout(gpu, &entries);
        Self {
            sight_layout,
            order_layout: layout(gpu, &[storage(0, Stages::VERTEX)]),
            particles: room(gpu, 0),
            clouds: room(gpu, 0),
            list: Vec::new(),
            sent: Vec::new(),
            eye_groups: Vec::new(),
            bytes_sent: 0,
        }
    }

    /// Uploads the changes of a swarm after its update.
    pub(crate) fn send(&mut self, gpu: &Gpu, swarm: &Swarm) {
        let each = size_of::<Particle>();
        let mut all = false;
        if self.particles.size() < size_of_val(swarm.particles()) as u64 {
            self.particles = room(gpu, size_of_val(swarm.particles()));
            self.eye_groups.clear();
            all = true;
        }
        for cloud in swarm.clouds().iter().filter(|cloud| (cloud.changed || all) && cloud.count > 0) {
            let rows = &swarm.particles()[cloud.first..cloud.first + cloud.count];
            gpu.queue.write_buffer(&self.particles, (cloud.first * each) as u64, bytemuck::cast_slice(rows));
            self.bytes_sent += size_of_val(rows) as u64;
        }
        self.list.clear();
        self.list.extend(swarm.clouds().iter().map(|cloud| GpuCloud {
            world_from_cloud: cloud.world_from_cloud.to_homogeneous().map(|part| part as f32).into(),
            color: cloud.color,
            unused: 0,
        }));
        if self.clouds.size() < (self.list.len() * size_of::<GpuCloud>()) as u64 {
            self.clouds = room(gpu, self.list.len().next_power_of_two() * size_of::<GpuCloud>());
            self.eye_groups.clear();
            self.sent.clear();
        }
        if self.sent != self.list {
            gpu.queue.write_buffer(&self.clouds, 0, bytemuck::cast_slice(&self.list));
            self.sent.clone_from(&self.list);
        }
    }

    /// Writes the view of an eye; each eye has its own number within a submission.
    pub(crate) fn set_eye(&mut self, gpu: &Gpu, eye: usize, swarm: &Swarm, of: &EyeView<'_>) {
        while self.eye_groups.len() <= eye {
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("eye"),
                size: size_of::<GpuEye>() as u64,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            let resources = [&buffer, &self.particles, &self.clouds].map(|buffer| buffer.as_entire_binding());
            let group = group(gpu, &self.sight_layout, &resources);
            self.eye_groups.push((buffer, group));
        }
        let EyeView { view, pane, quality, .. } = *of;
        let lens = &view.lens;
        let scale = lens.clip_from_eye();
        let radius = swarm.drop_radius() as f32;
        let texels =
            f64::from(pane[3]) / (2.0 * (0.5 * lens.field_of_view).tan() * f64::from(quality.pixels));
        let eye_view = GpuEye {
            eye_from_world: view.world_from_eye.inverse().to_homogeneous().map(|part| part as f32).into(),
            scale: [scale[(0, 0)] as f32, -scale[(1, 1)] as f32],
            shift: lens.shift.map(|part| part as f32),
            near: lens.near as f32,
            far: lens.far as f32,
            texels: texels as f32,
            pixels: quality.pixels as f32,
            pane: pane.map(|pixels| pixels as f32),
            reach: 2.2 * radius,
            range: radius,
            taps: quality.taps,
            lights: if quality.one_light { of.lights.min(1) } else { of.lights },
            shadows: of.shadows,
            wisps: u32::from(quality.wisps),
            first_number: of.first_number,
            smoke_pixels: quality.smoke_pixels as f32,
        };
        gpu.queue.write_buffer(&self.eye_groups[eye].0, 0, bytemuck::bytes_of(&eye_view));
    }

    /// The bind group of an eye that was written.
    pub(crate) fn eye_group(&self, eye: usize) -> &wgpu::BindGroup {
        &self.eye_groups[eye].1
    }
}

/// The drawing order on the device: the indices of the drawn particles.
#[derive(Default)]
pub(crate) struct Order {
    buffer: Option<(wgpu::Buffer, wgpu::BindGroup)>,
    pub(crate) list: Vec<u32>,
    sent: Vec<u32>,
}

impl Order {
    /// Uploads the list if it has changed.
    pub(crate) fn send(&mut self, gpu: &Gpu, copies: &ParticleCopies) {
        if self.list.is_empty() || self.list == self.sent {
            return;
        }
        let bytes: &[u8] = bytemuck::cast_slice(&self.list);
        let fits = |(buffer, _): &(wgpu::Buffer, wgpu::BindGroup)| buffer.size() >= bytes.len() as u64;
        let (buffer, group) = self.buffer.take().filter(fits).unwrap_or_else(|| {
            let buffer = room(gpu, bytes.len().next_power_of_two());
            let group = group(gpu, &copies.order_layout, &[buffer.as_entire_binding()]);
            (buffer, group)
        });
        gpu.queue.write_buffer(&buffer, 0, bytes);
        self.sent.clone_from(&self.list);
        self.buffer = Some((buffer, group));
    }

    /// Draws so many vertices for each particle.
    pub(crate) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, vertices: u32) {
        if let (Some((_, group)), false) = (&self.buffer, self.list.is_empty()) {
            pass.set_bind_group(3, group, &[]);
            pass.draw(0..vertices * self.list.len() as u32, 0..1);
        }
    }
}

/// The shader source that reads the scene's depth, with so many samples per pixel.
fn scene_depth(samples: u32) -> &'static str {
    if samples > 1 {
        include_str!("../../shaders/scene_depth_4.wgsl")
    } else {
        include_str!("../../shaders/scene_depth.wgsl")
    }
}

/// The binding of a texture that fragment shaders read by texel.
fn texels(binding: u32, sample_type: wgpu::TextureSampleType, samples: u32) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding,
        visibility: wgpu::ShaderStages::FRAGMENT,
        ty: wgpu::BindingType::Texture {
            sample_type,
            view_dimension: wgpu::TextureViewDimension::D2,
            multisampled: samples > 1,
        },
        count: None,
    }
}

fn layout(gpu: &Gpu, entries: &[wgpu::BindGroupLayoutEntry]) -> wgpu::BindGroupLayout {
    let descriptor = wgpu::BindGroupLayoutDescriptor { label: Some("particles"), entries };
    gpu.device.create_bind_group_layout(&descriptor)
}

/// A bind group with these at 0, 1, and so on.
fn group(
    gpu: &Gpu,
    layout: &wgpu::BindGroupLayout,
    resources: &[wgpu::BindingResource<'_>],
) -> wgpu::BindGroup {
    let mut entries = Vec::with_capacity(resources.len());
    for (binding, resource) in (0..).zip(resources) {
        entries.push(wgpu::BindGroupEntry { binding, resource: resource.clone() });
    }
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("particles"),
        layout,
        entries: &entries,
    })
}

fn room(gpu: &Gpu, bytes: usize) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("particles"),
        // Shaders require at least one element.
        size: bytes.max(size_of::<GpuCloud>()) as u64,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// The parts of a particle pipeline.
#[derive(Clone, Copy)]
struct Recipe<'a> {
    layouts: &'a [&'a wgpu::BindGroupLayout],
    source: &'a str,
    vertex: &'a str,
    fragment: &'a str,
    /// Layout of the drawing order, for a pipeline that draws particles; `None` for one that covers the whole pane.
    each: Option<&'a wgpu::BindGroupLayout>,
    targets: &'a [Option<wgpu::ColorTargetState>],
    /// Whether it writes depths; `None` without a depth attachment.
    depth: Option<bool>,
    samples: u32,
}

fn pipeline(gpu: &Gpu, recipe: &Recipe<'_>) -> wgpu::RenderPipeline {
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some(recipe.fragment),
        source: wgpu::ShaderSource::Wgsl(format!("{COMMON}{}", recipe.source).into()),
    });
    let mut groups: Vec<_> = recipe.layouts.iter().map(|group| Some(*group)).collect();
    if recipe.each.is_some() {
        groups.resize(3, None);
        groups.push(recipe.each);
    }
    let pipeline_layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: Some(recipe.fragment),
        bind_group_layouts: &groups,
        immediate_size: 0,
    });
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some(recipe.fragment),
        layout: Some(&pipeline_layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some(recipe.vertex),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: Default::default(),
        depth_stencil: recipe.depth.map(|write| wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(write),
            depth_compare: Some(wgpu::CompareFunction::LessEqual),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: wgpu::MultisampleState { count: recipe.samples, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some(recipe.fragment),
            compilation_options: Default::default(),
            targets: recipe.targets,
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// Adds the source to the destination times `left`.
const fn over(left: wgpu::BlendFactor) -> wgpu::BlendState {
    let component = wgpu::BlendComponent {
        src_factor: wgpu::BlendFactor::One,
        dst_factor: left,
        operation: wgpu::BlendOperation::Add,
    };
    wgpu::BlendState { color: component, alpha: component }
}
