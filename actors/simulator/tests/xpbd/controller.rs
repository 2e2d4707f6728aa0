//! XPBD bodies on a scene: pressed, hanging and restarted, with every kind of material.

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{BuildContext, CollisionList, Controller, ControllerError, Frozen, Pose, VertexPositions};
use trocar_simulator::controller::{DynamicFemController, XpbdController};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

const ROD: &str = r#"
[[entity]]
name = "rod"
pose = { translation = [0.0, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "hook_cautery", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.004, jaws = 0 }
"#;

fn build(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(GRAVITY, context)
}

fn down(z: f64) -> Pose {
    Pose {
        translation: Vector3::new(0.0, 0.0, z),
        ..Pose::from(Isometry3::rotation(Vector3::x() * std::f64::consts::PI))
    }
}

/// Moves the rod into a body from above for half a second; in the middle the controller may be restarted.
fn press<C: Controller>(stage: &mut Stage<C>, hz: u32, depth: f64, mut halfway: impl FnMut(&mut Stage<C>)) {
    let ticks = hz / 2;
    for tick in 0..ticks {
        if tick == ticks / 2 {
            halfway(stage);
        }
        stage.put("rod", down(0.004 - (0.004 + depth) * f64::from(tick) / f64::from(ticks)));
        stage.tick();
    }
}

/// Force on the body according to the collision list \[N\].
fn force<C: Controller>(stage: &Stage<C>) -> Vector3<f64> {
    let lists = stage.store.view().iter::<CollisionList>();
    lists.flat_map(|(_, list)| list.collisions.iter().map(|c| c.force_in_world).collect::<Vec<_>>()).sum()
}

fn pad(kind: &str) -> String {
    format!(
        "{ROD}\n[[entity]]\nname = \"pad\"\npose = {{ translation = [0.0, 0.0, -0.01] }}\n\
         mesh = {{ block = {{ size = [0.04, 0.04, 0.02], cells = [8, 8, 4] }} }}\n{kind}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] }} }}] }}\n"
    )
}

#[test]
fn a_pad_feels_as_one_of_finite_elements_does() {
    let kind = "xpbd = { matter = { volume = { young_modulus = 5000.0, poisson_ratio = 0.3, density = 1060.0 } }, \
                parts = 4, friction = 0.0 }";
    let mut ours = Stage::new(scene(&pad(kind)), 1000.0, build);
    press(&mut ours, 1000, 0.003, |_| {});
    let fem = |context: &BuildContext<'_>| DynamicFemController::new(GRAVITY, context);
    let mut other =
        Stage::new(scene(&pad("dynamic_fem = { young_modulus = 5000.0, poisson_ratio = 0.3 }")), 100.0, fem);
    press(&mut other, 100, 0.003, |_| {});
    (0..500).for_each(|_| ours.tick());
    (0..50).for_each(|_| other.tick());
    assert!(!ours.has::<Frozen>("pad"));
    let (found, wanted) = (force(&ours).z, force(&other).z);
    assert!(
        wanted < -0.01 && (found / wanted - 1.0).abs() < 0.15,
        "{found} N, of finite elements {wanted} N"
    );
    let moved = ours.measured("pad.displacement_max_m");
    assert!((0.0005..0.004).contains(&moved), "{moved} m");
}

#[test]
fn a_cloth_and_a_rod_hang_are_pushed_and_go_on_to_the_bit_in_another_life() {
    let cloth = "mesh = { sheet = { size = [0.06, 0.06], cells = [20, 20] } }\n\
         xpbd = { matter = { cloth = { membrane_stiffness = 150.0, bending_stiffness = 2e-6, density = 0.05 } }, \
         thickness = 0.0005 }\n\
         anchors = { regions = [{ box = { min = [-0.04, 0.029, -1.0], max = [0.04, 0.04, 1.0] } }, \
         { box = { min = [-0.04, -0.04, -1.0], max = [0.04, -0.029, 1.0] } }] }\n";
    let line = "mesh = { line = { length = 0.06, segments = 24, radius = 0.001 } }\n\
         xpbd = { matter = { rod = { axial_stiffness = 50.0, bending_stiffness = 1e-6, density = 2e-3 } } }\n\
         anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [-0.028, 1.0, 1.0] } }, \
         { box = { min = [0.028, -1.0, -1.0], max = [1.0, 1.0, 1.0] } }] }\n";
    for text in [cloth, line] {
        let text = format!("{ROD}\n[[entity]]\nname = \"body\"\n{text}");
        let mut whole = Stage::new(scene(&text), 1000.0, build);
        press(&mut whole, 1000, 0.006, |_| {});
        let mut one = Stage::new(scene(&text), 1000.0, build);
        press(&mut one, 1000, 0.006, |stage| stage.rebuild(build));
        let [a, b] = [&whole, &one].map(|stage| stage.get::<VertexPositions>("body"));
        assert_eq!(a, b);
        assert!(!whole.has::<Frozen>("body"));
        assert!(force(&whole).z < -1e-3, "{} N", force(&whole).z);
        let nearest = a.positions.iter().map(|p| (p - Point3::new(0.0, 0.0, p.z)).norm());
        let (at, _) = nearest
            .enumerate()
            .fold((0, f64::MAX), |least, (at, d)| if d < least.1 { (at, d) } else { least });
        assert!(a.positions[at].z < -0.004, "the rod has pushed it to {} m", a.positions[at].z);
    }
}
