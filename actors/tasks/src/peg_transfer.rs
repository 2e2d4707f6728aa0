//! Peg transfer as a state machine: lifts, hand-overs and placements of each ring, and errors.
//!
//! The exercise is the first one of the FLS programme (MISTELS: Derossis et al. 1998): every ring is lifted with one
//! hand (the *giver*), handed to the other (the *receiver*) in mid-air, and placed on a free peg of the other board;
//! then all are transferred back with the roles swapped. The input of the machine is positions and opposing contacts;
//! it is independent of who moves the hands and of their skill.
//!
//! Rules, where FLS is not specific:
//! - the clock starts when an instrument first touches a ring, and stops when the last ring rests on its peg;
//! - a hand holds a ring until [`Rules::release_secs`] after the last opposing contact of its jaws;
//! - a ring that was dropped in view must be picked up again. After a valid hand-over the receiver may do so;
//!   a ring that the giver lifts must be handed over (again);
//! - a ring that was lifted by the wrong hand, or handed over while on the board, does not count as handed
//!   over: placing it is an error, and it must be transferred again;
//! - a ring that leaves the field of view while not held, or comes to rest below the boards out of reach, is lost; the
//!   exercise continues without it, but is not *completed*.

use serde::{Deserialize, Serialize};
use trocar_scene::Side;

use crate::motion_metrics::MotionMetrics;
use crate::peg_rules::{
    ErrorKind, ExerciseError, PegTransferSetup, RingObservation, Rules, TaskEvent, TipObservation,
};

/// Errors beyond this number are counted, not listed.
pub const MAX_ERRORS: usize = 256;

/// State of one ring in the current half.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum RingState {
    /// Waiting to be lifted.
    Waiting,
    /// Off the board, held by these hands (left, right).
    Held([bool; 2]),
    /// Released at this time; not yet at rest.
    Released { at_secs: f64 },
    /// Done: rests on this peg.
    Placed { peg: usize },
    /// Out of view or out of reach.
    Lost,
}

/// Progress of one ring.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct RingProgress {
    state: RingState,
    /// Whether it was validly handed over since the giver lifted it.
    handed_over: bool,
    /// Last opposing contact per hand \[s\].
    contact_secs: [Option<f64>; 2],
    /// Time since when it has been at rest \[s\].
    resting_since: Option<f64>,
}

impl RingProgress {
    const WAITING: Self =
        Self { state: RingState::Waiting, handed_over: false, contact_secs: [None; 2], resting_since: None };
}

/// Outcome of the exercise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
    /// All rings were transferred and returned.
    Completed,
    /// All rings that were not lost were transferred and returned.
    SomeLost,
    /// The time was up.
    CutOff,
}

/// The exercise's running state: plain data, enough to continue after a restart.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PegTransfer {
    now_secs: Option<f64>,
    started_secs: Option<f64>,
    ended_secs: Option<f64>,
    /// Whether the second half (rings back) has begun.
    returning: bool,
    /// The lifting hand of the current half.
    giver: Side,
    rings: Vec<RingProgress>,
    errors: Vec<ExerciseError>,
    errors_beyond: u32,
    metrics: [MotionMetrics; 2],
    outcome: Option<Outcome>,
}

fn index(side: Side) -> usize {
    match side {
        Side::Left => 0,
        Side::Right => 1,
    }
}

impl PegTransfer {
    /// An exercise with this many rings, not started; `first_giver` is the non-dominant hand.
    pub fn new(rings: usize, first_giver: Side) -> Self {
        Self {
            now_secs: None,
            started_secs: None,
            ended_secs: None,
            returning: false,
            giver: first_giver,
            rings: vec![RingProgress::WAITING; rings],
            errors: Vec::new(),
            errors_beyond: 0,
            metrics: Default::default(),
            outcome: None,
        }
    }

    /// Takes the observations at `secs` \[s\]; `rings` in the same order every time, `tips` left then right.
    ///
    /// Observations that are not later than the last, or with another number of rings, are ignored, and so
    /// is everything after the end.
    pub fn observe(
        &mut self,
        setup: &PegTransferSetup,
        secs: f64,
        rings: &[RingObservation],
        tips: &[TipObservation; 2],
    ) -> Vec<TaskEvent> {
        let mut happened = Vec::new();
        let stale = self.now_secs.is_some_and(|now| secs <= now);
        if stale || !secs.is_finite() || self.outcome.is_some() || rings.len() != self.rings.len() {
            return happened;
        }
        self.now_secs = Some(secs);
        let touched = |ring: &RingObservation| (0..2).any(|i| ring.touched_by[i] || ring.held_by[i]);
        if self.started_secs.is_none() {
            if !rings.iter().any(touched) {
                return happened;
            }
            self.started_secs = Some(secs);
            happened.push(TaskEvent::Started);
        }
        for (metrics, tip) in self.metrics.iter_mut().zip(tips) {
            metrics.sample(secs, tip.tip_in_world, tip.shaft_in_world, setup.rules.idle_speed);
        }
        for (ring, seen) in rings.iter().enumerate() {
            self.judge(setup, secs, ring, seen, &mut happened);
        }
        self.advance(setup, secs, &mut happened);
        happened
    }

    /// Updates one ring.
    fn judge(
        &mut self,
        setup: &PegTransferSetup,
        secs: f64,
        ring: usize,
        seen: &RingObservation,
        happened: &mut Vec<TaskEvent>,
    ) {
        let holders = self.holders(ring, secs, seen, &setup.rules);
        let held = holders != [false; 2];
        let state = self.rings[ring].state;
        if state == RingState::Lost {
            return;
        }
        if !held && !setup.view.contains(&seen.placement.center_in_world) {
            self.rings[ring].state = RingState::Lost;
            self.fail(ErrorKind::DropOutOfView, secs, ring, happened);
            return;
        }
        let fallen = setup.clearance(&seen.placement) < -setup.rules.fallen_below;
        if !held && fallen && seen.speed <= setup.rules.rest_speed {
            self.rings[ring].state = RingState::Lost;
            self.fail(ErrorKind::DropOutOfReach, secs, ring, happened);
            return;
        }
        match state {
            RingState::Waiting | RingState::Placed { .. }
                if held && setup.clearance(&seen.placement) > setup.rules.lift_clearance =>
            {
                self.lift(ring, holders, secs, happened);
            }
            RingState::Placed { peg } => {
                if !held && !setup.ring.is_around(&seen.placement, &setup.pegs[peg]) {
                    self.rings[ring] = RingProgress::WAITING;
                    self.fail(ErrorKind::Displaced, secs, ring, happened);
                }
            }
            RingState::Held(before) if held => {
                self.rings[ring].state = RingState::Held(holders);
                self.change_hands(setup, secs, ring, before, holders, seen, happened);
            }
            RingState::Held(_) => {
                self.rings[ring].state = RingState::Released { at_secs: secs };
                self.rings[ring].resting_since = None;
            }
            RingState::Released { .. } if held => self.rings[ring].state = RingState::Held(holders),
            RingState::Released { at_secs } => {
                if seen.speed > setup.rules.rest_speed {
                    self.rings[ring].resting_since = None;
                    return;
                }
                let since = *self.rings[ring].resting_since.get_or_insert(secs);
                if secs - since >= setup.rules.settle_secs {
                    self.settle(setup, ring, seen, at_secs, happened);
                }
            }
            RingState::Waiting | RingState::Lost => {}
        }
    }

    /// The hands that hold the ring; short gaps in the contacts are bridged.
    fn holders(&mut self, ring: usize, secs: f64, seen: &RingObservation, rules: &Rules) -> [bool; 2] {
        std::array::from_fn(|hand| {
            let last = &mut self.rings[ring].contact_secs[hand];
            if seen.held_by[hand] {
                *last = Some(secs);
            }
            last.is_some_and(|last| secs - last <= rules.release_secs)
        })
    }

    /// Handles a ring lifted off the board.
    fn lift(&mut self, ring: usize, holders: [bool; 2], secs: f64, happened: &mut Vec<TaskEvent>) {
        let giver_holds = holders[index(self.giver)];
        let progress = &mut self.rings[ring];
        progress.state = RingState::Held(holders);
        if giver_holds {
            progress.handed_over = false;
        }
        let wrong = !giver_holds && !progress.handed_over;
        let by = if giver_holds { self.giver } else { self.giver.other() };
        self.metrics[index(by)].mark();
        happened.push(TaskEvent::Lifted { ring, by });
        if wrong {
            self.fail(ErrorKind::WrongHand, secs, ring, happened);
        }
    }

    /// Handles a held ring that may have passed from both hands into one.
    #[expect(clippy::too_many_arguments, reason = "one moment's facts about one ring")]
    fn change_hands(
        &mut self,
        setup: &PegTransferSetup,
        secs: f64,
        ring: usize,
        before: [bool; 2],
        now: [bool; 2],
        seen: &RingObservation,
        happened: &mut Vec<TaskEvent>,
    ) {
        if before != [true; 2] || now == [true; 2] {
            return;
        }
        let to = self.giver.other();
        if !now[index(to)] {
            // The receiver released it: the ring is back in the giver's hand.
            self.rings[ring].handed_over = false;
            return;
        }
        if self.rings[ring].handed_over {
            return;
        }
        let on_peg = setup.ring.peg_inside(&seen.placement, &setup.pegs).is_some();
        if on_peg || setup.clearance(&seen.placement) < setup.rules.mid_air_clearance {
            self.fail(ErrorKind::NotInMidAir, secs, ring, happened);
            return;
        }
        self.rings[ring].handed_over = true;
        self.metrics.iter_mut().for_each(MotionMetrics::mark);
        happened.push(TaskEvent::HandedOver { ring, to });
    }

    /// Judges where a released ring has come to rest.
    fn settle(
        &mut self,
        setup: &PegTransferSetup,
        ring: usize,
        seen: &RingObservation,
        released_secs: f64,
        happened: &mut Vec<TaskEvent>,
    ) {
        let handed_over = self.rings[ring].handed_over;
        self.rings[ring].state = RingState::Waiting;
        let Some(peg) = setup.ring.peg_inside(&seen.placement, &setup.pegs) else {
            self.fail(ErrorKind::DropInView, released_secs, ring, happened);
            return;
        };
        let from_first = setup.pegs[peg].board == setup.first_board;
        if from_first != self.returning {
            // Put back on a peg of the board that it came from: this only costs time.
            return;
        }
        let occupied = self.rings.iter().any(|other| other.state == RingState::Placed { peg });
        if !handed_over {
            self.fail(ErrorKind::NoHandOver, released_secs, ring, happened);
        } else if occupied {
            self.fail(ErrorKind::PegOccupied, released_secs, ring, happened);
        } else {
            self.rings[ring].state = RingState::Placed { peg };
            self.metrics[index(self.giver.other())].mark();
            happened.push(TaskEvent::Placed { ring, peg });
        }
    }

    fn fail(&mut self, kind: ErrorKind, at_secs: f64, ring: usize, happened: &mut Vec<TaskEvent>) {
        let error = ExerciseError { kind, at_secs, ring };
        if self.errors.len() < MAX_ERRORS {
            self.errors.push(error);
        } else {
            self.errors_beyond = self.errors_beyond.saturating_add(1);
        }
        happened.push(TaskEvent::Error(error));
    }

    /// Swaps the roles after the last ring of the first half, and ends the exercise after the second.
    fn advance(&mut self, setup: &PegTransferSetup, secs: f64, happened: &mut Vec<TaskEvent>) {
        let settled = |ring: &RingProgress| matches!(ring.state, RingState::Placed { .. } | RingState::Lost);
        if self.rings.iter().all(settled) {
            if !self.returning && self.lost() < self.ring_count() {
                self.returning = true;
                self.giver = self.giver.other();
                for ring in self.rings.iter_mut().filter(|ring| ring.state != RingState::Lost) {
                    *ring = RingProgress::WAITING;
                }
                happened.push(TaskEvent::Returning);
            } else {
                let complete = self.lost() == 0;
                self.end(if complete { Outcome::Completed } else { Outcome::SomeLost }, secs, happened);
            }
        }
        if self.outcome.is_none() && setup.weights.cuts_off(self.seconds()) {
            self.end(Outcome::CutOff, secs, happened);
        }
    }

    fn end(&mut self, outcome: Outcome, secs: f64, happened: &mut Vec<TaskEvent>) {
        self.outcome = Some(outcome);
        self.ended_secs = Some(secs);
        happened.push(TaskEvent::Finished);
    }

    /// Number of rings.
    pub fn ring_count(&self) -> u32 {
        self.rings.len() as u32
    }
    /// Rings lost out of view or out of reach.
    pub fn lost(&self) -> u32 {
        self.rings.iter().filter(|ring| ring.state == RingState::Lost).count() as u32
    }
    /// Transfers done, of [`Self::steps`].
    pub fn done(&self) -> u32 {
        let placed = self.rings.iter().filter(|ring| matches!(ring.state, RingState::Placed { .. })).count();
        placed as u32 + if self.returning { self.ring_count() - self.lost() } else { 0 }
    }
    /// Total transfers: each ring is transferred and returned.
    pub fn steps(&self) -> u32 {
        2 * self.ring_count()
    }
    /// How it ended, if it has.
    pub fn outcome(&self) -> Option<Outcome> {
        self.outcome
    }
    /// Time on the exercise's clock \[s\]; 0 before the first touch, still after the end.
    pub fn seconds(&self) -> f64 {
        match (self.started_secs, self.ended_secs.or(self.now_secs)) {
            (Some(start), Some(now)) => now - start,
            _ => 0.0,
        }
    }
    /// The FLS-style score, once the exercise is over.
    pub fn score(&self, setup: &PegTransferSetup) -> Option<f64> {
        let kinds = self.errors.iter().map(|error| error.kind.as_str());
        match self.outcome? {
            Outcome::CutOff => Some(0.0),
            _ => Some(setup.weights.score(self.seconds(), self.lost(), self.ring_count(), kinds)),
        }
    }
    /// Errors so far, in order; at most [`MAX_ERRORS`].
    pub fn errors(&self) -> &[ExerciseError] {
        &self.errors
    }
    /// Errors that were counted only.
    pub fn errors_beyond(&self) -> u32 {
        self.errors_beyond
    }
    /// Motion metrics of the left, the right hand.
    pub fn metrics(&self) -> &[MotionMetrics; 2] {
        &self.metrics
    }
    /// The hand that lifts in the current half.
    pub fn giver(&self) -> Side {
        self.giver
    }
    /// Name of the current phase: that of the held ring with the most progress.
    pub fn phase(&self) -> &'static str {
        match self.outcome {
            Some(Outcome::CutOff) => return "cut_off",
            Some(_) => return "finished",
            None if self.started_secs.is_none() => return "waiting",
            None => {}
        }
        let held = |ring: &&RingProgress| matches!(ring.state, RingState::Held(_));
        let furthest = self.rings.iter().filter(held).map(|ring| ring.handed_over).max();
        match (self.returning, furthest) {
            (false, None) => "over.lift",
            (false, Some(false)) => "over.hand_over",
            (false, Some(true)) => "over.place",
            (true, None) => "back.lift",
            (true, Some(false)) => "back.hand_over",
            (true, Some(true)) => "back.place",
        }
    }
}
