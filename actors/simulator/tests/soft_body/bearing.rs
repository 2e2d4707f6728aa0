//! Soft bodies and threads bear rigid bodies that move, at any rate and in whichever world.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::rigid_bodies::RigidBodiesController;
use trocar_scene::{
    Access, Commands, Controller, ControllerError, Frozen, Measured, Pose, Snapshot, Tick, VertexPositions,
};
use trocar_simulator::controller::{
    DynamicFemController, LinearFemController, MassSpringController, ThreadController, XpbdController,
};
use trocar_simulator::impulse_world::{ImpulseWorld, RigidSettings};

use crate::support::stage::other::Other;
use crate::support::stage::{Stage, scene};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
const SOFT: u16 = 9;
const RIGID: u16 = 10;

/// The clock of the stage: it does nothing.
struct Nobody;

impl Controller for Nobody {
    fn access(&self) -> Access {
        Access::new()
    }
    fn tick(&mut self, _: &Tick<'_>, _: &Snapshot, _: &mut Commands) -> Result<(), ControllerError> {
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Method {
    DynamicFem,
    LinearFem,
    Thread,
}

/// A soft controller and our own rigid world on a scene; ticks in milliseconds.
struct Scene {
    stage: Stage<Nobody>,
    soft: Other,
    rigid: Other,
}

impl Scene {
    fn new(text: &str, method: Method, [soft, rigid]: [u32; 2]) -> Self {
        let stage = Stage::new(scene(text), 1000.0, |_| Ok(Nobody));
        let soft = match method {
            Method::DynamicFem => Other::new(&stage, SOFT, soft, |c| DynamicFemController::new(GRAVITY, c)),
            Method::LinearFem => {
                Other::new(&stage, SOFT, soft, |c| LinearFemController::new(GRAVITY, None, c))
            }
            Method::Thread => Other::new(&stage, SOFT, soft, |c| ThreadController::new(GRAVITY, None, c)),
        };
        let rigid = Other::new(&stage, RIGID, rigid, |context| {
            let settings =
                RigidSettings { gravity_in_world: GRAVITY, floor_height: None, ..RigidSettings::default() };
            RigidBodiesController::<ImpulseWorld>::new(context, settings)
                .map_err(|error| ControllerError::Scene(error.to_string()))
        });
        Self { stage, soft, rigid }
    }

    /// Runs it; returns the mean height of the rigid body in the last third \[m\].
    fn run(&mut self, secs: f64) -> f64 {
        let ticks = (secs * 1000.0) as u64;
        let mut heights = Vec::new();
        for tick in 0..ticks {
            for other in [&mut self.soft, &mut self.rigid] {
                if tick.is_multiple_of(u64::from(other.every)) {
                    other.tick(&mut self.stage);
                }
            }
            self.stage.tick();
            if 3 * tick > 2 * ticks {
                heights.push(self.stage.get::<Pose>("rigid").isometry().translation.z);
            }
        }
        heights.iter().sum::<f64>() / heights.len() as f64
    }
}

/// A ball of 50 g, 1 mm above a block of 8 kPa that is 40 mm thick.
fn ball_above_block(kind: &str) -> String {
    format!(
        r#"
[[entity]]
name = "block"
pose = {{ translation = [0.0, 0.0, 0.02] }}
mesh = {{ block = {{ size = [0.06, 0.06, 0.04], cells = [6, 6, 4] }} }}
{kind}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0199] }} }}] }}
[[entity]]
name = "rigid"
pose = {{ translation = [0.0, 0.0, 0.053] }}
mesh = {{ shape = {{ sphere = {{ radius = 0.012 }} }}, segments = 16 }}
rigid_body = {{ motion = "dynamic", mass = 0.05, friction = 0.3 }}
"#
    )
}

#[test]
fn a_ball_rests_on_finite_elements_at_the_same_depth_at_any_rate() {
    // Hertz (1881) for a half-space: F = 4/3 E* √R d^(3/2), 4.8 mm deep. The block is thinner, and its cells of 10 mm
    // are as large as the contact: it is stiffer.
    let young = 8e3 / (1.0 - 0.45 * 0.45);
    let hertz = (0.05 * 9.81 / (4.0 / 3.0 * young * 0.012_f64.sqrt())).powf(2.0 / 3.0);
    let fem = "dynamic_fem = { young_modulus = 8e3, poisson_ratio = 0.45, density = 1000.0 }";
    let linear = "linear_fem = { young_modulus = 8e3, poisson_ratio = 0.45 }";
    let mut depths = Vec::new();
    for (method, kind, rates) in [
        (Method::DynamicFem, fem, &[[2, 1], [10, 2], [33, 2], [100, 2], [16, 16]][..]),
        (Method::LinearFem, linear, &[[2, 1], [10, 10]][..]),
    ] {
        for &every in rates {
            let mut scene = Scene::new(&ball_above_block(kind), method, every);
            let depth = 0.052 - scene.run(0.6);
            assert!(!scene.stage.has::<Frozen>("block"));
            let share = depth / hertz;
            assert!(
                (0.55..1.05).contains(&share),
                "{method:?}, ticks of {every:?} ms: {share} of Hertz's depth"
            );
            depths.push((method, every, depth));
        }
    }
    for method in [Method::DynamicFem, Method::LinearFem] {
        let of: Vec<f64> = depths.iter().filter(|of| of.0 == method).map(|of| of.2).collect();
        let (least, most) = of.iter().fold((f64::MAX, 0.0_f64), |(a, b), of| (a.min(*of), b.max(*of)));
        assert!(most < 1.1 * least, "{depths:?}");
    }
}

#[test]
fn a_weight_hangs_in_a_sling_that_a_scenario_declares() {
    let places: Vec<String> = (0..=12)
        .map(|k| std::f64::consts::PI * (1.0 + f64::from(k) / 12.0))
        .map(|angle| Point3::new(0.0058 * angle.cos(), 0.0, 0.0058 * angle.sin()))
        .map(|at| format!("[{}, 0.0, {}]", at.x, at.z))
        .collect();
    let text = format!(
        r#"
[[entity]]
name = "rigid"
pose = {{ translation = [0.0, 0.0, 0.0], rotation = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476] }}
shape = {{ capsule = {{ radius = 0.005, half_height = 0.012 }} }}
rigid_body = {{ motion = "dynamic", mass = 0.02, friction = 0.2 }}
[[entity]]
name = "thread"
mesh = {{ line = {{ length = 0.10, segments = 20, radius = 0.00025 }} }}
anchors = {{ regions = [{{ ball = {{ center = [-0.0058, 0.0, 0.03], radius = 0.002 }} }}, {{ ball = {{ center = [0.0058, 0.0, 0.03], radius = 0.002 }} }}] }}
[entity.thread]
suture = "silk2"
edges = [2.0, 1e-3]
[entity.thread.laid.through]
places = [[-0.0058, 0.0, 0.03], {}, [0.0058, 0.0, 0.03]]
"#,
        places.join(", ")
    );
    for every in [[2, 2], [2, 1], [10, 1], [2, 5], [1, 10], [2, 10]] {
        let mut scene = Scene::new(&text, Method::Thread, every);
        let height = scene.run(1.0);
        let measured = scene.stage.store.view().get::<Measured>(scene.soft.me).cloned().expect("measures");
        let tension = measured.values["thread.tension_n"];
        assert!((-3e-3..3e-3).contains(&height), "ticks of {every:?} ms: at {height} m");
        // At the end of a tick: over the ticks of a slower rigid controller, which moves the weight once for all that the
        // thread has given it, the tension swings about half of the weight.
        let swing = if every[1] > every[0] { 0.2 } else { 0.04 };
        assert!((tension / (0.5 * 0.02 * 9.81) - 1.0).abs() < swing, "ticks of {every:?} ms: {tension} N");
    }
}

#[test]
fn a_rope_that_is_joined_to_a_weight_holds_it() {
    let rope = r#"
[[entity]]
name = "rigid"
pose = { translation = [0.05, 0.0, 0.0] }
mesh = { shape = { sphere = { radius = 0.005 } }, segments = 16 }
rigid_body = { motion = "dynamic", mass = 0.02 }
[[entity]]
name = "rope"
mesh = { line = { length = 0.10, segments = 40, radius = 0.0005 } }
mass_spring = { method = "implicit", springs = { line = { axial_stiffness = 200.0, bending_stiffness = 1e-7, density = 0.001 } } }
anchors = { regions = [{ ball = { center = [-0.05, 0.0, 0.0], radius = 0.001 } }] }
[[entity.coupled.with]]
body = "rigid"
joined = { within = 0.006, stiffness = 500.0 }
"#;
    let stage = Stage::new(scene(rope), 1000.0, |_| Ok(Nobody));
    let soft = Other::new(&stage, SOFT, 2, |c| MassSpringController::new(GRAVITY, c));
    let rigid = Other::new(&stage, RIGID, 2, |context| {
        let settings =
            RigidSettings { gravity_in_world: GRAVITY, floor_height: None, ..RigidSettings::default() };
        RigidBodiesController::<ImpulseWorld>::new(context, settings)
            .map_err(|error| ControllerError::Scene(error.to_string()))
    });
    let mut scene = Scene { stage, soft, rigid };
    let mut longest = 0.0_f64;
    let mut lowest = 0.0_f64;
    for _ in 0..20 {
        scene.run(0.05);
        let at = scene.stage.get::<Pose>("rigid").isometry().translation.vector;
        longest = longest.max((at - Vector3::new(-0.05, 0.0, 0.0)).norm());
        lowest = lowest.min(at.z);
    }
    // It swings as a pendulum of the rope's length; it loses little.
    assert!(longest < 0.106, "{longest} m from the anchor");
    assert!(lowest < -0.09, "it swings down to {lowest} m");
}

/// A rod of 0.1 g, of which the last 7.5 mm are joined to a weight or hang on it.
#[test]
fn a_position_based_rod_is_stretched_by_a_weight_as_its_stiffness_says() {
    for ratio in [1.0, 10.0, 100.0, 1000.0] {
        let mass = 1e-4 * ratio;
        let axial_stiffness = 100.0 * mass * 9.81;
        let rope = format!(
            r#"
[[entity]]
name = "rigid"
pose = {{ translation = [0.0, 0.0, -0.05] }}
mesh = {{ shape = {{ sphere = {{ radius = 0.005 }} }}, segments = 16 }}
rigid_body = {{ motion = "dynamic", mass = {mass} }}
[[entity]]
name = "rope"
pose = {{ rotation = [0.0, 0.7071067811865476, 0.0, 0.7071067811865476] }}
mesh = {{ line = {{ length = 0.10, segments = 40, radius = 0.0005 }} }}
xpbd = {{ matter = {{ rod = {{ axial_stiffness = {axial_stiffness}, bending_stiffness = 1e-8, density = 0.001 }} }}, damping = 5.0 }}
anchors = {{ regions = [{{ ball = {{ center = [-0.05, 0.0, 0.0], radius = 0.001 }} }}] }}
[[entity.coupled.with]]
body = "rigid"
joined = {{ within = 0.003, stiffness = 500.0 }}
"#
        );
        let stage = Stage::new(scene(&rope), 1000.0, |_| Ok(Nobody));
        let soft = Other::new(&stage, SOFT, 2, |c| XpbdController::new(GRAVITY, c));
        let rigid = Other::new(&stage, RIGID, 1, |context| {
            let settings =
                RigidSettings { gravity_in_world: GRAVITY, floor_height: None, ..RigidSettings::default() };
            RigidBodiesController::<ImpulseWorld>::new(context, settings)
                .map_err(|error| ControllerError::Scene(error.to_string()))
        });
        let mut scene = Scene { stage, soft, rigid };
        scene.run(2.0);
        assert!(!scene.stage.has::<Frozen>("rope"));
        let (free, joined) = (0.0925, 0.0075);
        let wanted = (mass * free + 1e-3 * free * (0.5 * free + joined)) * 9.81 / axial_stiffness;
        let mut found = 0.0;
        for _ in 0..500 {
            scene.run(0.002);
            let positions = scene.stage.get::<VertexPositions>("rope").positions;
            found += (positions[37].x - positions[0].x - free) / 500.0;
        }
        assert!((found / wanted - 1.0).abs() < 0.02, "{ratio}: stretched by {found} of {wanted} m");
    }
}
