//! How far an instrument stands from where its hand leads it, where no world of rigid bodies moves it.
//!
//! The simulator of a body that does not let an instrument through couples it to its hand (virtual coupling) and tells how
//! far it has given way: [`InstrumentYields`]. The controller of the instruments displaces it by the sum, as springs that
//! are displaced by the sum of their loads, and tells by how much: [`InstrumentDeflection`]. So each simulator knows where
//! the hand leads the instrument.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, Entity, RecordPolicy, SimTime};

/// How one body holds an instrument back. All vectors in the world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InstrumentYield {
    /// The instrument.
    pub instrument: Entity,
    /// Its displacement from where the hand leads it \[m\].
    pub offset: Vector3<f64>,
    /// Velocity of that displacement \[m/s\].
    pub velocity: Vector3<f64>,
    /// Force of the coupling on the hand, mean over the tick \[N\].
    pub coupling_force: Vector3<f64>,
    /// Force on the instrument in the contacts that the body's simulator lists, mean over the tick \[N\].
    pub contact_force: Vector3<f64>,
}

/// How a body's simulator holds instruments back; on the body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "instrument_yields", record = RecordPolicy::sampled(30.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentYields {
    /// Those that it displaces.
    pub list: Vec<InstrumentYield>,
    /// When.
    pub at: SimTime,
    /// Longest step in which it follows them \[s\]; 0 where it need not be limited.
    pub step_max: f64,
}

impl InstrumentYields {
    /// How it holds an instrument back, if it does.
    #[must_use]
    pub fn of(&self, instrument: Entity) -> Option<&InstrumentYield> {
        self.list.iter().find(|of| of.instrument == instrument)
    }
}

/// By how much one body displaces an instrument, in the world.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Displacement {
    /// Displacement \[m\].
    pub offset: Vector3<f64>,
    /// Its velocity \[m/s\].
    pub velocity: Vector3<f64>,
}

/// How far an instrument's pose is displaced from where its hand leads it; on the instrument. An instrument without it does
/// not give way to bodies that hold it back in this way.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "instrument_deflection", record = RecordPolicy::sampled(30.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentDeflection {
    /// The bodies that displace it, and by how much.
    pub by: Vec<(Entity, Displacement)>,
    /// Bound of the force of the coupling between it and its hand \[N\].
    pub force_max: f64,
}

impl InstrumentDeflection {
    /// By how much a body displaces it.
    #[must_use]
    pub fn of(&self, body: Entity) -> Displacement {
        self.by.iter().find(|(by, _)| *by == body).map(|(_, of)| *of).unwrap_or_default()
    }

    /// Its displacement by all of them.
    #[must_use]
    pub fn total(&self) -> Displacement {
        self.by.iter().fold(Displacement::default(), |sum, (_, of)| Displacement {
            offset: sum.offset + of.offset,
            velocity: sum.velocity + of.velocity,
        })
    }
}
