//! Panic capture: message and place of a panic become an error instead of being printed, because printing a backtrace
//! takes tens of milliseconds on a thread that has one.

use std::any::Any;
use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Once;

thread_local! {
    static QUIET: Cell<u32> = const { Cell::new(0) };
    static SLOT: RefCell<Option<String>> = const { RefCell::new(None) };
}

fn install() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| {
            if QUIET.get() == 0 {
                return before(info);
            }
            let payload = info.payload();
            let text = match payload.downcast_ref::<String>() {
                Some(text) => text.as_str(),
                None => payload.downcast_ref::<&'static str>().copied().unwrap_or("panicked with no text"),
            };
            let text = match info.location() {
                Some(place) => format!("{text} ({}:{})", place.file(), place.line()),
                None => text.to_owned(),
            };
            SLOT.with(|slot| {
                if let Ok(mut slot) = slot.try_borrow_mut() {
                    *slot = Some(text);
                }
            });
        }));
    });
}

/// Runs `work`; a panic in it becomes an error with its message and place.
///
/// # Errors
/// The panic's message and place.
pub fn guarded<R>(work: impl FnOnce() -> R) -> Result<R, String> {
    /// Guard that silences the panic hook on this thread; counted, so that uses can nest, and released on drop.
    struct Quiet;
    impl Drop for Quiet {
        fn drop(&mut self) {
            QUIET.set(QUIET.get() - 1);
        }
    }
    install();
    QUIET.set(QUIET.get() + 1);
    let quiet = Quiet;
    let result = catch_unwind(AssertUnwindSafe(work));
    drop(quiet);
    result.map_err(|payload| {
        forget_payload(payload);
        take_text().unwrap_or_else(|| "panicked".to_owned())
    })
}

/// Message of the last panic on this thread, if it happened within [`guarded`] and another `catch_unwind` caught it.
pub fn take_text() -> Option<String> {
    SLOT.with(|slot| slot.try_borrow_mut().ok().and_then(|mut slot| slot.take()))
}

/// Frees string payloads and leaks others: a payload of an unknown type may panic when dropped.
fn forget_payload(payload: Box<dyn Any + Send>) {
    if !(payload.is::<&'static str>() || payload.is::<String>()) {
        std::mem::forget(payload);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_becomes_its_text_and_place() {
        let text = guarded(|| panic!("ring {}", 7)).map(|_: ()| ()).expect_err("panics");
        assert!(text.starts_with("ring 7") && text.contains("panics.rs:"), "{text}");
    }

    #[test]
    fn work_that_does_not_panic_returns() {
        assert_eq!(guarded(|| 3), Ok(3));
    }

    #[test]
    fn a_payload_that_panics_when_dropped_does_no_harm() {
        struct Bomb;
        impl Drop for Bomb {
            fn drop(&mut self) {
                panic!("in drop");
            }
        }
        let outcome = guarded(|| std::panic::panic_any(Bomb));
        assert!(outcome.is_err());
    }
}
