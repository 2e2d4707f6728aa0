//! Contact overlays: contact areas, normals and forces.

use std::collections::BTreeSet;

use nalgebra::Point3;
use trocar_scene::{
    Collision, CollisionList, Entity, LineMesh, Primitive, Snapshot, SurfaceMesh, TetMesh, VertexPositions,
};

use super::sketch::{Spot, Stroke};
use super::{Legend, Overlays, Seen};
use crate::draw_list::{DrawList, Item, Part};

/// Colour of contacts.
pub const CONTACT: [u8; 4] = [240, 20, 16, 255];
/// Colour of contact normals.
pub const NORMAL: [u8; 4] = [60, 210, 240, 255];
/// Colour of contact forces.
pub const FORCE: [u8; 4] = [255, 190, 30, 255];
/// Most contacts drawn.
const CONTACTS_MAX: usize = 4096;
/// Longest arrow \[m\].
const LONGEST: f64 = 0.3;
/// A pair without force and with less penetration than this is not in contact \[m\].
const APART: f64 = -1e-5;

/// Current contacts; a detector also reports pairs that are only close.
fn contacts(scene: &Snapshot) -> impl Iterator<Item = &Collision> {
    let touches =
        |collision: &&Collision| collision.depth >= APART || collision.force_in_world.norm_squared() > 0.0;
    scene.iter::<CollisionList>().flat_map(|(_, list)| &list.collisions).filter(touches).take(CONTACTS_MAX)
}

/// Colours contact areas: the triangles that a detector names, or a spot where it names none.
pub fn touching(overlays: &Overlays, scene: &Snapshot, draw_list: &DrawList, seen: &mut Seen) {
    let mut filled = BTreeSet::new();
    for contact in contacts(scene) {
        for (entity, primitive) in [(contact.a, contact.primitive_a), (contact.b, contact.primitive_b)] {
            let mut marker = Marker { overlays, scene, draw_list, seen, filled: &mut filled };
            marker.mark(entity, primitive, contact.middle_in_world());
        }
    }
    seen.legends.push(Legend::key("in contact", CONTACT));
}

struct Marker<'a> {
    overlays: &'a Overlays,
    scene: &'a Snapshot,
    draw_list: &'a DrawList,
    seen: &'a mut Seen,
    filled: &'a mut BTreeSet<(Entity, u8, u32)>,
}

impl Marker<'_> {
    fn mark(&mut self, entity: Entity, primitive: Primitive, point: Point3<f64>) {
        // A contact is between two bodies, so it is drawn through them.
        let stroke = Stroke { color: CONTACT, width: 3.0 * self.overlays.line_width, hidden: 0.45 };
        match primitive {
            Primitive::Triangle(index) => {
                let Some(corners) = self.triangle(entity, index) else {
                    return self.spot(entity, |part| part == Part::Whole, point);
                };
                if self.filled.insert((entity, 0, index)) {
                    self.seen.sketch.triangle(corners, &stroke);
                }
            }
            Primitive::Tetrahedron(index) => {
                let tets = self.scene.get::<TetMesh>(entity);
                let corners = tets.and_then(|mesh| mesh.tets.get(index as usize));
                let Some([a, b, c, d]) = corners.and_then(|corners| self.vertices(entity, *corners)) else {
                    return self.spot(entity, |part| part == Part::Whole, point);
                };
                if self.filled.insert((entity, 1, index)) {
                    for face in [[a, c, b], [a, b, d], [b, c, d], [c, a, d]] {
                        self.seen.sketch.triangle(face, &stroke);
                    }
                }
            }
            Primitive::Segment(index) => {
                let lines = self.scene.get::<LineMesh>(entity);
                let ends = lines.and_then(|mesh| mesh.segments.get(index as usize));
                let Some([from, to]) = ends.and_then(|ends| self.vertices(entity, *ends)) else {
                    return self.spot(entity, |part| part == Part::Whole, point);
                };
                if self.filled.insert((entity, 2, index)) {
                    self.seen.sketch.line(&from, &to, &stroke);
                }
            }
            Primitive::Vertex(index) => {
                let at = self.vertices(entity, [index]).map_or(point, |[vertex]| vertex);
                self.spot(entity, |part| part == Part::Whole, at);
            }
            Primitive::Shape(_) => self.spot(entity, |part| part == Part::Whole, point),
            Primitive::Jaw(0) => self.spot(entity, |part| part == Part::JawA, point),
            Primitive::Jaw(_) => self.spot(entity, |part| part == Part::JawB, point),
            Primitive::Shaft => self.spot(entity, |part| part == Part::Shaft, point),
        }
    }

    /// Corners of a drawn triangle, in world.
    fn triangle(&self, entity: Entity, index: u32) -> Option<[Point3<f64>; 3]> {
        let (_, item) = of(self.draw_list, entity).find(|(_, item)| item.part == Part::Whole)?;
        let geometry = &item.surface.geometry;
        // Triangles with invalid vertices are not drawn, which shifts the indices of later ones.
        let place = match self.scene.get::<SurfaceMesh>(entity) {
            Some(mesh) if mesh.triangles.len() * 3 != geometry.indices.len() => {
                let count = self.scene.get::<VertexPositions>(entity)?.positions.len();
                let exists = |corners: &&[u32; 3]| corners.iter().all(|corner| (*corner as usize) < count);
                let before = mesh.triangles.get(..index as usize)?;
                exists(&mesh.triangles.get(index as usize)?).then(|| before.iter().filter(exists).count())?
            }
            _ => index as usize,
        };
        let corners = geometry.indices.get(3 * place..3 * place + 3)?;
        let corner = |at: usize| {
            let [x, y, z] = *geometry.positions.get(corners[at] as usize)?;
            Some(item.world_from_item * Point3::new(f64::from(x), f64::from(y), f64::from(z)))
        };
        Some([corner(0)?, corner(1)?, corner(2)?])
    }

    /// Vertex positions of an entity in world.
    fn vertices<const N: usize>(&self, entity: Entity, indices: [u32; N]) -> Option<[Point3<f64>; N]> {
        let positions = &self.scene.get::<VertexPositions>(entity)?.positions;
        if indices.iter().any(|index| *index as usize >= positions.len()) {
            return None;
        }
        let world_from_entity = self.scene.world_pose(entity);
        Some(indices.map(|index| world_from_entity * positions[index as usize]))
    }

    fn spot(&mut self, entity: Entity, is: impl Fn(Part) -> bool, centre: Point3<f64>) {
        let radius = self.overlays.spot_radius;
        for (item, _) in of(self.draw_list, entity).filter(|(_, item)| is(item.part)) {
            self.seen.sketch.spot(Spot { item, centre, radius });
        }
    }
}

/// Items of an entity, with their indices in the draw list.
fn of(draw_list: &DrawList, entity: Entity) -> impl Iterator<Item = (usize, &Item)> {
    let items = draw_list.items();
    let first = items.partition_point(|item| item.entity < entity);
    items.iter().enumerate().skip(first).take_while(move |(_, item)| item.entity == entity)
}

/// Draws the normal of each contact, from its first to its second entity.
pub fn normals(overlays: &Overlays, scene: &Snapshot, seen: &mut Seen) {
    let stroke = Stroke { color: NORMAL, width: overlays.line_width, hidden: 0.4 };
    for contact in contacts(scene) {
        let along = contact.normal_in_world * overlays.axis_length;
        seen.sketch.arrow(&contact.middle_in_world(), &along, &stroke);
    }
    seen.legends.push(Legend::key("contact normal", NORMAL));
}

/// Draws the force of each contact on its second entity.
pub fn forces(overlays: &Overlays, scene: &Snapshot, seen: &mut Seen) {
    let stroke = Stroke { color: FORCE, width: 1.5 * overlays.line_width, hidden: 0.5 };
    for contact in contacts(scene) {
        let along = contact.force_in_world * overlays.metres_per_newton;
        seen.sketch.arrow(&contact.middle_in_world(), &along.cap_magnitude(LONGEST), &stroke);
    }
    seen.legends.push(Legend::arrow("contact force", FORCE, overlays.metres_per_newton));
}
