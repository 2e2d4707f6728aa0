//! The controller of the patient: the blood loss of all vessels leaves the circulation, and the monitor shows the vital
//! signs.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::frozen::{FrozenPart, freeze};
use trocar_scene::{
    Access, BuildContext, Commands, Component, ComponentError, Controller, ControllerError, Entity,
    EntitySet, Frozen, Measured, RecordPolicy, Snapshot, Tick, VitalSigns,
};

use super::bleeding::VesselState;
use crate::fluid::vital_signs::{Circulation, CirculationState, VitalSigns as Body};

/// Oxygen saturation while cardiac output is at least a third of its resting value: no lung is simulated.
const SATURATION: f64 = 0.98;
/// Largest loss rate that the circulation accepts \[m³/s\].
const LOSS_MAX: f64 = 0.01;

/// More than any body contains \[m³\].
const LOST_MAX: f64 = 1.0;

/// A patient whose circulation responds to blood loss.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "patient", check = Self::ranges, schema)]
#[serde(default, deny_unknown_fields)]
pub struct Patient {
    /// Blood volume \[m³\]; cardiac output and vascular capacity scale with it. An adult of 70 kg has 5 litres, a
    /// piglet of 5 kg a third of a litre (65 ml/kg).
    pub blood: f64,
    /// Mean arterial pressure at rest \[Pa\].
    pub arterial_pressure: f64,
    /// Heart rate at rest \[1/min\].
    pub heart_rate: f64,
}

impl Default for Patient {
    fn default() -> Self {
        let adult = Circulation::default();
        Self { blood: adult.blood, arterial_pressure: adult.arterial, heart_rate: 60.0 * adult.rate }
    }
}

impl Patient {
    /// Its circulation.
    #[must_use]
    pub fn circulation(&self) -> Circulation {
        let adult = Circulation::default();
        let rate = self.heart_rate / 60.0;
        Circulation {
            arterial: self.arterial_pressure,
            rate,
            rate_max: adult.rate_max / adult.rate * rate,
            ..adult.of_blood(self.blood)
        }
    }

    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("blood", self.blood, 1e-5..=0.05, "1e-5 to 0.05 m³")?;
        ComponentError::range("arterial_pressure", self.arterial_pressure, 1e3..=5e4, "1000 to 50000 Pa")?;
        ComponentError::range("heart_rate", self.heart_rate, 20.0..=600.0, "20 to 600 1/min")
    }
}

/// State for a restart, and the pressures that drive bleeding.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "patient_state", record = RecordPolicy::sampled(5.0, 1e-9))]
pub struct PatientState {
    /// The circulation.
    pub circulation: CirculationState,
    /// Mean arterial pressure \[Pa\].
    pub arterial: f64,
    /// Central venous pressure \[Pa\].
    pub venous: f64,
    /// Cumulative loss of all vessels already subtracted \[m³\].
    pub accounted: f64,
}

impl PatientState {
    /// Mean arterial and venous pressure of the scene's patient, or of an adult if there is none \[Pa\].
    #[must_use]
    pub fn pressures(scene: &Snapshot) -> (f64, f64) {
        if let Some((_, state)) = scene.iter::<Self>().next() {
            return (state.arterial, state.venous);
        }
        let patient = scene.iter::<Patient>().next().map(|(_, patient)| *patient).unwrap_or_default();
        let circulation = patient.circulation();
        (circulation.arterial, circulation.venous)
    }
}

/// Simulates the patient's circulation.
pub struct VitalSignsController {
    patient: Entity,
    body: Body,
    accounted: f64,
    frozen: bool,
}

impl VitalSignsController {
    /// Reads the patient, and resumes its state from the scene.
    ///
    /// # Errors
    /// There is none, or more than one; the state is out of range.
    pub fn new(context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let mut patients = context.scene.iter::<Patient>();
        let (Some((patient, body)), None) = (patients.next(), patients.next()) else {
            return Err(ControllerError::Scene("vital-signs: one entity has to be a 'patient'".into()));
        };
        let known = context.scene.get::<PatientState>(patient);
        let circulation = body.circulation();
        let body = match known {
            Some(known) => Body::restore(circulation, known.circulation),
            None => Body::new(circulation),
        };
        let body = body
            .map_err(|error| ControllerError::Scene(format!("'{}': {error}", context.scene.name(patient))))?;
        let frozen = context.scene.get::<Frozen>(patient).is_some();
        Ok(Self { patient, body, accounted: known.map_or(0.0, |known| known.accounted), frozen })
    }
}

impl VitalSignsController {
    /// One step; if it fails, the patient keeps its state.
    fn step(&mut self, tick: &Tick<'_>, scene: &Snapshot) -> Result<(), String> {
        let dt = tick.period.as_secs_f64();
        let mut lost = 0.0;
        for (entity, vessel) in scene.iter::<VesselState>() {
            if !(0.0..=LOST_MAX).contains(&vessel.bleeding.lost) {
                let lost = vessel.bleeding.lost;
                return Err(format!("'{}' has lost {lost:e} m³; 0 to {LOST_MAX} can be", scene.name(entity)));
            }
            lost += vessel.bleeding.lost;
        }
        let loss = ((lost - self.accounted) / dt).clamp(0.0, LOSS_MAX);
        let before = self.body;
        let done = self.body.step(dt, loss).map_err(|error| error.to_string()).and_then(|signs| {
            let all = [signs.heart_rate, signs.mean, signs.venous, signs.systolic, self.body.state().lost];
            all.iter().all(|x| x.is_finite()).then_some(()).ok_or("a sign came to no finite number".into())
        });
        match done {
            Ok(()) => self.accounted += loss * dt,
            Err(_) => self.body = before,
        }
        done
    }

    fn show(&self, out: &mut Commands) {
        let (signs, rest) = (self.body.signs(), self.body.circulation());
        let share = (signs.output / (rest.rate * rest.stroke) * 3.0).min(1.0);
        out.put(
            self.patient,
            VitalSigns {
                heart_rate: signs.heart_rate,
                arterial_pressure: signs.mean,
                oxygen_saturation: SATURATION * share,
                blood_loss: self.body.state().lost,
            },
        );
        out.put(
            self.patient,
            PatientState {
                circulation: *self.body.state(),
                arterial: signs.mean,
                venous: signs.venous,
                accounted: self.accounted,
            },
        );
    }
}

impl Controller for VitalSignsController {
    fn access(&self) -> Access {
        let patient = || EntitySet::Of(vec![self.patient]);
        Access::new()
            .reads::<Patient>()
            .reads::<VesselState>()
            .reads::<Frozen>()
            .writes::<Frozen>(patient())
            .writes::<VitalSigns>(patient())
            .writes::<PatientState>(patient())
            .writes::<Measured>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if !self.frozen {
            match self.step(tick, scene) {
                Ok(()) => self.show(out),
                Err(reason) => {
                    self.frozen = true;
                    freeze(self.patient, FrozenPart::Body, reason, tick, out);
                }
            }
        }
        let (signs, rest) = (self.body.signs(), self.body.circulation());
        let name = scene.name(self.patient);
        let values = [
            ("heart_rate_per_min", signs.heart_rate),
            ("arterial_pressure_pa", signs.mean),
            ("systolic_pressure_pa", signs.systolic),
            ("blood_lost_m3", self.body.state().lost),
            ("blood_lost_share", self.body.state().lost / rest.blood),
            ("frozen", f64::from(u8::from(self.frozen))),
        ];
        let values: BTreeMap<String, f64> =
            values.into_iter().map(|(what, value)| (format!("{name}.{what}"), value)).collect();
        out.put(tick.me, Measured { values });
        Ok(())
    }
}
