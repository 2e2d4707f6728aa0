//! In which order throws were tied, read from the thread.
//!
//! A closed curve does not tell the order of the throws that it is the sum of. The thread, open, does: its ends are shortened
//! on both sides, and one throw after the other comes undone, the last one that was tied first. Every look costs as much as
//! telling which knot it is, so that a thread that moves on meanwhile is read a look at a time.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};

use super::classification::{Throw, factors, identify};
use super::{Knot, KnotError, KnotKind};

/// How far a thread's throws have been read.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Reading {
    /// Throws that have not come undone, most wraps first.
    left: Vec<Throw>,
    /// Those that have, the last one that was tied first.
    undone: Vec<Throw>,
    /// Nodes that the last look took off either end.
    cut: u32,
}

impl Reading {
    /// Of a knot, before the first look.
    #[must_use]
    pub fn new(kind: &KnotKind) -> Self {
        Self { left: factors(kind), undone: Vec::new(), cut: 0 }
    }

    /// Whether what is left can only be in one order.
    #[must_use]
    pub fn is_done(&self) -> bool {
        self.left.windows(2).all(|pair| pair[0] == pair[1])
    }

    /// The throws, the first one first, with those that have not come undone as the innermost: in order once it is
    /// [done](Self::is_done). Empty for what is not a sequence of throws.
    #[must_use]
    pub fn throws(&self) -> Vec<Throw> {
        self.left.iter().chain(self.undone.iter().rev()).copied().collect()
    }

    /// Looks at the thread once more, its ends shorter by one node each. `false` when nothing is left of it to look at.
    pub fn look(&mut self, points: &[Point3<f64>]) -> bool {
        self.cut += 1;
        let cut = self.cut as usize;
        if 2 * cut + 4 >= points.len() {
            return false;
        }
        // What is cut through in the middle of a throw has no name, or the wrong number of them.
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

/// The throws of a thread tied around something, the first one first. Empty for what is not a sequence of throws.
///
/// # Errors
/// What keeps the crossings of the whole thread from being read.
pub fn throws(points: &[Point3<f64>]) -> Result<Vec<Throw>, KnotError> {
    let mut reading = Reading::new(&identify(points)?.kind);
    while !reading.is_done() && reading.look(points) {}
    Ok(reading.throws())
}

/// The throw that is in `all` and not in `left`, when that is all there is between them.
fn difference(all: &[Throw], left: &[Throw]) -> Option<Throw> {
    let mut rest = all.to_vec();
    for throw in left {
        rest.remove(rest.iter().position(|other| other == throw)?);
    }
    rest.pop().filter(|_| rest.is_empty())
}
