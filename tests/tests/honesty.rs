//! Negative controls that must fail: no friction, one jaw, a trainee that cheats.

use std::sync::Arc;

use trocar::app::Blueprint;
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Entity, EntitySet, HandTarget, Pose,
    Snapshot, Tick,
};
use trocar_tests::{app, finish, lockstep, peg_transfer};

/// Highest ring centre at the end, above the boards \[m\].
fn highest_ring(scene: &Snapshot) -> f64 {
    let rings = (1..=6).filter_map(|i| scene.find(&format!("ring.{i}")));
    rings.map(|ring| scene.world_pose(ring).translation.z).fold(f64::NEG_INFINITY, f64::max)
}

fn fails_with(replacements: &[(&str, &str)]) {
    let app = app();
    let mut options = lockstep(5);
    options.seconds = Some(40.0);
    let outcome = finish(&app, &peg_transfer(&app, replacements), &options);
    assert!(!outcome.summary.task.completed);
    assert_eq!(
        outcome.kernel.snapshot.iter::<trocar_scene::TaskState>().next().map(|(_, task)| task.done),
        Some(0)
    );
    assert!(highest_ring(&outcome.kernel.snapshot) < 0.02, "a ring is up in the air");
}

#[test]
fn without_friction_of_the_jaws_no_ring_is_carried() {
    fails_with(&[("jaw_friction = 0.6", "jaw_friction = 0.0")]);
}

#[test]
fn with_one_jaw_no_ring_is_carried() {
    fails_with(&[("jaws = 2\n", "jaws = 1\n")]);
}

/// Declares that it moves hands, and moves a ring.
struct Cheat {
    hand: Entity,
    ring: Entity,
    declares_it: bool,
}

impl Controller for Cheat {
    fn access(&self) -> Access {
        let access = Access::new().writes::<HandTarget>(EntitySet::Of(vec![self.hand]));
        if self.declares_it { access.writes::<Pose>(EntitySet::Of(vec![self.ring])) } else { access }
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        out.put(self.ring, Pose::at(0.0, 0.0, 0.5));
        Ok(())
    }
}

fn app_with_cheat(declares_it: bool) -> trocar::app::App {
    let kind = move |_: &trocar::app::KindContext<'_>| {
        Ok(Blueprint {
            class: RuntimeClass::Task,
            factory: Arc::new(move |context: &BuildContext<'_>| {
                let find = |name: &str| {
                    context.scene.find(name).ok_or_else(|| ControllerError::Scene(format!("no {name}")))
                };
                let cheat = Cheat { hand: find("hand.left")?, ring: find("ring.1")?, declares_it };
                Ok(Box::new(cheat) as Box<dyn Controller>)
            }),
            fences: Vec::new(),
            for_hands: None,
            arrange: None,
        })
    };
    trocar::app::App::new().kind("cheat", Arc::new(kind))
}

#[test]
fn a_trainee_that_writes_a_rings_pose_is_rejected_by_the_model() {
    let app = app_with_cheat(false);
    let scenario = peg_transfer(
        &app,
        &[("kind = \"autopilot\"", "kind = \"cheat\""), ("params = { skill = \"expert\" }\n", "")],
    );
    let mut options = lockstep(1);
    options.seconds = Some(1.0);
    let outcome = finish(&app, &scenario, &options);
    let row = outcome.reports.iter().find(|row| row.name == "autopilot").expect("its row");
    assert_eq!(row.rejected, row.scheduled, "every batch is refused");
    // The run says so with names, and does not end as if all were well, though it was cut off.
    let error = outcome.summary.error.clone().expect("it says so");
    let says = ["autopilot: all of its", "'pose' of 'ring.1'", "Access::writes"];
    assert!(says.iter().all(|part| error.contains(part)), "{error}");
    assert!(outcome.summary.task.cut_off && outcome.exit() == trocar::summary::Exit::Failed);
    assert!(highest_ring(&outcome.kernel.snapshot) < 0.005, "and no ring has moved");
}

#[test]
fn a_trainee_that_declares_a_rings_pose_for_itself_is_refused_at_the_start() {
    let app = app_with_cheat(true);
    let scenario = peg_transfer(
        &app,
        &[("kind = \"autopilot\"", "kind = \"cheat\""), ("params = { skill = \"expert\" }\n", "")],
    );
    let mut options = lockstep(1);
    options.seconds = Some(1.0);
    match trocar::run::run(&app, &scenario, &options, &mut |_| {}) {
        Err(error) => assert!(error.to_string().contains("pose"), "{error}"),
        // A kernel that checks the declaration never lets it act.
        Ok(outcome) => {
            let row = outcome.reports.iter().find(|row| row.name == "autopilot").expect("its row");
            assert_eq!(row.scheduled, 0, "it never ticked: {row:?}");
            assert!(highest_ring(&outcome.kernel.snapshot) < 0.005);
        }
    }
}
