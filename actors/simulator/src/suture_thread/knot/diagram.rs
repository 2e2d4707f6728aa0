//! A knot's diagram: a closed curve projected on a plane, as a planar diagram code of its crossings.

use nalgebra::{Point3, Rotation3, Vector3};

use super::KnotError;

/// One passage of the curve through a crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pass {
    /// The crossing.
    pub crossing: usize,
    /// Whether it is the upper strand.
    pub over: bool,
    /// Position along the curve: edge number plus fraction.
    pub at: f64,
}

/// A diagram: the passages in order along the curve, and the sign of each crossing.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Diagram {
    pub(super) passes: Vec<Pass>,
    pub(super) signs: Vec<i8>,
}

/// Projections with a crossing nearer to an end of an edge than this fraction of its length are rejected.
const END: f64 = 1e-9;
/// Number of projections tried before a curve counts as self-intersecting.
const DIRECTIONS: usize = 24;

impl Diagram {
    /// Diagram of the closed polygon through `points` \[m\], in the first of a fixed sequence of directions in which no
    /// crossing lies on a corner.
    ///
    /// # Errors
    /// Fewer than three points, non-finite coordinates, or a curve that intersects itself.
    pub fn of(points: &[Point3<f64>]) -> Result<Self, KnotError> {
        if points.len() < 3 {
            return Err(KnotError::Points(points.len()));
        }
        if let Some(bad) = points.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
            return Err(KnotError::NotFinite(bad));
        }
        let mut best: Option<Self> = None;
        for attempt in 0..DIRECTIONS {
            // Rotations by irrational fractions of a turn: all different, none along an axis.
            let k = attempt as f64 + 1.0;
            let axis = Vector3::new((1.3 * k).sin(), (2.1 * k).cos(), (0.7 * k + 0.4).sin());
            let turn = Rotation3::new(axis.normalize() * (0.618_033_988_749_895 * k * 2.0));
            let turned: Vec<_> = points.iter().map(|point| turn * point).collect();
            if let Some(diagram) = project(&turned)
                && best.as_ref().is_none_or(|best| diagram.signs.len() < best.signs.len())
            {
                best = Some(diagram);
            }
        }
        best.ok_or(KnotError::MeetsItself)
    }

    /// Number of crossings.
    #[must_use]
    pub fn crossings(&self) -> usize {
        self.signs.len()
    }

    /// Sum of the signs of the crossings; a property of the diagram, not of the knot.
    #[must_use]
    pub fn writhe(&self) -> i32 {
        self.signs.iter().map(|&sign| i32::from(sign)).sum()
    }

    /// The same knot after removing loops (Reidemeister I) and bigons (Reidemeister II) until none are left.
    #[must_use]
    pub fn simplified(&self) -> Self {
        let mut diagram = self.clone();
        while diagram.remove_loop() || diagram.remove_bigon() {}
        diagram
    }

    /// Removes a crossing that is passed twice in a row.
    fn remove_loop(&mut self) -> bool {
        let n = self.passes.len();
        let found = (0..n).find(|&i| self.passes[i].crossing == self.passes[(i + 1) % n].crossing);
        if let Some(i) = found {
            let crossing = self.passes[i].crossing;
            self.remove(&[crossing]);
        }
        found.is_some()
    }

    /// Removes two crossings passed consecutively both above and both below: two arcs between them without other
    /// crossings that bound a bigon, a region with these two sides only.
    fn remove_bigon(&mut self) -> bool {
        let n = self.passes.len();
        let place = self.places();
        for i in 0..n {
            let (a, b) = (self.passes[i], self.passes[(i + 1) % n]);
            if a.crossing == b.crossing || a.over != b.over || !a.over {
                continue;
            }
            let (pa, pb) = (place[a.crossing][0], place[b.crossing][0]);
            let next = (pa + 1) % n == pb || (pb + 1) % n == pa;
            if next && self.signs[a.crossing] != self.signs[b.crossing] && self.bounds_a_region(i, pa, pb) {
                self.remove(&[a.crossing, b.crossing]);
                return true;
            }
        }
        false
    }

    /// Whether the arc from passage `i` to the next and the arc between the lower passages `pa` and `pb` are the two
    /// sides of one region, found by walking around it.
    fn bounds_a_region(&self, i: usize, pa: usize, pb: usize) -> bool {
        let n = self.passes.len();
        let lower = if (pa + 1) % n == pb { pa } else { pb };
        self.regions().iter().any(|region| {
            region.len() == 2
                && region.iter().any(|side| side.0 == i)
                && region.iter().any(|side| side.0 == lower)
        })
    }

    /// The two passages of each crossing: below, above.
    pub(super) fn places(&self) -> Vec<[usize; 2]> {
        let mut places = vec![[0; 2]; self.signs.len()];
        for (i, pass) in self.passes.iter().enumerate() {
            places[pass.crossing][usize::from(pass.over)] = i;
        }
        places
    }

    /// The four arcs at a crossing, counter-clockwise from the incoming lower one, each with whether it leaves. Arc `i`
    /// runs from passage `i` to the next.
    pub(super) fn around(&self, crossing: usize, places: &[[usize; 2]]) -> [(usize, bool); 4] {
        let n = self.passes.len();
        let [below, above] = places[crossing];
        let before = |place: usize| (place + n - 1) % n;
        let (under_in, under_out) = ((before(below), false), (below, true));
        let (over_in, over_out) = ((before(above), false), (above, true));
        // Positive: the upper strand passes from left to right as seen along the lower one.
        if self.signs[crossing] > 0 {
            [under_in, over_out, under_out, over_in]
        } else {
            [under_in, over_in, under_out, over_out]
        }
    }

    /// The regions of the plane, each as a list of its sides: arcs with whether they are traversed forwards, the region
    /// on the left.
    pub(super) fn regions(&self) -> Vec<Vec<(usize, bool)>> {
        let n = self.passes.len();
        let places = self.places();
        let mut seen = vec![[false; 2]; n];
        let mut regions = Vec::new();
        for start in 0..2 * n {
            let (mut arc, mut forwards) = (start / 2, start % 2 == 0);
            if seen[arc][usize::from(forwards)] {
                continue;
            }
            let mut region = Vec::new();
            while !seen[arc][usize::from(forwards)] {
                seen[arc][usize::from(forwards)] = true;
                region.push((arc, forwards));
                // At the crossing where the arc ends, continue along the next arc clockwise: the leftmost turn.
                let pass = if forwards { (arc + 1) % n } else { arc };
                let around = self.around(self.passes[pass].crossing, &places);
                let came =
                    around.iter().position(|&(of, leaves)| of == arc && leaves != forwards).unwrap_or(0);
                let (next, leaves) = around[(came + 3) % 4];
                (arc, forwards) = (next, leaves);
            }
            regions.push(region);
        }
        regions
    }

    fn remove(&mut self, crossings: &[usize]) {
        self.passes.retain(|pass| !crossings.contains(&pass.crossing));
        let mut renamed = vec![0; self.signs.len()];
        let mut kept = Vec::new();
        for (crossing, &sign) in self.signs.iter().enumerate() {
            renamed[crossing] = kept.len();
            if !crossings.contains(&crossing) {
                kept.push(sign);
            }
        }
        for pass in &mut self.passes {
            pass.crossing = renamed[pass.crossing];
        }
        self.signs = kept;
    }
}

/// The diagram projected along z; `None` where a crossing lies on a corner or two edges intersect in space.
fn project(points: &[Point3<f64>]) -> Option<Diagram> {
    let n = points.len();
    let mut diagram = Diagram::default();
    for i in 0..n {
        let (a, b) = (points[i], points[(i + 1) % n]);
        let d = b - a;
        for j in i + 2..n {
            if i == 0 && j + 1 == n {
                continue;
            }
            let (p, q) = (points[j], points[(j + 1) % n]);
            if a.x.max(b.x) < p.x.min(q.x)
                || p.x.max(q.x) < a.x.min(b.x)
                || a.y.max(b.y) < p.y.min(q.y)
                || p.y.max(q.y) < a.y.min(b.y)
            {
                continue;
            }
            let (e, r) = (q - p, p - a);
            let turn = d.x * e.y - d.y * e.x;
            let (s, t) = ((r.x * e.y - r.y * e.x) / turn, (r.x * d.y - r.y * d.x) / turn);
            if turn == 0.0 {
                // Parallel edges cross only where they overlap.
                if (r.x * d.y - r.y * d.x) == 0.0 {
                    return None;
                }
                continue;
            }
            let outside = |x: f64| !(-END..=1.0 + END).contains(&x);
            if outside(s) || outside(t) {
                continue;
            }
            let inside = |x: f64| (END..=1.0 - END).contains(&x);
            let height = (a.z + d.z * s) - (p.z + e.z * t);
            if !inside(s) || !inside(t) || height == 0.0 {
                return None;
            }
            let over = height > 0.0;
            let crossing = diagram.signs.len();
            // Sign from the upper and lower directions, seen from above.
            let sign = if over { turn } else { -turn };
            diagram.signs.push(if sign > 0.0 { 1 } else { -1 });
            diagram.passes.push(Pass { crossing, over, at: i as f64 + s });
            diagram.passes.push(Pass { crossing, over: !over, at: j as f64 + t });
        }
    }
    diagram.passes.sort_by(|a, b| a.at.total_cmp(&b.at));
    Some(diagram)
}
