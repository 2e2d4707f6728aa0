//! Heat, burns and removal.

mod heat_and_cuts;
mod solver;
