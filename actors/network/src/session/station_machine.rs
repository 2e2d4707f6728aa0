//! The machine of a station: its connection to the host, and the copy of the host's scene. It is stepped by one actor, and
//! before there is one by whoever joins.

mod copy;
mod datagrams;
mod pause;
mod stream;

use std::collections::VecDeque;
use std::sync::Arc;

use thiserror::Error;
use trocar_devices::Pedals;
use trocar_scene::{Commands, Entity, LinkState, Revision, SimTime, Snapshot, Station, StationRole};

use super::carrier::Carrier;
use super::host_controller::{role, state};
use super::host_course::HostCourse;
use super::own_rows::own_rows;
use super::peer_repair::PeerRepair;
use crate::control::{
    ClientControl, ClientFacts, ClientState, ControlError, Credential, Note, Refusal, RequestKind,
    SceneManifest, SendError, StationInfo, Welcome,
};
use crate::hands_link::{ControllerEnd, HandsOrder, Parcel};
use crate::haptic::{LinkPoint, LinkQuality, LinkSummary, SenderConfig};
use crate::pairs::{PairDoor, PairMachine};
use crate::peers::comparison::ComparisonCounts;
use crate::replication::choice::ReplicatedColumns;
use crate::replication::replica::{Replica, ReplicaCounts};
use crate::streams::StationStream;

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
    /// Whether the host's session pauses, or is over.
    host_course: HostCourse,
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
            host_course: HostCourse::default(),
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
        if self.was_running && !is_running && self.control.state() != ClientState::Ended {
            let why = self.control.error().map_or_else(String::new, ToString::to_string);
            self.tell(StationNews::Away(why));
        }
        self.was_running = is_running;
        match (self.control.state(), self.control.error()) {
            (ClientState::Ended, Some(error)) => {
                if error.is_final() {
                    self.host_course.finish(error.clone());
                }
                Err(StationError::Over(error.clone()))
            }
            _ => Ok(()),
        }
    }

    /// Whether the host has paused the session: the station's own is then to pause as well, so that both clocks stand still.
    /// And whether it is over, so that the station's own is to end.
    pub fn host_course(&self) -> &HostCourse {
        &self.host_course
    }

    /// Tells it to who was told by the machine before this one.
    #[must_use]
    pub fn telling(self, host_course: HostCourse) -> Self {
        Self { host_course, ..self }
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

    /// Among peers: how the station's bodies compare with their owner's.
    pub fn comparison(&self) -> Option<&ComparisonCounts> {
        self.peer.as_ref().map(PeerRepair::counts)
    }

    fn tell(&mut self, news: StationNews) {
        push(&mut self.news, news);
    }
}

fn push(news: &mut VecDeque<StationNews>, what: StationNews) {
    if news.len() == NEWS_MAX {
        news.pop_front();
    }
    news.push_back(what);
}
