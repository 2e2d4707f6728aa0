//! What a scene says of a needle with its thread, and of tissue that is sewn; and what they need to go on.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::POISSON_MAX;
use trocar_scene::components::Parameter;
use trocar_scene::{Component, ComponentError, Entity};

use crate::controller::cutting::scissors::Blades;
use crate::controller::suture_thread::component::{Suture, ThreadBody};
use crate::controller::suture_thread::grasp::Grip;
use crate::controller::suture_thread::saved_state::Met;
use crate::suture::needle::NeedleShape;
use crate::suture::{Resistance, SutureState};
use crate::suture_thread::ThreadMaterial;
use crate::suture_thread::bishop_frame::perpendicular;

/// Tissue that a needle goes through: it needs a mesh of tetrahedra, and `anchors` where it is held. See [`Resistance`] for
/// what the numbers are of.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SewnTissue {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio, 0 to 0.45.
    pub poisson_ratio: f64,
    /// At which the surface gives to the tip from outside \[N\].
    pub puncture_force: f64,
    /// And from inside \[N\].
    pub exit_force: f64,
    /// Of the tip on its way \[N\].
    pub cutting_force: f64,
    /// Friction along the needle per length \[N/m\].
    pub needle_grip: f64,
    /// And along the thread \[N/m\].
    pub thread_grip: f64,
    /// Coulomb's coefficient of the needle.
    pub needle_friction: f64,
    /// And of the thread.
    pub thread_friction: f64,
}

impl Default for SewnTissue {
    /// As [`Resistance::default`]; Young's modulus between that of organs (2 to 20 kPa) and of skin (0.1 to 1 MPa).
    fn default() -> Self {
        let known = Resistance::default();
        Self {
            young_modulus: 6e4,
            poisson_ratio: 0.4,
            puncture_force: known.puncture_force,
            exit_force: known.exit_force,
            cutting_force: known.cutting_force,
            needle_grip: known.needle_grip,
            thread_grip: known.thread_grip,
            needle_friction: known.needle_friction,
            thread_friction: known.thread_friction,
        }
    }
}

impl SewnTissue {
    /// As the solver wants it.
    #[must_use]
    pub fn resistance(&self) -> Resistance {
        Resistance {
            puncture_force: self.puncture_force,
            exit_force: self.exit_force,
            cutting_force: self.cutting_force,
            needle_grip: self.needle_grip,
            thread_grip: self.thread_grip,
            needle_friction: self.needle_friction,
            thread_friction: self.thread_friction,
            ..Resistance::default()
        }
    }
}

impl Component for SewnTissue {
    const NAME: &'static str = "sewn";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        ComponentError::range("young_modulus", self.young_modulus, 1.0..=1e12, "1 to 1e12 Pa")?;
        ComponentError::range("poisson_ratio", self.poisson_ratio, 0.0..=POISSON_MAX, "0 to 0.45")?;
        ComponentError::range("puncture_force", self.puncture_force, 0.0..=1e6, "0 to 1e6 N")?;
        ComponentError::range("exit_force", self.exit_force, 0.0..=1e6, "0 to 1e6 N")?;
        let most = self.puncture_force;
        ComponentError::range("cutting_force", self.cutting_force, 0.0..=most, "0 to the puncture force")?;
        for (name, grip) in [("needle_grip", self.needle_grip), ("thread_grip", self.thread_grip)] {
            ComponentError::range(name, grip, 0.0..=1e5, "0 to 1e5 N/m")?;
        }
        for (name, friction) in
            [("needle_friction", self.needle_friction), ("thread_friction", self.thread_friction)]
        {
            ComponentError::range(name, friction, 0.0..=2.0, "0 to 2")?;
        }
        Ok(())
    }
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

/// Radius of the bend in which the thread leaves the tail \[m\].
const BEND: f64 = 4e-3;

/// A needle with a thread swaged to it. It needs a mesh of a line, which then follows needle and thread; places are in the
/// frame of the entity, which stays where it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct SutureNeedle {
    /// Of the arc \[m\].
    pub length: f64,
    /// That it spans \[rad\].
    pub angle: f64,
    /// Of the wire \[m\].
    pub wire_radius: f64,
    /// From the tip, over which the wire grows to its radius \[m\].
    pub taper: f64,
    /// Where the tip is at the beginning \[m\].
    pub tip: [f64; 3],
    /// Where it points.
    pub ahead: [f64; 3],
    /// Across the plane of the arc: turned about this by the right hand, the needle goes ahead.
    pub side: [f64; 3],
    /// Which thread.
    pub suture: Suture,
    /// Coulomb's coefficient of it on itself, where it is known otherwise.
    pub friction: Option<Parameter>,
    /// Its `EI` \[N·m²\], where it is known otherwise.
    pub bending_stiffness: Option<Parameter>,
    /// Its `GJ` \[N·m²\], where it is known otherwise.
    pub twisting_stiffness: Option<Parameter>,
    /// How much of it \[m\]; it lies straight behind the tail at the beginning, or as far as `thread_to` says.
    pub thread_length: f64,
    /// Where it leads to at the beginning, once it has left the tail in a bend.
    pub thread_to: Option<[f64; 3]>,
    /// Tension at which its thread breaks \[N\], if it can.
    pub breaks_at: Option<Parameter>,
    /// Coulomb's coefficient of the thread on instruments.
    pub tool_friction: f64,
    /// Of the thread's edges \[m\]; where strands come near to each other or it bends sharply they become shorter.
    pub thread_edge: f64,
    /// Of those, in diameters of the thread.
    pub knot_edge: f64,
    /// That jaws can hold the needle with, along each axis \[N\].
    pub jaw_force: f64,
    /// And about each axis \[N·m\].
    pub jaw_torque: f64,
    /// Where the tip is to come out \[m\]; for the measure of how far off it did.
    pub planned_exit: Option<[f64; 3]>,
}

impl Default for SutureNeedle {
    /// A half circle of 26 mm with 6 cm of 2-0 silk, over the origin and pointing down. A needle driver holds some 10 N and
    /// 50 mN·m: chosen.
    fn default() -> Self {
        let shape = NeedleShape::half_circle_26();
        Self {
            length: shape.length(),
            angle: shape.angle,
            wire_radius: shape.wire_radius,
            taper: shape.taper,
            tip: [0.0; 3],
            ahead: [0.0, 0.0, -1.0],
            side: [0.0, 1.0, 0.0],
            suture: Suture::default(),
            friction: None,
            bending_stiffness: None,
            twisting_stiffness: None,
            thread_length: 0.06,
            thread_to: None,
            breaks_at: None,
            tool_friction: 0.2,
            thread_edge: 1.5e-3,
            knot_edge: 1.5,
            jaw_force: 10.0,
            jaw_torque: 0.05,
            planned_exit: None,
        }
    }
}

impl SutureNeedle {
    /// Its shape, of steel.
    #[must_use]
    pub fn shape(&self) -> NeedleShape {
        NeedleShape {
            radius: self.length / self.angle,
            angle: self.angle,
            wire_radius: self.wire_radius,
            taper: self.taper,
            ..NeedleShape::half_circle_26()
        }
    }

    /// Its thread as one without a needle.
    fn thread(&self) -> ThreadBody {
        ThreadBody {
            suture: self.suture,
            friction: self.friction.clone(),
            bending_stiffness: self.bending_stiffness.clone(),
            twisting_stiffness: self.twisting_stiffness.clone(),
            breaks_at: self.breaks_at.clone(),
            tool_friction: self.tool_friction,
            ..ThreadBody::default()
        }
    }

    /// Of what its thread is made.
    #[must_use]
    pub fn material(&self) -> ThreadMaterial {
        self.thread().material()
    }

    /// Nodes of its thread at the beginning, behind a tail that points `back`, in the world \[m\].
    ///
    /// # Errors
    /// A direction that is none.
    pub fn thread_nodes(
        &self,
        tail: Point3<f64>,
        back: Vector3<f64>,
        world_from_entity: &Isometry3<f64>,
    ) -> Result<Vec<Point3<f64>>, String> {
        let edges = (self.thread_length / self.thread_edge).round().max(2.0);
        let edge = self.thread_length / edges;
        let to = self
            .thread_to
            .map_or(Some(back), |to| (world_from_entity.rotation * Vector3::from(to)).try_normalize(1e-9));
        let to = to.ok_or("thread_to is no direction")?;
        // About which it bends, and how far.
        let axis = Unit::try_new(back.cross(&to), 1e-9)
            .unwrap_or_else(|| Unit::new_normalize(perpendicular(&Vector3::z(), &back)));
        let angle = back.angle(&to);
        let (mut nodes, mut at) = (vec![tail], tail);
        for step in 0..edges as usize {
            // The first edge goes straight on, in the line of the tail.
            let turned = (step as f64 * edge / BEND).min(angle);
            at += UnitQuaternion::from_axis_angle(&axis, turned) * back * edge;
            nodes.push(at);
        }
        Ok(nodes)
    }

    /// Its pose at the beginning, in the frame of the entity.
    ///
    /// # Errors
    /// A shape that no needle has, directions that are none.
    pub fn pose(&self) -> Result<Isometry3<f64>, String> {
        let solid = self.shape().solid().map_err(|error| error.to_string())?;
        let unit = |direction: [f64; 3], what: &str| {
            Vector3::from(direction).try_normalize(1e-9).ok_or_else(|| format!("{what} is no direction"))
        };
        let ahead = unit(self.ahead, "ahead")?;
        let side = Vector3::from(self.side);
        let side = unit((side - ahead * ahead.dot(&side)).into(), "side, across ahead,")?;
        let own = solid.tangent(self.length);
        let from = Matrix3::from_columns(&[own, Vector3::z().cross(&own), Vector3::z()]);
        let to = Matrix3::from_columns(&[ahead, side.cross(&ahead), side]);
        let turn = Rotation3::from_matrix_unchecked(to * from.transpose());
        let rotation = UnitQuaternion::from_rotation_matrix(&turn);
        let place = Point3::from(self.tip) - rotation * solid.point(self.length);
        Ok(Isometry3::from_parts(Translation3::from(place), rotation))
    }
}

impl Component for SutureNeedle {
    const NAME: &'static str = "needle";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)?;
        ComponentError::range("length", self.length, 2e-3..=0.3, "2 mm to 0.3 m")?;
        ComponentError::range("angle", self.angle, 1e-3..=5.0, "0.001 to 5 rad")?;
        ComponentError::range("wire_radius", self.wire_radius, 2e-5..=5e-3, "20 µm to 5 mm")?;
        ComponentError::range("thread_length", self.thread_length, 5e-3..=0.5, "5 mm to 0.5 m")?;
        ComponentError::range("thread_edge", self.thread_edge, 2e-4..=0.02, "0.2 to 20 mm")?;
        ComponentError::range("knot_edge", self.knot_edge, 0.5..=20.0, "0.5 to 20 diameters")?;
        self.thread().check()?;
        ComponentError::range("jaw_force", self.jaw_force, 0.0..=1e3, "0 to 1000 N")?;
        ComponentError::range("jaw_torque", self.jaw_torque, 0.0..=10.0, "0 to 10 N·m")
    }
    fn schema() -> Option<serde_json::Value> {
        Some(schemars::schema_for!(Self).to_value())
    }
}

/// How an instrument holds the needle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldNeedle {
    /// Which instrument.
    pub instrument: Entity,
    /// Its pose at the last tick, in the world.
    pub at: Isometry3<f64>,
    /// Where it holds it: arc length from the tail \[m\].
    pub along: f64,
    /// As the jaws have it.
    pub instrument_from_needle: Isometry3<f64>,
}

/// Where the last tick ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SutureMemory {
    /// Of needle, thread and channels, in the world; none before the first tick.
    pub state: Option<SutureState>,
    /// What instruments hold of the needle.
    pub held: Vec<HeldNeedle>,
    /// And of its thread.
    pub grips: Vec<Grip>,
    /// Instruments that were closed.
    pub closed: Vec<Entity>,
    /// Where the blades of all scissors were, in the world.
    pub blades: Vec<Blades>,
    /// What the thread could touch besides the tissue, in the order that contacts count them in.
    pub met: Vec<Met>,
    /// How deep a contact of the thread has been at most since the beginning \[m\].
    pub penetration_max: f64,
    /// The shortest that the thread's loop has been since it became the knot that it is, and since anybody has taken hold of
    /// the thread or let it go \[m\]; none as long as there is no loop.
    pub loop_min: Option<f64>,
}

impl Component for SutureMemory {
    const NAME: &'static str = "suture_memory";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}
