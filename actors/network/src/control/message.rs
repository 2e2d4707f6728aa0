//! The messages of the control channel.
//!
//! They are enums in postcard: a variant's number is its place, so that variants are only ever added at the end, and every
//! other change raises [`WIRE_VERSION`](super::WIRE_VERSION).

use serde::{Deserialize, Serialize};
use trocar_scene::{Entity, Revision, SimTime};

use super::blob::Blob;
use super::component_list::COMPONENTS_MAX;
use super::credential::Credential;
use super::diagnosis::{Diagnose, Diagnosed, EchoCounts};
use super::error::{Goodbye, Refusal};
use super::keep_alive::{Ping, Pong};
use super::manifest::{HeldScene, SceneManifest};
use super::message_error::MessageError;
use super::note::{Note, NoteKind};
use super::plain_text::PlainText;
use crate::datagram::DATAGRAM_MAX;
use crate::peers::repair::{self, RepairRequest};
use crate::ticket::{PlainName, Role};

/// Most stations of a session.
pub const STATIONS_MAX: usize = 64;
/// Most hands of a session, all stations together.
pub const SESSION_HANDS_MAX: usize = 64;
/// Most hands that one station serves: as many as fit into one datagram.
pub const STATION_HANDS_MAX: usize = 11;
/// Most bytes of a scenario's text.
pub const SCENARIO_TEXT_MAX: usize = 512 << 10;
/// Most bytes of a part of the scene.
pub const SCENE_PART_MAX: usize = 64 << 10;
/// Most bytes of a message of replication.
pub const DELTA_MAX: usize = 512 << 10;
/// Most bytes of a ticket from one peer to another.
pub const PEER_TICKET_MAX: usize = 4 << 10;

const _: () = assert!(repair::REPAIR_BYTES_MAX <= DELTA_MAX);

/// Who computes what.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Architecture {
    /// The host's Model is authoritative, and the others hold replicas.
    ClientServer,
    /// Each entity has one owner.
    PeerToPeer,
    /// A server for the scene, peers for hands.
    Hybrid,
}

impl Architecture {
    /// All of them.
    pub const ALL: [Self; 3] = [Self::ClientServer, Self::PeerToPeer, Self::Hybrid];

    /// The word for it.
    pub fn word(self) -> &'static str {
        match self {
            Self::ClientServer => "client-server",
            Self::PeerToPeer => "peer-to-peer",
            Self::Hybrid => "hybrid",
        }
    }
}

/// What a station wants to be.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Wish {
    /// Its name.
    pub name: PlainName,
    /// Its role; without one it gets that of its ticket.
    pub role: Option<Role>,
    /// Names of the hands that it wants to serve.
    pub hands: Vec<PlainName>,
    /// Names of the hands for which it has devices; the rows of their haptics are its own, whether it serves them or not.
    pub devices: Vec<PlainName>,
    /// Whether a person or a program at the station says where its hands go, and not the session's virtual trainee.
    pub moves: bool,
}

/// First message of a station.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Hello {
    /// Version of the program, for people.
    pub program: PlainText,
    /// [`ComponentList::digest`](super::ComponentList::digest).
    pub components: [u8; 32],
    /// BLAKE3 of the station's own scenario, if it has one.
    pub scenario: Option<[u8; 32]>,
    /// What lets it in.
    pub credential: Credential,
    /// What it wants to be.
    pub wish: Wish,
    /// The scene that it still has after a break.
    pub held: Option<HeldScene>,
}

/// A hand of the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HandInfo {
    /// Its number in datagrams.
    pub number: u8,
    /// Its name.
    pub name: PlainName,
    /// Its entity in the scene.
    pub entity: Entity,
    /// Number of the station that serves it, if one does.
    pub station: Option<u16>,
}

/// How a link does, for panels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LinkFigures {
    /// Round trip \[µs\].
    pub round_trip_us: u32,
    /// Standard deviation of the delay \[µs\].
    pub jitter_us: u32,
    /// Share of the datagrams that is lost [10⁻⁶].
    pub loss_ppm: u32,
    /// Age of what is shown \[µs\].
    pub age_us: u32,
    /// Datagrams a second.
    pub rate_hz: u16,
}

/// A station of the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct StationInfo {
    /// Its number.
    pub number: u16,
    /// Its name.
    pub name: PlainName,
    /// What it may do.
    pub role: Role,
    /// Whether it is there, and not away after a break.
    pub is_here: bool,
    /// Numbers of the hands that it serves.
    pub hands: Vec<u8>,
    /// Its link to the host.
    pub link: LinkFigures,
}

/// What a newcomer is told of the session.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SessionInfo {
    /// Name of the scenario.
    pub scenario_name: PlainText,
    /// Text of the scenario, as in its file.
    pub scenario_text: String,
    /// Seed of the session.
    pub seed: u64,
    /// Who computes what.
    pub architecture: Architecture,
    /// All hands.
    pub hands: Vec<HandInfo>,
    /// All stations, the newcomer among them.
    pub stations: Vec<StationInfo>,
}

/// The host's answer to a station that it lets in.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Welcome {
    /// Number of the station.
    pub station: u16,
    /// Number of the connection in datagrams.
    pub connection: u32,
    /// What it may do.
    pub role: Role,
    /// The host's session clock.
    pub host_time: SimTime,
    /// The host's clock \[s since 1970\], for [`clock_difference`](crate::ticket::clock_difference) alone.
    pub host_unix_secs: u64,
    /// The session.
    pub session: SessionInfo,
    /// The scene that follows.
    pub manifest: SceneManifest,
}

/// Something that a station asks for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Request {
    /// Number that the answer names.
    pub number: u32,
    /// What it asks for.
    pub what: RequestKind,
}

/// What a station may ask for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum RequestKind {
    /// To serve a hand.
    TakeHand(PlainName),
    /// To serve it no longer.
    GiveHand(PlainName),
    /// To show something to the others.
    Note(NoteKind),
    /// To pass a ticket to another station, which then connects to this one.
    PeerTicket {
        /// The other station.
        to: u16,
        /// The ticket.
        ticket: Vec<u8>,
    },
    /// The rows of a body, of which the station's own differ; among peers.
    Repair(RepairRequest),
}

impl RequestKind {
    /// Whether a station of this role may ask for it.
    pub fn is_allowed_to(&self, role: Role) -> bool {
        match self {
            Self::TakeHand(_) | Self::GiveHand(_) | Self::PeerTicket { .. } => role.may_operate(),
            Self::Note(note) => note.is_allowed_to(role),
            Self::Repair(_) => true,
        }
    }

    /// What it is, for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::TakeHand(_) => "take a hand",
            Self::GiveHand(_) => "give a hand back",
            Self::Note(note) => note.name(),
            Self::PeerTicket { .. } => "connect to another station",
            Self::Repair(_) => "repair a body",
        }
    }
}

/// A datagram for which the other way is blocked, and what its sender knows of the other end's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Carried<'a> {
    /// Whether the sender hears the other end's datagrams by themselves.
    pub hears: bool,
    /// How many carried datagrams of hands the sender has taken over this connection, modulo 2³².
    pub taken: u32,
    /// The sealed datagram; empty when there is only something to tell.
    #[serde(borrow)]
    pub datagram: Blob<'a>,
}

impl Carried<'_> {
    fn check(&self) -> Result<(), MessageError> {
        MessageError::limit("bytes of a datagram", self.datagram.as_slice().len(), DATAGRAM_MAX)
    }
}

/// From a station to its host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum ClientMessage<'a> {
    /// The opening.
    Hello(Box<Hello>),
    /// The scene is built.
    Joined {
        /// Revision of the manifest.
        revision: Revision,
        /// Digest of what was built.
        digest: [u8; 32],
    },
    /// The station asks for something.
    Request(Request),
    /// Rows that the station owns, in order; for the replication.
    #[serde(borrow)]
    Write(Blob<'a>),
    /// For the keep-alive.
    Ping(Ping),
    /// For the keep-alive.
    Pong(Pong),
    /// The keys of this phase are in use.
    Rekeyed {
        /// The phase.
        phase: u32,
    },
    /// The end.
    Goodbye(Goodbye),
    /// For the hands link.
    #[serde(borrow)]
    Carried(Carried<'a>),
    /// An opening that asks for a diagnosis in place of the session.
    Diagnose(Box<Diagnose>),
}

/// From a host to a station.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum HostMessage<'a> {
    /// The opening, for a station that is not let in.
    Refused(Refusal),
    /// The opening.
    Welcome(Box<Welcome>),
    /// Part of the scene.
    ScenePart {
        /// Where it begins \[bytes\].
        offset: u32,
        /// At most [`SCENE_PART_MAX`].
        #[serde(borrow)]
        bytes: Blob<'a>,
    },
    /// Changes, in order; from the replication.
    #[serde(borrow)]
    Delta(Blob<'a>),
    /// Who is there.
    Roster(Vec<StationInfo>),
    /// Another station serves a hand, or none.
    HandServed {
        /// Number of the hand.
        hand: u8,
        /// Who serves it from now on.
        station: Option<u16>,
        /// Since when, by the host's session clock.
        at: SimTime,
    },
    /// A station shows something.
    Note(Note),
    /// Another station's ticket.
    PeerTicket {
        /// Who gives it.
        from: u16,
        /// The ticket.
        ticket: Vec<u8>,
    },
    /// Answer to a request; without a number for a write, which has none.
    Answer {
        /// Number of the request.
        request: Option<u32>,
        /// Why it is not done, if so.
        refusal: Option<Refusal>,
    },
    /// For the keep-alive.
    Ping(Ping),
    /// For the keep-alive.
    Pong(Pong),
    /// The keys of this phase are to be used.
    Rekey {
        /// The phase, one more than the last.
        phase: u32,
    },
    /// The end.
    Goodbye(Goodbye),
    /// For the hands link.
    #[serde(borrow)]
    Carried(Carried<'a>),
    /// The opening, for who asked for a diagnosis.
    Diagnosed(Diagnosed),
    /// What has come of a diagnosis's datagrams so far.
    Echoed(EchoCounts),
    /// The rows of a body that the station asked for; among peers.
    #[serde(borrow)]
    Repair(Blob<'a>),
    /// The session is paused, or goes on. While it is paused this is said again and again, so that silence tells of a host
    /// that is gone.
    Paused(bool),
}

fn decode<'a, T: Deserialize<'a>>(bytes: &'a [u8]) -> Result<(T, usize), MessageError> {
    let decoded = postcard::take_from_bytes::<T>(bytes);
    let (message, rest) = decoded.map_err(|reason| MessageError::Encoding { bytes: bytes.len(), reason })?;
    Ok((message, rest.len()))
}

fn nothing_left(message: &'static str, rest: usize) -> Result<(), MessageError> {
    if rest > 0 { Err(MessageError::Trailing { message, rest }) } else { Ok(()) }
}

impl<'a> ClientMessage<'a> {
    /// Reads a message, and checks its sizes and numbers.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn decode(bytes: &'a [u8]) -> Result<Self, MessageError> {
        let (message, rest) = decode::<Self>(bytes)?;
        nothing_left(message.name(), rest)?;
        message.check()?;
        Ok(message)
    }

    fn check(&self) -> Result<(), MessageError> {
        match self {
            Self::Hello(hello) => {
                let Wish { hands, devices, .. } = &hello.wish;
                MessageError::limit("hands of a station", hands.len().max(devices.len()), STATION_HANDS_MAX)
            }
            Self::Carried(carried) => carried.check(),
            Self::Write(bytes) => MessageError::limit("bytes of rows", bytes.as_slice().len(), DELTA_MAX),
            Self::Request(Request { what: RequestKind::Note(note), .. }) => note.check(),
            Self::Request(Request { what: RequestKind::PeerTicket { ticket, .. }, .. }) => {
                MessageError::limit("bytes of a ticket", ticket.len(), PEER_TICKET_MAX)
            }
            Self::Request(Request { what: RequestKind::Repair(asked), .. }) => {
                MessageError::limit("rows of a body", asked.rows.len(), repair::ROWS_MAX)
            }
            _ => Ok(()),
        }
    }

    /// What it is, for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Hello(_) => "hello",
            Self::Joined { .. } => "joined",
            Self::Request(_) => "request",
            Self::Write(_) => "write",
            Self::Ping(_) => "ping",
            Self::Pong(_) => "pong",
            Self::Rekeyed { .. } => "rekeyed",
            Self::Goodbye(_) => "goodbye",
            Self::Carried(_) => "carried datagram",
            Self::Diagnose(_) => "diagnose",
        }
    }
}

impl<'a> HostMessage<'a> {
    /// Reads a message, and checks its sizes and numbers.
    ///
    /// # Errors
    /// [`MessageError`].
    pub fn decode(bytes: &'a [u8]) -> Result<Self, MessageError> {
        let (message, rest) = decode::<Self>(bytes)?;
        nothing_left(message.name(), rest)?;
        message.check()?;
        Ok(message)
    }

    fn check(&self) -> Result<(), MessageError> {
        match self {
            Self::Refused(Refusal::OtherRegistry(list)) => {
                MessageError::limit("components", list.components().len(), COMPONENTS_MAX)
            }
            Self::Refused(Refusal::HandUnknown { valid, .. }) => {
                MessageError::limit("hands", valid.len(), SESSION_HANDS_MAX)
            }
            Self::Welcome(welcome) => {
                welcome.session.check()?;
                welcome.manifest.check()
            }
            Self::ScenePart { bytes, .. } => {
                MessageError::limit("bytes of the scene", bytes.as_slice().len(), SCENE_PART_MAX)
            }
            Self::Carried(carried) => carried.check(),
            Self::Delta(bytes) => MessageError::limit("bytes of changes", bytes.as_slice().len(), DELTA_MAX),
            Self::Repair(bytes) => {
                MessageError::limit("bytes of a repair", bytes.as_slice().len(), DELTA_MAX)
            }
            Self::Roster(stations) => check_stations(stations),
            Self::Note(note) => note.what.check(),
            Self::PeerTicket { ticket, .. } => {
                MessageError::limit("bytes of a ticket", ticket.len(), PEER_TICKET_MAX)
            }
            _ => Ok(()),
        }
    }

    /// What it is, for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Refused(_) => "refused",
            Self::Welcome(_) => "welcome",
            Self::ScenePart { .. } => "scene part",
            Self::Delta(_) => "delta",
            Self::Roster(_) => "roster",
            Self::HandServed { .. } => "hand served",
            Self::Note(_) => "note",
            Self::PeerTicket { .. } => "peer ticket",
            Self::Repair(_) => "repair",
            Self::Paused(_) => "pause",
            Self::Answer { .. } => "answer",
            Self::Ping(_) => "ping",
            Self::Pong(_) => "pong",
            Self::Rekey { .. } => "rekey",
            Self::Goodbye(_) => "goodbye",
            Self::Carried(_) => "carried datagram",
            Self::Diagnosed(_) => "diagnosed",
            Self::Echoed(_) => "echoed",
        }
    }
}

impl SessionInfo {
    /// Whether all sizes are within their limits.
    ///
    /// # Errors
    /// [`MessageError::Limit`].
    pub fn check(&self) -> Result<(), MessageError> {
        MessageError::limit("bytes of the scenario", self.scenario_text.len(), SCENARIO_TEXT_MAX)?;
        MessageError::limit("hands", self.hands.len(), SESSION_HANDS_MAX)?;
        check_stations(&self.stations)
    }
}

pub(super) fn check_stations(stations: &[StationInfo]) -> Result<(), MessageError> {
    MessageError::limit("stations", stations.len(), STATIONS_MAX)?;
    let hands = stations.iter().map(|station| station.hands.len()).max().unwrap_or(0);
    MessageError::limit("hands of a station", hands, STATION_HANDS_MAX)
}
