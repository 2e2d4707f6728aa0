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

/// From now on what the Wayland library has to say goes to the log instead of to stderr. Graphics drivers look for a
/// Wayland display wherever they start, also for a picture without a window, and where there is none the library calls
/// that an error. Does nothing without the library.
pub fn quieten_wayland() {
    #[cfg(all(unix, not(target_os = "macos")))]
    {
        use std::ffi::{c_char, c_void};

        /// The message comes with its arguments, which only C can read.
        unsafe extern "C" fn log(_: *const c_char, _: *const c_void) {
            tracing::debug!("the Wayland library: there is no display that it can use");
        }

        static ONCE: std::sync::Once = std::sync::Once::new();
        ONCE.call_once(|| {
            if wayland_sys::client::is_lib_available() {
                // SAFETY: the handler has the type that the library requires, reads none of its arguments, does not
                // unwind, and lives as long as the process; the library stays loaded.
                unsafe { (wayland_sys::client::wayland_client_handle().wl_log_set_handler_client)(log) }
            }
        });
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
