//! Tests of sessions whose datagrams are blocked: the control channel carries the newest hands, until they pass again.

use trocar_devices::HandIntent;
use trocar_scene::{Pose, SimTime};

use super::machines_tests::Bench;
use super::station_machine::StationNews;
use crate::impairments::Impairments;
use crate::lockstep::End;
use crate::remote_hand::Presence;
use crate::ticket::Role;

/// A station with the left hand on a path with these properties, once it is in the session.
fn joined(path: &Impairments, blocked: &[End]) -> Bench {
    let mut bench = Bench::new(path, 50, Role::Operate, &["left"]);
    blocked.iter().for_each(|end| bench.wire.block_datagrams(*end, true));
    bench.run_until(5_000, Bench::is_running);
    bench
}

/// A path of 150 ms there and back that loses nothing. TCP stands still for a round trip or more after a loss.
fn path() -> Impairments {
    Impairments::delay(SimTime::from_millis(75))
}

/// The station's device moves by so much for a second and a half, and both ends come to show it at one place.
fn assert_moves(bench: &mut Bench, by: f64) {
    let mut goal = bench.station.device.shown.expect("it is shown").pose_in_device;
    goal.translation.vector.x += by;
    for _ in 0..1_500 {
        bench.step(Some(HandIntent::at(goal, 0.2)));
        assert_eq!(bench.host.device.hand.presence(), Presence::Live(1), "the hand is never stale");
    }
    let (here, there) = (bench.host.device.x(), bench.station.device.x());
    assert!((there - goal.translation.vector.x).abs() < 1e-3, "the device follows");
    assert!((here - there).abs() < 2e-4, "{here} and {there}");
}

fn assert_follows(bench: &Bench) {
    for entity in &bench.host.moving {
        let there = bench.station.store.view().get::<Pose>(*entity).expect("it is there");
        let here = bench.host.scene.get::<Pose>(*entity).expect("a pose");
        assert!((here.translation - there.translation).norm() < 1.5e-3);
    }
}

/// What both ends say of their link in the last second: whether it is carried, and datagrams a second.
fn said(bench: &Bench) -> [(bool, f64); 2] {
    let host = bench.host.machine.points()[0].1;
    let station = bench.station.machine.point().expect("a second is over");
    [host, station].map(|point| (point.is_carried, point.rate))
}

#[test]
fn where_datagrams_are_blocked_the_hand_moves_over_the_stream_and_goes_back_when_they_pass() {
    let mut bench = joined(&path(), &[End::Host, End::Station]);
    bench.run(4_000);
    assert!(bench.station.news.contains(&StationNews::Carried(true)), "{:?}", bench.station.news);
    assert_moves(&mut bench, 0.02);
    assert_follows(&bench);
    for (is_carried, rate) in said(&bench) {
        // Hands at 100 Hz, rows or their acknowledgements at 50 Hz and more, reports.
        assert!(is_carried && rate >= 100.0, "{rate} Hz");
    }
    let row = bench.station.machine.row();
    assert!(row.link.over_tcp && row.link.loss == 0.0, "{:?}", row.link);
    let tried = bench.wire.blocked();
    bench.run(1_000);
    let tries = bench.wire.blocked()[End::Station as usize] - tried[End::Station as usize];
    assert!((9..=11).contains(&tries), "{tries} tries a second");
    [End::Host, End::Station].iter().for_each(|end| bench.wire.block_datagrams(*end, false));
    bench.run(2_500);
    assert!(bench.station.news.contains(&StationNews::Carried(false)), "{:?}", bench.station.news);
    assert!(said(&bench).iter().all(|(is_carried, _)| !is_carried));
    assert_moves(&mut bench, -0.02);
}

#[test]
fn a_path_that_is_lost_later_is_left_within_a_second_and_the_hand_goes_on_through_its_clutch() {
    let mut bench = joined(&path(), &[]);
    bench.run(1_500);
    assert_moves(&mut bench, 0.01);
    assert!(said(&bench).iter().all(|(is_carried, _)| !is_carried));
    [End::Host, End::Station].iter().for_each(|end| bench.wire.block_datagrams(*end, true));
    let mut silent = 0;
    for _ in 0..3_000 {
        bench.step(None);
        silent += u64::from(bench.host.device.hand.presence() != Presence::Live(1));
    }
    // A second until the loss is told, the message's way, and the way of the first hand; a silence begins after 100 ms.
    assert!((1_000..1_200).contains(&silent), "{silent} ms");
    assert_moves(&mut bench, 0.01);
    assert_follows(&bench);
}

#[test]
fn a_hand_whose_station_was_silent_for_long_comes_back_to_it_where_both_show_it() {
    for millis in [3_000, 8_000] {
        let mut bench = joined(&path(), &[]);
        bench.run(1_500);
        assert_moves(&mut bench, 0.01);
        let partition = trocar_kernel::spec::FaultOrder {
            kind: trocar_kernel::spec::FaultKind::Partition,
            ..Impairments { loss: 1.0, ..Impairments::default() }.orders(1).remove(0)
        };
        bench.wire.fault(&trocar_kernel::spec::FaultOrder { index: 9, ..partition.clone() });
        bench.run(millis);
        assert_eq!(bench.host.device.hand.presence(), Presence::Local, "after {millis} ms");
        bench.wire.fault(&trocar_kernel::spec::FaultOrder { index: 9, begins: false, ..partition });
        bench.run(3_500);
        assert!(bench.is_running(), "after {millis} ms");
        assert_moves(&mut bench, 0.01);
    }
}

#[test]
fn a_path_that_is_blocked_in_one_direction_carries_that_direction_alone() {
    for blocked in [End::Host, End::Station] {
        let mut bench = joined(&path(), &[blocked]);
        bench.run(4_000);
        assert_moves(&mut bench, 0.02);
        assert_follows(&bench);
        let before = bench.wire.blocked();
        bench.run(1_000);
        let after = bench.wire.blocked();
        let tries = |end: End| after[end as usize] - before[end as usize];
        assert!(tries(blocked) <= 11, "{blocked:?}: {}", tries(blocked));
        let carried = bench.station.news.contains(&StationNews::Carried(true));
        assert_eq!(carried, blocked == End::Station, "{blocked:?}");
    }
}

#[test]
fn behind_a_stream_that_stalled_comes_the_present_pose_and_no_queue_of_old_ones() {
    let path = Impairments::delay(SimTime::from_millis(20));
    let mut bench = joined(&path, &[End::Host, End::Station]);
    bench.run(4_000);
    assert_moves(&mut bench, 0.01);
    // Half the segments are lost: each costs 200 ms of standstill, and what was sent behind it comes at once.
    let stalls = Impairments { loss: 0.3, burst: 3.0, ..Impairments::default() };
    let order = stalls.orders(3).remove(0);
    bench.wire.fault(&order);
    let mut goal = bench.station.device.shown.expect("it is shown").pose_in_device;
    for step in 0..4_000 {
        goal.translation.vector.x += if step % 2_000 < 1_000 { 2e-5 } else { -2e-5 };
        bench.step(Some(HandIntent::at(goal, 0.2)));
    }
    bench.wire.fault(&trocar_kernel::spec::FaultOrder { begins: false, ..order });
    // Some silences were so long that the hand came back through its clutch, and was placed anew.
    for _ in 0..4_100 {
        bench.step(Some(HandIntent::at(goal, 0.2)));
    }
    let (here, there) = (bench.host.device.x(), bench.station.device.x());
    assert!((here - there).abs() < 2e-4, "{here} and {there}");
    // What is shown is as old as the path and the steps of both ends: no queue is left.
    let age = bench.host.machine.points()[0].1.age.expect("hands are shown");
    assert!(age < 50.0, "{age} ms");
}
