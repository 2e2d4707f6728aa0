//! Leaves of four triangles, and culling tests of four pairs at a time before the exact tests.

use super::lanes::{Lanes, Lanes3, cross, dot, each, minus, splat, three, times};
use super::obb::{Obb, Placement};

/// Four triangles in the unit of their tree; padded with the last one.
#[derive(Clone, Copy, Debug)]
pub(super) struct Leaf {
    pub corners: [Lanes3; 3],
}

/// Four triangles with their plane normals, for comparisons.
pub(super) struct LeafWithNormals {
    corners: [Lanes3; 3],
    normal: Lanes3,
    /// Smallest and largest height of the corners along the normal, which differ for thin triangles because their
    /// normal is inaccurate.
    low: Lanes,
    high: Lanes,
    /// Largest gap along the normal that may still be rounding.
    noise: Lanes,
}

#[inline(always)]
fn magnitude(v: Lanes3) -> Lanes {
    v[0].abs() + v[1].abs() + v[2].abs()
}

impl Leaf {
    pub const NONE: Self = Self { corners: [[Lanes::ZERO; 3]; 3] };

    #[inline]
    pub fn of(triangles: [[[f32; 3]; 3]; 4]) -> Self {
        Self {
            corners: three(|corner| {
                three(|axis| {
                    let of = |lane: usize| triangles[lane][corner][axis];
                    Lanes([of(0), of(1), of(2), of(3)])
                })
            }),
        }
    }

    /// One of the four.
    #[inline(always)]
    pub fn one(&self, lane: usize) -> [[f32; 3]; 3] {
        each(self.corners, |corner| each(corner, |coordinate| coordinate.0[lane]))
    }

    #[inline(always)]
    pub fn placed(&self, placement: &Placement) -> Self {
        Self { corners: each(self.corners, |corner| placement.place_points(corner)) }
    }

    /// Gaps between the four and a box along the axes of the box; negative where there is none.
    #[inline(always)]
    fn gaps_to(&self, obb: &Obb) -> Lanes3 {
        let center = splat(obb.center);
        three(|i| {
            let axis = splat(obb.axes[i]);
            let (low, high) = reach(axis, &self.corners);
            let middle = dot(axis, center);
            (low - middle).max(middle - high) - Lanes::all(obb.half[i])
        })
    }

    /// Which of the four overlap a box, by the box's axes.
    #[inline]
    pub fn reaching(&self, obb: &Obb, slack: f32) -> u32 {
        let [x, y, z] = self.gaps_to(obb);
        x.max(y).max(z).at_most(Lanes::all(slack))
    }

    /// Lower bounds of the squared distance of each of the four from a box.
    #[inline]
    pub fn distance_squared(&self, obb: &Obb, slack: f32) -> Lanes {
        let gaps = each(self.gaps_to(obb), |gap| (gap - Lanes::all(slack)).max(Lanes::ZERO));
        dot(gaps, gaps)
    }

    #[inline(always)]
    pub fn faced(&self, slack: f32) -> LeafWithNormals {
        let [a, b, c] = self.corners;
        let normal = cross(minus(b, a), minus(c, a));
        let (low, high) = reach(normal, &self.corners);
        LeafWithNormals {
            corners: self.corners,
            normal,
            low,
            high,
            noise: magnitude(normal) * Lanes::all(slack),
        }
    }
}

/// The normal of one triangle, copied to four lanes.
#[inline(always)]
fn normal_of([a, b, c]: &[[f32; 3]; 3]) -> Lanes3 {
    let (u, v) = (three(|i| b[i] - a[i]), three(|i| c[i] - a[i]));
    splat(three(|i| u[(i + 1) % 3] * v[(i + 2) % 3] - u[(i + 2) % 3] * v[(i + 1) % 3]))
}

/// Smallest and largest of three corners along a direction.
#[inline(always)]
fn reach(direction: Lanes3, corners: &[Lanes3; 3]) -> (Lanes, Lanes) {
    let [a, b, c] = each(*corners, |corner| dot(direction, corner));
    (a.min(b).min(c), a.max(b).max(c))
}

impl LeafWithNormals {
    /// Gap along the normal of one triangle, and along those of the four; negative where there is none.
    #[inline(always)]
    fn gaps(&self, corners: &[Lanes3; 3], normal: Lanes3) -> [Lanes; 2] {
        let ((low, high), (least, most)) = (reach(normal, corners), reach(normal, &self.corners));
        let along_one = (least - high).max(low - most);
        let (least, most) = reach(self.normal, corners);
        [along_one, (least - self.high).max(self.low - most)]
    }

    /// Which of the four may overlap a triangle: those not wholly on one side of its plane, nor it of theirs.
    #[inline]
    pub fn overlapping(&self, triangle: &[[f32; 3]; 3], slack: f32) -> u32 {
        let normal = normal_of(triangle);
        let [of_one, of_four] = self.gaps(&each(*triangle, splat), normal);
        let noise = magnitude(normal) * Lanes::all(slack);
        (of_one - noise).max(of_four - self.noise).at_most(Lanes::ZERO)
    }
}

/// Smallest square used as a divisor: smaller ones define no direction.
const TINY: f32 = 1e-30;

impl LeafWithNormals {
    /// Lower bounds of the squared distance of a triangle from each of the four.
    ///
    /// Along any direction, the gap between the extents of two triangles is at most their distance; along the direction
    /// of their nearest points it equals the distance. These are two edge points, or differ along one plane's normal:
    /// so the normals are tried, then the direction between the nearest two edges, within rounding. An inaccurate
    /// direction only lowers the bound.
    #[inline]
    pub fn distance_squared(&self, triangle: &[[f32; 3]; 3], slack: f32, limit: f32) -> Lanes {
        let corners = each(*triangle, splat);
        let normal = normal_of(triangle);
        let [of_one, of_four] = self.gaps(&corners, normal);
        let of_planes = bound_squared(of_one, normal, slack).max(bound_squared(of_four, self.normal, slack));
        if of_planes.at_most(Lanes::all(limit)) == 0 {
            return of_planes;
        }
        let across = self.across_edges(&corners);
        let (_, from) = reach(across, &corners);
        let (to, _) = reach(across, &self.corners);
        of_planes.max(bound_squared(to - from, across, slack))
    }

    /// Direction from the triangle to each of the four between their nearest edges.
    #[inline(always)]
    fn across_edges(&self, corners: &[Lanes3; 3]) -> Lanes3 {
        let tiny = Lanes::all(TINY);
        let mut across = [Lanes::ZERO; 3];
        let mut nearest = Lanes::all(f32::INFINITY);
        for i in 0..3 {
            let edge = minus(corners[(i + 1) % 3], corners[i]);
            let aa = dot(edge, edge).max(tiny);
            for j in 0..3 {
                let other = minus(self.corners[(j + 1) % 3], self.corners[j]);
                let from = minus(corners[i], self.corners[j]);
                let (ee, b) = (dot(other, other).max(tiny), dot(edge, other));
                let (c, f) = (dot(edge, from), dot(other, from));
                let s = ((b * f - c * ee) / (aa * ee - b * b).max(tiny)).clamp_to_one();
                let t = ((b * s + f) / ee).clamp_to_one();
                let s = ((b * t - c) / aa).clamp_to_one();
                let between = minus(minus(times(other, t), times(edge, s)), from);
                let square = dot(between, between);
                for axis in 0..3 {
                    across[axis] = between[axis].where_less(square, nearest, across[axis]);
                }
                nearest = nearest.min(square);
            }
        }
        across
    }
}

/// The square of a gap along a direction of any length, minus rounding.
#[inline(always)]
fn bound_squared(gap: Lanes, direction: Lanes3, slack: f32) -> Lanes {
    let certain = (gap - magnitude(direction) * Lanes::all(slack)).max(Lanes::ZERO);
    certain * certain / dot(direction, direction).max(Lanes::all(TINY))
}
