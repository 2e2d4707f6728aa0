//! Write → visible latency, beside a bare actix actor of the Model's priority that stores each message in an `ArcSwap`;
//! and the Model's CPU time per batch.

use std::sync::Arc;
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};

use actix::prelude::*;
use arc_swap::ArcSwap;
use trocar_scene::{Access, Entity, EntitySet, Revision, SimTime, WriterId};

use super::scene::{Mark, populated};
use super::{Better, Effort, Row, median, median_and_spread};
use crate::handle::{Submitted, WriterHandle};
use crate::live::{LiveError, LiveSession};
use crate::runtime::sched;
use crate::spec::SessionSpec;
use crate::supervision::RuntimeClass;

/// Pause between two samples, so that all threads are asleep.
const PAUSE: Duration = Duration::from_micros(500);
/// Limit after which a sample is discarded.
const SAMPLE_MAX: Duration = Duration::from_millis(500);
const GUEST: u16 = 7;
/// Largest latency of a write, relative to an actor of equal priority that only stores the message.
const EQUAL_MAX: f64 = 1.2;

struct Bench {
    live: LiveSession,
    handle: WriterHandle,
    me: Entity,
    next: u64,
}

impl Bench {
    fn start(entities: u32) -> Result<Self, LiveError> {
        let (store, _) = populated(entities);
        let live = LiveSession::start(SessionSpec::new("bench", 1, store, Vec::new()))?;
        let access = Access::new().writes::<Mark>(EntitySet::Own);
        let handle = live.guest("bench", WriterId(GUEST), &access, 4_096)?.into_handle();
        Ok(Self { live, handle, me: Entity::of_writer(0, GUEST), next: 0 })
    }

    fn submit(&mut self) -> Submitted {
        self.next += 1;
        let (me, mark) = (self.me, Mark(self.next));
        self.handle.begin(SimTime(self.next)).put(me, mark);
        self.handle.submit(self.next, SimTime(self.next), Revision::ZERO)
    }

    fn is_visible(&self, snapshots: &ArcSwap<trocar_scene::Snapshot>) -> bool {
        snapshots.load().get::<Mark>(self.me).is_some_and(|mark| mark.0 == self.next)
    }

    /// Latency from submission to visibility, µs; `None` when it took too long.
    fn sample(&mut self) -> Option<f64> {
        let snapshots = self.live.snapshots();
        let begun = Instant::now();
        self.submit();
        spin_until(begun, || self.is_visible(&snapshots))
    }
}

fn spin_until(begun: Instant, mut done: impl FnMut() -> bool) -> Option<f64> {
    while !done() {
        if begun.elapsed() > SAMPLE_MAX {
            return None;
        }
        std::hint::spin_loop();
    }
    Some(begun.elapsed().as_nanos() as f64 * 1e-3)
}

/// The floor: an actor on its own thread that stores each message.
struct Storer(Arc<ArcSwap<u64>>);
impl Actor for Storer {
    type Context = Context<Self>;
}
#[derive(Message)]
#[rtype(result = "()")]
struct Send(u64);
impl Handler<Send> for Storer {
    type Result = ();
    fn handle(&mut self, Send(value): Send, _: &mut Self::Context) {
        self.0.store(Arc::new(value));
    }
}

struct Floor {
    system: System,
    address: Addr<Storer>,
    slot: Arc<ArcSwap<u64>>,
    runtime: tokio::runtime::Runtime,
    next: u64,
}

impl Floor {
    /// `equal`: with the priority that the Model's thread has; otherwise a plain arbiter as actix makes it.
    fn start(equal: bool) -> Result<Self, LiveError> {
        let slot = Arc::new(ArcSwap::from_pointee(0));
        let (send, receive) = sync_channel(1);
        let given = slot.clone();
        std::thread::Builder::new().name("bench-floor".into()).spawn(move || {
            let runner = System::new();
            let arbiter = Arbiter::new();
            if equal {
                arbiter.spawn_fn(|| drop(sched::promote_current(RuntimeClass::Model)));
            }
            let address = Storer::start_in_arbiter(&arbiter.handle(), move |_| Storer(given));
            let _ = send.send((System::current(), address));
            let _ = runner.run();
        })?;
        let (system, address) = receive
            .recv()
            .map_err(|_| LiveError::Start("the floor's actor system did not start".to_owned()))?;
        let runtime = tokio::runtime::Builder::new_current_thread().build()?;
        Ok(Self { system, address, slot, runtime, next: 0 })
    }
    /// Time until an awaited send returns, after which the value is visible, µs.
    fn sample_awaited(&mut self) -> Option<f64> {
        self.next += 1;
        let begun = Instant::now();
        self.runtime.block_on(self.address.send(Send(self.next))).ok()?;
        let (slot, next) = (&self.slot, self.next);
        spin_until(begun, || **slot.load() == next)
    }
    /// Time until a value sent without awaiting is visible, µs.
    fn sample(&mut self) -> Option<f64> {
        self.next += 1;
        let begun = Instant::now();
        self.address.try_send(Send(self.next)).ok()?;
        let (slot, next) = (&self.slot, self.next);
        spin_until(begun, || **slot.load() == next)
    }
}

impl Drop for Floor {
    fn drop(&mut self) {
        self.system.stop();
    }
}

/// Write → visible at 100 and 10,000 populated entities, and the floors, sample by sample in turn.
///
/// The floor is an actor whose thread has the Model's priority: the same wake-up, and one store. Two more rows, without
/// a bar, compare with an actor on a plain arbiter: with actix's awaited `send`, and with sending without awaiting.
pub(super) fn write_to_visible(effort: Effort) -> Result<Vec<Row>, LiveError> {
    let (blocks, samples) = match effort {
        Effort::Smoke => (1, 60),
        Effort::Full => (9, 250),
    };
    let mut small = Bench::start(100)?;
    let mut large = Bench::start(10_000)?;
    let mut bare = Floor::start(false)?;
    let mut equal = Floor::start(true)?;
    let mut medians: [Vec<f64>; 5] = std::array::from_fn(|_| Vec::new());
    for _ in 0..blocks {
        let mut block: [Vec<f64>; 5] = std::array::from_fn(|_| Vec::with_capacity(samples));
        for _ in 0..samples {
            for (kind, results) in block.iter_mut().enumerate() {
                std::thread::sleep(PAUSE);
                results.extend(match kind {
                    0 => bare.sample_awaited(),
                    1 => small.sample(),
                    2 => large.sample(),
                    3 => bare.sample(),
                    _ => equal.sample(),
                });
            }
        }
        for (all, block) in medians.iter_mut().zip(&block) {
            all.push(median(block));
        }
    }
    let [awaited, small, large, sent, equal] = medians.map(|blocks| median_and_spread(&blocks));
    let beside =
        |name: &str, (floor, _): (f64, f64)| Row::on_ratio(name, "us", small, floor, None, Better::Lower);
    Ok(vec![
        Row::on_ratio("write_visible_100_entities_p50", "us", small, equal.0, Some(EQUAL_MAX), Better::Lower),
        Row::on_ratio("write_visible_10000_entities_p50", "us", large, small.0, Some(1.5), Better::Lower),
        beside("write_visible_beside_plain_awaited_send_p50", awaited),
        beside("write_visible_beside_plain_send_p50", sent),
    ])
}

/// CPU time of the Model's thread per batch: woken for each, and in a flood.
pub(super) fn model_cpu(effort: Effort) -> Result<Vec<Row>, LiveError> {
    let (blocks, paced, flood) = match effort {
        Effort::Smoke => (1, 100, 5_000),
        Effort::Full => (5, 500, 50_000),
    };
    let mut bench = Bench::start(10_000)?;
    let (mut woken, mut flooded) = (Vec::new(), Vec::new());
    for _ in 0..blocks {
        woken.push(bench.cost(paced, |bench| {
            bench.sample();
            std::thread::sleep(PAUSE);
        }));
        flooded.push(bench.cost(flood, |bench| while bench.submit() == Submitted::Dropped {}));
    }
    Ok(vec![
        Row::on_value("model_cpu_per_batch_woken", "ns", median_and_spread(&woken), None, Better::Lower),
        Row::on_value("model_cpu_per_batch_flood", "ns", median_and_spread(&flooded), None, Better::Lower),
    ])
}

impl Bench {
    fn cost(&mut self, batches: u32, mut one: impl FnMut(&mut Self)) -> f64 {
        let (cpu, count) = (self.live.model_cpu(), self.live.batches());
        for _ in 0..batches {
            one(self);
        }
        // Wait until the last batch is applied.
        self.sample();
        let spent = self.live.model_cpu().since(cpu).0 as f64;
        spent / (self.live.batches() - count).max(1) as f64
    }
}
