//! The machine of a station: its connection to the host, and the copy of the host's scene. It is stepped by one actor, and
//! before there is one by whoever joins.

use std::collections::VecDeque;
use std::sync::Arc;

use thiserror::Error;
use trocar_devices::Pedals;
use trocar_scene::{
    Activation, ActivationMode, Commands, Entity, Hand, LinkState, Revision, SimTime, Snapshot, Station,
    StationRole,
};

use super::carrier::Carrier;
use super::host_controller::{role, state};
use super::host_members::digest_of;
use super::host_pause::HostPause;
use super::own_rows::own_rows;
use super::peer_repair::PeerRepair;
use crate::control::{
    ClientControl, ClientEvent, ClientFacts, ClientState, ControlError, Credential, HandInfo, HeldScene,
    Note, Refusal, RequestKind, SILENCE_MAX, SceneCounts, SceneKind, SceneManifest, SendError, StationInfo,
    StreamWish, Welcome,
};
use crate::datagram::{Keys, Kind, Side};
use crate::hands_link::{Connection, ControllerEnd, HandNumbers, HandsNews, HandsOrder, Parcel};
use crate::haptic::{LinkPoint, LinkQuality, LinkSummary, SenderConfig};
use crate::pairs::{PairDoor, PairMachine};
use crate::peers::comparison::ComparisonCounts;
use crate::replication::choice::ReplicatedColumns;
use crate::replication::replica::{Replica, ReplicaCounts};
use crate::streams::{StationStream, StreamState};

/// Bytes taken from the stream at a step.
const TAKEN_MAX: usize = 1 << 20;
/// Time between two acknowledgements of rows.
const ACKNOWLEDGE_EVERY: SimTime = SimTime::from_millis(20);
/// Time between two tellings of what a person does with the pedals.
const PRESS_EVERY: SimTime = SimTime::from_millis(20);
/// Datagrams that the control channel is given to carry at a step.
const CARRIED_MAX: usize = 8;
/// Deltas that wait to be applied, one a step.
const DELTAS_MAX: usize = 64;
/// Notes and refusals that wait for the actor.
const NEWS_MAX: usize = 256;
/// Invitations that wait for the next step.
const INVITED_MAX: usize = 64;

/// What a station is.
#[derive(Clone)]
pub struct StationSetup {
    /// For its hello.
    pub facts: ClientFacts,
    /// Its ticket's token, or the secret with which it comes back.
    pub credential: Credential,
    /// How hands are sent.
    pub sender: SenderConfig,
    /// Seed of the challenges; random.
    pub secret: u64,
}

/// What stays the same while a station is in a session.
#[derive(Clone)]
pub struct StationParts {
    /// Which columns travel, and how.
    pub columns: Arc<ReplicatedColumns>,
    /// Entities of the hands for which the station has devices.
    pub devices: Vec<Entity>,
    /// Its number.
    pub station: u16,
}

/// Something that the person at the station should know.
#[derive(Clone, Debug, PartialEq)]
pub enum StationNews {
    /// Somebody shows something.
    Note(Note),
    /// A request, or a write, is refused.
    Refused(Refusal),
    /// The connection is gone; the station tries to come back.
    Away(String),
    /// The station is back.
    Back,
    /// The control channel carries its datagrams from now on, or no more.
    Carried(bool),
    /// A body of the station's differed, and is its owner's again.
    Repaired(Entity),
    /// The host has paused the session, or it goes on.
    Paused(bool),
}

/// Why a station cannot go on.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum StationError {
    /// The session is over for it.
    #[error("{0}")]
    Over(ControlError),
}

/// A station's connection and its copy of the scene. `A` is the address of a datagram.
pub struct StationMachine<A> {
    control: ClientControl,
    stream: Box<dyn StationStream<A>>,
    hands: ControllerEnd<A>,
    sender: SenderConfig,
    secret: u64,
    /// Entities of the hands for which it has devices, and whether it moves them itself.
    devices: Vec<Entity>,
    moves: bool,
    /// Once it is known which components the host's scenario has.
    columns: Option<Arc<ReplicatedColumns>>,
    replica: Option<Replica>,
    /// Among peers.
    peer: Option<PeerRepair>,
    /// Where hands go to other stations directly.
    pairs: Option<PairMachine<A>>,
    /// Invitations of other stations.
    invited: VecDeque<(u16, Vec<u8>)>,
    /// The number of the open connection, and since when it has served its hands.
    connection: Option<u32>,
    serves: Vec<u8>,
    /// The scene that has arrived and is not built yet.
    built: Option<(SceneManifest, Vec<u8>)>,
    /// The scene whose batch is on its way to the Model, with the mark that tells that it has arrived there.
    pending: Option<(SceneManifest, Option<Revision>)>,
    deltas: VecDeque<Vec<u8>>,
    rows: VecDeque<Parcel>,
    stations: Vec<StationInfo>,
    quality: Option<LinkQuality>,
    /// What the control channel of the present connection carries.
    carrier: Carrier,
    news: VecDeque<StationNews>,
    acknowledged_at: SimTime,
    /// The pedals of the hands that it serves, as they were told last, and when.
    pressed: Vec<(u8, Pedals)>,
    pressed_at: SimTime,
    received: Vec<u8>,
    payload: Vec<u8>,
    was_running: bool,
    has_joined: bool,
    /// Whether the station's own controllers run although this machine has taken nothing yet.
    is_in_session: bool,
    is_protected: bool,
    /// Time of the last step.
    now: SimTime,
    /// Whether the host has paused the session.
    host_pause: HostPause,
    /// Within a pause of the host's: when something came last, counted from the beginning of the station's own pause.
    heard_in_pause: Option<SimTime>,
}

impl<A: Copy + PartialEq + Send + 'static> StationMachine<A> {
    /// A station that wants to be in a session. Until the host's scenario is known it takes no scene:
    /// [`Self::replicate`].
    pub fn new(
        setup: StationSetup,
        stream: Box<dyn StationStream<A>>,
        hands: ControllerEnd<A>,
        now: SimTime,
    ) -> Self {
        Self {
            moves: setup.facts.wish.moves,
            control: ClientControl::new(setup.facts, setup.credential, now),
            stream,
            hands,
            sender: setup.sender,
            secret: setup.secret,
            devices: Vec::new(),
            columns: None,
            replica: None,
            peer: None,
            pairs: None,
            invited: VecDeque::new(),
            connection: None,
            serves: Vec::new(),
            built: None,
            pending: None,
            deltas: VecDeque::new(),
            rows: VecDeque::new(),
            stations: Vec::new(),
            quality: None,
            carrier: Carrier::default(),
            news: VecDeque::new(),
            acknowledged_at: SimTime::ZERO,
            pressed: Vec::new(),
            pressed_at: SimTime::ZERO,
            received: Vec::new(),
            payload: Vec::new(),
            was_running: false,
            has_joined: false,
            is_in_session: false,
            is_protected: true,
            now,
            host_pause: HostPause::default(),
            heard_in_pause: None,
        }
    }

    /// A station whose machine was lost while its own session goes on: it comes back by the secret of its credential, and
    /// compares what `scene` has of the host with what the host has.
    pub fn again(
        setup: StationSetup,
        stream: Box<dyn StationStream<A>>,
        hands: ControllerEnd<A>,
        parts: StationParts,
        scene: &Snapshot,
        now: SimTime,
    ) -> Self {
        hands.order(HandsOrder::CloseAll);
        let StationParts { columns, devices, station } = parts;
        let setup = StationSetup { credential: setup.credential.for_coming_back(), ..setup };
        let mut machine = Self::new(setup, stream, hands, now);
        let mut replica = Replica::adopt(columns.clone(), scene, |entity| entity.station() != station);
        replica.exclude(own_rows(&columns, scene, &devices, machine.moves));
        machine.peer = PeerRepair::of(&columns);
        (machine.replica, machine.columns, machine.devices) = (Some(replica), Some(columns), devices);
        (machine.is_in_session, machine.has_joined) = (true, true);
        machine
    }

    /// Puts something between the machine and its stream.
    pub fn over(
        mut self: Box<Self>,
        wrap: impl FnOnce(Box<dyn StationStream<A>>) -> Box<dyn StationStream<A>>,
    ) -> Box<Self> {
        self.stream = wrap(self.stream);
        self
    }

    /// What a machine has to know to be made [again](Self::again); `None` before the station is in the session.
    pub fn parts(&self) -> Option<StationParts> {
        let columns = self.columns.clone()?;
        Some(StationParts { columns, devices: self.devices.clone(), station: self.station() })
    }

    /// Where the host that was reached takes datagrams.
    pub fn peer(&self) -> Option<A> {
        self.stream.peer()
    }

    /// The host's welcome, once it has come.
    pub fn welcome(&self) -> Option<&Welcome> {
        self.control.welcome()
    }

    /// Where the station is.
    pub fn state(&self) -> ClientState {
        self.control.state()
    }

    /// Why it is away, or why all is over.
    pub fn error(&self) -> Option<&ControlError> {
        self.control.error()
    }

    /// How much of the scene has arrived, of how many bytes.
    pub fn progress(&self) -> Option<(u32, u32)> {
        self.control.progress()
    }

    /// Who is there.
    pub fn stations(&self) -> &[StationInfo] {
        &self.stations
    }

    /// How its own link does, as the other end is seen from here.
    pub fn figures(&self) -> Option<LinkSummary> {
        self.quality.as_ref().map(LinkQuality::summary)
    }

    /// The last second of its link.
    pub fn point(&self) -> Option<LinkPoint> {
        self.quality.as_ref().and_then(|quality| quality.curve().last().copied())
    }

    /// What the replica has taken.
    pub fn replica_counts(&self) -> ReplicaCounts {
        self.replica.as_ref().map_or_else(ReplicaCounts::default, |replica| *replica.counts())
    }

    /// The revision of the host's scene up to which everything has been applied.
    pub fn applied(&self) -> Revision {
        self.replica.as_ref().map_or(Revision::ZERO, Replica::applied)
    }

    /// What happened since the last call.
    pub fn take_news(&mut self) -> impl Iterator<Item = StationNews> + '_ {
        self.news.drain(..)
    }

    /// The columns of the session, which the welcome's scenario chooses: the scene can be taken now. `devices` are the
    /// entities of the hands for which the station has devices.
    pub fn replicate(&mut self, columns: Arc<ReplicatedColumns>, devices: Vec<Entity>) {
        self.replica = Some(Replica::new(columns.clone()));
        self.peer = PeerRepair::of(&columns);
        self.columns = Some(columns);
        self.devices = devices;
    }

    /// Asks the host for something.
    ///
    /// # Errors
    /// [`SendError`].
    pub fn request(&mut self, what: RequestKind, now: SimTime) -> Result<u32, SendError> {
        self.control.request(what, now)
    }

    /// Leaves the session, so that its hands are free at once: to be called again and again after the last
    /// [`Self::step`], until it is true that the host has been told, or nobody can be told.
    pub fn leave(&mut self) -> bool {
        let now = self.now;
        self.control.leave(now);
        self.flush(now);
        // The last words of a stream that is closed go out while it works.
        self.stream.work(now);
        self.control.outgoing().is_empty()
    }

    /// One step: takes what has come and puts it into `out`, which becomes one batch; `scene` is the station's as it is now.
    ///
    /// # Errors
    /// [`StationError`] when all is over.
    pub fn step(&mut self, now: SimTime, scene: &Snapshot, out: &mut Commands) -> Result<(), StationError> {
        self.now = now;
        if self.heard_in_pause.take().is_some() {
            // Where its device is now is not where the host has the hand.
            self.hands.order(HandsOrder::Place);
        }
        self.connect(now);
        self.receive(now);
        if let Some(peer) = &mut self.peer {
            peer.remember(now, scene);
        }
        self.take_hands_news();
        self.join(now, scene);
        self.build(now, scene, out);
        self.follow(now, out);
        self.repair(now, scene, out);
        self.pair(now);
        self.acknowledge(now);
        self.press(now, scene);
        self.flush(now);
        let is_running = self.control.state() == ClientState::Running;
        if !is_running {
            self.note_pause(false);
        }
        if self.was_running && !is_running {
            let why = self.control.error().map_or_else(String::new, ToString::to_string);
            self.tell(StationNews::Away(why));
        }
        self.was_running = is_running;
        match (self.control.state(), self.control.error()) {
            (ClientState::Ended, Some(error)) => Err(StationError::Over(error.clone())),
            _ => Ok(()),
        }
    }

    /// Whether the host has paused the session: the station's own is then to pause as well, so that both clocks stand still.
    pub fn host_pause(&self) -> &HostPause {
        &self.host_pause
    }

    /// Tells it to who was told by the machine before this one.
    #[must_use]
    pub fn telling(self, host_pause: HostPause) -> Self {
        Self { host_pause, ..self }
    }

    /// The station's session is paused, `passed` ago, and its time stands still. As long as the host has paused it, too, the
    /// machine listens to when it goes on; the pause is over as well if the host falls silent or the stream closes. A station
    /// that has paused by itself is silent.
    pub fn rest(&mut self, passed: SimTime) {
        if !self.host_pause.is_on() {
            return;
        }
        let now = self.now;
        let heard_at = *self.heard_in_pause.get_or_insert(passed);
        if let StreamState::Closed(why) = self.stream.work(now) {
            self.drain(now);
            self.control.broke(&why, now);
        } else {
            self.receive(now);
            if !self.received.is_empty() {
                self.heard_in_pause = Some(passed);
            } else if passed.since(heard_at) >= SILENCE_MAX {
                self.control.broke("the host has fallen silent within a pause", now);
            }
        }
        self.flush(now);
        if self.control.state() != ClientState::Running {
            self.note_pause(false);
        }
    }

    fn note_pause(&mut self, is_paused: bool) {
        if self.host_pause.set(is_paused) {
            self.tell(StationNews::Paused(is_paused));
        }
    }

    /// Does what the machine wishes about its stream.
    fn connect(&mut self, now: SimTime) {
        let poll = self.control.poll(now);
        match poll.stream {
            StreamWish::None | StreamWish::Over => self.stream.close(),
            StreamWish::Connect => self.stream.connect(now),
            StreamWish::Keep => {}
        }
        match (self.stream.work(now), self.control.state()) {
            (StreamState::Open, ClientState::Connecting) => {
                let held = self.held();
                // The machine asked for the stream, and the wish was checked when it was made.
                let _ = self.control.connected(held, now);
            }
            (StreamState::Closed(why), state) if !matches!(state, ClientState::Away | ClientState::Ended) => {
                self.drain(now);
                self.control.broke(&why, now);
            }
            _ => {}
        }
    }

    /// The scene that the station has, if it followed before.
    fn held(&self) -> Option<HeldScene> {
        let has_scene = |replica: &&Replica| replica.counts().deltas > 0 || self.is_in_session;
        let replica = self.replica.as_ref().filter(has_scene)?;
        // The host knows by the revision alone what it has sent; of revision zero it has sent nothing.
        Some(HeldScene { revision: replica.applied(), digest: [0; 32] })
    }

    fn receive(&mut self, now: SimTime) {
        if self.built.is_some() && self.replica.is_none() {
            // Nobody knows yet what to do with what follows.
            return;
        }
        self.received.clear();
        let received = match self.control.state() {
            ClientState::Away | ClientState::Connecting | ClientState::Ended => Ok(()),
            _ => self.stream.receive(now, TAKEN_MAX, &mut self.received),
        };
        self.hear(now);
        if let Err(closed) = received {
            self.control.broke(&closed.0, now);
        }
    }

    /// Last words of a stream that has ended, such as why the station is not let in.
    fn drain(&mut self, now: SimTime) {
        self.received.clear();
        // How it ended is known already.
        let _ = self.stream.receive(now, TAKEN_MAX, &mut self.received);
        self.hear(now);
    }

    fn hear(&mut self, now: SimTime) {
        let mut heard = Heard::default();
        let Self { control, received, deltas, news, stations, replica, carrier, peer, invited, .. } = self;
        let mut failed = None;
        control.receive(received, now, &mut |event| match event {
            ClientEvent::Welcomed(welcome) => {
                heard.welcomed = Some((welcome.connection, welcome.station));
                *stations = welcome.session.stations.clone();
                *carrier = Carrier::default();
                deltas.clear();
                heard.hands_changed = true;
            }
            ClientEvent::Scene(manifest, bytes) => heard.scene = Some((manifest.clone(), bytes)),
            ClientEvent::Delta(piece) => {
                if let Some(replica) = replica {
                    match replica.receive_piece(piece) {
                        Ok(Some(_)) if deltas.len() >= DELTAS_MAX => {
                            failed = Some("the station does not follow its host".to_owned());
                        }
                        Ok(Some(delta)) => deltas.push_back(delta),
                        Ok(None) => {}
                        Err(error) => failed = Some(error.to_string()),
                    }
                }
            }
            ClientEvent::Roster(roster) => *stations = roster,
            ClientEvent::HandServed { .. } => heard.hands_changed = true,
            ClientEvent::Note(note) => push(news, StationNews::Note(note)),
            ClientEvent::Repair(bytes) => {
                if let Some(peer) = peer {
                    peer.answered(bytes);
                }
            }
            ClientEvent::Answer { refusal: Some(refusal), .. } => push(news, StationNews::Refused(refusal)),
            ClientEvent::Answer { refusal: None, .. } | ClientEvent::Clock(_) => {}
            ClientEvent::PeerTicket { from, ticket } => {
                if invited.len() < INVITED_MAX {
                    invited.push_back((from, ticket));
                }
            }
            ClientEvent::Carried { hears, taken, datagram } => carrier.arrived(hears, taken, datagram),
            ClientEvent::Rekey(phase) => heard.rekey = Some(phase),
            ClientEvent::Paused(is_paused) => heard.paused = Some(is_paused),
        });
        if let Some(is_paused) = heard.paused {
            self.note_pause(is_paused);
        }
        if let Some(why) = failed {
            self.control.broke(&why, now);
        }
        if let Some((connection, station)) = heard.welcomed {
            self.open(connection, station, now);
        }
        if heard.hands_changed {
            self.serve_hands();
        }
        if let Some(phase) = heard.rekey {
            self.rekey(phase, now);
        }
        self.take_carried();
        self.built = heard.scene.or(self.built.take());
    }

    /// Gives the hands link what the control channel carried.
    fn take_carried(&mut self) {
        let Some(connection) = self.connection else { return };
        if let Some(is_heard) = self.carrier.take_heard() {
            self.hands.order(HandsOrder::Heard { connection, is_heard });
            self.tell(StationNews::Carried(!is_heard));
        }
        while let Some(datagram) = self.carrier.take_arrived() {
            // Without room it is lost, as on a path.
            self.hands.order(HandsOrder::Carried { connection, datagram });
        }
    }

    /// Puts what the control channel is to carry into it.
    fn send_carried(&mut self, now: SimTime) {
        let Self { control, carrier, .. } = self;
        if control.state() != ClientState::Running {
            return;
        }
        for _ in 0..CARRIED_MAX {
            let (round_trip, waiting) = (control.round_trip(), control.outgoing().len());
            let Some(frame) = carrier.next(round_trip, control.has_urgent(), waiting, now) else { break };
            // One that cannot go is lost, or has ended the connection, which the next step sees.
            let _ = control.send_carried(frame.message(), frame.is_urgent, now);
        }
    }

    /// Gives the datagrams of a new connection their keys.
    fn open(&mut self, id: u32, station: u16, now: SimTime) {
        self.rows.clear();
        if let Some(replica) = &mut self.replica {
            replica.reconnect();
        }
        let secret = self.secret ^ u64::from(id);
        let keys: Option<Keys> = self.stream.keys(id, 0);
        let made =
            keys.and_then(|keys| Connection::new(id, keys, Side::Client, &[], &self.sender, secret).ok());
        let Some(connection) = made.map(Box::new) else {
            self.control.broke("no keys for its datagrams", now);
            return;
        };
        self.quality = Some(LinkQuality::new(connection.meter().histograms().clone()));
        self.is_protected = connection.is_protected();
        self.connection = Some(id);
        self.hands.order(HandsOrder::Open { station, connection, peer: self.stream.peer() });
    }

    /// The hands of the session that this station serves.
    fn served(&self) -> impl Iterator<Item = &HandInfo> + '_ {
        let welcome = self.control.welcome();
        let station = welcome.map(|welcome| welcome.station);
        let hands = welcome.map_or(&[][..], |welcome| &welcome.session.hands);
        hands.iter().filter(move |hand| hand.station == station)
    }

    /// Follows who serves which hand.
    fn serve_hands(&mut self) {
        let serves: Vec<u8> = self.served().map(|hand| hand.number).collect();
        if let Some(connection) = self.connection {
            let hands = HandNumbers::new(serves.iter().copied());
            self.hands.order(HandsOrder::Serve { connection, hands });
        }
        self.serves = serves;
    }

    fn rekey(&mut self, phase: u32, now: SimTime) {
        let Some(connection) = self.connection else { return };
        let both = (self.stream.keys(connection, phase), self.stream.keys(connection, phase));
        if let (Some(first), Some(second)) = both {
            let ((_, key), (own, _)) = (first.split(Side::Client), second.split(Side::Client));
            self.hands.order(HandsOrder::RekeyOpener { connection, key });
            self.hands.order(HandsOrder::RekeySealer { connection, key: own });
            // A connection that is over by now needs no answer.
            let _ = self.control.rekeyed(now);
        }
    }

    fn take_hands_news(&mut self) {
        while let Some(news) = self.hands.next_news() {
            match news {
                HandsNews::Arrived { connection, parcel, sent_at: Some(sent_at) }
                    if Some(connection) == self.connection && parcel.kind() == Kind::Sketch =>
                {
                    if let Some(peer) = &mut self.peer {
                        peer.compare(sent_at, parcel.payload());
                    }
                }
                HandsNews::Arrived { connection, parcel, .. }
                    if Some(connection) == self.connection && parcel.kind() == Kind::Rows =>
                {
                    if self.rows.len() < NEWS_MAX {
                        self.rows.push_back(parcel);
                    }
                }
                HandsNews::Second { connection, point, .. } if Some(connection) == self.connection => {
                    if let Some(quality) = &mut self.quality {
                        quality.take(&point);
                    }
                }
                HandsNews::Carry { connection, datagram } if Some(connection) == self.connection => {
                    self.carrier.carry(datagram);
                }
                HandsNews::Hears { connection, hears } if Some(connection) == self.connection => {
                    self.carrier.hears(hears);
                }
                // The host counts what its own end has sealed, and asks for new keys.
                HandsNews::Arrived { .. }
                | HandsNews::Carry { .. }
                | HandsNews::Hears { .. }
                | HandsNews::Second { .. }
                | HandsNews::Worn { .. } => {}
                HandsNews::Closed(connection) => drop(connection),
                // A station echoes nobody's datagrams.
                HandsNews::Echoed { .. } | HandsNews::EchoEnded(_) => {}
            }
        }
    }

    /// Builds the scene that has arrived whole.
    fn build(&mut self, now: SimTime, scene: &Snapshot, out: &mut Commands) {
        let Some(replica) = &mut self.replica else { return };
        let Some((manifest, bytes)) = self.built.take() else { return };
        if !bytes.is_empty()
            && let Err(error) = replica.apply(&bytes, out)
        {
            self.control.scene_failed(manifest.revision, &error.to_string(), now);
            return;
        }
        // The row tells when the batch has reached the scene.
        let me = out.me();
        let mark = scene.changed::<Station>(me);
        out.put(me, self.row());
        self.pending = Some((manifest, mark));
    }

    /// Tells the host what was built, once it is in the station's scene.
    fn join(&mut self, now: SimTime, scene: &Snapshot) {
        let Some((manifest, mark)) = self.pending.take() else { return };
        let is_there = scene
            .iter::<Station>()
            .any(|(entity, _)| entity.station() == self.station() && scene.changed::<Station>(entity) > mark);
        let Some(replica) = self.replica.as_mut().filter(|_| is_there) else {
            self.pending = Some((manifest, mark));
            return;
        };
        let (entities, rows) = replica.row_counts();
        let counts = SceneCounts::of_rows(scene.registry(), entities, rows);
        let digest = match manifest.kind {
            SceneKind::Whole => replica.digest(scene).map(|digest| digest_of(&digest)),
            SceneKind::Missed { .. } => Ok(manifest.hash),
        };
        match digest {
            Ok(digest) => self.control.scene_built(manifest.revision, &counts, digest, now),
            Err(error) => self.control.scene_failed(manifest.revision, &error.to_string(), now),
        }
        if self.control.state() == ClientState::Running {
            // From here on what the station's own controllers write is left to them, at both ends.
            if let Some(columns) = &self.columns {
                replica.exclude(own_rows(columns, scene, &self.devices, self.moves));
            }
            if self.has_joined {
                self.tell(StationNews::Back);
            }
            self.has_joined = true;
        }
    }

    fn station(&self) -> u16 {
        self.control.welcome().map_or(0, |welcome| welcome.station)
    }

    /// The station's own row: its link, as it is seen from here.
    pub fn row(&self) -> Station {
        let point = self.quality.as_ref().and_then(|quality| quality.curve().last());
        let info = self.stations.iter().find(|info| info.number == self.station());
        let hands = self.served().map(|hand| hand.name.as_str().to_owned()).collect();
        Station {
            number: self.station(),
            name: info.map_or_else(String::new, |info| info.name.as_str().to_owned()),
            role: self.control.welcome().map_or(StationRole::Watch, |welcome| role(welcome.role)),
            here: self.control.state() == ClientState::Running,
            hands,
            protected: self.is_protected,
            link: point.map_or_else(LinkState::default, state),
        }
    }

    /// Puts what changed at the host into the station's scene: one delta at a time, since a batch holds no more than one,
    /// and all rows that have come.
    fn follow(&mut self, now: SimTime, out: &mut Commands) {
        let Some(replica) = self.replica.as_mut() else { return };
        if self.control.state() != ClientState::Running || !out.is_empty() {
            return;
        }
        if let Some(delta) = self.deltas.pop_front() {
            if let Err(error) = replica.apply(&delta, out) {
                self.control.broke(&error.to_string(), now);
            }
            return;
        }
        for parcel in self.rows.drain(..) {
            // What cannot be read is counted; it came from the host, whose next datagram is newer.
            let _ = replica.receive_rows(parcel.payload(), out);
        }
        replica.put_vertices(out);
    }

    /// Hands go to other stations directly through this door.
    pub fn with_pairs(mut self: Box<Self>, door: Box<dyn PairDoor<A>>) -> Box<Self> {
        self.pairs = Some(PairMachine::new(door, self.hands.clone(), self.sender, self.secret));
        self
    }

    /// The stations to which hands go directly.
    pub fn paired(&self) -> Vec<u16> {
        self.pairs.iter().flat_map(PairMachine::stations).collect()
    }

    /// Goes on with the pairs. The host passes invitations on; one that it does not is made again when the station comes back.
    fn pair(&mut self, now: SimTime) {
        let me = self.station();
        let Some(pairs) = &mut self.pairs else { return };
        self.invited.drain(..).for_each(|(from, ticket)| pairs.invited(from, &ticket, now));
        if self.control.state() != ClientState::Running {
            return;
        }
        for (to, ticket) in pairs.step(now, me, &self.stations) {
            let _ = self.control.request(RequestKind::PeerTicket { to, ticket }, now);
        }
    }

    /// Among peers: asks the owner for bodies that differ, and writes what it has answered.
    fn repair(&mut self, now: SimTime, scene: &Snapshot, out: &mut Commands) {
        let (Some(peer), Some(columns)) = (&mut self.peer, &self.columns) else { return };
        if self.control.state() != ClientState::Running {
            return;
        }
        peer.ask(now, scene, columns, &mut self.control);
        if let Some(entity) = peer.write(scene, columns, out) {
            self.tell(StationNews::Repaired(entity));
        }
    }

    /// Among peers: how the station's bodies compare with their owner's.
    pub fn comparison(&self) -> Option<&ComparisonCounts> {
        self.peer.as_ref().map(PeerRepair::counts)
    }

    /// Tells the host which rows have come.
    fn acknowledge(&mut self, now: SimTime) {
        let is_due = now.since(self.acknowledged_at) >= ACKNOWLEDGE_EVERY;
        let (Some(replica), Some(connection)) = (&self.replica, self.connection) else { return };
        if !is_due || self.control.state() != ClientState::Running {
            return;
        }
        self.acknowledged_at = now;
        self.payload.clear();
        replica.write_acknowledgement(&mut self.payload);
        if let Some(parcel) = Parcel::new(Kind::RowAcks, &self.payload) {
            self.hands.order(HandsOrder::Send { connection, parcel });
        }
    }

    /// Tells the hands link what the person at the station does with the pedals.
    fn press(&mut self, now: SimTime, scene: &Snapshot) {
        if !self.moves {
            return;
        }
        let pressed: Vec<(u8, Pedals)> =
            self.served().map(|hand| (hand.number, pedals_of(scene, hand.entity))).collect();
        if pressed == self.pressed && now.since(self.pressed_at) < PRESS_EVERY {
            return;
        }
        for &(hand, pedals) in &pressed {
            self.hands.order(HandsOrder::Press { hand, pedals });
        }
        (self.pressed, self.pressed_at) = (pressed, now);
    }

    /// Moves what waits into the stream.
    fn flush(&mut self, now: SimTime) {
        self.send_carried(now);
        while !self.control.outgoing().is_empty() {
            match self.stream.send(now, self.control.outgoing()) {
                Ok(0) => break,
                Ok(count) => self.control.advance(count, now),
                Err(closed) => {
                    self.control.broke(&closed.0, now);
                    break;
                }
            }
        }
        if self.control.state() == ClientState::Ended && self.control.outgoing().is_empty() {
            self.stream.close();
        }
    }

    fn tell(&mut self, news: StationNews) {
        push(&mut self.news, news);
    }
}

/// What the person does with the pedals of a hand, by the instrument that it holds in the station's own scene.
fn pedals_of(scene: &Snapshot, hand: Entity) -> Pedals {
    let instrument = scene.get::<Hand>(hand).map(|hand| hand.instrument);
    match instrument.and_then(|instrument| scene.get::<Activation>(instrument)) {
        Some(Activation { level, mode, .. }) if *level > 0.0 => match mode {
            Some(ActivationMode::Coagulate) => Pedals::Coagulate,
            _ => Pedals::Energy,
        },
        _ => Pedals::Released,
    }
}

#[derive(Default)]
struct Heard {
    welcomed: Option<(u32, u16)>,
    scene: Option<(SceneManifest, Vec<u8>)>,
    hands_changed: bool,
    rekey: Option<u32>,
    paused: Option<bool>,
}

fn push(news: &mut VecDeque<StationNews>, what: StationNews) {
    if news.len() == NEWS_MAX {
        news.pop_front();
    }
    news.push_back(what);
}
