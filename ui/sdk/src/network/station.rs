//! The station's side: it joins a host, gets scenario and scene from it, and runs a session of its own on them.

use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use ring::rand::SystemRandom;
use trocar_devices::HapticDevice;
use trocar_kernel::runtime::Clock;
use trocar_kernel::spec::{Factory, LINK, LINKS};
use trocar_network::control::{
    Architecture, ClientFacts, ClientState, ComponentList, Credential, HandInfo, PlainText, Welcome, Wish,
};
use trocar_network::datagram::Seal;
use trocar_network::faulty::LinkBoard;
use trocar_network::hands_link::{
    ControllerEnd, HandsLink, HandsStation, LinkEnd, StationHand, hands_channel,
};
use trocar_network::haptic::SenderConfig;
use trocar_network::live::pair_door::PairSockets;
use trocar_network::live::sockets;
use trocar_network::live::tls_station_stream::TlsStationStream;
use trocar_network::lockstep::{End, HandsPeer, PairDoors, PairWires, Wire, WireStationStream, Wires};
use trocar_network::pairs::PairDoor;
use trocar_network::remote_hand::{DoorLimits, RemoteHand};
use trocar_network::session::{MachineSlot, StationController, StationError, StationMachine, StationSetup};
use trocar_network::streams::StationStream;
use trocar_network::ticket::{ResumeSecret, Role, Ticket};
use trocar_scene::scenario::Scenario;
use trocar_scene::{
    BuildContext, Commands, Controller, ControllerError, EntityAllocator, Registry, SimTime, Snapshot, Store,
};

use super::host::{NetworkSettings, plain_name, random_secret, replicated};
use super::part::NetworkPart;
use super::{Faults, HANDS_PEER, LastWord, NetworkError, Sharing, TakingPart};

/// The writer under which a station's network joins before there is a session: the first of its controllers.
pub(crate) const STATION_WRITER: u16 = 1;
/// How long a stream over a wire takes to open.
const HANDSHAKE: SimTime = SimTime::from_millis(2);
/// Time between two looks at the link while a station joins.
const LOOK: Duration = Duration::from_millis(2);

/// How a station joins.
#[derive(Clone, Debug, Default)]
pub struct JoinOptions {
    /// Its name; without one it gets that of its role and a random number.
    pub name: Option<String>,
    /// A lower role than the ticket's.
    pub role: Option<Role>,
    /// Hands that it serves, each with its device: (hand, spec).
    pub hands: Vec<(String, String)>,
    /// Whether a person at the station moves its hands, and not the session's virtual trainee.
    pub play: bool,
    /// Datagrams without protection, for the loopback alone.
    pub insecure: bool,
    /// Whether it serves its hands only once they were handed over to it, as a mentor's station always does.
    pub stands_by: bool,
    /// The secret with which a station comes back after its program ended, in place of the ticket's token.
    pub resume: Option<ResumeSecret>,
}

/// How far a station has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct JoinProgress {
    /// Where the connection is.
    pub state: ClientState,
    /// Bytes of the scene that have arrived, of how many.
    pub scene: Option<(u32, u32)>,
}

/// A station on its way into a session; `A` is an address of datagrams.
pub struct Joining<A> {
    machine: StationMachine<A>,
    setup: StationSetup,
    controller: ControllerEnd<A>,
    link: LinkEnd<A>,
    devices: Vec<String>,
    moves: bool,
    is_insecure: bool,
    registry: Arc<Registry>,
    /// Since the welcome.
    begun: Option<Begun>,
    /// In virtual time: the doors of the session's stations.
    doors: Option<PairDoors>,
}

struct Begun {
    scenario: Scenario,
    store: Store,
    commands: Commands,
}

/// A station that is in a session, and whose own session has not begun.
pub struct Station {
    /// The host's scenario, without what its entities are made of.
    pub scenario: Scenario,
    /// The scene as it was when the station joined.
    pub scene: Snapshot,
    /// Its number.
    pub number: u16,
    /// Its name.
    pub name: String,
    /// What it may do.
    pub role: Role,
    /// The session's seed.
    pub seed: u64,
    /// The hands of the session.
    pub hands: Vec<HandInfo>,
    /// Who computes what.
    pub architecture: Architecture,
    /// Whether a person at the station moves its hands.
    pub moves: bool,
    /// The secret with which the station comes back after its program has ended: [`JoinOptions::resume`].
    pub resume: ResumeSecret,
    /// Whether its datagrams are without protection.
    is_insecure: bool,
    clock: Option<Clock>,
    parts: Mutex<Option<Parts>>,
}

enum Parts {
    Live { joined: Joined<SocketAddr>, peer: SocketAddr },
    Lockstep { joined: Joined<usize>, wire: Wire, doors: Option<PairDoors> },
}

/// Makes the door to other stations, for a machine that is made again.
type DoorFactory<A> = Box<dyn Fn() -> Result<Box<dyn PairDoor<A>>, String> + Send + Sync>;

/// Makes a stream to the host, for a machine that is made again.
type Redial<A> = Box<dyn Fn() -> Result<Box<dyn StationStream<A>>, String> + Send + Sync>;

/// A machine that has joined, and what another one needs if this one is lost.
struct Joined<A> {
    machine: Box<StationMachine<A>>,
    setup: StationSetup,
    controller: ControllerEnd<A>,
    link: LinkEnd<A>,
    redial: Redial<A>,
}

impl<A: Copy + PartialEq + Send + 'static> Joining<A> {
    /// A station with this credential, over this stream.
    ///
    /// # Errors
    /// [`NetworkError`] when a name does not travel.
    pub fn new(
        registry: &Arc<Registry>,
        options: &JoinOptions,
        credential: Credential,
        stream: Box<dyn StationStream<A>>,
        now: SimTime,
    ) -> Result<Self, NetworkError> {
        let secret = random_secret(0);
        let name = options.name.clone().unwrap_or_else(|| format!("station {:04x}", secret & 0xffff));
        let hands: Result<Vec<_>, _> = options.hands.iter().map(|(hand, _)| plain_name(hand)).collect();
        let hands = hands?;
        let setup = StationSetup {
            facts: ClientFacts {
                program: PlainText::new(env!("CARGO_PKG_VERSION")),
                components: ComponentList::of(registry),
                scenario: None,
                wish: Wish {
                    name: plain_name(&name)?,
                    role: options.role,
                    hands: if options.stands_by { Vec::new() } else { hands.clone() },
                    devices: hands,
                    moves: options.play,
                },
            },
            credential,
            sender: SenderConfig::default(),
            secret,
        };
        let (controller, link) = hands_channel();
        Ok(Self {
            machine: StationMachine::new(setup.clone(), stream, controller.clone(), now),
            setup,
            controller,
            link,
            devices: options.hands.iter().map(|(hand, _)| hand.clone()).collect(),
            moves: options.play,
            is_insecure: options.insecure,
            registry: registry.clone(),
            begun: None,
            doors: None,
        })
    }

    /// One step; whether the station is in the session.
    ///
    /// # Errors
    /// [`NetworkError`]: not let in, or the link does not carry.
    pub fn step(&mut self, now: SimTime) -> Result<bool, NetworkError> {
        if self.begun.is_none()
            && let Some(welcome) = self.machine.welcome()
        {
            let begun = Begun::new(welcome, self.registry.clone())?;
            let settings = NetworkSettings::of(&begun.scenario)?;
            let columns = replicated(&self.registry, &settings, welcome.session.architecture)
                .map_err(|error| NetworkError::Scenario(error.to_string()))?;
            let has_device = |hand: &&HandInfo| self.devices.iter().any(|name| name == hand.name.as_str());
            let devices = welcome.session.hands.iter().filter(has_device).map(|hand| hand.entity).collect();
            self.machine.replicate(Arc::new(columns), devices);
            self.begun = Some(begun);
        }
        let stepped = match &mut self.begun {
            Some(begun) => {
                begun.commands.begin(now);
                let scene = begun.store.snapshot();
                let stepped = self.machine.step(now, &scene, &mut begun.commands);
                begun.apply(now)?;
                stepped
            }
            None => {
                let registry = self.registry.clone();
                let scene = Store::new(registry.clone()).snapshot();
                let mut nothing = Commands::new(registry, EntityAllocator::new(0, STATION_WRITER));
                self.machine.step(now, &scene, &mut nothing)
            }
        };
        stepped.map_err(|StationError::Over(error)| NetworkError::Control(error))?;
        Ok(self.machine.state() == ClientState::Running)
    }

    /// How far it has come.
    pub fn progress(&self) -> JoinProgress {
        JoinProgress { state: self.machine.state(), scene: self.machine.progress() }
    }

    /// Why the link is down, if it is.
    pub fn trouble(&self) -> Option<String> {
        self.machine.error().map(ToString::to_string)
    }

    fn station(
        self,
        clock: Option<Clock>,
        redial: Redial<A>,
        parts: impl FnOnce(Joined<A>) -> Parts,
    ) -> Option<Station> {
        let Self { machine, setup, controller, link, moves, is_insecure, begun, .. } = self;
        let Begun { scenario, store, .. } = begun?;
        let Welcome { station, role, session, .. } = machine.welcome()?.clone();
        let (Credential::Ticket { resume, .. } | Credential::Resume { resume }) = setup.credential.clone();
        let name = session.stations.iter().find(|info| info.number == station)?.name.as_str().to_owned();
        Some(Station {
            scenario,
            scene: store.snapshot(),
            number: station,
            name,
            role,
            seed: session.seed,
            hands: session.hands,
            architecture: session.architecture,
            moves,
            resume,
            is_insecure,
            clock,
            parts: Mutex::new(Some(parts(Joined {
                machine: Box::new(machine),
                setup,
                controller,
                link,
                redial,
            }))),
        })
    }
}

impl Joining<usize> {
    /// A station over a wire inside the process, in virtual time; `number` is the wire's at its host.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn over(
        registry: &Arc<Registry>,
        options: &JoinOptions,
        ticket: &Ticket,
        wire: &Wire,
        number: usize,
        now: SimTime,
    ) -> Result<Self, NetworkError> {
        let stream = WireStationStream::new(wire.clone(), number, HANDSHAKE);
        let standing = standing_by(options, ticket);
        Self::new(registry, &standing, credential(ticket, options)?, Box::new(stream), now)
    }

    /// Hands go to other stations directly, by the session's doors, if its architecture has that.
    #[must_use]
    pub fn with_doors(self, doors: &PairDoors) -> Self {
        Self { doors: Some(doors.clone()), ..self }
    }

    /// The station, once it is in the session.
    pub fn joined(self, wire: &Wire, number: usize) -> Option<Station> {
        let wire = wire.clone();
        let doors = self.doors.clone();
        let other = wire.clone();
        let redial = move || {
            let stream = WireStationStream::new(other.clone(), number, HANDSHAKE);
            Ok(Box::new(stream) as Box<dyn StationStream<usize>>)
        };
        self.station(None, Box::new(redial), |joined| Parts::Lockstep { joined, wire, doors })
    }
}

impl Begun {
    fn new(welcome: &Welcome, registry: Arc<Registry>) -> Result<Self, NetworkError> {
        let session = &welcome.session;
        let file = format!("{}.toml", session.scenario_name);
        let scenario = Scenario::outline(Path::new(&file), &session.scenario_text)
            .map_err(|error| NetworkError::Scenario(format!("the host's scenario: {error}")))?;
        let allocator = EntityAllocator::new(welcome.station, STATION_WRITER);
        Ok(Self {
            scenario,
            store: Store::new(registry.clone()),
            commands: Commands::new(registry, allocator),
        })
    }

    fn apply(&mut self, now: SimTime) -> Result<(), NetworkError> {
        self.commands.seal();
        if let Some(error) = self.commands.error() {
            return Err(NetworkError::System(format!("the host's scene: {error}")));
        }
        self.store
            .check_room(&self.commands)
            .map_err(|error| NetworkError::System(format!("the host's scene: {error}")))?;
        self.store.apply(&mut self.commands, now);
        self.commands.clear();
        Ok(())
    }
}

/// A mentor takes nobody's instrument by joining.
fn standing_by(options: &JoinOptions, ticket: &Ticket) -> JoinOptions {
    let role = options.role.unwrap_or(ticket.role());
    JoinOptions { stands_by: options.stands_by || role == Role::Mentor, ..options.clone() }
}

fn credential(ticket: &Ticket, options: &JoinOptions) -> Result<Credential, NetworkError> {
    if let Some(resume) = &options.resume {
        return Ok(Credential::Resume { resume: resume.clone() });
    }
    credential_of(ticket)
}

/// What the holder of a ticket shows to its host, with a resume secret made now.
///
/// # Errors
/// When the system has no randomness.
pub fn credential_of(ticket: &Ticket) -> Result<Credential, NetworkError> {
    let resume = ResumeSecret::random(&SystemRandom::new())
        .map_err(|error| NetworkError::System(error.to_string()))?;
    Ok(Credential::Ticket { token: ticket.token().clone(), resume })
}

/// Joins a session over sockets, and waits until the scene is there. `progress` is called every few milliseconds.
///
/// # Errors
/// [`NetworkError`]; also when `stop` was set meanwhile.
pub fn join(
    registry: &Arc<Registry>,
    ticket: &Ticket,
    options: &JoinOptions,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(&JoinProgress, Option<&str>),
) -> Result<Station, NetworkError> {
    let seal = if options.insecure { Seal::Checksum } else { Seal::Aead };
    let (addresses, fingerprint) = (ticket.addresses().to_vec(), *ticket.fingerprint());
    let dial = move || {
        let stream = TlsStationStream::new(addresses.clone(), fingerprint, seal);
        let stream = stream.map_err(|error| error.to_string())?;
        Ok(Box::new(stream) as Box<dyn StationStream<SocketAddr>>)
    };
    let stream = dial().map_err(NetworkError::Usage)?;
    let clock = Clock::start();
    let now = clock.now();
    let standing = standing_by(options, ticket);
    let mut joining = Joining::new(registry, &standing, credential(ticket, options)?, stream, now)?;
    while !joining.step(clock.now())? {
        progress(&joining.progress(), joining.trouble().as_deref());
        if stop.load(Ordering::Relaxed) {
            return Err(NetworkError::System("the join was ended before the scene was there".to_owned()));
        }
        std::thread::sleep(LOOK);
    }
    let Some(peer) = joining.machine.peer() else {
        return Err(NetworkError::System("the host's address is unknown".to_owned()));
    };
    joining
        .station(Some(clock), Box::new(dial), |joined| Parts::Live { joined, peer })
        .ok_or_else(|| NetworkError::System("the host told nothing of its session".to_owned()))
}

impl Station {
    /// The session time at which the station's own session begins.
    pub fn now(&self) -> SimTime {
        self.clock.as_ref().map_or(SimTime::ZERO, Clock::now)
    }

    /// The number of a hand in datagrams.
    pub fn hand_number(&self, name: &str) -> Option<u8> {
        self.hands.iter().find(|hand| hand.name.as_str() == name).map(|hand| hand.number)
    }
}

/// The hands of a station, as its network reaches them.
#[derive(Default)]
pub(crate) struct StationHands(Vec<StationHand>);

impl StationHands {
    /// Wraps the device of a hand, so that it shows where the host has the hand before it goes on.
    ///
    /// # Errors
    /// [`NetworkError`] when the session has no such hand.
    pub fn wrap(
        &mut self,
        station: &Station,
        name: &str,
        device: Box<dyn HapticDevice>,
        sharing: Sharing,
    ) -> Result<Box<dyn HapticDevice>, NetworkError> {
        let number = station.hand_number(name).ok_or_else(|| {
            let known: Vec<&str> = station.hands.iter().map(|hand| hand.name.as_str()).collect();
            NetworkError::Usage(format!("the session has no hand '{name}'; there are: {}", known.join(", ")))
        })?;
        let (device, end) = RemoteHand::over(number, DoorLimits::default(), device)
            .map_err(|error| NetworkError::Scenario(error.to_string()))?;
        let hand = StationHand::new(number, end);
        self.0.push(if sharing.has_all_hands() { hand.following(sharing.playout) } else { hand });
        Ok(Box::new(device))
    }
}

/// The actor of a station's session, and its hands link.
pub(crate) fn stationed(
    station: &Station,
    hands: StationHands,
    has_faults: bool,
) -> Result<TakingPart, NetworkError> {
    let faults = Faults { board: Arc::new(LinkBoard::station()), has_plan: has_faults };
    let fault_sinks = faults.sinks(&[LINK, LINKS]);
    let parts = station.parts.lock().unwrap_or_else(PoisonError::into_inner).take();
    match parts {
        Some(Parts::Live { joined, peer }) => {
            let pairs = match station.architecture != Architecture::ClientServer && !station.is_insecure {
                true => {
                    Some(PairSockets::bind(&peer, &plain_name("station")?).map_err(NetworkError::System)?)
                }
                false => None,
            };
            let socket = match &pairs {
                Some(pairs) => pairs.datagrams().map_err(NetworkError::System)?,
                None => sockets::station(&peer)?,
            };
            let door = pairs.map(|pairs| {
                let door = move || pairs.door().map(|door| Box::new(door) as Box<dyn PairDoor<SocketAddr>>);
                Box::new(door) as DoorFactory<SocketAddr>
            });
            let host_course = Some(joined.machine.host_course().clone());
            let (actor, last_word, link) = blueprint(joined, faults.clone(), door)?;
            let link = faults.hands(Box::new(HandsStation::new(hands.0, link)));
            let part = NetworkPart::Live { socket, link };
            Ok(TakingPart { actor, part, last_word, host_course, fault_sinks })
        }
        Some(Parts::Lockstep { joined, wire, doors }) => {
            let pairs = PairWires::default();
            let has_pairs = station.architecture != Architecture::ClientServer;
            let door = doors.filter(|_| has_pairs).map(|doors| {
                let own = pairs.clone();
                let door = move || Ok(Box::new(doors.open(own.clone())) as Box<dyn PairDoor<usize>>);
                Box::new(door) as DoorFactory<usize>
            });
            let host_course = Some(joined.machine.host_course().clone());
            let (actor, last_word, link) = blueprint(joined, faults.clone(), door)?;
            let link: Box<dyn HandsLink<usize>> = faults.hands(Box::new(HandsStation::new(hands.0, link)));
            let wires = Wires::default();
            wires.add(wire);
            let peer = HandsPeer::new(HANDS_PEER, link, wires, End::Station).with_pairs(pairs);
            let part = NetworkPart::Lockstep(Box::new(peer));
            Ok(TakingPart { actor, part, last_word, host_course, fault_sinks })
        }
        None => Err(NetworkError::System("the station's session has ended; join again".to_owned())),
    }
}

/// The actor of a machine that has joined; one that is lost is made again, and comes back by its secret.
fn blueprint<A: Copy + PartialEq + Send + 'static>(
    joined: Joined<A>,
    faults: Faults,
    door: Option<DoorFactory<A>>,
) -> Result<(Factory, LastWord, LinkEnd<A>), NetworkError> {
    let Joined { machine, setup, controller, link, redial } = joined;
    let machine = machine.over(|stream| faults.station_stream(stream));
    let machine = match &door {
        Some(door) => machine.with_pairs(door().map_err(NetworkError::System)?),
        None => machine,
    };
    let (parts, host_course) = (machine.parts(), machine.host_course().clone());
    let slot = MachineSlot::new(*machine);
    let ended = slot.clone();
    // A machine that its actor still has, or that was lost, says nothing more.
    let last_word = move || ended.take().is_none_or(|mut machine| machine.work(StationMachine::leave));
    let again = move |scene: &Snapshot, now: SimTime| {
        let lost = || ControllerError::Failed("the network died before it was in the session".to_owned());
        let parts = parts.clone().ok_or_else(lost)?;
        let stream = faults.station_stream(redial().map_err(ControllerError::Failed)?);
        let machine = StationMachine::again(setup.clone(), stream, controller.clone(), parts, scene, now);
        let machine = machine.telling(host_course.clone());
        Ok::<_, ControllerError>(match &door {
            Some(door) => *Box::new(machine).with_pairs(door().map_err(ControllerError::Failed)?),
            None => machine,
        })
    };
    let factory = move |context: &BuildContext<'_>| {
        let machine = slot.take_or_make(|| again(context.scene, context.time))?;
        Ok(Box::new(StationController::new(context, machine)) as Box<dyn Controller>)
    };
    Ok((Arc::new(factory), Box::new(last_word), link))
}
