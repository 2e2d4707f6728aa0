//! Draws overlays on the device: lines, triangles, spots, edges, fields.

use std::collections::{BTreeMap, HashMap};

use bytemuck::{Pod, Zeroable};
use wgpu::util::DeviceExt;

use crate::colormap::Colormap;
use crate::draw_list::DrawList;
use crate::geometry::Geometry;
use crate::gpu::Gpu;
use crate::gpu::surfaces::{SurfaceCopies, SurfaceCopy};
use crate::gpu::targets::DEPTH;
use crate::gpu::uniforms::GpuItem;
use crate::overlay::sketch::{Corner, Line, Sketch};
use crate::overlay::{Field, Overlay, Overlays, Seen};
use crate::view::View;

/// Depth bias of overlays, as a share of the distance, so that they are drawn on top of their surface.
const NEARER: f64 = 1e-3;

/// Per-eye uniforms of overlays, in the layout of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct GpuView {
    clip_from_world: [[f32; 4]; 4],
    eye: [f32; 3],
    near: f32,
    pane: [f32; 2],
    bias: f32,
    edge_width: f32,
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Kind {
    Lines,
    Triangles,
    Spots,
    Edges,
    Field,
}

impl Kind {
    const ALL: [Self; 5] = [Self::Lines, Self::Triangles, Self::Spots, Self::Edges, Self::Field];

    /// Whether it stays partly visible behind surfaces.
    fn shows_through(self) -> bool {
        matches!(self, Self::Lines | Self::Triangles | Self::Spots)
    }
}

/// Kind, whether the hidden part, format, samples per pixel.
type Key = (Kind, bool, wgpu::TextureFormat, u32);

/// Edges of a surface.
struct Edges {
    topology: u64,
    edges: wgpu::Buffer,
    count: u32,
    /// The bind group, and the positions that it reads.
    group: (wgpu::BindGroup, wgpu::Buffer),
    used: bool,
}

/// An uploaded field over an item.
struct SentField {
    field: Field,
    surface: (u64, u64),
    fractions: wgpu::Buffer,
}

/// Pipelines and buffers of all overlays. Created when an overlay is first shown.
pub struct OverlayPass {
    view_layout: wgpu::BindGroupLayout,
    spots_layout: wgpu::BindGroupLayout,
    edges_layout: wgpu::BindGroupLayout,
    colors_layout: wgpu::BindGroupLayout,
    /// Pipeline layouts with an additional bind group (spots, edges, colours), and without.
    layouts: BTreeMap<u8, wgpu::PipelineLayout>,
    pipelines: HashMap<Key, wgpu::RenderPipeline>,
    views: Vec<(wgpu::Buffer, wgpu::BindGroup)>,
    lines: Option<(wgpu::Buffer, u32)>,
    triangles: Option<(wgpu::Buffer, u32)>,
    /// The bind group, and the items with spots.
    spots: Option<(wgpu::BindGroup, Vec<u32>)>,
    edges: BTreeMap<u64, Edges>,
    edge_width: f32,
    colors: Vec<(Colormap, wgpu::BindGroup)>,
    fields: Vec<SentField>,
    /// Bytes uploaded since the start.
    pub bytes_sent: u64,
}

impl OverlayPass {
    /// `items_layout` is the layout of the list of items.
    pub fn new(gpu: &Gpu, items_layout: &wgpu::BindGroupLayout) -> Self {
        use wgpu::ShaderStages as Stages;
        let device = &gpu.device;
        let group = |label, entries: &[wgpu::BindGroupLayoutEntry]| {
            device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries })
        };
        let buffer = |binding, visibility, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        };
        let storage = wgpu::BufferBindingType::Storage { read_only: true };
        let uniform = wgpu::BufferBindingType::Uniform;
        let view_layout = group("overlay view", &[buffer(0, Stages::VERTEX_FRAGMENT, uniform)]);
        let spots_layout = group("spots", &[0, 1].map(|at| buffer(at, Stages::FRAGMENT, storage)));
        let edges_layout = group("edges", &[0, 1].map(|at| buffer(at, Stages::VERTEX, storage)));
        let table = wgpu::BindGroupLayoutEntry {
            binding: 0,
            visibility: Stages::FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: wgpu::TextureSampleType::Float { filterable: false },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        };
        let colors_layout = group("colors", &[table]);
        let layout = |own: Option<&wgpu::BindGroupLayout>| {
            let items = own.map(|_| items_layout);
            let groups: Vec<_> = [Some(&view_layout), items, own].into_iter().flatten().map(Some).collect();
            device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
                label: Some("overlay"),
                bind_group_layouts: &groups,
                immediate_size: 0,
            })
        };
        let layouts = [
            (Kind::Lines as u8, layout(None)),
            (Kind::Triangles as u8, layout(None)),
            (Kind::Spots as u8, layout(Some(&spots_layout))),
            (Kind::Edges as u8, layout(Some(&edges_layout))),
            (Kind::Field as u8, layout(Some(&colors_layout))),
        ];
        Self {
            layouts: layouts.into(),
            view_layout,
            spots_layout,
            edges_layout,
            colors_layout,
            pipelines: HashMap::new(),
            views: Vec::new(),
            lines: None,
            triangles: None,
            spots: None,
            edges: BTreeMap::new(),
            edge_width: 1.0,
            colors: Vec::new(),
            fields: Vec::new(),
            bytes_sent: 0,
        }
    }

    /// Uploads the computed overlays.
    pub fn send(
        &mut self,
        gpu: &Gpu,
        overlays: &Overlays,
        seen: &Seen,
        draw_list: &DrawList,
        copies: &SurfaceCopies,
    ) {
        let vertex = wgpu::BufferUsages::VERTEX;
        let Sketch { lines, triangles, .. } = &seen.sketch;
        self.bytes_sent += fill(gpu, &mut self.lines, lines, vertex);
        self.bytes_sent += fill(gpu, &mut self.triangles, triangles, vertex);
        self.send_spots(gpu, &seen.sketch, draw_list);
        self.edge_width = 0.5 * overlays.line_width;
        if overlays.shows(Overlay::Wireframe) {
            for item in draw_list.items() {
                let surface = &item.surface;
                if let Some(copy) = copies.get(surface.id) {
                    self.send_edges(gpu, surface.id, surface.topology, &surface.geometry, copy);
                }
            }
        }
        self.edges.retain(|_, edges| std::mem::take(&mut edges.used));
        self.send_fields(gpu, &seen.fields, draw_list);
    }

    fn send_spots(&mut self, gpu: &Gpu, sketch: &Sketch, draw_list: &DrawList) {
        self.spots = None;
        if sketch.spots.is_empty() {
            return;
        }
        let mut order: Vec<_> = sketch.spots.iter().collect();
        order.sort_by_key(|spot| spot.item);
        let mut ranges = vec![[0_u32; 2]; draw_list.items().len().max(1)];
        let mut items = Vec::new();
        for (place, spot) in order.iter().enumerate() {
            let Some([first, count]) = ranges.get_mut(spot.item) else { continue };
            if *count == 0 {
                *first = place as u32;
                items.push(spot.item as u32);
            }
            *count += 1;
        }
        let balls: Vec<[f32; 4]> = order
            .iter()
            .map(|spot| spot.centre.coords.push(spot.radius.max(1e-6)).map(|part| part as f32).into())
            .collect();
        let buffers =
            [bytemuck::cast_slice::<_, u8>(&balls), bytemuck::cast_slice(&ranges)].map(|contents| {
                self.bytes_sent += contents.len() as u64;
                let usage = wgpu::BufferUsages::STORAGE;
                gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                    label: Some("spots"),
                    contents,
                    usage,
                })
            });
        let group = pair(gpu, &self.spots_layout, [&buffers[0], &buffers[1]]);
        self.spots = Some((group, items));
    }

    fn send_edges(&mut self, gpu: &Gpu, id: u64, topology: u64, geometry: &Geometry, copy: &SurfaceCopy) {
        let known = self.edges.get(&id).is_some_and(|edges| edges.topology == topology);
        if !known {
            let edges = edges_of(geometry);
            if edges.is_empty() {
                return;
            }
            let contents = bytemuck::cast_slice(&edges);
            self.bytes_sent += contents.len() as u64;
            let usage = wgpu::BufferUsages::STORAGE;
            let label = Some("edges");
            let buffer =
                gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor { label, contents, usage });
            let group = pair(gpu, &self.edges_layout, [&copy.positions, &buffer]);
            let group = (group, copy.positions.clone());
            let count = edges.len() as u32;
            self.edges.insert(id, Edges { topology, edges: buffer, count, group, used: true });
        }
        if let Some(edges) = self.edges.get_mut(&id) {
            edges.used = true;
            // A surface that grew has a larger buffer.
            if edges.group.1 != copy.positions {
                let group = pair(gpu, &self.edges_layout, [&copy.positions, &edges.edges]);
                edges.group = (group, copy.positions.clone());
            }
        }
    }

    fn send_fields(&mut self, gpu: &Gpu, fields: &[Field], draw_list: &DrawList) {
        let mut before = std::mem::take(&mut self.fields);
        for field in fields {
            let Some(item) = draw_list.items().get(field.item) else { continue };
            let surface = (item.surface.id, item.surface.topology);
            let same = |sent: &SentField| {
                sent.field.item == field.item && sent.surface == surface && sent.field.is_like(field)
            };
            if let Some(at) = before.iter().position(same) {
                self.fields.push(before.swap_remove(at));
                continue;
            }
            let geometry = &item.surface.geometry;
            if geometry.sources.len() != geometry.positions.len() {
                continue;
            }
            let fraction = |source: &u32| field.fraction(*source).unwrap_or(-1.0);
            let fractions: Vec<f32> = geometry.sources.iter().map(fraction).collect();
            let contents = bytemuck::cast_slice(&fractions);
            self.bytes_sent += contents.len() as u64;
            let fractions = gpu.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
                label: Some("field"),
                contents,
                usage: wgpu::BufferUsages::VERTEX,
            });
            self.fields.push(SentField { field: field.clone(), surface, fractions });
            if !self.colors.iter().any(|(colormap, _)| *colormap == field.colormap) {
                let group = self.color_table(gpu, field.colormap);
                self.colors.push((field.colormap, group));
            }
        }
    }

    fn color_table(&self, gpu: &Gpu, colormap: Colormap) -> wgpu::BindGroup {
        let descriptor = wgpu::TextureDescriptor {
            label: Some("colors"),
            size: wgpu::Extent3d { width: 256, height: 1, depth_or_array_layers: 1 },
            mip_level_count: 1,
            sample_count: 1,
            dimension: wgpu::TextureDimension::D2,
            format: wgpu::TextureFormat::Rgba8UnormSrgb,
            usage: wgpu::TextureUsages::TEXTURE_BINDING | wgpu::TextureUsages::COPY_DST,
            view_formats: &[],
        };
        let order = wgpu::util::TextureDataOrder::LayerMajor;
        let table = colormap.table();
        let bytes = bytemuck::cast_slice(&table);
        let texture = gpu.device.create_texture_with_data(&gpu.queue, &descriptor, order, bytes);
        let view = texture.create_view(&Default::default());
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("colors"),
            layout: &self.colors_layout,
            entries: &[wgpu::BindGroupEntry {
                binding: 0,
                resource: wgpu::BindingResource::TextureView(&view),
            }],
        })
    }

    /// Creates the pipelines for pictures of that kind, and writes the view of an eye; each eye has its own number
    /// within a submission.
    pub fn prepare(
        &mut self,
        gpu: &Gpu,
        eye: usize,
        view: &View,
        pane: [u32; 2],
        format: wgpu::TextureFormat,
        samples: u32,
    ) {
        for kind in Kind::ALL {
            let needed = match kind {
                Kind::Lines => self.lines.is_some(),
                Kind::Triangles => self.triangles.is_some(),
                Kind::Spots => self.spots.is_some(),
                Kind::Edges => !self.edges.is_empty(),
                Kind::Field => !self.fields.is_empty(),
            };
            for hidden in [false, true] {
                let key = (kind, hidden, format, samples);
                if needed && (!hidden || kind.shows_through()) && !self.pipelines.contains_key(&key) {
                    self.pipelines.insert(key, pipeline(gpu, &self.layouts[&(kind as u8)], key));
                }
            }
        }
        while self.views.len() <= eye {
            let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("overlay view"),
                size: size_of::<GpuView>() as u64,
                usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            });
            let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
                label: Some("overlay view"),
                layout: &self.view_layout,
                entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
            });
            self.views.push((buffer, group));
        }
        let (near, far) = (view.lens.near, view.lens.far);
        let uniform = GpuView {
            clip_from_world: view.clip_from_world().map(|part| part as f32).into(),
            eye: view.world_from_eye.translation.vector.map(|part| part as f32).into(),
            near: near as f32,
            pane: pane.map(|pixels| pixels as f32),
            // Depth times distance is linear in the distance, so a bias proportional to the distance is a constant.
            bias: (NEARER * near * far / (far - near)) as f32,
            edge_width: self.edge_width,
        };
        gpu.queue.write_buffer(&self.views[eye].0, 0, bytemuck::bytes_of(&uniform));
    }

    /// Draws the overlays for a prepared eye, over a finished scene.
    pub fn draw(
        &self,
        pass: &mut wgpu::RenderPass<'_>,
        eye: usize,
        (format, samples): (wgpu::TextureFormat, u32),
        draw_list: &DrawList,
        copies: &SurfaceCopies,
        items_group: &wgpu::BindGroup,
    ) {
        let Some((_, view)) = self.views.get(eye) else { return };
        pass.set_bind_group(0, view, &[]);
        // Every item has its own offset in the list.
        let item_at = |item: u32| [item * size_of::<GpuItem>() as u32];
        let copy = |item: u32| copies.get(draw_list.items().get(item as usize)?.surface.id);
        if let Some(pipeline) = self.pipelines.get(&(Kind::Field, false, format, samples)) {
            pass.set_pipeline(pipeline);
            for sent in &self.fields {
                let item = sent.field.item as u32;
                let colors = self.colors.iter().find(|(colormap, _)| *colormap == sent.field.colormap);
                let (Some(copy), Some((_, colors))) = (copy(item), colors) else { continue };
                pass.set_bind_group(1, items_group, &item_at(item));
                pass.set_bind_group(2, colors, &[]);
                pass.set_vertex_buffer(0, copy.positions.slice(..));
                pass.set_vertex_buffer(1, copy.normals.slice(..));
                pass.set_vertex_buffer(2, sent.fractions.slice(..));
                pass.set_index_buffer(copy.indices.slice(..), wgpu::IndexFormat::Uint32);
                pass.draw_indexed(0..copy.index_count, 0, 0..1);
            }
        }
        if let Some(pipeline) = self.pipelines.get(&(Kind::Edges, false, format, samples)) {
            pass.set_pipeline(pipeline);
            for (item, drawn) in draw_list.items().iter().enumerate() {
                let Some(edges) = self.edges.get(&drawn.surface.id) else { continue };
                pass.set_bind_group(1, items_group, &item_at(item as u32));
                pass.set_bind_group(2, &edges.group.0, &[]);
                pass.draw(0..6 * edges.count, 0..1);
            }
        }
        // Hidden parts first: they are farther away.
        for hidden in [true, false] {
            let pipeline = |kind| self.pipelines.get(&(kind, hidden, format, samples));
            if let (Some(pipeline), Some((group, items))) = (pipeline(Kind::Spots), &self.spots) {
                pass.set_pipeline(pipeline);
                pass.set_bind_group(2, group, &[]);
                for item in items {
                    let Some(copy) = copy(*item) else { continue };
                    pass.set_bind_group(1, items_group, &item_at(*item));
                    pass.set_vertex_buffer(0, copy.positions.slice(..));
                    pass.set_index_buffer(copy.indices.slice(..), wgpu::IndexFormat::Uint32);
                    // The instance index is the item.
                    pass.draw_indexed(0..copy.index_count, 0, *item..*item + 1);
                }
            }
            if let (Some(pipeline), Some((corners, count))) = (pipeline(Kind::Triangles), &self.triangles) {
                pass.set_pipeline(pipeline);
                pass.set_vertex_buffer(0, corners.slice(..));
                pass.draw(0..*count, 0..1);
            }
            if let (Some(pipeline), Some((lines, count))) = (pipeline(Kind::Lines), &self.lines) {
                pass.set_pipeline(pipeline);
                pass.set_vertex_buffer(0, lines.slice(..));
                pass.draw(0..6, 0..*count);
            }
        }
    }
}

/// Edges between drawn vertices, each once; along a texture seam the vertices are split, but the edge is one.
fn edges_of(geometry: &Geometry) -> Vec<[u32; 2]> {
    let source = |vertex: u32| geometry.sources.get(vertex as usize).copied().unwrap_or(vertex);
    let mut edges: Vec<[u32; 4]> = Vec::with_capacity(geometry.indices.len());
    for &[a, b, c] in geometry.indices.as_chunks().0 {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            let (low, high) = if source(from) < source(to) { (from, to) } else { (to, from) };
            edges.push([source(low), source(high), low, high]);
        }
    }
    edges.sort_unstable();
    edges.dedup_by_key(|[low, high, ..]| [*low, *high]);
    edges.into_iter().map(|[_, _, low, high]| [low, high]).collect()
}

fn pair(gpu: &Gpu, layout: &wgpu::BindGroupLayout, buffers: [&wgpu::Buffer; 2]) -> wgpu::BindGroup {
    let entry = |binding: usize| wgpu::BindGroupEntry {
        binding: binding as u32,
        resource: buffers[binding].as_entire_binding(),
    };
    gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("overlay"),
        layout,
        entries: &[entry(0), entry(1)],
    })
}

/// Uploads rows into a buffer, replaced by a larger one if needed; returns the number of bytes.
fn fill<T: Pod>(
    gpu: &Gpu,
    slot: &mut Option<(wgpu::Buffer, u32)>,
    rows: &[T],
    usage: wgpu::BufferUsages,
) -> u64 {
    if rows.is_empty() {
        *slot = None;
        return 0;
    }
    let bytes: &[u8] = bytemuck::cast_slice(rows);
    let fits = |(buffer, _): &(wgpu::Buffer, u32)| buffer.size() >= bytes.len() as u64;
    let buffer = slot.take().filter(fits).map_or_else(
        || {
            gpu.device.create_buffer(&wgpu::BufferDescriptor {
                label: Some("sketch"),
                size: (bytes.len() as u64).next_power_of_two(),
                usage: usage | wgpu::BufferUsages::COPY_DST,
                mapped_at_creation: false,
            })
        },
        |(buffer, _)| buffer,
    );
    gpu.queue.write_buffer(&buffer, 0, bytes);
    *slot = Some((buffer, rows.len() as u32));
    bytes.len() as u64
}

fn pipeline(gpu: &Gpu, layout: &wgpu::PipelineLayout, key: Key) -> wgpu::RenderPipeline {
    const COMMON: &str = include_str!("../shaders/overlay.wgsl");
    const ITEM: &str = include_str!("../shaders/item.wgsl");
    let (kind, hidden, format, samples) = key;
    let (own, vertex, fragment) = match kind {
        Kind::Lines => ("", "line", "stroke"),
        Kind::Triangles => ("", "triangle", "fill"),
        Kind::Spots => (include_str!("../shaders/overlay_spots.wgsl"), "on_surface", "spot"),
        Kind::Edges => (include_str!("../shaders/overlay_edges.wgsl"), "edge", "stroke"),
        Kind::Field => (include_str!("../shaders/overlay_field.wgsl"), "measured", "measure"),
    };
    let item = if own.is_empty() { "" } else { ITEM };
    let module = gpu.device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: Some("overlay"),
        source: wgpu::ShaderSource::Wgsl(format!("{COMMON}{item}{own}").into()),
    });
    let line = wgpu::vertex_attr_array![
        0 => Float32x3, 1 => Float32, 2 => Float32x3, 3 => Float32, 4 => Unorm8x4, 5 => Unorm8x4
    ];
    let corner = wgpu::vertex_attr_array![0 => Float32x3, 1 => Float32, 2 => Unorm8x4];
    let position = wgpu::vertex_attr_array![0 => Float32x3];
    let normal = wgpu::vertex_attr_array![1 => Float32x3];
    let fraction = wgpu::vertex_attr_array![2 => Float32];
    let rows = |array_stride, attributes, step_mode| {
        Some(wgpu::VertexBufferLayout { array_stride, step_mode, attributes })
    };
    let each = wgpu::VertexStepMode::Vertex;
    let buffers = match kind {
        Kind::Lines => vec![rows(size_of::<Line>() as u64, &line[..], wgpu::VertexStepMode::Instance)],
        Kind::Triangles => vec![rows(size_of::<Corner>() as u64, &corner[..], each)],
        Kind::Spots => vec![rows(12, &position[..], each)],
        Kind::Edges => Vec::new(),
        Kind::Field => {
            vec![rows(12, &position[..], each), rows(12, &normal[..], each), rows(4, &fraction[..], each)]
        }
    };
    let compare = if hidden { wgpu::CompareFunction::Greater } else { wgpu::CompareFunction::LessEqual };
    let constants = [("HIDDEN", f64::from(u8::from(hidden)))];
    let options = wgpu::PipelineCompilationOptions { constants: &constants, ..Default::default() };
    let target = wgpu::ColorTargetState {
        format,
        blend: Some(wgpu::BlendState::ALPHA_BLENDING),
        write_mask: wgpu::ColorWrites::ALL,
    };
    gpu.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("overlay"),
        layout: Some(layout),
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some(vertex),
            compilation_options: options.clone(),
            buffers: &buffers,
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: Some(wgpu::DepthStencilState {
            format: DEPTH,
            depth_write_enabled: Some(false),
            depth_compare: Some(compare),
            stencil: Default::default(),
            bias: Default::default(),
        }),
        multisample: wgpu::MultisampleState { count: samples, ..Default::default() },
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some(fragment),
            compilation_options: options,
            targets: &[Some(target)],
        }),
        multiview_mask: None,
        cache: None,
    })
}
