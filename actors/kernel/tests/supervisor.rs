//! What the supervisor tree does beyond Erlang/OTP, one test per promise: pauses between restarts, children that
//! are held, and what a shared address space adds (stalls, fences, zombies). `otp.rs` holds it against OTP itself.

use crate::support::rig::{A, B, C, Rig, ms, position, spec, stops, three};
use trocar_kernel::supervision::{
    Action, Backoff, Cause, ChildId, ChildSpec, EXIT_GAVE_UP, Event, GroupSpec, Health, RuntimeClass,
    Strategy, Supervisor, TreeError,
};
use trocar_scene::SimTime;

#[test]
fn a_child_that_fails_too_often_is_held_and_the_others_run_on() {
    let root = three(Strategy::RestForOne).with_intensity(2, ms(1_000)).holding();
    let mut rig = Rig::new(root);
    for at in [10, 20, 30] {
        rig.panics(at, B);
    }
    assert_eq!(
        (rig.health(A), rig.health(B), rig.health(C)),
        (Health::Healthy, Health::Held, Health::Healthy)
    );
    assert!(rig.tree.exit_code().is_none() && rig.tree.is_up());
    let given_up = rig.tree.given_up();
    assert_eq!(given_up[0].0, "b");
    assert!(given_up[0].1.contains("more than 2 restarts") && given_up[0].1.contains("boom"), "{given_up:?}");
    // Its siblings begin with a clean sheet, and it stays where it is when they fail.
    let lives = rig.lives();
    rig.panics(40, A);
    assert_eq!(rig.health(B), Health::Held);
    assert_eq!(rig.lives()[1], lives[1]);
    // Whoever holds it may let it go again.
    rig.at(50, Event::Held { child: B, held: false });
    assert_eq!(rig.health(B), Health::Healthy);
    assert!(rig.tree.given_up().is_empty());
    assert_eq!(rig.lives()[1], lives[1] + 1);
}

#[test]
fn the_default_tree_holds_everybody_but_the_model() {
    let classes = [
        RuntimeClass::Model,
        RuntimeClass::Haptics,
        RuntimeClass::Simulation,
        RuntimeClass::Task,
        RuntimeClass::Network,
        RuntimeClass::Recorder,
    ];
    for (index, class) in classes.into_iter().enumerate() {
        let children = classes.map(|class| ChildSpec::new(format!("{class:?}"), class, 100.0));
        let mut rig = Rig::new(GroupSpec::default_tree(children));
        let child = rig.tree.find(&format!("{class:?}")).expect("a child");
        let mut now = 0;
        for _ in 0..200 {
            // The pauses of the back-off, and a millisecond.
            now = rig.tree.next_deadline(ms(now)).map_or(now, |at| at.as_nanos() / 1_000_000) + 1;
            rig.at(now, Event::Tick);
            rig.panics(now, child);
        }
        let held = rig.health(child) == Health::Held;
        assert_eq!(held, index > 0, "{class:?}: {:?}", rig.health(child));
        assert_eq!(rig.tree.exit_code().is_some(), index == 0, "{class:?}");
    }
}

#[test]
fn the_first_restart_is_immediate_and_later_ones_back_off_up_to_a_limit() {
    let backoff = Backoff { base: ms(10), factor: 2.0, max: ms(30), jitter: 0.0, reset_after: ms(1_000) };
    let mut rig = Rig::new(three(Strategy::OneForOne).with_backoff(backoff).with_intensity(100, ms(100_000)));
    let mut now = 10;
    for pause in [0, 10, 20, 30, 30] {
        rig.panics(now, A);
        let life = rig.tree.incarnation(A);
        if pause > 0 {
            assert_eq!(rig.tree.next_deadline(ms(now)), Some(ms(now + pause)));
            assert_eq!(rig.health(A), Health::Restarting);
            rig.at(now + pause - 1, Event::Tick);
            assert_eq!(rig.tree.incarnation(A), life, "too early");
            rig.at(now + pause, Event::Tick);
            assert_eq!(rig.tree.incarnation(A), life + 1);
        } else {
            assert_eq!(rig.health(A), Health::Healthy);
        }
        now += pause;
    }
    // After a quiet time it starts from no pause again.
    rig.panics(now + 1_001, A);
    assert_eq!(rig.health(A), Health::Healthy);
}

#[test]
fn jitter_is_seeded_and_within_its_bounds() {
    let pauses = |seed: u64| -> Vec<u64> {
        let backoff =
            Backoff { base: ms(100), factor: 1.0, max: ms(100), jitter: 0.2, reset_after: ms(10_000) };
        let root = three(Strategy::OneForOne).with_backoff(backoff).with_intensity(100, ms(100_000));
        let mut tree = Supervisor::new(root, seed, 2).expect("a valid tree");
        let mut out = Vec::new();
        let mut now = SimTime::ZERO;
        let mut pauses = Vec::new();
        tree.apply(Event::Tick, now, &mut out);
        for life in 1..10 {
            tree.apply(Event::Started { child: A, incarnation: life }, now, &mut out);
            tree.apply(
                Event::Died { child: A, incarnation: life, cause: Cause::Error("x".to_owned()) },
                now,
                &mut out,
            );
            if life > 1 {
                let due = tree.next_deadline(now).expect("a pause");
                pauses.push(due.since(now).as_nanos());
                now = due;
                tree.apply(Event::Tick, now, &mut out);
            }
        }
        pauses
    };
    let first = pauses(1);
    assert_eq!(first, pauses(1));
    assert_ne!(first, pauses(2));
    assert!(first.iter().all(|p| (80_000_000..=120_000_000).contains(p)), "{first:?}");
    assert!(first.iter().any(|p| *p != first[0]));
}

#[test]
fn a_stall_is_fenced_first_then_abandoned_then_replaced_on_a_fresh_thread() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    rig.take();
    rig.stalls(100, B);
    let log = rig.take();
    assert_eq!(
        log,
        [
            Action::Fence { child: B, epoch: 2 },
            Action::Abandon { child: B, incarnation: 1 },
            Action::Start { child: B, incarnation: 2, fresh: true },
        ]
    );
    assert_eq!(rig.tree.zombies(), 1);
    assert_eq!(rig.lives(), [1, 2, 1]);
}

#[test]
fn a_panic_is_fenced_first_and_rebuilt_in_place() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    rig.take();
    rig.panics(100, B);
    assert_eq!(
        rig.take(),
        [Action::Fence { child: B, epoch: 2 }, Action::Start { child: B, incarnation: 2, fresh: false }]
    );
}

#[test]
fn too_many_zombies_escalate_to_the_process() {
    let mut rig = Rig::with(three(Strategy::OneForOne), 1, &[], &[]);
    rig.stalls(100, A);
    assert_eq!(rig.tree.exit_code(), None);
    rig.stalls(200, B);
    assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP));
    assert!(rig.tree.reason().is_some_and(|r| r.contains("abandoned")));
}

#[test]
fn a_zombie_that_ends_after_all_no_longer_counts() {
    let mut rig = Rig::with(three(Strategy::OneForOne), 1, &[], &[]);
    rig.stalls(100, A);
    rig.at(150, Event::ZombieEnded);
    rig.stalls(200, B);
    assert_eq!(rig.tree.exit_code(), None);
    assert_eq!(rig.tree.zombies(), 1);
}

#[test]
fn starting_has_a_limit_of_its_own() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    rig.slow_starters.push(A);
    rig.panics(10, A);
    assert_eq!(rig.health(A), Health::Restarting);
    rig.stalls(200, A);
    assert_eq!(rig.lives(), [2, 1, 1], "no heartbeat is asked for while it is built");
    rig.at(5_009, Event::Tick);
    assert_eq!(rig.lives(), [2, 1, 1]);
    rig.slow_starters.clear();
    rig.at(5_010, Event::Tick);
    assert_eq!(rig.lives(), [3, 1, 1]);
    assert_eq!(rig.tree.zombies(), 1);
    assert!(rig.tree.incidents().iter().any(|i| i.cause == Cause::StartTimeout));
}

#[test]
fn shutdown_zeroes_forces_first_and_ends_in_time_whatever_hangs() {
    let model = ChildSpec::new("model", RuntimeClass::Model, 0.0);
    let hands = GroupSpec::new("hands", Strategy::OneForOne).child(spec("b")).child(spec("c"));
    let root =
        GroupSpec::new("root", Strategy::RestForOne).with_intensity(5, ms(300_000)).child(model).group(hands);
    let mut rig = Rig::with(root, 2, &[A, B, C], &[]);
    rig.take();
    rig.at(1_000, Event::ShutdownRequested { code: 0 });
    let log = rig.take();
    assert_eq!(log[0], Action::ZeroForces);
    assert_eq!(stops(&log), [2, 1], "the controllers first, later ones before earlier ones");
    let mut now = 1_000;
    while rig.tree.exit_code().is_none() {
        now += 10;
        assert!(now < 3_000, "still not down");
        rig.at(now, Event::Tick);
    }
    let log = rig.take();
    let model_stops = position(&log, |a| *a == Action::Stop { child: A });
    let hand_left = position(&log, |a| matches!(a, Action::Abandon { child: C, .. }));
    assert!(hand_left < model_stops);
    assert_eq!(&log[log.len() - 2..], [Action::CloseRecording, Action::Exit(0)]);
    assert!(!log.iter().any(|a| matches!(a, Action::Start { .. })));
}

#[test]
fn nothing_is_restarted_while_the_session_ends() {
    let mut rig = Rig::with(three(Strategy::OneForOne), 2, &[A, B, C], &[]);
    rig.at(10, Event::ShutdownRequested { code: 0 });
    rig.take();
    rig.panics(11, A);
    rig.panics(12, B);
    rig.panics(13, C);
    assert_eq!(rig.take(), [Action::CloseRecording, Action::Exit(0)]);
}

#[test]
fn an_incident_tells_when_it_was_detected_restarted_and_resumed() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    rig.slow_starters.push(B);
    rig.panics(100, B);
    rig.at(103, Event::Started { child: B, incarnation: 2 });
    rig.at(105, Event::Resumed { child: B, incarnation: 2 });
    rig.at(106, Event::Resumed { child: B, incarnation: 2 });
    let incident = &rig.tree.incidents()[0];
    assert_eq!(incident.child, "b");
    assert_eq!(incident.cause, Cause::Panic("boom".to_owned()));
    assert_eq!(incident.detected, ms(100));
    assert_eq!(incident.restarted, Some(ms(103)));
    assert_eq!(incident.resumed, Some(ms(105)));
}

#[test]
fn health_follows_lateness_holds_and_stalls() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    assert_eq!(rig.health(A), Health::Healthy);
    rig.at(1, Event::Late { child: A, late: true });
    assert_eq!(rig.health(A), Health::Late);
    rig.at(2, Event::Held { child: A, held: true });
    assert_eq!(rig.health(A), Health::Held);
    assert!(!rig.tree.is_watched(A));
    rig.at(3, Event::Held { child: A, held: false });
    rig.at(3, Event::Late { child: A, late: false });
    assert!(rig.tree.is_watched(A));
    rig.slow_starters.push(A);
    rig.stalls(4, A);
    assert_eq!(rig.health(A), Health::Stalled);
    rig.at(5, Event::Started { child: A, incarnation: 2 });
    assert_eq!(rig.health(A), Health::Healthy);
}

#[test]
fn the_default_tree_isolates_the_model_and_orders_the_groups() {
    let child = |id: &str, class| ChildSpec::new(id, class, 100.0);
    let root = GroupSpec::default_tree([
        child("task", RuntimeClass::Task),
        child("haptics.left", RuntimeClass::Haptics),
        child("engine", RuntimeClass::Simulation),
        child("collision", RuntimeClass::Collision),
        child("model", RuntimeClass::Model),
    ]);
    let mut rig = Rig::new(root);
    let order: Vec<&str> = (0..5).map(|i| rig.tree.spec(ChildId(i)).expect("a child").id.as_str()).collect();
    assert_eq!(order, ["model", "collision", "engine", "haptics.left", "task"]);
    rig.panics(10, ChildId(0));
    assert_eq!(rig.lives(), [2, 1, 1], "clients resume with the Model, they are not restarted with it");
    rig.panics(20, ChildId(1));
    assert_eq!(rig.lives(), [2, 2, 2], "physics restarts with the collision detection that it follows");
    assert_eq!(rig.tree.incarnation(ChildId(3)), 1);
    for n in 0..5 {
        rig.panics(10_100 + n, ChildId(0));
        rig.at(10_100 + n, Event::Tick);
    }
    assert_eq!(rig.tree.exit_code(), None);
}

#[test]
fn trees_that_make_no_sense_are_refused() {
    let twice = GroupSpec::new("root", Strategy::OneForOne).child(spec("a")).child(spec("a"));
    assert_eq!(Supervisor::new(twice, 0, 1).err(), Some(TreeError::Duplicate("a".to_owned())));
    let empty = GroupSpec::new("root", Strategy::OneForOne);
    assert_eq!(Supervisor::new(empty, 0, 1).err(), Some(TreeError::Empty));
    let shrinking = three(Strategy::OneForOne).with_backoff(Backoff { factor: 0.5, ..Backoff::default() });
    assert!(matches!(Supervisor::new(shrinking, 0, 1), Err(TreeError::Backoff { field: "factor", .. })));
}
