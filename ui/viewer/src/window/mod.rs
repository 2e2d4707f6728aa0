//! Windows that show sessions and recordings.
//!
//! ```text
//!                    ┌─ events ─▶ screen (a thread per window) ─▶ views  ─▶ Renderer ─▶ canvas ┐
//!  event loop ───────┤                 │ panels ◀─ SubjectState                               ├─▶ surface ─▶ pixels
//!  (first thread)    │                 └ Request ─▶ Subject                                    ┘
//!                    └─ hands ─▶ Player ─▶ the session, at 125 Hz, however long a frame takes
//! ```
//!
//! A window shows one or several [`Subject`]s: running sessions, recordings. It reads their snapshots and state, and
//! sends them the user's requests; neither ever blocks the other.

mod canvas;
pub mod display;
mod events;
mod health;
pub mod keys;
mod lag;
mod lifecycle;
mod mentor;
mod mouse;
pub mod navigate;
mod panel;
mod screen;
pub mod subject;
mod surface;
pub mod view_state;

pub use events::{LoopMessage, Options, Windows};
pub use health::ViewerHealth;
pub use lifecycle::ViewerFault;
pub use subject::{PlayState, Player, Request, Subject, SubjectState};
pub use view_state::{Choice, StereoLayout};
pub use winit::event_loop::EventLoopProxy;
