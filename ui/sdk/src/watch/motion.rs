//! Motion metrics of each hand for exercises that take none themselves: those of a program of one's own, and those that
//! are judged by measurements.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use trocar_scene::{Entity, Hand, Snapshot, TaskState};

use crate::tasks::{IDLE_SPEED_DEFAULT, MotionMetrics};

/// The motion of each hand's instrument while an exercise runs.
///
/// A stretch, of which the economy of motion takes the straight line, ends whenever the exercise enters another phase or
/// has done another step.
#[derive(Clone, Debug, Default)]
pub struct HandMotions {
    hands: BTreeMap<Entity, MotionMetrics>,
    names: BTreeMap<Entity, String>,
    progress: Option<(u32, String)>,
}

impl HandMotions {
    /// Samples the scene at `secs` of the session. Does nothing before an exercise has begun and after it is over.
    pub fn look(&mut self, secs: f64, scene: &Snapshot) {
        let Some((_, task)) = scene.iter::<TaskState>().next().filter(|(_, task)| !task.over) else { return };
        let has_progressed =
            self.progress.as_ref().is_some_and(|(done, phase)| (*done, phase) != (task.done, &task.phase));
        for (hand, of) in scene.iter::<Hand>() {
            let tip = scene.world_pose(of.instrument);
            let motion = self.hands.entry(hand).or_default();
            let tip_in_world = Point3::from(tip.translation.vector);
            motion.sample(secs, tip_in_world, tip.rotation * Vector3::z(), IDLE_SPEED_DEFAULT);
            if has_progressed {
                motion.mark();
            }
            self.names.entry(hand).or_insert_with(|| name(scene, hand, of));
        }
        if has_progressed || self.progress.is_none() {
            self.progress = Some((task.done, task.phase.clone()));
        }
    }

    /// Adds the metrics of each hand for which the exercise has none.
    pub fn complete(&self, metrics: &mut BTreeMap<String, BTreeMap<String, f64>>) {
        for (hand, motion) in &self.hands {
            let Some(name) = self.names.get(hand) else { continue };
            metrics.entry(name.clone()).or_insert_with(|| motion.named());
        }
    }
}

/// A hand's side; where several have the same, their names.
fn name(scene: &Snapshot, hand: Entity, of: &Hand) -> String {
    let is_alone = scene.iter::<Hand>().filter(|(_, other)| other.side == of.side).count() == 1;
    if is_alone { of.side.as_str().to_owned() } else { scene.name(hand) }
}
