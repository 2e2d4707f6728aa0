//! Order of the throws of a knot, read from the open thread.
//!
//! A closed curve does not determine the order of the throws that it is the sum of. The open thread does: when its ends
//! are shortened on both sides, the throws come undone one after the other, the last tied first. Each look costs one
//! classification of the knot, so that a moving thread is read one look at a time.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::classification::{Throw, factors, identify};
use super::{Knot, KnotError, KnotKind};

/// Progress of reading a thread's throws.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ThrowReader {
    /// Throws still tied, most wraps first.
    left: Vec<Throw>,
    /// Throws that have come undone, the last tied first.
    undone: Vec<Throw>,
    /// Nodes that the last look removed from either end.
    cut: u32,
}

impl ThrowReader {
    /// Starts from a classified knot, before the first look.
    #[must_use]
    pub fn new(kind: &KnotKind) -> Self {
        Self { left: factors(kind), undone: Vec::new(), cut: 0 }
    }

    /// Whether the remaining throws have only one possible order.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.left.windows(2).all(|pair| pair[0] == pair[1])
    }

    /// The throws in order of tying, with the unread ones as the innermost: complete once [done](Self::is_done). Empty
    /// for a knot that is not a sequence of throws.
    #[must_use]
    pub fn throws(&self) -> Vec<Throw> {
        self.left.iter().chain(self.undone.iter().rev()).copied().collect()
    }

    /// One more look at the thread, its ends shortened by one node each. `false` when nothing is left to look at.
    pub fn look(&mut self, points: &[Point3<f64>]) -> bool {
        self.cut += 1;
        let cut = self.cut as usize;
        if 2 * cut + 4 >= points.len() {
            return false;
        }
        // A cut through the middle of a throw gives an unknown knot, or a wrong number of throws.
        if let Ok(Knot { kind, .. }) = identify(&points[cut..points.len() - cut]) {
            let left = factors(&kind);
            if left.len() + 1 == self.left.len()
                && let Some(undone) = difference(&self.left, &left)
            {
                self.undone.push(undone);
                self.left = left;
            }
        }
        true
    }
}

/// The throws of a thread tied around something, in order of tying. Empty for a knot that is not a sequence of throws.
///
/// # Errors
/// Why the crossings of the whole thread cannot be read.
pub fn throws(points: &[Point3<f64>]) -> Result<Vec<Throw>, KnotError> {
    let mut reading = ThrowReader::new(&identify(points)?.kind);
    while !reading.is_done() && reading.look(points) {}
    Ok(reading.throws())
}

/// The one throw of `all` that is missing in `left`, if they differ by exactly one.
fn difference(all: &[Throw], left: &[Throw]) -> Option<Throw> {
    let mut rest = all.to_vec();
    for throw in left {
        rest.remove(rest.iter().position(|other| other == throw)?);
    }
    rest.pop().filter(|_| rest.is_empty())
}
