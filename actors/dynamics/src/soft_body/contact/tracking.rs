//! Contacts that detectors find of soft bodies: what is kept of them from tick to tick, and where they are now.
//!
//! A detector says where two bodies touched in the scene that it read. Until its next list they move on, and once a sheet lies
//! within a face there is no crossing left for it to find. So a vertex at a triangle is *followed*: from tick to tick the nearest
//! place on that triangle and its neighbours is looked for, and it goes on for as long as it presses, has been found
//! lately, and is over the face. All else (edges that cross, places on bodies without vertices) is fixed to the places that
//! touched, until the detector's next list.
//!
//! Of two soft bodies one side computes what they exert on each other ([`super::penalty`]): a controller that moves
//! both, else that of the body with the lower name. What it has given the vertices of the other is a sum of impulses, of which
//! the other takes what it has not taken, as in [`crate::soft_body::coupling::components`]: what one gets the other loses, whoever is late or begins
//! another life. What passes across controllers comes a step late: thin sheets that meet at 0.2 m/s at 1 kHz are half a
//! millimetre in each other before they part. Of a rigid body that a world of rigid bodies moves the soft one computes all
//! in the same way ([`super::rigid`]); what else is not soft is a wall that moves as the scene says.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_collision::primitive::{closest_on_segment, closest_on_triangle};
use trocar_scene::{
    Access, Collision, CollisionList, Component, ComponentError, Detection, Entity, EntitySet, Frozen,
    Instrument, LineMesh, Primitive, Registry, SimTime, Snapshot, SurfaceMesh, Velocity, VertexPositions,
    VertexVelocities,
};

use super::{ImpulseTotals, RigidContacts};
use crate::tet_mesh::Stars;

/// Contacts of a body that are answered at a time.
pub const FOUND_MAX: usize = 256;
/// What has neither been found nor pressed for so long is forgotten.
const AGE_MAX: SimTime = SimTime(100_000_000);
/// How far beside a face a followed vertex may be \[m\].
const ASIDE: f64 = 1e-4;
/// Cosine of the angle by which the direction of a followed contact may turn at once.
const TURN: f64 = 0.7;
/// Cosine of the angle up to which two edges may part from the direction that one of their faces has: what lies flat on
/// each other crosses with its edges in any direction.
const ACROSS: f64 = 0.5;

/// A place of a body in a contact.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Feature {
    /// A vertex.
    Vertex(u32),
    /// Wherever on a triangle, or next to it, the other side is.
    Triangle(u32),
    /// A place between vertices.
    Between([u32; 3], [f64; 3]),
    /// A place of a body without vertices, in its frame \[m\].
    InFrame(Point3<f64>),
}

/// A contact that is answered.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PersistentContact {
    /// Who found it.
    pub writer: Entity,
    /// The other body, which may be the same one.
    pub other: Entity,
    /// On the body and on the other.
    pub spots: [Feature; 2],
    /// Unit direction in which the body is pushed.
    pub normal_in_world: Vector3<f64>,
    /// When it was found last, or pressed.
    pub seen: SimTime,
    /// Whether it pressed in the last tick.
    pub presses: bool,
    /// Whether one was within the other then.
    pub is_in: bool,
    /// Depth from which on its spring pushes \[m\]: what it had when they came into each other, and less from tick to tick.
    pub slack: f64,
    /// How far the body has been drawn across the other since it began to stick there \[m\], in world.
    pub drawn: Vector3<f64>,
}

/// Impulses that a body has given vertices of another or taken of them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ContactSums {
    /// Of or to whom.
    pub body: Option<Entity>,
    /// Its vertices, ascending.
    pub vertices: Vec<u32>,
    /// All so far, of each vertex, in world \[N·s\].
    pub sums: Vec<Vector3<f64>>,
}

/// What a soft body keeps of the contacts that others have found of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SoftContacts {
    /// Those that it answers for, also for the other side.
    pub contacts: Vec<PersistentContact>,
    /// Until when each detector has been listened to.
    pub heard: Vec<(Entity, SimTime)>,
    /// One over the mass of each vertex, 0 where it is held \[1/kg\]: for whoever answers for it.
    pub masses_inverse: Arc<Vec<f64>>,
    /// Length of its steps \[s\].
    pub step: f64,
    /// What it has given the vertices of bodies of other controllers.
    pub given: Vec<ContactSums>,
    /// What it has given bodies that move as a whole.
    pub given_whole: Vec<ImpulseTotals>,
    /// What of that which others have given it, it has taken.
    pub taken: Vec<ContactSums>,
    /// Of all its contacts in the last tick, on it \[N\].
    pub force_in_world: Vector3<f64>,
}
impl Component for SoftContacts {
    const NAME: &'static str = "soft_contacts";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}

impl ContactSums {
    /// Of one body among several; a new one if there is none.
    pub(crate) fn of(all: &mut Vec<Self>, body: Entity) -> &mut Self {
        let at = all.iter().position(|sums| sums.body == Some(body)).unwrap_or_else(|| {
            all.push(Self { body: Some(body), ..Self::default() });
            all.len() - 1
        });
        &mut all[at]
    }

    /// The sum of one vertex \[N·s\], zero of one that got nothing.
    pub(crate) fn of_vertex(&self, vertex: u32) -> Vector3<f64> {
        let at = self.vertices.binary_search(&vertex).ok();
        at.and_then(|at| self.sums.get(at)).copied().unwrap_or_default()
    }

    /// The sum of one vertex.
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

/// What answers are read from and written to.
pub(crate) fn access(access: Access, registry: &Registry, bodies: &[Entity]) -> Access {
    access
        .reads::<CollisionList>()
        .reads::<VertexPositions>()
        .reads::<VertexVelocities>()
        .reads_named(registry.soft_bodies_that(|of| of.responds_to_contacts))
        .reads::<RigidContacts>()
        .writes::<SoftContacts>(EntitySet::Of(bodies.to_vec()))
}

/// Whether a controller of soft bodies answers for a body.
pub(crate) fn answers(scene: &Snapshot, entity: Entity) -> bool {
    scene.soft_body(entity).is_some_and(|(_, of)| of.responds_to_contacts)
        && scene.get::<Frozen>(entity).is_none()
}

/// A body as it is now, of this controller or of the scene.
#[derive(Clone)]
pub(crate) struct Shape<'a> {
    pub world_from_body: Isometry3<f64>,
    pub positions: &'a [Point3<f64>],
    pub velocities: &'a [Vector3<f64>],
    pub triangles: Arc<Vec<[u32; 3]>>,
    pub segments: Arc<Vec<[u32; 2]>>,
    /// Of one that moves as a whole.
    pub motion: Velocity,
}

/// A place on a body now.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub nodes: [u32; 3],
    /// Zero of a body without vertices.
    pub weights: [f64; 3],
    pub at_in_world: Point3<f64>,
    /// By the motion of the body as a whole, its vertices not counted \[m/s\].
    pub carried: Vector3<f64>,
}

impl<'a> Shape<'a> {
    /// Of a body of the scene.
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

    fn place(&self, nodes: [u32; 3], weights: [f64; 3]) -> Option<Place> {
        let mut at = Vector3::zeros();
        for (node, weight) in nodes.into_iter().zip(weights) {
            at += self.vertex(node)?.coords * weight;
        }
        Some(Place { nodes, weights, at_in_world: at.into(), carried: self.carried(&at) })
    }

    /// How a place moves \[m/s\].
    pub fn speed(&self, place: &Place) -> Vector3<f64> {
        let shares = place.nodes.into_iter().zip(place.weights).filter(|(_, weight)| *weight != 0.0);
        let own = shares.filter_map(|(node, weight)| Some(self.velocities.get(node as usize)? * weight));
        place.carried + self.world_from_body.rotation * own.sum::<Vector3<f64>>()
    }

    fn carried(&self, at_in_world: &Vector3<f64>) -> Vector3<f64> {
        let lever = at_in_world - self.world_from_body.translation.vector;
        self.motion.linear + self.motion.angular.cross(&lever)
    }

    /// Unit direction across the face that a spot is fixed to.
    fn face(&self, spot: &Feature) -> Option<Vector3<f64>> {
        let Feature::Between(nodes, _) = spot else { return None };
        let [a, b, c] = nodes.map(|node| self.vertex(node));
        let (a, b, c) = (a?, b?, c?);
        (b - a).cross(&(c - a)).try_normalize(0.0)
    }

    /// The spot of a part that was touched at a point.
    fn spot(
        &self,
        part: Primitive,
        then: &Point3<f64>,
        is_followed: bool,
        stars: Option<&Stars>,
    ) -> Option<Feature> {
        match part {
            Primitive::Vertex(vertex) if is_followed => self.vertex(vertex).map(|_| Feature::Vertex(vertex)),
            // An edge is told by its first vertex: the place next to that one.
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
            // Of what moves by its vertices, the nearest one is told.
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

/// The nearest place to a vertex so far: its squared distance \[m²\], triangle and weights.
#[derive(Clone, Copy)]
struct Nearest {
    far: f64,
    candidate: u32,
    weights: [f64; 3],
    on_face: Point3<f64>,
    normal: Vector3<f64>,
}

/// Two places that press or nearly do.
#[derive(Clone, Copy)]
pub(crate) struct ContactPair {
    /// On the body and on the other.
    pub places: [Place; 2],
    pub normal_in_world: Vector3<f64>,
    pub depth: f64,
}

impl PersistentContact {
    /// A contact of a list, seen from the body on one side of it, `shapes` that body and the other one; `None` of what is
    /// not there.
    pub(crate) fn new(
        row: &Collision,
        side: usize,
        writer: Entity,
        shapes: [&Shape<'_>; 2],
        stars: [Option<&Stars>; 2],
    ) -> Option<Self> {
        let parts =
            if side == 0 { [row.primitive_a, row.primitive_b] } else { [row.primitive_b, row.primitive_a] };
        let is_followed = matches!(
            parts,
            [Primitive::Vertex(_), Primitive::Triangle(_)] | [Primitive::Triangle(_), Primitive::Vertex(_)]
        );
        let points = [row.points_in_world[side], row.points_in_world[1 - side]];
        let towards = if side == 0 { -row.normal_in_world } else { row.normal_in_world };
        let spot = |at: usize| shapes[at].spot(parts[at], &points[at], is_followed, stars[at]);
        let spots = [spot(0)?, spot(1)?];
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

    /// Whether it is of the same vertex as another one, and of the same bodies.
    pub(crate) fn is_of(&self, other: &Self) -> bool {
        let vertex = |of: &Self| match of.spots {
            [Feature::Vertex(vertex), Feature::Triangle(_)] => Some((0, vertex)),
            [Feature::Triangle(_), Feature::Vertex(vertex)] => Some((1, vertex)),
            _ => None,
        };
        self.other == other.other && vertex(self).is_some() && vertex(self) == vertex(other)
    }

    pub(crate) fn is_followed(&self) -> bool {
        self.spots.iter().any(|spot| matches!(spot, Feature::Triangle(_)))
    }

    /// Whether it is to be forgotten.
    pub(crate) fn is_old(&self, now: SimTime) -> bool {
        now.0.saturating_sub(self.seen.0) > AGE_MAX.0
    }

    /// Where it is now; a followed one follows. `None` when it is no longer there.
    pub(crate) fn meet(
        &mut self,
        shapes: [&Shape<'_>; 2],
        stars: [Option<&Stars>; 2],
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
        // In which direction the vertex is pushed.
        let push = if vertex == 0 { self.normal_in_world } else { -self.normal_in_world };
        let own = *shapes[face].triangles.get(triangle as usize)?;
        let about = own.iter().flat_map(|&node| stars[face].map_or(&[][..], |stars| stars.about(node)));
        let mut nearest: Option<Nearest> = None;
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
                nearest =
                    Some(Nearest { far, candidate, weights: found.weights, on_face: found.point, normal });
            }
        }
        let Nearest { candidate, weights, on_face, normal, .. } = nearest?;
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
                Some(Place { nodes: [0; 3], weights: [0.0; 3], at_in_world, carried })
            }
            Feature::Triangle(_) => None,
        };
        let places = [place(0)?, place(1)?];
        let normal = self.normal_in_world;
        let depth = (places[1].at_in_world - places[0].at_in_world).dot(&normal);
        Some(ContactPair { places, normal_in_world: normal, depth })
    }
}

/// Who is about the vertices of each surface: what does not change from tick to tick is found once.
#[derive(Default)]
pub(crate) struct Surroundings(BTreeMap<Entity, Surrounded>);

struct Surrounded {
    triangles: Arc<Vec<[u32; 3]>>,
    stars: Stars,
}

impl Surroundings {
    pub fn look(&mut self, entity: Entity, triangles: &Arc<Vec<[u32; 3]>>) {
        let known = self.0.get(&entity).is_some_and(|known| Arc::ptr_eq(&known.triangles, triangles));
        if !known {
            let stars = Stars::new(0, (0..).zip(triangles.iter().copied()));
            self.0.insert(entity, Surrounded { triangles: triangles.clone(), stars });
        }
    }

    pub fn of(&self, entity: Entity) -> Option<&Stars> {
        self.0.get(&entity).map(|known| &known.stars)
    }
}

/// The rows of all lists that say something of bodies without instruments, which every body meets by itself, with who
/// found them; not what `me`, or what answers contacts, has told.
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
