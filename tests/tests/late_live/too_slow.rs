//! A session that did not keep up says so, with the actors that were too slow; its score is marked as disturbed.

use std::time::Duration;

use trocar::app::App;
use trocar::prelude::*;
use trocar::summary::RunSummary;
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::runtime::sched;
use trocar_scene::ControllerError;
use trocar_scene::scenario::Scenario;
use trocar_test_support::alone;
use trocar_tests::load::under_load;
use trocar_tests::{finish, lockstep};

/// Rate of the sleeper \[Hz\].
const RATE: f64 = 100.0;

/// A controller that sleeps really.
struct Sleeper(Duration);

impl Controller for Sleeper {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        std::thread::sleep(self.0);
        Ok(())
    }
}

/// The wall, pressed by nobody, with a controller beside it whose steps take `millis`.
fn with_sleeper(millis: u64) -> (App, Scenario) {
    let app =
        App::new().controller_with("sleeper", move |(): &(), _| Ok(Sleeper(Duration::from_millis(millis))));
    let (_, text) = trocar::app::SCENARIOS.iter().find(|(name, _)| *name == "wall").expect("it is shipped");
    let text = format!("{text}\n[[controller]]\nname = \"sleeper\"\nkind = \"sleeper\"\nrate_hz = {RATE}\n");
    let scenario = Scenario::parse("wall.toml".as_ref(), &text, app.registry()).expect("a valid scenario");
    (app, scenario)
}

/// A controller whose steps take CPU time, of its own thread.
struct Worker(SimTime);

impl Controller for Worker {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        let used = || sched::thread_cpu(sched::current_tid()).unwrap_or_default();
        let begun = used();
        let mut x = 0_u64;
        while used().since(begun) < self.0 {
            (0..1_000).for_each(|_| x = std::hint::black_box(x.wrapping_mul(31).wrapping_add(1)));
        }
        Ok(())
    }
}

fn share_of(summary: &RunSummary, name: &str) -> Option<f64> {
    summary.slow_actors.iter().find(|actor| actor.name == name).map(|actor| actor.share)
}

/// In virtual time no tick is lost to a slow machine.
#[test]
fn lock_step_is_never_disturbed_by_slowness() {
    let _alone = alone();
    let (app, scenario) = with_sleeper(12);
    let options = RunOptions { seconds: Some(0.6), ..lockstep(1) };
    let summary = finish(&app, &scenario, &options).summary;
    assert_eq!(
        (&summary.slow_actors[..], summary.task.disturbed, summary.too_slow()),
        (&[][..], false, None)
    );
}

/// A fault file slows an actor down in virtual time as well.
#[test]
fn a_fault_that_slows_an_actor_down_disturbs_the_exercise_and_names_the_actor() {
    let _alone = alone();
    let plan = |step: f64| {
        let text = format!(
            "schema = 1\n[[fault]]\nid = \"tired\"\nat_secs = 0.5\nfor_secs = 2.0\ntarget = \"sleeper\"\n\
             kind = \"slow\"\nstep_secs = {step}\n"
        );
        FaultPlan::parse(&text, "tired.toml").expect("a valid plan")
    };
    let (app, scenario) = with_sleeper(0);
    let run = |step| {
        let options = RunOptions { seconds: Some(4.0), faults: Some(plan(step)), ..lockstep(1) };
        finish(&app, &scenario, &options).summary
    };
    // Each step takes five periods: every fifth or sixth tick runs in two of the four seconds.
    let summary = run(0.05);
    let [slow] = &summary.slow_actors[..] else { panic!("{:?}", summary.slow_actors) };
    assert!(slow.name == "sleeper" && (0.15..0.25).contains(&slow.worst_share), "{slow:?}");
    assert!((0.55..0.65).contains(&slow.share), "{slow:?}");
    assert!((slow.worst_at_secs - 0.5).abs() < 0.3, "{slow:?}");
    assert!(summary.task.disturbed);
    let told = summary.too_slow().expect("it says so");
    assert!(told.contains("sleeper ran at") && !told.contains("engine"), "{told}");
    // A step that takes half of its period is on time.
    assert!(!run(0.005).task.disturbed);
}

#[test]
fn a_live_session_with_an_actor_that_sleeps_says_that_the_machine_was_too_slow() {
    let _alone = alone();
    // Each step takes three of its periods.
    let (app, scenario) = with_sleeper(30);
    let options = RunOptions { seconds: Some(3.0), ..RunOptions::default() };
    let summary = finish(&app, &scenario, &options).summary;
    let share = share_of(&summary, "sleeper").expect("it is told");
    assert!((0.1..0.4).contains(&share), "{share}");
    assert!(summary.task.disturbed);
    let told = summary.too_slow().expect("it says so");
    assert!(told.starts_with("the machine was too slow: ") && told.contains("sleeper ran at"), "{told}");
    let json = serde_json::to_value(&summary).expect("JSON");
    assert_eq!(json["task"]["disturbed"], true);
    assert!(json["slow_actors"].as_array().is_some_and(|list| list.iter().any(|of| of["name"] == "sleeper")));
}

/// A step of 30 ms of CPU time takes longer than the limit of a stall, 50 ms, beside other programs. A replacement would
/// begin it anew and be late again.
#[test]
fn who_is_late_beside_other_programs_is_not_taken_for_stalled() {
    let _alone = alone();
    let app = App::new()
        .controller_with("worker", |(): &(), _: &BuildContext<'_>| Ok(Worker(SimTime::from_millis(30))));
    let (_, text) = trocar::app::SCENARIOS.iter().find(|(name, _)| *name == "wall").expect("it is shipped");
    let text = format!("{text}\n[[controller]]\nname = \"worker\"\nkind = \"worker\"\nrate_hz = 500\n");
    let scenario = Scenario::parse("wall.toml".as_ref(), &text, app.registry()).expect("a valid scenario");
    let options = RunOptions { seconds: Some(2.0), ..RunOptions::default() };
    let outcome = under_load(|| finish(&app, &scenario, &options));
    let row = outcome.summary.controllers.iter().find(|row| row.name == "worker").expect("its row");
    assert_eq!(row.restarts, 0, "{:?}", outcome.kernel.incidents);
    assert!(share_of(&outcome.summary, "worker").is_some_and(|share| share < 0.1), "{row:?}");
    assert_eq!(outcome.kernel.model.restarts, 0, "{:?}", outcome.kernel.incidents);
}
