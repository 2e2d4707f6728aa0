//! Pausing a live session: forces fade, no controller ticks, session time stops.

use std::sync::Arc;
use std::time::{Duration, Instant};

use trocar_devices::SessionTime;
use trocar_kernel::runtime::PausableClock;
use trocar_network::session::HostCourse;
use trocar_scene::SimTime;

use super::{Running, Session};

/// Longest wait for the forces to fade; a driver does it within 20 ms of its last command.
const FADE_MAX: Duration = Duration::from_millis(200);
const LOOK: Duration = Duration::from_millis(1);

/// Session time for the device drivers, computed from the time since the start of a session that starts at `begin`.
pub(super) fn device_time(clock: &Arc<PausableClock>, begin: SimTime) -> SessionTime {
    let clock = clock.clone();
    SessionTime::new(move |elapsed_ns| (clock.at(begin + SimTime(elapsed_ns)).as_nanos(), clock.is_paused()))
}

impl Session {
    /// Pauses a live session: controllers stop ticking, forces fade to zero, then session time stops and the drivers
    /// poll their devices only 20 times per second. No tick is missed, and no controller counts as stalled. In virtual
    /// time there is nothing to pause: time passes only in [`Session::run_until`].
    ///
    /// Returns false when the session is paused already, has ended, or runs in virtual time.
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

    /// Resumes a paused session within 50 ms; forces ramp in. Returns false when it is not paused.
    pub fn resume(&self) -> bool {
        match &self.running {
            Running::Live(session, _) => session.resume(),
            Running::Lockstep(_) => false,
        }
    }

    /// Whether it is paused because it is a station's, whose host has paused the session. It goes on when that does.
    pub fn is_paused_by_host(&self) -> bool {
        self.is_paused_by_host
    }

    /// Pauses and resumes a station's session as its host does.
    pub(super) fn follow_host(&mut self) {
        let Some(is_on) = self.host_course.as_ref().map(HostCourse::is_paused) else { return };
        if is_on && self.pause() {
            self.is_paused_by_host = true;
        } else if !is_on && std::mem::take(&mut self.is_paused_by_host) {
            self.resume();
        }
    }

    /// Whether it is paused.
    pub fn is_paused(&self) -> bool {
        matches!(&self.running, Running::Live(session, _) if session.is_paused())
    }
}
