//! Instruments that a hand leads: obstacles that stand where their hand leads them, unless the thread is in the way. Their
//! displacement from there is solved together with the thread.

use nalgebra::{Matrix3, Vector3};
use trocar_dynamics::instrument::hand_coupling::HandCoupling;

/// An instrument that is displaced, and moves in a substep, by less stands where it is led \[m\].
const OFFSET_MIN: f64 = 1e-9;

/// An instrument that a hand leads, at the beginning of a step. All vectors in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LedInstrument {
    /// Its first and its last part among the obstacles, whose poses are those that the hand leads to.
    pub obstacles: [usize; 2],
    /// The coupling to the hand.
    pub coupling: HandCoupling,
    /// Displacement from where the hand leads it \[m\].
    pub offset: Vector3<f64>,
    /// Velocity of that displacement \[m/s\].
    pub velocity: Vector3<f64>,
}

/// Motion of a led instrument in a step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LedMotion {
    /// Displacement from where the hand leads it, at the end \[m\].
    pub offset: Vector3<f64>,
    /// Velocity of that displacement, at the end \[m/s\].
    pub velocity: Vector3<f64>,
    /// Impulse of the coupling on the hand \[N·s\].
    pub impulse: Vector3<f64>,
}

impl LedInstrument {
    /// What is invalid in it among this many obstacles, if anything.
    pub(crate) fn wrong(&self, obstacles: usize) -> Option<String> {
        let [first, last] = self.obstacles;
        if first > last || last >= obstacles {
            return Some(format!("obstacles {first} to {last} of {obstacles}"));
        }
        let finite = |of: &Vector3<f64>| of.iter().all(|x| x.is_finite());
        if !finite(&self.offset) || !finite(&self.velocity) {
            return Some("a motion that is not finite".to_owned());
        }
        self.coupling.wrong().map(str::to_owned)
    }

    /// At the state that it has reached within the step.
    pub(crate) fn at(&self, motion: &LedMotion) -> Self {
        Self { offset: motion.offset, velocity: motion.velocity, ..*self }
    }

    /// Force that a change of the displacement by `by` \[m\] in a substep of `dt` \[s\] needs, and its derivative.
    pub(crate) fn needed(&self, by: &Vector3<f64>, dt: f64) -> (Vector3<f64>, Matrix3<f64>) {
        self.coupling.needed([&self.offset, &self.velocity], by, dt)
    }

    /// Change of the displacement in a substep without contact.
    pub(crate) fn freely(&self, dt: f64) -> Vector3<f64> {
        let none = Vector3::zeros();
        if self.offset == none && self.velocity == none {
            return none;
        }
        self.coupling.change([&self.offset, &self.velocity], (&none, &Matrix3::zeros()), &none, dt)
    }

    /// Its motion after a substep in which the displacement has changed by `by`.
    pub(crate) fn after(&self, before: &LedMotion, by: &Vector3<f64>, dt: f64) -> LedMotion {
        let impulse = before.impulse + self.coupling.force(&self.offset, by, dt).0 * dt;
        let offset = self.offset + by;
        if offset.norm() < OFFSET_MIN && by.norm() < OFFSET_MIN {
            return LedMotion { impulse, ..LedMotion::default() };
        }
        LedMotion { offset, velocity: by / dt, impulse }
    }
}
