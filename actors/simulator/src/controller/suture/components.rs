//! Components of suturing: needle with thread, sewn tissue, and their state for a restart.

use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Translation3, Unit, UnitQuaternion, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::POISSON_MAX;
use trocar_scene::components::Parameter;
use trocar_scene::{Component, ComponentError, Entity, RecordPolicy};

use crate::controller::cutting::scissors::Blades;
use crate::controller::suture_thread::component::ThreadBody;
use crate::controller::suture_thread::grasp::Grip;
use crate::controller::suture_thread::saved_state::ObstaclePose;
use crate::controller::suture_thread::suture::{InDocument, Suture};
use crate::suture::needle::NeedleShape;
use crate::suture::{Resistance, SutureState};
use crate::suture_thread::ThreadMaterial;
use crate::suture_thread::bishop_frame::perpendicular;

/// Tissue that a needle penetrates. It needs a tetrahedral mesh, and `anchors` where it is fixed. See [`Resistance`]
/// for the meaning of the forces.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "sewn", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct SewnTissue {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
    /// Poisson's ratio, 0 to 0.45.
    pub poisson_ratio: f64,
    /// Puncture force of the surface from outside \[N\].
    pub puncture_force: f64,
    /// Puncture force from inside \[N\].
    pub exit_force: f64,
    /// Cutting force at the tip inside the tissue \[N\].
    pub cutting_force: f64,
    /// Friction along the needle per length, without normal load \[N/m\].
    pub needle_grip: f64,
    /// Friction along the thread per length, without normal load \[N/m\].
    pub thread_grip: f64,
    /// Coulomb friction coefficient of the needle.
    pub needle_friction: f64,
    /// Coulomb friction coefficient of the thread.
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
    /// In the form that the solver takes.
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

    fn ranges(&self) -> Result<(), ComponentError> {
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
}

/// Radius of the bend in which the thread leaves the needle's tail \[m\].
const BEND: f64 = 4e-3;

/// A needle with a swaged thread. It needs a line mesh, which then follows needle and thread; positions are in the
/// frame of the entity, which does not move.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "needle", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct SutureNeedle {
    /// Arc length \[m\].
    pub length: f64,
    /// Angle of the arc \[rad\].
    pub angle: f64,
    /// Wire radius \[m\].
    pub wire_radius: f64,
    /// Length from the tip over which the wire tapers \[m\].
    pub taper: f64,
    /// Initial position of the tip \[m\].
    pub tip: [f64; 3],
    /// Initial direction of the tip.
    pub ahead: [f64; 3],
    /// Normal of the arc's plane: right-handed rotation about it moves the needle forward.
    pub side: [f64; 3],
    /// The thread: a name, or a table with size and material.
    #[schemars(with = "InDocument")]
    pub suture: Suture,
    /// Coulomb friction coefficient of the thread on itself; absent: the suture's.
    pub friction: Option<Parameter>,
    /// Bending stiffness `EI` \[N·m²\]; absent: the suture's.
    pub bending_stiffness: Option<Parameter>,
    /// Torsional stiffness `GJ` \[N·m²\]; absent: the suture's.
    pub twisting_stiffness: Option<Parameter>,
    /// Length of the thread \[m\]; initially straight behind the tail, or towards `thread_to`.
    pub thread_length: f64,
    /// Where the thread leads initially, after the bend at the tail.
    pub thread_to: Option<[f64; 3]>,
    /// Breaking force of the thread \[N\]; absent: it never breaks.
    pub breaks_at: Option<Parameter>,
    /// Coulomb friction coefficient of the thread on instruments.
    pub tool_friction: f64,
    /// Length of the thread's edges \[m\]; shorter where strands are close to each other or the thread bends sharply.
    pub thread_edge: f64,
    /// Length of those shorter edges, in thread diameters.
    pub knot_edge: f64,
    /// Maximum force of jaws on the needle along each axis \[N\].
    pub jaw_force: f64,
    /// Maximum torque of jaws on the needle about each axis \[N·m\].
    pub jaw_torque: f64,
    /// Planned exit point of the tip \[m\]; for the measure of the deviation.
    pub planned_exit: Option<[f64; 3]>,
}

impl Default for SutureNeedle {
    /// A half circle of 26 mm with 6 cm of 2-0 silk, above the origin and pointing down. A needle driver holds some 10
    /// N and 50 mN·m: assumed.
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
    /// Its shape, made of steel.
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

    /// Its thread, as a component without needle.
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

    /// Material of its thread.
    #[must_use]
    pub fn material(&self) -> ThreadMaterial {
        self.thread().material()
    }

    /// Initial nodes of its thread, behind a tail that points `back`, in the world \[m\].
    ///
    /// # Errors
    /// An invalid direction.
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
        // Axis and angle of the bend.
        let axis = Unit::try_new(back.cross(&to), 1e-9)
            .unwrap_or_else(|| Unit::new_normalize(perpendicular(&Vector3::z(), &back)));
        let angle = back.angle(&to);
        let (mut nodes, mut at) = (vec![tail], tail);
        for step in 0..edges as usize {
            // The first edge is straight, along the tail.
            let turned = (step as f64 * edge / BEND).min(angle);
            at += UnitQuaternion::from_axis_angle(&axis, turned) * back * edge;
            nodes.push(at);
        }
        Ok(nodes)
    }

    /// Initial pose, in the frame of the entity.
    ///
    /// # Errors
    /// An invalid needle shape or direction.
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

    fn ranges(&self) -> Result<(), ComponentError> {
        self.suture.check()?;
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
}

/// An instrument's grasp of the needle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldNeedle {
    /// The instrument.
    pub instrument: Entity,
    /// Its pose in the last tick, in the world.
    pub at: Isometry3<f64>,
    /// Grasp point: arc length from the tail \[m\].
    pub along: f64,
    /// The needle's pose in the jaws.
    pub instrument_from_needle: Isometry3<f64>,
}

/// State after the last tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "suture_memory", record = RecordPolicy::sampled(2.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct SutureMemory {
    /// Needle, thread and channels, in the world; `None` before the first tick.
    pub state: Option<SutureState>,
    /// Grasps of the needle.
    pub held: Vec<HeldNeedle>,
    /// Grasps of the thread.
    pub grips: Vec<Grip>,
    /// Instruments with closed jaws.
    pub closed: Vec<Entity>,
    /// Previous blades of all scissors, in the world.
    pub blades: Vec<Blades>,
    /// Obstacles of the thread besides the tissue, in the order of the contacts' indices.
    pub met: Vec<ObstaclePose>,
    /// Maximum penetration depth of the thread so far \[m\].
    pub penetration_max: f64,
    /// Shortest length of the thread's loop since the current knot was formed, and since the last grasp or release of
    /// the thread \[m\]; `None` while there is no loop.
    pub loop_min: Option<f64>,
}
