//! Plain actix actors in a live session: each with its own thread and actix system, rebuilt when it dies, ended with
//! the session.
//!
//! actix drops an actor that panics. Here a monitor thread rebuilds it from the current scene. An actor that blocks its
//! thread, even in an endless loop, affects no other thread: to the Model it is a [`Guest`].

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use actix::prelude::{Actor, Context, System};

use super::LiveError;
use super::guest::{Guest, GuestIdentity};
use super::shared::lock;
use crate::runtime::{guarded, panics};

/// Period of the check that an actor and its session are still alive.
const LOOK_EVERY: Duration = Duration::from_millis(10);
/// An actor is given up after this many restarts within [`RESTART_WINDOW`].
const RESTARTS_MAX: usize = 5;
/// See [`RESTARTS_MAX`].
const RESTART_WINDOW: Duration = Duration::from_secs(10);
/// Pause before the first restart; doubled with each further one within the window.
const BACKOFF: Duration = Duration::from_millis(20);
/// Longest wait for an actor's thread to end.
const END_MAX: Duration = Duration::from_millis(100);

/// An actor that takes part in a session. Dropping it ends the actor.
pub struct HostedActor {
    name: String,
    state: Arc<HostedState>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct HostedState {
    stop: AtomicBool,
    alive: AtomicBool,
    restarts: AtomicU32,
    /// Why it was given up, if it was.
    given_up: Mutex<Option<String>>,
}

impl HostedActor {
    /// Starts a thread on which `build` makes the actor, at the start and after each death.
    pub(super) fn start<A>(
        identity: GuestIdentity,
        build: impl Fn(Guest) -> A + Send + 'static,
    ) -> Result<Self, LiveError>
    where
        A: Actor<Context = Context<A>>,
    {
        // Declared here, so that an access conflict is returned to the caller.
        let first = identity.accept()?;
        let (name, state) = (identity.name.clone(), Arc::new(HostedState::default()));
        let given = state.clone();
        let thread = std::thread::Builder::new().name(format!("actor {name}")).spawn(move || {
            if let Err(panic) = guarded(|| run(&identity, first, &build, &given)) {
                *lock(&given.given_up) = Some(panic);
            }
            given.alive.store(false, Ordering::Relaxed);
        })?;
        Ok(Self { name, state, thread: Some(thread) })
    }

    /// Its name among the writers.
    pub fn name(&self) -> &str {
        &self.name
    }
    /// Whether it is alive and takes messages.
    pub fn is_alive(&self) -> bool {
        self.state.alive.load(Ordering::Relaxed)
    }
    /// Number of restarts.
    pub fn restarts(&self) -> u32 {
        self.state.restarts.load(Ordering::Relaxed)
    }
    /// Why it is no longer restarted, if it was given up.
    pub fn given_up(&self) -> Option<String> {
        lock(&self.state.given_up).clone()
    }
    /// Asks it to end, without waiting.
    pub fn ask_to_end(&self) {
        self.state.stop.store(true, Ordering::Relaxed);
    }
    /// HandleParts it; `false` when it hangs and its thread was abandoned.
    pub fn end(mut self) -> bool {
        self.finish()
    }

    fn finish(&mut self) -> bool {
        self.ask_to_end();
        let Some(thread) = self.thread.take() else { return true };
        let until = Instant::now() + END_MAX;
        while !thread.is_finished() {
            if Instant::now() >= until {
                return false;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        // The cause of its death is recorded in its state.
        let _ = thread.join();
        true
    }
}

impl Drop for HostedActor {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Runs one life after the other, until the session ends or the actor fails too often.
fn run<A>(identity: &GuestIdentity, first: Guest, build: &dyn Fn(Guest) -> A, state: &HostedState)
where
    A: Actor<Context = Context<A>>,
{
    let over = || state.stop.load(Ordering::Relaxed) || identity.shared.over.load(Ordering::Relaxed);
    System::new().block_on(async {
        let mut guest = Some(first);
        let mut deaths: Vec<Instant> = Vec::with_capacity(RESTARTS_MAX + 1);
        loop {
            let why = match guest.take().map_or_else(|| identity.accept(), Ok) {
                Err(error) => error.to_string(),
                Ok(guest) => match guarded(|| build(guest)) {
                    Err(panic) => panic,
                    Ok(actor) => {
                        let addr = actor.start();
                        state.alive.store(true, Ordering::Relaxed);
                        while addr.connected() && !over() {
                            actix_rt::time::sleep(LOOK_EVERY).await;
                        }
                        state.alive.store(false, Ordering::Relaxed);
                        panics::take_text().unwrap_or_else(|| "it stopped by itself".to_owned())
                    }
                },
            };
            if over() {
                return;
            }
            tracing::error!("actor '{}': {why}", identity.name);
            let now = Instant::now();
            deaths.retain(|died| now.duration_since(*died) < RESTART_WINDOW);
            deaths.push(now);
            if deaths.len() > RESTARTS_MAX {
                *lock(&state.given_up) =
                    Some(format!("{} times within {RESTART_WINDOW:?}: {why}", deaths.len()));
                return;
            }
            let pause = Instant::now() + BACKOFF * (1 << (deaths.len() - 1));
            while Instant::now() < pause && !over() {
                actix_rt::time::sleep(LOOK_EVERY).await;
            }
            state.restarts.fetch_add(1, Ordering::Relaxed);
        }
    });
}
