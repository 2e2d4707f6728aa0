//! Own rows: what a station writes itself of the hands that it serves, and so is never sent to it.

use trocar_scene::{
    Activation, DeviceForce, DeviceState, Entity, Hand, HandTarget, HapticStatus, InstrumentTarget,
    PressTarget, Registry, Snapshot, StationContactModel,
};

use super::instrument_follower;
use crate::replication::ExcludedRows;
use crate::replication::choice::ReplicatedColumns;
use crate::replication::delta::RowSet;

/// The rows that the controllers of these hands write: what the device measures and renders, and where the instrument is to
/// be; among peers, everything that each computes for itself. Both ends compute the same, of the same scene. `moves`: a person
/// or a program at the station says where the hands go, in place of the session's virtual trainee.
pub fn own_rows(
    columns: &ReplicatedColumns,
    scene: &Snapshot,
    hands: &[Entity],
    moves: bool,
) -> ExcludedRows {
    let registry = columns.registry();
    let mut rows = RowSet::new();
    let follows_all = columns.follows_hands();
    let all: Vec<Entity> = scene.iter::<Hand>().map(|(hand, _)| hand).filter(|_| follows_all).collect();
    for hand in all.iter().filter(|hand| !hands.contains(hand)) {
        rows.extend(of_hand(registry, scene, *hand, false));
    }
    for instrument in all.iter().filter_map(|hand| scene.get::<Hand>(*hand)).map(|hand| hand.instrument) {
        rows.extend(instrument_follower::rows(registry, instrument));
    }
    for hand in hands {
        rows.extend(of_hand(registry, scene, *hand, moves));
    }
    ExcludedRows::new(rows, columns.simulated())
}

fn of_hand(registry: &Registry, scene: &Snapshot, hand: Entity, moves: bool) -> RowSet {
    let of_hand = [
        registry.id::<DeviceState>(),
        registry.id::<DeviceForce>(),
        registry.id::<HapticStatus>(),
        registry.id::<HandTarget>().filter(|_| moves),
        registry.id::<PressTarget>().filter(|_| moves),
    ];
    let instrument = scene.get::<Hand>(hand).map(|hand| hand.instrument);
    let of_instrument = [
        registry.id::<InstrumentTarget>(),
        registry.id::<StationContactModel>(),
        registry.id::<Activation>().filter(|_| moves),
    ];
    let of_hand = of_hand.into_iter().flatten().map(|id| (id, hand));
    of_hand.chain(of_instrument.into_iter().flatten().zip(instrument.into_iter().cycle())).collect()
}
