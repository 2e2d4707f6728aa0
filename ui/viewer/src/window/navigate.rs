//! The orbiting camera of the mouse: turn, shift, zoom.

use nalgebra::{Point3, Vector3};

use crate::view::{Lens, View};

/// Rotation for a drag over the height of the picture \[rad\].
const TURN_PER_HEIGHT: f64 = 3.0;
/// Factor on the distance for a notch of the wheel.
const CLOSER_PER_NOTCH: f64 = 0.88;
/// Nearest and farthest distance from the target \[m\].
const DISTANCE: [f64; 2] = [0.005, 5.0];
/// Steepest pitch: never quite vertical, where left and right would swap.
const PITCH_MAX: f64 = 1.553;

/// An orbiting camera; up is along world z.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Orbit {
    /// The target.
    pub target_in_world: Point3<f64>,
    /// From the target to the eye \[m\].
    pub distance: f64,
    /// About the vertical \[rad\]; at 0 the eye looks along +y.
    pub yaw: f64,
    /// Above the horizontal \[rad\].
    pub pitch: f64,
    /// Vertical field of view \[rad\].
    pub field_of_view: f64,
}

impl Orbit {
    /// Starts from another view, around the point `distance` \[m\] in front of it.
    pub fn from_view(view: &View, distance: f64) -> Self {
        let distance = distance.clamp(DISTANCE[0], DISTANCE[1]);
        let forward = view.world_from_eye * Vector3::z();
        let eye = Point3::from(view.world_from_eye.translation.vector);
        // Straight down: the picture's up direction gives the yaw.
        let level = if forward.xy().norm() > 1e-3 { forward } else { view.world_from_eye * -Vector3::y() };
        Self {
            target_in_world: eye + forward * distance,
            distance,
            yaw: (-level.x).atan2(level.y),
            pitch: (-forward.z).clamp(-1.0, 1.0).asin().clamp(-PITCH_MAX, PITCH_MAX),
            field_of_view: view.lens.field_of_view,
        }
    }

    fn forward(&self) -> Vector3<f64> {
        let level = Vector3::new(-self.yaw.sin(), self.yaw.cos(), 0.0);
        level * self.pitch.cos() - Vector3::z() * self.pitch.sin()
    }

    /// The view, for a picture of this aspect ratio.
    pub fn view(&self, aspect: f64) -> View {
        let eye = self.target_in_world - self.forward() * self.distance;
        let lens = Lens {
            field_of_view: self.field_of_view,
            aspect,
            near: (0.02 * self.distance).min(0.005),
            far: (20.0 * self.distance).max(2.0),
            ..Lens::default()
        };
        View::looking_at(eye, self.target_in_world, Vector3::z(), lens)
    }

    /// Rotates about the target; the mouse moved to the right and down \[heights of the picture\].
    pub fn turn(&mut self, right: f64, down: f64) {
        self.yaw -= right * TURN_PER_HEIGHT;
        self.pitch = (self.pitch + down * TURN_PER_HEIGHT).clamp(-PITCH_MAX, PITCH_MAX);
    }

    /// Shifts parallel to the picture: the point under the mouse stays there \[heights of the picture\].
    pub fn shift(&mut self, right: f64, down: f64) {
        let view = self.view(1.0);
        let height = 2.0 * (0.5 * self.field_of_view).tan() * self.distance;
        self.target_in_world += view.world_from_eye * Vector3::new(-right, -down, 0.0) * height;
    }

    /// Zooms in, by notches of the wheel.
    pub fn zoom(&mut self, notches: f64) {
        let factor = CLOSER_PER_NOTCH.powf(notches.clamp(-20.0, 20.0));
        self.distance = (self.distance * factor).clamp(DISTANCE[0], DISTANCE[1]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn orbit() -> Orbit {
        let view =
            View::looking_at(Point3::new(0.1, -0.3, 0.2), Point3::origin(), Vector3::z(), Lens::default());
        Orbit::from_view(&view, view.world_from_eye.translation.vector.norm())
    }

    #[test]
    fn it_takes_over_where_another_view_was() {
        let orbit = orbit();
        assert!(orbit.target_in_world.coords.norm() < 1e-12);
        let eye = orbit.view(1.5).world_from_eye.translation.vector;
        assert!((eye - Vector3::new(0.1, -0.3, 0.2)).norm() < 1e-12, "{eye}");
    }

    #[test]
    fn what_lies_under_the_mouse_goes_with_it() {
        let mut orbit = orbit();
        let before = orbit.view(1.0).project(&Point3::origin()).unwrap().0;
        orbit.shift(0.1, 0.05);
        let after = orbit.view(1.0).project(&Point3::origin()).unwrap().0;
        assert!((after[0] - before[0] - 0.1).abs() < 1e-9 && (after[1] - before[1] - 0.05).abs() < 1e-9);
    }

    #[test]
    fn turning_keeps_the_distance_and_never_tips_over() {
        let mut orbit = orbit();
        let distance = orbit.distance;
        orbit.turn(0.3, 100.0);
        let view = orbit.view(1.0);
        assert!((view.world_from_eye.translation.vector.norm() - distance).abs() < 1e-9);
        // The picture's down is still down.
        assert!((view.world_from_eye * Vector3::y()).z < 0.0);
        // A drag to the right shows what is at the left: near things move to the right.
        let mut turned = self::orbit();
        let near = turned.target_in_world - turned.forward() * 0.1;
        turned.turn(0.05, 0.0);
        assert!(turned.view(1.0).project(&near).unwrap().0[0] > 0.5);
    }

    #[test]
    fn no_wheel_leads_through_things_or_out_of_sight() {
        let mut orbit = orbit();
        orbit.zoom(1e9);
        (0..100).for_each(|_| orbit.zoom(20.0));
        assert_eq!(orbit.distance, DISTANCE[0]);
        (0..100).for_each(|_| orbit.zoom(-20.0));
        assert_eq!(orbit.distance, DISTANCE[1]);
    }
}
