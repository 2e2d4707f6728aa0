//! Obstacles of a thread: the rods of instruments, and rigid bodies by their shapes. Their order in the list is fixed
//! for the same scene, and during a tick each moves from its last pose to its current one.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3, Translation3, Vector3};
use trocar_dynamics::soft_body::bearing::BorneBody;
use trocar_dynamics::soft_body::instrument_rods::{Rod, rods_of_all};
use trocar_dynamics::soft_body::jaws::opening;
use trocar_scene::shapes::{Detail, instrument_from_hinge, surface_of};
use trocar_scene::{
    Entity, Instrument, RigidBody, Shape as SceneShape, Snapshot, SurfaceMesh, VertexPositions,
};

use super::led_instruments::LedInstruments;
use super::saved_state::ObstaclePose;
use crate::suture_thread::{ContactMemory, Obstacle, ObstacleMobility, Shape};

/// A frame's pose at the last tick, and now.
pub type FrameFromTo = [Isometry3<f64>; 2];
/// Indices of an instrument's jaws in the list; `None` for a missing jaw.
pub type JawParts = [Option<usize>; 2];

/// Nodes and triangles of a deformable obstacle.
pub type DeformableMesh<'a> = (&'a [Point3<f64>], &'a [[u32; 3]]);

/// Apparent contact stiffness of a body with a thread \[N/m\].
const BODY_STIFFNESS: f64 = 1000.0;
/// Resolution of triangle meshes for shapes that the thread solver does not support.
const DETAIL: Detail = Detail { segments: 24, fine_segments: 8 };

/// A shape in the frame of its part.
#[derive(Clone, Debug)]
pub enum PartShape {
    /// A sphere at the origin.
    Sphere(f64),
    /// A capsule around a segment.
    Capsule([Point3<f64>; 2], f64),
    /// A rigid surface.
    Mesh(Arc<Vec<Point3<f64>>>, Arc<Vec<[u32; 3]>>),
    /// The deformable body that the thread is tied around, or lies on.
    Elastic,
}

/// A part of an obstacle.
#[derive(Clone, Debug)]
pub struct Part {
    /// Its entity, its part number, and its pose at the last tick; of an instrument, where its hand led it.
    pub met: ObstaclePose,
    /// `thread_from_part` now, likewise.
    pub to: Isometry3<f64>,
    /// Of an instrument: how far it is from there \[m\], and the stiffness of the coupling to its hand \[N/m\].
    pub displaced: Vector3<f64>,
    /// See above; of a body, of the same order.
    pub stiffness: f64,
    /// Its shape.
    pub form: PartShape,
    /// Coulomb friction coefficient.
    pub friction: f64,
    /// Of an instrument's rod: its current axis in the thread's frame, and its radius \[m\].
    pub rod: Option<Rod>,
    /// Index of the jaw, if it is one.
    pub jaw: Option<usize>,
}

impl Part {
    /// A part of a body.
    fn new(met: ObstaclePose, form: PartShape, friction: f64) -> Self {
        let (displaced, stiffness) = (Vector3::zeros(), BODY_STIFFNESS);
        Self { met, to: met.at, displaced, stiffness, form, friction, rod: None, jaw: None }
    }

    /// Which of these rigid bodies it is.
    #[must_use]
    pub fn borne(&self, bodies: &[BorneBody]) -> Option<usize> {
        let is_rigid = self.rod.is_none() && !matches!(self.form, PartShape::Elastic);
        bodies.iter().position(|body| is_rigid && body.entity == self.met.entity)
    }

    /// In the form that the solver takes, for a step of the tick; a deformable body by its current nodes and triangles.
    #[must_use]
    pub fn obstacle<'a>(
        &'a self,
        fractions: [f64; 2],
        yielding: Option<DeformableMesh<'a>>,
        moving: Option<MovingObstacle>,
    ) -> Obstacle<'a> {
        let shape = match &self.form {
            PartShape::Sphere(radius) => Shape::Sphere { radius: *radius },
            PartShape::Capsule(ends, radius) => Shape::Capsule { ends: *ends, radius: *radius },
            PartShape::Mesh(points, triangles) => {
                Shape::Mesh { from: points, to: points, triangles, radius: 0.0 }
            }
            PartShape::Elastic => {
                let (points, triangles) = yielding.unwrap_or((&[][..], &[][..]));
                let shape = Shape::Mesh { from: points, to: points, triangles, radius: 0.0 };
                // Not interpolated: exactly at its pose.
                return Obstacle::fixed(shape, self.to, self.friction);
            }
        };
        if let Some(MovingObstacle { thread_from_part: [from, to], mobility }) = moving {
            return Obstacle { shape, from, to, friction: self.friction, mobility: Some(mobility) };
        }
        let [from, to] = fractions.map(|fraction| between(&self.met.at, &self.to, fraction));
        Obstacle { shape, from, to, friction: self.friction, mobility: None }
    }
}

/// A rigid body that moves in a step of the thread: its poses at the beginning and, without the thread's forces, at the
/// end, and how it gives way to these.
#[derive(Clone, Copy, Debug)]
pub struct MovingObstacle {
    /// `thread_from_part` at both times.
    pub thread_from_part: [Isometry3<f64>; 2],
    /// Its mobility, in the thread's axes.
    pub mobility: ObstacleMobility,
}

impl MovingObstacle {
    /// A rigid body in a step of `step` seconds.
    #[must_use]
    pub fn of(body: &BorneBody, thread_from_world: &Isometry3<f64>, step: f64) -> Self {
        let (inertia, inertia_inverse) = body.inertia();
        let turn = thread_from_world.rotation.to_rotation_matrix();
        Self {
            thread_from_part: [thread_from_world * body.pose(), thread_from_world * body.pose_ahead(step)],
            mobility: ObstacleMobility {
                mass_inverse: inertia.mass_inverse,
                centre: inertia.centre_in_body,
                inertia_inverse: turn.matrix() * inertia_inverse * turn.matrix().transpose(),
                lever: Some(body.lever(step)),
            },
        }
    }
}

/// Interpolates between two poses.
#[must_use]
pub fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, fraction: f64) -> Isometry3<f64> {
    if fraction >= 1.0 {
        return *to;
    }
    let place = from.translation.vector.lerp(&to.translation.vector, fraction);
    let rotation = from.rotation.try_slerp(&to.rotation, fraction, 1e-12).unwrap_or(to.rotation);
    Isometry3::from_parts(place.into(), rotation)
}

/// Whether both are the same part of the same entity.
fn is_same(met: &ObstaclePose, other: &ObstaclePose) -> bool {
    met.entity == other.entity && met.part == other.part
}

/// All obstacles of a thread.
#[derive(Clone, Debug, Default)]
pub struct ObstacleParts {
    /// In the same order for the same scene; the deformable body comes first.
    pub list: Vec<Part>,
    /// The deformable body, and its Coulomb friction coefficient.
    tied: Option<(Entity, f64)>,
    /// Whether its nodes are in the thread's frame, and not in its own.
    is_in_frame: bool,
    /// Cached forms of analytic shapes.
    forms: BTreeMap<Entity, (SceneShape, PartShape)>,
    rods: Vec<Rod>,
}

impl ObstacleParts {
    /// An empty list, for a thread tied around an entity with this Coulomb friction coefficient, or around none.
    #[must_use]
    pub fn around(tied: Option<(Entity, f64)>) -> Self {
        Self { tied, ..Self::default() }
    }

    /// The same for a thread that lies on a body whose nodes are in the body's own frame.
    #[must_use]
    pub fn on(body: Entity, friction: f64) -> Self {
        Self { tied: Some((body, friction)), is_in_frame: true, ..Self::default() }
    }

    /// Lists all parts in the scene. `known` are those of the last tick, `led` the instruments that give way.
    pub fn read(
        &mut self,
        scene: &Snapshot,
        world_from_thread: &Isometry3<f64>,
        tool_friction: f64,
        known: &[ObstaclePose],
        led: &LedInstruments,
    ) {
        self.list.clear();
        rods_of_all(scene, world_from_thread, &mut self.rods);
        let thread_from_world = world_from_thread.inverse();
        if let Some((entity, friction)) = self.tied {
            let in_frame = self.is_in_frame;
            let to =
                if in_frame { Isometry3::identity() } else { thread_from_world * scene.world_pose(entity) };
            let met = ObstaclePose { entity, part: 0, at: to };
            self.list.push(Part::new(met, PartShape::Elastic, friction));
        }
        let mut count = 0;
        for (index, rod) in self.rods.iter().enumerate() {
            let entity = rod.instrument;
            let again = index > 0 && self.rods[index - 1].instrument == entity;
            count = if again { count + 1 } else { 0 };
            let Some(instrument) = scene.get::<Instrument>(entity) else { continue };
            let [to_led, displaced] = led.shifts(entity);
            let drawn = thread_from_world * scene.world_pose(entity);
            let thread_from_tip = Translation3::from(to_led) * drawn;
            let jaws = if instrument.kind.has_jaws() { usize::from(instrument.jaws.min(2)) } else { 0 };
            let jaw = (1..=jaws).contains(&count).then(|| count - 1);
            let [angle, _] = opening(scene, entity);
            let to = match jaw {
                Some(side) => {
                    thread_from_tip * instrument_from_hinge(instrument.jaw_length, [1.0, -1.0][side], angle)
                }
                None => thread_from_tip,
            };
            let ends = rod.ends.map(|end| to.inverse_transform_point(&(end + to_led)));
            let met = ObstaclePose { entity, part: count as u32, at: to };
            let form = PartShape::Capsule(ends, rod.radius);
            let rod = Rod { ends: rod.ends.map(|end| end + to_led + displaced), ..*rod };
            let part = Part::new(met, form, tool_friction);
            let stiffness = instrument.coupling_stiffness;
            self.list.push(Part { displaced, stiffness, rod: Some(rod), jaw, ..part });
        }
        let mut bodies: Vec<Entity> = scene.iter::<RigidBody>().map(|(entity, _)| entity).collect();
        bodies.sort_unstable();
        for entity in bodies {
            let Some(body) = scene.get::<RigidBody>(entity) else { continue };
            let to = thread_from_world * scene.world_pose(entity);
            if let Some(form) = self.form(scene, entity) {
                let met = ObstaclePose { entity, part: 0, at: to };
                self.list.push(Part::new(met, form, body.friction));
            }
        }
        for part in &mut self.list {
            if let Some(before) = known.iter().find(|met| is_same(met, &part.met)) {
                part.met.at = before.at;
            }
        }
    }

    /// The form of a rigid body; `None` without a shape.
    fn form(&mut self, scene: &Snapshot, entity: Entity) -> Option<PartShape> {
        let Some(shape) = scene.get::<SceneShape>(entity) else {
            let (mesh, points) = (scene.get::<SurfaceMesh>(entity)?, scene.get::<VertexPositions>(entity)?);
            return Some(PartShape::Mesh(points.positions.clone(), mesh.triangles.clone()));
        };
        if let Some((_, form)) = self.forms.get(&entity).filter(|(known, _)| known == shape) {
            return Some(form.clone());
        }
        let along_z = |half: f64| [Point3::new(0.0, 0.0, -half), Point3::new(0.0, 0.0, half)];
        let form = match shape {
            SceneShape::Sphere { radius } => PartShape::Sphere(*radius),
            SceneShape::Capsule { radius, half_height } => PartShape::Capsule(along_z(*half_height), *radius),
            other => {
                let surface = surface_of(other, &DETAIL).ok()?;
                PartShape::Mesh(Arc::new(surface.positions), Arc::new(surface.triangles))
            }
        };
        self.forms.insert(entity, (shape.clone(), form.clone()));
        Some(form)
    }

    /// Whether the parts are those of the last tick.
    #[must_use]
    pub fn are(&self, known: &[ObstaclePose]) -> bool {
        known.len() == self.list.len()
            && known.iter().zip(&self.list).all(|(met, part)| is_same(met, &part.met))
    }

    /// Renumbers contacts from the last tick's parts to the current ones, and drops those with removed parts. Indices
    /// beyond all parts stay so.
    pub fn renumber(&self, known: &[ObstaclePose], contacts: &mut Vec<ContactMemory>) {
        contacts.retain_mut(|contact| {
            let Some(index) = (contact.key.with as usize).checked_sub(1) else { return true };
            let now = match known.get(index) {
                Some(met) => self.list.iter().position(|part| is_same(met, &part.met)),
                None => Some(index - known.len() + self.list.len()),
            };
            contact.key.with = now.map_or(0, |now| 1 + now as u32);
            now.is_some()
        });
        contacts.sort_unstable_by_key(|contact| contact.key);
    }

    /// Sets how far an instrument is from where its hand leads it \[m\].
    pub fn displace(&mut self, instrument: Entity, by: &Vector3<f64>) {
        let own = |part: &&mut Part| part.met.entity == instrument && part.rod.is_some();
        self.list.iter_mut().filter(own).for_each(|part| part.displaced = *by);
    }

    /// The parts of an instrument where it is: its tip's frame at the last tick and now, and the indices of its jaws in the list.
    #[must_use]
    pub fn instrument(&self, entity: Entity) -> Option<(FrameFromTo, JawParts)> {
        let of = |want: &dyn Fn(&Part) -> bool| {
            self.list.iter().position(|part| part.met.entity == entity && part.rod.is_some() && want(part))
        };
        let shaft = &self.list[of(&|part| part.jaw.is_none())?];
        let at = [shaft.met.at, shaft.to].map(|pose| Translation3::from(shaft.displaced) * pose);
        Some((at, [0, 1].map(|side| of(&|part| part.jaw == Some(side)))))
    }
}
