//! The controller of linear organs on a scene: its use of the solver, its outputs, and restarts.

use crate::support::stage::{Stage, scene};
use nalgebra::{Point3, Vector3};
use trocar_scene::{
    BuildContext, CollisionList, ControllerError, Frozen, JawState, OutOfValidity, Pose, VertexPositions,
};
use trocar_simulator::controller::{
    CoagulatedElement, CoagulatedElements, LinearFemController, RemovedElements,
};

const HZ: f64 = 60.0;

/// A rod that points down, its tip at its origin, and a block that is held below.
fn block(young_modulus: f64) -> String {
    block_of([10, 10, 5], young_modulus, 0.006)
}

fn block_of(cells: [u32; 3], young_modulus: f64, contact_radius: f64) -> String {
    format!(
        r#"
[[entity]]
name = "rod"
pose = {{ translation = [0.0, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }}
instrument = {{ kind = "probe", shaft_length = 0.1, shaft_radius = 0.004, jaw_length = 0.004, jaws = 0 }}
[[entity]]
name = "pad"
pose = {{ translation = [0.0, 0.0, -0.01] }}
mesh = {{ block = {{ size = [0.04, 0.04, 0.02], cells = {cells:?} }} }}
linear_fem = {{ young_modulus = {young_modulus}, contact_radius = {contact_radius} }}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] }} }}] }}
"#
    )
}

fn build(context: &BuildContext<'_>) -> Result<LinearFemController, ControllerError> {
    LinearFemController::new(Vector3::zeros(), None, context)
}

fn down(z: f64) -> Pose {
    let turned = nalgebra::Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    Pose { translation: Vector3::new(0.0003, 0.0, z), ..Pose::from(turned) }
}

fn at(stage: &mut Stage<LinearFemController>, z: f64) {
    stage.put("rod", down(z));
    stage.tick();
}

/// Lowers the rod to 1.5 mm below the top at a hand's speed, and leaves it there.
fn press(stage: &mut Stage<LinearFemController>, ticks: u32) {
    at(stage, 0.02);
    at(stage, 0.02);
    assert_eq!(stage.measured("pad.precomputed_share"), 1.0);
    for tick in 1..=ticks {
        at(stage, 0.0005 - 0.002 * f64::from(tick) / f64::from(ticks));
    }
    (0..10).for_each(|_| at(stage, -0.0015));
}

fn force_on_body(stage: &Stage<LinearFemController>) -> Vector3<f64> {
    let lists = stage.store.view().iter::<CollisionList>();
    lists.flat_map(|(_, list)| &list.collisions).map(|collision| collision.force_in_world).sum()
}

#[test]
fn a_pad_gives_way_to_a_rod_by_a_force_that_its_modulus_says_and_comes_back() {
    let mut stage = Stage::new(scene(&block(6e3)), HZ, build);
    press(&mut stage, 20);
    assert!(!stage.has::<Frozen>("pad"));
    let positions = stage.get::<VertexPositions>("pad").positions;
    // In the pad's frame its top is at 0.01: no vertex is inside the rod.
    let tip = Point3::new(0.0003, 0.0, 0.01 - 0.0015 + 0.004);
    let nearest = positions.iter().map(|at| (at - tip).norm()).fold(f64::INFINITY, f64::min);
    assert!(nearest > 0.004 - 1e-5 && nearest < 0.0045, "{nearest} m from the middle of its round end");
    let force = force_on_body(&stage);
    let least = 4.0 / 3.0 * 6e3 / (1.0 - 0.45 * 0.45) * 0.004_f64.sqrt() * 0.0015_f64.powf(1.5);
    assert!(force.z < -least && force.z > -4.0 * least, "{force} N, and Hertz {least} N");
    assert!((stage.measured("pad.contact_force_n") - force.norm()).abs() < 0.25 * force.norm());
    assert_eq!(stage.measured("pad.beyond_linear"), 1.0, "more than a tenth of strain under the rod");
    // Twice as stiff: twice the force, the same shape.
    let mut stiff = Stage::new(scene(&block(12e3)), HZ, build);
    press(&mut stiff, 20);
    assert!((force_on_body(&stiff).z / force.z - 2.0).abs() < 1e-3);
    (0..12).for_each(|_| at(&mut stage, 0.02));
    assert_eq!(stage.measured("pad.contact_force_n"), 0.0);
    assert!(stage.measured("pad.displacement_max_m") < 1e-12);
    assert_eq!(stage.measured("pad.beyond_linear"), 0.0);
}

#[test]
fn a_rod_feels_the_same_on_a_finer_mesh() {
    let felt = |cells: [u32; 3], contact_radius: f64| {
        let mut stage = Stage::new(scene(&block_of(cells, 6e3, contact_radius)), HZ, build);
        press(&mut stage, 20);
        -force_on_body(&stage).z
    };
    let (coarse, fine) = ([14, 14, 7], [28, 28, 14]);
    let change = |contact_radius: f64| felt(fine, contact_radius) / felt(coarse, contact_radius) - 1.0;
    let (patch, nodes) = (change(0.008), change(0.0));
    assert!(patch.abs() < 0.1, "changes by {patch} on the finer mesh");
    assert!(nodes < -0.15, "on single nodes by {nodes} only");
}

#[test]
fn another_life_goes_on_from_the_scene() {
    let run = |kill: Option<u32>| {
        let mut stage = Stage::new(scene(&block(6e3)), HZ, build);
        press(&mut stage, 20);
        for tick in 0..40_u32 {
            if kill == Some(tick) {
                stage.rebuild(build);
            }
            at(&mut stage, -0.0015);
        }
        for tick in 0..40 {
            at(&mut stage, -0.0015 + 0.001 * (f64::from(tick) * 0.2).sin());
        }
        stage.get::<VertexPositions>("pad")
    };
    let [one, other] = [run(None), run(Some(7))].map(|vertices| vertices.positions);
    let apart = one.iter().zip(other.iter()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
    assert!(apart < 1e-9, "{apart} m");
}

#[test]
fn jaws_that_close_hold_and_lift_and_what_opens_lets_go() {
    let text = r#"
[[entity]]
name = "grasper"
pose = { translation = [0.0, 0.0, 0.06], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "grasper", shaft_length = 0.1, shaft_radius = 0.0025, jaw_length = 0.012, jaws = 2, jaw_thickness = 0.002 }
[[entity]]
name = "fold"
mesh = { block = { size = [0.002, 0.02, 0.03], cells = [1, 6, 8] } }
linear_fem = { young_modulus = 5000.0 }
anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0149] } }] }
"#;
    let mut stage = Stage::new(scene(text), HZ, build);
    let turned = nalgebra::Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let tip = |z: f64| Pose { translation: Vector3::new(0.0, 0.0, z), ..Pose::from(turned) };
    let mut act = |z: f64, angle: f64, ticks: u32| {
        for _ in 0..ticks {
            stage.put("grasper", tip(z));
            stage.put("grasper", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
            stage.tick();
        }
        let held = stage.measured("fold.held_vertices");
        (held, force_on_body(&stage), stage.measured("fold.displacement_max_m"))
    };
    act(0.02, 0.9, 3);
    // Around the fold without touching it, then closed.
    let (_, touched, _) = act(0.009, 0.9, 3);
    assert_eq!(touched, Vector3::zeros());
    let (held, ..) = act(0.009, 0.05, 2);
    assert!(held > 2.0, "{held}");
    let (_, pulled, moved) = act(0.012, 0.05, 1);
    assert!(pulled.z > 0.01 && moved > 0.0025, "{pulled} N, {moved} m");
    let (held, pulled, moved) = act(0.05, 0.9, 12);
    assert_eq!((held, pulled), (0.0, Vector3::zeros()));
    assert!(moved < 1e-12);
}

#[test]
fn elements_that_burn_are_gone_at_once_and_the_next_inverse_takes_over_unfelt() {
    let text = format!("{}cauterised = {{}}\n", block(5000.0));
    let mut stage = Stage::new(scene(&text), HZ, build);
    press(&mut stage, 30);
    let whole = force_on_body(&stage).norm();
    // A crater beside the rod.
    let mesh = stage.get::<trocar_scene::TetMesh>("pad").tets;
    let rest = stage.get::<trocar_scene::RestPositions>("pad").positions;
    let middle = |tet: &[u32; 4]| tet.iter().map(|&n| rest[n as usize].coords).sum::<Vector3<f64>>() / 4.0;
    let crater = |tet: &[u32; 4]| {
        let at = middle(tet);
        (0.003..0.012).contains(&at.x) && at.y.abs() < 0.006 && at.z > 0.004
    };
    let gone: Vec<u32> = (0..mesh.len() as u32).filter(|&tet| crater(&mesh[tet as usize])).collect();
    assert!((10..60).contains(&gone.len()), "{}", gone.len());
    let triangles = stage.get::<trocar_scene::SurfaceMesh>("pad").triangles;
    // Some elements are removed in each tick, as at a hook.
    for count in (0..=gone.len()).step_by(6).chain([gone.len()]) {
        stage.put("pad", RemovedElements { elements: std::sync::Arc::new(gone[..count].to_vec()) });
        at(&mut stage, -0.0015);
        assert_eq!(stage.measured("pad.elements_waiting"), 0.0);
    }
    let served = force_on_body(&stage).norm();
    assert!(served < 0.95 * whole, "{served} N with a crater, {whole} N without");
    assert_eq!(stage.measured("pad.elements_left"), (mesh.len() - gone.len()) as f64);
    assert_ne!(stage.get::<trocar_scene::SurfaceMesh>("pad").triangles, triangles);
    // The last new inverse takes over with the next tick.
    let mut forces = Vec::new();
    for _ in 0..4 {
        at(&mut stage, -0.0015);
        forces.push(force_on_body(&stage).norm());
    }
    let jump = forces.iter().map(|force| (force - served).abs() / served).fold(0.0, f64::max);
    assert!(jump < 0.05, "{forces:?} N after {served} N");
    // More removals than can be corrected are processed in two parts, with the same result after a restart.
    let layer: Vec<u32> =
        (0..mesh.len() as u32).filter(|&tet| middle(&mesh[tet as usize]).z > 0.006).collect();
    let more = layer.iter().filter(|tet| !gone.contains(tet));
    let all: Vec<u32> = gone.iter().chain(more).copied().take(200).collect();
    assert!(all.len() == 200);
    stage.put("pad", RemovedElements { elements: std::sync::Arc::new(all) });
    at(&mut stage, -0.0015);
    assert!(stage.measured("pad.elements_waiting") > 0.0);
    (0..20).for_each(|_| at(&mut stage, -0.0015));
    assert_eq!(stage.measured("pad.elements_waiting"), 0.0);
    let before = (force_on_body(&stage).norm(), stage.get::<VertexPositions>("pad").positions);
    stage.rebuild(build);
    (0..20).for_each(|_| at(&mut stage, -0.0015));
    let (force, again) = (before.0, force_on_body(&stage).norm());
    assert!((force - again).abs() < 1e-6 * force, "{force} N and {again} N");
    // Of the surface; interior nodes are updated now and then.
    let (now, corners) = (
        stage.get::<VertexPositions>("pad").positions,
        stage.get::<trocar_scene::SurfaceMesh>("pad").triangles,
    );
    let nodes = corners.iter().flatten().map(|&node| node as usize);
    let apart = nodes.map(|node| (now[node] - before.1[node]).norm()).fold(0.0, f64::max);
    assert!(apart < 1e-8, "another life finds the same to {apart} m");
    assert!(!stage.has::<Frozen>("pad"));
}

#[test]
fn what_is_stiffened_and_more_than_can_be_corrected_for_are_blended_in_unfelt() {
    let text = format!("{}cauterised = {{}}\n", block(5000.0));
    // The forces after the tick of the change, and long after that.
    let changed = |coagulates: bool, more: usize| {
        let mut stage = Stage::new(scene(&text), HZ, build);
        press(&mut stage, 30);
        let mesh = stage.get::<trocar_scene::TetMesh>("pad").tets;
        let rest = stage.get::<trocar_scene::RestPositions>("pad").positions;
        let middle =
            |tet: &[u32; 4]| tet.iter().map(|&n| rest[n as usize].coords).sum::<Vector3<f64>>() / 4.0;
        // A crater beside the rod; the tissue around it and under the rod is coagulated.
        let all = 0..mesh.len() as u32;
        let beside = |x: f64, at: Vector3<f64>| at.x > x && at.y.abs() < 0.012 && at.z > 0.002;
        let gone: Vec<u32> = all.clone().filter(|&tet| beside(0.004, middle(&mesh[tet as usize]))).collect();
        assert!(gone.len() > 64 + more, "{}", gone.len());
        let gone = &gone[..8 + more];
        let stiff = all.filter(|tet| !gone.contains(tet) && beside(-0.006, middle(&mesh[*tet as usize])));
        let stiff = stiff.map(|element| CoagulatedElement { element, stiffness: 7.0, length: 0.99 });
        if coagulates {
            stage.put("pad", CoagulatedElements { elements: std::sync::Arc::new(stiff.collect()) });
        }
        stage.put("pad", RemovedElements { elements: std::sync::Arc::new(gone.to_vec()) });
        let mut forces = Vec::new();
        for _ in 0..300 {
            at(&mut stage, -0.0015);
            forces.push(force_on_body(&stage).norm());
        }
        assert_eq!(stage.measured("pad.elements_waiting"), 0.0);
        assert!(!stage.has::<Frozen>("pad"));
        // A restart has only the last inverse, with the same result.
        stage.rebuild(build);
        (0..5).for_each(|_| at(&mut stage, -0.0015));
        let (last, again) = (forces[forces.len() - 1], force_on_body(&stage).norm());
        assert!((last - again).abs() < 1e-4 * last, "{last} N and {again} N");
        forces
    };
    for (coagulates, more) in [(true, 0), (false, 72), (true, 72)] {
        let forces = changed(coagulates, more);
        let jumps = forces.windows(2).map(|pair| (pair[1] / pair[0] - 1.0).abs());
        let jump = jumps.fold(0.0, f64::max);
        let in_all = forces[forces.len() - 1] / forces[0];
        assert!(jump < 0.05, "coagulated {coagulates}, {more} more: a jump by {jump}");
        // The control: at once it would be one.
        assert!((in_all - 1.0).abs() > 0.1, "coagulated {coagulates}, {more} more: {in_all} in all");
    }
}

#[test]
fn what_goes_beyond_small_displacements_is_told_once_and_goes_on() {
    let pressed = |deep: f64| {
        let mut stage = Stage::new(scene(&block(5000.0)), HZ, build);
        for tick in 0..40 {
            at(&mut stage, 0.001 - (0.001 + deep) * f64::from(tick) / 39.0);
        }
        stage
    };
    assert!(!pressed(0.0003).has::<OutOfValidity>("pad"));
    let mut stage = pressed(0.004);
    let doubtful = stage.get::<OutOfValidity>("pad");
    assert!(doubtful.reason.contains("beyond 10° or 10 %"), "{}", doubtful.reason);
    assert!(doubtful.since.as_secs_f64() > 0.1 && force_on_body(&stage).norm() > 0.0);
    at(&mut stage, -0.004);
    assert_eq!(stage.get::<OutOfValidity>("pad"), doubtful, "it is told once");
}
