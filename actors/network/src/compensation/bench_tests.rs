//! What the compensation does on the bench: the bars of test 14, and what they are worth.

use nalgebra::Vector3;
use trocar_scene::SimTime;
use trocar_test_support::thorough;

use super::teleoperation_testing::{
    ARMS, Coupling, LOSSES, Loss, MATTERS, Matter, Outcome, ROUND_TRIPS_MS, Setup, session,
};
use super::*;

const METHODS: [Compensation; 3] =
    [Compensation::Passivity, Compensation::WaveVariables, Compensation::ModelMediated];

/// Least energy that an operator's port may show \[J\].
const ENERGY_BAR: f64 = -1e-3;
/// Deepest debt of a tank \[J\]: what the prediction of a step may miss.
const TANK_BAR: f64 = -1e-5;

fn direct(matter: Matter) -> Outcome {
    session(&Setup::new(Coupling::Direct, 0, LOSSES[0], matter))
}

/// Whether the hand swings no more late than early in a long press, but for a tenth of a millimetre, and is quiet at the
/// end; a tremor alone has 5.7 mm/s.
fn is_calm(outcome: &Outcome) -> bool {
    outcome.swing[1] <= outcome.swing[0].max(1e-4) + 1e-4 && outcome.speed_end < 0.012
}

/// Checks the bars of one matter at all delays and these losses; a thorough run takes all losses.
fn check_bars(matter: Matter, losses: &[Loss]) {
    let losses = if thorough() { &LOSSES } else { losses };
    let reference = direct(matter);
    for method in METHODS {
        for ms in ROUND_TRIPS_MS {
            for &loss in losses {
                let outcome = session(&Setup::new(Coupling::Compensated(method), ms, loss, matter));
                let at = format!("{} {method:?} {ms} ms {}: {outcome:?}", matter.name, loss.name);
                if thorough() {
                    // The table of the documentation.
                    let [first, felt] = [outcome.first / reference.first, outcome.felt / reference.felt];
                    println!("{first:.2} {felt:.2} {at}");
                }
                assert!(outcome.energy_min >= ENERGY_BAR, "{at}");
                assert!(outcome.tank_min >= TANK_BAR, "{at}");
                assert!(is_calm(&outcome), "{at}");
                assert!(outcome.apart < 5e-4, "they meet again in the free: {at}");
                let [first, felt] = [outcome.first / reference.first, outcome.felt / reference.felt];
                let bar = if ms <= 100 { 0.5 } else { 0.02 };
                assert!(first > bar && felt > bar, "{first} {felt} {at}");
                // A model is as stiff as what it is a model of.
                let mediated = method == Compensation::ModelMediated;
                assert!(!mediated || (felt - 1.0).abs() < 0.05, "{felt} {at}");
            }
        }
    }
}

#[test]
fn the_liver_is_felt_over_every_delay_and_loss_and_nothing_grows() {
    check_bars(MATTERS[1], &LOSSES);
}

#[test]
fn a_wall_of_500_is_felt_over_every_delay_also_in_bursts_and_nothing_grows() {
    check_bars(MATTERS[2], &[LOSSES[0], LOSSES[3]]);
}

#[test]
fn a_wall_of_2000_is_felt_over_every_delay_also_with_loss_and_nothing_grows() {
    check_bars(MATTERS[3], &[LOSSES[2], LOSSES[3]]);
}

#[test]
fn without_compensation_the_same_bench_gives_energy_away() {
    for ms in [50, 100, 300] {
        let outcome = session(&Setup::new(Coupling::Uncompensated, ms, LOSSES[0], MATTERS[3]));
        assert!(outcome.energy_min < 10.0 * ENERGY_BAR, "{ms} ms: {outcome:?}");
        assert!(outcome.swing[1] > 1e-3, "{ms} ms: {outcome:?}");
    }
}

// The damper that fills the tanks takes tens of millijoules in the free, before which a bar at -1 mJ is easy to keep. Here
// nothing but the way to the wall precedes the contact.
#[test]
fn a_hand_that_touches_at_once_gets_no_energy_either() {
    for method in METHODS {
        for ms in [50, 300, 1_000] {
            let setup = Setup::new(Coupling::Compensated(method), ms, LOSSES[1], MATTERS[3]);
            let outcome = session(&Setup { begin_secs: 5.95, ..setup });
            assert!(outcome.energy_min >= ENERGY_BAR && is_calm(&outcome), "{method:?} {ms}: {outcome:?}");
            assert!(outcome.first > 0.0, "{method:?} {ms}: {outcome:?}");
        }
    }
}

#[test]
fn a_loose_and_a_stiff_arm_get_no_energy_and_do_not_swing_more_and_more() {
    for arm in [ARMS[1], ARMS[2]] {
        for method in METHODS {
            for ms in [100, 1_000] {
                for loss in [LOSSES[1], LOSSES[3]] {
                    let setup = Setup::new(Coupling::Compensated(method), ms, loss, MATTERS[2]);
                    let outcome = session(&Setup { arm, ..setup });
                    let at = format!("{arm:?} {method:?} {ms} ms {}: {outcome:?}", loss.name);
                    assert!(outcome.energy_min >= ENERGY_BAR && is_calm(&outcome), "{at}");
                    assert!(outcome.felt > 0.0 && outcome.tank_min >= TANK_BAR, "{at}");
                }
            }
        }
    }
}

#[test]
fn an_oblique_plane_is_felt_as_stiff_and_does_not_hold_the_tool() {
    let normal = Vector3::new(1.0, 2.0, -0.5).normalize();
    for matter in [MATTERS[1], MATTERS[3]] {
        let oblique = |coupling| session(&Setup { normal, ..Setup::new(coupling, 100, LOSSES[1], matter) });
        let reference = oblique(Coupling::Direct);
        for method in METHODS {
            let outcome = oblique(Coupling::Compensated(method));
            let at = format!("{} {method:?}: {outcome:?} of {reference:?}", matter.name);
            assert!(outcome.felt > 0.5 * reference.felt && outcome.felt < 1.1 * reference.felt, "{at}");
            assert!(outcome.energy_min >= ENERGY_BAR && is_calm(&outcome), "{at}");
        }
    }
}

#[test]
fn the_change_of_method_under_a_pressing_hand_is_not_felt_as_a_blow() {
    // The measured round trip crosses both limits during the long press.
    let measured = |secs: f64| {
        SimTime::from_millis(match secs {
            ..36.0 => 290,
            36.0..44.0 => 320,
            _ => 240,
        })
    };
    for matter in [MATTERS[1], MATTERS[2]] {
        let setup = Setup::new(Coupling::Compensated(Compensation::Automatic), 280, LOSSES[0], matter);
        let outcome = session(&Setup { measured: Some(measured), ..setup });
        assert_eq!(outcome.method, (Method::Passivity, 2), "{outcome:?}");
        assert!(outcome.jump < 0.1 && outcome.energy_min >= ENERGY_BAR, "{outcome:?}");
        assert!(outcome.felt > 0.5 * direct(matter).felt, "{outcome:?}");
    }
}

#[test]
fn the_same_session_has_the_same_bits() {
    let setup = Setup::new(Coupling::Compensated(Compensation::Automatic), 300, LOSSES[3], MATTERS[1]);
    assert_eq!(session(&setup), session(&setup));
}
