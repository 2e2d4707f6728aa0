//! The list of what is drawn: geometry, poses and materials of a snapshot. Only changes since the last snapshot are
//! processed.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Isometry3;
use trocar_scene::component::Component;
use trocar_scene::shapes::{Detail, instrument_from_hinge, instrument_surface, surface_of};
use trocar_scene::{
    Entity, Instrument, JawState, LineMesh, Revision, Shape, Snapshot, SurfaceMesh, TetMesh,
    TextureCoordinates, VertexPositions, VisualMaterial,
};

use crate::geometry::{Geometry, Moving};

/// Segments around a shaft.
const SHAFT_SEGMENTS: usize = 24;

/// Part of an instrument, or the whole of anything else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Part {
    /// All of it.
    Whole,
    /// The insulated shaft of an instrument.
    Shaft,
    /// Jaw A at +x.
    JawA,
    /// Jaw B at −x.
    JawB,
}

/// A surface with a number for its copies on devices.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Unique within a draw list.
    pub id: u64,
    /// How often its triangles and texture coordinates changed.
    pub topology: u64,
    /// How often its positions and normals changed.
    pub version: u64,
    /// Its triangles.
    pub geometry: Arc<Geometry>,
}

/// An item to draw.
#[derive(Clone, Debug)]
pub struct Item {
    /// Its entity.
    pub entity: Entity,
    /// The part of the entity.
    pub part: Part,
    /// Its surface.
    pub surface: Surface,
    /// Its pose in world.
    pub world_from_item: Isometry3<f64>,
    /// Its material.
    pub material: Arc<VisualMaterial>,
}

/// Surfaces and material of one entity.
struct Entry {
    parts: Vec<(Part, Surface)>,
    /// Makes the surface follow the entity's vertices.
    moving: Option<Moving>,
    material: Arc<VisualMaterial>,
    /// Distance from an instrument's hinge to its tip \[m\].
    jaw_length: f64,
}

/// The drawables of a scene, kept in step with its snapshots.
#[derive(Default)]
pub struct DrawList {
    entries: BTreeMap<Entity, Entry>,
    /// Surfaces of shapes that several entities share, by shape.
    shared: BTreeMap<String, Surface>,
    items: Vec<Item>,
    /// The last revision, with its interpolation counter.
    seen: Option<(Revision, u64)>,
    next_id: u64,
}

impl DrawList {
    /// An empty list.
    pub fn new() -> Self {
        Self::default()
    }

    /// The items, in the order of entities.
    pub fn items(&self) -> &[Item] {
        &self.items
    }

    /// Follows the scene to this snapshot; `false` when nothing has changed. An earlier snapshot than the last one (a
    /// rewound replay, another session) is processed from the start, as is one with a lower interpolation counter.
    pub fn update(&mut self, scene: &Snapshot) -> bool {
        let (revision, retouches) = (scene.revision(), scene.retouches());
        if self.seen == Some((revision, retouches)) {
            return false;
        }
        let follows = |(seen, before): &(Revision, u64)| *seen <= revision && *before <= retouches;
        let since = self.seen.filter(follows).map(|(seen, _)| seen);
        if since.is_none() {
            self.entries.clear();
        }
        // Only the entries hold surfaces now, so those that deform do so in place.
        self.items.clear();
        self.entries.retain(|entity, _| scene.contains(*entity) && is_visible(scene, *entity));
        self.follow_shapes(scene, since);
        self.follow_meshes(scene, since);
        self.follow_materials(scene, since);
        self.shared.retain(|_, surface| Arc::strong_count(&surface.geometry) > 1);
        self.place(scene);
        self.seen = Some((revision, retouches));
        true
    }

    fn follow_shapes(&mut self, scene: &Snapshot, since: Option<Revision>) {
        let shapes = changed::<Shape>(scene, since);
        for (entity, shape) in shapes {
            let key = format!("{shape:?}");
            let build = || Some(Geometry::from_surface(&surface_of(shape, &Detail::default()).ok()?));
            let Some(surface) = self.shared_surface(&key, build) else { continue };
            self.enter(scene, entity, vec![(Part::Whole, surface)], 0.0, None);
        }
        for (entity, instrument) in changed::<Instrument>(scene, since) {
            let key = format!("{instrument:?}");
            let Ok(built) = instrument_surface(instrument, SHAFT_SEGMENTS) else { continue };
            let mut parts = Vec::new();
            let pieces = [
                (Part::Shaft, Some(&built.shaft)),
                (Part::JawA, built.jaw_a.as_ref()),
                (Part::JawB, built.jaw_b.as_ref()),
            ];
            for (part, piece) in pieces {
                let surface = piece.and_then(|piece| {
                    self.shared_surface(&format!("{key} {part:?}"), || Some(Geometry::from_surface(piece)))
                });
                parts.extend(surface.map(|surface| (part, surface)));
            }
            self.enter(scene, entity, parts, built.jaw_length, None);
        }
    }

    fn follow_meshes(&mut self, scene: &Snapshot, since: Option<Revision>) {
        let mut rebuilt: Vec<Entity> = Vec::new();
        rebuilt.extend(changed::<SurfaceMesh>(scene, since).map(|(entity, _)| entity));
        rebuilt.extend(changed::<TetMesh>(scene, since).map(|(entity, _)| entity));
        rebuilt.extend(changed::<LineMesh>(scene, since).map(|(entity, _)| entity));
        rebuilt.extend(changed::<TextureCoordinates>(scene, since).map(|(entity, _)| entity));
        rebuilt.sort_unstable();
        rebuilt.dedup();
        for entity in &rebuilt {
            self.build_mesh(scene, *entity);
        }
        for (entity, vertices) in changed::<VertexPositions>(scene, since) {
            if rebuilt.binary_search(&entity).is_ok() {
                continue;
            }
            match self.entries.get_mut(&entity) {
                Some(Entry { parts, moving: Some(moving), .. }) => {
                    let [(_, surface), ..] = parts.as_mut_slice() else { continue };
                    let geometry = Arc::make_mut(&mut surface.geometry);
                    let line = scene.get::<LineMesh>(entity);
                    surface.topology += u64::from(moving.follow(line, &vertices.positions, geometry));
                    surface.version += 1;
                }
                _ => self.build_mesh(scene, entity),
            }
        }
    }

    fn build_mesh(&mut self, scene: &Snapshot, entity: Entity) {
        let Some(vertices) = scene.get::<VertexPositions>(entity) else { return };
        let (surface, volume) = (scene.get::<SurfaceMesh>(entity), scene.get::<TetMesh>(entity));
        let built = match scene.get::<LineMesh>(entity) {
            Some(line) => Some(Moving::line(line, vertices)),
            None => Moving::mesh(surface, volume, vertices, scene.get::<TextureCoordinates>(entity)),
        };
        let Some((moving, geometry)) = built else { return };
        let surface = Surface { id: self.new_id(), topology: 0, version: 0, geometry: Arc::new(geometry) };
        self.enter(scene, entity, vec![(Part::Whole, surface)], 0.0, Some(moving));
    }

    fn follow_materials(&mut self, scene: &Snapshot, since: Option<Revision>) {
        for (entity, material) in changed::<VisualMaterial>(scene, since) {
            if let Some(entry) = self.entries.get_mut(&entity)
                && *entry.material != *material
            {
                entry.material = Arc::new(material.clone());
            }
        }
    }

    fn enter(
        &mut self,
        scene: &Snapshot,
        entity: Entity,
        parts: Vec<(Part, Surface)>,
        jaw_length: f64,
        moving: Option<Moving>,
    ) {
        let material = Arc::new(scene.get::<VisualMaterial>(entity).cloned().unwrap_or_default());
        self.entries.insert(entity, Entry { parts, moving, material, jaw_length });
    }

    fn shared_surface(&mut self, key: &str, build: impl FnOnce() -> Option<Geometry>) -> Option<Surface> {
        if let Some(surface) = self.shared.get(key) {
            return Some(surface.clone());
        }
        let geometry = Arc::new(build()?);
        let surface = Surface { id: self.new_id(), topology: 0, version: 0, geometry };
        self.shared.insert(key.to_owned(), surface.clone());
        Some(surface)
    }

    fn new_id(&mut self) -> u64 {
        self.next_id += 1;
        self.next_id
    }

    fn place(&mut self, scene: &Snapshot) {
        for (entity, entry) in &self.entries {
            let world_from_entity = scene.world_pose(*entity);
            let opening = scene.get::<JawState>(*entity).map_or(0.0, |jaws| jaws.angle);
            for (part, surface) in &entry.parts {
                let world_from_item = match part {
                    Part::Whole | Part::Shaft => world_from_entity,
                    Part::JawA => world_from_entity * instrument_from_hinge(entry.jaw_length, 1.0, opening),
                    Part::JawB => world_from_entity * instrument_from_hinge(entry.jaw_length, -1.0, opening),
                };
                self.items.push(Item {
                    entity: *entity,
                    part: *part,
                    surface: surface.clone(),
                    world_from_item,
                    material: Arc::clone(&entry.material),
                });
            }
        }
    }
}

/// The changed rows of a component, or all of them.
fn changed<T: Component>(scene: &Snapshot, since: Option<Revision>) -> impl Iterator<Item = (Entity, &T)> {
    let all = since.is_none();
    let newer = since.map(|since| scene.iter_changed::<T>(since));
    newer.into_iter().flatten().chain(all.then(|| scene.iter::<T>()).into_iter().flatten())
}

fn is_visible(scene: &Snapshot, entity: Entity) -> bool {
    let is_mesh = || {
        scene.get::<SurfaceMesh>(entity).is_some()
            || scene.get::<TetMesh>(entity).is_some()
            || scene.get::<LineMesh>(entity).is_some()
    };
    scene.get::<Shape>(entity).is_some()
        || scene.get::<Instrument>(entity).is_some()
        || (scene.get::<VertexPositions>(entity).is_some() && is_mesh())
}
