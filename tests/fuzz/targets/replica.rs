//! A replica of a host's scene, to which deltas, pieces of them and datagrams of rows come from elsewhere; and the host's
//! end, to which acknowledgements and digests do. Whatever came, the replica and the station's scene agree, and the host
//! can bring both back to what it has.
#![no_main]

use std::collections::BTreeSet;

use libfuzzer_sys::fuzz_target;
use trocar_fuzz::replica_scene::{COLUMNS, FIRST_DELTA, SCENES, STATION_SCENE, feed};
use trocar_fuzz::{Bound, Step, first, steps};
use trocar_network::replication::{Replica, Resumed, RowWindow, SceneFeed, StateDigest, pieces};
use trocar_scene::{Commands, Entity, EntityAllocator, SimTime, Store, varint};

/// The dearest bytes are those of a lone row: one byte of an entity that has a page of its own in its column.
const DELTA: Bound = Bound { per_byte: 512, always: 64 << 10 };
/// A row may move one vertex of a body that is copied for it; bodies here have up to as many bytes as the inputs so far.
const ROWS: Bound = Bound { per_byte: 512, always: 256 << 10 };

struct Station {
    now: SimTime,
    replica: Replica,
    store: Store,
    commands: Commands,
    feed: Option<SceneFeed>,
    sequence: u64,
    /// How many more steps of an input may take the host's end to encode its scene.
    encodings: u8,
}

/// Whether the station goes on.
type Goes = bool;

impl Station {
    fn new(has_scene: bool) -> Self {
        let registry = COLUMNS.registry().clone();
        let mut replica = Replica::new(COLUMNS.clone());
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(2, 9));
        let store = if has_scene {
            replica.apply(&FIRST_DELTA, &mut commands).expect("the host wrote it");
            commands.clear();
            Store::from_snapshot(&STATION_SCENE)
        } else {
            Store::new(registry)
        };
        Self { now: SimTime::ZERO, replica, store, commands, feed: None, sequence: 0, encodings: 4 }
    }

    fn step(&mut self, step: Step<'_>) -> Goes {
        self.now += SimTime(step.pause_ns);
        let bytes = step.bytes;
        match step.what % 10 {
            0 => self.delta(bytes),
            1 => {
                // Changes since where the replica is.
                let mut delta = vec![0];
                varint::write(self.replica.applied().0, &mut delta);
                delta.extend_from_slice(bytes);
                self.delta(&delta)
            }
            2 => {
                let (came, _) = self.replica.progress();
                let joined = DELTA.holds(came + bytes.len(), || self.replica.receive_piece(bytes));
                joined.ok().flatten().is_none_or(|delta| self.delta(&delta))
            }
            3 => self.rows(bytes),
            4 => {
                // Rows of a datagram that is the next one, and of the newest scene.
                let (newer, rest) = first(bytes);
                let mut payload = Vec::new();
                self.sequence += 1;
                varint::write(self.sequence, &mut payload);
                varint::write(self.replica.applied().0.min(1 << 61) + u64::from(newer), &mut payload);
                varint::write(u64::from(newer), &mut payload);
                payload.extend_from_slice(rest);
                self.rows(&payload)
            }
            5 => self.apply(),
            _ if self.encodings == 0 => true,
            6 => self.acknowledgement(bytes),
            7 => self.digest(bytes),
            8 => self.honest_rows(bytes),
            _ => self.heal(),
        }
    }

    /// A delta goes into a batch of its own.
    fn delta(&mut self, bytes: &[u8]) -> Goes {
        let before = (self.replica.applied(), self.replica.known().len());
        if !self.apply() {
            return false;
        }
        let applied = DELTA.holds(bytes.len(), || self.replica.apply(bytes, &mut self.commands));
        match applied {
            Ok(summary) => {
                assert_eq!(summary.revision, self.replica.applied());
                self.apply()
            }
            Err(_) => {
                let after = (self.replica.applied(), self.replica.known().len());
                assert!(self.commands.is_empty() && before == after, "nothing of it was taken");
                true
            }
        }
    }

    fn rows(&mut self, payload: &[u8]) -> Goes {
        // Read or refused: the rows before a mistake are taken.
        let _ = ROWS.holds(payload.len(), || self.replica.receive_rows(payload, &mut self.commands));
        true
    }

    /// The station's Model applies what waits, and then holds what the replica believes it to hold.
    fn apply(&mut self) -> Goes {
        let Self { replica, store, commands, .. } = self;
        replica.put_vertices(commands);
        commands.seal();
        assert_eq!(commands.error(), None);
        let view = store.view();
        assert!(commands.spawns().iter().all(|entity| !view.contains(*entity)), "an id comes again");
        assert!(commands.despawns().iter().all(|entity| view.contains(*entity)), "nobody despawns twice");
        let spawned: BTreeSet<Entity> = commands.spawns().iter().copied().collect();
        let lives =
            |entity: Entity| view.contains(entity) || spawned.contains(&entity) || entity.counter() == 0;
        for (_, puts) in commands.puts() {
            assert!((0..puts.len()).all(|row| lives(puts.entity(row))) && puts.check().is_ok());
        }
        assert!(commands.events().iter().all(|event| event.value.is_finite()));
        if store.check_room(commands).is_err() {
            // The Model refuses it.
            return false;
        }
        store.apply(commands, self.now);
        commands.clear();
        let (view, known) = (store.view(), replica.known());
        assert!(view.entities().eq(known.entities().iter().copied()), "the same entities live");
        for id in COLUMNS.replicated() {
            let mut rows = Vec::new();
            view.erased_column(id).for_each_entity(&mut |entity| rows.push(entity));
            let name = view.registry().entry(id).name;
            assert!(rows.into_iter().eq(known.column(id)), "the same rows of {name} are there");
        }
        true
    }

    fn feed(&mut self) -> &mut SceneFeed {
        self.feed.get_or_insert_with(|| {
            let mut feed = feed();
            assert!(feed.delta(SimTime::ZERO, &SCENES[0]).is_ok_and(|delta| delta.is_some()));
            feed
        })
    }

    /// To the host: which datagrams have come. Written again it is the same.
    fn acknowledgement(&mut self, bytes: &[u8]) -> Goes {
        if let Ok((window, applied)) = RowWindow::read(bytes) {
            let mut again = Vec::new();
            window.write(applied, &mut again);
            assert!(again == bytes);
        }
        let now = self.now;
        // Numbers that were never sent are refused.
        let _ = self.feed().acknowledge(now, bytes);
        true
    }

    /// To the host: what a station says that it holds. The answer is a delta that is valid wherever it arrives.
    fn digest(&mut self, bytes: &[u8]) -> Goes {
        self.encodings -= 1;
        let Ok(digest) = DELTA.holds(bytes.len(), || StateDigest::read(bytes)) else { return true };
        let mut again = Vec::new();
        digest.write(&mut again);
        assert_eq!(StateDigest::read(&again), Ok(digest.clone()));
        let now = self.now;
        let delta = self.feed().reconcile(now, &digest, &SCENES[0]).expect("it encodes");
        self.feed = None;
        delta.is_none_or(|delta| {
            let goes = self.apply();
            goes && self.replica.apply(&delta, &mut self.commands).is_ok_and(|_| self.apply())
        })
    }

    /// From the host: what has moved, in its own pieces and datagrams.
    fn honest_rows(&mut self, bytes: &[u8]) -> Goes {
        self.encodings -= 1;
        let (now, what) = (self.now, first(bytes).0);
        let feed = self.feed();
        if what % 2 == 1 {
            let delta = feed.delta(now, &SCENES[1]).expect("it encodes").unwrap_or_default();
            let pieces: Vec<_> = pieces::split(&delta).collect();
            for piece in pieces {
                let joined = self.replica.receive_piece(&piece);
                if let Ok(Some(delta)) = joined
                    && !self.delta(&delta)
                {
                    return false;
                }
            }
            return true;
        }
        let mut payload = Vec::new();
        while self.feed().datagram(now, &SCENES[1], &mut payload) {
            self.rows(&payload);
        }
        let mut acknowledgement = Vec::new();
        self.replica.write_acknowledgement(&mut acknowledgement);
        self.acknowledgement(&acknowledgement)
    }

    /// The station comes back to a host that knows nothing of it, and then has what the host has.
    fn heal(&mut self) -> Goes {
        self.encodings -= 1;
        if !self.apply() {
            return false;
        }
        self.replica.reconnect();
        let (now, mut feed) = (self.now, feed());
        assert_eq!(feed.resume(self.replica.applied()), Resumed::Unknown);
        let digest = self.replica.compare(self.store.view()).expect("it encodes");
        let mut bytes = Vec::new();
        digest.write(&mut bytes);
        let digest = StateDigest::read(&bytes).expect("it is its own");
        let scene = &SCENES[0];
        let delta = feed.reconcile(now, &digest, scene).expect("it encodes").expect("nothing is under way");
        self.replica.apply(&delta, &mut self.commands).expect("the host wrote it");
        if !self.apply() {
            return false;
        }
        let (here, there) = (
            feed.digest(scene).expect("it encodes"),
            self.replica.digest(self.store.view()).expect("it encodes"),
        );
        assert_eq!(here.differing(&there), Vec::<u64>::new());
        assert!(scene.entities().eq(self.store.view().entities()), "the same entities live");
        self.feed = Some(feed);
        true
    }
}

// The first byte says whether the station has the scene already.
fuzz_target!(|bytes: &[u8]| {
    let (has_scene, rest) = first(bytes);
    let mut station = Station::new(has_scene % 2 == 1);
    if steps(rest).all(|step| station.step(step)) {
        station.apply();
    }
});
