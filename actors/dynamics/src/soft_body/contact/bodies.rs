//! Contact response of soft bodies. During a step vertices are treated as free; only the touched ones are considered.

use std::collections::BTreeMap;

use nalgebra::{UnitQuaternion, Vector3};
use trocar_scene::{Entity, Snapshot};

use super::penalty::RespondingBody;
use super::tracking::{Shape, SurfacePoint};
use super::{ContactSums, SoftContacts};
use crate::picking::DrivenVertex;
use crate::soft_body::method::ContactParams;

/// Impulses that a controller's bodies have given others so far: giver, and receivers.
pub(crate) struct AppliedImpulses {
    pub giver: Entity,
    pub vertices: Vec<ContactSums>,
}

/// A body under contact: one of this controller, or of another.
pub(crate) struct ContactBody<'a> {
    pub entity: Entity,
    pub friction: Option<f64>,
    pub stiffness: f64,
    /// Time until its impulses take effect \[s\].
    pub step: f64,
    vertices: Vertices<'a>,
}

/// A contact point on a mover.
#[derive(Clone, Copy)]
pub(crate) struct ContactTarget {
    /// Index of the mover.
    pub mover: usize,
    /// Indices among the touched vertices, and their weights.
    nodes: [(usize, f64); 3],
}

/// Touched vertices, as free masses.
struct Vertices<'a> {
    rotation: UnitQuaternion<f64>,
    velocities: &'a [Vector3<f64>],
    masses_inverse: &'a [f64],
    before: FreeMotion<'a>,
    places: BTreeMap<u32, usize>,
    /// Velocities in world \[m/s\], and inverse masses \[1/kg\].
    touched: Vec<(Vector3<f64>, f64)>,
}

/// Motion of vertices without contacts.
enum FreeMotion<'a> {
    Local {
        driven: &'a [DrivenVertex],
        /// Velocity that gravity adds, in the body's frame \[m/s\].
        falls: Vector3<f64>,
        period: f64,
        /// Forces in the body's frame \[N\], by vertex.
        forces: Vec<(u32, Vector3<f64>)>,
    },
    Remote {
        entity: Entity,
        /// Velocity that gravity adds, in world \[m/s\].
        falls: Vector3<f64>,
        given: &'a [AppliedImpulses],
        taken: &'a [ContactSums],
    },
}

impl Vertices<'_> {
    /// Velocity of a vertex without contacts \[m/s\], and its inverse mass \[1/kg\].
    fn begin(&self, node: u32) -> (Vector3<f64>, f64) {
        let at = node as usize;
        let mut speed = self.velocities.get(at).copied().unwrap_or_default();
        let mut mass = self.masses_inverse.get(at).copied().unwrap_or(0.0);
        match &self.before {
            FreeMotion::Local { driven, falls, period, forces } => {
                if driven.binary_search_by_key(&node, |driven| driven.vertex).is_ok() {
                    mass = 0.0;
                }
                if mass > 0.0 {
                    speed += falls;
                }
                let first = forces.partition_point(|(vertex, _)| *vertex < node);
                for (_, force) in forces[first..].iter().take_while(|(vertex, _)| *vertex == node) {
                    speed += force * (mass * period);
                }
                (self.rotation * speed, mass)
            }
            FreeMotion::Remote { entity, falls, given, taken } => {
                let mut speed = self.rotation * speed;
                if mass > 0.0 {
                    speed += falls;
                }
                // Impulses that it has not yet taken are included in its motion.
                for AppliedImpulses { giver, vertices, .. } in given.iter() {
                    for sums in vertices.iter().filter(|sums| sums.body == Some(*entity)) {
                        speed += sums.of_vertex(node) * mass;
                        let known = taken.iter().filter(|taken| taken.body == Some(*giver));
                        known.for_each(|taken| speed -= taken.of_vertex(node) * mass);
                    }
                }
                (speed, mass)
            }
        }
    }

    fn touch(&mut self, node: u32) -> usize {
        if let Some(place) = self.places.get(&node) {
            return *place;
        }
        let begun = self.begin(node);
        self.touched.push(begun);
        self.places.insert(node, self.touched.len() - 1);
        self.touched.len() - 1
    }
}

impl<'a> ContactBody<'a> {
    /// A body of this controller that answers contacts.
    pub fn of(body: &RespondingBody<'a>, period: f64) -> Self {
        let mut forces = body.forces.clone();
        // Forces on one vertex keep their order.
        forces.sort_by_key(|(vertex, _)| *vertex);
        let ContactParams { masses_inverse, stiffness, friction, .. } = body.terms;
        let falls = body.gravity_in_body * period;
        let before = FreeMotion::Local { driven: body.driven, falls, period, forces };
        let vertices = Vertices::new(&body.shape, masses_inverse, before);
        Self { entity: body.entity, friction: Some(friction), stiffness, step: 0.0, vertices }
    }

    /// A deformable body of another controller that has published its masses.
    pub fn remote(
        (scene, entity): (&'a Snapshot, Entity),
        falls: &Vector3<f64>,
        given: &'a [AppliedImpulses],
    ) -> Option<Self> {
        let (told, shape) = (scene.get::<SoftContacts>(entity)?, Shape::of(scene, entity));
        if told.masses_inverse.len() != shape.velocities.len() {
            return None;
        }
        let before = FreeMotion::Remote { entity, falls: *falls, given, taken: &told.taken };
        let vertices = Vertices::new(&shape, &told.masses_inverse, before);
        Some(Self { entity, friction: None, stiffness: f64::INFINITY, step: told.step, vertices })
    }

    /// Prepares a contact point; `mover` is the body's index.
    pub fn hold(&mut self, mover: usize, place: &SurfacePoint) -> ContactTarget {
        let mut nodes = [(0, 0.0); 3];
        for (node, (vertex, share)) in nodes.iter_mut().zip(joint(place)) {
            *node = (self.vertices.touch(vertex), share);
        }
        ContactTarget { mover, nodes }
    }

    /// Mobility of the point \[1/kg\].
    pub fn yields(&self, handle: &ContactTarget) -> f64 {
        handle.shares().map(|(place, share)| share * share * self.vertices.touched[place].1).sum()
    }

    /// Velocity of the point \[m/s\].
    pub fn speed(&self, handle: &ContactTarget) -> Vector3<f64> {
        handle.shares().map(|(place, share)| self.vertices.touched[place].0 * share).sum()
    }

    /// Applies an impulse at the point \[N·s\].
    pub fn push(&mut self, handle: &ContactTarget, impulse: &Vector3<f64>) {
        for (place, share) in handle.shares() {
            let (speed, mass) = &mut self.vertices.touched[place];
            *speed += impulse * (share * *mass);
        }
    }
}

impl<'a> Vertices<'a> {
    fn new(shape: &Shape<'a>, masses_inverse: &'a [f64], before: FreeMotion<'a>) -> Self {
        Self {
            rotation: shape.world_from_body.rotation,
            velocities: shape.velocities,
            masses_inverse,
            before,
            places: BTreeMap::new(),
            touched: Vec::new(),
        }
    }
}

impl ContactTarget {
    fn shares(&self) -> impl Iterator<Item = (usize, f64)> {
        self.nodes.into_iter().filter(|(_, share)| *share != 0.0)
    }
}

/// The distinct vertices of a point.
fn joint(place: &SurfacePoint) -> impl Iterator<Item = (u32, f64)> {
    let ([a, b, c], [u, v, w]) = (place.nodes, place.weights);
    let first = u + if b == a { v } else { 0.0 } + if c == a { w } else { 0.0 };
    let second = if b == a { 0.0 } else { v + if c == b { w } else { 0.0 } };
    let third = if c == a || c == b { 0.0 } else { w };
    [(a, first), (b, second), (c, third)].into_iter().filter(|(_, share)| *share != 0.0)
}
