//! State of needle, thread and their channel through the tissue: all that a bit-exact restart needs. The tissue is
//! quasi-static: its deformation follows from the forces stored here.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::SutureError;
use super::needle::NeedleState;
use super::needle_thread_contact::STRANDS_MAX;
use super::tissue::{MaterialPoint, Tissue, TissueFeature};
use super::tissue_surface::SAMPLES_MAX;
use crate::clone_in_place::clones_in_place;
use crate::suture_thread::elastic::SurfaceForce;
use crate::suture_thread::{NODES_MAX, ThreadState};

/// Maximum number of channel points, all channels together.
pub const CHANNEL_MAX: usize = 120;
/// Maximum number of bites remembered.
pub const BITES_MAX: usize = 32;

/// State of the needle tip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Tip {
    /// Outside of the tissue.
    #[default]
    Free,
    /// Pressing on the surface from outside.
    Touching(MaterialPoint, u32),
    /// Inside the tissue.
    Inside(MaterialPoint),
    /// Pressing on the surface from inside.
    Leaving(MaterialPoint, u32),
}

impl Tip {
    /// Its contact point with the tissue.
    #[must_use]
    pub fn place(&self) -> Option<&MaterialPoint> {
        match self {
            Self::Free => None,
            Self::Touching(place, _) | Self::Inside(place) | Self::Leaving(place, _) => Some(place),
        }
    }
}

/// A material point on the channel that the tip has cut. Needle and thread slide through it and cannot leave it
/// sideways.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelPoint {
    /// The point in the tissue.
    pub place: MaterialPoint,
    /// Arc length of what passes it now, from the swage \[m\]: positive along the needle, negative along the thread.
    pub along: f64,
    /// Arc length of the sticking point, as `along`.
    pub stuck: f64,
    /// Force of the tissue on needle or thread, in the world \[N\].
    pub force: Vector3<f64>,
    /// Number of its bite.
    pub bite: u32,
}

/// One pass into the tissue and, once completed, out again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Bite {
    /// Its number; bites are counted from 0.
    pub number: u32,
    /// Entry point of the tip, and its surface triangle.
    pub entry: (MaterialPoint, u32),
    /// Exit point.
    pub exit: Option<(MaterialPoint, u32)>,
    /// Puncture force at the entry \[N\].
    pub entry_force: f64,
    /// Puncture force at the exit \[N\].
    pub exit_force: f64,
}

/// A point of the needle's body in contact with the surface.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NeedleContact {
    /// The point, counted from the tail.
    pub sample: u32,
    /// Force of the tissue on the needle, in the world \[N\].
    pub force: Vector3<f64>,
    /// Tangential displacement from the sticking point, in the world \[m\].
    pub drawn: Vector3<f64>,
}

/// A strand of the thread in contact with the needle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StrandContact {
    /// Edge of the thread.
    pub edge: u32,
    /// Force of the needle on the strand, in the world \[N\].
    pub force: Vector3<f64>,
    /// Tangential displacement from the sticking point, in the world \[m\].
    pub drawn: Vector3<f64>,
}

/// State of needle, thread and channel.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub struct SutureState {
    /// The needle.
    pub needle: NeedleState,
    /// Its thread, the swaged end first.
    pub thread: Option<ThreadState>,
    /// Angle of the thread's first director from the needle's z-axis \[rad\].
    pub swage_turn: f64,
    /// State of the tip.
    pub tip: Tip,
    /// Force of the tissue on the tip, in the world \[N\].
    pub tip_force: Vector3<f64>,
    /// Channel points of all bites, in their order along thread and needle: from the end of the thread to the tip.
    pub channel: Vec<ChannelPoint>,
    /// Occupied bites, oldest first, and recent empty ones.
    pub bites: Vec<Bite>,
    /// Number of bites so far.
    pub bites_so_far: u32,
    /// Contacts of the needle's body with the surface.
    pub needle_contacts: Vec<NeedleContact>,
    /// Contacts of the thread with the needle.
    pub strand_contacts: Vec<StrandContact>,
    /// Contact forces of needle and thread on the surface, in the world.
    pub presses: Vec<SurfaceForce>,
}

clones_in_place!(SutureState {
    needle,
    thread,
    swage_turn,
    tip,
    tip_force,
    channel,
    bites,
    bites_so_far,
    needle_contacts,
    strand_contacts,
    presses,
});

impl SutureState {
    /// A needle at rest outside of the tissue, with its thread.
    #[must_use]
    pub fn new(needle: NeedleState, thread: Option<ThreadState>) -> Self {
        Self {
            needle,
            thread,
            swage_turn: 0.0,
            tip: Tip::Free,
            tip_force: Vector3::zeros(),
            channel: Vec::new(),
            bites: Vec::new(),
            bites_so_far: 0,
            needle_contacts: Vec::new(),
            strand_contacts: Vec::new(),
            presses: Vec::new(),
        }
    }

    /// Rejects a state that is impossible for this tissue; `radius` is that of the thread \[m\].
    pub(super) fn check(&self, tissue: &Tissue, radius: Option<f64>) -> Result<(), SutureError> {
        if !self.needle.is_finite() {
            return Err(SutureError::State("the needle's pose or momentum is not finite"));
        }
        match (&self.thread, radius) {
            (Some(thread), Some(radius)) => thread.check(radius)?,
            (None, None) => {}
            _ => {
                return Err(SutureError::State(
                    "a thread without a material, or a material without a thread",
                ));
            }
        }
        if self.channel.len() > CHANNEL_MAX || self.bites.len() > BITES_MAX {
            return Err(SutureError::State("more places in channels, or more bites, than can be followed"));
        }
        let finite = |x: &Vector3<f64>| x.iter().all(|x| x.is_finite());
        let triangles = tissue.mesh().surface().len();
        let surface =
            |(place, triangle): &(MaterialPoint, u32)| tissue.has(place) && (*triangle as usize) < triangles;
        let tip = match &self.tip {
            Tip::Free => true,
            Tip::Inside(place) => tissue.has(place),
            Tip::Touching(place, triangle) | Tip::Leaving(place, triangle) => surface(&(*place, *triangle)),
        };
        if !tip || !finite(&self.tip_force) || !self.swage_turn.is_finite() {
            return Err(SutureError::State("the tip is at no place of the tissue"));
        }
        let sound = |point: &ChannelPoint| {
            tissue.has(&point.place)
                && point.along.is_finite()
                && point.stuck.is_finite()
                && finite(&point.force)
                && self.bites.iter().any(|bite| bite.number == point.bite)
        };
        if !self.channel.iter().all(sound) {
            return Err(SutureError::State("a place of a channel is none of the tissue, or of no bite"));
        }
        if !self.channel.is_sorted_by(|a, b| a.along <= b.along + 1e-3) {
            return Err(SutureError::State("places of a channel are not in the order of what lies in them"));
        }
        if !self.bites.iter().all(|bite| surface(&bite.entry) && bite.exit.as_ref().is_none_or(surface)) {
            return Err(SutureError::State("a bite begins or ends at no place of the surface"));
        }
        let nodes = tissue.mesh().rest().len();
        let pressed = |press: &SurfaceForce| {
            press.at.nodes.iter().all(|node| (*node as usize) < nodes)
                && press.at.weights.iter().all(|weight| (-0.01..=1.01).contains(weight))
                && finite(&press.force)
        };
        let touching = |contact: &NeedleContact| {
            contact.sample < SAMPLES_MAX && finite(&contact.force) && finite(&contact.drawn)
        };
        if self.presses.len() > 4 * NODES_MAX || !self.presses.iter().all(pressed) {
            return Err(SutureError::State("something presses at no place of the surface"));
        }
        if self.needle_contacts.len() > SAMPLES_MAX as usize || !self.needle_contacts.iter().all(touching) {
            return Err(SutureError::State("the needle touches the surface with no place of it"));
        }
        let edges = self.thread.as_ref().map_or(0, |thread| thread.rest_lengths.len());
        let crossing = |contact: &StrandContact| {
            (contact.edge as usize) < edges && finite(&contact.force) && finite(&contact.drawn)
        };
        if self.strand_contacts.len() > STRANDS_MAX || !self.strand_contacts.iter().all(crossing) {
            return Err(SutureError::State("strands that touch the needle are none of the thread"));
        }
        Ok(())
    }

    /// Length of thread beyond the first entry point \[m\]; of a cut thread, of the piece that lies there.
    #[must_use]
    pub fn thread_through(&self) -> f64 {
        let Some((point, thread)) = self.channel.last().zip(self.thread.as_ref()) else { return 0.0 };
        let begin = thread.pieces().map(|[begin, _]| begin).take_while(|begin| *begin <= -point.along);
        begin.last().map_or(0.0, |begin| -point.along - begin)
    }

    /// Forces of needle and thread on the tissue.
    pub(super) fn forces_on_tissue(&self) -> impl Iterator<Item = (TissueFeature, Vector3<f64>)> {
        let tip = self.tip.place().map(|place| (TissueFeature::Inside(*place), -self.tip_force));
        let channel = self.channel.iter().map(|point| (TissueFeature::Inside(point.place), -point.force));
        let surface = self.presses.iter().map(|press| (TissueFeature::Surface(press.at), press.force));
        channel.chain(tip).chain(surface)
    }
}

/// Events of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// The tip has touched the surface at this point \[m\].
    Touched(Point3<f64>),
    /// The tip has punctured the surface from outside.
    Entered {
        /// Number of the bite.
        bite: u32,
        /// Puncture force \[N\].
        force: f64,
    },
    /// The tip has punctured the surface from inside.
    Left {
        /// Number of the bite.
        bite: u32,
        /// Puncture force \[N\].
        force: f64,
    },
    /// The tip has withdrawn through its entry.
    Withdrawn {
        /// Number of the bite.
        bite: u32,
    },
    /// The tip has gone back in through its exit.
    Back {
        /// Number of the bite.
        bite: u32,
    },
    /// The end of the thread, or of a needle without thread, has passed through.
    Through {
        /// Number of the bite.
        bite: u32,
    },
}
