//! Survives the loss of the display: the simulation goes on.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether the display is lost.
static GONE: AtomicBool = AtomicBool::new(false);

/// Whether the environment announces a display; nothing is opened.
pub fn is_announced() -> bool {
    let announced = |name| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    cfg!(not(all(unix, not(target_os = "macos")))) || announced("DISPLAY") || announced("WAYLAND_DISPLAY")
}

/// Whether the display is lost. It must not be used any more, and the thread of the event loop does not return.
pub fn is_gone() -> bool {
    GONE.load(Ordering::Acquire)
}

/// From now on the loss of an X display sets [`is_gone`] instead of ending the process, which is Xlib's default. Does
/// nothing without X.
pub fn survive_its_loss() {
    #[cfg(all(unix, not(target_os = "macos")))]
    if let Ok(xlib) = x11_dl::xlib::Xlib::open() {
        // SAFETY: the handler has the type that Xlib requires and lives as long as the process; it may be set at any
        // time, also before a display is opened. The library stays loaded: `x11_dl` keeps it.
        unsafe {
            (xlib.XSetIOErrorHandler)(Some(lost));
        }
    }
}

/// Called by Xlib on the thread that detected the broken connection. Xlib ends the process when this returns, and it
/// must not unwind: the thread stays here, and the others go on.
#[cfg(all(unix, not(target_os = "macos")))]
unsafe extern "C" fn lost(_: *mut x11_dl::xlib::Display) -> i32 {
    GONE.store(true, Ordering::Release);
    tracing::warn!("the display is gone: the session goes on without pictures");
    loop {
        std::thread::park();
    }
}
