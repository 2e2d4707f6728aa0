//! Mass-spring networks.

mod reference;
mod solver;
