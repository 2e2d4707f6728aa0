//! What of a scene a thread can touch: the rods of instruments, rigid bodies by their shapes. Each keeps its place in the
//! list as long as the scene has the same ones, and goes in a tick from where it was at the last one to where it is.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Isometry3, Point3};
use trocar_dynamics::soft_body::instrument_rods::{Rod, rods_of_all};
use trocar_dynamics::soft_body::jaws::opening;
use trocar_scene::shapes::{Detail, instrument_from_hinge, surface_of};
use trocar_scene::{
    Entity, Instrument, RigidBody, Shape as SceneShape, Snapshot, SurfaceMesh, VertexPositions,
};

use super::saved_state::Met;
use crate::suture_thread::{ContactMemory, Obstacle, Shape};

/// Where a frame was at the last tick, and where it is.
pub type FrameFromTo = [Isometry3<f64>; 2];
/// Which parts of the list the jaws of an instrument are; none that it has not.
pub type JawParts = [Option<usize>; 2];

/// Nodes and triangles of what gives way.
pub type Yielding<'a> = (&'a [Point3<f64>], &'a [[u32; 3]]);

/// How finely shapes that are none of the thread's own are made of triangles.
const DETAIL: Detail = Detail { segments: 24, fine_segments: 8 };

/// A shape in the frame of its part.
#[derive(Clone, Debug)]
pub enum Form {
    /// A ball about the origin.
    Sphere(f64),
    /// About a segment.
    Capsule([Point3<f64>; 2], f64),
    /// A surface that keeps its form.
    Mesh(Arc<Vec<Point3<f64>>>, Arc<Vec<[u32; 3]>>),
    /// The body that gives way: which the thread is tied around, or lies on.
    Elastic,
}

/// A part of something that a thread can touch.
#[derive(Clone, Debug)]
pub struct Part {
    /// Whose, which part of it, and where it was at the last tick.
    pub met: Met,
    /// `thread_from_part` now.
    pub to: Isometry3<f64>,
    /// What it looks like.
    pub form: Form,
    /// Coulomb's coefficient.
    pub friction: f64,
    /// For an instrument's rods: its axis in the thread's frame now, and its radius \[m\].
    pub rod: Option<Rod>,
    /// Whether it is one of two jaws, and which.
    pub jaw: Option<usize>,
}

impl Part {
    /// As the solver wants it, for a part of the tick; the body that gives way by its nodes and triangles as they are now.
    #[must_use]
    pub fn obstacle<'a>(&'a self, fractions: [f64; 2], yielding: Option<Yielding<'a>>) -> Obstacle<'a> {
        let shape = match &self.form {
            Form::Sphere(radius) => Shape::Sphere { radius: *radius },
            Form::Capsule(ends, radius) => Shape::Capsule { ends: *ends, radius: *radius },
            Form::Mesh(points, triangles) => Shape::Mesh { from: points, to: points, triangles, radius: 0.0 },
            Form::Elastic => {
                let (points, triangles) = yielding.unwrap_or((&[][..], &[][..]));
                let shape = Shape::Mesh { from: points, to: points, triangles, radius: 0.0 };
                // In its place to the bit.
                return Obstacle::fixed(shape, self.to, self.friction);
            }
        };
        let [from, to] = fractions.map(|fraction| between(&self.met.at, &self.to, fraction));
        Obstacle { shape, from, to, friction: self.friction }
    }
}

/// Part of the way between two poses.
#[must_use]
pub fn between(from: &Isometry3<f64>, to: &Isometry3<f64>, fraction: f64) -> Isometry3<f64> {
    if fraction >= 1.0 {
        return *to;
    }
    let place = from.translation.vector.lerp(&to.translation.vector, fraction);
    let rotation = from.rotation.try_slerp(&to.rotation, fraction, 1e-12).unwrap_or(to.rotation);
    Isometry3::from_parts(place.into(), rotation)
}

/// Whether they are the same part of the same entity.
fn is_same(met: &Met, other: &Met) -> bool {
    met.entity == other.entity && met.part == other.part
}

/// Everything that a thread can touch.
#[derive(Clone, Debug, Default)]
pub struct Parts {
    /// In the same order for the same scene; the elastic body is the first.
    pub list: Vec<Part>,
    /// What gives way, and Coulomb's coefficient on it.
    tied: Option<(Entity, f64)>,
    /// Whether its nodes are in the frame of the thread, and not in its own.
    is_in_frame: bool,
    /// What analytic shapes look like, as long as they are the same.
    forms: BTreeMap<Entity, (SceneShape, Form)>,
    rods: Vec<Rod>,
}

impl Parts {
    /// None yet, of a thread that is tied around an entity, with Coulomb's coefficient on it, or around none.
    #[must_use]
    pub fn around(tied: Option<(Entity, f64)>) -> Self {
        Self { tied, ..Self::default() }
    }

    /// The same of one that lies on a body whose nodes are in its own frame.
    #[must_use]
    pub fn on(body: Entity, friction: f64) -> Self {
        Self { tied: Some((body, friction)), is_in_frame: true, ..Self::default() }
    }

    /// Lists all parts as the scene has them. `known` are those of the last tick.
    pub fn read(
        &mut self,
        scene: &Snapshot,
        world_from_thread: &Isometry3<f64>,
        tool_friction: f64,
        known: &[Met],
    ) {
        self.list.clear();
        rods_of_all(scene, world_from_thread, &mut self.rods);
        let thread_from_world = world_from_thread.inverse();
        if let Some((entity, friction)) = self.tied {
            let in_frame = self.is_in_frame;
            let to =
                if in_frame { Isometry3::identity() } else { thread_from_world * scene.world_pose(entity) };
            let met = Met { entity, part: 0, at: to };
            self.list.push(Part { met, to, form: Form::Elastic, friction, rod: None, jaw: None });
        }
        let mut count = 0;
        for (index, rod) in self.rods.iter().enumerate() {
            let entity = rod.instrument;
            let again = index > 0 && self.rods[index - 1].instrument == entity;
            count = if again { count + 1 } else { 0 };
            let Some(instrument) = scene.get::<Instrument>(entity) else { continue };
            let thread_from_tip = thread_from_world * scene.world_pose(entity);
            let jaws = if instrument.kind.has_jaws() { usize::from(instrument.jaws.min(2)) } else { 0 };
            let jaw = (1..=jaws).contains(&count).then(|| count - 1);
            let [angle, _] = opening(scene, entity);
            let to = match jaw {
                Some(side) => {
                    thread_from_tip * instrument_from_hinge(instrument.jaw_length, [1.0, -1.0][side], angle)
                }
                None => thread_from_tip,
            };
            let ends = rod.ends.map(|end| to.inverse_transform_point(&end));
            let met = Met { entity, part: count as u32, at: to };
            let form = Form::Capsule(ends, rod.radius);
            self.list.push(Part { met, to, form, friction: tool_friction, rod: Some(*rod), jaw });
        }
        let mut bodies: Vec<Entity> = scene.iter::<RigidBody>().map(|(entity, _)| entity).collect();
        bodies.sort_unstable();
        for entity in bodies {
            let Some(body) = scene.get::<RigidBody>(entity) else { continue };
            let to = thread_from_world * scene.world_pose(entity);
            if let Some(form) = self.form(scene, entity) {
                let met = Met { entity, part: 0, at: to };
                self.list.push(Part { met, to, form, friction: body.friction, rod: None, jaw: None });
            }
        }
        for part in &mut self.list {
            if let Some(before) = known.iter().find(|met| is_same(met, &part.met)) {
                part.met.at = before.at;
            }
        }
    }

    /// What a rigid body looks like; nothing of one that has no shape.
    fn form(&mut self, scene: &Snapshot, entity: Entity) -> Option<Form> {
        let Some(shape) = scene.get::<SceneShape>(entity) else {
            let (mesh, points) = (scene.get::<SurfaceMesh>(entity)?, scene.get::<VertexPositions>(entity)?);
            return Some(Form::Mesh(points.positions.clone(), mesh.triangles.clone()));
        };
        if let Some((_, form)) = self.forms.get(&entity).filter(|(known, _)| known == shape) {
            return Some(form.clone());
        }
        let along_z = |half: f64| [Point3::new(0.0, 0.0, -half), Point3::new(0.0, 0.0, half)];
        let form = match shape {
            SceneShape::Sphere { radius } => Form::Sphere(*radius),
            SceneShape::Capsule { radius, half_height } => Form::Capsule(along_z(*half_height), *radius),
            other => {
                let surface = surface_of(other, &DETAIL).ok()?;
                Form::Mesh(Arc::new(surface.positions), Arc::new(surface.triangles))
            }
        };
        self.forms.insert(entity, (shape.clone(), form.clone()));
        Some(form)
    }

    /// Whether they are those of the last tick.
    #[must_use]
    pub fn are(&self, known: &[Met]) -> bool {
        known.len() == self.list.len()
            && known.iter().zip(&self.list).all(|(met, part)| is_same(met, &part.met))
    }

    /// Numbers contacts with those of the last tick as these are, and drops those with what is gone. What comes after all
    /// parts still does.
    pub fn renumber(&self, known: &[Met], contacts: &mut Vec<ContactMemory>) {
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

    /// The parts of an instrument: where its tip's frame was and is, and the places of its jaws in the list.
    #[must_use]
    pub fn instrument(&self, entity: Entity) -> Option<(FrameFromTo, JawParts)> {
        let of = |want: &dyn Fn(&Part) -> bool| {
            self.list.iter().position(|part| part.met.entity == entity && part.rod.is_some() && want(part))
        };
        let shaft = &self.list[of(&|part| part.jaw.is_none())?];
        Some(([shaft.met.at, shaft.to], [0, 1].map(|side| of(&|part| part.jaw == Some(side)))))
    }
}
