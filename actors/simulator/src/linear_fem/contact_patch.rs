//! Contact patches: loads and grasps on a finite area. The displacement under a point load diverges as the mesh is
//! refined; the mean displacement of a patch of given size converges.

use nalgebra::Point3;
use thiserror::Error;
use trocar_collision::primitive::closest_on_triangle;

use super::attachment::WEIGHTS_MAX;

/// Why there is no patch.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum PatchError {
    /// A non-finite point or radius.
    #[error("a patch at {center} of radius {radius} m: finite coordinates and a radius above 0 are valid")]
    NotFinite {
        /// Centre \[m\].
        center: Point3<f64>,
        /// Radius \[m\].
        radius: f64,
    },
    /// No surface within the radius.
    #[error("the surface is {distance} m from the middle of a patch of radius {radius} m: it is to be less")]
    TooFar {
        /// Distance to the surface \[m\].
        distance: f64,
        /// Radius of the patch \[m\].
        radius: f64,
    },
    /// More nodes than an attachment can have.
    #[error("a patch of radius {radius} m covers {nodes} nodes: at most {WEIGHTS_MAX} are valid")]
    TooLarge {
        /// Radius of the patch \[m\].
        radius: f64,
        /// Its number of nodes.
        nodes: usize,
    },
}

/// Maximum number of pieces per triangle edge for the integration.
const CUTS_MAX: usize = 24;

/// Surface nodes of a patch around a point of the rest shape \[m\], with weights that add up to 1: those of a pressure
/// 1 − (r/R)² at distance r from the centre (and of the mean displacement weighted by it), integrated over the
/// triangles connected to the nearest one. Sorted by node.
///
/// # Errors
/// Non-finite numbers, no surface there, too many nodes.
pub fn patch(
    rest: &[Point3<f64>],
    surface: &[[u32; 3]],
    center: &Point3<f64>,
    radius: f64,
) -> Result<Vec<(u32, f64)>, PatchError> {
    if !(radius > 0.0 && radius.is_finite() && center.iter().all(|x| x.is_finite())) {
        return Err(PatchError::NotFinite { center: *center, radius });
    }
    let corners = |triangle: &[u32; 3]| triangle.map(|node| rest[node as usize]);
    let mut near = Vec::new();
    let (mut nearest, mut least) = (None, f64::INFINITY);
    for triangle in surface {
        let distance = (closest_on_triangle(center, &corners(triangle)).point - center).norm();
        if distance < least {
            (least, nearest) = (distance, Some(near.len()));
        }
        if distance < radius {
            near.push(*triangle);
        }
    }
    let Some(first) = nearest.filter(|_| least < radius) else {
        return Err(PatchError::TooFar { distance: least, radius });
    };
    // The far side of a thin part is near, but not part of the patch.
    let mut joined = vec![false; near.len()];
    joined[first] = true;
    let mut open = vec![first];
    while let Some(own) = open.pop() {
        for other in 0..near.len() {
            let common = near[other].iter().filter(|node| near[own].contains(node)).count();
            if !joined[other] && common == 2 {
                joined[other] = true;
                open.push(other);
            }
        }
    }
    let mut shares: Vec<(u32, f64)> = Vec::new();
    let mut total = 0.0;
    for (triangle, _) in near.iter().zip(joined).filter(|(_, joined)| *joined) {
        for (node, share) in triangle.iter().zip(integrate(&corners(triangle), center, radius)) {
            shares.push((*node, share));
            total += share;
        }
    }
    shares.sort_by_key(|(node, _)| *node);
    let mut weights: Vec<(u32, f64)> = Vec::new();
    for (node, share) in shares {
        match weights.last_mut() {
            Some((last, sum)) if *last == node => *sum += share / total,
            _ => weights.push((node, share / total)),
        }
    }
    weights.retain(|(_, weight)| *weight > 0.0);
    if total > 0.0 && weights.len() <= WEIGHTS_MAX {
        return Ok(weights);
    }
    if weights.len() > WEIGHTS_MAX {
        return Err(PatchError::TooLarge { radius, nodes: weights.len() });
    }
    // Too small, or too near to grazing, for any sample to hit: use the point itself.
    let hit = closest_on_triangle(center, &corners(&near[first]));
    let alone = near[first].into_iter().zip(hit.weights);
    Ok(alone.filter(|(_, weight)| *weight > 0.0).collect())
}

/// Integrals of the pressure times each shape function over a triangle, by pieces far smaller than the patch.
fn integrate([a, b, c]: &[Point3<f64>; 3], center: &Point3<f64>, radius: f64) -> [f64; 3] {
    let area = (b - a).cross(&(c - a)).norm() / 2.0;
    let longest = (b - a).norm().max((c - a).norm()).max((c - b).norm());
    let cuts = ((8.0 * longest / radius).ceil() as usize).clamp(1, CUTS_MAX);
    let piece = area / (cuts * cuts) as f64;
    let mut sums = [0.0; 3];
    let mut sample = |u: f64, v: f64| {
        let weights = [1.0 - u - v, u, v];
        let point = a + (b - a) * u + (c - a) * v;
        let pressure = (1.0 - (point - center).norm_squared() / radius.powi(2)).max(0.0);
        for (sum, weight) in sums.iter_mut().zip(weights) {
            *sum += pressure * weight * piece;
        }
    };
    let step = 1.0 / cuts as f64;
    for i in 0..cuts {
        for j in 0..cuts - i {
            let (u, v) = (i as f64 * step, j as f64 * step);
            sample(u + step / 3.0, v + step / 3.0);
            if i + j + 1 < cuts {
                sample(u + 2.0 * step / 3.0, v + 2.0 * step / 3.0);
            }
        }
    }
    sums
}
