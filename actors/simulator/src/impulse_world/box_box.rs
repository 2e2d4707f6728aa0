//! Box–box contact: the axis of least overlap among the fifteen separating axes (Gottschalk, Lin, Manocha, *OBBTree*,
//! 1996), with the contact points of a clipped face, or the closest points of two edges.

use nalgebra::{Isometry3, Point3, Vector3};

use super::closest_features::TouchPoint;

/// An edge axis needs this much less overlap than a face axis to be preferred \[m\], so that flat contacts stay on
/// faces.
const EDGE_HANDICAP: f64 = 1e-5;
/// Maximum number of corners of a clipped face.
const CORNERS_MAX: usize = 8;

#[derive(Clone, Copy)]
struct LeastPenetration {
    depth: f64,
    /// From the first to the second, in world.
    normal: Vector3<f64>,
    of: SeparatingAxis,
}

#[derive(Clone, Copy)]
enum SeparatingAxis {
    Face { second: bool, axis: usize },
    Edges([usize; 2]),
}

type Side<'a> = (&'a Vector3<f64>, &'a Isometry3<f64>);

/// Contact points of boxes with these skin radii within `margin`; appends to `out`. Poses are `world_from_box`.
pub(super) fn box_box(a: Side<'_>, b: Side<'_>, skins: [f64; 2], margin: f64, out: &mut Vec<TouchPoint>) {
    let skin = skins[0] + skins[1];
    let turns = [a.1, b.1].map(|pose| pose.rotation.to_rotation_matrix());
    let axes = turns.map(|turn| [0, 1, 2].map(|axis| turn.matrix().column(axis).into_owned()));
    let apart = b.1.translation.vector - a.1.translation.vector;
    let reach = |half: &Vector3<f64>, axes: &[Vector3<f64>; 3], along: &Vector3<f64>| {
        (0..3).map(|axis| half[axis] * axes[axis].dot(along).abs()).sum::<f64>()
    };
    let mut best: Option<LeastPenetration> = None;
    // Whether no axis separates them by more than the margin.
    let mut consider = |axis: &Vector3<f64>, of: SeparatingAxis, handicap: f64| {
        let along = apart.dot(axis);
        let normal = if along < 0.0 { -axis } else { *axis };
        let depth = reach(a.0, &axes[0], &normal) + reach(b.0, &axes[1], &normal) + skin - along.abs();
        if best.is_none_or(|best| depth + handicap < best.depth) {
            best = Some(LeastPenetration { depth, normal, of });
        }
        depth > -margin
    };
    for (axis, along) in axes[0].iter().enumerate() {
        if !consider(along, SeparatingAxis::Face { second: false, axis }, 0.0) {
            return;
        }
    }
    for (axis, along) in axes[1].iter().enumerate() {
        if !consider(along, SeparatingAxis::Face { second: true, axis }, 1e-9) {
            return;
        }
    }
    for i in 0..3 {
        for j in 0..3 {
            let Some(axis) = axes[0][i].cross(&axes[1][j]).try_normalize(1e-3) else { continue };
            if !consider(&axis, SeparatingAxis::Edges([i, j]), EDGE_HANDICAP) {
                return;
            }
        }
    }
    let Some(best) = best else { return };
    match best.of {
        SeparatingAxis::Face { second: false, axis } => {
            faces(a, b, &axes, axis, &best.normal, skins, margin, out)
        }
        SeparatingAxis::Face { second: true, axis } => {
            let begin = out.len();
            faces(b, a, &[axes[1], axes[0]], axis, &-best.normal, [skins[1], skins[0]], margin, out);
            out[begin..].iter_mut().for_each(|point| {
                *point = TouchPoint { feature: point.feature + CORNERS_MAX as u32, ..point.swapped() };
            });
        }
        SeparatingAxis::Edges([i, j]) => {
            // The edges along those axes that are furthest towards each other.
            let middle =
                |(half, pose): Side<'_>, axes: &[Vector3<f64>; 3], along: usize, normal: &Vector3<f64>| {
                    let mut at = Point3::from(pose.translation.vector);
                    for axis in (0..3).filter(|axis| *axis != along) {
                        at += axes[axis] * (half[axis] * axes[axis].dot(normal).signum());
                    }
                    at
                };
            let p = middle(a, &axes[0], i, &best.normal);
            let q = middle(b, &axes[1], j, &-best.normal);
            let (d, e) = (axes[0][i], axes[1][j]);
            let (r, de) = (q - p, d.dot(&e));
            let square = 1.0 - de * de;
            let s = ((r.dot(&d) - de * r.dot(&e)) / square).clamp(-a.0[i], a.0[i]);
            let t = ((de * r.dot(&d) - r.dot(&e)) / square).clamp(-b.0[j], b.0[j]);
            let points = [p + d * s + best.normal * skins[0], q + e * t - best.normal * skins[1]];
            let feature = (2 * CORNERS_MAX + 3 * i + j) as u32;
            out.push(TouchPoint { points, normal: best.normal, depth: best.depth, feature });
        }
    }
}

/// The part of the face of `other` that lies above a face of `own`. `normal` points out of `own`.
#[allow(clippy::too_many_arguments)] // both boxes, and what is known of them
fn faces(
    own: Side<'_>,
    other: Side<'_>,
    axes: &[[Vector3<f64>; 3]; 2],
    axis: usize,
    normal: &Vector3<f64>,
    skins: [f64; 2],
    margin: f64,
    out: &mut Vec<TouchPoint>,
) {
    let facing = (0..3)
        .max_by(|i, j| axes[1][*i].dot(normal).abs().total_cmp(&axes[1][*j].dot(normal).abs()))
        .unwrap_or(0);
    let towards = -axes[1][facing].dot(normal).signum();
    let (u, v) = ((facing + 1) % 3, (facing + 2) % 3);
    let centre = Point3::from(other.1.translation.vector) + axes[1][facing] * (towards * other.0[facing]);
    let (along_u, along_v) = (axes[1][u] * other.0[u], axes[1][v] * other.0[v]);
    let mut polygon = Polygon::default();
    for (s, t) in [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)] {
        polygon.push(centre + along_u * s + along_v * t);
    }
    for side in (0..3).filter(|side| *side != axis) {
        for sign in [1.0, -1.0] {
            let outwards = axes[0][side] * sign;
            let limit = outwards.dot(&own.1.translation.vector) + own.0[side];
            polygon = polygon.below(&outwards, limit);
        }
    }
    let level = normal.dot(&own.1.translation.vector) + own.0[axis];
    for (index, corner) in polygon.corners[..polygon.count].iter().enumerate() {
        let depth = skins[0] + skins[1] - (normal.dot(&corner.coords) - level);
        if depth > -margin {
            let on_other = corner - normal * skins[1];
            let on_own = on_other + normal * depth;
            out.push(TouchPoint {
                points: [on_own, on_other],
                normal: *normal,
                depth,
                feature: index as u32,
            });
        }
    }
}

#[derive(Clone, Copy, Default)]
struct Polygon {
    corners: [Point3<f64>; CORNERS_MAX],
    count: usize,
}

impl Polygon {
    fn push(&mut self, corner: Point3<f64>) {
        if self.count < CORNERS_MAX {
            self.corners[self.count] = corner;
            self.count += 1;
        }
    }

    /// Clips it by a plane (Sutherland, Hodgman, 1974).
    fn below(&self, outwards: &Vector3<f64>, limit: f64) -> Self {
        let mut kept = Self::default();
        for index in 0..self.count {
            let (p, q) = (self.corners[index], self.corners[(index + 1) % self.count]);
            let (before, after) = (outwards.dot(&p.coords) - limit, outwards.dot(&q.coords) - limit);
            if before <= 0.0 {
                kept.push(p);
            }
            if before * after < 0.0 {
                kept.push(p + (q - p) * (before / (before - after)));
            }
        }
        kept
    }
}
