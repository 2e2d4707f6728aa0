//! What any world of rigid bodies and instruments has to do.

mod bodies;
mod controller;
mod grasping;
mod instruments;
mod surfaces;
