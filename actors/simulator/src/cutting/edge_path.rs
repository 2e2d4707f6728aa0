//! Embeds a cut path into the mesh as a chain of edges, walking from vertex to vertex in the rest shape, and splits the
//! mesh along it.

use nalgebra::Point3;

use super::Sheet;
use super::cuttable_surface::ordered;
use super::swept_path::{SurfacePath, in_edges};

/// Maximum steps of a walk per point of its path: it crosses one edge between two points, and few more where it goes
/// astray.
const STEPS: usize = 4;
/// Tolerance for a direction outside a triangle that still leads into it.
const ASIDE: f64 = 1e-9;
/// Distance from an edge's end, as a fraction, within which a path goes through the vertex.
const AT_END: f64 = 1e-3;

/// Where a walk crosses the edge opposite to its vertex.
struct Crossing {
    edge: [u32; 2],
    share: f64,
    /// Fraction of the way to the target.
    far: f64,
}

impl Sheet {
    /// Cuts along a path.
    pub(super) fn follow(&mut self, mut path: SurfacePath) {
        let tip = match (self.tip_near(&path, 0), self.tip_near(&path, 1)) {
            (Some(tip), _) => Some(tip),
            (None, Some(tip)) => {
                path.reverse();
                Some(tip)
            }
            (None, None) => None,
        };
        let start = match tip {
            Some(tip) => tip,
            None => {
                let border = [0, 1].map(|side| self.border_near(&path, side));
                if border[0].is_none() && border[1].is_some() {
                    path.reverse();
                }
                match border[0].or(border[1]) {
                    Some((edge, share)) => self.onto(edge, share, &[]),
                    None => self.nearest_corner(&path),
                }
            }
        };
        let chain = self.walk(start, &path.points);
        if chain.len() < 2 {
            // Not far enough for an edge: the next frame continues from here.
            if !self.state.tips.contains(&start) {
                self.state.tips.push(start);
            }
            return;
        }
        self.state.tips.retain(|tip| *tip != start);
        let ends = [chain[0], chain[chain.len() - 1]];
        let inside = ends.map(|end| !self.on_border(end));
        for pair in chain.windows(2) {
            let (from, to) = (self.state.rest[pair[0] as usize], self.state.rest[pair[1] as usize]);
            self.change.length += (to - from).norm();
            // It may have gone astray along a border, where nothing can be split.
            if !self.is_border([pair[0], pair[1]]) {
                self.suspend(pair[0], pair[1]);
            }
        }
        for &vertex in &chain {
            self.part(vertex);
        }
        for (end, inside) in ends.into_iter().zip(inside) {
            // The cut that the walk continues ended inside the mesh as well.
            let goes_on = inside && (end != start || tip.is_none());
            if goes_on && !self.state.tips.contains(&end) {
                self.state.tips.push(end);
            }
        }
    }

    /// The nearest tip around the triangle at one end of a path from which the path can continue.
    fn tip_near(&self, path: &SurfacePath, side: usize) -> Option<u32> {
        let end = if side == 0 { path.points[0] } else { path.points[path.points.len() - 1] };
        let around = self.state.triangles[path.triangles[side] as usize];
        let reach = |tip: u32| {
            let fan = self.about(tip);
            let near = fan.iter().any(|&triangle| {
                let corners = self.state.triangles[triangle as usize];
                corners.iter().any(|corner| around.contains(corner))
            });
            let corners = fan.iter().flat_map(|&triangle| self.state.triangles[triangle as usize]);
            let edge =
                corners.map(|corner| self.apart(tip, &self.state.rest[corner as usize])).fold(0.0, f64::max);
            near && self.apart(tip, &end) <= edge
        };
        let candidates = self.state.tips.iter().copied().filter(|&tip| reach(tip));
        candidates.min_by(|&a, &b| self.apart(a, &end).total_cmp(&self.apart(b, &end)))
    }

    fn apart(&self, vertex: u32, point: &Point3<f64>) -> f64 {
        (self.state.rest[vertex as usize] - point).norm()
    }

    /// The border edge on which one end of a path lies.
    fn border_near(&self, path: &SurfacePath, side: usize) -> Option<([u32; 2], f64)> {
        let end = if side == 0 { path.points[0] } else { path.points[path.points.len() - 1] };
        let [a, b, c] = self.state.triangles[path.triangles[side] as usize];
        [[a, b], [b, c], [c, a]].into_iter().filter(|&edge| self.is_border(edge)).find_map(|edge| {
            let [from, to] = edge.map(|vertex| self.state.rest[vertex as usize]);
            let along = to - from;
            let share = (end - from).dot(&along) / along.norm_squared();
            let off = (from + along * share - end).norm();
            ((0.0..=1.0).contains(&share) && off <= 1e-6 * along.norm()).then_some((edge, share))
        })
    }

    fn nearest_corner(&self, path: &SurfacePath) -> u32 {
        let corners = self.state.triangles[path.triangles[0] as usize];
        let [a, b, c] = corners.map(|corner| self.apart(corner, &path.points[0]));
        if a <= b && a <= c {
            corners[0]
        } else if b <= c {
            corners[1]
        } else {
            corners[2]
        }
    }

    /// The vertex where a path crosses an edge: a new one, a moved one, or the nearer end. `taken` cannot be moved.
    fn onto(&mut self, edge: [u32; 2], share: f64, taken: &[u32]) -> u32 {
        let (near, far, along) =
            if share <= 0.5 { (edge[0], edge[1], share) } else { (edge[1], edge[0], 1.0 - share) };
        if along <= AT_END {
            near
        } else if self.can_split(edge, share) {
            self.split(edge, share)
        } else if !taken.contains(&near) && self.can_move(near, far, along) {
            self.shift(near, far, along);
            near
        } else {
            near
        }
    }

    /// The vertices of a chain of edges along a path.
    fn walk(&mut self, start: u32, targets: &[Point3<f64>]) -> Vec<u32> {
        let mut chain = vec![start];
        let mut left = STEPS * targets.len() + STEPS;
        for target in targets {
            while left > 0 {
                left -= 1;
                let here = chain[chain.len() - 1];
                let Some(crossing) = self.crossing(here, target) else { break };
                if crossing.far > 1.0 + 1e-6 {
                    break;
                }
                let border = self.is_border(crossing.edge);
                let next = self.onto(crossing.edge, crossing.share, &chain);
                if chain.contains(&next) {
                    break;
                }
                // The edge to it: of the crossed triangle, whether split or not.
                if self.about_edge(ordered(here, next)).next().is_none() {
                    return chain;
                }
                chain.push(next);
                if border {
                    return chain;
                }
            }
        }
        chain
    }

    /// Where the segment from a vertex to a target leaves the triangles around the vertex.
    fn crossing(&self, here: u32, target: &Point3<f64>) -> Option<Crossing> {
        let from = self.state.rest[here as usize];
        let way = target - from;
        if way.norm_squared() == 0.0 {
            return None;
        }
        let mut best: Option<(f64, Crossing)> = None;
        for &triangle in self.about(here) {
            let corners = self.state.triangles[triangle as usize];
            let at = corners.iter().position(|&corner| corner == here)?;
            let edge = [corners[(at + 1) % 3], corners[(at + 2) % 3]];
            let [first, second] = edge.map(|vertex| self.state.rest[vertex as usize] - from);
            let [a, b] = in_edges(&way, &first, &second);
            let sum = a + b;
            if sum.is_nan() || sum <= 0.0 {
                continue;
            }
            // On a curved surface the segment lies in no triangle's plane: take the triangle that it enters most
            // directly.
            let into = (a.min(b) / sum).min(0.0);
            let off = (way - first * a - second * b).norm() / way.norm();
            let score = off - into;
            if into >= -ASIDE && best.as_ref().is_none_or(|(least, _)| score < *least) {
                let share = (b / sum).clamp(0.0, 1.0);
                best = Some((score, Crossing { edge, share, far: 1.0 / sum }));
            }
        }
        best.map(|(_, crossing)| crossing)
    }
}
