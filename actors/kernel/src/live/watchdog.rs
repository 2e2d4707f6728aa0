//! The watchdog: an operating-system thread at high priority that reads heartbeats and never awaits, so that it detects
//! threads that hang within a step.

use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use trocar_scene::SimTime;

use super::shared::{ChildState, Life, Report, Shared};
use crate::runtime::sched;
use crate::supervision::{Event, RuntimeClass};

/// Bounds of the pause between two checks; it is shorter when a child is close to its limit.
const PAUSE_MIN: SimTime = SimTime::from_millis(1);
const PAUSE_MAX: SimTime = SimTime::from_millis(10);
/// Shortest pause: about the lateness of any sleep.
const PAUSE_LAST: SimTime = SimTime::from_micros(50);
/// Number of limits after which even a starved thread is replaced.
const STARVED_MAX: u64 = 20;
/// Pause between two checks of a paused session.
const PAUSE_RESTING: Duration = Duration::from_millis(100);

/// Last observation of one child.
#[derive(Clone)]
struct Watch {
    life: Arc<Life>,
    beat: u64,
    since: SimTime,
    cpu: SimTime,
    late: bool,
    told: bool,
}

impl Watch {
    fn new(life: Arc<Life>, now: SimTime) -> Self {
        Self { life, beat: 0, since: now, cpu: SimTime::ZERO, late: false, told: false }
    }
}

/// Starts the thread; it ends with the session.
pub(super) fn start(shared: Arc<Shared>) -> std::io::Result<()> {
    std::thread::Builder::new().name("trocar-watchdog".into()).spawn(move || watch(&shared)).map(drop)
}

fn watch(shared: &Shared) {
    let _ = shared.reports.try_send(Report::Permission(sched::promote_current(RuntimeClass::Watchdog)));
    let shortest = shared.child_states().map(|state| state.limit(true)).min().unwrap_or(PAUSE_MAX);
    let pause = SimTime(shortest.0 / 8).clamp(PAUSE_MIN, PAUSE_MAX);
    let now = shared.clock.now();
    let mut watches: Vec<Watch> =
        shared.child_states().map(|state| Watch::new(state.life.load_full(), now)).collect();
    let mut last = now;
    let mut next = now + pause;
    while !shared.over.load(Ordering::Relaxed) {
        std::thread::sleep(Duration::from_nanos(next.since(last).max(PAUSE_LAST).0));
        while shared.resting.load(Ordering::Relaxed) && !shared.over.load(Ordering::Relaxed) {
            std::thread::sleep(PAUSE_RESTING);
            last = SimTime::ZERO;
        }
        let now = shared.clock.now();
        // If this thread itself was starved, the others may have been as well: restart the limits.
        let blind = now.since(last).0 > 4 * pause.0;
        last = now;
        next = now + pause;
        for (state, watch) in shared.child_states().zip(&mut watches) {
            if !Arc::ptr_eq(&watch.life, &state.life.load()) {
                *watch = Watch::new(state.life.load_full(), now);
            }
            look(shared, state, watch, now, blind);
            let limit = watch.since + limit_of(state, watch);
            if !watch.told && limit > now {
                next = next.min(limit);
            }
        }
    }
}

fn look(shared: &Shared, state: &ChildState, watch: &mut Watch, now: SimTime, blind: bool) {
    let at_rest = watch.life.at_rest.load(Ordering::Acquire);
    if !watch.life.running.load(Ordering::Acquire) || at_rest || state.fault_hooks.is_held() {
        watch.since = now;
        return;
    }
    // Read before the beat: if the first step ends in between, its beat is seen as well.
    let limit = limit_of(state, watch);
    let (beat, beat_at) = watch.life.heartbeat.look();
    let late = watch.life.late.load(Ordering::Relaxed);
    if late != watch.late {
        watch.late = late;
        let _ = shared.reports.try_send(Report::Event(Event::Late { child: state.child, late }));
    }
    // A message-driven child may be idle for any time.
    let resting = !state.ticks && beat.is_multiple_of(2);
    if beat != watch.beat || resting || blind {
        watch.beat = beat;
        watch.since = if resting || blind { now } else { SimTime(beat_at).min(now) };
        watch.cpu = cpu_of(&watch.life);
        return;
    }
    if watch.told || now.since(watch.since) < limit || is_starved(watch, limit, now) {
        return;
    }
    watch.told = true;
    shared.fence(state.child, watch.life.incarnation + 1);
    shared.report(Event::Stalled { child: state.child, incarnation: watch.life.incarnation });
}

fn limit_of(state: &ChildState, watch: &Watch) -> SimTime {
    state.limit(watch.life.settled.load(Ordering::Acquire))
}

fn cpu_of(life: &Life) -> SimTime {
    sched::thread_cpu(life.tid.load(Ordering::Relaxed)).unwrap_or_default()
}

/// Share of its limit that a thread must have used as CPU time to count as stalled while it is runnable. Almost all of it:
/// a step that takes half of its limit alone takes longer than that beside two compilers, and a replacement would only
/// begin it anew. Not all of it: the CPU time is read after the beat.
const USED_SHARE: f64 = 0.8;

/// Whether a thread is runnable but not scheduled. That is no stall: on a busy machine a replacement would make it
/// worse. It counts as a stall when the thread has used most of its limit as CPU time, or has waited too long.
fn is_starved(watch: &Watch, limit: SimTime, now: SimTime) -> bool {
    let used = cpu_of(&watch.life).since(watch.cpu);
    now.since(watch.since).0 < STARVED_MAX * limit.0
        && (used.0 as f64) < USED_SHARE * limit.0 as f64
        && sched::is_runnable(watch.life.tid.load(Ordering::Relaxed))
}
