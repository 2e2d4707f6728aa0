//! `/task`, `/task/phases`: the state of each exercise, and its phases as they begin.

use std::collections::BTreeMap;

use serde_json::{Value, json};
use trocar_scene::{Entity, Revision, SimTime, Snapshot, TaskState};

use super::super::format::channel;
use super::cadence::Cadence;
use super::numbers::{FORCE, rounded, significant};
use super::writers::WriterNames;
use super::{Message, without_nulls};

/// From one message to the next, where nothing but the clock has changed.
const PERIOD: SimTime = SimTime::from_millis(100);

/// What is judged of an exercise: a change of it is told at once.
#[derive(Clone, Debug, PartialEq)]
struct Judged {
    phase: String,
    done: u32,
    errors: usize,
    over: bool,
    completed: bool,
    score: Option<f64>,
}

impl Judged {
    fn of(task: &TaskState) -> Self {
        Self {
            phase: task.phase.clone(),
            done: task.done,
            errors: task.errors.len(),
            over: task.over,
            completed: task.completed,
            score: if task.over { task.score } else { None },
        }
    }
}

/// What has been told of the exercises.
pub(super) struct Tasks {
    cadence: Cadence,
    since: Revision,
    judged: BTreeMap<Entity, Judged>,
}

impl Default for Tasks {
    fn default() -> Self {
        Self { cadence: Cadence::new(PERIOD), since: Revision::ZERO, judged: BTreeMap::new() }
    }
}

impl Tasks {
    pub(super) fn begin_anew(&mut self) {
        self.since = Revision::ZERO;
    }

    /// Tells what has changed.
    pub(super) fn tell(
        &mut self,
        scene: &Snapshot,
        writers: &WriterNames,
        now: SimTime,
        message: &mut Message<'_>,
    ) {
        let is_due = self.cadence.is_due(now);
        // The entity of a writer is in no list of entities: what counts is the row.
        self.judged.retain(|entity, _| scene.get::<TaskState>(*entity).is_some());
        for (entity, task) in scene.iter::<TaskState>() {
            let judged = Judged::of(task);
            let before = self.judged.get(&entity);
            let is_newer = scene.changed::<TaskState>(entity).is_some_and(|revision| revision > self.since);
            let is_judged = before != Some(&judged);
            if before.is_none_or(|before| before.phase != judged.phase) {
                message(
                    channel::PHASES,
                    &phase(writers.name(scene, entity), task, before.map(|before| &*before.phase)),
                );
            }
            if is_judged || (is_due && is_newer) {
                message(channel::TASK, &state(writers.name(scene, entity), task));
            }
            if is_judged {
                self.judged.insert(entity, judged);
            }
        }
        if is_due {
            self.since = scene.revision();
        }
    }

    /// Tells everything.
    pub(super) fn tell_all(&mut self, scene: &Snapshot, writers: &WriterNames, message: &mut Message<'_>) {
        for (entity, task) in scene.iter::<TaskState>() {
            message(channel::TASK, &state(writers.name(scene, entity), task));
        }
    }
}

fn phase(exercise: String, task: &TaskState, before: Option<&str>) -> Value {
    without_nulls(json!({
        "exercise": exercise,
        "task": task.task,
        "phase": task.phase,
        "before": before,
        "done": task.done,
        "seconds": rounded(task.seconds, FORCE)
    }))
}

fn state(exercise: String, task: &TaskState) -> Value {
    // Metrics are many, and final only at the end.
    let metrics = task.metrics.iter().filter(|_| task.over).map(|(hand, metrics)| {
        let metrics: BTreeMap<_, _> =
            metrics.iter().map(|(name, value)| (name, significant(*value))).collect();
        (hand, metrics)
    });
    without_nulls(json!({
        "exercise": exercise,
        "task": task.task,
        "phase": task.phase,
        "done": task.done,
        "steps": task.steps,
        "seconds": rounded(task.seconds, FORCE),
        // Before the end a score is a forecast.
        "score": task.score.filter(|_| task.over).map(significant),
        "score_kind": task.score_kind(),
        "errors": task.errors.len(),
        "last_error": task.errors.last().map(|error| &error.kind),
        "over": task.over,
        "completed": task.completed,
        "cut_off": task.cut_off,
        "metrics": metrics.collect::<BTreeMap<_, _>>()
    }))
}
