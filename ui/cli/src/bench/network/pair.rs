//! A host and a station with the machines of a session, and the scene of each, without the actors around them: over any
//! streams, and with datagrams that do not leave the process.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use trocar::network::control::{
    Architecture, ClientFacts, ClientState, ComponentList, Credential, HostFacts, PlainText, SessionInfo,
    Wish,
};
use trocar::network::datagram::Keys;
use trocar::network::hands_link::{HandsHost, HandsLink, HandsStation, hands_channel};
use trocar::network::haptic::SenderConfig;
use trocar::network::live::store_admissions::{StoreAdmissions, wait_for_the_book};
use trocar::network::replication::{ColumnRates, FeedLimits, ReplicatedColumns};
use trocar::network::session::{HostMachine, HostSetup, StationError, StationMachine, StationSetup};
use trocar::network::streams::{Closed, HostStreams, StationStream, StreamState};
use trocar::network::ticket::{HostAddress, Identity, PlainName, Role, TicketStore};
use trocar::network::{TICKET_LIFE_SECS, credential_of, issue};
use trocar_scene::{Commands, EntityAllocator, Registry, SimTime, Snapshot, Store};

use crate::failure::Failure;

/// What a host needs of its disk: certificate and tickets.
pub struct Book {
    admissions: StoreAdmissions,
    _folder: tempfile::TempDir,
}

fn name(text: &str) -> Result<PlainName, Failure> {
    text.parse().map_err(Failure::internal)
}

impl Book {
    /// A new one, in a folder that goes with it.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn new() -> Result<Self, Failure> {
        let folder = tempfile::tempdir().map_err(Failure::internal)?;
        let file = folder.path().join("host.tickets");
        let store =
            TicketStore::open_host(&file, &name("host")?, wait_for_the_book).map_err(Failure::internal)?;
        Ok(Self { admissions: StoreAdmissions::new(store), _folder: folder })
    }

    /// The host's certificate.
    pub fn identity(&self) -> Identity {
        self.admissions.store().book().identity().clone()
    }

    /// What lets somebody in to look on.
    ///
    /// # Errors
    /// When no ticket can be given out.
    pub fn credential(&self, address: HostAddress) -> Result<Credential, Failure> {
        let mut store = self.admissions.store();
        let ticket = issue(&mut store, "Bo", Role::Watch, TICKET_LIFE_SECS, "bench", vec![address])?;
        Ok(credential_of(&ticket)?)
    }
}

/// Breaks a stream, and counts what comes over it.
#[derive(Clone, Default)]
pub struct Cutter {
    is_cut: Arc<AtomicBool>,
    bytes: Arc<AtomicU64>,
}

impl Cutter {
    /// Breaks the stream at its next step.
    pub fn cut(&self) {
        self.is_cut.store(true, Ordering::Release);
    }

    /// Bytes that have come over it.
    pub fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }
}

/// A stream that can be cut.
struct Cuttable<A> {
    inner: Box<dyn StationStream<A>>,
    cutter: Cutter,
}

impl<A: 'static> StationStream<A> for Cuttable<A> {
    fn peer(&self) -> Option<A> {
        self.inner.peer()
    }
    fn connect(&mut self, now: SimTime) {
        self.inner.connect(now);
    }
    fn work(&mut self, now: SimTime) -> StreamState {
        if self.cutter.is_cut.swap(false, Ordering::AcqRel) {
            self.inner.close();
            return StreamState::Closed("the bench has cut it".to_owned());
        }
        self.inner.work(now)
    }
    fn receive(&mut self, now: SimTime, most: usize, into: &mut Vec<u8>) -> Result<(), Closed> {
        let before = into.len();
        let received = self.inner.receive(now, most, into);
        self.cutter.bytes.fetch_add((into.len() - before) as u64, Ordering::Relaxed);
        received
    }
    fn send(&mut self, now: SimTime, bytes: &[u8]) -> Result<usize, Closed> {
        self.inner.send(now, bytes)
    }
    fn keys(&mut self, connection: u32, phase: u32) -> Option<Keys> {
        self.inner.keys(connection, phase)
    }
    fn close(&mut self) {
        self.inner.close();
    }
}

/// One end's scene.
pub struct Scene {
    /// What is in it.
    pub store: Store,
    /// What is to be changed.
    pub commands: Commands,
}

impl Scene {
    fn new(registry: &Arc<Registry>, station: u16) -> Self {
        let commands = Commands::new(registry.clone(), EntityAllocator::new(station, 1));
        Self { store: Store::new(registry.clone()), commands }
    }

    /// Takes in what was commanded.
    ///
    /// # Errors
    /// When a value is not valid.
    pub fn apply(&mut self, now: SimTime) -> Result<(), Failure> {
        self.commands.seal();
        if let Some(error) = self.commands.error() {
            return Err(Failure::internal(format!("a scene of the bench: {error}")));
        }
        self.store.apply(&mut self.commands, now);
        self.commands.clear();
        Ok(())
    }
}

/// Datagrams between the hands links of both ends.
struct Datagrams<A> {
    host: HandsHost<A>,
    station: HandsStation<A>,
    to_host: VecDeque<Vec<u8>>,
    to_station: VecDeque<Vec<u8>>,
    /// The station's address, and bytes that have come to it.
    address: A,
    bytes: u64,
}

impl<A: Copy + PartialEq + Send + 'static> Datagrams<A> {
    fn step(&mut self, now: SimTime) {
        let Self { host, station, to_host, to_station, address, bytes } = self;
        let mut answers = VecDeque::new();
        while let Some(mut datagram) = to_host.pop_front() {
            host.receive(now, *address, &mut datagram, &mut |_, out| {
                to_station.push_back(out.to_vec());
                true
            });
        }
        while let Some(mut datagram) = to_station.pop_front() {
            *bytes += datagram.len() as u64;
            // A station has one host, wherever its datagrams seem to come from.
            station.receive(now, *address, &mut datagram, &mut |_, out| {
                answers.push_back(out.to_vec());
                true
            });
        }
        to_host.append(&mut answers);
        host.tick(now, &mut |_, out| {
            to_station.push_back(out.to_vec());
            true
        });
        station.tick(now, &mut |_, out| {
            to_host.push_back(out.to_vec());
            true
        });
    }
}

/// Both ends.
pub struct Pair<A> {
    /// The host's scene.
    pub host: Scene,
    /// The station's copy.
    pub station: Scene,
    /// Cuts the station's stream.
    pub cutter: Cutter,
    at_host: HostMachine<A>,
    at_station: StationMachine<A>,
    datagrams: Datagrams<A>,
    columns: Arc<ReplicatedColumns>,
    scene: Arc<Snapshot>,
}

impl<A: Copy + PartialEq + Send + 'static> Pair<A> {
    /// A host whose scene is still empty, and a station that wants to look on.
    ///
    /// # Errors
    /// When names are not valid.
    pub fn new(
        book: &Book,
        streams: Box<dyn HostStreams>,
        stream: Box<dyn StationStream<A>>,
        credential: Credential,
        (address, bytes_per_sec): (A, f64),
        now: SimTime,
    ) -> Result<Self, Failure> {
        let registry = Registry::standard();
        let columns =
            ReplicatedColumns::new(&registry, &ColumnRates::default()).map_err(Failure::internal)?;
        let columns = Arc::new(columns);
        let components = ComponentList::of(&registry);
        let host = Scene::new(&registry, 0);
        let scene = Arc::new(host.store.snapshot());
        let setup = HostSetup {
            name: name("host")?,
            facts: HostFacts {
                components_digest: components.digest(),
                components: components.clone(),
                scenario_name: PlainText::new("bench"),
                scenario: [0; 32],
            },
            info: SessionInfo {
                scenario_name: PlainText::new("bench"),
                scenario_text: String::new(),
                seed: 1,
                architecture: Architecture::ClientServer,
                hands: Vec::new(),
                stations: Vec::new(),
            },
            columns: columns.clone(),
            limits: FeedLimits { bytes_per_sec, ..FeedLimits::default() },
            sender: SenderConfig::default(),
            hands: Vec::new(),
            is_attended: false,
            secret: 3,
        };
        let (controller, link) = hands_channel();
        let admissions = Box::new(book.admissions.clone());
        let at_host = HostMachine::new(setup, streams, admissions, controller, scene.clone());
        let at_hosts_hands = HandsHost::new(Vec::new(), link);
        let (controller, link) = hands_channel();
        let cutter = Cutter::default();
        let setup = StationSetup {
            facts: ClientFacts {
                program: PlainText::new(env!("CARGO_PKG_VERSION")),
                components,
                scenario: None,
                wish: Wish {
                    name: name("Bo")?,
                    role: None,
                    hands: Vec::new(),
                    devices: Vec::new(),
                    moves: false,
                },
            },
            credential,
            sender: SenderConfig::default(),
            secret: 5,
        };
        let stream = Box::new(Cuttable { inner: stream, cutter: cutter.clone() });
        let at_station = StationMachine::new(setup, stream, controller, now);
        let datagrams = Datagrams {
            host: at_hosts_hands,
            station: HandsStation::new(Vec::new(), link),
            to_host: VecDeque::new(),
            to_station: VecDeque::new(),
            address,
            bytes: 0,
        };
        let station = Scene::new(&registry, 1);
        Ok(Self { host, station, cutter, at_host, at_station, datagrams, columns, scene })
    }

    /// One step of both machines and of the datagrams between them.
    ///
    /// # Errors
    /// When the station is not let in, or cannot follow.
    pub fn step(&mut self, now: SimTime) -> Result<(), Failure> {
        if self.host.store.revision() != self.scene.revision() {
            self.scene = Arc::new(self.host.store.snapshot());
        }
        self.at_host.step(now, &self.scene);
        if self.at_station.parts().is_none() && self.at_station.welcome().is_some() {
            self.at_station.replicate(self.columns.clone(), Vec::new());
        }
        self.station.commands.begin(now);
        let scene = self.station.store.snapshot();
        let stepped = self.at_station.step(now, &scene, &mut self.station.commands);
        stepped.map_err(|StationError::Over(error)| {
            Failure::internal(format!("a station of the bench: {error}"))
        })?;
        self.station.apply(now)?;
        self.datagrams.step(now);
        Ok(())
    }

    /// Whether the station is in the session, with all of the scene.
    pub fn is_running(&self) -> bool {
        self.at_station.state() == ClientState::Running
    }

    /// Bytes that have come to the station: over its stream, and in datagrams.
    pub fn bytes(&self) -> u64 {
        self.cutter.bytes() + self.datagrams.bytes
    }
}
