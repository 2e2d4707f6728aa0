//! Conservative rasterisation: every pixel that a triangle overlaps, with the part inside it.

use nalgebra::{Point3, Vector3};

use crate::primitive::Triangle;

/// A point in the image: across and down in pixels, and the depth \[m\].
pub(super) type ImagePoint = [f64; 3];

/// Relative widening of a pixel, so that rounding leaves no gap between pixels.
const SEAM: f64 = 1e-9;

/// An orthographic view: pixels across and down, depth along the direction of view.
#[derive(Clone, Copy, Debug)]
pub(super) struct View {
    /// Corner of the first pixel, at depth 0.
    pub origin: Point3<f64>,
    /// Across, down, and away from the eye: unit vectors, right-handed.
    pub axes: [Vector3<f64>; 3],
    /// Side of a pixel \[m\].
    pub pixel: f64,
    /// Pixels across and down.
    pub size: [usize; 2],
}

impl View {
    /// An empty view.
    pub const EMPTY: Self = Self {
        origin: Point3::new(0.0, 0.0, 0.0),
        axes: [Vector3::new(1.0, 0.0, 0.0), Vector3::new(0.0, 1.0, 0.0), Vector3::new(0.0, 0.0, 1.0)],
        pixel: 1.0,
        size: [0, 0],
    };

    /// A view along the last axis that shows all of these points and a margin \[m\], with pixels of at least `pixel`
    /// \[m\], larger where there would be more than `pixels_max`.
    pub fn around(
        axes: [Vector3<f64>; 3],
        points: impl Iterator<Item = Point3<f64>>,
        margin: f64,
        pixel: f64,
        pixels_max: usize,
    ) -> Option<Self> {
        let mut bounds = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for point in points {
            for (bound, axis) in bounds.iter_mut().zip(&axes) {
                let at = axis.dot(&point.coords);
                *bound = [bound[0].min(at - margin), bound[1].max(at + margin)];
            }
        }
        let extent = bounds.map(|[low, high]| high - low);
        if !extent.iter().all(|length| length.is_finite() && *length >= 0.0) {
            return None;
        }
        // One spare pixel on each side for points that rounding puts outside.
        let sides = |pixel: f64| extent.map(|length| (length / pixel).ceil() + 2.0);
        let mut pixel = pixel;
        while sides(pixel).iter().product::<f64>() > pixels_max as f64 {
            let [across, down] = sides(pixel);
            pixel *= (across * down / pixels_max as f64).sqrt().max(1.01);
        }
        let corner = axes[0] * (bounds[0][0] - pixel) + axes[1] * (bounds[1][0] - pixel);
        Some(Self { origin: Point3::from(corner), axes, pixel, size: sides(pixel).map(|side| side as usize) })
    }

    pub fn place(&self, point: &Point3<f64>) -> ImagePoint {
        let from = point - self.origin;
        let [across, down, away] = self.axes;
        [from.dot(&across) / self.pixel, from.dot(&down) / self.pixel, from.dot(&away)]
    }

    pub fn point(&self, place: &ImagePoint) -> Point3<f64> {
        let [across, down, away] = self.axes;
        self.origin + across * (place[0] * self.pixel) + down * (place[1] * self.pixel) + away * place[2]
    }

    pub fn places(&self, triangle: &Triangle) -> [ImagePoint; 3] {
        triangle.each_ref().map(|corner| self.place(corner))
    }

    /// First and last pixel along one side that `[low, high]` overlaps; `None` outside the image.
    pub fn span(&self, axis: usize, low: f64, high: f64) -> Option<[usize; 2]> {
        let last = self.size[axis].checked_sub(1)?;
        let (low, high) = (low - SEAM, high + SEAM);
        // A cast of what is negative gives 0.
        (high >= 0.0 && low <= self.size[axis] as f64)
            .then(|| [(low as usize).min(last), (high as usize).min(last)])
    }

    /// Visits each wanted pixel that a triangle overlaps, with the part inside it.
    pub fn each_pixel(
        &self,
        triangle: &[ImagePoint; 3],
        is_wanted: impl Fn(usize) -> bool,
        mut visit: impl FnMut(usize, &Polygon),
    ) {
        let whole = Polygon::new(triangle);
        let Some([top, bottom]) = whole.range(1).and_then(|[low, high]| self.span(1, low, high)) else {
            return;
        };
        for row in top..=bottom {
            let strip = whole.clipped(1, row as f64 - SEAM, (row + 1) as f64 + SEAM);
            let Some([left, right]) = strip.range(0).and_then(|[low, high]| self.span(0, low, high)) else {
                continue;
            };
            for column in left..=right {
                let pixel = row * self.size[0] + column;
                if is_wanted(pixel) {
                    let part = strip.clipped(0, column as f64 - SEAM, (column + 1) as f64 + SEAM);
                    if part.count > 0 {
                        visit(pixel, &part);
                    }
                }
            }
        }
    }
}

/// A convex polygon: a triangle clipped by six planes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Polygon {
    corners: [ImagePoint; 9],
    count: usize,
}

impl Polygon {
    fn new(triangle: &[ImagePoint; 3]) -> Self {
        let mut corners = [[0.0; 3]; 9];
        corners[..3].copy_from_slice(triangle);
        Self { corners, count: 3 }
    }

    fn corners(&self) -> &[ImagePoint] {
        &self.corners[..self.count]
    }

    /// Lowest and highest coordinate on one axis; `None` if empty.
    pub fn range(&self, axis: usize) -> Option<[f64; 2]> {
        let empty = [f64::INFINITY, f64::NEG_INFINITY];
        let range = self
            .corners()
            .iter()
            .fold(empty, |[low, high], corner| [low.min(corner[axis]), high.max(corner[axis])]);
        (self.count > 0).then_some(range)
    }

    /// Clips it between two planes perpendicular to one axis (Sutherland, Hodgman 1974).
    pub fn clipped(&self, axis: usize, low: f64, high: f64) -> Self {
        self.cut(axis, low, 1.0).cut(axis, high, -1.0)
    }

    fn cut(&self, axis: usize, bound: f64, sign: f64) -> Self {
        let mut kept = Self { corners: self.corners, count: 0 };
        let inside = |corner: &ImagePoint| (corner[axis] - bound) * sign >= 0.0;
        if self.corners().iter().all(inside) {
            return *self;
        }
        let Some(mut previous) = self.corners().last().copied() else { return kept };
        for corner in self.corners() {
            if inside(corner) != inside(&previous) {
                let share = (bound - previous[axis]) / (corner[axis] - previous[axis]);
                let mut place: ImagePoint =
                    std::array::from_fn(|i| previous[i] + (corner[i] - previous[i]) * share);
                place[axis] = bound;
                kept.push(place);
            }
            if inside(corner) {
                kept.push(*corner);
            }
            previous = *corner;
        }
        kept
    }

    fn push(&mut self, place: ImagePoint) {
        // Each plane adds at most one corner; for nearly flat polygons rounding must not add more than fit.
        if self.count < self.corners.len() {
            self.corners[self.count] = place;
            self.count += 1;
        }
    }

    /// The mean of its corners, which is inside it.
    pub fn middle(&self) -> Option<ImagePoint> {
        let mean =
            |axis: usize| self.corners().iter().map(|corner| corner[axis]).sum::<f64>() / self.count as f64;
        (self.count > 0).then(|| std::array::from_fn(mean))
    }
}

/// Whether the centre of a pixel is covered by a triangle, at which depth, and whether the triangle faces the eye (1)
/// or not (-1). Of the triangles around an edge or a vertex exactly one counts for each sheet (fill rule): the centre
/// counts as shifted a little to the right, and less downwards.
pub(super) fn middle_depth(triangle: &[ImagePoint; 3], middle: [f64; 2]) -> Option<(f64, i32)> {
    let [a, b, c] = triangle;
    let sides = [left_of(a, b, middle), left_of(b, c, middle), left_of(c, a, middle)];
    if sides[0] != sides[1] || sides[1] != sides[2] {
        return None;
    }
    let area = |p: &ImagePoint, q: &ImagePoint| {
        (p[0] - middle[0]) * (q[1] - middle[1]) - (p[1] - middle[1]) * (q[0] - middle[0])
    };
    let weights = [area(b, c), area(c, a), area(a, b)];
    let whole = weights[0] + weights[1] + weights[2];
    let depth = (weights[0] * a[2] + weights[1] * b[2] + weights[2] * c[2]) / whole;
    let (low, high) = (a[2].min(b[2]).min(c[2]), a[2].max(b[2]).max(c[2]));
    // For slivers the quotient is dominated by rounding.
    let depth = if depth.is_finite() { depth.clamp(low, high) } else { low };
    Some((depth, if sides[0] { -1 } else { 1 }))
}

/// Whether a point is on the left of the line from `a` to `b`; the negation of the result for `b` to `a`.
fn left_of(a: &ImagePoint, b: &ImagePoint, [x, y]: [f64; 2]) -> bool {
    let ordered = (a[0], a[1]) <= (b[0], b[1]);
    let (from, to) = if ordered { (a, b) } else { (b, a) };
    let side = (to[0] - from[0]) * (y - from[1]) - (to[1] - from[1]) * (x - from[0]);
    // On the line: shifted right, it is on the right of a downward line; shifted down, it is on the left.
    let left = side > 0.0 || (side == 0.0 && (to[1] < from[1] || (to[1] == from[1] && to[0] > from[0])));
    left == ordered
}
