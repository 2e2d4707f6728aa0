//! Contact points of two parts: the closest points of their cores with the skins around them; where an edge lies along
//! a face or another edge, both of its ends, so that flat objects rest on more than one point.

use nalgebra::{Isometry3, Point3, Vector3};

use super::box_box::box_box;
use super::convex_parts::{Core, Part};

/// Edges at a smaller angle count as parallel, as its sine squared.
const ALONG: f64 = 0.01;
/// Faces count as flat on each other when the cosine between separation and normal exceeds this.
const FLAT: f64 = 0.98;
/// Cores nearer than this intersect \[m\].
const CROSSING: f64 = 1e-9;

/// A contact point of two parts, in world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TouchPoint {
    /// On the skins of the first and of the second \[m\].
    pub points: [Point3<f64>; 2],
    /// Unit direction from the first to the second.
    pub normal: Vector3<f64>,
    /// Penetration depth \[m\]; negative for a gap.
    pub depth: f64,
    /// Identifies it among those of the same two parts, from step to step.
    pub feature: u32,
}

impl TouchPoint {
    pub(super) fn swapped(self) -> Self {
        Self { points: [self.points[1], self.points[0]], normal: -self.normal, ..self }
    }
}

/// Contact points of `first` and `second` within `margin` \[m\]; appends to `out`. Poses are `world_from_part`.
pub fn touch(
    first: (&Part, &Isometry3<f64>),
    second: (&Part, &Isometry3<f64>),
    margin: f64,
    out: &mut Vec<TouchPoint>,
) {
    let apart = second.1.translation.vector - first.1.translation.vector;
    let reach = first.0.reach() + second.0.reach() + margin;
    if apart.norm_squared() > reach * reach {
        return;
    }
    let begin = out.len();
    match (first.0.core, second.0.core) {
        (Core::Box(a), Core::Box(b)) => {
            let skins = [first.0.radius, second.0.radius];
            box_box((&a, first.1), (&b, second.1), skins, margin, out);
        }
        (Core::Box(half), _) => {
            segment_box(second, (&half, first.0.radius, first.1), margin, out);
            out[begin..].iter_mut().for_each(|point| *point = point.swapped());
        }
        (_, Core::Box(half)) => segment_box(first, (&half, second.0.radius, second.1), margin, out),
        _ => segment_segment(first, second, margin, out),
    }
}

/// The ends of a core that is not a box; twice the same for a point.
fn ends((part, pose): (&Part, &Isometry3<f64>)) -> [Point3<f64>; 2] {
    let half = if let Core::Segment(half) = part.core { half } else { 0.0 };
    [-half, half].map(|z| pose * Point3::new(0.0, 0.0, z))
}

/// The contact at `p` of the first core and `q` of the second.
fn between(
    [p, q]: [Point3<f64>; 2],
    normal: Vector3<f64>,
    [r, s]: [f64; 2],
    margin: f64,
    feature: u32,
) -> Option<TouchPoint> {
    let depth = r + s - (q - p).dot(&normal);
    (depth > -margin).then(|| TouchPoint { points: [p + normal * r, q - normal * s], normal, depth, feature })
}

fn segment_segment(
    first: (&Part, &Isometry3<f64>),
    second: (&Part, &Isometry3<f64>),
    margin: f64,
    out: &mut Vec<TouchPoint>,
) {
    let (a, b) = (ends(first), ends(second));
    let radii = [first.0.radius, second.0.radius];
    let (d, e) = (a[1] - a[0], b[1] - b[0]);
    let [s, t] = nearest(&a, &b);
    let (p, q) = (a[0] + d * s, b[0] + e * t);
    let apart = q - p;
    let distance = apart.norm();
    if distance > radii[0] + radii[1] + margin {
        return;
    }
    let normal = if distance > CROSSING {
        apart / distance
    } else {
        // Intersecting cores: separate perpendicular to both, away from the centres.
        let square = d.cross(&e).try_normalize(CROSSING * (d.norm() * e.norm()).max(1e-30));
        let square = square.unwrap_or_else(|| across(if d.norm() > e.norm() { &d } else { &e }));
        let middles = nalgebra::center(&b[0], &b[1]) - nalgebra::center(&a[0], &a[1]);
        if middles.dot(&square) < 0.0 { -square } else { square }
    };
    let (dd, ee) = (d.norm_squared(), e.norm_squared());
    let is_along = dd > 0.0 && ee > 0.0 && d.cross(&e).norm_squared() < ALONG * dd * ee;
    if is_along {
        // The part of the first along which the second lies, and the second's corresponding positions.
        let at = |point: &Point3<f64>| ((point - a[0]).dot(&d) / dd).clamp(0.0, 1.0);
        let (from, to) = (at(&b[0]).min(at(&b[1])), at(&b[0]).max(at(&b[1])));
        if (to - from) * dd.sqrt() > 0.1 * radii[0].max(radii[1]) {
            for (feature, s) in [(0, from), (1, to)] {
                let p = a[0] + d * s;
                let q = b[0] + e * ((p - b[0]).dot(&e) / ee).clamp(0.0, 1.0);
                out.extend(between([p, q], normal, radii, margin, feature));
            }
            return;
        }
    }
    out.extend(between([p, q], normal, radii, margin, 2));
}

fn across(direction: &Vector3<f64>) -> Vector3<f64> {
    let least = direction.iamin();
    let mut axis = Vector3::zeros();
    axis[least] = 1.0;
    direction.cross(&axis).try_normalize(0.0).unwrap_or_else(Vector3::z)
}

/// Parameters of the nearest points of two segments, either of which may be a point (Ericson, *Real-time collision
/// detection*, 2005, 5.1.9).
fn nearest(a: &[Point3<f64>; 2], b: &[Point3<f64>; 2]) -> [f64; 2] {
    let (d, e, r) = (a[1] - a[0], b[1] - b[0], a[0] - b[0]);
    let (dd, ee, de) = (d.norm_squared(), e.norm_squared(), d.dot(&e));
    let (c, f) = (d.dot(&r), e.dot(&r));
    let share = |x: f64, of: f64| if of > 0.0 { (x / of).clamp(0.0, 1.0) } else { 0.0 };
    let square = dd * ee - de * de;
    let s = if square > 1e-12 * dd * ee { ((de * f - c * ee) / square).clamp(0.0, 1.0) } else { 0.5 };
    let t = share(de * s + f, ee);
    let s = share(de * t - c, dd);
    [s, share(de * s + f, ee)]
}

/// Contact of a point or segment (the first) with a box.
fn segment_box(
    first: (&Part, &Isometry3<f64>),
    (half, skin, world_from_box): (&Vector3<f64>, f64, &Isometry3<f64>),
    margin: f64,
    out: &mut Vec<TouchPoint>,
) {
    let [p, q] = ends(first).map(|end| world_from_box.inverse_transform_point(&end));
    let radii = [first.0.radius, skin];
    let along = q - p;
    let s = nearest_to_box(&p, &along, half);
    let at = p + along * s;
    let on_box = Point3::from(at.coords.inf(half).sup(&-half));
    let apart = on_box - at;
    let distance = apart.norm();
    if distance > radii[0] + skin + margin {
        return;
    }
    // From the segment to the box, in the frame of the box.
    let normal = if distance > CROSSING { apart / distance } else { out_of_box(&[p, q], half) };
    let begin = out.len();
    let face = normal.iamax();
    if normal[face].abs() > FLAT {
        // The part of the segment above the face.
        let mut inside = [0.0_f64, 1.0];
        for axis in (0..3).filter(|axis| *axis != face) {
            for side in [half[axis], -half[axis]] {
                let sign = side.signum();
                let (from, slope) = ((p[axis] - side) * sign, along[axis] * sign);
                if slope > 0.0 {
                    inside[1] = inside[1].min(-from / slope);
                } else if slope < 0.0 {
                    inside[0] = inside[0].max(-from / slope);
                } else if from > 0.0 {
                    inside[1] = -1.0;
                }
            }
        }
        if inside[1] >= inside[0] {
            let mut axis = Vector3::zeros();
            axis[face] = normal[face].signum();
            let is_point = (inside[1] - inside[0]) * along.norm() < 1e-3 * radii[0].max(1e-6);
            let count = if is_point { 1 } else { 2 };
            for (feature, s) in inside.into_iter().enumerate().take(count) {
                let at = p + along * s;
                let mut under = at;
                under[face] = -axis[face] * half[face];
                out.extend(between([at, under], axis, radii, margin, feature as u32));
            }
        }
    }
    if out.len() == begin {
        // For intersecting cores, the depth is the distance to exit.
        let mut on_box = on_box;
        if distance <= CROSSING {
            let depth = half.component_mul(&normal.abs()).sum()
                - (-normal.dot(&p.coords)).min(-normal.dot(&q.coords));
            on_box = at - normal * depth.max(0.0);
        }
        out.extend(between([at, on_box], normal, radii, margin, 2));
    }
    for point in &mut out[begin..] {
        point.points = point.points.map(|point| world_from_box * point);
        point.normal = world_from_box * point.normal;
    }
}

/// The parameter of `p + s·along`, 0 ≤ s ≤ 1, at the least distance to the box: its square is convex, and quadratic
/// between the parameters at which a coordinate crosses a face.
fn nearest_to_box(p: &Point3<f64>, along: &Vector3<f64>, half: &Vector3<f64>) -> f64 {
    // Half of the derivative of the squared distance.
    let slope = |s: f64| -> f64 {
        (0..3)
            .map(|axis| {
                let x = p[axis] + s * along[axis];
                (x - x.clamp(-half[axis], half[axis])) * along[axis]
            })
            .sum()
    };
    let mut places = [0.0; 8];
    let mut count = 0;
    for axis in 0..3 {
        for side in [-half[axis], half[axis]] {
            let s = (side - p[axis]) / along[axis];
            if s > 0.0 && s < 1.0 {
                places[count] = s;
                count += 1;
            }
        }
    }
    places[count] = 1.0;
    count += 1;
    places[..count].sort_unstable_by(f64::total_cmp);
    let (mut from, mut before) = (0.0, slope(0.0));
    if before >= 0.0 {
        // Where the distance is constant, the middle of the interval: a segment along a face makes contact in its
        // middle.
        return if before > 0.0 { 0.0 } else { middle_of_flat(&slope, 0.0, &places[..count]) };
    }
    for &to in &places[..count] {
        let after = slope(to);
        if after > 0.0 {
            return from + (to - from) * before / (before - after);
        }
        if after == 0.0 {
            return middle_of_flat(&slope, to, &places[..count]);
        }
        (from, before) = (to, after);
    }
    1.0
}

fn middle_of_flat(slope: &impl Fn(f64) -> f64, from: f64, places: &[f64]) -> f64 {
    let until = places.iter().copied().filter(|s| *s > from && slope(*s) == 0.0).fold(from, f64::max);
    0.5 * (from + until)
}

/// The shortest exit direction of a segment that intersects a box: from the segment to the box.
fn out_of_box([p, q]: &[Point3<f64>; 2], half: &Vector3<f64>) -> Vector3<f64> {
    let along = q - p;
    let mut best = (f64::INFINITY, Vector3::z());
    let unit = |axis: usize| Vector3::ith(axis, 1.0);
    let crosses =
        (0..3).filter_map(|axis| along.cross(&unit(axis)).try_normalize(1e-9 * along.norm().max(1e-30)));
    for axis in (0..3).map(unit).chain(crosses) {
        let reach = half.component_mul(&axis.abs()).sum();
        let (a, b) = (axis.dot(&p.coords), axis.dot(&q.coords));
        for (depth, normal) in [(reach - a.min(b), -axis), (a.max(b) + reach, axis)] {
            if depth < best.0 {
                best = (depth, normal);
            }
        }
    }
    best.1
}
