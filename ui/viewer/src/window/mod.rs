//! Windows that show sessions and recordings.
//!
//! ```text
//!                    ┌─ events ─▶ screen (a thread per window) ─▶ sights ─▶ Renderer ─▶ canvas ┐
//!  event loop ───────┤                 │ panels ◀─ Standing                                   ├─▶ painter ─▶ pixels
//!  (first thread)    │                 └ Ask ─▶ Subject                                       ┘
//!                    └─ hands ─▶ Player ─▶ the session, at 125 Hz, however long a frame takes
//! ```
//!
//! A window shows one or several [`Subject`]s: running sessions, recordings. It reads their snapshots and state, and
//! sends them the user's requests; neither ever blocks the other.

mod canvas;
pub mod display;
mod events;
pub mod keys;
mod lifecycle;
mod mouse;
pub mod navigate;
mod panel;
mod screen;
mod soundness;
pub mod subject;
mod surface;
pub mod view_state;

pub use events::{Options, Told, Windows};
pub use lifecycle::Trouble;
pub use soundness::Soundness;
pub use subject::{Ask, Course, Player, Standing, Subject};
pub use view_state::{Choice, Eyes};
pub use winit::event_loop::EventLoopProxy;
