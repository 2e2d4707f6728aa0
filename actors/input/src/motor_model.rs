//! Motor model of a trainee's hand: reaction, reach, error, correction, tremor.
//!
//! - A reach follows the minimum-jerk profile (Flash & Hogan 1985, "The coordination of arm movements").
//! - Its duration grows with distance over tolerance (Fitts 1954), and its peak speed is limited.
//! - Its end point errs in proportion to its distance, more along the movement than across (signal-dependent
//!   noise: Harris & Wolpert 1998; van Beers, Haggard & Wolpert 2004).
//! - Visual feedback then corrects with smaller reaches, one reaction time apart (Meyer et al. 1988).
//! - Tremor is added: 8–12 Hz, tens to hundreds of micrometres (Elble & Koller 1990; Riviere & Khosla 1997 measured
//!   surgeons' hands).
//!
//! A skill is only a set of [`MotorParameters`]; the strategy does not depend on it.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use thiserror::Error;

use crate::noise::{Noise, Tremor};

/// Most corrections of one movement; then it counts as done.
const CORRECTIONS_MAX: u8 = 5;
/// A correction aims at most this far from the goal itself \[m\].
const CORRECTION_REACH_MAX: f64 = 0.004;
/// Error across the movement relative to the error along it.
const LATERAL_ERROR: f64 = 0.5;
/// Peak speed of a minimum-jerk reach over its mean speed.
const PEAK_OVER_MEAN: f64 = 1.875;
/// No reach is shorter than this \[s\].
const REACH_SECS_MIN: f64 = 0.1;

/// How well practised a trainee is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Skill {
    /// First attempts.
    Novice,
    /// Some weeks of practice.
    Intermediate,
    /// Proficient.
    #[default]
    Expert,
}

/// Parameters of a trainee's motor behaviour.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MotorParameters {
    /// Tremor of the tip, root mean square per axis \[m\].
    pub tremor_rms: f64,
    /// Its centre frequency \[Hz\].
    pub tremor_hz: f64,
    /// Visual reaction time \[s\].
    pub reaction_secs: f64,
    /// Fitts: time of a movement without difficulty \[s\].
    pub fitts_base_secs: f64,
    /// Fitts: time per bit of difficulty \[s\].
    pub fitts_secs_per_bit: f64,
    /// Largest speed of the tip \[m/s\].
    pub peak_speed: f64,
    /// Standard deviation of a reach's end point along it, per metre of distance.
    pub aim_error: f64,
    /// Speed of opening and closing the gripper \[rad/s\].
    pub jaw_speed: f64,
}

/// A parameter outside of its range.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("motor parameter {name} is {value}; valid: {min} to {max}")]
pub struct MotorParameterError {
    /// Which one.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Least valid value.
    pub min: f64,
    /// Largest valid value.
    pub max: f64,
}

impl MotorParameters {
    /// Typical numbers of a skill. Reaction times span the visual reaction times of adults (Luce 1986,
    /// 0.18–0.4 s), tremor the range measured in surgeons' hands, 0.05–0.5 mm; speeds and Fitts slopes are
    /// set so that a transfer takes an expert 6–8 s, as it does a trained resident.
    pub fn of(skill: Skill) -> Self {
        match skill {
            Skill::Expert => Self {
                tremor_rms: 0.08e-3,
                tremor_hz: 10.0,
                reaction_secs: 0.20,
                fitts_base_secs: 0.12,
                fitts_secs_per_bit: 0.14,
                peak_speed: 0.20,
                aim_error: 0.02,
                jaw_speed: 3.0,
            },
            Skill::Intermediate => Self {
                tremor_rms: 0.16e-3,
                tremor_hz: 9.5,
                reaction_secs: 0.26,
                fitts_base_secs: 0.15,
                fitts_secs_per_bit: 0.18,
                peak_speed: 0.15,
                aim_error: 0.045,
                jaw_speed: 2.2,
            },
            Skill::Novice => Self {
                tremor_rms: 0.28e-3,
                tremor_hz: 9.0,
                reaction_secs: 0.34,
                fitts_base_secs: 0.20,
                fitts_secs_per_bit: 0.23,
                peak_speed: 0.10,
                aim_error: 0.08,
                jaw_speed: 1.5,
            },
        }
    }

    /// Refuses parameters out of range.
    ///
    /// # Errors
    /// Names the parameter and its range.
    pub fn validate(&self) -> Result<(), MotorParameterError> {
        let check = |name, value: f64, min, max| {
            if (min..=max).contains(&value) {
                Ok(())
            } else {
                Err(MotorParameterError { name, value, min, max })
            }
        };
        check("tremor_rms", self.tremor_rms, 0.0, 0.005)?;
        check("tremor_hz", self.tremor_hz, 1.0, 20.0)?;
        check("reaction_secs", self.reaction_secs, 0.0, 2.0)?;
        check("fitts_base_secs", self.fitts_base_secs, 0.0, 5.0)?;
        check("fitts_secs_per_bit", self.fitts_secs_per_bit, 0.0, 5.0)?;
        check("peak_speed", self.peak_speed, 0.005, 2.0)?;
        check("aim_error", self.aim_error, 0.0, 0.5)?;
        check("jaw_speed", self.jaw_speed, 0.1, 50.0)
    }

    /// Duration of a reach over `distance` \[m\] that must end within `tolerance` \[m\]: Fitts' law in the form
    /// `a + b log₂(D/W + 1)` with `W = 2 · tolerance`, and never faster than the peak speed allows \[s\].
    pub fn reach_secs(&self, distance: f64, tolerance: f64) -> f64 {
        let width = 2.0 * tolerance.max(1e-4);
        let fitts = self.fitts_base_secs + self.fitts_secs_per_bit * (distance / width + 1.0).log2();
        fitts.max(PEAK_OVER_MEAN * distance / self.peak_speed).max(REACH_SECS_MIN)
    }
}

/// The minimum-jerk profile: share of the way at the share `tau` of the time, both clamped to \[0, 1\].
pub fn minimum_jerk(tau: f64) -> f64 {
    let tau = tau.clamp(0.0, 1.0);
    tau.powi(3) * (10.0 - 15.0 * tau + 6.0 * tau * tau)
}

/// Goal of an instrument's tip.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TipGoal {
    /// Position of the tip in world \[m\].
    pub position: Vector3<f64>,
    /// Target closing direction of the jaws in world, unit; the sign does not matter.
    pub closing: Vector3<f64>,
    /// Position tolerance \[m\]; `None` for a via point without visual correction.
    pub tolerance: Option<f64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
struct Reach {
    from: Vector3<f64>,
    to: Vector3<f64>,
    closing_from: Vector3<f64>,
    closing_to: Vector3<f64>,
    start_secs: f64,
    duration_secs: f64,
}

#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
enum Phase {
    /// At the goal, or without one.
    Arrived,
    /// The movement starts at this time \[s\].
    Reacting(f64),
    Moving(Reach),
    /// Checks the tip's position at this time \[s\].
    Looking(f64),
}

/// Current command of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipCommand {
    /// Position of the tip in world \[m\], tremor included.
    pub position: Vector3<f64>,
    /// Closing direction in world, unit.
    pub closing: Vector3<f64>,
    /// Full opening of the jaws \[rad\].
    pub jaw_angle: f64,
}

/// One hand: plain data, enough to continue after a restart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HandMotor {
    position: Vector3<f64>,
    closing: Vector3<f64>,
    jaw_angle: f64,
    jaw_goal: f64,
    goal: TipGoal,
    phase: Phase,
    corrections: u8,
    tremor: Tremor,
    noise: Noise,
}

impl HandMotor {
    /// A hand at rest at `position` \[m\] with its jaws closing along `closing`, opened by `jaw_angle` \[rad\].
    pub fn new(position: Vector3<f64>, closing: Vector3<f64>, jaw_angle: f64, noise: Noise) -> Self {
        Self {
            position,
            closing,
            jaw_angle,
            jaw_goal: jaw_angle,
            goal: TipGoal { position, closing, tolerance: None },
            phase: Phase::Arrived,
            corrections: 0,
            tremor: Tremor::default(),
            noise,
        }
    }

    /// Starts towards `goal` at once (a planned movement) or after the reaction time (a response to a visual stimulus).
    pub fn aim(&mut self, now: f64, goal: TipGoal, parameters: &MotorParameters, planned: bool) {
        // Jaws are symmetric: turn the shorter way.
        let sign = if goal.closing.dot(&self.closing) < 0.0 { -1.0 } else { 1.0 };
        self.goal = TipGoal { closing: goal.closing * sign, ..goal };
        self.corrections = 0;
        self.phase = Phase::Reacting(if planned { now } else { now + parameters.reaction_secs });
    }

    /// Opens or closes the jaws to the full opening `angle` \[rad\].
    pub fn set_jaw(&mut self, angle: f64) {
        self.jaw_goal = angle;
    }

    /// Whether the movement to the last goal has ended.
    pub fn arrived(&self) -> bool {
        self.phase == Phase::Arrived
    }
    /// Target opening of the jaws \[rad\].
    pub fn jaw_goal(&self) -> f64 {
        self.jaw_goal
    }
    /// Whether the commanded opening has reached its target.
    pub fn jaw_settled(&self) -> bool {
        self.jaw_angle == self.jaw_goal
    }
    /// The current goal.
    pub fn goal(&self) -> &TipGoal {
        &self.goal
    }

    /// One step of `dt` \[s\] that ends at `now` \[s\]; `seen` is the observed tip position in world \[m\].
    pub fn advance(
        &mut self,
        now: f64,
        dt: f64,
        seen: &Vector3<f64>,
        parameters: &MotorParameters,
    ) -> TipCommand {
        match self.phase {
            Phase::Reacting(at) if now >= at => {
                let goal = self.goal.position;
                self.start_reach(now, goal, parameters);
            }
            Phase::Looking(at) if now >= at => self.look(now, seen, parameters),
            _ => {}
        }
        if let Phase::Moving(reach) = self.phase {
            let tau = (now - reach.start_secs) / reach.duration_secs;
            let share = minimum_jerk(tau);
            self.position = reach.from + (reach.to - reach.from) * share;
            self.closing = blend(&reach.closing_from, &reach.closing_to, share);
            if tau >= 1.0 {
                self.phase = match self.goal.tolerance {
                    Some(_) => Phase::Looking(now + parameters.reaction_secs),
                    None => Phase::Arrived,
                };
            }
        }
        let turn = parameters.jaw_speed * dt;
        self.jaw_angle += (self.jaw_goal - self.jaw_angle).clamp(-turn, turn);
        let tremor = self.tremor.next(&mut self.noise, dt, parameters.tremor_hz);
        TipCommand {
            position: self.position + tremor * parameters.tremor_rms,
            closing: self.closing,
            jaw_angle: self.jaw_angle,
        }
    }

    fn start_reach(&mut self, now: f64, to: Vector3<f64>, parameters: &MotorParameters) {
        let way = to - self.position;
        let distance = way.norm();
        let spread = parameters.aim_error * distance;
        let noise = self.noise.normal3();
        let along = if distance > 1e-9 { way / distance } else { Vector3::zeros() };
        let across = noise - along * noise.dot(&along);
        let error = (along * noise.dot(&along) + across * LATERAL_ERROR) * spread;
        let tolerance = self.goal.tolerance.unwrap_or(0.01);
        self.phase = Phase::Moving(Reach {
            from: self.position,
            to: to + error,
            closing_from: self.closing,
            closing_to: self.goal.closing,
            start_secs: now,
            duration_secs: parameters.reach_secs(distance, tolerance).max(self.turn_secs(parameters)),
        });
    }

    /// Duration of a wrist rotation, at the speed of the gripper.
    fn turn_secs(&self, parameters: &MotorParameters) -> f64 {
        PEAK_OVER_MEAN * self.closing.angle(&self.goal.closing) / parameters.jaw_speed
    }

    /// Compares the observed tip with the goal, and corrects.
    fn look(&mut self, now: f64, seen: &Vector3<f64>, parameters: &MotorParameters) {
        let off = self.goal.position - seen;
        let near = self.goal.tolerance.is_none_or(|tolerance| off.norm() <= tolerance);
        if near || self.corrections >= CORRECTIONS_MAX {
            self.phase = Phase::Arrived;
            return;
        }
        self.corrections += 1;
        let beyond = (self.position + off) - self.goal.position;
        let limited = beyond * (CORRECTION_REACH_MAX / beyond.norm().max(CORRECTION_REACH_MAX));
        self.start_reach(now, self.goal.position + limited, parameters);
    }
}

/// Unit vector between two unit vectors.
fn blend(from: &Vector3<f64>, to: &Vector3<f64>, share: f64) -> Vector3<f64> {
    let between = from * (1.0 - share) + to * share;
    between.try_normalize(1e-9).unwrap_or(*to)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const DT: f64 = 0.01;

    fn calm() -> MotorParameters {
        MotorParameters { tremor_rms: 0.0, aim_error: 0.0, ..MotorParameters::of(Skill::Expert) }
    }
    fn goal(x: f64, tolerance: Option<f64>) -> TipGoal {
        TipGoal { position: Vector3::new(x, 0.0, 0.0), closing: Vector3::x(), tolerance }
    }
    /// Runs until arrival with a hand that follows perfectly plus a constant offset; times and positions.
    fn run(
        motor: &mut HandMotor,
        parameters: &MotorParameters,
        offset: Vector3<f64>,
    ) -> Vec<(f64, Vector3<f64>)> {
        let mut seen = motor.position + offset;
        let mut path = Vec::new();
        for i in 1..2000 {
            let now = f64::from(i) * DT;
            let command = motor.advance(now, DT, &seen, parameters);
            seen = command.position + offset;
            path.push((now, command.position));
            if motor.arrived() {
                return path;
            }
        }
        panic!("never arrived");
    }
    fn motor(seed: u64) -> HandMotor {
        HandMotor::new(Vector3::zeros(), Vector3::x(), 0.0, Noise::new(seed, 0))
    }

    #[test]
    fn an_undisturbed_reach_is_minimum_jerk_after_the_reaction_time() {
        let parameters = calm();
        let mut motor = motor(1);
        motor.aim(0.0, goal(0.1, None), &parameters, false);
        let path = run(&mut motor, &parameters, Vector3::zeros());
        let duration = parameters.reach_secs(0.1, 0.01);
        for (now, position) in path {
            // A tick after the reaction time the reach begins.
            let tau = (now - parameters.reaction_secs) / duration;
            assert!((position.x - 0.1 * minimum_jerk(tau)).abs() < 0.25 * DT, "{now}");
        }
        assert!((motor.position.x - 0.1).abs() < 1e-12);
        assert_eq!((minimum_jerk(0.0), minimum_jerk(0.5), minimum_jerk(1.0)), (0.0, 0.5, 1.0));
    }

    #[test]
    fn fitts_law_holds_until_the_peak_speed_limits() {
        let p = MotorParameters { peak_speed: 2.0, ..MotorParameters::of(Skill::Expert) };
        // One bit more for twice the distance plus a width.
        let (near, far) = (p.reach_secs(0.02, 0.001), p.reach_secs(0.042, 0.001));
        assert!((far - near - p.fitts_secs_per_bit).abs() < 1e-12);
        let slow = MotorParameters { peak_speed: 0.1, ..p };
        assert!((slow.reach_secs(0.2, 0.01) - 1.875 * 2.0).abs() < 1e-12);
    }

    #[test]
    fn corrections_remove_an_offset_that_only_the_eye_sees() {
        let parameters = calm();
        let mut motor = motor(1);
        let offset = Vector3::new(0.0, 0.003, -0.002);
        motor.aim(0.0, goal(0.05, Some(0.0005)), &parameters, true);
        run(&mut motor, &parameters, offset);
        assert!((motor.position + offset - Vector3::new(0.05, 0.0, 0.0)).norm() < 0.0005);
        assert_eq!(motor.corrections, 1);
        // An offset beyond the limit is not corrected for ever.
        motor.aim(0.0, goal(0.0, Some(0.0005)), &parameters, true);
        run(&mut motor, &parameters, Vector3::new(0.0, 0.1, 0.0));
        assert_eq!(motor.corrections, CORRECTIONS_MAX);
        assert!(motor.position.norm() < CORRECTION_REACH_MAX + 1e-9);
    }

    #[test]
    fn the_worse_the_aim_the_longer_until_it_is_near_enough() {
        let time = |skill| {
            let parameters = MotorParameters::of(skill);
            let mut times: Vec<f64> = (0..31)
                .map(|seed| {
                    let mut motor = motor(seed);
                    motor.aim(0.0, goal(0.08, Some(0.0008)), &parameters, false);
                    run(&mut motor, &parameters, Vector3::zeros()).last().unwrap().0
                })
                .collect();
            times.sort_by(f64::total_cmp);
            times[15]
        };
        let (novice, intermediate, expert) =
            (time(Skill::Novice), time(Skill::Intermediate), time(Skill::Expert));
        assert!(
            expert < 0.8 * intermediate && intermediate < 0.8 * novice,
            "{expert} {intermediate} {novice}"
        );
    }

    #[test]
    fn jaws_move_at_their_speed_and_turn_the_shorter_way() {
        let parameters = calm();
        let mut motor = motor(1);
        motor.set_jaw(0.3);
        let mut steps = 0;
        while !motor.jaw_settled() {
            motor.advance(0.0, DT, &Vector3::zeros(), &parameters);
            steps += 1;
        }
        assert_eq!(steps, (0.3 / (parameters.jaw_speed * DT)).ceil() as i32);
        motor.aim(0.0, TipGoal { closing: -Vector3::x(), ..goal(0.01, None) }, &parameters, true);
        assert_eq!(motor.goal().closing, Vector3::x());
    }

    #[test]
    fn every_skill_is_valid_and_nonsense_is_named() {
        for skill in [Skill::Novice, Skill::Intermediate, Skill::Expert] {
            assert_eq!(MotorParameters::of(skill).validate(), Ok(()));
        }
        let shaking = MotorParameters { tremor_rms: f64::NAN, ..calm() };
        assert!(shaking.validate().unwrap_err().to_string().contains("tremor_rms"));
    }

    proptest! {
        #[test]
        fn a_stored_hand_moves_on_with_the_same_bits(seed in 0u64..500, cut in 1usize..100) {
            let parameters = MotorParameters::of(Skill::Novice);
            let mut whole = motor(seed);
            whole.aim(0.0, goal(0.06, Some(0.001)), &parameters, false);
            let mut other = whole;
            for i in 1..150usize {
                if i == cut {
                    other = postcard::from_bytes(&postcard::to_stdvec(&other).unwrap()).unwrap();
                }
                let now = i as f64 * DT;
                let seen = whole.position;
                let a = whole.advance(now, DT, &seen, &parameters);
                let b = other.advance(now, DT, &seen, &parameters);
                prop_assert_eq!(a, b);
                prop_assert!(a.position.norm() < 0.1);
            }
        }
    }
}
