//! Volumes that are burned through, cut or torn on a scene, by every method for volumes.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{
    BuildContext, Controller, ControllerError, Frozen, JawState, Pose, RestPositions, SurfaceMesh, TetMesh,
    VertexPositions, VertexVelocities,
};
use trocar_simulator::controller::{
    CoagulatedElement, CoagulatedElements, DynamicFemController, MassSpringController, RemovedElements,
    SurfaceElements, VolumeCuts, XpbdController,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
const XPBD: &str = "xpbd = { matter = { volume = { young_modulus = 2e4, poisson_ratio = 0.3, \
                    density = 1000.0 } }, parts = 30, damping = 5.0";
const FEM: &str =
    "dynamic_fem = { young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0, mass_damping = 5.0";

/// Springs, by implicit steps; blades always cut them.
const SPRINGS: &str = "mass_spring = { springs = { volume = { young_modulus = 2e4, density = 1000.0 } }, \
                       method = \"implicit\", damping = 5.0";

fn springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(GRAVITY, context)
}

fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(GRAVITY, context)
}

fn fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(GRAVITY, context)
}

/// A column of 2 cm by 2 cm by 6 cm that hangs from its upper end, and an instrument.
fn column(body: &str, more: &str, instrument: &str) -> String {
    format!(
        "[[entity]]\nname = \"tool\"\npose = {{ translation = [0.2, 0.0, 0.0] }}\n\
         instrument = {{ kind = \"{instrument}\", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.04, \
         jaws = 2 }}\n\
         [[entity]]\nname = \"column\"\ncauterised = {{}}\n\
         mesh = {{ block = {{ size = [0.02, 0.02, 0.06], cells = [3, 3, 9] }} }}\n{body}{more} }}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, 0.0299], max = [1.0, 1.0, 1.0] }} }}] }}\n"
    )
}

fn lowest<C: Controller>(stage: &Stage<C>) -> f64 {
    stage.get::<VertexPositions>("column").positions.iter().map(|p| p.z).fold(f64::INFINITY, f64::min)
}

fn run<C: Controller>(stage: &mut Stage<C>, ticks: u32) {
    (0..ticks).for_each(|_| stage.tick());
    assert!(!stage.has::<Frozen>("column"), "{}", stage.get::<Frozen>("column").reason);
}

/// Elements whose middle is in a layer.
fn within<C: Controller>(stage: &Stage<C>, low: f64, high: f64) -> Vec<u32> {
    let (mesh, rest) = (stage.get::<TetMesh>("column"), stage.get::<VertexPositions>("column"));
    let middle = |tet: &[u32; 4]| tet.iter().map(|&n| rest.positions[n as usize].z).sum::<f64>() / 4.0;
    (0..mesh.tets.len() as u32)
        .filter(|&tet| (low..high).contains(&middle(&mesh.tets[tet as usize])))
        .collect()
}

fn removed(elements: &[u32]) -> RemovedElements {
    RemovedElements { elements: Arc::new(elements.to_vec()) }
}

type State = (Arc<Vec<Point3<f64>>>, Arc<Vec<Vector3<f64>>>, Arc<Vec<[u32; 3]>>);

fn state<C: Controller>(stage: &Stage<C>) -> State {
    (
        stage.get::<VertexPositions>("column").positions,
        stage.get::<VertexVelocities>("column").velocities,
        stage.get::<SurfaceMesh>("column").triangles,
    )
}

fn burns_through<C: Controller>(
    body: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let run_it = |kill: bool| {
        let mut stage = Stage::new(scene(&column(body, "", "probe")), 200.0, build);
        let layer = within(&stage, -0.003, 0.003);
        let all = stage.get::<TetMesh>("column").tets.len();
        run(&mut stage, 20);
        let before = lowest(&stage);
        let triangles = stage.get::<SurfaceMesh>("column").triangles.len();
        // Half of the layer: the body still holds, and former interior faces are on the surface.
        let half = &layer[..layer.len() / 2];
        stage.put("column", removed(half));
        run(&mut stage, 10);
        assert_eq!(stage.measured("column.elements_left"), (all - half.len()) as f64);
        assert!(stage.get::<SurfaceMesh>("column").triangles.len() > triangles);
        if kill {
            stage.rebuild(build);
        }
        run(&mut stage, 10);
        assert!(lowest(&stage) > before - 0.006, "it hangs by the rest: {}", lowest(&stage));
        stage.put("column", removed(&layer));
        run(&mut stage, 30);
        assert_eq!(stage.measured("column.pieces"), 2.0);
        // It falls freely: half of g t² in 30 ticks.
        let fallen = before - lowest(&stage);
        assert!((0.05..0.16).contains(&fallen), "{fallen} m");
        // Unused nodes keep their positions, and the surface is closed.
        let edges = |corners: &[u32; 3]| [0, 1, 2].map(|k| [corners[k], corners[(k + 1) % 3]]);
        let mut open: Vec<[u32; 2]> =
            stage.get::<SurfaceMesh>("column").triangles.iter().flat_map(edges).collect();
        open.sort_unstable();
        for edge in &open {
            assert!(open.binary_search(&[edge[1], edge[0]]).is_ok(), "{edge:?} has one side");
        }
        state(&stage)
    };
    assert_eq!(run_it(true), run_it(false), "another life goes on to the bit");
}

#[test]
fn a_column_that_is_burned_through_comes_down() {
    burns_through(XPBD, xpbd);
    burns_through(FEM, fem);
    burns_through(SPRINGS, springs);
}

fn coagulates<C: Controller>(
    body: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    // Sag, by stiffness and rest length of its elements.
    let hangs = |stiffness: f64, length: f64, kill: bool| {
        let mut stage = Stage::new(scene(&column(body, "", "probe")), 200.0, build);
        let all = 0..stage.get::<TetMesh>("column").tets.len() as u32;
        stage.tick();
        let elements = all.map(|element| CoagulatedElement { element, stiffness, length }).collect();
        stage.put("column", CoagulatedElements { elements: Arc::new(elements) });
        run(&mut stage, 300);
        if kill {
            stage.rebuild(build);
        }
        run(&mut stage, 300);
        (lowest(&stage), state(&stage))
    };
    let sag = |low: f64| -0.03 - low;
    let (soft, stiff) = (sag(hangs(1.0, 1.0, false).0), sag(hangs(4.0, 1.0, false).0));
    assert!(soft > 3e-4, "{soft} m");
    assert!((soft / stiff - 4.0).abs() < 0.2, "{soft} m against {stiff} m");
    // The upper end is held and cannot become narrower; below it shrinks in width and length.
    let (low, whole) = hangs(4.0, 0.9, false);
    let shrunk = low + 0.03;
    assert!((shrunk - 0.1 * 0.06).abs() < 6e-4, "{shrunk} m");
    assert_eq!(hangs(4.0, 0.9, true).1, whole, "another life goes on to the bit");
}

#[test]
fn coagulated_elements_are_stiffer_and_shorter() {
    coagulates(XPBD, xpbd);
    coagulates(FEM, fem);
    coagulates(SPRINGS, springs);
}

/// `cut` enables cutting, `halved` tells whether elements are subdivided.
fn is_cut<C: Controller>(
    body: &str,
    cut: &str,
    halved: bool,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    // Closed blades of 4 cm that point along y, from beside the column through it within 40 ticks.
    let sweep = |more: &str, angle: f64, kill: bool| {
        let mut stage = Stage::new(scene(&column(body, more, "scissors")), 200.0, build);
        let turned = nalgebra::UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::y())
            .expect("a quarter of a turn");
        // Halfway between layers of nodes, or, where nothing is to be halved, nearly at one.
        let height = if halved { -0.0067 } else { -0.0041 };
        let tool = |x: f64| Pose::from(Isometry3::from_parts(Vector3::new(x, 0.02, height).into(), turned));
        stage.put("tool", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
        stage.put("tool", tool(-0.015));
        // It has come to rest.
        run(&mut stage, 300);
        for tick in 0..40_u32 {
            if kill && tick == 17 {
                stage.rebuild(build);
            }
            stage.put("tool", tool(-0.015 + 0.03 * f64::from(tick) / 39.0));
            run(&mut stage, 1);
        }
        run(&mut stage, 30);
        (stage.get::<VertexPositions>("column").positions.len(), lowest(&stage), state(&stage), stage)
    };
    let nodes = 4 * 4 * 10;
    let (count, low, whole, mut stage) = sweep(cut, 0.0, false);
    assert_eq!(stage.measured("column.pieces"), 2.0);
    assert!(count > nodes && low < -0.06, "{count} vertices, down to {low} m");
    // Volume and mass are unchanged: no element is missing.
    assert_eq!(stage.measured("column.elements_left"), stage.get::<TetMesh>("column").tets.len() as f64);
    let cuts = stage.get::<VolumeCuts>("column");
    assert_eq!(cuts.births.len(), count - nodes);
    let rest = stage.get::<RestPositions>("column").positions;
    for (node, birth) in cuts.births.iter().enumerate() {
        let between = birth.mix(&rest, |a, b, share| a + (b - a) * share);
        assert_eq!(rest[nodes + node], between, "a new vertex is where it was at rest");
    }
    assert_eq!(sweep(cut, 0.0, true).2, whole, "another life goes on to the bit");
    assert_eq!(!cuts.parts_of.is_empty(), halved);
    if halved {
        burns_where_it_was_cut(&mut stage, build);
    }
    // The controls: open blades, and a body that cannot be cut.
    for (more, angle) in [(cut, 0.6)].into_iter().chain((!cut.is_empty()).then_some(("", 0.0))) {
        let (count, low, ..) = sweep(more, angle, false);
        assert!(count == nodes && low > -0.04, "{more} {angle}: {count} vertices, down to {low} m");
    }
}

/// The lips are where the blades passed, and burning an element of the original mesh removes all its parts.
fn burns_where_it_was_cut<C: Controller>(
    stage: &mut Stage<C>,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let cuts = stage.get::<VolumeCuts>("column");
    let rest = stage.get::<RestPositions>("column").positions;
    let first = rest.len() - cuts.births.len();
    let halves = cuts.births.iter().zip(&rest[first..]).filter(|(birth, _)| birth.of[0] != birth.of[1]);
    let heights: Vec<f64> = halves.map(|(_, place)| place.z).collect();
    let mean = heights.iter().sum::<f64>() / heights.len() as f64;
    let off = heights.iter().map(|z| (z - mean).abs()).fold(0.0, f64::max);
    // Elements have edges of 7 mm; the hanging column bulges slightly.
    assert!(heights.len() > 20 && off < 6e-4, "{} nodes up to {off} m from a plane", heights.len());
    let of = cuts.parts_of[0];
    let parts = cuts.parts_of.iter().filter(|part| **part == of).count();
    let left = stage.measured("column.elements_left");
    stage.put("column", removed(&[of]));
    run(stage, 2);
    assert_eq!(stage.measured("column.elements_left"), left - 1.0 - parts as f64);
    stage.rebuild(build);
    run(stage, 2);
    assert_eq!(stage.measured("column.elements_left"), left - 1.0 - parts as f64, "in another life too");
}

#[test]
fn closed_blades_that_pass_through_a_column_cut_it_through() {
    is_cut(XPBD, ", cut = true", true, xpbd);
    is_cut(FEM, ", cut = true", true, fem);
    is_cut(SPRINGS, "", true, springs);
    // Halved elements would need shorter steps: explicit springs separate between elements.
    is_cut(&SPRINGS.replace("implicit", "explicit"), "", false, springs);
}

fn tears<C: Controller>(body: &str, build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy) {
    // Its own weight pulls with 590 Pa at the top; on the way to rest with some more, and about corners.
    let hangs = |strength: f64| {
        let mut stage =
            Stage::new(scene(&column(body, &format!(", strength = {strength:e}"), "probe")), 200.0, build);
        run(&mut stage, 120);
        (stage.measured("column.pieces"), stage.measured("column.torn_faces"), lowest(&stage))
    };
    let (pieces, torn, low) = hangs(300.0);
    assert!(pieces >= 2.0 && torn >= 18.0 && low < -0.1, "{pieces} pieces, {torn} faces, {low} m");
    let (pieces, torn, low) = hangs(5e3);
    assert_eq!((pieces, torn), (1.0, 0.0));
    assert!(low > -0.04, "{low} m");
}

#[test]
fn what_is_weaker_than_its_weight_tears() {
    tears(XPBD, xpbd);
    tears(FEM, fem);
    tears(SPRINGS, springs);
    tears(&SPRINGS.replace("implicit", "explicit"), springs);
}

#[test]
fn springs_tear_by_what_is_of_their_mesh() {
    let refused = |text: &str| {
        let store = scene(text);
        let context = BuildContext {
            scene: store.view(),
            time: trocar_scene::SimTime::ZERO,
            period: trocar_scene::SimTime::from_millis(1),
            name: "springs",
            me: trocar_scene::Entity::of_writer(0, 7),
            epoch: 1,
            seed: 1,
        };
        springs(&context).err().map(|error| error.to_string()).unwrap_or_default()
    };
    let volume = refused(&column(SPRINGS, ", tears_at = 1.5", "probe"));
    assert!(volume.contains("'column'") && volume.contains("a volume has a 'strength'"), "{volume}");
    let cloth = refused(&membrane("mass_spring = { strength = 300.0 }", ""));
    assert!(cloth.contains("surfaces and lines have 'tears_at'"), "{cloth}");
}

/// A membrane of 4 cm that is held along its four edges and sags.
fn membrane(body: &str, cauterised: &str) -> String {
    format!(
        "[[entity]]\nname = \"column\"\n{cauterised}\n\
         mesh = {{ sheet = {{ size = [0.04, 0.04], cells = [16, 16] }} }}\n{body}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [-0.0199, 1.0, 1.0] }} }},\n\
         {{ box = {{ min = [0.0199, -1.0, -1.0], max = [1.0, 1.0, 1.0] }} }}] }}\n"
    )
}

fn burns_as_a_membrane<C: Controller>(
    body: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let run_it = |kill: bool, length: f64| {
        let text = membrane(body, "cauterised = { thickness = 0.001 }");
        let mut stage = Stage::new(scene(&text), 500.0, build);
        let first = stage.get::<SurfaceMesh>("column").triangles;
        let rest = stage.get::<VertexPositions>("column").positions;
        run(&mut stage, 100);
        let (hanging, middle) = (lowest(&stage), 8 * 17 + 8);
        let drawn = |stage: &Stage<C>| stage.get::<VertexPositions>("column").positions[middle].x;
        assert!(hanging < -1e-4 && drawn(&stage).abs() < 1e-4, "{hanging} m, {} m", drawn(&stage));
        // The left half shrinks and pulls the middle towards itself.
        let left = first.iter().enumerate().filter(|(_, t)| t.iter().all(|&n| rest[n as usize].x < 1e-6));
        let elements =
            left.map(|(at, _)| CoagulatedElement { element: at as u32, stiffness: 3.0, length }).collect();
        stage.put("column", CoagulatedElements { elements: Arc::new(elements) });
        run(&mut stage, 200);
        let drawn = drawn(&stage);
        // A strip in the middle is removed: two flaps hang from two edges.
        let strip = |t: &[u32; 3]| t.iter().all(|&n| rest[n as usize].x.abs() < 0.0026);
        let gone: Vec<u32> = (0..first.len() as u32).filter(|&t| strip(&first[t as usize])).collect();
        assert_eq!(gone.len(), 2 * 2 * 16);
        stage.put("column", removed(&gone));
        if kill {
            stage.rebuild(build);
        }
        run(&mut stage, 150);
        let left = stage.get::<SurfaceMesh>("column").triangles;
        assert_eq!(left.len(), first.len() - gone.len());
        assert!(left.iter().all(|triangle| !strip(triangle)));
        assert!(lowest(&stage) < -0.01, "the flaps fall: {} m", lowest(&stage));
        let moved = stage.get::<VertexPositions>("column").positions;
        let column = (0..17).map(|row| row * 17 + 8);
        assert!(column.clone().all(|node| moved[node].iter().all(|x| x.is_finite())));
        (drawn, state(&stage))
    };
    let (drawn, whole) = run_it(false, 0.8);
    assert!(drawn < -0.001, "drawn by {drawn} m");
    assert!(run_it(false, 1.0).0 > -5e-4, "the control: what does not shrink does not draw");
    assert_eq!(run_it(true, 0.8).1, whole, "another life goes on to the bit");
}

#[test]
fn a_membrane_that_burns_shrinks_and_comes_apart() {
    let springs = "membrane_stiffness = 60.0, bending_stiffness = 1e-6, density = 1.0";
    burns_as_a_membrane(
        &format!("mass_spring = {{ springs = {{ surface = {{ {springs} }} }}, damping = 10.0 }}"),
        |context| MassSpringController::new(GRAVITY, context),
    );
    burns_as_a_membrane(
        &format!("xpbd = {{ matter = {{ cloth = {{ {springs} }} }}, damping = 10.0, parts = 8 }}"),
        xpbd,
    );
}

/// A membrane burned in its middle is cut beside that, by blades that point along y.
fn is_cut_as_a_membrane<C: Controller>(
    body: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let tool = "[[entity]]\nname = \"tool\"\npose = { translation = [0.2, 0.0, 0.0] }\n\
                instrument = { kind = \"scissors\", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.06, \
                jaws = 2 }\n";
    let run_it = |kill: bool, angle: f64| {
        let text = format!("{tool}{}", membrane(body, "cauterised = { thickness = 0.001 }"));
        let mut stage = Stage::new(scene(&text), 500.0, build);
        let turned = nalgebra::UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::y())
            .expect("a quarter of a turn");
        let place = |z: f64| Pose::from(Isometry3::from_parts(Vector3::new(0.0088, 0.03, z).into(), turned));
        stage.put("tool", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
        stage.put("tool", place(0.005));
        let first = stage.get::<SurfaceMesh>("column").triangles;
        run(&mut stage, 100);
        let hole: Vec<u32> = (0..2).flat_map(|row| [7, 8].map(|cell| 2 * ((row + 7) * 16 + cell))).collect();
        stage.put("column", removed(&hole));
        run(&mut stage, 10);
        for tick in 0..30_u32 {
            if kill && tick == 14 {
                stage.rebuild(build);
            }
            stage.put("tool", place(0.005 - 0.02 * f64::from(tick) / 29.0));
            run(&mut stage, 1);
        }
        // The elements burned now are parts of original elements divided by the blades.
        let cuts = stage.get::<SurfaceElements>("column");
        let mut divided = cuts.elements.to_vec();
        divided.sort_unstable();
        let divided = divided.windows(2).find(|two| two[0] == two[1]).map(|two| two[0]);
        let triangles = stage.get::<SurfaceMesh>("column").triangles.len();
        if let Some(element) = divided {
            let parts = cuts.elements.iter().filter(|of| **of == element).count();
            stage.put("column", removed(&[&hole[..], &[element]].concat()));
            run(&mut stage, 2);
            assert_eq!(stage.get::<SurfaceMesh>("column").triangles.len(), triangles - parts);
        }
        run(&mut stage, 150);
        let grown = stage.get::<VertexPositions>("column").positions.len();
        assert_eq!(grown, 17 * 17 + cuts.births.len());
        (stage.measured("column.pieces"), lowest(&stage), triangles > first.len() - hole.len(), state(&stage))
    };
    let (pieces, low, divided, whole) = run_it(false, 0.0);
    assert!(pieces >= 2.0 && low < -0.01 && divided, "{pieces} pieces, down to {low} m");
    assert_eq!(run_it(true, 0.0).3, whole, "another life goes on to the bit");
    let (pieces, low, divided, _) = run_it(false, 0.6);
    assert!(pieces == 1.0 && low > -0.005 && !divided, "open blades: {pieces} pieces, down to {low} m");
}

#[test]
fn a_membrane_that_has_burned_is_cut_and_one_that_was_cut_burns() {
    let springs = "membrane_stiffness = 60.0, bending_stiffness = 1e-6, density = 1.0";
    is_cut_as_a_membrane(
        &format!("mass_spring = {{ springs = {{ surface = {{ {springs} }} }}, damping = 10.0 }}"),
        crate::cutting::volume::springs,
    );
    is_cut_as_a_membrane(
        &format!(
            "xpbd = {{ matter = {{ cloth = {{ {springs} }} }}, damping = 10.0, parts = 8, cut = true }}"
        ),
        xpbd,
    );
}

#[test]
fn what_burns_otherwise_than_it_moves_is_refused() {
    let refused = |text: &str| {
        let store = scene(text);
        let stage = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| Stage::new(store, 100.0, xpbd)));
        let why = stage.err().expect("refused");
        why.downcast::<String>().map(|why| *why).unwrap_or_default()
    };
    let cloth = "xpbd = { matter = { cloth = { membrane_stiffness = 60.0, bending_stiffness = 1e-6, \
                 density = 1.0 } } }";
    assert!(refused(&membrane(cloth, "cauterised = {}")).contains("give 'cauterised' its 'thickness'"));
    let strong = cloth.replace("} } }", "} }, strength = 1e3 }");
    assert!(refused(&membrane(&strong, "")).contains("cloth 'tears_at'"));
    let volume = column(XPBD, "", "probe").replace("cauterised = {}", "cauterised = { thickness = 0.001 }");
    assert!(refused(&volume).contains("has no 'thickness'"));
}
