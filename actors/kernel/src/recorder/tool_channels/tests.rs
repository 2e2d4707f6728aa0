//! What standard tools are told: by its schemas, complete at every place where a reader may begin, and short.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use trocar_scene::{
    Commands, DeviceForce, DeviceState, Entity, EntityAllocator, Hand, Instrument, JawState, LineMesh,
    Measured, Name, Parent, Pose, Registry, Shape, Side, SimTime, Store, SurfaceMesh, TaskError, TaskState,
    VertexPositions, VisualMaterial, WriterId,
};

use super::super::format::{HAND_LEFT, MEASURED, PHASES, SCENE, SCENE_DEFORMING, TASK, TF, TF_STATIC};
use super::{FORMS, Form, ToolCache, ToolChannels, channels};

const fn entity(number: u32) -> Entity {
    Entity::new(0, 0, number)
}
const INSTRUMENT: Entity = entity(1);
const HAND: Entity = entity(2);
/// A writer: no list of entities has it.
const EXERCISE: Entity = Entity::of_writer(0, 3);
const SPARE: Entity = entity(3);
const BOARD: Entity = entity(4);
const LIVER: Entity = entity(5);
const THREAD: Entity = entity(6);
const BALL: Entity = entity(7);

/// A scene, and what is told of it.
struct Told {
    store: Store,
    out: Commands,
    now: SimTime,
    channels: ToolChannels,
    cache: ToolCache,
}

type Messages = Vec<(&'static str, Value)>;

impl Told {
    fn new(fill: impl FnOnce(&mut Commands)) -> Self {
        let registry = Registry::standard();
        let mut store = Store::new(registry.clone());
        let mut out = Commands::new(registry, EntityAllocator::new(0, 0));
        fill(&mut out);
        out.seal();
        store.apply(&mut out, SimTime::ZERO);
        let channels = ToolChannels::new(store.view(), SimTime::from_millis(33));
        Self { store, out, now: SimTime::ZERO, channels, cache: ToolCache::default() }
    }

    /// Writes, lets time pass, and returns what is told.
    fn after(&mut self, millis: u64, write: impl FnOnce(&mut Commands)) -> Messages {
        self.now += SimTime::from_millis(millis);
        self.out.clear();
        self.out.begin(self.now);
        write(&mut self.out);
        self.out.seal();
        self.store.apply(&mut self.out, self.now);
        let mut messages = Vec::new();
        let topics: BTreeMap<u16, &str> = channels().map(|channel| (channel.id, channel.topic)).collect();
        let mut message = |channel: u16, value: &Value| messages.push((topics[&channel], value.clone()));
        self.channels.tell(&mut self.cache, self.store.view(), self.now, &mut message);
        messages
    }
}

fn of<'a>(messages: &'a Messages, topic: &str) -> Vec<&'a Value> {
    messages.iter().filter(|(of, _)| *of == topic).map(|(_, message)| message).collect()
}

fn ids(message: &Value, list: &str) -> BTreeSet<String> {
    let entries = message[list].as_array().expect("a list").iter();
    entries.map(|entry| entry["id"].as_str().expect("an id").to_owned()).collect()
}

fn sheet(side: u32, height: f64) -> (SurfaceMesh, VertexPositions) {
    let row = side + 1;
    let quads = (0..side * side).map(|quad| quad / side * row + quad % side);
    let triangles = quads.flat_map(|a| [[a, a + 1, a + row + 1], [a, a + row + 1, a + row]]).collect();
    let points = (0..row * row).map(|v| Point3::new(f64::from(v % row), f64::from(v / row), height));
    (
        SurfaceMesh { triangles: Arc::new(triangles) },
        VertexPositions { positions: Arc::new(points.collect()) },
    )
}

fn task(phase: &str) -> TaskState {
    TaskState { task: "peg-transfer".into(), phase: phase.into(), steps: 12, ..TaskState::default() }
}

/// A scene with something of everything.
fn fill(out: &mut Commands) {
    for (entity, name) in [
        (INSTRUMENT, "grasper"),
        (HAND, "left hand"),
        (SPARE, "spare"),
        (BOARD, "board"),
        (LIVER, "liver"),
        (THREAD, "thread"),
        (BALL, "ball"),
    ] {
        out.spawn();
        out.put(entity, Name(name.into()));
    }
    out.put(INSTRUMENT, Instrument::default());
    out.put(INSTRUMENT, Pose::at(0.1, 0.2, 0.3));
    out.put(INSTRUMENT, JawState { angle: 0.5, ..JawState::default() });
    out.put(
        HAND,
        Hand { side: Side::Left, instrument: INSTRUMENT, world_from_device: Pose::default(), scale: 1.0 },
    );
    out.put(HAND, DeviceState { applied_force: Vector3::new(3.0, 0.0, 4.000_01), ..DeviceState::default() });
    out.put(HAND, DeviceForce { force: Vector3::new(0.0, 1.0, 0.0), ..DeviceForce::default() });
    out.put(EXERCISE, task("reach"));
    out.put(EXERCISE, Measured { values: BTreeMap::from([("cut_area_m2".to_owned(), 1.234_567_89e-4)]) });
    out.put(BOARD, Pose::at(0.0, 0.0, 0.0));
    out.put(
        BOARD,
        Shape::PegBoard {
            half_extents: [0.1, 0.1],
            thickness: 0.01,
            pegs: vec![[0.0, 0.0], [0.05, 0.05]],
            peg_radius: 0.002,
            peg_height: 0.02,
        },
    );
    out.put(BALL, Shape::Torus { ring_radius: 0.01, tube_radius: 0.002 });
    out.put(BALL, VisualMaterial { base_color: [1.0, 0.5, 0.0, 1.0], ..VisualMaterial::default() });
    let (surface, vertices) = sheet(30, 0.0);
    out.put(LIVER, surface);
    out.put(LIVER, vertices);
    let segments = (0..9).map(|point| [point, point + 1]).collect();
    out.put(THREAD, LineMesh { segments: Arc::new(segments), radius: 1e-4 });
    let points = (0..10).map(|point| Point3::new(f64::from(point) * 1e-3, 0.0, 0.0)).collect();
    out.put(THREAD, VertexPositions { positions: Arc::new(points) });
}

fn bend(out: &mut Commands) {
    out.put(LIVER, sheet(30, 0.25).1);
}

#[test]
fn every_message_keeps_to_the_schema_of_its_topic() {
    let mut told = Told::new(fill);
    let mut messages = told.after(10, |out| {
        bend(out);
        out.event("dropped", INSTRUMENT, Some(BALL), 1.5);
    });
    let mut message = |channel: u16, value: &Value| {
        let topic = channels().find(|one| one.id == channel).expect("a channel").topic;
        messages.push((topic, value.clone()));
    };
    told.channels.end(told.store.view(), &mut message);
    for Form { name, schema, channels, .. } in FORMS {
        let schema = schema();
        assert_eq!(schema["title"], name);
        let validator = jsonschema::validator_for(&schema).expect("a valid schema");
        let mut count = 0;
        for (_, topic) in channels {
            for message in of(&messages, topic) {
                let errors: Vec<String> =
                    validator.iter_errors(message).map(|error| error.to_string()).collect();
                assert!(errors.is_empty(), "{topic}: {errors:?} in {message}");
                count += 1;
            }
        }
        assert!(count > 0, "nothing was told on {channels:?}");
        assert!(!validator.is_valid(&json!({})), "{name}: the schema takes anything");
    }
}

/// Viewers read less than JSON Schema: each field has one type, and a choice has numbers with names.
#[test]
fn schemas_are_of_the_kind_that_viewers_read() {
    fn check(schema: &Value, at: &str) {
        match (schema.get("type"), schema.get("oneOf").and_then(Value::as_array)) {
            (Some(Value::String(_)), None) => {}
            (None, Some(choices)) => {
                assert!(choices.iter().all(|one| one["const"].is_u64() && one["title"].is_string()), "{at}");
            }
            _ => panic!("{at}: {schema}"),
        }
        for (name, field) in schema.get("properties").and_then(Value::as_object).into_iter().flatten() {
            check(field, &format!("{at}.{name}"));
        }
        for part in ["items", "additionalProperties"].iter().filter_map(|part| schema.get(part)) {
            check(part, &format!("{at}[]"));
        }
    }
    FORMS.iter().for_each(|form| check(&(form.schema)(), form.name));
}

#[test]
fn well_known_types_have_the_fields_that_viewers_look_for() {
    let fields = |schema: &Value| {
        let properties = schema["properties"].as_object().expect("properties");
        properties.keys().cloned().collect::<Vec<_>>().join(" ")
    };
    let transforms = super::schemas::transforms();
    let transform = &transforms["properties"]["transforms"]["items"];
    assert_eq!(transform["title"], "foxglove.FrameTransform");
    assert_eq!(fields(transform), "child_frame_id parent_frame_id rotation timestamp translation");
    let scene = super::schemas::scene();
    assert_eq!(fields(&scene), "deletions entities");
    assert_eq!(fields(&scene["properties"]["deletions"]["items"]), "id timestamp type");
    let entity = &scene["properties"]["entities"]["items"];
    assert_eq!(
        fields(entity),
        "arrows cubes cylinders frame_id frame_locked id lifetime lines metadata models spheres texts timestamp \
         triangles"
    );
    for (list, wanted) in [
        ("cubes", "color pose size"),
        ("spheres", "color pose size"),
        ("cylinders", "bottom_scale color pose size top_scale"),
        ("lines", "color colors indices points pose scale_invariant thickness type"),
        ("triangles", "color colors indices points pose"),
    ] {
        assert_eq!(fields(&entity["properties"][list]["items"]), wanted, "{list}");
    }
}

#[test]
fn every_frame_has_a_name_of_its_own_and_a_parent_that_is_a_frame() {
    const ROD: Entity = entity(8);
    let mut told = Told::new(|out| {
        fill(out);
        out.spawn();
        // Two have one name, one has that of the world, and a parent has no pose.
        out.put(BALL, Name("grasper".into()));
        out.put(BALL, Pose::at(0.0, 0.0, 1.0));
        out.put(THREAD, Name("world".into()));
        out.put(THREAD, Pose::at(0.0, 0.0, 2.0));
        out.put(THREAD, Parent(LIVER));
        out.put(LIVER, Parent(BOARD));
        out.put(ROD, Pose::at(0.123_456_789, -1e-9, 0.0));
    });
    let messages = told.after(10, |_| {});
    assert!(of(&messages, TF).is_empty(), "nothing has moved");
    let transforms = of(&messages, TF_STATIC)[0]["transforms"].as_array().expect("a list").clone();
    let name = |of: &Value, which: &str| of[which].as_str().expect("a name").to_owned();
    let children: Vec<String> = transforms.iter().map(|one| name(one, "child_frame_id")).collect();
    let wanted =
        ["grasper", "grasper/jaw_a", "grasper/jaw_b", "board", "world (0:0:6)", "grasper (0:0:7)", "0:0:8"];
    assert_eq!(children, wanted);
    let parents: Vec<String> = transforms.iter().map(|one| name(one, "parent_frame_id")).collect();
    assert_eq!(parents, ["world", "grasper", "grasper", "world", "board", "world", "world"]);
    assert_eq!(transforms[6]["translation"], json!({"x": 0.123457, "y": 0.0, "z": 0.0}));
    // Everything that is to be seen lies in one of them.
    let frames: BTreeSet<String> = children.into_iter().chain(["world".to_owned()]).collect();
    for message in of(&messages, SCENE) {
        for entity in message["entities"].as_array().expect("a list") {
            assert!(frames.contains(&name(entity, "frame_id")), "{}", entity["frame_id"]);
        }
    }
}

#[test]
fn a_frame_rests_until_it_has_moved_and_each_message_has_all_of_its_kind() {
    let mut told = Told::new(fill);
    let children = |messages: &Messages, topic: &str| {
        let told = of(messages, topic);
        assert!(told.len() <= 1, "{told:?}");
        let list = told
            .first()
            .map_or(Vec::new(), |message| message["transforms"].as_array().expect("a list").clone());
        list.iter().map(|one| one["child_frame_id"].as_str().expect("a name").to_owned()).collect::<Vec<_>>()
    };
    let all = ["grasper", "grasper/jaw_a", "grasper/jaw_b", "board"];
    assert_eq!(children(&told.after(10, |_| {}), TF_STATIC), all);
    // Jaws that hardly move, and a pose that is put again as it is, rest.
    let jaw = |angle| JawState { angle, ..JawState::default() };
    let still = told.after(40, |out| {
        out.put(INSTRUMENT, jaw(0.500_1));
        out.put(BOARD, Pose::at(0.0, 0.0, 0.0));
    });
    assert!(children(&still, TF).is_empty() && children(&still, TF_STATIC).is_empty());
    assert_eq!(children(&told.after(40, |out| out.put(INSTRUMENT, jaw(0.51))), TF), all[1..3]);
    // What has moved is told with everything that moves; what comes later moves.
    let moved = told.after(40, |out| {
        out.put(INSTRUMENT, Pose::at(0.0, 0.0, 0.3));
        out.put(BALL, Pose::at(0.0, 0.0, 0.1));
    });
    assert_eq!(children(&moved, TF), ["grasper", "grasper/jaw_a", "grasper/jaw_b", "ball"]);
    // Where a reader may begin both are told, and what is gone no longer.
    told.channels.begin_anew();
    let anew = told.after(40, |out| out.despawn(BALL));
    assert_eq!(
        (children(&anew, TF_STATIC), children(&anew, TF)),
        (vec!["board".to_owned()], all[..3].iter().map(|name| (*name).to_owned()).collect())
    );
    assert!(children(&told.after(40, |_| {}), TF).is_empty(), "nothing has moved");
}

#[test]
fn frames_that_come_into_an_empty_scene_are_told_at_once() {
    let mut told = Told::new(|_| {});
    told.store = Store::new(told.store.view().registry().clone());
    let mut nothing = |_: u16, _: &Value| panic!("there is nothing to tell");
    told.channels.tell(&mut told.cache, told.store.view(), SimTime::ZERO, &mut nothing);
    let first = told.after(40, |out| {
        out.spawn();
        out.put(INSTRUMENT, Pose::at(0.0, 0.0, 0.1));
    });
    assert_eq!(of(&first, TF)[0]["transforms"].as_array().map(Vec::len), Some(1));
}

#[test]
fn each_message_of_the_scene_shows_everything_and_deletes_what_is_gone() {
    let mut told = Told::new(fill);
    let first = told.after(10, bend);
    let names = |all: &[&str]| all.iter().map(|name| (*name).to_owned()).collect::<BTreeSet<_>>();
    let fixed = names(&["ball", "board", "grasper", "grasper/jaw_a", "grasper/jaw_b", "thread"]);
    assert_eq!(ids(of(&first, SCENE)[0], "entities"), fixed);
    assert_eq!(ids(of(&first, SCENE_DEFORMING)[0], "entities"), names(&["liver"]));
    // Nothing within a second, then what deforms; the rest when it looks different, or when a reader may begin.
    let within = told.after(500, bend);
    assert!(of(&within, SCENE).is_empty() && of(&within, SCENE_DEFORMING).is_empty());
    let later = told.after(600, bend);
    assert_eq!((of(&later, SCENE).len(), of(&later, SCENE_DEFORMING).len()), (0, 1));
    let material = VisualMaterial { base_color: [0.0, 1.0, 0.0, 1.0], ..VisualMaterial::default() };
    assert_eq!(of(&told.after(1_000, |out| out.put(BALL, material)), SCENE).len(), 1);
    told.channels.begin_anew();
    let anew = told.after(1, |_| {});
    assert_eq!(ids(of(&anew, SCENE)[0], "entities"), fixed);
    assert_eq!(ids(of(&anew, SCENE_DEFORMING)[0], "entities"), names(&["liver"]));
    // A thread that begins to move changes over; a ball goes.
    let moves = told.after(1_000, |out| {
        out.put(THREAD, VertexPositions { positions: Arc::new(vec![Point3::origin(); 10]) });
        out.despawn(BALL);
    });
    assert_eq!(ids(of(&moves, SCENE)[0], "deletions"), names(&["ball", "thread"]));
    assert_eq!(ids(of(&moves, SCENE_DEFORMING)[0], "entities"), names(&["liver", "thread"]));
}

#[test]
fn a_message_of_the_scene_is_short_however_large_the_bodies_are() {
    let mut told = Told::new(|out| {
        fill(out);
        for number in 10..60 {
            let (surface, vertices) = sheet(100, 0.0);
            let sheet = out.spawn();
            assert_eq!(sheet.counter(), number - 2);
            out.put(sheet, surface);
            out.put(sheet, vertices);
        }
    });
    let messages = told.after(10, bend);
    let fixed = of(&messages, SCENE)[0].to_string().len();
    assert!((500_000..1_050_000).contains(&fixed), "as much as may be: {fixed}");
    let deforming = of(&messages, SCENE_DEFORMING)[0];
    let points = deforming["entities"][0]["triangles"][0]["points"].as_array().expect("points");
    assert!((300..=500).contains(&points.len()), "{}", points.len());
    assert!(deforming.to_string().len() < 40_000, "{}", deforming.to_string().len());
}

#[test]
fn forces_are_told_with_their_magnitudes() {
    let messages = Told::new(fill).after(10, |_| {});
    let hand = of(&messages, HAND_LEFT)[0];
    assert_eq!((&hand["hand"], &hand["side"]), (&json!("left hand"), &json!("left")));
    assert_eq!(hand["applied"], json!({"x": 3.0, "y": 0.0, "z": 4.0}));
    assert_eq!((&hand["applied_norm"], &hand["commanded_norm"]), (&json!(5.0), &json!(1.0)));
    assert_eq!((&hand["jaw"], &hand["gripper"]), (&json!(0.5), &json!(0.0)));
}

#[test]
fn what_is_judged_is_told_at_once_and_the_clock_ten_times_a_second() {
    let mut told = Told::new(fill);
    told.channels.met(WriterId(3), "judge");
    let first = told.after(10, |_| {});
    assert_eq!(
        (&of(&first, PHASES)[0]["phase"], &of(&first, PHASES)[0]["exercise"]),
        (&json!("reach"), &json!("judge"))
    );
    assert_eq!(of(&first, MEASURED)[0]["controller"], "judge");
    assert_eq!(of(&first, MEASURED)[0]["values"], json!({"cut_area_m2": 1.23457e-4}));
    let at = |phase: &str, seconds| TaskState { seconds, ..task(phase) };
    let ticks: usize = (1..100)
        .map(|tick| {
            let messages = told.after(10, |out| out.put(EXERCISE, at("reach", f64::from(tick) * 0.01)));
            assert!(of(&messages, PHASES).is_empty());
            of(&messages, TASK).len()
        })
        .sum();
    assert!((9..=11).contains(&ticks), "{ticks}");
    let next = told.after(1, |out| out.put(EXERCISE, at("lift", 1.0)));
    assert_eq!(
        (&of(&next, PHASES)[0]["phase"], &of(&next, PHASES)[0]["before"]),
        (&json!("lift"), &json!("reach"))
    );
    assert_eq!(of(&next, TASK)[0].get("score"), None, "what has no value is left out");
    let error = TaskError { kind: "drop_in_view".into(), at_secs: 1.0, entity: None };
    let end = TaskState {
        over: true,
        completed: true,
        score: Some(87.654_321_9),
        errors: vec![error],
        ..at("lift", 1.1)
    };
    let last = told.after(1, |out| out.put(EXERCISE, end));
    let last = of(&last, TASK)[0];
    assert_eq!((&last["score"], &last["errors"]), (&json!(87.6543), &json!(1)));
    assert_eq!((&last["last_error"], &last["completed"]), (&json!("drop_in_view"), &json!(true)));
}
