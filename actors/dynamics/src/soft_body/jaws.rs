//! Jaws and blades as the scene has them: which hold, and how far they are open.

use trocar_scene::{Entity, Instrument, InstrumentKind, JawState, Snapshot};

/// Full opening below which jaws hold, and blades cut \[rad\].
pub const CLOSED: f64 = 0.12;
/// Jaws that turn no faster are at rest \[rad/s\].
pub const AT_REST: f64 = 0.01;

/// Whether its jaws take hold of what is between them; blades do not.
#[must_use]
pub fn holds(kind: InstrumentKind) -> bool {
    kind.has_jaws() && kind != InstrumentKind::Scissors
}

/// Opening of an instrument's jaws \[rad\], and how fast they open \[rad/s\]; closed and at rest as long as nobody has told,
/// as in the first tick of a scene. Whoever takes them as a body and as what holds has to take them alike: closed jaws that do not
/// hold squeeze out what lies between them.
#[must_use]
pub fn opening(scene: &Snapshot, instrument: Entity) -> [f64; 2] {
    scene.get::<JawState>(instrument).map_or([0.0; 2], |jaws| [jaws.angle, jaws.rate])
}

/// Whether the jaws of an instrument are closed, or its blades.
#[must_use]
pub fn is_closed(scene: &Snapshot, instrument: Entity) -> bool {
    opening(scene, instrument)[0] < CLOSED
}

/// Whether an instrument has blades.
pub fn is_blade(scene: &Snapshot, instrument: Entity) -> bool {
    scene.get::<Instrument>(instrument).is_some_and(|instrument| instrument.kind == InstrumentKind::Scissors)
}
