//! What holds and pulls a thread: nodes held in place, edges kept from turning, forces on nodes.

use nalgebra::{Point3, Vector3};

/// What a hold gives way at most under a newton: 1 µm \[N/m\].
pub const HOLD_STIFFNESS: f64 = 1e6;

/// A node that is led to a place, as by a jaw. Two neighbouring ones clamp the direction as well.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// Which.
    pub node: usize,
    /// Where it is at the end of the step, in the world \[m\]; led there in a straight line.
    pub to: Point3<f64>,
    /// Of the grip \[N/m\].
    pub stiffness: f64,
    /// Beyond this the node slips through the grip \[N\]; infinite for a clamp.
    pub force_max: f64,
}

impl Hold {
    /// A clamp.
    #[must_use]
    pub fn fixed(node: usize, to: Point3<f64>) -> Self {
        Self { node, to, stiffness: HOLD_STIFFNESS, force_max: f64::INFINITY }
    }
}

/// Edges that an obstacle does not stop: what jaws hold lies between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spared {
    /// The obstacle's place in the list.
    pub obstacle: usize,
    /// First and last edge.
    pub edges: [usize; 2],
}

/// An edge whose director is led to a direction, so that it cannot turn about itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistHold {
    /// Which.
    pub edge: usize,
    /// Where the director points at the end of the step; what lies along the edge does not count. No further than
    /// half a turn from where it was.
    pub director: Vector3<f64>,
}

/// A force on a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Which.
    pub node: usize,
    /// In the world \[N\].
    pub force: Vector3<f64>,
}
