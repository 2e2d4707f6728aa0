//! Signals that end a command in good order: SIGHUP, SIGINT and SIGTERM.
//!
//! The first one lets the command finish its files and say what came of it, and the command ends with the exit code of that
//! signal. A second one ends the process at once, with its own.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use trocar::summary::Exit;

use crate::failure::Failure;

/// The signals, with their names and exit codes.
const SIGNALS: [(i32, &str, Exit); 3] = [
    (SIGHUP, "SIGHUP", Exit::HungUp),
    (SIGINT, "SIGINT", Exit::Interrupted),
    (SIGTERM, "SIGTERM", Exit::Terminated),
];

/// The signals of this process.
#[derive(Debug, Default)]
pub struct Signals {
    stop: Arc<AtomicBool>,
    /// Number of the latest one; 0 before any.
    latest: Arc<AtomicUsize>,
}

impl Signals {
    /// Whether one has arrived; set from then on.
    pub fn stop(&self) -> &Arc<AtomicBool> {
        &self.stop
    }

    /// Name and exit code of the one that has arrived.
    pub fn arrived(&self) -> Option<(&'static str, Exit)> {
        let latest = self.latest.load(Ordering::Relaxed);
        let found = SIGNALS.iter().find(|(number, ..)| usize::try_from(*number) == Ok(latest));
        found.map(|(_, name, exit)| (*name, *exit))
    }
}

/// Catches the signals from now on; further calls return the same.
///
/// # Errors
/// When the system refuses.
pub fn catch() -> Result<&'static Signals, Failure> {
    static CAUGHT: OnceLock<Signals> = OnceLock::new();
    if let Some(signals) = CAUGHT.get() {
        return Ok(signals);
    }
    let signals = Signals::default();
    for (number, _, exit) in SIGNALS {
        if number == SIGHUP && is_ignored(SIGHUP) {
            // `nohup` lets the command outlive its terminal.
            continue;
        }
        let (stop, latest) = (signals.stop.clone(), signals.latest.clone());
        // In this order: the first signal finds `stop` unset.
        signal_hook::flag::register_conditional_shutdown(number, i32::from(exit.code()), stop.clone())
            .and_then(|_| {
                signal_hook::flag::register_usize(number, latest, usize::try_from(number).unwrap_or(0))
            })
            .and_then(|_| signal_hook::flag::register(number, stop))
            .map_err(Failure::internal)?;
    }
    Ok(CAUGHT.get_or_init(|| signals))
}

/// Whether the process was started with this signal ignored; where the system does not tell, it was not.
fn is_ignored(signal: i32) -> bool {
    let ignored = std::fs::read_to_string("/proc/self/status").ok().and_then(|status| {
        let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"))?;
        u64::from_str_radix(mask.trim(), 16).ok()
    });
    ignored.is_some_and(|mask| mask >> (signal - 1) & 1 == 1)
}
