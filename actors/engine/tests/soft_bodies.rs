//! The engine's soft volumes beside finite elements on the same mesh: how far they give way, what is felt of them, and
//! what stops them.

use crate::stage::{Stage, scene_with};
use nalgebra::{Isometry3, Vector3};
use trocar_engine::EngineSoftController;
use trocar_scene::{
    BuildContext, CollisionList, Controller, ControllerError, Frozen, JawState, Pose, Store, Velocity,
    VertexPositions,
};
use trocar_simulator::controller::{DynamicFemController, ElectrosurgeryController};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
const SOLVERS: [&str; 2] = ["constraints", "finite_elements"];

fn scene(text: &str) -> Store {
    scene_with(text, |builder| trocar_engine::register_soft(builder).expect("names are free"))
}

fn build(context: &BuildContext<'_>) -> Result<EngineSoftController, ControllerError> {
    EngineSoftController::new(GRAVITY, context)
}

fn fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(GRAVITY, context)
}

fn soft(solver: &str, poisson_ratio: f64) -> String {
    format!(
        "engine_soft = {{ young_modulus = 5000.0, poisson_ratio = {poisson_ratio}, solver = \"{solver}\", damping = 20.0, \
         friction = 0.0 }}"
    )
}

fn finite_elements(poisson_ratio: f64) -> String {
    format!(
        "dynamic_fem = {{ young_modulus = 5000.0, poisson_ratio = {poisson_ratio}, mass_damping = 20.0 }}"
    )
}

/// A beam that is held at one end, and hangs under its weight.
fn beam(kind: &str) -> String {
    format!(
        "[[entity]]\nname = \"beam\"\nmesh = {{ block = {{ size = [0.05, 0.01, 0.01], cells = [15, 3, 3] }} }}\n{kind}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [-0.0249, 1.0, 1.0] }} }}] }}\n"
    )
}

const ROD: &str = r#"
[[entity]]
name = "rod"
pose = { translation = [0.0, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "probe", shaft_length = 0.1, shaft_radius = 0.003, jaw_length = 0.004, jaws = 0 }
"#;

fn pad(kind: &str) -> String {
    format!(
        "{ROD}\n[[entity]]\nname = \"pad\"\npose = {{ translation = [0.0, 0.0, -0.01] }}\n\
         mesh = {{ block = {{ size = [0.04, 0.04, 0.02], cells = [8, 8, 4] }} }}\n{kind}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] }} }}] }}\n"
    )
}

fn down(z: f64) -> Pose {
    Pose {
        translation: Vector3::new(0.0, 0.0, z),
        ..Pose::from(Isometry3::rotation(Vector3::x() * std::f64::consts::PI))
    }
}

/// Leads the rod in from above within half a second, and leaves it there for as long.
fn press<C: Controller>(stage: &mut Stage<C>, hz: u32, depth: f64) -> f64 {
    for tick in 0..hz {
        let share = (2.0 * f64::from(tick) / f64::from(hz)).min(1.0);
        stage.put("rod", down(0.004 - (0.004 + depth) * share));
        stage.tick();
    }
    let lists = stage.store.view().iter::<CollisionList>();
    lists.flat_map(|(_, list)| list.collisions.iter().map(|c| c.force_in_world.z).collect::<Vec<_>>()).sum()
}

fn lowest<C: Controller>(stage: &Stage<C>, body: &str) -> f64 {
    let positions = stage.get::<VertexPositions>(body).positions;
    positions.iter().map(|position| position.z).fold(f64::INFINITY, f64::min)
}

#[test]
fn a_beam_hangs_as_far_as_one_of_finite_elements() {
    let mut wanted = Stage::new(scene(&beam(&finite_elements(0.3))), 200.0, fem);
    (0..300).for_each(|_| wanted.tick());
    let wanted = lowest(&wanted, "beam") + 0.005;
    for (solver, tolerance) in SOLVERS.into_iter().zip([0.1, 0.03]) {
        let mut stage = Stage::new(scene(&beam(&soft(solver, 0.3))), 200.0, build);
        (0..300).for_each(|_| stage.tick());
        let found = lowest(&stage, "beam") + 0.005;
        eprintln!("{solver}: {found} m, wanted {wanted}");
        assert!(
            wanted < -0.001 && (found / wanted - 1.0).abs() < tolerance,
            "{solver}: {found} m, {wanted} m"
        );
        assert_eq!(stage.measured("beam.frozen"), 0.0);
    }
}

#[test]
fn a_pad_feels_as_one_of_finite_elements_does() {
    let mut other = Stage::new(scene(&pad(&finite_elements(0.3))), 100.0, fem);
    let wanted = press(&mut other, 100, 0.003);
    for solver in SOLVERS {
        let mut stage = Stage::new(scene(&pad(&soft(solver, 0.3))), 500.0, build);
        let found = press(&mut stage, 500, 0.003);
        eprintln!("{solver}: {found} N, wanted {wanted}");
        assert!(wanted < -0.01 && (found / wanted - 1.0).abs() < 0.15, "{solver}: {found} N, {wanted} N");
    }
}

#[test]
fn jaws_hold_a_fold_and_feel_what_it_takes() {
    let text = |kind: String| {
        format!(
            r#"
[[entity]]
name = "grasper"
pose = {{ translation = [0.0, 0.0, 0.06], rotation = [1.0, 0.0, 0.0, 0.0] }}
instrument = {{ kind = "grasper", shaft_length = 0.1, shaft_radius = 0.0025, jaw_length = 0.012, jaws = 2, jaw_thickness = 0.002 }}
[[entity]]
name = "fold"
mesh = {{ block = {{ size = [0.002, 0.02, 0.03], cells = [1, 6, 8] }} }}
{kind}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0149] }} }}] }}
"#
        )
    };
    fn lift<C: Controller>(mut stage: Stage<C>) -> (f64, f64) {
        let mut act = |z: f64, angle: f64, ticks: u32| {
            for _ in 0..ticks {
                stage.put("grasper", down(z));
                stage.put("grasper", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
                stage.tick();
            }
        };
        act(0.009, 0.9, 20);
        act(0.009, 0.05, 20);
        (0..100).for_each(|tick| act(0.009 + 3e-5 * f64::from(tick), 0.05, 1));
        act(0.012, 0.05, 100);
        (stage.measured("fold.held_vertices"), stage.measured("fold.held_force_n"))
    }
    let (_, wanted) = lift(Stage::new(scene(&text(finite_elements(0.3))), 200.0, fem));
    for solver in SOLVERS {
        let (held, pull) = lift(Stage::new(scene(&text(soft(solver, 0.3))), 200.0, build));
        eprintln!("{solver}: {pull} N by {held}, wanted {wanted}");
        assert!(held > 2.0 && (pull / wanted - 1.0).abs() < 0.15, "{solver}: {pull} N, {wanted} N");
    }
}

/// A fold of 12.7 mN in jaws of this force, closed from the first tick on.
fn fold(kind: &str, force: f64, anchors: &str) -> Stage<EngineSoftController> {
    let text = format!(
        r#"
[[entity]]
name = "grasper"
pose = {{ translation = [0.0, 0.0, 0.009], rotation = [1.0, 0.0, 0.0, 0.0] }}
instrument = {{ kind = "grasper", shaft_length = 0.1, shaft_radius = 0.0025, jaw_length = 0.012, jaws = 2, jaw_thickness = 0.002, jaw_force_max = {force}, jaw_friction = 0.5 }}
[[entity]]
name = "fold"
mesh = {{ block = {{ size = [0.002, 0.02, 0.03], cells = [1, 6, 8] }} }}
{kind}
{anchors}
"#
    );
    Stage::new(scene(&text), 500.0, build)
}

/// Its force on the jaws, and how far it has slipped in them.
fn held(stage: &Stage<EngineSoftController>) -> (f64, f64) {
    let me = trocar_scene::Entity::of_writer(0, 7);
    let all = stage.store.view().get::<trocar_scene::Measured>(me).expect("it measures");
    let of = |what: &str| all.values.get(what).copied().unwrap_or(0.0);
    (of("fold.held_force_n"), of("fold.jaw_slip_m"))
}

fn lead(stage: &mut Stage<EngineSoftController>, z: f64) {
    stage.put("grasper", down(z));
    stage.put("grasper", JawState { angle: 0.05, rate: 0.0, pad_force: [0.0; 2] });
    stage.tick();
    assert!(!stage.has::<Frozen>("fold"), "{}", stage.get::<Frozen>("fold").reason);
}

/// Drawn up by 8 mm at 20 mm/s, from 2 μ N on it slips; strong jaws hold it.
#[test]
fn a_fold_slips_in_jaws_beyond_their_friction() {
    let anchors =
        "anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0149] } }] }";
    for solver in SOLVERS {
        let draw = |force: f64| {
            let mut stage = fold(&soft(solver, 0.3), force, anchors);
            (0..50).for_each(|_| lead(&mut stage, 0.009));
            let mut seen = Vec::new();
            for tick in 0..200 {
                lead(&mut stage, 0.009 + 4e-5 * f64::from(tick));
                seen.push(held(&stage));
            }
            seen
        };
        let strong = draw(50.0);
        let (most, slipped) = strong[strong.len() - 1];
        assert_eq!(slipped, 0.0, "{solver}");
        // By jaws that hold a third of that.
        let limit = most / 3.0;
        let weak = draw(limit);
        let began = weak.iter().position(|(_, slip)| *slip > 0.0).expect("it slips");
        let forces = weak[began + 5..].iter().map(|(force, _)| *force);
        let (least, most) =
            forces.fold((f64::INFINITY, 0.0_f64), |(a, b), force| (a.min(force), b.max(force)));
        eprintln!("{solver}: {least} to {most} N of {limit} N, from {began} on; {:?}", weak[weak.len() - 1]);
        assert!(least > 0.9 * limit && most < 1.1 * limit, "{solver}: {least} to {most} N of {limit} N");
        assert!(weak[began].0 > 0.8 * limit, "{solver}: it slips at {} N", weak[began].0);
        assert!(weak[weak.len() - 1].1 > 2e-3, "{solver}: {:?}", weak[weak.len() - 1]);
    }
}

#[test]
fn jaws_lift_a_free_fold_by_friction_or_lose_it() {
    let needed = 1060.0 * 0.002 * 0.02 * 0.03 * 9.81;
    for solver in SOLVERS {
        let mut lifted =
            fold(&soft(solver, 0.3).replace("damping = 20.0", "damping = 200.0"), 1.5 * needed, "");
        (0..250).for_each(|_| lead(&mut lifted, 0.009));
        let settled = held(&lifted);
        (0..500).for_each(|_| lead(&mut lifted, 0.009));
        let (force, slip) = held(&lifted);
        eprintln!("{solver}: {settled:?}, then {force} N of {needed} N, slipped by {slip} m");
        assert!((force / needed - 1.0).abs() < 0.1, "{solver}: {force} N of {needed} N");
        assert!(slip - settled.1 < 1e-5, "{solver}: it creeps from {} to {slip} m", settled.1);
        let mut dropped = fold(&soft(solver, 0.3), 0.5 * needed, "");
        (0..250).for_each(|_| lead(&mut dropped, 0.009));
        assert_eq!(dropped.measured("fold.held_vertices"), 0.0, "{solver}: it is held");
        assert!(lowest(&dropped, "fold") < -0.2, "{solver}: {} m", lowest(&dropped, "fold"));
    }
}

#[test]
fn another_life_goes_on_where_the_last_one_stood() {
    for solver in SOLVERS {
        let run = |kill: bool| {
            let mut stage = Stage::new(scene(&beam(&soft(solver, 0.3))), 200.0, build);
            for tick in 0..60 {
                if kill && tick == 20 {
                    stage.rebuild(build);
                }
                stage.tick();
            }
            stage.get::<VertexPositions>("beam").positions
        };
        let [one, same, other] = [run(false), run(false), run(true)];
        assert_eq!(one, same, "two runs are the same to the bit");
        let apart = one.iter().zip(other.iter()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        eprintln!("{solver}: {apart}");
        assert!(apart < 1e-4, "{solver}: {apart} m");
    }
}

#[test]
fn what_has_no_future_is_stopped_and_what_is_no_volume_is_refused() {
    let mut stage = Stage::new(scene(&pad(&soft("constraints", 0.3))), 200.0, build);
    stage.put("rod", down(-0.001));
    stage.tick();
    let before = stage.get::<VertexPositions>("pad").positions;
    // So fast that the force of its touch is no number any more.
    stage.put("rod", Velocity { linear: Vector3::new(0.0, 0.0, -1e308), ..Velocity::default() });
    (0..5).for_each(|_| stage.tick());
    let reason = stage.get::<Frozen>("pad").reason;
    assert!(reason.contains("not finite"), "{reason}");
    assert_eq!(stage.get::<VertexPositions>("pad").positions, before, "it is where it was last good");

    let sheet = "[[entity]]\nname = \"cloth\"\nmesh = { sheet = { size = [0.02, 0.02], cells = [4, 4] } }\nengine_soft = {}\n";
    let store = scene(sheet);
    let snapshot = store.snapshot();
    let me = trocar_scene::Entity::of_writer(0, 7);
    let context = BuildContext {
        scene: &snapshot,
        time: Default::default(),
        period: trocar_scene::SimTime::from_millis(1),
        name: "soft",
        me,
        epoch: 1,
        seed: 1,
    };
    let Err(error) = build(&context) else { panic!("a cloth is none of it") };
    assert!(error.to_string().contains("'cloth'") && error.to_string().contains("xpbd"), "{error}");
}

/// The engine keeps the elements that it began with: what burns would stay in its way.
#[test]
fn what_the_engine_moves_is_not_cauterised() {
    let burning = format!("{}\ncauterised = {{}}\n", soft("constraints", 0.3));
    let store = scene(&pad(&burning));
    let context = crate::stage::context(&store, Default::default(), 1);
    let Err(error) = ElectrosurgeryController::new(&context) else { panic!("it burns") };
    let error = error.to_string();
    assert!(error.contains("'pad'") && error.contains("'engine_soft'"), "{error}");
    assert!(error.contains("'dynamic_fem', 'linear_fem', 'mass_spring' or 'xpbd'"), "{error}");
}
