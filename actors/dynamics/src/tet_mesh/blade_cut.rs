//! Cutting a tetrahedral mesh along an arbitrary blade path. Nodes close to the path are on it. An edge that the blade
//! crosses between two ticks is split at the crossing; if that would make an element too small or too flat, the path
//! snaps to the nearer end node instead. Nodes on the path hold its local plane, also after the cut: so a blade that
//! passes again along the same path finds nothing left to cut.
//!
//! A blade that stops within an element leaves it whole until the blade goes on. Faces open behind the blade: never
//! ahead of it, and no element bridges the slit behind it ([`super::cut_sides`]).

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};

use super::blade_crossing::{Crossing, edges_of};
use super::cut_path::{OpenCut, PathNode};
use super::topology::{NodeOrigin, TetFace, Volume, VolumeChange, VolumeError};
use super::{Sweep, mean_ratio};

/// Shortest edge, as a fraction of the mean edge length.
const EDGE_SHARE_MIN: f64 = 0.2;
/// Minimum mean ratio of new elements; where the element is flatter already, its own.
const MEAN_RATIO_MIN: f64 = 0.05;
/// Element count above which no edge is split any more.
const TETS_MAX: usize = 1 << 20;

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

/// Nodes that a path has reached, with its planes there.
type Reached = BTreeMap<u32, PathNode>;

impl Volume {
    /// Cuts along the sweeps. Adds the changes to `change` and updates `nodes`. Returns the opened faces.
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
        if self.tets.len() > TETS_MAX {
            return Err(VolumeError::Full(self.tets.len()));
        }
        let mut all: Vec<Reached> = Vec::new();
        for sweep in sweeps {
            all.push(self.embed(sweep, nodes, slit, change));
        }
        let mut faces = Vec::new();
        for at in 0..all.len() {
            let passed = self.passed(&all[at], slit);
            let known = self.rest.len() as u32;
            let opened = self.open(&passed)?;
            for (node, birth) in (known..).zip(&opened.born) {
                slit.copy(birth.of[0], node);
                for reached in &mut all {
                    if let Some(plane) = reached.get(&birth.of[0]).copied() {
                        reached.insert(node, PathNode { node, ..plane });
                    }
                }
            }
            nodes.follow(&opened.born);
            change.uncovered.extend(opened.uncovered);
            change.renamed.extend(opened.renamed);
            change.born.extend(opened.born);
            faces.extend(passed);
        }
        Ok(faces)
    }

    /// Makes the path of a sweep run along faces: puts nodes onto it wherever it crosses an edge.
    fn embed(
        &mut self,
        sweep: &Sweep,
        nodes: &mut NodeMotion,
        slit: &mut OpenCut,
        change: &mut VolumeChange,
    ) -> Reached {
        let stroke = slit.stroke(sweep);
        let crossings = self.crossings(nodes, sweep, slit.near());
        if !crossings.is_inside {
            slit.end_stroke();
        }
        let mut reached = Reached::new();
        for (node, mark) in crossings.nodes {
            let mark = PathNode { stroke, ..mark };
            if let Some(known) = slit.come_to(node, &mark.normal_in_rest) {
                reached.insert(node, known);
            }
            if !mark.ahead {
                reached.insert(node, slit.put(&self.rest, mark));
            }
        }
        let mut whole = Vec::new();
        for (edge, crossing) in crossings.edges {
            if self.is_on_path(edge, &crossing, stroke, slit) {
                if let Some(end) = self.snap(edge, &crossing, slit.edge_min)
                    && slit.come_to(edge[end], &crossing.normal_in_rest).is_some()
                {
                    reached.insert(edge[end], self.mark(edge[end], edge, &crossing, stroke, slit));
                }
                continue;
            }
            match self.snap(edge, &crossing, slit.edge_min) {
                Some(end) => {
                    reached.insert(edge[end], self.mark(edge[end], edge, &crossing, stroke, slit));
                }
                None => whole.push((edge, crossing)),
            }
        }
        for (edge, crossing) in whole {
            // Other edges have been split meanwhile.
            if self.is_on_path(edge, &crossing, stroke, slit) {
                continue;
            }
            if let Some(end) = self.snaps_later(edge, &crossing, stroke, slit) {
                let mark = self.plane(edge[end], edge, &crossing, stroke);
                slit.put(&self.rest, PathNode { ahead: true, ..mark });
                continue;
            }
            let born = change.born.len();
            let quality = self.quality_of_halves(edge, crossing.share);
            let node = if quality < MEAN_RATIO_MIN.min(self.quality_about(edge)) {
                edge[usize::from(crossing.share > 0.5)]
            } else {
                self.halve(edge, crossing.share, change)
            };
            nodes.follow(&change.born[born..]);
            reached.insert(node, self.mark(node, edge, &crossing, stroke, slit));
        }
        reached
    }

    /// Whether an end of an edge is on the path already.
    fn is_on_path(&self, edge: [u32; 2], crossing: &Crossing, stroke: u32, slit: &OpenCut) -> bool {
        let place = self.place(edge, crossing);
        let plane = PathNode { height: 0.0, ..self.plane(edge[0], edge, crossing, stroke) };
        edge.iter().any(|&node| slit.same_path(&self.rest, node, &plane, &place).is_some())
    }

    fn place(&self, [a, b]: [u32; 2], crossing: &Crossing) -> Point3<f64> {
        self.rest[a as usize] + (self.rest[b as usize] - self.rest[a as usize]) * crossing.share
    }

    /// The end node of an edge to which the path will snap when the blade goes on and crosses another edge of the node,
    /// if there is one. Then the edge need not be split: so a cut is as smooth in many ticks as in one.
    fn snaps_later(&self, edge: [u32; 2], crossing: &Crossing, stroke: u32, slit: &OpenCut) -> Option<usize> {
        let place = self.place(edge, crossing);
        let plane = PathNode { ahead: true, ..self.plane(edge[0], edge, crossing, stroke) };
        let height = |node: u32| crossing.normal_in_rest.dot(&(self.rest[node as usize] - place));
        let is_on = |node: u32| {
            let on_path = PathNode { height: 0.0, ..plane };
            slit.same_path(&self.rest, node, &on_path, &place).is_some()
        };
        let snaps = |node: u32| {
            let own = height(node);
            let near = |other: u32| {
                let across = own - height(other);
                let share = own / across;
                let length = (self.rest[other as usize] - self.rest[node as usize]).norm();
                share > 0.0 && share <= 0.5 && share * length < slit.edge_min && !is_on(other)
            };
            let about = self.around[node as usize].iter().filter_map(|&tet| self.tet(tet));
            about.flatten().any(|other| other != node && near(other))
        };
        let nearer = usize::from(crossing.share > 0.5);
        [nearer, 1 - nearer].into_iter().find(|&end| crossing.ahead[end] && snaps(edge[end]))
    }

    /// The path's plane at a node of an edge that it crosses.
    fn plane(&self, node: u32, edge: [u32; 2], crossing: &Crossing, stroke: u32) -> PathNode {
        let normal_in_rest = crossing.normal_in_rest;
        let height = normal_in_rest.dot(&(self.rest[node as usize] - self.place(edge, crossing)));
        PathNode { node, normal_in_rest, height, stroke, ahead: false }
    }

    fn mark(
        &self,
        node: u32,
        edge: [u32; 2],
        crossing: &Crossing,
        stroke: u32,
        slit: &mut OpenCut,
    ) -> PathNode {
        slit.put(&self.rest, self.plane(node, edge, crossing, stroke))
    }

    fn mean_edge(&self) -> f64 {
        let edges = self.tets().flat_map(|(_, nodes)| edges_of(nodes));
        let (sum, count) = edges.fold((0.0, 0.0), |(sum, count), [a, b]| {
            (sum + (self.rest[a as usize] - self.rest[b as usize]).norm(), count + 1.0)
        });
        if count > 0.0 { sum / count } else { 0.0 }
    }

    /// The end node that a crossing snaps to, if the edge is not to be split.
    fn snap(&self, edge: [u32; 2], crossing: &Crossing, edge_min: f64) -> Option<usize> {
        let length = (self.rest[edge[1] as usize] - self.rest[edge[0] as usize]).norm();
        let nearer = usize::from(crossing.share > 0.5);
        (crossing.share.min(1.0 - crossing.share) * length < edge_min).then_some(nearer)
    }

    fn quality_about(&self, [a, b]: [u32; 2]) -> f64 {
        let about = self.around[a as usize].iter().filter_map(|&tet| self.tet(tet));
        let of = about.filter(|nodes| nodes.contains(&b)).map(|nodes| mean_ratio(&self.rest, &nodes));
        of.fold(f64::INFINITY, f64::min)
    }
}
