//! Vertices grasped by jaws follow them, for every method: from the beginning of each frame, with their neighbourhood
//! drawn along smoothly, until the jaws open.

use std::cell::Cell;

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_dynamics::soft_body::grasp::Grips;
use trocar_scene::{
    BuildContext, CollisionList, Controller, ControllerError, Frozen, JawState, Pose, Primitive,
    VertexPositions,
};
use trocar_simulator::controller::{DynamicFemController, MassSpringController, XpbdController};

const ZERO: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);
const HZ: f64 = 500.0;
const OPEN: f64 = 0.6;
const CLOSED: f64 = 0.05;

fn springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(ZERO, context)
}

fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(ZERO, context)
}

fn fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(ZERO, context)
}

/// Along y, one jaw above the body and one below, turned about y by an angle.
fn pose(at: Vector3<f64>, turned: f64) -> Isometry3<f64> {
    let level = UnitQuaternion::from_basis_unchecked(&[Vector3::z(), Vector3::x(), Vector3::y()]);
    Isometry3::from_parts(at.into(), UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned) * level)
}

/// `tip` is where the jaws close.
fn holds<C: Controller>(
    body: &str,
    tip: [f64; 3],
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let text = format!(
        "[[entity]]\nname = \"tool\"\npose = {{ translation = [0.3, 0.0, 0.0] }}\n\
         instrument = {{ kind = \"grasper\", shaft_length = 0.1, shaft_radius = 0.0025, jaw_length = 0.012, \
         jaws = 2, jaw_thickness = 0.002 }}\n[[entity]]\nname = \"body\"\n{body}\n"
    );
    let mut stage = Stage::new(scene(&text), HZ, build);
    let tool = stage.entity("tool").to_bits();
    let last = Cell::new(OPEN);
    let act = |stage: &mut Stage<C>, pose: Isometry3<f64>, angle: f64| {
        stage.put("tool", Pose::from(pose));
        let rate = (angle - last.replace(angle)) * HZ;
        stage.put("tool", JawState { angle, rate, pad_force: [0.0; 2] });
        stage.tick();
        assert!(!stage.has::<Frozen>("body"), "{body}: {}", stage.get::<Frozen>("body").reason);
    };
    let tip = Vector3::from(tip);
    let held = |stage: &Stage<C>| stage.measured("body.held_vertices");
    for _ in 0..5 {
        act(&mut stage, pose(tip, 0.0), OPEN);
        assert_eq!(held(&stage), 0.0, "{body}: open jaws hold nothing");
    }
    for tick in 0..=30 {
        act(&mut stage, pose(tip, 0.0), OPEN + (CLOSED - OPEN) * f64::from(tick) / 30.0);
    }
    // Flagged with the instrument that holds them.
    let grips = stage.get::<Grips>("body");
    assert_eq!(grips.picks.picks.len(), 1, "{body}: one instrument holds");
    let pick = grips.picks.of(tool).expect("the one that there is").clone();
    assert!(!pick.triangles.is_empty() && !pick.vertices.is_empty(), "{body}");
    let start = stage.get::<VertexPositions>("body").positions;
    let (mut off, mut now): (f64, Isometry3<f64>) = (0.0, pose(tip, 0.0));
    for tick in 1..=100 {
        let share = f64::from(tick) / 100.0;
        now = pose(tip + Vector3::new(0.001, -0.0005, 0.004) * share, 0.1 * share);
        act(&mut stage, now, CLOSED);
        let places = stage.get::<VertexPositions>("body").positions;
        for held in &pick.vertices {
            off = off.max((now * held.in_instrument - places[held.vertex as usize]).norm());
        }
        assert_eq!(stage.get::<Grips>("body").picks.of(tool), Some(&pick), "{body}: it holds what it held");
    }
    assert!(off < 1e-4, "{body}: what is held is {off} m from where the jaws have it");
    // The neighbourhood is drawn along, less with distance; and the force is published.
    (0..200).for_each(|_| act(&mut stage, now, CLOSED));
    let places = stage.get::<VertexPositions>("body").positions;
    let moved = |node: usize| (places[node] - start[node]).norm();
    let of: Vec<usize> = pick.vertices.iter().map(|held| held.vertex as usize).collect();
    let middle = of.iter().map(|&node| start[node].coords).sum::<Vector3<f64>>() / of.len() as f64;
    let away = |node: usize| (start[node].coords - middle).norm();
    let mean = |low: f64, high: f64| {
        let nodes = (0..start.len()).filter(|node| !of.contains(node) && (low..high).contains(&away(*node)));
        let moved: Vec<f64> = nodes.map(moved).collect();
        moved.iter().sum::<f64>() / moved.len().max(1) as f64
    };
    let (near, far) = (mean(0.0, 0.008), mean(0.016, 1.0));
    let drawn = of.iter().map(|&node| moved(node)).sum::<f64>() / of.len() as f64;
    assert!(near > 0.3 * drawn && near < 1.2 * drawn, "{body}: beside it {near} m of {drawn} m");
    assert!(far < 0.8 * near, "{body}: far away {far} m, near {near} m");
    assert!(stage.measured("body.held_force_n") > 0.0, "{body}");
    let all = stage.store.snapshot();
    let lists: Vec<CollisionList> = all.iter::<CollisionList>().map(|(_, list)| list.clone()).collect();
    let told = lists.iter().flat_map(|list| &list.collisions).find(|row| row.a.to_bits() == tool);
    let told = told.unwrap_or_else(|| panic!("{body}: nobody is told of the grip"));
    let is_line = body.contains("line = {");
    assert_eq!(matches!(told.primitive_b, Primitive::Segment(_)), is_line, "{body}: {:?}", told.primitive_b);
    // A restart holds it too, and opening releases it; jaws closed beside it and moved over it grasp nothing.
    stage.rebuild(build);
    act(&mut stage, now, CLOSED);
    assert_eq!(stage.get::<Grips>("body").picks.of(tool), Some(&pick), "{body}: another life holds it");
    act(&mut stage, now, OPEN);
    assert_eq!(stage.get::<Grips>("body").picks.picks, [], "{body}: the flags are reset");
    assert_eq!(held(&stage), 0.0);
    (0..100).for_each(|_| act(&mut stage, Isometry3::translation(0.3, 0.0, 0.0), OPEN));
    let places = stage.get::<VertexPositions>("body").positions;
    let away = of.iter().map(|&node| (places[node] - start[node]).norm()).fold(0.0, f64::max);
    assert!(away < 2.0 * drawn, "{body}: let go of, it stays behind: {away} m, {drawn} m before");
    act(&mut stage, Isometry3::translation(0.3, 0.0, 0.0), CLOSED);
    for share in (0..=20).map(|tick| f64::from(tick) / 20.0) {
        act(&mut stage, pose(tip - Vector3::y() * (0.01 * (1.0 - share)), 0.0), CLOSED);
        assert_eq!(held(&stage), 0.0, "{body}: jaws that closed on nothing took something");
    }
}

const SLAB: &str = "mesh = { block = { size = [0.04, 0.04, 0.002], cells = [16, 16, 1] } }\n\
    anchors = { regions = [{ box = { min = [-1.0, 0.0199, -1.0], max = [1.0, 1.0, 1.0] } }] }\n";
const LINE: &str = "mesh = { line = { length = 0.06, segments = 24, radius = 0.0005 } }\n\
    anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [-0.0299, 1.0, 1.0] } }, \
    { box = { min = [0.0299, -1.0, -1.0], max = [1.0, 1.0, 1.0] } }] }\n";
const ROD: &str = "axial_stiffness = 5.0, bending_stiffness = 1e-9, density = 2e-3";
/// Over the rim of what is flat, and across a line.
const RIM: [f64; 3] = [0.0, -0.013, 0.0];
const ACROSS: [f64; 3] = [0.0, 0.005, 0.0];

#[test]
fn a_volume_is_held_by_every_method() {
    let of = |kind: &str| format!("{SLAB}{kind}");
    let matter = "young_modulus = 3e4, poisson_ratio = 0.3, density = 1000.0";
    let by_springs = "mass_spring = { springs = { volume = { young_modulus = 3e4, density = 1000.0 } }, \
                      damping = 20.0 }";
    holds(&of(by_springs), RIM, springs);
    holds(&of(&by_springs.replace("damping", "method = \"implicit\", damping")), RIM, springs);
    let by_positions =
        format!("xpbd = {{ matter = {{ volume = {{ {matter} }} }}, parts = 10, damping = 20.0 }}");
    holds(&of(&by_positions), RIM, xpbd);
    holds(&of(&format!("dynamic_fem = {{ {matter}, mass_damping = 20.0 }}")), RIM, fem);
}

#[test]
fn a_line_is_held_by_every_method() {
    let by_springs =
        format!("{LINE}mass_spring = {{ springs = {{ line = {{ {ROD} }} }}, lag = 1e-5, damping = 20.0 }}");
    holds(&by_springs, ACROSS, springs);
    holds(&by_springs.replace("damping", "method = \"implicit\", damping"), ACROSS, springs);
    holds(&format!("{LINE}xpbd = {{ matter = {{ rod = {{ {ROD} }} }}, damping = 20.0 }}"), ACROSS, xpbd);
}

/// A thread that hangs from both its ends: by its weight, and by its axial stiffness.
#[test]
fn a_line_of_springs_hangs_as_a_string_does_and_tells_the_largest_safe_step() {
    let text = format!(
        "[[entity]]\nname = \"body\"\n{LINE}mass_spring = {{ springs = {{ line = {{ axial_stiffness = 5.0, \
         bending_stiffness = 1e-9, density = 2e-3 }} }}, lag = 1e-5, damping = 20.0 }}\n"
    );
    let build =
        |context: &BuildContext<'_>| MassSpringController::new(Vector3::new(0.0, 0.0, -9.81), context);
    let mut stage = Stage::new(scene(&text), HZ, build);
    (0..700).for_each(|_| stage.tick());
    stage.rebuild(build);
    (0..700).for_each(|_| stage.tick());
    // A shallow parabola: w L²/8 = T f, and T = EA 8 f²/(3 L²).
    let (weight, length, axial) = (2e-3 * 9.81, 0.06, 5.0);
    let sag: f64 = (3.0 * weight * f64::powi(length, 4) / (64.0 * axial)).cbrt();
    let lowest = -stage.measured("body.lowest_m");
    assert!((lowest / sag - 1.0).abs() < 0.03, "{lowest} m, by hand {sag} m");
    let safe = stage.measured("body.safe_step_s");
    // From the stiffest wave on a chain: h √(ρ/EA), with ρ and EA per length, reduced by damping.
    let wave = (length / 24.0) * f64::sqrt(2e-3 / axial);
    assert!(safe > 0.3 * wave && safe <= wave, "{safe} s against {wave} s");
    let implicit = text.replace("damping", "method = \"implicit\", damping");
    let mut stage = Stage::new(scene(&implicit), 500.0, build);
    stage.tick();
    let me = trocar_scene::Entity::of_writer(0, 7);
    let all = stage.store.view().get::<trocar_scene::Measured>(me).expect("it measures");
    assert!(!all.values.contains_key("body.safe_step_s"), "any step is safe");
}
