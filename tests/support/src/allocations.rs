//! An allocator that counts what each thread asks for, frees and holds. A program that wants to know says
//!
//! ```ignore
//! #[global_allocator]
//! static ALLOCATOR: CountingAllocator = CountingAllocator;
//! ```
//!
//! What other threads do at the same time is not counted, so that tests may run beside each other.

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
    // Threads that are being torn down no longer count.
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

// SAFETY: every call goes to the system's allocator unchanged; counting allocates nothing.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        allocated(layout.size());
        // SAFETY: the caller's obligations are passed on.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        allocated(layout.size());
        // SAFETY: the caller's obligations are passed on.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        freed(layout.size());
        // SAFETY: the caller's obligations are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        // As if it were copied: both are held for a moment.
        allocated(new_size);
        freed(layout.size());
        // SAFETY: the caller's obligations are passed on.
        unsafe { System.realloc(pointer, layout, new_size) }
    }
}

/// Bytes that the calling thread has allocated and not freed.
pub fn held() -> isize {
    COUNTS.with(|counts| counts.held.get())
}

/// How often the calling thread has allocated, and how often it has freed.
pub fn calls() -> (u64, u64) {
    COUNTS.with(|counts| (counts.allocations.get(), counts.frees.get()))
}

/// How often the calling thread has allocated or freed anything.
pub fn touches() -> u64 {
    let (allocations, frees) = calls();
    allocations + frees
}

/// Runs `work` on this thread; how often it allocated, and how often it freed.
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
