//! The lower bound: a bare loop that draws the triangles of a scene with one light and Phong's highlight (Phong 1975).
//! It is optimised for just that: interleaved vertices, one draw for each surface from the nearest to the farthest, no
//! allocation per frame.

use bytemuck::{Pod, Zeroable};
use nalgebra::{Matrix4, Point3, Vector3};
use wgpu::util::DeviceExt;

use crate::draw_list::{DrawList, Item};
use crate::gpu::{Gpu, targets};
use crate::view::View;

/// Stride of the items' uniforms: the alignment that every adapter supports.
const STRIDE: usize = 256;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Frame {
    clip_from_world: [[f32; 4]; 4],
    eye: [f32; 4],
    light: [f32; 4],
    candela: [f32; 4],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct ItemUniform {
    world_from_item: [[f32; 4]; 4],
    color: [f32; 4],
}

struct Part {
    vertices: wgpu::Buffer,
    indices: wgpu::Buffer,
    count: u32,
    /// Index in the list of uniforms.
    index: usize,
}

/// The bare loop.
pub struct BaselineRenderer {
    pipeline: wgpu::RenderPipeline,
    frame: wgpu::Buffer,
    frame_group: wgpu::BindGroup,
    items: wgpu::Buffer,
    items_group: wgpu::BindGroup,
    bytes: Vec<u8>,
    parts: Vec<Part>,
    target: wgpu::TextureView,
    depth: wgpu::TextureView,
}

impl BaselineRenderer {
    /// For the present surfaces of the list, which must not deform, seen from `view`, into `target`.
    pub fn new(gpu: &Gpu, draw_list: &DrawList, view: &View, target: &wgpu::Texture) -> Self {
        let device = &gpu.device;
        let layout = |dynamic, bytes: usize| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
                label: None,
                entries: &[wgpu::BindGroupLayoutEntry {
                    binding: 0,
                    visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
                    ty: wgpu::BindingType::Buffer {
                        ty: wgpu::BufferBindingType::Uniform,
                        has_dynamic_offset: dynamic,
                        min_binding_size: wgpu::BufferSize::new(bytes as u64),
                    },
                    count: None,
                }],
            })
        };
        let layouts = [layout(false, size_of::<Frame>()), layout(true, size_of::<ItemUniform>())];
        let buffer = |bytes: usize| {
            device.create_buffer(&wgpu::BufferDescriptor {
                label: None,
                size: bytes as u64,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        };
        let group = |layout, buffer, bytes: usize| {
            let size = wgpu::BufferSize::new(bytes as u64);
            device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: None,
                layout,
                entries: &[wgpu::BindGroupEntry {
                    binding: 0,
                    resource: wgpu::BindingResource::Buffer(wgpu::BufferBinding { buffer, offset: 0, size }),
                }],
            })
        };
        let count = draw_list.items().len();
        let (frame, items) = (buffer(size_of::<Frame>()), buffer(STRIDE * count.max(1)));
        let frame_group = group(&layouts[0], &frame, size_of::<Frame>());
        let items_group = group(&layouts[1], &items, size_of::<ItemUniform>());
        let size = [target.width(), target.height()];
        let depth = targets::target(gpu, size, targets::DEPTH, 1).create_view(&Default::default());
        Self {
            pipeline: pipeline(gpu, &layouts, target.format()),
            frame,
            frame_group,
            items,
            items_group,
            bytes: vec![0; STRIDE * count],
            parts: parts(gpu, draw_list, view),
            target: target.create_view(&Default::default()),
            depth,
        }
    }

    /// Draws a frame: poses from the list, a light beside the eye.
    pub fn draw(&mut self, gpu: &Gpu, draw_list: &DrawList, view: &View) {
        let eye = view.world_from_eye.translation.vector;
        let light = eye + Vector3::new(0.05, 0.0, 0.05);
        let single = |vector: Vector3<f64>| [vector.x as f32, vector.y as f32, vector.z as f32, 0.0];
        let frame = Frame {
            clip_from_world: matrix(&view.clip_from_world()),
            eye: single(eye),
            light: single(light),
            candela: single(Vector3::repeat(0.03)),
        };
        gpu.queue.write_buffer(&self.frame, 0, bytemuck::bytes_of(&frame));
        for (item, bytes) in draw_list.items().iter().zip(self.bytes.chunks_exact_mut(STRIDE)) {
            let uniform = ItemUniform {
                world_from_item: matrix(&item.world_from_item.to_homogeneous()),
                color: item.material.base_color.map(|part| part as f32),
            };
            bytes[..size_of::<ItemUniform>()].copy_from_slice(bytemuck::bytes_of(&uniform));
        }
        gpu.queue.write_buffer(&self.items, 0, &self.bytes);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("bare"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &self.target,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                depth_stencil_attachment: Some(wgpu::RenderPassDepthStencilAttachment {
                    view: &self.depth,
                    depth_ops: Some(wgpu::Operations {
                        load: wgpu::LoadOp::Clear(1.0),
                        store: wgpu::StoreOp::Discard,
                    }),
                    stencil_ops: None,
                }),
                ..Default::default()
            });
            pass.set_pipeline(&self.pipeline);
            pass.set_bind_group(0, &self.frame_group, &[]);
            for part in &self.parts {
                pass.set_bind_group(1, &self.items_group, &[(STRIDE * part.index) as u32]);
                pass.set_vertex_buffer(0, part.vertices.slice(..));
                pass.set_index_buffer(part.indices.slice(..), wgpu::IndexFormat::Uint32);
                pass.draw_indexed(0..part.count, 0, 0..1);
            }
        }
        gpu.queue.submit([encoder.finish()]);
    }
}

/// Interleaved vertices, from the nearest to the farthest part.
fn parts(gpu: &Gpu, draw_list: &DrawList, view: &View) -> Vec<Part> {
    let eye_from_world = view.world_from_eye.inverse();
    let depth = |item: &Item| {
        let centre = eye_from_world * Point3::from(item.world_from_item.translation.vector);
        centre.z - f64::from(item.surface.geometry.radius)
    };
    let mut order: Vec<(usize, &Item)> = draw_list.items().iter().enumerate().collect();
    order.sort_by(|(_, a), (_, b)| depth(a).total_cmp(&depth(b)));
    let buffer = |contents: &[u8], usage| {
        gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label: None, contents, usage })
    };
    let part = |(index, item): (usize, &Item)| {
        let geometry = &item.surface.geometry;
        let vertices: Vec<[[f32; 3]; 2]> =
            geometry.positions.iter().zip(&geometry.normals).map(|(at, normal)| [*at, *normal]).collect();
        Part {
            vertices: buffer(bytemuck::cast_slice(&vertices), wgpu::BufferUsages::VERTEX),
            indices: buffer(bytemuck::cast_slice(&geometry.indices), wgpu::BufferUsages::INDEX),
            count: geometry.indices.len() as u32,
            index,
        }
    };
    order.into_iter().map(part).collect()
}

fn pipeline(
    gpu: &Gpu,
    layouts: &[wgpu::BindGroupLayout; 2],
    format: wgpu::TextureFormat,
) -> wgpu::RenderPipeline {
    let layout = gpu.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
        label: None,
        bind_group_layouts: &[Some(&layouts[0]), Some(&layouts[1])],
        immediate_size: 0,
    });
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("bare"),
        source: wgpu::ShaderSource::Wgsl(include_str!("baseline.wgsl").into()),
    });
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("bare"),
        layout: Some(&layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("corner"),
            compilation_options: Default::default(),
            buffers: &[Some(wgpu::VertexBufferLayout {
                array_stride: size_of::<[[f32; 3]; 2]>() as u64,
                step_mode: wgpu::VertexStepMode::Vertex,
                attributes: &wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32x3],
            })],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: targets::DEPTH,
            depth_write_enabled: Some(true),
            depth_compare: Some(wgpu::CompareFunction::Less),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: Default::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("shade"),
            compilation_options: Default::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}

fn matrix(matrix: &Matrix4<f64>) -> [[f32; 4]; 4] {
    matrix.map(|part| part as f32).into()
}
