//! Outcome of a scene: measurements of simulators and stiffnesses felt by hands must be within bounds at the end.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use trocar_scene::components::OUTCOME;
use trocar_scene::readable::{given, number};
use trocar_scene::{
    Access, BuildContext, Commands, Component, Controller, ControllerError, EntitySet, Frozen, HapticStatus,
    HeatFrozen, Measured, Parent, Pose, RecordPolicy, Snapshot, TaskError, TaskState, Tick,
};

/// Most expectations of a scenario.
const EXPECTATIONS_MAX: usize = 256;
/// Suffixes of an entity's position in world, per axis \[m\]: `ring.lifted.z_m`.
const PLACE: [&str; 3] = [".x_m", ".y_m", ".z_m"];
/// Suffix of the stiffness felt by a hand \[N/m\]: `hand.left.felt_stiffness_n_per_m`.
const FELT_STIFFNESS: &str = ".felt_stiffness_n_per_m";

/// Statistic of a quantity that is judged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Which {
    /// The final value.
    #[default]
    Last,
    /// The maximum.
    Largest,
    /// The minimum.
    Smallest,
    /// The mean over all measurements; a stiffness is measured only while a hand presses.
    Mean,
}

/// Expectation of one quantity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Expectation {
    /// Its name: a simulator's measurement, as `gauze.cut_area_m2`; a hand's with `.felt_stiffness_n_per_m`; or any
    /// entity's with `.x_m`, `.y_m`, `.z_m`, its position in world.
    pub measure: String,
    /// The judged statistic.
    #[serde(default)]
    pub which: Which,
    /// Smallest accepted value.
    #[serde(default = "anything_above")]
    pub min: f64,
    /// Largest accepted value.
    #[serde(default = "anything_below")]
    pub max: f64,
}

fn anything_above() -> f64 {
    f64::MIN
}
fn anything_below() -> f64 {
    f64::MAX
}

impl Expectation {
    /// Its key among the values: quantity and statistic.
    fn key(&self) -> String {
        let which = match self.which {
            Which::Last => return self.measure.clone(),
            Which::Largest => "largest",
            Which::Smallest => "smallest",
            Which::Mean => "mean",
        };
        format!("{}.{which}", self.measure)
    }

    /// Why it is not met, with the value and the bound: `gauze.pieces is 1, at least 2 is expected`.
    fn failure(&self, value: Option<f64>) -> String {
        let key = self.key();
        match value {
            Some(value) if value < self.min => {
                format!("{key} is {}, at least {} is expected", told(value, self.min), given(self.min))
            }
            Some(value) => {
                format!("{key} is {}, at most {} is expected", told(value, self.max), given(self.max))
            }
            None => format!("{key} was not measured: nothing in the scene gives '{}'", self.measure),
        }
    }
}

/// A value beside the bound that it misses: with few digits where those tell the two apart, else with all of them.
fn told(value: f64, bound: f64) -> String {
    let few = number(value).to_string();
    if few == number(bound).to_string() || few == given(bound) { given(value) } else { few }
}

/// The judgement as a scenario file describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutcomeConfig {
    /// Time of the judgement \[s\].
    pub seconds: f64,
    /// The expectations at that time.
    #[serde(default)]
    pub expect: Vec<Expectation>,
}

impl OutcomeConfig {
    /// Refuses invalid expectations.
    ///
    /// # Errors
    /// Names the problem, and what would be valid.
    pub fn check(&self) -> Result<(), String> {
        if !(0.0..=86_400.0).contains(&self.seconds) {
            return Err(format!("seconds: {} is out of range (0 to 86,400)", given(self.seconds)));
        }
        if self.expect.len() > EXPECTATIONS_MAX {
            return Err(format!(
                "expect: {} expectations are too many (at most {EXPECTATIONS_MAX})",
                self.expect.len()
            ));
        }
        let empty = self.expect.iter().find(|expected| expected.min.is_nan() || expected.min > expected.max);
        match empty {
            Some(Expectation { measure, min, max, .. }) => {
                Err(format!("'{measure}': no value is at least {min} and at most {max}"))
            }
            None => Ok(()),
        }
    }
}

/// The statistics so far, in the order of the expectations.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "outcome_state", record = RecordPolicy::sampled(10.0, 1e-6))]
pub struct OutcomeState {
    /// `None` until it has been measured.
    pub values: Vec<Option<f64>>,
    /// How often each was measured.
    #[serde(default)]
    pub counts: Vec<u64>,
    /// Bodies stopped by their simulators, with the reason.
    pub frozen: Vec<String>,
    /// Whether the judgement is done.
    pub over: bool,
}

/// Judges a scene when its time is over.
pub struct OutcomeController {
    config: OutcomeConfig,
    name: String,
    state: OutcomeState,
}

impl OutcomeController {
    /// Continues where an earlier life stopped.
    ///
    /// # Errors
    /// When an expectation is invalid.
    pub fn new(config: &OutcomeConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        config.check().map_err(|reason| ControllerError::Scene(format!("outcome: {reason}")))?;
        let mut state = context.scene.get::<OutcomeState>(context.me).cloned().unwrap_or_default();
        state.values.resize(config.expect.len(), None);
        state.counts.resize(config.expect.len(), 0);
        Ok(Self { config: config.clone(), name: context.name.to_owned(), state })
    }

    fn look(&mut self, scene: &Snapshot) {
        self.state.frozen.clear();
        let frozen = scene.iter::<Frozen>();
        let told = |(body, frozen): (_, &Frozen)| format!("{} frozen: {}", scene.name(body), frozen.reason);
        self.state.frozen.extend(frozen.map(told));
        let heat = scene.iter::<HeatFrozen>();
        let heat = heat.map(|(body, heat)| format!("heat of {} frozen: {}", scene.name(body), heat.reason));
        self.state.frozen.extend(heat);
        let values = self.state.values.iter_mut().zip(&mut self.state.counts);
        for (expected, (value, count)) in self.config.expect.iter().zip(values) {
            let Some(now) = measured(scene, &expected.measure) else { continue };
            *count += 1;
            let before = value.unwrap_or(now);
            *value = Some(match expected.which {
                Which::Last => now,
                Which::Largest => before.max(now),
                Which::Smallest => before.min(now),
                Which::Mean => before + (now - before) / *count as f64,
            });
        }
    }

    fn judged(&self, secs: f64) -> TaskState {
        let over = self.state.over;
        let mut outcome = BTreeMap::new();
        let mut errors = Vec::new();
        let mut done = 0;
        for (expected, value) in self.config.expect.iter().zip(&self.state.values) {
            if let Some(value) = value {
                outcome.insert(expected.key(), *value);
            }
            if value.is_some_and(|value| value >= expected.min && value <= expected.max) {
                done += 1;
            } else if over {
                errors.push(TaskError { kind: expected.failure(*value), at_secs: secs, entity: None });
            }
        }
        errors.extend(self.state.frozen.iter().map(|kind| TaskError {
            kind: kind.clone(),
            at_secs: secs,
            entity: None,
        }));
        let steps = self.config.expect.len() as u32;
        let score = over.then(|| if steps == 0 { 100.0 } else { 100.0 * f64::from(done) / f64::from(steps) });
        TaskState {
            task: self.name.clone(),
            phase: if over { "over".into() } else { "running".into() },
            done,
            steps,
            seconds: secs,
            over,
            completed: over && done == steps && self.state.frozen.is_empty(),
            cut_off: false,
            score,
            errors,
            metrics: [(OUTCOME.to_owned(), outcome)].into(),
        }
    }
}

/// Current value of a quantity: a measurement, a felt stiffness, or a position; `None` if there is none.
fn measured(scene: &Snapshot, name: &str) -> Option<f64> {
    if let Some(hand) = name.strip_suffix(FELT_STIFFNESS) {
        let status = scene.get::<HapticStatus>(scene.find(hand)?)?;
        return Some(status.felt_stiffness).filter(|stiffness| *stiffness > 0.0);
    }
    let told = scene.iter::<Measured>().find_map(|(_, all)| all.values.get(name)).copied();
    told.or_else(|| {
        let (axis, entity) =
            PLACE.iter().enumerate().find_map(|(axis, what)| Some((axis, name.strip_suffix(what)?)))?;
        let entity = scene.find(entity)?;
        scene.get::<Pose>(entity)?;
        Some(scene.world_pose(entity).translation.vector[axis])
    })
}

impl Controller for OutcomeController {
    fn access(&self) -> Access {
        Access::new()
            .reads::<Measured>()
            .reads::<Frozen>()
            .reads::<Pose>()
            .reads::<Parent>()
            .reads::<HapticStatus>()
            .reads::<HeatFrozen>()
            .writes::<TaskState>(EntitySet::Own)
            .writes::<OutcomeState>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if self.state.over {
            return Ok(());
        }
        self.look(scene);
        let secs = tick.time.as_secs_f64();
        self.state.over = secs >= self.config.seconds;
        out.put(tick.me, self.judged(secs));
        out.put(tick.me, self.state.clone());
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{EntityAllocator, Name, RegistryBuilder, SimTime, Store};

    fn judge(values: &[Option<f64>], over: bool) -> TaskState {
        let expect =
            |measure: &str, min, max| Expectation { measure: measure.into(), which: Which::Last, min, max };
        let config = OutcomeConfig {
            seconds: 1.0,
            expect: vec![expect("area_m2", 1.0, 2.0), expect("force_n", f64::MIN, 3.0)],
        };
        let state = OutcomeState { values: values.to_vec(), over, ..OutcomeState::default() };
        OutcomeController { config, name: "judge".into(), state }.judged(1.0)
    }

    #[test]
    fn what_is_within_its_bounds_counts_and_what_is_not_is_named() {
        let good = judge(&[Some(1.5), Some(-4.0)], true);
        assert!(good.completed && good.over && good.errors.is_empty() && good.score == Some(100.0));
        assert_eq!(good.metrics["outcome"]["area_m2"], 1.5);
        let bad = judge(&[Some(0.5), None], true);
        assert!(!bad.completed && bad.over && bad.score == Some(0.0));
        let kinds: Vec<&str> = bad.errors.iter().map(|error| error.kind.as_str()).collect();
        let missing = "force_n was not measured: nothing in the scene gives 'force_n'";
        assert_eq!(kinds, ["area_m2 is 0.5, at least 1 is expected", missing]);
        let early = judge(&[Some(1.5), None], false);
        assert!(
            !early.completed && !early.over && early.errors.is_empty() && (early.done, early.steps) == (1, 2)
        );
    }

    #[test]
    fn what_fails_is_named_with_its_value_and_its_bound() {
        let expect = |which, min, max| Expectation { measure: "gauze.area_m2".into(), which, min, max };
        let cases = [
            (expect(Which::Last, 2.0, f64::MAX), 1.0, "gauze.area_m2 is 1, at least 2 is expected"),
            (
                expect(Which::Smallest, 1e-5, 1.0),
                2.5e-6,
                "gauze.area_m2.smallest is 2.5e-6, at least 1e-5 is expected",
            ),
            (
                expect(Which::Largest, f64::MIN, 0.0),
                137_571.0,
                "gauze.area_m2.largest is 137,571, at most 0 is expected",
            ),
            (
                expect(Which::Mean, 0.0, 0.5),
                0.500_04,
                "gauze.area_m2.mean is 0.50004, at most 0.5 is expected",
            ),
            (expect(Which::Last, 0.0, 0.5), f64::INFINITY, "gauze.area_m2 is inf, at most 0.5 is expected"),
        ];
        for (expected, value, told) in cases {
            assert_eq!(expected.failure(Some(value)), told);
        }
    }

    #[test]
    fn what_a_hand_feels_is_judged_by_its_mean_while_it_feels_it() {
        let mut builder = RegistryBuilder::new();
        trocar_scene::components::register(&mut builder).expect("names are free");
        crate::register(&mut builder).expect("names are free");
        let mut store = Store::new(builder.build());
        let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 0));
        let hand = out.spawn();
        out.put(hand, Name("hand.left".into()));
        let measure = format!("hand.left{FELT_STIFFNESS}");
        let expect = vec![Expectation { measure, which: Which::Mean, min: 150.0, max: 250.0 }];
        let state = OutcomeState { values: vec![None], counts: vec![0], ..OutcomeState::default() };
        let config = OutcomeConfig { seconds: 1.0, expect };
        let mut judge = OutcomeController { config, name: "judge".into(), state };
        for (at, felt_stiffness) in [0.0, 100.0, 0.0, 300.0, 200.0, 0.0].into_iter().enumerate() {
            out.put(hand, HapticStatus { felt_stiffness, ..HapticStatus::default() });
            out.seal();
            store.apply(&mut out, SimTime::from_millis(at as u64));
            out.clear();
            judge.look(&store.snapshot());
        }
        assert_eq!(judge.state.values, [Some(200.0)]);
        judge.state.over = true;
        let judged = judge.judged(1.0);
        assert!(judged.completed);
        assert_eq!(judged.metrics["outcome"]["hand.left.felt_stiffness_n_per_m.mean"], 200.0);
    }

    #[test]
    fn where_something_is_in_world_is_judged_along_each_axis_and_what_nobody_knows_is_not() {
        let mut builder = RegistryBuilder::new();
        trocar_scene::components::register(&mut builder).expect("names are free");
        crate::register(&mut builder).expect("names are free");
        let mut store = Store::new(builder.build());
        let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 0));
        let [table, ring] = [out.spawn(), out.spawn()];
        out.put(table, Pose::at(0.1, 0.2, 0.3));
        out.put(ring, Name("ring".into()));
        out.put(ring, Parent(table));
        out.put(ring, Pose::at(0.01, 0.02, 0.03));
        out.seal();
        store.apply(&mut out, SimTime::ZERO);
        let found = ["ring.x_m", "ring.y_m", "ring.z_m"].map(|name| measured(&store.snapshot(), name));
        for (found, wanted) in found.into_iter().zip([0.11, 0.22, 0.33]) {
            assert!((found.expect("it is somewhere") - wanted).abs() < 1e-12, "{found:?} for {wanted}");
        }
        for unknown in ["ring.w_m", "ring", "rings.x_m", ".x_m"] {
            assert_eq!(measured(&store.snapshot(), unknown), None, "{unknown}");
        }
    }

    #[test]
    fn bounds_that_nothing_can_be_within_are_refused() {
        let expect = vec![Expectation { measure: "x".into(), which: Which::Last, min: 2.0, max: 1.0 }];
        let error = OutcomeConfig { seconds: 1.0, expect }.check().unwrap_err();
        assert!(error.contains("'x'"), "{error}");
        assert!(OutcomeConfig { seconds: f64::NAN, expect: Vec::new() }.check().is_err());
    }
}
