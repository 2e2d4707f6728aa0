//! A host and a station in real time, over the loopback: a pause of the host, and faults of the link between them.

use std::time::Duration;

use trocar::network::control::Architecture;
use trocar_kernel::faults::{FaultKind, FaultPlan};
use trocar_scene::SimTime;

use crate::support::live::LivePair;

/// How far a hand may be from where the other end shows it \[m\].
const APART_MAX: f64 = 1e-3;

/// Waits until both ends have shown the hand at one place.
fn wait_until_together(pair: &mut LivePair) {
    pair.wait_until("the hand is at one place at both ends", |pair| pair.apart() <= APART_MAX);
}

#[test]
fn a_pause_of_the_host_pauses_its_station_and_both_go_on_where_they_stood() {
    let mut pair = LivePair::start(None);
    pair.wait_until("Ana is there", |pair| pair.row().is_some_and(|row| row.here && row.link.rate > 50.0));
    wait_until_together(&mut pair);
    assert!(pair.host.pause());
    pair.wait_until("the station is paused as well", |pair| pair.station.is_paused_by_host());
    let stood = (pair.host.now(), pair.station.now());
    // Longer than any silence that a connection survives.
    pair.run(Duration::from_millis(6_500));
    assert!(pair.station.is_paused() && pair.station.is_paused_by_host());
    assert_eq!((pair.host.now(), pair.station.now()), stood, "time stands still at both");
    assert!(pair.host.resume());
    pair.wait_until("the station goes on", |pair| !pair.station.is_paused());
    pair.run(Duration::from_millis(500));
    let row = pair.row().expect("it is there");
    assert!(row.here && !row.link.over_tcp, "{row:?}");
    assert_eq!(row.hands, ["left"]);
    wait_until_together(&mut pair);
    let at_host = pair.host.snapshot();
    let away = at_host.events().since(0).filter(|(_, event)| event.name == "station_away").count();
    assert_eq!(away, 0, "it was there all the time");
    pair.station.finish();
    assert_eq!(pair.host.finish().outcome.code, 0);
}

/// How many bodies of the station's were repaired so far.
fn repairs(pair: &mut LivePair) -> usize {
    pair.station.snapshot().events().since(0).filter(|(_, event)| event.name == "repaired").count()
}

#[test]
fn a_pause_among_peers_pauses_both_scenes_and_they_agree_afterwards() {
    let mut pair = LivePair::sharing(None, Some(Architecture::PeerToPeer));
    pair.wait_until("Ana is there", |pair| pair.row().is_some_and(|row| row.here && row.link.rate > 50.0));
    wait_until_together(&mut pair);
    let before = repairs(&mut pair);
    assert!(pair.host.pause());
    pair.wait_until("the station is paused as well", |pair| pair.station.is_paused_by_host());
    let stood = (pair.host.now(), pair.station.now());
    // Longer than any silence that a connection survives.
    pair.run(Duration::from_millis(6_500));
    assert_eq!((pair.host.now(), pair.station.now()), stood, "time stands still at both");
    assert!(pair.host.resume());
    pair.wait_until("the station goes on", |pair| !pair.station.is_paused());
    pair.run(Duration::from_millis(1_500));
    wait_until_together(&mut pair);
    pair.wait_until("the rings are at one place at both ends", |pair| pair.rings_apart() <= APART_MAX);
    let row = pair.row().expect("it is there");
    assert!(row.here && row.hands == ["left"], "{row:?}");
    // A ring that is between two blades at that moment may slip at one peer only.
    let repaired = repairs(&mut pair) - before;
    assert!(repaired <= 1, "{repaired} bodies were repaired");
    pair.station.finish();
    assert_eq!(pair.host.finish().outcome.code, 0);
}

#[test]
fn faults_of_a_link_are_met_in_real_time_and_the_station_is_back_with_its_hand() {
    let plan = r#"
schema = 1
seed = 5

[[fault]]
id = "late and lossy"
at_secs = 1.0
for_secs = 5.0
target = "link.Ana"
kind = "delay"
delay_secs = 0.04
jitter_secs = 0.01

[[fault]]
id = "some are lost"
at_secs = 1.0
for_secs = 5.0
target = "link.Ana"
kind = "drop"
probability = 0.05
burst_messages = 4

[[fault]]
id = "some are garbled"
at_secs = 1.0
for_secs = 5.0
target = "link.Ana"
kind = "corrupt"
probability = 0.02

[[fault]]
id = "no way through"
at_secs = 7.0
for_secs = 0.6
target = "link.Ana"
kind = "partition"

[[fault]]
id = "the line is cut"
at_secs = 8.0
target = "link.Ana"
kind = "kill"

[[fault]]
id = "the network dies with all its connections"
at_secs = 9.0
target = "links"
kind = "kill"
"#;
    let plan = FaultPlan::parse(plan, "links.toml").expect("a plan");
    let mut pair = LivePair::start(Some(plan));
    pair.wait_until("Ana is there", |pair| pair.row().is_some_and(|row| row.here && row.link.rate > 50.0));
    pair.wait_until("the path is as long as the fault makes it", |pair| {
        pair.row().is_some_and(|row| row.link.round_trip > 0.075)
    });
    pair.wait_until("the last fault is over", |pair| pair.host.now() > SimTime::from_millis(9_100));
    pair.wait_until("Ana is back", |pair| {
        pair.row().is_some_and(|row| row.here && row.hands == ["left"] && row.link.rate > 50.0)
    });
    wait_until_together(&mut pair);
    pair.station.finish();
    let finished = pair.host.finish();
    assert_eq!((finished.outcome.code, &finished.outcome.held[..]), (0, &[][..]));
    for row in &finished.outcome.faults {
        assert!(row.injected.is_some(), "{}", row.id);
        assert!(row.healed.is_some() || row.lasting.is_none(), "{}", row.id);
        // What was cut is not back at once.
        let is_cut = row.kind == FaultKind::Kill;
        let back = row.recovery();
        // Idle processors come back within a fraction of a second; others may be busy here.
        let is_in_time = |took: SimTime| took < SimTime::from_millis(5_000) && (took.0 > 0 || !is_cut);
        assert!(back.is_some_and(is_in_time), "{}: {back:?}", row.id);
    }
}
