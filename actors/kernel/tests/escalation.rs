//! Who fails for good ends the session, who fails now and then does not.

use crate::support::rig::{Rig, ms};
use trocar_kernel::supervision::{
    Backoff, Cause, ChildId, ChildSpec, EXIT_GAVE_UP, Event, GroupSpec, RuntimeClass, Strategy, Supervisor,
    TreeError,
};
use trocar_scene::SimTime;

fn spec(id: &str) -> ChildSpec {
    ChildSpec::new(id, RuntimeClass::Haptics, 1000.0)
}

/// A child of each default group, beside a Model that never fails.
fn default_tree(class: RuntimeClass) -> (GroupSpec, ChildId) {
    let child = ChildSpec::new("child", class, 100.0);
    if class == RuntimeClass::Model {
        return (GroupSpec::default_tree([child]), ChildId(0));
    }
    let model = ChildSpec::new("model", RuntimeClass::Model, 0.0);
    (GroupSpec::default_tree([model, child]), ChildId(1))
}

const CLASSES: [RuntimeClass; 9] = [
    RuntimeClass::Driver,
    RuntimeClass::Watchdog,
    RuntimeClass::Model,
    RuntimeClass::Haptics,
    RuntimeClass::Collision,
    RuntimeClass::Simulation,
    RuntimeClass::Task,
    RuntimeClass::Network,
    RuntimeClass::Recorder,
];

/// Fails whenever it is up, `after` its start, until `until`, or until it is held or the tree gives up.
fn keeps_failing(rig: &mut Rig, child: ChildId, after: SimTime, until: SimTime) {
    while rig.now < until && !is_over(rig) {
        let incarnation = rig.tree.incarnation(child);
        let cause = Cause::Panic("boom".to_owned());
        rig.at_time(rig.now + after, Event::Died { child, incarnation, cause });
        while !is_over(rig) && rig.tree.incarnation(child) == incarnation {
            let due = rig.tree.next_deadline(rig.now).expect("a pause before the restart");
            rig.at_time(due, Event::Tick);
        }
    }
}

fn is_over(rig: &Rig) -> bool {
    rig.tree.exit_code().is_some() || !rig.tree.given_up().is_empty()
}

/// Without a Model there is no session; everybody else is held.
fn assert_over(rig: &Rig, class: RuntimeClass, when: &str) {
    if class == RuntimeClass::Model {
        assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP), "{class:?} {when}");
    } else {
        let held: Vec<String> = rig.tree.given_up().into_iter().map(|(name, _)| name).collect();
        assert_eq!((held, rig.tree.exit_code()), (vec!["child".to_owned()], None), "{class:?} {when}");
    }
}

#[test]
fn a_child_that_always_fails_escalates_under_every_default_group() {
    for class in CLASSES {
        let (limit, slow) = match class {
            RuntimeClass::Model => (ms(60_000), ms(3_000)),
            RuntimeClass::Network | RuntimeClass::Recorder => (ms(40_000), ms(15_000)),
            _ => (ms(8_000), ms(3_000)),
        };
        let (root, child) = default_tree(class);
        let mut rig = Rig::new(root);
        keeps_failing(&mut rig, child, SimTime::ZERO, limit);
        assert_over(&rig, class, "from its first failure on");

        // Slow failures have driven the pauses to their longest, so slowly that nothing escalated: when it then
        // fails at once, it still does not go on for ever.
        let (root, child) = default_tree(class);
        let mut rig = Rig::new(root);
        keeps_failing(&mut rig, child, slow, ms(600_000));
        assert!(!is_over(&rig), "{class:?} fails too rarely to escalate");
        let until = rig.now + limit;
        keeps_failing(&mut rig, child, SimTime::ZERO, until);
        assert_over(&rig, class, "after long pauses");
    }
}

#[test]
fn a_child_that_fails_once_a_minute_is_restarted_for_ever() {
    for class in CLASSES {
        let (root, child) = default_tree(class);
        let mut rig = Rig::new(root);
        keeps_failing(&mut rig, child, ms(60_000), ms(24 * 3_600_000));
        assert!(!is_over(&rig), "{class:?}");
        assert!(rig.tree.restarts(child) > 24 * 55, "{class:?}: {}", rig.tree.restarts(child));
    }
}

#[test]
fn a_tree_that_would_never_give_up_is_refused_by_name() {
    let patient = Backoff { max: ms(10_000), factor: 10.0, ..Backoff::default() };
    let flat = GroupSpec::new("root", Strategy::OneForOne).with_backoff(patient).child(spec("a"));
    let error = Supervisor::new(flat.clone(), 0, 1).err().expect("5 restarts take 12 s");
    assert!(
        matches!(&error, TreeError::NeverGivesUp { group, restarts: 5, .. } if group == "root"),
        "{error}"
    );
    assert!(error.to_string().contains("period"), "{error}");
    assert!(Supervisor::new(flat.with_intensity(5, ms(30_000)), 0, 1).is_ok());

    // Each group for itself is fine, but the root never counts six groups that gave up in its 10 s.
    let inner = || GroupSpec::new("hands", Strategy::OneForOne).child(spec("a"));
    let nested = GroupSpec::new("root", Strategy::OneForOne).group(inner());
    let error = Supervisor::new(nested.clone(), 0, 1).err().expect("never");
    assert!(matches!(&error, TreeError::NeverGivesUp { group, .. } if group == "root"), "{error}");
    let mut rig = Rig::new(nested.with_intensity(5, ms(300_000)));
    keeps_failing(&mut rig, ChildId(0), SimTime::ZERO, ms(300_000));
    assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP));
}
