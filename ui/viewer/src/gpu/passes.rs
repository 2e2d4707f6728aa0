//! The pipelines: surfaces, shadows, probes.

use std::collections::HashMap;

use bytemuck::{Pod, Zeroable};

use crate::gpu::Gpu;
use crate::gpu::targets::{DEPTH, METRES, NUMBERS};
use crate::lights::{LIGHTS_MAX, SHADOWS_MAX};
use crate::quality::Quality;

/// Side of a shadow map \[texels\].
pub const SHADOW_SIDE: u32 = 1024;

/// A light, as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(crate) struct GpuLight {
    pub(crate) position: [f32; 3],
    pub(crate) cos_outer: f32,
    pub(crate) direction: [f32; 3],
    pub(crate) cos_inner: f32,
    pub(crate) candela: [f32; 3],
    pub(crate) shadow: i32,
    pub(crate) clip_from_world: [[f32; 4]; 4],
}

/// What holds for a whole frame, as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, Pod, Zeroable)]
pub(crate) struct GpuFrame {
    pub(crate) clip_from_world: [[f32; 4]; 4],
    pub(crate) eye: [f32; 4],
    pub(crate) forward: [f32; 4],
    pub(crate) above: [f32; 4],
    pub(crate) below: [f32; 4],
    pub(crate) light_count: u32,
    pub(crate) shadow_texel: f32,
    pub(crate) unused: [u32; 2],
    pub(crate) lights: [GpuLight; LIGHTS_MAX],
}

/// One item, as shaders read it.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub(crate) struct GpuItem {
    pub(crate) world_from_item: [[f32; 4]; 4],
    pub(crate) base_color: [f32; 4],
    pub(crate) surface: [f32; 4],
    pub(crate) tiling: [f32; 2],
    pub(crate) number: u32,
    pub(crate) flags: u32,
}

/// Which pipeline draws an item.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Key {
    /// With how much care.
    pub quality: Quality,
    /// Blended over what is behind it.
    pub blended: bool,
    /// What is drawn into.
    pub format: wgpu::TextureFormat,
    /// The material's own shader.
    pub shader: Option<String>,
}

/// Pipelines and what they share.
pub struct Passes {
    /// Layout of the frame's group.
    pub frame_layout: wgpu::BindGroupLayout,
    /// Layout of the items' group.
    pub items_layout: wgpu::BindGroupLayout,
    /// Layout of a light's own group, for its shadow.
    pub light_layout: wgpu::BindGroupLayout,
    /// Draws depths as a light sees them.
    pub shadow: wgpu::RenderPipeline,
    /// Draws depths and numbers.
    pub probe: wgpu::RenderPipeline,
    /// Depths as lights see them, a layer each.
    pub shadow_layers: Vec<wgpu::TextureView>,
    /// All of them.
    pub shadow_maps: wgpu::TextureView,
    /// Compares a depth with them.
    pub shadow_sampler: wgpu::Sampler,
    surface_layout: wgpu::PipelineLayout,
    surfaces: HashMap<Key, wgpu::RenderPipeline>,
}

fn uniform(visibility: wgpu::ShaderStages) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding: 0,
        visibility,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: false,
            min_binding_size: None,
        },
        count: None,
    }
}

const fn per_vertex<'a>(attributes: &'a [wgpu::VertexAttribute; 1]) -> wgpu::VertexBufferLayout<'a> {
    wgpu::VertexBufferLayout {
        array_stride: attributes[0].format.size(),
        step_mode: wgpu::VertexStepMode::Vertex,
        attributes,
    }
}
const POSITION: wgpu::VertexBufferLayout<'_> = per_vertex(&wgpu::vertex_attr_array![0 => Float32x3]);
const NORMAL: wgpu::VertexBufferLayout<'_> = per_vertex(&wgpu::vertex_attr_array![1 => Float32x3]);
const UV: wgpu::VertexBufferLayout<'_> = per_vertex(&wgpu::vertex_attr_array![2 => Float32x2]);
/// Positions move, texture coordinates stay: each has a buffer of its own.
const VERTEX: [Option<wgpu::VertexBufferLayout<'_>>; 3] = [Some(POSITION), Some(NORMAL), Some(UV)];
const COMMON: &str = concat!(include_str!("../shaders/item.wgsl"), include_str!("../shaders/common.wgsl"));
const SURFACE: &str = include_str!("../shaders/surface.wgsl");
const MATERIAL: &str = include_str!("../shaders/material.wgsl");
const PROBE: &str = include_str!("../shaders/probe.wgsl");
const SHADOW: &str = concat!(include_str!("../shaders/item.wgsl"), include_str!("../shaders/shadow.wgsl"));

impl Passes {
    /// The pipelines that everything needs; those of surfaces are made when they are first used.
    pub fn new(gpu: &Gpu, material_layout: &wgpu::BindGroupLayout) -> Self {
        let device = &gpu.device;
        let group = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let shadow_entries = [
            uniform(wgpu::ShaderStages::VERTEX_FRAGMENT),
            wgpu::BindGroupLayoutEntry {
                binding: 1,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: wgpu::BindingType::Texture {
                    sample_type: wgpu::TextureSampleType::Depth,
                    view_dimension: wgpu::TextureViewDimension::D2Array,
                    multisampled: false,
                },
                count: None,
            },
            wgpu::BindGroupLayoutEntry {
                binding: 2,
                visibility: wgpu::ShaderStages::FRAGMENT,
                ty: wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Comparison),
                count: None,
            },
        ];
        let frame_layout = group("frame", &shadow_entries);
        let items_entry = wgpu::BindGroupLayoutEntry {
            ty: wgpu::BindingType::Buffer {
                ty: wgpu::BufferBindingType::Storage { read_only: true },
                has_dynamic_offset: false,
                min_binding_size: None,
            },
            ..uniform(wgpu::ShaderStages::VERTEX_FRAGMENT)
        };
        let items_layout = group("items", &[items_entry]);
        let light_layout = group("light", &[uniform(wgpu::ShaderStages::VERTEX)]);
        let pipeline_layout = |groups: &[&wgpu::BindGroupLayout]| {
            let groups: Vec<_> = groups.iter().map(|group| Some(*group)).collect();
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: None,
                bind_group_layouts: &groups,
                immediate_size: 0,
            })
        };
        let module = |source: &str| {
            device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: None,
                source: wgpu::ShaderSource::Wgsl(source.into()),
            })
        };
        let shadow = module(SHADOW);
        let shadow = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("shadow"),
            layout: Some(&pipeline_layout(&[&light_layout, &items_layout])),
            vertex: wgpu::VertexState {
                module: &shadow,
                entry_point: None,
                compilation_options: Default::default(),
                buffers: &VERTEX[..1],
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(wgpu::DepthStencilState {
                bias: wgpu::DepthBiasState { constant: 2, slope_scale: 2.0, clamp: 0.0 },
                ..depth(wgpu::CompareFunction::Less, true)
            }),
            multisample: Default::default(),
            fragment: None,
            multiview_mask: None,
            cache: None,
        });
        let probe = module(&format!("{COMMON}{PROBE}"));
        let probe_targets = [METRES, NUMBERS].map(|format| Some(wgpu::ColorTargetState::from(format)));
        let probe = device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("probe"),
            layout: Some(&pipeline_layout(&[&frame_layout, &items_layout])),
            vertex: wgpu::VertexState {
                module: &probe,
                entry_point: None,
                compilation_options: Default::default(),
                buffers: &VERTEX,
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(depth(wgpu::CompareFunction::Less, true)),
            multisample: Default::default(),
            fragment: Some(wgpu::FragmentState {
                module: &probe,
                entry_point: None,
                compilation_options: Default::default(),
                targets: &probe_targets,
            }),
            multiview_mask: None,
            cache: None,
        });
        let maps = device.create_texture(&wgpu::TextureDescriptor {
            label: Some("shadows"),
            size: wgpu::Extent3d {
                width: SHADOW_SIDE,
                height: SHADOW_SIDE,
                depth_or_array_layers: SHADOWS_MAX as u32,
            },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: DEPTH,
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING,
            view_formats: &[],
        });
        let layer = |layer| {
            maps.create_view(&wgpu::TextureViewDescriptor {
                dimension: Some(wgpu::TextureViewDimension::D2),
                base_array_layer: layer,
                array_layer_count: Some(1),
                ..Default::default()
            })
        };
        let all = wgpu::TextureViewDescriptor {
            dimension: Some(wgpu::TextureViewDimension::D2Array),
            ..Default::default()
        };
        Self {
            surface_layout: pipeline_layout(&[&frame_layout, &items_layout, material_layout]),
            shadow,
            probe,
            shadow_layers: (0..SHADOWS_MAX as u32).map(layer).collect(),
            shadow_maps: maps.create_view(&all),
            shadow_sampler: device.create_sampler(&wgpu::SamplerDescriptor {
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                compare: Some(wgpu::CompareFunction::LessEqual),
                ..Default::default()
            }),
            frame_layout,
            items_layout,
            light_layout,
            surfaces: HashMap::new(),
        }
    }

    /// Makes the pipeline of this kind, unless it is there.
    pub fn prepare(&mut self, gpu: &Gpu, key: &Key) {
        if !self.surfaces.contains_key(key) {
            let pipeline = self.surface_pipeline(gpu, key);
            self.surfaces.insert(key.clone(), pipeline);
        }
    }

    /// A pipeline that was prepared.
    pub fn surface(&self, key: &Key) -> Option<&wgpu::RenderPipeline> {
        self.surfaces.get(key)
    }

    fn surface_pipeline(&self, gpu: &Gpu, key: &Key) -> wgpu::RenderPipeline {
        let material = key.shader.as_deref().unwrap_or(MATERIAL);
        let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
            label: Some("surface"),
            source: wgpu::ShaderSource::Wgsl(format!("{COMMON}{SURFACE}{material}").into()),
        });
        let flag = |on: bool| if on { 1.0 } else { 0.0 };
        let constants = [
            ("MAPS", flag(key.quality.maps)),
            ("WET", flag(key.quality.wet)),
            ("SHADOWS", flag(key.quality.shadows)),
        ];
        let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
        let target = wgpu::ColorTargetState {
            format: key.format,
            blend: key.blended.then_some(wgpu::BlendState::ALPHA_BLENDING),
            write_mask: wgpu::ColorWrites::ALL,
        };
        gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some("surface"),
            layout: Some(&self.surface_layout),
            vertex: wgpu::VertexState {
                module: &module,
                entry_point: Some("corner"),
                compilation_options: options.clone(),
                buffers: &VERTEX,
            },
            primitive: wgpu::PrimitiveState::default(),
            depth_stencil: Some(depth(wgpu::CompareFunction::Less, !key.blended)),
            multisample: wgpu::MultisampleState { count: key.quality.samples, ..Default::default() },
            fragment: Some(wgpu::FragmentState {
                module: &module,
                entry_point: Some("shade"),
                compilation_options: options,
                targets: &[Some(target)],
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Whether a material's own `surface` function fits into the shader.
///
/// # Errors
/// What the compiler says, with lines counted in the material's own text.
pub fn check_material(gpu: &Gpu, material: &str) -> Result<(), String> {
    let before = format!("{COMMON}{SURFACE}");
    let scope = gpu.device.push_error_scope(wgpu::ErrorFilter::Validation);
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("material"),
        source: wgpu::ShaderSource::Wgsl(format!("{before}{material}").into()),
    });
    let told = pollster::block_on(module.get_compilation_info());
    let failed = pollster::block_on(scope.pop());
    let lines_before = before.matches('\n').count() as u32;
    let error =
        told.messages.iter().find(|message| message.message_type == wgpu::CompilationMessageType::Error);
    match (error, failed) {
        (Some(error), _) => {
            let line = error.location.map_or(0, |at| at.line_number.saturating_sub(lines_before));
            Err(format!("line {line}: {}", error.message))
        }
        (None, Some(error)) => Err(error.to_string()),
        (None, None) => Ok(()),
    }
}

fn depth(compare: wgpu::CompareFunction, write: bool) -> wgpu::DepthStencilState {
    wgpu::DepthStencilState {
        format: DEPTH,
        depth_write_enabled: Some(write),
        depth_compare: Some(compare),
        stencil: Default::default(),
        bias: Default::default(),
    }
}
