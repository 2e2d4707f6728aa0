//! Deferred reclamation of retired snapshots: they are kept until no reader holds them, so that a controller never runs
//! a scene's destructor.
//!
//! A reader that drops the last reference frees the snapshot at once, which takes hundreds of microseconds within a
//! haptic tick. While the Model keeps one more reference, the reader's drop is only a decrement.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::time::Duration;

/// Keeps retired values alive while others hold them, and frees them on the sweeping thread.
///
/// Bounded: beyond `keep` values the oldest go to a reaper thread, which waits for their holders.
#[derive(Debug)]
pub struct Retired<T: Send + Sync + 'static> {
    held: VecDeque<Arc<T>>,
    keep: usize,
    reaper: SyncSender<Arc<T>>,
}

/// Capacity of the reaper's queue.
const REAPER_QUEUE: usize = 256;
/// Period at which the reaper checks for released values.
const REAPER_PAUSE: Duration = Duration::from_millis(5);

impl<T: Send + Sync + 'static> Retired<T> {
    /// Keeps up to `keep` values here; starts the reaper thread for the rest.
    ///
    /// # Errors
    /// When the operating system gives no thread.
    pub fn new(keep: usize) -> std::io::Result<Self> {
        let (reaper, inbox) = sync_channel(REAPER_QUEUE);
        std::thread::Builder::new().name("trocar-reaper".into()).spawn(move || reap(&inbox))?;
        Ok(Self { held: VecDeque::with_capacity(keep + 1), keep, reaper })
    }

    /// Takes a value that has just been replaced, and frees values without other holders.
    pub fn retire(&mut self, value: Arc<T>) {
        self.held.push_back(value);
        self.sweep();
        while self.held.len() > self.keep {
            let Some(oldest) = self.held.pop_front() else { break };
            match self.reaper.try_send(oldest) {
                Ok(()) => {}
                // Still in use: dropping it here would leave the freeing to its reader. The number of such values is
                // bounded by the number of readers, which hold one each.
                Err(TrySendError::Full(value) | TrySendError::Disconnected(value)) => {
                    self.held.push_front(value);
                    break;
                }
            }
        }
    }

    /// Frees, on this thread, the values without other holders.
    pub fn sweep(&mut self) {
        // A retired value can no longer be loaded, so a count of one stays one.
        self.held.retain(|value| Arc::strong_count(value) > 1);
    }

    /// Number of values kept for their readers.
    pub fn len(&self) -> usize {
        self.held.len()
    }

    /// Whether no value is kept.
    pub fn is_empty(&self) -> bool {
        self.held.is_empty()
    }
}

impl<T: Send + Sync + 'static> Drop for Retired<T> {
    fn drop(&mut self) {
        // Readers of the remaining values may outlive the Model; the reaper waits for them.
        for value in self.held.drain(..) {
            if Arc::strong_count(&value) > 1 {
                let _ = self.reaper.try_send(value);
            }
        }
    }
}

fn reap<T>(inbox: &Receiver<Arc<T>>) {
    let mut waiting: Vec<Arc<T>> = Vec::new();
    loop {
        let next = if waiting.is_empty() {
            inbox.recv().map_err(|_| RecvTimeoutError::Disconnected)
        } else {
            inbox.recv_timeout(REAPER_PAUSE)
        };
        match next {
            Ok(value) => waiting.push(value),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) if waiting.is_empty() => return,
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(REAPER_PAUSE),
        }
        waiting.retain(|value| Arc::strong_count(value) > 1);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::thread::{self, ThreadId};
    use std::time::Instant;

    use arc_swap::ArcSwap;

    use super::*;

    struct Scene(Arc<Mutex<Vec<ThreadId>>>);
    impl Drop for Scene {
        fn drop(&mut self) {
            self.0.lock().expect("not poisoned").push(thread::current().id());
        }
    }

    #[test]
    fn a_reader_never_runs_the_destructor() {
        let freed_by = Arc::new(Mutex::new(Vec::new()));
        let current = Arc::new(ArcSwap::from_pointee(Scene(freed_by.clone())));
        let stop = Arc::new(AtomicBool::new(false));
        let readers: Vec<_> = (0..2)
            .map(|_| {
                let (current, stop) = (current.clone(), stop.clone());
                thread::spawn(move || {
                    while !stop.load(Ordering::Relaxed) {
                        let guard = current.load();
                        let owned = current.load_full();
                        thread::yield_now();
                        drop((guard, owned));
                    }
                    thread::current().id()
                })
            })
            .collect();
        let mut retired = Retired::new(8).expect("a thread");
        for _ in 0..5_000 {
            retired.retire(current.swap(Arc::new(Scene(freed_by.clone()))));
        }
        stop.store(true, Ordering::Relaxed);
        let readers: Vec<ThreadId> = readers.into_iter().map(|reader| reader.join().expect("ran")).collect();
        let freed_by = freed_by.lock().expect("not poisoned");
        assert!(freed_by.len() > 4_900, "almost all are freed by now: {}", freed_by.len());
        assert!(freed_by.iter().all(|thread| !readers.contains(thread)));
    }

    #[test]
    fn what_is_held_for_long_goes_to_the_reaper_and_is_freed_there() {
        let freed_by = Arc::new(Mutex::new(Vec::new()));
        let mut retired = Retired::new(2).expect("a thread");
        let values: Vec<_> = (0..6).map(|_| Arc::new(Scene(freed_by.clone()))).collect();
        for value in &values {
            retired.retire(value.clone());
        }
        assert_eq!(retired.len(), 2, "bounded");
        drop(retired);
        drop(values);
        let begun = Instant::now();
        while freed_by.lock().expect("not poisoned").len() < 6 {
            assert!(begun.elapsed() < Duration::from_secs(5), "the reaper frees what it was given");
            thread::sleep(Duration::from_millis(1));
        }
        let me = thread::current().id();
        assert!(freed_by.lock().expect("not poisoned").iter().all(|thread| *thread != me));
    }
}
