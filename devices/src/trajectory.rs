//! Trajectories: hand motion over time, played by replay hands.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::device::DeviceState;
use crate::link::DeviceSample;

/// State of a hand at one instant.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrajectoryPoint {
    /// Session time \[ns\].
    pub time_ns: u64,
    /// State of the device then.
    pub state: DeviceState,
}

impl From<&DeviceSample> for TrajectoryPoint {
    /// The state at the time at which the driver published it, so that a replay gives each driver step the same state.
    fn from(sample: &DeviceSample) -> Self {
        Self { time_ns: sample.published_at_ns, state: sample.state }
    }
}

/// Why points do not form a trajectory.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum TrajectoryError {
    /// There is no point.
    #[error("the trajectory has no points")]
    Empty,
    /// Time does not increase.
    #[error("point {index} of the trajectory: time {time_ns} ns is not after {previous_ns} ns")]
    TimeNotIncreasing {
        /// Index of the point, from 0.
        index: usize,
        /// Its time \[ns\].
        time_ns: u64,
        /// Time of the point before \[ns\].
        previous_ns: u64,
    },
    /// A number that is NaN or infinite, or a rotation that is not of unit length.
    #[error("point {index} of the trajectory holds a NaN, an infinity or an unnormalised rotation")]
    Invalid {
        /// Index of the point, from 0.
        index: usize,
    },
}

/// Registration of a foreign recording to a device's frame: shifted by its centre, scaled, then posed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Registration {
    /// Point of the source \[m\] that maps to the origin of `device_from_source`.
    pub centre_in_source: Vector3<f64>,
    /// Scale of lengths; rotations are not scaled.
    pub scale: f64,
    /// Pose of the source in the device's frame.
    pub device_from_source: Isometry3<f64>,
}

impl Default for Registration {
    fn default() -> Self {
        Self { centre_in_source: Vector3::zeros(), scale: 1.0, device_from_source: Isometry3::identity() }
    }
}

impl Registration {
    /// Transforms a state of the source to the device's frame.
    pub fn apply(&self, state: &DeviceState) -> DeviceState {
        let pose = &state.pose_in_device;
        let rotation = self.device_from_source.rotation;
        let position = self.scale * (pose.translation.vector - self.centre_in_source);
        DeviceState {
            pose_in_device: Isometry3::from_parts(
                (rotation * position + self.device_from_source.translation.vector).into(),
                rotation * pose.rotation,
            ),
            linear_velocity: rotation * (self.scale * state.linear_velocity),
            angular_velocity: rotation * state.angular_velocity,
            ..*state
        }
    }
}

/// One point or more in order of time, all of them valid.
#[derive(Clone, Debug, PartialEq)]
pub struct Trajectory {
    points: Vec<TrajectoryPoint>,
}

impl Trajectory {
    /// A trajectory with the given velocities, such as of our own recordings.
    ///
    /// # Errors
    /// [`TrajectoryError`] names the point.
    pub fn new(points: Vec<TrajectoryPoint>) -> Result<Self, TrajectoryError> {
        if points.is_empty() {
            return Err(TrajectoryError::Empty);
        }
        let mut previous = None;
        for (index, point) in points.iter().enumerate() {
            if let Some(previous_ns) = previous
                && point.time_ns <= previous_ns
            {
                return Err(TrajectoryError::TimeNotIncreasing {
                    index,
                    time_ns: point.time_ns,
                    previous_ns,
                });
            }
            if !point.state.is_valid() {
                return Err(TrajectoryError::Invalid { index });
            }
            previous = Some(point.time_ns);
        }
        Ok(Self { points })
    }

    /// A trajectory with velocities computed from the poses by central differences, one-sided at the ends.
    ///
    /// # Errors
    /// As [`Trajectory::new`]; the velocities of the points given do not matter.
    pub fn with_differentiated_velocities(mut points: Vec<TrajectoryPoint>) -> Result<Self, TrajectoryError> {
        for point in &mut points {
            point.state.linear_velocity = Vector3::zeros();
            point.state.angular_velocity = Vector3::zeros();
        }
        let mut trajectory = Self::new(points)?;
        let last = trajectory.points.len() - 1;
        for index in 0..=last {
            let before = trajectory.points[index.saturating_sub(1)];
            let after = trajectory.points[(index + 1).min(last)];
            let elapsed = (after.time_ns - before.time_ns) as f64 * 1e-9;
            if elapsed > 0.0 {
                let (from, to) = (&before.state.pose_in_device, &after.state.pose_in_device);
                let state = &mut trajectory.points[index].state;
                state.linear_velocity = (to.translation.vector - from.translation.vector) / elapsed;
                state.angular_velocity = (to.rotation * from.rotation.inverse()).scaled_axis() / elapsed;
            }
            if !trajectory.points[index].state.is_valid() {
                return Err(TrajectoryError::Invalid { index });
            }
        }
        Ok(trajectory)
    }

    /// The points, in order of time.
    pub fn points(&self) -> &[TrajectoryPoint] {
        &self.points
    }

    /// Time of the first point \[ns\].
    pub fn start_ns(&self) -> u64 {
        self.points[0].time_ns
    }

    /// Time of the last point \[ns\].
    pub fn end_ns(&self) -> u64 {
        self.points[self.points.len() - 1].time_ns
    }

    /// Mean position of the points \[m\].
    pub fn centre(&self) -> Vector3<f64> {
        let count = self.points.len() as f64;
        self.points.iter().map(|point| point.state.pose_in_device.translation.vector / count).sum()
    }

    /// The same motion, registered to a device's frame.
    ///
    /// # Errors
    /// [`TrajectoryError::Invalid`] when the registration leads to numbers that are not finite.
    pub fn registered(self, registration: &Registration) -> Result<Self, TrajectoryError> {
        let mut points = self.points;
        for point in &mut points {
            point.state = registration.apply(&point.state);
        }
        Self::new(points)
    }

    /// The state at a session time \[ns\]: bit for bit that of a point of exactly this time, otherwise
    /// interpolated (slerp for rotations); at rest before the first point and after the last.
    pub fn at(&self, time_ns: u64) -> DeviceState {
        let after = match self.points.binary_search_by_key(&time_ns, |point| point.time_ns) {
            Ok(index) => return self.points[index].state,
            Err(after) => after,
        };
        if after == 0 {
            return at_rest(&self.points[0].state);
        }
        let Some(to) = self.points.get(after) else {
            return at_rest(&self.points[after - 1].state);
        };
        let from = &self.points[after - 1];
        let share = (time_ns - from.time_ns) as f64 / (to.time_ns - from.time_ns) as f64;
        interpolate(&from.state, &to.state, share)
    }
}

fn at_rest(state: &DeviceState) -> DeviceState {
    DeviceState { linear_velocity: Vector3::zeros(), angular_velocity: Vector3::zeros(), ..*state }
}

fn interpolate(from: &DeviceState, to: &DeviceState, share: f64) -> DeviceState {
    let (start, end) = (&from.pose_in_device, &to.pose_in_device);
    // Rotations exactly half a turn apart have no shortest path; either end is valid.
    let rotation: UnitQuaternion<f64> = start
        .rotation
        .try_slerp(&end.rotation, share, 1e-9)
        .unwrap_or(if share < 0.5 { start.rotation } else { end.rotation });
    DeviceState {
        pose_in_device: Isometry3::from_parts(
            start.translation.vector.lerp(&end.translation.vector, share).into(),
            rotation,
        ),
        linear_velocity: from.linear_velocity.lerp(&to.linear_velocity, share),
        angular_velocity: from.angular_velocity.lerp(&to.angular_velocity, share),
        gripper: from.gripper + share * (to.gripper - from.gripper),
        buttons: from.buttons,
        connected: from.connected && to.connected,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(time_ns: u64, x: f64, angle: f64) -> TrajectoryPoint {
        let pose = Isometry3::from_parts(
            Vector3::new(x, 0.0, 0.0).into(),
            UnitQuaternion::from_axis_angle(&Vector3::z_axis(), angle),
        );
        TrajectoryPoint {
            time_ns,
            state: DeviceState {
                pose_in_device: pose,
                gripper: x,
                connected: true,
                ..DeviceState::unknown()
            },
        }
    }

    #[test]
    fn between_points_it_interpolates_and_outside_it_rests() {
        let points = vec![point(1_000_000_000, 0.0, 0.0), point(2_000_000_000, 0.1, 0.5)];
        let trajectory = Trajectory::with_differentiated_velocities(points).unwrap();
        let middle = trajectory.at(1_500_000_000);
        assert!((middle.pose_in_device.translation.x - 0.05).abs() < 1e-15);
        assert!((middle.pose_in_device.rotation.angle() - 0.25).abs() < 1e-12);
        assert!((middle.linear_velocity.x - 0.1).abs() < 1e-12);
        assert!((middle.angular_velocity.z - 0.5).abs() < 1e-12);
        assert!((middle.gripper - 0.05).abs() < 1e-15);
        assert_eq!(trajectory.at(0).linear_velocity, Vector3::zeros());
        assert_eq!(trajectory.at(0).pose_in_device.translation.x, 0.0);
        let end = trajectory.at(u64::MAX);
        assert_eq!((end.pose_in_device.translation.x, end.linear_velocity), (0.1, Vector3::zeros()));
    }

    #[test]
    fn exact_times_give_the_recorded_bits() {
        let mut points = vec![point(10, 0.1, 0.3), point(20, 0.2, 0.4), point(30, 0.7, 0.1)];
        points[1].state.linear_velocity = Vector3::new(0.1 + 0.2, -0.0, 1e-300);
        // Within tolerance, but not exactly normalised.
        points[1].state.pose_in_device.rotation =
            UnitQuaternion::new_unchecked(nalgebra::Quaternion::new(1.0 + 1e-9, 0.0, 0.0, 0.0));
        let trajectory = Trajectory::new(points.clone()).unwrap();
        for point in &points {
            let state = trajectory.at(point.time_ns);
            assert_eq!(state, point.state);
            assert_eq!(state.linear_velocity.y.to_bits(), point.state.linear_velocity.y.to_bits());
        }
    }

    #[test]
    fn what_is_no_trajectory_is_refused_by_index() {
        assert_eq!(Trajectory::new(vec![]).unwrap_err(), TrajectoryError::Empty);
        let backwards = vec![point(10, 0.0, 0.0), point(10, 0.0, 0.0)];
        assert_eq!(
            Trajectory::new(backwards).unwrap_err(),
            TrajectoryError::TimeNotIncreasing { index: 1, time_ns: 10, previous_ns: 10 }
        );
        assert_eq!(
            Trajectory::new(vec![point(1, f64::NAN, 0.0)]).unwrap_err(),
            TrajectoryError::Invalid { index: 0 }
        );
    }

    #[test]
    fn registration_shifts_scales_and_poses() {
        let registration = Registration {
            centre_in_source: Vector3::new(0.1, 0.0, 0.0),
            scale: 2.0,
            device_from_source: Isometry3::new(Vector3::z(), Vector3::z() * std::f64::consts::FRAC_PI_2),
        };
        let mut source = point(0, 0.3, 0.0).state;
        source.linear_velocity = Vector3::x();
        let seen = registration.apply(&source);
        assert!((seen.pose_in_device.translation.vector - Vector3::new(0.0, 0.4, 1.0)).norm() < 1e-12);
        assert!((seen.linear_velocity - Vector3::new(0.0, 2.0, 0.0)).norm() < 1e-12);
        assert!((seen.pose_in_device.rotation.angle() - std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    }
}
