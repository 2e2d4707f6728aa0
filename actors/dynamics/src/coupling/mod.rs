//! Co-simulation coupling of bodies with different methods and rates: a membrane grown onto an organ, a band around
//! one.
//!
//! The faster body is stepped with [`GhostNodes`] of the slower one's nodes: mass points with the effective mass that a
//! node shows in one of the slower body's steps. Ties and contacts between the two are part of the faster body's solver
//! ([`ExternalNodes`](external_nodes::ExternalNodes)). The impulses on the ghosts accumulate, and the slower body takes
//! the sum at its next step. Action and reaction are the same numbers, so momentum is exchanged to rounding, for any
//! rates, masses and delays.
//!
//! A ghost is also damped as the slower body's implicit step damps it. Otherwise it would swing on its ties between two
//! reports, and a report that takes long to compute would find the swing elsewhere and feed it.
//!
//! Each report of the slower body corrects the ghosts. Correcting velocities costs nothing: it is the body's own
//! motion. Correcting positions would stretch the springs anew; this energy is paid from a tank that is filled by
//! dissipation in dampers and friction, and by the difference between the work on the ghosts and on the body (passivity
//! by an energy tank: Franken, Stramigioli, Misra, Secchi, Macchelli 2011). What the tank cannot pay is corrected
//! later, and a deficit is forgiven within about half a second.
//!
//! A slower body that is late breaks nothing. When its last report is older than two of its steps, its ghosts stand
//! still, as immovable, until it reports again. When it takes impulses of more than one and a half of its steps, it
//! takes their mean force: it has not moved in the steps that it missed, so the impulses of that time are not its own.
//! Momentum is exchanged to rounding by bodies that miss no steps.
//!
//! A thread on such a body has contacts far stiffer than those springs: its ghosts are corrected with a velocity,
//! within the thread's continuous collision tests, and without payment (see `trocar-simulator`).
//!
//! Do not put stiff groups on both sides of a coupling: needle, thread and what they rub on are stepped as one island.

pub mod external_nodes;
pub(crate) mod ghost_nodes;
pub(crate) mod surface_contact;

pub use ghost_nodes::{GhostNodes, GhostNodesError, SlowBodyReport};
pub use surface_contact::{StickPoint, SurfaceContactParams, SurfaceContacts};
