//! State of a thread that a bit-identical restart needs in addition to positions and velocities.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, Entity, RecordPolicy};

use super::grasp::Grip;
use crate::controller::cutting::scissors::Blades;
use crate::suture_thread::elastic::SurfaceForce;
use crate::suture_thread::{ContactMemory, Thread, ThreadState};

/// A part of an obstacle, and its pose in the thread's frame at the last tick.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ObstaclePose {
    /// The entity.
    pub entity: Entity,
    /// The part.
    pub part: u32,
    /// `thread_from_part`.
    pub at: Isometry3<f64>,
}

/// State after the last tick.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "thread_memory", record = RecordPolicy::sampled(2.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct ThreadMemory {
    /// Rest lengths of the edges \[m\].
    pub rest_lengths: Vec<f64>,
    /// Material directors: directions across the edges that rotate with the material.
    pub directors: Vec<Vector3<f64>>,
    /// Twist of each edge relative to the previous one \[rad\].
    pub twists: Vec<f64>,
    /// Angular velocities of the edges about their axes \[rad/s\].
    pub spins: Vec<f64>,
    /// Tensions of the edges \[N\].
    pub tensions: Vec<f64>,
    /// Persistent contact state.
    pub contacts: Vec<ContactMemory>,
    /// The obstacles, in the order of the contacts' indices.
    pub met: Vec<ObstaclePose>,
    /// Grasps of the thread.
    pub grips: Vec<Grip>,
    /// Previous blades of all scissors, in the thread's frame.
    pub blades: Vec<Blades>,
    /// For each anchored node the direction of its edge, and its director, when the thread was last known untwisted
    /// against the anchor.
    pub anchors: Vec<Option<[Vector3<f64>; 2]>>,
    /// Contact forces on the elastic body that it is tied around.
    pub presses: Vec<SurfaceForce>,
    /// Shortest length of its loop since the current knot was formed, and since the last grasp or release of the thread
    /// \[m\]; negative while there is no loop.
    pub loop_min: f64,
    /// Maximum penetration depth of a contact so far \[m\].
    pub penetration_max: f64,
}

impl ThreadMemory {
    /// Copies the state of a thread.
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
