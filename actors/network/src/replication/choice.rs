//! Which columns are replicated, and how: reliably and in order, or unreliably at a rate, the newest value winning.
//!
//! A scenario may change it, column by column:
//!
//! ```toml
//! [network.columns]
//! pose = 60
//! vertex_positions = 30
//! tissue = "reliable"
//! blood_pool = "never"
//! ```

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use serde::de::{self, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use thiserror::Error;
use trocar_scene::{
    Component, ComponentEntry, ComponentId, Pose, RecordPolicy, Registry, Sampling, SimTime, VertexPositions,
};

/// Highest rate of a column \[Hz\].
pub const RATE_HZ_MAX: f64 = 1_000.0;

/// How the rows of a column travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Delivery {
    /// Exactly and in order, over the control channel.
    Reliable,
    /// Quantised, in datagrams: the newest value, a row at most this often \[Hz\].
    Unreliable {
        /// Most values of one row a second.
        rate_hz: f64,
    },
    /// Not at all.
    Never,
}

/// A number is a rate in Hz; otherwise `"reliable"` or `"never"`.
impl Serialize for Delivery {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Reliable => serializer.serialize_str("reliable"),
            Self::Unreliable { rate_hz } => serializer.serialize_f64(*rate_hz),
            Self::Never => serializer.serialize_str("never"),
        }
    }
}

impl<'de> Deserialize<'de> for Delivery {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct OfDelivery;
        impl Visitor<'_> for OfDelivery {
            type Value = Delivery;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "a rate above 0 and up to {RATE_HZ_MAX} Hz, \"reliable\" or \"never\"")
            }
            fn visit_f64<E: de::Error>(self, rate_hz: f64) -> Result<Delivery, E> {
                if rate_hz > 0.0 && rate_hz <= RATE_HZ_MAX {
                    Ok(Delivery::Unreliable { rate_hz })
                } else {
                    Err(E::invalid_value(de::Unexpected::Float(rate_hz), &self))
                }
            }
            fn visit_i64<E: de::Error>(self, rate_hz: i64) -> Result<Delivery, E> {
                self.visit_f64(rate_hz as f64)
            }
            fn visit_u64<E: de::Error>(self, rate_hz: u64) -> Result<Delivery, E> {
                self.visit_f64(rate_hz as f64)
            }
            fn visit_str<E: de::Error>(self, word: &str) -> Result<Delivery, E> {
                match word {
                    "reliable" => Ok(Delivery::Reliable),
                    "never" => Ok(Delivery::Never),
                    _ => Err(E::invalid_value(de::Unexpected::Str(word), &self)),
                }
            }
        }
        deserializer.deserialize_any(OfDelivery)
    }
}

/// A scenario's own choices, by NAME of the component.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct ColumnRates(pub BTreeMap<String, Delivery>);

/// A choice that cannot be followed.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ChoiceError {
    /// No component has that name.
    #[error("network.columns: {0}")]
    Unknown(#[from] trocar_scene::RegistryError),
    /// A rate outside its range.
    #[error("network.columns.{name} = {rate_hz}: a rate is above 0 and at most {RATE_HZ_MAX} Hz")]
    Rate {
        /// The column.
        name: String,
        /// Its rate.
        rate_hz: f64,
    },
    /// Derived state does not travel: each station derives its own.
    #[error("network.columns.{0}: each station derives this component itself, it can only be \"never\"")]
    Derived(String),
}

/// What is known by name: rates \[Hz\] of what moves, where the rate of its recording does not suit.
const RATES: [(&str, f64); 12] = [
    ("device_force", 60.0),
    ("device_state", 60.0),
    ("hand_target", 60.0),
    ("instrument_force", 60.0),
    ("instrument_target", 60.0),
    ("jaw_state", 60.0),
    ("joint_state", 60.0),
    ("local_contact_model", 60.0),
    ("particles", 20.0),
    ("pose", 60.0),
    ("velocity", 30.0),
    ("vertex_positions", 30.0),
];

/// What peers compute, each for itself, of the same hands: how everything moves that a hand can meet, with the memories of the
/// solvers, and haptics. Tasks, heat, liquids and persons are the founder's.
const SIMULATED: [&str; 45] = [
    "coupling_given",
    "coupling_taken",
    "cuts",
    "device_force",
    "device_state",
    "doubtful",
    "dynamic_fem_memory",
    "frozen",
    "grasp",
    "grips",
    "haptic_status",
    "held_impacts",
    "instrument_deflection",
    "instrument_force",
    "instrument_target",
    "instrument_yields",
    "jaw_state",
    "joint_frames",
    "joint_state",
    "knot_state",
    "line_mesh",
    "linear_fem_contacts",
    "local_contact_model",
    "measured",
    "mechanism_state",
    "pin_places",
    "pose",
    "rest_positions",
    "rigid_contacts",
    "rod_paths",
    "soft_contacts",
    "spring_factor",
    "station_contact_model",
    "strained_grips",
    "surface_elements",
    "surface_mesh",
    "suture_memory",
    "tet_mesh",
    "texture_coordinates",
    "thread_memory",
    "velocity",
    "vertex_positions",
    "vertex_velocities",
    "volume_cuts",
    "xpbd_groups",
];

/// What a peer does not take even once, when it joins: it is found anew in every tick, or belongs to one person.
const MOMENTARY: [&str; 5] =
    ["autopilot_state", "collision_list", "manual_state", "person_input", "repaired"];

/// What only the station that computes it reads: contacts between two ticks, and memories of solvers and of persons.
const NEVER: [&str; 16] = [
    "autopilot_state",
    "collision_list",
    "coupling_given",
    "coupling_taken",
    "dynamic_fem_memory",
    "held_impacts",
    "linear_fem_contacts",
    "manual_state",
    "person_input",
    "repaired",
    "rigid_contacts",
    "soft_contacts",
    "strained_grips",
    "suture_memory",
    "thread_memory",
    "xpbd_groups",
];

/// Tolerances of numbers of exactly recorded columns that are sent unreliably, in the unit of each number.
const TOLERANCES: [(&str, f64); 2] = [("device_state", 2.5e-7), ("hand_target", 2.5e-7)];

/// How the rows of an unreliable column are quantised.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RowCodec {
    /// A pose: position on a grid and the smallest three of its quaternion.
    Pose,
    /// Vertices, in chunks of 64.
    Vertices,
    /// Any value: every number with a fraction is a multiple of this power of two.
    Grid {
        /// The grid's step, in the unit of the number.
        step: f64,
    },
    /// Any value, to the last bit.
    Exact,
}

#[derive(Clone, Copy, Debug)]
struct ReplicatedColumn {
    delivery: Delivery,
    codec: RowCodec,
    /// Whether peers compute it, each for itself.
    is_simulated: bool,
}

/// The choice for every column of a session. Both stations make the same one, since it travels with the scenario.
#[derive(Clone)]
pub struct ReplicatedColumns {
    registry: Arc<Registry>,
    columns: Vec<ReplicatedColumn>,
    /// Whether stations compute where the instruments of all hands are.
    follows_hands: bool,
}

impl ReplicatedColumns {
    /// The defaults, changed by a scenario's own choices. Unless something else is known of a component, it travels as
    /// it is recorded: exact ones reliably, sampled ones at their rate and within their tolerance, derived ones never.
    ///
    /// # Errors
    /// When a choice names no component or an impossible rate.
    pub fn new(registry: &Arc<Registry>, rates: &ColumnRates) -> Result<Self, ChoiceError> {
        let columns = registry.iter().map(|(_, entry)| ReplicatedColumn {
            delivery: default_delivery(entry),
            codec: codec(entry),
            is_simulated: false,
        });
        let mut columns: Vec<_> = columns.collect();
        for (name, delivery) in &rates.0 {
            let id = registry.by_name(name)?;
            if registry.entry(id).record == RecordPolicy::Derived && *delivery != Delivery::Never {
                return Err(ChoiceError::Derived(name.clone()));
            }
            if let Delivery::Unreliable { rate_hz } = *delivery
                && !(rate_hz > 0.0 && rate_hz <= RATE_HZ_MAX)
            {
                return Err(ChoiceError::Rate { name: name.clone(), rate_hz });
            }
            columns[usize::from(id.0)].delivery = *delivery;
        }
        Ok(Self { registry: registry.clone(), columns, follows_hands: false })
    }

    /// The same among peers: a station that joins gets everything once, also the memories of solvers, and computes from
    /// there on what the founder computes as well ([`Self::simulated`]).
    #[must_use]
    pub fn among_peers(mut self) -> Self {
        for ((_, entry), column) in self.registry.iter().zip(&mut self.columns) {
            column.is_simulated = SIMULATED.contains(&entry.name);
            let is_left_out = column.delivery == Delivery::Never && entry.record != RecordPolicy::Derived;
            if is_left_out && !MOMENTARY.contains(&entry.name) {
                column.delivery = Delivery::Reliable;
            }
        }
        self
    }

    /// The same where stations get the hands of all others directly: they compute themselves where the instruments are.
    #[must_use]
    pub fn with_all_hands(self) -> Self {
        Self { follows_hands: true, ..self }
    }

    /// Whether stations compute themselves where the instruments of all hands are.
    pub fn follows_hands(&self) -> bool {
        self.follows_hands
    }

    /// The columns that peers compute, each for itself; none unless the session is [among peers](Self::among_peers).
    pub fn simulated(&self) -> impl Iterator<Item = ComponentId> {
        self.ids().filter(|id| self.columns[usize::from(id.0)].is_simulated)
    }

    /// The components of the session.
    pub fn registry(&self) -> &Arc<Registry> {
        &self.registry
    }
    /// How a column travels.
    pub fn delivery(&self, id: ComponentId) -> Delivery {
        self.columns.get(usize::from(id.0)).map_or(Delivery::Never, |column| column.delivery)
    }
    /// Whether a column travels at all.
    pub fn is_replicated(&self, id: ComponentId) -> bool {
        self.delivery(id) != Delivery::Never
    }
    /// Whether a column travels in datagrams.
    pub fn is_unreliable(&self, id: ComponentId) -> bool {
        self.period(id).is_some()
    }
    /// Least time between two values of a row of an unreliable column.
    pub fn period(&self, id: ComponentId) -> Option<SimTime> {
        match self.delivery(id) {
            Delivery::Unreliable { rate_hz } => Some(SimTime::from_secs_f64(1.0 / rate_hz)),
            _ => None,
        }
    }
    /// How rows of an unreliable column are quantised.
    pub fn codec(&self, id: ComponentId) -> RowCodec {
        self.columns.get(usize::from(id.0)).map_or(RowCodec::Exact, |column| column.codec)
    }
    /// Hash of the whole choice, for the manifest of a session: stations with different choices cannot read each other.
    pub fn fingerprint(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for (id, entry) in self.registry.iter() {
            let what = format!("{} {:?} {:?}\n", entry.name, self.delivery(id), self.codec(id));
            hasher.update(what.as_bytes());
            if self.columns[usize::from(id.0)].is_simulated {
                hasher.update(b"simulated\n");
            }
        }
        hasher.update(&[u8::from(self.follows_hands)]);
        *hasher.finalize().as_bytes()
    }
    /// Every column that travels, ordered by NAME.
    pub fn replicated(&self) -> impl Iterator<Item = ComponentId> {
        self.ids().filter(|id| self.is_replicated(*id))
    }
    /// Every column that travels in datagrams, ordered by NAME.
    pub fn unreliable(&self) -> impl Iterator<Item = ComponentId> {
        self.ids().filter(|id| self.is_unreliable(*id))
    }
    fn ids(&self) -> impl Iterator<Item = ComponentId> + use<> {
        (0..self.columns.len() as u16).map(ComponentId)
    }
}

fn default_delivery(entry: &ComponentEntry) -> Delivery {
    if NEVER.contains(&entry.name) {
        return Delivery::Never;
    }
    let known = RATES.iter().find(|(name, _)| *name == entry.name);
    match (known, entry.record) {
        (_, RecordPolicy::Derived) => Delivery::Never,
        (Some((_, rate_hz)), _) => Delivery::Unreliable { rate_hz: *rate_hz },
        (None, RecordPolicy::Sampled(Sampling { hz, .. })) if hz > 0.0 => {
            Delivery::Unreliable { rate_hz: hz.min(RATE_HZ_MAX) }
        }
        _ => Delivery::Reliable,
    }
}

fn codec(entry: &ComponentEntry) -> RowCodec {
    if entry.name == Pose::NAME {
        return RowCodec::Pose;
    }
    if entry.name == VertexPositions::NAME {
        return RowCodec::Vertices;
    }
    let known = TOLERANCES.iter().find(|(name, _)| *name == entry.name);
    let tolerance = match entry.record {
        RecordPolicy::Sampled(sampling) => Some(sampling.tolerance),
        _ => known.map(|(_, tolerance)| *tolerance),
    };
    match tolerance.filter(|tolerance| *tolerance > 0.0 && tolerance.is_finite()) {
        Some(tolerance) => RowCodec::Grid { step: Sampling { hz: 1.0, tolerance }.step() },
        None => RowCodec::Exact,
    }
}

#[cfg(test)]
mod tests {
    use serde::de::IntoDeserializer;
    use serde::de::value::Error;

    use super::*;

    fn choice(rates: &[(&str, Delivery)]) -> Result<ReplicatedColumns, ChoiceError> {
        let rates = rates.iter().map(|(name, delivery)| ((*name).to_owned(), *delivery)).collect();
        ReplicatedColumns::new(&Registry::standard(), &ColumnRates(rates))
    }

    #[test]
    fn topology_goes_reliably_what_moves_at_a_rate_and_derived_state_stays() {
        let columns = choice(&[]).expect("the defaults hold");
        let of = |name: &str| columns.delivery(columns.registry().by_name(name).expect("it is standard"));
        for name in ["name", "parent", "surface_mesh", "tet_mesh", "grasp", "rest_positions", "task_state"] {
            assert_eq!(of(name), Delivery::Reliable, "{name}");
        }
        for (name, rate_hz) in [("pose", 60.0), ("vertex_positions", 30.0), ("temperature", 10.0)] {
            assert_eq!(of(name), Delivery::Unreliable { rate_hz }, "{name}");
        }
        assert_eq!(of("collision_list"), Delivery::Never);
        assert!(columns.unreliable().all(|id| columns.is_replicated(id)));
        assert!(!columns.is_replicated(ComponentId(u16::MAX)));
    }

    #[test]
    fn a_scenario_overrides_columns_by_name() {
        let rates = ColumnRates(
            [("pose", of_number(90.0)), ("name", of_word("never")), ("burn", of_word("reliable"))]
                .map(|(name, delivery)| (name.to_owned(), delivery.expect("it is valid")))
                .into(),
        );
        let columns = ReplicatedColumns::new(&Registry::standard(), &rates).expect("it is valid");
        let of = |name: &str| columns.delivery(columns.registry().by_name(name).expect("it is standard"));
        assert_eq!(of("pose"), Delivery::Unreliable { rate_hz: 90.0 });
        assert_eq!((of("name"), of("burn")), (Delivery::Never, Delivery::Reliable));
        let defaults = choice(&[]).expect("the defaults hold");
        assert_eq!(defaults.fingerprint(), choice(&[]).expect("the defaults hold").fingerprint());
        assert_ne!(defaults.fingerprint(), columns.fingerprint());
    }

    fn of_number(number: f64) -> Result<Delivery, Error> {
        Delivery::deserialize(number.into_deserializer())
    }
    fn of_word(word: &str) -> Result<Delivery, Error> {
        Delivery::deserialize(word.into_deserializer())
    }

    #[test]
    fn wrong_choices_are_named_with_what_is_valid() {
        let unknown = choice(&[("poses", Delivery::Never)]).err().expect("no such column").to_string();
        assert!(unknown.contains("'poses'") && unknown.contains("vertex_positions"), "{unknown}");
        let rate_hz = f64::NAN;
        assert!(matches!(
            choice(&[("pose", Delivery::Unreliable { rate_hz })]),
            Err(ChoiceError::Rate { .. })
        ));
        let bad = of_word("sometimes").expect_err("no such word").to_string();
        assert!(bad.contains("\"reliable\" or \"never\""), "{bad}");
        assert!([0.0, -1.0, 1e4, f64::NAN].into_iter().all(|rate| of_number(rate).is_err()));
    }
}
