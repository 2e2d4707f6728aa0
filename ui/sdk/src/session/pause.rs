//! Pausing a live session: forces fade, nobody ticks, time stands still.

use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_devices::SessionTime;
use trocar_kernel::runtime::Standstill;
use trocar_scene::SimTime;

use super::{Running, Session};

/// Longest wait for the forces to fade; a driver does it within 20 ms of its last command.
const FADE_MAX: Duration = Duration::from_millis(200);
const LOOK: Duration = Duration::from_millis(1);

/// The time of a session for the drivers of its devices, whose time since the start is given.
pub(super) fn device_time(still: &Arc<Standstill>) -> SessionTime {
    let still = still.clone();
    SessionTime::new(move |elapsed_ns| (still.at(SimTime(elapsed_ns)).as_nanos(), still.is_still()))
}

impl Session {
    /// Pauses a live session: no controller ticks any more, forces fade to zero, then time stands still and the drivers
    /// look at their devices 20 times per second only. What would have happened meanwhile does not exist: no tick is
    /// missed, nobody counts as stalled. In virtual time there is nothing to do: time passes only in
    /// [`Session::run_until`].
    ///
    /// False when the session is paused already, has ended, or runs in virtual time.
    pub fn pause(&self) -> bool {
        let Running::Live(session, _) = &self.running else { return false };
        session.pause(|| {
            let until = Instant::now() + FADE_MAX;
            let pushes = || {
                self.hands.iter().any(|hand| {
                    let applied = hand.monitor.sample().applied;
                    applied.force.norm() > 0.0 || applied.torque.norm() > 0.0
                })
            };
            while pushes() && Instant::now() < until {
                std::thread::sleep(LOOK);
            }
        })
    }

    /// Lets a paused session go on where it stood, within 50 ms; forces ramp in. False when it is not paused.
    pub fn resume(&self) -> bool {
        match &self.running {
            Running::Live(session, _) => session.resume(),
            Running::Lockstep(_) => false,
        }
    }

    /// Whether it is paused.
    pub fn is_paused(&self) -> bool {
        matches!(&self.running, Running::Live(session, _) if session.is_paused())
    }
}
