//! Stations of a session over a network: who is there, and how their links do.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::entity::Entity;
use crate::snapshot::Snapshot;
use crate::{Component, ComponentError};

/// Most bytes of a station's name, role or hand.
const TEXT_MAX: usize = 256;

/// What a station may do in a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum StationRole {
    /// The host of the session.
    Host,
    /// Serves hands.
    Operate,
    /// Serves hands, shows things, and takes instruments over.
    Mentor,
    /// Looks on.
    Watch,
}

/// How a link does, over the last second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LinkState {
    /// Round trip \[s\].
    pub round_trip: f64,
    /// Standard deviation of the delay \[s\].
    pub jitter: f64,
    /// Share of the datagrams that was lost, 0 to 1.
    pub loss: f64,
    /// Age of what is shown \[s\].
    pub age: f64,
    /// Datagrams that arrive \[Hz\].
    pub rate: f64,
    /// Bytes that arrive [B/s].
    pub bytes_received: f64,
    /// Bytes that are sent [B/s].
    pub bytes_sent: f64,
    /// Whether datagrams do not arrive by themselves, in one direction or both, and are carried over TCP.
    pub over_tcp: bool,
}

/// Says that the owner of a body has replaced its rows, among peers that compute it each for itself: whoever computes it here
/// is built anew from them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "repaired", schema)]
#[serde(deny_unknown_fields)]
pub struct Repaired {
    /// How often that was.
    pub times: u32,
}

/// A station of a session over a network; the host writes one for each, and a station one for its own link.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "station", check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct Station {
    /// Its number; the host's is 0.
    pub number: u16,
    /// Its name.
    pub name: String,
    /// What it may do.
    pub role: StationRole,
    /// Whether it is there, and not away after a break.
    pub here: bool,
    /// Names of the hands that it serves.
    #[serde(default)]
    pub hands: Vec<String>,
    /// Whether strangers can neither read nor forge what its link carries.
    pub protected: bool,
    /// Its link to the host, as the other end measures it.
    #[serde(default)]
    pub link: LinkState,
}

impl Station {
    /// The number of the station that serves a hand, for people: 0, the host, if the host says that none of the others
    /// does. Hands are told by their names.
    pub fn serving(scene: &Snapshot, hand: Entity) -> u16 {
        let name = scene.name(hand);
        let name = name.strip_prefix("hand.").unwrap_or(&name);
        let mut of_host = scene.iter::<Self>().filter(|(entity, _)| entity.station() == 0);
        let serves = |row: &Self| row.hands.iter().any(|hand| hand == name);
        of_host.find(|(_, row)| serves(row)).map_or(0, |(_, row)| row.number)
    }

    fn validate(&self) -> Result<(), ComponentError> {
        let longest = self.hands.iter().chain([&self.name]).map(String::len).max().unwrap_or(0);
        ComponentError::range("name", longest as f64, 0.0..=TEXT_MAX as f64, "0 to 256 bytes")?;
        let LinkState { round_trip, jitter, loss, age, rate, bytes_received, bytes_sent, over_tcp: _ } =
            self.link;
        ComponentError::range("loss", loss, 0.0..=1.0, "0 to 1")?;
        for (name, value) in [
            ("round_trip", round_trip),
            ("jitter", jitter),
            ("age", age),
            ("rate", rate),
            ("bytes_received", bytes_received),
            ("bytes_sent", bytes_sent),
        ] {
            ComponentError::range(name, value, 0.0..=1e12, "0 to 1e12")?;
        }
        Ok(())
    }
}
