//! Golden digests: two short numbers for a scenario's behaviour in lock-step, which a change of the code must not
//! change.
//!
//! The *state hash* is the session's own chain over all commits. The *digest of motion* covers only poses and the state
//! of the exercise, by the names of the entities: no component names, no schema, no writers. Moving code changes
//! neither. Renaming a component, a writer or a marker may change the state hash, never the digest of motion.
//!
//! `tests/golden.toml` holds both for each scenario and seed. Factorisations by `faer` choose their block sizes by the
//! processor, so their last bits differ between processors: each row names the [`arithmetic`] that it holds for.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use trocar_scene::{Pose, SimTime, Snapshot, TaskState, VertexPositions};

/// Sampling interval of the motion.
pub const LOOK_EVERY: SimTime = SimTime::from_millis(100);

/// `tests/golden.toml`.
#[derive(Clone, Debug, Default, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Golden {
    /// All recorded runs.
    pub run: Vec<GoldenRun>,
}

/// One run of a scenario in lock-step.
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct GoldenRun {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of everything random.
    pub seed: u64,
    /// Duration of the run in session time \[s\], or until the exercise is over.
    pub seconds: f64,
    /// The [`arithmetic`] that it holds for; `any` for every one.
    pub arithmetic: String,
    /// The state hash at the end, its first 128 bits.
    pub state: String,
    /// The digest of motion.
    pub motion: String,
}

/// The digest of motion of a session.
#[derive(Default)]
pub struct MotionDigest(blake3::Hasher);

impl MotionDigest {
    /// Adds the present poses and the state of the exercise.
    pub fn look(&mut self, scene: &Snapshot) {
        let mut named: Vec<_> = scene.entities().map(|entity| (scene.name(entity), entity)).collect();
        named.sort();
        self.number(scene.time().0 as f64);
        for (name, entity) in named {
            let (pose, vertices) = (scene.get::<Pose>(entity), scene.get::<VertexPositions>(entity));
            if pose.is_none() && vertices.is_none() {
                continue;
            }
            self.text(&name);
            if let Some(pose) = pose {
                let pose = pose.isometry();
                pose.translation
                    .vector
                    .iter()
                    .chain(pose.rotation.coords.iter())
                    .for_each(|x| self.number(*x));
            }
            if let Some(vertices) = vertices {
                self.number(vertices.positions.len() as f64);
                vertices.positions.iter().flat_map(|point| point.coords.iter()).for_each(|x| self.number(*x));
            }
        }
        for (entity, task) in scene.iter::<TaskState>() {
            self.text(&scene.name(entity));
            self.task(task);
        }
    }

    /// The first 128 bits, in hexadecimal.
    pub fn finish(&self) -> String {
        self.0.finalize().to_hex()[..32].to_owned()
    }

    fn task(&mut self, task: &TaskState) {
        self.text(&task.phase);
        for number in [f64::from(task.done), f64::from(task.steps), task.seconds, task.score.unwrap_or(-1.0)]
        {
            self.number(number);
        }
        self.0.update(&[task.over, task.completed, task.cut_off].map(u8::from));
        for error in &task.errors {
            self.text(&error.kind);
            self.number(error.at_secs);
        }
        for (owner, values) in &task.metrics {
            self.text(owner);
            for (name, value) in values {
                self.text(name);
                self.number(*value);
            }
        }
    }

    fn number(&mut self, number: f64) {
        self.0.update(&number.to_bits().to_le_bytes());
    }

    fn text(&mut self, text: &str) {
        self.0.update(&(text.len() as u64).to_le_bytes());
        self.0.update(text.as_bytes());
    }
}

/// Identifies the processor's arithmetic: a short number over the results of a few factorisations and matrix products,
/// and of the system's mathematical functions, which differ in their last bits.
pub fn arithmetic() -> String {
    use faer::{Mat, Par, Side};
    faer::set_global_parallelism(Par::Seq);
    let mut digest = MotionDigest::default();
    // Sizes below and above the block sizes for caches of different sizes.
    for size in [5, 48, 170, 420] {
        let entry = |row: usize, column: usize| ((row * 31 + column * 17 + 3) as f64).sqrt().fract() - 0.5;
        let factor = Mat::from_fn(size, size, entry);
        let product = &factor * factor.transpose() + Mat::<f64>::identity(size, size) * faer::Scale(0.5);
        let single = Mat::from_fn(size, size, |row, column| entry(row, column) as f32);
        let singles = &single * single.transpose();
        let llt = product.llt(Side::Lower).expect("a positive definite matrix");
        for column in 0..size {
            for row in 0..size {
                digest.number(product[(row, column)]);
                digest.number(llt.L()[(row, column)]);
                digest.number(f64::from(singles[(row, column)]));
            }
        }
    }
    for step in 1..2_000 {
        let x = f64::from(step) * 0.017;
        for value in
            [x.sin(), x.cos(), x.exp(), x.ln(), x.powf(1.3), x.tan(), x.atan2(0.7), x.acosh().max(0.0)]
        {
            digest.number(value);
        }
    }
    digest.finish()[..8].to_owned()
}

/// Rows by scenario and seed.
pub fn by_run(rows: &[GoldenRun]) -> BTreeMap<(String, u64), Vec<&GoldenRun>> {
    let mut sorted: BTreeMap<(String, u64), Vec<&GoldenRun>> = BTreeMap::new();
    for row in rows {
        sorted.entry((row.scenario.clone(), row.seed)).or_default().push(row);
    }
    sorted
}
