//! Contact reports of detectors to the scene.

use nalgebra::{Point3, Vector3};
use trocar_scene::components::{Collision, CollisionList, Detection, Primitive};
use trocar_scene::{Commands, Entity, SimTime};

use crate::Part;

/// Most contacts reported by one detector: the deepest ones.
pub const COLLISIONS_MAX: usize = 256;

/// Default stiffness of two bodies \[N/m\].
pub fn stiffness() -> f64 {
    500.0
}

/// Converts a part to the scene's primitive; an edge becomes its first vertex.
pub fn primitive(part: Part) -> Primitive {
    match part {
        Part::Vertex(index) | Part::Edge([index, _]) => Primitive::Vertex(index),
        Part::Segment(index) => Primitive::Segment(index),
        Part::Triangle(index) => Primitive::Triangle(index),
    }
}

/// A contact, before the stiffness is divided among the contacts of its pair.
#[derive(Clone, Copy, Debug)]
pub struct FoundContact {
    /// Entities, and their parts.
    pub parts: [(Entity, Primitive); 2],
    /// Contact point on the second one, in world \[m\]; the first reaches beyond it by the depth.
    pub on_second_in_world: Point3<f64>,
    /// Unit direction from the first to the second.
    pub normal_in_world: Vector3<f64>,
    /// Penetration depth \[m\]; negative while apart.
    pub depth: f64,
}

/// Collects the contacts of a detector in a tick.
#[derive(Debug)]
pub struct Report {
    method: Detection,
    /// Total stiffness of a pair of bodies, shared by its contacts \[N/m\].
    stiffness: f64,
    found: Vec<FoundContact>,
    /// End index of each pair of bodies in the list.
    pairs: Vec<usize>,
    penetration_max: f64,
    was_empty: bool,
}

impl Report {
    /// A report of a method.
    pub fn new(method: Detection, stiffness: f64) -> Self {
        Self {
            method,
            stiffness,
            found: Vec::new(),
            pairs: Vec::new(),
            penetration_max: 0.0,
            // The first list is always sent, even empty, so that the detector is known.
            was_empty: false,
        }
    }

    /// Begins a new tick.
    pub fn begin(&mut self) {
        self.found.clear();
        self.pairs.clear();
    }

    /// Adds a contact of the current pair of bodies.
    pub fn add(&mut self, found: FoundContact) {
        self.found.push(found);
    }

    /// Completes the contacts of the current pair of bodies.
    pub fn end_pair(&mut self) {
        self.pairs.push(self.found.len());
    }

    /// Contributes the list. `read_at` is the time of the scene in which the contacts were found.
    pub fn send(&mut self, read_at: SimTime, out: &mut Commands) {
        // An empty list after an empty list is not sent again.
        if self.found.is_empty() && std::mem::replace(&mut self.was_empty, true) {
            return;
        }
        self.was_empty = self.found.is_empty();
        let mut collisions = Vec::with_capacity(self.found.len().min(COLLISIONS_MAX));
        let mut from = 0;
        for &until in &self.pairs {
            let pair = &mut self.found[from..until];
            from = until;
            pair.sort_by(|a, b| b.depth.total_cmp(&a.depth));
            let room = COLLISIONS_MAX - collisions.len();
            let told = &pair[..pair.len().min(room)];
            let pressing = told.iter().filter(|found| found.depth > 0.0).count().max(1);
            let stiffness = self.stiffness / pressing as f64;
            let method = self.method;
            collisions.extend(told.iter().map(|found| collision(found, stiffness, method, read_at)));
        }
        let deepest = collisions.iter().map(|collision| collision.depth).fold(0.0, f64::max);
        self.penetration_max = self.penetration_max.max(deepest);
        out.contribute(CollisionList { collisions, penetration_max: self.penetration_max });
    }
}

fn collision(found: &FoundContact, stiffness: f64, method: Detection, detected_at: SimTime) -> Collision {
    let [(a, primitive_a), (b, primitive_b)] = found.parts;
    let normal_in_world = found.normal_in_world;
    Collision {
        a,
        primitive_a,
        b,
        primitive_b,
        points_in_world: [found.on_second_in_world + normal_in_world * found.depth, found.on_second_in_world],
        normal_in_world,
        depth: found.depth,
        force_in_world: normal_in_world * (stiffness * found.depth.max(0.0)),
        // They must not come nearer.
        velocity_constraint: 0.0,
        method,
        detected_at,
    }
}
