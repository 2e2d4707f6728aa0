//! The controller that changes the components: without it they would be constants.

use trocar::prelude::*;

use crate::{Bleeding, BloodPool};

/// Thickness of a pool \[m\].
const FILM: f64 = 0.001;
/// Largest blood loss \[m³\]: the component's own limit.
const LOST_MAX: f64 = 0.01;

/// Lets every vessel bleed. It has no state of its own: all data is in the components.
#[derive(Default)]
pub struct Bleeder;

impl Controller for Bleeder {
    fn access(&self) -> Access {
        Access::new().writes::<Bleeding>(EntitySet::All).writes::<BloodPool>(EntitySet::All)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        for (vessel, bleeding) in scene.iter::<Bleeding>() {
            let flow = bleeding.flow * (1.0 - bleeding.sealed);
            // An unchanged row is better not written: then it costs nothing.
            if flow == 0.0 && scene.get::<BloodPool>(vessel).is_some() {
                continue;
            }
            let lost = (bleeding.lost + flow * tick.period.as_secs_f64()).min(LOST_MAX);
            out.put(vessel, Bleeding { lost, ..*bleeding });
            out.put(vessel, BloodPool { radius: (lost / (std::f64::consts::PI * FILM)).sqrt() });
        }
        Ok(())
    }
}
