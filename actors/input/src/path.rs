//! Scripted path of a tip: via points at given times, with minimum-jerk profiles (Flash, Hogan 1985). The path ignores
//! contacts; their effect on the instrument is simulated by physics.

use nalgebra::{Point3, Rotation3, Unit, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::ActivationMode;

/// Most steps of a path.
pub const STEPS_MAX: usize = 10_000;
/// Longest step \[s\].
const SECS_MAX: f64 = 3600.0;

/// Part of a circle, from where the tip is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Arc {
    /// Its centre in world \[m\].
    pub center: [f64; 3],
    /// The axis that it goes around.
    #[serde(default = "upwards")]
    pub axis: [f64; 3],
    /// Its angle \[rad\]; negative against the axis.
    pub angle: f64,
    /// Whether the jaws' closing direction rotates with it, as when a curved needle is driven along itself.
    #[serde(default)]
    pub turns: bool,
}

fn upwards() -> [f64; 3] {
    [0.0, 0.0, 1.0]
}

/// One step: target, duration, jaws and pedal. Omitted values stay unchanged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Step {
    /// How long it takes \[s\].
    pub seconds: f64,
    /// Position of the tip in world at its end \[m\].
    pub to: Option<[f64; 3]>,
    /// Or along a circle.
    pub arc: Option<Arc>,
    /// Full opening of the jaws at its end \[rad\].
    pub jaws: Option<f64>,
    /// Closing direction of the jaws in world; its component along the shaft is removed.
    pub closing: Option<[f64; 3]>,
    /// Share of full power throughout, 0 to 1.
    pub level: Option<f64>,
    /// Electrosurgical mode from then on; else the instrument's own setting.
    pub mode: Option<ActivationMode>,
    /// Buttons of the handle that are pressed throughout, bit `n` for button `n`: for hands with `press_target`.
    pub buttons: Option<u16>,
    /// At uniform speed, for even cuts and burns; else it starts and ends at rest.
    pub uniform: bool,
}

/// Error of an invalid path.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("step {step}: {reason}")]
pub struct PathError {
    /// Index of the step, from 0.
    pub step: usize,
    /// What is wrong.
    pub reason: String,
}

/// State of a hand at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moment {
    /// Position of the tip in world \[m\].
    pub tip_in_world: Point3<f64>,
    /// Full opening of the jaws \[rad\].
    pub jaw_angle: f64,
    /// Their closing direction.
    pub closing_in_world: Vector3<f64>,
    /// Share of full power.
    pub level: f64,
    /// Electrosurgical mode.
    pub mode: Option<ActivationMode>,
    /// Buttons of the handle that are pressed, bit `n` for button `n`.
    pub buttons: u16,
}

/// A checked path: the start of each step, and the step.
#[derive(Clone, Debug, PartialEq)]
pub struct Path {
    /// Start \[s\], moment at the start, the step.
    legs: Vec<(f64, Moment, Step)>,
    end: (f64, Moment),
}

impl Path {
    /// Checks the steps of a hand that starts at `start`.
    ///
    /// # Errors
    /// The first invalid step.
    pub fn new(start: Moment, steps: &[Step]) -> Result<Self, PathError> {
        if steps.len() > STEPS_MAX {
            let reason = format!("{} steps are too many (at most {STEPS_MAX})", steps.len());
            return Err(PathError { step: STEPS_MAX, reason });
        }
        let (mut secs, mut moment) = (0.0, start);
        let mut legs = Vec::with_capacity(steps.len());
        for (index, step) in steps.iter().enumerate() {
            check(step).map_err(|reason| PathError { step: index, reason })?;
            if let Some(level) = step.level {
                moment.level = level;
            }
            moment.mode = step.mode.or(moment.mode);
            moment.buttons = step.buttons.unwrap_or(moment.buttons);
            legs.push((secs, moment, *step));
            moment = moment_within(&moment, step, 1.0);
            secs += step.seconds;
        }
        Ok(Self { legs, end: (secs, moment) })
    }

    /// Its end \[s\].
    pub fn seconds(&self) -> f64 {
        self.end.0
    }

    /// State of the hand at `secs`; constant after the end.
    pub fn at(&self, secs: f64) -> Moment {
        let next = self.legs.partition_point(|(start, ..)| *start <= secs);
        let Some((start, from, step)) = next.checked_sub(1).and_then(|at| self.legs.get(at)) else {
            return self.legs.first().map_or(self.end.1, |(_, moment, _)| *moment);
        };
        if secs >= start + step.seconds {
            return self.legs.get(next).map_or(self.end.1, |(_, moment, _)| *moment);
        }
        let share = ((secs - start) / step.seconds).clamp(0.0, 1.0);
        moment_within(from, step, if step.uniform { share } else { minimum_jerk(share) })
    }
}

fn check(step: &Step) -> Result<(), String> {
    let numbers = [Some(step.seconds), step.jaws, step.level];
    let vectors = [step.to, step.closing, step.arc.map(|arc| arc.center), step.arc.map(|arc| arc.axis)];
    let mut all = numbers.iter().flatten().chain(vectors.iter().flatten().flatten());
    if !all.all(|x| x.is_finite()) || step.arc.is_some_and(|arc| !arc.angle.is_finite()) {
        return Err("a number is not finite".into());
    }
    if !(0.0..=SECS_MAX).contains(&step.seconds) {
        return Err(format!("seconds: {} is out of range (0 to {SECS_MAX})", step.seconds));
    }
    if step.to.is_some() && step.arc.is_some() {
        return Err("'to' and 'arc' exclude each other".into());
    }
    if step.level.is_some_and(|level| !(0.0..=1.0).contains(&level)) {
        return Err("level: valid is 0 to 1".into());
    }
    if step.jaws.is_some_and(|jaws| !(0.0..=std::f64::consts::PI).contains(&jaws)) {
        return Err("jaws: valid is 0 to 3.14 rad".into());
    }
    let short = |v: [f64; 3]| Vector3::from(v).norm() < 1e-9;
    if step.closing.is_some_and(short) || step.arc.is_some_and(|arc| short(arc.axis)) {
        return Err("a direction has no length".into());
    }
    Ok(())
}

/// Minimum-jerk profile from rest to rest: share of the distance by share of the time.
fn minimum_jerk(share: f64) -> f64 {
    share * share * share * (10.0 - 15.0 * share + 6.0 * share * share)
}

/// The state within a step, at `share` of it.
fn moment_within(from: &Moment, step: &Step, share: f64) -> Moment {
    let mut moment = *from;
    if let Some(to) = step.to {
        moment.tip_in_world = from.tip_in_world + (Point3::from(to) - from.tip_in_world) * share;
    }
    if let Some(arc) = step.arc {
        let center = Point3::from(arc.center);
        let turn = Rotation3::from_axis_angle(&Unit::new_normalize(arc.axis.into()), arc.angle * share);
        moment.tip_in_world = center + turn * (from.tip_in_world - center);
        if arc.turns {
            moment.closing_in_world = turn * from.closing_in_world;
        }
    }
    if let Some(jaws) = step.jaws {
        moment.jaw_angle = from.jaw_angle + (jaws - from.jaw_angle) * share;
    }
    if let Some(closing) = step.closing {
        let to = Vector3::from(closing).normalize();
        let blend = from.closing_in_world + (to - from.closing_in_world) * share;
        moment.closing_in_world = blend.try_normalize(1e-9).unwrap_or(to);
    }
    moment
}

#[cfg(test)]
mod tests {
    use super::*;

    fn start() -> Moment {
        Moment {
            tip_in_world: Point3::origin(),
            jaw_angle: 0.0,
            closing_in_world: Vector3::x(),
            level: 0.0,
            mode: None,
            buttons: 0,
        }
    }

    #[test]
    fn a_path_goes_from_place_to_place_and_stays_at_the_end() {
        let steps = [
            Step { seconds: 2.0, to: Some([0.1, 0.0, 0.0]), jaws: Some(0.5), ..Step::default() },
            Step { seconds: 1.0, level: Some(0.7), ..Step::default() },
            Step {
                seconds: 1.0,
                to: Some([0.1, 0.2, 0.0]),
                uniform: true,
                level: Some(0.0),
                mode: Some(ActivationMode::Coagulate),
                ..Step::default()
            },
        ];
        let path = Path::new(start(), &steps).unwrap();
        assert_eq!(path.seconds(), 4.0);
        assert_eq!(path.at(-1.0), start());
        assert!((path.at(1.0).tip_in_world.x - 0.05).abs() < 1e-15);
        assert!((path.at(1.0).jaw_angle - 0.25).abs() < 1e-15);
        assert_eq!((path.at(1.9).level, path.at(2.5).level, path.at(3.5).level), (0.0, 0.7, 0.0));
        let coagulates = Some(ActivationMode::Coagulate);
        assert_eq!((path.at(2.5).mode, path.at(3.5).mode, path.at(9.0).mode), (None, coagulates, coagulates));
        assert!((path.at(3.25).tip_in_world.y - 0.05).abs() < 1e-12);
        assert!((path.at(9.0).tip_in_world - Point3::new(0.1, 0.2, 0.0)).norm() < 1e-12);
        // At rest where it starts and ends.
        assert!(path.at(0.01).tip_in_world.x < 1e-6 && path.at(1.99).tip_in_world.x > 0.1 - 1e-6);
    }

    #[test]
    fn an_arc_keeps_its_distance() {
        let axis = [0.0, 0.0, 2.0];
        let arc = Arc { center: [0.02, 0.0, 0.0], axis, angle: std::f64::consts::TAU, turns: false };
        let path = Path::new(start(), &[Step { seconds: 3.0, arc: Some(arc), ..Step::default() }]).unwrap();
        for k in 0..=30 {
            let tip = path.at(f64::from(k) * 0.1).tip_in_world;
            assert!(((tip - Point3::new(0.02, 0.0, 0.0)).norm() - 0.02).abs() < 1e-12);
        }
        assert!((path.at(1.5).tip_in_world.x - 0.04).abs() < 1e-9);
        assert!(path.at(3.0).tip_in_world.coords.norm() < 1e-12);
        assert!((path.at(1.0).closing_in_world - Vector3::x()).norm() < 1e-15);
        // A quarter of a turn later the jaws close the other way.
        let arc = Arc { angle: std::f64::consts::FRAC_PI_2, turns: true, ..arc };
        let path = Path::new(start(), &[Step { seconds: 3.0, arc: Some(arc), ..Step::default() }]).unwrap();
        assert!((path.at(3.0).closing_in_world - Vector3::y()).norm() < 1e-12);
    }

    #[test]
    fn steps_that_cannot_be_taken_are_told_with_their_number() {
        let good = Step { seconds: 1.0, ..Step::default() };
        for (bad, says) in [
            (Step { seconds: f64::NAN, ..good }, "finite"),
            (Step { seconds: -1.0, ..good }, "seconds"),
            (Step { level: Some(2.0), ..good }, "level"),
            (Step { jaws: Some(-0.1), ..good }, "jaws"),
            (Step { closing: Some([0.0; 3]), ..good }, "direction"),
        ] {
            let error = Path::new(start(), &[good, bad]).unwrap_err();
            assert!(error.step == 1 && error.reason.contains(says), "{error}");
        }
    }
}
