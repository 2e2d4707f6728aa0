//! Local spherical hash: collision detection of deforming bodies.
//!
//! After Maule, Maciel, Nedel (*Efficient collision detection and physics-based deformation for haptic simulation with
//! local spherical hash*, 2010): each deformable body is wrapped into a sphere of its own, in which its parts are
//! rehashed as it deforms, so that the cost of one query does not grow with the number of vertices. Only the idea is
//! from the paper (its abstract and first figure); the implementation is ours:
//!
//! - Directions are cells of a cube around the centre, which has no poles; a triangle is stored in *every* cell that it
//!   overlaps, so that no contact is lost between cells, large and thin triangles included.
//! - Bodies need not be star-shaped: each direction is divided into layers of radius, and any number of sheets may lie
//!   behind each other. The position of the centre affects only the cost.
//! - Cells only give candidates. Exact tests of primitives in `f64` decide.
//! - A point's inside test counts the sheets that the ray from the centre through it crosses further out, in one column
//!   of cells, as a winding number (open and inverted surfaces count by what they enclose). If the ray hits an edge, a
//!   ray beside it is used, and finally the solid angles of all triangles (Van Oosterom, Strackee 1983).
//!
//! Filling the table costs about as much as a query, and no state is kept across fillings, so that a body may deform,
//! be cut and be remeshed at any time.

mod inside;
mod table;

use nalgebra::{Point3, Vector3};

use crate::line::Line;
use crate::part::Part;
use crate::primitive::{
    Triangle, closest_on_triangle, closest_segment_triangle, segment_triangle_penetration,
    triangle_penetration,
};
use crate::surface::{Surface, SurfaceError, check_finite};
use crate::uniform_grid::Box3;
use table::Table;

/// A contact of a hashed body `a` and another one `b`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SphericalContact {
    /// Part of the first body.
    pub a: Part,
    /// Part of the second body.
    pub b: Part,
    /// Points on each \[m\]: the nearest points of the two parts (for spheres and tubes: of their centres and axes), or
    /// for both the middle of their intersection.
    pub points: [Point3<f64>; 2],
    /// Depth \[m\]. Of a sphere or vertex: its radius plus the depth of its centre, which is the distance to the
    /// nearest surface point. Of a tube's segment and a triangle: the radius minus the distance of the axis; if the
    /// axis crosses, the radius plus the minimum translation that separates axis and triangle. Of two triangles: the
    /// minimum translation that separates them.
    pub depth: f64,
    /// Unit direction from the first body to the second: a translation of the second part along it by the depth ends
    /// the contact.
    pub direction: Vector3<f64>,
}

impl SphericalContact {
    /// The same, seen from the other body.
    #[must_use]
    pub fn swapped(&self) -> Self {
        let [p, q] = self.points;
        Self { a: self.b, b: self.a, points: [q, p], direction: -self.direction, depth: self.depth }
    }
}

/// The nearest surface point of a hashed body.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfacePlace {
    /// Its triangle.
    pub triangle: u32,
    /// The point \[m\].
    pub point: Point3<f64>,
    /// Depth of the query point below the surface \[m\]; negative outside.
    pub depth: f64,
    /// Unit direction out of the body.
    pub outwards: Vector3<f64>,
}

/// A body's surface hashed by direction and distance from its centre. Buffers are reused: refills and queries of
/// similar size do not allocate.
#[derive(Clone, Debug, Default)]
pub struct SphericalHash {
    table: Table,
    triangles: Vec<Triangle>,
    vertices: Vec<(u32, Point3<f64>)>,
    bounds: Bounds,
    /// 1 for triangles counter-clockwise seen from outside, -1 for an inverted surface.
    orientation: f64,
    seen: VisitedTriangles,
}

#[derive(Clone, Copy, Debug)]
struct Bounds(Box3);

impl Default for Bounds {
    fn default() -> Self {
        Self(Box3::EMPTY)
    }
}

/// Triangles visited by one query.
#[derive(Clone, Debug, Default)]
struct VisitedTriangles {
    stamps: Vec<u32>,
    stamp: u32,
}

impl VisitedTriangles {
    fn resize(&mut self, count: usize) {
        self.stamps.clear();
        self.stamps.resize(count, 0);
        self.stamp = 0;
    }

    fn restart(&mut self) {
        if self.stamp == u32::MAX {
            self.resize(self.stamps.len());
        }
        self.stamp += 1;
    }

    fn is_new(&mut self, index: u32) -> bool {
        let stamp = &mut self.stamps[index as usize];
        std::mem::replace(stamp, self.stamp) != self.stamp
    }
}

impl SphericalHash {
    /// An empty hash, without collisions.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Hashes a body in its current state; replaces earlier content.
    pub fn rebuild(&mut self, surface: &Surface<'_>) {
        let vertices = surface.vertices();
        self.triangles.clear();
        self.triangles.extend(
            surface.triangles().iter().map(|corners| corners.map(|corner| vertices[corner as usize])),
        );
        self.seen.resize(vertices.len());
        self.seen.restart();
        self.vertices.clear();
        for &corner in surface.triangles().iter().flatten() {
            if self.seen.is_new(corner) {
                self.vertices.push((corner, vertices[corner as usize]));
            }
        }
        self.seen.resize(self.triangles.len());
        self.bounds = Bounds(Box3::of(self.vertices.iter().map(|(_, vertex)| vertex)));
        let centre = nalgebra::center(&self.bounds.0.min, &self.bounds.0.max);
        self.table.rebuild(if self.vertices.is_empty() { Point3::origin() } else { centre }, &self.triangles);
        let six_volumes = |[a, b, c]: &Triangle| (a - centre).cross(&(b - centre)).dot(&(c - centre));
        let volume: f64 = self.triangles.iter().map(six_volumes).sum();
        self.orientation = if volume < 0.0 { -1.0 } else { 1.0 };
    }

    /// The surface point nearest to a point, if the point is inside, or outside within `reach` \[m\] above 0. `None`
    /// for a non-finite point.
    pub fn place(&mut self, point: &Point3<f64>, reach: f64) -> Option<SurfacePlace> {
        if !self.bounds.0.grown(reach).overlaps(&Box3::of([point])) {
            return None;
        }
        let inside = self.inside(point);
        if inside.is_none() && reach <= 0.0 {
            return None;
        }
        let limit = inside.map_or(reach, |within| within + 1e-9 * self.size());
        let (triangle, nearest) = self.nearest(point, limit)?;
        let between = if inside.is_some() { nearest - point } else { point - nearest };
        let distance = between.norm();
        // For points on the surface the difference is only rounding.
        let outwards =
            if distance > 1e-12 * self.size() { between / distance } else { self.normal(triangle) };
        let depth = if inside.is_some() { distance } else { -distance };
        Some(SurfacePlace { triangle, point: nearest, depth, outwards })
    }

    /// Adds the contacts of spheres, or of the vertices of another body with `radius` 0: those whose centre is inside or
    /// nearer to the surface than `radius` \[m\].
    ///
    /// # Errors
    /// For the first non-finite centre; nothing is added then.
    pub fn spheres(
        &mut self,
        centres: &[Point3<f64>],
        radius: f64,
        contacts: &mut Vec<SphericalContact>,
    ) -> Result<(), SurfaceError> {
        check_finite(centres)?;
        for (centre, index) in centres.iter().zip(0..) {
            contacts.extend(self.sphere(index, centre, radius));
        }
        Ok(())
    }

    fn sphere(&mut self, index: u32, centre: &Point3<f64>, radius: f64) -> Option<SphericalContact> {
        self.place(centre, radius).map(|place| SphericalContact {
            a: Part::Triangle(place.triangle),
            b: Part::Vertex(index),
            points: [place.point, *centre],
            depth: radius + place.depth,
            direction: place.outwards,
        })
    }

    /// Adds the contacts of a line's segments with triangles nearer than the radius. Segments entirely inside touch no
    /// triangle: query the [`spheres`](Self::spheres) of their vertices as well.
    pub fn line(&mut self, line: &Line<'_>, contacts: &mut Vec<SphericalContact>) {
        let Self { table, triangles, seen, bounds, .. } = self;
        let radius = line.radius();
        for index in 0..line.segments().len() as u32 {
            let segment = line.segment(index);
            let around = Box3::of(&segment).grown(radius);
            if !around.overlaps(&bounds.0) {
                continue;
            }
            let first = contacts.len();
            seen.restart();
            table.around(&around, |triangle| {
                let corners = &triangles[triangle as usize];
                if !seen.is_new(triangle) || !Box3::of(corners).overlaps(&around) {
                    return;
                }
                let found = closest_segment_triangle(&segment, corners);
                let distance = found.distance_squared.sqrt();
                if distance > radius {
                    return;
                }
                let (depth, direction) = if distance > 0.0 {
                    (radius - distance, (found.on_segment - found.on_triangle) / distance)
                } else {
                    let overlap = segment_triangle_penetration(&segment, corners);
                    let (depth, direction) =
                        overlap.map_or((0.0, unit_normal(corners)), |o| (o.depth, -o.direction));
                    (radius + depth, direction)
                };
                contacts.push(SphericalContact {
                    a: Part::Triangle(triangle),
                    b: Part::Segment(index),
                    points: [found.on_triangle, found.on_segment],
                    depth,
                    direction,
                });
            });
            contacts[first..].sort_unstable_by_key(|contact| contact.a);
        }
    }

    /// Adds the pairs of triangles of both bodies that cross or touch.
    pub fn triangles(&mut self, other: &Surface<'_>, contacts: &mut Vec<SphericalContact>) {
        for index in 0..other.triangles().len() as u32 {
            self.triangle(index, &other.triangle(index), contacts);
        }
    }

    fn triangle(&mut self, index: u32, other: &Triangle, contacts: &mut Vec<SphericalContact>) {
        let Self { table, triangles, seen, bounds, .. } = self;
        let around = Box3::of(other);
        if !around.overlaps(&bounds.0) {
            return;
        }
        let first = contacts.len();
        seen.restart();
        table.around(&around, |triangle| {
            let corners = &triangles[triangle as usize];
            if !seen.is_new(triangle) || !Box3::of(corners).overlaps(&around) {
                return;
            }
            if let Some(overlap) = triangle_penetration(corners, other) {
                let middle = middle_of_common(corners, other);
                contacts.push(SphericalContact {
                    a: Part::Triangle(triangle),
                    b: Part::Triangle(index),
                    points: [middle; 2],
                    depth: overlap.depth,
                    direction: overlap.direction,
                });
            }
        });
        contacts[first..].sort_unstable_by_key(|contact| contact.a);
    }

    /// Adds all contacts with another hashed body: vertices of either that are inside the other or nearer to its surface
    /// than `separation` \[m\], and pairs of triangles that cross.
    pub fn bodies(&mut self, other: &mut Self, separation: f64, contacts: &mut Vec<SphericalContact>) {
        let near = |of: &Bounds| of.0.grown(separation);
        let (ours, theirs) = (near(&self.bounds), near(&other.bounds));
        if !ours.overlaps(&theirs) {
            return;
        }
        for place in 0..other.vertices.len() {
            let (index, vertex) = other.vertices[place];
            contacts.extend(self.sphere(index, &vertex, separation));
        }
        for place in 0..self.vertices.len() {
            let (index, vertex) = self.vertices[place];
            contacts.extend(other.sphere(index, &vertex, separation).map(|contact| contact.swapped()));
        }
        for index in 0..other.triangles.len() {
            self.triangle(index as u32, &other.triangles[index], contacts);
        }
    }

    /// The nearest triangle within `limit`, and the point on it.
    fn nearest(&mut self, point: &Point3<f64>, limit: f64) -> Option<(u32, Point3<f64>)> {
        let Self { table, triangles, seen, .. } = self;
        let from_centre = (point - table.centre).norm();
        let mut reach = table.width(from_centre).min(limit);
        loop {
            let mut best: Option<(f64, u32, Point3<f64>)> = None;
            seen.restart();
            table.around(&Box3::of([point]).grown(reach), |triangle| {
                let [near, far] = table.radii(triangle);
                let least = (near - from_centre).max(from_centre - far);
                if !seen.is_new(triangle) || best.is_some_and(|(distance, ..)| least > distance) {
                    return;
                }
                let found = closest_on_triangle(point, &triangles[triangle as usize]).point;
                let distance = (found - point).norm();
                if best.is_none_or(|(other, index, _)| (distance, triangle) < (other, index)) {
                    best = Some((distance, triangle, found));
                }
            });
            match best {
                Some((distance, triangle, found)) if distance <= reach => return Some((triangle, found)),
                _ if reach >= limit => return None,
                // At the centre, where the cell width is zero, the search uses the limit at once.
                _ => reach = if reach > 0.0 { (2.0 * reach).min(limit) } else { limit },
            }
        }
    }

    fn size(&self) -> f64 {
        (self.bounds.0.max - self.bounds.0.min).amax()
    }

    fn normal(&self, triangle: u32) -> Vector3<f64> {
        unit_normal(&self.triangles[triangle as usize]) * self.orientation
    }
}

fn unit_normal([a, b, c]: &Triangle) -> Vector3<f64> {
    (b - a).cross(&(c - a)).try_normalize(0.0).unwrap_or_else(Vector3::z)
}

/// The midpoint of the edge–triangle intersections of two triangles; if rounding misses them, the midpoint of the
/// nearest points.
fn middle_of_common(first: &Triangle, second: &Triangle) -> Point3<f64> {
    let (mut sum, mut count) = (Vector3::zeros(), 0.0);
    let (mut nearest, mut distance) = (first[0], f64::INFINITY);
    for (of, other) in [(first, second), (second, first)] {
        for corner in 0..3 {
            let found = closest_segment_triangle(&[of[corner], of[(corner + 1) % 3]], other);
            if found.distance_squared == 0.0 {
                sum += found.on_triangle.coords;
                count += 1.0;
            }
            if found.distance_squared < distance {
                (nearest, distance) =
                    (nalgebra::center(&found.on_segment, &found.on_triangle), found.distance_squared);
            }
        }
    }
    if count > 0.0 { Point3::from(sum / count) } else { nearest }
}
