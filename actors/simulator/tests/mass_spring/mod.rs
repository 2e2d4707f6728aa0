//! Mass-spring networks.

mod collapse;
mod reference;
mod solver;
