//! Linear organs cut by scissors and torn on a scene: they respond at once, the next inverse takes over without a jump,
//! and restarts continue identically.

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, Point3, Rotation3, UnitQuaternion, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::{
    BuildContext, CollisionList, ControllerError, Frozen, JawState, Pose, RestPositions, SurfaceMesh,
    VertexPositions,
};
use trocar_simulator::controller::LinearFemController;
use trocar_simulator::linear_algebra::SupernodalCholesky;
use trocar_simulator::stiffness::stiffness;

const HZ: f64 = 60.0;

fn build(context: &BuildContext<'_>) -> Result<LinearFemController, ControllerError> {
    LinearFemController::new(Vector3::zeros(), None, context)
}

/// A bar of 10 cm held at one end, a rod above its other end, and closed blades above its middle.
fn bar(body: &str) -> String {
    bar_of([20, 4, 4], body)
}

fn bar_of(cells: [u32; 3], body: &str) -> String {
    format!(
        r#"
[[entity]]
name = "rod"
pose = {{ translation = [0.04, 0.0, 0.05], rotation = [1.0, 0.0, 0.0, 0.0] }}
instrument = {{ kind = "probe", shaft_length = 0.1, shaft_radius = 0.004, jaw_length = 0.004, jaws = 0 }}
[[entity]]
name = "tool"
pose = {{ translation = [0.3, 0.0, 0.0] }}
instrument = {{ kind = "scissors", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.04, jaws = 2, jaw_thickness = 0.003 }}
[[entity]]
name = "bar"
mesh = {{ block = {{ size = [0.1, 0.02, 0.02], cells = {cells:?} }} }}
linear_fem = {{ young_modulus = 2e4, poisson_ratio = 0.3, contact_radius = 0.008{body} }}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [-0.0499, 1.0, 1.0] }} }}] }}
"#
    )
}

/// The rod points down; its round end this deep in the bar.
fn press(stage: &mut Stage<LinearFemController>, deep: f64) {
    let turned = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let translation = Vector3::new(0.0403, 0.0002, 0.01 - deep);
    stage.put("rod", Pose { translation, ..Pose::from(turned) });
}

/// Closed blades that point along y, across all of the bar, at this height.
fn blade(stage: &mut Stage<LinearFemController>, z: f64) {
    let turned = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::y()).expect("a quarter of a turn");
    let place = Isometry3::from_parts(Vector3::new(-0.0288, 0.02, z).into(), turned);
    stage.put("tool", Pose::from(place));
    stage.put("tool", JawState { angle: 0.0, rate: 0.0, pad_force: [0.0; 2] });
}

fn tick(stage: &mut Stage<LinearFemController>) -> f64 {
    stage.tick();
    assert!(!stage.has::<Frozen>("bar"), "{}", stage.get::<Frozen>("bar").reason);
    felt(stage)
}

fn felt(stage: &Stage<LinearFemController>) -> f64 {
    let lists = stage.store.view().iter::<CollisionList>();
    lists.flat_map(|(_, list)| &list.collisions).map(|c| c.force_in_world).sum::<Vector3<f64>>().norm()
}

/// Presses by 2 mm, and cuts from above down to a height within 20 ticks; returns the force in each tick from then on.
fn cut_to(z: f64, body: &str, kills: &[u32]) -> (Stage<LinearFemController>, f64, Vec<f64>) {
    let mut stage = Stage::new(scene(&bar(body)), HZ, build);
    blade(&mut stage, 0.013);
    press(&mut stage, -0.002);
    (0..3).for_each(|_| {
        tick(&mut stage);
    });
    let mut whole = 0.0;
    for step in 0..=20_u32 {
        press(&mut stage, 0.002 * f64::from(step) / 20.0);
        whole = tick(&mut stage);
    }
    let mut forces = Vec::new();
    for step in 0..60_u32 {
        blade(&mut stage, 0.013 + (z - 0.013) * f64::from(step.min(20)) / 20.0);
        forces.push(tick(&mut stage));
        if kills.contains(&step) {
            stage.rebuild(build);
            // Its inverse takes over with the next tick.
            tick(&mut stage);
        }
    }
    (stage, whole, forces)
}

#[test]
fn scissors_open_a_linear_organ_at_once_and_the_next_inverse_takes_over_unfelt() {
    let (stage, whole, forces) = cut_to(0.0, ", cut = true", &[]);
    let faces = stage.measured("bar.opened_faces");
    assert!(faces >= 16.0 && stage.measured("bar.pieces") == 1.0, "{faces} faces");
    assert_eq!(stage.measured("bar.nodes_waiting"), 0.0);
    // It deforms in the tick in which the blades have passed, and hangs by its lower half.
    let last = forces[59];
    assert!(forces[21] < 0.7 * whole && last < 0.7 * whole, "{whole} N whole, {forces:?} N");
    // After the cut the next inverse takes over, and no tick changes the force.
    let jump = forces[21..].windows(2).map(|pair| (pair[1] / pair[0] - 1.0).abs()).fold(0.0, f64::max);
    assert!(jump < 0.05, "{forces:?} N");
    assert!(jump < 2e-3, "but for rounding, and where the rod presses, it is the same: {jump}");
    // The slit opens.
    let (rest, now) =
        (stage.get::<RestPositions>("bar").positions, stage.get::<VertexPositions>("bar").positions);
    let mut gap: f64 = 0.0;
    for (one, place) in rest.iter().enumerate() {
        for other in one + 1..rest.len() {
            if (place - rest[other]).norm() < 1e-12 {
                gap = gap.max((now[one] - now[other]).norm());
            }
        }
    }
    assert!(gap > 2e-4, "its lips are {gap} m apart");
    let triangles = stage.get::<SurfaceMesh>("bar").triangles;
    assert_eq!(triangles.len(), (2.0 * faces) as usize + 2 * (2 * 16 + 4 * 80));
    // The controls: blades beside it, and an organ that cannot be cut.
    let (beside, whole, forces) = cut_to(0.0115, ", cut = true", &[]);
    assert_eq!(beside.measured("bar.opened_faces"), 0.0);
    assert!(forces.iter().all(|force| (force / whole - 1.0).abs() < 1e-3), "{whole} N, {forces:?} N");
    let (pushed, whole, forces) = cut_to(0.0, "", &[]);
    assert!(
        pushed.store.view().get::<SurfaceMesh>(pushed.entity("bar")).expect("one").triangles.len() == 704
    );
    assert!(forces[59] > 1.1 * whole, "blades push it: {} N", forces[59]);
}

#[test]
fn blades_that_close_about_a_linear_organ_part_it_and_others_do_not() {
    let bite = |from: f64, to: f64| {
        let mut stage = Stage::new(scene(&bar(", cut = true")), HZ, build);
        blade(&mut stage, 0.0);
        press(&mut stage, -0.02);
        // The hinge below the bar, the tips above it: blades of 4 cm that open along x.
        let place = Isometry3::translation(-0.0288, 0.0, 0.02);
        stage.put("tool", Pose::from(place));
        for step in 0..=40_u32 {
            let angle = from + (to - from) * f64::from(step.min(30)) / 30.0;
            stage.put("tool", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
            tick(&mut stage);
        }
        (stage.measured("bar.opened_faces"), stage.measured("bar.pieces"))
    };
    let (faces, _) = bite(0.9, 0.0);
    assert!(faces >= 8.0, "{faces} faces");
    // Blades that open around it, and that stay open, cut nothing.
    assert_eq!(bite(0.0, 0.9), (0.0, 1.0));
    assert_eq!(bite(0.9, 0.9), (0.0, 1.0));
}

#[test]
fn another_life_of_a_cut_organ_finds_the_same() {
    let (stage, _, forces) = cut_to(0.0, ", cut = true", &[]);
    let positions = stage.get::<VertexPositions>("bar").positions;
    // At the beginning of the cut, in between, as the next inverse takes over, and long after.
    for kills in [vec![2], vec![9, 10, 11], vec![20, 21], vec![50]] {
        let (again, _, others) = cut_to(0.0, ", cut = true", &kills);
        let (one, other) = (forces[59], others[59]);
        assert!((one - other).abs() < 1e-6 * one, "killed after {kills:?}: {one} N and {other} N");
        assert_eq!(again.measured("bar.opened_faces"), stage.measured("bar.opened_faces"));
        let there = again.get::<VertexPositions>("bar").positions;
        let apart = positions.iter().zip(there.iter()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        assert!(apart < 1e-8, "killed after {kills:?}: {apart} m");
    }
}

#[test]
fn after_the_next_inverse_it_is_where_a_direct_solve_of_the_slit_mesh_has_it() {
    let (stage, ..) = cut_to(0.0, ", cut = true", &[]);
    let tets = stage.get::<trocar_scene::TetMesh>("bar").tets;
    let (rest, now) =
        (stage.get::<RestPositions>("bar").positions, stage.get::<VertexPositions>("bar").positions);
    let rules = MeshRules { coincident_within: None, ..MeshRules::default() };
    let mesh = TetMesh::new(&rest, &tets, &rules).expect("a sound mesh");
    let every: Vec<_> = (0..rest.len() as u32).map(Some).collect();
    let material = Elastic::new(2e4, 0.3).expect("a material");
    let k = stiffness(&mesh, &material, &every, rest.len());
    let moved: Vec<_> = now.iter().zip(rest.iter()).map(|(now, rest)| now - rest).collect();
    let mut forces = vec![Vector3::zeros(); rest.len()];
    k.multiply(&moved, &mut forces);
    // The forces for its displacements are those of the rod, reported to the hand, and nothing else.
    let wall = |node: usize| rest[node].x < -0.0499;
    let near = |node: usize| (rest[node] - Point3::new(0.0403, 0.0002, 0.01)).norm() < 0.012;
    let by_rod: Vector3<f64> = (0..rest.len()).filter(|&node| near(node)).map(|node| forces[node]).sum();
    let told: Vector3<f64> = {
        let lists = stage.store.view().iter::<CollisionList>();
        lists.flat_map(|(_, list)| &list.collisions).map(|c| c.force_in_world).sum()
    };
    assert!((by_rod - told).norm() < 0.01 * told.norm(), "{by_rod} N and {told} N");
    let rest_of = (0..rest.len()).filter(|&node| !wall(node) && !near(node));
    let stray = rest_of.map(|node| forces[node].norm()).fold(0.0, f64::max);
    assert!(stray < 1e-3 * told.norm(), "{stray} N on nodes that nothing touches");
    // Under those forces an independent solve gives the same shape.
    let mut next = 0;
    let numbers: Vec<Option<u32>> = (0..rest.len())
        .map(|node| {
            next += u32::from(!wall(node));
            (!wall(node)).then(|| next - 1)
        })
        .collect();
    let inner = stiffness(&mesh, &material, &numbers, next as usize);
    let mut factor = SupernodalCholesky::new(inner.pattern(), 1).expect("room");
    factor.factor(inner.pattern(), inner.values()).expect("definite");
    let mut right = vec![0.0; 3 * next as usize];
    for (node, number) in numbers.iter().enumerate().filter(|(node, _)| near(*node)) {
        let at = 3 * number.expect("free") as usize;
        right[at..at + 3].copy_from_slice(forces[node].as_slice());
    }
    factor.solve(&mut right);
    let largest = moved.iter().map(|moved| moved.norm()).fold(0.0, f64::max);
    for (moved, number) in moved.iter().zip(&numbers) {
        let Some(at) = number.map(|number| 3 * number as usize) else { continue };
        let off = (moved - Vector3::from_column_slice(&right[at..at + 3])).norm();
        assert!(off < 2e-3 * largest, "{off} m of {largest} m");
    }
}

#[test]
fn what_is_cut_through_is_two_pieces_and_the_one_that_nothing_holds_gives_way_to_everything() {
    let (mut stage, whole, forces) = cut_to(-0.012, ", cut = true", &[]);
    assert_eq!(stage.measured("bar.pieces"), 2.0);
    assert_eq!(stage.measured("bar.nodes_waiting"), 0.0);
    assert!(forces[59] < 1e-3 * whole, "{} N of {whole} N", forces[59]);
    // The held part is unchanged, and can be pressed.
    press(&mut stage, -0.02);
    (0..5).for_each(|_| {
        tick(&mut stage);
    });
    let turned = Isometry3::from_parts(
        Vector3::new(-0.0375, 0.0, 0.008).into(),
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_axis_angle(
            &Vector3::x_axis(),
            std::f64::consts::PI,
        )),
    );
    stage.put("rod", Pose::from(turned));
    (0..5).for_each(|_| {
        tick(&mut stage);
    });
    assert!(felt(&stage) > 10.0 * forces[59].max(1e-4), "{} N", felt(&stage));
    // A restart has the same two pieces.
    let before = felt(&stage);
    stage.rebuild(build);
    (0..5).for_each(|_| {
        tick(&mut stage);
    });
    assert!((felt(&stage) - before).abs() < 1e-6 * before, "{before} N and {} N", felt(&stage));
}

#[test]
fn what_is_too_much_for_a_tick_waits_and_comes_with_the_next_inverse() {
    let mut stage = Stage::new(scene(&bar_of([12, 12, 12], ", cut = true")), HZ, build);
    blade(&mut stage, 0.013);
    press(&mut stage, -0.002);
    (0..3).for_each(|_| {
        tick(&mut stage);
    });
    press(&mut stage, 0.001);
    let whole = (0..4).map(|_| tick(&mut stage)).last().expect("some");
    // All the way through between two ticks.
    blade(&mut stage, -0.013);
    let (mut forces, mut waiting) = (Vec::new(), Vec::new());
    for _ in 0..80 {
        forces.push(tick(&mut stage));
        waiting.push(stage.measured("bar.nodes_waiting"));
    }
    assert_eq!(stage.measured("bar.pieces"), 2.0);
    // More unknowns than an inverse can be corrected by.
    assert!(waiting[0] > 128.0, "{waiting:?} nodes");
    assert!(waiting[79] == 0.0 && forces[79] < 1e-3 * whole, "{whole} N whole, {forces:?} N");
    // It then waits for a new inverse, as for removals beyond the limit.
    let changes = forces.windows(2).map(|pair| (pair[1] - pair[0]).abs() / whole);
    let most = changes.fold(0.0, f64::max);
    assert!(most < 0.05, "by {most} of what was felt in a tick: {forces:?} N");
}

#[test]
fn what_is_pulled_harder_than_it_bears_tears_and_what_is_not_does_not() {
    let pulled = |strength: f64| {
        let mut stage = Stage::new(scene(&bar(&format!(", strength = {strength}"))), HZ, build);
        press(&mut stage, -0.002);
        (0..3).for_each(|_| {
            tick(&mut stage);
        });
        let mut forces = Vec::new();
        for step in 0..120_u32 {
            press(&mut stage, 0.006 * f64::from(step.min(60)) / 60.0);
            forces.push(tick(&mut stage));
        }
        (stage, forces)
    };
    let (torn, forces) = pulled(280.0);
    let (whole, control) = pulled(1e5);
    assert_eq!(whole.measured("bar.torn_faces"), 0.0);
    let faces = torn.measured("bar.torn_faces");
    assert!(faces >= 4.0, "{faces} faces");
    assert!(forces[119] < 0.9 * control[119], "{} N, {} N where it bears it", forces[119], control[119]);
    // It tears where the bending is largest, above the support.
    let rest = torn.get::<RestPositions>("bar").positions;
    let first = 21 * 5 * 5;
    assert!(rest.len() > first && rest[first].x < -0.02 && rest[first].z > 0.0, "{}", rest[first]);
    assert!(rest[first..].iter().all(|place| place.x < 0.0), "{:?}", &rest[first..]);
}
