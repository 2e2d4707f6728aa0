//! The network's actor at a station: steps the machine, and writes what comes from the host into the station's scene.

use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, SimTime, Snapshot, Station, Tick,
};

use super::machine_slot::HeldMachine;
use super::station_machine::{StationMachine, StationNews};

/// Time between two rows of the station's own link.
const ROW_EVERY: SimTime = SimTime::from_millis(1_000);

/// The network's actor at a station.
pub struct StationController<A> {
    machine: HeldMachine<StationMachine<A>>,
    row_at: SimTime,
}

impl<A: Copy + PartialEq + Send + 'static> StationController<A> {
    /// Carries the machine of the session.
    pub fn new(context: &BuildContext<'_>, machine: HeldMachine<StationMachine<A>>) -> Self {
        Self { machine, row_at: context.time }
    }
}

impl<A: Copy + PartialEq + Send + 'static> Controller for StationController<A> {
    fn access(&self) -> Access {
        Access::new().replicates().contributes::<Station>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let (stepped, row) = self.machine.work(|machine| {
            let stepped = machine.step(tick.time, scene, out);
            for news in machine.take_news() {
                match news {
                    StationNews::Away(why) => tracing::warn!("away from the host: {why}"),
                    StationNews::Carried(true) => {
                        tracing::warn!(
                            "datagrams do not arrive at the host: hands go over TCP, 100 times a second"
                        );
                    }
                    StationNews::Carried(false) => tracing::info!("datagrams arrive at the host again"),
                    StationNews::Back => tracing::info!("back at the host"),
                    StationNews::Refused(refusal) => tracing::warn!("the host refused: {refusal}"),
                    StationNews::Note(_) => {}
                }
            }
            (stepped, machine.row())
        });
        if tick.time >= self.row_at {
            self.row_at = tick.time + ROW_EVERY;
            out.put(tick.me, row);
        }
        stepped.map_err(|error| ControllerError::Failed(error.to_string()))
    }
}
