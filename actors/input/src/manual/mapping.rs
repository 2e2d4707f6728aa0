//! Mapping from a person's input in the image to the handle's pose.
//!
//! The input controls the tip. The tip's goal moves in the image as the pointer does: in the camera's projective
//! coordinates `(x/z, y/z, log z)`, so that the tip stays under the pointer at any depth, and the wheel moves it along
//! its own line of sight. The handle's pose follows from the goal through the port, with the shaft rotated minimally
//! from its initial direction, and rolled about itself.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector1, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::kinematics::coupling::InstrumentCoupling;
use trocar_scene::kinematics::hand_rig::HandRig;
use trocar_scene::kinematics::spatial::minimal_rotation;
use trocar_scene::{PersonHand, PersonView, Pose};

use super::follower::{Follower, exp};

/// Range of the tip's depth along the line of sight \[m\].
const DEPTH_MIN: f64 = 0.02;
const DEPTH_MAX: f64 = 2.0;
/// Iterations of the projection of a goal onto the limits, which are curved by the fulcrum.
const PASSES: usize = 4;
/// Distance of the eye from the tip without a camera \[m\].
const FALLBACK_DEPTH: f64 = 0.25;

/// Limits and smoothing of a manually controlled hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HandLimits {
    /// Motion of the tip's image per motion of the pointer.
    pub pointer_gain: f64,
    /// Largest speed of the tip \[m/s\].
    pub speed_max: f64,
    /// Largest speed of rolling \[rad/s\].
    pub roll_speed_max: f64,
    /// Largest speed of the jaws' opening \[rad/s\].
    pub jaw_speed_max: f64,
    /// Lag of the hand behind a steady motion \[s\], which smooths it.
    pub smoothing_secs: f64,
    /// Largest lead of the goal over the actual tip \[m\], which limits pressing against an obstacle.
    pub lead_max: f64,
    /// Largest roll to either side \[rad\].
    pub roll_max: f64,
    /// Opening of the jaws at the start of a session, as a share of the largest one.
    pub opening: f64,
}

impl Default for HandLimits {
    fn default() -> Self {
        Self {
            pointer_gain: 1.0,
            speed_max: 0.25,
            roll_speed_max: 6.0,
            jaw_speed_max: 4.0,
            smoothing_secs: 0.04,
            lead_max: 0.04,
            roll_max: 3.0,
            opening: 0.5,
        }
    }
}

impl HandLimits {
    /// Checks that every parameter is in range.
    ///
    /// # Errors
    /// Names the first parameter out of range, and its range.
    pub fn check(&self) -> Result<(), String> {
        let figures = [
            ("pointer_gain", self.pointer_gain, 0.01, 10.0),
            ("speed_max", self.speed_max, 0.001, 2.0),
            ("roll_speed_max", self.roll_speed_max, 0.01, 50.0),
            ("jaw_speed_max", self.jaw_speed_max, 0.01, 50.0),
            ("smoothing_secs", self.smoothing_secs, 0.002, 1.0),
            ("lead_max", self.lead_max, 0.001, 1.0),
            ("roll_max", self.roll_max, 0.0, 3.1),
            ("opening", self.opening, 0.0, 1.0),
        ];
        for (field, value, min, max) in figures {
            // Written so that a NaN fails.
            if !(min..=max).contains(&value) {
                return Err(format!("{field} = {value} is out of range ({min} to {max})"));
            }
        }
        Ok(())
    }
}

/// Kinematic limits of a hand by its device.
#[derive(Clone, Copy, Debug)]
pub struct HandKinematics<'a> {
    /// Device, handle, port, tip.
    pub rig: &'a HandRig,
    /// Full extent of the device's workspace about its origin \[m\]; zero if unknown.
    pub workspace: Vector3<f64>,
}

/// A manually controlled hand: its goal and its current state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ManualHand {
    /// Initial rotation `world_from_tip`, before swing and roll.
    pub rest_in_world: UnitQuaternion<f64>,
    /// Goal of the tip \[m\].
    pub goal_in_world: Vector3<f64>,
    /// Goal of the roll \[rad\].
    pub goal_roll: f64,
    /// Goal of the jaw opening \[rad\].
    pub goal_jaw: f64,
    /// Smoothed tip position \[m\].
    pub tip_in_world: Follower<3>,
    /// Smoothed roll \[rad\].
    pub roll: Follower<1>,
    /// Smoothed jaw opening \[rad\].
    pub jaw: Follower<1>,
    /// Input totals already processed.
    pub seen: PersonHand,
}

/// Target of a hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandGoal {
    /// `device_from_handle`.
    pub handle_in_device: Isometry3<f64>,
    /// Opening of the gripper \[rad\].
    pub gripper: f64,
}

impl ManualHand {
    /// A hand at rest, with all earlier input processed.
    pub fn at(tip_in_world: &Isometry3<f64>, jaw: f64, goal_jaw: f64, seen: PersonHand) -> Self {
        let position = tip_in_world.translation.vector;
        Self {
            rest_in_world: tip_in_world.rotation,
            goal_in_world: position,
            goal_roll: 0.0,
            goal_jaw,
            tip_in_world: Follower::at(position),
            roll: Follower::at(Vector1::zeros()),
            jaw: Follower::at(Vector1::new(jaw)),
            seen,
        }
    }

    /// Takes the person's input since the last call, relative to `view`; `actual` is the actual tip position.
    pub fn ask(
        &mut self,
        asked: &PersonHand,
        view: Option<&PersonView>,
        actual: &Vector3<f64>,
        reach: &HandKinematics<'_>,
        limits: &HandLimits,
    ) {
        let moved = Vector3::from(asked.moved) - Vector3::from(self.seen.moved);
        if moved != Vector3::zeros() {
            let fallback;
            let view = match view {
                Some(view) => view,
                None => {
                    fallback = looking_ahead(&self.goal_in_world);
                    &fallback
                }
            };
            let goal = moved_in_picture(&self.goal_in_world, &moved, view, limits.pointer_gain);
            let goal = self.within_reach(&goal, reach);
            // Beyond the lead limit the goal never moves farther from the actual tip.
            let lead = goal - actual;
            let allowed = limits.lead_max.max((self.goal_in_world - actual).norm());
            let length = lead.norm();
            self.goal_in_world = if length > allowed { actual + lead * (allowed / length) } else { goal };
        }
        let roll = self.goal_roll + (asked.rolled - self.seen.rolled);
        self.goal_roll = roll.clamp(-limits.roll_max, limits.roll_max);
        if let Some(opening) = asked.opening {
            self.goal_jaw = opening * reach.rig.jaw_angle_max;
        }
        self.seen = *asked;
    }

    /// Advances by `dt_secs`.
    pub fn advance(&mut self, dt_secs: f64, limits: &HandLimits) {
        let rate = 2.0 / limits.smoothing_secs;
        self.tip_in_world.advance(&self.goal_in_world, dt_secs, limits.speed_max, rate);
        self.roll.advance(&Vector1::new(self.goal_roll), dt_secs, limits.roll_speed_max, rate);
        self.jaw.advance(&Vector1::new(self.goal_jaw), dt_secs, limits.jaw_speed_max, rate);
    }

    /// The hand's current target.
    pub fn place(&self, reach: &HandKinematics<'_>) -> HandGoal {
        let tip = self.tip_pose(&self.tip_in_world.position, reach.rig);
        let mut handle = reach.rig.handle_in_device(&tip);
        handle.translation.vector = within(&handle.translation.vector, &reach.workspace);
        HandGoal {
            handle_in_device: handle,
            gripper: self.jaw.position.x.clamp(0.0, reach.rig.jaw_angle_max),
        }
    }

    /// `world_from_tip` of a tip at `position`, with its current roll.
    fn tip_pose(&self, position: &Vector3<f64>, rig: &HandRig) -> Isometry3<f64> {
        let rest_axis = self.rest_in_world * Vector3::z();
        let swing = match &rig.coupling {
            InstrumentCoupling::Fulcrum(fulcrum) => {
                let inside = position - fulcrum.port_in_world();
                let axis = inside.try_normalize(1e-9).unwrap_or(rest_axis);
                minimal_rotation(&rest_axis, &axis)
            }
            InstrumentCoupling::Free(_) => UnitQuaternion::identity(),
        };
        let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), self.roll.position.x);
        Isometry3::from_parts((*position).into(), swing * self.rest_in_world * roll)
    }

    /// The tip position nearest to `goal` within the device's workspace and the port's insertion limits.
    fn within_reach(&self, goal: &Vector3<f64>, reach: &HandKinematics<'_>) -> Vector3<f64> {
        let mut goal = *goal;
        for _ in 0..PASSES {
            let tip = self.tip_pose(&goal, reach.rig);
            let mut handle = reach.rig.handle_in_device(&tip);
            let inside = within(&handle.translation.vector, &reach.workspace);
            let is_inside = inside == handle.translation.vector;
            handle.translation.vector = inside;
            let axis = tip.rotation * Vector3::z();
            let reached = reach.rig.tip_in_world(&handle, &axis).translation.vector;
            if is_inside && (reached - goal).norm() < 1e-9 {
                break;
            }
            goal = reached;
        }
        goal
    }
}

/// The point of the workspace nearest to `point`; an axis without extent is unlimited.
fn within(point: &Vector3<f64>, workspace: &Vector3<f64>) -> Vector3<f64> {
    point.zip_map(workspace, |x, extent| if extent > 0.0 { x.clamp(-0.5 * extent, 0.5 * extent) } else { x })
}

/// `point` \[m\] after its image has moved by `moved` (right, down, away; see [`PersonHand::moved`]).
pub fn moved_in_picture(
    point_in_world: &Vector3<f64>,
    moved: &Vector3<f64>,
    view: &PersonView,
    gain: f64,
) -> Vector3<f64> {
    let world_from_view = view.world_from_view.isometry();
    let in_view = world_from_view.inverse_transform_point(&Point3::from(*point_in_world));
    // A point behind the eye has no image; it is moved as if it were close in front of it.
    let depth = in_view.z.max(DEPTH_MIN);
    let height = 2.0 * (0.5 * view.field_of_view).tan() * gain;
    let (right, down) = (in_view.x / depth + moved.x * height, in_view.y / depth + moved.y * height);
    let depth = (depth * exp(moved.z)).clamp(depth.min(DEPTH_MIN), depth.max(DEPTH_MAX));
    (world_from_view * Point3::new(right * depth, down * depth, depth)).coords
}

/// A view of a point from the front, without a camera: x to the right, z up in the image.
fn looking_ahead(point_in_world: &Vector3<f64>) -> PersonView {
    // z of the view is y of the world, y of the view is −z.
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let eye = point_in_world - Vector3::y() * FALLBACK_DEPTH;
    PersonView { world_from_view: Pose::new(eye, rotation), field_of_view: 1.0 }
}

#[cfg(test)]
#[path = "mapping_tests.rs"]
mod tests;
