//! Scenes of soft matter, in lock-step: judged by what came of them, and with a control that fails.

use trocar::run::RunOutcome;
use trocar_tests::{app, edited, finish, lockstep};

fn run(name: &str, replacements: &[(&str, &str)]) -> RunOutcome {
    let app = app();
    finish(&app, &edited(&app, name, replacements), &lockstep(1))
}

/// What was measured at the end.
fn outcome(run: &RunOutcome, measure: &str) -> f64 {
    let values = &run.summary.task.metrics["outcome"];
    *values.get(measure).unwrap_or_else(|| panic!("no '{measure}': {values:?}"))
}

fn holds(name: &str) -> RunOutcome {
    let run = run(name, &[]);
    assert!(run.summary.task.completed, "{:?} {:?}", run.summary.task, run.summary.error);
    assert!(run.summary.controllers.iter().all(|row| row.rejected == 0 && row.restarts == 0), "{name}");
    run
}

#[test]
fn two_hands_cut_a_circle_out_of_a_gauze() {
    let cut = holds("cloth-cut");
    let area = outcome(&cut, "gauze.cut_area_m2");
    assert!((area / (std::f64::consts::PI * 0.02 * 0.02) - 1.0).abs() < 0.01, "{area} m²");
    // Open blades cut nothing.
    let open =
        run("cloth-cut", &[("{ seconds = 1.5, to = [0.055", "{ seconds = 1.5, jaws = 0.6, to = [0.055")]);
    assert!(!open.summary.task.completed);
    assert_eq!((outcome(&open, "gauze.pieces"), outcome(&open, "gauze.cut_area_m2")), (1.0, 0.0));
}

#[test]
fn a_hook_cuts_a_membrane_through_and_burns_a_crater() {
    holds("cautery");
    // A hook that is off burns nothing.
    let off = run("cautery", &[("power = 30.0", "power = 0.0")]);
    assert!(!off.summary.task.completed);
    assert_eq!(outcome(&off, "liver.removed_volume_m3"), 0.0);
    assert!((outcome(&off, "membrane.largest_piece_share") - 1.0).abs() < 1e-9);
}

#[test]
fn a_probe_presses_on_a_stomach_and_feels_it() {
    let pressed = holds("soft-stomach");
    assert!(pressed.summary.force_newtons_max > 0.1, "{} N", pressed.summary.force_newtons_max);
    // A stiffer one pushes back harder.
    let stiffer = run("soft-stomach", &[("young_modulus = 6000.0", "young_modulus = 18000.0")]);
    let force = |run: &RunOutcome| outcome(run, "stomach.contact_force_n.largest");
    assert!(force(&stiffer) > 1.5 * force(&pressed), "{} and {} N", force(&stiffer), force(&pressed));
}

#[test]
fn an_implicit_and_an_explicit_simulator_share_a_scene() {
    let both = holds("two-rates");
    let rate =
        |name: &str| both.summary.controllers.iter().find(|row| row.name == name).expect("it").achieved_hz;
    assert!((rate("organ") - 20.0).abs() < 0.2 && (rate("membrane") - 500.0).abs() < 1.0);
    // What the explicit one computes does not depend on how often the implicit one does.
    let other = run("two-rates", &[("rate_hz = 20\n", "rate_hz = 10\n")]);
    let force = |run: &RunOutcome| outcome(run, "membrane.contact_force_n.largest");
    assert_eq!(force(&both), force(&other));
}

#[test]
fn a_bleeding_artery_is_clamped_and_sealed_and_the_patient_minds_when_nobody_does() {
    let sealed = holds("bleeding");
    let lost = outcome(&sealed, "artery.lost_m3");
    assert!(
        (outcome(&sealed, "piglet.blood_lost_m3") / lost - 1.0).abs() < 1e-9,
        "what is lost is the patient's"
    );
    // A clamp that stays open lets it bleed, and what runs keeps the hole from being sealed.
    let open = run("bleeding", &[("{ seconds = 0.4, jaws = 0.0 }", "{ seconds = 0.4, jaws = 0.5 }")]);
    assert!(!open.summary.task.completed);
    assert!(
        outcome(&open, "artery.lost_m3") > 2.0 * lost,
        "{} of {lost} m³",
        outcome(&open, "artery.lost_m3")
    );
    assert!(outcome(&open, "artery.rate_m3_per_s") > 0.0);
    let pressure = |run: &RunOutcome| outcome(run, "piglet.arterial_pressure_pa.smallest");
    assert!(pressure(&open) < pressure(&sealed), "{} and {} Pa", pressure(&open), pressure(&sealed));
}

#[test]
fn a_probe_presses_on_a_liver_with_a_precomputed_inverse() {
    let pressed = holds("fem-liver");
    assert!(pressed.summary.force_newtons_max > 0.05, "{} N", pressed.summary.force_newtons_max);
    // Linear: three times as stiff answers with three times the force where the displacement is the same.
    let stiffer = run("fem-liver", &[("young_modulus = 6000.0", "young_modulus = 18000.0")]);
    let ratio = |measure: &str| outcome(&stiffer, measure) / outcome(&pressed, measure);
    let (force, moved) = (ratio("liver.contact_force_n.largest"), ratio("liver.displacement_max_m.largest"));
    assert!((force / moved / 3.0 - 1.0).abs() < 0.25 && force > 1.5, "{force} times, moved {moved} times");
}
