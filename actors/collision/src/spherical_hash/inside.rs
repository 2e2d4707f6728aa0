//! Inside test for a hashed body: counts the sheets crossed further out by the ray from the centre through the point.

use nalgebra::{Point3, Vector3};

use super::SphericalHash;
use crate::primitive::Triangle;

/// Share of the product of lengths below which a triple product has no certain sign.
const UNCERTAIN: f64 = 1e-13;

/// Offset of alternative rays from an uncertain one, as a share of the body's size.
const ASIDE: f64 = 1e-9;
/// Offset directions: none first, then directions that do not occur in regular meshes.
const OFFSETS: [[f64; 3]; 4] = [[0.0; 3], [0.31, 0.57, -0.76], [-0.83, 0.11, 0.54], [0.19, -0.92, 0.34]];

/// Intersection of a ray with one triangle.
enum RayCrossing {
    Missed,
    /// At this distance from the centre, going out of the surface (1) or into it (-1).
    Met(f64, i32),
    /// Too near to an edge to decide.
    Uncertain,
}

impl SphericalHash {
    /// Upper bound of the distance from an inside point to the surface \[m\]; `None` for a point outside.
    pub(super) fn inside(&mut self, point: &Point3<f64>) -> Option<f64> {
        // In regular meshes many rays hit edges and vertices exactly. Rays beside them give the same result for all
        // points farther from the surface than the offset.
        let aside = ASIDE * self.size();
        for offset in OFFSETS {
            if let Some((winding, within)) = self.winding(&(point + Vector3::from(offset) * aside)) {
                return (winding != 0).then_some(within + 2.0 * aside);
            }
        }
        let angles: f64 = self.triangles.iter().map(|triangle| solid_angle(point, triangle)).sum();
        (angles.abs() > std::f64::consts::TAU).then(|| self.size() * 2.0)
    }

    /// Winding number of the surface around a point, and the distance to it along the ray; `None` if uncertain.
    fn winding(&mut self, point: &Point3<f64>) -> Option<(i32, f64)> {
        let size = self.size();
        let Self { table, triangles, seen, .. } = self;
        let from_centre = point - table.centre;
        let radius = from_centre.norm();
        // At the centre any direction is valid.
        let direction =
            if radius > 1e-12 * size { from_centre / radius } else { Vector3::new(0.48, 0.6, 0.64) };
        let (mut winding, mut within, mut is_certain) = (0, f64::INFINITY, true);
        seen.restart();
        table.along(&direction, radius, |triangle| {
            if table.radii(triangle)[1] < radius || !seen.is_new(triangle) {
                return;
            }
            match meeting(&direction, &triangles[triangle as usize].map(|corner| corner - table.centre)) {
                RayCrossing::Met(at, sign) if at > radius => {
                    winding += sign;
                    within = within.min(at - radius);
                }
                RayCrossing::Met(..) | RayCrossing::Missed => {}
                RayCrossing::Uncertain => is_certain = false,
            }
        });
        is_certain.then_some((winding, within))
    }
}

fn meeting(direction: &Vector3<f64>, [a, b, c]: &[Vector3<f64>; 3]) -> RayCrossing {
    let products = [a.cross(b), b.cross(c), c.cross(a)];
    let signs = products.map(|product| direction.dot(&product));
    let certain = UNCERTAIN * a.norm_squared().max(b.norm_squared()).max(c.norm_squared());
    if signs.iter().any(|sign| *sign > certain) && signs.iter().any(|sign| *sign < -certain) {
        return RayCrossing::Missed;
    }
    let normal = products[0] + products[1] + products[2];
    // A triangle without area encloses nothing.
    if normal == Vector3::zeros() {
        return RayCrossing::Missed;
    }
    let ahead = signs[0] + signs[1] + signs[2];
    let at = normal.dot(a) / ahead;
    if signs.iter().any(|sign| sign.abs() <= certain) {
        // On the line of an edge, but behind the centre: no outward ray hits it.
        return if at < 0.0 && ahead.abs() > certain { RayCrossing::Missed } else { RayCrossing::Uncertain };
    }
    if at > 0.0 { RayCrossing::Met(at, if ahead > 0.0 { 1 } else { -1 }) } else { RayCrossing::Missed }
}

/// The solid angle under which a triangle is seen, positive from inside \[sr\].
fn solid_angle(point: &Point3<f64>, triangle: &Triangle) -> f64 {
    let [a, b, c] = triangle.map(|corner| corner - point);
    let (x, y, z) = (a.norm(), b.norm(), c.norm());
    let height = a.dot(&b.cross(&c));
    let base = x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y;
    2.0 * height.atan2(base)
}
