//! Outcome of each fault (injected → detected → restarted → resumed), and the check against the plan's expectations.

use trocar_scene::SimTime;

use super::plan::{Expect, FaultPlan};
use crate::spec::{FaultKind, FaultRecord, FaultSink, RECORDER, takes};

/// The life of one fault, in session time.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultRow {
    /// The fault's id in the plan.
    pub id: String,
    /// The fault's target.
    pub target: String,
    /// Kind of the fault.
    pub kind: FaultKind,
    /// Planned duration; `None` for an instant fault or one that lasts to the end.
    pub lasting: Option<SimTime>,
    /// Time of injection.
    pub injected: Option<SimTime>,
    /// Time at which it ended by itself.
    pub healed: Option<SimTime>,
    /// Time of detection.
    pub detected: Option<SimTime>,
    /// Time at which the target was restarted; `None` for faults that heal.
    pub restarted: Option<SimTime>,
    /// Time of the target's first good work after the fault.
    pub resumed: Option<SimTime>,
}

impl FaultRow {
    /// Recovery time: from the injection (or the healing, for faults that heal) to the first good work. What was killed and
    /// nobody restarts, such as a link, is back by itself, and counts from the blow.
    pub fn recovery(&self) -> Option<SimTime> {
        let from = match (self.restarted, self.healed) {
            (None, Some(healed)) if self.kind != FaultKind::Kill => healed,
            _ => self.injected?,
        };
        Some(self.resumed?.since(from))
    }

    /// Whether the session ended, at `ended`, before the fault's duration was over.
    fn is_cut_off(&self, ended: SimTime) -> bool {
        let until = self.injected.zip(self.lasting).map(|(from, span)| from + span);
        self.healed.is_none() && until.is_some_and(|until| until > ended)
    }

    /// The row of the report.
    pub fn record(&self) -> FaultRecord {
        let secs = |time: Option<SimTime>| time.map(SimTime::as_secs_f64);
        FaultRecord {
            id: self.id.clone(),
            target: self.target.clone(),
            kind: self.kind,
            injected_secs: secs(self.injected),
            healed_secs: secs(self.healed),
            detected_secs: secs(self.detected),
            restarted_secs: secs(self.restarted),
            resumed_secs: secs(self.resumed),
        }
    }

    fn begun(&self) -> bool {
        self.injected.is_some() && self.resumed.is_none()
    }
}

/// Measured values of a run, compared with the plan's expectations.
#[derive(Clone, Copy, Debug, Default)]
pub struct Measured {
    /// Largest force at any driver after its clamp \[N\].
    pub force_newtons_max: f64,
    /// Restarts of the Model.
    pub model_restarts: u64,
    /// Whether the exercise was completed.
    pub task_completed: bool,
    /// End of the run: faults that it cut off are not evaluated.
    pub ended: SimTime,
}

/// Log with one row per fault of a plan, filled in from the driver's reports.
///
/// Every report may come at any time and any number of times: only the first one after the injection
/// counts, so a driver can report each good step without asking first.
#[derive(Clone, Debug, Default)]
pub struct FaultLog {
    rows: Vec<FaultRow>,
    open: usize,
}

impl FaultLog {
    /// One row per fault of the plan.
    pub fn new(plan: &FaultPlan) -> Self {
        let row = |fault: &super::FaultSpec| FaultRow {
            id: fault.id.clone(),
            target: fault.target.clone(),
            kind: fault.kind,
            lasting: fault.lasting.filter(|_| !fault.kind.is_instant()),
            injected: None,
            healed: None,
            detected: None,
            restarted: None,
            resumed: None,
        };
        Self { rows: plan.faults.iter().map(row).collect(), open: 0 }
    }

    /// Whether any injected fault has not yet recovered. Cheap, so that drivers can check it before composing a report.
    pub fn is_open(&self) -> bool {
        self.open > 0
    }

    /// Records that fault `index` of the plan took effect.
    pub fn injected(&mut self, index: usize, now: SimTime) {
        if let Some(row) = self.rows.get_mut(index).filter(|row| row.injected.is_none()) {
            row.injected = Some(now);
            if row.kind.is_of_clock() {
                // It goes on at once.
                (row.healed, row.resumed) = (Some(now), Some(now));
            } else {
                self.open += 1;
            }
        }
    }

    /// Records that fault `index` of the plan ended by itself.
    pub fn healed(&mut self, index: usize, now: SimTime) {
        if let Some(row) = self.rows.get_mut(index).filter(|row| row.begun()) {
            row.healed = Some(now);
        }
    }

    /// Targets with a fault from which they have not yet recovered.
    pub fn open_targets(&self) -> impl Iterator<Item = &str> {
        self.rows.iter().filter(|row| row.begun()).map(|row| row.target.as_str())
    }

    /// Records that a stall of the target ended before the supervisor replaced it.
    pub fn stall_ended(&mut self, target: &str, now: SimTime) {
        if self.open > 0 {
            for row in self.begun(target).filter(|row| row.kind == FaultKind::Stall) {
                row.healed.get_or_insert(now);
            }
        }
    }

    /// Records the state that an unsupervised target (a device, a disk) reports. When it is sound again after an
    /// instant fault, that fault has healed. The recorder's disk reports only faults of the disk.
    pub fn looked_at(&mut self, target: &str, sound: bool, now: SimTime) {
        if target == RECORDER {
            self.disk_looked_at(sound, now);
            return;
        }
        if !sound {
            self.detected(target, now);
            return;
        }
        for row in self.begun(target).filter(|row| row.kind.is_instant() && row.detected.is_some()) {
            row.healed.get_or_insert(now);
        }
        self.resumed(target, now);
    }

    fn disk_looked_at(&mut self, sound: bool, now: SimTime) {
        let rows = self.rows.iter_mut().filter(|row| row.begun() && row.kind.is_of_disk());
        for row in rows.filter(|row| row.target == RECORDER) {
            if !sound {
                row.detected.get_or_insert(now);
            } else if row.healed.is_some() {
                row.resumed = Some(now);
                self.open -= 1;
            }
        }
    }

    /// Records that a failure of the target was detected.
    pub fn detected(&mut self, target: &str, now: SimTime) {
        for row in self.begun(target).filter(|row| row.detected.is_none()) {
            row.detected = Some(now);
        }
    }

    /// Records a restart of the target.
    pub fn restarted(&mut self, target: &str, now: SimTime) {
        for row in self.begun(target).filter(|row| row.detected.is_some() && row.restarted.is_none()) {
            row.restarted = Some(now);
        }
    }

    /// Records good work of the target: its batch was applied, its sample was sound, its tick came on time.
    pub fn resumed(&mut self, target: &str, now: SimTime) {
        if self.open == 0 {
            return;
        }
        let mut closed = 0;
        for row in self.begun(target).filter(|row| row.restarted.is_some() || row.healed.is_some()) {
            row.resumed = Some(now);
            closed += 1;
        }
        self.open -= closed;
    }

    /// The rows in the order of the plan.
    pub fn rows(&self) -> &[FaultRow] {
        &self.rows
    }

    /// The target's own active faults: restarting the writer does not cure a full disk.
    fn begun(&mut self, target: &str) -> impl Iterator<Item = &mut FaultRow> {
        self.rows.iter_mut().filter(move |row| row.begun() && row.target == target && !row.kind.is_of_disk())
    }
}

impl Expect {
    /// Failed expectations, one sentence each; empty when all hold.
    pub fn failures(&self, rows: &[FaultRow], measured: &Measured) -> Vec<String> {
        let mut failures = Vec::new();
        if let Some(limit) = self.recovery_secs_max {
            for row in rows {
                recovery_failure(row, limit, measured.ended, &mut failures);
            }
        }
        if let Some(limit) = self.force_newtons_max
            && (measured.force_newtons_max > limit || measured.force_newtons_max.is_nan())
        {
            failures.push(format!("force {:.3} N is above {limit} N", measured.force_newtons_max));
        }
        if let Some(limit) = self.model_restarts_max
            && measured.model_restarts > limit
        {
            failures.push(format!(
                "the Model restarted {} times, at most {limit} allowed",
                measured.model_restarts
            ));
        }
        if let Some(expected) = self.task_completed
            && measured.task_completed != expected
        {
            let said = |completed: bool| if completed { "completed" } else { "not completed" };
            failures.push(format!(
                "the exercise was {}, expected {}",
                said(measured.task_completed),
                said(expected)
            ));
        }
        failures
    }
}

fn recovery_failure(row: &FaultRow, limit: f64, ended: SimTime, failures: &mut Vec<String>) {
    let Some(injected) = row.injected else {
        failures.push(format!("fault '{}' never took effect", row.id));
        return;
    };
    match row.recovery() {
        Some(span) if span.as_secs_f64() <= limit => {}
        Some(span) => failures.push(format!(
            "fault '{}': '{}' resumed after {:.3} s, allowed {limit} s",
            row.id,
            row.target,
            span.as_secs_f64()
        )),
        // The run ended before the fault did: no verdict is possible.
        None if row.is_cut_off(ended) => {}
        None if ended.since(row.healed.unwrap_or(injected)).as_secs_f64() < limit => {}
        None => failures.push(format!("fault '{}': '{}' never resumed", row.id, row.target)),
    }
}

/// What a sink of many targets says of those that have not yet recovered.
pub(crate) fn soundness(log: &FaultLog, name: &str, sink: &dyn FaultSink) -> Vec<(String, bool)> {
    if !log.is_open() || !name.ends_with('*') {
        return Vec::new();
    }
    let targets = log.open_targets().filter(|target| takes(name, target));
    targets.filter_map(|target| Some((target.to_owned(), sink.is_target_sound(target)?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::faults::secs;

    fn plan() -> FaultPlan {
        FaultPlan::new(7)
            .at(secs(1.0))
            .kill("engine")
            .at(secs(2.0))
            .lasting(secs(1.0))
            .queue_full("engine")
            .at(secs(9.0))
            .kill("task")
    }

    #[test]
    fn a_kill_runs_through_its_four_stages() {
        let mut log = FaultLog::new(&plan());
        log.detected("engine", secs(0.5));
        log.resumed("engine", secs(0.6));
        assert_eq!(log.rows()[0].detected, None, "nothing counts before the injection");
        log.injected(0, secs(1.0));
        log.resumed("engine", secs(1.0));
        log.restarted("engine", secs(1.0));
        assert_eq!((log.rows()[0].restarted, log.rows()[0].resumed), (None, None), "not detected yet");
        log.detected("task", secs(1.0));
        log.detected("engine", secs(1.001));
        log.detected("engine", secs(1.002));
        log.restarted("engine", secs(1.020));
        log.resumed("engine", secs(1.022));
        log.resumed("engine", secs(1.024));
        let row = &log.rows()[0];
        assert_eq!(row.detected, Some(secs(1.001)));
        assert_eq!(row.restarted, Some(secs(1.020)));
        assert_eq!(row.resumed, Some(secs(1.022)));
        assert_eq!(row.recovery(), Some(secs(0.022)));
        assert!(!log.is_open());
    }

    #[test]
    fn a_fault_that_heals_is_measured_from_its_healing() {
        let mut log = FaultLog::new(&plan());
        log.injected(1, secs(2.0));
        log.detected("engine", secs(2.002));
        log.resumed("engine", secs(2.5));
        assert_eq!(log.rows()[1].resumed, None, "still broken");
        log.healed(1, secs(3.0));
        log.resumed("engine", secs(3.004));
        assert_eq!(log.rows()[1].recovery(), Some(secs(0.004)));
        assert_eq!(log.rows()[1].restarted, None);
    }

    #[test]
    fn a_device_that_is_killed_or_unplugged_tells_itself_when_it_is_back() {
        let plan = FaultPlan::new(7)
            .at(secs(1.0))
            .fault(FaultKind::Kill, "device.left")
            .at(secs(2.0))
            .lasting(secs(1.0))
            .unplug("device.left");
        let mut log = FaultLog::new(&plan);
        log.injected(0, secs(1.0));
        log.looked_at("device.left", true, secs(1.0));
        assert_eq!(log.rows()[0].resumed, None, "nobody has noticed anything yet");
        log.looked_at("device.left", false, secs(1.001));
        log.looked_at("device.left", true, secs(1.1));
        let row = &log.rows()[0];
        assert_eq!((row.detected, row.resumed), (Some(secs(1.001)), Some(secs(1.1))));
        log.injected(1, secs(2.0));
        log.looked_at("device.left", false, secs(2.001));
        log.looked_at("device.left", true, secs(2.5));
        assert_eq!(log.rows()[1].resumed, None, "still unplugged, whatever it says");
        log.healed(1, secs(3.0));
        log.looked_at("device.left", true, secs(3.01));
        assert_eq!(log.rows()[1].resumed, Some(secs(3.01)));
    }

    #[test]
    fn of_a_fault_that_outlasts_the_run_nothing_can_be_said() {
        let mut log = FaultLog::new(&plan());
        log.injected(1, secs(2.0));
        let lasting = log.rows()[1].lasting.expect("it heals");
        let expect = Expect { recovery_secs_max: Some(0.01), ..Expect::default() };
        let judged = |log: &FaultLog, ended: SimTime| {
            let measured =
                Measured { force_newtons_max: 0.0, model_restarts: 0, task_completed: false, ended };
            expect.failures(&log.rows()[1..=1], &measured).len()
        };
        assert_eq!(judged(&log, secs(2.5)), 0);
        assert_eq!(judged(&log, secs(2.0) + lasting + secs(1.0)), 1, "it should have healed");
    }

    #[test]
    fn a_recorder_that_is_killed_on_a_full_disk_has_two_faults_of_their_own() {
        let plan =
            FaultPlan::new(7).at(secs(1.0)).lasting(secs(2.0)).disk_full().at(secs(2.0)).kill(RECORDER);
        let mut log = FaultLog::new(&plan);
        log.injected(0, secs(1.0));
        log.looked_at(RECORDER, false, secs(1.5));
        log.injected(1, secs(2.0));
        log.looked_at(RECORDER, true, secs(2.0));
        assert_eq!((log.rows()[0].resumed, log.rows()[1].healed), (None, None), "full, and not yet dead");
        log.detected(RECORDER, secs(2.02));
        log.restarted(RECORDER, secs(2.02));
        log.resumed(RECORDER, secs(2.04));
        assert_eq!((log.rows()[0].restarted, log.rows()[0].resumed), (None, None), "still full");
        assert_eq!(log.rows()[1].resumed, Some(secs(2.04)));
        log.healed(0, secs(3.0));
        log.looked_at(RECORDER, true, secs(3.5));
        assert_eq!(log.rows()[0].recovery(), Some(secs(0.5)));
        assert!(!log.is_open());
    }

    #[test]
    fn expectations_name_what_failed() {
        let mut log = FaultLog::new(&plan());
        log.injected(0, secs(1.0));
        log.detected("engine", secs(1.0));
        log.restarted("engine", secs(1.1));
        log.resumed("engine", secs(1.5));
        log.injected(1, secs(2.0));
        log.healed(1, secs(3.0));
        let expect = Expect {
            recovery_secs_max: Some(0.1),
            force_newtons_max: Some(3.3),
            model_restarts_max: Some(0),
            task_completed: Some(true),
        };
        let measured = Measured {
            force_newtons_max: f64::NAN,
            model_restarts: 1,
            task_completed: false,
            ended: secs(10.0),
        };
        let failures = expect.failures(log.rows(), &measured);
        assert_eq!(failures.len(), 6, "{failures:#?}");
        assert!(failures[0].contains("0.500 s") && failures[1].contains("never resumed"));
        assert!(failures[2].contains("never took effect") && failures[3].contains("force"));
        let measured =
            Measured { force_newtons_max: 3.3, model_restarts: 0, task_completed: true, ended: secs(1.55) };
        assert!(expect.failures(&log.rows()[..1], &measured).len() == 1);
        assert!(Expect::default().failures(log.rows(), &measured).is_empty());
    }

    #[test]
    fn the_report_has_the_promised_keys() {
        let log = FaultLog::new(&plan());
        let json = serde_json::to_value(log.rows()[0].record()).expect("serialises");
        let keys: Vec<&str> = json.as_object().expect("object").keys().map(String::as_str).collect();
        let promised = [
            "id",
            "target",
            "kind",
            "injected_secs",
            "healed_secs",
            "detected_secs",
            "restarted_secs",
            "resumed_secs",
        ];
        for key in promised {
            assert!(keys.contains(&key), "{key}");
        }
        assert_eq!(keys.len(), promised.len());
    }
}
