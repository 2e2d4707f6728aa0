//! What a station does with the frames of its host, with breaks of the link, and with the time that passes.

use trocar_scene::SimTime;

use super::client::{
    ANSWER_TIME_MAX, AWAY_TIME_MAX, BROKEN_JOINS_MAX, BUILD_TIME_MAX, ClientEvent, ClientFacts, ClientState,
    FIRST_TIME_MAX, PAUSE_FIRST, PAUSE_MAX,
};
use super::component_list::ComponentDifference;
use super::credential::Credential;
use super::error::{ControlError, Refusal};
use super::frame::after_preamble;
use super::host::{LINGER_MAX, SendError};
use super::host_end::outbox_error;
use super::keep_alive::KeepAlive;
use super::keep_alive::Pong;
use super::manifest::{HeldScene, SceneCounts, SceneKind, SceneManifest};
use super::message::{Carried, ClientMessage, Hello, HostMessage, STATION_HANDS_MAX, Welcome, Wish};
use super::message_error::MessageError;
use super::outbox::{Outbox, STALLED_MAX};
use super::plain_text::PlainText;
use super::scene_assembly::SceneAssembly;

/// All but the decoder, whose frames are borrowed while they are handled.
#[derive(Debug)]
pub(super) struct ClientEnd {
    facts: ClientFacts,
    components_digest: [u8; 32],
    credential: Credential,
    pub(super) outbox: Outbox,
    pub(super) state: ClientState,
    /// By when the present state has to be over, or when the next try is due.
    pub(super) until: Option<SimTime>,
    /// Since when the station tries to come in.
    away_since: SimTime,
    pause: SimTime,
    /// Breaks before the scene was built, since the station was last in the session.
    broken_joins: u32,
    pub(super) welcomed: Option<Welcome>,
    held: Option<HeldScene>,
    pub(super) scene: Option<SceneAssembly>,
    pub(super) building: Option<SceneManifest>,
    pub(super) alive: KeepAlive,
    pub(super) next_request: u32,
    pub(super) phase: u32,
    /// Of the last break, or of the end.
    pub(super) error: Option<ControlError>,
}

impl ClientEnd {
    pub(super) fn new(facts: ClientFacts, credential: Credential, now: SimTime) -> Self {
        Self {
            components_digest: facts.components.digest(),
            facts,
            credential,
            outbox: Outbox::default(),
            state: ClientState::Away,
            until: Some(now),
            away_since: now,
            pause: PAUSE_FIRST,
            broken_joins: 0,
            welcomed: None,
            held: None,
            scene: None,
            building: None,
            alive: KeepAlive::new(now),
            next_request: 0,
            phase: 0,
            error: None,
        }
    }

    pub(super) fn has_stream(&self) -> bool {
        !matches!(self.state, ClientState::Away | ClientState::Connecting | ClientState::Ended)
    }

    /// What the station wants to be now: at first what it was told to, later what it was at the break.
    fn wish(&self) -> Wish {
        let Some(welcome) = &self.welcomed else { return self.facts.wish.clone() };
        let hands = welcome.session.hands.iter().filter(|hand| hand.station == Some(welcome.station));
        let hands = hands.map(|hand| hand.name.clone()).collect();
        Wish { hands, ..self.facts.wish.clone() }
    }

    /// Keeps who serves a hand.
    fn note_server(&mut self, number: u8, station: Option<u16>) {
        let hands = self.welcomed.iter_mut().flat_map(|welcome| &mut welcome.session.hands);
        for hand in hands.filter(|hand| hand.number == number) {
            hand.station = station;
        }
    }

    /// Somebody else took a hand while the station was away: it comes back without that hand.
    fn give_up_hand(&mut self, name: &str) {
        let hands = self.welcomed.iter_mut().flat_map(|welcome| &mut welcome.session.hands);
        for hand in hands.filter(|hand| hand.name.as_str() == name) {
            hand.station = None;
        }
    }

    /// When a station that is not in the session gives up.
    pub(super) fn gives_up_at(&self) -> SimTime {
        self.away_since + if self.welcomed.is_some() { AWAY_TIME_MAX } else { FIRST_TIME_MAX }
    }

    pub(super) fn say_hello(&mut self, held: Option<HeldScene>, now: SimTime) -> Result<(), SendError> {
        MessageError::limit("hands of a station", self.facts.wish.hands.len(), STATION_HANDS_MAX)?;
        self.outbox.clear();
        self.held = held;
        self.alive = KeepAlive::new(now);
        self.phase = 0;
        let hello = Hello {
            program: self.facts.program.clone(),
            components: self.components_digest,
            scenario: self.facts.scenario,
            credential: self.credential.clone(),
            wish: self.wish(),
            held,
        };
        let pushed = self.outbox.push(&ClientMessage::Hello(Box::new(hello)), true, now);
        pushed.map_err(|error| SendError::Ended(outbox_error(error)))?;
        self.state = ClientState::Opening;
        self.until = Some((now + ANSWER_TIME_MAX).min(self.gives_up_at()));
        Ok(())
    }

    pub(super) fn handle(
        &mut self,
        frame: &[u8],
        now: SimTime,
        hear: &mut dyn FnMut(ClientEvent<'_>),
    ) -> Result<(), ControlError> {
        if self.state == ClientState::Opening {
            let message = HostMessage::decode(after_preamble(frame)?)?;
            return self.answered(message, now, hear);
        }
        let message = HostMessage::decode(frame)?;
        let name = message.name();
        let state = match self.state {
            ClientState::Loading => "before all of the scene has arrived",
            ClientState::Building => "before the scene is built",
            _ => "within a running session",
        };
        match message {
            HostMessage::ScenePart { offset, bytes } if self.state == ClientState::Loading => {
                if let Some(scene) = &mut self.scene {
                    scene.take(offset, bytes.as_slice())?;
                }
                self.load(now, hear)?;
            }
            HostMessage::Delta(bytes) if self.state == ClientState::Running => {
                hear(ClientEvent::Delta(bytes.as_slice()));
            }
            HostMessage::Roster(stations) => hear(ClientEvent::Roster(stations)),
            HostMessage::HandServed { hand, station, at } => {
                self.note_server(hand, station);
                hear(ClientEvent::HandServed { hand, station, at });
            }
            HostMessage::Note(note) => hear(ClientEvent::Note(note)),
            HostMessage::Repair(bytes) => hear(ClientEvent::Repair(bytes.as_slice())),
            HostMessage::Paused(is_paused) => hear(ClientEvent::Paused(is_paused)),
            HostMessage::PeerTicket { from, ticket } => hear(ClientEvent::PeerTicket { from, ticket }),
            HostMessage::Answer { request, refusal } => hear(ClientEvent::Answer { request, refusal }),
            HostMessage::Ping(ping) => {
                let pong = Pong { ping_sent_at: ping.sent_at, received_at: now, sent_at: now };
                self.push(&ClientMessage::Pong(pong), now)?;
            }
            HostMessage::Pong(pong) => {
                if let Some(sample) = self.alive.pong(pong, now) {
                    hear(ClientEvent::Clock(sample));
                }
            }
            HostMessage::Rekey { phase }
                if self.state == ClientState::Running && Some(phase) == self.phase.checked_add(1) =>
            {
                self.phase = phase;
                hear(ClientEvent::Rekey(phase));
            }
            HostMessage::Goodbye(goodbye) => return Err(ControlError::Goodbye(goodbye)),
            HostMessage::Carried(Carried { hears, taken, datagram }) => {
                hear(ClientEvent::Carried { hears, taken, datagram: datagram.as_slice() });
            }
            _ => return Err(ControlError::Unexpected { message: name, state }),
        }
        Ok(())
    }

    /// The host has answered the hello.
    fn answered(
        &mut self,
        message: HostMessage<'_>,
        now: SimTime,
        hear: &mut dyn FnMut(ClientEvent<'_>),
    ) -> Result<(), ControlError> {
        let welcome = match message {
            HostMessage::Welcome(welcome) => *welcome,
            HostMessage::Refused(refusal) => {
                let difference = match &refusal {
                    Refusal::OtherRegistry(theirs) => self.facts.components.difference(theirs),
                    _ => ComponentDifference::default(),
                };
                if let Refusal::HandTaken { hand, .. } = &refusal {
                    self.give_up_hand(hand.as_str());
                }
                return Err(ControlError::Refused { refusal, difference });
            }
            other => {
                return Err(ControlError::Unexpected {
                    message: other.name(),
                    state: "as answer to a hello",
                });
            }
        };
        if let SceneKind::Missed { since } = welcome.manifest.kind
            && self.held.is_none_or(|held| held.revision != since)
        {
            let state = "with changes since a revision that the station does not hold";
            return Err(ControlError::Unexpected { message: "welcome", state });
        }
        hear(ClientEvent::Welcomed(&welcome));
        self.credential = self.credential.for_coming_back();
        self.scene = Some(SceneAssembly::new(welcome.manifest.clone()));
        self.welcomed = Some(welcome);
        self.state = ClientState::Loading;
        self.until = Some(now + BUILD_TIME_MAX);
        self.load(now, hear)
    }

    fn load(&mut self, now: SimTime, hear: &mut dyn FnMut(ClientEvent<'_>)) -> Result<(), ControlError> {
        let Some(scene) = self.scene.take_if(|scene| scene.is_complete()) else { return Ok(()) };
        let (manifest, bytes) = scene.finish()?;
        self.state = ClientState::Building;
        self.until = Some(now + BUILD_TIME_MAX);
        hear(ClientEvent::Scene(&manifest, bytes));
        self.building = Some(manifest);
        Ok(())
    }

    pub(super) fn join(
        &mut self,
        manifest: &SceneManifest,
        counts: &SceneCounts,
        digest: [u8; 32],
        now: SimTime,
    ) -> Result<(), ControlError> {
        manifest.counts.compare(counts).map_err(ControlError::SceneCounts)?;
        let revision = manifest.revision;
        if digest != manifest.digest {
            return Err(ControlError::SceneDigest { revision: revision.0 });
        }
        self.push(&ClientMessage::Joined { revision, digest }, now)?;
        self.state = ClientState::Running;
        self.until = None;
        self.pause = PAUSE_FIRST;
        self.broken_joins = 0;
        self.error = None;
        Ok(())
    }

    /// What time brings while there is a stream.
    pub(super) fn work(&mut self, now: SimTime) -> Result<(), ControlError> {
        if self.until.is_some_and(|until| now >= until) {
            return Err(match self.state {
                ClientState::Opening => ControlError::SlowOpening(ANSWER_TIME_MAX),
                _ => ControlError::SlowJoin(BUILD_TIME_MAX),
            });
        }
        // The answer to a hello has a limit of its own: the host may have to encode the scene first.
        if self.state != ClientState::Opening {
            if self.alive.is_silent(now) {
                return Err(ControlError::Silent);
            }
            if let Some(ping) = self.alive.ping(now) {
                self.push(&ClientMessage::Ping(ping), now)?;
            }
        }
        if self.outbox.stalls_at().is_some_and(|at| now >= at) {
            return Err(ControlError::Stalled(STALLED_MAX));
        }
        Ok(())
    }

    pub(super) fn send(&mut self, message: &ClientMessage<'_>, now: SimTime) -> Result<(), SendError> {
        if self.state != ClientState::Running {
            return Err(SendError::NotNow);
        }
        self.push(message, now).map_err(|error| {
            self.fail(error.clone(), now);
            SendError::Ended(error)
        })
    }

    pub(super) fn send_carried(
        &mut self,
        carried: Carried<'_>,
        is_urgent: bool,
        now: SimTime,
    ) -> Result<bool, SendError> {
        let message = ClientMessage::Carried(carried);
        if !is_urgent {
            return self.send(&message, now).map(|()| true);
        }
        if self.state != ClientState::Running {
            return Err(SendError::NotNow);
        }
        self.outbox.push_urgent(&message, now).map_err(|error| {
            let error = outbox_error(error);
            self.fail(error.clone(), now);
            SendError::Ended(error)
        })
    }

    fn push(&mut self, message: &ClientMessage<'_>, now: SimTime) -> Result<(), ControlError> {
        self.outbox.push(message, false, now).map_err(outbox_error)
    }

    /// Tries again if the link is to blame and there is time left; else all is over.
    pub(super) fn fail(&mut self, error: ControlError, now: SimTime) {
        let is_hand_gone = self.welcomed.is_some()
            && matches!(&error, ControlError::Refused { refusal: Refusal::HandTaken { .. }, .. });
        if !error.is_of_the_link() && !is_hand_gone {
            return self.finish(error, now);
        }
        if matches!(self.state, ClientState::Loading | ClientState::Building | ClientState::Running) {
            // The host was there a moment ago. A join that fails over and over is another matter.
            self.away_since = now;
            self.broken_joins += u32::from(self.state != ClientState::Running);
        }
        let next_try_at = now + self.pause;
        if next_try_at > self.gives_up_at() || self.broken_joins > BROKEN_JOINS_MAX {
            let tried = now.since(self.away_since);
            return self.finish(ControlError::Lost(tried, PlainText::new(error.to_string())), now);
        }
        self.pause = (self.pause + self.pause).min(PAUSE_MAX);
        self.outbox.clear();
        self.scene = None;
        self.building = None;
        self.state = ClientState::Away;
        self.until = Some(next_try_at);
        self.error = Some(error);
    }

    pub(super) fn finish(&mut self, error: ControlError, now: SimTime) {
        if self.state == ClientState::Ended {
            return;
        }
        let farewell = error.farewell().filter(|_| self.has_stream() && self.state != ClientState::Opening);
        if let Some(goodbye) = farewell {
            // A full outbox has no room for it; the host then learns the end from the closed stream.
            let _ = self.outbox.push(&ClientMessage::Goodbye(goodbye), false, now);
        } else {
            // A hello that has not gone out yet must not let in a station that is gone.
            self.outbox.clear();
        }
        self.scene = None;
        self.building = None;
        self.state = ClientState::Ended;
        self.until = Some(now + LINGER_MAX);
        self.error = Some(error);
    }
}
