//! Clock, sleep and scheduling of a driver thread (Linux). The only module with unsafe code.

use std::io;
use std::num::NonZeroU64;
use std::time::Duration;

use rustix::thread::{ClockId, Timespec};

/// Time of the monotonic clock \[ns\].
pub(crate) fn monotonic_ns() -> u64 {
    let now = rustix::time::clock_gettime(ClockId::Monotonic);
    u64::try_from(now.tv_sec).unwrap_or(0) * 1_000_000_000 + u64::try_from(now.tv_nsec).unwrap_or(0)
}

/// Sleeps until the monotonic clock shows `deadline_ns`; early when a signal interrupts.
pub(crate) fn sleep_until(deadline_ns: u64) {
    let deadline = Timespec {
        tv_sec: i64::try_from(deadline_ns / 1_000_000_000).unwrap_or(i64::MAX),
        tv_nsec: (deadline_ns % 1_000_000_000) as _,
    };
    if rustix::thread::clock_nanosleep_absolute(ClockId::Monotonic, &deadline).is_err() {
        // Interrupted by a signal: the caller's loop checks the clock anyway.
        std::hint::spin_loop();
    }
}

/// Asks for timers of the calling thread to be rounded to 1 ns instead of 50 µs; ignored for FIFO threads.
pub(crate) fn sharpen_timers() -> io::Result<()> {
    rustix::thread::set_current_timer_slack(NonZeroU64::new(1)).map_err(io::Error::from)
}

/// Range of FIFO priorities of this system, lowest and highest.
pub(crate) fn fifo_priorities() -> (u8, u8) {
    // SAFETY: both functions take a policy by value and touch no memory of ours.
    let (min, max) = unsafe {
        (libc::sched_get_priority_min(libc::SCHED_FIFO), libc::sched_get_priority_max(libc::SCHED_FIFO))
    };
    (u8::try_from(min).unwrap_or(1), u8::try_from(max).unwrap_or(99))
}

/// Puts the calling thread under FIFO scheduling; threads that it starts do not inherit it.
pub(crate) fn set_fifo(priority: u8) -> io::Result<()> {
    let (min, max) = fifo_priorities();
    if !(min..=max).contains(&priority) {
        return Err(io::Error::new(
            io::ErrorKind::InvalidInput,
            format!("FIFO priority {priority} is out of range ({min} to {max})"),
        ));
    }
    // SAFETY: `sched_param` is a plain C struct of integers, for which zero bytes are a valid value.
    let mut parameters: libc::sched_param = unsafe { std::mem::zeroed() };
    parameters.sched_priority = i32::from(priority);
    // SAFETY: pid 0 is the calling thread, and `parameters` outlives the call, which only reads it.
    let status =
        unsafe { libc::sched_setscheduler(0, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, &parameters) };
    if status == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}

/// Sleeps for about this long; for threads that wait for a driver to end.
pub(crate) fn nap(span: Duration) {
    std::thread::sleep(span);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sleep_until_never_returns_before_its_deadline_without_a_signal() {
        let deadline = monotonic_ns() + 2_000_000;
        sleep_until(deadline);
        assert!(monotonic_ns() >= deadline);
    }

    #[test]
    fn a_priority_out_of_range_is_named() {
        let error = set_fifo(0).unwrap_err().to_string();
        assert!(error.contains("FIFO priority 0 is out of range (1 to 99)"), "{error}");
    }
}
