//! The network's actor at a station: steps the machine, and writes what comes from the host into the station's scene.

use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, SimTime, Snapshot, Station, Tick,
};

use super::machine_slot::HeldMachine;
use super::station_machine::{StationError, StationMachine, StationNews};
use crate::annotation::{DeskOwner, MentorDesk};
use crate::control::{ClientState, RequestKind};

/// Time between two rows of the station's own link.
const ROW_EVERY: SimTime = SimTime::from_millis(1_000);

/// The network's actor at a station.
pub struct StationController<A> {
    machine: HeldMachine<StationMachine<A>>,
    row_at: SimTime,
    /// Of the station's own person.
    desk: MentorDesk,
}

impl<A: Copy + PartialEq + Send + 'static> StationController<A> {
    /// Carries the machine of the session.
    pub fn new(context: &BuildContext<'_>, machine: HeldMachine<StationMachine<A>>) -> Self {
        let desk = MentorDesk::of(context.scene, context.me);
        Self { machine, row_at: context.time, desk }
    }
}

/// Tells the host what the station's own person shows and asks for.
fn show_own<A: Copy + PartialEq + Send + 'static>(
    machine: &mut StationMachine<A>,
    desk: &mut MentorDesk,
    now: SimTime,
    scene: &Snapshot,
) {
    let Some(welcome) = machine.welcome() else { return };
    let hands = welcome.session.hands.clone();
    let is_heard = machine.state() == ClientState::Running;
    let role = Some(welcome.role);
    let owner = DeskOwner { station: welcome.station, role, is_heard, hands: &hands, pedals: &[] };
    for note in desk.take(now, scene, &owner) {
        if let Err(error) = machine.request(RequestKind::Note(note), now) {
            desk.refuse(now, &error);
        }
    }
}

impl<A: Copy + PartialEq + Send + 'static> Controller for StationController<A> {
    fn access(&self) -> Access {
        MentorDesk::access(Access::new().replicates().repairs().contributes::<Station>())
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let (now, desk) = (tick.time, &mut self.desk);
        let (stepped, row) = self.machine.work(|machine| {
            show_own(machine, desk, now, scene);
            let stepped = machine.step(now, scene, out);
            for news in machine.take_news() {
                match news {
                    StationNews::Paused(true) => tracing::warn!("the host has paused the session"),
                    StationNews::Paused(false) => tracing::warn!("the session goes on"),
                    StationNews::Away(why) => tracing::warn!("away from the host: {why}"),
                    StationNews::Carried(true) => {
                        tracing::warn!(
                            "datagrams do not arrive at the host: hands go over TCP, 100 times a second"
                        );
                    }
                    StationNews::Carried(false) => tracing::info!("datagrams arrive at the host again"),
                    StationNews::Back => tracing::info!("back at the host"),
                    StationNews::Refused(refusal) => {
                        tracing::warn!("the host refused: {refusal}");
                        desk.refuse(now, &refusal);
                    }
                    StationNews::Note(_) => {}
                    StationNews::Repaired(body) => {
                        tracing::info!("{} differed from its owner's, and was repaired", scene.name(body));
                        out.event("repaired", body, None, 0.0);
                    }
                }
            }
            (stepped, machine.row())
        });
        self.desk.show(tick.me, out);
        if tick.time >= self.row_at {
            self.row_at = tick.time + ROW_EVERY;
            out.put(tick.me, row);
        }
        match stepped {
            // Whoever runs the session ends it; to make the machine again would not help.
            Err(StationError::Over(error)) if error.is_final() => Ok(()),
            other => other.map_err(|error| ControllerError::Failed(error.to_string())),
        }
    }

    fn rest(&mut self, passed: SimTime, _: &Snapshot) {
        self.machine.work(|machine| machine.rest(passed));
    }
}
