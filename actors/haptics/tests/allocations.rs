//! A warmed haptic tick allocates nothing and frees nothing: counted by the allocator itself.

mod bench;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use bench::{Bench, Mount, Wall, handle, start_tip};
use nalgebra::Vector3;
use trocar_devices::VirtualHandConfig;
use trocar_haptics::HapticsConfig;
use trocar_haptics::renderer::{ProxyConfig, RendererConfig, VirtualCouplingConfig};

thread_local! {
    static COUNTING: Cell<bool> = const { Cell::new(false) };
    static COUNT: Cell<(u64, u64)> = const { Cell::new((0, 0)) };
}

struct Counting;

fn count(allocations: u64, frees: u64) {
    // A thread that is being torn down has no counters left; it is not the one under test.
    let _ = COUNTING.try_with(|counting| {
        if counting.get() {
            let _ = COUNT.try_with(|count| {
                let (a, f) = count.get();
                count.set((a + allocations, f + frees));
            });
        }
    });
}

// SAFETY: every call is passed on to the system allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(1, 0);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.alloc(layout) }
    }
    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(0, 1);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.dealloc(pointer, layout) }
    }
    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count(1, 1);
        // SAFETY: the caller's promises are passed on.
        unsafe { System.realloc(pointer, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `work` and returns how often it allocated and freed.
fn counted(work: impl FnOnce()) -> (u64, u64) {
    COUNT.with(|count| count.set((0, 0)));
    COUNTING.with(|counting| counting.set(true));
    work();
    COUNTING.with(|counting| counting.set(false));
    COUNT.with(Cell::get)
}

#[test]
fn the_counter_counts() {
    assert_eq!(counted(|| drop(std::hint::black_box(vec![1u8; 100]))), (1, 1));
}

#[test]
fn a_warmed_tick_allocates_and_frees_nothing() {
    for renderer in [
        RendererConfig::Proxy(ProxyConfig::default()),
        RendererConfig::VirtualCoupling(VirtualCouplingConfig::default()),
        RendererConfig::Held,
    ] {
        let hand =
            VirtualHandConfig { start_in_device: handle(0.002, 0.0, 0.0), ..VirtualHandConfig::default() };
        let wall = Wall {
            friction: 0.3,
            base_force: Vector3::new(0.0, 0.0, -0.05),
            ..Wall::plane(start_tip(Mount::SealedPort), -Vector3::x(), 500)
        };
        let config = HapticsConfig { renderer, ..HapticsConfig::default() };
        let mut bench = Bench::new(hand, config, Mount::SealedPort, wall);
        bench.aim(Vector3::new(-0.004, 0.001, 0.001));
        bench.run(200);
        let mut total = (0, 0);
        for tick in 0..1000 {
            if tick % 100 == 0 {
                bench.aim(Vector3::new(-0.004, 0.002 * f64::from(tick % 200 / 100), 0.001));
            }
            let (allocations, frees) = bench.step_with(|tick| counted(tick));
            total = (total.0 + allocations, total.1 + frees);
        }
        assert_eq!(total, (0, 0), "{renderer:?}");
        assert!(bench.felt().1.norm() > 0.3, "the tick must have had work to do");
    }
}
