//! What a thread needs to go on bit for bit besides where its vertices are and how they move.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, Entity};

use super::grasp::Grip;
use crate::controller::cutting::scissors::Blades;
use crate::suture_thread::elastic::Press;
use crate::suture_thread::{ContactMemory, Thread, ThreadState};

/// A part of what a thread can touch, and where it was in the thread's frame at the last tick.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Met {
    /// Whose.
    pub entity: Entity,
    /// Which part of it.
    pub part: u32,
    /// `thread_from_part`.
    pub at: Isometry3<f64>,
}

/// Where the last tick ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThreadMemory {
    /// Of the edges, without strain \[m\].
    pub rest_lengths: Vec<f64>,
    /// Directions across the edges that turn with their material.
    pub directors: Vec<Vector3<f64>>,
    /// Of each edge against the one before \[rad\].
    pub twists: Vec<f64>,
    /// Of the edges \[rad/s\].
    pub spins: Vec<f64>,
    /// Of the edges \[N\].
    pub tensions: Vec<f64>,
    /// What contacts remember.
    pub contacts: Vec<ContactMemory>,
    /// What it could touch, in the order that contacts count them in.
    pub met: Vec<Met>,
    /// What instruments hold of it.
    pub grips: Vec<Grip>,
    /// Where the blades of all scissors were, in the frame of the thread.
    pub blades: Vec<Blades>,
    /// What presses the elastic body that it is tied around.
    pub presses: Vec<Press>,
    /// The shortest that its loop has been since it became the knot that it is, and since anybody has taken hold of the thread or let it
    /// go \[m\]; below 0 as long as there is none.
    pub loop_min: f64,
    /// How deep a contact has been at most since the beginning \[m\].
    pub penetration_max: f64,
}

impl Component for ThreadMemory {
    const NAME: &'static str = "thread_memory";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}

impl ThreadMemory {
    /// Takes over where a thread is.
    pub fn take(&mut self, thread: &Thread) {
        let state = thread.state();
        self.rest_lengths.clone_from(&state.rest_lengths);
        self.directors.clone_from(&state.directors);
        self.twists.clone_from(&state.twists);
        self.spins.clone_from(&state.spins);
        self.tensions.clone_from(&state.tensions);
        self.contacts.clone_from(&state.contacts);
        self.presses.clear();
        self.presses.extend_from_slice(thread.presses());
    }

    /// The state, with positions \[m\] and velocities \[m/s\] of the scene.
    #[must_use]
    pub fn state(&self, positions: &[Point3<f64>], velocities: &[Vector3<f64>]) -> ThreadState {
        ThreadState {
            positions: positions.to_vec(),
            velocities: velocities.to_vec(),
            rest_lengths: self.rest_lengths.clone(),
            directors: self.directors.clone(),
            twists: self.twists.clone(),
            spins: self.spins.clone(),
            tensions: self.tensions.clone(),
            contacts: self.contacts.clone(),
        }
    }
}
