//! Cutting a tetrahedral mesh along an arbitrary blade path. An edge that the blade crosses between two ticks is split
//! at the crossing; if that would make an element too small or too flat, the path snaps to the nearer end node instead.
//! Nodes on the path are marked with the path's local plane. Once all three nodes of a face are marked, and the path
//! passes between the face's two elements, the face opens.
//!
//! So a blade that stops within an element leaves it whole until the blade goes on. Faces open behind the blade: never
//! ahead of it, and no element bridges the slit behind it.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};

use super::topology::{NodeOrigin, TetFace, Volume, VolumeChange, VolumeError};
use super::{Sweep, mean_ratio, shape};
use trocar_scene::mesh::tet_faces::OPPOSITE;

/// Shortest edge, as a fraction of the mean edge length.
const EDGE_SHARE_MIN: f64 = 0.2;
/// Minimum mean ratio of new elements; where the element is flatter already, its own.
const MEAN_RATIO_MIN: f64 = 0.05;
/// Minimum cosine between planes of the same path.
const ALIGNED: f64 = 0.5;
/// Element count above which no edge is split any more.
const TETS_MAX: usize = 1 << 20;

/// A node on the path of a blade.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PathNode {
    /// The node.
    pub node: u32,
    /// Normal of the path at the node, in the rest shape.
    pub normal_in_rest: Vector3<f64>,
    /// Height of the node above the path at rest \[m\]: a node that the path snapped to is not exactly on it.
    pub height: f64,
}

/// State of unfinished cuts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OpenCut {
    /// By node, ascending.
    pub marks: Vec<PathNode>,
    /// Shortest edge that a split may create \[m\]; 0 before the first cut.
    pub edge_min: f64,
}

/// Current node positions \[m\], and their displacements since the beginning of the sweeps \[m\].
#[derive(Clone, Debug, Default)]
pub struct NodeMotion {
    /// Current positions.
    pub positions: Vec<Point3<f64>>,
    /// Displacements since then.
    pub moved: Vec<Vector3<f64>>,
}

impl NodeMotion {
    /// Interpolates position and displacement of new nodes from their parent nodes.
    pub fn follow(&mut self, born: &[NodeOrigin]) {
        for birth in born {
            self.positions.push(birth.mix(&self.positions, |a, b, share| a + (b - a) * share));
            self.moved.push(birth.mix(&self.moved, |a, b, share| a + (b - a) * share));
        }
    }
}

impl OpenCut {
    fn find(&self, node: u32) -> Option<&PathNode> {
        let at = self.marks.binary_search_by_key(&node, |mark| mark.node).ok()?;
        Some(&self.marks[at])
    }

    fn put(&mut self, mark: PathNode) {
        match self.marks.binary_search_by_key(&mark.node, |mark| mark.node) {
            Ok(at) => self.marks[at] = mark,
            Err(at) => self.marks.insert(at, mark),
        }
    }
}

/// Intersection of an edge with a blade's path.
struct Crossing {
    share: f64,
    /// Distances of the two ends from the blade's path \[m\].
    distances: [f64; 2],
    normal_in_rest: Vector3<f64>,
}

impl Volume {
    /// Cuts along the sweeps. Adds the changes to `change` and updates `nodes`.
    ///
    /// # Errors
    /// The mesh has reached its maximum size; nothing has changed then.
    pub fn cut(
        &mut self,
        nodes: &mut NodeMotion,
        sweeps: &[Sweep],
        slit: &mut OpenCut,
        change: &mut VolumeChange,
    ) -> Result<Vec<TetFace>, VolumeError> {
        if slit.edge_min <= 0.0 {
            slit.edge_min = EDGE_SHARE_MIN * self.mean_edge();
        }
        let mut marked = BTreeSet::new();
        for sweep in sweeps {
            if self.tets.len() > TETS_MAX {
                return Err(VolumeError::Full(self.tets.len()));
            }
            let crossings = self.crossings(nodes, sweep);
            let mut halves = Vec::new();
            for (edge, crossing) in &crossings {
                match self.snap(*edge, crossing, slit.edge_min) {
                    Some(end) => {
                        self.mark(edge[end], edge, crossing, slit);
                        marked.insert(edge[end]);
                    }
                    None => halves.push((*edge, crossing)),
                }
            }
            for (edge, crossing) in halves {
                let is_on_path = |node: &u32| {
                    slit.find(*node)
                        .is_some_and(|mark| mark.normal_in_rest.dot(&crossing.normal_in_rest).abs() > ALIGNED)
                };
                if edge.iter().any(is_on_path) {
                    continue;
                }
                // Other edges have been split meanwhile.
                let born = change.born.len();
                let quality = self.quality_of_halves(edge, crossing.share);
                let node = if quality < MEAN_RATIO_MIN.min(self.quality_about(edge)) {
                    edge[usize::from(crossing.distances[1] < crossing.distances[0])]
                } else {
                    self.halve(edge, crossing.share, change)
                };
                nodes.follow(&change.born[born..]);
                self.mark(node, &edge, crossing, slit);
                marked.insert(node);
            }
        }
        let faces = self.passed(&marked, slit);
        let born = change.born.len();
        let opened = self.open(&faces)?;
        change.uncovered.extend(opened.uncovered);
        change.renamed.extend(opened.renamed);
        change.born.extend(opened.born);
        nodes.follow(&change.born[born..]);
        // Where the mesh has come apart, the path has passed.
        for birth in &change.born[born..] {
            slit.marks.retain(|mark| mark.node != birth.of[0]);
        }
        Ok(faces)
    }

    fn mean_edge(&self) -> f64 {
        let edges = self.tets().flat_map(|(_, nodes)| edges_of(nodes));
        let (sum, count) = edges.fold((0.0, 0.0), |(sum, count), [a, b]| {
            (sum + (self.rest[a as usize] - self.rest[b as usize]).norm(), count + 1.0)
        });
        if count > 0.0 { sum / count } else { 0.0 }
    }

    /// Edges that the blades have crossed, each in the order of its ends.
    fn crossings(&self, nodes: &NodeMotion, sweep: &Sweep) -> BTreeMap<[u32; 2], Crossing> {
        let reach = nodes.moved.iter().map(Vector3::norm).fold(0.0, f64::max);
        let ends = || sweep.before.iter().chain(&sweep.after);
        let corner = |pick: fn(f64, f64) -> f64, start: f64, out: f64| {
            let by = |axis: usize| ends().map(|end| end[axis]).fold(start, pick) + out;
            [by(0), by(1), by(2)]
        };
        let (min, max) =
            (corner(f64::min, f64::INFINITY, -reach), corner(f64::max, f64::NEG_INFINITY, reach));
        let mut found = BTreeMap::new();
        for (tet, corners) in self.tets() {
            let places = corners.map(|node| nodes.positions[node as usize]);
            let is_away = |axis: usize| {
                places.iter().all(|p| p[axis] < min[axis]) || places.iter().all(|p| p[axis] > max[axis])
            };
            if (0..3).any(is_away) {
                continue;
            }
            for edge in edges_of(corners) {
                if found.contains_key(&edge) {
                    continue;
                }
                if let Some(crossing) = self.crossing(edge, tet, nodes, sweep) {
                    found.insert(edge, crossing);
                }
            }
        }
        found
    }

    fn crossing(&self, edge: [u32; 2], tet: u32, nodes: &NodeMotion, sweep: &Sweep) -> Option<Crossing> {
        let [from, to] = edge.map(|node| nodes.positions[node as usize]);
        // The blade's path relative to the tissue: the tissue's own motion is subtracted.
        let moved = edge.map(|node| nodes.moved[node as usize]);
        let moved = (moved[0] + moved[1]) / 2.0;
        let (before, after) = (sweep.before.map(|end| end + moved), sweep.after);
        let (share, normal, distances) = [[before[0], before[1], after[1]], [before[0], after[1], after[0]]]
            .iter()
            .find_map(|triangle| through(&from, &to, triangle))?;
        let corners = self.tet(tet)?;
        let gradient = shape(&nodes.positions, &corners) * shape(&self.rest, &corners).try_inverse()?;
        let gradient: Matrix3<f64> = gradient;
        let normal_in_rest = gradient.tr_mul(&normal).try_normalize(0.0)?;
        Some(Crossing { share, distances, normal_in_rest })
    }

    /// The end node that a crossing snaps to, if the edge is not to be split.
    fn snap(&self, [a, b]: [u32; 2], crossing: &Crossing, edge_min: f64) -> Option<usize> {
        let length = (self.rest[b as usize] - self.rest[a as usize]).norm();
        let [from, to] = [crossing.share * length, (1.0 - crossing.share) * length];
        let is_near = |along: f64, off: f64| along < edge_min || off < 0.5 * edge_min;
        let nearer = usize::from(crossing.distances[1] < crossing.distances[0]);
        (is_near(from, crossing.distances[0]) || is_near(to, crossing.distances[1])).then_some(nearer)
    }

    fn quality_about(&self, [a, b]: [u32; 2]) -> f64 {
        let about = self.around[a as usize].iter().filter_map(|&tet| self.tet(tet));
        let of = about.filter(|nodes| nodes.contains(&b)).map(|nodes| mean_ratio(&self.rest, &nodes));
        of.fold(f64::INFINITY, f64::min)
    }

    fn mark(&self, node: u32, edge: &[u32; 2], crossing: &Crossing, slit: &mut OpenCut) {
        let [a, b] = edge.map(|end| self.rest[end as usize]);
        let place = a + (b - a) * crossing.share;
        let normal_in_rest = crossing.normal_in_rest;
        let height = normal_in_rest.dot(&(self.rest[node as usize] - place));
        // Of several planes the node keeps the nearest one.
        let known = slit.find(node).filter(|mark| mark.height.abs() <= height.abs());
        if !known.is_some_and(|mark| mark.normal_in_rest.dot(&normal_in_rest).abs() > ALIGNED) {
            slit.put(PathNode { node, normal_in_rest, height });
        }
    }

    /// Faces with three marked nodes, at least one of them new, whose two elements the path separates.
    fn passed(&self, marked: &BTreeSet<u32>, slit: &OpenCut) -> Vec<TetFace> {
        let about: BTreeSet<u32> =
            marked.iter().flat_map(|&node| self.around[node as usize].iter().copied()).collect();
        let mut faces = BTreeSet::new();
        for tet in about {
            let Some(nodes) = self.tet(tet) else { continue };
            for (corner, next) in self.neighbours[tet as usize].iter().enumerate() {
                let Some((next, beyond)) = next.and_then(|next| Some((next, self.tet(next)?))) else {
                    continue;
                };
                let marks = OPPOSITE[corner].map(|at| slit.find(nodes[at]));
                let [Some(one), Some(two), Some(three)] = marks else { continue };
                if self.passes_between([one, two, three], &nodes, &beyond) {
                    let back = self.neighbours[next as usize].iter().position(|side| *side == Some(tet));
                    // One of its two sides suffices.
                    let other = (next, back.unwrap_or_default() as u8);
                    faces.insert((tet, corner as u8).min(other));
                }
            }
        }
        faces.into_iter().collect()
    }

    /// Whether the path, by the marks of a face's nodes, separates the two elements at the face.
    fn passes_between(&self, marks: [&PathNode; 3], tet: &[u32; 4], beyond: &[u32; 4]) -> bool {
        let planes = marks.map(|mark| {
            let sign = if mark.normal_in_rest.dot(&marks[0].normal_in_rest) < 0.0 { -1.0 } else { 1.0 };
            (self.rest[mark.node as usize], mark.normal_in_rest * sign, mark.height * sign)
        });
        let [a, b, c] = planes.map(|plane| plane.0);
        let Some(face) = (b - a).cross(&(c - a)).try_normalize(0.0) else { return false };
        let mean: Vector3<f64> = planes.iter().map(|plane| plane.1).sum();
        if face.dot(&mean).abs() < ALIGNED * mean.norm() {
            return false;
        }
        let side = |nodes: &[u32; 4]| {
            let sum: Vector3<f64> = nodes.iter().map(|&node| self.rest[node as usize].coords).sum();
            let middle = Point3::from(sum / 4.0);
            let above = |(place, normal, height): &(Point3<f64>, Vector3<f64>, f64)| {
                normal.dot(&(middle - place)) + height
            };
            planes.iter().map(above).sum::<f64>() > 0.0
        };
        side(tet) != side(beyond)
    }
}

fn edges_of([a, b, c, d]: [u32; 4]) -> [[u32; 2]; 6] {
    [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]].map(|[x, y]| if x < y { [x, y] } else { [y, x] })
}

/// Intersection of a segment with a triangle: the position along the segment as a fraction, the triangle's normal, and
/// the distances of both ends from its plane \[m\].
fn through(
    from: &Point3<f64>,
    to: &Point3<f64>,
    [a, b, c]: &[Point3<f64>; 3],
) -> Option<(f64, Vector3<f64>, [f64; 2])> {
    let way = to - from;
    let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
    let heights = [normal.dot(&(from - a)), normal.dot(&(to - a))];
    // Half open: a point on the surface belongs to one side of it.
    if (heights[0] < 0.0) == (heights[1] < 0.0) {
        return None;
    }
    let side = |p: &Point3<f64>, q: &Point3<f64>| way.dot(&(p - from).cross(&(q - from)));
    let sides = [side(a, b), side(b, c), side(c, a)];
    if !(sides.iter().all(|s| *s >= 0.0) || sides.iter().all(|s| *s <= 0.0)) {
        return None;
    }
    let share = heights[0] / (heights[0] - heights[1]);
    Some((share.clamp(0.0, 1.0), normal, heights.map(f64::abs)))
}
