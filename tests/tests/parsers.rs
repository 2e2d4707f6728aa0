//! Robustness of every reader of outside data against malformed input: it must not panic or hang, must not use more
//! memory than a fixed multiple of its input, and must report the error and its place. Meshes, keyframes and batches
//! have tests beside their readers; docs/guarantees.md lists them all.

use std::cell::RefCell;
use std::path::Path;

use proptest::prelude::*;
use proptest::sample::select;
use proptest::test_runner::TestCaseError;
use serde::Deserialize;
use serde::de::IntoDeserializer;
use serde::de::value::Error as ValueError;
use trocar::app::{App, SCENARIOS};
use trocar::plans::PLANS;
use trocar::run::RunOptions;
use trocar_devices::{
    DeviceSpec, JigsawsSelection, JigsawsSide, JigsawsSource, StartTime, read_hand_csv_from,
    read_jigsaws_from,
};
use trocar_input::Skill;
use trocar_kernel::faults::FaultPlan;
use trocar_kernel::recorder::{Item, Recording, RecordingError, Replay};
use trocar_scene::scenario::{Scenario, ScenarioError};
use trocar_scene::{Commands, DeviceState, Entity, EntityAllocator};
use trocar_test_support::allocations::peak_of;
use trocar_test_support::hostile::mutated;
use trocar_tests::{app, edited, finish};

type Checked = Result<(), TestCaseError>;

/// Memory per byte of input, and memory that any input may cost.
struct Bound {
    per_byte: usize,
    always: usize,
}

impl Bound {
    fn holds(&self, peak: usize, input: usize) -> Checked {
        let allowed = self.per_byte * input + self.always;
        prop_assert!(peak <= allowed, "{} bytes for an input of {}, allowed are {}", peak, input, allowed);
        Ok(())
    }
}

/// A TOML value of one character ("a=0\n" is four) becomes a table entry with the places of key and value, twice: as a
/// document and as parsed data.
const TOML: Bound = Bound { per_byte: 1_024, always: 256 << 10 };

/// Memory for a mesh that a scenario generates.
const MADE_MESH: usize = 16 << 20;

thread_local! {
    static APP: App = app();
}

fn scenarios() -> Vec<Vec<u8>> {
    SCENARIOS.iter().map(|(_, text)| text.as_bytes().to_vec()).collect()
}

/// Whether a message begins with `file:line:column:`.
fn names_a_place(message: &str, file: &str) -> bool {
    let mut parts = message.splitn(4, ':');
    parts.next() == Some(file)
        && parts.next().is_some_and(|line| line.parse::<u32>().is_ok_and(|line| line > 0))
        && parts.next().is_some_and(|column| column.parse::<u32>().is_ok_and(|column| column > 0))
        && parts.next().is_some_and(|rest| rest.len() > 1)
}

fn check_scenario(text: &str) -> Checked {
    APP.with(|app| {
        let file = Path::new("hostile.toml");
        let (parsed, peak) = peak_of(|| Scenario::parse(file, text, app.registry()));
        // A few letters may request a mesh of thousands of elements: each is generated within its own limits.
        let asked = text.matches("mesh").count();
        Bound { always: TOML.always + asked * MADE_MESH, ..TOML }.holds(peak, text.len())?;
        match parsed {
            Ok(scenario) => {
                // An accepted scenario can be spawned, and every controller's parameters are checked without a panic.
                let (spawned, peak) = peak_of(|| scenario.spawn(app.registry()));
                TOML.holds(peak, text.len())?;
                prop_assert!(spawned.is_ok());
            }
            // A mesh name created by a mutation: the place is that of the reference.
            Err(error @ (ScenarioError::Invalid { .. } | ScenarioError::Mesh { .. })) => {
                let message = error.to_string();
                prop_assert!(names_a_place(&message, "hostile.toml"), "{}", message);
            }
            Err(error) => prop_assert!(false, "{}", error),
        }
        Ok(())
    })
}

const PLAN: &str = r#"schema = 1
seed = 42
[[fault]]
id = "left-hand dies"
at_secs = 3.0
target = "haptics.left"
kind = "kill"
[[fault]]
at_secs = 5.0
for_secs = 10.0
target = "network.station-2"
kind = "drop"
probability = 0.05
[[fault]]
at_secs = 1.0
for_secs = 1.0
target = "engine"
kind = "slow"
step_secs = 0.01
[[fault]]
at_secs = 1.0
for_secs = 1.0
target = "network.a"
kind = "delay"
delay_secs = 0.1
[expect]
recovery_secs_max = 0.1
force_newtons_max = 3.3
model_restarts_max = 0
task_completed = true
"#;

fn plans() -> Vec<Vec<u8>> {
    let ready = PLANS.iter().map(|(_, text)| *text);
    ready.chain([PLAN]).map(|text| text.as_bytes().to_vec()).collect()
}

fn check_plan(text: &str) -> Checked {
    let (parsed, peak) = peak_of(|| FaultPlan::parse(text, "hostile.toml"));
    TOML.holds(peak, text.len())?;
    match parsed {
        Ok(plan) => {
            for fault in &plan.faults {
                prop_assert!((0.0..=1.0).contains(&fault.probability), "{:?}", fault);
                prop_assert!(fault.at.as_secs_f64() <= 1e6, "{:?}", fault);
            }
        }
        Err(error) => {
            let message = error.to_string();
            prop_assert!(message.starts_with("hostile.toml: "), "{}", message);
            let place = ["line ", "fault ", "expect", "schema", "faults"];
            prop_assert!(place.iter().any(|place| message.contains(place)), "{}", message);
        }
    }
    Ok(())
}

const HAND: &str = "t,x,y,z,qw,qx,qy,qz,gripper\n\
    0.000,0.010,0.020,-0.030,1,0,0,0,0.5\n\
    0.001,0.011,0.020,-0.030,0.7071067811865476,0.7071067811865476,0,0,0.25\n\
    0.002,0.012,0.020,-0.030,0,0,1,0,0\n";

/// Three frames at rest: 76 columns, four manipulators of 19.
fn jigsaws() -> String {
    let block = "0.01 0.02 -0.03 1 0 0 0 1 0 0 0 1 0 0 0 0 0 0 0.5";
    let row = [block; 4].join(" ");
    format!("{row}\n{row}\n{row}\n")
}

/// Rows become 200 bytes of state each, in a vector that doubles; a CSV row has at least 18 bytes.
const ROWS: Bound = Bound { per_byte: 128, always: 256 << 10 };

fn check_hand(bytes: &[u8]) -> Checked {
    for start in [StartTime::File, StartTime::Zero] {
        let (read, peak) = peak_of(|| read_hand_csv_from(bytes, "hand.csv", start, None));
        ROWS.holds(peak, bytes.len())?;
        check_trajectory(read.map_err(|error| error.to_string()), "hand.csv")?;
    }
    for side in [JigsawsSide::Left, JigsawsSide::Right] {
        for source in [JigsawsSource::Slave, JigsawsSource::Master] {
            let selection = JigsawsSelection { side, source };
            let (read, peak) = peak_of(|| read_jigsaws_from(bytes, "hand.txt", selection));
            ROWS.holds(peak, bytes.len())?;
            check_trajectory(read.map_err(|error| error.to_string()), "hand.txt")?;
        }
    }
    Ok(())
}

fn check_trajectory(read: Result<trocar_devices::Trajectory, String>, file: &str) -> Checked {
    match read {
        Ok(trajectory) => {
            for time_ns in [0, trajectory.start_ns(), trajectory.end_ns(), u64::MAX] {
                prop_assert!(trajectory.at(time_ns).is_valid());
            }
        }
        Err(message) => {
            prop_assert!(message.starts_with(file), "{}", message);
            let place = ["line ", "point ", "no rows"];
            prop_assert!(place.iter().any(|place| message.contains(place)), "{}", message);
        }
    }
    Ok(())
}

const SPECS: [&str; 5] = [
    "virtual",
    "virtual:impedance=off, mass=0.05,outputs=6,workspace=0.2x0.1x0.1,friction=0.1",
    "replay:no-such-file.csv,force=on,arm_stiffness=300,start=zero",
    "jigsaws:no-such-file.txt,side=left,source=slave,scale=1.0,centre=on,roll=1.5",
    "recording:no-such-file.mcap",
];

/// A device's text as a scenario or `--hand NAME=SPEC` gives it.
fn check_spec(text: &str) -> Checked {
    let (parsed, peak) = peak_of(|| text.parse::<DeviceSpec>());
    Bound { per_byte: 64, always: 16 << 10 }.holds(peak, text.len())?;
    match parsed {
        Ok(DeviceSpec::Virtual(config)) => prop_assert!(config.check().is_ok()),
        Ok(DeviceSpec::Replay { force, .. } | DeviceSpec::Jigsaws { force, .. }) => {
            prop_assert!(force.is_none_or(|config| config.check().is_ok()));
        }
        Err(error) => {
            // Kinds, keys and values are quoted with control characters escaped.
            let message = error.to_string();
            prop_assert!(!message.is_empty() && !message.contains(char::is_control), "{:?}", message);
        }
    }
    Ok(())
}

/// A short recording of the wall, unchanged and without checksums, so that damage reaches the decoders behind them.
fn recordings() -> Vec<Vec<u8>> {
    let app = app();
    let scenario = edited(&app, "wall", &[]);
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("wall.mcap");
    let record = Some(file.clone());
    finish(
        &app,
        &scenario,
        &RunOptions { lockstep: true, seconds: Some(0.05), record, ..RunOptions::default() },
    );
    let whole = std::fs::read(&file).expect("written");
    let mut unchecked = whole.clone();
    clear_checksums(&mut unchecked);
    assert_ne!(whole, unchecked);
    vec![whole, unchecked.clone(), unchecked]
}

/// Sets the checksum of every chunk of an MCAP file to "none".
fn clear_checksums(bytes: &mut [u8]) {
    const CHUNK: u8 = 0x06;
    let mut at = 8;
    while let Some(length) = bytes.get(at + 1..at + 9).and_then(|length| length.try_into().ok()) {
        if bytes[at] == CHUNK {
            bytes[at + 33..at + 37].fill(0);
        }
        at = at.saturating_add(9).saturating_add(u64::from_le_bytes(length) as usize);
    }
}

/// A chunk is held as bytes, as the pieces cut out of it, and as the scene that they make.
const RECORDING: Bound = Bound { per_byte: 384, always: 1 << 20 };

fn check_recording(bytes: &[u8]) -> Checked {
    thread_local! {
        static FOLDER: RefCell<tempfile::TempDir> = RefCell::new(tempfile::tempdir().expect("a folder"));
    }
    let file = FOLDER.with(|folder| folder.borrow().path().join("hostile.mcap"));
    std::fs::write(&file, bytes).expect("written");
    let place = |error: RecordingError| {
        let message = error.to_string();
        prop_assert!(message.contains("hostile.mcap"), "{}", message);
        Ok(())
    };
    APP.with(|app| {
        let registry = app.registry();
        let (opened, peak) = peak_of(|| Recording::open(&file));
        RECORDING.holds(peak, bytes.len())?;
        let recording = match opened {
            Ok(recording) => recording,
            Err(error) => return place(error),
        };
        let (replayed, peak) =
            peak_of(|| Replay::new(&recording, registry).and_then(|mut replay| replay.run_to_end()));
        RECORDING.holds(peak, bytes.len())?;
        replayed.map(|_| ()).or_else(place)?;
        let (read, peak) = peak_of(|| {
            for item in recording.items() {
                if let Item::Keyframe(keyframe) = item? {
                    // Whether refused or not, it must not panic.
                    let _ = keyframe.load(registry);
                }
            }
            recording.series::<DeviceState>(registry, Entity::new(0, 0, 3)).map(|_| ())
        });
        RECORDING.holds(peak, bytes.len())?;
        read.or_else(place)
    })
}

/// One value of every component that occurs in a peg transfer, with a virtual trainee or a person: its NAME and its
/// bytes.
fn components() -> Vec<(&'static str, Vec<u8>)> {
    APP.with(|app| {
        let mut found: Vec<(&'static str, Vec<u8>)> = Vec::new();
        for play in [false, true] {
            let options = RunOptions { lockstep: true, seconds: Some(0.05), play, ..RunOptions::default() };
            let scene = finish(app, &edited(app, "peg-transfer", &[]), &options).kernel.snapshot;
            for (id, entry) in app.registry().iter() {
                let (mut first, mut bytes) = (None, Vec::new());
                let column = scene.erased_column(id);
                column.for_each_entity(&mut |entity| first = first.or(Some(entity)));
                let known = found.iter().any(|(name, _)| *name == entry.name);
                if !known
                    && first.is_some_and(|entity| column.encode_row(entity, &mut bytes).expect("encodes"))
                {
                    found.push((entry.name, bytes));
                }
            }
        }
        assert!(found.len() >= 15, "{} components", found.len());
        found
    })
}

/// A row, its place in the command buffer, and its content: the largest values are states of controllers.
const COMPONENT: Bound = Bound { per_byte: 128, always: 64 << 10 };

fn check_component(name: &str, bytes: &[u8]) -> Checked {
    APP.with(|app| {
        let registry = app.registry();
        let id = registry.by_name(name).expect("registered");
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 1));
        let (read, peak) = peak_of(|| {
            registry.put_postcard(id, &mut commands, Entity::new(0, 1, 1), bytes).map(<[u8]>::len)
        });
        COMPONENT.holds(peak, bytes.len())?;
        prop_assert_eq!(read.is_ok(), !commands.is_empty());
        prop_assert!(commands.puts().all(|(_, puts)| puts.check().is_ok()), "{}", name);
        Ok(())
    })
}

fn lossy(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn words(alphabet: &'static str) -> impl Strategy<Value = String> {
    prop::collection::vec(alphabet, 0..40).prop_map(|words| words.concat())
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(250) })]

    #[test]
    fn scenario_toml(
        text in prop_oneof![
            3 => mutated(scenarios()).prop_map(|bytes| lossy(&bytes)),
            1 => words("(schema = 1\n|name = \"a\"\n|\\[\\[entity\\]\\]\n|\\[a\\]\n|pose = |\\{|\\}|\\[|\\]|[a-z]{1,4}|=|\"|[0-9.e-]{1,5}|\n)"),
            1 => "\\PC{0,200}",
        ],
    ) {
        check_scenario(&text)?;
    }

    #[test]
    fn fault_plan_toml(
        text in prop_oneof![
            3 => mutated(plans()).prop_map(|bytes| lossy(&bytes)),
            1 => words("(schema = 1\n|\\[\\[fault\\]\\]\n|at_secs = |target = \"a\"\n|kind = \"(kill|drop|slow)\"\n|[0-9.e-]{1,5}|\n|nan|inf)"),
            1 => "\\PC{0,200}",
        ],
    ) {
        check_plan(&text)?;
    }

    #[test]
    fn hand_csv_and_jigsaws_kinematics(
        bytes in prop_oneof![
            4 => mutated(vec![HAND.into(), jigsaws().into_bytes(), jigsaws().replace(' ', ",").into_bytes()]),
            1 => prop::collection::vec(any::<u8>(), 0..400),
        ],
    ) {
        check_hand(&bytes)?;
    }

    #[test]
    fn device_spec_strings(
        text in prop_oneof![
            3 => mutated(SPECS.iter().map(|spec| spec.as_bytes().to_vec()).collect()).prop_map(|bytes| lossy(&bytes)),
            1 => words("(virtual|replay|jigsaws|:|,|=|[a-z_]{1,8}|on|off|nan|inf|-?[0-9.ex]{1,6})"),
            1 => "\\PC{0,80}",
        ],
    ) {
        check_spec(&text)?;
    }

    #[test]
    fn names_of_skills_and_entities(
        text in prop_oneof![
            "\\PC{0,40}",
            "[0-9]{0,22}:[0-9]{0,22}:[0-9]{0,22}(:[0-9])?",
            select(vec!["novice", "intermediate", "expert"]).prop_map(str::to_owned),
        ],
    ) {
        let skill: Result<Skill, ValueError> = Skill::deserialize(text.as_str().into_deserializer());
        prop_assert_eq!(skill.is_ok(), ["novice", "intermediate", "expert"].contains(&text.as_str()));
        if let Ok(entity) = text.parse::<Entity>() {
            prop_assert_eq!(entity.to_string().parse(), Ok(entity));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(1_000) })]

    #[test]
    fn components_of_the_program(
        (name, bytes) in select(components()).prop_flat_map(|(name, bytes)| (Just(name), mutated(vec![bytes]))),
        noise in prop::collection::vec(any::<u8>(), 0..200),
    ) {
        check_component(name, &bytes)?;
        check_component(name, &noise)?;
    }
}

proptest! {
    // Each case replays a recording.
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(150) })]

    #[test]
    fn mcap_recordings(
        bytes in prop_oneof![
            8 => mutated(recordings()),
            1 => prop::collection::vec(any::<u8>(), 0..400),
            1 => prop::collection::vec(any::<u8>(), 0..400)
                .prop_map(|bytes| [b"\x89MCAP0\r\n".as_slice(), &bytes].concat()),
        ],
    ) {
        check_recording(&bytes)?;
    }
}

#[test]
fn what_the_mutations_start_from_is_valid() {
    APP.with(|app| {
        for text in scenarios() {
            Scenario::parse("a.toml".as_ref(), &lossy(&text), app.registry()).expect("valid");
        }
        for text in plans() {
            FaultPlan::parse(&lossy(&text), "a.toml").expect("valid");
        }
        read_hand_csv_from(HAND.as_bytes(), "a.csv", StartTime::File, None).expect("valid");
        let selection = JigsawsSelection { side: JigsawsSide::Left, source: JigsawsSource::Slave };
        read_jigsaws_from(jigsaws().as_bytes(), "a.txt", selection).expect("valid");
        for spec in &SPECS[..4] {
            spec.parse::<DeviceSpec>().expect("valid");
        }
        let folder = tempfile::tempdir().expect("a folder");
        for (n, bytes) in recordings().into_iter().enumerate() {
            let file = folder.path().join(format!("{n}.mcap"));
            std::fs::write(&file, bytes).expect("written");
            let recording = Recording::open(&file).expect("valid");
            assert!(recording.is_complete());
            Replay::new(&recording, app.registry()).expect("valid").run_to_end().expect("the recorded hash");
        }
    });
}

/// Texts that would cost more than linear time in a parser with recursion or pairwise comparison.
#[test]
fn deep_and_wide_documents_are_refused_or_read_in_time() {
    let deep_keys = format!("{}=1\n", vec!["a"; 100_000].join("."));
    let deep_arrays = format!("a={}\n", "[".repeat(100_000));
    let deep_tables = format!("a={}\n", "{a=".repeat(100_000));
    let deep_header = format!("[{}]\n", vec!["a"; 100_000].join("."));
    // As deep as the TOML reader allows, in every way at once.
    let dots = vec!["a"; 79].join(".");
    let nested = format!("[{dots}]\n{dots} = {}1{}\n", format!("{{{dots}=").repeat(78), "}".repeat(78));
    for text in [deep_keys, deep_arrays, deep_tables, deep_header, nested] {
        let text = format!("schema = 1\nname = \"a\"\n[task]\n{text}");
        check_scenario(&text).expect("refused or read");
        check_plan(&text).expect("refused");
    }
    // A chain of parents through every entity, from both ends.
    for reversed in [false, true] {
        let mut text = String::from("schema = 1\nname = \"chain\"\n");
        for n in 0..20_000 {
            let (name, parent) = if reversed { (20_000 - n, 19_999 - n) } else { (n, n + 1) };
            text += &format!("[[entity]]\nname = \"e{name:05}\"\nparent = \"e{parent:05}\"\n");
        }
        let last = if reversed { 0 } else { 20_000 };
        text += &format!("[[entity]]\nname = \"e{last:05}\"\n");
        let begun = std::time::Instant::now();
        check_scenario(&text).expect("read");
        assert!(begun.elapsed().as_secs() < 60, "{:?}", begun.elapsed());
    }
}
