//! First times of contact: nothing is missed, nothing is reported too late, nothing that passes at a distance counts.

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_collision::continuous::{
    Impact, RESOLUTION, Sweep, edge_edge, segment_face, vertex_edge, vertex_face, vertex_vertex,
};
use trocar_collision::primitive::{
    closest_on_segment, closest_on_triangle, closest_segment_triangle, closest_segments,
};

/// Which primitives meet.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    VertexFace,
    EdgeEdge,
    VertexEdge,
    VertexVertex,
    SegmentFace,
}

const KINDS: [Kind; 5] =
    [Kind::VertexFace, Kind::EdgeEdge, Kind::VertexEdge, Kind::VertexVertex, Kind::SegmentFace];

impl Kind {
    fn corners(self) -> (usize, usize) {
        match self {
            Self::VertexFace => (1, 3),
            Self::EdgeEdge => (2, 2),
            Self::VertexEdge => (1, 2),
            Self::VertexVertex => (1, 1),
            Self::SegmentFace => (2, 3),
        }
    }

    fn impact(self, case: &Case) -> Option<Impact> {
        let (a, b) = (&case.first, &case.second);
        let sweep = |of: &[Sweep<Point3<f64>>], i: usize| of[i];
        let segment =
            |of: &[Sweep<Point3<f64>>]| Sweep { from: [of[0].from, of[1].from], to: [of[0].to, of[1].to] };
        let face = |of: &[Sweep<Point3<f64>>]| Sweep {
            from: [of[0].from, of[1].from, of[2].from],
            to: [of[0].to, of[1].to, of[2].to],
        };
        let separation = case.separation;
        match self {
            Self::VertexFace => vertex_face(&sweep(a, 0), &face(b), separation),
            Self::EdgeEdge => edge_edge(&segment(a), &segment(b), separation),
            Self::VertexEdge => vertex_edge(&sweep(a, 0), &segment(b), separation),
            Self::VertexVertex => vertex_vertex(&sweep(a, 0), &sweep(b, 0), separation),
            Self::SegmentFace => segment_face(&segment(a), &face(b), separation),
        }
    }

    fn distance(self, case: &Case, time: f64) -> f64 {
        let at = |of: &[Sweep<Point3<f64>>]| -> Vec<Point3<f64>> {
            of.iter().map(|point| point.from + (point.to - point.from) * time).collect()
        };
        let (a, b) = (at(&case.first), at(&case.second));
        match self {
            Self::VertexFace => (closest_on_triangle(&a[0], &[b[0], b[1], b[2]]).point - a[0]).norm(),
            Self::EdgeEdge => closest_segments(&[a[0], a[1]], &[b[0], b[1]]).distance_squared.sqrt(),
            Self::VertexEdge => {
                let along = closest_on_segment(&a[0], &[b[0], b[1]]);
                (b[0] + (b[1] - b[0]) * along - a[0]).norm()
            }
            Self::VertexVertex => (b[0] - a[0]).norm(),
            Self::SegmentFace => {
                closest_segment_triangle(&[a[0], a[1]], &[b[0], b[1], b[2]]).distance_squared.sqrt()
            }
        }
    }
}

#[derive(Clone, Debug)]
struct Case {
    first: Vec<Sweep<Point3<f64>>>,
    second: Vec<Sweep<Point3<f64>>>,
    separation: f64,
}

impl Case {
    /// Extent and relative motion together, as the resolution takes it, or more.
    fn size(&self) -> f64 {
        let all = || self.first.iter().chain(&self.second);
        let reference = self.first[0];
        let extent = all().map(|point| (point.from - reference.from).norm()).fold(0.0, f64::max);
        let motion = |point: &Sweep<Point3<f64>>| point.to - point.from;
        let moved = all().map(|point| (motion(point) - motion(&reference)).norm()).fold(0.0, f64::max);
        extent + moved + self.separation
    }

    /// What rounding of positions far from the origin adds.
    fn rounding(&self) -> f64 {
        let all = self.first.iter().chain(&self.second);
        1e-15 * all.flat_map(|point| [point.from.coords.amax(), point.to.coords.amax()]).fold(0.0, f64::max)
    }
}

fn vector(random: &mut Pcg64Mcg) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.random_range(-1.0..1.0))
}

/// A coordinate that is often a round one, so that things are parallel, coplanar and coincident.
fn round_vector(random: &mut Pcg64Mcg) -> Vector3<f64> {
    Vector3::from_fn(|_, _| f64::from(random.random_range(-2..=2_i32)) * 0.5)
}

fn any_vector(random: &mut Pcg64Mcg) -> Vector3<f64> {
    match random.random_range(0..6) {
        0 => Vector3::zeros(),
        1 | 2 => round_vector(random),
        3 => vector(random) * 1e-6,
        _ => vector(random),
    }
}

/// Weights of a place inside, on the border or in a corner.
fn weights(count: usize, random: &mut Pcg64Mcg) -> Vec<f64> {
    let mut weights: Vec<f64> = (0..count)
        .map(|_| if random.random_bool(0.3) { 0.0 } else { random.random_range(0.0..1.0) })
        .collect();
    let sum: f64 = weights.iter().sum();
    if sum == 0.0 {
        weights[random.random_range(0..count)] = 1.0;
    } else {
        weights.iter_mut().for_each(|weight| *weight /= sum);
    }
    weights
}

/// Two primitives of which a chosen point of the one is at `time` at a chosen point of the other.
fn meeting(kind: Kind, time: f64, random: &mut Pcg64Mcg) -> Case {
    let scale = 10.0_f64.powf(random.random_range(-4.0..0.0));
    let speed = 10.0_f64.powf(random.random_range(-3.0..2.0));
    let away = if random.random_bool(0.5) { Vector3::zeros() } else { vector(random) };
    let shared = if random.random_bool(0.5) { Vector3::zeros() } else { any_vector(random) * 3.0 };
    let still = random.random_bool(0.1);
    let mut body = |count: usize| -> Vec<Sweep<Point3<f64>>> {
        let weights = weights(count, random);
        let places: Vec<_> = (0..count).map(|_| any_vector(random)).collect();
        let rigid = random.random_bool(0.3).then(|| any_vector(random));
        let motions: Vec<_> =
            (0..count)
                .map(|_| {
                    if still { Vector3::zeros() } else { rigid.unwrap_or_else(|| any_vector(random)) * speed }
                })
                .collect();
        let middle =
            places.iter().zip(&weights).fold(Vector3::zeros(), |sum, (place, weight)| sum + place * *weight);
        places
            .iter()
            .zip(&motions)
            .map(|(place, motion)| {
                let (place, motion) = (place - middle + away, motion + shared);
                Sweep {
                    from: Point3::from((place - motion * time) * scale),
                    to: Point3::from((place + motion * (1.0 - time)) * scale),
                }
            })
            .collect()
    };
    let (first, second) = kind.corners();
    let (mut first, second) = (body(first), body(second));
    // The middle moves with its body, so that both middles are at one place at `time`, however fast each is.
    let separation = if random.random_bool(0.5) { 0.0 } else { random.random_range(0.0..0.3) * scale };
    if random.random_bool(0.2) {
        first.reverse();
    }
    let mut case = Case { first, second, separation };
    // Positions far from the origin are rounded by more than a small pair is resolved.
    case.separation += 4.0 * case.rounding();
    case
}

/// What was found.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Found {
    Nothing,
    Impact,
    /// Reported at a distance beyond the resolution.
    GivenUp,
}

/// What holds of every answer.
fn check(kind: Kind, case: &Case, samples: usize) -> Found {
    let size = case.size();
    let rounding = case.rounding() + 1e-14 * size;
    let found = kind.impact(case);
    let until = found.as_ref().map_or(1.0, |impact| impact.time);
    assert!((0.0..=1.0).contains(&until), "{kind:?} {case:?} {found:?}");
    for sample in 0..samples {
        let time = until * sample as f64 / samples as f64;
        let distance = kind.distance(case, time);
        assert!(
            until == 0.0 || distance >= case.separation - rounding,
            "{kind:?} at {time} before {until} only {distance} apart: {case:?}"
        );
    }
    let Some(impact) = found else { return Found::Nothing };
    let distance = kind.distance(case, impact.time);
    // Computed in another frame, of triangles as thin as they come: to what the nearest points are good for then.
    assert!((distance - impact.distance).abs() <= 1e-6 * size + rounding, "{kind:?} {distance} {impact:?}");
    let over = (distance - case.separation - rounding).max(0.0) / (size + f64::MIN_POSITIVE);
    assert!(over <= 1e-5, "{kind:?} {over:e} too early, size {size}: {impact:?} {case:?}");
    if impact.time > 0.0 {
        assert!(distance >= case.separation - rounding, "{kind:?} {distance} {case:?}");
    }
    assert!((impact.normal.norm() - 1.0).abs() < 1e-12);
    for (weights, (body, point)) in
        impact.weights.iter().zip([&case.first, &case.second].into_iter().zip(&impact.points))
    {
        assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-9);
        let rebuilt = body.iter().zip(weights).fold(Vector3::zeros(), |sum, (corner, weight)| {
            sum + (corner.from.coords * (1.0 - impact.time) + corner.to.coords * impact.time) * *weight
        });
        assert!((rebuilt - point.coords).norm() <= rounding + 1e-12 * size);
    }
    if impact.time > 0.0 && over > 1.1 * RESOLUTION { Found::GivenUp } else { Found::Impact }
}

/// How often; `TROCAR_TRIALS` multiplies it for long runs.
fn trials(count: usize) -> usize {
    count * std::env::var("TROCAR_TRIALS").ok().and_then(|factor| factor.parse().ok()).unwrap_or(1)
}

#[test]
fn what_meets_is_reported_at_a_time_not_after_it() {
    for kind in KINDS {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let mut given_up = 0;
        for _ in 0..trials(20_000) {
            let time = match random.random_range(0..10) {
                0 => 0.0,
                1 => 1.0,
                _ => random.random_range(0.0..1.0),
            };
            let case = meeting(kind, time, &mut random);
            let impact = kind.impact(&case).unwrap_or_else(|| panic!("{kind:?} missed at {time}: {case:?}"));
            assert!(impact.time <= time + 1e-9, "{kind:?} late: {} after {time}: {case:?}", impact.time);
            given_up += usize::from(check(kind, &case, 4) == Found::GivenUp);
        }
        assert!(given_up <= trials(20_000) / 100, "{kind:?}: {given_up} given up");
    }
}

#[test]
fn until_an_impact_they_are_apart_and_at_it_as_near_as_said() {
    for kind in KINDS {
        let mut random = Pcg64Mcg::seed_from_u64(8);
        let (mut impacts, mut given_up) = (0, 0);
        let count = trials(5_000);
        for _ in 0..count {
            let mut case = meeting(kind, 0.5, &mut random);
            let shift = vector(&mut random) * case.size() * 10.0_f64.powf(random.random_range(-9.0..0.0));
            for point in &mut case.first {
                point.from += shift;
                point.to += shift;
            }
            let found = check(kind, &case, 40);
            impacts += usize::from(found != Found::Nothing);
            given_up += usize::from(found == Found::GivenUp);
        }
        assert!(given_up <= count / 100, "{kind:?}: {given_up} of {count} given up");
        assert!(impacts > count / 10 && impacts < count * 99 / 100, "{kind:?}: {impacts} of {count}");
    }
}

fn still(points: &[[f64; 3]]) -> Vec<Sweep<Point3<f64>>> {
    points.iter().map(|&place| Sweep { from: place.into(), to: place.into() }).collect()
}

#[test]
fn analytic_times() {
    // A sphere of 0.1 falls 1 onto a triangle at 0.35 below it.
    let vertex = Sweep { from: Point3::new(0.2, 0.2, 0.35), to: Point3::new(0.2, 0.2, -0.65) };
    let corners = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
    let face = Sweep { from: corners, to: corners };
    let impact = vertex_face(&vertex, &face, 0.1).expect("meets");
    assert!((impact.time - 0.25).abs() < 1e-9 && (impact.approach - 1.0).abs() < 1e-12);
    assert!((impact.normal + Vector3::z()).norm() < 1e-12);
    assert!((impact.points[1] - Point3::new(0.2, 0.2, 0.0)).norm() < 1e-12);
    // Beside the triangle it meets the edge: at a height of 0.06 when 0.08 beside it.
    let vertex = Sweep { from: Point3::new(0.5, -0.08, 0.26), to: Point3::new(0.5, -0.08, -0.14) };
    let impact = vertex_face(&vertex, &face, 0.1).expect("meets");
    assert!((impact.time - 0.5).abs() < 1e-8, "{}", impact.time);
    // Two crossing capsules, 0.3 apart, closing by 0.4.
    let x = [Point3::new(-1.0, 0.0, 0.0), Point3::new(1.0, 0.0, 0.0)];
    let y = [Point3::new(0.0, -1.0, 0.3), Point3::new(0.0, 1.0, 0.3)];
    let closing = Sweep { from: y, to: y.map(|point| point - Vector3::z() * 0.4) };
    let impact = edge_edge(&Sweep { from: x, to: x }, &closing, 0.2).expect("meets");
    assert!((impact.time - 0.25).abs() < 1e-9 && (impact.normal - Vector3::z()).norm() < 1e-12);
    // Exactly touching at the end, and short of it.
    let end = Sweep { from: Point3::new(0.2, 0.2, 1.0), to: Point3::new(0.2, 0.2, 0.0) };
    assert!(vertex_face(&end, &face, 0.0).is_some());
    let short = Sweep { from: Point3::new(0.2, 0.2, 1.0), to: Point3::new(0.2, 0.2, 1e-9) };
    assert!(vertex_face(&short, &face, 0.0).is_none());
}

#[test]
fn already_in_contact_is_time_zero_and_tells_whether_they_part() {
    let corners = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
    let face = Sweep { from: corners, to: corners };
    let touching = |to: f64| Sweep { from: Point3::new(0.2, 0.2, 0.0), to: Point3::new(0.2, 0.2, to) };
    let parting = vertex_face(&touching(0.5), &face, 0.1).expect("in contact");
    assert_eq!((parting.time, parting.distance), (0.0, 0.0));
    let within = Sweep { from: Point3::new(0.2, 0.2, 0.05), to: Point3::new(0.2, 0.2, 0.5) };
    let parting = vertex_face(&within, &face, 0.1).expect("in contact");
    assert!(parting.time == 0.0 && parting.approach < 0.0 && (parting.distance - 0.05).abs() < 1e-15);
    let through = Sweep {
        from: [Point3::new(0.2, 0.2, -1.0), Point3::new(0.2, 0.2, 1.0)],
        to: [Point3::new(0.2, 0.2, -2.0), Point3::new(0.2, 0.2, 0.0)],
    };
    assert_eq!(segment_face(&through, &face, 0.0).expect("crosses").time, 0.0);
}

#[test]
fn motion_past_a_surface_at_any_distance_beyond_the_resolution_is_no_impact() {
    let corners = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
    let face = Sweep { from: corners, to: corners };
    for height in [1e-8, 1e-6, 1e-3] {
        let slide = Sweep { from: Point3::new(-5.0, 0.3, height), to: Point3::new(5.0, 0.3, height) };
        assert!(vertex_face(&slide, &face, 0.0).is_none(), "{height}");
        assert!(vertex_face(&slide, &face, height * 1.01).is_some(), "{height}");
    }
    // In the plane of the triangle, into it and beside it.
    let into = Sweep { from: Point3::new(-1.0, 0.25, 0.0), to: Point3::new(1.0, 0.25, 0.0) };
    let impact = vertex_face(&into, &face, 0.0).expect("meets the edge");
    assert!((impact.time - 0.5).abs() < 1e-9 && impact.weights[1][1] < 1e-9);
    let beside = Sweep { from: Point3::new(-1.0, -0.001, 0.0), to: Point3::new(2.0, -0.001, 0.0) };
    assert!(vertex_face(&beside, &face, 0.0).is_none());
}

#[test]
fn what_is_not_a_number_is_not_proven_apart() {
    let far = still(&[[9.0, 9.0, 9.0]])[0];
    let corners = [Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX] {
        for place in 0..3 {
            let mut face = Sweep { from: corners, to: corners };
            face.to[place].y = bad;
            assert_eq!(vertex_face(&far, &face, 0.0).map(|impact| impact.time), Some(0.0), "{bad} {place}");
        }
        let vertex = Sweep { from: Point3::new(0.0, bad, 0.0), to: far.to };
        assert_eq!(vertex_vertex(&vertex, &far, 0.0).map(|impact| impact.time), Some(0.0), "{bad}");
    }
    assert!(vertex_face(&far, &Sweep { from: corners, to: corners }, f64::NAN).is_some());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    /// Where and how fast the pair moves as a whole, and in what unit it is measured, changes nothing.
    #[test]
    fn a_common_motion_and_a_scale_change_nothing(seed in any::<u64>(), kind in 0..KINDS.len(), exponent in -12..4_i32) {
        let kind = KINDS[kind];
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        let mut case = meeting(kind, 0.5, &mut random);
        case.separation += 1e-3 * case.size();
        let before = kind.impact(&case);
        let scale = 2.0_f64.powi(exponent);
        let turn = nalgebra::Rotation3::from_euler_angles(0.3, -1.1, 2.0);
        let (shift, drift) = (vector(&mut random) * case.size(), vector(&mut random) * case.size());
        let moved = |of: &[Sweep<Point3<f64>>]| of.iter().map(|point| Sweep {
            from: Point3::from(turn * (point.from + shift).coords * scale),
            to: Point3::from(turn * (point.to + shift + drift).coords * scale),
        }).collect::<Vec<_>>();
        let again = Case {
            first: moved(&case.first), second: moved(&case.second), separation: case.separation * scale,
        };
        let after = kind.impact(&again);
        prop_assert_eq!(before.is_some(), after.is_some());
        if let (Some(before), Some(after)) = (before, after) {
            // Grazing contacts have an uncertain time, but not an uncertain distance.
            let late = before.time.max(after.time);
            let between = [before.time.min(after.time), late, 0.5 * (before.time + after.time)];
            for time in between {
                prop_assert!(kind.distance(&case, time) <= case.separation + 1e-6 * case.size());
            }
        }
    }
}
