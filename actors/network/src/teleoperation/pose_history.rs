//! Poses of the last seconds by their times, to compare a slave with the pose that it applies.

use std::collections::VecDeque;

use nalgebra::Isometry3;
use trocar_scene::SimTime;

/// Most poses: eight seconds at 1 kHz.
const POSES_MAX: usize = 8_192;
/// Times travel in whole microseconds.
const ROUNDED: SimTime = SimTime::from_micros(1);

/// Poses in the order of their times. Pushing allocates nothing.
#[derive(Clone, Debug)]
pub struct PoseHistory(VecDeque<(SimTime, Isometry3<f64>)>);

impl Default for PoseHistory {
    fn default() -> Self {
        Self(VecDeque::with_capacity(POSES_MAX))
    }
}

impl PoseHistory {
    /// Adds the newest pose; one that is not newer is passed over.
    pub fn push(&mut self, at: SimTime, pose: Isometry3<f64>) {
        if self.0.back().is_some_and(|(last, _)| *last >= at) {
            return;
        }
        if self.0.len() >= POSES_MAX {
            self.0.pop_front();
        }
        self.0.push_back((at, pose));
    }

    /// The pose of this time, within a microsecond; `None` when there is none, or not any more.
    pub fn at(&self, at: SimTime) -> Option<&Isometry3<f64>> {
        let next = self.0.partition_point(|(time, _)| *time < at);
        let near =
            [Some(next), next.checked_sub(1)].into_iter().flatten().filter_map(|place| self.0.get(place));
        let distance = |time: SimTime| time.since(at).max(at.since(time));
        let (time, pose) = near.min_by_key(|(time, _)| distance(*time))?;
        (distance(*time) <= ROUNDED).then_some(pose)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_found_by_its_time_within_a_microsecond_while_it_is_kept() {
        let mut poses = PoseHistory::default();
        assert_eq!(poses.at(SimTime::ZERO), None);
        for ms in 0..10_000 {
            poses.push(SimTime::from_millis(ms), Isometry3::translation(ms as f64, 0.0, 0.0));
        }
        let found = |nanos| poses.at(SimTime(nanos)).map(|pose| pose.translation.x);
        assert_eq!(found(5_000_000_000), Some(5_000.0));
        assert_eq!((found(5_000_000_700), found(4_999_999_300)), (Some(5_000.0), Some(5_000.0)));
        assert_eq!(found(5_000_300_000), None);
        assert_eq!((found(9_999_000_000), found(10_000_000_000)), (Some(9_999.0), None));
        assert_eq!(found(1_000_000_000), None, "eight seconds are kept");
    }
}
