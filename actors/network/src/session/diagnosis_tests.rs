//! Diagnoses over the machines of a host: a whole path, one that carries no long datagrams, one that carries none, one that
//! brings no answers; and the ticket afterwards.

use trocar_scene::SimTime;

use super::{Bench, Role};
use crate::control::{ClientState, DIAGNOSES_MAX, Refusal, TicketVerdict};
use crate::datagram::DATAGRAM_MAX;
use crate::diagnosis::{ECHOES, Examination, Examined};
use crate::impairments::Impairments;
use crate::lockstep::{End, Wire, WireStationStream};

const MS: fn(u64) -> SimTime = SimTime::from_millis;

fn path() -> Impairments {
    Impairments { delay: MS(20), ..Impairments::default() }
}

fn bench() -> Bench {
    Bench::new(&path(), 5, Role::Operate, &["left"])
}

fn begin(bench: &Bench, wire: &Wire, number: usize) -> Examination<usize> {
    let stream = WireStationStream::new(wire.clone(), number, MS(2));
    Examination::begin(Box::new(stream), "0.1.0", bench.credential.clone(), bench.now)
}

/// One millisecond of a host and of those who ask it, each over its wire. `there` says which datagrams pass to the host,
/// and `back` whether any pass from it.
fn step(bench: &mut Bench, asking: &mut [(Wire, Examination<usize>)], there: fn(&[u8]) -> bool, back: bool) {
    bench.pass();
    let now = bench.now;
    bench.host.step(now);
    for (wire, examination) in asking {
        while let Some(mut bytes) = wire.receive_datagram(End::Station, now) {
            if back {
                examination.receive(now, &mut bytes);
            }
        }
        examination.step(now, &mut |_, bytes| {
            if there(bytes) {
                wire.send_datagram(End::Station, now, bytes);
            }
            true
        });
    }
}

fn examined(bench: &mut Bench, there: fn(&[u8]) -> bool, back: bool) -> Examined {
    let wire = bench.wire.clone();
    let mut asking = [(wire.clone(), begin(bench, &wire, 0))];
    while !asking[0].1.is_over() {
        assert!(bench.now < MS(60_000), "it never ends: {:?}", asking[0].1.found());
        step(bench, &mut asking, there, back);
    }
    asking[0].1.found().clone()
}

#[test]
fn a_whole_path_brings_all_back_and_the_ticket_still_lets_in() {
    let mut bench = bench();
    let found = examined(&mut bench, |_| true, true);
    let answer = found.answer.expect("an answer").expect("the ticket is good");
    assert_eq!(answer.ticket, TicketVerdict::LetsIn(Role::Operate));
    assert_eq!(answer.host_unix_secs, super::NOW);
    assert_eq!(found.error, None);
    for echoed in [found.short, found.long] {
        let all = ECHOES as u32;
        assert_eq!((echoed.sent, echoed.there, echoed.back), (all, all, all));
        let (shortest, longest) = (echoed.shortest.expect("measured"), echoed.longest.expect("measured"));
        assert!(MS(40) <= shortest && longest <= MS(44), "{shortest} to {longest}");
    }
    bench.run_until(5_000, |bench| bench.station.machine.state() == ClientState::Running);
    let found = examined(&mut bench, |_| true, true);
    let answer = found.answer.expect("an answer").expect("whoever is in may look, too");
    assert_eq!(answer.ticket, TicketVerdict::Spent { at: super::NOW });
}

#[test]
fn a_path_that_carries_no_long_datagrams_none_at_all_or_no_answers_is_told_apart() {
    let all = ECHOES as u32;
    let narrow = examined(&mut bench(), |bytes| bytes.len() < DATAGRAM_MAX, true);
    assert_eq!((narrow.short.back, narrow.long.sent, narrow.long.there, narrow.long.back), (all, all, 0, 0));
    let blocked = examined(&mut bench(), |_| false, true);
    assert_eq!((blocked.short.there, blocked.short.back, blocked.long.there), (0, 0, 0));
    assert!(blocked.answer.is_some_and(|answer| answer.is_ok()), "the control channel is good");
    let one_way = examined(&mut bench(), |_| true, false);
    assert_eq!((one_way.short.there, one_way.short.back), (all, 0));
    assert_eq!((one_way.long.there, one_way.long.back), (all, 0));
}

#[test]
fn more_than_a_few_at_once_are_asked_to_come_again() {
    let mut bench = bench();
    let mut asking = Vec::new();
    for _ in 0..=DIAGNOSES_MAX {
        let wire = Wire::new(&path(), 12);
        let number = bench.wires.add(wire.clone());
        asking.push((wire.clone(), begin(&bench, &wire, number)));
    }
    for _ in 0..5_000 {
        step(&mut bench, &mut asking, |_| true, true);
    }
    let refused = asking
        .iter()
        .filter(|(_, examination)| matches!(&examination.found().answer, Some(Err(Refusal::HostTrouble(_)))));
    assert_eq!(refused.count(), 1);
    let whole = asking.iter().filter(|(_, examination)| examination.found().long.back == ECHOES as u32);
    assert_eq!(whole.count(), DIAGNOSES_MAX);
    let wire = bench.wire.clone();
    let mut again = [(wire.clone(), begin(&bench, &wire, 0))];
    for _ in 0..3_000 {
        step(&mut bench, &mut again, |_| true, true);
    }
    assert_eq!(again[0].1.found().short.back, ECHOES as u32, "there is room again");
}
