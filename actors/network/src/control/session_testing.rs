//! Doubles for tests: a session in memory, and a host and a station whose streams carry any number of bytes at once.

use std::collections::BTreeMap;
use std::sync::Arc;

use trocar_scene::{Entity, Revision, SimTime};

use super::client::{ClientControl, ClientEvent, ClientFacts, ClientState, StreamWish};
use super::component_list::{ComponentList, ListedComponent};
use super::credential::Credential;
use super::diagnosis::{Diagnosed, TicketVerdict};
use super::error::{ControlError, Refusal};
use super::host::{HostControl, HostState};
use super::host_session::{Admitted, HostEvent, HostFacts, HostSession, SceneOffer};
use super::manifest::{HeldScene, SceneCounts, SceneKind, SceneManifest};
use super::message::{Architecture, HandInfo, RequestKind, SessionInfo, Wish};
use super::note::Note;
use super::plain_text::PlainText;
use super::roster::Roster;
use crate::ticket::{PlainName, Refused, ResumeSecret, Role, Token};

pub fn name(text: &str) -> PlainName {
    text.parse().expect("a name")
}

pub fn ms(millis: u64) -> SimTime {
    SimTime::from_millis(millis)
}

pub fn components() -> ComponentList {
    let listed = ["pose", "tissue"].map(|name| ListedComponent { name: PlainText::new(name), schema: 1 });
    ComponentList::new(listed.to_vec())
}

/// The ticket of a number, and the secret of the station that has it.
pub fn ticket(number: u8) -> Credential {
    Credential::Ticket {
        token: Token::from_bytes([number; 16]),
        resume: ResumeSecret::from_bytes([number; 32]),
    }
}

/// In this double a scene is as many entities as it has eight bytes, and a later revision only appends to it.
fn counts_of(scene: &[u8]) -> SceneCounts {
    let rows = BTreeMap::from([(PlainText::new("pose"), scene.len() as u32 / 8)]);
    SceneCounts { entities: scene.len() as u32 / 8, rows }
}

fn digest_of(scene: &[u8]) -> [u8; 32] {
    blake3::derive_key("trocar-network tests: digest of a scene", scene)
}

/// The session behind the connections.
pub struct TestSession {
    pub tickets: BTreeMap<u8, (Role, Option<Refused>)>,
    /// Stations by their resume secret.
    pub known: BTreeMap<u8, (u16, Role)>,
    pub roster: Roster,
    pub scene: Vec<u8>,
    /// Length of the scene at each revision that the host still knows.
    pub revisions: BTreeMap<u64, usize>,
    pub heard: Vec<String>,
    pub written: Vec<u8>,
    pub redeemed: u32,
    pub tamper: fn(&mut SceneOffer),
}

impl TestSession {
    pub fn new(entities: usize) -> Self {
        let hand = |number: u8, text: &str| HandInfo {
            number,
            name: name(text),
            entity: Entity::new(0, 0, u32::from(number) + 1),
            station: None,
        };
        let roles = [(1, Role::Operate), (2, Role::Watch), (3, Role::Mentor)];
        Self {
            tickets: roles.map(|(number, role)| (number, (role, None))).into(),
            known: BTreeMap::new(),
            roster: Roster::new(vec![hand(0, "left"), hand(1, "right")]),
            scene: (0..entities as u64).flat_map(u64::to_le_bytes).collect(),
            revisions: BTreeMap::from([(1, 8 * entities)]),
            heard: Vec::new(),
            written: Vec::new(),
            redeemed: 0,
            tamper: |_| (),
        }
    }

    /// The scene gets more entities.
    pub fn grow(&mut self, entities: u64) {
        self.scene.extend((0..entities).flat_map(|number| (number ^ u64::MAX).to_le_bytes()));
        let revision = self.revisions.last_key_value().map_or(0, |(revision, _)| *revision) + 1;
        self.revisions.insert(revision, self.scene.len());
    }

    fn station(&self, credential: &Credential) -> Result<(Option<u16>, Role), Refusal> {
        match credential {
            Credential::Ticket { token, .. } => {
                let (role, refused) =
                    self.tickets.get(&token.as_bytes()[0]).ok_or(Refusal::Ticket(Refused::Unknown))?;
                refused.map_or(Ok((None, *role)), |refused| Err(Refusal::Ticket(refused)))
            }
            Credential::Resume { resume } => {
                let known = self.known.get(&resume.as_bytes()[0]);
                known.map(|(station, role)| (Some(*station), *role)).ok_or(Refusal::Ticket(Refused::Unknown))
            }
        }
    }
}

impl HostSession for TestSession {
    fn check(&mut self, credential: &Credential, wish: &Wish) -> Result<Role, Refusal> {
        let (station, role) = self.station(credential)?;
        self.roster.check(station, &wish.name, &wish.hands)?;
        Ok(role)
    }

    fn diagnose(&mut self, credential: &Credential) -> Result<Diagnosed, Refusal> {
        let ticket = match self.station(credential) {
            Ok((_, role)) => TicketVerdict::LetsIn(role),
            Err(Refusal::Ticket(Refused::Spent { at })) => TicketVerdict::Spent { at },
            Err(refusal) => return Err(refusal),
        };
        let connection = self.roster.next_connection();
        Ok(Diagnosed { connection, ticket, host_unix_secs: 7 })
    }

    fn admit(
        &mut self,
        credential: &Credential,
        wish: &Wish,
        role: Role,
        _: SimTime,
    ) -> Result<Admitted, Refusal> {
        let (station, granted) = self.station(credential)?;
        let station = station.unwrap_or(100 + self.known.len() as u16);
        if let Credential::Ticket { token, resume } = credential {
            self.redeemed += 1;
            self.known.insert(resume.as_bytes()[0], (station, granted));
            if let Some((_, refused)) = self.tickets.get_mut(&token.as_bytes()[0]) {
                *refused = Some(Refused::Spent { at: 7 });
            }
        }
        let arrival = self.roster.arrive(station, wish.name.clone(), role);
        for hand in &wish.hands {
            self.roster.take_hand(station, hand)?;
        }
        Ok(Admitted { station, connection: arrival.connection, role })
    }

    fn offer(&mut self, _: &Admitted, held: Option<HeldScene>) -> Result<SceneOffer, Refusal> {
        let (revision, _) = self.revisions.last_key_value().expect("a revision");
        let known = held.and_then(|held| Some((held, *self.revisions.get(&held.revision.0)?)));
        let known = known.filter(|(held, length)| digest_of(&self.scene[..*length]) == held.digest);
        let (kind, begin) = match known {
            Some((held, length)) => (SceneKind::Missed { since: held.revision }, length),
            None => (SceneKind::Whole, 0),
        };
        let scene: Arc<[u8]> = self.scene[begin..].into();
        let mut offer = SceneOffer {
            session: SessionInfo {
                scenario_name: PlainText::new("peg-transfer"),
                scenario_text: "schema = 1\n".repeat(100),
                seed: 42,
                architecture: Architecture::ClientServer,
                hands: self.roster.hands().to_vec(),
                stations: self.roster.stations(),
            },
            host_unix_secs: 1_795_938_052,
            manifest: SceneManifest {
                kind,
                revision: Revision(*revision),
                time: ms(1),
                bytes: scene.len() as u32,
                hash: *blake3::hash(&scene).as_bytes(),
                counts: counts_of(&self.scene),
                digest: digest_of(&self.scene),
            },
            scene,
        };
        (self.tamper)(&mut offer);
        Ok(offer)
    }

    fn request(&mut self, station: u16, what: &RequestKind, at: SimTime) -> Result<(), Refusal> {
        self.heard.push(format!("{station} asks to {}", what.name()));
        match what {
            RequestKind::TakeHand(hand) => self.roster.take_hand(station, hand).map(|_| ()),
            RequestKind::GiveHand(hand) => self.roster.give_hand(station, hand).map(|_| ()),
            RequestKind::Note(what) => {
                let note = Note { station, at, what: what.clone() };
                self.heard.push(format!("{note:?}"));
                Ok(())
            }
            RequestKind::PeerTicket { .. } | RequestKind::Repair(_) => Ok(()),
        }
    }

    fn hear(&mut self, station: u16, event: HostEvent<'_>) {
        match event {
            HostEvent::Write(bytes) => self.written.extend_from_slice(bytes),
            HostEvent::Clock(_) => {}
            other => self.heard.push(format!("{station}: {other:?}")),
        }
    }
}

/// A session, one station, and the stream between them.
pub struct Pair {
    pub now: SimTime,
    pub session: TestSession,
    pub facts: Arc<HostFacts>,
    pub host: Option<HostControl>,
    pub client: ClientControl,
    /// What the station has built.
    pub scene: Vec<u8>,
    pub held: Option<HeldScene>,
    pub deltas: Vec<u8>,
    pub heard: Vec<String>,
    pub builds: bool,
    /// Whether streams can be made and carry anything.
    pub is_up: bool,
    /// Bytes that the stream carries in a step, and in one piece, to the station and to the host.
    pub to_client: (usize, usize),
    pub to_host: (usize, usize),
    /// Most bytes that ever waited at the host.
    pub waited: usize,
    pub connections: u32,
    pub carried: usize,
    /// Bytes after which the stream to the station breaks, once.
    pub cut_after: Option<usize>,
    /// Why the connections so far ended at the host.
    pub host_errors: Vec<ControlError>,
}

impl Pair {
    pub fn new(session: TestSession, credential: Credential, wish: Wish) -> Self {
        let facts =
            ClientFacts { program: PlainText::new("0.1.0"), components: components(), scenario: None, wish };
        Self::with(session, credential, facts)
    }

    pub fn with(session: TestSession, credential: Credential, facts: ClientFacts) -> Self {
        let host_facts = HostFacts {
            components: components(),
            components_digest: components().digest(),
            scenario_name: PlainText::new("peg-transfer"),
            scenario: [5; 32],
        };
        Self {
            now: SimTime::ZERO,
            session,
            facts: Arc::new(host_facts),
            host: None,
            client: ClientControl::new(facts, credential, SimTime::ZERO),
            scene: Vec::new(),
            held: None,
            deltas: Vec::new(),
            heard: Vec::new(),
            builds: true,
            is_up: true,
            to_client: (usize::MAX, usize::MAX),
            to_host: (usize::MAX, usize::MAX),
            waited: 0,
            connections: 0,
            carried: 0,
            cut_after: None,
            host_errors: Vec::new(),
        }
    }

    /// A station that serves the left hand.
    pub fn operating() -> Self {
        Self::new(TestSession::new(100), ticket(1), wish("Ana", &["left"]))
    }

    /// One step of a millisecond, or as many as the condition takes, up to some two virtual minutes.
    pub fn run_until(&mut self, is_done: impl Fn(&Self) -> bool) {
        for _ in 0..125_000 {
            if is_done(self) {
                return;
            }
            self.step();
        }
        panic!("it never happened: {:?}, {:?}", self.client.state(), self.client.error());
    }

    pub fn run(&mut self, span: SimTime) {
        let until = self.now + span;
        while self.now < until {
            self.step();
        }
    }

    pub fn step(&mut self) {
        self.now += ms(1);
        let now = self.now;
        let poll = self.client.poll(now);
        let is_due_later = poll.deadline > now || poll.stream == StreamWish::Over;
        assert!(is_due_later, "a driver would spin: {poll:?} at {now}");
        match poll.stream {
            StreamWish::Keep => {}
            StreamWish::None | StreamWish::Over => self.drop_stream("the station closed it"),
            StreamWish::Connect => {
                self.drop_stream("the station closed it");
                if self.is_up {
                    self.connections += 1;
                    self.host = Some(HostControl::new(Arc::clone(&self.facts), now));
                    self.client.connected(self.held, now).expect("it asked for a stream");
                } else {
                    self.client.broke("no route to host", now);
                }
            }
        }
        if self.is_up {
            self.carry_to_host();
            self.carry_to_client();
        }
        let poll = self.host.as_mut().map(|host| host.poll(now));
        assert!(
            poll.is_none_or(|poll| poll.deadline > now || poll.is_over),
            "a driver would spin: {poll:?} at {now}"
        );
        let over = poll.is_some_and(|poll| poll.is_over);
        if over {
            self.drop_stream("the host closed it");
            self.client.broke("the host closed it", now);
        }
    }

    fn carry_to_host(&mut self) {
        let Some(host) = &mut self.host else { return };
        let (mut budget, piece) = self.to_host;
        while budget > 0 && !self.client.outgoing().is_empty() {
            let count = self.client.outgoing().len().min(piece).min(budget);
            let bytes = self.client.outgoing()[..count].to_vec();
            self.client.advance(count, self.now);
            host.receive(&bytes, self.now, &mut self.session);
            host.poll(self.now);
            budget -= count;
        }
    }

    fn carry_to_client(&mut self) {
        let (mut budget, piece) = self.to_client;
        while let Some(host) = &mut self.host
            && budget > 0
            && !host.outgoing().is_empty()
        {
            self.waited = self.waited.max(host.outgoing().len());
            let count = host.outgoing().len().min(piece).min(budget);
            let bytes = host.outgoing()[..count].to_vec();
            host.advance(count, self.now);
            host.poll(self.now);
            budget -= count;
            self.carried += count;
            self.deliver(&bytes);
            if self.cut_after.is_some_and(|most| self.carried >= most) {
                self.cut_after = None;
                self.cut();
                return;
            }
        }
    }

    /// The station takes bytes, and builds what it gets.
    pub fn deliver(&mut self, bytes: &[u8]) {
        let mut arrived = None;
        let (deltas, heard) = (&mut self.deltas, &mut self.heard);
        self.client.receive(bytes, self.now, &mut |event| match event {
            ClientEvent::Scene(manifest, bytes) => arrived = Some((manifest.clone(), bytes)),
            ClientEvent::Delta(bytes) => deltas.extend_from_slice(bytes),
            ClientEvent::Clock(_) | ClientEvent::Welcomed(_) => {}
            other => heard.push(format!("{other:?}")),
        });
        if let Some((manifest, bytes)) = arrived
            && self.builds
        {
            if manifest.kind == SceneKind::Whole {
                self.scene.clear();
            }
            self.scene.extend(bytes);
            let digest = digest_of(&self.scene);
            self.held = Some(HeldScene { revision: manifest.revision, digest });
            self.client.scene_built(manifest.revision, &counts_of(&self.scene), digest, self.now);
        }
    }

    fn drop_stream(&mut self, why: &str) {
        if let Some(mut host) = self.host.take() {
            host.broke(why, self.now);
            self.host_errors.extend(host.error().cloned());
            if let Some(admitted) = host.admitted() {
                self.session.roster.break_off(admitted.station, admitted.connection, self.now);
            }
        }
    }

    /// The stream breaks at both ends.
    pub fn cut(&mut self) {
        self.drop_stream("connection reset by peer");
        self.client.broke("connection reset by peer", self.now);
    }

    pub fn is_running(&self) -> bool {
        self.client.state() == ClientState::Running
            && self.host.as_ref().is_some_and(|host| host.state() == HostState::Running)
    }

    pub fn join(&mut self) {
        self.run_until(Self::is_running);
    }

    pub fn host(&mut self) -> &mut HostControl {
        self.host.as_mut().expect("a connection")
    }

    /// Runs until all is over for the station, and returns why.
    pub fn end(&mut self) -> ControlError {
        self.run_until(|pair| pair.client.state() == ClientState::Ended);
        self.client.error().expect("an error").clone()
    }

    /// Runs until the host's end of a connection is over, and returns why.
    pub fn host_end(&mut self) -> ControlError {
        self.run_until(|pair| !pair.host_errors.is_empty());
        self.host_errors[0].clone()
    }

    /// Runs until the station has said hello, which has not gone out yet.
    pub fn say_hello(&mut self) -> Vec<u8> {
        let usual = std::mem::replace(&mut self.to_host.0, 0);
        self.run_until(|pair| pair.client.state() == ClientState::Opening);
        self.to_host.0 = usual;
        self.client.outgoing().to_vec()
    }
}

pub fn wish(station: &str, hands: &[&str]) -> Wish {
    let hands: Vec<_> = hands.iter().map(|hand| name(hand)).collect();
    Wish { name: name(station), role: None, devices: hands.clone(), hands, moves: false }
}
