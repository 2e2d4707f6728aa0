//! What an eye has in sight, in which order it is drawn, and where the eye rests.

use nalgebra::{Matrix4, Point3, Vector4};

use crate::renderer::items::Draw;
use crate::view::View;

/// Where an eye rests that sees nothing \[m\].
const FOCUS_DEPTH: f64 = 0.2;

/// What is in sight: opaque things from front to back, then those that light passes through from back to front; each with
/// the least depth that any of it may have \[m\].
pub(super) fn order(draws: &[Draw], view: &View) -> Vec<(usize, f64)> {
    let eye_from_world = view.world_from_eye.inverse();
    let clip_from_eye = view.lens.clip_from_eye();
    let mut seen: Vec<(bool, f64, usize)> = Vec::with_capacity(draws.len());
    for (index, draw) in draws.iter().enumerate() {
        let centre = eye_from_world * draw.centre_in_world;
        if is_in_sight(&clip_from_eye, &centre, draw.radius, view) {
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

/// Where the eye rests: along the line of sight, as far as what it sees is in the mean.
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

/// Whether a ball may be seen.
fn is_in_sight(clip_from_eye: &Matrix4<f64>, centre: &Point3<f64>, radius: f64, view: &View) -> bool {
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
