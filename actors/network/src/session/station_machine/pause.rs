//! A pause of the host, in which the station rests and listens.

use trocar_scene::SimTime;

use super::{StationMachine, StationNews};
use crate::control::{ClientState, SILENCE_MAX};
use crate::streams::StreamState;

impl<A: Copy + PartialEq + Send + 'static> StationMachine<A> {
    /// The station's session is paused, `passed` ago, and its time stands still. As long as the host has paused it, too, the
    /// machine listens to when it goes on; the pause is over as well if the host falls silent or the stream closes. A station
    /// that has paused by itself is silent.
    pub fn rest(&mut self, passed: SimTime) {
        if !self.host_course.is_paused() {
            return;
        }
        let now = self.now;
        let heard_at = *self.heard_in_pause.get_or_insert(passed);
        if let StreamState::Closed(why) = self.stream.work(now) {
            self.drain(now);
            self.control.broke(&why, now);
        } else {
            self.receive(now);
            if !self.received.is_empty() {
                self.heard_in_pause = Some(passed);
            } else if passed.since(heard_at) >= SILENCE_MAX {
                self.control.broke("the host has fallen silent within a pause", now);
            }
        }
        self.flush(now);
        if self.control.state() != ClientState::Running {
            self.note_pause(false);
        }
    }

    pub(super) fn note_pause(&mut self, is_paused: bool) {
        if self.host_course.pause(is_paused) {
            self.tell(StationNews::Paused(is_paused));
        }
    }
}
