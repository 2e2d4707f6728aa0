//! Which instruments a soft body may not stop, by the steps of its controller and by its method: when one goes beyond, the
//! body is told to be outside what its method is right for.

use nalgebra::Vector3;
use trocar_scene::Snapshot;
use trocar_scene::readable::quantity;

use super::held_back::HeldBack;
use super::instrument_rods::Rod;
use super::rod_contact::RodContact;
use super::tick_course::{FORESEEN, foresees};

/// Up to what a body stops instruments that hands lead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstrumentLimit {
    /// Largest force \[N\].
    pub force_max: f64,
    /// Largest speed towards it \[m/s\].
    pub speed_max: f64,
    /// What lifts the limit.
    pub remedy: &'static str,
}

impl InstrumentLimit {
    /// Whatever they do.
    pub const NONE: Self = Self { force_max: f64::INFINITY, speed_max: f64::INFINITY, remedy: "" };

    /// Why an instrument that the body meets in a step may pass through it, if it may; `forces` are those of the touches
    /// \[N\], `period` that of the controller \[s\].
    pub(super) fn passed(
        &self,
        held_back: &HeldBack,
        (touches, rods): (&[RodContact], &[Rod]),
        forces: &[Vector3<f64>],
        period: f64,
        scene: &Snapshot,
    ) -> Option<String> {
        held_back.instruments().find_map(|(instrument, ..)| {
            let met = || touches.iter().zip(forces).filter(|(touch, _)| rods[touch.rod].instrument == instrument);
            let force: f64 = met().map(|(_, force)| force.norm()).sum();
            let towards = met().map(|(touch, _)| (touch.velocity.dot(&touch.normal), rods[touch.rod].radius));
            let (speed, radius) = towards.max_by(|a, b| a.0.total_cmp(&b.0))?;
            let why = if !foresees(period) && speed * period > 2.0 * radius {
                format!(
                    "goes by {} in each of its steps of {}, and may pass through it: take a 'rate_hz' of {:.0} \
                     or more",
                    quantity(speed * period, "m"),
                    quantity(period, "s"),
                    1.0 / FORESEEN
                )
            } else if speed > self.speed_max {
                format!("meets it at {}, and may pass through it: {}", quantity(speed, "m/s"), self.remedy)
            } else if force > self.force_max {
                format!("presses it with {}, and may pass through it: {}", quantity(force, "N"), self.remedy)
            } else {
                return None;
            };
            Some(format!("{} {why}", scene.name(instrument)))
        })
    }
}
