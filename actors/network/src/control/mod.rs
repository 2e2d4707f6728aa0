//! The control channel: how a station comes into a session, gets its scene, and is told what must not be lost.
//!
//! Two sans-IO machines over an ordered, reliable and authenticated stream of bytes (TLS over TCP when live):
//! [`HostControl`] for one connection at the host, and [`ClientControl`] for a station, over as many connections as its
//! links need. The driver brings them bytes and the time, and takes bytes and a deadline from them. What a session decides
//! is asked of a [`HostSession`]; [`Roster`] keeps its stations and hands.
//!
//! ```text
//! station                                      host
//!   hello: versions, ticket, wish, held  ───▶   ticket, components, scenario, role, hands: only then is the token spent
//!                                        ◀───   welcome: station, session, manifest of the scene       (or refused)
//!   hash                                 ◀───   parts of the scene, paced
//!   builds, counts, digest: joined       ───▶   same digest
//!   requests, writes                     ◀──▶   changes, roster, hands, notes, keys; pings both ways
//!   datagrams, where UDP is blocked      ◀──▶   datagrams, where UDP is blocked
//! ```
//!
//! Everything is bounded:
//!
//! | what | limit |
//! |---|---|
//! | frame of a stranger, of a station | [`OPENING_MAX`] 16 KiB, [`FRAME_MAX`] 1 MiB |
//! | time for a hello, for its answer | [`OPENING_TIME_MAX`] 5 s, [`ANSWER_TIME_MAX`] 10 s |
//! | time to get and build the scene | [`JOIN_TIME_MAX`] 120 s |
//! | silence, and bytes that nobody takes | [`SILENCE_MAX`] 5 s, [`STALLED_MAX`] 5 s |
//! | bytes that wait for a station; while the scene goes out | [`WAITING_MAX`] 16 MiB; [`PACE_BYTES`] 64 KiB and a part |
//! | scene, part of it, message of replication | [`SCENE_BYTES_MAX`] 512 MiB, [`SCENE_PART_MAX`] 64 KiB, [`DELTA_MAX`] 512 KiB |
//! | stations, hands, hands of a station | [`STATIONS_MAX`] 64, [`SESSION_HANDS_MAX`] 64, [`STATION_HANDS_MAX`] 11 |
//! | place and hands kept after a break | [`AWAY_TIME_MAX`] 60 s |
//! | datagrams of hands that are carried and wait, others | 1, the newest; 32 |
//! | requests beyond the role before a station is cut off | [`FORBIDDEN_MAX`] 256 |
//! | diagnoses at once, time of each | [`DIAGNOSES_MAX`] 4, [`DIAGNOSIS_TIME_MAX`] 15 s |
//!
//! Whoever holds a ticket may ask for a diagnosis in place of the session: [`Diagnose`] is the opening then. The token is
//! not spent, the scene stays untold, and the connection's only use is the keys under which datagrams are echoed.

mod blob;
mod client;
mod client_end;
mod component_list;
mod credential;
mod diagnosis;
mod error;
mod frame;
mod host;
mod host_end;
mod host_session;
#[cfg(test)]
mod join_tests;
mod keep_alive;
#[cfg(test)]
mod limits_tests;
mod manifest;
mod message;
mod message_error;
mod note;
mod outbox;
mod plain_text;
#[cfg(test)]
mod resume_tests;
mod roster;
mod scene_assembly;
#[cfg(test)]
pub(crate) mod session_testing;

pub use blob::Blob;
pub use client::{
    ANSWER_TIME_MAX, BROKEN_JOINS_MAX, BUILD_TIME_MAX, CONNECT_TIME_MAX, ClientControl, ClientEvent,
    ClientFacts, ClientPoll, ClientState, FIRST_TIME_MAX, PAUSE_FIRST, PAUSE_MAX, StreamWish,
};
pub use component_list::{COMPONENTS_MAX, ComponentDifference, ComponentList, ListedComponent};
pub use credential::Credential;
pub use diagnosis::{DIAGNOSES_MAX, DIAGNOSIS_TIME_MAX, Diagnose, Diagnosed, EchoCounts, TicketVerdict};
pub use error::{ControlError, ExitClass, Goodbye, Refusal};
pub use frame::{
    FRAME_MAX, FrameDecoder, FrameError, LENGTH_BYTES, OPENING_MAX, PREAMBLE_BYTES, WIRE_VERSION,
    after_preamble, preamble,
};
pub use host::{
    FORBIDDEN_MAX, HostControl, HostPoll, HostState, JOIN_TIME_MAX, LINGER_MAX, OPENING_TIME_MAX, PACE_BYTES,
    SendError,
};
pub use host_session::{Admitted, HostEvent, HostFacts, HostSession, SceneOffer};
pub use keep_alive::{ClockSample, KeepAlive, PING_EVERY, Ping, Pong, SILENCE_MAX};
pub use manifest::{CountsDiffer, HeldScene, SCENE_BYTES_MAX, SceneCounts, SceneKind, SceneManifest};
pub use message::{
    Architecture, Carried, ClientMessage, DELTA_MAX, HandInfo, Hello, HostMessage, LinkFigures,
    PEER_TICKET_MAX, Request, RequestKind, SCENARIO_TEXT_MAX, SCENE_PART_MAX, SESSION_HANDS_MAX,
    STATION_HANDS_MAX, STATIONS_MAX, SessionInfo, StationInfo, Welcome, Wish,
};
pub use message_error::MessageError;
pub use note::{Note, NoteKind, NoteRefusal, STROKE_PLACES_MAX, TakeOver};
pub use outbox::{Outbox, OutboxError, STALLED_MAX, WAITING_MAX};
pub use plain_text::{PlainText, TEXT_MAX};
pub use roster::{AWAY_TIME_MAX, Arrival, Roster};
pub use scene_assembly::SceneAssembly;
