//! Pedals of a hand's device, as what they ask of its instrument.

use trocar_devices::Pedals;
use trocar_scene::{ActivationMode, DeviceState, Entity, Snapshot};

/// Level and mode for the instrument of a hand whose device has pedals, which then alone switch it: a person's foot, here
/// or at another station, and no script and no key. `None` without pedals, and while the device is unplugged nothing is on.
pub fn asked_by_pedals(scene: &Snapshot, hand: Entity) -> Option<(f64, Option<ActivationMode>)> {
    let state = scene.get::<DeviceState>(hand)?;
    let asked = match Pedals::of(state.buttons) {
        Pedals::None => return None,
        Pedals::Released => (0.0, None),
        Pedals::Energy => (1.0, None),
        Pedals::Coagulate => (1.0, Some(ActivationMode::Coagulate)),
    };
    Some(if state.connected { asked } else { (0.0, None) })
}
