//! Scenario files: what they become, and what every mistake in one is answered with.

use crate::support as common;
use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;
use proptest::prelude::*;
use trocar_scene::scenario::{self, Scenario, ScenarioError};
use trocar_scene::*;

fn peg_transfer() -> (Arc<Registry>, Scenario) {
    let registry = Registry::standard();
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scenarios/peg-transfer.toml");
    let scenario = Scenario::load(&file, &registry).unwrap_or_else(|error| panic!("{error}"));
    (registry, scenario)
}

fn parse(text: &str) -> Result<Scenario, ScenarioError> {
    Scenario::parse(Path::new("folder/test.toml"), text, &Registry::standard())
}

#[test]
fn the_published_schema_is_valid_and_no_rubber_stamp() {
    let schema = scenario::json_schema(&Registry::standard());
    jsonschema::draft202012::meta::validate(&schema).unwrap_or_else(|error| panic!("{error}"));
    let validator = jsonschema::draft202012::new(&schema).expect("a schema");
    let valid = serde_json::json!({ "schema": 1, "name": "x", "entity": [{ "name": "a", "pose": {} }] });
    assert!(validator.is_valid(&valid));
    for (pointer, bad) in [
        ("/schema", serde_json::json!(2)),
        ("/name", serde_json::json!("no spaces")),
        ("/gravity", serde_json::json!([0, 0])),
        ("/bogus", serde_json::json!(1)),
        ("/entity", serde_json::json!([{ "pose": {} }])),
        ("/entity", serde_json::json!([{ "name": "a", "poze": {} }])),
        ("/entity", serde_json::json!([{ "name": "a", "pose": { "translatoin": [0, 0, 0] } }])),
        ("/entity", serde_json::json!([{ "name": "a", "shape": { "sphere": { "radius": "big" } } }])),
        ("/entity", serde_json::json!([{ "name": "a", "mesh": { "scale": 1 } }])),
        ("/controller", serde_json::json!([{ "name": "a", "kind": "b", "rate_hz": 0 }])),
        ("/controller", serde_json::json!([{ "name": "a", "kind": "b", "rate_hz": 1, "rate": 1 }])),
        ("/hand", serde_json::json!([{ "device": "virtual" }])),
    ] {
        let mut value = valid.clone();
        value[pointer.trim_start_matches('/')] = bad;
        assert!(!validator.is_valid(&value), "{pointer} = {}", value[pointer.trim_start_matches('/')]);
    }
}

#[test]
fn smoke_may_stand_in_a_scenario() {
    let text = r#"
schema = 1
name = "smoky"

[[entity]]
name = "plume"
pose = {}
particles = { kind = "smoke", positions = [[0.0, 0.0, 0.01], [0.0, 0.001, 0.02]], radius = 0.004, ages = [0.0, 0.5] }
"#;
    let scenario = parse(text).unwrap_or_else(|error| panic!("{error}"));
    let store = scenario.spawn(&Registry::standard()).expect("valid");
    let (_, plume) = store.view().iter::<Particles>().next().expect("a plume");
    assert_eq!((plume.kind, plume.positions.len(), plume.ages[1]), (ParticleKind::Smoke, 2, 0.5));
    let refused = parse(&text.replace("ages = [0.0, 0.5]", "ages = [0.0]")).expect_err("refused").to_string();
    assert!(refused.contains("ages: 1 values for 2 particles"), "{refused}");
}

#[test]
fn the_peg_transfer_is_laid_out_as_it_says() {
    let (registry, scenario) = peg_transfer();
    assert_eq!(scenario.gravity_in_world, nalgebra::Vector3::new(0.0, 0.0, -9.81));
    let store = scenario.spawn(&registry).expect("valid");
    let view = store.view();
    assert_eq!(store.revision(), Revision(1));
    let boards: Vec<(Entity, &Shape)> =
        view.iter::<Shape>().filter(|(_, shape)| matches!(shape, Shape::PegBoard { .. })).collect();
    assert_eq!(boards.len(), 2);
    let (left, Shape::PegBoard { pegs, .. }) = boards[0] else { panic!("a peg board") };
    let feet: Vec<_> =
        pegs.iter().map(|[x, y]| view.world_pose(left) * nalgebra::Point3::new(*x, *y, 0.0)).collect();
    let mut rings = 0;
    for (ring, shape) in view.iter::<Shape>() {
        let Shape::Torus { ring_radius, tube_radius } = shape else { continue };
        rings += 1;
        let center = view.world_pose(ring).translation.vector;
        assert_eq!((*ring_radius, *tube_radius, center.z), (0.008, 0.0015, 0.0015));
        let around = feet.iter().filter(|foot| (foot.coords - center).xy().norm() < 1e-12).count();
        assert_eq!(around, 1, "{} lies around one peg of the left board", view.name(ring));
        let body = view.get::<RigidBody>(ring).expect("a body");
        assert_eq!((body.motion, body.mass), (Motion::Dynamic, 0.005));
    }
    assert_eq!(rings, 6);
    for side in ["left", "right"] {
        let instrument = scenario.entity(&format!("grasper.{side}")).expect("an instrument");
        let port = view.get::<Instrument>(instrument).and_then(|build| build.port).expect("a port");
        assert_eq!(Some(port), scenario.entity(&format!("port.{side}")));
        // The shaft passes the port: port, tip and shaft direction are in line.
        let pose = view.world_pose(instrument);
        let to_port = view.world_pose(port).translation.vector - pose.translation.vector;
        assert!((pose.rotation * nalgebra::Vector3::z()).cross(&to_port).norm() < 1e-6);
    }
    let rates: Vec<(&str, &str, f64)> =
        scenario.controllers.iter().map(|c| (c.name.as_str(), c.kind.as_str(), c.rate_hz)).collect();
    assert_eq!(
        rates,
        [
            ("haptics.left", "haptics", 1000.0),
            ("haptics.right", "haptics", 1000.0),
            ("engine", "rapier", 500.0),
            ("task", "peg-transfer", 100.0),
            ("autopilot", "autopilot", 100.0),
        ]
    );
}

#[test]
fn the_home_pose_of_each_instrument_is_where_its_hand_puts_it() {
    let (registry, scenario) = peg_transfer();
    let store = scenario.spawn(&registry).expect("valid");
    let view = store.view();
    for hand in &scenario.hands {
        let hand = view.get::<Hand>(hand.entity).expect("a hand");
        let build = view.get::<Instrument>(hand.instrument).expect("an instrument");
        let port = view.world_pose(build.port.expect("a port")).translation.vector;
        let handle = hand.world_from_device.translation;
        let shaft = (port - handle).normalize();
        let tip = handle + shaft * build.shaft_length;
        let home = view.world_pose(hand.instrument);
        assert!((home.translation.vector - tip).norm() < 1e-8, "{} is not {tip}", home.translation);
        let own_axis = hand.world_from_device.rotation * nalgebra::Vector3::z();
        let swing = nalgebra::UnitQuaternion::rotation_between(&own_axis, &shaft).expect("not opposite");
        assert!(home.rotation.angle_to(&(swing * hand.world_from_device.rotation)) < 1e-6);
    }
}

#[test]
fn parameters_are_interpreted_where_they_are_used_and_errors_keep_their_place() {
    #[derive(Debug, PartialEq, serde::Deserialize)]
    #[serde(deny_unknown_fields, default)]
    struct Tuning {
        gain: f64,
        target: Option<Entity>,
    }
    impl Default for Tuning {
        fn default() -> Self {
            Self { gain: 2.5, target: None }
        }
    }
    let text = "schema = 1\nname = \"x\"\n[[entity]]\nname = \"ring\"\n\
                [[controller]]\nname = \"a\"\nkind = \"k\"\nrate_hz = 10\nparams = { gain = 3, target = \"ring\" }\n\
                [[controller]]\nname = \"b\"\nkind = \"k\"\nrate_hz = 10\n\
                [[controller]]\nname = \"c\"\nkind = \"k\"\nrate_hz = 10\n[controller.params]\ngian = 3\n\
                [[controller]]\nname = \"d\"\nkind = \"k\"\nrate_hz = 10\n[controller.params]\ntarget = \"peg\"\n";
    let scenario = parse(text).expect("valid");
    let [a, b, c, d] = &scenario.controllers[..] else { panic!("four controllers") };
    let ring = scenario.entity("ring");
    assert_eq!(a.params.parse::<Tuning>().expect("valid"), Tuning { gain: 3.0, target: ring });
    assert_eq!(b.params.parse::<Tuning>().expect("defaults"), Tuning::default());
    let error = c.params.parse::<Tuning>().expect_err("a slip").to_string();
    for part in ["folder/test.toml:19:1", "controller 'c', params", "gian", "gain"] {
        assert!(error.contains(part), "'{part}' is missing in '{error}'");
    }
    let error = d.params.parse::<Tuning>().expect_err("no such entity").to_string();
    assert!(error.contains("no entity is named 'peg'; there are: ring") && error.contains(":25:"), "{error}");
    let error = c.params.error("gain must be positive").to_string();
    assert!(error.starts_with("folder/test.toml:18:") && error.ends_with("gain must be positive"), "{error}");
    let error = scenario.error_at("controller", 1, "unknown kind").to_string();
    assert!(error.starts_with("folder/test.toml:10:"), "{error}");
    assert_eq!(scenario.task.parse::<Tuning>().expect("defaults"), Tuning::default());
    #[derive(Debug, serde::Deserialize)]
    struct Needs {
        #[allow(dead_code)]
        gain: f64,
    }
    assert!(b.params.parse::<Needs>().expect_err("missing").to_string().contains("gain"));
}

/// A range, a condition between keys, a name: what no decoder sees is answered with the line of its own key.
#[test]
fn errors_that_are_found_after_decoding_stand_at_the_line_of_their_own_key() {
    let entity = "schema = 1\nname = \"x\"\n[[entity]]\nname = \"ring\"\n\
                  shape = { torus = { ring_radius = 0.008, tube_radius = 0.0015 } }\n";
    let cases = [
        ("[entity.rigid_body]\nmotion = \"dynamic\"\nfriction = 0.5\nmass = -1.0\n", ":9:8", "mass"),
        ("[entity.instrument]\nkind = \"grasper\"\nshaft_length = 3.0\n", ":8:16", "shaft_length"),
        (
            "[entity.instrument]\nkind = \"grasper\"\nshaft_length = 0.1\njaw_angle_max = 7.0\n",
            ":9:17",
            "jaw_angle_max",
        ),
    ];
    for (text, place, key) in cases {
        let error = parse(&format!("{entity}{text}")).expect_err("out of range").to_string();
        assert!(
            error.starts_with(&format!("folder/test.toml{place}")) && error.contains(key),
            "{text}: {error}"
        );
    }

    let text = "schema = 1\nname = \"x\"\n[[controller]]\nname = \"a\"\nkind = \"nonsense\"\nrate_hz = 10\n\
                [controller.params]\nhand = \"left\"\nstep = [\n  { seconds = 1.0 },\n  { seconds = 2.0, to = \"b\" },\n]\n\
                [task]\nexpect = [{ measure = \"ring.z_m\", min = 2.0 }]\nseconds = -1.0\n";
    let scenario = parse(text).expect("valid");
    let params = &scenario.controllers[0].params;
    for (error, line) in [
        (params.error("hand: no hand is called 'left'; there are: right"), 8),
        (params.error("no hand is called 'left'; there are: right"), 8),
        (params.error("there is no 'b' to go to"), 11),
        (params.error("the whole is wrong"), 7),
        (scenario.task.error("seconds: -1 is out of range (0 to 86,400)"), 15),
        (scenario.task.error("'ring.z_m': no value is at least 2 and at most 1"), 14),
        (scenario.error_at("controller", 0, "unknown kind 'nonsense'; there are: rapier"), 5),
        (scenario.error_at("controller", 0, "rate_hz: 10 is too slow"), 6),
        (scenario.error_at("controller", 0, "it cannot be built"), 3),
    ] {
        let error = error.to_string();
        assert!(error.starts_with(&format!("folder/test.toml:{line}:")), "line {line}: {error}");
    }
}

const HEAD: &str = "schema = 1\nname = \"x\"\n";

/// Every mistake is answered with file, line, column, key and what would be valid.
#[test]
fn the_outline_of_a_scenario_needs_neither_its_meshes_nor_its_components() {
    let text = r#"
schema = 1
name = "elsewhere"

[[entity]]
name = "liver"
mesh = { file = "not-here.obj" }
some_programs_own = { value = 1 }

[[entity]]
name = "hand.left"
hand = { side = "left", instrument = "liver" }

[[hand]]
name = "left"

[network]
architecture = "client-server"
"#;
    assert!(parse(text).is_err(), "the scene itself cannot be made here");
    let outline =
        Scenario::outline(Path::new("elsewhere.toml"), text).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(outline.hands[0].entity, outline.entity("hand.left").expect("it is named"));
    #[derive(serde::Deserialize)]
    struct Network {
        architecture: String,
    }
    let network: Network = outline.network.parse().unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(network.architecture, "client-server");
    let wrong = Scenario::outline(Path::new("x.toml"), "schema = 1\nname = \"x\"\nnetwork = 3").unwrap_err();
    assert!(wrong.to_string().contains("x.toml:3"), "{wrong}");
}

#[test]
fn mistakes_are_named_with_their_place() {
    let entity = |rest: &str| format!("{HEAD}[[entity]]\nname = \"ring\"\n{rest}");
    let controller = |rest: &str| format!("{HEAD}[[controller]]\nname = \"engine\"\n{rest}");
    let hand = "[[entity]]\nname = \"tool\"\ninstrument = {}\n[[entity]]\nname = \"hand.left\"\n\
                hand = { side = \"left\", instrument = \"tool\" }\n";
    let cases: Vec<(String, &[&str])> = vec![
        ("schema = 1\nname = ".into(), &[":2:"]),
        ("name = \"x\"\n".into(), &["'schema' is missing"]),
        ("schema = 2\nname = \"x\"\nnew_key = 1\n".into(), &[":1:10", "version 2", "reads 1"]),
        ("schema = \"1\"\n".into(), &[":1:10", "schema"]),
        ("schema = 1\n".into(), &["'name' is missing"]),
        ("schema = 1\nname = \"a b\"\n".into(), &[":2:8", "'a b' is no name"]),
        (format!("{HEAD}gravty = [0, 0, 0]\n"), &[":3:1", "unknown key 'gravty'", "gravity"]),
        (format!("{HEAD}gravity = [0, 0]\n"), &[":3:11", "gravity"]),
        (format!("{HEAD}gravity = [0, 0, nan]\n"), &[":3:11", "gravity", "-100 to 100 m/s²"]),
        (format!("{HEAD}entity = 3\n"), &[":3:10", "[[entity]]"]),
        (format!("{HEAD}[[entity]]\npose = {{}}\n"), &[":3:1", "'name' is missing"]),
        (entity("[[entity]]\nname = \"ring\"\n"), &[":6:8", "two entities are named 'ring'"]),
        (entity("poze = {}\n"), &[":5:1", "entity 'ring'", "unknown component 'poze'", "pose", "mesh"]),
        (
            entity("pose = { translatoin = [0, 0, 0] }\n"),
            &[":5:10", "entity 'ring', pose", "translatoin", "translation"],
        ),
        (entity("pose = { translation = [0, 0] }\n"), &[":5:", "entity 'ring', pose"]),
        (entity("pose = { rotation = [0, 0, 0, 2] }\n"), &[":5:21", "not normalised", "2"]),
        (entity("pose = { translation = [0, inf, 0] }\n"), &[":5:28", "not finite"]),
        (entity("rigid_body = { mass = -1 }\n"), &[":5:23", "mass", "-1", "1e-6 to 1e3 kg"]),
        (
            entity("rigid_body = { motion = \"liquid\" }\n"),
            &[":5:25", "liquid", "static", "dynamic", "kinematic"],
        ),
        (entity("shape = { torus = { ring_radius = 1 } }\n"), &["entity 'ring', shape", "tube_radius"]),
        (entity("parent = \"nobody\"\n"), &[":5:10", "no entity is named 'nobody'", "ring"]),
        (entity("parent = \"ring\"\n"), &[":5:10", "entity 'ring', parent", "cycle"]),
        (entity("name2 = 1\n"), &["unknown component 'name2'"]),
        (entity("mesh = \"a.obj\"\n"), &[":5:8", "a table with a file"]),
        (
            entity("mesh = { scale = 1 }\n"),
            &["one of file, shape, organ, sheet, tube, block, line is missing"],
        ),
        (entity("mesh = { file = \"../a.obj\" }\n"), &[":5:17", "must not leave its folder"]),
        (entity("mesh = { file = \"/a.obj\" }\n"), &[":5:17", "relative"]),
        (entity("mesh = { file = \"a.doc\" }\n"), &[":5:17", "'doc'", "obj", "msh"]),
        (
            entity("mesh = { file = \"none.obj\" }\n"),
            &[":5:17", "entity 'ring', mesh, file", "none.obj", "cannot be read"],
        ),
        (entity("mesh = { file = \"a.obj\", scale = 0 }\n"), &[":5:34", "scale", "out of range"]),
        (entity("mesh = { file = \"a.obj\", require = \"x\" }\n"), &[":5:36", "'x'", "solid, manifold, any"]),
        (entity("mesh = { file = \"a.obj\" }\ntet_mesh = { tets = [] }\n"), &["mesh file provides"]),
        (entity("visual_material = { color_map = { file = \"../x.png\" } }\n"), &[":5:42", "must not leave"]),
        (controller("rate_hz = 10\n"), &["controller 'engine'", "'kind' is missing"]),
        (controller("kind = \"rapier\"\n"), &["'rate_hz' is missing"]),
        (
            controller("kind = \"rapier\"\nrate_hz = -5\n"),
            &[":6:11", "controller 'engine', rate_hz", "-5", "1 to 10000 Hz"],
        ),
        (controller("kind = \"rapier\"\nrate_hz = 10001\n"), &[":6:11", "out of range"]),
        (controller("kind = \"rapier\"\nrate_hz = nan\n"), &[":6:11", "out of range"]),
        (controller("kind = \"rapier\"\nrate_hz = \"fast\"\n"), &[":6:11", "fast"]),
        (controller("kind = \"rapier\"\nrate = 5\n"), &[":6:1", "unknown key 'rate'", "rate_hz"]),
        (
            controller("kind = \"rapier\"\nrate_hz = 5\nparams = 3\n"),
            &[":7:10", "a table is expected, found integer"],
        ),
        (
            controller("kind = \"r\"\nrate_hz = 5\n[controller.params]\nfile = \"/etc/passwd\"\n"),
            &[":8:8", "relative"],
        ),
        (
            controller("kind = \"r\"\nrate_hz = 5\n[[controller]]\nname = \"engine\"\n"),
            &[":8:8", "'engine' is taken"],
        ),
        (
            format!("{HEAD}{hand}[[hand]]\nname = \"right\"\n"),
            &["'hand.right' is no entity with a hand component", "hand.left"],
        ),
        (
            format!("{HEAD}{hand}[[hand]]\nname = \"left\"\nentity = \"tool\"\n"),
            &["'tool' is no entity with a hand"],
        ),
        (format!("{HEAD}{hand}[[hand]]\nname = \"left\"\ndevice = 3\n"), &["a string is expected"]),
        (
            format!("{HEAD}{hand}[[hand]]\nname = \"left\"\ncolour = 3\n"),
            &["hand 'left'", "'colour'", "device"],
        ),
        (
            format!(
                "{HEAD}{hand}[[hand]]\nname = \"left\"\n[[hand]]\nname = \"l2\"\nentity = \"hand.left\"\n"
            ),
            &["two hands refer to entity 'hand.left'"],
        ),
        (format!("{HEAD}task = 3\n"), &[":3:8", "a table is expected"]),
        ("schema = 1\nname = \"x\"\nname = \"y\"\n".into(), &[":3:1", "duplicate key"]),
    ];
    for (text, expected) in cases {
        let error = match parse(&text) {
            Ok(_) => panic!("this must be refused:\n{text}"),
            Err(error) => error.to_string(),
        };
        for part in expected.iter().chain(&["folder/test.toml:"]) {
            assert!(error.contains(part), "'{part}' is missing in '{error}' for\n{text}");
        }
    }
}

#[test]
fn joints_are_read_one_or_several_and_those_that_join_nothing_are_refused_with_their_place() {
    let body = |name: &str, motion: &str, joint: &str| {
        format!(
            "[[entity]]\nname = \"{name}\"\nshape = {{ sphere = {{ radius = 0.01 }} }}\n\
             rigid_body = {{ motion = \"{motion}\" }}\n{joint}"
        )
    };
    let ball = "{ kind = \"ball\", at = [0.0, 0.0, 0.1], to = \"frame\" }";
    let hinge = "{ kind = \"hinge\", at = [0.0, 0.0, 0.2], axis = [0.0, 2.0, 0.0] }";
    let others = body("frame", "static", "") + &body("wall", "static", "");
    let read = |joint: &str| {
        let text = format!("{HEAD}{others}{}", body("link", "dynamic", &format!("joint = {joint}\n")));
        let scenario = parse(&text).unwrap_or_else(|error| panic!("{error}"));
        let scene = scenario.spawn(&Registry::standard()).expect("valid").snapshot();
        let joints = scene.get::<Joints>(scenario.entity("link").expect("named")).expect("put").0.clone();
        (joints, scenario.entity("frame"))
    };
    let (one, frame) = read(ball);
    assert_eq!((one.len(), one[0].kind, one[0].to, one[0].at.z), (1, JointKind::Ball, frame, 0.1));
    let (two, _) = read(&format!("[{ball}, {hinge}]"));
    assert_eq!((two.len(), two[0], two[1].to), (2, one[0], None));
    assert!((two[1].frame_in_world() * Vector3::z() - Vector3::y()).norm() < 1e-15);

    let refused = |text: String, place: &str, says: &[&str]| {
        let error = parse(&text).err().unwrap_or_else(|| panic!("this must be refused:\n{text}")).to_string();
        for part in says.iter().chain(&[place]) {
            assert!(error.contains(part), "'{part}' is missing in '{error}' for\n{text}");
        }
    };
    // The joint of a body stands in line 15, behind the two others.
    let link = |motion: &str, joint: &str| {
        format!("{HEAD}{others}{}", body("link", motion, &format!("joint = {joint}\n")))
    };
    let to = |name: &str| ball.replace("frame", name);
    refused(
        link("dynamic", &to("nobody")),
        ":15:",
        &["entity 'link', joint", "'nobody'", "frame, link, wall"],
    );
    refused(link("dynamic", &to("link")), ":15:", &["'to' leads from 'link' to itself"]);
    refused(link("static", &to("frame")), ":15:", &["neither 'link' nor 'frame'", "dynamic"]);
    refused(link("kinematic", hinge), ":15:", &["'link' does not move by forces"]);
    refused(link("dynamic", &hinge.replace("2.0", "0.0")), ":15:", &["'axis' has no direction"]);
    refused(link("dynamic", &hinge.replace("hinge", "fixed")), ":15:", &["'axis' is of a hinge"]);
    refused(
        link("dynamic", &hinge.replace("hinge", "slider")),
        ":15:",
        &["slider", "ball", "hinge", "fixed"],
    );
    refused(link("dynamic", &format!("[{hinge}, {}]", to("link"))), ":15:", &["'link' to itself"]);
    let bare = format!("{HEAD}{others}[[entity]]\nname = \"tool\"\ninstrument = {{}}\n");
    refused(format!("{bare}joint = {hinge}\n"), ":14:", &["give 'tool' a 'rigid_body'"]);
    let to_tool = format!("{bare}{}", body("link", "dynamic", &format!("joint = {}\n", to("tool"))));
    refused(to_tool, ":18:", &["'tool' is no rigid body; there are: frame, wall"]);
}

#[test]
fn a_file_that_cannot_be_read_is_named() {
    let registry = Registry::standard();
    let folder = tempfile::tempdir().expect("a folder");
    let missing = folder.path().join("missing.toml");
    let error = Scenario::load(&missing, &registry).expect_err("missing");
    assert!(
        matches!(error, ScenarioError::Io { .. }) && error.to_string().contains("missing.toml"),
        "{error}"
    );
    assert!(Scenario::load(folder.path(), &registry).is_err());
    let binary = folder.path().join("binary.toml");
    std::fs::write(&binary, [0xff, 0xfe, 0x00]).expect("a file");
    assert!(matches!(Scenario::load(&binary, &registry), Err(ScenarioError::Io { .. })));
}

#[test]
fn mesh_files_become_components() {
    let registry = Registry::standard();
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(folder.path().join("meshes")).expect("a folder");
    let mut volume = common::tet_box(2);
    let torus = shapes::torus(7.5, 2.5, 12, 8).expect("a torus");
    std::fs::write(folder.path().join("meshes/ring.obj"), common::write_obj(&torus)).expect("a file");
    std::fs::write(folder.path().join("meshes/box.msh"), common::write_gmsh_4(&volume, None))
        .expect("a file");
    let thread = "v 9 9 9\nv 0 0 0\nv 10 0 0\nv 10 10 0\nl 2 3 4\n";
    std::fs::write(folder.path().join("meshes/thread.obj"), thread).expect("a file");
    volume.tets[4].swap(0, 1);
    std::fs::write(folder.path().join("meshes/bad.vtk"), common::write_vtk(&volume, true, 5))
        .expect("a file");
    let file = folder.path().join("s.toml");
    let scene = |bad: &str| {
        let text = format!(
            "{HEAD}[[entity]]\nname = \"ring\"\nmesh = {{ file = \"meshes/ring.obj\", scale = 0.001 }}\n\
             [[entity]]\nname = \"box\"\nmesh = {{ file = \"meshes/box.msh\" }}\n\
             [[entity]]\nname = \"thread\"\n\
             mesh = {{ file = \"meshes/thread.obj\", scale = 0.001, radius = 0.0005 }}\n\
             [[entity]]\nname = \"flipped\"\nmesh = {{ file = \"meshes/bad.vtk\", {bad} }}\n"
        );
        std::fs::write(&file, text).expect("a file");
        Scenario::load(&file, &registry)
    };
    let scenario = scene("repair = true").unwrap_or_else(|error| panic!("{error}"));
    let store = scenario.spawn(&registry).expect("valid");
    let view = store.view();
    let named = |name: &str| view.find(name).expect("an entity");
    let ring = view.get::<VertexPositions>(named("ring")).expect("positions");
    assert!((ring.positions[0].coords.norm() - 0.010).abs() < 1e-12, "millimetres became metres");
    assert_eq!(
        view.get::<SurfaceMesh>(named("ring")).expect("triangles").triangles.len(),
        torus.triangles.len()
    );
    assert!(view.get::<TetMesh>(named("ring")).is_none());
    let line = view.get::<LineMesh>(named("thread")).expect("a line");
    assert_eq!((line.segments.to_vec(), line.radius), (vec![[0, 1], [1, 2]], 0.0005));
    let places = view.get::<VertexPositions>(named("thread")).expect("positions");
    assert_eq!(places.positions.len(), 3);
    assert!((places.positions[2].coords.norm() - 0.01 * 2.0_f64.sqrt()).abs() < 1e-12);
    assert!(view.get::<SurfaceMesh>(named("thread")).is_none());
    assert!(view.get::<TextureCoordinates>(named("ring")).is_some());
    for name in ["box", "flipped"] {
        assert_eq!(view.get::<TetMesh>(named(name)).expect("tetrahedra").tets.len(), 48);
        assert_eq!(view.get::<SurfaceMesh>(named(name)).expect("the boundary").triangles.len(), 48);
        assert_eq!(view.get::<VertexPositions>(named(name)).expect("positions").positions.len(), 27);
    }
    // Two scenes of one scenario share their payloads.
    let again = scenario.spawn(&registry).expect("valid");
    let other = again.view().get::<VertexPositions>(named("ring")).expect("positions");
    assert!(Arc::ptr_eq(&ring.positions, &other.positions));

    let error = scene("require = \"solid\"").expect_err("inverted").to_string();
    for part in [
        "s.toml:14:",
        "entity 'flipped', mesh, file",
        "bad.vtk",
        "tetrahedron 5 is inverted",
        "repair = true",
    ] {
        assert!(error.contains(part), "'{part}' is missing in '{error}'");
    }
    assert!(scene("require = \"any\"").is_ok());
}

#[test]
fn shapes_become_surfaces_divided_as_finely_as_asked_for() {
    let registry = Registry::standard();
    let scene = |mesh: &str| {
        let text = format!("{HEAD}[[entity]]\nname = \"stone\"\nmesh = {{ {mesh} }}\n");
        let scenario = parse(&text)?;
        let store = scenario.spawn(&registry).expect("valid");
        let stone = store.view().find("stone").expect("an entity");
        let positions = store.view().get::<VertexPositions>(stone).expect("positions").positions.clone();
        assert!(store.view().get::<Shape>(stone).is_none(), "it is a surface only");
        assert!(positions.iter().all(|position| (position.coords.norm() - 0.01).abs() < 1e-12));
        Ok::<_, ScenarioError>(positions.len())
    };
    let coarse = scene("shape = { sphere = { radius = 0.01 } }, segments = 8").expect("a ball");
    let fine = scene("shape = { sphere = { radius = 0.01 } }").expect("a ball");
    assert!(coarse < 60 && fine > 500, "{coarse} {fine}");
    for (mesh, says) in [
        ("shape = { sphere = { radius = 0.01 } }, segments = 4", "segments"),
        ("shape = { sphere = { radius = 0.01 } }, segments = 9.5", "segments"),
        ("shape = { sphere = { radius = -0.01 } }", "radius"),
        ("shape = { ball = { radius = 0.01 } }", "ball"),
        ("shape = { sphere = { radius = 0.01 } }, scale = 2.0", "scale"),
        ("file = \"a.obj\", shape = { sphere = { radius = 0.01 } }", "file"),
    ] {
        let refused = scene(mesh).expect_err(mesh).to_string();
        assert!(refused.contains("test.toml:") && refused.contains(says), "{refused}");
    }
}

#[test]
fn organs_sheets_tubes_blocks_and_threads_are_made_without_files() {
    let registry = Registry::standard();
    let scene = |mesh: &str| {
        let text = format!("{HEAD}[[entity]]\nname = \"thing\"\nmesh = {{ {mesh} }}\n");
        let store = parse(&text)?.spawn(&registry).expect("valid");
        let thing = store.view().find("thing").expect("an entity");
        let view = store.view();
        Ok::<_, ScenarioError>((
            view.get::<VertexPositions>(thing).map_or(0, |vertices| vertices.positions.len()),
            view.get::<SurfaceMesh>(thing).map_or(0, |surface| surface.triangles.len()),
            view.get::<TetMesh>(thing).map_or(0, |volume| volume.tets.len()),
            view.get::<LineMesh>(thing).map_or(0, |line| line.segments.len()),
            view.get::<TextureCoordinates>(thing).map_or(0, |texture| texture.uv.len()),
        ))
    };
    let made = |mesh: &str| scene(mesh).unwrap_or_else(|error| panic!("{error}"));
    let (vertices, triangles, tets, lines, _) = made("organ = \"liver\", edge = 0.02");
    assert!(vertices > 100 && triangles > 100 && tets > 300 && lines == 0, "{vertices} {triangles} {tets}");
    let bag = made("organ = \"stomach\", edge = 0.012, wall = 0.012, levels = 0");
    assert!(bag.1 > made("organ = \"stomach\", edge = 0.012").1 && bag.2 > 1000, "{bag:?}");
    let half = made("organ = \"kidney\", edge = 0.005, scale = 0.5");
    assert_eq!(half, made("organ = \"kidney\", edge = 0.01"), "the same lattice, half as large");
    assert_eq!(made("sheet = { size = [0.1, 0.1], cells = [4, 3] }"), (20, 24, 0, 0, 20));
    assert_eq!(made("tube = { radius = 0.01, length = 0.08, cells = [6, 2] }"), (18, 24, 0, 0, 0));
    assert_eq!(made("block = { size = [0.1, 0.1, 0.02], cells = [2, 2, 1] }"), (18, 32, 24, 0, 0));
    assert_eq!(made("line = { length = 0.15, segments = 10, radius = 0.00015 }"), (11, 0, 0, 10, 0));
    for (mesh, says) in [
        ("organ = \"heart\"", "liver"),
        ("organ = \"liver\", edge = 0.0001", "make them longer"),
        ("organ = \"liver\", levels = 1.5", "levels"),
        ("organ = \"liver\", cells = 4", "cells"),
        ("sheet = { size = [0.1, 0.1], cells = [0, 3] }", "1 to 1024"),
        ("sheet = { size = [0.1, 0.1] }", "cells"),
        ("line = { length = 0.1, segments = 4, radius = 2.0 }", "radius"),
        ("sheet = { size = [0.1, 0.1], cells = [4, 3] }, scale = 2.0", "scale"),
    ] {
        let refused = scene(mesh).expect_err(mesh).to_string();
        assert!(refused.contains("test.toml:") && refused.contains(says), "{refused}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn a_mutated_scenario_never_panics(
        at in any::<prop::sample::Index>(),
        cut in 0..40usize,
        insert in prop_oneof![
            "[ -~\n]{0,12}",
            prop::sample::select(vec!["nan", "-1", "1e999", "\"\"", "[]", "{}", "[[entity]]", "99999999999999999999", "\u{0}", "é"])
                .prop_map(str::to_owned),
        ],
    ) {
        let mut text = include_str!("../../scenarios/wall.toml").to_owned();
        let mut begin = at.index(text.len());
        while !text.is_char_boundary(begin) {
            begin -= 1;
        }
        let mut end = (begin + cut).min(text.len());
        while !text.is_char_boundary(end) {
            end += 1;
        }
        text.replace_range(begin..end, &insert);
        if let Err(error) = parse(&text) {
            prop_assert!(error.to_string().contains("folder/test.toml"), "{}", error);
        }
    }

    #[test]
    fn random_text_never_panics(
        text in r#"([a-z_]{1,9}( = |\.)|\[{1,2}|\]{1,2}|"[a-z]{0,3}"|[0-9.]{1,4}|\n|[{}, ]){0,60}"#
    ) {
        let _ = parse(&text);
        let _ = parse(&format!("{HEAD}{text}"));
    }
}
