//! From a snapshot to a frame.

use std::path::PathBuf;

use nalgebra::{Matrix4, Point3, Vector4};
use trocar_scene::{Entity, Snapshot, VisualMaterial};
use wgpu::util::DeviceExt;

use crate::error::ViewError;
use crate::gpu::composite::{Composite, Seen};
use crate::gpu::edits::Edits;
use crate::gpu::materials::Materials;
use crate::gpu::passes::{GpuFrame, GpuItem, GpuLight, Key, Passes, SHADOW_SIDE};
use crate::gpu::surfaces::SurfaceCopies;
use crate::gpu::{Gpu, targets};
use crate::layout::{Layout, Weave};
use crate::lights::{self, Shining};
use crate::picture::Probe;
use crate::quality::Quality;
use crate::stage::{Item, Part, Stage};
use crate::view::View;

/// What the surroundings shed on a surface, relative to a well-lit white one: from above and from below.
const ABOVE: [f32; 3] = [0.17, 0.175, 0.19];
const BELOW: [f32; 3] = [0.045, 0.038, 0.036];
/// What is seen where nothing is.
const BACKDROP: wgpu::Color = wgpu::Color { r: 0.012, g: 0.014, b: 0.017, a: 1.0 };

/// How an item is drawn.
struct Draw {
    surface: u64,
    material: String,
    shader: Option<String>,
    blended: bool,
    radius: f64,
    centre_in_world: Point3<f64>,
}

/// Where an eye's picture goes.
#[derive(Clone, Copy)]
struct Canvas<'a> {
    into: &'a wgpu::TextureView,
    format: wgpu::TextureFormat,
    size: [u32; 2],
    /// Part of it \[pixels\]: left, top, width, height.
    pane: [u32; 4],
    /// Whether nothing is on it yet.
    clear: bool,
}

/// Where frames of one size go before they are composed.
struct Scratch {
    size: [u32; 2],
    samples: u32,
    format: wgpu::TextureFormat,
    depth: wgpu::TextureView,
    /// With several samples per pixel.
    smooth: Option<wgpu::TextureView>,
}

/// Draws scenes. Everything that lies on the device is kept from frame to frame; only what changed is sent.
pub struct Renderer {
    stage: Stage,
    copies: SurfaceCopies,
    materials: Materials,
    edits: Edits,
    passes: Passes,
    composite: Option<Composite>,
    draws: Vec<Draw>,
    sent_items: Vec<GpuItem>,
    items: wgpu::Buffer,
    items_group: wgpu::BindGroup,
    entities: Vec<Entity>,
    scratch: Vec<Scratch>,
    eyes: Vec<(wgpu::Texture, wgpu::TextureView)>,
}

impl Renderer {
    /// A renderer on this device; `folder` is the scenario's, below which files of textures and shaders are.
    pub fn new(gpu: &Gpu, folder: Option<PathBuf>) -> Self {
        let materials = Materials::new(gpu, folder);
        let passes = Passes::new(gpu, &materials.layout);
        let (items, items_group) = items_buffer(gpu, &passes, 64);
        Self {
            stage: Stage::new(),
            copies: SurfaceCopies::default(),
            materials,
            edits: Edits::default(),
            passes,
            composite: None,
            draws: Vec::new(),
            sent_items: Vec::new(),
            items,
            items_group,
            entities: Vec::new(),
            scratch: Vec::new(),
            eyes: Vec::new(),
        }
    }

    /// What is drawn.
    pub fn stage(&self) -> &Stage {
        &self.stage
    }

    /// Texels of edit maps sent to the device since the start.
    pub fn texels_sent(&self) -> u64 {
        self.edits.texels_sent
    }

    /// Bytes of surfaces sent to the device since the start.
    pub fn bytes_sent(&self) -> u64 {
        self.copies.bytes_sent
    }

    /// Follows the scene to this snapshot, and sends what changed.
    pub fn update(&mut self, gpu: &Gpu, scene: &Snapshot) {
        if !self.stage.update(scene) {
            return;
        }
        let materials = &self.materials;
        let base = |entity| {
            scene.get::<VisualMaterial>(entity).and_then(|material| materials.edit_picture(material))
        };
        self.edits.update(gpu, scene, base);
        self.draws.clear();
        self.entities.clear();
        let mut items = Vec::with_capacity(self.stage.items().len());
        for item in self.stage.items() {
            self.copies.send(gpu, &item.surface);
            if self.entities.last() != Some(&item.entity) {
                self.entities.push(item.entity);
            }
            let material = self.materials.send(gpu, &item.material, self.edits.get(item.entity));
            let shader = self.materials.shader(gpu, &item.material);
            items.push(gpu_item(item, self.entities.len() as u32));
            self.draws.push(Draw {
                surface: item.surface.id,
                material,
                shader,
                blended: item.material.base_color[3] < 1.0,
                radius: f64::from(item.surface.geometry.radius),
                centre_in_world: Point3::from(item.world_from_item.translation.vector),
            });
        }
        self.copies.sweep();
        self.materials.sweep();
        self.send_items(gpu, items);
    }

    /// Sends the items that differ from those that are there.
    fn send_items(&mut self, gpu: &Gpu, items: Vec<GpuItem>) {
        let size = size_of::<GpuItem>() as u64;
        if self.items.size() < items.len() as u64 * size {
            let room = items.len().next_power_of_two();
            (self.items, self.items_group) = items_buffer(gpu, &self.passes, room);
            self.sent_items.clear();
        }
        let differs = |index: &usize| self.sent_items.get(*index) != items.get(*index);
        let first = (0..items.len()).find(differs);
        let last = (0..items.len()).rfind(differs);
        if let (Some(first), Some(last)) = (first, last) {
            gpu.queue.write_buffer(
                &self.items,
                first as u64 * size,
                bytemuck::cast_slice(&items[first..=last]),
            );
        }
        self.sent_items = items;
    }

    /// Draws the scene that was last followed into `target`, through a view, in a layout. The scene is asked for its
    /// lights only.
    pub fn draw(
        &mut self,
        gpu: &Gpu,
        scene: &Snapshot,
        view: &View,
        layout: &Layout,
        quality: Quality,
        target: &wgpu::Texture,
    ) {
        let size = [target.width(), target.height()];
        let format = target.format();
        let into = target.create_view(&Default::default());
        let (panes, weave) = layout.eyes(view);
        let lights = lights::shining(scene, view);
        let exposure = lights::exposure(&lights, &self.focus(view));
        for draw in &self.draws {
            self.passes.prepare(gpu, &draw.key(quality, format));
        }
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        if quality.shadows && quality.wet {
            self.draw_shadows(gpu, &mut encoder, &lights);
        }
        // Straight into the target, unless a lens bends the picture or two eyes are woven.
        let bent = view.distortion != 0.0 || view.vignette != 0.0;
        let straight = weave == Weave::Panes && !bent;
        let mut drawn = Vec::new();
        for (index, (pane, eye)) in panes.iter().enumerate() {
            let pixels = pane.pixels(size);
            let frame = self.frame_group(gpu, scene, eye, &lights, exposure);
            if straight {
                let canvas = Canvas { into: &into, format, size, pane: pixels, clear: index == 0 };
                self.draw_eye(gpu, &mut encoder, &frame, eye, quality, &canvas);
            } else {
                let own = [pixels[2], pixels[3]];
                let picture = self.eye_target(gpu, index, own, format);
                let pane = [0, 0, own[0], own[1]];
                let canvas = Canvas { into: &picture, format, size: own, pane, clear: true };
                self.draw_eye(gpu, &mut encoder, &frame, eye, quality, &canvas);
                drawn.push((pixels, picture));
            }
        }
        if !straight {
            if self.composite.as_ref().is_none_or(|composite| !composite.is_for(format)) {
                self.composite = Some(Composite::new(gpu, format));
            }
            if let Some(composite) = &self.composite {
                if weave == Weave::Panes {
                    for (index, (pane, picture)) in drawn.iter().enumerate() {
                        let seen = Seen { pane: *pane, eyes: [picture; 2], view, weave, clear: index == 0 };
                        composite.draw(gpu, &mut encoder, &into, &seen);
                    }
                } else if let [(pane, left), (_, right)] = drawn.as_slice() {
                    let seen = Seen { pane: *pane, eyes: [left, right], view, weave, clear: true };
                    composite.draw(gpu, &mut encoder, &into, &seen);
                }
            }
        }
        gpu.queue.submit([encoder.finish()]);
    }

    /// Depths and entities through an undistorted view.
    ///
    /// # Errors
    /// [`ViewError::DeviceLost`].
    pub fn probe(
        &mut self,
        gpu: &Gpu,
        scene: &Snapshot,
        view: &View,
        size: [u32; 2],
    ) -> Result<Probe, ViewError> {
        let frame = self.frame_group(gpu, scene, view, &[], 1.0);
        let metres = targets::target(gpu, size, targets::METRES, 1);
        let numbers = targets::target(gpu, size, targets::NUMBERS, 1);
        let depth = targets::target(gpu, size, targets::DEPTH, 1).create_view(&Default::default());
        let views = [&metres, &numbers].map(|texture| texture.create_view(&Default::default()));
        let clear = [wgpu::Color { r: f64::from(f32::MAX), ..Default::default() }, wgpu::Color::TRANSPARENT];
        let attachment = |index: usize| {
            Some(wgpu::RenderPassColorAttachment {
                view: &views[index],
                depth_slice: None,
                resolve_target: None,
                ops: wgpu::Operations {
                    load: wgpu::LoadOp::Clear(clear[index]),
                    store: wgpu::StoreOp::Store,
                },
            })
        };
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("probe"),
                color_attachments: &[attachment(0), attachment(1)],
                depth_stencil_attachment: Some(cleared_depth(&depth)),
                ..Default::default()
            });
            pass.set_pipeline(&self.passes.probe);
            pass.set_bind_group(0, &frame, &[]);
            pass.set_bind_group(1, &self.items_group, &[]);
            for index in 0..self.draws.len() {
                self.draw_item(&mut pass, index, true);
            }
        }
        gpu.queue.submit([encoder.finish()]);
        let floats = targets::read(gpu, &metres)?;
        let whole = targets::read(gpu, &numbers)?;
        let far = |bytes: &[u8; 4]| {
            let metres = f32::from_le_bytes(*bytes);
            if metres == f32::MAX { f32::INFINITY } else { metres }
        };
        Ok(Probe {
            width: size[0],
            height: size[1],
            depth: floats.as_chunks().0.iter().map(far).collect(),
            numbers: whole.as_chunks().0.iter().map(|bytes| u32::from_le_bytes(*bytes)).collect(),
            entities: self.entities.clone(),
        })
    }

    /// Where the eye rests: along the line of sight, as far as what it sees is in the mean.
    fn focus(&self, view: &View) -> Point3<f64> {
        let eye_from_world = view.world_from_eye.inverse();
        let (mut sum, mut count) = (0.0, 0.0);
        for draw in &self.draws {
            let centre = eye_from_world * draw.centre_in_world;
            if view
                .project(&draw.centre_in_world)
                .is_some_and(|(at, _)| at.iter().all(|part| (0.0..=1.0).contains(part)))
            {
                sum += centre.z;
                count += 1.0;
            }
        }
        let depth = if count > 0.0 { sum / count } else { 0.2 };
        view.world_from_eye * Point3::new(0.0, 0.0, depth)
    }

    fn frame_group(
        &self,
        gpu: &Gpu,
        scene: &Snapshot,
        view: &View,
        lights: &[Shining],
        exposure: f64,
    ) -> wgpu::BindGroup {
        let eye = view.world_from_eye.translation.vector;
        let forward = view.world_from_eye.rotation * nalgebra::Vector3::z();
        let around = |light: [f32; 3], last: f32| {
            let [r, g, b] = light.map(|part| part / exposure as f32);
            [r, g, b, last]
        };
        let mut frame = GpuFrame {
            clip_from_world: matrix(&view.clip_from_world()),
            eye: single(eye.push(scene.time().as_secs_f64())),
            forward: single(forward.push(0.0)),
            above: around(ABOVE, exposure as f32),
            below: around(BELOW, 0.0),
            light_count: lights.len() as u32,
            shadow_texel: 2.0 / SHADOW_SIDE as f32,
            ..GpuFrame::default()
        };
        for (slot, light) in frame.lights.iter_mut().zip(lights) {
            *slot = gpu_light(light);
        }
        let buffer = uniform(gpu, &frame);
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("frame"),
            layout: &self.passes.frame_layout,
            entries: &[
                wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() },
                wgpu::BindGroupEntry {
                    binding: 1,
                    resource: wgpu::BindingResource::TextureView(&self.passes.shadow_maps),
                },
                wgpu::BindGroupEntry {
                    binding: 2,
                    resource: wgpu::BindingResource::Sampler(&self.passes.shadow_sampler),
                },
            ],
        })
    }

    fn draw_shadows(&self, gpu: &Gpu, encoder: &mut wgpu::CommandEncoder, lights: &[Shining]) {
        for (layer, clip_from_world) in lights.iter().filter_map(|light| light.shadow) {
            let buffer = uniform(gpu, &matrix(&clip_from_world));
            let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("light"),
                layout: &self.passes.light_layout,
                entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
            });
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("shadow"),
                depth_stencil_attachment: Some(cleared_depth(&self.passes.shadow_layers[layer])),
                ..Default::default()
            });
            pass.set_pipeline(&self.passes.shadow);
            pass.set_bind_group(0, &group, &[]);
            pass.set_bind_group(1, &self.items_group, &[]);
            for (index, draw) in self.draws.iter().enumerate() {
                // What light passes through throws no shadow.
                if !draw.blended {
                    self.draw_item(&mut pass, index, false);
                }
            }
        }
    }

    fn draw_eye(
        &mut self,
        gpu: &Gpu,
        encoder: &mut wgpu::CommandEncoder,
        frame: &wgpu::BindGroup,
        view: &View,
        quality: Quality,
        canvas: &Canvas<'_>,
    ) {
        let Canvas { into, format, size, pane, clear } = *canvas;
        let at = self.scratch(gpu, size, quality.samples, format);
        let scratch = &self.scratch[at];
        // A pane beside one that is drawn keeps what is there.
        let load = if clear { wgpu::LoadOp::Clear(BACKDROP) } else { wgpu::LoadOp::Load };
        let (drawn, resolved) = match &scratch.smooth {
            Some(smooth) => (smooth, Some(into)),
            None => (into, None),
        };
        let attachment = wgpu::RenderPassColorAttachment {
            view: drawn,
            depth_slice: None,
            resolve_target: resolved,
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
        pass.set_bind_group(0, frame, &[]);
        pass.set_bind_group(1, &self.items_group, &[]);
        for index in self.order(view) {
            let draw = &self.draws[index];
            let pipeline = self.passes.surface(&draw.key(quality, format));
            let (Some(pipeline), Some(group)) = (pipeline, self.materials.group(&draw.material)) else {
                continue;
            };
            pass.set_pipeline(pipeline);
            pass.set_bind_group(2, group, &[]);
            self.draw_item(&mut pass, index, true);
        }
    }

    /// What is in sight: opaque things from front to back, then those that light passes through from back to front.
    fn order(&self, view: &View) -> Vec<usize> {
        let eye_from_world = view.world_from_eye.inverse();
        let clip_from_eye = view.lens.clip_from_eye();
        let mut seen: Vec<(bool, f64, usize)> = Vec::with_capacity(self.draws.len());
        for (index, draw) in self.draws.iter().enumerate() {
            let centre = eye_from_world * draw.centre_in_world;
            if is_in_sight(&clip_from_eye, &centre, draw.radius, view) {
                let key = if draw.blended { -centre.z } else { centre.z - draw.radius };
                seen.push((draw.blended, key, index));
            }
        }
        seen.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        seen.into_iter().map(|(_, _, index)| index).collect()
    }

    fn draw_item(&self, pass: &mut wgpu::RenderPass<'_>, index: usize, shaded: bool) {
        let Some(copy) = self.copies.get(self.draws[index].surface) else { return };
        pass.set_vertex_buffer(0, copy.positions.slice(..));
        if shaded {
            pass.set_vertex_buffer(1, copy.normals.slice(..));
            pass.set_vertex_buffer(2, copy.uvs.slice(..));
        }
        pass.set_index_buffer(copy.indices.slice(..), wgpu::IndexFormat::Uint32);
        let instance = index as u32;
        pass.draw_indexed(0..copy.index_count, 0, instance..instance + 1);
    }

    /// The place of scratch textures of this kind.
    fn scratch(&mut self, gpu: &Gpu, size: [u32; 2], samples: u32, format: wgpu::TextureFormat) -> usize {
        let fits = |scratch: &Scratch| {
            scratch.size == size && scratch.samples == samples && scratch.format == format
        };
        if let Some(at) = self.scratch.iter().position(fits) {
            return at;
        }
        // A window that is being resized asks for new sizes all the time.
        if self.scratch.len() >= 4 {
            self.scratch.remove(0);
        }
        let view = |format| targets::target(gpu, size, format, samples).create_view(&Default::default());
        let smooth = (samples > 1).then(|| view(format));
        self.scratch.push(Scratch { size, samples, format, depth: view(targets::DEPTH), smooth });
        self.scratch.len() - 1
    }

    fn eye_target(
        &mut self,
        gpu: &Gpu,
        index: usize,
        size: [u32; 2],
        format: wgpu::TextureFormat,
    ) -> wgpu::TextureView {
        let fits = |(texture, _): &(wgpu::Texture, wgpu::TextureView)| {
            [texture.width(), texture.height()] == size && texture.format() == format
        };
        if !self.eyes.get(index).is_some_and(fits) {
            let texture = targets::target(gpu, size, format, 1);
            let view = texture.create_view(&Default::default());
            self.eyes.truncate(index);
            self.eyes.push((texture, view));
        }
        self.eyes[index].1.clone()
    }
}

impl Draw {
    fn key(&self, quality: Quality, format: wgpu::TextureFormat) -> Key {
        Key { quality, blended: self.blended, format, shader: self.shader.clone() }
    }
}

/// Whether a ball may be seen.
fn is_in_sight(clip_from_eye: &Matrix4<f64>, centre: &Point3<f64>, radius: f64, view: &View) -> bool {
    let lens = &view.lens;
    if centre.z + radius < lens.near || centre.z - radius > lens.far {
        return false;
    }
    // Planes of the four sides, from the rows of the projection (Gribb, Hartmann 2001).
    let row = |index: usize| clip_from_eye.row(index).transpose();
    let at = centre.to_homogeneous();
    [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)].into_iter().all(|(axis, side)| {
        let plane: Vector4<f64> = row(3) + row(axis) * side;
        plane.dot(&at) >= -radius * plane.xyz().norm()
    })
}

fn gpu_item(item: &Item, number: u32) -> GpuItem {
    let material: &VisualMaterial = &item.material;
    let [r, g, b, a] = material.base_color.map(|part| part as f32);
    let mut base_color = [r, g, b, a];
    let mut surface =
        [material.roughness, material.metalness, material.wetness, material.relief].map(|part| part as f32);
    if item.part == Part::Shaft {
        // Shafts are sleeved with a dark insulation, whatever the jaws are made of.
        base_color = [0.012, 0.012, 0.013, a];
        surface = [0.38, 0.0, 0.0, 0.0];
    }
    GpuItem {
        world_from_item: matrix(&item.world_from_item.to_homogeneous()),
        base_color,
        surface,
        tiling: material.tiling.map(|part| part as f32),
        number,
        flags: 0,
    }
}

fn gpu_light(light: &Shining) -> GpuLight {
    let (shadow, clip_from_world) = light.shadow.unwrap_or((0, Matrix4::identity()));
    GpuLight {
        position: light.position_in_world.coords.map(|part| part as f32).into(),
        cos_outer: light.cone[0] as f32,
        direction: light.direction_in_world.map(|part| part as f32).into(),
        cos_inner: light.cone[1] as f32,
        candela: light.candela.map(|part| part as f32).into(),
        shadow: if light.shadow.is_some() { shadow as i32 } else { -1 },
        clip_from_world: matrix(&clip_from_world),
    }
}

fn matrix(matrix: &Matrix4<f64>) -> [[f32; 4]; 4] {
    matrix.map(|part| part as f32).into()
}

fn single(vector: Vector4<f64>) -> [f32; 4] {
    vector.map(|part| part as f32).into()
}

fn uniform<T: bytemuck::Pod>(gpu: &Gpu, contents: &T) -> wgpu::Buffer {
    gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
        label: None,
        contents: bytemuck::bytes_of(contents),
        usage: wgpu::BufferUsages::UNIFORM,
    })
}

fn cleared_depth(view: &wgpu::TextureView) -> wgpu::RenderPassDepthStencilAttachment<'_> {
    wgpu::RenderPassDepthStencilAttachment {
        view,
        depth_ops: Some(wgpu::Operations { load: wgpu::LoadOp::Clear(1.0), store: wgpu::StoreOp::Store }),
        stencil_ops: None,
    }
}

/// Room for so many items, and its group.
fn items_buffer(gpu: &Gpu, passes: &Passes, room: usize) -> (wgpu::Buffer, wgpu::BindGroup) {
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("items"),
        size: (room.max(1) * size_of::<GpuItem>()) as u64,
        usage: wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("items"),
        layout: &passes.items_layout,
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
    });
    (buffer, group)
}
