//! Damaged deltas and datagrams: whatever comes, the replica and the station's scene agree, and a host can mend both.

use std::collections::BTreeSet;

use proptest::prelude::*;
use trocar_scene::{ComponentId, Entity, Name, Pose, SimTime, varint};
use trocar_test_support::hostile::mutated;

use super::scene_testing::{Host, Station, columns};
use super::wire_reader::write_entity;
use super::{FeedLimits, Resumed, SceneFeed, StateDigest};

/// A host, a station that has its scene, and deltas and datagrams after that.
struct Bench {
    host: Host,
    station: Station,
    deltas: Vec<Vec<u8>>,
    payloads: Vec<Vec<u8>>,
}

impl Bench {
    fn new(seed: u64) -> Self {
        let columns = columns();
        let (mut host, mut station) = (Host::new(seed), Station::new(&columns));
        let mut feed = SceneFeed::new(columns, FeedLimits::default());
        let ms = SimTime::from_millis;
        (0..30).for_each(|k| host.change(ms(k)));
        let first = feed.delta(ms(40), &host.scene).expect("it encodes").expect("there is much");
        station.replica.apply(&first, &mut station.commands).expect("it is the host's");
        station.apply(ms(40));
        let (mut deltas, mut payloads) = (vec![first], Vec::new());
        for k in 1..12 {
            let mut acknowledgement = Vec::new();
            station.replica.write_acknowledgement(&mut acknowledgement);
            feed.acknowledge(ms(100 * k), &acknowledgement).expect("it is the station's");
            host.change(ms(100 * k));
            let mut payload = Vec::new();
            while feed.datagram(ms(100 * k), &host.scene, &mut payload) {
                payloads.push(payload.clone());
            }
            deltas.extend(feed.delta(ms(100 * k), &host.scene).expect("it encodes"));
        }
        Self { host, station, deltas, payloads }
    }

    /// A delta of changes since where the station is, of these lists, to the next revision.
    fn delta(&self, lists: &dyn Fn(&mut Vec<u8>)) -> Vec<u8> {
        let applied = self.station.replica.applied().0;
        let mut bytes = vec![0];
        for number in [applied, applied + 1, 0] {
            varint::write(number, &mut bytes);
        }
        lists(&mut bytes);
        bytes
    }

    /// Applies it as a batch of its own, if it is read.
    fn take(&mut self, delta: &[u8]) -> bool {
        self.station.apply(SimTime::ZERO);
        let is_read = self.station.replica.apply(delta, &mut self.station.commands).is_ok();
        assert!(is_read || self.station.commands.is_empty(), "nothing of it was taken");
        self.station.apply(SimTime::ZERO);
        is_read
    }

    fn agrees(&self) {
        let (view, known) = (self.station.store.view(), self.station.replica.known());
        assert!(view.entities().eq(known.entities().iter().copied()), "the same entities live");
        for id in columns().replicated() {
            let mut rows = BTreeSet::new();
            view.erased_column(id).for_each_entity(&mut |entity| _ = rows.insert(entity));
            let name = view.registry().entry(id).name;
            assert!(rows.into_iter().eq(known.column(id)), "the same rows of {name}");
        }
    }

    /// The station comes back to a host that knows nothing of it.
    fn mend(&mut self) {
        let (columns, now) = (columns(), SimTime::from_millis(9_000));
        let mut feed = SceneFeed::new(columns, FeedLimits::default());
        self.station.replica.reconnect();
        assert_eq!(feed.resume(self.station.replica.applied()), Resumed::Unknown);
        let digest = self.station.replica.compare(self.station.store.view()).expect("it encodes");
        let mut bytes = Vec::new();
        digest.write(&mut bytes);
        let digest = StateDigest::read(&bytes).expect("it is its own");
        let delta = feed.reconcile(now, &digest, &self.host.scene).expect("it encodes").expect("an answer");
        assert!(self.take(&delta));
        let there = self.station.replica.digest(self.station.store.view()).expect("it encodes");
        let here = feed.digest(&self.host.scene).expect("it encodes");
        assert_eq!(here.differing(&there), Vec::<u64>::new());
    }
}

fn entities(list: &[Entity], out: &mut Vec<u8>) {
    varint::write(list.len() as u64, out);
    let mut before = 0;
    list.iter().for_each(|entity| write_entity(*entity, &mut before, out));
}

/// One column with the name of one entity, then no events.
fn put_name(id: ComponentId, entity: Entity, out: &mut Vec<u8>) {
    varint::write(1, out);
    varint::write(id.0.into(), out);
    varint::write(1, out);
    write_entity(entity, &mut 0, out);
    out.extend([0, 1, b'x', 0, 0]);
}

#[test]
fn a_delta_that_removes_what_it_puts_is_refused() {
    let mut bench = Bench::new(1);
    let id = columns().registry().id::<Name>().expect("it is standard");
    let entity = *bench.host.living.first().expect("some live");
    let named = bench.delta(&|out| {
        (0..2).for_each(|_| entities(&[], out));
        varint::write(0, out);
        put_name(id, entity, out);
    });
    assert!(bench.take(&named));
    bench.agrees();
    let contradiction = bench.delta(&|out| {
        (0..2).for_each(|_| entities(&[], out));
        varint::write(1, out);
        varint::write(id.0.into(), out);
        entities(&[entity], out);
        put_name(id, entity, out);
    });
    assert!(!bench.take(&contradiction));
    bench.agrees();
    bench.mend();
}

#[test]
fn a_delta_that_puts_a_row_of_what_it_despawns_is_refused() {
    let mut bench = Bench::new(2);
    let id = columns().registry().id::<Name>().expect("it is standard");
    // Whoever writes has an entity that need not live, but may.
    for entity in [*bench.host.living.first().expect("some live"), Entity::of_writer(1, 77)] {
        let spawned = bench.delta(&|out| {
            entities(&[entity], out);
            entities(&[], out);
            out.extend([0, 0, 0, 0]);
        });
        assert!(bench.take(&spawned));
        let contradiction = bench.delta(&|out| {
            entities(&[], out);
            entities(&[entity], out);
            varint::write(0, out);
            put_name(id, entity, out);
        });
        assert!(!bench.take(&contradiction));
        bench.agrees();
    }
    bench.mend();
}

#[test]
fn numbers_of_events_beyond_all_counting_do_no_harm() {
    let mut bench = Bench::new(3);
    for first in [u64::MAX, 0, u64::MAX - 1] {
        let delta = bench.delta(&|out| {
            (0..2).for_each(|_| entities(&[], out));
            out.extend([0, 0]);
            varint::write(first, out);
            let event = trocar_scene::Event {
                name: "seen".into(),
                subject: Entity::of_writer(1, 4),
                object: None,
                value: 1.0,
                at: SimTime(u64::MAX),
            };
            out.extend(postcard::to_stdvec(&vec![event]).expect("it encodes"));
        });
        assert!(bench.take(&delta));
    }
    assert_eq!(bench.station.replica.counts().events_lost, u64::MAX);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn damaged_deltas_and_datagrams_leave_replica_and_scene_in_agreement(
        seed in 0_u64..4,
        deltas in prop::collection::vec(mutated(Bench::new(0).deltas), 1..4),
        payloads in prop::collection::vec(mutated(Bench::new(0).payloads), 1..6),
        likely: bool,
    ) {
        let mut bench = Bench::new(seed);
        for mut delta in deltas {
            if likely && delta.first() == Some(&0) {
                // Of this station's revision; most damage lies behind it.
                let rest = delta.split_off(delta.len().min(2));
                delta = vec![0];
                varint::write(bench.station.replica.applied().0, &mut delta);
                delta.extend(rest);
            }
            bench.take(&delta);
            bench.agrees();
        }
        for payload in payloads {
            // Refused or taken in part: each row stands for itself.
            let _ = bench.station.replica.receive_rows(&payload, &mut bench.station.commands);
            bench.station.apply(SimTime::ZERO);
            bench.agrees();
        }
        bench.mend();
        prop_assert!(bench.station.store.view().iter::<Pose>().all(|(_, pose)| pose.translation.norm().is_finite()));
    }
}
