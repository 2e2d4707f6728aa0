//! A kinematic double of the exercise: tips follow their commands, a ring sticks to jaws that close across its
//! tube, and falls straight down when nobody holds it. No forces, so a whole exercise takes milliseconds.

pub mod lockstep;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use trocar_input::autopilot::Autopilot;
use trocar_input::motor_model::{MotorParameters, TipCommand};
use trocar_input::strategy::Strategy;
use trocar_input::trainee_view::{BenchSeen, GrasperSeen, HandSeen, MomentSeen, PegSeen, RingSeen, tip_pose};
use trocar_scene::Side;

pub const DT: f64 = 0.01;
/// Time constant with which a tip follows its command \[s\].
const FOLLOW_SECS: f64 = 0.03;

/// The bench of the shipped exercise, its rings on board `first_board`.
pub fn bench(first_board: usize) -> BenchSeen {
    let peg = |board: usize, column: f64, row: f64| PegSeen {
        board,
        foot: Vector3::new(if board == 0 { -0.04 } else { 0.04 } + 0.028 * column, 0.015 * row, 0.0),
        up: Vector3::z(),
        height: 0.02,
        radius: 0.001,
    };
    let grasper = |x: f64| GrasperSeen {
        jaw_length: 0.018,
        jaw_width: 0.003,
        jaw_thickness: 0.0015,
        jaw_angle_max: 0.9,
        shaft_radius: 0.0025,
        apex: Vector3::new(x, -0.09, 0.17),
    };
    let board = |board| {
        [-1.0, 0.0, 1.0].into_iter().flat_map(move |column| [-1.0, 1.0].map(|row| peg(board, column, row)))
    };
    BenchSeen {
        pegs: board(0).chain(board(1)).collect(),
        ring_radius: 0.008,
        tube_radius: 0.0015,
        graspers: [grasper(-0.1), grasper(0.1)],
        first_board,
    }
}

/// Bench, rings, hands and the trainee.
pub struct Double {
    pub bench: BenchSeen,
    pub strategy: Strategy,
    pub parameters: MotorParameters,
    pub moment: MomentSeen,
    pub trainee: Autopilot,
    pub secs: f64,
    /// The n-th closing that would have grasped fails when this says so.
    pub slips: fn(u32) -> bool,
    pub closings: u32,
    held: [Option<(usize, Isometry3<f64>)>; 2],
    carriers: Vec<Option<usize>>,
    open_at: [f64; 2],
}

impl Double {
    pub fn new(first_giver: Side, parameters: MotorParameters, seed: u64) -> Self {
        let bench = bench(if first_giver == Side::Left { 0 } else { 1 });
        let rings = bench
            .pegs
            .iter()
            .filter(|peg| peg.board == bench.first_board)
            .map(|peg| RingSeen {
                pose: Isometry3::from_parts(
                    (peg.foot + peg.up * bench.tube_radius).into(),
                    UnitQuaternion::identity(),
                ),
                speed: 0.0,
            })
            .collect();
        let hand = |index: usize| {
            let position = Vector3::new(if index == 0 { -0.03 } else { 0.03 }, 0.0, 0.05);
            HandSeen {
                tip: tip_pose(&position, &bench.graspers[index].apex, &Vector3::x()),
                jaw_angle: 0.0,
                held: None,
            }
        };
        let moment = MomentSeen { rings, hands: [hand(0), hand(1)] };
        let trainee = Autopilot::new(&moment, first_giver, seed);
        Self {
            bench,
            strategy: Strategy::default(),
            parameters,
            moment,
            trainee,
            secs: 0.0,
            slips: |_| false,
            closings: 0,
            held: [None; 2],
            carriers: vec![None; 6],
            open_at: [0.0; 2],
        }
    }

    /// One tick of trainee and world.
    pub fn tick(&mut self) {
        self.secs += DT;
        let commands =
            self.trainee.step(&self.strategy, &self.bench, &self.moment, &self.parameters, self.secs, DT);
        let before: Vec<Vector3<f64>> = self.moment.rings.iter().map(RingSeen::center).collect();
        for (hand, command) in commands.iter().enumerate() {
            self.follow(hand, command);
        }
        self.fall();
        for (ring, before) in self.moment.rings.iter_mut().zip(before) {
            ring.speed = (ring.center() - before).norm() / DT;
        }
        for hand in 0..2 {
            self.moment.hands[hand].held = self.held[hand].map(|(ring, _)| ring);
        }
    }

    fn follow(&mut self, hand: usize, command: &TipCommand) {
        let grasper = self.bench.graspers[hand];
        let here = self.moment.hands[hand].tip.translation.vector;
        let share = 1.0 - (-DT / FOLLOW_SECS).exp();
        let position = here + (command.position - here) * share;
        let tip = tip_pose(&position, &grasper.apex, &command.closing);
        let grip = 2.0 * (self.bench.tube_radius / grasper.jaw_length).asin();
        let before = self.moment.hands[hand].jaw_angle;
        let after = command.jaw_angle.max(if self.held[hand].is_some() { grip } else { 0.0 });
        self.moment.hands[hand].tip = tip;
        self.moment.hands[hand].jaw_angle = after;
        if after > before {
            self.open_at[hand] = after;
        }
        if before > grip + 1e-9 && after <= grip + 1e-9 {
            self.close(hand);
        }
        if after > grip + 0.02 {
            self.release(hand);
        }
        if let Some((ring, tip_from_ring)) = self.held[hand]
            && self.carriers[ring] == Some(hand)
        {
            self.moment.rings[ring].pose = tip * tip_from_ring;
        }
    }

    /// A hand lets go; the other one carries on if it holds the same ring.
    pub fn release(&mut self, hand: usize) {
        let Some((ring, _)) = self.held[hand].take() else { return };
        self.carriers[ring] = match self.held[1 - hand] {
            Some((other, _)) if other == ring => Some(1 - hand),
            _ => None,
        };
        if let Some(carrier) = self.carriers[ring] {
            let pose = self.moment.rings[ring].pose;
            self.held[carrier] = Some((ring, self.moment.hands[carrier].tip.inv_mul(&pose)));
        }
    }

    /// Jaws close: a ring whose tube lies between them stays.
    fn close(&mut self, hand: usize) {
        let tip = self.moment.hands[hand].tip;
        let half_gap = self.bench.graspers[hand].jaw_length * (0.5 * self.open_at[hand]).sin();
        for ring in 0..self.moment.rings.len() {
            let pose = self.moment.rings[ring].pose;
            let between = (0..360).any(|degrees| {
                let angle = f64::from(degrees).to_radians();
                let on_tube = pose * (Point3::new(angle.cos(), angle.sin(), 0.0) * self.bench.ring_radius);
                let in_tip = tip.inverse_transform_point(&on_tube);
                in_tip.x.abs() < half_gap - self.bench.tube_radius
                    && in_tip.y.abs() < 0.0015
                    && (-0.006..=-0.0002).contains(&in_tip.z)
            });
            if between {
                self.closings += 1;
                if !(self.slips)(self.closings) {
                    self.held[hand] = Some((ring, tip.inv_mul(&pose)));
                    self.carriers[ring].get_or_insert(hand);
                    return;
                }
            }
        }
    }

    /// Rings that nobody holds drop flat onto the board.
    fn fall(&mut self) {
        for ring in 0..self.moment.rings.len() {
            if self.carriers[ring].is_some() {
                continue;
            }
            let seen = self.moment.rings[ring];
            let height = self.bench.height(&seen.center());
            if height > self.bench.tube_radius {
                let down = (0.3 * DT).min(height - self.bench.tube_radius);
                let center = seen.center() - self.bench.up() * down;
                let flat = UnitQuaternion::identity();
                let rotation = seen.pose.rotation.slerp(&flat, 0.3);
                self.moment.rings[ring].pose = Isometry3::from_parts(Translation3::from(center), rotation);
            } else {
                let center = seen.center() + self.bench.up() * (self.bench.tube_radius - height);
                self.moment.rings[ring].pose =
                    Isometry3::from_parts(center.into(), UnitQuaternion::identity());
            }
        }
    }

    /// Runs until the trainee is finished or `limit` \[s\] is over.
    pub fn run(&mut self, limit: f64) -> bool {
        while self.secs < limit && !self.trainee.finished() {
            self.tick();
        }
        self.trainee.finished()
    }

    /// Number of rings around pegs of a board.
    pub fn on_board(&self, board: usize) -> usize {
        let on = |ring: &&RingSeen| {
            self.bench.peg_inside(ring).is_some_and(|peg| self.bench.pegs[peg].board == board)
        };
        self.moment.rings.iter().filter(on).count()
    }
}
