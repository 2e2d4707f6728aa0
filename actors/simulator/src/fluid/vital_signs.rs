//! Vital signs under blood loss: a lumped circulation of an arterial and a venous compartment (two-element Windkessel),
//! a Frank–Starling heart, and baroreflexes of arterial and low-pressure receptors on rate, resistance, venous tone and
//! contractility. The structure is that of Zenker, Rubin and Clermont (*From inverse problems in mathematical
//! physiology to quantitative differential diagnoses*, 2007); normal values are those of an adult of 70 kg; reflex
//! gains are tuned to the haemorrhage classes of *Advanced Trauma Life Support*, and a test checks these. Not a
//! prediction for a patient.

use serde::{Deserialize, Serialize};

use super::error::{FluidError, FluidStepError, parameter};

/// Pa in a millimetre of mercury.
pub const MMHG: f64 = 133.322;
/// Longest substep \[s\]: a hundredth of the arterial time constant.
const PART: f64 = 0.015;

/// Parameters of a circulation. Volumes \[m³\], pressures \[Pa\].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Circulation {
    /// Initial blood volume.
    pub blood: f64,
    /// Mean arterial pressure at rest.
    pub arterial: f64,
    /// Central venous pressure at rest.
    pub venous: f64,
    /// Heart rate at rest \[1/s\].
    pub rate: f64,
    /// Heart rate at full reflex activity \[1/s\].
    pub rate_max: f64,
    /// Stroke volume at rest.
    pub stroke: f64,
    /// Arterial compliance \[m³/Pa\].
    pub arterial_compliance: f64,
    /// Venous compliance \[m³/Pa\].
    pub venous_compliance: f64,
    /// Filling pressure at half of the largest stroke volume.
    pub filling: f64,
    /// Venous volume mobilised by venoconstriction.
    pub reserve: f64,
    /// Largest increase of the resistance, as a fraction.
    pub constriction: f64,
    /// Largest increase of contractility, as a fraction.
    pub contraction: f64,
    /// Fall of arterial pressure per unit of the reflex.
    pub arterial_gain: f64,
    /// Fall of venous pressure per unit of the reflex.
    pub venous_gain: f64,
    /// Time constant of the reflex \[s\].
    pub delay: f64,
}

impl Default for Circulation {
    fn default() -> Self {
        Self {
            blood: 5e-3,
            arterial: 93.0 * MMHG,
            venous: 5.0 * MMHG,
            rate: 70.0 / 60.0,
            rate_max: 165.0 / 60.0,
            stroke: 75e-6,
            arterial_compliance: 1.5e-6 / MMHG,
            venous_compliance: 185e-6 / MMHG,
            filling: 3.0 * MMHG,
            reserve: 1.4e-3,
            constriction: 1.1,
            contraction: 0.4,
            arterial_gain: 15.0 * MMHG,
            venous_gain: 1.8 * MMHG,
            delay: 8.0,
        }
    }
}

impl Circulation {
    /// Scaled to a body with this blood volume \[m³\]: cardiac output and vessel volumes scale with it, pressures and
    /// times do not (Schmidt-Nielsen, *Scaling: why is animal size so important?*, 1984).
    #[must_use]
    pub fn of_blood(self, blood: f64) -> Self {
        let share = blood / self.blood;
        Self {
            blood,
            stroke: self.stroke * share,
            arterial_compliance: self.arterial_compliance * share,
            venous_compliance: self.venous_compliance * share,
            reserve: self.reserve * share,
            ..self
        }
    }
}

/// Reflex activity at rest, out of 1.
const TONE: f64 = 0.09;
/// Pulse pressure as a fraction of stroke volume over compliance: the rest flows off during the beat.
const PULSE: f64 = 0.8;

/// State of a circulation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct CirculationState {
    /// Stressed volume of the arteries \[m³\].
    pub arterial: f64,
    /// Stressed volume of the veins, without the reflex's contribution \[m³\]; below 0 they are slack.
    pub venous: f64,
    /// Reflex activity, 0 to 1.
    pub reflex: f64,
    /// Blood volume \[m³\].
    pub blood: f64,
    /// Blood lost since the beginning \[m³\].
    pub lost: f64,
}

/// Vital signs as on a monitor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signs {
    /// Heart rate \[1/min\].
    pub heart_rate: f64,
    /// Systolic arterial pressure \[Pa\].
    pub systolic: f64,
    /// Diastolic arterial pressure \[Pa\].
    pub diastolic: f64,
    /// Mean arterial pressure \[Pa\].
    pub mean: f64,
    /// Central venous pressure \[Pa\].
    pub venous: f64,
    /// Cardiac output \[m³/s\].
    pub output: f64,
    /// Blood volume \[m³\].
    pub blood: f64,
}

/// A patient's circulation.
#[derive(Clone, Copy, Debug)]
pub struct VitalSigns {
    circulation: Circulation,
    state: CirculationState,
}

/// Pressures and flows of a state.
struct Flow {
    arterial: f64,
    venous: f64,
    rate: f64,
    stroke: f64,
    runoff: f64,
    reflex: f64,
}

impl VitalSigns {
    /// A patient at rest.
    ///
    /// # Errors
    /// A parameter out of range.
    pub fn new(circulation: Circulation) -> Result<Self, FluidError> {
        let state = CirculationState {
            arterial: circulation.arterial_compliance * circulation.arterial,
            venous: circulation.venous_compliance * circulation.venous,
            reflex: TONE,
            blood: circulation.blood,
            lost: 0.0,
        };
        Self::restore(circulation, state)
    }

    /// Restores from a state.
    ///
    /// # Errors
    /// A parameter or a number of the state out of range.
    pub fn restore(circulation: Circulation, state: CirculationState) -> Result<Self, FluidError> {
        let c = &circulation;
        let ranges = [
            ("blood", c.blood, 1e-5, 0.1),
            ("arterial", c.arterial, 1e3, 1e5),
            ("venous", c.venous, 10.0, 5e3),
            ("rate", c.rate, 0.1, 20.0),
            ("rate_max", c.rate_max, c.rate, 30.0),
            ("stroke", c.stroke, 1e-8, 1e-3),
            ("arterial_compliance", c.arterial_compliance, 1e-11, 1e-6),
            ("venous_compliance", c.venous_compliance, 1e-10, 1e-5),
            ("filling", c.filling, 10.0, 1e4),
            ("reserve", c.reserve, 0.0, 0.1),
            ("constriction", c.constriction, 0.0, 10.0),
            ("contraction", c.contraction, 0.0, 10.0),
            ("arterial_gain", c.arterial_gain, 10.0, 1e6),
            ("venous_gain", c.venous_gain, 10.0, 1e6),
            ("delay", c.delay, 0.1, 1e4),
            ("state.arterial", state.arterial, 0.0, 0.1),
            ("state.venous", state.venous, -0.2, 0.2),
            ("state.reflex", state.reflex, 0.0, 1.0),
            ("state.blood", state.blood, -0.1, 0.2),
            ("state.lost", state.lost, -0.2, 0.2),
        ];
        for (what, value, least, most) in ranges {
            parameter(what, value, least..=most, "a number as a body has it")?;
        }
        Ok(Self { circulation, state })
    }

    /// The state.
    #[must_use]
    pub fn state(&self) -> &CirculationState {
        &self.state
    }

    /// Its parameters.
    #[must_use]
    pub fn circulation(&self) -> &Circulation {
        &self.circulation
    }

    fn flow(&self, state: &CirculationState) -> Flow {
        let c = &self.circulation;
        let arterial = state.arterial.max(0.0) / c.arterial_compliance;
        let awake = (state.reflex - TONE) / (1.0 - TONE);
        let venous = ((state.venous + c.reserve * awake) / c.venous_compliance).max(0.0);
        let slowest = (c.rate - TONE * c.rate_max) / (1.0 - TONE);
        let rate = slowest + (c.rate_max - slowest) * state.reflex;
        let most = c.stroke * (c.venous + c.filling) / c.venous;
        let stroke = most * (1.0 + c.contraction * awake) * venous / (venous + c.filling);
        let resistance = (c.arterial - c.venous) / (c.rate * c.stroke) * (1.0 + c.constriction * awake);
        let drive = (c.arterial - arterial) / c.arterial_gain + (c.venous - venous) / c.venous_gain;
        let rest = ((1.0 - TONE) / TONE).ln();
        let reflex = 1.0 / (1.0 + (rest - drive).exp());
        Flow { arterial, venous, rate, stroke, runoff: (arterial - venous).max(0.0) / resistance, reflex }
    }

    /// Advances by `dt` \[s\] at a rate of blood loss \[m³/s\]; negative for a transfusion.
    ///
    /// # Errors
    /// An invalid time step, or one longer than 60 s; a rate beyond 0.01 m³/s.
    pub fn step(&mut self, dt: f64, loss: f64) -> Result<Signs, FluidStepError> {
        let is_rate = loss.abs() <= 0.01;
        if !(1e-9..=60.0).contains(&dt) || !is_rate {
            return Err(FluidStepError::Time(if is_rate { dt } else { f64::NAN }));
        }
        let parts = (dt / PART).ceil().max(1.0);
        let part = dt / parts;
        for _ in 0..parts as u32 {
            // The loss cannot exceed the remaining volume.
            let loss = if self.state.blood - loss * part > 0.0 { loss } else { 0.0 };
            let slope = |state: &CirculationState| {
                let flow = self.flow(state);
                let gain = flow.rate * flow.stroke - flow.runoff;
                [gain, -gain - loss, (flow.reflex - state.reflex) / self.circulation.delay]
            };
            let moved = |state: &CirculationState, by: [f64; 3], time: f64| CirculationState {
                arterial: state.arterial + by[0] * time,
                venous: state.venous + by[1] * time,
                reflex: state.reflex + by[2] * time,
                ..*state
            };
            let half = moved(&self.state, slope(&self.state), part / 2.0);
            let mut next = moved(&self.state, slope(&half), part);
            next.blood -= loss * part;
            next.lost += loss * part;
            self.state = next;
        }
        Ok(self.signs())
    }

    /// The present vital signs.
    #[must_use]
    pub fn signs(&self) -> Signs {
        let flow = self.flow(&self.state);
        let pulse = PULSE * flow.stroke / self.circulation.arterial_compliance;
        Signs {
            heart_rate: flow.rate * 60.0,
            systolic: flow.arterial + 2.0 / 3.0 * pulse,
            diastolic: (flow.arterial - pulse / 3.0).max(0.0),
            mean: flow.arterial,
            venous: flow.venous,
            output: flow.rate * flow.stroke,
            blood: self.state.blood,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// After losing a fraction of the blood in ten minutes, and another ten minutes.
    fn after_losing(share: f64) -> Signs {
        let mut patient = VitalSigns::new(Circulation::default()).expect("a patient");
        let rate = share * 5e-3 / 600.0;
        for _ in 0..600 {
            patient.step(1.0, rate).expect("a step");
        }
        for _ in 0..600 {
            patient.step(1.0, 0.0).expect("a step");
        }
        assert!((patient.state().lost - share * 5e-3).abs() < 1e-9);
        patient.signs()
    }

    #[test]
    fn at_rest_nothing_changes() {
        let mut patient = VitalSigns::new(Circulation::default()).expect("a patient");
        for _ in 0..3600 {
            patient.step(1.0, 0.0).expect("a step");
        }
        let signs = patient.signs();
        assert!((signs.heart_rate - 70.0).abs() < 0.1 && (signs.mean / MMHG - 93.0).abs() < 0.1, "{signs:?}");
        let (systolic, diastolic) = (signs.systolic / MMHG, signs.diastolic / MMHG);
        assert!((115.0..125.0).contains(&systolic) && (75.0..85.0).contains(&diastolic));
        assert!((signs.output - 87.5e-6).abs() < 1e-7);
    }

    #[test]
    fn the_classes_of_haemorrhage_come_out() {
        // Fraction lost, heart rate, systolic pressure: ATLS classes I to IV.
        let classes = [
            (0.10, 60.0..100.0, 105.0..130.0),
            (0.24, 100.0..120.0, 95.0..130.0),
            (0.35, 120.0..140.0, 70.0..100.0),
            (0.45, 140.0..180.0, 0.0..80.0),
        ];
        let mut before = VitalSigns::new(Circulation::default()).expect("a patient").signs();
        for (share, rates, pressures) in classes {
            let signs = after_losing(share);
            assert!(rates.contains(&signs.heart_rate), "{share}: {signs:?}");
            assert!(pressures.contains(&(signs.systolic / MMHG)), "{share}: {} mmHg", signs.systolic / MMHG);
            // From class II on, pulse pressure falls, before the mean does.
            let pulse = |signs: &Signs| signs.systolic - signs.diastolic;
            assert!(pulse(&signs) < pulse(&before) && signs.heart_rate > before.heart_rate);
            before = signs;
        }
    }

    #[test]
    fn a_small_body_answers_the_same_share_in_the_same_way() {
        let small = Circulation::default().of_blood(0.3e-3);
        let mut patients =
            [Circulation::default(), small].map(|body| VitalSigns::new(body).expect("a patient"));
        for _ in 0..300 {
            patients[0].step(1.0, 5e-6).expect("a step");
            patients[1].step(1.0, 0.3e-6).expect("a step");
        }
        let [large, small] = patients.map(|patient| patient.signs());
        assert!((large.heart_rate - small.heart_rate).abs() < 1e-9 && large.heart_rate > 90.0, "{large:?}");
        assert!((large.mean / small.mean - 1.0).abs() < 1e-9 && large.mean < 90.0 * MMHG);
    }

    #[test]
    fn blood_that_is_given_back_restores_the_patient_and_all_of_it_is_the_end() {
        let mut patient = VitalSigns::new(Circulation::default()).expect("a patient");
        for rate in [1e-3 / 300.0, 0.0, -1e-3 / 300.0, 0.0] {
            for _ in 0..300 {
                patient.step(1.0, rate).expect("a step");
            }
        }
        let signs = patient.signs();
        assert!((signs.heart_rate - 70.0).abs() < 1.0 && (signs.mean / MMHG - 93.0).abs() < 1.0, "{signs:?}");
        for _ in 0..2000 {
            patient.step(1.0, 5e-6).expect("a step");
        }
        let signs = patient.signs();
        assert!(signs.mean < 10.0 * MMHG && signs.blood >= 0.0 && signs.output.is_finite(), "{signs:?}");
    }

    #[test]
    fn the_step_does_not_matter_and_a_state_goes_on() {
        let run = |dt: f64| {
            let mut patient = VitalSigns::new(Circulation::default()).expect("a patient");
            for _ in 0..(300.0 / dt) as u32 {
                patient.step(dt, 3e-6).expect("a step");
            }
            patient
        };
        let (fine, coarse) = (run(0.01), run(10.0));
        assert!((fine.signs().mean / coarse.signs().mean - 1.0).abs() < 1e-3);
        let mut restored = VitalSigns::restore(Circulation::default(), *coarse.state()).expect("its state");
        let mut coarse = coarse;
        coarse.step(5.0, 1e-6).expect("a step");
        restored.step(5.0, 1e-6).expect("a step");
        assert_eq!(restored.state(), coarse.state());
        for (dt, loss) in [(0.0, 0.0), (f64::NAN, 0.0), (1.0, f64::NAN), (1.0, 1.0)] {
            coarse.step(dt, loss).expect_err("no such step");
        }
        assert_eq!(restored.state(), coarse.state());
    }
}
