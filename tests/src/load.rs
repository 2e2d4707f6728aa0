//! A stated load on the machine: busy threads of ordinary priority.

use std::sync::atomic::{AtomicBool, Ordering};

/// Busy threads per processor.
pub const PER_PROCESSOR: usize = 2;

/// Ends the load, also when the work panics.
struct Ends<'a>(&'a AtomicBool);

impl Drop for Ends<'_> {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Runs `work` beside the load.
pub fn under_load<T>(work: impl FnOnce() -> T) -> T {
    let over = AtomicBool::new(false);
    let threads = PER_PROCESSOR * std::thread::available_parallelism().map_or(1, usize::from);
    std::thread::scope(|scope| {
        let _ends = Ends(&over);
        for _ in 0..threads {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    std::hint::spin_loop();
                }
            });
        }
        work()
    })
}
