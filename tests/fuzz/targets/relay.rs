//! A relay: what strangers and hosts say to it in any order, among what a host with the key says.
#![no_main]

use std::net::SocketAddr;

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::{first, first_chunk};
use trocar_network::relay::{
    Bind, FromHost, FromRelay, LineDecoder, LineNews, Nonce, RelayKey, RelaySwitch, StreamId, numbered,
};
use trocar_scene::SimTime;

const PORTS: [u16; 2] = [7_500, 7_501];

fn address(byte: u8) -> SocketAddr {
    SocketAddr::from(([192, 0, 2, byte >> 4], 1_000 + u16::from(byte)))
}

fn host() -> SocketAddr {
    SocketAddr::from(([198, 51, 100, 1], 9))
}

fuzz_target!(|bytes: &[u8]| {
    let key: RelayKey = "ab".repeat(32).parse().expect("a key");
    let mut relay = RelaySwitch::new(key.clone(), PORTS.to_vec());
    let (mut now, mut line, mut nonce) = (SimTime::ZERO, 0_u64, Nonce::default());
    let (mut port, mut registered, mut stream, mut binds) = (0, Nonce::default(), StreamId(0), 0);
    let mut rest = bytes;
    while !rest.is_empty() {
        let (what, after) = first(rest);
        let (length, after) = first(after);
        let (taken, after) = after.split_at(usize::from(length).min(after.len()));
        rest = after;
        let (byte, _) = first(taken);
        match what % 9 {
            0 => {
                line += 1;
                (nonce, _) = first_chunk(taken);
                let (words, _) = relay.line_opened(line, nonce, now);
                assert_eq!(FromRelay::decode(&words[1..]), Ok(FromRelay::Challenge(nonce)));
            }
            1 => {
                let (mut decoder, mut input) = (LineDecoder::default(), taken);
                while let Ok(Some(message)) = decoder.next(&mut input) {
                    // Both directions read any bytes.
                    let _ = FromRelay::decode(&message);
                    if let Ok(message) = FromHost::decode(&message) {
                        relay.line_heard(line, &message, now);
                    }
                }
            }
            2 => {
                if let LineNews::Registered(given, _) =
                    relay.line_heard(line, &key.register(&nonce, u16::from(byte)), now)
                {
                    assert!(PORTS.contains(&given));
                    (port, registered, binds) = (given, nonce, 0);
                }
            }
            3 => {
                if let Some((given, ..)) = relay.knocked(PORTS[usize::from(byte & 1)], address(byte), now) {
                    assert!(given > stream, "numbers of streams rise");
                    stream = given;
                }
            }
            4 => {
                if let LineNews::Splice(_, fetched) =
                    relay.line_heard(line, &key.fetch(&nonce, stream.0), now)
                {
                    assert_eq!(fetched, stream);
                }
            }
            5 => {
                let forwarded =
                    relay.from_station(PORTS[usize::from(byte & 1)], address(byte), taken.len(), now);
                assert!(forwarded.is_none_or(|(to, _)| to == host()), "only who has bound gets datagrams");
            }
            6 => {
                assert_eq!(relay.from_host(address(byte), taken, now), None, "a stranger is no host");
                let mut datagram = Vec::new();
                numbered(u32::from(byte), taken, &mut datagram);
                if let Some((_, _, forwarded)) = relay.from_host(host(), &datagram, now) {
                    assert_eq!(forwarded, taken);
                }
            }
            7 => {
                binds += 1;
                let bind = Bind { port, number: binds }.encode(&key, &registered);
                assert_eq!(relay.from_host(host(), &bind, now), None);
            }
            _ => {
                now += SimTime::from_millis(u64::from(byte) * 100);
                let overdue = relay.work(now);
                overdue.lines.iter().for_each(|line| drop(relay.line_closed(*line)));
            }
        }
        assert!(relay.sessions() <= PORTS.len());
    }
});
