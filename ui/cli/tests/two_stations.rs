//! Whole exercises of a host and its stations, in virtual time.

use trocar::network::impairments::Impairments;
use trocar_scene::SimTime;

use crate::support::pair::Pair;

#[test]
fn the_left_hand_at_a_station_and_the_right_one_at_the_host_transfer_the_pegs() {
    let path = Impairments {
        loss: 0.02,
        jitter: SimTime::from_millis(5),
        ..Impairments::delay(SimTime::from_millis(75))
    };
    let mut pair = Pair::new("peg-transfer", &path, &["left"]);
    while pair.step() && pair.now < SimTime::from_millis(300_000) {}
    let task = pair.host.task();
    assert!(task.completed, "{task:?} at {}", pair.now);
}
