//! Code shared by several tests.

pub mod basin;
pub mod beam;
pub mod delaunay;
pub mod direct;
pub mod freezing;
pub mod sheet;
pub mod springs;
pub mod stage;
pub mod suture;
pub mod thread;
