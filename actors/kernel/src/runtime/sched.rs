//! Thread scheduling: real-time priority where permitted, demotion of an unresponsive thread, CPU time. The only module
//! of this crate with unsafe code.
#![allow(unsafe_code)]

use std::io;

use serde::{Deserialize, Serialize};
use trocar_scene::SimTime;

use crate::supervision::RuntimeClass;

/// What the operating system allowed, for the report and for `doctor`.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Permission {
    /// Whether real-time priority was granted.
    pub fifo: bool,
    /// What was refused and how to fix it; empty when all was granted.
    pub refused: String,
}

impl Permission {
    fn granted() -> Self {
        Self { fifo: true, refused: String::new() }
    }
    fn refused(error: &io::Error) -> Self {
        Self {
            fifo: false,
            refused: format!(
                "real-time priority (SCHED_FIFO) was refused: {error}; grant it with CAP_SYS_NICE or an \
                 rtprio limit of at least {} (ulimit -r, /etc/security/limits.conf)",
                fifo_priority(RuntimeClass::Driver).unwrap_or(1)
            ),
        }
    }
}

/// SCHED_FIFO priority of a class; `None`: the ordinary scheduler is good enough.
///
/// The Model does short, bounded work and rings have no priority inheritance, so its priority is above its clients'.
/// Physics steps are long: at a real-time priority they would starve all other threads.
pub const fn fifo_priority(class: RuntimeClass) -> Option<i32> {
    match class {
        RuntimeClass::Driver => Some(60),
        RuntimeClass::Watchdog => Some(58),
        RuntimeClass::Model => Some(56),
        RuntimeClass::Haptics => Some(50),
        RuntimeClass::Collision => Some(40),
        RuntimeClass::Simulation | RuntimeClass::Task | RuntimeClass::Network | RuntimeClass::Recorder => {
            None
        }
    }
}

/// The calling thread's id in the operating system (tid).
pub fn current_tid() -> u32 {
    imp::current_tid()
}

/// Gives the calling thread the priority of its class.
pub fn promote_current(class: RuntimeClass) -> Permission {
    match fifo_priority(class) {
        None => Permission::granted(),
        Some(priority) => match imp::set_fifo(0, priority) {
            Ok(()) => Permission::granted(),
            Err(error) => Permission::refused(&error),
        },
    }
}

/// Returns the calling thread to the ordinary scheduler, because it used too much CPU time at real-time priority.
///
/// # Errors
/// When the system refuses.
pub fn normal_current() -> io::Result<()> {
    imp::set_normal(0)
}

/// Whether the calling thread has real-time priority now.
pub fn is_real_time() -> bool {
    imp::is_real_time()
}

/// Moves thread `tid` to SCHED_IDLE, so that it gets only otherwise idle CPU time. `tid` must be a live thread of this
/// process.
///
/// # Errors
/// When there is no such thread, or the system refuses.
pub fn demote(tid: u32) -> io::Result<()> {
    imp::set_idle(tid)
}

/// CPU time that a thread of this process has used; `None` when it has ended.
pub fn thread_cpu(tid: u32) -> Option<SimTime> {
    imp::thread_cpu(tid)
}

/// Whether a thread of this process runs or waits for a processor, rather than being blocked.
pub fn is_runnable(tid: u32) -> bool {
    imp::is_runnable(tid)
}

/// Sets the calling thread's name, as `ps` and debuggers show it; at most 15 bytes are kept.
pub fn name_current(name: &str) {
    imp::name_current(name);
}

/// Lets the calling thread's runtime wait for `fd` to become readable.
///
/// # Errors
/// When the runtime cannot watch it.
#[cfg(target_os = "linux")]
pub(crate) fn watch_readable(
    fd: std::os::fd::OwnedFd,
) -> io::Result<tokio::io::unix::AsyncFd<std::os::fd::OwnedFd>> {
    // SAFETY: `OwnedFd` always answers with the one descriptor that it owns and that stays open as long as
    // it lives, and the `AsyncFd` owns it until it has deregistered it.
    unsafe { tokio::io::unix::AsyncFd::register_with_interest(fd, tokio::io::Interest::READABLE) }
        .map_err(Into::into)
}

/// Whether the system grants real-time priority, asked on a thread of its own.
pub fn probe() -> Permission {
    std::thread::scope(|scope| {
        scope
            .spawn(|| promote_current(RuntimeClass::Driver))
            .join()
            .unwrap_or_else(|_| Permission::refused(&io::Error::other("the probe failed")))
    })
}

#[cfg(target_os = "linux")]
mod imp {
    use std::io;

    use trocar_scene::SimTime;

    pub(super) fn current_tid() -> u32 {
        rustix::thread::gettid().as_raw_nonzero().get() as u32
    }

    pub(super) fn is_runnable(tid: u32) -> bool {
        std::fs::read_to_string(format!("/proc/self/task/{tid}/stat"))
            .ok()
            .and_then(|stat| stat.rsplit(')').next().map(|rest| rest.trim_start().starts_with('R')))
            .unwrap_or(false)
    }

    pub(super) fn name_current(name: &str) {
        let end = (0..=name.len().min(15)).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
        if let Ok(name) = std::ffi::CString::new(&name[..end]) {
            // The name only helps debugging: a failure to set it is ignored.
            let _ = rustix::thread::set_name(&name);
        }
    }

    fn set(tid: u32, policy: libc::c_int, priority: libc::c_int) -> io::Result<()> {
        let param = libc::sched_param { sched_priority: priority };
        let tid = libc::pid_t::try_from(tid).map_err(|_| io::Error::from(io::ErrorKind::InvalidInput))?;
        // SAFETY: `param` is a valid sched_param that outlives the call, which keeps no pointer to it; a
        // wrong thread number is answered with an error.
        if unsafe { libc::sched_setscheduler(tid, policy, &param) } == 0 {
            Ok(())
        } else {
            Err(io::Error::last_os_error())
        }
    }

    pub(super) fn set_fifo(tid: u32, priority: i32) -> io::Result<()> {
        // RESET_ON_FORK: threads that a controller spawns do not inherit the priority.
        set(tid, libc::SCHED_FIFO | libc::SCHED_RESET_ON_FORK, priority)
    }
    pub(super) fn is_real_time() -> bool {
        // SAFETY: 0 is the calling thread; nothing is passed by reference.
        let policy = unsafe { libc::sched_getscheduler(0) };
        policy >= 0 && policy & !libc::SCHED_RESET_ON_FORK == libc::SCHED_FIFO
    }
    pub(super) fn set_normal(tid: u32) -> io::Result<()> {
        set(tid, libc::SCHED_OTHER | libc::SCHED_RESET_ON_FORK, 0)
    }
    pub(super) fn set_idle(tid: u32) -> io::Result<()> {
        set(tid, libc::SCHED_IDLE | libc::SCHED_RESET_ON_FORK, 0)
    }

    pub(super) fn thread_cpu(tid: u32) -> Option<SimTime> {
        // The kernel's encoding of "CPU clock of thread tid" (CPUCLOCK_PERTHREAD | CPUCLOCK_SCHED), which
        // unlike pthread_getcpuclockid stays defined after the thread has ended: the call then fails.
        let clock = (!libc::clockid_t::try_from(tid).ok()? << 3) | 0b110;
        let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
        // SAFETY: `time` is a valid timespec to write to; an unknown clock is answered with an error.
        let rc = unsafe { libc::clock_gettime(clock, &mut time) };
        (rc == 0).then(|| SimTime(time.tv_sec as u64 * 1_000_000_000 + time.tv_nsec as u64))
    }
}

#[cfg(not(target_os = "linux"))]
mod imp {
    use std::io;
    use std::sync::atomic::{AtomicU32, Ordering};

    use trocar_scene::SimTime;

    fn unsupported() -> io::Error {
        io::Error::new(io::ErrorKind::Unsupported, "not available on this system")
    }
    pub(super) fn current_tid() -> u32 {
        static NEXT: AtomicU32 = AtomicU32::new(1);
        thread_local!(static TID: u32 = NEXT.fetch_add(1, Ordering::Relaxed));
        TID.with(|tid| *tid)
    }
    pub(super) fn is_runnable(_: u32) -> bool {
        false
    }
    pub(super) fn name_current(_: &str) {}
    pub(super) fn set_fifo(_: u32, _: i32) -> io::Result<()> {
        Err(unsupported())
    }
    pub(super) fn is_real_time() -> bool {
        false
    }
    pub(super) fn set_normal(_: u32) -> io::Result<()> {
        Ok(())
    }
    pub(super) fn set_idle(_: u32) -> io::Result<()> {
        Err(unsupported())
    }
    pub(super) fn thread_cpu(_: u32) -> Option<SimTime> {
        None
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use std::sync::atomic::{AtomicBool, Ordering};

    use super::*;

    #[test]
    fn priorities_fall_in_the_order_of_the_classes() {
        let classes = [
            RuntimeClass::Driver,
            RuntimeClass::Watchdog,
            RuntimeClass::Model,
            RuntimeClass::Haptics,
            RuntimeClass::Collision,
            RuntimeClass::Simulation,
        ];
        let ranks: Vec<i32> = classes.iter().map(|c| fifo_priority(*c).unwrap_or(0)).collect();
        assert!(ranks.windows(2).all(|pair| pair[0] > pair[1]), "{ranks:?}");
    }

    #[test]
    fn another_thread_can_be_demoted_to_idle() {
        let done = AtomicBool::new(false);
        std::thread::scope(|scope| {
            let (send, receive) = std::sync::mpsc::sync_channel(1);
            let done = &done;
            scope.spawn(move || {
                send.send(current_tid()).expect("the test listens");
                while !done.load(Ordering::Relaxed) {
                    std::thread::sleep(std::time::Duration::from_millis(1));
                }
            });
            let tid = receive.recv().expect("a thread number");
            demote(tid).expect("a thread may always be demoted");
            let stat = std::fs::read_to_string(format!("/proc/self/task/{tid}/stat")).expect("proc");
            // Field 41 is the policy; 39 fields stand after the name's closing bracket and the state.
            let policy = stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(38));
            assert_eq!(policy, Some("5"), "{stat}");
            done.store(true, Ordering::Relaxed);
        });
    }

    #[test]
    fn a_thread_that_is_gone_has_no_cpu_time_and_cannot_be_demoted() {
        let tid = std::thread::spawn(current_tid).join().expect("the thread ends");
        // The number is free as soon as the kernel has reaped the thread.
        for _ in 0..1_000 {
            if thread_cpu(tid).is_none() {
                break;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert_eq!(thread_cpu(tid), None);
        assert!(demote(tid).is_err());
    }

    #[test]
    fn a_refusal_says_how_to_mend_it() {
        let refusal = Permission::refused(&io::Error::from_raw_os_error(libc::EPERM));
        assert!(!refusal.fifo && refusal.refused.contains("rtprio"));
    }
}
