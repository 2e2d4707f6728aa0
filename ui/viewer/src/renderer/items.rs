//! The drawn items of a snapshot, and their list on the device.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{Entity, VisualMaterial};

use crate::draw_list::{Item, Part};
use crate::gpu::Gpu;
use crate::gpu::materials::Look;
use crate::gpu::passes::{Features, Key, Passes, Shading};
use crate::gpu::uniforms::{GpuItem, ITEM_BYTES};
use crate::quality::Quality;
use crate::renderer::frames::matrix;

/// Width below which relief is invisible \[pixels\].
const RELIEF_PIXELS: f64 = 0.75;

/// The drawing state of an item.
pub(super) struct Draw {
    pub(super) surface: u64,
    pub(super) look: Look,
    pub(super) blended: bool,
    pub(super) radius: f64,
    pub(super) centre_in_world: Point3<f64>,
    /// Depth of its relief \[m\].
    relief: f64,
    /// The material of its look.
    material: Arc<VisualMaterial>,
    edit: Option<u64>,
}

/// Settings shared by the pipelines of a frame.
#[derive(Clone, Copy)]
pub(super) struct Style {
    pub(super) quality: Quality,
    pub(super) format: wgpu::TextureFormat,
    pub(super) lights: u32,
    pub(super) shadows: u32,
}

impl Draw {
    /// `edit` is the number of the entity's own edit map.
    pub(super) fn new(item: &Item, look: Look, edit: Option<u64>) -> Self {
        Self {
            surface: item.surface.id,
            look,
            blended: item.material.base_color[3] < 1.0,
            radius: f64::from(item.surface.geometry.radius),
            centre_in_world: Point3::from(item.world_from_item.translation.vector),
            relief: if item.part == Part::Shaft { 0.0 } else { item.material.relief },
            material: Arc::clone(&item.material),
            edit,
        }
    }

    /// Its pipeline key; `pixels_per_metre` is taken at its point nearest to the eye.
    pub(super) fn key(&self, style: &Style, pixels_per_metre: f64) -> Key {
        let Style { quality, format, lights, shadows } = *style;
        let shading = if quality.wet {
            let features = if quality.maps {
                let relief = self.look.features.normal_map && self.relief * pixels_per_metre > RELIEF_PIXELS;
                Features { relief, ..self.look.features }
            } else {
                Features { coat: self.look.features.coat, ..Features::default() }
            };
            Shading::Full { features, fine: quality.fine, lights, shadows, shader: self.look.shader }
        } else {
            Shading::Plain
        };
        Key { shading, samples: quality.samples, blended: self.blended, format }
    }
}

/// An item counts as still after so many updates without a change.
pub(super) const STILL_AFTER: u32 = 8;

/// The properties of an item that its shadow depends on.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Caster {
    pub(super) id: u64,
    pub(super) topology: u64,
    pub(super) version: u64,
    pub(super) world_from_item: [[f32; 4]; 4],
    pub(super) triangles: usize,
    /// Transparent items cast no shadow.
    pub(super) throws: bool,
    /// Updates since its last change.
    pub(super) age: u32,
}

impl Caster {
    pub(super) fn is_still(&self) -> bool {
        self.age >= STILL_AFTER
    }

    /// Whether it casts the same shadow as another.
    fn same(&self, other: &Self) -> bool {
        (self.id, self.topology, self.version) == (other.id, other.topology, other.version)
            && (self.world_from_item == other.world_from_item && self.throws == other.throws)
    }
}

/// All shadow casters, in the order of the items. Lists with the same number are equal.
#[derive(Debug, Default)]
pub(super) struct Casters {
    pub(super) list: Vec<Caster>,
    pub(super) number: u64,
    /// Number of the list of still casters.
    pub(super) still_number: u64,
}

impl Casters {
    /// Share of all triangles that is still.
    pub(super) fn still_share(&self) -> f64 {
        let sum = |still: bool| -> usize {
            let counts = |caster: &&Caster| caster.throws && (!still || caster.is_still());
            self.list.iter().filter(counts).map(|caster| caster.triangles).sum()
        };
        sum(true) as f64 / sum(false).max(1) as f64
    }

    /// Replaces the list by `next`, whose ages are not known yet, and leaves the old one there.
    fn follow(&mut self, next: &mut Vec<Caster>) {
        let mut changed = next.len() != self.list.len();
        let mut still_changed = changed;
        for (index, caster) in next.iter_mut().enumerate() {
            let last = self.list.get(index);
            caster.age = last.filter(|last| caster.same(last)).map_or(0, |last| last.age.saturating_add(1));
            let throws = caster.throws || last.is_some_and(|last| last.throws);
            changed |= throws && caster.age == 0;
            still_changed |= throws && last.is_some_and(Caster::is_still) != caster.is_still();
        }
        self.number += u64::from(changed);
        self.still_number += u64::from(still_changed);
        std::mem::swap(&mut self.list, next);
    }
}

/// All items: their drawing state, and their data for the shaders.
pub(super) struct Items {
    /// In the order of the list on the device.
    pub(super) draws: Vec<Draw>,
    /// Indexed by their numbers in a segmentation picture, less one.
    pub(super) entities: Vec<Entity>,
    /// The bind group of the list.
    pub(super) group: wgpu::BindGroup,
    buffer: wgpu::Buffer,
    sent: Vec<GpuItem>,
    next: Vec<GpuItem>,
    /// Shadow casters, item by item.
    pub(super) casters: Casters,
    next_casters: Vec<Caster>,
    last_draws: Vec<Draw>,
}

impl Items {
    pub(super) fn new(gpu: &Gpu, passes: &Passes) -> Self {
        let (buffer, group) = room_for(gpu, passes, 64);
        Self {
            draws: Vec::new(),
            entities: Vec::new(),
            group,
            buffer,
            sent: Vec::new(),
            next: Vec::new(),
            casters: Casters::default(),
            next_casters: Vec::new(),
            last_draws: Vec::new(),
        }
    }

    /// Clears the list; data on the device stays until the next upload.
    pub(super) fn clear(&mut self) {
        std::mem::swap(&mut self.draws, &mut self.last_draws);
        self.draws.clear();
        self.entities.clear();
        self.next.clear();
        self.next_casters.clear();
    }

    /// The look of the next item, if it is unchanged since the last list.
    pub(super) fn known_look(&self, item: &Item, edit: Option<u64>) -> Option<Look> {
        let last = self.last_draws.get(self.draws.len())?;
        let same = Arc::ptr_eq(&last.material, &item.material) && last.edit == edit;
        same.then(|| last.look.clone())
    }

    /// Adds an item; those of one entity are consecutive.
    pub(super) fn add(&mut self, item: &Item, draw: Draw) {
        if self.entities.last() != Some(&item.entity) {
            self.entities.push(item.entity);
        }
        let on_device = gpu_item(item, &draw.look, self.entities.len() as u32);
        self.next_casters.push(Caster {
            id: item.surface.id,
            topology: item.surface.topology,
            version: item.surface.version,
            world_from_item: on_device.world_from_item,
            triangles: item.surface.geometry.indices.len() / 3,
            throws: !draw.blended,
            age: 0,
        });
        self.next.push(on_device);
        self.draws.push(draw);
    }

    /// Uploads the changed items.
    pub(super) fn send(&mut self, gpu: &Gpu, passes: &Passes) {
        let size = size_of::<GpuItem>() as u64;
        let (sent, next) = (&mut self.sent, &mut self.next);
        if self.buffer.size() < next.len() as u64 * size {
            (self.buffer, self.group) = room_for(gpu, passes, next.len().next_power_of_two());
            sent.clear();
        }
        let differs = |index: &usize| sent.get(*index) != next.get(*index);
        let first = (0..next.len()).find(differs);
        let last = (0..next.len()).rfind(differs);
        if let (Some(first), Some(last)) = (first, last) {
            let bytes = bytemuck::cast_slice(&next[first..=last]);
            gpu.queue.write_buffer(&self.buffer, first as u64 * size, bytes);
        }
        std::mem::swap(sent, next);
        self.casters.follow(&mut self.next_casters);
    }
}

fn gpu_item(item: &Item, look: &Look, number: u32) -> GpuItem {
    let material: &VisualMaterial = &item.material;
    let [r, g, b, a] = material.base_color.map(|part| part as f32);
    let mut base_color = [r, g, b, a];
    let mut mean_color = look.mean_color;
    let mut surface =
        [material.roughness, material.metalness, material.wetness, material.relief].map(|part| part as f32);
    if item.part == Part::Shaft {
        // Shafts have a dark insulating sleeve, whatever the material of the jaws.
        base_color = [0.012, 0.012, 0.013, a];
        mean_color = base_color;
        surface = [0.38, 0.0, 0.0, 0.0];
    }
    GpuItem {
        world_from_item: matrix(&item.world_from_item.to_homogeneous()),
        base_color,
        surface,
        tiling: material.tiling.map(|part| part as f32),
        number,
        flags: 0,
        mean_color,
        empty: [[0.0; 4]; 8],
    }
}

/// A buffer for so many items, and its bind group.
fn room_for(gpu: &Gpu, passes: &Passes, count: usize) -> (wgpu::Buffer, wgpu::BindGroup) {
    let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("items"),
        size: (count.max(1) * size_of::<GpuItem>()) as u64,
        usage: wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let size = wgpu::BufferSize::new(ITEM_BYTES);
    let binding = wgpu::BufferBinding { buffer: &buffer, offset: 0, size };
    let group = gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: Some("items"),
        layout: &passes.items_layout,
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: wgpu::BindingResource::Buffer(binding) }],
    });
    (buffer, group)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_casters_have_the_same_number_as_long_as_they_throw_the_same_shadows() {
        let caster = |id, version| Caster { id, version, triangles: 10, throws: true, ..Caster::default() };
        let mut casters = Casters::default();
        casters.follow(&mut vec![caster(1, 0), caster(2, 0)]);
        let first = casters.number;
        for _ in 0..2 * STILL_AFTER {
            casters.follow(&mut vec![caster(1, 0), caster(2, 0)]);
        }
        assert_eq!(casters.number, first);
        assert!((casters.still_share() - 1.0).abs() < 1e-12);
        let still = casters.still_number;
        casters.follow(&mut vec![caster(1, 0), caster(2, 1)]);
        assert_eq!((casters.number, casters.still_number), (first + 1, still + 1));
        // It keeps moving: the still casters are the same.
        for version in 2..20 {
            casters.follow(&mut vec![caster(1, 0), caster(2, version)]);
        }
        assert_eq!((casters.number, casters.still_number), (first + 19, still + 1));
        assert!((casters.still_share() - 0.5).abs() < 1e-12);
        // One item is removed.
        casters.follow(&mut vec![caster(1, 0)]);
        assert_eq!((casters.number, casters.still_number), (first + 20, still + 2));
    }
}
