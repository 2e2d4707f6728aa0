//! Surface of a rigid body for contact with soft ones: signed distance of points, and the points of its own that meet a
//! soft surface.

use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use trocar_collision::moving_surface::MovingSurface;
use trocar_collision::{Surface, pseudonormal};
use trocar_scene::shapes::{Detail, surface_of};
use trocar_scene::{Entity, Shape, Snapshot, SurfaceMesh, VertexPositions};

/// Maximum number of its points that are tested against soft surfaces.
const POINTS_MAX: usize = 512;
/// Edges longer than this fraction of its radius get points between their ends: a bar lies on what is below its middle.
const EDGE_MAX: f64 = 0.25;
/// Resolution of an analytic shape's surface.
const DETAIL: Detail = Detail { segments: 32, fine_segments: 8 };

/// A rigid body's surface, in its frame.
pub(crate) struct RigidSurface {
    surface: MovingSurface,
    /// Its vertices, and points along its longer edges \[m\].
    points: Vec<Point3<f64>>,
    /// Radius of the bounding sphere about its origin \[m\].
    reach: f64,
    source: Source,
}

/// What it was made from.
#[derive(Clone)]
enum Source {
    Shape(Shape),
    Mesh(Arc<Vec<Point3<f64>>>, Arc<Vec<[u32; 3]>>),
}

impl Source {
    fn is(&self, scene: &Snapshot, entity: Entity) -> bool {
        match (self, scene.get::<Shape>(entity)) {
            (Self::Shape(known), Some(shape)) => known == shape,
            (Self::Mesh(points, triangles), None) => {
                scene.get::<VertexPositions>(entity).is_some_and(|of| Arc::ptr_eq(&of.positions, points))
                    && scene
                        .get::<SurfaceMesh>(entity)
                        .is_some_and(|of| Arc::ptr_eq(&of.triangles, triangles))
            }
            _ => false,
        }
    }
}

/// The point of a surface nearest to another point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearestOnSurface {
    /// Signed distance, negative inside \[m\].
    pub distance: f64,
    /// Unit normal, outwards.
    pub outwards: Vector3<f64>,
    /// The nearest point \[m\], its triangle and its barycentric weights.
    pub point: Point3<f64>,
    pub triangle: u32,
    pub weights: [f64; 3],
}

/// The nearest point of a surface within `radius` \[m\]. `side` is a point on the side that counts as outside of an open
/// sheet; absent: the surface is closed, and its normals point outwards.
pub(crate) fn nearest_on(
    surface: &MovingSurface,
    at: &Point3<f64>,
    radius: f64,
    side: Option<&Point3<f64>>,
) -> Option<NearestOnSurface> {
    let geometry = surface.surface();
    let found = surface.tree().nearest_to_point(&geometry, at, radius).ok()??;
    let weights = found.nearest.weights;
    let face = pseudonormal(&geometry, surface.topology(), found.triangle, &weights)?.try_normalize(0.0)?;
    let face = match side {
        Some(side) if (side - found.nearest.point).dot(&face) < 0.0 => -face,
        _ => face,
    };
    let away = at - found.nearest.point;
    let is_inside = away.dot(&face) < 0.0;
    let away = if is_inside { -away } else { away };
    // On the surface only its normal has a direction.
    let outwards = away.try_normalize(1e-9).unwrap_or(face);
    Some(NearestOnSurface {
        distance: if is_inside { -found.distance } else { found.distance },
        outwards,
        point: found.nearest.point,
        triangle: found.triangle,
        weights,
    })
}

impl RigidSurface {
    /// The surface of a rigid body of the scene: its analytic shape, or else its mesh. `None` if it has neither.
    pub fn of(scene: &Snapshot, entity: Entity) -> Option<Self> {
        let (positions, triangles, source) = match scene.get::<Shape>(entity) {
            Some(shape) => {
                let made = surface_of(shape, &DETAIL).ok()?;
                (Arc::new(made.positions), Arc::new(made.triangles), Source::Shape(shape.clone()))
            }
            None => {
                let (mesh, points) =
                    (scene.get::<SurfaceMesh>(entity)?, scene.get::<VertexPositions>(entity)?);
                let (points, triangles) = (points.positions.clone(), mesh.triangles.clone());
                (points.clone(), triangles.clone(), Source::Mesh(points, triangles))
            }
        };
        let surface = Surface::new(&positions, &triangles).ok()?;
        let reach = triangles.iter().flatten().map(|&at| positions[at as usize].coords.norm());
        let reach = reach.fold(0.0, f64::max);
        let points = points_of(&positions, &triangles, EDGE_MAX * reach);
        Some(Self { surface: MovingSurface::new(&surface), points, reach, source })
    }

    /// Whether it is still that of the entity.
    pub fn is_of(&self, scene: &Snapshot, entity: Entity) -> bool {
        self.source.is(scene, entity)
    }

    /// Its vertices \[m\] and triangles.
    pub fn mesh(&self) -> (&[Point3<f64>], &[[u32; 3]]) {
        let surface = self.surface.surface();
        (surface.vertices(), surface.triangles())
    }

    /// Its points that are tested against soft surfaces \[m\].
    pub fn points(&self) -> &[Point3<f64>] {
        &self.points
    }

    /// Radius of the bounding sphere about its origin \[m\].
    pub fn reach(&self) -> f64 {
        self.reach
    }

    /// Its nearest point to a point in its frame, wherever that is.
    pub fn nearest(&self, at: &Point3<f64>) -> Option<NearestOnSurface> {
        nearest_on(&self.surface, at, 2.0 * (self.reach + at.coords.norm()), None)
    }
}

/// The vertices of triangles, and points between the ends of edges longer than `spacing` \[m\].
fn points_of(positions: &[Point3<f64>], triangles: &[[u32; 3]], spacing: f64) -> Vec<Point3<f64>> {
    let mut used: Vec<u32> = triangles.iter().flatten().copied().collect();
    used.sort_unstable();
    used.dedup();
    let mut points: Vec<Point3<f64>> = used.iter().map(|&vertex| positions[vertex as usize]).collect();
    let mut edges: Vec<[u32; 2]> = triangles
        .iter()
        .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]].map(|[a, b]| [a.min(b), a.max(b)]))
        .collect();
    edges.sort_unstable();
    edges.dedup();
    for [a, b] in edges {
        let (a, b) = (positions[a as usize], positions[b as usize]);
        let parts = ((b - a).norm() / spacing.max(f64::MIN_POSITIVE)).ceil().min(POINTS_MAX as f64) as u32;
        points.extend((1..parts).map(|part| a.lerp(&b, f64::from(part) / f64::from(parts))));
    }
    // Of too many, evenly many: neighbours follow each other.
    if points.len() > POINTS_MAX {
        let all = points.len();
        points = (0..POINTS_MAX).map(|index| points[index * all / POINTS_MAX]).collect();
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_points_of_a_bar_lie_along_its_edges_too() {
        let bar = surface_of(&Shape::Box { half_extents: [0.05, 0.002, 0.002] }, &DETAIL).expect("a box");
        let points = points_of(&bar.positions, &bar.triangles, 0.01);
        let along = |from: f64, to: f64| points.iter().filter(|at| at.x > from && at.x < to).count();
        for tenth in 0..10 {
            let from = -0.05 + 0.01 * f64::from(tenth);
            assert!(along(from - 1e-9, from + 0.01 + 1e-9) >= 4, "{tenth}: {points:?}");
        }
        assert!(points.len() <= POINTS_MAX);
    }

    #[test]
    fn a_distance_is_signed_inside_and_outside_and_beyond_an_edge() {
        let cube = surface_of(&Shape::Box { half_extents: [0.01; 3] }, &DETAIL).expect("a box");
        let surface = Surface::new(&cube.positions, &cube.triangles).expect("a surface");
        let surface = MovingSurface::new(&surface);
        for (at, expected) in [
            ([0.0, 0.0, 0.008], -0.002),
            ([0.0, 0.0, 0.013], 0.003),
            ([0.013, 0.0, 0.014], 0.005),
            ([0.004, 0.003, 0.01], 0.0),
        ] {
            let found = nearest_on(&surface, &Point3::from(at), 1.0, None).expect("a point");
            assert!((found.distance - expected).abs() < 1e-12, "{at:?}: {found:?}");
        }
        // Of an open sheet the side decides.
        let sheet = Surface::new(&cube.positions, &cube.triangles[..2]).expect("a surface");
        let sheet = MovingSurface::new(&sheet);
        let [a, b, c] = cube.triangles[0].map(|at| cube.positions[at as usize]);
        let normal = (b - a).cross(&(c - a)).normalize();
        let middle = nalgebra::center(&a, &nalgebra::center(&b, &c));
        for side in [1.0, -1.0] {
            let body = middle + normal * (0.02 * side);
            let through = middle - normal * (0.001 * side);
            let found = nearest_on(&sheet, &through, 1.0, Some(&body)).expect("a point");
            assert!((found.distance + 0.001).abs() < 1e-12 && found.outwards.dot(&normal) * side > 0.99);
        }
    }
}
