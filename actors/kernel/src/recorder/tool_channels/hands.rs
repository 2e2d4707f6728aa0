//! `/hands/left` and `/hands/right`: the forces at each hand, and what it does.

use serde_json::json;
use trocar_scene::{DeviceForce, DeviceState, Hand, JawState, Side, SimTime, Snapshot};

use super::super::format::channel;
use super::cadence::Cadence;
use super::numbers::{FORCE, rounded, vector};
use super::{Message, without_nulls};

/// From one message of a hand to the next.
const PERIOD: SimTime = SimTime(33_333_333);

/// When the hands are told next.
pub(super) struct Hands {
    cadence: Cadence,
}

impl Default for Hands {
    fn default() -> Self {
        Self { cadence: Cadence::new(PERIOD) }
    }
}

impl Hands {
    /// Tells the state of every hand.
    pub(super) fn tell(&mut self, scene: &Snapshot, now: SimTime, message: &mut Message<'_>) {
        if !self.cadence.is_due(now) {
            return;
        }
        for (entity, hand) in scene.iter::<Hand>() {
            let Some(device) = scene.get::<DeviceState>(entity) else { continue };
            let commanded = scene.get::<DeviceForce>(entity).map(|force| force.force).unwrap_or_default();
            let jaw = scene.get::<JawState>(hand.instrument).map(|jaws| rounded(jaws.angle, FORCE));
            let number = match hand.side {
                Side::Left => channel::HAND_LEFT,
                Side::Right => channel::HAND_RIGHT,
            };
            let told = json!({
                "hand": scene.name(entity),
                "side": hand.side.as_str(),
                "instrument": scene.name(hand.instrument),
                "applied": vector(&device.applied_force, FORCE),
                "applied_norm": rounded(device.applied_force.norm(), FORCE),
                "commanded": vector(&commanded, FORCE),
                "commanded_norm": rounded(commanded.norm(), FORCE),
                "gripper": rounded(device.gripper, FORCE),
                "jaw": jaw,
                "buttons": device.buttons,
                "connected": device.connected
            });
            message(number, &without_nulls(told));
        }
    }
}
