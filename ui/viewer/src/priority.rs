//! Drawing steps back behind whoever holds the hands.
//!
//! A rasteriser in software takes every core that it gets. Its threads are made by the graphics driver, and inherit the
//! priority of the thread that asks for the device: so that is done by one that has stepped back.

use std::panic::resume_unwind;
use std::thread;

/// Steps that drawing is nicer than the rest of the process.
pub const NICER: i32 = 10;

/// Does `work` on a thread of its own that has stepped back; threads that it starts stay behind as well. Where the system
/// has no such thing, the work is done all the same.
pub fn stepped_back<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    thread::scope(|scope| {
        let worker = scope.spawn(move || {
            step_back();
            work()
        });
        worker.join().unwrap_or_else(|panic| resume_unwind(panic))
    })
}

/// The calling thread steps back for good, and with it the threads that it starts from now on.
pub fn step_back() {
    #[cfg(target_os = "linux")]
    {
        // On Linux a process of number 0 is the calling thread alone.
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
