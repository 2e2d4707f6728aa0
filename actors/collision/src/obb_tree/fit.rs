//! Fit of an oriented box to points: axes along their principal directions (PCA), extents from the points.

use super::lanes::{Lanes, Lanes3, dot, each, splat, three};
use super::obb::{Obb, ObbQuad};

/// Accumulated moments for the principal directions.
#[derive(Clone, Copy)]
pub(super) struct Moments {
    /// Reference point among the others: without it squares of coordinates would cancel their differences.
    from: [f32; 3],
    count: f32,
    sum: [f32; 3],
    /// xx, yy, zz, xy, yz, zx.
    squares: [f32; 6],
}

impl Moments {
    pub fn about(from: [f32; 3]) -> Self {
        Self { from, count: 0.0, sum: [0.0; 3], squares: [0.0; 6] }
    }

    #[inline(always)]
    pub fn add(&mut self, point: [f32; 3]) {
        let p = [point[0] - self.from[0], point[1] - self.from[1], point[2] - self.from[2]];
        self.count += 1.0;
        for (sum, value) in self.sum.iter_mut().zip(p) {
            *sum += value;
        }
        let products = [p[0] * p[0], p[1] * p[1], p[2] * p[2], p[0] * p[1], p[1] * p[2], p[2] * p[0]];
        for (sum, value) in self.squares.iter_mut().zip(products) {
            *sum += value;
        }
    }

    /// Unit axes by rows, along the greatest spread first; right-handed, and valid for any points.
    pub fn axes(&self) -> [[f32; 3]; 3] {
        let count = self.count.max(1.0);
        let mean = self.sum.map(|sum| sum / count);
        let s = self.squares.map(|square| square / count);
        let mut matrix = [
            [s[0] - mean[0] * mean[0], s[3] - mean[0] * mean[1], s[5] - mean[2] * mean[0]],
            [s[3] - mean[0] * mean[1], s[1] - mean[1] * mean[1], s[4] - mean[1] * mean[2]],
            [s[5] - mean[2] * mean[0], s[4] - mean[1] * mean[2], s[2] - mean[2] * mean[2]],
        ];
        let mut axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        jacobi(&mut matrix, &mut axes);
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| matrix[b][b].total_cmp(&matrix[a][a]));
        orthonormal([axes[order[0]], axes[order[1]]])
    }
}

/// Rotates the axes until the matrix is diagonal (Jacobi 1846): three sweeps of three rotations reach rounding error.
fn jacobi(matrix: &mut [[f32; 3]; 3], axes: &mut [[f32; 3]; 3]) {
    for _ in 0..4 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let off = matrix[p][q];
            if off.abs() <= 1e-7 * (matrix[p][p].abs() + matrix[q][q].abs()) {
                continue;
            }
            let theta = (matrix[q][q] - matrix[p][p]) / (2.0 * off);
            let tangent = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
            let sine = tangent * cosine;
            let r = 3 - p - q;
            let (rp, rq) = (matrix[r][p], matrix[r][q]);
            matrix[p][p] -= tangent * off;
            matrix[q][q] += tangent * off;
            (matrix[p][q], matrix[q][p]) = (0.0, 0.0);
            (matrix[r][p], matrix[r][q]) = (cosine * rp - sine * rq, sine * rp + cosine * rq);
            (matrix[p][r], matrix[q][r]) = (matrix[r][p], matrix[r][q]);
            let (u, v) = (axes[p], axes[q]);
            axes[p] = three(|k| cosine * u[k] - sine * v[k]);
            axes[q] = three(|k| sine * u[k] + cosine * v[k]);
        }
    }
}

/// Orthonormalises two nearly orthonormal directions, and adds the third.
fn orthonormal([a, b]: [[f32; 3]; 2]) -> [[f32; 3]; 3] {
    let product = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let unit = |v: [f32; 3]| {
        let length = product(v, v).sqrt();
        v.map(|x| x / length)
    };
    let a = unit(a);
    let along = product(a, b);
    let b = unit(three(|i| b[i] - along * a[i]));
    let c = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    if [a, b, c].iter().flatten().all(|x| x.is_finite()) {
        [a, b, c]
    } else {
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    }
}

/// Extent of points along three axes, four points at a time.
pub(super) struct AxisExtents {
    axes: [Lanes3; 3],
    low: Lanes3,
    high: Lanes3,
}

impl AxisExtents {
    #[inline(always)]
    pub fn new(axes: &[[f32; 3]; 3]) -> Self {
        Self {
            axes: each(*axes, splat),
            low: [Lanes::all(f32::INFINITY); 3],
            high: [Lanes::all(f32::NEG_INFINITY); 3],
        }
    }

    /// Adds four triangles, one axis after the other, so that registers suffice.
    #[inline(always)]
    pub fn add(&mut self, corners: &[Lanes3; 3]) {
        for i in 0..3 {
            let [a, b, c] = each(*corners, |corner| dot(self.axes[i], corner));
            self.low[i] = self.low[i].min(a.min(b).min(c));
            self.high[i] = self.high[i].max(a.max(b).max(c));
        }
    }

    /// Adds four boxes.
    #[inline(always)]
    pub fn add_boxes(&mut self, quad: &ObbQuad) {
        for i in 0..3 {
            let axis = self.axes[i];
            let middle = dot(axis, quad.center);
            let half = dot(each(quad.axes, |other| dot(axis, other).abs()), quad.half);
            self.low[i] = self.low[i].min(middle - half);
            self.high[i] = self.high[i].max(middle + half);
        }
    }

    #[inline(always)]
    pub fn into_box(self, axes: &[[f32; 3]; 3]) -> Obb {
        let (least, most) = (each(self.low, Lanes::lowest), each(self.high, Lanes::highest));
        let half = three(|i| 0.5 * (most[i] - least[i]));
        let middle = three(|i| 0.5 * (most[i] + least[i]));
        Obb {
            center: three(|k| middle[0] * axes[0][k] + middle[1] * axes[1][k] + middle[2] * axes[2][k]),
            axes: *axes,
            half,
            size: half[0].max(half[1]).max(half[2]),
        }
    }
}
