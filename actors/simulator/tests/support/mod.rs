//! Code shared by several tests.
#![allow(dead_code, reason = "each program of tests uses a part of it")]

pub mod basin;
pub mod beam;
pub mod blade;
pub mod cut_cases;
pub mod delaunay;
pub mod direct;
pub mod freezing;
pub mod heated_tissue;
pub mod sheet;
pub mod springs;
pub mod stage;
pub mod suture;
pub mod thread;
pub mod turned_knot;
