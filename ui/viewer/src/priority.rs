//! Lowers the priority of drawing below that of haptics.
//!
//! A software rasteriser takes every core that it gets. The graphics driver creates its threads, which inherit the
//! priority of the thread that creates the device: so a thread of lowered priority creates it.

use std::panic::resume_unwind;
use std::thread;

/// Increase of the nice value of drawing threads.
pub const NICER: i32 = 10;

/// Runs `work` on its own thread of lowered priority, which its child threads inherit. Where the system does not
/// support this, the work still runs.
pub fn stepped_back<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    thread::scope(|scope| {
        let worker = scope.spawn(move || {
            step_back();
            work()
        });
        worker.join().unwrap_or_else(|panic| resume_unwind(panic))
    })
}

/// Lowers the priority of the calling thread permanently, and of threads that it starts later.
pub fn step_back() {
    #[cfg(target_os = "linux")]
    {
        // On Linux process number 0 is the calling thread alone.
        let now = rustix::process::getpriority_process(None).unwrap_or(0);
        if let Err(error) = rustix::process::setpriority_process(None, (now + NICER).min(19)) {
            tracing::debug!("drawing keeps its priority: {error}");
        }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    fn niceness() -> i32 {
        rustix::process::getpriority_process(None).expect("the priority of this thread")
    }

    #[test]
    fn what_is_started_behind_stays_behind_and_the_caller_stays_where_it_is() {
        let before = niceness();
        let (worker, its_thread) =
            stepped_back(|| (niceness(), thread::spawn(niceness).join().expect("it only looks")));
        assert_eq!(worker, (before + NICER).min(19));
        assert_eq!(its_thread, worker);
        assert_eq!(niceness(), before);
    }
}
