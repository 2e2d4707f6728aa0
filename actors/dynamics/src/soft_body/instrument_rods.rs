//! Instruments as collision geometry for soft bodies: capsules ("rods") with pose and velocity.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::shapes::{instrument_from_hinge, working_end};
use trocar_scene::{Entity, Instrument, Snapshot, Velocity};

use super::jaws::{CLOSED, opening};

/// Maximum length of the shaft that takes part in contacts, from the hinge backwards \[m\].
const SHAFT_REACH: f64 = 0.12;

/// One rod of an instrument, in the requested frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rod {
    /// Its instrument.
    pub instrument: Entity,
    /// Its ends: nearer to the handle, nearer to the tip \[m\].
    pub ends: [Point3<f64>; 2],
    /// Radius \[m\].
    pub radius: f64,
    /// Velocities of its ends \[m/s\].
    pub velocities: [Vector3<f64>; 2],
    /// Whether it is one of two open jaws, which pass on either side of the tissue to be grasped.
    pub is_open_jaw: bool,
}

/// The rods of all instruments in the scene: shaft, and jaws or other end effector, in the frame of a body at
/// `world_from_body`, in the order of the instruments' entities. Clears `rods` first.
pub fn rods_of_all(scene: &Snapshot, world_from_body: &Isometry3<f64>, rods: &mut Vec<Rod>) {
    rods.clear();
    let body_from_world = world_from_body.inverse();
    for (entity, instrument) in scene.iter::<Instrument>() {
        let world_from_tip = scene.world_pose(entity);
        let body_from_tip = body_from_world * world_from_tip;
        let velocity = scene.get::<Velocity>(entity).copied().unwrap_or_default();
        let [angle, _] = opening(scene, entity);
        let mut add = |from: Point3<f64>, to: Point3<f64>, radius: f64, is_open_jaw: bool| {
            let ends = [from, to];
            let velocities = ends.map(|end| {
                let lever = world_from_tip * end - world_from_tip.translation.vector;
                body_from_world.rotation * (velocity.linear + velocity.angular.cross(&lever.coords))
            });
            rods.push(Rod {
                instrument: entity,
                ends: ends.map(|end| body_from_tip * end),
                radius,
                velocities,
                is_open_jaw,
            });
        };
        let jaws = if instrument.kind.has_jaws() { instrument.jaws.min(2) } else { 0 };
        let end = working_end(instrument);
        let front = if jaws == 0 && end.is_empty() { 0.0 } else { instrument.jaw_length };
        let back = front + SHAFT_REACH.min(instrument.shaft_length - front).max(0.0);
        let radius = instrument.shaft_radius;
        add(Point3::new(0.0, 0.0, -back), Point3::new(0.0, 0.0, -front - radius), radius, false);
        for side in [1.0, -1.0].into_iter().take(usize::from(jaws)) {
            let radius = 0.5 * instrument.jaw_thickness;
            let jaw = instrument_from_hinge(instrument.jaw_length, side, angle);
            // The pad is in the plane x = 0 of the closed jaw.
            let middle = |z: f64| jaw * Point3::new(side * radius, 0.0, z);
            let is_open_jaw = jaws == 2 && angle > CLOSED;
            add(middle(radius), middle(instrument.jaw_length - radius), radius, is_open_jaw);
        }
        for rod in &end {
            rod.axis.windows(2).for_each(|piece| add(piece[0], piece[1], rod.radius, false));
        }
    }
}
