//! Heat, burns and tissue removal.

mod heat_and_cuts;
mod solver;
