//! Simulators: each physical method a plain solver in a folder of its own, and in `controller/` the thin controller that
//! applies it to the entities that carry its component. A solver takes slices and numbers, knows no scene, and steps by a
//! given time; it commits a step only if every number of it is finite. [`controller`] schedules them.
//!
//! | Method | File |
//! |---|---|
//! | linear quasi-static finite elements with a precomputed inverse | [`linear_fem`], [`stiffness`] |
//! | implicit dynamic finite elements, corotational and neo-Hookean | [`dynamic_fem`] |
//! | sparse matrices of 3×3 blocks and their Cholesky factors | [`linear_algebra`] |
//! | surfaces that are cut along any path, and tear | [`cutting`] |
//! | masses and springs: thread, cloth, tube, volume, explicit and implicit | [`mass_spring`] |
//! | position-based: distances, neo-Hookean volumes, small steps | [`xpbd`] |
//! | Electrosurgery: enthalpy method, Pennes perfusion, Arrhenius damage | [`electrosurgery`] |
//! | Suture thread, knots | [`suture_thread`] |
//! | Suture needle | [`suture::needle`] |
//! | needle, thread and the tissue that they go through, as one island | [`suture`] |
//! | Liquids, smoke, bleeding, vital signs | [`fluid`] |
//! | rigid bodies: momenta, impulses | [`rigid`] |
//! | a world of rigid bodies and instruments, computed by that | [`impulse_world`] |
#![forbid(unsafe_code)]

mod clone_in_place;
pub mod controller;
pub mod cutting;
pub mod dynamic_fem;
pub mod electrosurgery;
pub mod fluid;
pub mod impulse_world;
pub mod linear_algebra;
pub mod linear_fem;
pub mod mass_spring;
pub mod rigid;
mod simd;
pub mod stiffness;
pub mod suture;
pub mod suture_thread;
pub mod xpbd;
