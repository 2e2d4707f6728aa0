//! A counting allocator: counts what each thread allocates, frees and holds. A program enables it by
//!
//! ```text
//! #[global_allocator]
//! static ALLOCATOR: CountingAllocator = CountingAllocator;
//! ```
//!
//! Other threads are not counted, so that tests may run in parallel.

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator, counting for each thread.
pub struct CountingAllocator;

struct Counts {
    held: Cell<isize>,
    peak: Cell<isize>,
    allocations: Cell<u64>,
    frees: Cell<u64>,
}

thread_local! {
    static COUNTS: Counts = const {
        Counts { held: Cell::new(0), peak: Cell::new(0), allocations: Cell::new(0), frees: Cell::new(0) }
    };
}

fn allocated(bytes: usize) {
    // Threads that are being torn down are not counted.
    let _ = COUNTS.try_with(|counts| {
        let held = counts.held.get() + bytes as isize;
        counts.held.set(held);
        counts.peak.set(counts.peak.get().max(held));
        counts.allocations.set(counts.allocations.get() + 1);
    });
}

fn freed(bytes: usize) {
    let _ = COUNTS.try_with(|counts| {
        counts.held.set(counts.held.get() - bytes as isize);
        counts.frees.set(counts.frees.get() + 1);
    });
}

// SAFETY: every call is forwarded to the system's allocator unchanged; counting allocates nothing.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        allocated(layout.size());
        // SAFETY: the caller keeps the contract.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        allocated(layout.size());
        // SAFETY: the caller keeps the contract.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        freed(layout.size());
        // SAFETY: the caller keeps the contract.
        unsafe { System.dealloc(pointer, layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // As if it were copied: both blocks are held for a moment.
        allocated(new_size);
        freed(layout.size());
        // SAFETY: the caller keeps the contract.
        unsafe { System.realloc(pointer, layout, new_size) }
    }
}

/// Bytes that the calling thread has allocated and not freed.
pub fn held() -> isize {
    COUNTS.with(|counts| counts.held.get())
}

/// Numbers of allocations and frees of the calling thread.
pub fn calls() -> (u64, u64) {
    COUNTS.with(|counts| (counts.allocations.get(), counts.frees.get()))
}

/// Number of allocations and frees of the calling thread together.
pub fn touches() -> u64 {
    let (allocations, frees) = calls();
    allocations + frees
}

/// Runs `work` on this thread; returns its numbers of allocations and frees.
pub fn counted(work: impl FnOnce()) -> (u64, u64) {
    let before = calls();
    work();
    let after = calls();
    (after.0 - before.0, after.1 - before.1)
}

/// Largest number of bytes held at once while `work` runs on this thread, above what was held before.
pub fn peak_of<R>(work: impl FnOnce() -> R) -> (R, usize) {
    let before = held();
    COUNTS.with(|counts| counts.peak.set(before));
    let result = work();
    (result, COUNTS.with(|counts| (counts.peak.get() - before) as usize))
}
