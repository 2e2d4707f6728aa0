//! Instruments that hands lead, as a linear organ holds them back. It has no mass, so an instrument dents it as far as its
//! hand goes, until that takes more force than the hand's coupling has: from there on it gives way against that force.

use nalgebra::Vector3;
use trocar_dynamics::soft_body::instrument_rods::Rod;
use trocar_dynamics::soft_body::method::StepContext;
use trocar_scene::Entity;

use super::contacts::{ConstraintReaction, ConstraintSource};
use super::{Body, ROUNDS_MAX};
use crate::linear_fem::LinearFemError;

/// Force beside the coupling's bound at which the search for a balance ends, as a share of it.
const TOLERANCE: f64 = 1e-3;
/// Maximum number of its steps. While the same contacts press, force and way are proportional, and two are enough.
const STEPS_MAX: usize = 8;
/// A first way where the organ is not dented along the force \[m\].
const FIRST: f64 = 1e-5;

impl Body {
    /// Solves for all constraints, and for contacts that come by that.
    pub(super) fn settle(
        &mut self,
        answers: &mut Vec<ConstraintReaction>,
        rods: &[Rod],
        asked: &mut usize,
    ) -> Result<(), LinearFemError> {
        for _ in 0..ROUNDS_MAX {
            let before = answers.len();
            self.answer(answers, asked)?;
            self.collect_more_contacts(rods, answers);
            let moved = self.advance_to_rod(answers)?;
            if answers.len() == before && !moved {
                break;
            }
        }
        Ok(())
    }

    /// Lets instruments give way on which the contacts press harder than their hands can, and come back when they do not.
    pub(super) fn hold_back(
        &mut self,
        answers: &mut Vec<ConstraintReaction>,
        site: &StepContext<'_>,
    ) -> Result<(), LinearFemError> {
        let led: Vec<(Entity, f64, Vector3<f64>)> = self.held_back.instruments().collect();
        let mut rods = Vec::new();
        for (number, (instrument, bound, offset)) in led.into_iter().enumerate() {
            let force = pressed_by(answers, site.rods, instrument);
            let beyond = force.norm() - bound;
            let is_back = offset == Vector3::zeros();
            if beyond <= bound * TOLERANCE && (is_back || beyond >= -bound * TOLERANCE) {
                self.held_back.balance(number, Vector3::zeros(), -force, site.period_secs());
                continue;
            }
            if rods.is_empty() {
                rods.extend_from_slice(site.rods);
            }
            // It gives way against the force, or goes on to where its hand leads it and no farther.
            let (along, most) = if beyond > 0.0 {
                (-force / force.norm(), f64::INFINITY)
            } else {
                (-offset / offset.norm(), offset.norm())
            };
            let own = answers.iter().filter(|answer| is_of(answer, site.rods, instrument));
            let deepest = own.map(|answer| -answer.target.dot(&along)).fold(0.0, f64::max);
            let guess = beyond / (beyond + bound) * deepest;
            let first = if beyond > 0.0 { guess.max(FIRST) } else { most };
            // A way and the force beyond the bound there, and the way to be tried next.
            let (mut known, mut way, mut gone) = ((0.0, beyond), first, 0.0);
            for _ in 0..STEPS_MAX {
                self.lead(answers, &mut rods, instrument, &(along * (way - gone)))?;
                gone = way;
                let now = pressed_by(answers, &rods, instrument).norm() - bound;
                let is_back = way == most && now <= 0.0;
                if is_back || now.abs() <= TOLERANCE * bound || now == known.1 {
                    break;
                }
                let next = way - now * (way - known.0) / (now - known.1);
                known = (way, now);
                way = next.clamp(0.0, most.min(4.0 * way.max(FIRST)));
            }
            let force = pressed_by(answers, &rods, instrument);
            let by = if gone == most { -offset } else { along * gone };
            self.held_back.balance(number, by, -force, site.period_secs());
        }
        Ok(())
    }

    /// Moves an instrument, and solves again.
    fn lead(
        &mut self,
        answers: &mut Vec<ConstraintReaction>,
        rods: &mut [Rod],
        instrument: Entity,
        by: &Vector3<f64>,
    ) -> Result<(), LinearFemError> {
        let Some(solver) = &mut self.solver else { return Ok(()) };
        for (index, answer) in answers.iter_mut().enumerate() {
            let ConstraintSource::RodContact(touch) = &mut answer.by else { continue };
            if rods[touch.rod].instrument != instrument {
                continue;
            }
            touch.on_axis += by;
            answer.target += by;
            if self.holding.holds(index) {
                let target = answer.target - touch.normal * answer.lag;
                self.holding.set_target(solver, index, target)?;
                if let Some(blend) = &mut self.blend {
                    blend.set_target(index, target)?;
                }
            }
        }
        let own = rods.iter_mut().filter(|rod| rod.instrument == instrument);
        own.for_each(|rod| rod.ends.iter_mut().for_each(|end| *end += by));
        let mut asked = answers.len();
        self.settle(answers, rods, &mut asked)
    }
}

/// Whether a constraint is a contact with an instrument.
fn is_of(answer: &ConstraintReaction, rods: &[Rod], instrument: Entity) -> bool {
    matches!(&answer.by, ConstraintSource::RodContact(touch) if rods[touch.rod].instrument == instrument)
}

/// Force of an instrument's contacts on the organ \[N\].
fn pressed_by(answers: &[ConstraintReaction], rods: &[Rod], instrument: Entity) -> Vector3<f64> {
    answers.iter().filter(|answer| is_of(answer, rods, instrument)).map(|answer| answer.force).sum()
}
