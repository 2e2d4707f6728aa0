//! Each part of the suite does what it measures: hands come and go, scenes are whole, a flood is turned away. How long it
//! took is the suite's own affair.

use std::time::Duration;

use trocar::network::datagram::DATAGRAM_MAX;
use trocar_scene::SimTime;

use super::link::{HANDS, hands_at};
use super::raw::{RawEcho, round_trips};
use super::round_trip::{Question, through_links};
use super::veth::Place;
use super::{architectures, feedback, flood, rows, scenes, sealing, stations};
use crate::failure::Failure;

const BRIEF: Duration = Duration::from_millis(200);

fn good<T>(result: Result<T, Failure>) -> T {
    result.unwrap_or_else(|failure| panic!("{}", failure.message))
}

#[test]
fn the_hands_of_the_load_move_without_a_jump_and_touch_now_and_then() {
    let (mut before, mut touched, mut most) = (hands_at(0, SimTime::ZERO), false, 0.0_f64);
    for ms in 1..8_000 {
        let now = hands_at(0, SimTime::from_millis(ms));
        for (now, before) in now.iter().zip(&before) {
            let moved = (now.position_in_device() - before.position_in_device()).norm();
            // A millisecond at the speed that the sample tells.
            let told = 1e-3 * now.state.linear_velocity.norm().max(before.state.linear_velocity.norm());
            assert!(moved <= told + 1e-6, "{moved} m at {ms} ms, {told} told");
            touched |= now.wrench.force.norm() > 1.0;
            most = most.max(now.position_in_device().norm());
        }
        before = now;
    }
    assert!(touched && (0.08..0.09).contains(&most), "{touched}, {most}");
}

#[test]
fn a_warmed_hands_link_of_both_ends_allocates_and_frees_nothing() {
    for row in good(sealing::allocations()) {
        assert!(row.holds && row.value == 0.0, "{row:?}");
    }
}

#[test]
fn hands_and_bare_datagrams_come_back() {
    let place = Place::Loopback;
    let (sockets, address) = good(place.host());
    let echo = RawEcho::start(sockets.udp).expect("a thread");
    assert!(good(round_trips(address, 252, BRIEF)).count() > 10);
    drop(echo);
    for question in [Question::Challenge, Question::Hands] {
        assert!(good(through_links(&place, question, BRIEF)).count() > 10, "{question:?}");
    }
}

#[test]
fn the_hands_of_stations_reach_their_host_and_its_answers_come_back() {
    let block = good(stations::block(2, &stations::ALL, BRIEF));
    assert!(block.delivered > 0.5 && block.bytes > 0.0, "{} of {} B/s", block.delivered, block.bytes);
    assert!(block.cpu >= 0.0 && block.load_cpu >= 0.0);
}

#[test]
fn a_station_joins_and_comes_back_with_what_it_missed() {
    let block = good(scenes::block(&Place::Loopback, 200));
    assert!(block.rejoin_bytes < block.join_bytes, "{} and {} B", block.rejoin_bytes, block.join_bytes);
    assert!(block.join_ms > 0.0 && block.rejoin_ms > 0.0);
}

#[test]
fn a_station_joins_where_packets_have_1_280_bytes_at_most() {
    let place = Place::new().with_packets_of(1_280);
    println!("over {}", place.name());
    let block = good(scenes::block(&place, 500));
    assert!(block.join_bytes > 10_000.0 && block.rejoin_ms > 0.0, "{} B", block.join_bytes);
    let (sockets, address) = good(place.host());
    let echo = RawEcho::start(sockets.udp).expect("a thread");
    assert!(good(round_trips(address, DATAGRAM_MAX, BRIEF)).count() > 10, "the longest datagrams pass");
    drop(echo);
}

#[test]
fn a_pulled_liver_takes_fewer_bytes_than_one_that_moves_as_a_whole_and_both_fewer_than_plain_numbers() {
    let rows = good(rows::liver());
    assert!(rows[0].value > 0.0 && rows[0].value < 0.5 * rows[1].value, "{rows:?}");
    assert!(rows[1].ratio.is_some_and(|ratio| ratio < 0.5), "{rows:?}");
}

#[test]
fn a_flood_comes_and_the_hands_are_still_served() {
    let block = good(flood::block(true, BRIEF));
    assert!(block.flood > 0.0 && block.lost < 0.5, "{} datagrams/s, {} lost", block.flood, block.lost);
    assert!(block.hands >= 0.0 && block.link >= 0.0 && HANDS == 2);
}

#[test]
fn a_thin_client_computes_less_than_its_server() {
    let rows = good(architectures::thin_client());
    assert!(rows.len() == 1 && rows[0].value > 0.0 && rows[0].floor > Some(0.0), "{rows:?}");
}

#[test]
fn a_liver_is_felt_by_way_of_its_slave() {
    let share = good(feedback::felt("passivity", feedback::DELAYS[0].0));
    assert!((0.5..1.2).contains(&share), "{share}");
}
