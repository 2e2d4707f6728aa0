//! Per-frame uniforms: eye and lights. The buffers and bind groups are created once and rewritten for every frame.

use nalgebra::{Matrix4, Vector4};
use trocar_scene::Snapshot;

use crate::gpu::Gpu;
use crate::gpu::passes::Passes;
use crate::gpu::shadow_maps::SHADOW_SIDE;
use crate::gpu::uniforms::{GpuFrame, GpuLight};
use crate::lights::Shining;
use crate::view::View;

/// Ambient light relative to a well-lit white surface: from above and from below.
const ABOVE: [f32; 4] = [0.17, 0.175, 0.19, 0.0];
const BELOW: [f32; 4] = [0.045, 0.038, 0.036, 0.0];

/// The lights of a frame, and the exposure.
#[derive(Clone, Copy)]
pub(super) struct Lighting<'a> {
    pub(super) lights: &'a [Shining],
    pub(super) exposure: f64,
}

/// A uniform with its bind group.
type Slot = (wgpu::Buffer, wgpu::BindGroup);

/// Uniforms of the eyes and of the lights with shadows. Each may be used once per submission: writes take effect before
/// any draw of the submission.
#[derive(Default)]
pub(super) struct Frames {
    eyes: Vec<Slot>,
    shadows: Vec<Slot>,
}

impl Frames {
    /// Writes the view of the eye of that number.
    pub(super) fn set_eye(
        &mut self,
        gpu: &Gpu,
        passes: &Passes,
        index: usize,
        scene: &Snapshot,
        view: &View,
        lighting: &Lighting<'_>,
    ) {
        while self.eyes.len() <= index {
            let buffer = uniform(gpu, "frame", size_of::<GpuFrame>());
            let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("frame"),
                layout: &passes.frame_layout,
                entries: &[
                    wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() },
                    wgpu::BindGroupEntry {
                        binding: 1,
                        resource: wgpu::BindingResource::TextureView(&passes.shadow_maps.all),
                    },
                    wgpu::BindGroupEntry {
                        binding: 2,
                        resource: wgpu::BindingResource::Sampler(&passes.shadow_sampler),
                    },
                ],
            });
            self.eyes.push((buffer, group));
        }
        let frame = gpu_frame(scene, view, lighting);
        gpu.queue.write_buffer(&self.eyes[index].0, 0, bytemuck::bytes_of(&frame));
    }

    /// The bind group of an eye that was written.
    pub(super) fn eye(&self, index: usize) -> &wgpu::BindGroup {
        &self.eyes[index].1
    }

    /// Writes the projection of the light of that layer.
    pub(super) fn set_shadow(
        &mut self,
        gpu: &Gpu,
        passes: &Passes,
        layer: usize,
        clip_from_world: &Matrix4<f64>,
    ) {
        while self.shadows.len() <= layer {
            let buffer = uniform(gpu, "light", size_of::<[[f32; 4]; 4]>());
            let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("light"),
                layout: &passes.light_layout,
                entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
            });
            self.shadows.push((buffer, group));
        }
        let matrix = matrix(clip_from_world);
        gpu.queue.write_buffer(&self.shadows[layer].0, 0, bytemuck::bytes_of(&matrix));
    }

    /// The bind group of a light that was written.
    pub(super) fn shadow(&self, layer: usize) -> &wgpu::BindGroup {
        &self.shadows[layer].1
    }
}

fn gpu_frame(scene: &Snapshot, view: &View, lighting: &Lighting<'_>) -> GpuFrame {
    let Lighting { lights, exposure } = *lighting;
    let eye = view.world_from_eye.translation.vector;
    let forward = view.world_from_eye.rotation * nalgebra::Vector3::z();
    let mut frame = GpuFrame {
        clip_from_world: matrix(&view.clip_from_world()),
        eye: single(eye.push(scene.time().as_secs_f64())),
        forward: single(forward.push(0.0)),
        above: ABOVE,
        below: BELOW,
        light_count: lights.len() as u32,
        shadow_texel: 1.0 / SHADOW_SIDE as f32,
        ..GpuFrame::default()
    };
    for (slot, light) in frame.lights.iter_mut().zip(lights) {
        *slot = gpu_light(light, exposure);
    }
    frame
}

fn gpu_light(light: &Shining, exposure: f64) -> GpuLight {
    let clip_from_world = light.shadow.map_or(Matrix4::identity(), |(_, clip_from_world)| clip_from_world);
    let [outer, inner] = light.cone;
    let scale = 1.0 / (inner - outer).max(1e-6);
    GpuLight {
        position: light.position_in_world.coords.map(|part| part as f32).into(),
        cone_scale: scale as f32,
        direction: light.direction_in_world.map(|part| part as f32).into(),
        cone_bias: (-outer * scale) as f32,
        candela: light.candela.map(|part| (part * exposure) as f32).into(),
        unused: 0,
        clip_from_world: matrix(&clip_from_world),
    }
}

/// In the layout of the shaders.
pub(super) fn matrix(matrix: &Matrix4<f64>) -> [[f32; 4]; 4] {
    matrix.map(|part| part as f32).into()
}

fn single(vector: Vector4<f64>) -> [f32; 4] {
    vector.map(|part| part as f32).into()
}

fn uniform(gpu: &Gpu, label: &str, bytes: usize) -> wgpu::Buffer {
    gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some(label),
        size: bytes as u64,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}
