//! The machine of a host: all its connections, and what they need of the scene. It is stepped by one actor.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use trocar_devices::Pedals;
use trocar_scene::{Entity, SimTime, Snapshot, TakeOverRequest};

use super::admissions::Admissions;
use super::host_members::{AcceptedNote, HostHandControl, Member, Members, NOTES_MAX, figures};
use crate::control::{
    Architecture, ControlError, Goodbye, HandInfo, HostControl, HostFacts, HostSession, HostState, NoteKind,
    PACE_BYTES, Refusal, RequestKind, Roster, SendError, SessionInfo, StationInfo,
};
use crate::datagram::{Kind, Side};
use crate::diagnosis::EchoEnd;
use crate::hands_link::{
    Connection, ControllerEnd, HOST, HandNumbers, HandsNews, HandsOrder, ORDERS_MAX, Parcel,
};
use crate::haptic::{LinkPoint, LinkQuality, SenderConfig};
use crate::peers::comparison::SKETCH_EVERY;
use crate::peers::{repair, sketch};
use crate::replication::choice::ReplicatedColumns;
use crate::replication::pieces;
use crate::replication::scene_feed::FeedLimits;
use crate::streams::{HostStreams, StreamId};
use crate::ticket::PlainName;

/// Bytes taken from one stream at a tick.
const TAKEN_MAX: usize = 64 << 10;
/// Datagrams of rows for one station at a tick.
const DATAGRAMS_MAX: usize = 32;
/// The same while the control channel carries them.
const CARRIED_DATAGRAMS_MAX: usize = 4;
/// Places of the ring of orders that rows leave free.
const ORDERS_KEPT: usize = ORDERS_MAX / 4;
/// Time between two looks at what others changed in the tickets.
const REFRESH_EVERY: SimTime = SimTime::from_millis(1_000);
/// Time between two rosters with new figures of the links.
const ROSTER_EVERY: SimTime = SimTime::from_millis(1_000);
/// Time between two words that the session is paused.
const PAUSED_EVERY: SimTime = SimTime::from_millis(1_000);
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

    /// The session is paused: its time stands still at that of the last step, and stations that are told so stand still as
    /// well. What comes is answered, so that nobody takes the host for gone, and whoever joins gets in; nothing expires.
    /// `passed` is how long the pause has lasted.
    pub fn rest(&mut self, passed: SimTime, scene: &Snapshot) {
        let now = self.now;
        let is_due = self.paused_again_at.is_none_or(|at| passed >= at);
        if is_due {
            self.paused_again_at = Some(passed + PAUSED_EVERY);
        }
        let running = |link: &&mut Link| link.control.state() == HostState::Running;
        for link in self.links.values_mut().filter(running).filter(|link| is_due || !link.is_paused) {
            link.is_paused = true;
            told(link.control.send_paused(true, now));
        }
        self.work(now, scene);
    }

    /// The session goes on after a pause. Hands that stations serve stand where they are until their stations have brought
    /// their own there.
    fn go_on(&mut self, now: SimTime) {
        for link in self.links.values_mut().filter(|link| link.is_paused) {
            link.is_paused = false;
            told(link.control.send_paused(false, now));
        }
        self.members.retake_hands();
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

    fn accept(&mut self, now: SimTime) {
        self.streams.work(now, &mut self.opened);
        for stream in self.opened.drain(..) {
            let control = HostControl::new(self.facts.clone(), now);
            let link = Link {
                control,
                opened: None,
                is_echoed: false,
                pieces: VecDeque::new(),
                is_told: false,
                is_paused: false,
            };
            self.links.insert(stream, link);
        }
    }

    /// Takes what one stream has brought.
    fn serve(&mut self, stream: StreamId, now: SimTime) {
        let Some(link) = self.links.get_mut(&stream) else { return };
        self.received.clear();
        let received = self.streams.receive(stream, now, TAKEN_MAX, &mut self.received);
        link.control.receive(&self.received, now, &mut self.members);
        if let Err(closed) = received {
            link.control.broke(&closed.0, now);
        }
        let admitted = link.control.admitted().copied();
        let admitted = admitted.filter(|_| link.opened.is_none() && link.control.state() != HostState::Ended);
        if let Some(admitted) = admitted {
            link.opened = Some((admitted.connection, admitted.station));
        }
        let diagnosed = link.control.diagnosed().filter(|_| !link.is_echoed);
        link.is_echoed |= diagnosed.is_some();
        let opened = link.opened;
        if let Some(id) = diagnosed {
            self.echo(stream, id, now);
        }
        if let Some(admitted) = admitted {
            self.open(stream, admitted.connection, admitted.station, now);
        }
        if let Some((id, station)) = opened
            && let Some(phase) = self.members.take_rekeyed(station)
            && let Some(keys) = self.streams.keys(stream, id, phase)
        {
            let (key, _) = keys.split(Side::Server);
            self.hands.order(HandsOrder::RekeySealer { connection: id, key });
        }
        if let Some((connection, station)) = opened {
            self.take_carried(connection, station, now);
        }
        let superseded = std::mem::take(&mut self.members.superseded);
        for connection in superseded {
            let of_connection = |link: &&mut Link| link.opened.is_some_and(|(id, _)| id == connection);
            self.links
                .values_mut()
                .filter(of_connection)
                .for_each(|link| link.control.dismiss(Goodbye::Superseded, now));
        }
    }

    /// Gives the hands link what a station's control channel carried.
    fn take_carried(&mut self, connection: u32, station: u16, now: SimTime) {
        let Some(member) = self.members.members.get_mut(&station) else { return };
        if member.connection != connection {
            return;
        }
        if let Some(is_heard) = member.carrier.take_heard() {
            self.hands.order(HandsOrder::Heard { connection, is_heard });
            let name = self.members.name_of(station);
            let what = if is_heard { "arrive by themselves again" } else { "are carried over TCP" };
            self.note_incident(now, format!("{name}: datagrams {what}"));
        }
        let Some(member) = self.members.members.get_mut(&station) else { return };
        while let Some(datagram) = member.carrier.take_arrived() {
            // Without room it is lost, as on a path.
            self.hands.order(HandsOrder::Carried { connection, datagram });
        }
    }

    /// Has the datagrams of a diagnosis echoed.
    fn echo(&mut self, stream: StreamId, id: u32, now: SimTime) {
        let keys = self.streams.keys(stream, id, 0);
        let echo = keys.map(|keys| HandsOrder::Echo(Box::new(EchoEnd::new(id, keys))));
        let is_open = echo.is_some_and(|echo| self.hands.order(echo));
        if !is_open && let Some(link) = self.links.get_mut(&stream) {
            link.control.broke("no keys for its datagrams", now);
        }
    }

    /// Gives a connection's datagrams their keys, and its hands.
    fn open(&mut self, stream: StreamId, id: u32, station: u16, now: SimTime) {
        let hands = HandNumbers::new(self.members.served_by(station));
        let secret = self.secret ^ u64::from(id).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        let connection = self
            .streams
            .keys(stream, id, 0)
            .and_then(|keys| {
                Connection::new(id, keys, Side::Server, hands.as_slice(), &self.sender, secret).ok()
            })
            .map(Box::new);
        let Some(connection) = connection else {
            if let Some(link) = self.links.get_mut(&stream) {
                link.control.broke("no keys for its datagrams", now);
            }
            return;
        };
        let quality = LinkQuality::new(connection.meter().histograms().clone());
        let name = self.members.name_of(station);
        self.streams.admitted(stream, id, station, name.as_str());
        let is_open = self.hands.order(HandsOrder::Open { station, connection, peer: None })
            && self.hands.order(HandsOrder::Serve { connection: id, hands });
        if let Some(member) = self.members.members.get_mut(&station) {
            member.quality = Some(quality);
        }
        if !is_open && let Some(link) = self.links.get_mut(&stream) {
            link.control.broke("the link of hands is overloaded", now);
        }
    }

    fn take_news(&mut self, now: SimTime) {
        while let Some(news) = self.hands.next_news() {
            match news {
                HandsNews::Arrived { connection, parcel, .. } if parcel.kind() == Kind::RowAcks => {
                    let member = self.member_of(connection);
                    // What a station acknowledges without having got it is counted by its feed and has no effect.
                    let _ = member.map(|member| member.feed.acknowledge(now, parcel.payload()));
                }
                HandsNews::Arrived { .. } => {}
                HandsNews::Second { connection, point, rate } => {
                    let station = self.station_of(connection);
                    if let Some(quality) =
                        self.member_of(connection).and_then(|member| member.quality.as_mut())
                    {
                        quality.take(&point);
                    }
                    if let Some(station) = station {
                        self.members.roster.set_link(station, figures(&point, rate));
                    }
                }
                HandsNews::Carry { connection, datagram } => {
                    if let Some(member) = self.member_of(connection) {
                        member.carrier.carry(datagram);
                    }
                }
                HandsNews::Hears { connection, hears } => {
                    if let Some(member) = self.member_of(connection) {
                        member.carrier.hears(hears);
                    }
                }
                HandsNews::Worn { connection } => self.rekey(connection, now),
                HandsNews::Closed(connection) => drop(connection),
                HandsNews::Echoed { connection, counts } => {
                    let of = |link: &&mut Link| link.control.diagnosed() == Some(connection);
                    if let Some(link) = self.links.values_mut().find(of) {
                        told(link.control.send_echoed(counts, now));
                    }
                }
                HandsNews::EchoEnded(echo) => drop(echo),
            }
        }
    }

    fn station_of(&self, connection: u32) -> Option<u16> {
        let of = |(_, member): &(&u16, &Member)| member.connection == connection;
        self.members.members.iter().find(of).map(|(station, _)| *station)
    }

    fn member_of(&mut self, connection: u32) -> Option<&mut Member> {
        self.members.members.values_mut().find(|member| member.connection == connection)
    }

    /// Begins the next phase of a connection's keys: the other side's first, so that this end can open what it seals.
    fn rekey(&mut self, connection: u32, now: SimTime) {
        let found =
            self.links.iter_mut().find(|(_, link)| link.opened.is_some_and(|(id, _)| id == connection));
        let Some((stream, link)) = found else { return };
        let Ok(phase) = link.control.rekey(now) else { return };
        if let Some(keys) = self.streams.keys(*stream, connection, phase) {
            let (_, key) = keys.split(Side::Server);
            self.hands.order(HandsOrder::RekeyOpener { connection, key });
        }
    }

    /// Tells all stations who is there, who serves which hand, and what is shown.
    fn tell_all(&mut self, now: SimTime) {
        let served = std::mem::take(&mut self.members.served);
        let notes: Vec<AcceptedNote> = self.members.notes.drain(..).collect();
        let peers = std::mem::take(&mut self.members.peer_tickets);
        if self.members.roster_changed || now >= self.roster_at {
            self.roster_at = now + ROSTER_EVERY;
            self.members.roster_changed = false;
            let stations = self.members.roster.stations();
            for link in self.links.values_mut() {
                told(link.control.send_roster(stations.clone(), now));
            }
        }
        for link in self.links.values_mut() {
            for (hand, station) in &served {
                told(link.control.send_hand_served(*hand, *station, now));
            }
            for note in &notes {
                told(link.control.send_note(note.note.clone(), now));
            }
            for (from, to, ticket) in &peers {
                if link.opened.is_some_and(|(_, station)| station == *to) {
                    told(link.control.send_peer_ticket(*from, ticket.clone(), now));
                }
            }
        }
        let room = NOTES_MAX.saturating_sub(self.shown.len());
        self.shown.extend(notes.into_iter().take(room));
        if !served.is_empty() {
            let links: Vec<(u32, u16)> = self.links.values().filter_map(|link| link.opened).collect();
            for (connection, station) in links {
                let hands = HandNumbers::new(self.members.served_by(station));
                self.hands.order(HandsOrder::Serve { connection, hands });
            }
        }
    }

    /// Sends what has changed to each station that follows.
    fn feed(&mut self, now: SimTime) {
        let Self { links, members, hands, payload, .. } = self;
        let scene = members.scene.clone();
        for link in links.values_mut().filter(|link| link.control.state() == HostState::Running) {
            let Some((connection, station)) = link.opened else { continue };
            let Some(member) = members.members.get_mut(&station) else { continue };
            if member.connection != connection {
                continue;
            }
            if link.pieces.is_empty() {
                match member.feed.delta(now, &scene) {
                    Ok(Some(delta)) => link.pieces.extend(pieces::split(&delta)),
                    Ok(None) => {}
                    Err(error) => link.control.broke(&error.to_string(), now),
                }
            }
            // One piece at a time, so that pings and notes wait behind no more than that.
            while link.control.outgoing().len() < PACE_BYTES {
                let Some(piece) = link.pieces.pop_front() else { break };
                told(link.control.send_delta(&piece, now));
            }
            let is_carrying = member.carrier.is_carrying();
            for _ in 0..if is_carrying { CARRIED_DATAGRAMS_MAX } else { DATAGRAMS_MAX } {
                if is_carrying && !member.carrier.has_room(link.control.outgoing().len()) {
                    break;
                }
                // Rows leave room for orders that must not be lost.
                if hands.room() <= ORDERS_KEPT || !member.feed.datagram(now, &scene, payload) {
                    break;
                }
                if let Some(parcel) = Parcel::new(Kind::Rows, payload) {
                    hands.order(HandsOrder::Send { connection, parcel });
                }
            }
        }
    }

    /// Sends peers the rows of bodies that they asked for.
    fn repair(&mut self, now: SimTime) {
        while let Some((station, asked)) = self.members.repairs.pop_front() {
            let Some(answer) = repair::answer(&self.members.scene, &self.members.columns, &asked) else {
                continue;
            };
            let of_station = |link: &&mut Link| link.opened.is_some_and(|(_, number)| number == station);
            if let Some(link) = self.links.values_mut().find(of_station) {
                told(link.control.send_repair(&answer, now));
                let what = self.members.scene.name(asked.entity);
                let name = self.members.name_of(station);
                self.note_incident(now, format!("{name}: {what} was repaired, {} bytes", answer.len()));
            }
        }
    }

    /// Tells peers how the bodies are, so that each compares them with its own.
    fn send_sketches(&mut self, now: SimTime) {
        if now < self.sketch_at {
            return;
        }
        self.sketch_at = now + SKETCH_EVERY;
        self.sketches += 1;
        let running = self.links.values().filter(|link| link.control.state() == HostState::Running);
        let connections: Vec<u32> = running.filter_map(|link| Some(link.opened?.0)).collect();
        if connections.is_empty() {
            return;
        }
        let (scene, number) = (&self.members.scene, self.sketches);
        let sketches: Vec<_> =
            sketch::bodies(scene).into_iter().flat_map(|body| sketch::of(scene, body, number)).collect();
        for payload in sketch::write(number, &sketches) {
            let Some(parcel) = Parcel::new(Kind::Sketch, &payload) else { continue };
            for &connection in &connections {
                // What has no room is in the next sketch.
                if self.hands.room() > ORDERS_KEPT {
                    self.hands.order(HandsOrder::Send { connection, parcel: parcel.clone() });
                }
            }
        }
    }

    /// Moves what waits into the stream, and lets go of a connection that is over.
    fn flush(&mut self, stream: StreamId, now: SimTime) {
        let Some(link) = self.links.get_mut(&stream) else { return };
        send_carried(link, &mut self.members, now);
        let mut poll = link.control.poll(now);
        while !link.control.outgoing().is_empty() {
            match self.streams.send(stream, now, link.control.outgoing()) {
                Ok(0) => break,
                Ok(count) => {
                    link.control.advance(count, now);
                    poll = link.control.poll(now);
                }
                Err(closed) => {
                    link.control.broke(&closed.0, now);
                    poll = link.control.poll(now);
                }
            }
        }
        let ended = link.control.state() == HostState::Ended;
        if ended && !link.is_told {
            link.is_told = true;
            self.ended(stream, now);
        }
        if poll.is_over {
            self.streams.close(stream);
            self.links.remove(&stream);
        }
    }

    fn ended(&mut self, stream: StreamId, now: SimTime) {
        let Some(link) = self.links.get(&stream) else { return };
        let error = link.control.error().cloned();
        let text = error.as_ref().map_or_else(String::new, ToString::to_string);
        if let Some(connection) = link.control.diagnosed() {
            self.hands.order(HandsOrder::Close { connection });
            self.note_incident(now, "somebody with a ticket has looked at the path".to_owned());
            return;
        }
        let Some((connection, station)) = link.opened else {
            self.strangers += 1;
            if matches!(error, Some(ControlError::Refused { .. })) {
                self.note_incident(now, format!("a station was not let in: {text}"));
            }
            return;
        };
        self.hands.order(HandsOrder::Close { connection });
        let is_over = error.as_ref().is_some_and(|error| !error.is_of_the_link());
        let name = self.stations().into_iter().find(|info| info.number == station).map(|info| info.name);
        let is_superseded = matches!(error, Some(ControlError::Ended(Goodbye::Superseded)));
        self.members.disconnected(station, connection, is_over && !is_superseded, now);
        if let Some(name) = name.filter(|_| !is_superseded) {
            let what = if is_over { "has left" } else { "is away" };
            self.note_incident(now, format!("{name} {what}: {text}"));
        }
    }

    fn note_incident(&mut self, at: SimTime, what: String) {
        if self.incidents.len() == INCIDENTS_MAX {
            self.incidents.pop_front();
        }
        self.incidents.push_back(Incident { at, what });
    }
}

/// Puts what a station's control channel is to carry into it.
fn send_carried(link: &mut Link, members: &mut Members, now: SimTime) {
    let Link { control, opened: Some((connection, station)), .. } = link else { return };
    let member = members.members.get_mut(station).filter(|member| member.connection == *connection);
    let Some(member) = member.filter(|_| control.state() == HostState::Running) else { return };
    for _ in 0..DATAGRAMS_MAX {
        let (round_trip, waiting) = (control.round_trip(), control.outgoing().len());
        let Some(frame) = member.carrier.next(round_trip, control.has_urgent(), waiting, now) else { break };
        told(control.send_carried(frame.message(), frame.is_urgent, now).map(|_| ()));
    }
}

/// A message that cannot go ends its connection, or is for a state that the connection has not reached; the machine sees
/// both at its next step.
fn told(sent: Result<(), SendError>) {
    let _ = sent;
}
