//! A plain actix actor in a session: a coach that tells trainees when they move too fast.
//!
//! Write an actor rather than a controller for work that is driven by messages (a web page, a speech synthesiser, a
//! database), that may be slow, or that does not belong into lock-step. It reads the same snapshots as a controller and
//! writes through a [`Guest`] with its own bounded ring. If it hangs, the Model is not affected.

mod speaker;

use std::time::Duration;

use actix::prelude::*;
pub use speaker::{Say, Speaker};
use trocar::prelude::*;

/// Speed of an instrument's tip above which the coach speaks \[m/s\].
pub const SPEED_MAX: f64 = 0.1;
/// Interval between two looks: an actor chooses its own rate, and a person cannot listen faster than that.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// The coach's advice, on its own entity: for reports, for replay, and for the coach after a restart.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "advice")]
pub struct Advice {
    /// Number of warnings.
    pub count: u32,
    /// Fastest movement so far \[m/s\].
    pub speed_max: f64,
    /// Number of events that it has received.
    pub events: u32,
}

/// The actor.
pub struct Coach {
    guest: Guest,
    speaker: Addr<Speaker>,
    speed_max: f64,
    advice: Advice,
    /// Whether an instrument is too fast right now: it warns once each time.
    too_fast: bool,
}

impl Coach {
    /// The coach's declared access, which the Model enforces as for a controller.
    pub fn access() -> Access {
        Access::new().reads::<InstrumentTarget>().writes::<Advice>(EntitySet::Own)
    }

    /// Called at the start, and again after a panic: it continues from the scene.
    pub fn new(guest: Guest, speed_max: f64) -> Self {
        let advice = guest.snapshot().get::<Advice>(guest.me()).cloned().unwrap_or_default();
        // Blocking work (printing, a disk, a network without async) goes to a thread of its own.
        let speaker = SyncArbiter::start(1, || Speaker);
        Self { guest, speaker, speed_max, advice, too_fast: false }
    }

    /// Its advice so far.
    pub fn advice(&self) -> &Advice {
        &self.advice
    }

    /// Looks at the scene once, and gives advice.
    pub fn look(&mut self) {
        // The latest snapshot is loaded on demand: nothing queues up, and a slow actor sees fewer snapshots, never
        // older ones. Events in between are not lost.
        let scene = self.guest.snapshot();
        let heard = self.guest.events().len() as u32;
        let targets = scene.iter::<InstrumentTarget>();
        let fastest = targets.map(|(_, target)| target.velocity_in_world.linear.norm()).fold(0.0, f64::max);
        let begins = fastest > self.speed_max && !self.too_fast;
        self.too_fast = fastest > self.speed_max;
        if begins {
            self.advice.count += 1;
            let text = format!("gently: {:.0} mm/s", 1e3 * fastest);
            // `try_send`, which a full mailbox refuses. `do_send` would let it grow without limit.
            if self.speaker.try_send(Say(text)).is_err() {
                eprintln!("the speaker is busy");
            }
        }
        if begins || heard > 0 || fastest > self.advice.speed_max {
            self.advice.events += heard;
            self.advice.speed_max = self.advice.speed_max.max(fastest);
            let (me, advice) = (self.guest.me(), self.advice.clone());
            // Never blocks. `Ok(Submitted::Dropped)` means that the ring is full: the next look sends it again.
            if let Err(error) = self.guest.write(|_, out| out.put(me, advice)) {
                eprintln!("the coach commands nonsense: {error}");
            }
        }
    }
}

impl Actor for Coach {
    type Context = Context<Self>;

    fn started(&mut self, ctx: &mut Self::Context) {
        ctx.run_interval(LOOK_EVERY, |coach, _| coach.look());
    }
}

/// Trocar with this crate's additions. The actor joins every live session, is rebuilt after a panic, and ends with the
/// session; lock-step has no real time, so it is left out there.
pub fn app(speed_max: f64) -> App {
    App::new()
        .component::<Advice>()
        .actor("coach", Coach::access(), move |guest| Coach::new(guest, speed_max))
}
