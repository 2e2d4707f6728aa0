//! The network's actor at a host: steps the machine, and shows in the scene who is there.

use std::collections::BTreeMap;

use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Entity, EntitySet, Grasp, Hand, LinkState,
    Snapshot, Station, StationRole, Tick,
};

use super::host_machine::HostMachine;
use super::host_members::AcceptedNote;
use super::machine_slot::HeldMachine;
use crate::annotation::{AnnotationBoard, Author};
use crate::control::StationInfo;
use crate::hands_link::HOST;
use crate::haptic::LinkPoint;
use crate::ticket::Role;

/// The network's actor at a host.
pub struct HostController<A> {
    machine: HeldMachine<HostMachine<A>>,
    is_protected: bool,
    board: AnnotationBoard,
    /// The entity of each station.
    shown: BTreeMap<u16, Entity>,
}

impl<A: Copy + PartialEq + Send + 'static> HostController<A> {
    /// Carries the machine of the session.
    pub fn new(context: &BuildContext<'_>, machine: HeldMachine<HostMachine<A>>, is_protected: bool) -> Self {
        // An earlier life has created entities for the stations.
        let shown = context.scene.iter::<Station>().map(|(entity, station)| (station.number, entity));
        let board = AnnotationBoard::of(context.scene);
        Self { machine, is_protected, board, shown: shown.collect() }
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
                self.board.leave(*number, out);
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

/// A role, as the scene shows it.
pub(super) fn role(role: Role) -> StationRole {
    match role {
        Role::Operate => StationRole::Operate,
        Role::Mentor => StationRole::Mentor,
        Role::Watch => StationRole::Watch,
    }
}

impl<A: Copy + PartialEq + Send + 'static> Controller for HostController<A> {
    fn access(&self) -> Access {
        AnnotationBoard::access(
            Access::new().reads::<Hand>().reads::<Grasp>().writes::<Station>(EntitySet::Own),
        )
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let (stations, notes) = self.machine.work(|machine| {
            machine.step(tick.time, scene);
            for incident in machine.take_incidents() {
                tracing::info!("{}", incident.what);
            }
            (machine.stations(), machine.take_notes().collect::<Vec<_>>())
        });
        for AcceptedNote { note, author, hands } in &notes {
            let author = Author { name: author, is_host: note.station == HOST };
            if let Err(refusal) = self.board.apply(note, author, hands, scene, out) {
                tracing::info!("a note of {} is not shown: {refusal}", author.name);
            }
        }
        self.show(stations, scene, out);
        self.board.follow(scene, out);
        Ok(())
    }
}
