//! Tests of the machines of host and station together: a scene that moves, a hand of the station, and a path that delays
//! and loses.

#[path = "diagnosis_tests.rs"]
mod diagnosis_tests;
#[path = "pause_tests.rs"]
mod pause_tests;

use std::sync::{Arc, Mutex};

use trocar_devices::{DeviceState, HandIntent, HapticDevice, VirtualHand, VirtualHandConfig, Wrench};
use trocar_kernel::spec::{FaultKind, FaultOrder};
use trocar_scene::{
    Commands, Entity, EntityAllocator, Hand, Name, Pose, Registry, Side as Handedness, SimTime, Snapshot,
    Store, Velocity,
};

use self::pause_tests::{ByTheWall, Wall};
use super::admissions::BookAdmissions;
use super::host_machine::{HostMachine, HostSetup};
use super::host_members::HostHandControl;
use super::station_machine::{StationMachine, StationNews, StationSetup};
use crate::control::{
    Architecture, ClientFacts, ClientState, ComponentList, Credential, HandInfo, HostFacts, PlainText,
    SessionInfo, Wish,
};
use crate::hands_link::{ControllerEnd, HandsHost, HandsStation, HostHand, StationHand, hands_channel};
use crate::haptic::SenderConfig;
use crate::impairments::Impairments;
use crate::lockstep::{End, HandsPeer, Wire, WireHostStreams, WireStationStream, Wires};
use crate::remote_hand::{DoorLimits, Presence, RemoteHand};
use crate::replication::choice::{ColumnRates, ReplicatedColumns};
use crate::replication::scene_feed::FeedLimits;
use crate::ticket::{HostAddress, Identity, Offer, PlainName, ResumeSecret, Role, TicketBook};

const NOW: u64 = 1_795_938_052;

fn name(text: &str) -> PlainName {
    text.parse().expect("a name")
}

/// A hand with its device, as a driver would step it.
pub(super) struct Device {
    pub(super) hand: RemoteHand,
    pub(super) shown: Option<DeviceState>,
}

impl Device {
    fn step(&mut self, now: SimTime, intent: Option<HandIntent>) {
        if let Some(intent) = intent {
            self.hand.set_intent(now.as_nanos(), &intent);
        }
        self.shown = self.hand.read(now.as_nanos()).ok();
        self.hand.write(now.as_nanos(), &Wrench::ZERO).expect("it is rendered");
    }

    pub(super) fn x(&self) -> f64 {
        self.shown.map_or(f64::NAN, |state| state.pose_in_device.translation.vector.x)
    }
}

pub(super) struct Host {
    store: Store,
    commands: Commands,
    pub(super) scene: Arc<Snapshot>,
    pub(super) machine: HostMachine<usize>,
    hands: HandsPeer,
    pub(super) device: Device,
    pub(super) moving: Vec<Entity>,
    wall: Wall,
}

pub(super) struct Station {
    pub(super) store: Store,
    commands: Commands,
    pub(super) machine: StationMachine<usize>,
    hands: HandsPeer,
    pub(super) device: Device,
    columns: Arc<ReplicatedColumns>,
    pub(super) news: Vec<StationNews>,
    /// What a machine that is made again needs.
    setup: StationSetup,
    controller: ControllerEnd<usize>,
    wire: Wire,
    wall: Wall,
}

pub(super) struct Bench {
    pub(super) now: SimTime,
    wires: Wires,
    pub(super) wire: Wire,
    pub(super) host: Host,
    pub(super) station: Station,
    credential: Credential,
    /// How far the session clocks of both are behind, as they stood still for so long.
    host_behind: SimTime,
    station_behind: SimTime,
    wall: Wall,
}

fn remote_hand(at_x: f64) -> (RemoteHand, crate::remote_hand::StationEnd) {
    let mut config = VirtualHandConfig::default();
    config.start_in_device.translation.vector.x += at_x;
    let local = Box::new(VirtualHand::new(config).expect("a valid hand"));
    let (mut hand, end) = RemoteHand::over(0, DoorLimits::default(), local).expect("valid limits");
    hand.open(0).expect("it opens");
    (hand, end)
}

impl Bench {
    pub(super) fn new(path: &Impairments, entities: usize, role: Role, hands: &[&str]) -> Self {
        let registry = Registry::standard();
        let columns = Arc::new(ReplicatedColumns::new(&registry, &ColumnRates::default()).expect("columns"));
        let mut store = Store::new(registry.clone());
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let instrument = commands.spawn();
        commands.put(instrument, Name("grasper".into()));
        let hand_entity = commands.spawn();
        commands.put(hand_entity, Name("hand.left".into()));
        commands.put(
            hand_entity,
            Hand { side: Handedness::Left, instrument, world_from_device: Pose::default(), scale: 1.0 },
        );
        let moving: Vec<Entity> = (0..entities).map(|_| commands.spawn()).collect();
        for entity in &moving {
            commands.put(*entity, Pose::at(0.0, 0.0, 0.0));
        }
        commands.seal();
        store.apply(&mut commands, SimTime::ZERO);
        commands.clear();
        let scene = Arc::new(store.snapshot());

        let components = ComponentList::of(&registry);
        let facts = HostFacts {
            components_digest: components.digest(),
            components: components.clone(),
            scenario_name: PlainText::new("moving bodies"),
            scenario: [5; 32],
        };
        let info = HandInfo { number: 0, name: name("left"), entity: hand_entity, station: None };
        let (host_hand, host_end) = remote_hand(0.0);
        let control = HostHandControl { number: 0, control: host_end.control().clone() };
        let (controller, link) = hands_channel();
        let (wires, wall) = (Wires::default(), Wall::default());
        let wire = Wire::new(path, 11);
        wires.add(wire.clone());
        let links = HandsHost::new(vec![HostHand { number: 0, end: host_end, playout: None }], link);
        let mut book = TicketBook::new(Identity::create(&name("host")).expect("an identity"));
        let offer = Offer {
            role,
            person: name("Ana"),
            expires: NOW + 3_600,
            session: name("moving bodies"),
            addresses: vec![
                HostAddress::of_socket("127.0.0.1:7417".parse().expect("an address")).expect("valid"),
            ],
        };
        let random = ring::rand::SystemRandom::new();
        let (_, ticket) = book.issue(offer, NOW, &random).expect("a ticket");
        let resume = ResumeSecret::random(&random).expect("a secret");
        let credential = Credential::Ticket { token: ticket.token().clone(), resume };
        let setup = HostSetup {
            name: name("host"),
            facts,
            info: SessionInfo {
                scenario_name: PlainText::new("moving bodies"),
                scenario_text: String::new(),
                seed: 1,
                architecture: Architecture::ClientServer,
                hands: Vec::new(),
                stations: Vec::new(),
            },
            columns: columns.clone(),
            limits: FeedLimits::default(),
            sender: SenderConfig::default(),
            hands: vec![(info, control)],
            is_attended: false,
            secret: 3,
        };
        let machine = HostMachine::new(
            setup,
            Box::new(ByTheWall(WireHostStreams::new(wires.clone()), wall.clone())),
            Box::new(BookAdmissions { book: Arc::new(Mutex::new(book)), clock: NOW }),
            controller,
            scene.clone(),
        );
        let host = Host {
            store,
            commands,
            scene,
            machine,
            hands: HandsPeer::new("network.hands", Box::new(links), wires.clone(), End::Host),
            device: Device { hand: host_hand, shown: None },
            moving,
            wall: wall.clone(),
        };
        let station = Station::new(&wires, &wire, &wall, credential.clone(), hands, columns);
        let (now, host_behind, station_behind) = (SimTime::ZERO, SimTime::ZERO, SimTime::ZERO);
        Self { now, wires, wire, host, station, credential, host_behind, station_behind, wall }
    }

    pub(super) fn step(&mut self, intent: Option<HandIntent>) {
        self.pass();
        self.step_host();
        self.step_station(intent);
    }

    /// A millisecond passes.
    fn pass(&mut self) {
        self.now += SimTime::from_millis(1);
        self.wall.set(self.now);
    }

    fn step_host(&mut self) {
        self.host.step(self.now - self.host_behind);
    }

    fn step_station(&mut self, intent: Option<HandIntent>) {
        self.station.step(self.now - self.station_behind, intent);
    }

    pub(super) fn run(&mut self, millis: u64) {
        (0..millis).for_each(|_| self.step(None));
    }

    pub(super) fn run_until(&mut self, millis: u64, is_done: impl Fn(&Self) -> bool) -> u64 {
        for millis in 0..millis {
            if is_done(self) {
                return millis;
            }
            self.step(None);
        }
        let machine = &self.station.machine;
        panic!(
            "it never happened: {:?}, {:?}, {:?}",
            machine.state(),
            machine.error(),
            self.host.machine.stations()
        );
    }

    /// Nothing passes between both any more, or all does again.
    fn partition(&self, begins: bool) {
        let lossy = Impairments { loss: 1.0, ..Impairments::default() };
        for order in lossy.orders(1) {
            self.wire.fault(&FaultOrder { kind: FaultKind::Partition, index: 9, begins, ..order });
        }
    }

    pub(super) fn is_running(&self) -> bool {
        self.station.machine.state() == ClientState::Running
    }
}

impl Host {
    fn step(&mut self, now: SimTime) {
        self.device.step(now, None);
        self.hands.step_at(now, self.wall.now());
        if now.as_nanos().is_multiple_of(4_000_000) {
            self.commands.begin(now);
            let phase = now.as_secs_f64();
            for (index, entity) in self.moving.iter().take(20).enumerate() {
                self.commands.put(*entity, Pose::at(0.01 * (phase + index as f64).sin(), 0.0, 0.0));
            }
            self.commands.seal();
            self.store.apply(&mut self.commands, now);
            self.commands.clear();
            self.scene = Arc::new(self.store.snapshot());
            self.machine.step(now, &self.scene);
        }
    }
}

impl Station {
    fn new(
        wires: &Wires,
        wire: &Wire,
        wall: &Wall,
        credential: Credential,
        hands: &[&str],
        columns: Arc<ReplicatedColumns>,
    ) -> Self {
        let registry = columns.registry().clone();
        let (hand, end) = remote_hand(0.03);
        let (controller, link) = hands_channel();
        let number = wires.all().len() - 1;
        let links = HandsStation::new(vec![StationHand::new(0, end)], link);
        let own = Wires::default();
        own.add(wire.clone());
        let hands: Vec<PlainName> = hands.iter().map(|hand| name(hand)).collect();
        let setup = StationSetup {
            facts: ClientFacts {
                program: PlainText::new("0.1.0"),
                components: ComponentList::of(&registry),
                scenario: None,
                wish: Wish { name: name("Ana"), role: None, devices: hands.clone(), hands, moves: true },
            },
            credential,
            sender: SenderConfig::default(),
            secret: 5,
        };
        let stream = WireStationStream::new(wire.clone(), number, SimTime::from_millis(300));
        let stream = ByTheWall(stream, wall.clone());
        let machine = StationMachine::new(setup.clone(), Box::new(stream), controller.clone(), SimTime::ZERO);
        Self {
            store: Store::new(registry.clone()),
            commands: Commands::new(registry, EntityAllocator::new(1, 1)),
            machine,
            hands: HandsPeer::new("network.hands", Box::new(links), own, End::Station),
            device: Device { hand, shown: None },
            columns,
            news: Vec::new(),
            setup,
            controller,
            wire: wire.clone(),
            wall: wall.clone(),
        }
    }

    /// Its actor dies at work, and the next life begins with what is in the scene.
    fn lose_machine(&mut self, now: SimTime) {
        let parts = self.machine.parts().expect("it is in the session");
        let stream = WireStationStream::new(self.wire.clone(), 0, SimTime::from_millis(300));
        let stream = ByTheWall(stream, self.wall.clone());
        let (setup, controller) = (self.setup.clone(), self.controller.clone());
        let scene = self.store.snapshot();
        self.machine = StationMachine::again(setup, Box::new(stream), controller, parts, &scene, now);
    }

    fn step(&mut self, now: SimTime, intent: Option<HandIntent>) {
        self.device.step(now, intent);
        self.hands.step_at(now, self.wall.now());
        if !now.as_nanos().is_multiple_of(4_000_000) {
            return;
        }
        if self.machine.progress().is_some() || self.machine.welcome().is_some() {
            let hands =
                self.machine.welcome().map(|welcome| welcome.session.hands.clone()).unwrap_or_default();
            if self.machine.parts().is_none() {
                let devices = hands.iter().map(|hand| hand.entity).collect();
                self.machine.replicate(self.columns.clone(), devices);
            }
        }
        self.commands.begin(now);
        let scene = self.store.snapshot();
        // An end is seen in the state.
        let _ = self.machine.step(now, &scene, &mut self.commands);
        self.news.extend(self.machine.take_news());
        self.commands.seal();
        assert_eq!(self.commands.error(), None);
        self.store.apply(&mut self.commands, now);
        self.commands.clear();
    }
}

fn bad_path() -> Impairments {
    Impairments { loss: 0.02, ..Impairments::delay(SimTime::from_millis(75)) }
}

#[test]
fn a_station_joins_gets_the_scene_and_follows_it() {
    let mut bench = Bench::new(&bad_path(), 500, Role::Operate, &["left"]);
    let took = bench.run_until(5_000, Bench::is_running);
    assert!(took < 2_000, "{took} ms");
    bench.run(2_000);
    let (host, station) = (&bench.host.scene, bench.station.store.view());
    for entity in &bench.host.moving {
        let (here, there) = (host.get::<Pose>(*entity), station.get::<Pose>(*entity));
        let (here, there) = (here.expect("a pose"), there.expect("it was sent"));
        // 10 mm/s, at 60 Hz, over 75 ms.
        assert!((here.translation - there.translation).norm() < 1.5e-3);
    }
    assert_eq!(bench.station.machine.replica_counts().malformed, 0);
    let info = &bench.host.machine.stations()[0];
    assert_eq!((info.name.as_str(), info.is_here, &info.hands[..]), ("Ana", true, &[0][..]));
    let round_trip = f64::from(info.link.round_trip_us) * 1e-3;
    assert!((149.0..160.0).contains(&round_trip), "{round_trip} ms");
}

#[test]
fn a_hand_begins_where_the_host_has_it_and_moves_both_ends_alike() {
    let mut bench = Bench::new(&bad_path(), 20, Role::Operate, &["left"]);
    bench.run_until(5_000, Bench::is_running);
    bench.run(1_500);
    let (here, there) = (bench.host.device.x(), bench.station.device.x());
    assert!((here - there).abs() < 1e-4, "both show it at one place: {here} and {there}");
    assert_eq!(bench.host.device.hand.presence(), Presence::Live(1));
    assert_eq!(bench.station.device.hand.presence(), Presence::Local);
    let mut goal = bench.station.device.shown.expect("it is shown").pose_in_device;
    goal.translation.vector.x += 0.02;
    for _ in 0..1_500 {
        bench.step(Some(HandIntent::at(goal, 0.2)));
    }
    let (here, there) = (bench.host.device.x(), bench.station.device.x());
    assert!((there - goal.translation.vector.x).abs() < 1e-3, "the device follows");
    assert!((here - there).abs() < 2e-4, "{here} and {there}");
}

#[test]
fn after_a_break_the_station_is_back_with_what_it_missed_and_its_hand_is_at_one_place() {
    let mut bench = Bench::new(&bad_path(), 500, Role::Operate, &["left"]);
    bench.run_until(5_000, Bench::is_running);
    bench.run(1_000);
    bench.wire.disconnect();
    bench.run(20);
    assert!(!bench.is_running(), "it has noticed");
    // The hand goes on moving meanwhile.
    let mut goal = bench.station.device.shown.expect("it is shown").pose_in_device;
    goal.translation.vector.x += 0.02;
    for _ in 0..300 {
        bench.step(Some(HandIntent::at(goal, 0.2)));
    }
    let took = bench.run_until(5_000, Bench::is_running);
    assert!(took < 1_500, "{took} ms");
    assert!(bench.station.news.contains(&StationNews::Back));
    bench.run(2_000);
    let (here, there) = (bench.host.device.x(), bench.station.device.x());
    assert!((here - there).abs() < 2e-4, "{here} and {there}");
    for entity in &bench.host.moving {
        let there = bench.station.store.view().get::<Pose>(*entity).expect("it is there");
        assert!(
            (bench.host.scene.get::<Pose>(*entity).expect("a pose").translation - there.translation).norm()
                < 1.5e-3
        );
    }
    let Credential::Ticket { .. } = bench.credential else { panic!("it came with a ticket") };
}

#[test]
fn after_a_short_silence_the_hand_is_at_one_place_again_however_short_the_path_is() {
    for delay in [1, 5, 20, 40, 75] {
        let mut bench =
            Bench::new(&Impairments::delay(SimTime::from_millis(delay)), 20, Role::Operate, &["left"]);
        bench.run_until(5_000, Bench::is_running);
        bench.run(1_500);
        let mut goal = bench.station.device.shown.expect("it is shown").pose_in_device;
        for (silence, to_x) in [(150, 0.02), (800, -0.03), (1_500, 0.01)] {
            // The hand moves on while nothing passes.
            goal.translation.vector.x += to_x;
            bench.partition(true);
            (0..silence).for_each(|_| bench.step(Some(HandIntent::at(goal, 0.2))));
            bench.partition(false);
            let mut stood = bench.host.device.x();
            let took = (0..3_000).find(|_| {
                bench.step(None);
                let (here, there) = (bench.host.device.x(), bench.station.device.x());
                assert!((here - stood).abs() < 1.1e-3, "no jump");
                stood = here;
                let is_own = bench.station.device.hand.presence() == Presence::Local;
                is_own && (here - there).abs() < 1e-5
            });
            let took = took.expect("they come together again");
            assert!(took <= 250 + 6 * delay, "{delay} ms of path, {silence} ms of silence: {took} ms");
            bench.run(500);
            let (here, there) = (bench.host.device.x(), bench.station.device.x());
            assert!((here - there).abs() < 1e-5, "{delay} ms: {here} and {there}");
        }
    }
}

#[test]
fn a_station_whose_network_died_at_work_comes_back_with_the_same_scene_and_hand() {
    let mut bench = Bench::new(&bad_path(), 200, Role::Operate, &["left"]);
    bench.run_until(5_000, Bench::is_running);
    bench.run(1_000);
    // What happened at the host meanwhile it does not know.
    let gone = bench.host.moving.pop().expect("a body");
    bench.host.commands.begin(bench.now);
    bench.host.commands.despawn(gone);
    bench.host.commands.seal();
    bench.host.store.apply(&mut bench.host.commands, bench.now);
    bench.host.commands.clear();
    bench.station.lose_machine(bench.now);
    let took = bench.run_until(5_000, Bench::is_running);
    assert!(took < 1_500, "{took} ms");
    bench.run(1_500);
    let stations = bench.host.machine.stations();
    assert_eq!((stations.len(), stations[0].is_here, &stations[0].hands[..]), (1, true, &[0][..]));
    assert!(!bench.station.store.view().contains(gone), "a despawn that was missed");
    let (host, station) = (&bench.host.scene, bench.station.store.view());
    for entity in &bench.host.moving {
        let (here, there) = (host.get::<Pose>(*entity), station.get::<Pose>(*entity));
        let (here, there) = (here.expect("a pose"), there.expect("it is there"));
        assert!((here.translation - there.translation).norm() < 1.5e-3);
    }
    let (here, there) = (bench.host.device.x(), bench.station.device.x());
    assert!((here - there).abs() < 2e-4, "{here} and {there}");
}

#[test]
fn a_watcher_sees_all_and_serves_nothing() {
    let mut bench = Bench::new(&bad_path(), 20, Role::Watch, &[]);
    bench.run_until(5_000, Bench::is_running);
    bench.run(500);
    assert_eq!(bench.host.device.hand.presence(), Presence::Local);
    assert_eq!(bench.station.store.view().iter::<Velocity>().count(), 0);
    assert_eq!(bench.station.store.view().iter::<Pose>().count(), 20);
    let mut refused = Bench::new(&bad_path(), 20, Role::Watch, &["left"]);
    refused.run(2_000);
    assert_eq!(refused.station.machine.state(), ClientState::Ended);
    let why = refused.station.machine.error().expect("an error").to_string();
    assert!(why.contains("watch"), "{why}");
}
