//! Smooth following of a jumping goal: a slew limit, then a critically damped second-order filter.
//!
//! The reference moves straight to the goal with limited speed; the filter `ẍ + 2ω ẋ + ω² x = ω² r` follows the
//! reference. Its impulse response is nowhere negative, so the follower, which starts at rest, is never faster than the
//! reference's limit and never overshoots. Both parts are solved exactly over a step, in which the goal is constant:
//! any division of a span into steps gives the same result, up to rounding.

use nalgebra::SVector;
use serde::{Deserialize, Serialize};

/// A point that follows a goal.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Follower<const D: usize> {
    /// Reference of the filter: moves to the goal with limited speed.
    pub reference: SVector<f64, D>,
    /// Position of the follower.
    pub position: SVector<f64, D>,
    /// Its velocity \[1/s\].
    pub velocity: SVector<f64, D>,
}

impl<const D: usize> Follower<D> {
    /// At rest.
    pub fn at(position: SVector<f64, D>) -> Self {
        Self { reference: position, position, velocity: SVector::zeros() }
    }

    /// Follows `goal` for `dt_secs`, at most at `speed_max` \[1/s\], with a filter of the angular frequency `rate`
    /// \[rad/s\]: behind a steady motion it lags by `2/rate` \[s\].
    pub fn advance(&mut self, goal: &SVector<f64, D>, dt_secs: f64, speed_max: f64, rate: f64) {
        let way = goal - self.reference;
        let length = way.norm();
        let travel_secs = (length / speed_max).min(dt_secs);
        if travel_secs > 0.0 {
            self.filter(&(way * (speed_max / length)), travel_secs, rate);
            self.reference = if travel_secs < dt_secs {
                *goal
            } else {
                self.reference + way * (speed_max * dt_secs / length)
            };
        }
        if travel_secs < dt_secs {
            self.filter(&SVector::zeros(), dt_secs - travel_secs, rate);
        }
    }

    /// The filter's exact response to a reference with constant velocity.
    fn filter(&mut self, reference_velocity: &SVector<f64, D>, secs: f64, rate: f64) {
        let lag = reference_velocity * (2.0 / rate);
        let offset = self.position - self.reference + lag;
        let slope = self.velocity - reference_velocity;
        let bend = slope + offset * rate;
        let decay = exp(-rate * secs);
        self.position = self.reference + reference_velocity * secs - lag + (offset + bend * secs) * decay;
        self.velocity = reference_velocity + (slope - bend * (rate * secs)) * decay;
    }
}

/// `e^x` by a series with scaling and squaring: additions and multiplications only, bit-identical on every machine.
pub(crate) fn exp(x: f64) -> f64 {
    let (mut scaled, mut squarings) = (x.clamp(-700.0, 700.0), 0);
    while scaled.abs() > 0.125 {
        scaled *= 0.5;
        squarings += 1;
    }
    let mut sum = 1.0;
    for term in (1..=12).rev() {
        sum = 1.0 + scaled * sum / f64::from(term);
    }
    for _ in 0..squarings {
        sum *= sum;
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Vector1, Vector3};
    use proptest::prelude::*;

    #[test]
    fn the_exponential_is_that_of_the_library() {
        for step in -400..=400 {
            let x = f64::from(step) * 0.05;
            assert!((exp(x) / x.exp() - 1.0).abs() < 1e-12, "{x}");
        }
    }

    /// The same equations in tiny steps.
    fn integrated(mut follower: Follower<1>, goal: f64, secs: f64, speed_max: f64, rate: f64) -> Follower<1> {
        let dt = 1e-6;
        for _ in 0..(secs / dt).round() as u64 {
            let way = goal - follower.reference.x;
            let pull = (follower.reference - follower.position) * (rate * rate);
            follower.velocity += (pull - follower.velocity * (2.0 * rate)) * dt;
            follower.position += follower.velocity * dt;
            follower.reference.x += way.clamp(-speed_max * dt, speed_max * dt);
        }
        follower
    }

    #[test]
    fn a_step_solves_the_equations_of_slew_and_filter() {
        for (goal, secs) in [(0.1, 0.2), (0.02, 0.2), (-0.3, 0.05)] {
            let start = Follower { velocity: Vector1::new(0.1), ..Follower::at(Vector1::new(0.01)) };
            let mut exact = start;
            exact.advance(&Vector1::new(goal), secs, 0.3, 50.0);
            let numeric = integrated(start, goal, secs, 0.3, 50.0);
            assert!((exact.position - numeric.position).norm() < 1e-5, "{exact:?} {numeric:?}");
            assert!((exact.velocity - numeric.velocity).norm() < 1e-3, "{exact:?} {numeric:?}");
        }
    }

    fn vector() -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-0.2..0.2f64).prop_map(Vector3::from)
    }

    proptest! {
        #[test]
        fn any_division_of_a_span_ends_in_the_same_place(
            goals in prop::collection::vec((vector(), 0.001..0.2f64, 1..40u32), 1..5),
            speed_max in 0.01..1.0f64, rate in 5.0..200.0f64,
        ) {
            let (mut whole, mut divided) = (Follower::at(Vector3::zeros()), Follower::at(Vector3::zeros()));
            for (goal, secs, parts) in goals {
                whole.advance(&goal, secs, speed_max, rate);
                for _ in 0..parts {
                    divided.advance(&goal, secs / f64::from(parts), speed_max, rate);
                }
            }
            prop_assert!((whole.position - divided.position).norm() < 1e-12);
            prop_assert!((whole.velocity - divided.velocity).norm() < 1e-9);
        }

        #[test]
        fn no_jump_of_the_goal_makes_it_faster_than_the_limit_or_overshoot(
            goals in prop::collection::vec((vector(), 1..30u32), 1..20),
            speed_max in 0.01..1.0f64, rate in 5.0..200.0f64,
        ) {
            let mut follower = Follower::at(Vector3::zeros());
            for (goal, ticks) in goals {
                for _ in 0..ticks {
                    let before = follower.position;
                    follower.advance(&goal, 0.01, speed_max, rate);
                    prop_assert!(follower.velocity.norm() <= speed_max * (1.0 + 1e-9));
                    prop_assert!((follower.position - before).norm() <= speed_max * 0.01 * (1.0 + 1e-9));
                }
            }
        }
    }

    #[test]
    fn a_goal_that_stands_still_is_reached_without_overshoot() {
        let goal = Vector1::new(0.05);
        let mut follower = Follower::at(Vector1::new(0.0));
        for _ in 0..200 {
            follower.advance(&goal, 0.01, 0.25, 50.0);
            assert!(follower.position.x <= goal.x + 1e-12);
        }
        assert!((follower.position - goal).norm() < 1e-9 && follower.velocity.norm() < 1e-7);
    }
}
