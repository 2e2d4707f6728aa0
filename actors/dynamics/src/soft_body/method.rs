//! What a method of soft bodies is: how it is built from the scene, what it is given in a step, and what it tells.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{Access, Commands, Component, Entity, Snapshot, Tick};

use super::Deformable;
use super::instrument_rods::Rod;
use super::rod_contact::{Skin, Touch};
use crate::picking::DrivenVertex;

/// What meets a body in one tick; everything in the frame of the body.
#[derive(Clone, Copy)]
pub struct StepContext<'a> {
    /// The scene that the tick reads.
    pub scene: &'a Snapshot,
    /// The tick.
    pub tick: &'a Tick<'a>,
    /// Where the body is.
    pub world_from_body: &'a Isometry3<f64>,
    /// Gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// The rods of all instruments.
    pub rods: &'a [Rod],
    /// Where rods touch the body and push it.
    pub touches: &'a [Touch],
    /// Forces on vertices that others have given the body \[N\].
    pub forces: &'a [(u32, Vector3<f64>)],
    /// Vertices that jaws hold, and where they have them at the end of the tick; ascending, none that is anchored.
    pub led: &'a [DrivenVertex],
}

impl StepContext<'_> {
    /// How long the step is \[s\].
    #[must_use]
    pub fn period_secs(&self) -> f64 {
        self.tick.period.as_secs_f64()
    }
}

/// What a change of shape did to the triangles of a body. Those that are new have the highest numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reshaped {
    /// The new number of each old triangle, where it is still there; `None` when all have the numbers they had.
    pub kept: Option<Vec<Option<u32>>>,
    /// For each new triangle the one that it is a part of.
    pub parents: Vec<u32>,
}

/// A method that moves the vertices of bodies.
pub trait SoftMethod: Send + Sized + 'static {
    /// The component by which a scene says that a body is moved by it.
    type Kind: Component + Clone;
    /// The kind of its controller, for messages.
    const CONTROLLER: &'static str;

    /// The solver of one body, where the scene says that the body is.
    ///
    /// # Errors
    /// What is wrong with the body.
    fn build(kind: &Self::Kind, body: &mut Deformable, scene: &Snapshot) -> Result<Self, String>;

    /// What it reads and writes besides what every soft body does.
    fn access(access: Access, _bodies: &[Entity]) -> Access {
        access
    }

    /// Vertices now \[m\].
    fn positions(&self) -> &[Point3<f64>];
    /// And how they move \[m/s\].
    fn velocities(&self) -> &[Vector3<f64>];
    /// What of it may be touched.
    fn skin<'a>(&'a self, body: &'a Deformable) -> Skin<'a>;

    /// How it answers contacts that detectors find; one without terms does not.
    fn terms(&self) -> Option<ContactParams<'_>> {
        None
    }

    /// Whether blades cut it; then they do not push it.
    fn is_cut_by_blades(&self) -> bool {
        false
    }

    /// Changes of its shape before anything touches it: cuts, elements that others have removed. `touches` and `led` of the
    /// site are empty. Brings `body` up to date and tells the scene of its new meshes.
    ///
    /// # Errors
    /// Why it cannot go on.
    fn reshape(
        &mut self,
        _body: &mut Deformable,
        _site: &StepContext<'_>,
        _out: &mut Commands,
    ) -> Result<Option<Reshaped>, String> {
        Ok(None)
    }

    /// One step. Fills `forces` with what each touch exerts on the body \[N\].
    ///
    /// # Errors
    /// Why it cannot go on; the body is where it was.
    fn step(
        &mut self,
        body: &Deformable,
        site: &StepContext<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String>;

    /// One step of all bodies that can make one; each says whether it did. Those that belong together are stepped together.
    fn step_all(steps: &mut [Step<'_, Self>]) {
        for step in steps {
            step.done = step.method.step(step.body, &step.site, &mut step.forces);
        }
    }

    /// What is to be expected of the next step, after one; `active` are the vertices that others give something or
    /// soon will.
    fn look_ahead(
        &mut self,
        _body: &Deformable,
        _site: &StepContext<'_>,
        _active: &[u32],
        _outlook: &mut Outlook,
    ) {
    }

    /// What the body exerts now on whoever holds these vertices \[N\]; ascending.
    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64>;

    /// What a later life needs besides positions and velocities.
    fn publish(&mut self, _body: &Deformable, _site: &StepContext<'_>, _out: &mut Commands) {}

    /// What is worth knowing of it.
    fn measure(&self, body: &Deformable, measures: &mut Measures<'_>);
}

/// Where a method puts its measures: `NAME.what`.
pub struct Measures<'a> {
    name: &'a str,
    values: &'a mut BTreeMap<String, f64>,
}

impl<'a> Measures<'a> {
    /// Measures of the body of that name go here.
    pub fn new(name: &'a str, values: &'a mut BTreeMap<String, f64>) -> Self {
        Self { name, values }
    }

    /// Tells one; the unit is the end of its name. What is not a number is no measure.
    pub fn put(&mut self, what: &str, value: f64) {
        if !value.is_finite() {
            return;
        }
        self.values.insert(format!("{}.{what}", self.name), value);
    }
}

/// A body that is about to be stepped.
pub struct Step<'a, M> {
    /// Who steps it.
    pub method: &'a mut M,
    /// The body.
    pub body: &'a Deformable,
    /// What meets it.
    pub site: StepContext<'a>,
    /// What each touch exerts on it \[N\], to be filled.
    pub forces: Vec<Vector3<f64>>,
    /// Whether it was stepped, or why not; then it is where it was.
    pub done: Result<(), String>,
}

/// How a body answers.
#[derive(Clone, Copy, Debug)]
pub struct ContactParams<'a> {
    /// One over the mass of each vertex, 0 where it is held \[1/kg\].
    pub masses_inverse: &'a [f64],
    /// Force per depth of each contact \[N/m\].
    pub stiffness: f64,
    /// Coulomb's coefficient.
    pub friction: f64,
}

/// What is to be expected of the next step of a body.
#[derive(Clone, Debug, Default)]
pub struct Outlook {
    /// How all vertices would move after one more step like the last \[m/s\].
    pub expected: Vec<Vector3<f64>>,
    /// How readily those that were asked for follow impulses that all of them are given alike \[1/kg\].
    pub yielding: Vec<f64>,
    /// Masses of all vertices \[kg\].
    pub masses: Vec<f64>,
}

/// Whether places and speeds are numbers; names the first vertex of which they are not.
pub fn finite_vertices(positions: &[Point3<f64>], velocities: &[Vector3<f64>]) -> Result<(), String> {
    let place = positions.iter().position(|place| !place.iter().all(|x| x.is_finite()));
    let speed = || velocities.iter().position(|speed| !speed.iter().all(|x| x.is_finite()));
    match place.or_else(speed) {
        Some(vertex) => Err(format!("vertex {vertex} came to a place or a speed that is no finite number")),
        None => Ok(()),
    }
}
