//! Tests of the two ends of a connection.

use trocar_scene::SimTime;

use super::connection::{Arrived, Connection, ConnectionError};
use crate::datagram::{DATAGRAM_MAX, Keys, Kind, Side};
use crate::hand_sample::HandSample;
use crate::haptic::SenderConfig;

const MS: fn(u64) -> SimTime = SimTime::from_millis;

fn keys(phase: u32) -> Keys {
    let made = Keys::from_exporter(7, phase, |_, context, out: &mut [u8]| {
        out.iter_mut().enumerate().for_each(|(index, byte)| *byte = index as u8 ^ context[4]);
        Ok::<(), ()>(())
    });
    made.expect("keys")
}

/// Both ends, with addresses that are letters: the host knows the station at 's'.
fn ends() -> (Connection<char>, Connection<char>) {
    let end = |side, secret| {
        Connection::new(7, keys(0), side, &[0, 1], &SenderConfig::default(), secret).expect("two hands")
    };
    (end(Side::Server, 1), end(Side::Client, 2))
}

fn hand(x: f64) -> HandSample {
    let mut sample = HandSample::unknown(0);
    sample.state.connected = true;
    sample.state.pose_in_device.translation.vector.x = x;
    sample
}

/// The datagram of hands of an end, if one is due.
fn tick(from: &mut Connection<char>, samples: &[HandSample], now: SimTime) -> Option<Vec<u8>> {
    let mut out = [0; DATAGRAM_MAX];
    let length = from.tick(samples, now, &mut out)?;
    from.sent(samples, length, true, now);
    Some(out[..length].to_vec())
}

#[test]
fn hands_go_both_ways_and_each_end_learns_the_round_trip() {
    let (mut host, mut station) = ends();
    for ms in 1..=500 {
        if let Some(mut datagram) = tick(&mut station, &[hand(1e-4 * ms as f64)], MS(ms)) {
            host.receive(MS(ms) + MS(5), 's', &mut datagram).expect("it is authentic");
        }
        if let Some(mut datagram) = tick(&mut host, &[hand(0.0)], MS(ms) + MS(5)) {
            station.receive(MS(ms) + MS(10), 'h', &mut datagram).expect("it is authentic");
        }
    }
    let read = host.read(0, MS(506)).expect("a sample");
    assert!((read.sample.state.pose_in_device.translation.vector.x - 0.05).abs() < 1e-3);
    assert_eq!((host.address(), host.heard_at().is_some()), (Some('s'), true));
    let round_trip = station.clock().round_trip().expect("measured");
    assert!((MS(9)..=MS(11)).contains(&round_trip), "{round_trip}");
}

#[test]
fn a_change_of_keys_loses_nothing_while_both_ends_take_it_in_turn() {
    let (mut host, mut station) = ends();
    let mut out = [0; DATAGRAM_MAX];
    let mut sent = |from: &mut Connection<char>, to: &mut Connection<char>, now: SimTime| {
        let length = from.seal(Kind::RowAcks, b"row", now, &mut out).expect("it is sealed");
        let (arrived, _) = to.receive(now, 's', &mut out[..length]).expect("it is opened");
        assert_eq!(arrived, Arrived::RowAcks(b"row"));
    };
    sent(&mut station, &mut host, MS(1));
    // The host can open the next phase before it asks for it; the station then takes both keys, the host its own last.
    let (_, opens) = keys(1).split(Side::Server);
    host.rekey_opener(MS(2), opens).expect("the next phase");
    sent(&mut station, &mut host, MS(3));
    let (seals, opens) = keys(1).split(Side::Client);
    station.rekey_opener(MS(4), opens).expect("the next phase");
    station.rekey_sealer(seals).expect("the next phase");
    sent(&mut station, &mut host, MS(5));
    sent(&mut host, &mut station, MS(6));
    let (seals, _) = keys(1).split(Side::Server);
    host.rekey_sealer(seals).expect("the next phase");
    sent(&mut host, &mut station, MS(7));
    let (seals, _) = keys(3).split(Side::Server);
    assert!(host.rekey_sealer(seals).is_err(), "a phase is left out");
}

#[test]
fn a_station_that_moves_to_another_address_is_followed_after_its_answer() {
    let (mut host, mut station) = ends();
    let mut out = [0; DATAGRAM_MAX];
    let mut first = tick(&mut station, &[hand(0.0)], MS(1)).expect("the first");
    assert_eq!(host.receive(MS(2), 's', &mut first).expect("authentic").1, None);
    let mut moved = tick(&mut station, &[hand(0.1)], MS(30)).expect("it has moved");
    let (arrived, challenge) = host.receive(MS(31), 'n', &mut moved).expect("authentic");
    assert_eq!((arrived, host.address()), (Arrived::Hands, Some('s')));
    let challenge = challenge.expect("a challenge");
    let length = host.seal(challenge.kind, &challenge.payload, MS(31), &mut out).expect("sealed");
    let (_, answer) = station.receive(MS(32), 'h', &mut out[..length]).expect("authentic");
    let answer = answer.expect("an answer");
    assert_eq!((answer.kind, answer.payload), (Kind::PathResponse, challenge.payload));
    let length = station.seal(answer.kind, &answer.payload, MS(32), &mut out).expect("sealed");
    host.receive(MS(33), 'n', &mut out[..length]).expect("authentic");
    assert_eq!(host.address(), Some('n'));
}

#[test]
fn authentic_nonsense_is_counted_and_a_strangers_datagram_is_not_authentic() {
    let (mut host, mut station) = ends();
    let mut out = [0; DATAGRAM_MAX];
    for (kind, payload) in
        [(Kind::Report, &[1_u8, 2][..]), (Kind::PathChallenge, &[0; 9]), (Kind::Hands, &[0; 3])]
    {
        let length = station.seal(kind, payload, MS(1), &mut out).expect("sealed");
        let refused = host.receive(MS(1), 's', &mut out[..length]).expect_err("it cannot be read");
        assert_eq!(refused, ConnectionError::Malformed(kind));
    }
    assert_eq!(host.counts().malformed, 3);
    let length = station.seal(Kind::Rows, b"rows", MS(2), &mut out).expect("sealed");
    out[length - 1] ^= 1;
    assert!(matches!(host.receive(MS(2), 's', &mut out[..length]), Err(ConnectionError::Refused(_))));
    assert_eq!(host.opener().counts().forged, 1);
}
