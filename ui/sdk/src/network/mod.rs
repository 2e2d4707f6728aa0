//! Sessions over a network: a host that others join, and stations that join it.
//!
//! ```no_run
//! use std::sync::Arc;
//! use trocar::network::{HostOptions, Network, NetworkHost};
//! use trocar::prelude::*;
//! use trocar::run;
//!
//! let app = App::new();
//! let host = Arc::new(NetworkHost::open(&HostOptions::default())?);
//! println!("{}", host.ticket("Ana", trocar::network::ticket::Role::Operate, 3_600, "peg-transfer")?);
//! let options = RunOptions { network: Network::Host(host), ..RunOptions::default() };
//! run::run(&app, &app.scenario("peg-transfer")?, &options, &mut |_| ())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A station [joins](join) with a ticket: it gets scenario and scene from the host, and runs its own haptics, window and
//! network on them.

mod host;
mod itp_console;
mod itp_device;
mod part;
mod reflected;
mod station;

use std::fmt;
use std::sync::Arc;

use thiserror::Error;
use trocar_kernel::spec::{Factory, FaultSink};
use trocar_network::control::{Architecture, ControlError, ExitClass};
use trocar_network::faulty::{FaultyHands, FaultyHostStreams, FaultyStationStream, LinkBoard};
use trocar_network::hands_link::HandsLink;
use trocar_network::live::sockets::SocketError;
use trocar_network::session::HostCourse;
use trocar_network::streams::{HostStreams, StationStream};
use trocar_network::ticket::StoreError;
use trocar_scene::SimTime;
use trocar_scene::scenario::Scenario;

use self::host::NetworkSettings;

pub use host::{HostOptions, LockstepHost, NetworkHost, TICKET_LIFE_SECS, addresses, default_book, issue};
pub(crate) use host::{NetworkHands, hosted};
pub(crate) use itp_device::{ITP_ABOUT, ITP_USAGE, ItpRobots};
pub use part::NetworkPart;
pub(crate) use part::RunningPart;
pub(crate) use reflected::{
    ReflectedOrigin, TELEOPERATION, TELEOPERATION_HZ, TeleoperatedHands, TeleoperationPart,
};
pub use station::{JoinOptions, JoinProgress, Joining, Station, credential_of, join};
pub(crate) use station::{STATION_WRITER, StationHands, stationed};

#[doc(no_inline)]
pub use trocar_network::*;

/// Name of the network's actor.
pub const NETWORK: &str = "network";
/// Ticks per second of the network's actor \[Hz\]: rows of the scene go at 60 Hz, each at the next tick.
pub const NETWORK_HZ: f64 = 250.0;

/// Name of the hands link in virtual time.
const HANDS_PEER: &str = "network.hands";

/// Tells the other end that the session is over; true once it was told, or cannot be.
pub(crate) type LastWord = Box<dyn FnMut() -> bool + Send>;

/// A session's part in a network.
pub(crate) struct TakingPart {
    /// Makes its actor.
    pub actor: Factory,
    /// Its hands link.
    pub part: NetworkPart,
    /// What is said at the end.
    pub last_word: LastWord,
    /// At a station, whether the session of its host pauses, or is over.
    pub host_course: Option<HostCourse>,
    /// Targets for faults.
    pub fault_sinks: Vec<(String, Arc<dyn FaultSink>)>,
}

/// The faults of a session's links: the board on which its fault plan puts them. Without a plan nothing is put between the
/// session and what moves its bytes.
#[derive(Clone)]
struct Faults {
    board: Arc<LinkBoard>,
    has_plan: bool,
}

impl Faults {
    fn hands<A: Copy + Send + 'static>(&self, link: Box<dyn HandsLink<A>>) -> Box<dyn HandsLink<A>> {
        if self.has_plan { Box::new(FaultyHands::new(link, self.board.clone())) } else { link }
    }

    fn host_streams(&self, streams: Box<dyn HostStreams>) -> Box<dyn HostStreams> {
        if self.has_plan { Box::new(FaultyHostStreams::new(streams, self.board.clone())) } else { streams }
    }

    fn station_stream<A: 'static>(&self, stream: Box<dyn StationStream<A>>) -> Box<dyn StationStream<A>> {
        if self.has_plan { Box::new(FaultyStationStream::new(stream, self.board.clone())) } else { stream }
    }

    /// The board under these names.
    fn sinks(&self, names: &[&str]) -> Vec<(String, Arc<dyn FaultSink>)> {
        names.iter().map(|name| ((*name).to_owned(), self.board.clone() as Arc<dyn FaultSink>)).collect()
    }
}

/// How a session takes part in a network.
#[derive(Clone, Default)]
pub enum Network {
    /// Not at all.
    #[default]
    None,
    /// It is the host, over sockets.
    Host(Arc<NetworkHost>),
    /// It is the host, over wires inside the process, in virtual time.
    LockstepHost(Arc<LockstepHost>),
    /// It is a station, which has joined.
    Station(Arc<Station>),
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::None => "None",
            Self::Host(_) => "Host",
            Self::LockstepHost(_) => "LockstepHost",
            Self::Station(_) => "Station",
        })
    }
}

/// How the stations of a session share its scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Sharing {
    /// Who computes what.
    pub architecture: Architecture,
    /// How long after a hand was there its instrument moves, at all peers.
    pub playout: SimTime,
}

impl Sharing {
    /// Whether each computes the scene for itself.
    pub fn is_among_peers(self) -> bool {
        self.architecture == Architecture::PeerToPeer
    }

    /// Whether every station gets the hands of all others.
    pub fn has_all_hands(self) -> bool {
        self.architecture != Architecture::ClientServer
    }
}

impl Network {
    /// How a session of this scenario is shared.
    pub(crate) fn sharing(&self, scenario: &Scenario) -> Result<Sharing, NetworkError> {
        let settings = NetworkSettings::of(scenario)?;
        let chosen = match self {
            Self::None => Some(Architecture::ClientServer),
            Self::Host(host) => host.architecture(),
            Self::LockstepHost(host) => host.architecture(),
            Self::Station(station) => Some(station.architecture),
        };
        let architecture = chosen.or(settings.architecture).unwrap_or(Architecture::ClientServer);
        let playout = match architecture {
            Architecture::PeerToPeer => settings.playout(),
            _ => SimTime::ZERO,
        };
        Ok(Sharing { architecture, playout })
    }

    /// The station, if the session is one.
    pub fn station(&self) -> Option<&Arc<Station>> {
        match self {
            Self::Station(station) => Some(station),
            _ => None,
        }
    }
}

/// Why a session cannot take part in a network.
#[derive(Debug, Error)]
pub enum NetworkError {
    /// A port or an address.
    #[error(transparent)]
    Socket(#[from] SocketError),
    /// The host's file of tickets.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The host did not let the station in, or the link does not carry.
    #[error("{0}")]
    Control(ControlError),
    /// What the scenario says of its network.
    #[error("{0}")]
    Scenario(String),
    /// A name, an address or a ticket.
    #[error("{0}")]
    Usage(String),
    /// The system.
    #[error("{0}")]
    System(String),
}

impl NetworkError {
    /// Class of the exit code.
    pub fn exit_class(&self) -> ExitClass {
        match self {
            Self::Socket(_) | Self::System(_) => ExitClass::Unavailable,
            Self::Store(_) | Self::Scenario(_) => ExitClass::Scenario,
            Self::Control(error) => error.exit_class(),
            Self::Usage(_) => ExitClass::Usage,
        }
    }
}
