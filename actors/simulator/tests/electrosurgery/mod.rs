//! Heat, burns and tissue removal.

mod closed_forms;
mod heat_and_cuts;
mod solver;
