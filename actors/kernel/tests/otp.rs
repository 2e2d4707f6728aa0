//! The supervisor core against Erlang/OTP: one test per guarantee of OTP's "Supervisor Behaviour" (OTP Design
//! Principles) and of the reference manual of `supervisor`, named for it. `docs/guarantees.md` has the table, with
//! what is deliberately different.

use crate::support::rig::{A, B, C, Rig, ms, position, prompt, spec, starts, stops, three};
use trocar_kernel::supervision::{
    Action, Cause, ChildId, EXIT_GAVE_UP, Event, GroupSpec, Health, Restart, Strategy,
};

const STRATEGIES: [Strategy; 3] = [Strategy::OneForOne, Strategy::RestForOne, Strategy::OneForAll];
const RESTARTS: [Restart; 3] = [Restart::Permanent, Restart::Transient, Restart::Temporary];

/// Three children with restart types of their own.
fn mixed(strategy: Strategy, restarts: [Restart; 3]) -> GroupSpec {
    let names = ["a", "b", "c"].into_iter().zip(restarts);
    names.fold(GroupSpec::new("root", strategy).with_backoff(prompt()), |group, (name, restart)| {
        group.child(spec(name).with_restart(restart))
    })
}

fn boom() -> Cause {
    Cause::Panic("boom".to_owned())
}

// ---- Start and shutdown.

#[test]
fn children_start_in_the_order_of_the_list_each_after_the_one_before_is_up() {
    let mut rig = Rig::with(three(Strategy::OneForOne), 2, &[], &[B]);
    assert_eq!(starts(&rig.take()), [0, 1]);
    assert_eq!(rig.health(C), Health::Starting);
    rig.at(3, Event::Started { child: B, incarnation: 1 });
    assert_eq!(starts(&rig.take()), [2]);
    assert!(rig.tree.is_up());
}

#[test]
fn children_are_terminated_in_the_reverse_of_their_start_order() {
    for strategy in STRATEGIES {
        let mut rig = Rig::new(three(strategy));
        rig.take();
        rig.at(10, Event::ShutdownRequested { code: 0 });
        assert_eq!(stops(&rig.take()), [2, 1, 0], "{strategy:?}");
        assert_eq!(rig.tree.exit_code(), Some(0));
    }
}

#[test]
fn if_a_child_does_not_start_those_that_did_are_terminated_and_the_supervisor_does_not_come_up() {
    let mut rig = Rig::with(three(Strategy::OneForOne), 2, &[], &[C]);
    rig.take();
    rig.died(1, C, Cause::Error("no such component".to_owned()));
    assert_eq!(stops(&rig.take()), [1, 0], "in reverse");
    assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP));
    assert!(rig.tree.reason().is_some_and(|r| r.contains("no such component")), "{:?}", rig.tree.reason());
    assert_eq!(rig.tree.restarts(C), 0, "and is not tried again");
}

#[test]
fn a_child_that_is_not_down_within_its_shutdown_time_is_done_with() {
    let mut rig = Rig::with(three(Strategy::RestForOne), 2, &[C], &[]);
    rig.panics(10, B);
    rig.take();
    rig.at(209, Event::Tick);
    assert!(rig.take().is_empty(), "200 ms are not over");
    rig.at(210, Event::Tick);
    let log = rig.take();
    assert!(log.contains(&Action::Abandon { child: C, incarnation: 1 }));
    assert!(log.contains(&Action::Start { child: C, incarnation: 2, fresh: true }));
    assert_eq!(rig.tree.zombies(), 1, "a thread cannot be killed: it is fenced and left behind");
}

// ---- Restart strategies.

#[test]
fn one_for_one_restarts_only_the_failed_child() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    rig.take();
    rig.panics(10, B);
    assert_eq!(rig.lives(), [1, 2, 1]);
    assert!(stops(&rig.take()).is_empty());
}

#[test]
fn one_for_all_terminates_the_others_in_reverse_and_restarts_all_in_order() {
    let mut rig = Rig::new(three(Strategy::OneForAll));
    rig.take();
    rig.panics(10, B);
    let log = rig.take();
    assert_eq!(rig.lives(), [2, 2, 2]);
    assert_eq!(stops(&log), [2, 0]);
    assert_eq!(starts(&log), [0, 1, 2]);
}

#[test]
fn rest_for_one_terminates_the_later_ones_in_reverse_and_restarts_them_in_order() {
    let mut rig = Rig::new(three(Strategy::RestForOne));
    rig.take();
    rig.panics(10, A);
    let log = rig.take();
    assert_eq!((stops(&log), starts(&log)), (vec![2, 1], vec![0, 1, 2]));
    rig.panics(20, B);
    let log = rig.take();
    assert_eq!((stops(&log), starts(&log)), (vec![2], vec![1, 2]));
    rig.panics(30, C);
    let log = rig.take();
    assert_eq!((stops(&log), starts(&log)), (vec![], vec![2]));
    assert_eq!(rig.lives(), [2, 3, 4]);
}

#[test]
fn restarts_begin_only_after_all_that_had_to_be_terminated_are_down() {
    let mut rig = Rig::with(three(Strategy::RestForOne), 2, &[C], &[]);
    rig.take();
    rig.panics(10, B);
    assert!(starts(&rig.take()).is_empty(), "c is still stopping");
    rig.died(12, C, Cause::Stop);
    assert_eq!(starts(&rig.take()), [1, 2]);
}

// ---- Restart types.

#[test]
fn permanent_child_is_always_restarted() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    rig.died(10, A, Cause::Stop);
    rig.died(20, A, boom());
    assert_eq!(rig.lives(), [3, 1, 1]);
    assert_eq!(rig.tree.incidents().len(), 1, "an end by itself is no incident");
}

#[test]
fn transient_child_is_restarted_only_after_abnormal_exit() {
    let causes = [
        (Cause::Stop, false),
        (boom(), true),
        (Cause::Error("disk".to_owned()), true),
        (Cause::Stall, true),
        (Cause::StartTimeout, true),
    ];
    for (cause, again) in causes {
        let mut rig = Rig::new(mixed(Strategy::OneForOne, [Restart::Transient; 3]));
        rig.died(10, A, cause.clone());
        assert_eq!(rig.tree.incarnation(A) == 2, again, "{cause:?}");
        assert_eq!(rig.health(A), if again { Health::Healthy } else { Health::Stopped }, "{cause:?}");
    }
}

#[test]
fn temporary_child_is_never_restarted() {
    for cause in [Cause::Stop, boom()] {
        let mut rig = Rig::new(mixed(Strategy::OneForOne, [Restart::Temporary; 3]));
        rig.died(10, A, cause);
        assert_eq!(rig.lives(), [1, 1, 1]);
    }
}

#[test]
fn temporary_child_is_not_restarted_even_when_a_siblings_death_terminates_it() {
    for strategy in [Strategy::RestForOne, Strategy::OneForAll] {
        let restarts = [Restart::Permanent, Restart::Temporary, Restart::Permanent];
        let mut rig = Rig::new(mixed(strategy, restarts));
        rig.take();
        rig.panics(10, A);
        assert!(stops(&rig.take()).contains(&1), "{strategy:?}");
        assert_eq!(rig.lives(), [2, 1, 2], "{strategy:?}");
        assert_eq!(rig.health(B), Health::Stopped);
    }
}

#[test]
fn the_end_of_a_temporary_child_takes_nobody_with_it() {
    let restarts = [Restart::Temporary, Restart::Permanent, Restart::Permanent];
    let mut rig = Rig::new(mixed(Strategy::OneForAll, restarts));
    rig.panics(10, A);
    assert_eq!(rig.lives(), [1, 1, 1]);
    assert_eq!(rig.health(A), Health::Failed);
}

/// OTP's rules for three running children, read off its manual: who lives again after `dead` ended.
fn who_lives_again(strategy: Strategy, restarts: [Restart; 3], dead: usize, abnormal: bool) -> [bool; 3] {
    let restarted = match restarts[dead] {
        Restart::Permanent => true,
        Restart::Transient => abnormal,
        Restart::Temporary => false,
    };
    let mut again = [false; 3];
    if !restarted {
        return again;
    }
    for (child, again) in again.iter_mut().enumerate() {
        let taken_along = match strategy {
            Strategy::OneForOne => false,
            Strategy::RestForOne => child > dead,
            Strategy::OneForAll => child != dead,
        };
        *again = child == dead || (taken_along && restarts[child] != Restart::Temporary);
    }
    again
}

#[test]
fn strategy_and_restart_type_together_decide_as_in_otp() {
    let mut cases = 0;
    for strategy in STRATEGIES {
        for code in 0..27 {
            let restarts = [RESTARTS[code % 3], RESTARTS[code / 3 % 3], RESTARTS[code / 9]];
            for dead in 0..3 {
                for cause in [Cause::Stop, boom()] {
                    let mut rig = Rig::new(mixed(strategy, restarts));
                    let expected = who_lives_again(strategy, restarts, dead, cause.is_abnormal());
                    rig.died(10, ChildId(dead as u16), cause.clone());
                    let again = rig.lives().map(|life| life == 2);
                    assert_eq!(again, expected, "{strategy:?} {restarts:?}, {dead} ended: {cause:?}");
                    assert_eq!(rig.tree.exit_code(), None);
                    cases += 1;
                }
            }
        }
    }
    assert_eq!(cases, 486);
}

// ---- Maximum restart intensity.

#[test]
fn intensity_n_in_t_terminates_the_supervisor_on_n_plus_one() {
    for n in 0..6 {
        let mut rig = Rig::new(three(Strategy::OneForOne).with_intensity(n, ms(1_000)));
        for failure in 0..n {
            rig.panics(10 + u64::from(failure), A);
            assert_eq!(rig.tree.exit_code(), None, "{failure} of {n}");
        }
        assert_eq!(rig.tree.restarts(A), n);
        rig.panics(500, A);
        assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP), "one more than {n}");
    }
}

#[test]
fn intensity_counts_the_restarts_of_all_children_of_a_supervisor_together() {
    let mut rig = Rig::new(three(Strategy::OneForOne).with_intensity(2, ms(1_000)));
    rig.panics(10, A);
    rig.panics(20, B);
    assert_eq!(rig.tree.exit_code(), None);
    rig.panics(30, C);
    assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP));
}

#[test]
fn a_restart_that_takes_siblings_along_counts_once() {
    let mut rig = Rig::new(three(Strategy::OneForAll).with_intensity(2, ms(1_000)));
    rig.panics(10, A);
    rig.panics(20, B);
    assert_eq!((rig.tree.exit_code(), rig.lives()), (None, [3, 3, 3]));
}

#[test]
fn a_supervisor_that_gives_up_terminates_all_its_children_then_itself() {
    let mut rig = Rig::new(three(Strategy::OneForOne).with_intensity(2, ms(1_000)));
    rig.panics(10, A);
    rig.panics(20, A);
    rig.take();
    rig.panics(30, A);
    let log = rig.take();
    assert_eq!(stops(&log), [2, 1], "those that are left, in reverse");
    let zero = position(&log, |a| *a == Action::ZeroForces);
    let stop = position(&log, |a| matches!(a, Action::Stop { .. }));
    let close = position(&log, |a| *a == Action::CloseRecording);
    assert!(zero < stop && stop < close, "with a hand in it, forces come first");
    assert_eq!(log.last(), Some(&Action::Exit(EXIT_GAVE_UP)));
    assert!(rig.tree.reason().is_some_and(|r| r.contains("root") && r.contains("boom")));
}

#[test]
fn restart_count_resets_after_window() {
    // Never three within a second, for ever.
    let mut rig = Rig::new(three(Strategy::OneForOne).with_intensity(2, ms(1_000)));
    for n in 0..20 {
        rig.panics(600 * (n + 1), A);
    }
    assert_eq!((rig.tree.restarts(A), rig.tree.exit_code()), (20, None));
    // The window slides: the third within a second of the first is one too many, a moment later it is not.
    for (third, gives_up) in [(1_010, true), (1_011, false)] {
        let mut rig = Rig::new(three(Strategy::OneForOne).with_intensity(2, ms(1_000)));
        for at in [10, 900, third] {
            rig.panics(at, A);
        }
        assert_eq!(rig.tree.exit_code().is_some(), gives_up, "{third}");
    }
}

#[test]
fn a_failed_restart_counts_and_is_tried_again() {
    let mut rig = Rig::new(three(Strategy::OneForOne).with_intensity(3, ms(1_000)));
    rig.slow_starters.push(A);
    rig.panics(10, A);
    rig.died(11, A, Cause::Error("device busy".to_owned()));
    assert_eq!(rig.tree.incarnation(A), 3);
    rig.died(12, A, Cause::Error("device busy".to_owned()));
    rig.died(13, A, Cause::Error("device busy".to_owned()));
    assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP));
}

// ---- Supervisors of supervisors.

/// Two in a group that tolerates one restart, beside a third.
fn nested(strategy: Strategy, outer: u32) -> GroupSpec {
    let inner = GroupSpec::new("devices", Strategy::OneForOne)
        .with_backoff(prompt())
        .with_intensity(1, ms(10_000))
        .child(spec("a"))
        .child(spec("b"));
    GroupSpec::new("root", strategy)
        .with_backoff(prompt())
        .with_intensity(outer, ms(10_000))
        .group(inner)
        .child(spec("c"))
}

#[test]
fn a_supervisor_that_gave_up_is_restarted_by_the_next_higher_one() {
    let mut rig = Rig::new(nested(Strategy::OneForOne, 5));
    rig.panics(10, A);
    assert_eq!(rig.lives(), [2, 1, 1]);
    rig.panics(20, A);
    assert_eq!(rig.lives(), [3, 2, 1], "the whole group, not its sibling");
}

#[test]
fn the_strategy_of_the_higher_supervisor_applies_to_a_whole_group() {
    let mut rig = Rig::new(nested(Strategy::RestForOne, 5));
    rig.take();
    rig.panics(10, A);
    rig.panics(20, A);
    assert_eq!(rig.lives(), [3, 2, 2], "c stands after the group");
}

#[test]
fn a_restarted_supervisor_counts_from_zero() {
    let mut rig = Rig::new(nested(Strategy::OneForOne, 5));
    rig.panics(10, A);
    rig.panics(20, A);
    rig.panics(30, A);
    assert_eq!(rig.lives(), [4, 2, 1], "one is tolerated again, by the group itself");
    assert_eq!(rig.tree.exit_code(), None);
}

#[test]
fn the_highest_supervisor_gives_up_when_every_level_is_exhausted() {
    let mut rig = Rig::new(nested(Strategy::OneForOne, 1));
    for n in 1..=3 {
        rig.panics(10 * n, A);
        assert_eq!(rig.tree.exit_code(), None, "after {n}");
    }
    rig.panics(40, A);
    assert_eq!(rig.tree.exit_code(), Some(EXIT_GAVE_UP));
}

// ---- What replaces OTP's process identifiers and calls.

#[test]
fn an_exit_of_an_earlier_life_is_ignored() {
    let mut rig = Rig::new(three(Strategy::OneForOne));
    rig.stalls(100, B);
    rig.take();
    rig.at(101, Event::Died { child: B, incarnation: 1, cause: Cause::Panic("late".to_owned()) });
    rig.at(102, Event::Stalled { child: B, incarnation: 1 });
    rig.at(103, Event::Started { child: B, incarnation: 1 });
    assert!(rig.take().is_empty());
    assert_eq!(rig.lives(), [1, 2, 1]);
}

// ---- Where Trocar deliberately differs; `supervisor.rs` tests back-off and holding.

#[test]
fn unlike_in_otp_a_transient_child_that_has_done_its_work_stays_ended_when_siblings_restart() {
    let mut rig =
        Rig::new(mixed(Strategy::OneForAll, [Restart::Permanent, Restart::Transient, Restart::Permanent]));
    rig.died(10, B, Cause::Stop);
    rig.panics(20, A);
    assert_eq!(rig.lives(), [2, 1, 2]);
    assert_eq!(rig.health(B), Health::Stopped);
}
