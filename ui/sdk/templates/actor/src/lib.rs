//! A plain actix actor in a session: a coach, who tells trainees when they move too fast.
//!
//! When to write an actor rather than a controller: when it lives on messages (a web page, a speech synthesiser, a
//! database), when it may be slow, or when it does not belong into lock-step. It sees the same snapshots as
//! everybody and writes through a [`Guest`], whose bounded ring nobody else shares. It can hang, and the Model
//! does not notice.

mod speaker;

use std::time::Duration;

use actix::prelude::*;
pub use speaker::{Say, Speaker};
use trocar::prelude::*;

/// Speed of an instrument's tip from which on the coach speaks up \[m/s\].
pub const SPEED_MAX: f64 = 0.1;
/// How often it looks: an actor chooses its own rate, and a person cannot listen faster than that.
const LOOK_EVERY: Duration = Duration::from_millis(20);

/// What the coach has said, on its own entity: for reports, for replay, and for the next life of the coach.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Advice {
    /// How often it spoke up.
    pub count: u32,
    /// Fastest movement so far \[m/s\].
    pub speed_max: f64,
    /// Events of the session that it has heard.
    pub events: u32,
}

impl Component for Advice {
    const NAME: &'static str = "advice";
}

/// The actor.
pub struct Coach {
    guest: Guest,
    speaker: Addr<Speaker>,
    speed_max: f64,
    advice: Advice,
    /// Whether somebody is too fast right now: it speaks up once for each time.
    too_fast: bool,
}

impl Coach {
    /// What the coach reads and writes; the Model holds it to that, as it does a controller.
    pub fn access() -> Access {
        Access::new().reads::<InstrumentTarget>().writes::<Advice>(EntitySet::Own)
    }

    /// Called at the start, and again when the coach has panicked: it goes on from what stands in the scene.
    pub fn new(guest: Guest, speed_max: f64) -> Self {
        let advice = guest.snapshot().get::<Advice>(guest.me()).cloned().unwrap_or_default();
        // What blocks (printing, a disk, a network without async) goes to a thread of its own.
        let speaker = SyncArbiter::start(1, || Speaker);
        Self { guest, speaker, speed_max, advice, too_fast: false }
    }

    /// What it has said so far.
    pub fn advice(&self) -> &Advice {
        &self.advice
    }

    /// Looks once at the scene, and says what is to be said.
    pub fn look(&mut self) {
        // Subscribing to snapshots is to load the latest one when one wants it: nothing queues up, and who is
        // slow sees fewer of them, never older ones. Events do not get lost in between.
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
            // Never waits. `Ok(Submitted::Dropped)` says that the ring is full: then with the next look.
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

/// Trocar, and what this crate adds to it. The actor joins every live session, is built again when it dies, and
/// ends with the session; in lock-step, where there is no real time, it is left out.
pub fn app(speed_max: f64) -> App {
    App::new()
        .component::<Advice>()
        .actor("coach", Coach::access(), move |guest| Coach::new(guest, speed_max))
}
