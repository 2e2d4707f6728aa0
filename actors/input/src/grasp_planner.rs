//! Grasp planner for rings: a point of the tube and a closing direction that the shaft allows.
//!
//! A grasper that passes a port can turn only about its own shaft `u`. To pinch the tube at a point with the tangent
//! `t` its closing direction must be `±(u × t)`; so a grasp is one number, the angle of the point on the ring. The
//! planner tries angles all around and keeps the best one whose approach is free of collisions with the board, pegs,
//! other rings and the other instrument.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::trainee_view::{BenchSeen, GrasperSeen, MomentSeen, RingSeen};

/// Angles that are tried.
const CANDIDATES: usize = 72;
/// Pieces of a ring's tube when it is an obstacle.
const TUBE_PIECES: usize = 16;
/// Least sine between shaft and tube: flatter, the jaws would lie along the tube instead of across it.
const CROSSING_MIN: f64 = 0.5;
/// Two hands on a ring are far enough apart at this many ring radii: 100° on the ring.
const SEPARATION: f64 = 1.53;
/// Distance that is kept from everything \[m\].
const MARGIN: f64 = 0.0005;
/// Length of the shaft behind the jaws that is checked for collisions \[m\].
const SHAFT_SEEN: f64 = 0.06;
/// Planned penetration of the blades' corners into the board \[m\]: a light touch, so that the jaws reach as far around
/// the tube as the board allows.
const BOARD_TOUCH: f64 = 0.0003;
/// Least and largest depth of a grasp: how far the tip passes beyond the tube's centre line \[m\].
const DEPTH_MIN: f64 = 0.0003;
const DEPTH_MAX: f64 = 0.0022;

/// A grasp of a ring.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct GraspPlan {
    /// Point on the tube's centre line, in the ring's frame \[m\].
    pub point_in_ring: Point3<f64>,
    /// Full jaw opening on the way in \[rad\].
    pub opening: f64,
    /// How far the tip passes beyond the tube's centre line \[m\].
    pub depth: f64,
}

/// A grasp plan in world, for the ring's current pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedGrasp {
    /// Position of the tip \[m\].
    pub tip: Vector3<f64>,
    /// Unit direction of the shaft there.
    pub shaft: Vector3<f64>,
    /// Closing direction, unit.
    pub closing: Vector3<f64>,
}

/// Request to the planner.
#[derive(Clone, Copy, Debug)]
pub struct GraspRequest {
    /// Index of the ring.
    pub ring: usize,
    /// The hand: 0 left, 1 right.
    pub hand: usize,
    /// A grasp that just failed, to try another.
    pub not_again: Option<Point3<f64>>,
}

impl GraspPlan {
    /// The grasp in world for the current poses.
    pub fn place(&self, ring: &RingSeen, grasper: &GrasperSeen) -> PlacedGrasp {
        let point = (ring.pose * self.point_in_ring).coords;
        let tangent = ring.pose.rotation * Vector3::z().cross(&self.point_in_ring.coords).normalize();
        // The tip lies beyond the point along the shaft, which changes the shaft's direction only little.
        let shaft = (point - grasper.apex).normalize();
        let closing = shaft.cross(&tangent).try_normalize(1e-6).unwrap_or(tangent);
        PlacedGrasp { tip: point + shaft * self.depth, shaft, closing }
    }
}

/// A thick line.
#[derive(Clone, Copy, Debug)]
struct Capsule {
    from: Vector3<f64>,
    to: Vector3<f64>,
    radius: f64,
}

impl Capsule {
    fn gap(&self, other: &Self) -> f64 {
        segment_distance(&self.from, &self.to, &other.from, &other.to) - self.radius - other.radius
    }
}

/// Finds the best grasp of a ring, if there is any.
pub fn plan_grasp(bench: &BenchSeen, moment: &MomentSeen, wish: &GraspRequest) -> Option<GraspPlan> {
    let ring = moment.rings.get(wish.ring)?;
    let grasper = &bench.graspers[wish.hand];
    let opening = comfortable_opening(bench, grasper);
    let up = bench.up();
    let obstacles = obstacles(bench, moment, wish);
    let other_apex = bench.graspers[1 - wish.hand].apex;
    let outwards = (grasper.apex - other_apex).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    let held_at = moment.hands[1 - wish.hand].tip.translation.vector;
    let other_holds = moment.hands[1 - wish.hand].held == Some(wish.ring);
    let closing_now = moment.hands[wish.hand].tip.rotation * Vector3::x();

    let mut best: Option<(f64, GraspPlan)> = None;
    for candidate in 0..CANDIDATES {
        let angle = 2.0 * std::f64::consts::PI * candidate as f64 / CANDIDATES as f64;
        let point_in_ring = Point3::new(angle.cos(), angle.sin(), 0.0) * bench.ring_radius;
        let on_line = GraspPlan { point_in_ring, opening, depth: 0.0 }.place(ring, grasper);
        let depth = depth_above_board(bench, &on_line, grasper, opening);
        if depth < DEPTH_MIN {
            continue;
        }
        let plan = GraspPlan { point_in_ring, opening, depth };
        let placed = plan.place(ring, grasper);
        let point = on_line.tip;
        let tangent = ring.pose.rotation * Vector3::z().cross(&point_in_ring.coords).normalize();
        let crossing = placed.shaft.cross(&tangent).norm();
        if crossing < CROSSING_MIN {
            continue;
        }
        let parts = instrument_parts(&placed, grasper, opening, bench.tube_radius);
        if touches(&parts, &obstacles) || touches_own_ring(&parts, bench, ring, angle) {
            continue;
        }
        let radial = (point - ring.center()) / bench.ring_radius;
        // Deep, across the tube, and level, so that both pads bear evenly. With the ring's centre on the closing axis
        // its weight causes no torque between the pads.
        let swing = placed.closing.dot(&radial.cross(&up)).abs();
        let mut score = 0.5 * crossing + depth / bench.tube_radius - swing;
        score -= 0.5 * placed.closing.dot(&up).abs();
        // Room for the other hand, now or later.
        score += if other_holds {
            (point - held_at).norm().min(SEPARATION * bench.ring_radius) / bench.ring_radius
        } else {
            0.8 * radial.dot(&outwards)
        };
        score += 0.1 * placed.closing.dot(&closing_now).abs();
        if let Some(failed) = wish.not_again {
            score -= 1.5 * (1.0 - (failed - point_in_ring).norm() / (2.0 * bench.ring_radius));
        }
        if best.as_ref().is_none_or(|(best, _)| score > *best) {
            best = Some((score, plan));
        }
    }
    best.map(|(_, plan)| plan)
}

/// The opening that leaves equal room on both sides of a jaw: to the tube, and to a peg in the ring's centre.
pub fn comfortable_opening(bench: &BenchSeen, grasper: &GrasperSeen) -> f64 {
    let peg_radius = bench.pegs.first().map_or(0.0, |peg| peg.radius);
    let room = bench.ring_radius - peg_radius - bench.tube_radius - grasper.jaw_thickness;
    let half_gap = bench.tube_radius + 0.5 * room.max(0.0);
    (2.0 * (half_gap / grasper.jaw_length).min(1.0).asin()).min(grasper.jaw_angle_max)
}

/// How deep the tip can go beyond the tube's centre line before a corner of an opened blade is at the board \[m\].
fn depth_above_board(bench: &BenchSeen, on_line: &PlacedGrasp, grasper: &GrasperSeen, opening: f64) -> f64 {
    let up = bench.up();
    let sinks = -on_line.shaft.dot(&up);
    let half_gap = grasper.jaw_length * (0.5 * opening).sin() + grasper.jaw_thickness;
    let width = on_line.shaft.cross(&on_line.closing);
    let corner = half_gap * on_line.closing.dot(&up).abs() + 0.5 * grasper.jaw_width * width.dot(&up).abs();
    let room = bench.height(&on_line.tip) - corner + BOARD_TOUCH;
    if sinks > 1e-3 { (room / sinks).min(DEPTH_MAX) } else { DEPTH_MAX }
}

/// Capsules of both open blades and the shaft behind them.
fn instrument_parts(
    placed: &PlacedGrasp,
    grasper: &GrasperSeen,
    opening: f64,
    tube_radius: f64,
) -> [Capsule; 3] {
    let hinge = placed.tip - placed.shaft * grasper.jaw_length;
    let half = 0.5 * opening;
    let blade = |side: f64| {
        let along = placed.shaft * half.cos() + placed.closing * (side * half.sin());
        let offset = placed.closing * (side * 0.5 * grasper.jaw_thickness);
        // The end of the blade is as near to the board as the ring is, so it is excluded.
        let length = grasper.jaw_length - tube_radius;
        Capsule {
            from: hinge + offset,
            to: hinge + offset + along * length,
            radius: 0.6 * grasper.jaw_thickness,
        }
    };
    let shaft = Capsule { from: hinge, to: hinge - placed.shaft * SHAFT_SEEN, radius: grasper.shaft_radius };
    [blade(1.0), blade(-1.0), shaft]
}

fn obstacles(bench: &BenchSeen, moment: &MomentSeen, wish: &GraspRequest) -> Vec<Capsule> {
    let pegs = bench.pegs.iter().map(|peg| Capsule {
        from: peg.foot,
        to: peg.foot + peg.up * peg.height,
        radius: peg.radius,
    });
    let rings = moment.rings.iter().enumerate().filter(|(index, _)| *index != wish.ring);
    let tubes = rings.flat_map(|(_, ring)| (0..TUBE_PIECES).map(|piece| tube_piece(bench, ring, piece)));
    let other = &moment.hands[1 - wish.hand];
    let grasper = &bench.graspers[1 - wish.hand];
    let shaft = other.tip.rotation * Vector3::z();
    let tip = other.tip.translation.vector;
    let hinge = tip - shaft * grasper.jaw_length;
    let half_width = grasper.jaw_thickness + 0.5 * other.jaw_angle * grasper.jaw_length;
    let instrument = [
        Capsule { from: tip, to: hinge, radius: half_width },
        Capsule { from: hinge, to: hinge - shaft * SHAFT_SEEN, radius: grasper.shaft_radius },
    ];
    pegs.chain(tubes).chain(instrument).collect()
}

fn tube_piece(bench: &BenchSeen, ring: &RingSeen, piece: usize) -> Capsule {
    let at = |index: usize| {
        let angle = 2.0 * std::f64::consts::PI * index as f64 / TUBE_PIECES as f64;
        (ring.pose * (Point3::new(angle.cos(), angle.sin(), 0.0) * bench.ring_radius)).coords
    };
    Capsule { from: at(piece), to: at(piece + 1), radius: bench.tube_radius }
}

fn touches(parts: &[Capsule], obstacles: &[Capsule]) -> bool {
    parts.iter().any(|part| obstacles.iter().any(|obstacle| part.gap(obstacle) < MARGIN))
}

/// Whether blades or shaft pass through the ring away from the grasp.
fn touches_own_ring(parts: &[Capsule], bench: &BenchSeen, ring: &RingSeen, angle: f64) -> bool {
    let step = 2.0 * std::f64::consts::PI / TUBE_PIECES as f64;
    (0..TUBE_PIECES).any(|piece| {
        let away = (step * (piece as f64 + 0.5) - angle).rem_euclid(2.0 * std::f64::consts::PI);
        let away = away.min(2.0 * std::f64::consts::PI - away);
        let tube = tube_piece(bench, ring, piece);
        away > 0.8 && parts.iter().any(|part| part.gap(&tube) < MARGIN)
    })
}

/// Distance between two segments (Ericson 2005, "Real-Time Collision Detection", §5.1.9).
fn segment_distance(p1: &Vector3<f64>, q1: &Vector3<f64>, p2: &Vector3<f64>, q2: &Vector3<f64>) -> f64 {
    let (d1, d2, r) = (q1 - p1, q2 - p2, p1 - p2);
    let (a, e) = (d1.norm_squared().max(1e-18), d2.norm_squared().max(1e-18));
    let (b, c, f) = (d1.dot(&d2), d1.dot(&r), d2.dot(&r));
    let denominator = a * e - b * b;
    let mut s = if denominator > 1e-18 { ((b * f - c * e) / denominator).clamp(0.0, 1.0) } else { 0.0 };
    let mut t = (b * s + f) / e;
    if t < 0.0 {
        t = 0.0;
        s = (-c / a).clamp(0.0, 1.0);
    } else if t > 1.0 {
        t = 1.0;
        s = ((b - c) / a).clamp(0.0, 1.0);
    }
    ((p1 + d1 * s) - (p2 + d2 * t)).norm()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trainee_view::{HandSeen, PegSeen, tip_pose};
    use nalgebra::{Isometry3, UnitQuaternion};
    use proptest::prelude::*;

    fn grasper(x: f64) -> GrasperSeen {
        GrasperSeen {
            jaw_length: 0.018,
            jaw_width: 0.003,
            jaw_thickness: 0.0015,
            jaw_angle_max: 0.9,
            shaft_radius: 0.0025,
            apex: Vector3::new(x, -0.09, 0.17),
        }
    }

    fn bench() -> BenchSeen {
        let peg = |x: f64, board| PegSeen {
            board,
            foot: Vector3::new(x, 0.0, 0.0),
            up: Vector3::z(),
            height: 0.02,
            radius: 0.001,
        };
        BenchSeen {
            pegs: vec![peg(-0.04, 0), peg(-0.012, 0), peg(0.04, 1)],
            ring_radius: 0.008,
            tube_radius: 0.0015,
            graspers: [grasper(-0.1), grasper(0.1)],
            first_board: 0,
        }
    }

    fn moment(rings: Vec<Isometry3<f64>>) -> MomentSeen {
        let bench = bench();
        let hand = |index: usize| {
            let position = Vector3::new(if index == 0 { -0.03 } else { 0.05 }, 0.03, 0.08);
            HandSeen {
                tip: tip_pose(&position, &bench.graspers[index].apex, &Vector3::x()),
                jaw_angle: 0.0,
                held: None,
            }
        };
        let rings = rings.into_iter().map(|pose| RingSeen { pose, speed: 0.0 }).collect();
        MomentSeen { rings, hands: [hand(0), hand(1)] }
    }

    const LEFT: GraspRequest = GraspRequest { ring: 0, hand: 0, not_again: None };

    #[test]
    fn a_ring_around_a_peg_is_taken_level_and_from_the_side() {
        let (bench, moment) = (bench(), moment(vec![Isometry3::translation(-0.04, 0.0, 0.0015)]));
        let plan = plan_grasp(&bench, &moment, &LEFT).unwrap();
        let placed = plan.place(&moment.rings[0], &bench.graspers[0]);
        assert!(placed.closing.z.abs() < 0.2, "{}", placed.closing);
        assert!(placed.closing.dot(&placed.shaft).abs() < 1e-9);
        assert!(plan.depth >= DEPTH_MIN && placed.tip.z > 0.0, "{plan:?}");
        // The side that is turned away from the other hand.
        assert!(placed.tip.x < -0.04, "{}", placed.tip);
        // Between tube and peg, with about as much room to either.
        let half_gap = 0.018 * (0.5 * plan.opening).sin();
        let (to_tube, to_peg) = (half_gap - 0.0015, 0.008 - 0.001 - 0.0015 - half_gap);
        assert!(to_tube > 0.0015 && (to_tube - to_peg).abs() < 1e-9, "{to_tube} {to_peg}");
    }

    #[test]
    fn a_failed_grasp_is_followed_by_another() {
        let (bench, moment) = (bench(), moment(vec![Isometry3::translation(-0.04, 0.0, 0.0015)]));
        let first = plan_grasp(&bench, &moment, &LEFT).unwrap();
        let not_again = Some(first.point_in_ring);
        let second = plan_grasp(&bench, &moment, &GraspRequest { not_again, ..LEFT }).unwrap();
        assert!((second.point_in_ring - first.point_in_ring).norm() > 0.004);
    }

    #[test]
    fn the_receiver_keeps_away_from_the_giver() {
        let bench = bench();
        let center = Vector3::new(0.0, 0.02, 0.045);
        let mut moment = moment(vec![Isometry3::from_parts(center.into(), UnitQuaternion::identity())]);
        let held_at = center + Vector3::new(-0.64, 0.77, 0.0) * 0.008;
        moment.hands[0].tip = tip_pose(&held_at, &bench.graspers[0].apex, &Vector3::new(-0.64, 0.77, 0.0));
        moment.hands[0].held = Some(0);
        let plan = plan_grasp(&bench, &moment, &GraspRequest { hand: 1, ..LEFT }).unwrap();
        let placed = plan.place(&moment.rings[0], &bench.graspers[1]);
        let (one, other) = (held_at - center, placed.tip - placed.shaft * plan.depth - center);
        assert!(one.angle(&other).to_degrees() > 75.0, "{}", one.angle(&other).to_degrees());
    }

    #[test]
    fn what_cannot_be_reached_has_no_plan() {
        let bench = bench();
        // Below the board, and a ring that does not exist.
        let low = moment(vec![Isometry3::translation(-0.04, 0.0, -0.02)]);
        assert_eq!(plan_grasp(&bench, &low, &LEFT), None);
        assert_eq!(plan_grasp(&bench, &low, &GraspRequest { ring: 5, ..LEFT }), None);
    }

    #[test]
    fn segments_have_their_known_distances() {
        let v = Vector3::new;
        let distance = |a, b, c, d| segment_distance(&a, &b, &c, &d);
        let cross = distance(v(-1.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(0.0, -1.0, 2.0), v(0.0, 1.0, 2.0));
        assert!((cross - 2.0).abs() < 1e-12);
        let apart = distance(v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(3.0, 0.0, 0.0), v(4.0, 0.0, 0.0));
        assert!((apart - 2.0).abs() < 1e-12);
        let parallel = distance(v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(0.5, 1.0, 0.0), v(2.0, 1.0, 0.0));
        assert!((parallel - 1.0).abs() < 1e-12);
        let points = distance(v(0.0, 0.0, 0.0), v(0.0, 0.0, 0.0), v(0.0, 3.0, 4.0), v(0.0, 3.0, 4.0));
        assert!((points - 5.0).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn every_plan_is_a_pinch_that_clears_pegs_and_boards(
            x in -0.07..0.07f64, y in -0.03..0.03f64, z in 0.0015..0.06f64,
            tilt in 0.0..0.5f64, turn in 0.0..6.2f64, hand in 0usize..2,
        ) {
            let bench = bench();
            let axis = nalgebra::Unit::new_normalize(Vector3::new(turn.cos(), turn.sin(), 0.0));
            let height = z.max(0.0015 + 0.008 * tilt.sin());
            let pose = Isometry3::from_parts(
                Vector3::new(x, y, height).into(), UnitQuaternion::from_axis_angle(&axis, tilt));
            let moment = moment(vec![pose]);
            if let Some(plan) = plan_grasp(&bench, &moment, &GraspRequest { hand, ..LEFT }) {
                let placed = plan.place(&moment.rings[0], &bench.graspers[hand]);
                prop_assert!((placed.closing.norm() - 1.0).abs() < 1e-9);
                prop_assert!(placed.closing.dot(&placed.shaft).abs() < 1e-9);
                let tangent = pose.rotation * Vector3::z().cross(&plan.point_in_ring.coords).normalize();
                prop_assert!(placed.closing.dot(&tangent).abs() < 1e-9);
                prop_assert!((DEPTH_MIN..=DEPTH_MAX).contains(&plan.depth));
                let parts =
                    instrument_parts(&placed, &bench.graspers[hand], plan.opening, bench.tube_radius);
                for peg in &bench.pegs {
                    let peg = Capsule { from: peg.foot, to: peg.foot + peg.up * peg.height, radius: peg.radius };
                    prop_assert!(parts.iter().all(|part| part.gap(&peg) >= MARGIN));
                }
            }
        }
    }
}
