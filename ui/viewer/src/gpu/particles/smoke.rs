//! Draws smoke as sorted billboards, from back to front.

use std::collections::HashMap;

use trocar_scene::random::seed_of;
use wgpu::util::DeviceExt;

use super::{Order, ParticleCopies, Recipe, group, layout, over, pipeline, scene_depth, texels};
use crate::gpu::Gpu;
use crate::gpu::targets::target;
use crate::particles::Swarm;
use crate::texture::noise::Fbm;
use crate::view::View;

/// Side of the puff texture \[texels\].
const WISPS_SIDE: u32 = 128;

/// Format of the low-resolution smoke picture.
const VEIL: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
/// Most sizes of such pictures kept.
const KEPT_MAX: usize = 4;

/// The picture's format, samples per pixel.
type Kind = (wgpu::TextureFormat, u32);

/// The data of one eye.
#[derive(Default)]
struct EyeBuffers {
    order: Order,
    /// The bind group of the scene's depth, and that depth texture.
    depth: Option<(wgpu::TextureView, wgpu::BindGroup)>,
}

/// Draws smoke. Created when a scene first has some.
pub(crate) struct SmokePass {
    /// By samples per pixel.
    depth_layouts: HashMap<u32, wgpu::BindGroupLayout>,
    /// Pipelines that draw directly into pictures.
    straight: HashMap<Kind, wgpu::RenderPipeline>,
    /// Pipelines that draw into the low-resolution picture, by the scene's samples per pixel.
    apart: HashMap<u32, wgpu::RenderPipeline>,
    veil_layout: wgpu::BindGroupLayout,
    /// Pipelines that composite that picture over the scene.
    veils: HashMap<Kind, wgpu::RenderPipeline>,
    pictures: Vec<([u32; 2], wgpu::TextureView, wgpu::BindGroup)>,
    wisps: wgpu::TextureView,
    sampler: wgpu::Sampler,
    clamped: wgpu::Sampler,
    eyes: Vec<EyeBuffers>,
    keys: Vec<(f32, u32)>,
}

impl SmokePass {
    pub(crate) fn new(gpu: &Gpu) -> Self {
        let linear = |mode| {
            gpu.device.create_sampler(&wgpu::SamplerDescriptor {
                address_mode_u: mode,
                address_mode_v: mode,
                mag_filter: wgpu::FilterMode::Linear,
                min_filter: wgpu::FilterMode::Linear,
                ..Default::default()
            })
        };
        Self {
            depth_layouts: HashMap::new(),
            straight: HashMap::new(),
            apart: HashMap::new(),
            veil_layout: layout(gpu, &[smooth_texels(0), sampler(1)]),
            veils: HashMap::new(),
            pictures: Vec::new(),
            wisps: wisps(gpu),
            sampler: linear(wgpu::AddressMode::Repeat),
            clamped: linear(wgpu::AddressMode::ClampToEdge),
            eyes: Vec::new(),
            keys: Vec::new(),
        }
    }

    /// Creates what an eye needs to draw into pictures of that kind, over a scene of that depth.
    pub(crate) fn prepare(
        &mut self,
        gpu: &Gpu,
        (copies, frame_layout): (&ParticleCopies, &wgpu::BindGroupLayout),
        swarm: &Swarm,
        eye: usize,
        view: &View,
        (kind, depth, smoke_pixels): (Kind, &wgpu::TextureView, u32),
    ) {
        let (format, samples) = kind;
        let depth_layout = self.depth_layouts.entry(samples).or_insert_with(|| {
            let entries = [texels(0, wgpu::TextureSampleType::Depth, samples), smooth_texels(1), sampler(2)];
            layout(gpu, &entries)
        });
        let blend = Some(over(wgpu::BlendFactor::OneMinusSrcAlpha));
        let state =
            |format| Some(wgpu::ColorTargetState { format, blend, write_mask: wgpu::ColorWrites::ALL });
        let source = || format!("{}{}", scene_depth(samples), include_str!("../../shaders/smoke.wgsl"));
        let puffs = Recipe {
            layouts: &[frame_layout, &copies.sight_layout, depth_layout],
            source: "",
            vertex: "puff",
            fragment: "smoke",
            each: Some(&copies.order_layout),
            targets: &[state(format)],
            depth: Some(false),
            samples,
        };
        if smoke_pixels == 1 {
            let new = || pipeline(gpu, &Recipe { source: &source(), ..puffs });
            self.straight.entry(kind).or_insert_with(new);
        } else {
            let targets = &[state(VEIL)];
            let new =
                || pipeline(gpu, &Recipe { source: &source(), targets, depth: None, samples: 1, ..puffs });
            self.apart.entry(samples).or_insert_with(new);
            let veil = Recipe {
                layouts: &[frame_layout, &copies.sight_layout, &self.veil_layout],
                source: include_str!("../../shaders/smoke_veil.wgsl"),
                vertex: "everywhere",
                fragment: "cover",
                each: None,
                ..puffs
            };
            self.veils.entry(kind).or_insert_with(|| pipeline(gpu, &veil));
        }
        if self.eyes.len() <= eye {
            self.eyes.resize_with(eye + 1, EyeBuffers::default);
        }
        let own = &mut self.eyes[eye];
        if own.depth.as_ref().is_none_or(|(before, _)| before != depth) {
            let resources = [
                wgpu::BindingResource::TextureView(depth),
                wgpu::BindingResource::TextureView(&self.wisps),
                wgpu::BindingResource::Sampler(&self.sampler),
            ];
            own.depth = Some((depth.clone(), group(gpu, depth_layout, &resources)));
        }
        swarm.sorted(view, &mut self.keys, &mut own.order.list);
        own.order.send(gpu, copies);
    }

    /// Draws for a prepared eye into a picture of lower resolution than the pane; returns its index, for
    /// [`Self::draw`].
    pub(crate) fn draw_apart(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        (frame, eye_group): (&wgpu::BindGroup, &wgpu::BindGroup),
        eye: usize,
        samples: u32,
        (pane, smoke_pixels): ([u32; 2], u32),
    ) -> Option<usize> {
        let place = self.picture(gpu, pane.map(|side| side.div_ceil(smoke_pixels)));
        let own = self.eyes.get(eye)?;
        let (pipeline, (_, depth)) = (self.apart.get(&samples)?, own.depth.as_ref()?);
        let ops = wgpu::Operations {
            load: wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT),
            store: wgpu::StoreOp::Store,
        };
        let view = &self.pictures[place].1;
        let attachment =
            wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops };
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some("smoke apart"),
            color_attachments: &[Some(attachment)],
            ..Default::default()
        });
        let [width, height] = pane.map(|side| side as f32 / smoke_pixels as f32);
        pass.set_viewport(0.0, 0.0, width, height, 0.0, 1.0);
        pass.set_pipeline(pipeline);
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, eye_group, &[]);
        pass.set_bind_group(2, depth, &[]);
        own.order.draw(&mut pass, 6);
        Some(place)
    }

    /// Draws for a prepared eye, in a pass with read-only depth and the frame and sight groups bound; from the
    /// low-resolution picture if it was drawn there.
    pub(crate) fn draw(&self, pass: &mut wgpu::RenderPass<'_>, eye: usize, kind: Kind, apart: Option<usize>) {
        if let Some((_, _, group)) = apart.and_then(|place| self.pictures.get(place)) {
            if let Some(pipeline) = self.veils.get(&kind) {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(2, group, &[]);
                pass.draw(0..3, 0..1);
            }
            return;
        }
        let Some(own) = self.eyes.get(eye) else { return };
        if let (Some(pipeline), Some((_, depth))) = (self.straight.get(&kind), &own.depth) {
            pass.set_pipeline(pipeline);
            pass.set_bind_group(2, depth, &[]);
            own.order.draw(pass, 6);
        }
    }

    /// Index of the picture of that size.
    fn picture(&mut self, gpu: &Gpu, size: [u32; 2]) -> usize {
        if let Some(place) = self.pictures.iter().position(|(other, ..)| *other == size) {
            return place;
        }
        if self.pictures.len() >= KEPT_MAX {
            self.pictures.remove(0);
        }
        let view = target(gpu, size, VEIL, 1).create_view(&Default::default());
        let resources =
            [wgpu::BindingResource::TextureView(&view), wgpu::BindingResource::Sampler(&self.clamped)];
        let group = group(gpu, &self.veil_layout, &resources);
        self.pictures.push((size, view, group));
        self.pictures.len() - 1
    }
}

fn smooth_texels(binding: u32) -> wgpu::BindGroupLayoutEntry {
    texels(binding, wgpu::TextureSampleType::Float { filterable: true }, 1)
}

fn sampler(binding: u32) -> wgpu::BindGroupLayoutEntry {
    let ty = wgpu::BindingType::Sampler(wgpu::SamplerBindingType::Filtering);
    wgpu::BindGroupLayoutEntry { ty, ..smooth_texels(binding) }
}

/// The texture of density variations.
fn wisps(gpu: &Gpu) -> wgpu::TextureView {
    let noise = Fbm::field(seed_of("smoke"), [4, 4], 4, 0.55, WISPS_SIDE);
    let place = |index: u32| (index as f32 + 0.5) / WISPS_SIDE as f32;
    let texel = |index: u32| {
        let value = noise.at(place(index % WISPS_SIDE), place(index / WISPS_SIDE));
        ((0.5 + 0.7 * value).clamp(0.0, 1.0) * 255.0).round() as u8
    };
    let bytes: Vec<u8> = (0..WISPS_SIDE * WISPS_SIDE).map(texel).collect();
    let descriptor = wgpu::TextureDescriptor {
        label: Some("wisps"),
        size: wgpu::Extent3d { width: WISPS_SIDE, height: WISPS_SIDE, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: wgpu::TextureFormat::R8Unorm,
        usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
        view_formats: &[],
    };
    let order = wgpu::util::TextureDataOrder::LayerMajor;
    gpu.device
        .create_texture_with_data(&gpu.queue, &descriptor, order, &bytes)
        .create_view(&Default::default())
}
