//! Clutch: a constant offset between the hand that moves and the pose that is shown.
//!
//! Indexing of a master, as in tele-manipulation since the first servo arms (Vertut and Coiffet, "Robot technology:
//! teleoperation and robotics", 1985): while it is open the hand moves freely, when it closes the shown pose stays where
//! it is and only the hand's motion counts.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};

/// Offset in position and rotation. The shift is added along the device's axes, and the turn is applied in the handle's
/// own frame, so that every motion of the hand is shown along and about the device's own axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Clutch {
    shift_in_device: Vector3<f64>,
    turn_in_handle: UnitQuaternion<f64>,
}

impl Clutch {
    /// No offset.
    pub fn identity() -> Self {
        Self { shift_in_device: Vector3::zeros(), turn_in_handle: UnitQuaternion::identity() }
    }

    /// The offset with which a hand at `hand_in_device` is shown at `shown_in_device`.
    pub fn between(hand_in_device: &Isometry3<f64>, shown_in_device: &Isometry3<f64>) -> Self {
        Self {
            shift_in_device: shown_in_device.translation.vector - hand_in_device.translation.vector,
            turn_in_handle: hand_in_device.rotation.inverse() * shown_in_device.rotation,
        }
    }

    /// Where a hand at `hand_in_device` is shown.
    pub fn shown(&self, hand_in_device: &Isometry3<f64>) -> Isometry3<f64> {
        self.placed(hand_in_device, self.shift_in_device, self.turn_in_handle)
    }

    /// Where the hand is that is shown at `shown_in_device`.
    pub fn hand(&self, shown_in_device: &Isometry3<f64>) -> Isometry3<f64> {
        self.placed(shown_in_device, -self.shift_in_device, self.turn_in_handle.inverse())
    }

    fn placed(
        &self,
        pose: &Isometry3<f64>,
        shift: Vector3<f64>,
        turn: UnitQuaternion<f64>,
    ) -> Isometry3<f64> {
        let mut rotation = pose.rotation * turn;
        rotation.renormalize();
        Isometry3::from_parts((pose.translation.vector + shift).into(), rotation)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(position: [f64; 3], turn: [f64; 3]) -> Isometry3<f64> {
        let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
        Isometry3::from_parts(Vector3::from(position).into(), rotation)
    }

    fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (f64, f64) {
        ((a.translation.vector - b.translation.vector).norm(), a.rotation.angle_to(&b.rotation))
    }

    #[test]
    fn a_clutch_that_closes_moves_nothing_and_opens_the_way_back() {
        let hand = pose([0.03, -0.02, 0.01], [0.4, 1.1, -0.3]);
        let shown = pose([-0.05, 0.04, 0.0], [-1.0, 0.2, 2.0]);
        let clutch = Clutch::between(&hand, &shown);
        let (moved, turned) = apart(&clutch.shown(&hand), &shown);
        assert!(moved < 1e-15 && turned < 1e-7);
        let (moved, turned) = apart(&clutch.hand(&shown), &hand);
        assert!(moved < 1e-15 && turned < 1e-7);
    }

    #[test]
    fn motion_keeps_its_direction_and_its_axis() {
        let hand = pose([0.0; 3], [0.4, 1.1, -0.3]);
        let shown = pose([0.1, 0.0, 0.0], [0.0, -2.0, 0.5]);
        let clutch = Clutch::between(&hand, &shown);
        let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.0, 0.0, 0.2));
        let moved = Isometry3::from_parts(Vector3::new(0.0, 0.01, 0.0).into(), turn * hand.rotation);
        let after = clutch.shown(&moved);
        assert!((after.translation.vector - Vector3::new(0.1, 0.01, 0.0)).norm() < 1e-15);
        assert!(after.rotation.angle_to(&(turn * shown.rotation)) < 1e-7);
    }
}
