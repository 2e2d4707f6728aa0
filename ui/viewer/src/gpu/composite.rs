//! The last pass of a frame: lens distortion, stereo interleaving, panes.

use bytemuck::{Pod, Zeroable};

use crate::gpu::Gpu;
use crate::layout::Weave;
use crate::view::View;

/// The uniforms of the shader.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Uniform {
    distortion: f32,
    vignette: f32,
    aspect: f32,
    how: u32,
    pane: [f32; 4],
}

/// The pictures of the eyes, and their target.
#[derive(Clone, Copy)]
pub struct Seen<'a> {
    /// Pane in the target \[pixels\]: left, top, width, height.
    pub pane: [u32; 4],
    /// Pictures of the left and the right eye; the same for a single eye.
    pub eyes: [&'a wgpu::TextureView; 2],
    /// The view, for its lens.
    pub view: &'a View,
    /// Combination of the two pictures.
    pub weave: Weave,
    /// Whether the target must be cleared.
    pub clear: bool,
}

/// The bindings of one draw, kept as long as the eyes' textures are the same.
struct Slot {
    uniform: wgpu::Buffer,
    eyes: [wgpu::TextureView; 2],
    group: wgpu::BindGroup,
}

/// The pass for one texture format.
pub struct Composite {
    slots: Vec<Slot>,
    format: wgpu::TextureFormat,
    layout: wgpu::BindGroupLayout,
    pipeline: wgpu::RenderPipeline,
    sampler: wgpu::Sampler,
}

impl Composite {
    /// For targets of that format.
    pub fn new(gpu: &Gpu, format: wgpu::TextureFormat) -> Self {
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("composite"),
            source: wgpu::ShaderSource::Wgsl(include_str!("../shaders/composite.wgsl").into()),
        });
        let pipeline = gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("composite"),
            layout: None,
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: None,
                compilation_options: Default::default(),
                buffers: &[],
            },
            primitive: Default::default(),
            depth_stencil: None,
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: None,
                compilation_options: Default::default(),
                targets: &[Some(format.into())],
            }),
            multiview_mask: None,
            cache: None,
        });
        let sampler = gpu.device.create_sampler(&wgpu::SamplerDescriptor {
            mag_filter: wgpu::FilterMode::Linear,
            min_filter: wgpu::FilterMode::Linear,
            ..Default::default()
        });
        Self { slots: Vec::new(), format, layout: pipeline.get_bind_group_layout(0), pipeline, sampler }
    }

    /// Whether it draws into targets of that format.
    pub fn is_for(&self, format: wgpu::TextureFormat) -> bool {
        self.format == format
    }

    /// Draws the picture of one eye or two into `target`; `index` counts the draws of a submission.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        index: usize,
        seen: &Seen<'_>,
    ) {
        let Seen { pane, eyes, view, weave, clear } = *seen;
        let uniform = Uniform {
            distortion: view.distortion as f32,
            vignette: view.vignette as f32,
            aspect: view.lens.aspect as f32,
            how: match weave {
                Weave::Panes => 0,
                Weave::Rows => 1,
                Weave::Colors => 2,
            },
            pane: pane.map(|pixels| pixels as f32),
        };
        if self.slots.get(index).is_none_or(|slot| [&slot.eyes[0], &slot.eyes[1]] != eyes) {
            let slot = self.slot(gpu, eyes);
            self.slots.truncate(index);
            self.slots.push(slot);
        }
        let slot = &self.slots[index.min(self.slots.len() - 1)];
        gpu.queue.write_buffer(&slot.uniform, 0, bytemuck::bytes_of(&uniform));
        let load = if clear { wgpu::LoadOp::Clear(wgpu::Color::BLACK) } else { wgpu::LoadOp::Load };
        let attachment = wgpu::RenderPassColorAttachment {
            view: target,
            depth_slice: None,
            resolve_target: None,
            ops: wgpu::Operations { load, store: wgpu::StoreOp::Store },
        };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("composite"),
            color_attachments: &[Some(attachment)],
            ..Default::default()
        });
        let [x, y, width, height] = pane.map(|pixels| pixels as f32);
        pass.set_viewport(x, y, width, height, 0.0, 1.0);
        pass.set_pipeline(&self.pipeline);
        pass.set_bind_group(0, &slot.group, &[]);
        pass.draw(0..3, 0..1);
    }

    fn slot(&self, gpu: &Gpu, eyes: [&wgpu::TextureView; 2]) -> Slot {
        let uniform = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("composite"),
            size: size_of::<Uniform>() as u64,
            usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let binding = |binding, resource| wgpu::BindGroupEntry { binding, resource };
        let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("composite"),
            layout: &self.layout,
            entries: &[
                binding(0, uniform.as_entire_binding()),
                binding(1, wgpu::BindingResource::TextureView(eyes[0])),
                binding(2, wgpu::BindingResource::TextureView(eyes[1])),
                binding(3, wgpu::BindingResource::Sampler(&self.sampler)),
            ],
        });
        Slot { uniform, eyes: eyes.map(Clone::clone), group }
    }
}
