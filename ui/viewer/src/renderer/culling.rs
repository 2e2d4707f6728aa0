//! Frustum culling, drawing order, and the focus point of a view.

use nalgebra::{Matrix4, Point3, Vector4};

use crate::renderer::items::Draw;
use crate::view::View;

/// Focus depth of an empty view \[m\].
const FOCUS_DEPTH: f64 = 0.2;

/// The visible draws: opaque ones from front to back, then transparent ones from back to front; each with a lower bound
/// of its depth \[m\].
pub(super) fn order(draws: &[Draw], view: &View) -> Vec<(usize, f64)> {
    let eye_from_world = view.world_from_eye.inverse();
    let clip_from_eye = view.lens.clip_from_eye();
    let mut seen: Vec<(bool, f64, usize)> = Vec::with_capacity(draws.len());
    for (index, draw) in draws.iter().enumerate() {
        let centre = eye_from_world * draw.centre_in_world;
        if is_in_frustum(&clip_from_eye, &centre, draw.radius, view) {
            let key = if draw.blended { -centre.z } else { centre.z - draw.radius };
            seen.push((draw.blended, key, index));
        }
    }
    seen.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let nearest = |index: usize| {
        let centre = eye_from_world * draws[index].centre_in_world;
        (centre.z - draws[index].radius).max(view.lens.near)
    };
    seen.into_iter().map(|(_, _, index)| (index, nearest(index))).collect()
}

/// The focus point: on the line of sight, at the mean depth of the visible draws.
pub(super) fn focus(draws: &[Draw], view: &View) -> Point3<f64> {
    let eye_from_world = view.world_from_eye.inverse();
    let (mut sum, mut count) = (0.0, 0.0);
    for draw in draws {
        let centre = eye_from_world * draw.centre_in_world;
        let within = |(at, _): ([f64; 2], f64)| at.iter().all(|part| (0.0..=1.0).contains(part));
        if view.project(&draw.centre_in_world).is_some_and(within) {
            sum += centre.z;
            count += 1.0;
        }
    }
    let depth = if count > 0.0 { sum / count } else { FOCUS_DEPTH };
    view.world_from_eye * Point3::new(0.0, 0.0, depth)
}

/// Whether a bounding sphere intersects the frustum.
fn is_in_frustum(clip_from_eye: &Matrix4<f64>, centre: &Point3<f64>, radius: f64, view: &View) -> bool {
    let lens = &view.lens;
    if centre.z + radius < lens.near || centre.z - radius > lens.far {
        return false;
    }
    // Planes of the four sides, from the rows of the projection (Gribb, Hartmann 2001).
    let row = |index: usize| clip_from_eye.row(index).transpose();
    let at = centre.to_homogeneous();
    [(0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)].into_iter().all(|(axis, side)| {
        let plane: Vector4<f64> = row(3) + row(axis) * side;
        plane.dot(&at) >= -radius * plane.xyz().norm()
    })
}
