//! A linear organ holds back an instrument that its hand leads against it: with no more force than the hand's coupling has.

use nalgebra::Vector3;
use trocar_dynamics::instrument::deflection::{InstrumentDeflection, InstrumentYields};
use trocar_scene::{Frozen, InstrumentForce, InstrumentTarget, Pose, Velocity};
use trocar_simulator::controller::{InstrumentsConfig, InstrumentsController, LinearFemController};

use crate::support::stage::other::Other;
use crate::support::stage::{Stage, scene};

const HZ: f64 = 1000.0;

/// A probe that points down on the middle of a pad, whose top is at z = 0.
struct Session {
    stage: Stage<LinearFemController>,
    instruments: Other,
    hand: f64,
    hardest: f64,
}

impl Session {
    fn new(bound: f64) -> Self {
        let text = "[[entity]]\nname = \"probe\"\npose = { translation = [0.001, 0.001, 0.01], rotation = [1.0, 0.0, 0.0, 0.0] }\n\
             instrument = { kind = \"probe\", shaft_length = 0.1, shaft_radius = 0.0025 }\n\
             [[entity]]\nname = \"pad\"\npose = { translation = [0.0, 0.0, -0.02] }\n\
             mesh = { block = { size = [0.06, 0.06, 0.04], cells = [12, 12, 6] } }\n\
             linear_fem = { young_modulus = 2e4, poisson_ratio = 0.4, contact_radius = 0.008 }\n\
             anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0199] } }] }\n";
        let stage = Stage::new(scene(text), HZ, |c| LinearFemController::new(Vector3::zeros(), None, c));
        let instruments = Other::new(&stage, 9, 1, |context| {
            let config = InstrumentsConfig { coupling_force_max: bound, ..InstrumentsConfig::default() };
            InstrumentsController::new(config, context)
        });
        let mut session = Self { stage, instruments, hand: 0.01, hardest: 0.0 };
        // Until its inverse is there.
        (0..3).for_each(|_| session.tick(0.0));
        assert_eq!(session.stage.measured("pad.precomputed_share"), 1.0);
        session
    }

    fn tick(&mut self, way: f64) {
        self.hand += way;
        let target = InstrumentTarget {
            tip_in_world: Pose {
                translation: Vector3::new(1e-3, 1e-3, self.hand),
                ..self.stage.get("probe")
            },
            velocity_in_world: Velocity { linear: Vector3::z() * (way * HZ), angular: Vector3::zeros() },
            sampled_at: self.stage.now(),
            ..InstrumentTarget::default()
        };
        self.stage.put("probe", target);
        self.instruments.tick(&mut self.stage);
        self.stage.tick();
        assert!(!self.stage.has::<Frozen>("pad"));
        self.hardest = self.hardest.max(self.force());
    }

    fn force(&self) -> f64 {
        self.stage.measured("pad.contact_force_n")
    }

    fn lead(&mut self, to: f64, speed: f64) {
        while (self.hand - to).abs() > 1e-9 {
            self.tick((to - self.hand).clamp(-speed / HZ, speed / HZ));
        }
        (0..5).for_each(|_| self.tick(0.0));
    }
}

#[test]
fn a_linear_organ_stops_a_probe_with_its_bound_at_any_speed() {
    let bound = 1.0;
    let mut session = Session::new(200.0);
    session.lead(-0.001, 0.05);
    let stiffness = session.force() / 1e-3;
    session.lead(-0.015, 0.05);
    // Without a bound it is dented as far as the hand goes.
    assert!(session.force() > 2.0 * bound, "{} N", session.force());
    assert_eq!(session.stage.get::<Pose>("probe").translation.z, session.hand);
    for speed in [0.05, 0.2, 1.0] {
        let mut session = Session::new(bound);
        session.lead(-0.015, speed);
        let dent = -session.stage.get::<Pose>("probe").translation.z;
        let felt = session.stage.get::<InstrumentForce>("probe").force.norm();
        println!(
            "{speed} m/s: hardest {} N, felt {felt} N, dent {dent} m of {} m",
            session.hardest,
            bound / stiffness
        );
        assert!(session.hardest < 1.002 * bound, "{speed} m/s: {} N", session.hardest);
        assert!((felt / bound - 1.0).abs() < 2e-3, "{speed} m/s: a hand feels {felt} N");
        assert!((dent * stiffness / bound - 1.0).abs() < 0.02, "{speed} m/s: {dent} m, {stiffness} N/m");
        // It stands back from its hand by the rest of the way, and not when the hand comes back.
        let back = session.stage.get::<InstrumentDeflection>("probe").total().offset;
        assert!((back.z - (0.015 - dent)).abs() < 1e-9, "{back}");
        session.lead(-0.001, speed);
        assert!((session.force() / (1e-3 * stiffness) - 1.0).abs() < 0.02, "{} N", session.force());
        assert_eq!(session.stage.get::<Pose>("probe").translation.z, session.hand);
        session.lead(0.01, speed);
        assert_eq!(session.force(), 0.0);
        assert!(session.stage.get::<InstrumentYields>("pad").list.is_empty());
    }
}
