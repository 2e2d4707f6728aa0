//! Nodes on the path of a blade: each holds the path's local plane. Nodes of the same path are told from those of another,
//! which may cross it or run beside it, by how their planes lie to each other.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use serde::ser::SerializeSeq;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::Sweep;

/// Minimum cosine between planes of the same path: of the same stroke, and of different ones. A blade that turns more
/// sharply begins another path.
const ALIGNED: [f64; 2] = [0.25, 0.985];
/// By how much the planes of two nodes of the same path may miss each other, relative to the distance of the nodes: of the
/// same stroke, and of different ones.
const BEND: [f64; 2] = [0.4, 0.1];
/// Maximum number of paths through one node. A further one replaces the oldest.
const PATHS_MAX: usize = 4;
/// Number of strokes that may go on. A further one replaces the oldest.
const STROKES_MAX: usize = 16;
/// Distance within which a blade is where a stroke has ended, as a fraction of that within which nodes are on a path.
const STILL: f64 = 0.05;

/// A node on the path of a blade.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathNode {
    /// The node.
    pub node: u32,
    /// Normal of the path at the node, in the rest shape.
    pub normal_in_rest: Vector3<f64>,
    /// Height of the node above the path at rest \[m\]: a node that the path snapped to is not exactly on it.
    pub height: f64,
    /// The stroke that made the path.
    #[serde(default)]
    pub stroke: u32,
    /// Whether the blade has not come to the node yet: no face opens at it before.
    #[serde(default)]
    pub ahead: bool,
}

/// An uninterrupted motion of a blade.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stroke {
    /// Its number.
    pub number: u32,
    /// Both ends of the blade's edge where it is now \[m\].
    pub blade: [Point3<f64>; 2],
}

impl PathNode {
    /// Height of a point above the path's plane at this node; all in the rest shape \[m\].
    pub(super) fn above(&self, rest: &[Point3<f64>], point: &Point3<f64>) -> f64 {
        self.normal_in_rest.dot(&(point - rest[self.node as usize])) + self.height
    }

    /// The place of the path below the node.
    pub(super) fn foot(&self, place: &Point3<f64>) -> Point3<f64> {
        place - self.normal_in_rest * self.height
    }

    /// The same plane, facing as another one does.
    fn facing(self, normal: &Vector3<f64>) -> Self {
        if self.normal_in_rest.dot(normal) < 0.0 {
            Self { normal_in_rest: -self.normal_in_rest, height: -self.height, ..self }
        } else {
            self
        }
    }
}

/// The nodes on paths, by node, ascending; of one node the oldest first. In files they are one list in this order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PathNodes(BTreeMap<u32, Vec<PathNode>>);

impl PathNodes {
    /// How many there are; a node through which several paths lead counts for each.
    #[must_use]
    pub fn len(&self) -> usize {
        self.0.values().map(Vec::len).sum()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }
}

impl Serialize for PathNodes {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let mut list = serializer.serialize_seq(Some(self.len()))?;
        self.0.values().flatten().try_for_each(|mark| list.serialize_element(mark))?;
        list.end()
    }
}

impl<'de> Deserialize<'de> for PathNodes {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let mut marks = Self::default();
        for mark in Vec::<PathNode>::deserialize(deserializer)? {
            marks.0.entry(mark.node).or_default().push(mark);
        }
        Ok(marks)
    }
}

/// State of unfinished cuts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpenCut {
    /// The nodes on paths.
    pub marks: PathNodes,
    /// Shortest edge that a split may create \[m\]; 0 before the first cut.
    pub edge_min: f64,
    /// The last strokes, the oldest first.
    pub strokes: Vec<Stroke>,
    /// How many strokes have begun.
    pub strokes_begun: u32,
}

impl OpenCut {
    /// The nodes nearer to the path than this are on it \[m\].
    pub(super) fn near(&self) -> f64 {
        0.5 * self.edge_min
    }

    /// Paths through a node.
    pub(super) fn through(&self, node: u32) -> &[PathNode] {
        self.marks.0.get(&node).map_or(&[], Vec::as_slice)
    }

    /// The blade has come to a node: returns the path there, facing as given, if the node was ahead.
    pub(super) fn come_to(&mut self, node: u32, facing: &Vector3<f64>) -> Option<PathNode> {
        let here = self.marks.0.get_mut(&node)?.iter_mut();
        let ahead = here.filter(|mark| mark.ahead).map(|mark| {
            mark.ahead = false;
            mark.facing(facing)
        });
        ahead.last()
    }

    /// The stroke that a sweep goes on with, or else a new one.
    pub(super) fn stroke(&mut self, sweep: &Sweep) -> u32 {
        let near = self.near();
        let goes_on = |stroke: &Stroke| {
            stroke.blade.iter().zip(&sweep.before).all(|(was, is)| (was - is).norm() <= STILL * near)
        };
        let number = match self.strokes.iter().position(goes_on) {
            Some(at) => self.strokes.remove(at).number,
            None => {
                self.strokes_begun = self.strokes_begun.wrapping_add(1);
                self.strokes_begun
            }
        };
        if self.strokes.len() == STROKES_MAX {
            self.strokes.remove(0);
        }
        self.strokes.push(Stroke { number, blade: sweep.after });
        number
    }

    /// Ends the stroke that went on last: its blade is out of the tissue.
    pub(super) fn end_stroke(&mut self) {
        self.strokes.pop();
    }

    /// The path through a node that is the same as at another place, which need not be a node; it faces as that does.
    pub(super) fn same_path(
        &self,
        rest: &[Point3<f64>],
        node: u32,
        other: &PathNode,
        place: &Point3<f64>,
    ) -> Option<PathNode> {
        let at = rest[node as usize];
        let cosine = |mark: &PathNode| mark.normal_in_rest.dot(&other.normal_in_rest);
        let is_same = |mark: &PathNode| {
            let same_stroke = mark.stroke == other.stroke;
            // Height of each above the plane of the other.
            let over = mark.normal_in_rest.dot(&(other.foot(place) - mark.foot(&at)));
            let under = other.normal_in_rest.dot(&(mark.foot(&at) - other.foot(place)));
            // Where a path bends both are above, or both below. Beside another path one is above, one below.
            let miss = match (same_stroke, (over < 0.0) == (under < 0.0)) {
                (true, true) => 0.0,
                (true, false) => over.abs().min(under.abs()),
                (false, _) => (over - under).abs() / 2.0,
            };
            let most = self.near() + BEND[usize::from(!same_stroke)] * (place - at).norm();
            cosine(mark) > ALIGNED[usize::from(!same_stroke)] && miss <= most
        };
        let same = self.through(node).iter().map(|mark| mark.facing(&other.normal_in_rest));
        same.filter(is_same).max_by(|a, b| cosine(a).total_cmp(&cosine(b)))
    }

    /// Adds a path through a node. Of several planes of the same path the node keeps the nearest one, facing as the
    /// last.
    pub(super) fn put(&mut self, rest: &[Point3<f64>], mark: PathNode) -> PathNode {
        let known = self.same_path(rest, mark.node, &mark, &rest[mark.node as usize]);
        let here = self.marks.0.entry(mark.node).or_default();
        if let Some(known) = known {
            let nearer = if known.height.abs() <= mark.height.abs() { known } else { mark };
            let kept = PathNode { ahead: known.ahead && mark.ahead, stroke: mark.stroke, ..nearer };
            let same = |other: &PathNode| other.facing(&known.normal_in_rest) == known;
            if let Some(at) = here.iter().position(same) {
                here[at] = kept;
            }
            return kept;
        }
        if here.len() == PATHS_MAX {
            here.remove(0);
        }
        here.push(mark);
        mark
    }

    /// Takes over the paths through a node for its duplicate.
    pub(super) fn copy(&mut self, of: u32, node: u32) {
        let copies: Vec<PathNode> = self.through(of).iter().map(|mark| PathNode { node, ..*mark }).collect();
        if !copies.is_empty() {
            self.marks.0.insert(node, copies);
        }
    }
}
