//! Rigid bodies on a scene: the configured integrator is used.

use crate::support::stage::{Stage, scene};
use nalgebra::Vector3;
use trocar_dynamics::rigid_bodies::RigidBodiesController;
use trocar_scene::{Pose, Velocity};
use trocar_simulator::impulse_world::{ImpulseWorld, RigidSettings};
use trocar_simulator::rigid::Integrator;

const HALF: [f64; 3] = [0.03, 0.02, 0.01];
const MASS: f64 = 0.1;

/// Moments about x, y and z \[kg·m²\].
fn moments() -> Vector3<f64> {
    let [a, b, c] = HALF.map(|half| half * half / 3.0);
    Vector3::new(b + c, a + c, a + b) * MASS
}

/// A plate rotating almost about its intermediate axis for 10 s: number of flips, and largest relative gain and loss of
/// energy.
fn turns(text: &str) -> (u32, f64, f64) {
    let settings: RigidSettings = serde_json::from_str(text).expect("settings");
    let settings = RigidSettings {
        gravity_in_world: Vector3::zeros(),
        floor_height: None,
        substep_secs: 0.001,
        ..settings
    };
    let [x, y, z] = HALF;
    let store = scene(&format!(
        "[[entity]]\nname = \"plate\"\npose = {{}}\nshape = {{ box = {{ half_extents = [{x}, {y}, {z}] }} }}\n\
         rigid_body = {{ motion = \"dynamic\", mass = {MASS} }}\n\
         velocity = {{ linear = [0.0, 0.0, 0.0], angular = [0.001, 12.0, 0.001] }}\n"
    ));
    let mut stage = Stage::new(store, 250.0, |context| {
        RigidBodiesController::<ImpulseWorld>::new(context, settings.clone())
            .map_err(|error| trocar_scene::ControllerError::Scene(error.to_string()))
    });
    let energy = |stage: &Stage<_>| {
        let (pose, velocity) = (stage.get::<Pose>("plate"), stage.get::<Velocity>("plate"));
        let spin = pose.rotation.inverse() * velocity.angular;
        (0.5 * spin.component_mul(&moments()).dot(&spin), spin.y)
    };
    let (first, _) = energy(&stage);
    let (mut flips, mut side, mut most, mut least) = (0, 1.0, 0.0_f64, 0.0_f64);
    for _ in 0..2500 {
        stage.tick();
        let (now, about) = energy(&stage);
        (most, least) = (most.max(now / first - 1.0), least.min(now / first - 1.0));
        if about * side < -6.0 {
            (flips, side) = (flips + 1, -side);
        }
    }
    (flips, most, least)
}

#[test]
fn the_integrator_that_is_asked_for_moves_bodies() {
    let (flips, gained, lost) = turns(r#"{"integrator": "runge_kutta4"}"#);
    assert!(flips >= 2, "it flips over and over: {flips}");
    assert!(gained < 1e-6 && lost > -1e-6, "{gained} {lost}");
    let (_, by_explicit, _) = turns(r#"{"integrator": "explicit_euler"}"#);
    assert!(by_explicit > 1e-3, "explicit steps gain energy: {by_explicit}");
    let (flips, gained, lost) = turns(r#"{"integrator": "symplectic"}"#);
    assert!(flips >= 2 && gained < 0.02 && lost > -0.02, "{flips} {gained} {lost}");
    let (same, ..) = turns("{}");
    assert_eq!(same, flips, "which is what is taken where none is asked for");
    let unknown =
        serde_json::from_str::<RigidSettings>(r#"{"integrator": "verlet"}"#).expect_err("there is no such");
    let text = unknown.to_string();
    assert!(text.contains("runge_kutta4") && text.contains("explicit_euler"), "{text}");
    assert_eq!(RigidSettings::default().integrator, Integrator::Symplectic);
}
