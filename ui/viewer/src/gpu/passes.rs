//! Render pipelines: surfaces, shadows, probes.

use std::collections::{BTreeMap, HashMap};

use crate::gpu::Gpu;
use crate::gpu::shadow_maps::ShadowMaps;
use crate::gpu::targets::{DEPTH, METRES, NUMBERS};
use crate::gpu::uniforms::{GpuFrame, ITEM_BYTES};

/// Features of a material that its pipeline needs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Features {
    /// A colour map.
    pub color_map: bool,
    /// A normal map.
    pub normal_map: bool,
    /// An edit map.
    pub edit_map: bool,
    /// A free map.
    pub free_map: bool,
    /// Relief that is wider than a pixel.
    pub relief: bool,
    /// A wet coat.
    pub coat: bool,
}

/// How surfaces are shaded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Shading {
    /// One light with one highlight.
    Plain,
    /// Physically based.
    Full {
        /// Features of the material.
        features: Features,
        /// Interpolation between mip levels, and soft shadow edges.
        fine: bool,
        /// Number of active lights.
        lights: u32,
        /// Number of lights with shadows, which come first.
        shadows: u32,
        /// The material's own shader by its number; 0 is the default.
        shader: u32,
    },
}

/// The key of an item's pipeline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Key {
    /// How it is shaded.
    pub shading: Shading,
    /// Samples per pixel.
    pub samples: u32,
    /// Alpha blending.
    pub blended: bool,
    /// Format of the target.
    pub format: wgpu::TextureFormat,
}

/// Pipelines and their shared resources.
pub struct Passes {
    /// Layout of the frame's group.
    pub frame_layout: wgpu::BindGroupLayout,
    /// Layout of the items' group.
    pub items_layout: wgpu::BindGroupLayout,
    /// Layout of a light's bind group, for its shadow map.
    pub light_layout: wgpu::BindGroupLayout,
    /// Draws a shadow map.
    pub shadow: wgpu::RenderPipeline,
    /// Draws depths and numbers of a probe.
    pub probe: wgpu::RenderPipeline,
    /// The shadow maps.
    pub shadow_maps: ShadowMaps,
    /// The comparison sampler of the shadow maps.
    pub shadow_sampler: wgpu::Sampler,
    surface_layout: wgpu::PipelineLayout,
    plain_layout: wgpu::PipelineLayout,
    plain_module: wgpu::ShaderModule,
    /// Shader modules by the number of the material's own shader.
    modules: BTreeMap<u32, wgpu::ShaderModule>,
    surfaces: HashMap<Key, wgpu::RenderPipeline>,
}

pub(crate) fn uniform(
    visibility: wgpu::ShaderStages,
    dynamic: bool,
    bytes: u64,
) -> wgpu::BindGroupLayoutEntry {
    wgpu::BindGroupLayoutEntry {
        binding: 0,
        visibility,
        ty: wgpu::BindingType::Buffer {
            ty: wgpu::BufferBindingType::Uniform,
            has_dynamic_offset: dynamic,
            min_binding_size: wgpu::BufferSize::new(bytes),
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
/// Positions change and texture coordinates do not, so each has its own buffer.
const VERTEX: [Option<wgpu::VertexBufferLayout<'_>>; 3] = [Some(POSITION), Some(NORMAL), Some(UV)];
const COMMON: &str = concat!(
    include_str!("../shaders/item.wgsl"),
    include_str!("../shaders/frame.wgsl"),
    include_str!("../shaders/tone.wgsl"),
);
const PLAIN: &str = include_str!("../shaders/plain.wgsl");
const SURFACE: &str = include_str!("../shaders/surface.wgsl");
/// The default material shader.
pub(crate) const MATERIAL: &str = include_str!("../shaders/material.wgsl");
const PROBE: &str = include_str!("../shaders/probe.wgsl");
const SHADOW: &str = concat!(include_str!("../shaders/item.wgsl"), include_str!("../shaders/shadow.wgsl"));

impl Passes {
    /// The common pipelines; those of surfaces are created on first use.
    pub fn new(gpu: &Gpu, material_layout: &wgpu::BindGroupLayout) -> Self {
        let device = &gpu.device;
        let group = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let shadow_entries = [
            uniform(wgpu::ShaderStages::VERTEX_FRAGMENT, false, size_of::<GpuFrame>() as u64),
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
        let items_layout = group("items", &[uniform(wgpu::ShaderStages::VERTEX_FRAGMENT, true, ITEM_BYTES)]);
        let light_layout = group("light", &[uniform(wgpu::ShaderStages::VERTEX, false, 64)]);
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
                buffers: &VERTEX[..1],
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
        Self {
            surface_layout: pipeline_layout(&[&frame_layout, &items_layout, material_layout]),
            plain_layout: pipeline_layout(&[&frame_layout, &items_layout]),
            plain_module: module(&format!("{COMMON}{PLAIN}")),
            modules: BTreeMap::new(),
            shadow,
            probe,
            shadow_maps: ShadowMaps::new(gpu),
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

    /// The pipeline of this key, created on first use; `source` returns a material's own shader.
    pub fn surface<'a>(
        &mut self,
        gpu: &Gpu,
        key: &Key,
        source: impl FnOnce(u32) -> &'a str,
    ) -> wgpu::RenderPipeline {
        if let Some(pipeline) = self.surfaces.get(key) {
            return pipeline.clone();
        }
        let pipeline = match key.shading {
            Shading::Plain => {
                let stages = (&self.plain_layout, &self.plain_module, &VERTEX[..2]);
                surface_pipeline(gpu, key, stages, &[])
            }
            Shading::Full { features, fine, lights, shadows, shader } => {
                let module = self.modules.entry(shader).or_insert_with(|| {
                    let text = format!("{COMMON}{SURFACE}{}", source(shader));
                    gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
                        label: Some("surface"),
                        source: wgpu::ShaderSource::Wgsl(text.into()),
                    })
                });
                let flag = |on: bool| if on { 1.0 } else { 0.0 };
                let constants = [
                    ("COLOR_MAP", flag(features.color_map)),
                    ("NORMAL_MAP", flag(features.normal_map)),
                    ("EDIT_MAP", flag(features.edit_map)),
                    ("FREE_MAP", flag(features.free_map)),
                    ("RELIEF", flag(features.relief)),
                    ("COAT", flag(features.coat)),
                    ("FINE", flag(fine)),
                    ("LIGHTS", f64::from(lights)),
                    ("SHADOWS", f64::from(shadows)),
                ];
                surface_pipeline(gpu, key, (&self.surface_layout, module, &VERTEX), &constants)
            }
        };
        self.surfaces.insert(*key, pipeline.clone());
        pipeline
    }
}

fn surface_pipeline(
    gpu: &Gpu,
    key: &Key,
    (layout, module, buffers): (
        &wgpu::PipelineLayout,
        &wgpu::ShaderModule,
        &[Option<wgpu::VertexBufferLayout<'_>>],
    ),
    constants: &[(&str, f64)],
) -> wgpu::RenderPipeline {
    let options = wgpu::PipelineCompilationOptions { constants, ..Default::default() };
    let target = wgpu::ColorTargetState {
        format: key.format,
        blend: key.blended.then_some(wgpu::BlendState::ALPHA_BLENDING),
        write_mask: wgpu::ColorWrites::ALL,
    };
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("surface"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module,
            entry_point: Some("corner"),
            // The shader uses none of the constants.
            compilation_options: Default::default(),
            buffers,
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(depth(wgpu::CompareFunction::Less, !key.blended)),
        multisample: wgpu::MultisampleState { count: key.samples, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module,
            entry_point: Some("shade"),
            compilation_options: options,
            targets: &[Some(target)],
        }),
        multiview_mask: None,
        cache: None,
    })
}

/// Checks whether a material's own `surface` function compiles in the shader.
///
/// # Errors
/// The compiler's message, with line numbers of the material's own text.
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
