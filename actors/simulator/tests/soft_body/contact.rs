//! Soft-body contact from the collision list: contacts detected with a table, between two bodies and within one body
//! keep them apart, for every method, and with a detector slower than the solver. Action and reaction are equal.

use std::sync::Arc;

use crate::support::stage::other::Other;
use crate::support::stage::{Stage, scene_with};
use nalgebra::{Point3, Vector3};
use trocar_collision::controller::{
    ContinuousConfig, ContinuousController, ObbTreeConfig, ObbTreeController,
};
use trocar_dynamics::soft_body::contact::{ContactSums, SoftContacts};
use trocar_scene::{
    BuildContext, Collision, CollisionList, Commands, Controller, ControllerError, Detection, Entity,
    EntityAllocator, Frozen, Primitive, RestPositions, SimTime, Store, VertexPositions, VertexVelocities,
};
use trocar_simulator::controller::{DynamicFemController, MassSpringController, XpbdController};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
const DETECTOR: u16 = 9;
const SWEEPER: u16 = 10;
const SECOND: u16 = 11;

type Build<C> = fn(&BuildContext<'_>) -> Result<C, ControllerError>;

fn springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(GRAVITY, context)
}

fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(GRAVITY, context)
}

fn elements(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(GRAVITY, context)
}

fn scene(text: &str) -> Store {
    scene_with(text, |builder| trocar_collision::controller::register(builder).expect("names are free"))
}

fn detector<C: Controller>(stage: &Stage<C>, every: u32, pairs: &[[&str; 2]]) -> Other {
    let pairs = pairs.iter().map(|pair| pair.map(str::to_owned)).collect();
    let config = ObbTreeConfig { pairs, stiffness: 500.0 };
    Other::new(stage, DETECTOR, every, |context| ObbTreeController::new(&config, context))
}

fn sweeper<C: Controller>(stage: &Stage<C>, every: u32, pair: [&str; 2]) -> Other {
    let config = ContinuousConfig { pairs: vec![pair.map(str::to_owned)], stiffness: 500.0 };
    Other::new(stage, SWEEPER, every, |context| ContinuousController::new(&config, context))
}

/// Runs for this many milliseconds.
fn run<C: Controller>(stage: &mut Stage<C>, others: &mut [Other], ticks: u32) {
    for _ in 0..ticks {
        for other in others.iter_mut() {
            if stage.ticks.is_multiple_of(u64::from(other.every)) {
                other.tick(stage);
            }
        }
        stage.tick();
    }
    assert!(!stage.has::<Frozen>("body"), "{}", stage.get::<Frozen>("body").reason);
}

fn span<C: Controller>(stage: &Stage<C>, name: &str) -> [f64; 2] {
    let pose = stage.store.view().world_pose(stage.entity(name));
    let heights = stage.get::<VertexPositions>(name).positions;
    let heights = heights.iter().map(|p| (pose * p).z);
    heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], z| [low.min(z), high.max(z)])
}

/// Penetration of the vertices over the interior of the table.
fn deepest<C: Controller>(stage: &Stage<C>, name: &str) -> f64 {
    let pose = stage.store.view().world_pose(stage.entity(name));
    let rest = stage.get::<RestPositions>(name).positions;
    let places = stage.get::<VertexPositions>(name).positions;
    let over = places.iter().zip(rest.iter()).filter(|(_, rest)| rest.x.abs().max(rest.y.abs()) < 0.012);
    over.map(|(place, _)| -(pose * place).z).fold(f64::NEG_INFINITY, f64::max)
}

fn fastest<C: Controller>(stage: &Stage<C>, name: &str) -> f64 {
    stage.get::<VertexVelocities>(name).velocities.iter().map(Vector3::norm).fold(0.0, f64::max)
}

/// A table, whose top is at z = 0.
const TABLE: &str = "[[entity]]\nname = \"table\"\npose = { translation = [0.0, 0.0, -0.02] }\n\
    mesh = { shape = { box = { half_extents = [0.0151, 0.0147, 0.02] } } }\n";
const CLOTH: &str = "membrane_stiffness = 60.0, bending_stiffness = 1e-6, density = 0.5";

/// A cloth of 4 cm by 4 cm at a height, moved by a method.
fn sheet(name: &str, z: f64, method: &str) -> String {
    format!(
        "[[entity]]\nname = \"{name}\"\npose = {{ translation = [0.0, 0.0, {z}] }}\n\
         mesh = {{ sheet = {{ size = [0.04, 0.04], cells = [8, 8] }} }}\n{method}\n"
    )
}

fn of_springs(more: &str) -> String {
    format!("mass_spring = {{ springs = {{ surface = {{ {CLOTH} }} }}, damping = 20.0{more} }}")
}

fn of_positions() -> String {
    format!("xpbd = {{ matter = {{ cloth = {{ {CLOTH} }} }}, damping = 20.0 }}")
}

/// A cloth of 2 cm by 2 cm with the same vertex spacing.
fn small(sheet: &str) -> String {
    sheet.replace("[0.04, 0.04], cells = [8, 8]", "[0.02, 0.02], cells = [4, 4]")
}

const WEIGHT: f64 = 0.04 * 0.04 * 0.5 * 9.81;

/// Its support force, averaged over some ticks: a cloth is never completely at rest.
fn borne<C: Controller>(stage: &mut Stage<C>, others: &mut [Other], name: &str) -> Vector3<f64> {
    let mut sum = Vector3::zeros();
    for _ in 0..200 {
        run(stage, others, 1);
        sum += stage.get::<SoftContacts>(name).force_in_world / 200.0;
    }
    sum
}

/// A body falling on a table comes to rest there; without a detector it falls through.
fn comes_to_rest<C: Controller>(
    what: &str,
    every: u32,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let fall = |detects: bool, kill: bool| {
        let text = format!("{TABLE}{}", sheet("body", 0.0005, what));
        let mut stage = Stage::new(scene(&text), 1000.0, build);
        let mut others = Vec::new();
        if detects {
            others.push(detector(&stage, every, &[["table", "body"]]));
        }
        run(&mut stage, &mut others, 253);
        if kill {
            stage.rebuild(build);
        }
        run(&mut stage, &mut others, 997);
        (stage, others)
    };
    let (mut stage, mut others) = fall(true, false);
    let end = |stage: &Stage<C>| stage.get::<VertexPositions>("body").positions;
    assert_eq!(end(&fall(true, true).0), end(&stage), "another life goes on to the bit");
    let (deep, [_, high], speed) = (deepest(&stage, "body"), span(&stage, "body"), fastest(&stage, "body"));
    let force = borne(&mut stage, &mut others, "body");
    assert!(deep < 2e-4, "{what}, {every}: {deep} m within the table");
    assert!((-0.001..0.002).contains(&high), "{what}: its highest place is at {high} m");
    assert!(speed < 0.05, "{what}: it still moves by {speed} m/s");
    assert!((force.z / WEIGHT - 1.0).abs() < 0.03, "{what}: {} N bear {WEIGHT} N", force.z);
    let [_, high] = span(&fall(false, false).0, "body");
    assert!(high < -0.1, "{what}: nobody tells of the table, so that it is at {high} m");
}

#[test]
fn a_cloth_of_springs_falls_on_a_table_and_lies_on_it() {
    comes_to_rest(&of_springs(""), 2, springs);
    comes_to_rest(&of_springs(""), 10, springs);
    comes_to_rest(&of_springs(", method = \"implicit\""), 10, springs);
}

#[test]
fn a_cloth_of_positions_falls_on_a_table_and_lies_on_it() {
    comes_to_rest(&of_positions(), 2, xpbd);
    comes_to_rest(&of_positions(), 10, xpbd);
}

/// A block of 2 cm of a soft volume, 0.3 mm above the table.
fn block(method: &str) -> String {
    format!(
        "[[entity]]\nname = \"body\"\npose = {{ translation = [0.0, 0.0, 0.0103] }}\n\
         mesh = {{ block = {{ size = [0.02, 0.02, 0.02], cells = [3, 3, 3] }} }}\n{method}\n"
    )
}

const SOFT: &str = "xpbd = { matter = { volume = { young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0 } }, \
                    parts = 10, damping = 20.0 }";

const FINITE: &str = "dynamic_fem = { young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0, mass_damping = 20.0, \
                      stiffness_damping = 0.002 }";

/// A block falling on a table comes to rest on it, and the table bears its weight.
fn block_rests<C: Controller>(
    method: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let fall = |detects: bool| {
        let mut stage = Stage::new(scene(&format!("{TABLE}{}", block(method))), 1000.0, build);
        let mut others = Vec::new();
        if detects {
            others.push(detector(&stage, 10, &[["table", "body"]]));
        }
        run(&mut stage, &mut others, 1500);
        (stage, others)
    };
    let (mut stage, mut others) = fall(true);
    let [low, high] = span(&stage, "body");
    assert!(low > -3e-4 && (0.018..0.0205).contains(&high), "{method}: from {low} to {high} m");
    let before = stage.get::<VertexPositions>("body").positions;
    let force = borne(&mut stage, &mut others, "body");
    let after = stage.get::<VertexPositions>("body").positions;
    // A light corner held by friction jitters by micrometres, as its elements oscillate within a step.
    let moved = before.iter().zip(after.iter()).map(|(one, two)| (one - two).norm()).fold(0.0, f64::max);
    assert!(moved < 1e-5, "{method}: it still moves, by {moved} m in 0.2 s");
    let weight = 8e-6 * 1000.0 * 9.81;
    assert!((force.z / weight - 1.0).abs() < 0.03, "{method}: {} N bear {weight} N", force.z);
    assert!(span(&fall(false).0, "body")[1] < -0.1, "{method}: nobody tells of the table");
}

#[test]
fn soft_blocks_fall_on_a_table_and_lie_on_it() {
    block_rests(SOFT, xpbd);
    let of_springs =
        "mass_spring = { springs = { volume = { young_modulus = 2e4, density = 1000.0 } }, damping = 20.0";
    block_rests(&format!("{of_springs} }}"), springs);
    block_rests(&format!("{of_springs}, method = \"implicit\" }}"), springs);
    block_rests(FINITE, elements);
}

/// Sliding distance of a block in 0.2 s down a slope of 17 degrees, whose tangent is 0.31, and its acceleration.
fn down_a_slope<C: Controller>(
    method: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError>,
    settles: u32,
) -> (f64, f64) {
    let table = TABLE.replace("0.0151, 0.0147", "0.2, 0.1");
    let mut stage = Stage::new(scene(&format!("{table}{}", block(method))), 1000.0, build);
    let mut others = vec![detector(&stage, 2, &[["table", "body"]])];
    let middle = |stage: &Stage<C>| {
        let places = stage.get::<VertexPositions>("body").positions;
        places.iter().map(|place| place.x).sum::<f64>() / places.len() as f64
    };
    run(&mut stage, &mut others, settles);
    let speed = |stage: &Stage<C>| {
        let speeds = stage.get::<VertexVelocities>("body").velocities;
        speeds.iter().map(|speed| speed.x).sum::<f64>() / speeds.len() as f64
    };
    let (start, begun) = (middle(&stage), speed(&stage));
    run(&mut stage, &mut others, 200);
    (middle(&stage) - start, (speed(&stage) - begun) / 0.2)
}

#[test]
fn on_a_slope_it_stays_or_slides_as_friction_says() {
    // The table is level, gravity is not.
    let tilted = Vector3::new(2.9, 0.0, -9.37);
    // It leans back once it rests.
    let settles = |damping: f64| if damping > 0.0 { 300 } else { 100 };
    let positions = |friction: f64, damping: f64| {
        let method = SOFT.replace("damping = 20.0", &format!("damping = {damping}, friction = {friction}"));
        down_a_slope(&method, |context| XpbdController::new(tilted, context), settles(damping))
    };
    let finite = |friction: f64, damping: f64| {
        let damped = format!("mass_damping = {damping}, friction = {friction}");
        let method = FINITE.replace("mass_damping = 20.0", &damped);
        down_a_slope(&method, |context| DynamicFemController::new(tilted, context), settles(damping))
    };
    for slides in [&positions as &dyn Fn(f64, f64) -> (f64, f64), &finite] {
        let (smooth, rubbed, rough) = (slides(0.0, 0.0), slides(0.15, 0.0), slides(0.6, 20.0));
        assert!((smooth.1 / 2.9 - 1.0).abs() < 0.02, "{} m/s²", smooth.1);
        let expected = 2.9 - 0.15 * 9.37;
        assert!((rubbed.1 / expected - 1.0).abs() < 0.1, "{} m/s², not {expected}", rubbed.1);
        assert!(rough.0.abs() < 2e-4, "{} m", rough.0);
    }
}

/// Two sheets on a table: the table bears both, for every method.
fn lie_on_each_other<C: Controller>(
    [below, above]: [&str; 2],
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
    second: Option<Build<XpbdController>>,
    is_small: bool,
) {
    let upper = sheet("upper", 0.0005, above);
    let (upper, weight) = if is_small { (small(&upper), 0.25 * WEIGHT) } else { (upper, WEIGHT) };
    let fall = |meet: bool| {
        let text = format!("{TABLE}{}{upper}", sheet("body", 0.0002, below));
        let mut stage = Stage::new(scene(&text), 1000.0, build);
        let mut others = vec![detector(&stage, 2, &[["table", "body"]])];
        others.extend(meet.then(|| sweeper(&stage, 2, ["body", "upper"])));
        others.extend(second.map(|second| Other::new(&stage, SECOND, 1, second)));
        run(&mut stage, &mut others, 1500);
        (stage, others)
    };
    let (mut stage, mut others) = fall(true);
    let (low, high) = (deepest(&stage, "body"), deepest(&stage, "upper"));
    let top = span(&stage, "upper")[1];
    let on_lower = borne(&mut stage, &mut others, "body");
    let on_upper = borne(&mut stage, &mut others, "upper");
    assert!(low < 4e-4 && high < 4e-4 && top < 0.003, "{low} m and {high} m within the table, up to {top} m");
    // Force from the table minus force passed on: its own weight.
    for (force, weight) in [(on_lower, WEIGHT), (on_upper, weight)] {
        assert!((force.z / weight - 1.0).abs() < 0.05, "{} N and {} N", on_lower.z, on_upper.z);
    }
    let places = stage.get::<VertexPositions>("upper").positions;
    let mean: Vector3<f64> = places.iter().map(|p| p.coords).sum::<Vector3<f64>>() / places.len() as f64;
    assert!(mean.x.hypot(mean.y) < 1e-3, "it has slid to {mean}");
    let (stage, _) = fall(false);
    assert!(span(&stage, "upper")[1] < -0.1, "nobody tells of the other");
}

#[test]
fn sheets_of_one_controller_lie_on_each_other() {
    for is_small in [false, true] {
        lie_on_each_other([&of_springs(""), &of_springs("")], springs, None, is_small);
        lie_on_each_other([&of_positions(), &of_positions()], xpbd, None, is_small);
    }
}

#[test]
fn sheets_of_two_controllers_lie_on_each_other() {
    lie_on_each_other([&of_springs(""), &of_positions()], springs, Some(xpbd), true);
}

/// A sheet with one half held and the other, folded over it, falling on the first: it comes to rest there. Without
/// self-collision detection it falls through and hangs.
fn lies_on_itself<C: Controller>(
    method: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let anchors =
        "anchors = { regions = [{ box = { min = [-1.0, -1.0, -1e-4], max = [0.001, 1.0, 1e-4] } }] }";
    let fall = |looks: bool| {
        let text = scene(&format!("{}{anchors}\n", sheet("body", 0.0, method)));
        let mut stage = Stage::new(text, 1000.0, build);
        let mut folded = stage.get::<VertexPositions>("body");
        for place in Arc::make_mut(&mut folded.positions).iter_mut().filter(|place| place.x > 0.001) {
            (place.x, place.z) = (-0.97 * place.x, 1e-3 + 0.02 * place.x);
        }
        stage.put("body", folded);
        stage.rebuild(build);
        let mut others = Vec::new();
        if looks {
            others.push(sweeper(&stage, 1, ["body", "body"]));
            others.push(detector(&stage, 2, &[["body", "body"]]));
        }
        run(&mut stage, &mut others, 1000);
        stage
    };
    let lies = fall(true);
    let [low, high] = span(&lies, "body");
    assert!(low > -1e-3 && high < 3e-3, "{method}: from {low} to {high} m");
    assert!(fastest(&lies, "body") < 0.02, "{method}: it comes to rest, at {} m/s", fastest(&lies, "body"));
    let [low, _] = span(&fall(false), "body");
    assert!(low < -0.01, "{method}: nobody tells it, and it hangs: {low} m");
}

#[test]
fn a_sheet_that_is_folded_lies_on_itself() {
    lies_on_itself(&of_springs(""), springs);
    lies_on_itself(&of_positions(), xpbd);
}

/// Linear momentum of a body \[kg·m/s\], and impulses not applied to it yet \[N·s\].
fn momentum<C: Controller>(stage: &Stage<C>, name: &str) -> Vector3<f64> {
    let masses = stage.get::<SoftContacts>(name).masses_inverse;
    let speeds = stage.get::<VertexVelocities>(name).velocities;
    masses.iter().zip(speeds.iter()).map(|(inverse, speed)| speed / *inverse).sum()
}

fn in_flight<C: Controller>(stage: &Stage<C>, from: &str, to: &str) -> Vector3<f64> {
    let sum = |all: &[ContactSums], of: &str| -> Vector3<f64> {
        let all = all.iter().filter(|sums| sums.body == Some(stage.entity(of)));
        all.flat_map(|sums| &sums.sums).sum()
    };
    sum(&stage.get::<SoftContacts>(from).given, to) - sum(&stage.get::<SoftContacts>(to).taken, from)
}

/// Two sheets that collide in free space, one of them at rest.
fn exchange<C: Controller>(
    [first, second]: [String; 2],
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
    other: Option<Build<XpbdController>>,
) {
    let text = format!("{}{}", sheet("body", 0.0, &first), sheet("upper", 0.001, &second));
    let mut stage = Stage::new(scene(&text), 1000.0, build);
    let down = |velocity: f64| VertexVelocities { velocities: Arc::new(vec![Vector3::z() * velocity; 81]) };
    stage.put("body", down(0.0));
    stage.put("upper", down(-0.1));
    stage.rebuild(build);
    let mut others = vec![sweeper(&stage, 1, ["body", "upper"])];
    others.extend(other.map(|other| Other::new(&stage, SECOND, 1, other)));
    let whole = 0.04 * 0.04 * 0.5 * 0.1;
    let mut exchanged: f64 = 0.0;
    for _ in 0..60 {
        run(&mut stage, &mut others, 1);
        let has_met = ["body", "upper"].iter().all(|name| stage.has::<SoftContacts>(name));
        if !has_met {
            continue;
        }
        let (one, two) = (momentum(&stage, "body"), momentum(&stage, "upper"));
        let [to, back] = [["body", "upper"], ["upper", "body"]].map(|[from, to]| in_flight(&stage, from, to));
        let off = (one + two + to + back + Vector3::z() * whole).norm();
        exchanged = exchanged.max(one.norm());
        assert!(off < 1e-9 * whole, "{off} of {whole} N·s are lost");
    }
    assert!(exchanged > 0.3 * whole, "{exchanged} of {whole} N·s");
    assert!(fastest(&stage, "upper") < 0.2 && fastest(&stage, "body") < 0.2, "nothing is made of nothing");
}

#[test]
fn what_one_gets_the_other_loses() {
    let free = |text: String| text.replace("damping = 20.0", "damping = 0.0");
    let (springs_of, positions_of) = (free(of_springs("")), free(of_positions()));
    let still = |context: &BuildContext<'_>| MassSpringController::new(Vector3::zeros(), context);
    fn still_xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
        XpbdController::new(Vector3::zeros(), context)
    }
    exchange([springs_of.clone(), springs_of.clone()], still, None);
    exchange([positions_of.clone(), positions_of.clone()], still_xpbd, None);
    exchange([springs_of.clone(), positions_of.clone()], still, Some(still_xpbd));
}

/// Adds one row to the collision list, as a detector would.
fn contribute<C: Controller>(stage: &mut Stage<C>, row: Collision) {
    let registry = stage.store.view().registry().clone();
    let mut commands = Commands::new(registry, EntityAllocator::new(0, DETECTOR));
    commands.contribute(CollisionList { collisions: vec![row], penetration_max: 0.0 });
    commands.seal();
    assert_eq!(commands.error(), None);
    let now = stage.now();
    stage.store.apply(&mut commands, now);
}

#[test]
fn what_is_old_or_not_there_or_told_by_a_solver_is_not_answered() {
    let build = |context: &BuildContext<'_>| XpbdController::new(Vector3::zeros(), context);
    let pressed = |change: &dyn Fn(Collision) -> Collision| {
        let mut stage = Stage::new(scene(&sheet("body", 0.2, &of_positions())), 1000.0, build);
        (0..400).for_each(|_| stage.tick());
        let row = Collision {
            a: Entity::new(0, 0, 9999),
            primitive_a: Primitive::Shape(0),
            b: stage.entity("body"),
            primitive_b: Primitive::Triangle(70),
            points_in_world: [Point3::new(0.0, 0.0, 0.202), Point3::new(0.0, 0.0, 0.2)],
            normal_in_world: Vector3::z(),
            depth: 0.002,
            force_in_world: Vector3::zeros(),
            velocity_constraint: 0.0,
            method: Detection::ObbTree,
            detected_at: stage.now(),
        };
        contribute(&mut stage, change(row));
        (0..20).for_each(|_| stage.tick());
        assert!(!stage.has::<Frozen>("body"));
        stage.measured("body.found_force_n")
    };
    assert!(pressed(&|row| row) > 0.0);
    assert!(pressed(&|row| Collision { primitive_b: Primitive::Shape(0), ..row }) > 0.0);
    assert!(pressed(&|row| Collision { primitive_b: Primitive::Vertex(40), ..row }) > 0.0);
    assert_eq!(pressed(&|row| Collision { detected_at: SimTime::ZERO, ..row }), 0.0);
    assert_eq!(pressed(&|row| Collision { method: Detection::Simulator, ..row }), 0.0);
    assert_eq!(pressed(&|row| Collision { b: Entity::new(0, 0, 9998), ..row }), 0.0);
    for part in [Primitive::Vertex(9_999), Primitive::Triangle(9_999), Primitive::Segment(0)] {
        assert_eq!(pressed(&|row| Collision { primitive_b: part, ..row }), 0.0, "{part:?} is not there");
    }
    assert_eq!(pressed(&|row| Collision { normal_in_world: Vector3::zeros(), ..row }), 0.0);
}
