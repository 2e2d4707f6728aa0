//! Rate benchmark: controllers ticking in a live session, beside bare timer loops on equal threads.

use std::sync::Arc;
use std::time::Duration;

use serde::{Deserialize, Serialize};
use trocar_scene::{
    Access, Commands, Component, Controller, ControllerError, Entity, EntitySet, RegistryBuilder, SimTime,
    Snapshot, Store, Tick,
};

use super::{Better, Effort, Row, median_and_spread};
use crate::live::{LiveError, LiveSession};
use crate::runtime::{AtomicHistogram, Quantiles, sched, ticker};
use crate::spec::{ControllerSpec, SessionOutcome, SessionSpec};
use crate::supervision::RuntimeClass;

/// State that a toy hand writes at every tick, about the size of a real one.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Component)]
#[component(name = "bench_toy_state")]
struct ToyState {
    position: [f64; 3],
    orientation: [f64; 4],
    force: [f64; 6],
}

struct ToyHand {
    other: Entity,
}

impl Controller for ToyHand {
    fn access(&self) -> Access {
        Access::new().reads::<ToyState>().writes::<ToyState>(EntitySet::Own)
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let theirs = scene.get::<ToyState>(self.other).map_or([0.0; 3], |state| state.position);
        let phase = tick.time.as_secs_f64();
        let position = [phase.sin(), phase.cos(), 0.5 * theirs[0]];
        let state = ToyState { position, orientation: [0.0, 0.0, 0.0, 1.0], force: [0.1; 6] };
        out.put(tick.me, state);
        Ok(())
    }
}

fn hand(name: &str, id: u16, other: u16, rate_hz: f64) -> ControllerSpec {
    let other = Entity::of_writer(0, other);
    let mut spec = ControllerSpec::new(name, id, RuntimeClass::Haptics, rate_hz, move |_| {
        Ok(Box::new(ToyHand { other }) as Box<dyn Controller>)
    });
    // Hands of one rate are staggered, so that they and the Model do not need a processor at the same instant.
    spec.phase = SimTime(spec.period().0 / 2 * u64::from(id % 2));
    // A busy machine is no reason to replace a hand in the middle of a measurement.
    spec.child.heartbeat_limit = SimTime::from_millis(2_000);
    spec
}

fn run(hands: Vec<ControllerSpec>, span: Duration) -> Result<SessionOutcome, LiveError> {
    let mut builder = RegistryBuilder::new();
    // A single name cannot conflict.
    let _ = builder.register::<ToyState>();
    let store = Store::new(builder.build());
    let live = LiveSession::start(SessionSpec::new("bench", 1, store, hands))?;
    std::thread::sleep(span);
    Ok(live.stop(0))
}

/// Results of bare timer loops on this machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct BareRates {
    /// Share of the scheduled ticks that started less than 1 ms late, the worst of the loops.
    pub on_time: f64,
    /// Share of the scheduled ticks that ran, the worst of the loops.
    pub ran: f64,
    /// Lateness, the worst of the loops at each quantile, µs.
    pub lateness_us: Quantiles,
}

/// Runs `threads` bare timer loops at `rate_hz` for `span`, on threads of the same priority as hands.
pub fn bare_rates(threads: usize, rate_hz: f64, span: Duration) -> BareRates {
    let period = crate::spec::period_of(rate_hz);
    let loops: Vec<_> = (0..threads)
        .map(|_| {
            std::thread::spawn(move || {
                let _ = sched::promote_current(RuntimeClass::Haptics);
                let histogram = Arc::new(AtomicHistogram::default());
                let missed =
                    ticker::bare_loop(period, SimTime::from(span), |lateness| histogram.record(lateness.0));
                (histogram, missed)
            })
        })
        .collect();
    let mut worst = BareRates { on_time: 1.0, ran: 1.0, lateness_us: Quantiles::default() };
    for one in loops {
        let Ok((histogram, Ok(missed))) = one.join() else { continue };
        let ran = histogram.count() as f64;
        let scheduled = (ran + missed as f64).max(1.0);
        let on_time = histogram.count_to(crate::runtime::stats::ON_TIME_NS) as f64;
        worst.on_time = worst.on_time.min(on_time / scheduled);
        worst.ran = worst.ran.min(ran / scheduled);
        let (one, all) = (histogram.quantiles(), &mut worst.lateness_us);
        all.p50 = all.p50.max(one.p50);
        all.p99 = all.p99.max(one.p99);
        all.p999 = all.p999.max(one.p999);
        all.max = all.max.max(one.max);
    }
    worst
}

/// Two hands at 1 kHz beside two bare loops at 1 kHz.
pub(super) fn two_hands(effort: Effort) -> Result<Vec<Row>, LiveError> {
    let (blocks, span) = match effort {
        Effort::Smoke => (1, Duration::from_millis(500)),
        Effort::Full => (5, Duration::from_secs(3)),
    };
    let (mut on_time, mut floor_on_time) = (Vec::new(), Vec::new());
    let (mut p99, mut floor_p99) = (Vec::new(), Vec::new());
    let mut cpu = Vec::new();
    for _ in 0..blocks {
        let bare = bare_rates(2, 1_000.0, span);
        floor_on_time.push(bare.on_time);
        floor_p99.push(bare.lateness_us.p99);
        let ours = run(vec![hand("left", 1, 2, 1_000.0), hand("right", 2, 1, 1_000.0)], span)?;
        let worst =
            |pick: fn(&crate::runtime::ControllerReport) -> f64, start: f64, f: fn(f64, f64) -> f64| {
                ours.controllers.iter().map(pick).fold(start, f)
            };
        on_time.push(worst(|row| row.on_time, 1.0, f64::min));
        p99.push(worst(|row| row.lateness_us.p99, 0.0, f64::max));
        cpu.push(worst(|row| row.cpu_share, 0.0, f64::max));
    }
    let floor = super::median(&floor_on_time);
    let mut share = Row::on_value(
        "hands_1khz_on_time",
        "share",
        median_and_spread(&on_time),
        Some((floor - 0.005).max(0.99)),
        Better::Higher,
    );
    share.floor = Some(floor);
    share.ratio = Some(share.value / floor);
    Ok(vec![
        share,
        Row::on_ratio(
            "hands_1khz_lateness_p99",
            "us",
            median_and_spread(&p99),
            super::median(&floor_p99),
            Some(1.5),
            Better::Lower,
        ),
        Row::on_value("hands_1khz_thread_cpu", "share", median_and_spread(&cpu), Some(0.10), Better::Lower),
    ])
}

/// One hand at 10 kHz, by the share of the scheduled ticks that ran.
pub(super) fn one_hand_at_10_khz(effort: Effort) -> Result<Vec<Row>, LiveError> {
    let (blocks, span) = match effort {
        Effort::Smoke => (1, Duration::from_millis(500)),
        Effort::Full => (1, Duration::from_secs(10)),
    };
    let (mut ran, mut floor, mut cpu) = (Vec::new(), Vec::new(), Vec::new());
    for _ in 0..blocks {
        floor.push(bare_rates(1, 10_000.0, span).ran);
        let ours = run(vec![hand("left", 1, 1, 10_000.0)], span)?;
        for row in &ours.controllers {
            ran.push((row.scheduled - row.missed) as f64 / row.scheduled.max(1) as f64);
            cpu.push(row.cpu_share);
        }
    }
    let mut share =
        Row::on_value("hand_10khz_ticks_run", "share", median_and_spread(&ran), Some(0.97), Better::Higher);
    share.floor = Some(super::median(&floor));
    share.ratio = share.floor.map(|floor| share.value / floor);
    let cpu = median_and_spread(&cpu);
    Ok(vec![share, Row::on_value("hand_10khz_thread_cpu", "share", cpu, None, Better::Lower)])
}
