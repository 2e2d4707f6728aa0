//! Interface of a soft-body method: its construction from the scene, the input of a step, and its results.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{Access, Commands, Component, Entity, Snapshot, Tick};

use super::Deformable;
use super::bearing::rigid_response::RigidPresses;
use super::instrument_limits::InstrumentLimit;
use super::instrument_rods::Rod;
use super::jaw_friction::{GripForce, JawFriction};
use super::rod_contact::{ContactSurface, RodContact};
use crate::picking::DrivenVertex;

/// Input of a body's step; everything in the body's frame.
#[derive(Clone, Copy)]
pub struct StepContext<'a> {
    /// The scene that the tick reads.
    pub scene: &'a Snapshot,
    /// The tick.
    pub tick: &'a Tick<'a>,
    /// Length of the step \[s\]: the tick's period, or an equal part of it.
    pub step_secs: f64,
    /// Pose of the body.
    pub world_from_body: &'a Isometry3<f64>,
    /// Gravity \[m/s²\].
    pub gravity: Vector3<f64>,
    /// The rods of all instruments.
    pub rods: &'a [Rod],
    /// Contacts of rods with the body.
    pub touches: &'a [RodContact],
    /// Contacts with rigid bodies that move.
    pub rigid: RigidPresses<'a>,
    /// Whether instruments that it holds back touch it, or may within the tick.
    pub meets_instruments: bool,
    /// External forces on vertices \[N\].
    pub forces: &'a [(u32, Vector3<f64>)],
    /// Vertices held by jaws, with their prescribed positions at the end of the tick; ascending, without anchored ones.
    pub driven: &'a [DrivenVertex],
    /// The largest force of each grip on the body \[N\], by the number of its pick; infinite for one that is not watched.
    pub grip_limits: &'a [f64],
}

impl StepContext<'_> {
    /// Length of the step \[s\].
    #[must_use]
    pub fn period_secs(&self) -> f64 {
        self.step_secs
    }

    /// The friction of the jaws; fills `grips` with the grip of each driven vertex.
    pub fn jaw_friction<'b>(&'b self, grips: &'b mut Vec<u32>) -> JawFriction<'b> {
        grips.clear();
        grips.extend(self.driven.iter().map(|driven| driven.grip));
        JawFriction { grips, limits: self.grip_limits }
    }
}

/// Effect of a topology change on a body's triangles. New triangles have the highest numbers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SurfaceChange {
    /// New number of each old triangle, or `None` if it was removed; the list is absent when all keep their numbers.
    pub kept: Option<Vec<Option<u32>>>,
    /// The parent of each new triangle.
    pub parents: Vec<u32>,
}

/// A method that moves the vertices of bodies.
pub trait SoftMethod: Send + Sized + 'static {
    /// The component by which a scene assigns a body to this method.
    type Kind: Component + Clone;
    /// The kind of its controller, for messages.
    const CONTROLLER: &'static str;

    /// Builds the solver of one body, at its state in the scene.
    ///
    /// # Errors
    /// What is wrong with the body.
    fn build(kind: &Self::Kind, body: &mut Deformable, scene: &Snapshot) -> Result<Self, String>;

    /// Whether the body can take steps of this length at all \[s\], as it is now and without contacts.
    ///
    /// # Errors
    /// Why it cannot, and what helps.
    fn check_step(&self, _step_secs: f64) -> Result<(), String> {
        Ok(())
    }

    /// Reads and writes in addition to those of every soft body.
    fn access(access: Access, _bodies: &[Entity]) -> Access {
        access
    }

    /// Vertex positions \[m\].
    fn positions(&self) -> &[Point3<f64>];
    /// Vertex velocities \[m/s\].
    fn velocities(&self) -> &[Vector3<f64>];
    /// Its collision geometry.
    fn contact_surface<'a>(&'a self, body: &'a Deformable) -> ContactSurface<'a>;

    /// Parameters for contacts that detectors find; `None`: it does not answer them.
    fn terms(&self) -> Option<ContactParams<'_>> {
        None
    }

    /// Up to what it stops instruments that hands lead, in ticks of this period \[s\].
    fn instrument_limit(&self, _period: f64) -> InstrumentLimit {
        InstrumentLimit::NONE
    }

    /// Whether blades cut it; then they do not push it.
    fn is_cut_by_blades(&self) -> bool {
        false
    }

    /// Topology changes at the beginning of the tick: cuts, elements that other controllers have removed. `touches` and
    /// `driven` of `site` are empty. Updates `body` and writes its new meshes to the scene.
    ///
    /// # Errors
    /// Why the body cannot continue.
    fn reshape(
        &mut self,
        _body: &mut Deformable,
        _site: &StepContext<'_>,
        _out: &mut Commands,
    ) -> Result<Option<SurfaceChange>, String> {
        Ok(None)
    }

    /// One step. Fills `forces` with the force on the body of each rod contact, then of each contact with a rigid body
    /// \[N\].
    ///
    /// # Errors
    /// Why it cannot continue; the body keeps its previous state.
    fn step(
        &mut self,
        body: &Deformable,
        site: &StepContext<'_>,
        forces: &mut Vec<Vector3<f64>>,
    ) -> Result<(), String>;

    /// One step of all bodies that can be stepped; each stores its result. Coupled bodies are stepped together.
    fn step_all(steps: &mut [Step<'_, Self>]) {
        for step in steps {
            step.done = step.method.step(step.body, &step.site, &mut step.forces);
        }
    }

    /// Prediction for the next step, after a step; `active` are the vertices with present or imminent external forces.
    fn look_ahead(
        &mut self,
        _body: &Deformable,
        _site: &StepContext<'_>,
        _active: &[u32],
        _outlook: &mut StepPrediction,
    ) {
    }

    /// What the jaws of each watched grip did in the last step, by the number of its pick; those that are not watched
    /// may be missing or zero. A method without it holds whatever the force.
    fn grip_forces(&self) -> &[GripForce] {
        &[]
    }

    /// The force of the body on the jaws that hold these vertices \[N\]; ascending.
    fn pull_by(&mut self, held: &[u32]) -> Vector3<f64>;

    /// State that a restart needs in addition to positions and velocities.
    fn publish(&mut self, _body: &Deformable, _site: &StepContext<'_>, _out: &mut Commands) {}

    /// Measures of the body.
    fn measure(&self, body: &Deformable, measures: &mut Measures<'_>);
}

/// Where a method records its measures: `NAME.what`.
pub struct Measures<'a> {
    name: &'a str,
    values: &'a mut BTreeMap<String, f64>,
}

impl<'a> Measures<'a> {
    /// Measures of the body of that name.
    pub fn new(name: &'a str, values: &'a mut BTreeMap<String, f64>) -> Self {
        Self { name, values }
    }

    /// Records a measure; the unit is the suffix of its name. Non-finite values are dropped.
    pub fn put(&mut self, what: &str, value: f64) {
        if !value.is_finite() {
            return;
        }
        self.values.insert(format!("{}.{what}", self.name), value);
    }
}

/// A body to be stepped.
pub struct Step<'a, M> {
    /// Its method.
    pub method: &'a mut M,
    /// The body.
    pub body: &'a Deformable,
    /// Its input.
    pub site: StepContext<'a>,
    /// Force on it of each rod contact, then of each contact with a rigid body \[N\], to be filled.
    pub forces: Vec<Vector3<f64>>,
    /// Whether it was stepped, or the reason; then it keeps its previous state.
    pub done: Result<(), String>,
}

/// Contact parameters of a body.
#[derive(Clone, Copy, Debug)]
pub struct ContactParams<'a> {
    /// Inverse mass of each vertex, 0 where it is fixed \[1/kg\].
    pub masses_inverse: &'a [f64],
    /// Stiffness of each contact: force per depth \[N/m\].
    pub stiffness: f64,
    /// The same of each contact with a rigid body that moves: well above that of the body itself between neighbouring
    /// vertices, so that what lies on it does not sink in \[N/m\].
    pub bearing_stiffness: f64,
    /// Young's modulus of a volume \[Pa\]; 0 of others.
    pub young_modulus: f64,
    /// Coulomb friction coefficient.
    pub friction: f64,
}

/// How much stiffer a contact with a rigid body is than the tissue between two neighbouring vertices. With a handful of
/// contacts the body sinks in by a few hundredths of the tissue's own depth.
const STIFFER: f64 = 10.0;

/// Stiffness of each contact of a volume with a rigid body that moves \[N/m\]: at least this contact stiffness, and
/// well above that of tissue of this Young's modulus \[Pa\] over the mean edge of its surface.
#[must_use]
pub fn bearing_stiffness(contact_stiffness: f64, young_modulus: f64, body: &Deformable) -> f64 {
    contact_stiffness.max(STIFFER * young_modulus * mean_edge(body))
}

/// Longest substep under a rigid body, over the time that a wave takes across an edge, of methods that divide a step: in
/// longer ones their constraints are so far from converged that the body is many times too soft, and heavy rigid bodies
/// fall through.
const CONVERGED: f64 = 0.7;

/// Longest substep \[s\] in which a method that divides its steps bears rigid bodies, for the square of the speed at which
/// waves of strain travel in the body \[m²/s²\]; infinite for a body without a surface.
#[must_use]
pub fn bearing_substep(speed_squared: f64, body: &Deformable) -> f64 {
    let edge = mean_edge(body);
    if edge > 0.0 { CONVERGED * edge / speed_squared.sqrt() } else { f64::INFINITY }
}

/// Square of the speed of pressure waves in a solid \[m²/s²\], by Young's modulus \[Pa\], Poisson's ratio and density
/// \[kg/m³\].
#[must_use]
pub fn pressure_wave_squared(young_modulus: f64, poisson_ratio: f64, density: f64) -> f64 {
    let nu = poisson_ratio;
    young_modulus * (1.0 - nu) / ((1.0 + nu) * (1.0 - 2.0 * nu) * density)
}

/// Mean edge of a body's surface at rest \[m\]; 0 without triangles.
#[must_use]
fn mean_edge(body: &Deformable) -> f64 {
    let edges = body.triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let lengths = edges.map(|[a, b]| (body.rest[a as usize] - body.rest[b as usize]).norm());
    let (sum, count) = lengths.fold((0.0, 0.0), |(sum, count), length| (sum + length, count + 1.0));
    if count == 0.0 { 0.0 } else { sum / count }
}

/// Prediction of a body's next step.
#[derive(Clone, Debug, Default)]
pub struct StepPrediction {
    /// Velocities of all vertices after one more step like the last \[m/s\].
    pub expected: Vec<Vector3<f64>>,
    /// Mobility of the requested vertices under equal impulses on all of them \[1/kg\].
    pub yielding: Vec<f64>,
    /// Masses of all vertices \[kg\].
    pub masses: Vec<f64>,
}

/// Checks that positions and velocities are finite; the error names the first vertex that is not.
pub fn finite_vertices(positions: &[Point3<f64>], velocities: &[Vector3<f64>]) -> Result<(), String> {
    let place = positions.iter().position(|place| !place.iter().all(|x| x.is_finite()));
    let speed = || velocities.iter().position(|speed| !speed.iter().all(|x| x.is_finite()));
    match place.or_else(speed) {
        Some(vertex) => Err(format!("vertex {vertex} came to a place or a speed that is no finite number")),
        None => Ok(()),
    }
}
