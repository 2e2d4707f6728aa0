//! Statistics of every controller: rates, lateness, step time, losses, restarts.

use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

use super::contribution_stats::{HitCounts, Hits};
use super::histogram::{AtomicHistogram, Bars, Quantiles};
use super::sched;
use crate::admission::Rejection;

/// A tick that starts later than this counts as missed in `on_time`, ns.
pub const ON_TIME_NS: u64 = 1_000_000;

/// Counters that a controller's host updates at every tick and any thread may read. They last for the whole session,
/// across restarts.
pub struct TickStats {
    name: String,
    rate_hz: f64,
    lateness: AtomicHistogram,
    step: AtomicHistogram,
    queue_age: AtomicHistogram,
    ran: AtomicU64,
    late: AtomicU64,
    missed: AtomicU64,
    rejected: AtomicU64,
    /// Why the first batch was refused that was not just of an earlier life.
    refusal: OnceLock<Rejection>,
    conflicts: AtomicU64,
    dropped: AtomicU64,
    account: [AtomicU64; 5],
    restarts: AtomicU32,
    demotions: AtomicU32,
    hits: HitCounts,
    /// Due time of the first tick, and the end of the last tick's period, ns of session time; 0: none yet.
    first_due: AtomicU64,
    last_due: AtomicU64,
    /// Thread whose CPU time is being counted; 0: none.
    thread: AtomicU32,
    /// CPU time of earlier threads, ns.
    cpu_before: AtomicU64,
    cpu_now: AtomicU64,
}

impl TickStats {
    /// Statistics with all counters at zero.
    pub fn new(name: impl Into<String>, rate_hz: f64) -> Self {
        Self {
            name: name.into(),
            rate_hz,
            lateness: AtomicHistogram::default(),
            step: AtomicHistogram::default(),
            queue_age: AtomicHistogram::default(),
            ran: AtomicU64::new(0),
            late: AtomicU64::new(0),
            missed: AtomicU64::new(0),
            rejected: AtomicU64::new(0),
            refusal: OnceLock::new(),
            conflicts: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
            account: Default::default(),
            restarts: AtomicU32::new(0),
            demotions: AtomicU32::new(0),
            hits: HitCounts::default(),
            first_due: AtomicU64::new(u64::MAX),
            last_due: AtomicU64::new(0),
            thread: AtomicU32::new(0),
            cpu_before: AtomicU64::new(0),
            cpu_now: AtomicU64::new(0),
        }
    }
    /// Name of the controller.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Records that the tick due at `due` has run.
    pub fn ran(&self, due: SimTime, lateness: SimTime, step: SimTime) {
        self.ran.fetch_add(1, Ordering::Relaxed);
        self.lateness.record(lateness.0);
        self.step.record(step.0);
        if lateness.0 >= ON_TIME_NS {
            self.late.fetch_add(1, Ordering::Relaxed);
        }
        self.first_due.fetch_min(due.0, Ordering::Relaxed);
        self.last_due.fetch_max(due.0, Ordering::Relaxed);
    }
    /// Records how many entries a tick contributed to shared lists; `None`: its previous entries stay valid.
    pub fn found(&self, listed: Option<u64>) {
        self.hits.tick(listed);
    }
    /// Counts `count` scheduled ticks that never ran.
    pub fn missed(&self, count: u64) {
        self.missed.fetch_add(count, Ordering::Relaxed);
    }
    /// Counts a batch refused at its own handle: the ring was full, or the writer exceeded its flow limit.
    pub fn dropped(&self) {
        self.dropped.fetch_add(1, Ordering::Relaxed);
    }
    /// Records the age of a batch, from sealing to when the Model took it.
    pub fn waited(&self, age: SimTime) {
        self.queue_age.record(age.0);
    }
    /// Sets the account of all batches sent so far.
    pub fn set_account(&self, account: Account) {
        let Account { sent, applied, lost, delayed, duplicated } = account;
        for (counter, value) in self.account.iter().zip([sent, applied, lost, delayed, duplicated]) {
            counter.store(value, Ordering::Relaxed);
        }
    }
    /// Counts a batch that the Model rejected.
    pub fn rejected(&self, why: &Rejection) {
        self.rejected.fetch_add(1, Ordering::Relaxed);
        if !matches!(why, Rejection::StaleEpoch { .. }) && self.refusal.get().is_none() {
            // The first one counts; another thread's is as good.
            let _ = self.refusal.set(why.clone());
        }
    }
    /// Counts a batch that made the Model panic.
    pub fn quarantined(&self) {
        self.rejected.fetch_add(1, Ordering::Relaxed);
    }
    /// Why the first batch was refused that was not just of an earlier life.
    pub fn refusal(&self) -> Option<&Rejection> {
        self.refusal.get()
    }
    /// Counts a batch whose precondition did not hold.
    pub fn conflict(&self) {
        self.conflicts.fetch_add(1, Ordering::Relaxed);
    }
    /// Counts a restart.
    pub fn restarted(&self) {
        self.hits.forget();
        self.restarts.fetch_add(1, Ordering::Relaxed);
    }
    /// Counts a demotion from real-time priority.
    pub fn demoted(&self) {
        self.demotions.fetch_add(1, Ordering::Relaxed);
    }
    /// Counts CPU time of thread `tid` from now on; called on that thread.
    pub fn enter_thread(&self, tid: u32) {
        if self.thread.swap(tid, Ordering::Relaxed) != tid {
            // CPU time of the previous thread when it was last read.
            let before = self.cpu_now.swap(0, Ordering::Relaxed);
            self.cpu_before.fetch_add(before, Ordering::Relaxed);
        }
    }
    /// Keeps the CPU time used so far, because the working thread may end now.
    pub fn leave_thread(&self) {
        self.cpu();
    }
    /// How many ticks have run.
    pub fn ticks(&self) -> u64 {
        self.ran.load(Ordering::Relaxed)
    }
    /// How many ticks never ran.
    pub fn ticks_missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }
    /// How many ticks ran a millisecond late or later.
    pub fn ticks_late(&self) -> u64 {
        self.late.load(Ordering::Relaxed)
    }
    /// How many batches the Model refused.
    pub fn rejections(&self) -> u64 {
        self.rejected.load(Ordering::Relaxed)
    }
    /// CPU time of the controller's threads so far.
    pub fn cpu(&self) -> SimTime {
        if let Some(cpu) =
            Some(self.thread.load(Ordering::Relaxed)).filter(|tid| *tid != 0).and_then(sched::thread_cpu)
        {
            self.cpu_now.store(cpu.0, Ordering::Relaxed);
        }
        SimTime(self.cpu_before.load(Ordering::Relaxed) + self.cpu_now.load(Ordering::Relaxed))
    }

    /// The row of the report; `elapsed` is the time since the session began.
    pub fn report(&self, elapsed: SimTime) -> ControllerReport {
        let ran = self.ticks();
        let missed = self.ticks_missed();
        let scheduled = ran + missed;
        let first = self.first_due.load(Ordering::Relaxed);
        let last = self.last_due.load(Ordering::Relaxed);
        // The span from the first tick to the end of the last tick's period.
        let active = if first <= last && self.rate_hz > 0.0 {
            (last - first) as f64 * 1e-9 + 1.0 / self.rate_hz
        } else {
            0.0
        };
        let on_time = ran - self.late.load(Ordering::Relaxed).min(ran);
        let ratio = |part: f64, whole: f64| if whole > 0.0 { part / whole } else { 0.0 };
        let account = [0, 1, 2, 3, 4].map(|index| self.account[index].load(Ordering::Relaxed));
        let [sent, applied, lost, delayed, duplicated] = account;
        ControllerReport {
            name: self.name.clone(),
            target_hz: self.rate_hz,
            achieved_hz: ratio(ran as f64, active),
            scheduled,
            on_time: ratio(on_time as f64, scheduled as f64),
            lateness_us: self.lateness.quantiles(),
            step_us: self.step.quantiles(),
            missed,
            dropped: self.dropped.load(Ordering::Relaxed),
            sent,
            applied,
            lost,
            delayed,
            duplicated,
            queue_age_us: self.queue_age.quantiles(),
            rejected: self.rejected.load(Ordering::Relaxed),
            conflicts: self.conflicts.load(Ordering::Relaxed),
            restarts: self.restarts.load(Ordering::Relaxed),
            demotions: self.demotions.load(Ordering::Relaxed),
            kind: None,
            hits: self.hits.report(),
            cpu_share: ratio(self.cpu().as_secs_f64(), elapsed.as_secs_f64()),
            lateness_bars: self.lateness.bars(),
        }
    }
}

/// Outcome counts of one writer's batches. Every batch is accounted for: once none is in flight,
/// `sent + duplicated = applied + rejected + conflicts + lost`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Account {
    /// Batches that left the handle.
    pub sent: u64,
    /// Batches published in the scene.
    pub applied: u64,
    /// Batches that never reached the scene.
    pub lost: u64,
    /// Batches that came late or were overtaken.
    pub delayed: u64,
    /// Batches that arrived twice.
    pub duplicated: u64,
}

impl ControllerReport {
    /// Batches without a known outcome, as an absolute difference; batches in flight are among them.
    pub fn unaccounted(&self) -> u64 {
        (self.sent + self.duplicated).abs_diff(self.applied + self.rejected + self.conflicts + self.lost)
    }
}

/// Report on how one controller kept its rate.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "ControllerSummary")]
pub struct ControllerReport {
    /// Name of the writer, such as `haptics.left`.
    pub name: String,
    /// Target rate, ticks per second.
    pub target_hz: f64,
    /// Achieved rate, ticks per second.
    pub achieved_hz: f64,
    /// Ticks that were due.
    pub scheduled: u64,
    /// Share of the scheduled ticks that started less than 1 ms late, 0 to 1.
    #[schemars(range(min = 0.0, max = 1.0))]
    pub on_time: f64,
    /// How late ticks started.
    pub lateness_us: Quantiles,
    /// How long steps took.
    pub step_us: Quantiles,
    /// Ticks that never ran.
    pub missed: u64,
    /// Batches refused at its handle: the ring was full, or the flow limit was exceeded.
    pub dropped: u64,
    /// Batches that left its handle.
    pub sent: u64,
    /// Batches published in the scene.
    pub applied: u64,
    /// Batches that were sent and never reached the scene: lost on a faulty link, or with a Model that ended before
    /// publishing them.
    pub lost: u64,
    /// Batches that a faulty link delayed or reordered.
    pub delayed: u64,
    /// Batches that arrived twice.
    pub duplicated: u64,
    /// How long batches waited from being sealed to being taken by the Model; live only.
    pub queue_age_us: Quantiles,
    /// Batches refused by the Model.
    pub rejected: u64,
    /// Batches whose precondition no longer held.
    pub conflicts: u64,
    /// Number of restarts.
    #[schemars(with = "u64")]
    pub restarts: u32,
    /// Number of demotions from real-time priority, because steps took too much of their periods.
    #[schemars(with = "u64")]
    pub demotions: u32,
    /// Kind of the controller in the scenario, such as `obb-tree`; null for writers that the scenario does not declare.
    pub kind: Option<String>,
    /// Its contribution to the collision list; null for writers that contribute none.
    pub hits: Option<Hits>,
    /// CPU time of its thread per time of the session, 0 to 1; for people, not in the machine-readable report.
    #[serde(skip)]
    pub cpu_share: f64,
    /// Lateness as a small histogram for plots; not in the machine-readable report.
    #[serde(skip)]
    pub lateness_bars: Bars,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_perfect_second_at_1_khz() {
        let stats = TickStats::new("hand", 1_000.0);
        for k in 0..1_000 {
            stats.ran(SimTime::from_millis(k), SimTime::from_micros(5), SimTime::from_micros(20));
        }
        let row = stats.report(SimTime::from_millis(1_000));
        assert_eq!((row.scheduled, row.missed, row.on_time), (1_000, 0, 1.0));
        assert!((row.achieved_hz - 1_000.0).abs() < 1e-6, "{}", row.achieved_hz);
        assert!((row.lateness_us.p50 - 5.0).abs() < 0.05 && row.lateness_us.max == 5.0);
        assert!((row.step_us.p999 - 20.0).abs() < 0.2);
    }

    #[test]
    fn late_and_missed_ticks_are_not_on_time() {
        let stats = TickStats::new("hand", 1_000.0);
        stats.ran(SimTime(0), SimTime(ON_TIME_NS - 1), SimTime(0));
        stats.ran(SimTime::from_millis(1), SimTime(ON_TIME_NS), SimTime(0));
        stats.missed(2);
        let row = stats.report(SimTime::from_millis(4));
        assert_eq!((row.scheduled, row.missed, row.on_time), (4, 2, 0.25));
    }

    #[test]
    fn nothing_run_gives_zeros_not_nan() {
        let row = TickStats::new("hand", 1_000.0).report(SimTime::ZERO);
        assert_eq!((row.achieved_hz, row.on_time, row.cpu_share), (0.0, 0.0, 0.0));
    }

    #[test]
    fn cpu_time_of_a_busy_thread_is_seen_from_outside_and_after_its_end() {
        let stats = std::sync::Arc::new(TickStats::new("busy", 0.0));
        let worker = stats.clone();
        std::thread::spawn(move || {
            let tid = sched::current_tid();
            worker.enter_thread(tid);
            let mut x = 0_u64;
            while worker.cpu() < SimTime::from_millis(5) {
                x = x.wrapping_mul(31).wrapping_add(1);
                std::hint::black_box(x);
            }
            worker.leave_thread();
        })
        .join()
        .expect("the worker ends");
        assert!(stats.cpu() >= SimTime::from_millis(5));
    }
}
