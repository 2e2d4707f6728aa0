//! Collision of an instrument's volume with a scene in image space (Shinya, Forgue 1991; Myszkowski, Okunev, Kunii
//! 1995; layers of depth as in Heidelberger, Teschner, Gross 2004), rasterised on the CPU.
//!
//! The volume is drawn into an orthographic image whose pixels hold layers of depth, each from an entry to an exit: a
//! closed surface seen along any direction ([`ZBuffer::draw_surface`]), or the swept volume of a shaft between two
//! frames as it turns about its port ([`ZBuffer::draw_shaft`]), seen across the plane of its motion. So a fast
//! instrument misses no triangle between its poses. Triangles of the scene are then compared with the layers of the
//! pixels that they overlap.
//!
//! # Tolerance
//! Rasterisation is conservative on both sides: a pixel takes all of the volume and all of the triangle in its column,
//! clipped exactly. So every triangle that intersects the volume is reported, and every reported triangle has a point
//! within [`ZBuffer::tolerance`] of the volume: the diagonal of a pixel, for a shaft less than a pixel more, and as
//! much as its axis leaves the plane of motion where the port moves aside.
//!
//! The arithmetic is `f64` on the CPU: the result is the same on every machine.

mod columns;
mod raster;
mod shaft;

use nalgebra::{Point3, Vector3};
use thiserror::Error;

use crate::surface::Surface;
use columns::Columns;
use raster::{ImagePoint, View, middle_depth};
pub use shaft::{ShaftError, ShaftSweep};

/// Why an image is invalid.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum ZBufferError {
    /// The pixel size is invalid.
    #[error("a pixel of {pixel} m is not one: its side is above 0 and finite")]
    Pixel {
        /// The value given \[m\].
        pixel: f64,
    },
    /// The image size is invalid.
    #[error("an image of {pixels} pixels at most holds nothing: {} to {} are valid", PIXELS_MIN, PIXELS_MAX)]
    Pixels {
        /// The value given.
        pixels: usize,
    },
    /// The direction is zero or not finite.
    #[error("the direction of view has no length")]
    Direction,
}

/// Fewest pixels that an image may be limited to.
pub const PIXELS_MIN: usize = 64;
/// Most pixels that an image may be limited to: 64 MB of columns.
pub const PIXELS_MAX: usize = 1 << 24;

/// A triangle of the scene that intersects the volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VolumeHit {
    /// Its index.
    pub triangle: u32,
    /// Number of pixels.
    pub pixels: u32,
    /// Nearest and farthest depth of the intersection along the direction of view \[m\], measured from the plane
    /// through the world's origin.
    pub depths: [f64; 2],
    /// A point of the triangle within the tolerance of the volume, in the pixel of the longest overlap \[m\].
    pub point: Point3<f64>,
}

/// An image of a volume. Buffers are reused: drawing and queries of similar size do not allocate.
#[derive(Clone, Debug)]
pub struct ZBuffer {
    pixel: f64,
    pixels_max: usize,
    view: View,
    columns: Columns,
    range: Option<[f64; 2]>,
    tolerance: f64,
}

impl ZBuffer {
    /// An empty image whose pixels are `pixel` \[m\] wide, or wider to stay within `pixels_max`.
    ///
    /// # Errors
    /// For a pixel without size, less than [`PIXELS_MIN`] or more than [`PIXELS_MAX`] pixels.
    pub fn new(pixel: f64, pixels_max: usize) -> Result<Self, ZBufferError> {
        if !(pixel.is_finite() && pixel > 0.0) {
            return Err(ZBufferError::Pixel { pixel });
        }
        if !(PIXELS_MIN..=PIXELS_MAX).contains(&pixels_max) {
            return Err(ZBufferError::Pixels { pixels: pixels_max });
        }
        let (view, columns) = (View::EMPTY, Columns::default());
        Ok(Self { pixel, pixels_max, view, columns, range: None, tolerance: 0.0 })
    }

    /// Largest distance of a reported triangle from the volume \[m\].
    #[must_use]
    pub fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Pixels of the image, across and down.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        self.view.size
    }

    /// Side of a pixel of the image \[m\]: as requested, or larger for a large volume.
    #[must_use]
    pub fn pixel(&self) -> f64 {
        self.view.pixel
    }

    /// Draws the volume that a surface encloses, seen along `direction` (of any length). For an open surface the volume
    /// is between each sheet and the closing sheet behind it, plus the sheets themselves.
    ///
    /// # Errors
    /// For a direction without length; the image is then empty.
    pub fn draw_surface(
        &mut self,
        surface: &Surface<'_>,
        direction: &Vector3<f64>,
    ) -> Result<(), ZBufferError> {
        self.clear();
        let away = direction.try_normalize(0.0).filter(|away| away.iter().all(|part| part.is_finite()));
        let away = away.ok_or(ZBufferError::Direction)?;
        let across = away.cross(&Vector3::ith(away.iamin(), 1.0)).normalize();
        let axes = [across, away.cross(&across), away];
        let corners = surface.triangles().iter().flatten().map(|&corner| surface.vertices()[corner as usize]);
        let Some(view) = View::around(axes, corners, 0.0, self.pixel, self.pixels_max) else { return Ok(()) };
        self.view = view;
        let Self { columns, .. } = self;
        for triangle in 0..surface.triangles().len() as u32 {
            let places = view.places(&surface.triangle(triangle));
            view.each_pixel(
                &places,
                |_| true,
                |pixel, part| {
                    if let Some(range) = part.range(2) {
                        columns.sheet(pixel, range);
                    }
                    let middle = [(pixel % view.size[0]) as f64 + 0.5, (pixel / view.size[0]) as f64 + 0.5];
                    if let Some((depth, into)) = middle_depth(&places, middle) {
                        columns.pass(pixel, depth, into);
                    }
                },
            );
        }
        self.finish(std::f64::consts::SQRT_2 * view.pixel);
        Ok(())
    }

    /// Draws the volume that a shaft sweeps over between two frames, seen across the plane of its motion.
    pub fn draw_shaft(&mut self, shaft: &ShaftSweep) {
        self.clear();
        let (slices, bulge) = shaft.slices(0.25 * self.pixel);
        let ends = |slice: usize| shaft.at(slice as f64 / slices as f64);
        let radius = shaft.radius() + bulge;
        let points = (0..=slices).flat_map(ends);
        let Some(view) = View::around(shaft.axes(), points, radius, self.pixel, self.pixels_max) else {
            return;
        };
        self.view = view;
        let mut thickness = 0.0_f64;
        let mut slack = 0.0_f64;
        for slice in 0..slices {
            let ([port, tip], [next_port, next_tip]) = (ends(slice), ends(slice + 1));
            let corners = [port, tip, next_tip, next_port].map(|point| view.place(&point));
            let depths = corners.iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[near, far], corner| {
                [near.min(corner[2]), far.max(corner[2])]
            });
            thickness = thickness.max(depths[1] - depths[0]);
            let twist = (next_tip - next_port) - (tip - port);
            slack = slack.max((next_port - port).norm().min(0.25 * twist.norm()));
            self.draw_slice(&corners, depths, radius);
        }
        self.finish(std::f64::consts::SQRT_2 * view.pixel + bulge + slack + thickness);
    }

    /// Draws all points within `radius` \[m\] of the hull of four image points between two depths.
    fn draw_slice(&mut self, corners: &[ImagePoint; 4], [near, far]: [f64; 2], radius: f64) {
        let Self { view, columns, .. } = self;
        // No point of a pixel is nearer than its centre by more than half of its diagonal.
        let diagonal = std::f64::consts::FRAC_1_SQRT_2 * (1.0 + 1e-9);
        let reach = radius / view.pixel + diagonal;
        let down = range_between(corners, 1, [f64::NEG_INFINITY, f64::INFINITY]);
        let Some([top, bottom]) = down.and_then(|[low, high]| view.span(1, low - reach, high + reach)) else {
            return;
        };
        for row in top..=bottom {
            let strip = [row as f64 - reach, (row + 1) as f64 + reach];
            let across = range_between(corners, 0, strip);
            let Some([left, right]) = across.and_then(|[low, high]| view.span(0, low - reach, high + reach))
            else {
                continue;
            };
            for column in left..=right {
                let middle = [column as f64 + 0.5, row as f64 + 0.5];
                // No point of a pixel is nearer than its centre by more than half of its diagonal.
                let apart =
                    distance_to_hull(corners, middle) - std::f64::consts::FRAC_1_SQRT_2 * (1.0 + 1e-9);
                let apart = apart.max(0.0) * view.pixel;
                if apart <= radius {
                    let half = (radius * radius - apart * apart).max(0.0).sqrt();
                    columns.sheet(row * view.size[0] + column, [near - half, far + half]);
                }
            }
        }
    }

    /// Adds the triangles of a surface that intersect the volume, in their order.
    pub fn hits(&self, surface: &Surface<'_>, hits: &mut Vec<VolumeHit>) {
        let Some([nearest, farthest]) = self.range else { return };
        for triangle in 0..surface.triangles().len() as u32 {
            let places = self.view.places(&surface.triangle(triangle));
            let depths = places.map(|place| place[2]);
            let is_beside =
                depths.iter().all(|depth| *depth < nearest) || depths.iter().all(|depth| *depth > farthest);
            if !is_beside {
                hits.extend(self.hit(triangle, &places));
            }
        }
    }

    fn hit(&self, triangle: u32, places: &[ImagePoint; 3]) -> Option<VolumeHit> {
        let mut found: Option<VolumeHit> = None;
        let mut longest = f64::NEG_INFINITY;
        let is_filled = |pixel: usize| !self.columns.layers(pixel).is_empty();
        self.view.each_pixel(places, is_filled, |pixel, part| {
            let layers = self.columns.layers(pixel);
            let Some([near, far]) = part.range(2) else { return };
            let mut is_hit = false;
            for [entry, exit] in layers {
                let common = [near.max(*entry), far.min(*exit)];
                if common[0] > common[1] {
                    continue;
                }
                let Some(place) = part.clipped(2, common[0], common[1]).middle() else { continue };
                let point = self.view.point(&place);
                let base = self.view.axes[2].dot(&self.view.origin.coords);
                let depths = common.map(|depth| base + depth);
                let hit = found.get_or_insert(VolumeHit { triangle, pixels: 0, depths, point });
                hit.depths = [hit.depths[0].min(depths[0]), hit.depths[1].max(depths[1])];
                hit.pixels += u32::from(!is_hit);
                is_hit = true;
                if common[1] - common[0] > longest {
                    longest = common[1] - common[0];
                    hit.point = point;
                }
            }
        });
        found
    }

    fn clear(&mut self) {
        self.columns.clear();
        (self.view, self.range, self.tolerance) = (View::EMPTY, None, 0.0);
    }

    fn finish(&mut self, tolerance: f64) {
        self.columns.finish(self.view.size.iter().product());
        self.range = self.columns.range();
        self.tolerance = tolerance;
    }
}

/// The edges and diagonals of the hull of four points.
const EDGES: [[usize; 2]; 6] = [[0, 1], [1, 2], [2, 3], [3, 0], [0, 2], [1, 3]];

/// Range on one image axis of the part of the hull of four points between two bounds on the other axis (of all of it
/// for infinite bounds).
fn range_between(corners: &[ImagePoint; 4], axis: usize, [low, high]: [f64; 2]) -> Option<[f64; 2]> {
    let other = 1 - axis;
    let mut range: Option<[f64; 2]> = None;
    for [from, to] in EDGES.map(|edge| edge.map(|corner| corners[corner])) {
        let [first, last] = if from[other] <= to[other] { [from, to] } else { [to, from] };
        if last[other] < low || first[other] > high {
            continue;
        }
        let length = last[other] - first[other];
        for bound in [low.max(first[other]), high.min(last[other])] {
            let share = if length > 0.0 { (bound - first[other]) / length } else { 0.0 };
            let ends = if length > 0.0 {
                [first[axis] + (last[axis] - first[axis]) * share; 2]
            } else {
                [first[axis].min(last[axis]), first[axis].max(last[axis])]
            };
            let [least, most] = range.unwrap_or(ends);
            range = Some([least.min(ends[0]), most.max(ends[1])]);
        }
    }
    range
}

/// Distance of an image point from the hull of four points, in pixels; 0 inside.
fn distance_to_hull(corners: &[ImagePoint; 4], middle: [f64; 2]) -> f64 {
    let from = |corner: &ImagePoint| [corner[0] - middle[0], corner[1] - middle[1]];
    let [a, b, c, d] = corners.each_ref().map(from);
    let cross = |p: [f64; 2], q: [f64; 2]| p[0] * q[1] - p[1] * q[0];
    let within = |p: [f64; 2], q: [f64; 2], r: [f64; 2]| {
        let sides = [cross(p, q), cross(q, r), cross(r, p)];
        sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0)
    };
    if within(a, b, c) && !is_flat(a, b, c) || within(a, c, d) && !is_flat(a, c, d) {
        return 0.0;
    }
    if within(a, b, d) && !is_flat(a, b, d) || within(b, c, d) && !is_flat(b, c, d) {
        return 0.0;
    }
    let places = [a, b, c, d];
    EDGES.iter().map(|[from, to]| distance_to_edge(places[*from], places[*to])).fold(f64::INFINITY, f64::min)
}

/// Three collinear points would contain their whole line, not only the part between them.
fn is_flat(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> bool {
    (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]) == 0.0
}

fn distance_to_edge(from: [f64; 2], to: [f64; 2]) -> f64 {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length_squared = along[0] * along[0] + along[1] * along[1];
    let share = -(from[0] * along[0] + from[1] * along[1]) / length_squared;
    let share = if length_squared > 0.0 { share.clamp(0.0, 1.0) } else { 0.0 };
    (from[0] + along[0] * share).hypot(from[1] + along[1] * share)
}
