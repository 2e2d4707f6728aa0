//! A display that disappears must not take the simulation with it.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the display is gone.
static GONE: AtomicBool = AtomicBool::new(false);

/// Whether there may be a display: nothing else is asked, and nothing is opened.
pub fn is_announced() -> bool {
    let announced = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    cfg!(not(all(unix, not(target_os = "macos")))) || announced("DISPLAY") || announced("WAYLAND_DISPLAY")
}

/// Whether the display that there was is gone. Nothing may be asked of it any more, and the thread of the event loop
/// does not come back.
pub fn is_gone() -> bool {
    GONE.load(Ordering::Acquire)
}

/// From now on the loss of an X display is told by [`is_gone`] instead of ending the process, which is what Xlib does
/// otherwise. Does nothing where there is no X.
pub fn survive_its_loss() {
    #[cfg(all(unix, not(target_os = "macos")))]
    if let Ok(xlib) = x11_dl::xlib::Xlib::open() {
        // SAFETY: the handler has the type that Xlib asks for and lives as long as the process; it may be set at any
        // time, also before a display is opened. What was loaded stays loaded: `x11_dl` keeps it.
        unsafe {
            (xlib.XSetIOErrorHandler)(Some(lost));
        }
    }
}

/// Called by Xlib, on the thread that has found the connection broken. Xlib ends the process when this returns, and
/// unwinding through it is not allowed: the thread stays here, and the others go on.
#[cfg(all(unix, not(target_os = "macos")))]
unsafe extern "C" fn lost(_: *mut x11_dl::xlib::Display) -> i32 {
    GONE.store(true, Ordering::Release);
    tracing::warn!("the display is gone: the session goes on without pictures");
    loop {
        std::thread::park();
    }
}
