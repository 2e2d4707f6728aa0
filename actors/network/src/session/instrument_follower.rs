//! Instruments at a station that follow their hands at once, where the hands come from their stations directly and the scene
//! from a server.
//!
//! The server's instruments are as old as its path, and those of others as two paths. What hands do is known sooner: each
//! instrument is where its hand has it, or where the station's own touch stops it above a wall. What it does to the scene is
//! the server's, and comes later.

use trocar_scene::{
    Access, BuildContext, Commands, Controller, ControllerError, Entity, EntitySet, Hand, InstrumentTarget,
    Pose, Revision, Snapshot, StationContactModel, Tick, Velocity,
};

/// Moves the instruments of all hands.
pub struct InstrumentFollower {
    instruments: Vec<Entity>,
    seen: Revision,
}

impl InstrumentFollower {
    /// Follows the hands of the scene.
    pub fn new(context: &BuildContext<'_>) -> Self {
        let instruments = context.scene.iter::<Hand>().map(|(_, hand)| hand.instrument).collect();
        Self { instruments, seen: Revision::ZERO }
    }
}

/// The rows that it writes of an instrument.
pub(super) fn rows(
    registry: &trocar_scene::Registry,
    instrument: Entity,
) -> impl Iterator<Item = (trocar_scene::ComponentId, Entity)> {
    let columns = [registry.id::<Pose>(), registry.id::<Velocity>()];
    columns.into_iter().flatten().map(move |id| (id, instrument))
}

impl Controller for InstrumentFollower {
    fn access(&self) -> Access {
        let instruments = || EntitySet::Of(self.instruments.clone());
        Access::new()
            .reads::<InstrumentTarget>()
            .reads::<StationContactModel>()
            .writes::<Pose>(instruments())
            .writes::<Velocity>(instruments())
    }

    fn tick(
        &mut self,
        _tick: &Tick<'_>,
        scene: &Snapshot,
        out: &mut Commands,
    ) -> Result<(), ControllerError> {
        for &instrument in &self.instruments {
            let changed = [
                scene.changed::<InstrumentTarget>(instrument),
                scene.changed::<StationContactModel>(instrument),
            ];
            let is_new = changed.into_iter().flatten().any(|revision| revision > self.seen);
            let Some(target) = scene.get::<InstrumentTarget>(instrument).filter(|_| is_new) else { continue };
            let touch = scene.get::<StationContactModel>(instrument);
            let is_stopped = touch.is_some_and(|touch| touch.model.at >= target.sampled_at);
            match touch.filter(|_| is_stopped) {
                Some(StationContactModel { model }) => {
                    out.put(instrument, model.proxy_in_world);
                    out.put(instrument, model.proxy_velocity);
                }
                None => {
                    out.put(instrument, target.tip_in_world);
                    out.put(instrument, target.velocity_in_world);
                }
            }
        }
        self.seen = scene.revision();
        Ok(())
    }
}
