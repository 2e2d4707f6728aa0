//! Instruments, their ports (trocars), and their grasps.
//!
//! Instrument frame: the origin (*tip*) is the midpoint between the closed jaw tips; +z runs along the
//! shaft from the handle to the tip; +x is the closing direction (jaw A lies at +x, jaw B at −x); y is the
//! width of the blades. The jaws' hinge is at z = −`jaw_length`, the handle at z = −`shaft_length`.

use nalgebra::{Point3, Vector3};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::components::graph::{Pose, Velocity};
use crate::entity::Entity;
use crate::time::SimTime;
use crate::{Component, ComponentError, RecordPolicy};

/// What kind of instrument it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum InstrumentKind {
    /// Two opposing blunt jaws (Maryland dissector).
    #[default]
    Grasper,
    /// Two cutting blades.
    Scissors,
    /// A heated hook.
    HookCautery,
    /// A needle driver.
    NeedleDriver,
    /// A rod without jaws.
    Probe,
    /// Two long blunt jaws that spread tissue.
    BluntDissector,
    /// Two fine jaws that hold and pull thread.
    SutureGrasper,
    /// A rod from which a pre-tied loop is drawn tight.
    LoopApplier,
    /// A rod with a notch that slides a knot down its thread.
    KnotPusher,
    /// A bent rod that holds an organ aside (Nathanson).
    Retractor,
    /// A curved rod that carries a band around an organ.
    BandPasser,
}

impl InstrumentKind {
    /// Whether it has jaws that open and close.
    pub fn has_jaws(self) -> bool {
        match self {
            Self::Grasper
            | Self::Scissors
            | Self::NeedleDriver
            | Self::BluntDissector
            | Self::SutureGrasper => true,
            Self::HookCautery
            | Self::Probe
            | Self::LoopApplier
            | Self::KnotPusher
            | Self::Retractor
            | Self::BandPasser => false,
        }
    }
}

/// Dimensions and mechanics of an instrument. Lengths \[m\], angles \[rad\].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "instrument", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Instrument {
    /// What kind it is.
    pub kind: InstrumentKind,
    /// From the handle to the tip \[m\].
    pub shaft_length: f64,
    /// Radius of the shaft \[m\].
    pub shaft_radius: f64,
    /// From the hinge to the tip \[m\].
    pub jaw_length: f64,
    /// Width of a blade (y) \[m\].
    pub jaw_width: f64,
    /// Thickness of a blade (x) \[m\].
    pub jaw_thickness: f64,
    /// Largest full opening angle between the jaws \[rad\].
    pub jaw_angle_max: f64,
    /// Largest force of a jaw, measured at its tip \[N\].
    pub jaw_force_max: f64,
    /// Coulomb friction of the jaw pads.
    pub jaw_friction: f64,
    /// Number of working jaws; 1 models a broken grasper.
    pub jaws: u8,
    /// Moving mass of the distal shaft \[kg\].
    pub mass: f64,
    /// Whether a grasp constraint may help friction once both jaws oppose each other on one body.
    pub grasp_assist: bool,
    /// Force at which the grasp constraint breaks \[N\].
    pub grasp_break_force: f64,
    /// Stiffness of the coupling between hand and instrument \[N/m\].
    pub coupling_stiffness: f64,
    /// The port that the shaft passes; free 6-DOF motion without one.
    #[schemars(with = "Option<String>")]
    pub port: Option<Entity>,
}
impl Default for Instrument {
    fn default() -> Self {
        Self {
            kind: InstrumentKind::Grasper,
            shaft_length: 0.33,
            shaft_radius: 0.0025,
            jaw_length: 0.018,
            jaw_width: 0.003,
            jaw_thickness: 0.0015,
            jaw_angle_max: 0.9,
            jaw_force_max: 1.5,
            jaw_friction: 0.6,
            jaws: 2,
            mass: 0.03,
            grasp_assist: false,
            grasp_break_force: 4.0,
            coupling_stiffness: 1000.0,
            port: None,
        }
    }
}

impl Instrument {
    fn ranges(&self) -> Result<(), ComponentError> {
        let length = |field, value| ComponentError::range(field, value, 1e-5..=1.0, "1e-5 to 1 m");
        length("shaft_length", self.shaft_length)?;
        length("shaft_radius", self.shaft_radius)?;
        length("jaw_length", self.jaw_length)?;
        length("jaw_width", self.jaw_width)?;
        length("jaw_thickness", self.jaw_thickness)?;
        ComponentError::range("jaw_angle_max", self.jaw_angle_max, 0.0..=3.0, "0 to 3 rad")?;
        ComponentError::range("jaw_force_max", self.jaw_force_max, 0.0..=50.0, "0 to 50 N")?;
        ComponentError::range("jaw_friction", self.jaw_friction, 0.0..=10.0, "0 to 10")?;
        ComponentError::range("jaws", f64::from(self.jaws), 0.0..=2.0, "0, 1 or 2")?;
        ComponentError::range("mass", self.mass, 1e-4..=1.0, "1e-4 to 1 kg")?;
        ComponentError::range("grasp_break_force", self.grasp_break_force, 0.0..=100.0, "0 to 100 N")?;
        ComponentError::range("coupling_stiffness", self.coupling_stiffness, 1.0..=1e5, "1 to 1e5 N/m")
    }
}

/// The trocar: the fulcrum in the wall that a shaft passes. Its position is the entity's pose.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "port", schema)]
#[serde(default, deny_unknown_fields)]
pub struct Port {
    /// Viscous friction along the shaft \[N·s/m\].
    pub axial_damping: f64,
    /// Coulomb friction along the shaft \[N\].
    pub axial_friction: f64,
    /// Viscous friction of turning about the fulcrum \[N·m·s/rad\].
    pub angular_damping: f64,
    /// Least insertion: from the fulcrum to the tip \[m\].
    pub insertion_min: f64,
    /// Largest insertion: from the fulcrum to the tip \[m\].
    pub insertion_max: f64,
}
impl Default for Port {
    fn default() -> Self {
        Self {
            axial_damping: 0.5,
            axial_friction: 0.1,
            angular_damping: 0.001,
            insertion_min: 0.02,
            insertion_max: 0.30,
        }
    }
}

/// Target of an instrument, from its hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "instrument_target", record = RecordPolicy::sampled(60.0, 2.5e-7), check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentTarget {
    /// Target of `world_from_instrument`.
    pub tip_in_world: Pose,
    /// Its velocity, for extrapolation between ticks.
    pub velocity_in_world: Velocity,
    /// Target of the full jaw opening \[rad\].
    pub jaw_angle: f64,
    /// Time of the hand's sample.
    pub sampled_at: SimTime,
}

impl InstrumentTarget {
    fn validate(&self) -> Result<(), ComponentError> {
        super::graph::check_rotation(&self.tip_in_world.rotation)
    }
}

/// State of the jaws.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "jaw_state", record = RecordPolicy::sampled(60.0, 1e-6), schema)]
#[serde(default, deny_unknown_fields)]
pub struct JawState {
    /// Actual full opening \[rad\].
    pub angle: f64,
    /// Its rate \[rad/s\].
    pub rate: f64,
    /// Normal force on the pad of jaw A and of jaw B \[N\].
    pub pad_force: [f64; 2],
}

/// Mode of an electrosurgical generator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ActivationMode {
    /// Cut mode (yellow pedal): tissue vaporises and parts.
    Cut,
    /// Coagulation mode (blue pedal): tissue desiccates, shrinks and chars.
    Coagulate,
}

/// Activation of an instrument by a pedal, a button or a virtual trainee.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "activation", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Activation {
    /// Share of full power, 0 to 1.
    pub level: f64,
    /// Time since when it has had that level.
    pub since: SimTime,
    /// Mode of an electrode; none: the instrument's own setting.
    pub mode: Option<ActivationMode>,
}

impl Activation {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("level", self.level, 0.0..=1.0, "0 to 1")
    }
}

/// The wrench that the instrument exerts on the hand, at the tip, in world axes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "instrument_force", record = RecordPolicy::sampled(100.0, 0.0001), schema)]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentForce {
    /// Force \[N\].
    #[schemars(with = "[f64; 3]")]
    pub force: Vector3<f64>,
    /// Torque about the tip \[N·m\].
    #[schemars(with = "[f64; 3]")]
    pub torque: Vector3<f64>,
    /// When it was computed.
    pub at: SimTime,
}

/// A grasp by opposing contacts of both jaws; absent while nothing is held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "grasp", schema)]
#[serde(deny_unknown_fields)]
pub struct Grasp {
    /// The body held.
    #[schemars(with = "String")]
    pub held: Entity,
    /// `instrument_from_held` when the grasp formed.
    pub anchor: Pose,
    /// Since when.
    pub since: SimTime,
    /// Whether the grasp constraint helps friction.
    pub assisted: bool,
}

/// A plane that an instrument touches, with its compliance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ContactPlane {
    /// A point on the plane, above which the instrument's tip must stay, in world \[m\].
    #[schemars(with = "[f64; 3]")]
    pub point_in_world: Point3<f64>,
    /// Unit normal pointing to the allowed side.
    #[schemars(with = "[f64; 3]")]
    pub normal_in_world: Vector3<f64>,
    /// Stiffness against penetration \[N/m\].
    pub stiffness: f64,
    /// Damping along the normal \[N·s/m\].
    pub damping: f64,
    /// Coulomb friction.
    pub friction: f64,
}

/// Time-stamped local contact model of an instrument, which haptics evaluates at its own rate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "local_contact_model", record = RecordPolicy::sampled(30.0, 1e-5), schema)]
#[serde(deny_unknown_fields)]
pub struct LocalContactModel {
    /// Pose of the simulated tip at `at`, in world.
    pub proxy_in_world: Pose,
    /// Its velocity.
    pub proxy_velocity: Velocity,
    /// The planes; used ones come first.
    pub planes: [Option<ContactPlane>; 4],
    /// Force on the hand that the planes do not explain (a held body's weight) \[N\].
    #[schemars(with = "[f64; 3]")]
    pub base_force: Vector3<f64>,
    /// When it was computed.
    pub at: SimTime,
}

/// The local contact model that a station makes for an instrument of its own hand, from its own copy of the scene; haptics
/// there renders it in place of the host's, which is late by the network's delay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "station_contact_model", record = RecordPolicy::sampled(30.0, 1e-5), schema)]
#[serde(deny_unknown_fields)]
pub struct StationContactModel {
    /// The model.
    pub model: LocalContactModel,
}
