//! Toy components and controllers for the live tests; not every test program uses all of them.

use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use trocar_kernel::spec::{ControllerSpec, SessionSpec};
use trocar_kernel::supervision::RuntimeClass;
use trocar_scene::{
    Access, Commands, Component, ComponentError, Controller, ControllerError, Entity, EntitySet, Registry,
    RegistryBuilder, SimTime, Snapshot, Store, Tick,
};

/// How often its writer has ticked, through all its lives.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Component)]
#[component(name = "toy_count")]
pub struct Count(pub u64);

/// Its own code panics (1) or hangs until [`let_go`] (2) in the Model; the sender's check goes well.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trap(pub u32);
/// How often those who hang were let go.
static LET_GO: AtomicU32 = AtomicU32::new(0);
thread_local! {
    /// Whether this thread has been let go: it runs on to its end then.
    static WENT: Cell<bool> = const { Cell::new(false) };
}

/// Lets everybody go who hangs in a [`Trap`] now; another Model that runs into one later hangs again.
pub fn let_go() {
    LET_GO.fetch_add(1, Ordering::Relaxed);
}

impl Component for Trap {
    const NAME: &'static str = "toy_trap";
    fn check(&self) -> Result<(), ComponentError> {
        // The Model's thread is the one that bears its name.
        let task = std::fs::read_to_string("/proc/thread-self/comm").unwrap_or_default();
        if task.trim() == "model" {
            match self.0 {
                1 => panic!("a component's own code"),
                2 if !WENT.get() => {
                    let before = LET_GO.load(Ordering::Relaxed);
                    while LET_GO.load(Ordering::Relaxed) == before {
                        std::thread::sleep(Duration::from_millis(1));
                    }
                    WENT.set(true);
                }
                _ => {}
            }
        }
        Ok(())
    }
}

pub fn registry() -> Arc<Registry> {
    let mut builder = RegistryBuilder::new();
    builder.register::<Count>().and_then(|builder| builder.register::<Trap>()).expect("two names");
    builder.build()
}

/// What a test asks of a toy from outside.
#[derive(Default)]
pub struct Wish {
    /// Panic, once.
    pub panic: AtomicBool,
    /// Return an error, once.
    pub fail: AtomicBool,
    /// Panic when dropped, once.
    pub panic_in_drop: AtomicBool,
    /// So many constructions fail before one goes well.
    pub fail_builds: AtomicU32,
    /// Loop until it is `false`.
    pub hang: AtomicBool,
    /// Write this [`Trap`] next.
    pub trap: AtomicU32,
    /// Ticks that began, of all lives.
    pub ticks: AtomicU64,
    /// Calls while the session was paused, of all lives, and how long the pause had lasted at the latest one \[ns\].
    pub rests: AtomicU64,
    pub rested_ns: AtomicU64,
    /// The latest epoch.
    pub epoch: AtomicU32,
}

impl Wish {
    fn once(flag: &AtomicBool) -> bool {
        flag.load(Ordering::Relaxed) && flag.swap(false, Ordering::Relaxed)
    }
}

/// Counts its ticks in the scene, from where its last life stood.
pub struct Toy {
    wish: Arc<Wish>,
}

impl Controller for Toy {
    fn access(&self) -> Access {
        Access::new().writes::<Count>(EntitySet::Own).writes::<Trap>(EntitySet::Own)
    }
    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.wish.ticks.fetch_add(1, Ordering::Relaxed);
        self.wish.epoch.store(tick.epoch, Ordering::Relaxed);
        if Wish::once(&self.wish.panic) {
            panic!("as wished");
        }
        if Wish::once(&self.wish.fail) {
            return Err(ControllerError::Failed("as wished".to_owned()));
        }
        while self.wish.hang.load(Ordering::Relaxed) {
            std::hint::spin_loop();
        }
        let trap = self.wish.trap.swap(0, Ordering::Relaxed);
        if trap > 0 {
            out.put(tick.me, Trap(trap));
        }
        let before = scene.get::<Count>(tick.me).map_or(0, |count| count.0);
        out.put(tick.me, Count(before + 1));
        Ok(())
    }
    fn rest(&mut self, passed: SimTime, _: &Snapshot) {
        self.wish.rests.fetch_add(1, Ordering::Relaxed);
        self.wish.rested_ns.store(passed.as_nanos(), Ordering::Relaxed);
        if Wish::once(&self.wish.panic) {
            panic!("as wished");
        }
    }
}

impl Drop for Toy {
    fn drop(&mut self) {
        if Wish::once(&self.wish.panic_in_drop) {
            panic!("in drop, as wished");
        }
    }
}

/// A toy of this name and rate, as writer `id`.
pub fn toy(name: &str, id: u16, rate_hz: f64) -> (ControllerSpec, Arc<Wish>) {
    let wish = Arc::new(Wish::default());
    let given = wish.clone();
    let spec = ControllerSpec::new(name, id, RuntimeClass::Task, rate_hz, move |_| {
        let left = given.fail_builds.load(Ordering::Relaxed);
        if left > 0 {
            given.fail_builds.store(left - 1, Ordering::Relaxed);
            return Err(ControllerError::Scene("not today".to_owned()));
        }
        Ok(Box::new(Toy { wish: given.clone() }) as Box<dyn Controller>)
    });
    (spec, wish)
}

pub fn session(controllers: Vec<ControllerSpec>) -> SessionSpec {
    SessionSpec::new("toys", 1, Store::new(registry()), controllers)
}

/// The count of writer `id` as readers see it.
pub fn count(scene: &Snapshot, id: u16) -> u64 {
    scene.get::<Count>(Entity::of_writer(0, id)).map_or(0, |count| count.0)
}

/// Waits until `what` holds; panics with `why` when it does not within ten seconds.
pub fn eventually(why: &str, mut what: impl FnMut() -> bool) {
    let until = Instant::now() + Duration::from_secs(10);
    while !what() {
        assert!(Instant::now() < until, "{why}");
        std::thread::sleep(Duration::from_millis(1));
    }
}
