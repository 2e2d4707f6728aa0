//! Own rows: what a station writes itself of the hands that it serves, and so is never sent to it.

use trocar_scene::{
    Activation, DeviceForce, DeviceState, Entity, Hand, HandTarget, HapticStatus, InstrumentTarget, Snapshot,
    StationContactModel,
};

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
    for hand in hands {
        let of_hand = [
            registry.id::<DeviceState>(),
            registry.id::<DeviceForce>(),
            registry.id::<HapticStatus>(),
            registry.id::<HandTarget>().filter(|_| moves),
        ];
        rows.extend(of_hand.into_iter().flatten().map(|id| (id, *hand)));
        let instrument = scene.get::<Hand>(*hand).map(|hand| hand.instrument);
        let of_instrument = [
            registry.id::<InstrumentTarget>(),
            registry.id::<StationContactModel>(),
            registry.id::<Activation>().filter(|_| moves),
        ];
        rows.extend(of_instrument.into_iter().flatten().zip(instrument.into_iter().cycle()));
    }
    ExcludedRows::new(rows, columns.simulated())
}
