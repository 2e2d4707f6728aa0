//! Jaws and blades of instruments, read from the scene: which ones grasp, and their opening.

use trocar_scene::{Entity, Instrument, InstrumentKind, JawState, Snapshot};

/// Full opening below which jaws grasp and blades cut \[rad\].
pub const CLOSED: f64 = 0.12;
/// Jaws that turn no faster count as at rest \[rad/s\].
pub const AT_REST: f64 = 0.01;

/// Whether its jaws grasp what is between them; blades do not.
#[must_use]
pub fn holds(kind: InstrumentKind) -> bool {
    kind.has_jaws() && kind != InstrumentKind::Scissors
}

/// Opening of an instrument's jaws \[rad\], and its rate \[rad/s\]; closed and at rest until the state is written, as
/// in the first tick of a scene. Contact and grasp code must agree on this: closed jaws that do not grasp squeeze out
/// what lies between them.
#[must_use]
pub fn opening(scene: &Snapshot, instrument: Entity) -> [f64; 2] {
    scene.get::<JawState>(instrument).map_or([0.0; 2], |jaws| [jaws.angle, jaws.rate])
}

/// Whether an instrument's jaws or blades are closed.
#[must_use]
pub fn is_closed(scene: &Snapshot, instrument: Entity) -> bool {
    opening(scene, instrument)[0] < CLOSED
}

/// Whether an instrument has blades.
pub fn is_blade(scene: &Snapshot, instrument: Entity) -> bool {
    scene.get::<Instrument>(instrument).is_some_and(|instrument| instrument.kind == InstrumentKind::Scissors)
}
