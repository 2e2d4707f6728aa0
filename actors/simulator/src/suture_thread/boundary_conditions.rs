//! Boundary conditions of a thread: nodes with prescribed motion, edges with held rotation, forces on nodes.

use nalgebra::{Point3, Vector3};

/// Default stiffness of a hold: 1 µm per newton \[N/m\].
pub const HOLD_STIFFNESS: f64 = 1e6;

/// A node with a prescribed position, as in a jaw. Two neighbouring ones also clamp the direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hold {
    /// The node.
    pub node: usize,
    /// Target at the end of the step, in the world \[m\]; approached in a straight line.
    pub to: Point3<f64>,
    /// Stiffness of the grip \[N/m\].
    pub stiffness: f64,
    /// Force limit at which the node slips through the grip \[N\]; infinite for a clamp.
    pub force_max: f64,
}

impl Hold {
    /// A clamp.
    #[must_use]
    pub fn fixed(node: usize, to: Point3<f64>) -> Self {
        Self { node, to, stiffness: HOLD_STIFFNESS, force_max: f64::INFINITY }
    }
}

/// Edges that ignore an obstacle, because jaws hold them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IgnoredObstacle {
    /// The obstacle's index.
    pub obstacle: usize,
    /// First and last edge.
    pub edges: [usize; 2],
}

/// An edge with a prescribed director, so that it cannot rotate about its own axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TwistHold {
    /// The edge.
    pub edge: usize,
    /// Direction of the director at the end of the step; its component along the edge is ignored. At most half a turn
    /// from the previous direction.
    pub director: Vector3<f64>,
}

/// A force on a node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// The node.
    pub node: usize,
    /// The force, in the world \[N\].
    pub force: Vector3<f64>,
}
