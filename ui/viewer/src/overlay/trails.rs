//! Trails of the instruments' tips.

use std::collections::{BTreeMap, VecDeque};

use nalgebra::Point3;
use trocar_scene::{Entity, Instrument, SimTime, Snapshot};

use super::Overlays;
use super::sketch::{Sketch, Stroke};

/// Most points kept for each tip.
const POINTS_MAX: usize = 1024;
/// Least time and distance \[m\] between two points of a trail.
const APART: SimTime = SimTime::from_millis(5);
const STEP: f64 = 1e-4;
/// A larger jump counts as a teleport of the tip \[m\].
const LEAP: f64 = 0.05;
/// Colours of trails, in the order of instruments.
const COLORS: [[u8; 3]; 4] = [[80, 200, 255], [255, 160, 60], [150, 235, 110], [235, 130, 235]];

/// The trail of each tip; records as much as is shown.
#[derive(Clone, Debug, Default)]
pub struct Trails {
    paths: BTreeMap<Entity, VecDeque<(SimTime, Point3<f64>)>>,
    now: SimTime,
}

impl Trails {
    /// Records a snapshot; one that is earlier than the last restarts the trails.
    pub fn watch(&mut self, scene: &Snapshot, trail_secs: f64) {
        let now = scene.time();
        if now < self.now {
            self.paths.clear();
        }
        self.now = now;
        let reach = SimTime::from_secs_f64(trail_secs);
        // Spaced so that the points suffice for a trail of any length.
        let apart = APART.max(SimTime(reach.as_nanos() / (POINTS_MAX as u64 - 2)));
        self.paths.retain(|entity, _| scene.get::<Instrument>(*entity).is_some());
        for (entity, _) in scene.iter::<Instrument>() {
            let tip = Point3::from(scene.world_pose(entity).translation.vector);
            let path = self.paths.entry(entity).or_default();
            // The last point moves with the tip; the one before it is fixed.
            let settled = match path.len() {
                0 => true,
                1 => now.since(path[0].0) >= apart,
                count => {
                    let ((before, there), (last, here)) = (path[count - 2], path[count - 1]);
                    last.since(before) >= apart && (here - there).norm() >= STEP
                }
            };
            if !settled && path.len() > 1 {
                path.pop_back();
            }
            path.push_back((now, tip));
            while path.len() > POINTS_MAX || path.front().is_some_and(|(at, _)| now.since(*at) > reach) {
                path.pop_front();
            }
        }
    }

    /// Clears all trails.
    pub fn clear(&mut self) {
        self.paths.clear();
    }

    /// The trail of a tip, the oldest point first.
    pub fn of(&self, instrument: Entity) -> impl Iterator<Item = (SimTime, Point3<f64>)> + '_ {
        self.paths.get(&instrument).into_iter().flatten().copied()
    }

    /// Draws the trails, older parts fainter.
    pub fn draw(&self, overlays: &Overlays, sketch: &mut Sketch) {
        for (path, [r, g, b]) in self.paths.values().zip(COLORS.into_iter().cycle()) {
            let color = |at: SimTime| {
                let age = self.now.since(at).as_secs_f64() / overlays.trail_secs.max(1e-3);
                [r, g, b, ((1.0 - age).clamp(0.0, 1.0) * 255.0) as u8]
            };
            let stroke = Stroke { color: [r, g, b, 255], width: overlays.line_width, hidden: 0.3 };
            for ((from_time, from), (to_time, to)) in path.iter().zip(path.iter().skip(1)) {
                if (to - from).norm() < LEAP {
                    sketch.fading_line((from, color(*from_time)), (to, color(*to_time)), &stroke);
                }
            }
        }
    }
}
