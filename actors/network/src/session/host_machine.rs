//! The machine of a host: all its connections, and what they need of the scene. It is stepped by one actor.

mod connections;
mod datagrams;
mod pause;
mod telling;

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use trocar_devices::Pedals;
use trocar_scene::{Entity, SimTime, Snapshot, TakeOverRequest};

use super::admissions::Admissions;
use super::host_members::{AcceptedNote, HostHandControl, Members};
use crate::control::{
    Architecture, Goodbye, HandInfo, HostControl, HostFacts, HostSession, HostState, NoteKind, Refusal,
    RequestKind, Roster, SendError, SessionInfo, StationInfo,
};
use crate::hands_link::{ControllerEnd, HOST, HandsOrder};
use crate::haptic::{LinkPoint, SenderConfig};
use crate::replication::choice::ReplicatedColumns;
use crate::replication::scene_feed::FeedLimits;
use crate::streams::{HostStreams, StreamId};
use crate::ticket::PlainName;

/// Time between two looks at what others changed in the tickets.
const REFRESH_EVERY: SimTime = SimTime::from_millis(1_000);
/// Incidents that wait for the actor, the newest.
const INCIDENTS_MAX: usize = 64;

/// What a host is.
#[derive(Clone)]
pub struct HostSetup {
    /// Name of the host, as the author of what it shows.
    pub name: PlainName,
    /// What stations have to agree with.
    pub facts: HostFacts,
    /// What they are told of the session; hands and stations are filled in.
    pub info: SessionInfo,
    /// Which columns travel, and how.
    pub columns: Arc<ReplicatedColumns>,
    /// Limits of each station's feed.
    pub limits: FeedLimits,
    /// How hands are sent.
    pub sender: SenderConfig,
    /// The hands: what is told of them, and who says who moves them.
    pub hands: Vec<(HandInfo, HostHandControl)>,
    /// Whether a person at the host answers for hands that the host itself serves.
    pub is_attended: bool,
    /// Seed of the challenges to new addresses; random.
    pub secret: u64,
}

struct Link {
    control: HostControl,
    /// Number and station, once its datagrams have keys.
    opened: Option<(u32, u16)>,
    /// Whether its datagrams are echoed, as somebody diagnoses the path.
    is_echoed: bool,
    /// Pieces of a delta that wait for room.
    pieces: VecDeque<Vec<u8>>,
    is_told: bool,
    /// Whether the station was told that the session is paused.
    is_paused: bool,
}

/// Something that a person at the host should know.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Incident {
    /// When.
    pub at: SimTime,
    /// What, in words.
    pub what: String,
}

/// All connections of a host. `A` is the address of a datagram.
pub struct HostMachine<A> {
    facts: Arc<HostFacts>,
    streams: Box<dyn HostStreams>,
    links: BTreeMap<StreamId, Link>,
    members: Members,
    hands: ControllerEnd<A>,
    sender: SenderConfig,
    secret: u64,
    opened: Vec<StreamId>,
    received: Vec<u8>,
    payload: Vec<u8>,
    refresh_at: SimTime,
    roster_at: SimTime,
    /// When the next sketch is due, and its number; among peers.
    sketch_at: SimTime,
    sketches: u64,
    incidents: VecDeque<Incident>,
    /// Notes that all stations were told, for the actor.
    shown: VecDeque<AcceptedNote>,
    strangers: u64,
    /// Time of the last step.
    now: SimTime,
    /// While the session is paused: when stations are told so again, counted from the beginning of the pause.
    paused_again_at: Option<SimTime>,
}

impl<A: Copy + PartialEq + Send + 'static> HostMachine<A> {
    /// A host over these streams.
    pub fn new(
        setup: HostSetup,
        streams: Box<dyn HostStreams>,
        admissions: Box<dyn Admissions>,
        hands: ControllerEnd<A>,
        scene: Arc<Snapshot>,
    ) -> Self {
        // A machine that was before this one may have left connections.
        hands.order(HandsOrder::CloseAll);
        let (infos, controls): (Vec<HandInfo>, Vec<HostHandControl>) = setup.hands.into_iter().unzip();
        let members = Members {
            info: setup.info,
            columns: setup.columns,
            limits: setup.limits,
            admissions,
            host_name: setup.name,
            roster: Roster::new(infos),
            hands: controls,
            members: BTreeMap::new(),
            scene,
            notes: VecDeque::new(),
            superseded: Vec::new(),
            served: Vec::new(),
            peer_tickets: Vec::new(),
            roster_changed: false,
            host_trouble: None,
            diagnoses: 0,
            requests: BTreeMap::new(),
            lent: BTreeMap::new(),
            is_attended: setup.is_attended,
            repairs: VecDeque::new(),
        };
        Self {
            facts: Arc::new(setup.facts),
            streams,
            links: BTreeMap::new(),
            members,
            hands,
            sender: setup.sender,
            secret: setup.secret,
            opened: Vec::new(),
            received: Vec::new(),
            payload: Vec::new(),
            refresh_at: SimTime::ZERO,
            roster_at: SimTime::ZERO,
            sketch_at: SimTime::ZERO,
            sketches: 0,
            incidents: VecDeque::new(),
            shown: VecDeque::new(),
            strangers: 0,
            now: SimTime::ZERO,
            paused_again_at: None,
        }
    }

    /// The stations, with the figures of their links.
    pub fn stations(&self) -> Vec<StationInfo> {
        self.members.roster.stations()
    }

    /// The hands, and who serves them.
    pub fn hand_infos(&self) -> &[HandInfo] {
        self.members.roster.hands()
    }

    /// What the pedals of the host's own devices say, by the numbers of their hands.
    pub fn own_pedals(&self) -> Vec<(u8, Pedals)> {
        self.members.hands.iter().map(|hand| (hand.number, hand.control.local_pedals())).collect()
    }

    /// The last second of each link.
    pub fn points(&self) -> Vec<(u16, LinkPoint)> {
        let points = self
            .members
            .members
            .iter()
            .filter_map(|(station, member)| Some((*station, *member.quality.as_ref()?.curve().last()?)));
        points.collect()
    }

    /// Connections that ended before anybody was let in.
    pub fn strangers(&self) -> u64 {
        self.strangers
    }

    /// What happened since the last call.
    pub fn take_incidents(&mut self) -> impl Iterator<Item = Incident> + '_ {
        self.incidents.drain(..)
    }

    /// What stations, or the host, show since the last call; each was sent to all stations already.
    pub fn take_notes(&mut self) -> impl Iterator<Item = AcceptedNote> + '_ {
        self.shown.drain(..)
    }

    /// The person at the host shows something, or hands an instrument over.
    ///
    /// # Errors
    /// [`Refusal`].
    pub fn show(&mut self, what: NoteKind, now: SimTime) -> Result<(), Refusal> {
        self.members.request(HOST, &RequestKind::Note(what), now)
    }

    /// What a station has shown cannot be shown, and its person is told so.
    pub fn refuse(&mut self, station: u16, refusal: Refusal) {
        let now = self.now;
        let is_its = |link: &&mut Link| {
            link.control.state() == HostState::Running
                && link.opened.is_some_and(|(_, number)| number == station)
        };
        if let Some(link) = self.links.values_mut().find(is_its) {
            told(link.control.send_refusal(refusal, now));
        }
    }

    /// Requests for instruments, by the entities of their hands.
    pub fn requests(&self) -> Vec<(Entity, TakeOverRequest)> {
        let of_hand = |info: &HandInfo| Some((info.entity, self.members.requests.get(&info.number)?.clone()));
        self.hand_infos().iter().filter_map(of_hand).collect()
    }

    /// One step: takes what has come, and sends what is due of the scene as it is now.
    pub fn step(&mut self, now: SimTime, scene: &Snapshot) {
        self.now = now;
        if self.paused_again_at.take().is_some() {
            self.go_on(now);
        }
        self.work(now, scene);
    }

    fn work(&mut self, now: SimTime, scene: &Snapshot) {
        if self.members.scene.revision() != scene.revision() {
            self.members.scene = Arc::new(scene.clone());
            self.members.tell_holding();
        }
        if now >= self.refresh_at {
            self.refresh_at = now + REFRESH_EVERY;
            self.refresh(now);
        }
        self.members.expire(now);
        self.accept(now);
        self.take_news(now);
        let diagnoses = |link: &&Link| link.control.state() == HostState::Diagnosing;
        self.members.diagnoses = self.links.values().filter(diagnoses).count();
        let streams: Vec<StreamId> = self.links.keys().copied().collect();
        for stream in streams {
            self.serve(stream, now);
        }
        self.tell_all(now);
        if self.paused_again_at.is_none() {
            self.feed(now);
        }
        if self.members.info.architecture == Architecture::PeerToPeer {
            self.repair(now);
            self.send_sketches(now);
        }
        let streams: Vec<StreamId> = self.links.keys().copied().collect();
        for stream in streams {
            self.flush(stream, now);
        }
    }

    /// The session is over, and all stations are told: to be called again and again after the last [`Self::step`], until it
    /// is true that they were told, or cannot be.
    pub fn finish(&mut self) -> bool {
        let now = self.now;
        self.links.values_mut().for_each(|link| link.control.dismiss(Goodbye::SessionOver, now));
        let streams: Vec<StreamId> = self.links.keys().copied().collect();
        streams.into_iter().for_each(|stream| self.flush(stream, now));
        // The last words of streams that are closed go out while they work; who comes now comes too late.
        self.streams.work(now, &mut self.opened);
        self.opened.drain(..).for_each(|stream| self.streams.close(stream));
        self.links.is_empty()
    }

    fn refresh(&mut self, now: SimTime) {
        self.members.host_trouble = self.members.admissions.refresh().err();
        for station in self.members.revoked() {
            let of_station = |link: &&mut Link| link.opened.is_some_and(|(_, number)| number == station);
            self.links
                .values_mut()
                .filter(of_station)
                .for_each(|link| link.control.dismiss(Goodbye::Revoked, now));
        }
    }

    fn note_incident(&mut self, at: SimTime, what: String) {
        if self.incidents.len() == INCIDENTS_MAX {
            self.incidents.pop_front();
        }
        self.incidents.push_back(Incident { at, what });
    }
}

/// A message that cannot go ends its connection, or is for a state that the connection has not reached; the machine sees
/// both at its next step.
fn told(sent: Result<(), SendError>) {
    let _ = sent;
}
