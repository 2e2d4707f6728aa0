//! The controller of dynamic finite elements: a restart continues bit for bit.

use crate::support::stage::{Stage, scene};
use nalgebra::Vector3;
use trocar_scene::{BuildContext, Pose, VertexPositions, VertexVelocities};
use trocar_simulator::controller::{DynamicFemController, DynamicFemMemory};

const SCENE: &str = r#"
[[entity]]
name = "rod"
pose = { translation = [0.0, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "probe", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.004, jaws = 0 }
[[entity]]
name = "pad"
pose = { translation = [0.0, 0.0, -0.01] }
mesh = { block = { size = [0.04, 0.04, 0.02], cells = [8, 8, 4] } }
dynamic_fem = { young_modulus = 5000.0 }
anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] } }] }
"#;

#[test]
fn another_life_goes_on_to_the_bit() {
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    let build = |context: &BuildContext<'_>| DynamicFemController::new(gravity, context);
    let turned = nalgebra::Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let run = |kill: Option<u32>, forget: bool| {
        let mut stage = Stage::new(scene(SCENE), 100.0, build);
        for tick in 0..40_u32 {
            if kill == Some(tick) {
                if forget {
                    stage.put("pad", DynamicFemMemory::default());
                }
                stage.rebuild(build);
            }
            let z = 0.004 - 0.010 * f64::from(tick) / 40.0;
            stage.put("rod", Pose { translation: Vector3::new(0.001, 0.0, z), ..Pose::from(turned) });
            stage.tick();
        }
        (stage.get::<VertexPositions>("pad"), stage.get::<VertexVelocities>("pad"))
    };
    let whole = run(None, false);
    assert_eq!(run(Some(23), false), whole);
    // The control: without its saved state it continues approximately, but not bit for bit.
    assert_ne!(run(Some(23), true), whole);
}
