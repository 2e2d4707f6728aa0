//! A host and a station with links between them, for tests: scenes that change at random, and the two channels.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_kernel::faults::{FaultKind, FaultOrder, LinkFaults, Message};
use trocar_scene::random::SplitMix64;
use trocar_scene::{
    Commands, Entity, EntityAllocator, Name, Parent, Pose, Registry, Revision, SimTime, Snapshot, Store,
    SurfaceMesh, TaskState, Velocity, VertexPositions,
};

use super::*;

/// A datagram on a link.
#[derive(Clone, Debug)]
pub struct Datagram(pub Vec<u8>);

impl Message for Datagram {
    fn bytes(&self) -> usize {
        self.0.len() + 68
    }
    fn duplicate(&self) -> Option<Self> {
        Some(self.clone())
    }
    fn through(self, noise: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        // The seal around the payload refuses what was garbled.
        let mut bytes = self.0.clone();
        noise(&mut bytes);
        (bytes == self.0).then_some(self)
    }
}

pub fn columns() -> Arc<ReplicatedColumns> {
    let registry = Registry::standard();
    Arc::new(ReplicatedColumns::new(&registry, &ColumnRates::default()).expect("the defaults hold"))
}

pub fn fault(index: u32, kind: FaultKind) -> FaultOrder {
    FaultOrder {
        index,
        target: "link".to_owned(),
        kind,
        begins: true,
        span: SimTime::ZERO,
        jitter: SimTime::ZERO,
        independent: false,
        delays: Vec::new(),
        every: SimTime::ZERO,
        burst: 0.0,
        probability: 0.0,
        bytes_per_sec: 0.0,
        seed: 11 + u64::from(index),
    }
}

/// The host's scene.
pub struct Host {
    pub store: Store,
    pub commands: Commands,
    pub scene: Arc<Snapshot>,
    pub random: SplitMix64,
    pub living: Vec<Entity>,
}

impl Host {
    pub fn new(seed: u64) -> Self {
        let registry = Registry::standard();
        let store = Store::new(registry.clone());
        Self {
            scene: Arc::new(store.snapshot()),
            store,
            commands: Commands::new(registry, EntityAllocator::new(1, 4)),
            random: SplitMix64::new(seed),
            living: Vec::new(),
        }
    }

    pub fn apply(&mut self, now: SimTime) -> Revision {
        self.commands.seal();
        let revision = self.store.apply(&mut self.commands, now);
        self.commands.clear();
        self.scene = Arc::new(self.store.snapshot());
        revision
    }

    pub fn pose(&mut self) -> Pose {
        let mut unit = || 2.0 * self.random.unit() - 1.0;
        let translation = Vector3::new(unit(), unit(), unit());
        Pose::new(translation, UnitQuaternion::from_euler_angles(3.0 * unit(), 3.0 * unit(), 3.0 * unit()))
    }

    /// An organ of so many vertices, wherever they are.
    pub fn body(&mut self, count: usize) -> VertexPositions {
        let random = &mut self.random;
        let positions = (0..count).map(|_| Point3::from([(); 3].map(|()| 0.3 * random.unit())));
        VertexPositions { positions: Arc::new(positions.collect()) }
    }

    fn any(&mut self) -> Option<Entity> {
        let index = self.random.below(self.living.len() as u64) as usize;
        self.living.get(index).copied()
    }

    /// Some changes of any kind. Velocities carry the revision in which they are written, which shows a step back.
    pub fn change(&mut self, now: SimTime) {
        self.commands.begin(now);
        let revision = self.store.revision().next().0 as f64;
        for _ in 0..self.random.below(8) {
            let Some(entity) = self.any() else { break };
            match self.random.below(12) {
                0..4 => {
                    let pose = self.pose();
                    self.commands.put(entity, pose);
                }
                4..7 => {
                    let angular = Vector3::new(revision, 0.0, 0.0);
                    self.commands.put(entity, Velocity { linear: Vector3::zeros(), angular });
                }
                7 => self.commands.put(entity, Name(format!("row of {revision}"))),
                8 => self.commands.remove::<Velocity>(entity),
                9 => self.commands.remove::<Name>(entity),
                10 => {
                    // Another mesh, with the vertices that belong to it.
                    let count = 1 + self.random.below(200);
                    let body = self.body(count as usize);
                    self.commands
                        .put(entity, SurfaceMesh { triangles: Arc::new(vec![[0, 0, count as u32 - 1]]) });
                    self.commands.put(entity, body);
                }
                _ => {
                    if let Some(body) = self.scene.get::<VertexPositions>(entity) {
                        let mut positions = body.positions.to_vec();
                        for _ in 0..5 {
                            let index = self.random.below(positions.len() as u64) as usize;
                            positions[index].x += 0.01 * self.random.unit();
                        }
                        self.commands.put(entity, VertexPositions { positions: Arc::new(positions) });
                    }
                }
            }
        }
        // What is despawned last takes whatever was just put on it along.
        if self.random.below(10) == 0 && self.living.len() > 10 {
            let index = self.random.below(self.living.len() as u64) as usize;
            let gone = self.living.swap_remove(index);
            self.commands.despawn(gone);
        }
        if self.random.below(3) == 0 && self.living.len() < 150 {
            let entity = self.commands.spawn();
            let pose = self.pose();
            self.commands.put(entity, pose);
            if let Some(parent) = self.any() {
                self.commands.put(entity, Parent(parent));
            }
            self.living.push(entity);
        }
        // A writer's own entity, which is never spawned.
        self.commands.put(self.commands.me(), TaskState::default());
        self.commands.event("step", self.commands.me(), None, revision);
        self.apply(now);
    }
}

/// The station's scene and replica.
pub struct Station {
    pub store: Store,
    pub replica: Replica,
    pub commands: Commands,
    /// The revision that each velocity carried last.
    seen: BTreeMap<Entity, f64>,
    pub steps_back: usize,
    pub events: Vec<f64>,
}

impl Station {
    pub fn new(columns: &Arc<ReplicatedColumns>) -> Self {
        let registry = columns.registry().clone();
        Self {
            store: Store::new(registry.clone()),
            replica: Replica::new(columns.clone()),
            commands: Commands::new(registry, EntityAllocator::new(2, 9)),
            seen: BTreeMap::new(),
            steps_back: 0,
            events: Vec::new(),
        }
    }

    /// Applies what the replica has put, as a Model would, and looks for rows that went back.
    pub fn apply(&mut self, now: SimTime) {
        self.replica.put_vertices(&mut self.commands);
        self.commands.seal();
        assert_eq!(self.commands.error(), None);
        self.events.extend(self.commands.events().iter().map(|event| event.value));
        let (view, commands) = (self.store.view(), &self.commands);
        assert!(commands.spawns().iter().all(|entity| !view.contains(*entity)), "an id comes again");
        assert!(commands.despawns().iter().all(|entity| view.contains(*entity)), "nobody despawns twice");
        let lives = |entity: Entity| {
            view.contains(entity) || commands.spawns().contains(&entity) || entity.counter() == 0
        };
        for (_, puts) in commands.puts() {
            assert!((0..puts.len()).all(|row| lives(puts.entity(row))) && puts.check().is_ok());
        }
        self.store.check_room(commands).expect("there is room");
        self.store.apply(&mut self.commands, now);
        self.commands.clear();
        for (entity, velocity) in self.store.view().iter::<Velocity>() {
            let last = self.seen.insert(entity, velocity.angular.x).unwrap_or(0.0);
            self.steps_back += usize::from(velocity.angular.x < last);
        }
    }
}

/// Both ends and the channels between them.
pub struct Pair {
    pub now: SimTime,
    pub host: Host,
    pub feed: SceneFeed,
    pub station: Station,
    pub columns: Arc<ReplicatedColumns>,
    pub down: LinkFaults<Datagram>,
    pub up: LinkFaults<Datagram>,
    /// Pieces of deltas and when they arrive: in order, whatever it takes.
    control: VecDeque<(SimTime, Vec<u8>)>,
    pub control_delay: SimTime,
    pub is_open: bool,
    pub control_bytes: usize,
    pub control_messages: usize,
    acknowledged_at: SimTime,
    payload: Vec<u8>,
}

impl Pair {
    pub fn new(seed: u64, limits: FeedLimits) -> Self {
        let columns = columns();
        Self {
            now: SimTime::ZERO,
            host: Host::new(seed),
            feed: SceneFeed::new(columns.clone(), limits),
            station: Station::new(&columns),
            columns,
            down: LinkFaults::default(),
            up: LinkFaults::default(),
            control: VecDeque::new(),
            control_delay: SimTime::ZERO,
            is_open: true,
            control_bytes: 0,
            control_messages: 0,
            acknowledged_at: SimTime::ZERO,
            payload: Vec::new(),
        }
    }

    /// A fault of both directions begins or ends.
    pub fn apply(&mut self, order: &FaultOrder) {
        self.down.apply(order);
        self.up.apply(&FaultOrder { seed: order.seed ^ 0x55, ..order.clone() });
    }

    pub fn send_delta(&mut self, delta: &[u8]) {
        for piece in pieces::split(delta) {
            self.control_bytes += piece.len();
            self.control_messages += 1;
            self.control.push_back((self.now + self.control_delay, piece));
        }
    }

    /// One step of the link: what is due moves.
    pub fn step(&mut self, span: SimTime) {
        self.now += span;
        let now = self.now;
        if self.is_open
            && let Some(delta) = self.feed.delta(now, &self.host.scene).expect("it encodes")
        {
            self.send_delta(&delta);
        }
        while self.feed.datagram(now, &self.host.scene, &mut self.payload) {
            assert!(self.payload.len() <= ROWS_PAYLOAD_MAX);
            self.down.send(now, Datagram(self.payload.clone()));
        }
        while self.is_open && self.control.front().is_some_and(|(due, _)| *due <= now) {
            let Some((_, piece)) = self.control.pop_front() else { break };
            if let Some(delta) = self.station.replica.receive_piece(&piece).expect("it is in order") {
                self.station.apply(now);
                self.station.replica.apply(&delta, &mut self.station.commands).expect("it is well formed");
                self.station.apply(now);
            }
        }
        while let Some(Datagram(payload)) = self.down.due(now) {
            self.station
                .replica
                .receive_rows(&payload, &mut self.station.commands)
                .expect("it is well formed");
        }
        self.station.apply(now);
        if now.since(self.acknowledged_at) >= SimTime::from_millis(20) {
            self.acknowledged_at = now;
            let mut bytes = Vec::new();
            self.station.replica.write_acknowledgement(&mut bytes);
            self.up.send(now, Datagram(bytes));
        }
        while let Some(Datagram(bytes)) = self.up.due(now) {
            self.feed.acknowledge(now, &bytes).expect("it is well formed");
        }
    }

    /// The control channel breaks, with what was under way.
    pub fn cut(&mut self) {
        self.is_open = false;
        self.control.clear();
    }

    /// The station comes back.
    pub fn come_back(&mut self) {
        self.is_open = true;
        self.station.replica.reconnect();
        if self.feed.resume(self.station.replica.applied()) == Resumed::Unknown {
            let digest = self.station.replica.compare(self.station.store.view()).expect("it encodes");
            let mut bytes = Vec::new();
            digest.write(&mut bytes);
            self.control_bytes += bytes.len();
            let digest = StateDigest::read(&bytes).expect("it reads its own");
            let scene = self.host.scene.clone();
            let delta = self.feed.reconcile(self.now, &digest, &scene).expect("it encodes");
            self.send_delta(&delta.expect("nothing is on its way"));
        }
    }

    /// Lets the scene rest until both ends agree; the time that it took.
    pub fn settle(&mut self, most: SimTime) -> SimTime {
        let begin = self.now;
        while !self.feed.is_settled(&self.host.scene) {
            let (rows, station) = (self.feed.rows(), self.station.replica.counts());
            assert!(
                self.now.since(begin) < most,
                "not settled: {} waiting, {:?}, {station:?}",
                rows.waiting(),
                rows.counts()
            );
            self.step(SimTime::from_millis(5));
        }
        self.now.since(begin)
    }

    /// Both scenes are the same: by digest, and row by row for what travels exactly.
    pub fn assert_equal(&mut self) {
        let here = self.feed.digest(&self.host.scene).expect("it encodes");
        let there = self.station.replica.digest(self.station.store.view()).expect("it encodes");
        assert_eq!(here.differing(&there), Vec::<u64>::new());
        let (host, station) = (&*self.host.scene, self.station.store.view());
        assert!(host.entities().eq(station.entities()), "the same entities live");
        for id in self.columns.replicated() {
            let (here, there) = (host.erased_column(id), station.erased_column(id));
            assert_eq!(here.len(), there.len(), "{}", host.registry().entry(id).name);
            if !self.columns.is_unreliable(id) {
                here.for_each_entity(&mut |entity| assert_eq!(here.row_json(entity), there.row_json(entity)));
            }
        }
        for (entity, pose) in host.iter::<Pose>() {
            let other = station.get::<Pose>(entity).expect("it is there");
            assert!((pose.translation - other.translation).norm() < 1e-6);
            assert!(pose.rotation.angle_to(&other.rotation) < 2e-5);
        }
        for (entity, body) in host.iter::<VertexPositions>() {
            let other = station.get::<VertexPositions>(entity).expect("it is there");
            let far =
                body.positions.iter().zip(other.positions.iter()).map(|(one, other)| (one - other).norm());
            assert!(far.fold(0.0, f64::max) < 3.4e-6);
        }
        assert_eq!(self.station.steps_back, 0, "no row goes back");
    }
}
