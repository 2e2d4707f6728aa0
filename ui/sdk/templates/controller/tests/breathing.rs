//! The behaviour in lock-step: virtual time on one thread, bit-identical every time, faster than real time.

use std::path::Path;

use template_controller::{Respiration, app};
use trocar::prelude::*;

const SCENARIO: &str = include_str!("../scenario.toml");
/// The scenario's parameters: a breath takes 4 s, and lifts the liver by 12 mm, a tenth more or less.
const BREATH_SECS: f64 = 4.0;
const REST: f64 = 0.05;
const EXCURSION: f64 = 0.012;
const VARIATION: f64 = 0.1;

/// The height of the liver every 10 ms, and the scene at the end.
fn heights(app: &App, seconds: f64, faults: Option<FaultPlan>) -> (Vec<f64>, std::sync::Arc<Snapshot>) {
    let scenario = app.scenario_from(Path::new("scenario.toml"), SCENARIO).expect("a sound scenario");
    let options = RunOptions { lockstep: true, seed: 5, faults, ..RunOptions::default() };
    let mut session = start(app, &scenario, &options).expect("it starts");
    let liver = scenario.entity("liver").expect("the scenario has one");
    let mut heights = Vec::new();
    for step in 1..=(seconds * 100.0) as u64 {
        session.run_until(SimTime::from_millis(10 * step));
        heights.push(session.snapshot().get::<Pose>(liver).expect("a pose").translation.z);
    }
    let scene = session.snapshot();
    let finished = session.finish();
    assert_eq!(finished.outcome.controllers[0].rejected, 0, "the Model refused nothing");
    (heights, scene)
}

fn respiration(scene: &Snapshot) -> Respiration {
    scene.iter::<Respiration>().next().expect("the controller's own entity has it").1.clone()
}

#[test]
fn organs_rise_and_sink_with_every_breath() {
    let (heights, scene) = heights(&app(), 5.0 * BREATH_SECS + 0.1, None);
    assert_eq!(respiration(&scene).breaths, 5);
    for breath in heights.chunks_exact((BREATH_SECS * 100.0) as usize) {
        let top = breath.iter().fold(f64::MIN, |top, height| top.max(*height)) - REST;
        assert!((top / EXCURSION - 1.0).abs() < VARIATION + 0.01, "{top}");
        let bottom = breath.iter().fold(f64::MAX, |bottom, height| bottom.min(*height)) - REST;
        assert!(bottom.abs() < 1e-6, "{bottom}");
    }
}

/// The test that every controller should have: kill it in the middle of its work. The ticks between the kill and the
/// restart are missing; otherwise the result is the same.
#[test]
fn a_kill_in_mid_breath_costs_ticks_and_changes_nothing_else() {
    let (mut whole, _) = heights(&app(), 10.0, None);
    let plan = FaultPlan::new(1).at(secs(1.234)).kill("breathing").at(secs(5.678)).kill("breathing");
    let (mut killed, scene) = heights(&app(), 10.0, Some(plan));
    // While the controller is dead nothing moves: without repeats, only the ticks that ran are left.
    whole.dedup();
    killed.dedup();
    assert!(whole.starts_with(&killed), "it went on from somewhere else");
    assert!(whole.len() - killed.len() <= 10, "{} ticks are missing", whole.len() - killed.len());
    assert_eq!(respiration(&scene).breaths, 2);
}

/// Requests a breath hold, once.
#[derive(Default)]
struct Anaesthetist;
impl Controller for Anaesthetist {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if tick.number == 10 {
            out.event("hold_breath", tick.me, None, 3.0);
        }
        Ok(())
    }
}

#[test]
fn the_breath_is_held_while_it_is_asked_for() {
    let app = app().controller::<Anaesthetist>("anaesthetist").joins("anaesthetist", 10.0);
    let (heights, _) = heights(&app, 5.0, None);
    // Requested at 1.0 s, and held for 3 s.
    let held = &heights[105..395];
    assert!(held.iter().all(|height| *height == held[0]), "it moves while it is held");
    assert!(heights[95] != heights[100] && heights[405] != heights[410], "it moves before and after");
}

#[test]
fn a_slip_of_the_pen_is_named_with_its_line() {
    let text = SCENARIO.replace("breaths_per_minute", "breaths_per_minte");
    let app = app();
    let scenario = app.scenario_from(Path::new("scenario.toml"), &text).expect("a sound scenario so far");
    let error = start(&app, &scenario, &RunOptions { lockstep: true, ..RunOptions::default() });
    let error = error.err().expect("refused").to_string();
    assert!(error.contains("scenario.toml:") && error.contains("breaths_per_minte"), "{error}");
}
