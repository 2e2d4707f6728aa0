//! A ticker of high resolution on an async runtime: a kernel timer armed a little early, then a bounded spin.
//! `tokio::time` counts in milliseconds and is good enough only far below 100 Hz.

use std::io;
use std::sync::Arc;
use std::time::Instant;

use trocar_scene::SimTime;

use super::pausable_clock::PausableClock;

/// How early the timer is armed: the rest is spent spinning.
pub const LEAD: SimTime = SimTime::from_micros(30);
/// Longest single wait, so that a slow controller still sees a request to stop.
pub const WAIT_MAX: SimTime = SimTime::from_millis(50);
/// The task yields to the runtime after this many ticks without a wait.
const YIELD_EVERY: u32 = 16;

/// Session time, on the system's monotonic clock; clones read the same time.
#[derive(Clone, Debug)]
pub struct Clock {
    start: Instant,
    /// Session time at `start`. The instant at which it was zero may lie before all that the system's clock can tell.
    begin: SimTime,
    pausable: Arc<PausableClock>,
}

impl Clock {
    /// Clock of a session that starts now, at time zero.
    pub fn start() -> Self {
        Self::since(Instant::now())
    }
    /// Clock of a session that starts now, at the session time `begin`.
    pub fn starting_at(begin: SimTime) -> Self {
        Self::start().beginning_at(begin)
    }
    /// Clock of a session that started at `start`, at time zero; several clocks can share that origin.
    pub fn since(start: Instant) -> Self {
        Self::pausable(start, Arc::default())
    }
    /// The same, paused and resumed through `pausable`.
    pub fn pausable(start: Instant, pausable: Arc<PausableClock>) -> Self {
        Self { start, begin: SimTime::ZERO, pausable }
    }
    /// The same clock for a session that started at the session time `begin` instead of zero.
    #[must_use]
    pub fn beginning_at(self, begin: SimTime) -> Self {
        Self { begin, ..self }
    }
    /// Session time, without the paused spans.
    pub fn now(&self) -> SimTime {
        self.pausable.at(self.elapsed())
    }
    /// Pauses the clock, for all readers.
    pub fn pause(&self) {
        self.pausable.pause(self.elapsed());
    }
    /// Resumes the clock at the time where it was paused.
    pub fn resume(&self) {
        self.pausable.resume(self.elapsed());
    }
    /// Session time, with the paused spans.
    fn elapsed(&self) -> SimTime {
        self.begin + SimTime::from(self.start.elapsed())
    }
}

/// A tick to run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Due {
    /// Tick number; skipped ticks count.
    pub number: u64,
    /// When it was due: start + number · period, exactly.
    pub at: SimTime,
    /// Number of ticks skipped directly before it.
    pub missed: u64,
}

/// Schedule of periodic ticks: arithmetic without a clock.
#[derive(Clone, Copy, Debug)]
pub struct Schedule {
    start: SimTime,
    period: SimTime,
    next: u64,
}

impl Schedule {
    /// Tick `k` is due at `start + k · period`; `next` is the first tick that has not run yet.
    pub fn new(start: SimTime, period: SimTime, next: u64) -> Self {
        Self { start, period: period.max(SimTime(1)), next }
    }
    /// When tick `number` is due.
    pub fn due(&self, number: u64) -> SimTime {
        SimTime(self.start.0.saturating_add(number.saturating_mul(self.period.0)))
    }
    /// When the next tick is due.
    pub fn next_due(&self) -> SimTime {
        self.due(self.next)
    }
    /// Number of the next tick.
    pub fn next_number(&self) -> u64 {
        self.next
    }
    /// Makes the first tick that is due at `now` or later the next one.
    pub fn skip_to(&mut self, now: SimTime) {
        self.next = self.next.max(now.since(self.start).0.div_ceil(self.period.0));
    }
    /// The tick to run at `now`: the latest that is due. Earlier ones are skipped, so that a late controller never runs
    /// a burst. `None` when none is due yet.
    pub fn take(&mut self, now: SimTime) -> Option<Due> {
        let at = self.next_due();
        if now < at {
            return None;
        }
        let missed = now.since(at).0 / self.period.0;
        let number = self.next + missed;
        self.next = number + 1;
        Some(Due { number, at: self.due(number), missed })
    }
}

/// Waits for the ticks of a schedule on the runtime of the calling thread.
pub struct Ticker {
    schedule: Schedule,
    clock: Clock,
    timer: imp::Timer,
    spins: bool,
    since_wait: u32,
}

impl Ticker {
    /// Must be built on the runtime on which it is awaited.
    ///
    /// # Errors
    /// When the system cannot create a timer.
    pub fn new(schedule: Schedule, clock: Clock) -> io::Result<Self> {
        Ok(Self { schedule, clock, timer: imp::Timer::new()?, spins: true, since_wait: 0 })
    }
    /// Whether to spin for the last microseconds or to sleep until the due time.
    pub fn set_spinning(&mut self, spins: bool) {
        self.spins = spins;
    }
    /// Waits for [`WAIT_MAX`] of real time without a tick; used while the session clock may be paused.
    ///
    /// # Errors
    /// When the system's timer fails.
    pub async fn rest(&mut self) -> io::Result<()> {
        self.timer.sleep(SimTime::ZERO, WAIT_MAX).await
    }
    /// Skips the ticks that were due before now, without counting them as missed.
    pub fn skip_to_now(&mut self) {
        self.schedule.skip_to(self.clock.now());
    }
    /// The schedule.
    pub fn schedule(&self) -> &Schedule {
        &self.schedule
    }

    /// Waits for the next tick; `None` after [`WAIT_MAX`], when it is not due yet.
    ///
    /// # Errors
    /// When the system's timer fails.
    pub async fn next(&mut self) -> io::Result<Option<Due>> {
        let due = self.schedule.next_due();
        let wake = if self.spins { SimTime(due.0.saturating_sub(LEAD.0)) } else { due };
        let mut waited = false;
        loop {
            let now = self.clock.now();
            if now >= wake {
                break;
            }
            if wake.since(now) > WAIT_MAX {
                self.timer.sleep(now, now + WAIT_MAX).await?;
                return Ok(None);
            }
            self.timer.sleep(now, wake).await?;
            waited = true;
        }
        if waited {
            self.since_wait = 0;
        } else {
            self.since_wait += 1;
            if self.since_wait >= YIELD_EVERY {
                self.since_wait = 0;
                tokio::task::yield_now().await;
            }
        }
        loop {
            if let Some(due) = self.schedule.take(self.clock.now()) {
                return Ok(Some(due));
            }
            std::hint::spin_loop();
        }
    }
}

#[cfg(target_os = "linux")]
mod imp {
    use std::io;
    use std::os::fd::OwnedFd;

    use rustix::time::{
        Itimerspec, TimerfdClockId, TimerfdFlags, TimerfdTimerFlags, Timespec, timerfd_create,
        timerfd_settime,
    };
    use tokio::io::unix::AsyncFd;
    use trocar_scene::SimTime;

    pub(super) struct Timer {
        fd: AsyncFd<OwnedFd>,
    }

    /// A timerfd that is read without an async runtime.
    pub(super) struct BlockingTimer(OwnedFd);

    impl BlockingTimer {
        pub(super) fn new() -> io::Result<Self> {
            Ok(Self(timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::CLOEXEC)?))
        }
        pub(super) fn sleep(&self, span: SimTime) -> io::Result<()> {
            timerfd_settime(&self.0, TimerfdTimerFlags::empty(), &once(span))?;
            rustix::io::retry_on_intr(|| rustix::io::read(&self.0, &mut [0_u8; 8]))?;
            Ok(())
        }
    }

    fn once(span: SimTime) -> Itimerspec {
        // A value of zero would disarm the timer.
        let span = span.0.max(1);
        Itimerspec {
            it_interval: Timespec { tv_sec: 0, tv_nsec: 0 },
            it_value: Timespec {
                tv_sec: (span / 1_000_000_000) as i64,
                tv_nsec: (span % 1_000_000_000) as i64,
            },
        }
    }

    impl Timer {
        pub(super) fn new() -> io::Result<Self> {
            let fd =
                timerfd_create(TimerfdClockId::Monotonic, TimerfdFlags::NONBLOCK | TimerfdFlags::CLOEXEC)?;
            Ok(Self { fd: crate::runtime::sched::watch_readable(fd)? })
        }

        pub(super) async fn sleep(&mut self, now: SimTime, until: SimTime) -> io::Result<()> {
            let span = until.since(now);
            timerfd_settime(self.fd.get_ref(), TimerfdTimerFlags::empty(), &once(span))?;
            loop {
                let mut ready = self.fd.readable().await?;
                let mut expirations = [0_u8; 8];
                match ready.try_io(|fd| Ok(rustix::io::read(fd.get_ref(), &mut expirations)?)) {
                    Ok(read) => {
                        read?;
                        // The descriptor is drained: the next readiness edge comes from the next arming.
                        ready.clear_ready();
                        return Ok(());
                    }
                    Err(_would_block) => {}
                }
            }
        }
    }
}

#[cfg(not(target_os = "linux"))]
mod imp {
    use std::io;
    use std::time::Duration;

    use trocar_scene::SimTime;

    /// The runtime's own timer counts in milliseconds: it waits for the long part, a plain sleep for the rest.
    pub(super) struct Timer;

    /// Waits with the system's sleep.
    pub(super) struct BlockingTimer;

    impl BlockingTimer {
        pub(super) fn new() -> io::Result<Self> {
            Ok(Self)
        }
        pub(super) fn sleep(&self, span: SimTime) -> io::Result<()> {
            std::thread::sleep(span.to_duration());
            Ok(())
        }
    }

    const COARSE: SimTime = SimTime::from_millis(2);

    impl Timer {
        pub(super) fn new() -> io::Result<Self> {
            Ok(Self)
        }
        pub(super) async fn sleep(&mut self, now: SimTime, until: SimTime) -> io::Result<()> {
            let span = until.since(now);
            if span > COARSE {
                tokio::time::sleep(span.since(COARSE).to_duration()).await;
            } else {
                std::thread::sleep(span.to_duration().max(Duration::from_micros(1)));
            }
            Ok(())
        }
    }
}

/// A plain loop around the same timer, without runtime, host or scene: the baseline for a controller's lateness. Runs
/// for `span` at `period` on the calling thread and hands every tick's lateness to `each`; returns how many ticks were
/// skipped.
///
/// # Errors
/// When the system cannot create a timer.
pub fn bare_loop(period: SimTime, span: SimTime, mut each: impl FnMut(SimTime)) -> io::Result<u64> {
    let timer = imp::BlockingTimer::new()?;
    let clock = Clock::start();
    let mut schedule = Schedule::new(period, period, 0);
    let mut missed = 0;
    while schedule.next_due() <= span {
        let wake = schedule.next_due().since(LEAD);
        let now = clock.now();
        if now < wake {
            timer.sleep(wake.since(now))?;
        }
        loop {
            let now = clock.now();
            if let Some(tick) = schedule.take(now) {
                missed += tick.missed;
                each(now.since(tick.at));
                break;
            }
            std::hint::spin_loop();
        }
    }
    Ok(missed)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: SimTime = SimTime::from_millis(1);

    #[test]
    fn ticks_are_due_at_whole_multiples_of_the_period() {
        let period = SimTime(333_333);
        let mut schedule = Schedule::new(SimTime(1_000), period, 0);
        for k in 0..1_000_000 {
            let due = schedule.next_due();
            assert_eq!(due.0, 1_000 + k * 333_333);
            assert_eq!(schedule.take(due), Some(Due { number: k, at: due, missed: 0 }));
        }
    }

    #[test]
    fn nothing_runs_early() {
        let mut schedule = Schedule::new(SimTime(500), MS, 0);
        assert_eq!(schedule.take(SimTime(499)), None);
        assert!(schedule.take(SimTime(500)).is_some());
    }

    #[test]
    fn missed_ticks_are_skipped_and_counted_never_burst() {
        let mut schedule = Schedule::new(SimTime::ZERO, MS, 0);
        assert_eq!(schedule.take(SimTime(0)).map(|d| d.number), Some(0));
        // A step of 5.4 periods: ticks 1 to 4 are skipped, 5 runs late, 6 is on time again.
        let late = schedule.take(SimTime(5_400_000)).expect("a tick");
        assert_eq!((late.number, late.missed, late.at), (5, 4, SimTime(5_000_000)));
        assert_eq!(schedule.take(SimTime(5_400_001)), None);
        assert_eq!(schedule.take(SimTime(6_000_000)).map(|d| (d.number, d.missed)), Some((6, 0)));
    }

    #[test]
    fn a_new_life_goes_on_where_the_old_one_stood_and_counts_the_gap() {
        let mut schedule = Schedule::new(SimTime::ZERO, MS, 100);
        let first = schedule.take(SimTime(130_200_000)).expect("a tick");
        assert_eq!((first.number, first.missed), (130, 30));
    }

    #[test]
    fn a_clock_that_starts_later_than_at_zero_pauses_and_goes_on_like_any_other() {
        // Fifty years: longer than any machine has been up.
        let begin = SimTime::from_millis(50 * 365 * 86_400_000);
        let clock = Clock::starting_at(begin);
        let other = clock.clone();
        let first = clock.now();
        assert!(first >= begin && first < begin + SimTime::from_millis(10_000), "{first}");
        other.pause();
        let paused = clock.now();
        std::thread::sleep(MS.to_duration());
        assert_eq!(clock.now(), paused);
        assert!(paused >= first);
        other.resume();
        let resumed = clock.now();
        assert!(resumed >= paused && resumed < paused + SimTime::from_millis(10_000), "{resumed}");
        std::thread::sleep(MS.to_duration());
        assert!(clock.now() >= resumed + MS);
    }

    /// How many of 50 ticks run; none before it is due.
    async fn how_many_run(clock: &Clock, spins: bool) -> u64 {
        let schedule = Schedule::new(SimTime::ZERO, MS, clock.now().0 / MS.0 + 1);
        let mut ticker = Ticker::new(schedule, clock.clone()).expect("a timer");
        ticker.set_spinning(spins);
        let (mut ran, mut missed) = (0, 0);
        while ran + missed < 50 {
            let due = ticker.next().await.expect("a timer").expect("a tick");
            assert!(clock.now() >= due.at);
            ran += 1;
            missed += due.missed;
        }
        ran
    }

    #[test]
    fn the_ticker_wakes_at_its_ticks_and_not_before() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let clock = Clock::start();
        runtime.block_on(async {
            for spins in [true, false] {
                // The best of some tries: while a machine starves this thread, most ticks are skipped.
                let mut most = 0;
                for _ in 0..40 {
                    most = how_many_run(&clock, spins).await.max(most);
                    if most >= 25 {
                        break;
                    }
                }
                assert!(most >= 25, "at most {most} of 50 ran");
            }
        });
    }

    #[test]
    fn a_slow_controller_looks_around_between_its_ticks() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let clock = Clock::start();
        let looks = runtime.block_on(async {
            let schedule = Schedule::new(clock.now(), SimTime::from_millis(180), 1);
            let mut ticker = Ticker::new(schedule, clock).expect("a timer");
            let mut looks = 0;
            while ticker.next().await.expect("a timer").is_none() {
                looks += 1;
            }
            looks
        });
        assert!((1..=3).contains(&looks), "{looks}");
    }

    #[test]
    fn waiting_costs_no_cpu() {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().expect("a runtime");
        let clock = Clock::start();
        let tid = super::super::sched::current_tid();
        let before = super::super::sched::thread_cpu(tid);
        runtime.block_on(async {
            let schedule = Schedule::new(clock.now(), SimTime::from_millis(20), 1);
            let mut ticker = Ticker::new(schedule, clock).expect("a timer");
            for _ in 0..10 {
                ticker.next().await.expect("a timer").expect("a tick");
            }
        });
        if let (Some(before), Some(after)) = (before, super::super::sched::thread_cpu(tid)) {
            assert!(after.since(before) < SimTime::from_millis(40), "{} of 200 ms", after.since(before));
        }
    }
}
