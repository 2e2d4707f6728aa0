//! One model per promise. Each is run in every interleaving, with every value that a weak memory model lets a load
//! return.

use loom::sync::atomic::{AtomicU64, Ordering};
use loom::sync::{Arc, Mutex};
use loom::thread;

use crate::heartbeat::Heartbeat;
use crate::lane_gate::{ActiveLane, LowestEpoch};
use crate::signal::Signal;

/// Two writers with a ring each, and the bell of the Model. A ring's end is stored with Relaxed, weaker than a real one's,
/// so that only the signal orders anything.
#[test]
fn a_batch_that_was_sent_is_seen_or_somebody_rings() {
    loom::model(|| {
        let shared = Arc::new((Signal::default(), [AtomicU64::new(0), AtomicU64::new(0)], AtomicU64::new(0)));
        let writers: Vec<_> = (0..2)
            .map(|index| {
                let shared = shared.clone();
                thread::spawn(move || {
                    let (signal, rings, bell) = &*shared;
                    rings[index].store(1, Ordering::Relaxed);
                    if signal.raise() {
                        bell.fetch_add(1, Ordering::Relaxed);
                    }
                })
            })
            .collect();
        let (signal, rings, bell) = &*shared;
        // A pass of the Model, woken for no reason.
        let raised = signal.take();
        let seen = [rings[0].load(Ordering::Relaxed), rings[1].load(Ordering::Relaxed)];
        writers.into_iter().for_each(|writer| writer.join().expect("no panic"));
        let rung = bell.load(Ordering::Relaxed) - u64::from(raised);
        assert!(seen == [1, 1] || rung > 0, "seen {seen:?}, and nobody rings");
    });
}

#[test]
fn a_fence_that_was_raised_before_the_signal_is_seen_by_who_takes_it() {
    loom::model(|| {
        let shared = Arc::new((Signal::default(), AtomicU64::new(1)));
        let supervisor = {
            let shared = shared.clone();
            thread::spawn(move || {
                shared.1.fetch_max(2, Ordering::Relaxed);
                shared.0.raise();
            })
        };
        if shared.0.take() {
            assert_eq!(shared.1.load(Ordering::Relaxed), 2, "the signal came without the fence");
        }
        supervisor.join().expect("no panic");
        assert!(shared.1.load(Ordering::Relaxed) == 2);
    });
}

#[test]
fn a_beat_never_looks_older_than_it_is() {
    loom::model(|| {
        let heart = Arc::new(Heartbeat::default());
        let worker = {
            let heart = heart.clone();
            thread::spawn(move || (1..=3).for_each(|beat| heart.bump(beat * 10)))
        };
        let (count, at_ns) = heart.look();
        assert!(at_ns >= count * 10, "beat {count} seems to be of {at_ns}");
        worker.join().expect("no panic");
        assert_eq!(heart.look(), (3, 30));
    });
}

#[test]
fn of_two_fences_the_higher_one_stays() {
    loom::model(|| {
        let fence = Arc::new(LowestEpoch::default());
        let others: Vec<_> = [3, 2]
            .into_iter()
            .map(|epoch| {
                let fence = fence.clone();
                thread::spawn(move || fence.raise(epoch))
            })
            .collect();
        others.into_iter().for_each(|other| other.join().expect("no panic"));
        assert_eq!(fence.get(), 3);
        assert!(!fence.admits(2) && fence.admits(3));
    });
}

#[test]
fn a_driver_that_obeys_the_successor_refuses_its_predecessor() {
    loom::model(|| {
        let shared = Arc::new((LowestEpoch::default(), ActiveLane::default()));
        let successor = {
            let shared = shared.clone();
            thread::spawn(move || {
                shared.0.raise(2);
                shared.1.set(2, 1);
            })
        };
        // A step of the driver.
        if shared.1.get() == Some((2, 1)) {
            assert!(!shared.0.admits(1), "the zombie is still admitted");
        }
        successor.join().expect("no panic");
    });
}

/// As `DeviceSlot::take` does it, with the lock that it holds.
fn take(lock: &Mutex<()>, fence: &LowestEpoch, active: &ActiveLane, epoch: u32, lane: usize) -> bool {
    let _held = lock.lock().expect("no panic");
    if !fence.admits(epoch) || active.get().is_some_and(|(newest, _)| epoch < newest) {
        return false;
    }
    active.set(epoch, lane);
    true
}

#[test]
fn a_zombie_that_is_late_cannot_take_the_device_back() {
    loom::model(|| {
        let shared = Arc::new((Mutex::new(()), LowestEpoch::default(), ActiveLane::default()));
        let zombie = {
            let shared = shared.clone();
            thread::spawn(move || take(&shared.0, &shared.1, &shared.2, 1, 0))
        };
        shared.1.raise(2);
        assert!(take(&shared.0, &shared.1, &shared.2, 2, 1), "the successor gets its lane");
        zombie.join().expect("no panic");
        assert_eq!(shared.2.get(), Some((2, 1)));
    });
}
