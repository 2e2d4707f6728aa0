//! The engine's soft volumes hold back a shaft that a hand leads against them.

use crate::stage::other::Other;
use crate::stage::{Stage, scene_with};
use nalgebra::Vector3;
use trocar_dynamics::instrument::deflection::InstrumentDeflection;
use trocar_engine::EngineSoftController;
use trocar_scene::{Frozen, InstrumentTarget, Pose, RestPositions, Velocity, VertexPositions};
use trocar_simulator::controller::{InstrumentsConfig, InstrumentsController};

const RADIUS: f64 = 0.0025;
const MASS: f64 = 0.03;
const HZ: f64 = 1000.0;

/// A shaft along z, and a slab across its way along y that is held at both ends.
struct Session {
    stage: Stage<EngineSoftController>,
    instruments: Other,
    hand: f64,
    hardest: f64,
    /// Whether the controller of instruments moves it, or nobody but its hand.
    gives_way: bool,
}

impl Session {
    fn new(kind: &str, bound: f64) -> Self {
        let text = format!(
            "[[entity]]\nname = \"probe\"\npose = {{ translation = [0.0, -0.03, 0.03] }}\n\
             instrument = {{ kind = \"probe\", shaft_length = 0.1, shaft_radius = {RADIUS}, mass = {MASS} }}\n\
             [[entity]]\nname = \"body\"\n\
             mesh = {{ block = {{ size = [0.04, 0.004, 0.008], cells = [20, 2, 4] }} }}\n\
             anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [-0.0199, 1.0, 1.0] }} }}, \
             {{ box = {{ min = [0.0199, -1.0, -1.0], max = [1.0, 1.0, 1.0] }} }}] }}\n\
             engine_soft = {{ {kind}, damping = 20.0 }}\n"
        );
        let scene =
            scene_with(&text, |builder| trocar_engine::register_soft(builder).expect("names are free"));
        let stage = Stage::new(scene, HZ, |c| EngineSoftController::new(Vector3::zeros(), c));
        let instruments = Other::new(&stage, 9, 1, |context| {
            let config = InstrumentsConfig { coupling_force_max: bound, ..InstrumentsConfig::default() };
            InstrumentsController::new(config, context)
        });
        Self { stage, instruments, hand: -0.03, hardest: 0.0, gives_way: true }
    }

    fn tick(&mut self, way: f64) {
        self.hand += way;
        let target = InstrumentTarget {
            tip_in_world: Pose::at(0.0, self.hand, 0.03),
            velocity_in_world: Velocity { linear: Vector3::y() * (way * HZ), angular: Vector3::zeros() },
            sampled_at: self.stage.now(),
            ..InstrumentTarget::default()
        };
        if self.gives_way {
            self.stage.put("probe", target);
            self.instruments.tick(&mut self.stage);
        } else {
            self.stage.put("probe", target.tip_in_world);
            self.stage.put("probe", target.velocity_in_world);
        }
        self.stage.tick();
        self.hardest = self.hardest.max(self.stage.measured("body.contact_force_n"));
    }

    /// The lowest place of what was in the middle of the far side, relative to the shaft's axis, along its way \[m\].
    fn before(&self) -> f64 {
        let rest = self.stage.get::<RestPositions>("body").positions;
        let all = self.stage.get::<VertexPositions>("body").positions;
        let middle = all.iter().zip(rest.iter()).filter(|(_, rest)| rest.x.abs() < 1e-6 && rest.y > -1e-6);
        middle.map(|(point, _)| point.y).fold(f64::INFINITY, f64::min)
            - self.stage.get::<Pose>("probe").translation.y
    }
}

/// Led 12 mm beyond where the slab is; returns how near its far side has come to the shaft's axis \[m\].
fn lead(session: &mut Session, speed: f64) -> f64 {
    session.hand = -0.006;
    session.tick(0.0);
    let mut nearest = f64::INFINITY;
    while session.hand < 0.012 - 1e-9 {
        session.tick((speed / HZ).min(0.012 - session.hand));
        nearest = nearest.min(session.before());
    }
    for _ in 0..30 {
        session.tick(0.0);
        nearest = nearest.min(session.before());
    }
    assert!(!session.stage.has::<Frozen>("body"), "{speed} m/s");
    nearest
}

fn is_stopped(kind: &str, bound: f64) {
    for speed in [0.05, 0.2, 1.0] {
        let mut session = Session::new(kind, bound);
        let nearest = lead(&mut session, speed);
        let back = session.stage.get::<InstrumentDeflection>("probe").total().offset.norm();
        println!(
            "{kind} {bound} N {speed} m/s: nearest {nearest} m, held back by {back} m, hardest {} N",
            session.hardest
        );
        assert!(nearest > 0.1 * RADIUS, "{kind} {speed} m/s: it is through: {nearest} m");
        assert!(back > 1e-3, "{kind} {speed} m/s: it is held back by {back} m");
        // What stops it within a tick, and the springs of the body's own contacts, of at most 300 N/m.
        let most = 1.1 * bound + MASS * speed * HZ + 300.0 * 0.5 * RADIUS * 20.0;
        assert!(session.hardest < most, "{kind} {speed} m/s: {} N", session.hardest);
    }
}

fn slab(solver: &str, young_modulus: &str) -> String {
    format!(
        "young_modulus = {young_modulus}, poisson_ratio = 0.3, density = 1000.0, solver = \"{solver}\", parts = 4"
    )
}

#[test]
fn constraints_stop_a_shaft_at_any_speed() {
    let kind = slab("constraints", "1e6");
    is_stopped(&kind, 5.0);
    // A shaft that does not give way goes through.
    let mut passing = Session::new(&kind, 5.0);
    passing.gives_way = false;
    let nearest = lead(&mut passing, 0.2);
    assert!(nearest < -RADIUS, "{nearest} m");
}

#[test]
fn finite_elements_of_the_engine_stop_a_shaft_at_any_speed() {
    is_stopped(&slab("finite_elements", "5e6"), 12.0);
}
