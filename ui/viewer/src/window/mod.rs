//! Windows onto a scene.
//!
//! ```text
//!                    ┌─ events ─▶ screen (a thread per window) ─▶ sights ─▶ Renderer ─▶ canvas ┐
//!  event loop ───────┤                 │ panels ◀─ Standing                                   ├─▶ painter ─▶ pixels
//!  (first thread)    │                 └ Ask ─▶ Subject                                       ┘
//!                    └─ hands ─▶ Player ─▶ the session, at 125 Hz, however long a frame takes
//! ```
//!
//! A window shows one or several [`Subject`]s: running sessions, recordings. It reads their snapshots, shows what they
//! say of themselves, and asks them for what a person wants; it never waits for them, nor they for it.

mod canvas;
pub mod display;
mod events;
pub mod keys;
mod life;
mod mouse;
pub mod navigate;
mod painter;
mod panel;
mod screen;
pub mod sight;
mod soundness;
pub mod subject;

pub use events::{Options, Told, Windows};
pub use life::Trouble;
pub use sight::{Choice, Eyes};
pub use soundness::Soundness;
pub use subject::{Ask, Course, Player, Standing, Subject};
pub use winit::event_loop::EventLoopProxy;
