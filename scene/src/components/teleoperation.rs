//! Tele-surgery: a hand whose instrument follows poses that have come over a network.

use nalgebra::Vector3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::components::graph::Pose;
use crate::time::SimTime;
use crate::{Component, ComponentError, RecordPolicy};

/// What a slave does.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum SlaveState {
    /// Nothing has come from the master yet.
    #[default]
    Waiting,
    /// It follows the master.
    Following,
    /// The pedal is up: the master moves freely, the slave stands.
    PedalUp,
    /// The path is silent: the slave stands.
    Silent,
    /// After a silence or a stop it stands until the pedal is released.
    ReleasePedal,
    /// Emergency stop.
    Stopped,
    /// The master's device is unplugged.
    Unplugged,
}

impl SlaveState {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Following => "following",
            Self::PedalUp => "pedal up",
            Self::Silent => "silent",
            Self::ReleasePedal => "release the pedal",
            Self::Stopped => "stopped",
            Self::Unplugged => "unplugged",
        }
    }
}

/// What of a tele-operation is in this session.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TeleoperationEnd {
    /// The master's device, and the slave: a packet reflector is between them.
    #[default]
    Both,
    /// The slave; its master is a console elsewhere.
    Slave,
    /// The master's console; its slave is a robot elsewhere.
    Console,
}

/// The pedals of an instrument's current, as they count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum EnergyPedal {
    /// There are none.
    #[default]
    None,
    /// All are up.
    Released,
    /// The instrument's own current is on.
    Energy,
    /// The instrument coagulates.
    Coagulate,
}

/// How the force at a slave is brought to its master's hand over a delay.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum ForceFeedback {
    /// Not at all.
    #[default]
    None,
    /// Time-domain passivity.
    Passivity,
    /// Wave variables.
    WaveVariables,
    /// Model-mediated.
    ModelMediated,
}

impl ForceFeedback {
    /// In words.
    pub fn words(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Passivity => "passivity",
            Self::WaveVariables => "wave variables",
            Self::ModelMediated => "model-mediated",
        }
    }
}

/// How well a slave has followed, and what its path did, since the session's start. What is unknown is `None`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct TeleoperationFigures {
    /// Packets that were sent.
    pub sent: u64,
    /// Packets that came back, each once.
    pub received: u64,
    /// Packets that a newer one had overtaken: they came, and were not applied.
    pub late: u64,
    /// Packets that were refused: damaged, forged, or come twice.
    pub refused: u64,
    /// Mean round trip \[s\].
    pub round_trip_mean: Option<f64>,
    /// Shortest round trip \[s\].
    pub round_trip_min: Option<f64>,
    /// Round trip that 99 % of the packets do not exceed \[s\].
    pub round_trip_p99: Option<f64>,
    /// Longest round trip \[s\].
    pub round_trip_max: Option<f64>,
    /// How far a packet's round trip is from the trace's delay at its sending, of 99 % of the packets \[s\]; known for a
    /// reflector of the session's own.
    pub delay_error_p99: Option<f64>,
    /// The same of the worst packet \[s\].
    pub delay_error_max: Option<f64>,
    /// Distance of the slave's tip from the master's at the same time, root mean square \[m\].
    pub rms: Option<f64>,
    /// The same from where the master's tip was a constant time before, for the time that makes it least \[m\].
    pub constant_lag_rms: Option<f64>,
    /// That time \[s\].
    pub constant_lag: Option<f64>,
    /// Largest distance of the slave from the master's pose whose time stamp was applied \[m\].
    pub applied_error_max: Option<f64>,
    /// The same, root mean square \[m\].
    pub applied_error_rms: Option<f64>,
    /// Range of the slave's tip along the world's x axis \[m\].
    pub x_range: f64,
    /// Largest speed of the master's tip [m/s].
    pub speed_max: f64,
    /// Share of the time since the first pose was applied in which the instrument felt a contact, 0 to 1.
    pub contact_share: f64,
    /// Steps in which a limit of speed, workspace or force held the slave back.
    pub limited: u64,
    /// Emergency stops.
    pub stops: u64,
    /// Silences of the path of 100 ms or more.
    pub silences: u64,
    /// Time with the slave's current on \[s\].
    pub energised: f64,
    /// Mean of the force on the master's hand along that at the slave, over the mean of that at the slave, while there was
    /// one; known if forces are fed back. What is scaled counts as if it were not.
    pub felt_share: Option<f64>,
}

/// A hand that is a master, and the instrument that is its slave; on the hand. The network's actor writes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "teleoperation", record = RecordPolicy::sampled(50.0, 1e-7), check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Teleoperation {
    /// What of it is in this session.
    pub end: TeleoperationEnd,
    /// What the slave does.
    pub state: SlaveState,
    /// The pedals of the current, as they count at the slave; of a robot elsewhere, as they were sent.
    pub pedals: EnergyPedal,
    /// `world_from_tip` of the master: where the instrument would be without the path.
    pub master_in_world: Pose,
    /// `world_from_tip` of the slave's command, at the same time.
    pub slave_in_world: Pose,
    /// That time.
    pub at: SimTime,
    /// Time stamp of the master's pose that the slave applies.
    pub applied: SimTime,
    /// Round trip of the newest packet \[s\]; 0 where only the other end knows it.
    pub round_trip: f64,
    /// Force at the slave, in world \[N\].
    #[schemars(with = "[f64; 3]")]
    pub force_in_world: Vector3<f64>,
    /// How that force is brought to the master's hand, at present.
    pub feedback: ForceFeedback,
    /// Force on the master's hand, in world \[N\].
    #[schemars(with = "[f64; 3]")]
    pub felt_in_world: Vector3<f64>,
    /// Whether strangers can neither read nor forge the packets.
    pub protected: bool,
    /// All of it in numbers.
    pub figures: TeleoperationFigures,
}

impl Teleoperation {
    /// What a person at it has to know, in words: `following, current on, 151 ms behind, 0.42 N`.
    pub fn words(&self) -> String {
        let mut words = self.state.words().to_owned();
        match self.pedals {
            EnergyPedal::Energy => words += ", current on",
            EnergyPedal::Coagulate => words += ", coagulating",
            EnergyPedal::Released => words += ", current off",
            EnergyPedal::None => {}
        }
        if self.round_trip > 0.0 {
            words += &format!(", {:.1} ms behind", self.round_trip * 1e3);
        }
        words += &format!(", {:.2} N", self.force_in_world.norm());
        if self.feedback != ForceFeedback::None {
            words += &format!(", {:.2} N felt by {}", self.felt_in_world.norm(), self.feedback.words());
        }
        if !self.protected {
            words += ", unprotected";
        }
        words
    }

    fn validate(&self) -> Result<(), ComponentError> {
        super::graph::check_rotation(&self.master_in_world.rotation)?;
        super::graph::check_rotation(&self.slave_in_world.rotation)?;
        ComponentError::range("round_trip", self.round_trip, 0.0..=1e6, "0 to 1e6 s")
    }
}

/// What somebody asks of a slave; on the hand. Anybody may write it: a controller, a program, an instructor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "slave_order", schema)]
#[serde(default, deny_unknown_fields)]
pub struct SlaveOrder {
    /// Emergency stop: the slave stands until this is false again and the pedal was released and pressed.
    pub stop: bool,
}
