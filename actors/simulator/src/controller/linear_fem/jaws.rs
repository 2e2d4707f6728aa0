//! Jaws that hold a linear organ by friction. It has no mass, so a grip that needs more force than its jaws bear slips
//! at once, against that force, until they bear it.

use nalgebra::Vector3;
use trocar_dynamics::picking::Jaws;
use trocar_dynamics::soft_body::jaw_friction::crush;
use trocar_dynamics::soft_body::method::StepContext;
use trocar_scene::{Commands, Entity};

use super::Body;
use super::contacts::{ConstraintReaction, ConstraintSource};
use crate::linear_fem::LinearFemError;

/// Force beyond that of the jaws at which the search for a slip ends, as a share of it.
const TOLERANCE: f64 = 1e-3;
/// Maximum number of its steps; without contacts beside the jaws, force and slip are proportional, and two are enough.
const STEPS_MAX: usize = 8;
/// A first slip where the organ is not displaced along the force \[m\].
const FIRST: f64 = 1e-5;

impl Body {
    /// Takes and releases vertices.
    pub(super) fn hold(
        &mut self,
        jaws: &[Jaws<'_>],
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<(), String> {
        let before: Vec<u64> = self.grips.picks.picks.iter().map(|pick| pick.instrument).collect();
        let triangles = self.body.triangles.clone();
        self.grips.picks.update(&triangles, &self.positions, jaws).map_err(|error| error.to_string())?;
        for jaw in jaws.iter().filter(|jaw| self.strained.has_slipped(jaw.instrument)) {
            self.grips.picks.take_more(&triangles, &self.positions, jaw);
        }
        let new = self.grips.picks.picks.iter().filter(|pick| !before.contains(&pick.instrument));
        new.for_each(|pick| crush(pick, &self.body, site.scene, out));
        let pose = |of: u64| jaws.iter().find(|jaw| jaw.instrument == of).map(|jaw| jaw.body_from_instrument);
        self.jaws.begin(&self.grips.picks, &self.strained, site.scene, pose);
        Ok(())
    }

    /// Lets slip what jaws cannot hold.
    pub(super) fn slip(&mut self, answers: &mut [ConstraintReaction]) -> Result<(), LinearFemError> {
        for grip in 0..self.grips.picks.picks.len() {
            let instrument = Entity::from_bits(self.grips.picks.picks[grip].instrument);
            let (limit, force) = (self.jaws.friction[grip], force_of(answers, instrument));
            if force.norm() <= limit * (1.0 + TOLERANCE) {
                continue;
            }
            let along = force.normalize();
            let own = answers.iter().filter(|answer| is_of(answer, instrument));
            let (sum, count) =
                own.fold((0.0, 0.0), |(sum, count), own| (sum + own.target.dot(&along), count + 1.0));
            let beyond = force.norm() - limit;
            let guess = beyond / force.norm() * sum / f64::max(count, 1.0);
            // A way of slipping and the force beyond the limit there, and the way to be tried next.
            let (mut known, mut way) = ((0.0, beyond), if guess > 0.0 { guess } else { FIRST });
            for _ in 0..STEPS_MAX {
                self.draw_back(answers, instrument, &(along * (way - known.0)))?;
                let now = force_of(answers, instrument).norm() - limit;
                if now.abs() <= TOLERANCE * limit || now == known.1 {
                    break;
                }
                let next = way - now * (way - known.0) / (now - known.1);
                (known, way) = ((way, now), next.clamp(0.0, 4.0 * way));
            }
            self.jaws.forces[grip] = Some(force_of(answers, instrument));
            self.jaws.slipped[grip] = true;
        }
        Ok(())
    }

    /// Moves what an instrument holds back in its jaws, and solves again.
    fn draw_back(
        &mut self,
        answers: &mut [ConstraintReaction],
        instrument: Entity,
        by: &Vector3<f64>,
    ) -> Result<(), LinearFemError> {
        let Some(solver) = &mut self.solver else { return Ok(()) };
        for (index, answer) in answers.iter_mut().enumerate().filter(|(_, answer)| is_of(answer, instrument))
        {
            answer.target -= by;
            self.holding.set_target(solver, index, answer.target)?;
            if let Some(blend) = &mut self.blend {
                blend.set_target(index, answer.target)?;
            }
        }
        let mut asked = answers.len();
        self.answer(answers, &mut asked)
    }

    /// Takes over where what has slipped is in its jaws now.
    pub(super) fn keep_slipped(
        &mut self,
        answers: &[ConstraintReaction],
        site: &StepContext<'_>,
        out: &mut Commands,
    ) {
        let pull = |(grip, instrument)| {
            let pull = self.jaws.pull(grip, || -force_of(answers, Entity::from_bits(instrument)));
            (pull, 0.0)
        };
        let pulls: Vec<(Vector3<f64>, f64)> =
            self.grips.picks.picks.iter().map(|pick| pick.instrument).enumerate().map(pull).collect();
        let picks = (&mut self.grips.picks, &self.jaws, &pulls[..]);
        self.strained.take(picks, &self.body, &self.positions, (site.scene, site.tick), out);
    }
}

/// Whether a constraint is that of an instrument's jaws.
fn is_of(answer: &ConstraintReaction, instrument: Entity) -> bool {
    matches!(answer.by, ConstraintSource::Jaws(by, _) if by == instrument)
}

/// Force of an instrument's jaws on the organ \[N\].
fn force_of(answers: &[ConstraintReaction], instrument: Entity) -> Vector3<f64> {
    answers.iter().filter(|answer| is_of(answer, instrument)).map(|answer| answer.force).sum()
}
