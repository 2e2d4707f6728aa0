//! Where to take a ring: a point of its tube and a closing direction that the shaft allows.
//!
//! A grasper that passes a port can turn only about its own shaft `u`. To pinch the tube at a point with the
//! tangent `t` its closing direction must be `±(u × t)`; so a grasp is one number, the angle of the point on
//! the ring. The planner tries angles all round and keeps the best that touches nothing on its way in: no
//! board below the jaws, no peg, no other ring, not the other instrument.

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
/// How much of the shaft behind the jaws is looked at \[m\].
const SHAFT_SEEN: f64 = 0.06;
/// How far the corners of the blades may be aimed into the board \[m\]: a light touch, so that the jaws reach
/// as far around the tube as the board allows.
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

/// A grasp plan, placed in the world as the ring lies now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedGrasp {
    /// Where the tip goes \[m\].
    pub tip: Vector3<f64>,
    /// Unit direction of the shaft there.
    pub shaft: Vector3<f64>,
    /// Closing direction, unit.
    pub closing: Vector3<f64>,
}

/// What a planner should take into account besides the bench.
#[derive(Clone, Copy, Debug)]
pub struct GraspWish {
    /// Index of the ring.
    pub ring: usize,
    /// The hand: 0 left, 1 right.
    pub hand: usize,
    /// A grasp that just failed, to try another.
    pub not_again: Option<Point3<f64>>,
}

impl GraspPlan {
    /// Where the grasp is now.
    pub fn place(&self, ring: &RingSeen, grasper: &GrasperSeen) -> PlacedGrasp {
        let point = (ring.pose * self.point_in_ring).coords;
        let tangent = ring.pose.rotation * Vector3::z().cross(&self.point_in_ring.coords).normalize();
        // The tip lies beyond the point along the shaft, which changes the shaft's direction but little.
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
pub fn plan_grasp(bench: &BenchSeen, moment: &MomentSeen, wish: &GraspWish) -> Option<GraspPlan> {
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
        // Deep, across the tube, and level: then both pads bear evenly. With the ring's centre on the closing
        // axis its weight does not turn it between the pads.
        let swing = placed.closing.dot(&radial.cross(&up)).abs();
        let mut score = 0.5 * crossing + depth / bench.tube_radius - swing;
        score -= 0.5 * placed.closing.dot(&up).abs();
        // The other hand will need room, or already takes it.
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

/// Both blades, opened, and the shaft behind them.
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
        // The blade's last bit is as near to the board as the ring is: leave it out.
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

fn obstacles(bench: &BenchSeen, moment: &MomentSeen, wish: &GraspWish) -> Vec<Capsule> {
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

/// Whether blades or shaft pass through the ring elsewhere than at the grasp.
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
