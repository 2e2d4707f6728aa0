//! What a host does with the frames of one connection, and with the time that passes.

use std::sync::Arc;

use trocar_scene::{Revision, SimTime};

use super::blob::Blob;
use super::component_list::ComponentDifference;
use super::credential::Credential;
use super::diagnosis::{DIAGNOSIS_TIME_MAX, Diagnose};
use super::error::{ControlError, Goodbye, Refusal};
use super::frame::{FrameError, after_preamble};
use super::host::{
    FORBIDDEN_MAX, HostState, JOIN_TIME_MAX, LINGER_MAX, OPENING_TIME_MAX, PACE_BYTES, SendError,
};
use super::host_session::{Admitted, HostEvent, HostFacts, HostSession, SceneOffer};
use super::keep_alive::KeepAlive;
use super::keep_alive::Pong;
use super::message::{Carried, ClientMessage, Hello, HostMessage, Request, SCENE_PART_MAX, Welcome};
use super::message_error::MessageError;
use super::outbox::{Outbox, OutboxError, STALLED_MAX};
use super::plain_text::PlainText;
use crate::ticket::Refused;

/// All but the decoder, whose frames are borrowed while they are handled.
#[derive(Debug)]
pub(super) struct HostEnd {
    facts: Arc<HostFacts>,
    pub(super) outbox: Outbox,
    pub(super) state: HostState,
    /// By when the present state has to be over, if it must.
    pub(super) until: Option<SimTime>,
    pub(super) admitted: Option<Admitted>,
    /// Number of the connection of a diagnosis.
    pub(super) diagnosed: Option<u32>,
    pub(super) alive: KeepAlive,
    scene: Option<SceneOnItsWay>,
    forbidden: u32,
    pub(super) phase: u32,
    pub(super) phase_in_use: u32,
    pub(super) error: Option<ControlError>,
}

#[derive(Debug)]
struct SceneOnItsWay {
    bytes: Arc<[u8]>,
    sent: usize,
    revision: Revision,
    digest: [u8; 32],
}

impl HostEnd {
    pub(super) fn new(facts: Arc<HostFacts>, now: SimTime) -> Self {
        Self {
            facts,
            outbox: Outbox::default(),
            state: HostState::Opening,
            until: Some(now + OPENING_TIME_MAX),
            admitted: None,
            diagnosed: None,
            alive: KeepAlive::new(now),
            scene: None,
            forbidden: 0,
            phase: 0,
            phase_in_use: 0,
            error: None,
        }
    }

    pub(super) fn handle(
        &mut self,
        frame: &[u8],
        now: SimTime,
        session: &mut dyn HostSession,
    ) -> Result<(), ControlError> {
        if self.state == HostState::Opening {
            return self.open(frame, now, session);
        }
        if self.state == HostState::Diagnosing {
            return Err(match ClientMessage::decode(frame)? {
                ClientMessage::Goodbye(goodbye) => ControlError::Goodbye(goodbye),
                other => ControlError::Unexpected { message: other.name(), state: "within a diagnosis" },
            });
        }
        let admitted =
            self.admitted.ok_or(ControlError::Unexpected { message: "frame", state: "without a hello" })?;
        let message = ClientMessage::decode(frame)?;
        let (state, name) = (self.state, message.name());
        let at = match state {
            HostState::Sending => "before the station has all of the scene",
            HostState::Awaiting => "before the station has built the scene",
            _ => "within a running session",
        };
        match message {
            ClientMessage::Ping(ping) => {
                let pong = Pong { ping_sent_at: ping.sent_at, received_at: now, sent_at: now };
                self.push(&HostMessage::Pong(pong), now)
            }
            ClientMessage::Pong(pong) => {
                if let Some(sample) = self.alive.pong(pong, now) {
                    session.hear(admitted.station, HostEvent::Clock(sample));
                }
                Ok(())
            }
            ClientMessage::Goodbye(goodbye) => Err(ControlError::Goodbye(goodbye)),
            ClientMessage::Carried(Carried { hears, taken, datagram }) => {
                let datagram = datagram.as_slice();
                session.hear(admitted.station, HostEvent::Carried { hears, taken, datagram });
                Ok(())
            }
            ClientMessage::Joined { revision, digest } if state == HostState::Awaiting => {
                self.joined(revision, digest, admitted.station, session)
            }
            ClientMessage::Request(request) if state == HostState::Running => {
                self.request(&request, &admitted, now, session)
            }
            ClientMessage::Write(bytes) if state == HostState::Running => {
                if admitted.role.may_operate() {
                    session.hear(admitted.station, HostEvent::Write(bytes.as_slice()));
                    return Ok(());
                }
                self.forbid(None, "write to the scene", &admitted, now, session)
            }
            ClientMessage::Rekeyed { phase } if state == HostState::Running && phase == self.phase => {
                self.phase_in_use = phase;
                session.hear(admitted.station, HostEvent::Rekeyed(phase));
                Ok(())
            }
            _ => Err(ControlError::Unexpected { message: name, state: at }),
        }
    }

    fn open(
        &mut self,
        frame: &[u8],
        now: SimTime,
        session: &mut dyn HostSession,
    ) -> Result<(), ControlError> {
        let body = after_preamble(frame).inspect_err(|error| {
            if matches!(error, FrameError::OtherVersion { .. }) {
                self.outbox.push_bare_opening(now);
            }
        })?;
        let hello = match ClientMessage::decode(body)? {
            ClientMessage::Hello(hello) => hello,
            ClientMessage::Diagnose(diagnose) => return self.diagnose(&diagnose, now, session),
            other => return Err(ControlError::Unexpected { message: other.name(), state: "before a hello" }),
        };
        match self.let_in(&hello, now, session) {
            Ok((admitted, offer)) => self.welcome(admitted, offer, now),
            Err(refusal) => {
                self.push_opening(&HostMessage::Refused(refusal.clone()), now)?;
                Err(ControlError::Refused { refusal, difference: ComponentDifference::default() })
            }
        }
    }

    /// Answers who has a ticket and wants to know whether the path carries what a station needs. The token is not spent.
    fn diagnose(
        &mut self,
        diagnose: &Diagnose,
        now: SimTime,
        session: &mut dyn HostSession,
    ) -> Result<(), ControlError> {
        match session.diagnose(&diagnose.credential) {
            Ok(diagnosed) => {
                self.push_opening(&HostMessage::Diagnosed(diagnosed), now)?;
                self.diagnosed = Some(diagnosed.connection);
                self.state = HostState::Diagnosing;
                self.until = Some(now + DIAGNOSIS_TIME_MAX);
                Ok(())
            }
            Err(refusal) => {
                self.push_opening(&HostMessage::Refused(refusal.clone()), now)?;
                Err(ControlError::Refused { refusal, difference: ComponentDifference::default() })
            }
        }
    }

    /// Everything that speaks against the station is found before its token is spent; and nothing but the ticket is
    /// looked at before that is known to be good.
    fn let_in(
        &mut self,
        hello: &Hello,
        now: SimTime,
        session: &mut dyn HostSession,
    ) -> Result<(Admitted, SceneOffer), Refusal> {
        let (credential, granted) =
            known(&hello.credential, |credential| session.check(credential, &hello.wish))?;
        let facts = &self.facts;
        if hello.components != facts.components_digest {
            return Err(Refusal::OtherRegistry(facts.components.clone()));
        }
        if hello.scenario.is_some_and(|scenario| scenario != facts.scenario) {
            return Err(Refusal::ScenarioDiffers { name: facts.scenario_name.clone() });
        }
        let role = hello.wish.role.unwrap_or(granted);
        if role > granted {
            return Err(Refusal::RoleTooHigh { granted, wished: role });
        }
        if !role.may_operate() && !hello.wish.hands.is_empty() {
            return Err(Refusal::not_allowed(role, "serve a hand"));
        }
        let admitted = session.admit(&credential, &hello.wish, role, now)?;
        // From here on the session has the station, also if the scene cannot be offered.
        self.admitted = Some(admitted);
        let offer = session.offer(&admitted, hello.held)?;
        let trouble = |error: MessageError| Refusal::HostTrouble(PlainText::new(error.to_string()));
        offer.session.check().map_err(trouble)?;
        offer.manifest.check().map_err(trouble)?;
        if offer.scene.len() != offer.manifest.bytes as usize {
            return Err(Refusal::HostTrouble(PlainText::new("its scene is not as long as it announced")));
        }
        Ok((admitted, offer))
    }

    fn welcome(&mut self, admitted: Admitted, offer: SceneOffer, now: SimTime) -> Result<(), ControlError> {
        let SceneOffer { session, host_unix_secs, manifest, scene: bytes } = offer;
        let (revision, digest) = (manifest.revision, manifest.digest);
        let Admitted { station, connection, role } = admitted;
        let welcome =
            Welcome { station, connection, role, host_time: now, host_unix_secs, session, manifest };
        self.push_opening(&HostMessage::Welcome(Box::new(welcome)), now)?;
        self.scene = Some(SceneOnItsWay { bytes, sent: 0, revision, digest });
        self.state = HostState::Sending;
        self.until = Some(now + JOIN_TIME_MAX);
        self.alive = KeepAlive::new(now);
        Ok(())
    }

    fn joined(
        &mut self,
        revision: Revision,
        digest: [u8; 32],
        station: u16,
        session: &mut dyn HostSession,
    ) -> Result<(), ControlError> {
        let is_same =
            self.scene.take().is_some_and(|scene| scene.revision == revision && scene.digest == digest);
        if !is_same {
            return Err(ControlError::SceneDigest { revision: revision.0 });
        }
        self.state = HostState::Running;
        self.until = None;
        session.hear(station, HostEvent::Joined(revision));
        Ok(())
    }

    fn request(
        &mut self,
        request: &Request,
        admitted: &Admitted,
        now: SimTime,
        session: &mut dyn HostSession,
    ) -> Result<(), ControlError> {
        if !request.what.is_allowed_to(admitted.role) {
            return self.forbid(Some(request.number), request.what.name(), admitted, now, session);
        }
        let refusal = session.request(admitted.station, &request.what, now).err();
        self.push(&HostMessage::Answer { request: Some(request.number), refusal }, now)
    }

    fn forbid(
        &mut self,
        request: Option<u32>,
        deed: &str,
        admitted: &Admitted,
        now: SimTime,
        session: &mut dyn HostSession,
    ) -> Result<(), ControlError> {
        let refusal = Refusal::not_allowed(admitted.role, deed);
        session.hear(admitted.station, HostEvent::Forbidden(refusal.clone()));
        self.forbidden += 1;
        if self.forbidden > FORBIDDEN_MAX {
            return Err(ControlError::TooManyRefusals(self.forbidden));
        }
        self.push(&HostMessage::Answer { request, refusal: Some(refusal) }, now)
    }

    /// What time brings.
    pub(super) fn work(&mut self, now: SimTime) -> Result<(), ControlError> {
        if self.until.is_some_and(|until| now >= until) {
            return Err(match self.state {
                HostState::Opening => ControlError::SlowOpening(OPENING_TIME_MAX),
                HostState::Diagnosing => {
                    let text = format!("a diagnosis takes at most {DIAGNOSIS_TIME_MAX}");
                    ControlError::Ended(Goodbye::TooSlow(PlainText::new(text)))
                }
                _ => ControlError::SlowJoin(JOIN_TIME_MAX),
            });
        }
        if matches!(self.state, HostState::Opening | HostState::Diagnosing) {
            return Ok(());
        }
        if self.alive.is_silent(now) {
            return Err(ControlError::Silent);
        }
        if self.outbox.stalls_at().is_some_and(|at| now >= at) {
            return Err(ControlError::Stalled(STALLED_MAX));
        }
        if let Some(ping) = self.alive.ping(now) {
            self.push(&HostMessage::Ping(ping), now)?;
        }
        self.pace_scene(now)
    }

    fn pace_scene(&mut self, now: SimTime) -> Result<(), ControlError> {
        while self.state == HostState::Sending && self.outbox.waiting().len() < PACE_BYTES {
            let Some(scene) = self.scene.as_mut() else { break };
            let end = scene.bytes.len().min(scene.sent + SCENE_PART_MAX);
            let (bytes, begin) = (Arc::clone(&scene.bytes), scene.sent);
            scene.sent = end;
            if end == bytes.len() {
                self.state = HostState::Awaiting;
            }
            if begin < end {
                let part =
                    HostMessage::ScenePart { offset: begin as u32, bytes: Blob::from(&bytes[begin..end]) };
                self.push(&part, now)?;
            }
        }
        Ok(())
    }

    /// Sends a message of the caller once the connection is in the state `from`, or later.
    pub(super) fn send(
        &mut self,
        from: HostState,
        message: &HostMessage<'_>,
        now: SimTime,
    ) -> Result<(), SendError> {
        let is_so_far = match self.state {
            HostState::Opening | HostState::Ended => false,
            HostState::Diagnosing => from == HostState::Diagnosing,
            HostState::Sending | HostState::Awaiting => from == HostState::Sending,
            HostState::Running => from != HostState::Diagnosing,
        };
        if !is_so_far {
            return Err(SendError::NotNow);
        }
        self.push(message, now).map_err(|error| {
            self.finish(error.clone(), now);
            SendError::Ended(error)
        })
    }

    pub(super) fn send_carried(
        &mut self,
        carried: Carried<'_>,
        is_urgent: bool,
        now: SimTime,
    ) -> Result<bool, SendError> {
        let message = HostMessage::Carried(carried);
        if !is_urgent {
            return self.send(HostState::Running, &message, now).map(|()| true);
        }
        if self.state != HostState::Running {
            return Err(SendError::NotNow);
        }
        self.outbox.push_urgent(&message, now).map_err(|error| {
            let error = outbox_error(error);
            self.finish(error.clone(), now);
            SendError::Ended(error)
        })
    }

    fn push(&mut self, message: &HostMessage<'_>, now: SimTime) -> Result<(), ControlError> {
        self.outbox.push(message, false, now).map_err(outbox_error)
    }

    fn push_opening(&mut self, message: &HostMessage<'_>, now: SimTime) -> Result<(), ControlError> {
        self.outbox.push(message, true, now).map_err(outbox_error)
    }

    pub(super) fn finish(&mut self, error: ControlError, now: SimTime) {
        if self.state == HostState::Ended {
            return;
        }
        // A stranger is told nothing but why its hello is refused.
        let farewell = error.farewell().filter(|_| self.state != HostState::Opening);
        if let Some(goodbye) = farewell {
            // In a running session nobody needs the changes that wait; before that, the welcome may be among them.
            if self.state == HostState::Running {
                self.outbox.drop_waiting();
            }
            // The outbox has room; if it had not, the station would learn the end from the closed stream.
            let _ = self.outbox.push(&HostMessage::Goodbye(goodbye), false, now);
        }
        self.state = HostState::Ended;
        self.until = Some(now + LINGER_MAX);
        self.scene = None;
        self.error = Some(error);
    }
}

pub(super) fn outbox_error(error: OutboxError) -> ControlError {
    match error {
        OutboxError::Full { .. } => ControlError::TooSlow(error),
        OutboxError::TooLong(_) | OutboxError::Encoding(_) => ControlError::Unsendable(error),
    }
}

/// Asks by the credential that a station shows; and if its token is spent, by the secret that it showed with the token: then
/// it was itself who spent it, and the answer was lost.
fn known<R>(
    credential: &Credential,
    mut ask: impl FnMut(&Credential) -> Result<R, Refusal>,
) -> Result<(Credential, R), Refusal> {
    let refusal = match ask(credential) {
        Ok(answer) => return Ok((credential.clone(), answer)),
        Err(refusal) => refusal,
    };
    if matches!(refusal, Refusal::Ticket(Refused::Spent { .. }))
        && matches!(credential, Credential::Ticket { .. })
    {
        let again = credential.for_coming_back();
        if let Ok(answer) = ask(&again) {
            return Ok((again, answer));
        }
    }
    Err(refusal)
}
