//! Simulators as controllers on a scene: their inputs, their outputs, and restarts.

use std::collections::BTreeSet;

use crate::support::stage::{Stage, scene};
use nalgebra::Vector3;
use trocar_dynamics::soft_body::grasp::Grips;
use trocar_scene::{
    Activation, BuildContext, Burn, CollisionList, Controller, ControllerError, Frozen, InstrumentForce,
    InstrumentTarget, JawState, LocalContactModel, OutOfValidity, Pose, RestPositions, SurfaceMesh,
    Temperature, VertexPositions,
};
use trocar_simulator::controller::xpbd::component::Matter;
use trocar_simulator::controller::{
    CauterisedBody, DynamicFemBody, DynamicFemController, ElectrosurgeryController, InstrumentsConfig,
    InstrumentsController, LinearFemBody, MassSpringController, XpbdBody, XpbdController,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// A rod that points down, with its origin at its tip.
const ROD: &str = r#"
[[entity]]
name = "rod"
pose = { translation = [0.0, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "hook_cautery", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.004, jaws = 0 }
"#;

fn down(x: f64, y: f64, z: f64) -> Pose {
    Pose {
        translation: Vector3::new(x, y, z),
        ..Pose::from(nalgebra::Isometry3::rotation(Vector3::x() * std::f64::consts::PI))
    }
}

#[test]
fn an_electrode_heats_burns_and_removes_while_it_is_switched_on_and_another_life_goes_on() {
    let text = format!(
        "{ROD}electrode = {{ power = 30.0, contact_area = 1e-6 }}\n\
         [[entity]]\nname = \"fold\"\nmesh = {{ sheet = {{ size = [0.02, 0.02], cells = [20, 20] }} }}\n\
         cauterised = {{ thickness = 0.001 }}\n"
    );
    let mut stage = Stage::new(scene(&text), 100.0, ElectrosurgeryController::new);
    let before = stage.get::<SurfaceMesh>("fold").triangles.len();
    stage.put("rod", down(0.0, 0.0, 0.0005));
    stage.tick();
    assert_eq!(stage.measured("fold.heat_supplied_j"), 0.0, "it is off");
    stage.put("rod", Activation { level: 1.0, since: stage.now(), mode: None });
    for _ in 0..20 {
        stage.tick();
    }
    assert!(stage.measured("fold.heat_supplied_j") > 1.0, "{}", stage.measured("fold.heat_supplied_j"));
    let hottest = stage.get::<Temperature>("fold").celsius.iter().copied().fold(0.0, f64::max);
    assert!(hottest > 60.0, "{hottest} °C");
    assert!(stage.get::<Burn>("fold").omega.iter().any(|omega| *omega > 1.0));
    let (supplied, removed) =
        (stage.measured("fold.heat_supplied_j"), stage.measured("fold.removed_volume_m3"));
    stage.rebuild(ElectrosurgeryController::new);
    for _ in 0..20 {
        stage.tick();
    }
    assert!(stage.measured("fold.heat_supplied_j") > supplied, "it goes on from there");
    assert!(stage.measured("fold.removed_volume_m3") > removed);
    assert!(stage.get::<SurfaceMesh>("fold").triangles.len() < before, "there is a hole");
    assert!(stage.measured("fold.heat_missing_share") < 0.01);
    assert!(!stage.has::<Frozen>("fold"));
}

/// Draws a hook of 30 W along x at 4 mm/s for a second; returns the heat absorbed by each body \[J\] and the volume
/// removed from it \[mm³\].
fn drawn_over(entities: &str, bodies: &[&str], z: f64) -> Vec<[f64; 2]> {
    let text = format!("{ROD}electrode = {{ power = 30.0, contact_area = 1e-6 }}\n{entities}");
    let mut stage = Stage::new(scene(&text), 100.0, ElectrosurgeryController::new);
    stage.put("rod", Activation { level: 1.0, since: stage.now(), mode: None });
    for tick in 0..100 {
        stage.put("rod", down(-0.002 + 4e-5 * f64::from(tick), 0.0001, z));
        stage.tick();
    }
    let measured = |body: &&str| {
        assert!(stage.measured(&format!("{body}.heat_missing_share")) < 0.01);
        let of = |what: &str| stage.measured(&format!("{body}.{what}"));
        [of("heat_supplied_j"), 1e9 * of("removed_volume_m3")]
    };
    bodies.iter().map(measured).collect()
}

#[test]
fn bodies_that_one_tip_is_at_share_what_the_generator_gives_and_one_alone_gets_all() {
    let block = |name: &str, y: f64| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [0.0, {y}, -0.0055] }}\ncauterised = {{}}\n\
             mesh = {{ block = {{ size = [0.02, 0.01, 0.01], cells = [10, 5, 5] }} }}\n"
        )
    };
    let fold = "[[entity]]\nname = \"fold\"\ncauterised = { thickness = 0.001 }\n\
                mesh = { sheet = { size = [0.02, 0.02], cells = [40, 40] } }\n";
    // Its top is at −0.5 mm.
    let alone = drawn_over(&block("a", 0.0), &["a"], -0.0005)[0];
    assert!((20.0..=30.3).contains(&alone[0]) && (5.0..15.0).contains(&alone[1]), "{alone:?}");
    let sum = |of: &[[f64; 2]]| of.iter().fold([0.0, 0.0], |sum, one| [sum[0] + one[0], sum[1] + one[1]]);
    // Along the seam of two: half to each.
    let seam = format!("{}{}", block("a", -0.0049), block("b", 0.0051));
    let seam = drawn_over(&seam, &["a", "b"], -0.0005);
    assert!(seam.iter().all(|one| one[0] > 0.3 * sum(&seam)[0]), "{seam:?}");
    // Through a membrane on another body: first the membrane, then the body beneath.
    let laid = format!("{fold}{}", block("a", 0.0));
    let laid = drawn_over(&laid, &["fold", "a"], -0.0002);
    assert!(laid.iter().all(|one| one[0] > 1.0), "{laid:?}");
    for both in [sum(&seam), sum(&laid)] {
        assert!((20.0..=30.3).contains(&both[0]), "{both:?} J and mm³ of 30 J");
        assert!((5.0..=15.0).contains(&both[1]), "{both:?} J and mm³ in a second");
        assert!(both[1] < 1.3 * alone[1], "{both:?}, and {alone:?} alone");
    }
    // Two such controllers would each supply the heat; both write the same component, which is refused.
    let store = scene(&format!("{ROD}{fold}"));
    let rules = [7, 8].map(|me| {
        let me = trocar_scene::Entity::of_writer(0, me);
        let (scene, time) = (store.view(), trocar_scene::SimTime::ZERO);
        let period = trocar_scene::SimTime::from_millis(1);
        let context = trocar_scene::BuildContext { scene, time, period, name: "heat", me, epoch: 1, seed: 1 };
        let controller = ElectrosurgeryController::new(&context).expect("a membrane");
        let access = trocar_scene::Controller::access(&controller);
        trocar_scene::WriterRules::compile(&access, scene.registry(), me).expect("its access is right")
    });
    assert!(rules[0].overlap(&rules[1]).is_some());
}

/// A rod pressed on a soft body deforms it, and gets the reaction force.
fn pressed<C: trocar_scene::Controller>(
    mut stage: Stage<C>,
    body: &str,
    top: f64,
    secs: f64,
    hz: f64,
) -> Stage<C> {
    let ticks = (secs * hz) as u64;
    for tick in 0..ticks {
        let share = tick as f64 / ticks as f64;
        stage.put("rod", down(0.0, 0.0, top + 0.004 - 0.010 * share));
        stage.tick();
    }
    assert!(!stage.has::<Frozen>(body), "{}", stage.get::<Frozen>(body).reason);
    let lowest =
        stage.get::<VertexPositions>(body).positions.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    assert!(lowest.is_finite());
    let lists: Vec<CollisionList> =
        stage.store.view().iter::<CollisionList>().map(|(_, list)| list.clone()).collect();
    let force: Vector3<f64> = lists.iter().flat_map(|list| &list.collisions).map(|c| c.force_in_world).sum();
    assert!(force.z < -1e-3, "the body is pushed down by {} N", force.z);
    stage
}

const GAUZE: &str = r#"
[[entity]]
name = "gauze"
mesh = { sheet = { size = [0.06, 0.06], cells = [20, 20] } }
mass_spring = { method = "implicit" }
anchors = { regions = [{ box = { min = [-0.04, 0.029, -1.0], max = [0.04, 0.04, 1.0] } }, { box = { min = [-0.04, -0.04, -1.0], max = [0.04, -0.029, 1.0] } }] }
"#;

#[test]
fn a_gauze_gives_way_to_a_rod_and_goes_on_to_the_bit_in_another_life() {
    let build = |context: &trocar_scene::BuildContext<'_>| MassSpringController::new(GRAVITY, context);
    let ends = ["node_blocks", "warped", "auto"].map(|solver| {
        let gauze = GAUZE.replace("\"implicit\" }", &format!("\"implicit\", solver = \"{solver}\" }}"));
        assert_ne!(gauze, GAUZE);
        let stage = || Stage::new(scene(&format!("{ROD}{gauze}")), 100.0, build);
        let whole = pressed(stage(), "gauze", 0.0, 0.5, 100.0);
        let mut one = stage();
        for tick in 0..50_u64 {
            if tick == 25 {
                one.rebuild(build);
            }
            one.put("rod", down(0.0, 0.0, 0.004 - 0.010 * (tick as f64 / 50.0)));
            one.tick();
        }
        let [a, b] = [&whole, &one].map(|stage| stage.get::<VertexPositions>("gauze"));
        assert_eq!(a, b, "{solver}");
        let corner = a.positions[0];
        assert!((corner - nalgebra::Point3::new(-0.03, -0.03, 0.0)).norm() < 1e-15, "anchors hold: {corner}");
        a.positions
    });
    // Whatever the linear solver, the rod has pressed by 6 mm.
    let far = ends[0].iter().zip(ends[1].iter()).map(|(one, other)| (one - other).norm()).fold(0.0, f64::max);
    assert!(far < 1e-4, "{far} m");
    assert_eq!(ends[0], ends[2], "in steps of 10 ms the nodes' own blocks suit");
}

const PAD: &str = r#"
[[entity]]
name = "pad"
pose = { translation = [0.0, 0.0, -0.01] }
mesh = { block = { size = [0.04, 0.04, 0.02], cells = [8, 8, 4] } }
dynamic_fem = { young_modulus = 5000.0 }
anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] } }] }
"#;

#[test]
fn a_pad_of_finite_elements_gives_way_to_a_rod() {
    let build = |context: &trocar_scene::BuildContext<'_>| DynamicFemController::new(GRAVITY, context);
    let stage = pressed(Stage::new(scene(&format!("{ROD}{PAD}")), 100.0, build), "pad", 0.0, 0.4, 100.0);
    let moved = stage.measured("pad.displacement_max_m");
    assert!((0.001..0.01).contains(&moved), "{moved} m");
}

/// Two jaws that point down.
const GRASPER: &str = r#"
[[entity]]
name = "rod"
pose = { translation = [0.0, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }
instrument = { kind = "grasper", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.01, jaws = 2 }
"#;

fn jaws(angle: f64) -> JawState {
    JawState { angle, ..JawState::default() }
}

/// Rise of the held vertices, of their neighbours, and of the neighbours of those \[m\].
fn rises<C: trocar_scene::Controller>(stage: &Stage<C>, body: &str) -> [f64; 3] {
    let grips = stage.get::<Grips>(body).picks.picks;
    let mut inner: BTreeSet<u32> =
        grips.iter().flat_map(|pick| &pick.vertices).map(|held| held.vertex).collect();
    let (now, rest) =
        (stage.get::<VertexPositions>(body).positions, stage.get::<RestPositions>(body).positions);
    let triangles = stage.get::<SurfaceMesh>(body).triangles;
    let mean = |ring: &BTreeSet<u32>| {
        let rise = ring.iter().map(|&vertex| now[vertex as usize].z - rest[vertex as usize].z);
        rise.sum::<f64>() / ring.len() as f64
    };
    let mut ring = inner.clone();
    [0, 1, 2].map(|_| {
        let risen = mean(&ring);
        let about = triangles.iter().filter(|corners| corners.iter().any(|corner| ring.contains(corner)));
        ring = about.flatten().copied().filter(|vertex| !inner.contains(vertex)).collect();
        inner.extend(&ring);
        risen
    })
}

/// Jaws that close on a body lift it, feel its pull, hold it after a restart, and release it when they open.
fn lifted<C: trocar_scene::Controller>(
    body: &str,
    text: &str,
    deep: f64,
    build: impl Fn(&trocar_scene::BuildContext<'_>) -> Result<C, trocar_scene::ControllerError>,
) {
    let mut stage = Stage::new(scene(&format!("{GRASPER}{text}")), 100.0, &build);
    let held = |stage: &Stage<C>| stage.measured(&format!("{body}.held_vertices"));
    stage.put("rod", jaws(0.6));
    stage.put("rod", down(0.0, 0.0, -deep));
    for _ in 0..5 {
        stage.tick();
    }
    assert_eq!(held(&stage), 0.0, "open jaws hold nothing");
    stage.put("rod", jaws(0.0));
    stage.tick();
    stage.tick();
    let vertices = held(&stage);
    assert!(vertices >= 3.0, "{vertices}");
    for tick in 0..50 {
        if tick == 25 {
            stage.rebuild(&build);
        }
        stage.put("rod", down(0.0, 0.0, -deep + 0.0001 * f64::from(tick)));
        stage.tick();
    }
    assert_eq!(held(&stage), vertices, "another life holds the same");
    let pulled = stage.measured(&format!("{body}.held_force_n"));
    assert!(pulled > 1e-3, "{pulled} N");
    let (rod, entity) = (stage.entity("rod"), stage.entity(body));
    let lists: Vec<CollisionList> =
        stage.store.view().iter::<CollisionList>().map(|(_, list)| list.clone()).collect();
    let grip = lists.iter().flat_map(|list| &list.collisions).find(|c| c.a == rod && c.b == entity);
    let grip = grip.expect("everybody sees the grip");
    assert!(grip.force_in_world.z > 0.9 * pulled && grip.depth > 0.002, "{grip:?}");
    let [held_rise, near, far] = rises(&stage, body);
    assert!(held_rise > 0.002, "{held_rise} m");
    assert!(near > 0.25 * held_rise && near < held_rise, "neighbours rise by {near} m with {held_rise} m");
    assert!(far > 0.0 && far < near, "and those beyond by {far} m");
    stage.put("rod", jaws(0.6));
    stage.tick();
    assert_eq!((held(&stage), stage.measured(&format!("{body}.held_force_n"))), (0.0, 0.0));
    assert!(!stage.has::<Frozen>(body));
}

#[test]
fn jaws_lift_a_gauze_and_feel_its_pull() {
    lifted("gauze", GAUZE, 0.0008, |context| MassSpringController::new(GRAVITY, context));
}

#[test]
fn jaws_lift_a_fold_of_finite_elements_and_feel_its_pull() {
    lifted("pad", PAD, 0.0015, |context| DynamicFemController::new(GRAVITY, context));
}

#[test]
fn an_instrument_is_told_what_pushes_it() {
    let store = scene(&format!("{ROD}{GAUZE}"));
    let mut stage = Stage::new(store, 1000.0, |context| {
        InstrumentsController::new(InstrumentsConfig::default(), context)
    });
    let target = InstrumentTarget { tip_in_world: down(0.0, 0.0, -0.002), ..InstrumentTarget::default() };
    stage.put("rod", target);
    stage.tick();
    assert_eq!(stage.get::<Pose>("rod"), target.tip_in_world);
    assert_eq!(stage.get::<InstrumentForce>("rod").force, Vector3::zeros());
    // An external contact: the gauze is pushed down by 0.5 N, at a depth of 1 mm.
    let (rod, gauze) = (stage.entity("rod"), stage.entity("gauze"));
    let collision = trocar_scene::Collision {
        a: rod,
        primitive_a: trocar_scene::Primitive::Shaft,
        b: gauze,
        primitive_b: trocar_scene::Primitive::Triangle(3),
        points_in_world: [nalgebra::Point3::new(0.0, 0.0, -0.002); 2],
        normal_in_world: -Vector3::z(),
        depth: 0.001,
        force_in_world: Vector3::new(0.0, 0.0, -0.5),
        velocity_constraint: 0.0,
        method: trocar_scene::Detection::Simulator,
        detected_at: stage.now(),
    };
    stage.put("gauze", CollisionList { collisions: vec![collision], penetration_max: 0.001 });
    stage.tick();
    let force = stage.get::<InstrumentForce>("rod").force;
    assert!((force - Vector3::new(0.0, 0.0, 0.5)).norm() < 1e-12, "{force}");
    let plane = stage.get::<LocalContactModel>("rod").planes[0].expect("a plane");
    assert!((plane.stiffness - 500.0).abs() < 1e-9 && (plane.normal_in_world - Vector3::z()).norm() < 1e-12);
    // At the present position of the tip it pushes with the contact's force.
    assert!(((plane.point_in_world.z - -0.002) * plane.stiffness - 0.5).abs() < 1e-12);
}

#[test]
fn a_tissue_fills_in_what_its_components_leave_open_and_doubts_what_it_is_known_not_to_be() {
    let body = |kinds: &str| {
        format!(
            "[[entity]]\nname = \"organ\"\ntissue = \"liver\"\nmesh = {{ block = {{ size = [0.02, 0.02, 0.02], cells = [2, 2, 2] }} }}\n{kinds}\n"
        )
    };
    let has = |kinds: &str| {
        let store = scene(&body(kinds));
        let organ = store.view().iter::<trocar_scene::Tissue>().next().expect("an organ").0;
        (store.snapshot(), organ)
    };
    let (snapshot, organ) = has("linear_fem = {}\ndynamic_fem = { young_modulus = 6000.0 }\n\
         xpbd = { matter = { volume = {} } }\ncauterised = {}");
    let organ_of_liver = organ;
    let linear = snapshot.get::<LinearFemBody>(organ).expect("one").young_modulus;
    let dynamic = *snapshot.get::<DynamicFemBody>(organ).expect("one");
    assert_eq!((linear, dynamic.young_modulus, dynamic.density), (4740.0, 6000.0, 1079.0));
    let Matter::Volume { young_modulus, poisson_ratio, density } =
        snapshot.get::<XpbdBody>(organ).expect("one").matter
    else {
        panic!("it is a volume")
    };
    assert_eq!([young_modulus, poisson_ratio, density], [4740.0, 0.45, 1079.0]);
    assert!(snapshot.get::<OutOfValidity>(organ).is_none());
    let kidney = scene(&body("cauterised = { charring = 250.0 }").replace("liver", "kidney"));
    let organ = kidney.view().find("organ").expect("it");
    let burns = *kidney.view().get::<CauterisedBody>(organ).expect("one");
    assert_eq!((burns.conductivity, burns.heat_capacity, burns.density), (0.53, 3763.0, 1066.0));
    assert_eq!((burns.perfusion, burns.water, burns.charring), (0.067, 0.79, 250.0));
    // Parameters not given are those of liver, and liver is the solver's default.
    let table = snapshot.get::<CauterisedBody>(organ_of_liver).expect("one");
    assert_eq!((*table, burns.damage_energy), (CauterisedBody::default(), table.damage_energy));
    let (snapshot, organ) = has("linear_fem = { young_modulus = 1e5 }");
    let doubt = &snapshot.get::<OutOfValidity>(organ).expect("no such liver").reason;
    assert!(doubt.contains("young_modulus of 100 kPa") && doubt.contains("2,700 Pa to 7,800 Pa"), "{doubt}");
}

/// A membrane hanging from one side for a second: pieces, torn length, lowest point, and final vertices.
fn hung<C: Controller>(
    kind: &str,
    kill: Option<u32>,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) -> ([f64; 3], VertexPositions) {
    let text = format!(
        "[[entity]]\nname = \"fold\"\nmesh = {{ sheet = {{ size = [0.06, 0.04], cells = [12, 8] }} }}\n{kind}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [-0.0299, 1.0, 1.0] }} }}] }}\n"
    );
    let mut stage = Stage::new(scene(&text), 200.0, build);
    for tick in 0..200 {
        if kill == Some(tick) {
            stage.rebuild(build);
        }
        stage.tick();
    }
    assert!(!stage.has::<Frozen>("fold"), "{}", stage.get::<Frozen>("fold").reason);
    let told = ["pieces", "cut_length_m", "lowest_m"].map(|what| stage.measured(&format!("fold.{what}")));
    (told, stage.get::<VertexPositions>("fold"))
}

fn a_membrane_tears<C: Controller>(
    kind: impl Fn(&str) -> String,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let weak = kind(", tears_at = 1.05");
    let ([pieces, length, lowest], positions) = hung(&weak, None, build);
    assert!(pieces >= 2.0 && length >= 0.035, "{weak}: {pieces} pieces, {length} m torn");
    assert!(lowest < -0.3, "{weak}: what has come off falls: {lowest} m");
    assert_eq!(hung(&weak, Some(60), build).1, positions, "{weak}: another life");
    // The same membrane hangs without a limit, and with one that it does not reach.
    for none in ["", ", tears_at = 1.6"] {
        let ([pieces, length, lowest], _) = hung(&kind(none), None, build);
        assert_eq!((pieces, length), (1.0, 0.0), "{none}");
        assert!(lowest > -0.1, "{none}: {lowest} m");
    }
}

#[test]
fn a_membrane_that_is_drawn_too_far_tears_and_goes_on_to_the_bit_in_another_life() {
    let matter = "membrane_stiffness = 0.3, bending_stiffness = 1e-7, density = 0.05";
    a_membrane_tears(
        |tears_at| {
            format!("mass_spring = {{ springs = {{ surface = {{ {matter} }} }}, damping = 10.0{tears_at} }}")
        },
        |context: &BuildContext<'_>| MassSpringController::new(GRAVITY, context),
    );
    a_membrane_tears(
        |tears_at| {
            format!(
                "xpbd = {{ matter = {{ cloth = {{ {matter} }} }}, cut = true, damping = 10.0{tears_at} }}"
            )
        },
        |context: &BuildContext<'_>| XpbdController::new(GRAVITY, context),
    );
}
