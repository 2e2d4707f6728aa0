//! Overlay of the forces that the haptic devices render.

use nalgebra::Point3;
use trocar_scene::{DeviceState, Hand, Snapshot};

use super::sketch::Stroke;
use super::{Legend, Overlays, Seen};

/// Colour of hand forces.
pub const HAND_FORCE: [u8; 4] = [225, 90, 255, 255];
/// Longest arrow \[m\].
const LONGEST: f64 = 0.3;

/// Draws the force that each device rendered, at the tip of the instrument.
pub fn hands(overlays: &Overlays, scene: &Snapshot, seen: &mut Seen) {
    let stroke = Stroke { color: HAND_FORCE, width: 1.5 * overlays.line_width, hidden: 0.5 };
    for (entity, hand) in scene.iter::<Hand>() {
        let Some(state) = scene.get::<DeviceState>(entity) else { continue };
        let tip = Point3::from(scene.world_pose(hand.instrument).translation.vector);
        let force_in_world = hand.world_from_device.rotation * state.applied_force;
        let along = force_in_world * overlays.metres_per_newton;
        seen.sketch.arrow(&tip, &along.cap_magnitude(LONGEST), &stroke);
    }
    seen.legends.push(Legend::arrow("force on the hand", HAND_FORCE, overlays.metres_per_newton));
}
