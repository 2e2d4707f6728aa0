//! The network's actor at a host: steps the machine, and shows in the scene who is there.

use std::collections::BTreeMap;

use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Entity, EntitySet, Grasp, LinkState,
    SimTime, Snapshot, Station, Tick,
};

use super::host_machine::HostMachine;
use super::host_members::AcceptedNote;
use super::machine_slot::HeldMachine;
pub(super) use crate::annotation::shown_role as role;
use crate::annotation::{AnnotationBoard, Author, DeskOwner, MentorDesk};
use crate::control::{NoteKind, StationInfo};
use crate::hands_link::HOST;
use crate::haptic::LinkPoint;

/// The network's actor at a host.
pub struct HostController<A> {
    machine: HeldMachine<HostMachine<A>>,
    is_protected: bool,
    board: AnnotationBoard,
    /// Of the host's own person.
    desk: MentorDesk,
    /// The entity of each station.
    shown: BTreeMap<u16, Entity>,
}

impl<A: Copy + PartialEq + Send + 'static> HostController<A> {
    /// Carries the machine of the session.
    pub fn new(context: &BuildContext<'_>, machine: HeldMachine<HostMachine<A>>, is_protected: bool) -> Self {
        // An earlier life has created entities for the stations.
        let shown = context.scene.iter::<Station>().map(|(entity, station)| (station.number, entity));
        let board = AnnotationBoard::of(context.scene);
        let desk = MentorDesk::of(context.scene, context.me);
        Self { machine, is_protected, board, desk, shown: shown.collect() }
    }

    /// What the person at the host shows and asks for.
    fn serve_own_person(&mut self, now: SimTime, scene: &Snapshot) {
        let desk = &mut self.desk;
        self.machine.work(|machine| {
            let (hands, pedals) = (machine.hand_infos().to_vec(), machine.own_pedals());
            let owner =
                DeskOwner { station: HOST, role: None, is_heard: true, hands: &hands, pedals: &pedals };
            for note in desk.take(now, scene, &owner) {
                if let Err(refusal) = machine.show(note, now) {
                    desk.refuse(now, &refusal);
                }
            }
        });
    }

    fn show(&mut self, stations: Vec<StationInfo>, scene: &Snapshot, out: &mut Commands) {
        let points = self.machine.work(|machine| machine.points());
        let names = self.machine.work(|machine| {
            let named = |hand: &crate::control::HandInfo| (hand.number, hand.name.as_str().to_owned());
            machine.hand_infos().iter().map(named).collect::<BTreeMap<u8, String>>()
        });
        self.shown.retain(|number, entity| {
            let is_there = stations.iter().any(|station| station.number == *number);
            if !is_there {
                self.board.leave(*number);
                out.event("station_left", *entity, None, f64::from(*number));
                out.despawn(*entity);
            }
            is_there
        });
        for info in stations {
            let point = points.iter().find(|(station, _)| *station == info.number);
            let link = point.map_or_else(LinkState::default, |(_, point)| state(point));
            let row = Station {
                number: info.number,
                name: info.name.as_str().to_owned(),
                role: role(info.role),
                here: info.is_here,
                hands: info.hands.iter().filter_map(|hand| names.get(hand).cloned()).collect(),
                protected: self.is_protected,
                link,
            };
            let entity = *self.shown.entry(info.number).or_insert_with(|| {
                let entity = out.spawn();
                out.event("station_joined", entity, None, f64::from(info.number));
                entity
            });
            let before = scene.get::<Station>(entity);
            if let Some(before) = before.filter(|before| before.here != row.here) {
                let what = if before.here { "station_away" } else { "station_back" };
                out.event(what, entity, None, f64::from(info.number));
            }
            if before != Some(&row) {
                out.put(entity, row);
            }
        }
    }
}

/// A second of a link, as the scene shows it.
pub(super) fn state(point: &LinkPoint) -> LinkState {
    LinkState {
        round_trip: point.round_trip.unwrap_or_default() * 1e-3,
        jitter: point.jitter * 1e-3,
        loss: point.loss,
        age: point.age.unwrap_or_default() * 1e-3,
        rate: point.rate,
        bytes_received: point.bytes_received,
        bytes_sent: point.bytes_sent,
        over_tcp: point.is_carried,
    }
}

impl<A: Copy + PartialEq + Send + 'static> Controller for HostController<A> {
    fn access(&self) -> Access {
        let access = Access::new().reads::<Grasp>().writes::<Station>(EntitySet::Own);
        MentorDesk::access(AnnotationBoard::access(access))
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let now = tick.time;
        self.serve_own_person(now, scene);
        let (stations, notes, requests) = self.machine.work(|machine| {
            machine.step(now, scene);
            for incident in machine.take_incidents() {
                tracing::info!("{}", incident.what);
            }
            (machine.stations(), machine.take_notes().collect::<Vec<_>>(), machine.requests())
        });
        for AcceptedNote { note, author } in &notes {
            let is_host = note.station == HOST;
            let applied = self.board.apply(note, Author { name: author, is_host }, scene, out);
            let Err(refusal) = applied else { continue };
            // A pointer that is nowhere will soon be somewhere else.
            let is_pointer = matches!(note.what, NoteKind::Pointer(_));
            tracing::debug!("a note of {author} is not shown: {refusal}");
            match is_host {
                _ if is_pointer => {}
                true => self.desk.refuse(now, &refusal),
                false => self.machine.work(|machine| machine.refuse(note.station, refusal)),
            }
        }
        self.board.show_requests(requests.into_iter(), scene, out);
        self.desk.show(tick.me, out);
        self.show(stations, scene, out);
        self.board.follow(scene, out);
        Ok(())
    }

    fn rest(&mut self, passed: SimTime, scene: &Snapshot) {
        self.machine.work(|machine| {
            machine.rest(passed, scene);
            for incident in machine.take_incidents() {
                tracing::info!("{}", incident.what);
            }
        });
    }
}
