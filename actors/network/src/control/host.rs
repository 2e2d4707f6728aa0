//! The host's end of the control channel: a state machine for one connection.
//!
//! ```text
//! Opening ──hello, let in──▶ Sending ──last part──▶ Awaiting ──joined, same digest──▶ Running
//!    └───────────────┴───────────────────┴───────────────┴──────error, goodbye──────▶ Ended
//! Opening ──diagnose, known ticket──▶ Diagnosing ──goodbye, or time over───────────────▶ Ended
//! ```
//!
//! Who is let in, what the scene is and who has which hand is decided by a [`HostSession`]. The machine sees to it that
//! nothing is asked of the session before the credential was checked, that no token is spent on a station which could not
//! join anyway, and that no station does what its role does not allow.

use std::sync::Arc;

use thiserror::Error;
use trocar_scene::SimTime;

use super::blob::Blob;
use super::diagnosis::EchoCounts;
use super::error::{ControlError, Goodbye, Refusal};
use super::frame::{FrameDecoder, OPENING_MAX};
use super::host_end::HostEnd;
use super::host_session::{Admitted, HostFacts, HostSession};
use super::message::{Carried, DELTA_MAX, HostMessage, PEER_TICKET_MAX, StationInfo, check_stations};
use super::message_error::MessageError;
use super::note::Note;
use super::outbox::STALLED_MAX;
use super::plain_text::PlainText;

/// Longest time from the connection to a complete hello. The caller bounds how many connections are so far at once.
pub const OPENING_TIME_MAX: SimTime = SimTime::from_millis(5_000);
/// Longest time from the welcome until the station has built the scene.
pub const JOIN_TIME_MAX: SimTime = SimTime::from_millis(120_000);
/// While less than this waits \[bytes\], the next part of the scene follows: pings and the roster wait behind no more.
pub const PACE_BYTES: usize = 64 << 10;
/// Longest time that the last words of an ended connection wait for the stream.
pub const LINGER_MAX: SimTime = SimTime::from_millis(2_000);
/// After so many requests that its role does not allow, a station is cut off.
pub const FORBIDDEN_MAX: u32 = 256;

/// Where a connection is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HostState {
    /// Nobody knows who it is.
    Opening,
    /// The station is let in and receives the scene.
    Sending,
    /// The station builds the scene.
    Awaiting,
    /// The station is in the session.
    Running,
    /// Somebody with a ticket looks whether datagrams pass, and is not in the session.
    Diagnosing,
    /// It is over.
    Ended,
}

/// Why a message is not sent to a station.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum SendError {
    /// The other side does not take it in this state.
    #[error("the connection is not so far, or over")]
    NotNow,
    /// It is beyond the limits.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The connection ended by it.
    #[error(transparent)]
    Ended(ControlError),
}

/// When a machine is to be asked again, and whether it still needs its stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostPoll {
    /// The latest time for the next [`HostControl::poll`]; it is also due after [`HostControl::advance`].
    pub deadline: SimTime,
    /// The connection is over, and its stream is to be closed.
    pub is_over: bool,
}

/// The host's end of one connection.
#[derive(Debug)]
pub struct HostControl {
    decoder: FrameDecoder,
    end: HostEnd,
}

impl HostControl {
    /// A connection that a station has just made.
    pub fn new(facts: Arc<HostFacts>, now: SimTime) -> Self {
        let end = HostEnd::new(facts, now);
        Self { decoder: FrameDecoder::new(OPENING_MAX), end }
    }

    /// Takes bytes of the stream, in any pieces.
    pub fn receive(&mut self, mut bytes: &[u8], now: SimTime, session: &mut dyn HostSession) {
        if self.end.state == HostState::Ended {
            return;
        }
        if !bytes.is_empty() {
            self.end.alive.hear(now);
        }
        while self.end.state != HostState::Ended {
            let handled = match self.decoder.next_frame(&mut bytes) {
                Ok(Some(frame)) => self.end.handle(frame, now, session),
                Ok(None) => return,
                Err(error) => Err(error.into()),
            };
            if let Err(error) = handled {
                self.end.finish(error, now);
            }
            if self.end.admitted.is_some() {
                self.decoder.trust();
            }
        }
    }

    /// Sends what is due, and ends what has lasted too long.
    pub fn poll(&mut self, now: SimTime) -> HostPoll {
        let end = &mut self.end;
        if end.state != HostState::Ended
            && let Err(error) = end.work(now)
        {
            end.finish(error, now);
        }
        if end.state == HostState::Ended {
            let is_over = end.outbox.is_empty() || end.until.is_none_or(|until| now >= until);
            return HostPoll { deadline: end.until.unwrap_or(now), is_over };
        }
        let has_pings = !matches!(end.state, HostState::Opening | HostState::Diagnosing);
        let pings = has_pings.then(|| end.alive.deadline());
        let deadlines = [end.until, end.outbox.stalls_at(), pings];
        let deadline = deadlines.into_iter().flatten().min().unwrap_or(now + STALLED_MAX);
        HostPoll { deadline, is_over: false }
    }

    /// Bytes for the stream.
    pub fn outgoing(&self) -> &[u8] {
        self.end.outbox.waiting()
    }

    /// The stream has taken so many of [`Self::outgoing`].
    pub fn advance(&mut self, count: usize, now: SimTime) {
        self.end.outbox.advance(count, now);
    }

    /// The stream closed or failed.
    pub fn broke(&mut self, why: &str, now: SimTime) {
        self.end.outbox.clear();
        self.end.finish(ControlError::Broke(PlainText::new(why)), now);
    }

    /// Ends the connection with a word to the station.
    pub fn dismiss(&mut self, goodbye: Goodbye, now: SimTime) {
        self.end.finish(ControlError::Ended(goodbye), now);
    }

    /// Sends a message of the replication, at most [`DELTA_MAX`] bytes.
    ///
    /// # Errors
    /// [`SendError`]; [`SendError::NotNow`] before the station has joined: what changes until then follows afterwards.
    pub fn send_delta(&mut self, bytes: &[u8], now: SimTime) -> Result<(), SendError> {
        MessageError::limit("bytes of changes", bytes.len(), DELTA_MAX)?;
        self.end.send(HostState::Running, &HostMessage::Delta(Blob::from(bytes)), now)
    }

    /// Tells who is there.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_roster(&mut self, stations: Vec<StationInfo>, now: SimTime) -> Result<(), SendError> {
        check_stations(&stations)?;
        self.end.send(HostState::Sending, &HostMessage::Roster(stations), now)
    }

    /// Tells who serves a hand from now on.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_hand_served(
        &mut self,
        hand: u8,
        station: Option<u16>,
        now: SimTime,
    ) -> Result<(), SendError> {
        self.end.send(HostState::Sending, &HostMessage::HandServed { hand, station, at: now }, now)
    }

    /// Passes on what a station shows.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_note(&mut self, note: Note, now: SimTime) -> Result<(), SendError> {
        note.what.check()?;
        self.end.send(HostState::Running, &HostMessage::Note(note), now)
    }

    /// Tells the station that something it has shown, which was accepted at first, cannot be shown.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_refusal(&mut self, refusal: Refusal, now: SimTime) -> Result<(), SendError> {
        let answer = HostMessage::Answer { request: None, refusal: Some(refusal) };
        self.end.send(HostState::Running, &answer, now)
    }

    /// Passes on a ticket of the station `from`.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_peer_ticket(&mut self, from: u16, ticket: Vec<u8>, now: SimTime) -> Result<(), SendError> {
        MessageError::limit("bytes of a ticket", ticket.len(), PEER_TICKET_MAX)?;
        self.end.send(HostState::Running, &HostMessage::PeerTicket { from, ticket }, now)
    }

    /// Tells that the session is paused, or goes on.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_paused(&mut self, is_paused: bool, now: SimTime) -> Result<(), SendError> {
        self.end.send(HostState::Running, &HostMessage::Paused(is_paused), now)
    }

    /// Sends the rows of a body that the station asked for, at most [`DELTA_MAX`] bytes.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_repair(&mut self, bytes: &[u8], now: SimTime) -> Result<(), SendError> {
        MessageError::limit("bytes of a repair", bytes.len(), DELTA_MAX)?;
        self.end.send(HostState::Running, &HostMessage::Repair(Blob::from(bytes)), now)
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

    /// Tells who diagnoses the path what has come of its datagrams.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn send_echoed(&mut self, counts: EchoCounts, now: SimTime) -> Result<(), SendError> {
        self.end.send(HostState::Diagnosing, &HostMessage::Echoed(counts), now)
    }

    /// Number of the connection whose datagrams are echoed, for who diagnoses the path; also after the end.
    pub fn diagnosed(&self) -> Option<u32> {
        self.end.diagnosed
    }

    /// Asks the station to use the keys of the next phase, and returns its number. Only when it uses those of the present
    /// one, [`HostEvent::Rekeyed`](super::HostEvent::Rekeyed).
    ///
    /// # Errors
    /// [`SendError`].
    pub fn rekey(&mut self, now: SimTime) -> Result<u32, SendError> {
        let phase = self.end.phase.checked_add(1).ok_or(SendError::NotNow)?;
        if self.end.phase_in_use != self.end.phase {
            return Err(SendError::NotNow);
        }
        self.end.send(HostState::Running, &HostMessage::Rekey { phase }, now)?;
        self.end.phase = phase;
        Ok(phase)
    }

    /// Where the connection is.
    pub fn state(&self) -> HostState {
        self.end.state
    }

    /// The station, once it was let in; also after the end, so that the session can be told who is away.
    pub fn admitted(&self) -> Option<&Admitted> {
        self.end.admitted.as_ref()
    }

    /// Why the connection ended.
    pub fn error(&self) -> Option<&ControlError> {
        self.end.error.as_ref()
    }

    /// Newest round trip of a ping.
    pub fn round_trip(&self) -> Option<SimTime> {
        self.end.alive.round_trip()
    }
}
