//! The sampled virtual wall with a zero-order hold: critical stiffness against the reference table.
//!
//! m = 0.1 kg, b = 0.5 N·s/m, T = 1 ms, no human: 1000.83 N/m; 1398.38 N/m with 0.2 N·s/m of virtual damping;
//! 48.03 N/m with ten samples of delay. Stable at 0.98 of it, growing at 1.02. The spring is the virtual
//! coupling to an instrument at rest.

use std::collections::VecDeque;

use nalgebra::{Isometry3, Vector3};
use trocar_haptics::renderer::{
    ForceRenderer, RenderInput, SimulatedInstrument, VirtualCoupling, VirtualCouplingConfig,
};
use trocar_haptics::spatial::Twist;
use trocar_scene::SimTime;

const MASS: f64 = 0.1;
const VISCOUS: f64 = 0.5;
const PERIOD: f64 = 1e-3;

/// Growth of the envelope from the first to the last quarter of 60,000 samples.
fn growth(stiffness: f64, damping: f64, delay: usize) -> f64 {
    let mut coupling = VirtualCoupling::new(VirtualCouplingConfig {
        stiffness,
        damping,
        angular_stiffness: 0.0,
        angular_damping: 0.0,
        horizon_secs: 0.0,
    });
    // Exact motion of a damped mass under a force that is held for a period.
    let decay = (-VISCOUS / MASS * PERIOD).exp();
    let glide = (1.0 - decay) * MASS / VISCOUS;
    let (mut x, mut v) = (1e-3f64, 0.0f64);
    let mut in_flight: VecDeque<f64> = std::iter::repeat_n(0.0, delay).collect();
    let samples = 60_000;
    let (mut early, mut late) = (0.0f64, 0.0f64);
    for sample in 0..samples {
        let now = SimTime::from_millis(sample);
        let input = RenderInput {
            now,
            dt: PERIOD,
            tip_in_world: Isometry3::translation(x, 0.0, 0.0),
            tip_twist: Twist::new(Vector3::new(v, 0.0, 0.0), Vector3::zeros()),
            stiffness_max: f64::INFINITY,
            damping_max: f64::INFINITY,
            apparent_mass: MASS,
            energy_available: f64::INFINITY,
            instrument: Some(SimulatedInstrument {
                tip_in_world: Isometry3::identity(),
                twist: Twist::ZERO,
                at: now,
            }),
            instrument_force: None,
            contact_model: None,
            remote: false,
        };
        in_flight.push_back(coupling.render(&input).force.x);
        let force = in_flight.pop_front().unwrap();
        let terminal = force / VISCOUS;
        x += terminal * PERIOD + (v - terminal) * glide;
        v = terminal + (v - terminal) * decay;
        if !x.is_finite() || x.abs() > 1e6 {
            return f64::INFINITY;
        }
        if sample < samples / 4 {
            early = early.max(x.abs());
        } else if sample >= 3 * samples / 4 {
            late = late.max(x.abs());
        }
    }
    late / early
}

#[test]
fn critical_stiffness_of_the_reference_table() {
    for (damping, delay, critical) in [(0.0, 0, 1000.83), (0.2, 0, 1398.38), (0.0, 10, 48.03)] {
        let (below, above) =
            (growth(0.98 * critical, damping, delay), growth(1.02 * critical, damping, delay));
        assert!(below < 0.9, "B {damping}, {delay} samples: grows at 0.98 of {critical} N/m ({below})");
        assert!(above > 1.1, "B {damping}, {delay} samples: stable at 1.02 of {critical} N/m ({above})");
    }
}

#[test]
fn colgates_bound_is_on_the_safe_side() {
    // b > KT/2 + |B| allows 600 N/m with B = 0.2: sufficient for passivity, well inside of stability.
    assert!(growth(600.0, 0.2, 0) < 0.1);
}
