//! Jaws hold soft bodies by friction, whichever method moves them: up to 2 μ times their force, and no more.

use std::cell::Cell;

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_dynamics::soft_body::grasp::Grips;
use trocar_scene::{
    BuildContext, CollisionList, Controller, ControllerError, Frozen, JawState, Pose, VertexPositions,
};
use trocar_simulator::controller::{
    DynamicFemController, LinearFemController, MassSpringController, XpbdController,
};

const ZERO: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);
/// Along the jaws, out of their tip.
const GRAVITY: Vector3<f64> = Vector3::new(0.0, 9.81, 0.0);
const HZ: f64 = 1000.0;
const FRICTION: f64 = 0.6;

fn springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(ZERO, context)
}
fn falling_springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(GRAVITY, context)
}
fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(ZERO, context)
}
fn falling_xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(GRAVITY, context)
}
fn fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(ZERO, context)
}
fn falling_fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(GRAVITY, context)
}
fn linear(context: &BuildContext<'_>) -> Result<LinearFemController, ControllerError> {
    LinearFemController::new(ZERO, None, context)
}

/// Along y, one jaw above the body and one below.
fn pose(tip: Vector3<f64>) -> Isometry3<f64> {
    let level = UnitQuaternion::from_basis_unchecked(&[Vector3::z(), Vector3::x(), Vector3::y()]);
    Isometry3::from_parts(tip.into(), level)
}

/// A body whose rim is between jaws of this force.
struct Bench<C> {
    stage: Stage<C>,
    last: Cell<f64>,
    /// Times at which it was told that something slips \[s\].
    told: Vec<f64>,
}

impl<C: Controller> Bench<C> {
    fn new(body: &str, force: f64, build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError>) -> Self {
        let text = format!(
            "[[entity]]\nname = \"tool\"\npose = {{ translation = [0.3, 0.0, 0.0] }}\n\
             instrument = {{ kind = \"grasper\", shaft_length = 0.1, shaft_radius = 0.0025, jaw_length = 0.012, \
             jaws = 2, jaw_thickness = 0.002, jaw_force_max = {force}, jaw_friction = {FRICTION} }}\n\
             [[entity]]\nname = \"body\"\n{body}\n"
        );
        Self { stage: Stage::new(scene(&text), HZ, build), last: Cell::new(0.6), told: Vec::new() }
    }

    fn act(&mut self, tip: Vector3<f64>, angle: f64) {
        self.stage.put("tool", Pose::from(pose(tip)));
        let rate = (angle - self.last.replace(angle)) * HZ;
        self.stage.put("tool", JawState { angle, rate, pad_force: [0.0; 2] });
        self.stage.tick();
        assert!(!self.stage.has::<Frozen>("body"), "{}", self.stage.get::<Frozen>("body").reason);
        let told = self.stage.store.view().events().since(0);
        let told = told.filter(|(_, event)| event.name == "tissue_slips");
        self.told = told.map(|(_, event)| event.at.as_secs_f64()).collect();
    }

    /// Closes the jaws over the rim.
    fn close(&mut self, tip: Vector3<f64>) {
        for tick in 0..=30 {
            self.act(tip, 0.6 - 0.55 * f64::from(tick) / 30.0);
        }
        assert!(self.held() > 0, "the jaws hold nothing");
    }

    fn held(&self) -> usize {
        let grips = self.stage.get::<Grips>("body");
        grips.picks.picks.iter().map(|pick| pick.vertices.len()).sum()
    }

    /// Force of the jaws on the body, as everyone is told of it \[N\].
    fn force(&self) -> Vector3<f64> {
        let tool = self.stage.entity("tool");
        let lists = self.stage.store.view().iter::<CollisionList>();
        let rows = lists.flat_map(|(_, list)| list.collisions.clone()).filter(|row| row.a == tool);
        rows.map(|row| row.force_in_world).sum()
    }

    fn slip(&self) -> f64 {
        let me = trocar_scene::Entity::of_writer(0, 7);
        let all = self.stage.store.view().get::<trocar_scene::Measured>(me).expect("it measures");
        all.values.get("body.jaw_slip_m").copied().unwrap_or(0.0)
    }

    fn centre(&self) -> Vector3<f64> {
        let all = self.stage.get::<VertexPositions>("body").positions;
        all.iter().map(|point| point.coords).sum::<Vector3<f64>>() / all.len() as f64
    }
}

/// A slab, a cloth and a line, held at the far end and pulled at the near one: below their friction the jaws hold for
/// seconds, beyond it they slip and feel 2 μ N.
fn slips_beyond_the_cone<C: Controller>(
    body: &str,
    tip: [f64; 3],
    (force, way): (f64, f64),
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let (tip, limit) = (Vector3::from(tip), 2.0 * FRICTION * force);
    let mut bench = Bench::new(body, force, build);
    bench.close(tip);
    // As far as it takes for four fifths of what they hold.
    let mut at = tip;
    let mut strained = 0.0;
    while strained < 0.8 * limit {
        at -= Vector3::y() * (0.02 / HZ);
        bench.act(at, 0.05);
        strained = bench.force().norm();
        assert!((tip - at).norm() < way, "{body}: {strained} N after {} m", (tip - at).norm());
    }
    let held = bench.held();
    (0..2000).for_each(|_| bench.act(at, 0.05));
    assert!(bench.slip() < 2e-4, "{body}: below the cone it creeps by {} m in 2 s", bench.slip());
    assert_eq!(bench.held(), held, "{body}");
    // Three millimetres beyond.
    while strained < 0.99 * limit {
        at -= Vector3::y() * (0.02 / HZ);
        bench.act(at, 0.05);
        strained = bench.force().norm();
        assert!((tip - at).norm() < 2.0 * way, "{body}: {strained} N after {} m", (tip - at).norm());
    }
    let before = bench.slip();
    let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
    for tick in 0..150 {
        at -= Vector3::y() * (0.02 / HZ);
        bench.act(at, 0.05);
        if tick >= 30 {
            (least, most) = (least.min(bench.force().norm()), most.max(bench.force().norm()));
        }
    }
    let slip = bench.slip() - before;
    println!("{body}: {least} to {most} N of {limit} N, slipped by {slip} m; {:?}", bench.told);
    assert!(least > 0.9 * limit && most < 1.1 * limit, "{body}: {least} to {most} N of {limit} N");
    assert!(slip > 0.002, "{body}: it slipped by {slip} m");
    assert!((1..4).contains(&bench.told.len()), "{body}: told at {:?}", bench.told);
    // Strong jaws hold it on the same way, and feel more.
    let mut strong = Bench::new(body, 50.0, build);
    strong.close(tip);
    let ticks = ((tip - at).norm() / (0.02 / HZ)).round() as usize;
    (1..=ticks).for_each(|tick| strong.act(tip.lerp(&at, tick as f64 / ticks as f64), 0.05));
    assert_eq!((strong.slip(), strong.told.len()), (0.0, 0), "{body}");
    assert!(strong.force().norm() > 1.05 * limit, "{body}: {} N of {limit} N", strong.force().norm());
}

const SLAB: &str = "mesh = { block = { size = [0.04, 0.04, 0.002], cells = [16, 16, 1] } }\n\
    anchors = { regions = [{ box = { min = [-1.0, 0.0199, -1.0], max = [1.0, 1.0, 1.0] } }] }\n";
const SHEET: &str = "mesh = { sheet = { size = [0.04, 0.04], cells = [16, 16] } }\n\
    anchors = { regions = [{ box = { min = [-1.0, 0.0199, -1.0], max = [1.0, 1.0, 1.0] } }] }\n";
const LINE: &str = "mesh = { line = { length = 0.06, segments = 24, radius = 0.0005 } }\n\
    anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [-0.0299, 1.0, 1.0] } }, \
    { box = { min = [0.0299, -1.0, -1.0], max = [1.0, 1.0, 1.0] } }] }\n";
const ROD: &str = "axial_stiffness = 5.0, bending_stiffness = 1e-9, density = 2e-3";
const CLOTH: &str = "membrane_stiffness = 150.0, bending_stiffness = 2e-6, density = 0.05";
const RIM: [f64; 3] = [0.0, -0.013, 0.0];
const ACROSS: [f64; 3] = [0.0, 0.005, 0.0];
const VOLUME: &str = "young_modulus = 3e4, poisson_ratio = 0.3, density = 1000.0";

#[test]
fn explicit_springs_slip_in_jaws_beyond_their_friction() {
    let volume = format!(
        "{SLAB}mass_spring = {{ springs = {{ volume = {{ young_modulus = 3e4, density = 1000.0 }} }}, damping = 20.0 }}"
    );
    slips_beyond_the_cone(&volume, RIM, (0.1, 0.01), springs);
    let cloth = format!(
        "{SHEET}mass_spring = {{ springs = {{ surface = {{ {CLOTH} }} }}, lag = 1e-5, damping = 20.0 }}"
    );
    slips_beyond_the_cone(&cloth, RIM, (0.1, 0.01), springs);
    let line =
        format!("{LINE}mass_spring = {{ springs = {{ line = {{ {ROD} }} }}, lag = 1e-5, damping = 20.0 }}");
    slips_beyond_the_cone(&line, ACROSS, (0.1, 0.02), springs);
}

#[test]
fn implicit_springs_slip_in_jaws_beyond_their_friction() {
    let implicit = "method = \"implicit\", damping = 20.0";
    let volume = format!(
        "{SLAB}mass_spring = {{ springs = {{ volume = {{ young_modulus = 3e4, density = 1000.0 }} }}, {implicit} }}"
    );
    slips_beyond_the_cone(&volume, RIM, (0.1, 0.01), springs);
    let cloth = format!("{SHEET}mass_spring = {{ springs = {{ surface = {{ {CLOTH} }} }}, {implicit} }}");
    slips_beyond_the_cone(&cloth, RIM, (0.1, 0.01), springs);
    let line =
        format!("{LINE}mass_spring = {{ springs = {{ line = {{ {ROD} }} }}, lag = 1e-5, {implicit} }}");
    slips_beyond_the_cone(&line, ACROSS, (0.1, 0.02), springs);
}

#[test]
fn position_based_bodies_slip_in_jaws_beyond_their_friction() {
    let volume =
        format!("{SLAB}xpbd = {{ matter = {{ volume = {{ {VOLUME} }} }}, parts = 10, damping = 20.0 }}");
    slips_beyond_the_cone(&volume, RIM, (0.1, 0.01), xpbd);
    let cloth =
        format!("{SHEET}xpbd = {{ matter = {{ cloth = {{ {CLOTH} }} }}, parts = 30, damping = 20.0 }}");
    slips_beyond_the_cone(&cloth, RIM, (0.1, 0.01), xpbd);
    let line = format!("{LINE}xpbd = {{ matter = {{ rod = {{ {ROD} }} }}, parts = 30, damping = 20.0 }}");
    slips_beyond_the_cone(&line, ACROSS, (0.1, 0.02), xpbd);
}

#[test]
fn finite_elements_slip_in_jaws_beyond_their_friction() {
    slips_beyond_the_cone(
        &format!("{SLAB}dynamic_fem = {{ {VOLUME}, mass_damping = 20.0 }}"),
        RIM,
        (0.1, 0.01),
        fem,
    );
}

#[test]
fn a_linear_organ_slips_in_jaws_beyond_their_friction() {
    let organ = "linear_fem = { young_modulus = 3e4, poisson_ratio = 0.3, contact_radius = 0.0 }";
    slips_beyond_the_cone(&format!("{SLAB}{organ}"), RIM, (0.1, 0.01), linear);
}

/// A free body in closed jaws, in the field of its weight: held by half as much again as its weight takes, it stays;
/// by half of that it slips out at g/2.
fn lifts_or_falls<C: Controller>(
    body: &str,
    mass: f64,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let (tip, weight) = (Vector3::from(RIM), mass * 9.81);
    let needed = weight / (2.0 * FRICTION);
    // Suddenly loaded, it would swing, and pull twice as hard.
    let calm = body.replace("damping = 0.0", "damping = 400.0").replace("3e5", "3e4");
    let mut lifted = Bench::new(&calm, 1.5 * needed, build);
    lifted.last.set(0.051);
    lifted.act(tip, 0.05);
    let held = lifted.held();
    assert!(held > 0, "{body}: nothing is held");
    (0..500).for_each(|_| lifted.act(tip, 0.05));
    let settled = lifted.slip();
    let mut force = Vector3::zeros();
    for _ in 0..1500 {
        lifted.act(tip, 0.05);
        force += lifted.force() / 1500.0;
    }
    let slip = lifted.slip();
    println!("{body}: held with {force:?} of {weight} N, slipped by {slip} m");
    assert_eq!(lifted.held(), held, "{body}");
    assert!(settled < 2e-4 && slip - settled < 1e-7, "{body}: it slipped by {settled} m, then by {slip} m");
    assert!((force.norm() / weight - 1.0).abs() < 0.05, "{body}: {force:?} of {weight} N");
    let mut dropped = Bench::new(body, 0.5 * needed, build);
    dropped.last.set(0.051);
    dropped.act(tip, 0.05);
    let start = dropped.centre().y;
    // While it slides, 2 μ N is half of its weight. In the first milliseconds it is still being drawn.
    let mut ways = [0.0; 36];
    for way in &mut ways[1..] {
        dropped.act(tip, 0.05);
        *way = dropped.centre().y - start;
    }
    let felt = dropped.force().norm();
    let faster = ((ways[35] - ways[30]) - (ways[20] - ways[15])) * HZ / 5.0 / 0.015;
    println!("{body}: falls by {faster} m/s², and is felt with {felt} N of {weight} N");
    assert!((felt / (0.5 * weight) - 1.0).abs() < 0.01, "{body}: {felt} N of {weight} N");
    assert!((faster / (0.5 * 9.81) - 1.0).abs() < 0.01, "{body}: it falls by {faster} m/s²");
    (0..165).for_each(|_| dropped.act(tip, 0.05));
    assert_eq!(dropped.held(), 0, "{body}: it has left the jaws");
    assert!(dropped.centre().y - start > 0.1, "{body}");
}

#[test]
fn jaws_lift_a_free_body_by_friction_or_lose_it() {
    const SLAB: &str = "mesh = { block = { size = [0.04, 0.04, 0.002], cells = [16, 16, 1] } }\n";
    // Stiff, so that it falls as one from the beginning.
    const VOLUME: &str = "young_modulus = 3e5, poisson_ratio = 0.3, density = 1000.0";
    const SHEET: &str = "mesh = { sheet = { size = [0.04, 0.04], cells = [16, 16] } }\n";
    let (of_cloth, of_slab) = (0.05 * 0.04 * 0.04, 1000.0 * 0.04 * 0.04 * 0.002);
    for method in ["explicit", "implicit"] {
        let cloth = format!(
            "{SHEET}mass_spring = {{ springs = {{ surface = {{ {CLOTH} }} }}, method = \"{method}\", lag = 1e-5, damping = 0.0 }}"
        );
        lifts_or_falls(&cloth, of_cloth, falling_springs);
    }
    let cloth =
        format!("{SHEET}xpbd = {{ matter = {{ cloth = {{ {CLOTH} }} }}, parts = 30, damping = 0.0 }}");
    lifts_or_falls(&cloth, of_cloth, falling_xpbd);
    lifts_or_falls(&format!("{SLAB}dynamic_fem = {{ {VOLUME}, mass_damping = 0.0 }}"), of_slab, falling_fem);
}

/// 0.5 N on a pad of 12 by 3 mm is 13.9 kPa; a line of 1 mm between pads of that length is pressed harder.
#[test]
fn jaws_tell_of_tissue_that_they_crush() {
    let cloth = format!(
        "{SHEET}mass_spring = {{ springs = {{ surface = {{ {CLOTH} }} }}, method = \"implicit\", damping = 20.0 }}\n"
    );
    let line =
        format!("{LINE}mass_spring = {{ springs = {{ line = {{ {ROD} }} }}, method = \"implicit\" }}\n");
    let told = |body: &str, tip: [f64; 3], force: f64| {
        let mut bench = Bench::new(body, force, springs);
        bench.close(Vector3::from(tip));
        (0..50).for_each(|_| bench.act(Vector3::from(tip), 0.05));
        let events = bench.stage.store.view().events().since(0).map(|(_, event)| event.clone());
        events.filter(|event| event.name == "tissue_crushed").collect::<Vec<_>>()
    };
    let pressure = 0.5 / (0.012 * 0.003);
    let weak = format!("{cloth}crushable = {{ pressure = {} }}\n", 0.99 * pressure);
    let crushed = told(&weak, RIM, 0.5);
    assert_eq!(crushed.len(), 1, "once a grasp: {crushed:?}");
    assert!((crushed[0].value / pressure - 1.0).abs() < 1e-9, "{crushed:?}, by hand {pressure} Pa");
    assert!(crushed[0].object.is_some(), "by which instrument");
    let strong = format!("{cloth}crushable = {{ pressure = {} }}\n", 1.01 * pressure);
    assert_eq!(told(&strong, RIM, 0.5).len(), 0, "it bears that");
    assert_eq!(told(&cloth, RIM, 50.0).len(), 0, "without a limit nothing is crushed");
    let thin = format!("{line}crushable = {{ pressure = {} }}\n", 1.5 * pressure);
    assert_eq!(told(&thin, ACROSS, 0.5).len(), 1, "what is held is smaller than the pad");
}

/// Restarted in the middle of a slip, from the scene alone.
fn goes_on_slipping<C: Controller>(
    body: &str,
    tip: [f64; 3],
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let tip = Vector3::from(tip);
    let run = |restarts: bool| {
        let mut bench = Bench::new(body, 0.02, build);
        bench.close(tip);
        let mut slips = 0.0;
        for tick in 0..400 {
            if restarts && tick % 97 == 50 {
                bench.stage.rebuild(build);
            }
            bench.act(tip - Vector3::y() * (0.02 / HZ * f64::from(tick)), 0.05);
            slips = bench.slip();
        }
        assert!(slips > 1e-3, "{body}: it slips by {slips} m only");
        bench.stage.get::<VertexPositions>("body").positions
    };
    assert_eq!(run(false), run(true), "{body}");
}

#[test]
fn another_life_goes_on_slipping_to_the_bit() {
    let springs_of = |method: &str| {
        format!(
            "{SHEET}mass_spring = {{ springs = {{ surface = {{ {CLOTH} }} }}, {method}, damping = 20.0 }}"
        )
    };
    goes_on_slipping(&springs_of("lag = 1e-5"), RIM, springs);
    goes_on_slipping(&springs_of("method = \"implicit\", solver = \"node_blocks\""), RIM, springs);
    goes_on_slipping(
        &format!("{SHEET}xpbd = {{ matter = {{ cloth = {{ {CLOTH} }} }}, parts = 30 }}"),
        RIM,
        xpbd,
    );
    goes_on_slipping(&format!("{SLAB}dynamic_fem = {{ {VOLUME}, mass_damping = 20.0 }}"), RIM, fem);
}
