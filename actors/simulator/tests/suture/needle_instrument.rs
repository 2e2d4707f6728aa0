//! A needle in the way of an instrument: it stops the instrument, or is pushed along; nothing passes through.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_collision::primitive::closest_segments;
use trocar_dynamics::instrument::hand_coupling::HandCoupling;
use trocar_simulator::suture::{Grip, Resistance, StepInputs, Suture};
use trocar_simulator::suture_thread::{LedInstrument, Obstacle, Shape};

use crate::support::suture::{bare, jaws, nowhere, pose, straight};

/// A shaft along z \[m\].
const RADIUS: f64 = 1.8e-3;
const MASS: f64 = 0.03;
const STIFFNESS: f64 = 1000.0;
const BOUND: f64 = 20.0;
/// From the middle of the needle, where jaws hold it, to where the shaft meets it \[m\].
const ASIDE: f64 = 5e-3;

/// A straight needle along x at the origin, far from the tissue, and a shaft that a hand leads along y.
struct Stage {
    suture: Suture,
    grip: Option<Grip>,
    led: LedInstrument,
    hand: f64,
    aside: f64,
    /// Largest force of the coupling, and force on the needle in the last step \[N\].
    hardest: f64,
    contact: f64,
}

impl Stage {
    fn new(hold: Option<f64>, aside: f64) -> Self {
        let shape = straight();
        let at = pose(&shape, Point3::new(0.5 * shape.length(), 0.0, 0.0), Vector3::x(), Vector3::z());
        let suture = bare(&shape, &at, Resistance::default(), nowhere());
        let led = LedInstrument {
            obstacles: [0, 0],
            coupling: HandCoupling::critically_damped(MASS, STIFFNESS, BOUND),
            offset: Vector3::zeros(),
            velocity: Vector3::zeros(),
        };
        let grip = hold.map(|force_max| Grip { force_max, ..jaws(&shape, 0.5 * shape.length(), at, at) });
        Self { suture, grip, led, hand: -5e-3, aside, hardest: 0.0, contact: 0.0 }
    }

    fn step(&mut self, speed: f64, dt: f64) {
        let at = |y: f64| Isometry3::translation(self.aside, y, 0.0);
        let obstacles = [Obstacle {
            shape: Shape::Capsule { ends: [-0.02, 0.02].map(|z| Point3::new(0.0, 0.0, z)), radius: RADIUS },
            from: at(self.hand),
            to: at(self.hand + speed * dt),
            friction: 0.2,
            mobility: None,
        }];
        let (grips, led): (Vec<Grip>, _) = (self.grip.into_iter().collect(), [self.led]);
        let around = StepInputs { grips: &grips, obstacles: &obstacles, led: &led, ..StepInputs::default() };
        let done =
            self.suture.step(dt, &around).unwrap_or_else(|error| panic!("{speed} m/s, {dt} s: {error}"));
        self.hand += speed * dt;
        let motion = self.suture.led()[0];
        (self.led.offset, self.led.velocity) = (motion.offset, motion.velocity);
        self.hardest = self.hardest.max(motion.impulse.norm() / dt);
        self.contact = done.force_on_instruments;
        let slipped = self.suture.gripped().first().and_then(|gripped| gripped.slipped);
        if let (Some(grip), Some(wanted)) = (&mut self.grip, slipped) {
            (grip.from, grip.to) = (wanted, wanted);
        }
        let axis = [-0.02, 0.02].map(|z| Point3::new(self.aside, self.axis(), z));
        let length = self.suture.solid().shape().length();
        let needle = self.suture.state().needle.pose();
        let ends = [0.0, length].map(|along| needle * self.suture.solid().point(along));
        let apart = closest_segments(&axis, &ends).distance_squared.sqrt();
        assert!(apart > 0.95 * (RADIUS + 3e-4), "{speed} m/s, {dt} s: {apart} m from axis to axis");
        assert!(ends[0].lerp(&ends[1], 0.5).y > self.axis(), "it is on the other side");
    }

    fn axis(&self) -> f64 {
        self.hand + self.led.offset.y
    }

    fn lead(&mut self, hand: f64, speed: f64, dt: f64) {
        while self.hand < hand - 1e-9 {
            self.step(speed.min((hand - self.hand) / dt), dt);
        }
        for _ in 0..(0.1 / dt) as usize {
            self.step(0.0, dt);
        }
    }
}

#[test]
fn a_held_needle_stops_a_shaft_at_any_speed_and_the_coupling_gives_its_stiffness() {
    let hand = 6e-3;
    // In series: the coupling, the jaws, and their turn about the grip.
    let gives = 1.0 / STIFFNESS + 1.0 / 1e5 + ASIDE * ASIDE / 20.0;
    let force = (hand + RADIUS + 3e-4) / gives;
    for speed in [0.1, 0.5, 1.0] {
        for dt in [2e-3, 1e-3, 5e-4] {
            let mut stage = Stage::new(Some(f64::INFINITY), ASIDE);
            stage.lead(hand, speed, dt);
            let found = format!("{speed} m/s, {dt} s: {} N of {force}, {:?}", stage.contact, stage.led);
            assert!((stage.contact / force - 1.0).abs() < 0.01, "{found}");
            assert!((stage.led.offset.y * -STIFFNESS / force - 1.0).abs() < 0.01, "{found}");
            assert!(stage.hardest <= BOUND * (1.0 + 1e-9), "{found}");
        }
    }
}

#[test]
fn a_needle_that_jaws_hold_weakly_slips_through_them_with_their_force_and_goes_along() {
    for speed in [0.1, 1.0] {
        let mut stage = Stage::new(Some(2.0), 0.0);
        stage.lead(6e-3, speed, 1e-3);
        let offset = stage.led.offset.y * -STIFFNESS;
        // A fast shaft throws it further than the jaws' force alone would let it.
        let least = if speed < 0.5 { 1.9 } else { 0.0 };
        assert!((least..2.05).contains(&offset), "{speed} m/s: {offset} N");
        assert!(stage.suture.state().needle.pose().translation.y > 4e-3, "{speed} m/s: it stays");
    }
}

#[test]
fn a_free_needle_is_pushed_along_by_a_shaft_that_meets_its_middle() {
    for speed in [0.1, 0.5, 1.0] {
        let mut stage = Stage::new(None, 0.0);
        while stage.hand < 3e-3 {
            stage.step(speed, 1e-3);
        }
        assert!(stage.suture.state().needle.pose().translation.y > 4.9e-3, "{speed} m/s");
        assert!(stage.led.offset.norm() < 2e-3, "{speed} m/s: {:?}", stage.led);
    }
}
