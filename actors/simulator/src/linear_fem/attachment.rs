//! Attachments: the weighted means of nodes that constraints hold.

use nalgebra::{Unit, Vector3};
use thiserror::Error;

/// Handle of a constraint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Handle(pub u64);

/// Maximum number of nodes in one attachment.
pub const WEIGHTS_MAX: usize = 512;

/// Constrained part of an attachment's mean displacement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Hold {
    /// All of it, as for a grasp or a needle.
    Point,
    /// Its component along a direction; it slides perpendicular to it.
    Along(Unit<Vector3<f64>>),
    /// Unilateral: its component along a direction is kept from falling below the target, as by a tool that may lift
    /// off; the force acts along the direction only, never against it.
    AtLeast(Unit<Vector3<f64>>),
    /// The same, by a body that gives way: all targets that it sets move with its six unknowns.
    AtLeastOnBody {
        /// The direction.
        along: Unit<Vector3<f64>>,
        /// How far the contact alone yields per force \[m/N\], 0 or more.
        compliance: f64,
        /// The body, and how it moves the target: two constraints of one body are coupled by the product of these
        /// vectors \[√(m/N)\].
        body: u32,
        /// See above.
        motion: [f64; 6],
    },
}

impl Hold {
    /// The constrained directions and their number.
    pub(super) fn directions(&self) -> ([Vector3<f64>; 3], usize) {
        match self {
            Self::Point => ([Vector3::x(), Vector3::y(), Vector3::z()], 3),
            Self::Along(along) | Self::AtLeast(along) | Self::AtLeastOnBody { along, .. } => {
                ([along.into_inner(); 3], 1)
            }
        }
    }

    /// Whether it can lift off.
    pub(crate) fn is_one_sided(&self) -> bool {
        matches!(self, Self::AtLeast(_) | Self::AtLeastOnBody { .. })
    }

    /// How far the target moves back per force on another constraint, or on itself \[m/N\].
    pub(super) fn coupling(&self, other: &Self, is_itself: bool) -> f64 {
        match (self, other) {
            (
                Self::AtLeastOnBody { compliance, body, motion, .. },
                Self::AtLeastOnBody { body: with, motion: moves, .. },
            ) if body == with => {
                let together: f64 = motion.iter().zip(moves).map(|(a, b)| a * b).sum();
                together + if is_itself { *compliance } else { 0.0 }
            }
            _ => 0.0,
        }
    }

    /// Whether its numbers are valid.
    pub(super) fn is_finite(&self) -> bool {
        let Self::AtLeastOnBody { compliance, motion, .. } = self else { return true };
        *compliance >= 0.0 && compliance.is_finite() && motion.iter().all(|x| x.is_finite())
    }
}

/// Nodes with weights whose mean displacement is constrained: one node, a point in an element by its barycentric
/// weights, or a surface patch.
#[derive(Clone, Debug, PartialEq)]
pub struct Attachment {
    /// Nodes and their weights, which add up to 1.
    pub weights: Vec<(u32, f64)>,
    /// Constrained part of their mean.
    pub hold: Hold,
}

/// Why an attachment was rejected.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum AttachmentError {
    /// Too few or too many nodes.
    #[error("an attachment to {0} nodes: 1 to {WEIGHTS_MAX} are valid")]
    Count(usize),
    /// A node that does not exist.
    #[error("an attachment to node {node}, but there are {nodes}: 0 to {nodes} - 1 are valid")]
    NoNode {
        /// The node.
        node: u32,
        /// Number of nodes.
        nodes: usize,
    },
    /// Weights that do not add up to 1.
    #[error("the weights of an attachment add up to {0}, not to 1")]
    Sum(f64),
}

impl Attachment {
    /// A single node.
    #[must_use]
    pub fn node(node: u32, hold: Hold) -> Self {
        Self { weights: vec![(node, 1.0)], hold }
    }

    /// A point in an element, by its corners and barycentric weights.
    #[must_use]
    pub fn barycentric(corners: [u32; 4], weights: [f64; 4], hold: Hold) -> Self {
        Self {
            weights: corners.into_iter().zip(weights).filter(|(_, weight)| *weight != 0.0).collect(),
            hold,
        }
    }

    pub(super) fn check(&self, nodes: usize) -> Result<(), AttachmentError> {
        check_weights(&self.weights, nodes)
    }
}

/// Whether weights define a mean of existing nodes.
pub(super) fn check_weights(weights: &[(u32, f64)], nodes: usize) -> Result<(), AttachmentError> {
    if weights.is_empty() || weights.len() > WEIGHTS_MAX {
        return Err(AttachmentError::Count(weights.len()));
    }
    if let Some(&(node, _)) = weights.iter().find(|(node, _)| *node as usize >= nodes) {
        return Err(AttachmentError::NoNode { node, nodes });
    }
    let sum: f64 = weights.iter().map(|(_, weight)| weight).sum();
    // The negation holds for NaN too.
    if !((sum - 1.0).abs() <= 1e-9) {
        return Err(AttachmentError::Sum(sum));
    }
    Ok(())
}
