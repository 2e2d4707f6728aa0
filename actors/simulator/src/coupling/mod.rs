//! Bodies of different methods at different rates, joined at points: a membrane grown onto an organ, the end of a thread
//! in tissue, a needle in it.
//!
//! A [`Link`] is stepped with the faster body. What it gives that body it owes the slower one, which takes the sum of all
//! impulses at its next step: action and reaction are the same numbers, so momentum is exchanged to rounding, whatever
//! the rates and masses are. Between two steps of the slower body the faster one feels a proxy of it: its points, with
//! the velocities that they had and the mobility that they have.
//!
//! No energy comes from the link. Its springs and dampers are solved implicitly against both mobilities; where the proxy
//! and the body have drifted apart, the spring may only be stretched anew out of a tank that its own dissipation has
//! filled (passivity by a tank: Franken, Stramigioli, Misra, Secchi, Macchelli 2011). What the tank cannot pay is made
//! up for later.
//!
//! Stiff groups do not belong on both sides of a link: needle, thread and what they rub on are stepped as one island
//! (see [`thread`](crate::thread)).

mod ends;
mod link;

pub use ends::{End, PointWeights, RigidPoints, WeightedNodes, inverse_masses};
pub use link::{Link, LinkConfig, LinkError, LinkState, POINTS_MAX};
