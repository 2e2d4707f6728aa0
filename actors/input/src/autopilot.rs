//! Autopilot: a virtual trainee that performs the peg transfer with both hands.
//!
//! Each hand runs a sequence of steps; the two meet where one offers a ring and the other takes it:
//!
//! ```text
//! giver:    Reach → Enter → Pinch → Lift → Bring → Offer ──────→ Open → Back
//! receiver:           (waits)                Reach → Enter → Pinch → Take → Over → Lower → Open → Back
//! ```
//!
//! The trainee observes rings, pegs and its own instruments, and sets goals for its two tips; the motor model executes
//! the movements, and only it differs between skills. A failed pinch is tried again elsewhere on the ring; a ring that
//! slips away is picked up where it lies.

use nalgebra::{UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::Side;

use crate::grasp_planner::{GraspPlan, GraspRequest, comfortable_opening, plan_grasp};
use crate::motor_model::{HandMotor, MotorParameters, TipCommand, TipGoal};
use crate::noise::Noise;
use crate::strategy::{Step, Strategy};
use crate::trainee_view::{BenchSeen, MomentSeen, tip_for_point, tip_pose};

/// Planning state of one hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HandState {
    motor: HandMotor,
    step: Step,
    /// Start of the current step \[s\].
    since: f64,
    /// Its current ring.
    ring: Option<usize>,
    /// The ring was validly handed to this hand, so this hand may pick it up again.
    received: bool,
    /// Time of the last contact with its ring between the jaws \[s\], and start of the uninterrupted contact.
    felt_secs: Option<f64>,
    feeling_since: Option<f64>,
    /// The grasp that failed last.
    failed: Option<nalgebra::Point3<f64>>,
    /// Consecutive failed pinches and placements.
    failures: u32,
}

/// The trainee's whole state: plain data, enough to continue after a restart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Autopilot {
    hands: [HandState; 2],
    giver: usize,
    returning: bool,
    finished: bool,
    /// Time since when no step was possible \[s\].
    stuck_since: Option<f64>,
}

/// Index of a side: left 0, right 1.
fn index(side: Side) -> usize {
    match side {
        Side::Left => 0,
        Side::Right => 1,
    }
}

/// Observations of one tick for the strategy.
struct Scene<'a> {
    strategy: &'a Strategy,
    bench: &'a BenchSeen,
    moment: &'a MomentSeen,
    parameters: &'a MotorParameters,
    now: f64,
}

impl Autopilot {
    /// A trainee whose hands rest at their current poses; `first_giver` is its non-dominant hand.
    pub fn new(moment: &MomentSeen, first_giver: Side, seed: u64) -> Self {
        let hand = |index: usize| {
            let seen = &moment.hands[index];
            let closing = seen.tip.rotation * Vector3::x();
            HandState {
                motor: HandMotor::new(
                    seen.tip.translation.vector,
                    closing,
                    seen.jaw_angle,
                    Noise::new(seed, index as u64),
                ),
                step: Step::Back,
                since: 0.0,
                ring: None,
                received: false,
                felt_secs: None,
                feeling_since: None,
                failed: None,
                failures: 0,
            }
        };
        Self {
            hands: [hand(0), hand(1)],
            giver: index(first_giver),
            returning: false,
            finished: false,
            stuck_since: None,
        }
    }

    /// Whether it has finished.
    pub fn finished(&self) -> bool {
        self.finished
    }
    /// Current steps of the left and the right hand.
    pub fn steps(&self) -> [Step; 2] {
        self.hands.map(|hand| hand.step)
    }
    /// Current rings of the left and the right hand.
    pub fn rings(&self) -> [Option<usize>; 2] {
        self.hands.map(|hand| hand.ring)
    }
    /// Whether the second half (rings back) has begun.
    pub fn returning(&self) -> bool {
        self.returning
    }

    /// One step of `dt` \[s\] that ends at `now` \[s\]: observes, decides, moves. Returns commands for left and right.
    pub fn step(
        &mut self,
        strategy: &Strategy,
        bench: &BenchSeen,
        moment: &MomentSeen,
        parameters: &MotorParameters,
        now: f64,
        dt: f64,
    ) -> [TipCommand; 2] {
        let scene = Scene { strategy, bench, moment, parameters, now };
        for hand in 0..2 {
            self.feel(&scene, hand);
            self.proceed(&scene, hand);
        }
        self.turn_round(&scene);
        std::array::from_fn(|hand| {
            let seen = moment.hands[hand].tip.translation.vector;
            self.hands[hand].motor.advance(now, dt, &seen, parameters)
        })
    }

    /// Tracks the ring between the jaws.
    fn feel(&mut self, scene: &Scene<'_>, hand: usize) {
        let state = &mut self.hands[hand];
        if state.ring.is_some() && scene.moment.hands[hand].held == state.ring {
            state.felt_secs = Some(scene.now);
            state.feeling_since.get_or_insert(scene.now);
        } else if state.felt_secs.is_none_or(|felt| scene.now - felt > 0.05) {
            state.feeling_since = None;
        }
    }

    fn holds_firmly(&self, scene: &Scene<'_>, hand: usize) -> bool {
        self.hands[hand].feeling_since.is_some_and(|since| scene.now - since >= scene.strategy.verify_secs)
    }

    fn has_lost(&self, scene: &Scene<'_>, hand: usize) -> bool {
        self.hands[hand].felt_secs.is_none_or(|felt| scene.now - felt > scene.strategy.loss_secs)
    }

    /// Whether a receiver reaches for a ring that the giver no longer offers.
    fn waits_in_vain(&self, hand: usize) -> bool {
        let (state, other) = (&self.hands[hand], &self.hands[1 - hand]);
        hand != self.giver && !state.received && !(other.step == Step::Offer && other.ring == state.ring)
    }

    fn enter(&mut self, scene: &Scene<'_>, hand: usize, step: Step) {
        self.hands[hand].step = step;
        self.hands[hand].since = scene.now;
    }

    fn aim(
        &mut self,
        scene: &Scene<'_>,
        hand: usize,
        position: Vector3<f64>,
        closing: Vector3<f64>,
        tolerance: Option<f64>,
        planned: bool,
    ) {
        let goal = TipGoal { position, closing, tolerance };
        self.hands[hand].motor.aim(scene.now, goal, scene.parameters, planned);
    }

    /// Starts one hand's next step when the current one is done.
    fn proceed(&mut self, scene: &Scene<'_>, hand: usize) {
        let state = self.hands[hand];
        let arrived = state.motor.arrived();
        let carrying = matches!(
            state.step,
            Step::Lift | Step::Bring | Step::Offer | Step::Take | Step::Over(_) | Step::Lower(_)
        );
        if carrying && self.has_lost(scene, hand) {
            self.hands[hand].failures += 1;
            self.let_go(scene, hand);
            return;
        }
        let grasping = matches!(state.step, Step::Reach(_) | Step::Enter(_) | Step::Pinch(_));
        if grasping && self.waits_in_vain(hand) {
            self.let_go(scene, hand);
            return;
        }
        match state.step {
            Step::Rest => self.decide(scene, hand),
            Step::Reach(plan) if arrived => self.go_in(scene, hand, plan),
            Step::Enter(plan) if arrived => {
                self.hands[hand].motor.set_jaw(0.0);
                self.enter(scene, hand, Step::Pinch(plan));
            }
            Step::Pinch(plan) => self.pinch(scene, hand, plan),
            Step::Lift if arrived => self.carry_on(scene, hand),
            Step::Bring if arrived => self.enter(scene, hand, Step::Offer),
            Step::Offer => {
                let other = &self.hands[1 - hand];
                if other.step == Step::Take && other.ring == state.ring {
                    self.let_go(scene, hand);
                }
            }
            Step::Take => self.take(scene, hand),
            Step::Over(peg) if arrived => self.check_over(scene, hand, peg),
            Step::Lower(_) if arrived => self.let_go(scene, hand),
            Step::Open => {
                let open = scene.moment.hands[hand].jaw_angle >= 0.8 * self.opening(hand);
                if state.motor.jaw_settled() && (open || scene.now - state.since > 0.6) {
                    self.withdraw(scene, hand);
                }
            }
            Step::Back if arrived => {
                self.forget(scene, hand);
                self.decide(scene, hand);
            }
            _ => {}
        }
    }

    /// The opening of the hand's current grasp, or a default without one.
    fn opening(&self, hand: usize) -> f64 {
        self.hands[hand].motor.jaw_goal()
    }

    // --- Choosing what to do ---------------------------------------------------------------------------

    fn decide(&mut self, scene: &Scene<'_>, hand: usize) {
        if self.finished {
            return self.rest(scene, hand);
        }
        let other = self.hands[1 - hand];
        if hand != self.giver {
            // The receiver picks up a ring that slipped out of its own jaws.
            if self.hands[hand].received
                && let Some(ring) = self.hands[hand].ring
            {
                if self.can_be_taken(scene, ring) && self.try_ring(scene, hand, ring, true) {
                    return;
                }
                let seen = &scene.moment.rings[ring];
                let fallen =
                    scene.bench.height(&seen.center()) <= 0.0 && seen.speed < scene.strategy.rest_speed;
                if self.is_done(scene, ring) || fallen || self.hands[hand].failures > 2 {
                    self.hands[hand].received = false;
                    self.hands[hand].ring = None;
                }
            } else if other.step == Step::Offer
                && let Some(ring) = other.ring
                && self.try_ring(scene, hand, ring, false)
            {
                return;
            }
        } else if let Some(ring) = self.next_ring(scene, hand) {
            let anew = self.hands[hand].step != Step::Rest;
            if self.try_ring(scene, hand, ring, anew) {
                return;
            }
        }
        self.rest(scene, hand);
    }

    /// Plans a grasp of the ring and starts it.
    fn try_ring(&mut self, scene: &Scene<'_>, hand: usize, ring: usize, planned: bool) -> bool {
        let wish = GraspRequest { ring, hand, not_again: self.hands[hand].failed };
        let Some(plan) = plan_grasp(scene.bench, scene.moment, &wish) else { return false };
        let placed = plan.place(&scene.moment.rings[ring], &scene.bench.graspers[hand]);
        let stand_off = placed.tip - placed.shaft * scene.strategy.stand_off;
        self.hands[hand].ring = Some(ring);
        self.hands[hand].felt_secs = None;
        self.hands[hand].feeling_since = None;
        self.hands[hand].motor.set_jaw(plan.opening);
        self.aim(scene, hand, stand_off, placed.closing, Some(scene.strategy.way_tolerance), planned);
        self.enter(scene, hand, Step::Reach(plan));
        true
    }

    /// The unfinished ring that is nearest to the hand, among those that can be grasped.
    fn next_ring(&self, scene: &Scene<'_>, hand: usize) -> Option<usize> {
        let tip = scene.moment.hands[hand].tip.translation.vector;
        let busy = self.hands[1 - hand].ring;
        let mut rings: Vec<usize> = (0..scene.moment.rings.len())
            .filter(|ring| busy != Some(*ring) && !self.is_done(scene, *ring))
            .filter(|ring| self.can_be_taken(scene, *ring))
            .collect();
        let distance = |ring: &usize| (scene.moment.rings[*ring].center() - tip).norm();
        rings.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
        // After repeated failures another ring may be easier.
        if self.hands[hand].failures >= 3 && rings.len() > 1 {
            let turn = self.hands[hand].failures as usize % rings.len();
            rings.rotate_left(turn);
        }
        rings.into_iter().find(|ring| {
            let wish = GraspRequest { ring: *ring, hand, not_again: self.hands[hand].failed };
            plan_grasp(scene.bench, scene.moment, &wish).is_some()
        })
    }

    fn can_be_taken(&self, scene: &Scene<'_>, ring: usize) -> bool {
        let seen = &scene.moment.rings[ring];
        let held = scene.moment.hands.iter().any(|hand| hand.held == Some(ring));
        let on_board = scene.bench.height(&seen.center()) > 0.0;
        !held && on_board && seen.speed < scene.strategy.rest_speed
    }

    fn target_board(&self, scene: &Scene<'_>) -> usize {
        if self.returning { scene.bench.first_board } else { 1 - scene.bench.first_board }
    }

    /// Whether the ring is placed in this half: on a peg of the target board, as the only or the lowest ring.
    fn is_done(&self, scene: &Scene<'_>, ring: usize) -> bool {
        let held = scene.moment.hands.iter().any(|hand| hand.held == Some(ring));
        let peg = scene.bench.peg_of(&scene.moment.rings, ring);
        !held && peg.is_some_and(|peg| scene.bench.pegs[peg].board == self.target_board(scene))
    }

    /// The nearest free peg of the target board.
    fn free_peg(&self, scene: &Scene<'_>, ring: usize) -> Option<usize> {
        let others = || scene.moment.rings.iter().enumerate().filter(|(index, _)| *index != ring);
        let taken = |peg: usize| {
            let foot = scene.bench.pegs[peg].foot;
            let up = scene.bench.pegs[peg].up;
            others().any(|(_, other)| {
                scene.bench.peg_inside(other) == Some(peg)
                    || (other.center() - foot - up * (other.center() - foot).dot(&up)).norm()
                        < scene.bench.ring_radius
            })
        };
        let center = scene.moment.rings[ring].center();
        let distance = |peg: &usize| (scene.bench.pegs[*peg].foot - center).norm();
        (0..scene.bench.pegs.len())
            .filter(|peg| scene.bench.pegs[*peg].board == self.target_board(scene) && !taken(*peg))
            .min_by(|a, b| distance(a).total_cmp(&distance(b)))
    }

    // --- The steps -------------------------------------------------------------------------------------

    fn rest(&mut self, scene: &Scene<'_>, hand: usize) {
        if self.hands[hand].step == Step::Rest {
            return;
        }
        let meeting = self.meeting_point(scene);
        let outwards = self.outwards(scene, hand);
        let position = meeting + outwards * 0.035 + scene.bench.up() * 0.015;
        let closing = self.hands[hand].motor.goal().closing;
        self.aim(scene, hand, position, closing, None, true);
        self.enter(scene, hand, Step::Rest);
    }

    /// Horizontal unit direction from the other hand's port to this hand's.
    fn outwards(&self, scene: &Scene<'_>, hand: usize) -> Vector3<f64> {
        let up = scene.bench.up();
        let across = scene.bench.graspers[hand].apex - scene.bench.graspers[1 - hand].apex;
        (across - up * across.dot(&up)).try_normalize(1e-9).unwrap_or_else(Vector3::x)
    }

    /// Position of a ring's centre at the hand-over.
    fn meeting_point(&self, scene: &Scene<'_>) -> Vector3<f64> {
        let pegs = &scene.bench.pegs;
        let count = pegs.len().max(1) as f64;
        let middle = pegs.iter().fold(Vector3::zeros(), |sum, peg| sum + peg.foot) / count;
        let height = pegs.iter().map(|peg| peg.height).fold(0.0, f64::max);
        let up = scene.bench.up();
        let behind = up.cross(&self.outwards(scene, 1));
        middle + behind * scene.strategy.hand_over_behind + up * (height + scene.strategy.hand_over_above)
    }

    fn go_in(&mut self, scene: &Scene<'_>, hand: usize, plan: GraspPlan) {
        let Some(ring) = self.hands[hand].ring else { return self.let_go(scene, hand) };
        // The ring may have been moved meanwhile.
        let placed = plan.place(&scene.moment.rings[ring], &scene.bench.graspers[hand]);
        self.aim(scene, hand, placed.tip, placed.closing, Some(scene.strategy.grasp_tolerance), true);
        self.enter(scene, hand, Step::Enter(plan));
    }

    fn pinch(&mut self, scene: &Scene<'_>, hand: usize, plan: GraspPlan) {
        if self.holds_firmly(scene, hand) {
            self.hands[hand].failures = 0;
            self.hands[hand].failed = None;
            if hand == self.giver || self.hands[hand].received {
                self.lift(scene, hand);
            } else {
                self.enter(scene, hand, Step::Take);
            }
        } else if scene.now - self.hands[hand].since > scene.strategy.pinch_secs {
            self.hands[hand].failures += 1;
            self.hands[hand].failed = Some(plan.point_in_ring);
            self.let_go(scene, hand);
        }
    }

    fn lift(&mut self, scene: &Scene<'_>, hand: usize) {
        let Some(ring) = self.hands[hand].ring else { return self.let_go(scene, hand) };
        let seen = &scene.moment.rings[ring];
        let up = scene.bench.up();
        let peg_height = scene.bench.pegs.iter().map(|peg| peg.height).fold(0.0, f64::max);
        let wanted = peg_height + scene.strategy.carry_clearance + scene.bench.drop_below_center(seen);
        let raise = (wanted - scene.bench.height(&seen.center())).max(0.0);
        let goal = *self.hands[hand].motor.goal();
        self.aim(scene, hand, goal.position + up * raise, goal.closing, None, true);
        self.enter(scene, hand, Step::Lift);
    }

    /// After the lift: to the hand-over, or directly to a peg if it was already handed over.
    fn carry_on(&mut self, scene: &Scene<'_>, hand: usize) {
        if self.hands[hand].received {
            return self.go_over(scene, hand);
        }
        let goal = self.meeting_point(scene);
        self.carry(scene, hand, goal, scene.strategy.way_tolerance);
        self.enter(scene, hand, Step::Bring);
    }

    /// Moves the tip so that the held ring's centre comes to `center`, and rolls so that the ring lies as level
    /// as the roll alone can make it.
    fn carry(&mut self, scene: &Scene<'_>, hand: usize, center: Vector3<f64>, tolerance: f64) {
        let Some(ring) = self.hands[hand].ring else { return };
        let seen = &scene.moment.rings[ring];
        let tip = &scene.moment.hands[hand].tip;
        let apex = scene.bench.graspers[hand].apex;
        let up = scene.bench.up();
        let tip_from_ring = tip.inv_mul(&seen.pose);
        let offset = tip_from_ring.translation.vector.into();
        let normal_in_tip = tip.rotation.inverse_transform_vector(&seen.normal(&up));
        let closing = tip.rotation * Vector3::x();
        let there = tip_pose(&tip_for_point(&center, &offset, &apex, &closing), &apex, &closing);
        let closing = level(&there.rotation, &normal_in_tip, &up);
        let position = tip_for_point(&center, &offset, &apex, &closing);
        self.aim(scene, hand, position, closing, Some(tolerance), true);
    }

    fn take(&mut self, scene: &Scene<'_>, hand: usize) {
        let Some(ring) = self.hands[hand].ring else { return self.let_go(scene, hand) };
        let other = &self.hands[1 - hand];
        let free = scene.moment.hands[1 - hand].held != Some(ring);
        if free && !matches!(other.step, Step::Offer | Step::Open) {
            let away = (scene.moment.hands[1 - hand].tip.translation.vector
                - scene.moment.rings[ring].center())
            .norm();
            if away > 0.6 * scene.strategy.stand_off + scene.bench.ring_radius || other.step == Step::Rest {
                self.hands[hand].received = true;
                self.go_over(scene, hand);
            }
        }
    }

    fn go_over(&mut self, scene: &Scene<'_>, hand: usize) {
        let Some(ring) = self.hands[hand].ring else { return self.let_go(scene, hand) };
        let Some(peg) = self.free_peg(scene, ring) else { return self.let_go(scene, hand) };
        let seen = &scene.bench.pegs[peg];
        let room = scene.strategy.carry_clearance + scene.bench.drop_below_center(&scene.moment.rings[ring]);
        let center = seen.foot + seen.up * (seen.height + room);
        self.carry(scene, hand, center, scene.strategy.peg_tolerance);
        self.enter(scene, hand, Step::Over(peg));
    }

    fn check_over(&mut self, scene: &Scene<'_>, hand: usize, peg: usize) {
        let Some(ring) = self.hands[hand].ring else { return self.let_go(scene, hand) };
        let (seen, peg_seen) = (&scene.moment.rings[ring], &scene.bench.pegs[peg]);
        let off = seen.center() - peg_seen.foot;
        let lateral = (off - peg_seen.up * off.dot(&peg_seen.up)).norm();
        if lateral > 2.0 * scene.strategy.peg_tolerance && self.hands[hand].failures < 4 {
            self.hands[hand].failures += 1;
            return self.go_over(scene, hand);
        }
        self.hands[hand].failures = 0;
        let low = scene.bench.drop_below_center(seen) + 0.0005;
        self.carry(scene, hand, peg_seen.foot + peg_seen.up * low, scene.strategy.way_tolerance);
        self.enter(scene, hand, Step::Lower(peg));
    }

    fn let_go(&mut self, scene: &Scene<'_>, hand: usize) {
        let opening = comfortable_opening(scene.bench, &scene.bench.graspers[hand]);
        self.hands[hand].motor.set_jaw(opening);
        self.enter(scene, hand, Step::Open);
    }

    fn withdraw(&mut self, scene: &Scene<'_>, hand: usize) {
        let tip = &scene.moment.hands[hand].tip;
        let back = tip.rotation * Vector3::z() * -scene.strategy.stand_off;
        let closing = self.hands[hand].motor.goal().closing;
        self.aim(scene, hand, tip.translation.vector + back, closing, None, true);
        self.enter(scene, hand, Step::Back);
    }

    /// After withdrawing, releases the ring: it is in the other hand, on its peg, or to be picked up again.
    fn forget(&mut self, scene: &Scene<'_>, hand: usize) {
        let keeps = hand != self.giver
            && self.hands[hand].received
            && self.hands[hand].ring.is_some_and(|ring| !self.is_done(scene, ring));
        if !keeps {
            self.hands[hand].ring = None;
            self.hands[hand].received = false;
        }
    }

    /// Swaps the roles when all rings are transferred; finishes when all are back.
    fn turn_round(&mut self, scene: &Scene<'_>) {
        let idle = self.hands.iter().all(|hand| hand.step == Step::Rest);
        if self.finished || !idle {
            self.stuck_since = None;
            return;
        }
        let all_done = (0..scene.moment.rings.len()).all(|ring| self.is_done(scene, ring));
        let since = *self.stuck_since.get_or_insert(scene.now);
        if !all_done && scene.now - since < scene.strategy.patience_secs {
            return;
        }
        if self.returning {
            self.finished = true;
        } else {
            self.returning = true;
            self.giver = 1 - self.giver;
        }
        for hand in &mut self.hands {
            hand.ring = None;
            hand.received = false;
            hand.failed = None;
            hand.failures = 0;
        }
        self.stuck_since = None;
    }
}

/// The closing direction that, by roll about the shaft alone, turns a normal fixed to the instrument as far up as
/// possible; at most by 35°, a comfortable limit of the wrist.
fn level(rotation: &UnitQuaternion<f64>, normal_in_tip: &Vector3<f64>, up: &Vector3<f64>) -> Vector3<f64> {
    let shaft = rotation * Vector3::z();
    let normal = rotation * normal_in_tip;
    let sine = up.dot(&shaft.cross(&normal));
    let cosine = up.dot(&normal) - up.dot(&shaft) * shaft.dot(&normal);
    let roll = sine.atan2(cosine).clamp(-0.6, 0.6);
    let closing = rotation * Vector3::x();
    closing * roll.cos() + shaft.cross(&closing) * roll.sin()
}
