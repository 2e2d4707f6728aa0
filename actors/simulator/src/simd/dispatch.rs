//! Run-time dispatch to the widest vector registers.
//!
//! Code for any x86-64 may only use registers of two numbers; most machines have registers of four. The work is
//! compiled for both and selected at run time. Results are bit-identical: the same operations in the same order, none
//! of them fused, only more of them at once.

/// Runs `work`; everything that it calls has to be inlined.
#[inline]
pub(crate) fn wide<R>(work: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(work)
}
