//! What the tests of several crates share: an allocator that counts, input that nobody meant, a lock for tests that
//! need the machine for themselves, and how long a test may take.

pub mod allocations;
#[cfg(feature = "hostile")]
pub mod hostile;

use std::sync::{Mutex, MutexGuard, PoisonError};

/// Keeps every other test of the program waiting while its result lives: for tests in real time, of signals, and of
/// processes that must not be disturbed. Each test of a program `alone` begins with `let _alone = alone();`. Cargo runs
/// one program after another, so that such a test has the machine for itself.
#[must_use = "the test is alone as long as the guard lives"]
pub fn alone() -> MutexGuard<'static, ()> {
    static ALONE: Mutex<()> = Mutex::new(());
    // A test that failed leaves nothing behind that the next one could trip over.
    ALONE.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Whether tests run at their full length, as `tests/run --thorough` does before a release: the environment variable
/// `TROCAR_THOROUGH` says `1`.
///
/// # Panics
/// When the variable says anything else than `0` or `1`.
pub fn thorough() -> bool {
    match std::env::var("TROCAR_THOROUGH").as_deref() {
        Err(_) | Ok("" | "0") => false,
        Ok("1") => true,
        Ok(other) => panic!("TROCAR_THOROUGH is '{other}'; it may be 0 or 1"),
    }
}

/// The middle value; of an even number of values the mean of the two in the middle.
///
/// # Panics
/// When there is no value.
pub fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let half = sorted.len() / 2;
    if sorted.len() % 2 == 1 { sorted[half] } else { (sorted[half - 1] + sorted[half]) / 2.0 }
}
