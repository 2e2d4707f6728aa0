//! Limits: slow ends, nonsense, and what a role does not allow.

use std::sync::Arc;

use proptest::prelude::*;
use trocar_scene::{Entity, Revision, SimTime, SurfacePlace, SurfacePoint};
use trocar_test_support::hostile::mutated;

use super::client::ClientState;
use super::error::{ControlError, Goodbye};
use super::frame::{FRAME_MAX, FrameError, LENGTH_BYTES, OPENING_MAX, PREAMBLE_BYTES};
use super::host::{FORBIDDEN_MAX, HostControl, HostState, JOIN_TIME_MAX, OPENING_TIME_MAX, SendError};
use super::keep_alive::Ping;
use super::message::{ClientMessage, DELTA_MAX, HostMessage, Request, RequestKind};
use super::note::{Note, NoteKind, TakeOver};
use super::outbox::{STALLED_MAX, WAITING_MAX};
use super::plain_text::PlainText;
use super::session_testing::{Pair, TestSession, ms, name, ticket, wish};

fn hello() -> Vec<u8> {
    Pair::operating().say_hello()
}

#[test]
fn who_opens_slowly_is_dropped_without_a_word_after_five_seconds() {
    let mut session = TestSession::new(10);
    let mut host = HostControl::new(Arc::clone(&Pair::operating().facts), SimTime::ZERO);
    let hello = hello();
    for (at, byte) in hello[..49].iter().enumerate() {
        host.receive(&[*byte], ms(100 * at as u64), &mut session);
        assert!(!host.poll(ms(100 * at as u64)).is_over);
    }
    assert_eq!(host.poll(ms(4_900)).deadline, OPENING_TIME_MAX);
    assert!(host.poll(OPENING_TIME_MAX).is_over);
    assert_eq!(host.error(), Some(&ControlError::SlowOpening(OPENING_TIME_MAX)));
    assert!(host.outgoing().is_empty());
    host.receive(&hello, OPENING_TIME_MAX, &mut session);
    assert_eq!(session.redeemed, 0);
}

#[test]
fn a_stranger_may_not_announce_what_a_station_may() {
    let mut session = TestSession::new(10);
    let mut host = HostControl::new(Arc::clone(&Pair::operating().facts), SimTime::ZERO);
    let length = OPENING_MAX as u32 + 1;
    host.receive(&length.to_le_bytes(), ms(1), &mut session);
    assert_eq!(host.error(), Some(&ControlError::Frame(FrameError::TooLong { length, most: OPENING_MAX })));
    assert!(host.outgoing().is_empty(), "a stranger gets no answer");
    let mut pair = Pair::operating();
    pair.join();
    let (now, rows) = (pair.now, vec![3; DELTA_MAX]);
    pair.client.write(&rows, now).expect("a station may");
    pair.step();
    assert_eq!(pair.session.written, rows);
    assert!(matches!(pair.client.write(&[0; DELTA_MAX + 1], now), Err(SendError::Message(_))));
    pair.host().receive(&(FRAME_MAX as u32 + 1).to_le_bytes(), now, &mut TestSession::new(0));
    assert!(
        matches!(pair.end(), ControlError::Goodbye(Goodbye::Broken(text)) if text.as_str().contains("1048577"))
    );
}

#[test]
fn what_a_watcher_may_not_do_is_refused_and_named_at_both_ends() {
    let mut pair = Pair::new(TestSession::new(10), ticket(2), wish("Vera", &[]));
    pair.join();
    let now = pair.now;
    pair.client.write(&[1, 2, 3], now).expect("it runs");
    let take = pair.client.request(RequestKind::TakeHand(name("left")), now).expect("it runs");
    let point = pair.client.request(RequestKind::Note(NoteKind::Pointer(None)), now).expect("it runs");
    pair.step();
    assert!(pair.session.written.is_empty(), "nothing of it reached the scene");
    assert_eq!(pair.session.roster.hands()[0].station, None);
    assert_eq!((take, point), (0, 1));
    for (heard, deed) in pair.heard.iter().zip(["write to the scene", "take a hand", "point"]) {
        assert!(heard.contains(&format!("deed: PlainText(\"{deed}\")")), "{heard}");
    }
    assert!(pair.heard[0].contains("request: None") && pair.heard[2].contains("request: Some(1)"));
    let named: Vec<_> = pair.session.heard.iter().filter(|line| line.starts_with("100: Forbidden")).collect();
    assert_eq!(named.len(), 3, "{:?}", pair.session.heard);
    assert!(pair.is_running(), "one oversight is no reason to leave");
    for _ in 0..FORBIDDEN_MAX {
        pair.client.write(&[1], now).expect("it runs");
    }
    assert_eq!(pair.host_end(), ControlError::TooManyRefusals(FORBIDDEN_MAX + 1));
}

#[test]
fn notes_carry_the_station_that_sent_them_and_only_a_mentor_asks_for_an_instrument() {
    let mut pair = Pair::new(TestSession::new(10), ticket(3), wish("Mona", &[]));
    pair.join();
    let now = pair.now;
    let on = |barycentric| SurfacePlace {
        entity: Entity::new(0, 0, 4),
        on: SurfacePoint::Triangle { corners: [7, 8, 9], barycentric },
    };
    let place = on([0.5, 0.25, 0.25]);
    let label = NoteKind::Label { label: 1, place, text: PlainText::new("cut here") };
    pair.client.request(RequestKind::Note(label), now).expect("it runs");
    pair.client
        .request(RequestKind::Note(NoteKind::TakeOver { hand: 0, step: TakeOver::Ask }), now)
        .expect("it runs");
    pair.step();
    let heard = &pair.session.heard;
    assert!(heard[2].starts_with("Note { station: 100") && heard[2].contains("cut here"), "{heard:?}");
    assert!(heard[4].contains("step: Ask"), "{heard:?}");
    let astray = NoteKind::Pointer(Some(on([f32::NAN; 3])));
    let refused = pair.client.request(RequestKind::Note(astray), now);
    assert!(matches!(refused, Err(SendError::Message(_))), "{refused:?}");

    let mut pair = Pair::operating();
    pair.join();
    let ask = RequestKind::Note(NoteKind::TakeOver { hand: 1, step: TakeOver::Ask });
    pair.client.request(ask, pair.now).expect("it runs");
    pair.step();
    assert!(pair.heard[0].contains("take over an instrument"), "{:?}", pair.heard);
}

#[test]
fn a_request_is_answered_by_its_number_with_what_is_valid() {
    let mut pair = Pair::operating();
    pair.join();
    let now = pair.now;
    pair.client.request(RequestKind::TakeHand(name("right")), now).expect("it runs");
    pair.client.request(RequestKind::TakeHand(name("third")), now).expect("it runs");
    pair.client.request(RequestKind::GiveHand(name("left")), now).expect("it runs");
    pair.step();
    assert_eq!(pair.heard[0], "Answer { request: Some(0), refusal: None }");
    assert!(
        pair.heard[1].contains("Some(1)") && pair.heard[1].contains("PlainName(\"left\")"),
        "{:?}",
        pair.heard
    );
    assert_eq!(pair.heard[2], "Answer { request: Some(2), refusal: None }");
    let served: Vec<_> = pair.session.roster.hands().iter().map(|hand| hand.station).collect();
    assert_eq!(served, [None, Some(100)]);
}

#[test]
fn a_station_that_stops_reading_is_dropped_with_the_reason_before_it_fills_the_memory() {
    let mut pair = Pair::operating();
    pair.join();
    pair.to_client.0 = 100;
    let part = vec![7; DELTA_MAX];
    let mut sent = 0;
    let error = loop {
        let now = pair.now;
        match pair.host().send_delta(&part, now) {
            Ok(()) => sent += part.len(),
            Err(error) => break error,
        }
        pair.step();
    };
    assert!(sent <= WAITING_MAX && sent > WAITING_MAX / 2, "{sent} bytes");
    assert!(matches!(error, SendError::Ended(ControlError::TooSlow(_))), "{error}");
    // It can still read why, behind the frame that it is in the middle of.
    pair.to_client.0 = usize::MAX;
    let told = pair.end();
    assert!(matches!(told, ControlError::Goodbye(Goodbye::TooSlow(_))), "{told}");
    assert_eq!(told.exit_class().code(), 75);
}

#[test]
fn a_station_that_takes_nothing_for_five_seconds_is_dropped_though_it_still_pings() {
    let mut pair = Pair::operating();
    pair.join();
    let (from, mut host) = (pair.now, pair.host.take().expect("a connection"));
    let mut now = from;
    while host.state() == HostState::Running {
        now += ms(500);
        let mut pings = super::outbox::Outbox::default();
        pings.push(&ClientMessage::Ping(Ping { sent_at: now }), false, now).expect("room");
        host.receive(pings.waiting(), now, &mut pair.session);
        host.poll(now);
    }
    assert_eq!(host.error(), Some(&ControlError::Stalled(STALLED_MAX)));
    assert_eq!(now.since(from), ms(500) + STALLED_MAX);
}

#[test]
fn a_station_that_never_builds_its_scene_is_dropped() {
    let mut pair = Pair::operating();
    pair.builds = false;
    let (error, code) = (pair.host_end(), pair.end().exit_class().code());
    assert!(error.to_string().contains("did not have the scene within 120"), "{error}");
    assert!(code == 75 && pair.now <= JOIN_TIME_MAX + ms(100), "{code} at {}", pair.now);
}

#[test]
fn a_message_out_of_place_ends_the_connection_and_is_named() {
    let joined = ClientMessage::Joined { revision: Revision(1), digest: [0; 32] };
    let request = ClientMessage::Request(Request { number: 1, what: RequestKind::TakeHand(name("left")) });
    for (message, word) in [(joined, "joined"), (ClientMessage::Rekeyed { phase: 3 }, "rekeyed")] {
        let mut pair = Pair::operating();
        pair.join();
        let error = told(&mut pair, &message);
        assert!(
            error.to_string().contains(&format!("'{word}' is not valid within a running session")),
            "{error}"
        );
    }
    let mut pair = Pair::operating();
    pair.builds = false;
    pair.run_until(|pair| pair.host.as_ref().is_some_and(|host| host.state() == HostState::Awaiting));
    let error = told(&mut pair, &request);
    assert!(error.to_string().contains("before the station has built the scene"), "{error}");
}

fn told(pair: &mut Pair, message: &ClientMessage<'_>) -> ControlError {
    let mut outbox = super::outbox::Outbox::default();
    outbox.push(message, false, pair.now).expect("room");
    let host = pair.host.as_mut().expect("a connection");
    host.receive(outbox.waiting(), pair.now, &mut pair.session);
    host.error().expect("an error").clone()
}

#[test]
fn a_changed_byte_anywhere_in_a_hello_is_an_error_or_a_refusal_and_never_a_panic() {
    let hello = hello();
    let mut refused = 0;
    for at in 0..hello.len() {
        for change in [0x01, 0x80, 0xff] {
            let mut bytes = hello.clone();
            bytes[at] ^= change;
            let mut session = TestSession::new(10);
            let mut host = HostControl::new(Arc::clone(&Pair::operating().facts), SimTime::ZERO);
            host.receive(&bytes, ms(1), &mut session);
            host.poll(OPENING_TIME_MAX);
            refused += u32::from(host.state() == HostState::Ended);
        }
    }
    // TLS finds every change. What is left without it are letters of a name, and bytes of a secret of the station's own.
    assert!(2 * refused > 3 * hello.len() as u32, "{refused} of {}", 3 * hello.len());
}

#[test]
fn a_changed_byte_anywhere_on_the_way_to_the_station_never_makes_another_scene() {
    let mut pair = Pair::new(TestSession::new(20), ticket(1), wish("Ana", &[]));
    pair.to_client.0 = 0;
    pair.run_until(|pair| pair.host.as_ref().is_some_and(|host| host.state() == HostState::Awaiting));
    let stream = pair.host().outgoing().to_vec();
    for at in 0..stream.len() {
        for change in [0x01, 0x80] {
            let mut bytes = stream.clone();
            bytes[at] ^= change;
            let mut pair = Pair::new(TestSession::new(20), ticket(1), wish("Ana", &[]));
            pair.say_hello();
            pair.deliver(&bytes);
            let is_same = pair.scene == pair.session.scene;
            assert!(pair.client.state() != ClientState::Running || is_same, "byte {at}");
        }
    }
}

/// Messages of a station and of a host, encoded: the longest, and some with numbers and lists.
fn messages() -> Vec<Vec<u8>> {
    let mut pair = Pair::operating();
    let hello = pair.say_hello();
    pair.to_client.0 = 0;
    pair.run_until(|pair| pair.host.as_ref().is_some_and(|host| !host.outgoing().is_empty()));
    let opening = LENGTH_BYTES + PREAMBLE_BYTES;
    let welcome = pair.host().outgoing().to_vec();
    let end = LENGTH_BYTES + u32::from_le_bytes(std::array::from_fn(|at| welcome[at])) as usize;
    let on = SurfacePoint::Triangle { corners: [7, 8, 9], barycentric: [0.2, 0.3, 0.5] };
    let place = SurfacePlace { entity: Entity::new(0, 0, 7), on };
    let stroke = NoteKind::Stroke { stroke: 1, colour: [9; 3], width: 0.002, places: vec![place; 5] };
    let note = Note { station: 3, at: ms(5), what: stroke.clone() };
    let request = ClientMessage::Request(Request { number: 7, what: RequestKind::Note(stroke) });
    let roster = HostMessage::Roster(pair.session.roster.stations());
    let encoded = [postcard::to_stdvec(&HostMessage::Note(note)), postcard::to_stdvec(&request)];
    let mut messages = vec![hello[opening..].to_vec(), welcome[opening..end].to_vec()];
    messages.extend(encoded.map(|message| message.expect("it encodes")));
    messages.push(postcard::to_stdvec(&roster).expect("it encodes"));
    messages
}

proptest! {
    #[test]
    fn a_damaged_message_is_refused_or_written_as_it_is_read(bytes in mutated(messages())) {
        if let Ok(message) = ClientMessage::decode(&bytes) {
            let again = postcard::to_stdvec(&message).expect("it encodes");
            prop_assert_eq!(ClientMessage::decode(&again), Ok(message));
        }
        if let Ok(message) = HostMessage::decode(&bytes) {
            let again = postcard::to_stdvec(&message).expect("it encodes");
            prop_assert_eq!(HostMessage::decode(&again), Ok(message));
        }
    }

    #[test]
    fn no_bytes_make_a_message_reader_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        let _ = ClientMessage::decode(&bytes);
        let _ = HostMessage::decode(&bytes);
    }

    #[test]
    fn no_bytes_make_a_running_end_panic_or_answer_without_bound(
        bytes in prop::collection::vec(any::<u8>(), 0..300), is_framed: bool,
    ) {
        let mut pair = Pair::operating();
        pair.join();
        let mut stream = if is_framed { (bytes.len() as u32).to_le_bytes().to_vec() } else { Vec::new() };
        stream.extend(&bytes);
        let now = pair.now;
        pair.deliver(&stream);
        let host = pair.host.as_mut().expect("a connection");
        host.receive(&stream, now, &mut pair.session);
        prop_assert!(host.outgoing().len() < 100 * (bytes.len() + 10));
        host.poll(now + ms(100_000));
        pair.client.poll(now + ms(100_000));
    }

    #[test]
    fn what_is_read_is_what_was_written(number: u32, phase: u32, at: u64, bytes in prop::collection::vec(any::<u8>(), 0..99)) {
        let served = HostMessage::HandServed { hand: number as u8, station: Some(phase as u16), at: SimTime(at) };
        let delta = HostMessage::Delta(bytes.as_slice().into());
        for message in [served, delta, HostMessage::Rekey { phase }] {
            let encoded = postcard::to_stdvec(&message).expect("it encodes");
            prop_assert_eq!(HostMessage::decode(&encoded), Ok(message.clone()));
            let mut longer = encoded.clone();
            longer.push(0);
            prop_assert!(HostMessage::decode(&longer).is_err(), "a byte too many");
            prop_assert!(HostMessage::decode(&encoded[..encoded.len() - 1]).is_err(), "a byte too few");
        }
    }
}
