//! Instruments driven into a linear organ constrain interior points: these follow the instrument, the reaction is felt
//! by the hand and equals that of a direct solve, and constraints persist over ticks and restarts.

use crate::support::stage::{Stage, context, scene};
#[allow(dead_code)] // every test uses another part
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::{
    BuildContext, CollisionList, ControllerError, Frozen, JawState, Pose, RestPositions, TetMesh as Tets,
    VertexPositions,
};
use trocar_simulator::controller::{DynamicFemController, LinearFemController, PinPlaces, RemovedElements};
use trocar_simulator::linear_algebra::SupernodalCholesky;
use trocar_simulator::stiffness::stiffness;

const HZ: f64 = 60.0;
/// Two interior points of the bar held by a hook, in the bar's frame \[m\].
const POINTS: [[f64; 3]; 2] = [[0.0213, 0.0012, -0.0023], [0.0371, -0.0031, 0.0017]];

fn build(context: &BuildContext<'_>) -> Result<LinearFemController, ControllerError> {
    LinearFemController::new(Vector3::zeros(), None, context)
}

/// A bar of 10 cm held at one end, at an arbitrary pose, and a hook driven into it.
fn bar(pinned: &str) -> String {
    format!(
        r#"
[[entity]]
name = "hook"
pose = {{ translation = [0.33, 0.2, 0.12], rotation = [0.0, 0.0, 0.3826834323650898, 0.9238795325112867] }}
instrument = {{ kind = "probe", shaft_length = 0.001, shaft_radius = 0.0001, jaw_length = 0.0005, jaws = 0 }}
[[entity]]
name = "bar"
pose = {{ translation = [0.3, 0.2, 0.1], rotation = [0.0, 0.0, 0.7071067811865476, 0.7071067811865476] }}
mesh = {{ block = {{ size = [0.1, 0.02, 0.02], cells = [20, 4, 4] }} }}
linear_fem = {{ young_modulus = 2e4, poisson_ratio = 0.3, contact_radius = 0.008 }}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [-0.0499, 1.0, 1.0] }} }}] }}
{pinned}
"#
    )
}

fn pinned() -> String {
    bar(&format!("pinned = {{ with = [{{ entity = \"hook\", points = {POINTS:?} }}] }}"))
}

/// The hook, displaced by this much from where it was driven in, in the world, and rotated by this much.
fn draw(stage: &mut Stage<LinearFemController>, by: Vector3<f64>, turned: f64) {
    let quarter = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_4);
    let about = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned);
    let place = Vector3::new(0.33, 0.2, 0.12) + by;
    stage.put("hook", Pose::from(Isometry3::from_parts(place.into(), about * quarter)));
}

fn felt(stage: &Stage<LinearFemController>) -> Vec<Vector3<f64>> {
    let hook = stage.entity("hook");
    let lists = stage.store.view().iter::<CollisionList>();
    lists.flat_map(|(_, list)| &list.collisions).filter(|c| c.a == hook).map(|c| c.force_in_world).collect()
}

fn tick(stage: &mut Stage<LinearFemController>) {
    stage.tick();
    assert!(!stage.has::<Frozen>("bar"), "{}", stage.get::<Frozen>("bar").reason);
}

/// The mesh of the bar, and the position of a point from the nodes of its element.
fn mesh(stage: &Stage<LinearFemController>) -> TetMesh {
    let rest = stage.get::<RestPositions>("bar").positions;
    TetMesh::new(&rest, &stage.get::<Tets>("bar").tets, &MeshRules::default()).expect("a sound mesh")
}

#[test]
fn a_hook_that_is_driven_into_an_organ_feels_the_force_of_a_direct_solve() {
    let mut stage = Stage::new(scene(&pinned()), HZ, build);
    (0..4).for_each(|_| tick(&mut stage));
    let idle: f64 = felt(&stage).iter().map(|force| force.norm()).sum();
    assert!(idle < 1e-12, "{idle} N where it was driven in");
    let (by, turned) = (Vector3::new(0.0004, 0.0011, 0.0015), 0.02);
    // The force is present from the first tick after that of the inverse.
    draw(&mut stage, by, turned);
    tick(&mut stage);
    let forces = felt(&stage);
    assert_eq!(forces.len(), 2);
    // A direct f64 solve with both points prescribed: W λ = d with W = C K⁻¹ Cᵀ by columns, in the frame of the bar.
    let mesh = mesh(&stage);
    let wall: Vec<bool> = mesh.rest().iter().map(|place| place.x < -0.0499).collect();
    let mut next = 0;
    let numbers: Vec<Option<u32>> = wall
        .iter()
        .map(|&stays| {
            next += u32::from(!stays);
            (!stays).then(|| next - 1)
        })
        .collect();
    let material = Elastic::new(2e4, 0.3).expect("a material");
    let k = stiffness(&mesh, &material, &numbers, next as usize);
    let mut factor = SupernodalCholesky::new(k.pattern(), 1).expect("room");
    factor.factor(k.pattern(), k.values()).expect("definite");
    let inside = POINTS.map(|point| mesh.locate(&Point3::from(point)).expect("inside"));
    let mut w = nalgebra::DMatrix::zeros(6, 6);
    for (one, (tet, weights)) in inside.iter().enumerate() {
        for axis in 0..3 {
            let mut column = vec![0.0; 3 * next as usize];
            for (node, weight) in mesh.tets()[*tet].iter().zip(weights) {
                column[3 * numbers[*node as usize].expect("free") as usize + axis] += weight;
            }
            factor.solve(&mut column);
            for (other, (tet, weights)) in inside.iter().enumerate() {
                for (node, weight) in mesh.tets()[*tet].iter().zip(weights) {
                    let at = 3 * numbers[*node as usize].expect("free") as usize;
                    (0..3).for_each(|to| w[(3 * other + to, 3 * one + axis)] += weight * column[at + to]);
                }
            }
        }
    }
    let world_from_bar = Isometry3::from_parts(
        Vector3::new(0.3, 0.2, 0.1).into(),
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), std::f64::consts::FRAC_PI_2),
    );
    let about = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), turned);
    let pivot = Vector3::new(0.33, 0.2, 0.12);
    let mut wanted = nalgebra::DVector::zeros(6);
    for (at, point) in POINTS.iter().enumerate() {
        let place = (world_from_bar * Point3::from(*point)).coords;
        let led = pivot + by + about * (place - pivot);
        let moved = world_from_bar.rotation.inverse() * (led - place);
        wanted.rows_mut(3 * at, 3).copy_from(&moved);
    }
    let exact = w.lu().solve(&wanted).expect("two points");
    let mut sum = 0.0;
    for (at, force) in forces.iter().enumerate() {
        let direct =
            world_from_bar.rotation * Vector3::from_column_slice(&exact.as_slice()[3 * at..3 * at + 3]);
        let error = (force - direct).norm() / direct.norm();
        assert!(error < 0.01, "point {at}: {force} N, {direct} N by a direct solve");
        assert!(error < 1e-4, "but for the rounding of a product the same: {error}");
        sum += force.norm();
    }
    assert!(sum > 1e-3 && (stage.measured("bar.pinned_force_n") - sum).abs() < 1e-12);
    assert_eq!(stage.measured("bar.contact_force_n"), 0.0, "nothing touches its surface");
    // The held points are at the hook.
    (0..12).for_each(|_| tick(&mut stage));
    let now = stage.get::<VertexPositions>("bar").positions;
    for (at, (tet, weights)) in inside.iter().enumerate() {
        let corners = mesh.tets()[*tet].iter().zip(weights);
        let place: Vector3<f64> = corners.map(|(node, weight)| now[*node as usize].coords * *weight).sum();
        let led = Vector3::from(POINTS[at]) + Vector3::from_column_slice(wanted.rows(3 * at, 3).as_slice());
        assert!((place - led).norm() < 1e-8, "point {at}: {place}, led to {led}");
    }
    // The control: an organ without instruments keeps its position.
    let mut free = Stage::new(scene(&bar("")), HZ, build);
    (0..3).for_each(|_| tick(&mut free));
    draw(&mut free, by, turned);
    tick(&mut free);
    assert!(felt(&free).is_empty() && free.measured("bar.displacement_max_m") == 0.0);
    assert!(!free.has::<PinPlaces>("bar"));
}

#[test]
fn another_life_holds_on_where_the_hook_was_driven_in_and_finds_the_same_to_the_bit() {
    let run = |kills: &[u32]| {
        let mut stage = Stage::new(scene(&pinned()), HZ, build);
        let mut kept = Vec::new();
        for step in 0..60_u32 {
            let along = f64::from(step.min(50)) / 50.0;
            draw(&mut stage, Vector3::new(0.001 * along, 0.0, 0.002 * along), 0.03 * along);
            tick(&mut stage);
            kept.push(stage.measured("bar.kept_constraints"));
            if kills.contains(&step) {
                stage.rebuild(build);
            }
        }
        (felt(&stage), stage.get::<VertexPositions>("bar").positions, kept)
    };
    let (forces, positions, kept) = run(&[]);
    // Their rows are computed once, and kept as long as they are held.
    assert!(kept[5..].iter().all(|kept| *kept == 2.0), "{kept:?}");
    for kills in [vec![0], vec![1, 2, 3], vec![30], vec![10, 40, 55]] {
        let (again, there, kept) = run(&kills);
        assert_eq!(again, forces, "killed after {kills:?}");
        assert_eq!(there, positions, "killed after {kills:?}");
        assert!(kept[kills[0] as usize + 1..].contains(&0.0), "the control: it does begin anew");
    }
}

#[test]
fn jaws_that_hold_beside_a_pin_come_and_go_and_every_life_finds_the_same_to_the_bit() {
    let text = r#"
[[entity]]
name = "pin"
pose = { translation = [0.0, 0.004, 0.0] }
[[entity]]
name = "grasper"
pose = { translation = [0.0, 0.0, 0.06], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "grasper", shaft_length = 0.1, shaft_radius = 0.0025, jaw_length = 0.012, jaws = 2, jaw_thickness = 0.002 }
[[entity]]
name = "bar"
mesh = { block = { size = [0.002, 0.02, 0.03], cells = [1, 6, 8] } }
linear_fem = { young_modulus = 5000.0 }
anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0149] } }] }
pinned = { with = [{ entity = "pin", points = [[0.0002, 0.0041, 0.0013]] }] }
"#;
    let turned = Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
    let run = |kills: &[u32]| {
        let mut stage = Stage::new(scene(text), HZ, build);
        let mut seen = Vec::new();
        for step in 0..40_u32 {
            // Opens around the fold, closes, lifts, and releases; the pin moves aside meanwhile.
            let (z, angle) = match step {
                0..6 => (0.02, 0.9),
                6..9 => (0.009, 0.9),
                9..12 => (0.009, 0.05),
                12..30 => (0.009 + 1e-4 * f64::from(step - 12), 0.05),
                _ => (0.03, 0.9),
            };
            let tip = Pose { translation: Vector3::new(0.0, 0.0, z), ..Pose::from(turned) };
            stage.put("grasper", tip);
            stage.put("grasper", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
            let aside = Vector3::new(2e-5 * f64::from(step), 0.004, 0.0);
            stage.put("pin", Pose { translation: aside, ..Pose::default() });
            tick(&mut stage);
            let held = [stage.measured("bar.held_vertices"), stage.measured("bar.kept_constraints")];
            seen.push((held, stage.measured("bar.pinned_force_n"), stage.get::<VertexPositions>("bar")));
            if kills.contains(&step) {
                stage.rebuild(build);
            }
        }
        seen
    };
    let whole = run(&[]);
    let held = |step: usize| whole[step].0;
    assert_eq!(held(8), [0.0, 1.0]);
    assert!(held(20)[0] > 2.0 && held(20)[1] > 2.0, "what jaws hold stays, too: {:?}", held(20));
    assert_eq!(held(35), [0.0, 1.0]);
    assert!(whole[35].1 > 1e-4);
    for kills in [vec![2], vec![15], vec![20, 21, 29]] {
        let again = run(&kills);
        let last = kills[kills.len() - 1] as usize + 2;
        for step in last + 8..40 {
            let ((_, one, there), (_, other, then)) = (&whole[step], &again[step]);
            assert_eq!((one, &there.positions), (other, &then.positions), "killed after {kills:?}, {step}");
        }
    }
}

#[test]
fn what_cannot_be_pinned_is_refused_by_name_and_what_burns_away_lets_go() {
    let refused = |with: &str| {
        let store = scene(&bar(&format!("pinned = {{ with = [{with}] }}")));
        let context = context(&store, trocar_scene::SimTime::ZERO, 1);
        match build(&context) {
            Ok(_) => panic!("{with} is not to be taken"),
            Err(error) => error.to_string(),
        }
    };
    // Points that are far from the mesh are refused while the scenario is read.
    let outside = refused("{ entity = \"hook\", points = [[0.0, 0.0, 0.0], [0.02, 0.0, 0.012]] }");
    for part in ["'bar'", "'hook'", "[0.02, 0, 0.012]", "2.0 mm outside"] {
        assert!(outside.contains(part), "{outside}");
    }
    let nobody = refused("{ entity = \"hooc\", points = [[0.0, 0.0, 0.0]] }");
    assert!(nobody.contains("'bar'") && nobody.contains("'hooc'"), "{nobody}");
    assert!(refused("{ entity = \"bar\", points = [[0.0, 0.0, 0.0]] }").contains("no other entity"));
    let stays = refused("{ entity = \"hook\", points = [[-0.05, 0.0, 0.0]] }");
    assert!(stays.contains("anchors hold it"), "{stays}");
    // Pins in bodies of other methods are rejected with a message.
    let pin = "pinned = { with = [{ entity = \"hook\", points = [[0.0, 0.0, 0.0]] }] }";
    let store =
        scene(&bar(pin).replace("linear_fem =", "dynamic_fem =").replace(", contact_radius = 0.008", ""));
    let refused =
        DynamicFemController::new(Vector3::zeros(), &context(&store, trocar_scene::SimTime::ZERO, 1));
    let refused = refused.err().expect("refused").to_string();
    assert!(refused.contains("'bar'") && refused.contains("'linear_fem' only"), "{refused}");

    let text = bar("pinned = { with = [] }");
    let parsed = std::panic::catch_unwind(|| scene(&text));
    assert!(parsed.is_err(), "no points at all");

    // A removed element no longer holds anything.
    let text = pinned().replace("pinned =", "cauterised = {}\npinned =");
    let mut stage = Stage::new(scene(&text), HZ, build);
    (0..4).for_each(|_| tick(&mut stage));
    draw(&mut stage, Vector3::new(0.0, 0.0, 0.001), 0.0);
    tick(&mut stage);
    assert_eq!(felt(&stage).len(), 2);
    let gone = mesh(&stage).locate(&Point3::from(POINTS[0])).expect("inside").0 as u32;
    stage.put("bar", RemovedElements { elements: std::sync::Arc::new(vec![gone]) });
    (0..6).for_each(|_| tick(&mut stage));
    assert_eq!(felt(&stage).len(), 1);
}
