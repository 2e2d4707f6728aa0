//! The members of a session: who is in it, which scene they have, and what their hands do. It answers the questions of the
//! connections ([`HostSession`]).

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use trocar_scene::{
    Entity, Grasp, Hand, Revision, Signature, SimTime, Snapshot, TakeOverRequest, TakeOverStep,
};

use super::admissions::Admissions;
use super::carrier::Carrier;
use super::own_rows::own_rows;
use crate::annotation::hand_over;
use crate::control::{
    Admitted, Architecture, ClockSample, Credential, DIAGNOSES_MAX, Diagnosed, HandInfo, HeldScene,
    HostEvent, HostSession, LinkFigures, Note, NoteKind, NoteRefusal, PlainText, Refusal, RequestKind,
    Roster, SceneCounts, SceneKind, SceneManifest, SceneOffer, SessionInfo, TakeOver, TicketVerdict, Wish,
};
use crate::hands_link::HOST;
use crate::haptic::{LinkPoint, LinkQuality, Rate};
use crate::peers::repair::RepairRequest;
use crate::remote_hand::HandControl;
use crate::replication::choice::ReplicatedColumns;
use crate::replication::scene_feed::{FeedLimits, Resumed, SceneFeed};
use crate::ticket::{PlainName, Refused, Role, TicketId};

/// Notes that wait for the actor. More of them within a tick are refused.
pub const NOTES_MAX: usize = 256;
/// Bodies that wait for their repair.
const REPAIRS_MAX: usize = 64;
/// How long it is shown that a request was declined.
const DECLINED_SHOWN: SimTime = SimTime::from_millis(10_000);

/// A hand of the session, as the host hands it over.
#[derive(Clone, Debug)]
pub struct HostHandControl {
    /// Its number in datagrams.
    pub number: u8,
    /// Says who moves it.
    pub control: HandControl,
}

/// A station of the session.
pub(super) struct Member {
    pub ticket: TicketId,
    pub role: Role,
    pub connection: u32,
    pub feed: SceneFeed,
    /// Whether it has the scene and follows.
    pub is_running: bool,
    /// Hands for which it has devices.
    pub devices: Vec<PlainName>,
    pub moves: bool,
    pub quality: Option<LinkQuality>,
    /// What the control channel of its present connection carries.
    pub carrier: Carrier,
    pub clock: Option<ClockSample>,
    pub forbidden: u64,
    pub writes_refused: u64,
    /// Phase of the keys that it uses since the last look.
    pub rekeyed: Option<u32>,
}

/// A note that the session has accepted, for the board that shows it in the scene.
#[derive(Clone, Debug)]
pub struct AcceptedNote {
    /// The note.
    pub note: Note,
    /// Name of its author.
    pub author: PlainName,
}

/// Everything that a session knows of its stations.
pub(super) struct Members {
    pub info: SessionInfo,
    pub columns: Arc<ReplicatedColumns>,
    pub limits: FeedLimits,
    pub admissions: Box<dyn Admissions>,
    /// Name of the host itself.
    pub host_name: PlainName,
    pub roster: Roster,
    pub hands: Vec<HostHandControl>,
    pub members: BTreeMap<u16, Member>,
    /// The scene as of this tick.
    pub scene: Arc<Snapshot>,
    /// Notes for the scene and for all stations.
    pub notes: VecDeque<AcceptedNote>,
    /// Connections that a newer one of their station replaced.
    pub superseded: Vec<u32>,
    /// Hands whose server changed.
    pub served: Vec<(u8, Option<u16>)>,
    /// Tickets to pass on: from, to, bytes.
    pub peer_tickets: Vec<(u16, u16, Vec<u8>)>,
    /// Whether the roster is to be told anew.
    pub roster_changed: bool,
    pub host_trouble: Option<String>,
    /// How many diagnose their paths.
    pub diagnoses: usize,
    /// Requests for the instruments of hands: asked for, handed over, declined.
    pub requests: BTreeMap<u8, TakeOverRequest>,
    /// Hands that were handed over, and whom they go back to.
    pub lent: BTreeMap<u8, Option<u16>>,
    /// Whether a person at the host answers for hands that the host itself serves.
    pub is_attended: bool,
    /// Bodies that peers asked for: by whom, and what they have.
    pub repairs: VecDeque<(u16, RepairRequest)>,
}

impl Members {
    /// The hands that a station serves, by their numbers.
    pub fn served_by(&self, station: u16) -> impl Iterator<Item = u8> + '_ {
        let of_station = move |hand: &&HandInfo| hand.station == Some(station);
        self.roster.hands().iter().filter(of_station).map(|hand| hand.number)
    }

    /// Names to a station's feed the rows that the station writes itself, of the hands for which it has devices.
    fn exclude_own_rows(&mut self, station: u16) {
        let Some(member) = self.members.get_mut(&station) else { return };
        let has_device = |hand: &&HandInfo| member.devices.contains(&hand.name);
        let hands: Vec<Entity> =
            self.roster.hands().iter().filter(has_device).map(|hand| hand.entity).collect();
        // A station's hands have far fewer rows than a feed can leave out.
        member.feed.exclude(own_rows(&self.columns, &self.scene, &hands, member.moves));
    }

    /// Tells each hand's device whether the instrument holds something: its jaws then wait for the fingers of whoever comes.
    pub fn tell_holding(&self) {
        for (info, hand) in self.roster.hands().iter().zip(&self.hands) {
            let instrument = self.scene.get::<Hand>(info.entity).map(|hand| hand.instrument);
            let holds = instrument.is_some_and(|instrument| self.scene.get::<Grasp>(instrument).is_some());
            hand.control.set_holding(holds);
        }
    }

    /// A hand goes to another station, or back to the host.
    fn hand_over(&mut self, hand: u8, station: Option<u16>) {
        if let Some(known) = self.hands.iter().find(|known| known.number == hand) {
            match station {
                Some(station) => known.control.take(station),
                None => known.control.give_back(),
            }
        }
        self.served.push((hand, station));
        self.roster_changed = true;
    }

    /// Takes the motion of all hands that stations serve up anew, from where the hands are.
    pub fn retake_hands(&self) {
        for (info, hand) in self.roster.hands().iter().zip(&self.hands) {
            // One that was lost in a silence comes back by its station's first word.
            if info.station.is_some() && hand.control.station() == info.station {
                info.station.into_iter().for_each(|station| hand.control.take(station));
            }
        }
    }

    /// A station's connection ended; `is_over` if it left and does not come back.
    pub fn disconnected(&mut self, station: u16, connection: u32, is_over: bool, now: SimTime) {
        self.roster_changed = true;
        if let Some(member) = self.members.get_mut(&station)
            && member.connection == connection
        {
            member.is_running = false;
            self.return_hands_of(station);
        }
        if is_over {
            let hands = self.roster.leave(station, connection);
            self.left(station, connection, &hands);
        } else {
            self.roster.break_off(station, connection, now);
        }
    }

    fn left(&mut self, station: u16, connection: u32, hands: &[u8]) {
        for hand in hands {
            if let Some(known) = self.hands.iter().find(|known| known.number == *hand) {
                known.control.give_back_from(station);
            }
            self.served.push((*hand, None));
        }
        if self.members.get(&station).is_some_and(|member| member.connection == connection) {
            self.members.remove(&station);
        }
    }

    /// Lets go of stations that were away for too long, and of requests that were declined.
    pub fn expire(&mut self, now: SimTime) {
        self.requests.retain(|_, request| {
            let answered = request.answer.as_ref().map_or(now, |answer| answer.at);
            request.step != TakeOverStep::Declined || now.since(answered) < DECLINED_SHOWN
        });
        while let Some((station, hands)) = self.roster.expire(now) {
            let connection = self.members.get(&station).map_or(0, |member| member.connection);
            self.left(station, connection, &hands);
            self.roster_changed = true;
        }
    }

    /// The name of a station; the host's if none has the number.
    pub fn name_of(&self, station: u16) -> PlainName {
        let found = self.roster.stations().into_iter().find(|info| info.number == station);
        found.map_or_else(|| self.host_name.clone(), |info| info.name)
    }

    /// The phase of keys that a station uses since the last call.
    pub fn take_rekeyed(&mut self, station: u16) -> Option<u32> {
        self.members.get_mut(&station)?.rekeyed.take()
    }

    /// Stations whose ticket was withdrawn.
    pub fn revoked(&self) -> Vec<u16> {
        let is_revoked = |member: &Member| self.admissions.is_revoked(member.ticket);
        self.members.iter().filter(|(_, member)| is_revoked(member)).map(|(station, _)| *station).collect()
    }

    /// A step of handing an instrument over. Nothing is changed if it is refused.
    fn take_over(&mut self, station: u16, hand: u8, step: TakeOver, now: SimTime) -> Result<(), Refusal> {
        let Some(info) = self.roster.hands().iter().find(|info| info.number == hand).cloned() else {
            let valid = self.roster.hands().iter().map(|info| info.name.clone()).collect();
            return Err(Refusal::HandUnknown { hand: PlainText::new(hand.to_string()), valid });
        };
        if step == TakeOver::Ask && !self.has_device(station, &info.name) {
            return Err(NoteRefusal::NoDevice { hand: info.name }.into());
        }
        let by = Signature { station, name: self.name_of(station).as_str().to_owned(), at: now };
        let before = self.requests.get(&hand);
        let after = hand_over::after(before, step, by, station == HOST, &info)?;
        let was_taken = before.is_some_and(|request| request.step == TakeOverStep::Accepted);
        match &after {
            Some(request) if step == TakeOver::Accept => {
                let mentor = request.by.station;
                self.lend(&info, mentor)?;
            }
            // Asked again for what it has got.
            Some(_) if was_taken => return Ok(()),
            None if was_taken => self.return_hand(&info)?,
            _ => {}
        }
        match after {
            Some(request) => self.requests.insert(hand, request),
            None => self.requests.remove(&hand),
        };
        // Where nobody is to answer, the host agrees.
        if step == TakeOver::Ask && info.station.is_none() && !self.is_attended {
            return self.take_over(HOST, hand, TakeOver::Accept, now);
        }
        Ok(())
    }

    fn has_device(&self, station: u16, hand: &PlainName) -> bool {
        // The host has a device of each hand.
        station == HOST || self.members.get(&station).is_some_and(|member| member.devices.contains(hand))
    }

    fn lend(&mut self, info: &HandInfo, mentor: u16) -> Result<(), Refusal> {
        if let Some(station) = info.station {
            self.roster.give_hand(station, &info.name)?;
        }
        if mentor != HOST
            && let Err(refusal) = self.roster.take_hand(mentor, &info.name)
        {
            // Whoever had it keeps it.
            if let Some(station) = info.station {
                self.roster.take_hand(station, &info.name)?;
            }
            return Err(refusal);
        }
        self.lent.entry(info.number).or_insert(info.station);
        self.hand_over(info.number, owner(mentor));
        Ok(())
    }

    /// A hand goes back to whom it was taken from.
    fn return_hand(&mut self, info: &HandInfo) -> Result<(), Refusal> {
        if let Some(station) = info.station {
            self.roster.give_hand(station, &info.name)?;
        }
        let before = self.lent.remove(&info.number).flatten();
        let before = before.filter(|station| self.roster.take_hand(*station, &info.name).is_ok());
        self.hand_over(info.number, before);
        Ok(())
    }

    /// A mentor's link broke: what it had taken over goes back at once.
    fn return_hands_of(&mut self, mentor: u16) {
        self.requests.retain(|_, request| request.by.station != mentor);
        let of_mentor =
            |info: &&HandInfo| info.station == Some(mentor) && self.lent.contains_key(&info.number);
        let lent: Vec<HandInfo> = self.roster.hands().iter().filter(of_mentor).cloned().collect();
        for info in lent {
            // The mentor has the hand, so that it can be given back.
            let _ = self.return_hand(&info);
        }
    }

    fn offer_scene(&mut self, station: u16, held: Option<HeldScene>) -> Result<SceneOffer, Refusal> {
        let trouble = |error: String| Refusal::HostTrouble(PlainText::new(error));
        let Some(member) = self.members.get_mut(&station) else {
            return Err(trouble("the station is not in the session".to_owned()));
        };
        let resumed = held.filter(|held| member.feed.resume(held.revision) == Resumed::Known);
        if resumed.is_none() {
            member.feed = SceneFeed::new(self.columns.clone(), self.limits);
        }
        if held.is_some() {
            // Its own controllers run already, and what they write is not to be written by others.
            self.exclude_own_rows(station);
        }
        let Some(member) = self.members.get_mut(&station) else {
            return Err(trouble("the station is not in the session".to_owned()));
        };
        let (scene, feed) = (&self.scene, &mut member.feed);
        let told = feed.delta(self.scene.time(), scene).map_err(|error| trouble(error.to_string()))?;
        let bytes = told.unwrap_or_default();
        let hash = *blake3::hash(&bytes).as_bytes();
        let (kind, digest) = match resumed {
            Some(held) => (SceneKind::Missed { since: held.revision }, hash),
            None => (
                SceneKind::Whole,
                digest_of(&feed.digest(scene).map_err(|error| trouble(error.to_string()))?),
            ),
        };
        let revision = feed.sent_revision().unwrap_or(scene.revision());
        let (entities, rows) = feed.row_counts(scene);
        let mut info = self.info.clone();
        (info.hands, info.stations) = (self.roster.hands().to_vec(), self.roster.stations());
        Ok(SceneOffer {
            session: info,
            host_unix_secs: self.admissions.unix_secs(),
            manifest: SceneManifest {
                kind,
                revision,
                time: scene.time(),
                bytes: u32::try_from(bytes.len()).map_err(|error| trouble(error.to_string()))?,
                hash,
                counts: SceneCounts::of_rows(self.columns.registry(), entities, rows),
                digest,
            },
            scene: bytes.into(),
        })
    }
}

/// A second of a link, for the roster.
pub(super) fn figures(point: &LinkPoint, rate: Rate) -> LinkFigures {
    let micros = |millis: f64| (millis * 1e3).clamp(0.0, f64::from(u32::MAX)) as u32;
    LinkFigures {
        round_trip_us: micros(point.round_trip.unwrap_or_default()),
        jitter_us: micros(point.jitter),
        loss_ppm: (point.loss * 1e6).clamp(0.0, 1e6) as u32,
        age_us: micros(point.age.unwrap_or_default()),
        rate_hz: (point.rate.clamp(0.0, f64::from(u16::MAX)) as u16).min(rate.hz() as u16),
    }
}

/// Who serves a hand, by the number of a station that may be the host's.
fn owner(station: u16) -> Option<u16> {
    (station != HOST).then_some(station)
}

/// A digest as the manifest has it.
pub(super) fn digest_of(digest: &crate::replication::state_digest::StateDigest) -> [u8; 32] {
    let mut bytes = Vec::new();
    digest.write(&mut bytes);
    *blake3::hash(&bytes).as_bytes()
}

impl HostSession for Members {
    fn check(&mut self, credential: &Credential, wish: &Wish) -> Result<Role, Refusal> {
        if let Some(why) = &self.host_trouble {
            return Err(Refusal::HostTrouble(PlainText::new(why.as_str())));
        }
        let (station, role) = self.admissions.examine(credential)?;
        self.roster.check(station, &wish.name, &wish.hands)?;
        Ok(role)
    }

    fn admit(
        &mut self,
        credential: &Credential,
        wish: &Wish,
        role: Role,
        _: SimTime,
    ) -> Result<Admitted, Refusal> {
        let admission = self.admissions.admit(credential)?;
        let station = admission.station;
        let arrival = self.roster.arrive(station, wish.name.clone(), role);
        self.superseded.extend(arrival.superseded);
        self.roster_changed = true;
        let before: Vec<u8> = self.served_by(station).collect();
        for hand in &wish.hands {
            let number = self.roster.take_hand(station, hand)?;
            if !before.contains(&number) {
                self.hand_over(number, Some(station));
            }
        }
        let connection = arrival.connection;
        let feed = SceneFeed::new(self.columns.clone(), self.limits);
        let member = self.members.entry(station).or_insert_with(|| Member {
            ticket: admission.ticket,
            role,
            connection,
            feed,
            is_running: false,
            devices: Vec::new(),
            moves: wish.moves,
            quality: None,
            carrier: Carrier::default(),
            clock: None,
            forbidden: 0,
            writes_refused: 0,
            rekeyed: None,
        });
        (member.role, member.connection, member.moves) = (role, connection, wish.moves);
        (member.is_running, member.devices) = (false, wish.devices.clone());
        member.carrier = Carrier::default();
        Ok(Admitted { station, connection, role })
    }

    fn diagnose(&mut self, credential: &Credential) -> Result<Diagnosed, Refusal> {
        if let Some(why) = &self.host_trouble {
            return Err(Refusal::HostTrouble(PlainText::new(why.as_str())));
        }
        let ticket = match self.admissions.examine(credential) {
            Ok((_, role)) => TicketVerdict::LetsIn(role),
            Err(Refusal::Ticket(Refused::Spent { at })) => TicketVerdict::Spent { at },
            Err(refusal) => return Err(refusal),
        };
        if self.diagnoses >= DIAGNOSES_MAX {
            let text = format!("{DIAGNOSES_MAX} others diagnose their paths; try again in half a minute");
            return Err(Refusal::HostTrouble(PlainText::new(text)));
        }
        self.diagnoses += 1;
        let connection = self.roster.next_connection();
        Ok(Diagnosed { connection, ticket, host_unix_secs: self.admissions.unix_secs() })
    }

    fn offer(&mut self, admitted: &Admitted, held: Option<HeldScene>) -> Result<SceneOffer, Refusal> {
        self.offer_scene(admitted.station, held)
    }

    fn request(&mut self, station: u16, what: &RequestKind, now: SimTime) -> Result<(), Refusal> {
        match what {
            RequestKind::TakeHand(hand) => {
                let number = self.roster.take_hand(station, hand)?;
                self.hand_over(number, Some(station));
            }
            RequestKind::GiveHand(hand) => {
                let number = self.roster.give_hand(station, hand)?;
                self.hand_over(number, None);
            }
            RequestKind::Note(what) => {
                if self.notes.len() >= NOTES_MAX {
                    let text = "too many notes at once; some were not shown";
                    return Err(Refusal::HostTrouble(PlainText::new(text)));
                }
                if let NoteKind::TakeOver { hand, step } = what {
                    self.take_over(station, *hand, *step, now)?;
                }
                let note = Note { station, at: now, what: what.clone() };
                self.notes.push_back(AcceptedNote { note, author: self.name_of(station) });
            }
            RequestKind::Repair(asked) => {
                if self.info.architecture != Architecture::PeerToPeer {
                    let text = "only peers repair bodies: here the host computes them";
                    return Err(Refusal::HostTrouble(PlainText::new(text)));
                }
                if self.repairs.len() >= REPAIRS_MAX {
                    let text = "too many bodies to repair at once; ask again";
                    return Err(Refusal::HostTrouble(PlainText::new(text)));
                }
                self.repairs.push_back((station, asked.clone()));
            }
            RequestKind::PeerTicket { to, ticket } => {
                self.peer_tickets.push((station, *to, ticket.clone()));
            }
        }
        Ok(())
    }

    fn hear(&mut self, station: u16, event: HostEvent<'_>) {
        let Some(member) = self.members.get_mut(&station) else { return };
        match event {
            HostEvent::Joined(Revision(_)) => {
                member.is_running = true;
                self.exclude_own_rows(station);
            }
            HostEvent::Write(_) => member.writes_refused += 1,
            HostEvent::Forbidden(_) => member.forbidden += 1,
            HostEvent::Clock(sample) => member.clock = Some(sample),
            HostEvent::Rekeyed(phase) => member.rekeyed = Some(phase),
            HostEvent::Carried { hears, taken, datagram } => member.carrier.arrived(hears, taken, datagram),
        }
    }
}
