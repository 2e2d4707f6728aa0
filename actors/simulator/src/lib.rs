//! Simulation methods: each method is a solver in a folder of its own; `controller/` holds the thin controller that
//! applies it to the entities with its component. A solver takes slices and numbers, does not depend on the scene, and
//! steps by a given time. It commits a step only if all values are finite. [`controller`] schedules the solvers.
//!
//! | Method | File |
//! |---|---|
//! | linear quasi-static finite elements with a precomputed inverse | [`linear_fem`], [`stiffness`] |
//! | implicit dynamic finite elements, corotational and neo-Hookean | [`dynamic_fem`] |
//! | sparse matrices of 3×3 blocks and their Cholesky factorisation | [`linear_algebra`] |
//! | cutting and tearing of surfaces along arbitrary paths | [`cutting`] |
//! | mass-spring systems: thread, cloth, tube, volume, explicit and implicit | [`mass_spring`] |
//! | position-based dynamics (XPBD): distances, volumes of a modified St. Venant–Kirchhoff law, small steps | [`xpbd`] |
//! | Electrosurgery: enthalpy method, Pennes perfusion, Arrhenius damage | [`electrosurgery`] |
//! | Suture thread, knots | [`suture_thread`] |
//! | Suture needle | [`suture::needle`] |
//! | needle, thread and the sewn tissue, as one island | [`suture`] |
//! | Liquids, smoke, bleeding, vital signs | [`fluid`] |
//! | rigid bodies by impulses | [`rigid`] |
//! | a world of rigid bodies and instruments with that solver | [`impulse_world`] |
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
