//! Closest points, regularised to depend continuously on the shapes: on parallel segments any pair along the overlap is
//! closest, and a pair that jumped from end to end would lose the contact's memory.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_collision::primitive::{closest_on_segment, closest_segment_triangle};

use super::{Motion, Shape};

/// Weight of the preference for the middle, relative to the squared length.
const CENTRING: f64 = 5e-3;

/// Parameters of the closest points of two segments, 0 to 1, with a slight preference for their middles: the unique
/// minimum of a strictly convex function, by exact coordinate minimisation.
#[inline]
pub(crate) fn nearest_segments(first: &[Point3<f64>; 2], second: &[Point3<f64>; 2]) -> [f64; 2] {
    let (d1, d2, r) = (first[1] - first[0], second[1] - second[0], first[0] - second[0]);
    let (a, e, b) = (d1.norm_squared(), d2.norm_squared(), d1.dot(&d2));
    let (c, f) = (d1.dot(&r), d2.dot(&r));
    let pull = CENTRING * a.min(e);
    let (aa, ee) = (a + pull, e + pull);
    let (cc, ff) = (c - 0.5 * pull, f + 0.5 * pull);
    // Stationary where aa·s − b·t = −cc and ee·t − b·s = ff.
    let determinant = aa * ee - b * b;
    let mut s = ((b * ff - cc * ee) / determinant).clamp(0.0, 1.0);
    let mut t = ((b * s + ff) / ee).clamp(0.0, 1.0);
    for _ in 0..3 {
        s = ((b * t - cc) / aa).clamp(0.0, 1.0);
        t = ((b * s + ff) / ee).clamp(0.0, 1.0);
    }
    [s, t]
}

/// The closest point of an obstacle to an edge of the thread.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ObstaclePoint {
    /// Parameter along the edge, 0 to 1.
    pub along: f64,
    /// Unit normal from the obstacle to the edge, in the world.
    pub normal: Vector3<f64>,
    /// Distance of the centre line from the obstacle's surface; negative inside \[m\].
    pub distance: f64,
    /// The material point of the obstacle's surface, at the beginning and at the end of the substep \[m\].
    pub surface: [Point3<f64>; 2],
}

/// The closest point of `shape` (of triangle `feature`, for a mesh) at the end of `motion` to `edge`, in the world.
/// `end` selects the end of the edge for a half-space.
pub(crate) fn nearest_on_obstacle(
    shape: &Shape,
    motion: &Motion,
    feature: u32,
    edge: &[Point3<f64>; 2],
) -> Option<ObstaclePoint> {
    let local = edge.map(|point| motion.to.inverse_transform_point(&point));
    let rigid = |along: f64, normal: Vector3<f64>, distance: f64, surface: Point3<f64>| ObstaclePoint {
        along,
        normal: motion.to.rotation * normal,
        distance,
        surface: [motion.from * surface, motion.to * surface],
    };
    match shape {
        Shape::Sphere { radius } => {
            let along = closest_on_segment(&Point3::origin(), &local);
            let place = local[0].coords.lerp(&local[1].coords, along);
            let normal = place.try_normalize(1e-12)?;
            Some(rigid(along, normal, place.norm() - radius, Point3::from(normal * *radius)))
        }
        Shape::Capsule { ends, radius } => {
            let [along, on] = nearest_segments(&local, ends);
            let (place, core) =
                (local[0].coords.lerp(&local[1].coords, along), ends[0].coords.lerp(&ends[1].coords, on));
            let between = place - core;
            let normal = between.try_normalize(1e-12)?;
            Some(rigid(along, normal, between.norm() - radius, Point3::from(core + normal * *radius)))
        }
        Shape::HalfSpace { normal } => {
            // Feature 0 is the first end of the edge, 1 the second.
            let along = f64::from(feature.min(1));
            let place = local[feature.min(1) as usize];
            let distance = place.coords.dot(normal);
            Some(rigid(along, *normal, distance, place - normal * distance))
        }
        Shape::Mesh { from, to, triangles, radius } => {
            let corners = triangles.get(feature as usize)?.map(|corner| corner as usize);
            let at = |pose: &Isometry3<f64>, fraction: f64| {
                corners.map(|k| pose * Point3::from(from[k].coords.lerp(&to[k].coords, fraction)))
            };
            let triangle = at(&motion.to, motion.fractions[1]);
            let found = closest_segment_triangle(edge, &triangle);
            let between = found.on_segment - found.on_triangle;
            let normal = between.try_normalize(1e-12)?;
            let before = at(&motion.from, motion.fractions[0]);
            let weights = found.weights;
            let place = |of: &[Point3<f64>; 3]| {
                Point3::from(
                    of[0].coords * weights[0] + of[1].coords * weights[1] + of[2].coords * weights[2],
                )
            };
            Some(ObstaclePoint {
                along: found.along,
                normal,
                distance: between.norm() - radius,
                surface: [place(&before), place(&triangle)],
            })
        }
    }
}

/// Of an edge that crosses triangle `feature` of a mesh at the end of `motion`, and was on the side of `away` before: its
/// end on the other side.
pub(crate) fn crossing_of_mesh(
    shape: &Shape,
    motion: &Motion,
    feature: u32,
    edge: &[Point3<f64>; 2],
    away: &Vector3<f64>,
) -> Option<ObstaclePoint> {
    let Shape::Mesh { from, to, triangles, radius } = shape else { return None };
    let corners = triangles.get(feature as usize)?.map(|corner| corner as usize);
    let at = |pose: &Isometry3<f64>, fraction: f64| {
        corners.map(|k| pose * Point3::from(from[k].coords.lerp(&to[k].coords, fraction)))
    };
    let [a, b, c] = at(&motion.to, motion.fractions[1]);
    let normal = (b - a).cross(&(c - a)).try_normalize(0.0)?;
    let normal = normal * normal.dot(away).signum();
    let heights = edge.map(|end| normal.dot(&(end - a)));
    let along = if heights[0] <= heights[1] { 0.0 } else { 1.0 };
    let (height, end) = if along == 0.0 { (heights[0], edge[0]) } else { (heights[1], edge[1]) };
    let touching = end - normal * height;
    let before = motion.from * motion.to.inverse_transform_point(&touching);
    Some(ObstaclePoint { along, normal, distance: height - radius, surface: [before, touching] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_collision::primitive::closest_segments;

    #[test]
    fn parallel_segments_are_nearest_in_the_middle_of_their_overlap() {
        let first = [Point3::new(0.0, 0.0, 0.0), Point3::new(1.0, 0.0, 0.0)];
        let second = [Point3::new(0.5, 0.3, 0.0), Point3::new(1.5, 0.3, 0.0)];
        let [s, t] = nearest_segments(&first, &second);
        assert!((s - 0.75).abs() < 0.02 && (t - 0.25).abs() < 0.02, "{s} {t}");
    }

    #[test]
    fn the_distance_is_hardly_more_than_the_least() {
        use rand::{Rng, SeedableRng};
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(4);
        for _ in 0..20_000 {
            let mut point = || {
                Point3::new(
                    random.random_range(-1.0..1.0_f64),
                    random.random_range(-1.0..1.0),
                    random.random_range(-1.0..1.0),
                )
            };
            let (first, second) = ([point(), point()], [point(), point()]);
            let [s, t] = nearest_segments(&first, &second);
            let between =
                first[0].coords.lerp(&first[1].coords, s) - second[0].coords.lerp(&second[1].coords, t);
            let least = closest_segments(&first, &second).distance_squared;
            let size = (first[1] - first[0]).norm_squared().min((second[1] - second[0]).norm_squared());
            assert!(between.norm_squared() <= least + CENTRING * size, "{first:?} {second:?}");
        }
    }
}
