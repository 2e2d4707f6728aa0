//! A pause of the host, in which its stations rest.

use trocar_scene::{SimTime, Snapshot};

use super::{HostMachine, Link, told};
use crate::control::HostState;

/// Time between two words that the session is paused.
const PAUSED_EVERY: SimTime = SimTime::from_millis(1_000);

impl<A: Copy + PartialEq + Send + 'static> HostMachine<A> {
    /// The session is paused: its time stands still at that of the last step, and stations that are told so stand still as
    /// well. What comes is answered, so that nobody takes the host for gone, and whoever joins gets in; nothing expires.
    /// `passed` is how long the pause has lasted.
    pub fn rest(&mut self, passed: SimTime, scene: &Snapshot) {
        let now = self.now;
        let is_due = self.paused_again_at.is_none_or(|at| passed >= at);
        if is_due {
            self.paused_again_at = Some(passed + PAUSED_EVERY);
        }
        let running = |link: &&mut Link| link.control.state() == HostState::Running;
        for link in self.links.values_mut().filter(running).filter(|link| is_due || !link.is_paused) {
            link.is_paused = true;
            told(link.control.send_paused(true, now));
        }
        self.work(now, scene);
    }

    /// The session goes on after a pause. Hands that stations serve stand where they are until their stations have brought
    /// their own there.
    pub(super) fn go_on(&mut self, now: SimTime) {
        for link in self.links.values_mut().filter(|link| link.is_paused) {
            link.is_paused = false;
            told(link.control.send_paused(false, now));
        }
        self.members.retake_hands();
    }
}
