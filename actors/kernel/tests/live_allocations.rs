//! A warmed tick allocates nothing and frees nothing on its thread: not in the controller, not in the ring,
//! not in the host around them.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::support::toys::{Count, session};
use trocar_kernel::live::LiveSession;
use trocar_kernel::spec::ControllerSpec;
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::{Access, Commands, Controller, ControllerError, EntitySet, Snapshot, Tick};
use trocar_test_support::allocations::touches;
use trocar_test_support::alone;

/// At the beginning of a tick: how many there were before, and its thread's count of allocations and frees.
type Seen = (u64, u64);

/// Notes what it sees in every tick in which nobody reads the notes, in room that is there already.
struct Scale {
    seen: Arc<Mutex<Vec<Seen>>>,
    waste: Arc<AtomicBool>,
    ticks: u64,
}

impl Controller for Scale {
    fn access(&self) -> Access {
        Access::new().writes::<Count>(EntitySet::Own)
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if let Ok(mut seen) = self.seen.try_lock()
            && seen.len() < seen.capacity()
        {
            seen.push((self.ticks, touches()));
        }
        self.ticks += 1;
        if self.waste.load(Ordering::Relaxed) {
            std::hint::black_box(Box::new(tick.number));
        }
        let before = scene.get::<Count>(tick.me).map_or(0, |count| count.0);
        out.put(tick.me, Count(before + 1));
        Ok(())
    }
}

const TICKS: usize = 1_500;

/// What a controller saw, that wastes one allocation and its free in every tick or does not.
fn run(waste: bool) -> Vec<Seen> {
    let seen = Arc::new(Mutex::new(Vec::with_capacity(TICKS)));
    let (given, waste) = (seen.clone(), Arc::new(AtomicBool::new(waste)));
    let spec = ControllerSpec::new("scale", 1, RuntimeClass::Haptics, 1_000.0, move |_| {
        Ok(Box::new(Scale { seen: given.clone(), waste: waste.clone(), ticks: 0 }) as Box<dyn Controller>)
    });
    let live = LiveSession::start(session(vec![spec])).expect("starts");
    for _ in 0..200 {
        std::thread::sleep(Duration::from_millis(50));
        let full = seen.lock().map(|seen| seen.len() == TICKS).unwrap_or(false);
        if full {
            break;
        }
    }
    drop(live);
    let seen = seen.lock().expect("not poisoned").clone();
    assert_eq!(seen.len(), TICKS, "it has ticked");
    seen
}

#[test]
fn a_warmed_tick_neither_allocates_nor_frees() {
    let _alone = alone();
    let ticks_and_touches = |seen: &[Seen]| {
        let [(first, before), (last, after)] = [seen[500], seen[TICKS - 1]];
        (last - first, after - before)
    };
    let (ticks, touched) = ticks_and_touches(&run(false));
    assert_eq!(touched, 0, "in {ticks} ticks");
    // The count sees what it should.
    let (ticks, touched) = ticks_and_touches(&run(true));
    assert_eq!(touched, 2 * ticks);
}
