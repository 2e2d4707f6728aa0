//! A counting allocator: it counts each thread's allocations, so that "allocates nothing" can be measured. The only
//! module of this crate with unsafe code. A program's `main` selects its allocator:
//!
//! ```
//! #[global_allocator]
//! static ALLOCATOR: trocar_cli::CountingAllocator = trocar_cli::CountingAllocator;
//! # fn main() {}
//! ```
#![allow(unsafe_code)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

/// The system's allocator, with three counters per thread for `trocar bench`.
pub struct CountingAllocator;

thread_local! {
    // Constant and without a destructor: safe to touch from within the allocator, at any time.
    static ALLOCATIONS: Cell<u64> = const { Cell::new(0) };
    static FREES: Cell<u64> = const { Cell::new(0) };
    static HELD: Cell<isize> = const { Cell::new(0) };
}

/// Allocations and frees of the calling thread so far; a reallocation counts as both.
pub fn counts() -> (u64, u64) {
    (ALLOCATIONS.with(Cell::get), FREES.with(Cell::get))
}

/// Bytes that the calling thread has allocated and not freed; frees by other threads are not subtracted.
pub fn held() -> isize {
    HELD.with(Cell::get)
}

/// Whether this is the program's allocator; otherwise nothing is counted.
pub fn is_counting() -> bool {
    let before = counts();
    drop(std::hint::black_box(Box::new(0_u64)));
    counts() != before
}

fn allocated(bytes: usize) {
    ALLOCATIONS.with(|count| count.set(count.get().wrapping_add(1)));
    HELD.with(|held| held.set(held.get().wrapping_add_unsigned(bytes)));
}

fn freed(bytes: usize) {
    FREES.with(|count| count.set(count.get().wrapping_add(1)));
    HELD.with(|held| held.set(held.get().wrapping_sub_unsigned(bytes)));
}

// SAFETY: every call is forwarded to the system's allocator unchanged; counting only touches a thread-local integer and
// neither allocates nor unwinds.
unsafe impl GlobalAlloc for CountingAllocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        allocated(layout.size());
        // SAFETY: the caller keeps the contract of `alloc`.
        unsafe { System.alloc(layout) }
    }
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        allocated(layout.size());
        // SAFETY: the caller keeps the contract of `alloc_zeroed`.
        unsafe { System.alloc_zeroed(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        freed(layout.size());
        // SAFETY: the caller keeps the contract of `dealloc`.
        unsafe { System.dealloc(pointer, layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        allocated(size);
        freed(layout.size());
        // SAFETY: the caller keeps the contract of `realloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[global_allocator]
    static ALLOCATOR: CountingAllocator = CountingAllocator;

    #[test]
    fn a_box_is_one_allocation_and_one_free() {
        let before = counts();
        drop(std::hint::black_box(Box::new(7_u64)));
        let after = counts();
        assert_eq!((after.0 - before.0, after.1 - before.1), (1, 1));
        let before = held();
        let mut list = std::hint::black_box(Vec::<u64>::with_capacity(8));
        assert_eq!(held() - before, 64);
        list.reserve_exact(16);
        assert_eq!(held() - before, 128);
        drop(list);
        assert_eq!(held(), before);
        assert!(is_counting());
    }
}
