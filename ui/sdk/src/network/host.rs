//! The host's side: sockets and tickets before the session, and the machine once its scene is there.

use std::net::{IpAddr, Ipv4Addr, SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use serde::Deserialize;
use trocar_devices::HapticDevice;
use trocar_haptics::playout::PLAYOUT_SECS_MAX;
use trocar_kernel::spec::{CLOCK, Factory, LINK_OF_STATION, LINKS};
use trocar_network::control::{
    Architecture, ComponentList, HandInfo, HostFacts, PlainText, SCENARIO_TEXT_MAX, SESSION_HANDS_MAX,
    SessionInfo,
};
use trocar_network::datagram::Seal;
use trocar_network::faulty::LinkBoard;
use trocar_network::hands_link::playout::Playout;
use trocar_network::hands_link::{HandsHost, HandsLink, HostHand, LinkEnd, hands_channel};
use trocar_network::haptic::SenderConfig;
use trocar_network::live::interfaces::own_addresses;
use trocar_network::live::sockets::{HostSockets, PORT};
use trocar_network::live::store_admissions::{StoreAdmissions, unix_secs, wait_for_the_book};
use trocar_network::live::tls;
use trocar_network::live::tls_host_streams::TlsHostStreams;
use trocar_network::lockstep::{End, HandsPeer, WireHostStreams, Wires};
use trocar_network::remote_hand::{DoorLimits, RemoteHand};
use trocar_network::replication::choice::{ChoiceError, ColumnRates, ReplicatedColumns};
use trocar_network::replication::scene_feed::FeedLimits;
use trocar_network::session::{
    BookAdmissions, HostController, HostHandControl, HostMachine, HostSetup, MachineSlot, SteppedClock,
    UnixClock,
};
use trocar_network::streams::HostStreams;
use trocar_network::ticket::{
    ADDRESSES_MAX, HostAddress, HostTime, Identity, NameError, Offer, PlainName, Role, Ticket, TicketBook,
    TicketStore,
};
use trocar_scene::scenario::Scenario;
use trocar_scene::{BuildContext, Controller, ControllerError, Entity, Registry, SimTime, Snapshot};

use super::part::NetworkPart;
use super::reflected::ReflectorSettings;
use super::{Faults, HANDS_PEER, LastWord, Network, NetworkError, Sharing, TakingPart};

/// How long a ticket lets in, if nothing else is said \[s\].
pub const TICKET_LIFE_SECS: u64 = 24 * 3_600;

/// How long after a hand was there its instrument moves, at all peers, if the scenario says nothing else \[s\]: a path of
/// 150 ms there and back, and a quarter of that for its jitter.
const PLAYOUT_SECS: f64 = 0.1;

/// Table `[network]` of a scenario.
#[derive(Debug, Default, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub(super) struct NetworkSettings {
    pub architecture: Option<Architecture>,
    pub columns: ColumnRates,
    /// How long after a hand was there its instrument moves, at all peers \[s\].
    pub playout_secs: Option<f64>,
    /// Most bytes of positions a second for each station.
    pub bytes_per_sec: Option<f64>,
    /// Hands whose devices are behind a packet reflector.
    pub reflector: Option<ReflectorSettings>,
}

impl NetworkSettings {
    pub fn of(scenario: &Scenario) -> Result<Self, NetworkError> {
        let settings: Self = crate::kinds::parse_or_default(&scenario.network)
            .map_err(|error| NetworkError::Scenario(error.to_string()))?;
        if settings.bytes_per_sec.is_some_and(|rate| !(1e3..=1e9).contains(&rate)) {
            let reason = "bytes_per_sec: valid are 1e3 to 1e9 bytes a second";
            return Err(NetworkError::Scenario(scenario.network.error(reason).to_string()));
        }
        if settings.playout_secs.is_some_and(|secs| !(0.0..=PLAYOUT_SECS_MAX).contains(&secs)) {
            let reason = format!("playout_secs: valid are 0 to {PLAYOUT_SECS_MAX} seconds");
            return Err(NetworkError::Scenario(scenario.network.error(reason).to_string()));
        }
        Ok(settings)
    }

    pub fn playout(&self) -> SimTime {
        SimTime::from_secs_f64(self.playout_secs.unwrap_or(PLAYOUT_SECS))
    }
}

/// What a host is to be.
#[derive(Clone, Debug)]
pub struct HostOptions {
    /// Its name.
    pub name: String,
    /// The address to listen at; every one of the machine if none is named.
    pub bind: Option<IpAddr>,
    /// The port of TCP and UDP; 0 is any.
    pub port: u16,
    /// Addresses that tickets carry, in place of those that the machine knows of itself.
    pub addresses: Vec<HostAddress>,
    /// The file of certificate and tickets.
    pub book: PathBuf,
    /// Datagrams without protection, for the loopback alone.
    pub insecure: bool,
    /// Whether a person at the host answers when a mentor asks for an instrument that the host serves.
    pub is_attended: bool,
    /// Who computes what, in place of what the scenario says.
    pub architecture: Option<Architecture>,
}

impl Default for HostOptions {
    fn default() -> Self {
        Self {
            name: "host".to_owned(),
            bind: None,
            port: PORT,
            addresses: Vec::new(),
            book: default_book(),
            insecure: false,
            is_attended: false,
            architecture: None,
        }
    }
}

/// The file of a host's tickets, if no other is named: in the user's folder of state, or else in the current one.
pub fn default_book() -> PathBuf {
    let absolute = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let state = absolute("XDG_STATE_HOME").or_else(|| absolute("HOME").map(|home| home.join(".local/state")));
    state.map_or_else(|| PathBuf::from("trocar-host.tickets"), |state| state.join("trocar/host.tickets"))
}

/// A host with its port and its tickets, before its session begins. Several sessions may follow each other on it.
pub struct NetworkHost {
    options: HostOptions,
    sockets: HostSockets,
    tickets: StoreAdmissions,
}

impl NetworkHost {
    /// Takes the port, and opens the file of tickets.
    ///
    /// # Errors
    /// [`NetworkError`]: the port is in use, another host runs with the file.
    pub fn open(options: &HostOptions) -> Result<Self, NetworkError> {
        let name = plain_name(&options.name)?;
        let sockets = HostSockets::bind(options.bind, options.port)?;
        let store = TicketStore::open_host(&options.book, &name, wait_for_the_book)?;
        Ok(Self { options: options.clone(), sockets, tickets: StoreAdmissions::new(store) })
    }

    /// The port of TCP and UDP.
    pub fn port(&self) -> u16 {
        self.sockets.port
    }

    /// The addresses that tickets carry.
    pub fn addresses(&self) -> Vec<HostAddress> {
        addresses(&self.options, self.port())
    }

    /// The address at which this machine itself reaches the host.
    pub fn local(&self) -> SocketAddr {
        let here = self.options.bind.filter(|address| !address.is_unspecified());
        SocketAddr::new(here.unwrap_or_else(|| Ipv4Addr::LOCALHOST.into()), self.port())
    }

    /// Has tickets carry another address, such as that of its port at a relay, after its own.
    pub fn also_at(&mut self, address: HostAddress) {
        let mut all = self.addresses();
        all.truncate(ADDRESSES_MAX - 1);
        all.push(address);
        self.options.addresses = all;
    }

    pub(super) fn architecture(&self) -> Option<Architecture> {
        self.options.architecture
    }

    /// The tickets.
    pub fn tickets(&self) -> &StoreAdmissions {
        &self.tickets
    }

    /// Whether strangers can neither read nor forge datagrams.
    pub fn is_protected(&self) -> bool {
        !self.options.insecure
    }

    /// A new ticket.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn ticket(
        &self,
        person: &str,
        role: Role,
        life_secs: u64,
        session: &str,
    ) -> Result<Ticket, NetworkError> {
        issue(&mut self.tickets.store(), person, role, life_secs, session, self.addresses())
    }

    /// Sockets and streams of a session.
    fn streams(&self) -> Result<(Box<dyn HostStreams>, UdpSocket), NetworkError> {
        let system = |error: std::io::Error| NetworkError::System(format!("the port: {error}"));
        let identity = self.tickets.store().book().identity().clone();
        let key = identity.private_key().map_err(|error| NetworkError::System(error.to_string()))?;
        let config = tls::host(identity.certificate().clone(), key)
            .map_err(|error| NetworkError::System(error.to_string()))?;
        let seal = if self.options.insecure { Seal::Checksum } else { Seal::Aead };
        let listener = self.sockets.tcp.try_clone().map_err(system)?;
        let streams = TlsHostStreams::new(listener, config, seal)
            .map_err(|error| NetworkError::Usage(error.to_string()))?;
        let udp = self.sockets.udp.try_clone().map_err(system)?;
        Ok((Box::new(streams), udp))
    }
}

/// Gives out a ticket, of a host that runs or of one that will.
///
/// # Errors
/// [`NetworkError`].
pub fn issue(
    store: &mut TicketStore,
    person: &str,
    role: Role,
    life_secs: u64,
    session: &str,
    addresses: Vec<HostAddress>,
) -> Result<Ticket, NetworkError> {
    let now = unix_secs();
    let offer = Offer {
        role,
        person: plain_name(person)?,
        expires: now.saturating_add(life_secs),
        session: plain_name(session)?,
        addresses,
    };
    let issued = store.issue(offer, now, &ring::rand::SystemRandom::new())?;
    issued.map(|(_, ticket)| ticket).map_err(|error| NetworkError::Usage(error.to_string()))
}

/// The addresses that tickets carry: those that were named, or else those that other machines may reach this one by, and
/// the loopback last.
pub fn addresses(options: &HostOptions, port: u16) -> Vec<HostAddress> {
    if !options.addresses.is_empty() {
        return options.addresses.clone();
    }
    let mut found: Vec<IpAddr> = match options.bind {
        Some(address) if !address.is_unspecified() => vec![address],
        _ => own_addresses(),
    };
    found.truncate(ADDRESSES_MAX);
    found.into_iter().filter_map(|ip| HostAddress::of_socket(SocketAddr::new(ip, port)).ok()).collect()
}

pub(super) fn plain_name(text: &str) -> Result<PlainName, NetworkError> {
    text.parse().map_err(|error: NameError| NetworkError::Usage(error.to_string()))
}

/// A host over wires inside the process, in virtual time: for tests and for what a network does to an exercise.
pub struct LockstepHost {
    wires: Wires,
    book: Arc<Mutex<TicketBook>>,
    clock: VirtualClock,
    architecture: Option<Architecture>,
}

/// The wall clock of sessions in virtual time: it stands still, unless a fault steps it.
#[derive(Clone, Default)]
struct VirtualClock(Arc<SteppedClock>);

impl UnixClock for VirtualClock {
    fn now(&self) -> HostTime {
        HostTime { wall: self.0.stepped(VIRTUAL_UNIX_SECS), steady: VIRTUAL_UNIX_SECS }
    }
}

/// When sessions in virtual time take place \[s since 1970\].
const VIRTUAL_UNIX_SECS: u64 = 1_800_000_000;

impl LockstepHost {
    /// A host without stations.
    ///
    /// # Errors
    /// When the system has no randomness for its certificate.
    pub fn new() -> Result<Self, NetworkError> {
        let identity = Identity::create(&plain_name("host")?)
            .map_err(|error| NetworkError::System(error.to_string()))?;
        Ok(Self {
            wires: Wires::default(),
            book: Arc::new(Mutex::new(TicketBook::new(identity))),
            clock: VirtualClock::default(),
            architecture: None,
        })
    }

    /// Who computes what, in place of what the scenario says.
    #[must_use]
    pub fn with_architecture(self, architecture: Architecture) -> Self {
        Self { architecture: Some(architecture), ..self }
    }

    pub(super) fn architecture(&self) -> Option<Architecture> {
        self.architecture
    }

    /// The wires to its stations.
    pub fn wires(&self) -> &Wires {
        &self.wires
    }

    /// A new ticket. All are to be given out before the session begins.
    ///
    /// # Errors
    /// [`NetworkError`].
    pub fn ticket(&self, person: &str, role: Role) -> Result<Ticket, NetworkError> {
        let offer = Offer {
            role,
            person: plain_name(person)?,
            expires: VIRTUAL_UNIX_SECS + TICKET_LIFE_SECS,
            session: plain_name("session")?,
            addresses: vec![
                HostAddress::of_socket(SocketAddr::from(([127, 0, 0, 1], PORT)))
                    .map_err(|error| NetworkError::Usage(error.to_string()))?,
            ],
        };
        let mut book = self.book.lock().unwrap_or_else(PoisonError::into_inner);
        let issued = book.issue(offer, VIRTUAL_UNIX_SECS, &ring::rand::SystemRandom::new());
        issued.map(|(_, ticket)| ticket).map_err(|error| NetworkError::Usage(error.to_string()))
    }

    fn admissions(&self) -> BookAdmissions<VirtualClock> {
        BookAdmissions { book: self.book.clone(), clock: self.clock.clone() }
    }
}

/// The hands of a session, as its network reaches them.
#[derive(Default)]
pub(crate) struct NetworkHands {
    infos: Vec<(HandInfo, HostHandControl)>,
    ends: Vec<HostHand>,
}

impl NetworkHands {
    /// Wraps the device of a hand, so that stations can serve it.
    ///
    /// # Errors
    /// [`NetworkError`] when there are too many hands, or a name does not travel.
    pub fn wrap(
        &mut self,
        name: &str,
        entity: Entity,
        device: Box<dyn HapticDevice>,
        sharing: Sharing,
    ) -> Result<Box<dyn HapticDevice>, NetworkError> {
        if self.infos.len() >= SESSION_HANDS_MAX {
            let text = format!("a session over a network has at most {SESSION_HANDS_MAX} hands");
            return Err(NetworkError::Scenario(text));
        }
        let number = self.infos.len() as u8;
        let (hand, end) = RemoteHand::over(number, DoorLimits::default(), device)
            .map_err(|error| NetworkError::Scenario(error.to_string()))?;
        let control = HostHandControl { number, control: end.control().clone() };
        let info = HandInfo { number, name: plain_name(name)?, entity, station: None };
        self.infos.push((info, control));
        let playout = sharing.is_among_peers().then(|| Playout::new(sharing.playout));
        self.ends.push(HostHand { number, end, playout });
        Ok(Box::new(hand))
    }
}

/// The actor of a host's session, and its hands link.
pub(crate) fn hosted(
    network: &Network,
    scenario: &Scenario,
    seed: u64,
    scene: &Snapshot,
    hands: NetworkHands,
    has_faults: bool,
) -> Result<Option<TakingPart>, NetworkError> {
    let settings = NetworkSettings::of(scenario)?;
    let sharing = network.sharing(scenario)?;
    let faults = Faults { board: Arc::new(LinkBoard::host()), has_plan: has_faults };
    let mut fault_sinks = faults.sinks(&[LINK_OF_STATION, LINKS]);
    match network {
        Network::None | Network::Station(_) => Ok(None),
        Network::Host(host) => {
            let (streams, socket) = host.streams()?;
            let host = host.clone();
            let setup =
                setup(scenario, &settings, sharing, (seed, scene), hands.infos, host.options.is_attended)?;
            let (controller, link) = hands_channel();
            let link: Box<dyn HandsLink<SocketAddr>> =
                faults.hands(Box::new(hands_host(sharing, hands.ends, link)));
            let admissions = Box::new(host.tickets.clone());
            fault_sinks.push((CLOCK.to_owned(), host.tickets.clock().clone()));
            let first = HostMachine::new(
                setup.clone(),
                faults.host_streams(streams),
                admissions,
                controller.clone(),
                Arc::new(scene.clone()),
            );
            let is_protected = host.is_protected();
            let again = move |scene: &Snapshot| {
                let (streams, _) =
                    host.streams().map_err(|error| ControllerError::Failed(error.to_string()))?;
                let admissions = Box::new(host.tickets.clone());
                let scene = Arc::new(scene.clone());
                let streams = faults.host_streams(streams);
                Ok(HostMachine::new(setup.clone(), streams, admissions, controller.clone(), scene))
            };
            let (actor, last_word) = blueprint(first, is_protected, again);
            let part = NetworkPart::Live { socket, link };
            Ok(Some(TakingPart { actor, part, last_word, host_course: None, fault_sinks }))
        }
        Network::LockstepHost(host) => {
            let setup = setup(scenario, &settings, sharing, (seed, scene), hands.infos, false)?;
            let (controller, link) = hands_channel();
            let link: Box<dyn HandsLink<usize>> =
                faults.hands(Box::new(hands_host(sharing, hands.ends, link)));
            fault_sinks.push((CLOCK.to_owned(), host.clock.0.clone()));
            let host = host.clone();
            let peer = HandsPeer::new(HANDS_PEER, link, host.wires.clone(), End::Host);
            let make = move |scene: &Snapshot| {
                let streams = faults.host_streams(Box::new(WireHostStreams::new(host.wires.clone())));
                // Every machine gets the book as it is.
                let admissions = Box::new(host.admissions());
                let scene = Arc::new(scene.clone());
                Ok(HostMachine::new(setup.clone(), streams, admissions, controller.clone(), scene))
            };
            let first =
                make(scene).map_err(|error: ControllerError| NetworkError::System(error.to_string()))?;
            let (actor, last_word) = blueprint(first, true, make);
            let part = NetworkPart::Lockstep(Box::new(peer));
            Ok(Some(TakingPart { actor, part, last_word, host_course: None, fault_sinks }))
        }
    }
}

fn hands_host<A: Copy + PartialEq>(sharing: Sharing, hands: Vec<HostHand>, link: LinkEnd<A>) -> HandsHost<A> {
    let host = HandsHost::new(hands, link);
    if sharing.has_all_hands() { host.sharing() } else { host }
}

fn setup(
    scenario: &Scenario,
    settings: &NetworkSettings,
    sharing: Sharing,
    (seed, scene): (u64, &Snapshot),
    hands: Vec<(HandInfo, HostHandControl)>,
    is_attended: bool,
) -> Result<HostSetup, NetworkError> {
    let registry = scene.registry();
    let text = scenario.text();
    if text.len() > SCENARIO_TEXT_MAX {
        let reason =
            format!("{}: longer than the {SCENARIO_TEXT_MAX} bytes that travel", scenario.file.display());
        return Err(NetworkError::Scenario(reason));
    }
    let columns = replicated(registry, settings, sharing.architecture)
        .map_err(|error| NetworkError::Scenario(scenario.network.error(error.to_string()).to_string()))?;
    let components = ComponentList::of(registry);
    let mut limits = FeedLimits::default();
    limits.bytes_per_sec = settings.bytes_per_sec.unwrap_or(limits.bytes_per_sec);
    Ok(HostSetup {
        name: plain_name("host")?,
        facts: HostFacts {
            components_digest: components.digest(),
            components,
            scenario_name: PlainText::new(scenario.name.as_str()),
            scenario: *blake3::hash(text.as_bytes()).as_bytes(),
        },
        info: SessionInfo {
            scenario_name: PlainText::new(scenario.name.as_str()),
            scenario_text: text.to_owned(),
            seed,
            architecture: sharing.architecture,
            hands: Vec::new(),
            stations: Vec::new(),
        },
        columns: Arc::new(columns),
        limits,
        sender: SenderConfig::default(),
        hands,
        is_attended,
        secret: random_secret(seed),
    })
}

/// Which columns travel, and how.
pub(super) fn replicated(
    registry: &Arc<Registry>,
    settings: &NetworkSettings,
    architecture: Architecture,
) -> Result<ReplicatedColumns, ChoiceError> {
    let columns = ReplicatedColumns::new(registry, &settings.columns)?;
    Ok(match architecture {
        Architecture::ClientServer => columns,
        Architecture::PeerToPeer => columns.among_peers(),
        Architecture::Hybrid => columns.with_all_hands(),
    })
}

/// Seed of the challenges to new addresses. Of no use to whoever has not the keys of a connection.
pub(super) fn random_secret(seed: u64) -> u64 {
    let mut bytes = seed.to_le_bytes();
    // Without randomness no certificate could have been made.
    let _ = ring::rand::SecureRandom::fill(&ring::rand::SystemRandom::new(), &mut bytes);
    u64::from_le_bytes(bytes)
}

/// The actor of the first machine; one that is lost is made `again`, and the stations come back by their secrets.
fn blueprint<A: Copy + PartialEq + Send + 'static>(
    first: HostMachine<A>,
    is_protected: bool,
    again: impl Fn(&Snapshot) -> Result<HostMachine<A>, ControllerError> + Send + Sync + 'static,
) -> (Factory, LastWord) {
    let slot = MachineSlot::new(first);
    let ended = slot.clone();
    // A machine that its actor still has, or that was lost, says nothing more.
    let last_word = move || ended.take().is_none_or(|mut machine| machine.work(HostMachine::finish));
    let factory = move |context: &BuildContext<'_>| {
        let machine = slot.take_or_make(|| again(context.scene))?;
        Ok(Box::new(HostController::new(context, machine, is_protected)) as Box<dyn Controller>)
    };
    (Arc::new(factory), Box::new(last_word))
}
