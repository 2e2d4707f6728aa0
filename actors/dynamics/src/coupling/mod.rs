//! Bodies of different methods at different rates: a membrane that is grown onto an organ, a band that lies about one.
//!
//! The faster body is stepped with [`Ghosts`] of the slower one's nodes, mass points as heavy as those are to push in a step
//! of theirs. What joins the two, or keeps them apart, is part of the faster one's solver
//! ([`ExternalNodes`](external_nodes::ExternalNodes)). What that gives the ghosts it owes the nodes, and the slower body
//! takes the sum at its next step: action and reaction are the same numbers, so momentum is exchanged to rounding, whatever
//! the rates and masses are, and whatever either body does when.
//!
//! Each step of the slower body puts the ghosts right. How they move then costs nothing: it is what the body does. Where they
//! are then would stretch the springs anew, and that is paid out of a tank which what dampers and friction took has filled,
//! and what the ghosts were given beyond what the body received (passivity by a tank: Franken, Stramigioli, Misra, Secchi,
//! Macchelli 2011). What the tank cannot pay is made up for later, and what it lacks is forgiven within half a second or so.
//!
//! A thread that lies on such a body has contacts far stiffer than those springs: its ghosts are put right at a velocity, within
//! its own continuous tests, and not paid for (see `trocar-simulator`).
//!
//! Stiff groups do not belong on both sides of that: needle, thread and what they rub on are stepped as one island.

pub mod external_nodes;
pub(crate) mod ghost_nodes;
pub(crate) mod surface_contact;

pub use ghost_nodes::{Ghosts, GhostsError, News};
pub use surface_contact::{Anchor, Lying, LyingRule};
