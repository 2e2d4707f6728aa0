//! Breaks: a station comes back to what it had, from every state.

use proptest::prelude::*;
use trocar_scene::SimTime;

use super::client::{AWAY_TIME_MAX, ClientState, FIRST_TIME_MAX};
use super::error::{ControlError, Goodbye};
use super::host::{HostState, SendError};
use super::message::RequestKind;
use super::session_testing::{Pair, TestSession, ms, name, ticket, wish};
use crate::ticket::Role;

#[test]
fn a_station_that_was_away_gets_only_what_it_missed_and_has_its_hand_still() {
    let mut pair = Pair::operating();
    pair.join();
    let first = pair.carried;
    let connection = pair.client.welcome().expect("a welcome").connection;
    pair.cut();
    assert_eq!(pair.client.state(), ClientState::Away);
    assert!(!pair.session.roster.stations()[0].is_here);
    pair.session.grow(3);
    let broke_at = pair.now;
    pair.join();
    assert!(pair.now.since(broke_at) < ms(1_000), "{}", pair.now.since(broke_at));
    assert_eq!(pair.scene, pair.session.scene);
    assert!(pair.carried - first < first - 700, "{} bytes after {first}", pair.carried - first);
    let welcome = pair.client.welcome().expect("a welcome");
    assert_eq!((welcome.station, welcome.session.hands[0].station), (100, Some(100)));
    assert_ne!(welcome.connection, connection, "keys and sequences are of a new connection");
    assert_eq!(pair.session.redeemed, 1);
    assert!(pair.client.error().is_none());
}

#[test]
fn a_station_comes_back_with_the_hands_of_the_break_and_without_one_that_is_taken_since() {
    let mut pair = Pair::operating();
    pair.join();
    let now = pair.now;
    pair.client.request(RequestKind::TakeHand(name("right")), now).expect("it runs");
    pair.step();
    pair.host().send_hand_served(1, Some(100), now).expect("it runs");
    pair.step();
    // The host forgets the station; somebody else takes one of its hands.
    pair.cut();
    pair.session.roster.expire(now + AWAY_TIME_MAX + ms(10)).expect("over");
    pair.session.roster.arrive(7, name("Bo"), Role::Operate);
    pair.session.roster.take_hand(7, &name("left")).expect("free");
    pair.join();
    let served: Vec<_> = pair.session.roster.hands().iter().map(|hand| hand.station).collect();
    assert_eq!(served, [Some(7), Some(100)]);
    assert_eq!(pair.connections, 3);
}

#[test]
fn a_break_after_any_byte_of_the_join_ends_in_the_same_scene_without_a_second_ticket() {
    let mut whole = Pair::operating();
    whole.join();
    for cut_after in 1..=whole.carried {
        let mut pair = Pair::operating();
        (pair.to_client.1, pair.cut_after) = (1, Some(cut_after));
        pair.join();
        assert_eq!(pair.scene, pair.session.scene, "cut after {cut_after} bytes");
        assert_eq!((pair.session.redeemed, pair.session.roster.stations().len()), (1, 1));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn after_any_breaks_and_changes_station_and_host_have_the_same_scene(
        breaks in prop::collection::vec((1_usize..4_000, 0_u64..60, any::<bool>()), 1..6), piece in 1_usize..500,
    ) {
        let mut pair = Pair::operating();
        (pair.to_client.1, pair.to_host.1) = (piece, piece);
        for (bytes, entities, is_forgetful) in breaks {
            pair.cut_after = Some(pair.carried + bytes);
            for _ in 0..300 {
                pair.step();
            }
            pair.session.grow(entities);
            if is_forgetful {
                let newest = *pair.session.revisions.last_key_value().expect("a revision").0;
                pair.session.revisions.retain(|revision, _| *revision == newest);
            }
            pair.cut();
        }
        pair.cut_after = None;
        pair.join();
        prop_assert_eq!(&pair.scene, &pair.session.scene);
        prop_assert_eq!((pair.session.redeemed, pair.session.roster.stations().len()), (1, 1));
        prop_assert_eq!(pair.session.roster.hands()[0].station, Some(100));
    }
}

#[test]
fn a_break_while_the_scene_is_being_built_makes_the_result_worthless_and_no_trouble() {
    let mut pair = Pair::operating();
    pair.builds = false;
    pair.run_until(|pair| pair.client.state() == ClientState::Building);
    let manifest = pair.client.welcome().expect("a welcome").manifest.clone();
    pair.cut();
    pair.client.scene_built(manifest.revision, &manifest.counts, manifest.digest, pair.now);
    assert_eq!(pair.client.state(), ClientState::Away);
    pair.builds = true;
    pair.join();
    assert_eq!((pair.scene == pair.session.scene, pair.connections), (true, 2));
}

#[test]
fn a_host_that_no_longer_knows_what_the_station_holds_sends_all_of_it() {
    let mut pair = Pair::operating();
    pair.join();
    pair.cut();
    pair.session.grow(5);
    pair.session.revisions.remove(&1);
    pair.join();
    assert_eq!(pair.scene, pair.session.scene);
}

#[test]
fn a_link_that_falls_silent_is_noticed_at_both_ends_and_mended_when_it_heals() {
    let mut pair = Pair::operating();
    pair.join();
    pair.run(ms(10_000));
    assert_eq!((pair.connections, pair.is_running()), (1, true), "pings keep it alive");
    pair.is_up = false;
    let silent_from = pair.now;
    pair.run_until(|pair| pair.client.state() == ClientState::Away);
    assert!(pair.now.since(silent_from) <= ms(5_001), "{}", pair.now);
    assert_eq!(pair.client.error(), Some(&ControlError::Silent));
    pair.run(ms(20_000));
    pair.is_up = true;
    let healed_at = pair.now;
    pair.join();
    assert!(pair.now.since(healed_at) <= ms(2_100), "{}", pair.now.since(healed_at));
    assert_eq!(pair.session.heard.len(), 2);
}

#[test]
fn a_station_gives_up_a_minute_after_the_break_with_the_last_reason() {
    let mut pair = Pair::operating();
    pair.join();
    pair.is_up = false;
    pair.cut();
    let broke_at = pair.now;
    let error = pair.end();
    let tried = pair.now.since(broke_at);
    assert!(tried <= AWAY_TIME_MAX && tried > AWAY_TIME_MAX - ms(2_100), "{tried}");
    assert!(
        matches!(&error, ControlError::Lost(_, why) if why.as_str().contains("no route to host")),
        "{error}"
    );
    assert_eq!(error.exit_class().code(), 69);
    pair.session.roster.expire(broke_at + AWAY_TIME_MAX).expect("the hands are free");
    assert_eq!(pair.session.roster.hands()[0].station, None);
}

#[test]
fn a_host_that_was_never_reached_is_given_up_sooner() {
    let mut pair = Pair::operating();
    pair.is_up = false;
    assert!(matches!(pair.end(), ControlError::Lost(..)));
    assert!(pair.now <= FIRST_TIME_MAX, "{}", pair.now);
}

#[test]
fn a_host_that_does_not_answer_the_hello_is_given_up() {
    let mut pair = Pair::operating();
    pair.to_client.0 = 0;
    let error = pair.end();
    assert!(matches!(error, ControlError::Lost(..)), "{error}");
    assert!(pair.now <= FIRST_TIME_MAX, "{}", pair.now);
}

#[test]
fn whoever_leaves_is_told_apart_from_a_break() {
    let mut pair = Pair::operating();
    pair.join();
    pair.client.leave(pair.now);
    assert_eq!(pair.host_end(), ControlError::Goodbye(Goodbye::Leaves));
    assert_eq!(pair.end(), ControlError::Ended(Goodbye::Leaves));
    for (goodbye, code) in [(Goodbye::SessionOver, 0), (Goodbye::Revoked, 77), (Goodbye::Superseded, 0)] {
        let mut pair = Pair::operating();
        pair.join();
        let now = pair.now;
        pair.host().dismiss(goodbye.clone(), now);
        let error = pair.end();
        assert_eq!((error.exit_class().code(), error), (code, ControlError::Goodbye(goodbye)));
        pair.run(ms(3_000));
        assert_eq!(pair.connections, 1, "it does not come back");
    }
}

#[test]
fn a_station_that_leaves_before_its_hello_has_gone_out_spends_no_ticket() {
    let mut pair = Pair::operating();
    pair.say_hello();
    pair.client.leave(pair.now);
    assert_eq!(pair.end(), ControlError::Ended(Goodbye::Leaves));
    pair.run(ms(100));
    assert_eq!((pair.session.redeemed, pair.client.outgoing().len()), (0, 0));
}

#[test]
fn a_station_that_is_dismissed_while_it_loads_reads_the_reason() {
    let mut pair = Pair::new(TestSession::new(100_000), ticket(1), wish("Ana", &[]));
    pair.to_client = (1_000, 1_000);
    pair.run_until(|pair| pair.client.state() == ClientState::Loading);
    let now = pair.now;
    pair.host().dismiss(Goodbye::SessionOver, now);
    assert_eq!(pair.end(), ControlError::Goodbye(Goodbye::SessionOver));
}

#[test]
fn keys_change_one_phase_at_a_time_and_begin_anew_with_a_connection() {
    let mut pair = Pair::operating();
    pair.join();
    for phase in 1..=3 {
        let now = pair.now;
        assert_eq!(pair.host().rekey(now), Ok(phase));
        assert_eq!(pair.host().rekey(now), Err(SendError::NotNow), "the station still uses the last keys");
        pair.step();
        assert_eq!(pair.heard.last(), Some(&format!("Rekey({phase})")));
        pair.client.rekeyed(pair.now).expect("it runs");
        pair.step();
        assert_eq!(pair.session.heard.last(), Some(&format!("100: Rekeyed({phase})")));
    }
    pair.cut();
    pair.join();
    let now = pair.now;
    assert_eq!(pair.host().rekey(now), Ok(1));
}

#[test]
fn before_a_station_has_joined_no_changes_are_sent_to_it_but_the_roster_is() {
    let mut pair = Pair::operating();
    pair.builds = false;
    pair.run_until(|pair| pair.host.as_ref().is_some_and(|host| host.state() == HostState::Awaiting));
    let (now, stations) = (pair.now, pair.session.roster.stations());
    assert_eq!(pair.host().send_delta(&[1], now), Err(SendError::NotNow));
    pair.host().send_roster(stations, now).expect("it is let in");
    pair.host().send_hand_served(1, Some(100), now).expect("it is let in");
    pair.step();
    assert!(pair.heard[0].starts_with("Roster([StationInfo { number: 100"), "{:?}", pair.heard);
    assert!(pair.heard[1].starts_with("HandServed { hand: 1, station: Some(100)"), "{:?}", pair.heard);
    assert_eq!(pair.client.write(&[1], now), Err(SendError::NotNow));
}

#[test]
fn the_same_inputs_give_the_same_bytes() {
    let run = || {
        let mut pair = Pair::operating();
        (pair.to_client.1, pair.cut_after) = (7, Some(900));
        pair.join();
        pair.run(SimTime::from_millis(3_000));
        (pair.carried, pair.now, pair.session.heard, pair.client.round_trip())
    };
    assert_eq!(run(), run());
}
