//! What a stranger on the path can try against sealed datagrams: replays, flipped bits, reflections, splices, forged
//! sequences. And an audit of the nonces.

use std::collections::BTreeSet;

use ring::aead::{Aad, CHACHA20_POLY1305, LessSafeKey, Nonce, UnboundKey};
use trocar_scene::random::SplitMix64;

use super::*;
use crate::datagram::keys_testing::{End, ends, exporter, keys};
use crate::datagram::{Keys, Kind, Sealer, Side};

const NOW: SimTime = SimTime::ZERO;

/// How many attacks a test tries: 10⁶ when the environment asks for a thorough run.
fn attacks() -> u64 {
    if trocar_test_support::thorough() { 1_000_000 } else { 100_000 }
}

/// A datagram of up to 300 bytes.
fn sealed(sealer: &mut Sealer, random: &mut SplitMix64) -> Vec<u8> {
    let payload: Vec<u8> = (0..random.below(260)).map(|_| random.next_u64() as u8).collect();
    let mut out = [0; DATAGRAM_MAX];
    let kind = Kind::ALL[random.below(5) as usize];
    let length = sealer.seal(kind, 0, SimTime(random.next_u64()), &payload, &mut out).expect("it fits");
    out[..length].to_vec()
}

/// Shows the server a copy, and says whether it was opened.
fn opens(server: &mut End, copy: &mut Vec<u8>, datagram: &[u8]) -> bool {
    copy.clear();
    copy.extend_from_slice(datagram);
    server.opener.open(NOW, copy).is_ok()
}

fn flip(datagram: &mut [u8], random: &mut SplitMix64) {
    let mut flipped = BTreeSet::new();
    for _ in 0..=random.below(3) {
        let bit = random.below(8 * datagram.len() as u64) as usize;
        if flipped.insert(bit) {
            datagram[bit / 8] ^= 1 << (bit % 8);
        }
    }
}

#[test]
fn replays_flipped_bits_reflections_and_splices_are_never_opened() {
    for is_protected in [true, false] {
        let mut random = SplitMix64::new(20);
        let [mut client, mut server] = ends(is_protected);
        let mut copy = Vec::new();
        let seen: Vec<_> = (0..1_000).map(|_| sealed(&mut client.sealer, &mut random)).collect();
        assert!(seen.iter().all(|datagram| opens(&mut server, &mut copy, datagram)));
        // Those under way, which the stranger holds back.
        let held: Vec<_> = (0..1_000).map(|_| sealed(&mut client.sealer, &mut random)).collect();
        let own: Vec<_> = (0..1_000).map(|_| sealed(&mut server.sealer, &mut random)).collect();
        let mut attack = Vec::new();
        for number in 0..attacks() {
            let random = &mut random;
            let one_of = |all: &[Vec<u8>], random: &mut SplitMix64| all[random.below(1_000) as usize].clone();
            attack = match number % 4 {
                0 => one_of(&seen, random),
                1 => {
                    let mut changed = one_of(if number % 8 < 4 { &held } else { &seen }, random);
                    flip(&mut changed, random);
                    changed
                }
                2 => one_of(&own, random),
                _ => {
                    let (head, tail) =
                        (one_of(&held, random), one_of(if number % 8 < 4 { &held } else { &seen }, random));
                    // At the same place of both, at the tag, at the header's end, or anywhere.
                    let cut = match random.below(4) {
                        0 => head.len() - if is_protected { 16 } else { 4 },
                        1 => 24,
                        _ => random.below(head.len() as u64) as usize,
                    };
                    let from = match random.below(3) {
                        0 => cut.min(tail.len()),
                        1 => (tail.len() + cut).saturating_sub(head.len()).min(tail.len()),
                        _ => random.below(tail.len() as u64) as usize,
                    };
                    let spliced = [&head[..cut], &tail[from..]].concat();
                    if spliced == head || spliced == tail { one_of(&seen, random) } else { spliced }
                }
            };
            assert!(!opens(&mut server, &mut copy, &attack), "attack {number}: {attack:?}");
        }
        assert!(!attack.is_empty());
        let counts = *server.opener.counts();
        assert_eq!((counts.opened, counts.refused()), (1_000, attacks()));
        assert!(counts.replayed >= attacks() / 4 && counts.forged >= attacks() / 2, "{counts:?}");
        // Nothing of this harms the honest ones.
        assert!(held.iter().all(|datagram| opens(&mut server, &mut copy, datagram)));
    }
}

#[test]
fn a_forged_leading_sequence_costs_no_honest_datagram() {
    let mut random = SplitMix64::new(19);
    let [mut client, mut server] = ends(true);
    let mut copy = Vec::new();
    for _ in 0..2_000 {
        let honest = sealed(&mut client.sealer, &mut random);
        let sequence = client.sealer.next_sequence() - 1;
        let ahead = [1, 2, 4_095, 4_096, 1_000_000, 1 << 32, u64::MAX - sequence, 1 << 62];
        for ahead in ahead {
            let mut forged = honest.clone();
            forged[8..16].copy_from_slice(&(sequence + ahead).to_le_bytes());
            assert!(!opens(&mut server, &mut copy, &forged));
        }
        assert_eq!(server.opener.newest_sequence(), sequence - 1);
        assert!(opens(&mut server, &mut copy, &honest), "number {sequence}");
    }
    let counts = server.opener.counts();
    assert_eq!((counts.opened, counts.forged, counts.refused()), (2_000, 16_000, 16_000));
}

#[test]
fn a_checksum_is_no_protection() {
    // This is why `--insecure` stays on the loopback: a stranger without any secret makes a valid datagram.
    let [_, mut server] = ends(false);
    let (send, _) = Keys::unprotected(7, 0).split(Side::Client);
    let forged = sealed(&mut Sealer::new(send), &mut SplitMix64::new(1));
    assert!(opens(&mut server, &mut Vec::new(), &forged) && !server.opener.is_protected());
}

#[test]
fn datagrams_of_other_connections_sessions_and_phases_are_not_opened() {
    let mut random = SplitMix64::new(5);
    for (connection, phase, session) in [(7, 0, 2), (8, 0, 1), (7, 1, 1), (7, 256, 1)] {
        let (send, _) = keys(connection, phase, session).split(Side::Client);
        let mut stranger = Sealer::new(send);
        let [_, mut server] = ends(true);
        for _ in 0..100 {
            let mut datagram = sealed(&mut stranger, &mut random);
            assert!(server.opener.open(NOW, &mut datagram.clone()).is_err());
            // Nor when connection and phase are made to fit.
            datagram[2] = 0;
            datagram[4..8].copy_from_slice(&[7, 0, 0, 0]);
            assert_eq!(server.opener.open(NOW, &mut datagram).err(), Some(Refused::Forged));
        }
    }
}

/// Key and initialisation vector of a direction, read from the exporter as the table says.
fn secret(connection: u32, phase: u32, session: u64, is_to_client: bool) -> ([u8; 32], [u8; 12]) {
    let mut bytes = [0; 88];
    let context = [connection.to_le_bytes(), phase.to_le_bytes()].concat();
    exporter(session)(b"EXPORTER-trocar-datagrams", &context, &mut bytes).expect("it exports");
    let place = if is_to_client { 44 } else { 0 };
    let half = &bytes[place..place + 44];
    (half[..32].try_into().expect("32 bytes"), half[32..].try_into().expect("12 bytes"))
}

#[test]
fn no_nonce_is_used_twice_with_a_key() {
    // Each datagram is opened here by the cipher alone, with a nonce that the test computes: so it is the one that was
    // used, and the sets below are a true log.
    let mut random = SplitMix64::new(25);
    let (mut pairs, mut all_keys) = (BTreeSet::new(), BTreeSet::new());
    let mut count = 0;
    for (connection, session) in [(1, 1), (2, 1), (1, 2), (u32::MAX, 3)] {
        for (side, is_to_client) in [(Side::Client, false), (Side::Server, true)] {
            let mut sealer = Sealer::new(keys(connection, 0, session).split(side).0);
            for phase in 0..300 {
                if phase > 0 {
                    sealer.rekey(keys(connection, phase, session).split(side).0).expect("it is the next");
                }
                let (key, iv) = secret(connection, phase, session, is_to_client);
                assert!(all_keys.insert(key), "phase {phase} of connection {connection} has a key again");
                let cipher = LessSafeKey::new(UnboundKey::new(&CHACHA20_POLY1305, &key).expect("32 bytes"));
                for _ in 0..4 {
                    // Refused ones take no nonce, or at least none that comes again.
                    let too_long = [0; DATAGRAM_MAX];
                    let mut out = [0; DATAGRAM_MAX];
                    assert!(sealer.seal(Kind::Rows, 0, NOW, &too_long, &mut out).is_err());
                    let mut datagram = sealed(&mut sealer, &mut random);
                    let (head, body) = datagram.split_at_mut(24);
                    let mut nonce = iv;
                    for place in 0..8 {
                        nonce[4 + place] ^= head[15 - place];
                    }
                    let opened =
                        cipher.open_in_place(Nonce::assume_unique_for_key(nonce), Aad::from(&*head), body);
                    assert!(opened.is_ok(), "the nonce is not the sequence's");
                    assert!(pairs.insert((key, nonce)), "a nonce came twice");
                    count += 1;
                }
            }
        }
    }
    assert_eq!((pairs.len(), all_keys.len(), count), (9_600, 2_400, 9_600));
}
