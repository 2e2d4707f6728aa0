//! The same arithmetic with the widest registers that the machine has.
//!
//! A program for any x86-64 may only use registers of two numbers; most machines have those of four. What is run here is
//! compiled for either, and what the machine can do decides. Each number comes out to the bit as it would otherwise: the
//! same operations in the same order, none of them fused, only more of them at once.

/// Runs `work`; what it calls has to be inlined into it.
#[inline]
pub(crate) fn wide<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}
