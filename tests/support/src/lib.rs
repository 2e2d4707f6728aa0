//! Shared test support: a counting allocator, malformed input, a lock for tests that need the machine for themselves,
//! and the test length.

pub mod allocations;
#[cfg(feature = "hostile")]
pub mod hostile;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Blocks every other test of the program while the returned guard lives: for tests in real time, of signals, and of
/// processes that must not be disturbed. Each test of a program `alone` begins with `let _alone = alone();`. Cargo runs
/// one program after another, so that such a test has the machine for itself.
#[must_use = "the test is alone as long as the guard lives"]
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    // A failed test leaves no state that could affect the next one.
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether tests run at their full length, as `tests/run --thorough` does before a release: the environment variable
/// `TROCAR_THOROUGH` is `1`.
///
/// # Panics
/// When the variable is anything else than `0` or `1`.
pub fn thorough() -> bool {
    match std::env::var("TROCAR_THOROUGH").as_deref() {
        Err(_) | Ok("" | "0") => false,
        Ok("1") => true,
        Ok(other) => panic!("TROCAR_THOROUGH is '{other}'; it may be 0 or 1"),
    }
}

/// The median; for an even number of values the mean of the two in the middle.
///
/// # Panics
/// When there is no value.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let half = sorted.len() / 2;
    if sorted.len() % 2 == 1 { sorted[half] } else { (sorted[half - 1] + sorted[half]) / 2.0 }
}
