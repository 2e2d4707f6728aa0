//! Whoever is killed in the middle of the exercise, it is completed: every kind of actor once, the Model too.

use trocar::run::RunOptions;
use trocar_kernel::faults::{FaultPlan, secs};
use trocar_tests::{app, finish, lockstep, peg_transfer};

fn plan() -> FaultPlan {
    FaultPlan::new(7)
        .at(secs(6.0))
        .kill("haptics.left")
        .at(secs(13.0))
        .kill("engine")
        .at(secs(20.0))
        .kill("model")
        .at(secs(27.0))
        .kill("haptics.right")
        .at(secs(34.0))
        .kill("task")
        .at(secs(41.0))
        .kill("autopilot")
        .at(secs(48.0))
        .kill("device.left")
}

fn completes(options: RunOptions) {
    let app = app();
    let outcome = finish(&app, &peg_transfer(&app, &[]), &options);
    let summary = &outcome.summary;
    assert!(summary.task.completed, "{:?}\n{:?}", summary.task, summary.faults);
    for fault in &summary.faults {
        assert!(fault.injected_secs.is_some() && fault.resumed_secs.is_some(), "{fault:?}");
    }
    for name in ["haptics.left", "haptics.right", "engine", "task", "autopilot"] {
        let row = summary.controllers.iter().find(|row| row.name == name).expect("its row");
        assert!(row.restarts >= 1, "{name} was not restarted");
    }
    assert!(summary.force_newtons_max <= 3.3 + 1e-9, "{} N", summary.force_newtons_max);
}

#[test]
fn every_actor_is_killed_once_in_lockstep_and_the_exercise_completes() {
    completes(RunOptions { faults: Some(plan()), ..lockstep(3) });
}

#[test]
fn every_actor_is_killed_once_live_and_the_exercise_completes() {
    completes(RunOptions { faults: Some(plan()), seed: 3, ..RunOptions::default() });
}
