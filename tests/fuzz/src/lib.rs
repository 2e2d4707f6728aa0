//! What the targets share: memory counted per input, and how much an input may cost; inputs that are lists of steps.

pub mod control_session;
pub mod peer_scene;
pub mod replica_scene;
mod steps;

pub use steps::{Step, first, first_chunk, pause_of, push_step, steps};
use trocar_test_support::allocations::CountingAllocator;
pub use trocar_test_support::allocations::{peak_of, touches};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// Memory per byte of input, and memory that any input may cost.
pub struct Bound {
    /// Bytes held at once per byte of input.
    pub per_byte: usize,
    /// Bytes held at once whatever the input.
    pub always: usize,
}

impl Bound {
    /// Runs `work` on an input of `length` bytes.
    ///
    /// # Panics
    /// When it held more memory than the bound allows: that is the finding.
    pub fn holds<R>(&self, length: usize, work: impl FnOnce() -> R) -> R {
        let (result, peak) = peak_of(work);
        let allowed = self.per_byte * length + self.always;
        assert!(peak <= allowed, "{peak} bytes for an input of {length}, allowed are {allowed}");
        result
    }
}
