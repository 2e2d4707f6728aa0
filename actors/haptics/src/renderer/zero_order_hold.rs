//! Zero-order hold of the simulation's force between its steps: the extended-MVC paper's method.
//!
//! A zero-order hold delays the wall by half a period of the *physics*, so its stiffness is bounded by `K ≲ 2b/T`
//! (Colgate & Schenkel 1997): 50 ms of hold leave about 21 N/m. Accurate only at the haptic rate.

use super::{ForceRenderer, RenderInput, freshness};
use crate::spatial::Wrench;

/// Age after which a force of this station's simulation fades \[s\]: one at 10 Hz may miss a step. A force from another
/// station fades after [`REMOTE_FADE_SECS`](super::REMOTE_FADE_SECS).
const FADE_SECS: f64 = 0.25;

/// Renders [`InstrumentForce`](trocar_scene::InstrumentForce) as it stands.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ZeroOrderHold;

impl ForceRenderer for ZeroOrderHold {
    fn render(&mut self, input: &RenderInput<'_>) -> Wrench {
        let Some(held) = input.instrument_force else { return Wrench::ZERO };
        let fresh = freshness(input.now.since(held.at).as_secs_f64(), input.fade_secs(FADE_SECS));
        Wrench::new(held.force, held.torque) * fresh
    }
    fn reset(&mut self) {}
    fn name(&self) -> &'static str {
        "held"
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::input_at;
    use super::*;
    use nalgebra::Vector3;
    use trocar_scene::{InstrumentForce, SimTime};

    #[test]
    fn the_force_is_held_and_fades_when_nobody_renews_it() {
        let force = InstrumentForce { force: Vector3::z(), ..InstrumentForce::default() };
        let at = |millis| {
            let mut input = input_at(Vector3::zeros());
            input.now = SimTime::from_millis(millis);
            input.instrument_force = Some(&force);
            ZeroOrderHold.render(&input).force.z
        };
        assert_eq!((at(0), at(250)), (1.0, 1.0));
        assert!((at(375) - 0.5).abs() < 1e-12);
        assert_eq!(at(500), 0.0);
        assert_eq!(ZeroOrderHold.render(&input_at(Vector3::zeros())), Wrench::ZERO);
    }

    #[test]
    fn a_force_from_another_station_is_full_until_50_ms_and_zero_from_100_ms() {
        let force =
            InstrumentForce { force: Vector3::z(), torque: Vector3::x(), ..InstrumentForce::default() };
        let at = |millis| {
            let mut input = input_at(Vector3::zeros());
            input.now = SimTime::from_millis(millis);
            input.instrument_force = Some(&force);
            input.remote = true;
            let wrench = ZeroOrderHold.render(&input);
            assert_eq!(wrench.force.z, wrench.torque.x);
            wrench.force.z
        };
        assert_eq!((at(0), at(50), at(100)), (1.0, 1.0, 0.0));
        assert!((at(75) - 0.5).abs() < 1e-12);
    }
}
