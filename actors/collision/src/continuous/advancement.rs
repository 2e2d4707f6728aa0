//! Conservative advancement of two small convex hulls along separating planes (Mirtich 1996; directional bounds as in
//! Zhang, Lee, Kim 2006, exact here for vertices in linear motion).

#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "what is not a number is not proven apart")]

use nalgebra::{Point3, Vector3};

/// Linear motion of an object over a step: its states at the beginning and at the end. In between each point moves in a
/// straight line at constant speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sweep<T> {
    /// At the beginning.
    pub from: T,
    /// At the end.
    pub to: T,
}

/// Time and geometry of the first contact of two objects within a separation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impact {
    /// Time, as a fraction of the step in \[0, 1\]; never after the first contact. 0 where they were in contact at the
    /// beginning.
    pub time: f64,
    /// The nearest points of the first and of the second at that time \[m\].
    pub points: [Point3<f64>; 2],
    /// The weights of those points on the corners of the first and of the second, in the order in which they were
    /// given; 0 for missing corners.
    pub weights: [[f64; 3]; 2],
    /// Unit direction from the first to the second at that time. If they intersect, one of their normals, facing the
    /// motion.
    pub normal: Vector3<f64>,
    /// Their distance at that time \[m\]; 0 if they intersect.
    pub distance: f64,
    /// Approach of the two points along the normal, per step \[m\]; negative if they separate.
    pub approach: f64,
}

/// Contact tolerance beyond `separation`, relative to the pair's size (its extent and its relative motion, together
/// with the separation). Far above the rounding of the gap along a plane, far below a simulation's resolution: 0.1 nm
/// for a metre.
pub const RESOLUTION: f64 = 1e-10;

/// Number of planes after which an undecided pair counts as an impact at the time reached. Two or three are usual; more
/// than 64 are needed for one in a hundred pairs constructed to graze.
const PLANES_MAX: usize = 256;
/// Number of fixed planes among them: most pairs are decided by one or two.
const FIXED_PLANES: usize = 4;

/// Nearest points: the weights on the corners of each.
pub(super) struct Nearest<const M: usize, const N: usize> {
    pub points: [Point3<f64>; 2],
    pub weights: ([f64; M], [f64; N]),
}

/// The pair in a frame that moves with the first corner of the first hull, so that rounding is relative to the size of
/// the pair and not to its position.
struct Pair<const M: usize, const N: usize> {
    first: [Point3<f64>; M],
    first_motion: [Vector3<f64>; M],
    second: [Point3<f64>; N],
    second_motion: [Vector3<f64>; N],
}

impl<const M: usize, const N: usize> Pair<M, N> {
    fn new(first: &Sweep<[Point3<f64>; M]>, second: &Sweep<[Point3<f64>; N]>) -> Self {
        let (origin, moved) = (first.from[0], first.to[0]);
        let relative = |point: &Point3<f64>| Point3::from(point - origin);
        // Differences within the pair, at both ends of the step.
        let motion = |from: &Point3<f64>, to: &Point3<f64>| (to - moved) - (from - origin);
        Self {
            first: first.from.each_ref().map(relative),
            first_motion: std::array::from_fn(|i| motion(&first.from[i], &first.to[i])),
            second: second.from.each_ref().map(relative),
            second_motion: std::array::from_fn(|i| motion(&second.from[i], &second.to[i])),
        }
    }

    /// Largest coordinate at the beginning and largest motion \[m\].
    fn size(&self) -> f64 {
        let points = self.first.iter().chain(&self.second).map(|point| point.coords.amax());
        let motions = self.first_motion.iter().chain(&self.second_motion).map(Vector3::amax);
        // A sum, not a maximum, so that NaN stays.
        points.fold(0.0, larger) + motions.fold(0.0, larger)
    }

    fn at(&self, time: f64) -> ([Point3<f64>; M], [Point3<f64>; N]) {
        (
            std::array::from_fn(|i| self.first[i] + self.first_motion[i] * time),
            std::array::from_fn(|i| self.second[i] + self.second_motion[i] * time),
        )
    }

    /// The first time from `time` on at which the gap across `plane` may be as small as `gap`; `None` if it already is.
    /// A rotating plane is a proof only until its `end`.
    fn clear_until(&self, plane: &Plane, time: f64, gap: f64) -> Option<f64> {
        let first: [_; M] =
            std::array::from_fn(|i| plane.course(&self.first[i], &self.first_motion[i], time));
        let mut until = plane.end;
        for (point, motion) in self.second.iter().zip(&self.second_motion) {
            let course = plane.course(point, motion, time);
            for other in &first {
                // The gap between these two corners in the time since: a + b s + c s².
                let [a, b, c] = std::array::from_fn(|i| course[i] - other[i]);
                let a = a - gap;
                // The negation holds for NaN too.
                if !(a > 0.0) {
                    return None;
                }
                let discriminant = b * b - 4.0 * a * c;
                let closing = discriminant.max(0.0).sqrt() - b;
                if discriminant >= 0.0 && closing > 0.0 {
                    until = until.min(2.0 * a / closing);
                }
            }
        }
        Some(time + until)
    }
}

/// The direction from the nearest point of the first hull to that of the second, normal to the features that they lie
/// on. The difference of two nearly coincident points is mostly rounding; the corners of their features are accurate.
fn direction<const M: usize, const N: usize>(
    first: &[Point3<f64>; M],
    second: &[Point3<f64>; N],
    found: &Nearest<M, N>,
) -> Option<Vector3<f64>> {
    let between = found.points[1] - found.points[0];
    let mut spanned = [Vector3::zeros(); 2];
    let mut count = 0;
    let on_first = span(first, &found.weights.0);
    let on_second = span(second, &found.weights.1);
    for edge in on_first.into_iter().chain(on_second).flatten() {
        if count < 2 {
            spanned[count] = edge;
        }
        count += 1;
    }
    let normal = match count {
        0 => between,
        1 => {
            let along = spanned[0].try_normalize(0.0)?;
            let across = between - along * along.dot(&between);
            across - along * along.dot(&across)
        }
        2 => spanned[0].cross(&spanned[1]),
        // A face and the interior of an edge: they cross.
        _ => return None,
    };
    let normal = normal.try_normalize(0.0)?;
    Some(if normal.dot(&between) < 0.0 { -normal } else { normal })
}

/// Directions that span the feature of a point with these weights: none for a corner, the edge, or two edges of a face.
fn span<const K: usize>(corners: &[Point3<f64>; K], weights: &[f64; K]) -> [Option<Vector3<f64>>; 2] {
    let mut spanned = [None; 2];
    let mut carried =
        corners.iter().zip(weights).filter(|(_, weight)| **weight > 0.0).map(|(corner, _)| corner);
    if let Some(origin) = carried.next() {
        for (slot, corner) in spanned.iter_mut().zip(carried) {
            *slot = Some(corner - origin);
        }
    }
    spanned
}

/// A separating plane of two hulls: its normal at one time, the normal's rate of change, and how long the changing
/// normal is at most 1 long (then the gap along it is at most the distance).
struct Plane {
    normal: Vector3<f64>,
    turn: Vector3<f64>,
    end: f64,
}

impl Plane {
    fn fixed(normal: Vector3<f64>) -> Self {
        Self { normal, turn: Vector3::zeros(), end: f64::INFINITY }
    }

    /// A normal that moves along the chord between two unit normals.
    fn turning(normal: Vector3<f64>, later: &Vector3<f64>, end: f64) -> Self {
        Self { normal, turn: (later - normal) / end, end }
    }

    /// Position of a corner along the normal, as coefficients of the time since `time`.
    fn course(&self, point: &Point3<f64>, motion: &Vector3<f64>, time: f64) -> [f64; 3] {
        let point = point.coords + motion * time;
        [self.normal.dot(&point), self.normal.dot(motion) + self.turn.dot(&point), self.turn.dot(motion)]
    }
}

/// The larger of two, or NaN.
fn larger(a: f64, b: f64) -> f64 {
    if a > b || a.is_nan() { a } else { b }
}

/// The first time that `first` and `second` are within `separation`; `nearest` gives the nearest points of two hulls.
pub(super) fn advance<const M: usize, const N: usize>(
    first: &Sweep<[Point3<f64>; M]>,
    second: &Sweep<[Point3<f64>; N]>,
    separation: f64,
    nearest: impl Fn(&[Point3<f64>; M], &[Point3<f64>; N]) -> Nearest<M, N>,
) -> Option<Impact> {
    let pair = Pair::new(first, second);
    let separation = if separation < 0.0 { 0.0 } else { separation };
    let slack = RESOLUTION * (pair.size() + separation);
    let gap = separation + 0.5 * slack;
    let (mut time, mut stride) = (0.0_f64, 1.0_f64);
    for plane in 0..PLANES_MAX {
        let (a, b) = pair.at(time);
        let found = nearest(&a, &b);
        let between = found.points[1] - found.points[0];
        let distance = between.norm();
        if !(distance > separation + slack) {
            return Some(impact(first, second, &pair, time, &found));
        }
        let direct = between / distance;
        let across = direction(&a, &b, &found).unwrap_or(direct);
        // For thin triangles and nearly parallel edges the normal is less accurate.
        let clear = |normal| pair.clear_until(&Plane::fixed(normal), time, gap);
        let (normal, fixed) =
            clear(across).map_or_else(|| (direct, clear(direct)), |until| (across, Some(until)));
        let mut until = fixed.unwrap_or(time);
        if plane >= FIXED_PLANES && until <= 1.0 {
            // Objects that rotate past each other closely soon violate every fixed plane: a plane that rotates with
            // them lasts longer.
            let ahead = (2.0 * stride).min(1.0 - time);
            let (a, b) = pair.at(time + ahead);
            if let Some(later) = direction(&a, &b, &nearest(&a, &b))
                && let Some(turning) = pair.clear_until(&Plane::turning(normal, &later, ahead), time, gap)
            {
                until = until.max(if turning >= 1.0 { 2.0 } else { turning });
            }
        }
        if until > 1.0 {
            return None;
        }
        if !(until > time) {
            return Some(impact(first, second, &pair, time, &found));
        }
        (time, stride) = (until, until - time);
    }
    let (a, b) = pair.at(time);
    Some(impact(first, second, &pair, time, &nearest(&a, &b)))
}

fn impact<const M: usize, const N: usize>(
    first: &Sweep<[Point3<f64>; M]>,
    second: &Sweep<[Point3<f64>; N]>,
    pair: &Pair<M, N>,
    time: f64,
    found: &Nearest<M, N>,
) -> Impact {
    let (on_first, on_second) = &found.weights;
    let motion = weighted(&pair.second_motion, on_second) - weighted(&pair.first_motion, on_first);
    let between = found.points[1] - found.points[0];
    let distance = between.norm();
    let normal = if distance > 0.0 {
        between / distance
    } else {
        let (a, b) = pair.at(time);
        let geometric = crossing_normal(&a, &b).try_normalize(0.0);
        let normal = geometric.or_else(|| (-motion).try_normalize(0.0)).unwrap_or_else(Vector3::x);
        if normal.dot(&motion) > 0.0 { -normal } else { normal }
    };
    Impact {
        time,
        points: [place(first, on_first, time), place(second, on_second, time)],
        weights: [padded(on_first), padded(on_second)],
        normal,
        distance,
        approach: -normal.dot(&motion),
    }
}

/// A normal of two intersecting primitives: of the triangle, else of the two edges.
fn crossing_normal<const M: usize, const N: usize>(
    first: &[Point3<f64>; M],
    second: &[Point3<f64>; N],
) -> Vector3<f64> {
    match (M, N) {
        (_, 3) => (second[1] - second[0]).cross(&(second[2] - second[0])),
        (2, 2) => (first[1] - first[0]).cross(&(second[1] - second[0])),
        _ => Vector3::zeros(),
    }
}

fn weighted<const K: usize>(vectors: &[Vector3<f64>; K], weights: &[f64; K]) -> Vector3<f64> {
    vectors.iter().zip(weights).fold(Vector3::zeros(), |sum, (vector, weight)| sum + vector * *weight)
}

fn place<const K: usize>(of: &Sweep<[Point3<f64>; K]>, weights: &[f64; K], time: f64) -> Point3<f64> {
    let moments: [_; K] = std::array::from_fn(|i| of.from[i].coords * (1.0 - time) + of.to[i].coords * time);
    Point3::from(weighted(&moments, weights))
}

fn padded<const K: usize>(weights: &[f64; K]) -> [f64; 3] {
    std::array::from_fn(|i| weights.get(i).copied().unwrap_or(0.0))
}
