//! A station's end of the control channel: a state machine for as long as the station is in the session, over as many
//! connections as that takes.
//!
//! ```text
//! Away ──time to try──▶ Connecting ──stream──▶ Opening ──welcome──▶ Loading ──last part──▶ Building ──built──▶ Running
//!  ▲                        │                     │                    │                      │                  │
//!  └────────the link broke──┴─────────────────────┴────────────────────┴──────────────────────┴──────────────────┤
//!                                                               refused, goodbye, not the host's scene, away too long
//!                                                                                                                ▼
//!                                                                                                              Ended
//! ```
//!
//! After a break the station tries again, with growing pauses, and shows what it still has of the scene; the host sends what
//! it missed. The first time it shows its ticket, and goes on doing so until it was welcomed: a token that is spent because
//! an answer was lost still lets in, together with the secret that was shown with it.

use trocar_scene::{Revision, SimTime};

use super::blob::Blob;
use super::client_end::ClientEnd;
use super::component_list::ComponentList;
use super::credential::Credential;
use super::error::{ControlError, Goodbye, Refusal};
use super::frame::{FRAME_MAX, FrameDecoder};
use super::host::SendError;
use super::keep_alive::ClockSample;
use super::manifest::{HeldScene, SceneCounts, SceneManifest};
use super::message::{
    Carried, ClientMessage, DELTA_MAX, PEER_TICKET_MAX, Request, RequestKind, StationInfo, Welcome, Wish,
};
use super::message_error::MessageError;
use super::note::Note;
use super::plain_text::PlainText;
use crate::peers::repair;

/// Longest time for a connection with its TLS handshake.
pub const CONNECT_TIME_MAX: SimTime = SimTime::from_millis(10_000);
/// Longest time from the hello to the answer.
pub const ANSWER_TIME_MAX: SimTime = SimTime::from_millis(10_000);
/// Longest time from the welcome until the station has built the scene: as long as the host waits.
pub const BUILD_TIME_MAX: SimTime = super::host::JOIN_TIME_MAX;
/// How long a station that was there tries to come back: as long as the host keeps its hands for it.
pub const AWAY_TIME_MAX: SimTime = super::roster::AWAY_TIME_MAX;
/// How long a station tries that never was there.
pub const FIRST_TIME_MAX: SimTime = SimTime::from_millis(15_000);
/// Pause before the first try after a break.
pub const PAUSE_FIRST: SimTime = SimTime::from_millis(50);
/// Longest pause between two tries; each is twice the one before.
pub const PAUSE_MAX: SimTime = SimTime::from_millis(2_000);
/// After so many breaks between the welcome and the built scene, the station gives up.
pub const BROKEN_JOINS_MAX: u32 = 10;

/// What a station is, for its hello.
#[derive(Clone, Debug)]
pub struct ClientFacts {
    /// Version of the program, for people.
    pub program: PlainText,
    /// The components of the station's program.
    pub components: ComponentList,
    /// BLAKE3 of the station's own scenario, if it has one.
    pub scenario: Option<[u8; 32]>,
    /// What the station wants to be.
    pub wish: Wish,
}

/// What the host does and tells.
#[derive(Debug)]
pub enum ClientEvent<'a> {
    /// The station is let in, for the first time or again. Its keys and datagrams are of a new connection.
    Welcomed(&'a Welcome),
    /// The scene has arrived as announced. The station builds it and calls [`ClientControl::scene_built`].
    Scene(&'a SceneManifest, Vec<u8>),
    /// Changes of the scene, in order.
    Delta(&'a [u8]),
    /// Who is there.
    Roster(Vec<StationInfo>),
    /// Another station serves a hand, or none.
    HandServed {
        /// Number of the hand.
        hand: u8,
        /// Who serves it.
        station: Option<u16>,
        /// Since when, by the host's session clock.
        at: SimTime,
    },
    /// A station shows something.
    Note(Note),
    /// The rows of a body that the station asked for.
    Repair(&'a [u8]),
    /// The host has paused the session, or it goes on.
    Paused(bool),
    /// Another station's ticket, with which this one can connect to it.
    PeerTicket {
        /// Who gives it.
        from: u16,
        /// The ticket.
        ticket: Vec<u8>,
    },
    /// Answer to a request of that number, or to a write that is refused.
    Answer {
        /// Number of the request.
        request: Option<u32>,
        /// Why it is not done, if so.
        refusal: Option<Refusal>,
    },
    /// A ping came back.
    Clock(ClockSample),
    /// What the host's hands link has to tell, and a datagram unless it is empty.
    Carried {
        /// Whether the host hears the station's datagrams by themselves.
        hears: bool,
        /// How many carried datagrams of hands it has taken.
        taken: u32,
        /// The sealed datagram.
        datagram: &'a [u8],
    },
    /// The keys of this phase are to be used; the station then calls [`ClientControl::rekeyed`].
    Rekey(u32),
}

/// Where a station is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClientState {
    /// It has no connection and waits for the next try.
    Away,
    /// The driver connects.
    Connecting,
    /// It has said hello.
    Opening,
    /// It receives the scene.
    Loading,
    /// It builds the scene.
    Building,
    /// It is in the session.
    Running,
    /// It is over.
    Ended,
}

/// What the driver is to do about the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StreamWish {
    /// Close it, if there is one.
    None,
    /// Close it, if there is one, and connect anew. This is told once for each try; [`ClientControl::connected`] or
    /// [`ClientControl::broke`] answers it.
    Connect,
    /// Keep it.
    Keep,
    /// Close it: all is over.
    Over,
}

/// When the machine is to be asked again, and what is to be done about the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClientPoll {
    /// The latest time for the next [`ClientControl::poll`].
    pub deadline: SimTime,
    /// What is to be done about the stream.
    pub stream: StreamWish,
}

/// A station's end of the control channel.
#[derive(Debug)]
pub struct ClientControl {
    decoder: FrameDecoder,
    end: ClientEnd,
}

impl ClientControl {
    /// A station that wants to be in a session.
    pub fn new(facts: ClientFacts, credential: Credential, now: SimTime) -> Self {
        let end = ClientEnd::new(facts, credential, now);
        Self { decoder: FrameDecoder::new(FRAME_MAX), end }
    }

    /// The stream is there, authenticated; `held` is what the station still has of the scene after a break.
    ///
    /// # Errors
    /// [`SendError::NotNow`] if the machine did not ask for a stream, [`SendError::Message`] if the wish has too many
    /// hands.
    pub fn connected(&mut self, held: Option<HeldScene>, now: SimTime) -> Result<(), SendError> {
        if self.end.state != ClientState::Connecting {
            return Err(SendError::NotNow);
        }
        self.decoder = FrameDecoder::new(FRAME_MAX);
        self.end.say_hello(held, now)
    }

    /// The stream closed or failed, or there was no connection.
    pub fn broke(&mut self, why: &str, now: SimTime) {
        if !matches!(self.end.state, ClientState::Away | ClientState::Ended) {
            self.end.fail(ControlError::Broke(PlainText::new(why)), now);
        }
        // The stream that would have taken the last words is gone.
        self.end.outbox.clear();
    }

    /// Takes bytes of the stream, in any pieces.
    pub fn receive(&mut self, mut bytes: &[u8], now: SimTime, hear: &mut dyn FnMut(ClientEvent<'_>)) {
        if !bytes.is_empty() {
            self.end.alive.hear(now);
        }
        while self.end.has_stream() {
            let handled = match self.decoder.next_frame(&mut bytes) {
                Ok(Some(frame)) => self.end.handle(frame, now, hear),
                Ok(None) => return,
                Err(error) => Err(error.into()),
            };
            if let Err(error) = handled {
                self.end.fail(error, now);
            }
        }
    }

    /// Sends what is due, tries again when it is time, and gives up what has lasted too long.
    pub fn poll(&mut self, now: SimTime) -> ClientPoll {
        let end = &mut self.end;
        if end.has_stream()
            && let Err(error) = end.work(now)
        {
            end.fail(error, now);
        }
        match end.state {
            ClientState::Away if end.until.is_none_or(|until| now >= until) => {
                end.state = ClientState::Connecting;
                let deadline = (now + CONNECT_TIME_MAX).min(end.gives_up_at());
                end.until = Some(deadline);
                ClientPoll { deadline, stream: StreamWish::Connect }
            }
            ClientState::Connecting if end.until.is_some_and(|until| now >= until) => {
                end.fail(ControlError::Broke(PlainText::new("no answer to the connection")), now);
                let stream =
                    if end.state == ClientState::Ended { StreamWish::Over } else { StreamWish::None };
                ClientPoll { deadline: end.until.unwrap_or(now), stream }
            }
            ClientState::Away => ClientPoll { deadline: end.until.unwrap_or(now), stream: StreamWish::None },
            ClientState::Connecting => {
                ClientPoll { deadline: end.until.unwrap_or(now), stream: StreamWish::Keep }
            }
            ClientState::Ended => {
                let is_over = end.outbox.is_empty() || end.until.is_none_or(|until| now >= until);
                let stream = if is_over { StreamWish::Over } else { StreamWish::Keep };
                ClientPoll { deadline: end.until.unwrap_or(now), stream }
            }
            _ => {
                let pings = (end.state != ClientState::Opening).then(|| end.alive.deadline());
                let deadlines = [end.until, end.outbox.stalls_at(), pings];
                let deadline = deadlines.into_iter().flatten().min().unwrap_or(now);
                ClientPoll { deadline, stream: StreamWish::Keep }
            }
        }
    }

    /// Bytes for the stream.
    pub fn outgoing(&self) -> &[u8] {
        self.end.outbox.waiting()
    }

    /// The stream has taken so many of [`Self::outgoing`].
    pub fn advance(&mut self, count: usize, now: SimTime) {
        self.end.outbox.advance(count, now);
    }

    /// The station has built the scene of this revision: what is in it, and its digest. Nothing happens if it is not the
    /// one that is being built, because the connection broke meanwhile.
    pub fn scene_built(&mut self, revision: Revision, counts: &SceneCounts, digest: [u8; 32], now: SimTime) {
        if let Some(manifest) = self.end.building.take_if(|manifest| manifest.revision == revision)
            && let Err(error) = self.end.join(&manifest, counts, digest, now)
        {
            self.end.fail(error, now);
        }
    }

    /// The station cannot build the scene of this revision.
    pub fn scene_failed(&mut self, revision: Revision, why: &str, now: SimTime) {
        if self.end.building.take_if(|manifest| manifest.revision == revision).is_some() {
            self.end.fail(ControlError::SceneInvalid(PlainText::new(why)), now);
        }
    }

    /// Asks the host for something, and returns the number that its answer names.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn request(&mut self, what: RequestKind, now: SimTime) -> Result<u32, SendError> {
        match &what {
            RequestKind::Note(note) => note.check()?,
            RequestKind::PeerTicket { ticket, .. } => {
                MessageError::limit("bytes of a ticket", ticket.len(), PEER_TICKET_MAX)?;
            }
            RequestKind::Repair(asked) => {
                MessageError::limit("rows of a body", asked.rows.len(), repair::ROWS_MAX)?;
            }
            RequestKind::TakeHand(_) | RequestKind::GiveHand(_) => {}
        }
        let number = self.end.next_request;
        self.end.send(&ClientMessage::Request(Request { number, what }), now)?;
        self.end.next_request = number.wrapping_add(1);
        Ok(number)
    }

    /// Sends rows that the station owns, at most [`DELTA_MAX`] bytes.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn write(&mut self, bytes: &[u8], now: SimTime) -> Result<(), SendError> {
        MessageError::limit("bytes of rows", bytes.len(), DELTA_MAX)?;
        self.end.send(&ClientMessage::Write(Blob::from(bytes)), now)
    }

    /// Sends what the hands link has to tell; urgently, if it is about hands: then it returns false while an earlier one waits.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_carried(
        &mut self,
        carried: Carried<'_>,
        is_urgent: bool,
        now: SimTime,
    ) -> Result<bool, SendError> {
        self.end.send_carried(carried, is_urgent, now)
    }

    /// Whether an urgent message waits of which nothing has gone.
    pub fn has_urgent(&self) -> bool {
        self.end.outbox.has_urgent()
    }

    /// The station uses the keys that [`ClientEvent::Rekey`] asked for.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn rekeyed(&mut self, now: SimTime) -> Result<(), SendError> {
        let phase = self.end.phase;
        self.end.send(&ClientMessage::Rekeyed { phase }, now)
    }

    /// Leaves the session.
    pub fn leave(&mut self, now: SimTime) {
        self.end.finish(ControlError::Ended(Goodbye::Leaves), now);
    }

    /// Where the station is.
    pub fn state(&self) -> ClientState {
        self.end.state
    }

    /// The newest welcome, with who serves which hand now.
    pub fn welcome(&self) -> Option<&Welcome> {
        self.end.welcomed.as_ref()
    }

    /// How much of the scene has arrived, of how many bytes.
    pub fn progress(&self) -> Option<(u32, u32)> {
        self.end.scene.as_ref().map(|scene| (scene.arrived(), scene.manifest().bytes))
    }

    /// Why the station is away, or why all is over.
    pub fn error(&self) -> Option<&ControlError> {
        self.end.error.as_ref()
    }

    /// Newest round trip of a ping.
    pub fn round_trip(&self) -> Option<SimTime> {
        self.end.alive.round_trip()
    }
}
