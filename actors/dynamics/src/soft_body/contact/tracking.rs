//! Persistent contacts of soft bodies: which detected contacts are tracked from tick to tick, and their current
//! geometry.
//!
//! A detector reports where two bodies touched in the snapshot that it read. They move on until its next list, and a
//! sheet that lies entirely within a face has no crossing left to detect. So a vertex at a triangle is *followed*: each
//! tick finds the nearest point on that triangle and its neighbours, and the contact persists while it presses, was
//! found recently, and lies over the face. All other contacts (crossing edges, points on bodies without vertices) stay
//! fixed to the points that touched, until the detector's next list.
//!
//! Between two soft bodies one side computes the contact force ([`super::penalty`]): a controller that moves both, else
//! that of the body with the lower name. It accumulates impulses on the other body's vertices; the other applies the
//! difference to what it has taken before, as in [`crate::soft_body::coupling::components`]. So momentum is conserved
//! for any delays and restarts. Impulses across controllers arrive a step late: thin sheets that collide at 0.2 m/s at
//! 1 kHz overlap by half a millimetre before they separate. With a rigid body of a rigid world the soft body computes
//! the contact in the same way ([`super::rigid`]); anything else that is not soft is a wall that moves as the scene
//! says.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_collision::primitive::{closest_on_segment, closest_on_triangle};
use trocar_scene::{
    Access, Collision, CollisionList, Component, Detection, Entity, Frozen, Instrument, LineMesh, Primitive,
    RecordPolicy, Registry, SimTime, Snapshot, SurfaceMesh, Velocity, VertexPositions, VertexVelocities,
};

use super::{BorneContact, ImpulseTotals, RigidJoint};
use crate::tet_mesh::NodeAdjacency;

/// Maximum number of answered contacts of a body.
pub const FOUND_MAX: usize = 256;
/// A contact that has neither been found nor pressed for this long is dropped.
const AGE_MAX: SimTime = SimTime(100_000_000);
/// How far beside a face a followed vertex may lie \[m\].
const ASIDE: f64 = 1e-4;
/// Minimum cosine between consecutive directions of a followed contact.
const TURN: f64 = 0.7;
/// Cosine of the maximum angle between the direction of two crossing edges and a normal of their faces: the edges of
/// bodies that lie flat on each other cross in any direction.
const ACROSS: f64 = 0.5;

/// The touched feature of a body in a contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// A vertex.
    Vertex(u32),
    /// The point on a triangle, or on its neighbours, that is nearest to the other side.
    Triangle(u32),
    /// A point between vertices, with barycentric weights.
    Between([u32; 3], [f64; 3]),
    /// A point of a body without vertices, in its frame \[m\].
    InFrame(Point3<f64>),
}

/// A persistent contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PersistentContact {
    /// The detector that found it.
    pub writer: Entity,
    /// The other body; may be the same one.
    pub other: Entity,
    /// Features on the body and on the other.
    pub spots: [Feature; 2],
    /// Unit direction in which the body is pushed.
    pub normal_in_world: Vector3<f64>,
    /// When it was last found, or pressed.
    pub seen: SimTime,
    /// Whether it pressed in the last tick.
    pub presses: bool,
    /// Whether one was inside the other then.
    pub is_in: bool,
    /// Rest depth of its spring \[m\]: the depth at the first detection, released from tick to tick.
    pub slack: f64,
    /// Displacement of the tangential spring: motion of the body across the other since it began to stick \[m\], in
    /// world.
    pub drawn: Vector3<f64>,
}

/// Cumulative impulses that a body has given to vertices of another, or taken from them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactSums {
    /// The other body.
    pub body: Option<Entity>,
    /// Vertices, ascending.
    pub vertices: Vec<u32>,
    /// Cumulative impulse on each vertex, in world \[N·s\].
    pub sums: Vec<Vector3<f64>>,
}

/// Contact state of a soft body, for contacts that detectors find.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "soft_contacts", record = RecordPolicy::sampled(10.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct SoftContacts {
    /// The contacts that it answers, also for the other side.
    pub contacts: Vec<PersistentContact>,
    /// Its contacts with rigid bodies that move, and its joints with them.
    pub borne: Vec<BorneContact>,
    /// See above.
    pub joints: Vec<RigidJoint>,
    /// Impulses given to rigid bodies in the last step.
    pub last_given: Vec<ImpulseTotals>,
    /// All impulses given to rigid bodies up to the beginning of each equal part of the last step, if it had several.
    pub course: Vec<Vec<ImpulseTotals>>,
    /// Up to which time each detector's list has been read.
    pub heard: Vec<(Entity, SimTime)>,
    /// Inverse mass of each vertex, 0 where it is fixed \[1/kg\], for bodies that answer its contacts.
    pub masses_inverse: Arc<Vec<f64>>,
    /// Length of its steps \[s\].
    pub step: f64,
    /// Impulses given to vertices of other controllers' bodies.
    pub given: Vec<ContactSums>,
    /// Impulses given to bodies that move as a whole.
    pub given_whole: Vec<ImpulseTotals>,
    /// Impulses taken from others.
    pub taken: Vec<ContactSums>,
    /// Sum of the forces of all its contacts in the last tick \[N\].
    pub force_in_world: Vector3<f64>,
}

impl ContactSums {
    /// The entry of a body; a new one if there is none.
    pub(crate) fn of(all: &mut Vec<Self>, body: Entity) -> &mut Self {
        let at = all.iter().position(|sums| sums.body == Some(body)).unwrap_or_else(|| {
            all.push(Self { body: Some(body), ..Self::default() });
            all.len() - 1
        });
        &mut all[at]
    }

    /// Cumulative impulse on one vertex \[N·s\]; zero if it received none.
    pub(crate) fn of_vertex(&self, vertex: u32) -> Vector3<f64> {
        let at = self.vertices.binary_search(&vertex).ok();
        at.and_then(|at| self.sums.get(at)).copied().unwrap_or_default()
    }

    /// Cumulative impulse on one vertex, mutable.
    pub(crate) fn at(&mut self, vertex: u32) -> &mut Vector3<f64> {
        self.sums.resize(self.vertices.len(), Vector3::zeros());
        let at = self.vertices.binary_search(&vertex).unwrap_or_else(|at| {
            self.vertices.insert(at, vertex);
            self.sums.insert(at, Vector3::zeros());
            at
        });
        &mut self.sums[at]
    }
}

/// Reads and writes of the contact response.
pub(crate) fn access(access: Access, registry: &Registry) -> Access {
    access
        .reads::<CollisionList>()
        .reads::<VertexPositions>()
        .reads::<VertexVelocities>()
        .reads_named(registry.soft_bodies_that(|of| of.responds_to_contacts))
}

/// Whether a controller of soft bodies answers for a body.
pub(crate) fn answers(scene: &Snapshot, entity: Entity) -> bool {
    scene.soft_body(entity).is_some_and(|(_, of)| of.responds_to_contacts)
        && scene.get::<Frozen>(entity).is_none()
}

/// Current geometry of a body, from this controller or from the scene.
#[derive(Clone)]
pub(crate) struct Shape<'a> {
    pub world_from_body: Isometry3<f64>,
    pub positions: &'a [Point3<f64>],
    pub velocities: &'a [Vector3<f64>],
    pub triangles: Arc<Vec<[u32; 3]>>,
    pub segments: Arc<Vec<[u32; 2]>>,
    /// Velocity of a body that moves as a whole.
    pub motion: Velocity,
}

/// Current position of a point on a body.
#[derive(Clone, Copy)]
pub(crate) struct SurfacePoint {
    pub nodes: [u32; 3],
    /// Zero for a body without vertices.
    pub weights: [f64; 3],
    pub at_in_world: Point3<f64>,
    /// Velocity by the rigid motion of the body, without its vertices' velocities \[m/s\].
    pub carried: Vector3<f64>,
}

impl<'a> Shape<'a> {
    /// A body of the scene.
    pub fn of(scene: &'a Snapshot, entity: Entity) -> Self {
        let vertices = scene.get::<VertexPositions>(entity);
        let velocities = scene.get::<VertexVelocities>(entity);
        let triangles = scene.get::<SurfaceMesh>(entity).map(|mesh| mesh.triangles.clone());
        let segments = scene.get::<LineMesh>(entity).map(|line| line.segments.clone());
        Self {
            world_from_body: scene.world_pose(entity),
            positions: vertices.map_or(&[], |vertices| &vertices.positions),
            velocities: velocities.map_or(&[], |velocities| &velocities.velocities),
            triangles: triangles.unwrap_or_default(),
            segments: segments.unwrap_or_default(),
            motion: scene.get::<Velocity>(entity).copied().unwrap_or_default(),
        }
    }

    fn vertex(&self, vertex: u32) -> Option<Point3<f64>> {
        self.positions.get(vertex as usize).map(|point| self.world_from_body * point)
    }

    fn place(&self, nodes: [u32; 3], weights: [f64; 3]) -> Option<SurfacePoint> {
        let mut at = Vector3::zeros();
        for (node, weight) in nodes.into_iter().zip(weights) {
            at += self.vertex(node)?.coords * weight;
        }
        Some(SurfacePoint { nodes, weights, at_in_world: at.into(), carried: self.carried(&at) })
    }

    /// Velocity of a point \[m/s\].
    pub fn speed(&self, place: &SurfacePoint) -> Vector3<f64> {
        let shares = place.nodes.into_iter().zip(place.weights).filter(|(_, weight)| *weight != 0.0);
        let own = shares.filter_map(|(node, weight)| Some(self.velocities.get(node as usize)? * weight));
        place.carried + self.world_from_body.rotation * own.sum::<Vector3<f64>>()
    }

    fn carried(&self, at_in_world: &Vector3<f64>) -> Vector3<f64> {
        let lever = at_in_world - self.world_from_body.translation.vector;
        self.motion.linear + self.motion.angular.cross(&lever)
    }

    /// Unit normal of the face of a feature.
    fn face(&self, feature: &Feature) -> Option<Vector3<f64>> {
        let Feature::Between(nodes, _) = feature else { return None };
        let [a, b, c] = nodes.map(|node| self.vertex(node));
        let (a, b, c) = (a?, b?, c?);
        (b - a).cross(&(c - a)).try_normalize(0.0)
    }

    /// The feature for a primitive that was touched at a point.
    fn feature(
        &self,
        part: Primitive,
        then: &Point3<f64>,
        is_followed: bool,
        stars: Option<&NodeAdjacency>,
    ) -> Option<Feature> {
        match part {
            Primitive::Vertex(vertex) if is_followed => self.vertex(vertex).map(|_| Feature::Vertex(vertex)),
            // An edge is identified by its first vertex: take the nearest point.
            Primitive::Vertex(vertex) => {
                let about = stars.map_or(&[][..], |stars| stars.about(vertex)).iter();
                let near = about.filter_map(|&triangle| {
                    let nodes = *self.triangles.get(triangle as usize)?;
                    let [a, b, c] = nodes.map(|node| self.vertex(node));
                    let nearest = closest_on_triangle(then, &[a?, b?, c?]);
                    Some(((nearest.point - then).norm_squared(), nodes, nearest.weights))
                });
                match near.min_by(|a, b| a.0.total_cmp(&b.0)) {
                    Some((_, nodes, weights)) => Some(Feature::Between(nodes, weights)),
                    None => self.vertex(vertex).map(|_| Feature::Vertex(vertex)),
                }
            }
            Primitive::Triangle(triangle) => {
                let nodes = *self.triangles.get(triangle as usize)?;
                let [a, b, c] = nodes.map(|node| self.vertex(node));
                let nearest = closest_on_triangle(then, &[a?, b?, c?]);
                Some(if is_followed {
                    Feature::Triangle(triangle)
                } else {
                    Feature::Between(nodes, nearest.weights)
                })
            }
            Primitive::Segment(segment) => {
                let [a, b] = *self.segments.get(segment as usize)?;
                let along = closest_on_segment(then, &[self.vertex(a)?, self.vertex(b)?]);
                Some(Feature::Between([a, b, b], [1.0 - along, along, 0.0]))
            }
            // For a body with moving vertices, the nearest one.
            _ if !self.velocities.is_empty() => {
                let near = |vertex: &u32| self.vertex(*vertex).map(|point| (point - then).norm_squared());
                let all =
                    (0..self.positions.len() as u32).filter_map(|vertex| Some((near(&vertex)?, vertex)));
                all.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, vertex)| Feature::Vertex(vertex))
            }
            _ => Some(Feature::InFrame(self.world_from_body.inverse_transform_point(then))),
        }
    }
}

/// Nearest point to a vertex so far: squared distance \[m²\], triangle and weights.
#[derive(Clone, Copy)]
struct NearestPoint {
    far: f64,
    candidate: u32,
    weights: [f64; 3],
    on_face: Point3<f64>,
    normal: Vector3<f64>,
}

/// Two points in contact or close to it.
#[derive(Clone, Copy)]
pub(crate) struct ContactPair {
    /// On the body and on the other.
    pub places: [SurfacePoint; 2],
    pub normal_in_world: Vector3<f64>,
    pub depth: f64,
}

impl PersistentContact {
    /// A detected contact, seen from the body on one side; `shapes` are that body and the other one. `None` if a
    /// feature does not exist.
    pub(crate) fn new(
        row: &Collision,
        side: usize,
        writer: Entity,
        shapes: [&Shape<'_>; 2],
        stars: [Option<&NodeAdjacency>; 2],
    ) -> Option<Self> {
        let parts =
            if side == 0 { [row.primitive_a, row.primitive_b] } else { [row.primitive_b, row.primitive_a] };
        let is_followed = matches!(
            parts,
            [Primitive::Vertex(_), Primitive::Triangle(_)] | [Primitive::Triangle(_), Primitive::Vertex(_)]
        );
        let points = [row.points_in_world[side], row.points_in_world[1 - side]];
        let towards = if side == 0 { -row.normal_in_world } else { row.normal_in_world };
        let feature = |at: usize| shapes[at].feature(parts[at], &points[at], is_followed, stars[at]);
        let spots = [feature(0)?, feature(1)?];
        let normal_in_world = towards.try_normalize(0.5)?;
        let along = |at: usize| shapes[at].face(&spots[at]).map(|face| face.dot(&normal_in_world).abs());
        if let (Some(one), Some(two)) = (along(0), along(1))
            && one.max(two) < ACROSS
        {
            return None;
        }
        Some(Self {
            writer,
            other: if side == 0 { row.b } else { row.a },
            spots,
            normal_in_world,
            seen: row.detected_at,
            presses: false,
            is_in: false,
            slack: 0.0,
            drawn: Vector3::zeros(),
        })
    }

    /// Whether it has the same vertex and bodies as another one.
    pub(crate) fn is_of(&self, other: &Self) -> bool {
        let vertex = |of: &Self| match of.spots {
            [Feature::Vertex(vertex), Feature::Triangle(_)] => Some((0, vertex)),
            [Feature::Triangle(_), Feature::Vertex(vertex)] => Some((1, vertex)),
            _ => None,
        };
        self.other == other.other && vertex(self).is_some() && vertex(self) == vertex(other)
    }

    pub(crate) fn is_followed(&self) -> bool {
        self.spots.iter().any(|feature| matches!(feature, Feature::Triangle(_)))
    }

    /// Whether it has expired.
    pub(crate) fn is_old(&self, now: SimTime) -> bool {
        now.0.saturating_sub(self.seen.0) > AGE_MAX.0
    }

    /// Its current geometry; a followed contact is tracked. `None` when it has ended.
    pub(crate) fn contact_geometry(
        &mut self,
        shapes: [&Shape<'_>; 2],
        stars: [Option<&NodeAdjacency>; 2],
    ) -> Option<ContactPair> {
        let (vertex, face) = match self.spots {
            [Feature::Vertex(_), Feature::Triangle(_)] => (0, 1),
            [Feature::Triangle(_), Feature::Vertex(_)] => (1, 0),
            _ => return self.meet_fixed(shapes),
        };
        let (Feature::Vertex(number), Feature::Triangle(triangle)) = (self.spots[vertex], self.spots[face])
        else {
            return None;
        };
        let point = shapes[vertex].vertex(number)?;
        // Push direction of the vertex.
        let push = if vertex == 0 { self.normal_in_world } else { -self.normal_in_world };
        let own = *shapes[face].triangles.get(triangle as usize)?;
        let about = own.iter().flat_map(|&node| stars[face].map_or(&[][..], |stars| stars.about(node)));
        let mut nearest: Option<NearestPoint> = None;
        for candidate in std::iter::once(triangle).chain(about.copied()) {
            let Some(nodes) = shapes[face].triangles.get(candidate as usize) else { continue };
            if std::ptr::eq(shapes[0].positions, shapes[1].positions) && nodes.contains(&number) {
                continue;
            }
            let [Some(a), Some(b), Some(c)] = nodes.map(|node| shapes[face].vertex(node)) else { continue };
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
            let normal = if normal.dot(&push) < 0.0 { -normal } else { normal };
            if normal.dot(&push) < TURN {
                continue;
            }
            let found = closest_on_triangle(&point, &[a, b, c]);
            let far = (found.point - point).norm_squared();
            if nearest.is_none_or(|nearest| far < nearest.far) {
                nearest = Some(NearestPoint {
                    far,
                    candidate,
                    weights: found.weights,
                    on_face: found.point,
                    normal,
                });
            }
        }
        let NearestPoint { candidate, weights, on_face, normal, .. } = nearest?;
        let depth = (on_face - point).dot(&normal);
        if ((on_face - point) - normal * depth).norm() > ASIDE {
            return None;
        }
        self.spots[face] = Feature::Triangle(candidate);
        self.normal_in_world = if vertex == 0 { normal } else { -normal };
        let on_vertex = shapes[vertex].place([number; 3], [1.0, 0.0, 0.0])?;
        let on_triangle = shapes[face].place(shapes[face].triangles[candidate as usize], weights)?;
        let places = if vertex == 0 { [on_vertex, on_triangle] } else { [on_triangle, on_vertex] };
        Some(ContactPair { places, normal_in_world: self.normal_in_world, depth })
    }

    fn meet_fixed(&self, shapes: [&Shape<'_>; 2]) -> Option<ContactPair> {
        let place = |side: usize| match self.spots[side] {
            Feature::Vertex(vertex) => shapes[side].place([vertex; 3], [1.0, 0.0, 0.0]),
            Feature::Between(nodes, weights) => shapes[side].place(nodes, weights),
            Feature::InFrame(point) => {
                let at_in_world = shapes[side].world_from_body * point;
                let carried = shapes[side].carried(&at_in_world.coords);
                Some(SurfacePoint { nodes: [0; 3], weights: [0.0; 3], at_in_world, carried })
            }
            Feature::Triangle(_) => None,
        };
        let places = [place(0)?, place(1)?];
        let normal = self.normal_in_world;
        let depth = (places[1].at_in_world - places[0].at_in_world).dot(&normal);
        Some(ContactPair { places, normal_in_world: normal, depth })
    }
}

/// Cached vertex-to-triangle adjacency of each surface.
#[derive(Default)]
pub(crate) struct AdjacencyCache(BTreeMap<Entity, CachedAdjacency>);

struct CachedAdjacency {
    triangles: Arc<Vec<[u32; 3]>>,
    stars: NodeAdjacency,
}

impl AdjacencyCache {
    pub fn look(&mut self, entity: Entity, triangles: &Arc<Vec<[u32; 3]>>) {
        let known = self.0.get(&entity).is_some_and(|known| Arc::ptr_eq(&known.triangles, triangles));
        if !known {
            let stars = NodeAdjacency::new(0, (0..).zip(triangles.iter().copied()));
            self.0.insert(entity, CachedAdjacency { triangles: triangles.clone(), stars });
        }
    }

    pub fn of(&self, entity: Entity) -> Option<&NodeAdjacency> {
        self.0.get(&entity).map(|known| &known.stars)
    }
}

/// The rows of all collision lists about bodies without instruments (instrument contacts are handled by each body),
/// with their writers; without those written by `me` or by contact responses.
pub(crate) fn rows(scene: &Snapshot, me: Entity, now: SimTime) -> impl Iterator<Item = (Entity, &Collision)> {
    let lists = scene.iter::<CollisionList>().filter(move |(writer, _)| *writer != me);
    let all = lists.flat_map(|(writer, list)| list.collisions.iter().map(move |row| (writer, row)));
    all.filter(move |(_, row)| {
        let tells = !matches!(row.method, Detection::Simulator | Detection::Engine | Detection::Proxy);
        let is_body = |entity: Entity| scene.get::<Instrument>(entity).is_none();
        let is_new = now.0.saturating_sub(row.detected_at.0) <= AGE_MAX.0;
        tells && is_new && is_body(row.a) && is_body(row.b)
    })
}
