//! Tests of the opener: what passes, what is refused for which reason, and changes of keys.

use proptest::prelude::*;
use trocar_scene::random::SplitMix64;

use super::*;
use crate::datagram::keys_testing::{End, GRACE, ends, keys};
use crate::datagram::{Hands, Keys, Kind, REPLAY_WINDOW, Side};
use crate::hand_sample::HandSample;

const NOW: SimTime = SimTime::ZERO;

/// A datagram with a payload of some bytes.
fn sealed(end: &mut End, payload: &[u8]) -> Vec<u8> {
    let mut out = [0; DATAGRAM_MAX];
    let length = end.sealer.seal(Kind::Rows, 0, SimTime(5), payload, &mut out).expect("it fits");
    out[..length].to_vec()
}

fn open(end: &mut End, datagram: &[u8]) -> Result<(Header, Vec<u8>), Refused> {
    open_at(end, NOW, datagram)
}

fn open_at(end: &mut End, now: SimTime, datagram: &[u8]) -> Result<(Header, Vec<u8>), Refused> {
    let mut datagram = datagram.to_vec();
    end.opener.open(now, &mut datagram).map(|(header, payload)| (header, payload.to_vec()))
}

/// A client that seals with the next key, and a server that knows it.
fn rekey(client: &mut End, server: &mut End, now: SimTime, phase: u32) {
    server.opener.rekey(now, keys(7, phase, 1).split(Side::Server).1).expect("it is the next");
    client.sealer.rekey(keys(7, phase, 1).split(Side::Client).0).expect("it is the next");
}

#[test]
fn hands_pass_in_both_directions_under_both_seals() {
    for is_protected in [true, false] {
        let [mut client, mut server] = ends(is_protected);
        assert!([&client, &server].iter().all(|end| end.sealer.is_protected() == is_protected));
        assert!([&client, &server].iter().all(|end| end.opener.is_protected() == is_protected));
        let samples = [HandSample::unknown(3), HandSample::unknown(1)];
        let (mut out, mut hands) = ([0; DATAGRAM_MAX], Hands::default());
        for sequence in 1..100 {
            for _ in 0..2 {
                let sent_at = SimTime(1_000 * sequence);
                let length = client.sealer.seal_hands(sent_at, None, &samples, &mut out).expect("they fit");
                let (header, payload) = server.opener.open(NOW, &mut out[..length]).expect("it is new");
                let expected =
                    Header { kind: Kind::Hands, phase: 0, hands: 2, connection: 7, sequence, sent_at };
                assert_eq!(header, expected);
                hands.decode(header.hands, payload).expect("it is valid");
                assert_eq!(hands.samples(), samples);
                std::mem::swap(&mut client, &mut server);
            }
        }
    }
}

#[test]
fn a_sealed_payload_cannot_be_read_and_its_header_can() {
    let [mut client, _] = ends(true);
    let datagram = sealed(&mut client, &[0; 64]);
    assert_eq!(datagram[..16], [1, 1, 0, 0, 7, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0]);
    assert!(datagram[24..].iter().filter(|byte| **byte == 0).count() < 8, "{datagram:?}");
    assert_eq!(datagram.len(), 24 + 64 + 16);
}

#[test]
fn every_refusal_is_counted_by_its_reason() {
    let [mut client, mut server] = ends(true);
    let datagram = sealed(&mut client, &[9; 20]);
    let with = |place: usize, value: u8| {
        let mut changed = datagram.clone();
        changed[place] = value;
        changed
    };
    let length = |bytes| Refused::Length { bytes, min: 40 };
    assert_eq!(open(&mut server, &[]), Err(length(0)));
    assert_eq!(open(&mut server, &datagram[..39]), Err(length(39)));
    assert_eq!(open(&mut server, &[1; 1_201]), Err(length(1_201)));
    assert_eq!(open(&mut server, &with(0, 9)), Err(HeaderError::Version(9).into()));
    assert_eq!(open(&mut server, &with(1, 9)), Err(HeaderError::Kind(9).into()));
    let hands = HeaderError::Hands { kind: Kind::Rows, hands: 9 };
    assert_eq!(open(&mut server, &with(3, 9)), Err(hands.into()));
    assert_eq!(open(&mut server, &with(4, 9)), Err(Refused::Connection { given: 9, expected: 7 }));
    assert_eq!(open(&mut server, &with(2, 9)), Err(Refused::Phase { given: 9, current: 0 }));
    assert_eq!(open(&mut server, &with(16, 9)), Err(Refused::Forged));
    assert_eq!(open(&mut server, &datagram[..40]), Err(Refused::Forged));
    assert_eq!(server.opener.newest_sequence(), 0);
    assert!(open(&mut server, &datagram).is_ok());
    assert_eq!(open(&mut server, &datagram), Err(Stale::Replayed(1).into()));
    let late = sealed(&mut client, &[]);
    client.sealer.skip_to(2 + REPLAY_WINDOW);
    let newest = sealed(&mut client, &[]);
    assert!(open(&mut server, &newest).is_ok());
    let too_old = Stale::TooOld { sequence: 2, newest: 2 + REPLAY_WINDOW };
    assert_eq!(open(&mut server, &late), Err(too_old.into()));
    let expected = RefusalCounts {
        opened: 2,
        length: 3,
        version: 1,
        header: 2,
        connection: 1,
        phase: 1,
        forged: 2,
        replayed: 1,
        too_old: 1,
    };
    assert_eq!((*server.opener.counts(), server.opener.counts().refused()), (expected, 12));
}

#[test]
fn around_every_power_of_two_each_number_is_opened_once() {
    for around in [1 << 16, 1 << 32, 1 << 48, u64::MAX] {
        let [mut client, mut server] = ends(true);
        // So that the present key has not sealed more than one may.
        client.sealer.skip_to(around - 1_000);
        rekey(&mut client, &mut server, NOW, 1);
        let mut datagrams = Vec::new();
        while datagrams.len() < 2_000 && client.sealer.next_sequence() < u64::MAX {
            datagrams.push(sealed(&mut client, &[]));
        }
        assert_eq!(datagrams.len(), if around == u64::MAX { 1_000 } else { 2_000 });
        let count = datagrams.len() as u64;
        // Neighbours overtake each other, and each comes twice.
        let mut random = SplitMix64::new(around);
        for place in 0..datagrams.len() {
            let other = (place + random.below(8) as usize).min(datagrams.len() - 1);
            datagrams.swap(place, other);
        }
        for datagram in &datagrams {
            assert!(open(&mut server, datagram).is_ok());
            assert!(matches!(open(&mut server, datagram), Err(Refused::Stale(Stale::Replayed(_)))));
        }
        let counts = server.opener.counts();
        assert_eq!((counts.opened, counts.replayed, counts.refused()), (count, count, count));
    }
}

#[test]
fn a_change_of_keys_loses_nothing_that_was_under_way() {
    let [mut client, mut server] = ends(true);
    let [early, overtaken, lost] = [1, 2, 3].map(|byte| sealed(&mut client, &[byte]));
    server.opener.rekey(NOW, keys(7, 1, 1).split(Side::Server).1).expect("it is the next");
    // The sender has not changed yet.
    assert!(open(&mut server, &early).is_ok() && server.opener.phase() == 0);
    client.sealer.rekey(keys(7, 1, 1).split(Side::Client).0).expect("it is the next");
    let changed = sealed(&mut client, &[4]);
    let at = SimTime::from_millis(500);
    let (header, payload) = open_at(&mut server, at, &changed).expect("its key is known");
    // Numbers go on.
    assert_eq!((header.phase, header.sequence, payload), (1, 4, vec![4]));
    assert_eq!(server.opener.phase(), 1);
    assert!(open_at(&mut server, at + GRACE, &overtaken).is_ok());
    // What was opened under the old key is still known as opened.
    assert_eq!(open_at(&mut server, at + GRACE, &early), Err(Stale::Replayed(1).into()));
    let after = at + GRACE + SimTime(1);
    assert_eq!(open_at(&mut server, after, &lost), Err(Refused::Phase { given: 0, current: 1 }));
}

#[test]
fn a_forged_datagram_of_the_next_phase_does_not_change_the_key() {
    let [mut client, mut server] = ends(true);
    server.opener.rekey(NOW, keys(7, 1, 1).split(Side::Server).1).expect("it is the next");
    let honest = sealed(&mut client, &[1]);
    let mut forged = honest.clone();
    forged[2] = 1;
    assert_eq!(open(&mut server, &forged), Err(Refused::Forged));
    assert_eq!(server.opener.phase(), 0);
    assert!(open_at(&mut server, SimTime::from_millis(10_000), &honest).is_ok());
}

#[test]
fn keys_change_more_often_than_a_header_can_count() {
    let [mut client, mut server] = ends(true);
    let first = sealed(&mut client, &[]);
    for phase in 1..=600 {
        let now = SimTime::from_millis(u64::from(phase) * 1_000);
        rekey(&mut client, &mut server, now, phase);
        let datagram = sealed(&mut client, &[]);
        let (header, _) = open_at(&mut server, now, &datagram).expect("its key is known");
        assert_eq!((header.phase, header.sequence), (phase as u8, u64::from(phase) + 1));
        // The byte of its phase comes again; its key does not.
        if phase % 256 == 0 {
            assert_eq!(open_at(&mut server, now, &first), Err(Refused::Forged));
        }
    }
}

#[test]
fn a_silent_direction_takes_one_key_after_the_other() {
    let [mut client, mut server] = ends(true);
    for phase in 1..=3 {
        rekey(&mut client, &mut server, NOW, phase);
    }
    assert_eq!(server.opener.phase(), 2);
    let datagram = sealed(&mut client, &[]);
    assert!(open(&mut server, &datagram).is_ok() && server.opener.phase() == 3);
    let error = server.opener.rekey(NOW, keys(7, 3, 1).split(Side::Server).1);
    assert_eq!(error, Err(RekeyError::Phase { given: 3, expected: 4 }));
    // A protected connection stays protected.
    let error = server.opener.rekey(NOW, Keys::unprotected(7, 4).split(Side::Server).1);
    assert!(matches!(error, Err(RekeyError::Seal { .. })), "{error:?}");
}

proptest! {
    #[test]
    fn any_bytes_are_refused_without_a_panic(
        mut bytes in prop::collection::vec(any::<u8>(), 0..1_300),
        likely in any::<bool>(),
        is_protected in any::<bool>(),
    ) {
        let [_, mut server] = ends(is_protected);
        if likely && bytes.len() >= 24 {
            bytes[..8].copy_from_slice(&[1, 0, 0, 2, 7, 0, 0, 0]);
        }
        prop_assert!(server.opener.open(NOW, &mut bytes).is_err());
        prop_assert_eq!(server.opener.newest_sequence(), 0);
    }

    #[test]
    fn a_datagram_opens_to_what_was_sealed_and_with_changed_bytes_not_at_all(
        payload in prop::collection::vec(any::<u8>(), 0..=1_160),
        changes in prop::collection::vec((any::<prop::sample::Index>(), 1..=255_u8), 1..4),
        cut in any::<prop::sample::Index>(),
        is_protected in any::<bool>(),
    ) {
        let [mut client, mut server] = ends(is_protected);
        let datagram = sealed(&mut client, &payload);
        let mut changed = datagram.clone();
        for (place, bits) in changes {
            changed[place.index(datagram.len())] ^= bits;
        }
        // Two changes of a byte may undo each other.
        if changed != datagram {
            prop_assert!(open(&mut server, &changed).is_err());
        }
        prop_assert!(open(&mut server, &datagram[..cut.index(datagram.len())]).is_err());
        prop_assert_eq!(open(&mut server, &datagram).expect("it is new").1, payload);
    }
}
