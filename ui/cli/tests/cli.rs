//! The program from outside: what it prints, how it ends, what it leaves behind.

use std::path::Path;
use std::process::Command;

use serde_json::Value;

use crate::support::{assert_valid, here, object, stderr, stdout, trocar};

/// A program of one's own, built beside this test as an example.
#[test]
fn a_program_with_a_controller_of_its_own_has_the_whole_command_line() {
    let program = Path::new(env!("CARGO_BIN_EXE_trocar")).with_file_name("examples").join("haste");
    let folder = here();
    let run = |arguments: &[&str]| {
        let output = Command::new(&program).args(arguments).current_dir(folder.path()).output();
        output.unwrap_or_else(|error| panic!("{}: {error}", program.display()))
    };
    let output =
        run(&["run", "peg-transfer", "--lockstep", "--seconds", "8", "--no-record", "--no-report", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let summary = object(&output);
    let rows = summary["controllers"].as_array().expect("rows");
    let row = rows.iter().find(|row| row["name"] == "watcher").expect("the program's own controller");
    assert_eq!((row["scheduled"].as_u64(), row["rejected"].as_u64()), (Some(800), Some(0)));
    assert!(stdout(&run(&["list", "components"])).contains("haste"));
    assert!(stdout(&run(&["graph", "wall"])).contains("watcher"));
    assert!(stdout(&run(&["--help"])).contains("Usage: haste"));
}

/// A viewer that knows nothing of windows and graphics cards, built beside this test as an example.
#[test]
fn a_viewer_of_ones_own_shows_a_session_on_a_terminal() {
    let program = Path::new(env!("CARGO_BIN_EXE_trocar")).with_file_name("examples").join("plan_view");
    let output = Command::new(&program).output();
    let output = output.unwrap_or_else(|error| panic!("{}: {error}", program.display()));
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let text = stdout(&output);
    let pictures: Vec<&str> = text.split("\x1b[H\x1b[2J").skip(1).collect();
    assert_eq!(pictures.len(), 20);
    for picture in &pictures {
        // Each tip may be over a ring.
        assert!((4..=6).contains(&picture.matches('o').count()), "six rings can move:\n{picture}");
        assert!(picture.contains('L') && picture.contains('R'), "{picture}");
    }
    assert_eq!(pictures[0].matches('o').count(), 6, "nobody is there yet:\n{}", pictures[0]);
    let place = |picture: &str| picture.find('L');
    assert!(pictures.iter().any(|picture| place(picture) != place(pictures[0])), "nothing moves:\n{text}");
}

#[test]
fn the_fault_table_can_be_asked_for_and_ready_plans_are_known_by_name() {
    let folder = here();
    assert!(stdout(&trocar(folder.path(), &["faults", "verify", "--help"])).contains("--lockstep"));
    assert!(stdout(&trocar(folder.path(), &["list", "plans"])).contains("bad-day"));
    let wrong =
        trocar(folder.path(), &["run", "peg-transfer", "--lockstep", "--faults", "bad-dya", "--no-record"]);
    assert_eq!(wrong.status.code(), Some(4));
    assert!(stderr(&wrong).contains("did you mean 'bad-day'"), "{}", stderr(&wrong));
}

#[test]
fn a_run_prints_one_object_that_keeps_the_contract_and_leaves_its_files() {
    let folder = here();
    let output = trocar(
        folder.path(),
        &["run", "peg-transfer", "--lockstep", "--seconds", "2", "--seed", "5", "--json"],
    );
    assert_eq!(output.status.code(), Some(0), "cut off by --seconds is no failure: {}", stderr(&output));
    let summary = object(&output);
    assert_valid("run", &summary);
    assert_eq!(summary["mode"], "lockstep");
    assert_eq!(summary["scenario"], "peg-transfer");
    assert_eq!(summary["seed"], 5);
    assert_eq!(summary["task"]["completed"], false);
    assert_eq!(summary["task"]["cut_off"], true);
    assert_eq!(summary["task"]["score"], Value::Null);
    assert_eq!(summary["error"], Value::Null);
    assert_eq!(summary["recording_complete"], true);
    let sim_secs = summary["sim_secs"].as_f64().expect("a number");
    assert!((sim_secs - 2.0).abs() < 0.02, "{sim_secs}");
    for row in summary["controllers"].as_array().expect("rows") {
        let scheduled = row["scheduled"].as_u64().expect("a count") as f64;
        let expected = row["target_hz"].as_f64().expect("a rate") * sim_secs;
        assert!(
            (scheduled - expected).abs() <= 1.0,
            "{}: {scheduled} ticks, expected {expected}",
            row["name"]
        );
        assert_eq!(row["missed"], 0, "{}", row["name"]);
    }
    let report = std::fs::read_to_string(folder.path().join("report-peg-transfer.html")).expect("a report");
    assert!(report.contains("not clinically validated") && report.contains("<svg"));
    let names: Vec<String> = std::fs::read_dir(folder.path())
        .expect("a folder")
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    assert_eq!(names.len(), 2, "nothing half-written is left: {names:?}");

    let replayed = trocar(folder.path(), &["replay", "peg-transfer.mcap", "--json"]);
    assert_eq!(replayed.status.code(), Some(0), "{}", stderr(&replayed));
    let replay = object(&replayed);
    assert_valid("run", &replay);
    assert_eq!(replay["mode"], "replay");
    assert_eq!(replay["state_hash"], summary["state_hash"]);
    assert_eq!(replay["task"], summary["task"]);
}

#[test]
fn two_processes_with_one_seed_end_in_one_hash_and_another_seed_in_another() {
    let folder = here();
    let hash = |seed: &str| {
        let arguments = [
            "run",
            "peg-transfer",
            "--lockstep",
            "--seconds",
            "3",
            "--seed",
            seed,
            "--json",
            "--no-record",
            "--no-report",
        ];
        object(&trocar(folder.path(), &arguments))["state_hash"].as_str().expect("a hash").to_owned()
    };
    let first = hash("7");
    assert_eq!(first, hash("7"));
    assert_ne!(first, hash("8"));
}

#[test]
fn the_gallery_of_detectors_tells_rate_cost_and_hits_of_each_method() {
    let folder = here();
    let options = ["--seconds", "1.5", "--no-record", "--no-report"];
    let run =
        |how: &[&str]| trocar(folder.path(), &[&["run", "collision-gallery"], how, &options[..]].concat());
    // A live run tells the same of each; how much there is to find in 1.5 s depends on the machine.
    let live = object(&run(&["--json"]));
    assert_valid("run", &live);
    let summary = object(&run(&["--json", "--lockstep"]));
    assert_valid("run", &summary);
    let rows = summary["controllers"].as_array().expect("rows");
    let live = live["controllers"].as_array().expect("rows");
    let kinds = [
        "obb-tree",
        "proximity",
        "continuous",
        "spherical-hash",
        "dynamic-point",
        "z-buffer",
        "finger-proxy",
        "rapier",
    ];
    for kind in kinds {
        let row = rows.iter().find(|row| row["kind"] == kind).unwrap_or_else(|| panic!("no row of {kind}"));
        let number = |of: &Value| of.as_f64().unwrap_or_else(|| panic!("{kind}: {row}"));
        assert!(number(&row["hits"]["mean"]) > 0.0 && number(&row["hits"]["max"]) > 0.0, "{row}");
        assert!(row["hits"]["ticks"].as_u64().is_some_and(|ticks| ticks > 0), "{row}");
        assert!(number(&row["achieved_hz"]) > 0.0 && number(&row["step_us"]["p50"]) > 0.0, "{row}");
        assert!(number(&row["step_us"]["p99"]) >= number(&row["step_us"]["p50"]), "{row}");
        let row = live.iter().find(|row| row["kind"] == kind).unwrap_or_else(|| panic!("no row of {kind}"));
        assert!(row["hits"]["mean"].is_number() && number(&row["achieved_hz"]) > 0.0, "{row}");
    }
    assert!(rows.iter().any(|row| row["kind"] == "haptics" && row["hits"].is_null()), "{rows:?}");
    let text = stdout(&run(&["--lockstep"]));
    assert!(text.contains("hits mean") && text.contains("in ticks"), "{text}");
}

#[test]
fn a_live_run_keeps_the_contract() {
    let folder = here();
    let arguments = ["run", "peg-transfer", "--seconds", "1.5", "--no-record", "--no-report", "--json"];
    let output = trocar(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let summary = object(&output);
    assert_valid("run", &summary);
    assert_eq!(summary["mode"], "live");
    assert_eq!(summary["recording"], Value::Null);
    assert!(summary["wall_secs"].as_f64().expect("a number") >= 1.5);
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
    for row in summary["controllers"].as_array().expect("rows") {
        assert!(row["scheduled"].as_u64().expect("a count") > 0, "{row}");
    }
}

#[test]
fn without_json_a_person_reads_the_score_and_stderr_stays_quiet() {
    let folder = here();
    let arguments = ["run", "peg-transfer", "--lockstep", "--seconds", "1", "--no-record", "--no-report"];
    let output = trocar(folder.path(), &arguments);
    let text = stdout(&output);
    assert!(text.contains("not clinically validated") && text.contains("haptics.left"), "{text}");
    // On a busy machine the start may be slow enough to be announced.
    let told = stderr(&output);
    let told: Vec<&str> = told.lines().filter(|line| !line.starts_with("Preparing ")).collect();
    assert_eq!(told, [] as [&str; 0], "nobody looks at a terminal here");
    assert!(!text.contains('\u{1b}'), "NO_COLOR is respected");
}

/// An exercise of expectations without any physics: a stone that stays where it is.
const STONE: &str = "schema = 1\nname = \"stone\"\n[[entity]]\nname = \"stone\"\npose = { translation = [0.1, 0.0, 0.5] }\n\
    [[controller]]\nname = \"judge\"\nkind = \"outcome\"\nrate_hz = 10\n\
    [task]\nseconds = 0.2\nexpect = [\n\
    { measure = \"stone.z_m\", min = 0.6 },\n\
    { measure = \"stone.z_m\", which = \"largest\", max = 0.25 },\n\
    { measure = \"stone.x_m\", max = 1.0 },\n\
    { measure = \"nobody.mass_kg\" },\n]\n";

#[test]
fn the_summary_names_each_expectation_that_failed_with_its_value_and_its_bound() {
    let folder = here();
    std::fs::write(folder.path().join("stone.toml"), STONE).expect("a file");
    let run = ["run", "stone.toml", "--lockstep", "--no-record"];
    let output = trocar(folder.path(), &run);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let failed = [
        "stone.z_m is 0.5, at least 0.6 is expected",
        "stone.z_m.largest is 0.5, at most 0.25 is expected",
        "nobody.mass_kg was not measured: nothing in the scene gives 'nobody.mass_kg'",
    ];
    let text = stdout(&output);
    let report = std::fs::read_to_string(folder.path().join("report-stone.html")).expect("a report");
    for line in failed {
        assert!(text.contains(&format!("\n  {line}\n")), "'{line}' is not in: {text}");
        assert!(report.contains(&line.replace('\'', "&#39;")), "'{line}' is not in the report");
    }
    assert!(!text.contains("stone.x_m"), "that one holds: {text}");
    assert!(text.contains("3 errors") && text.contains("score 25.0 / 100"), "{text}");
    let object = object(&trocar(folder.path(), &[&run[..], &["--no-report", "--json"]].concat()));
    let told: Vec<&str> = object["task"]["errors"]
        .as_array()
        .expect("a list")
        .iter()
        .filter_map(|error| error["kind"].as_str())
        .collect();
    assert_eq!(told, failed);
}

#[test]
fn only_the_peg_transfer_calls_its_score_fls_style() {
    let folder = here();
    std::fs::write(folder.path().join("stone.toml"), STONE).expect("a file");
    for (scenario, kind, words) in [
        ("stone.toml", "expectations", "share of the expectations that were met"),
        ("peg-transfer", "fls_style", "FLS-style score, not clinically validated"),
    ] {
        let run = ["run", scenario, "--lockstep", "--no-record", "--seconds", "0.3"];
        let text = stdout(&trocar(folder.path(), &run));
        assert!(text.contains(words), "{scenario}: {text}");
        assert_eq!(text.contains("FLS"), kind == "fls_style", "{scenario}: {text}");
        let report = format!("report-{}.html", scenario.trim_end_matches(".toml"));
        let report = std::fs::read_to_string(folder.path().join(report)).expect("a report");
        assert_eq!(report.contains("FLS"), kind == "fls_style", "{scenario}: its report");
        let summary = object(&trocar(folder.path(), &[&run[..], &["--no-report", "--json"]].concat()));
        assert_valid("run", &summary);
        assert_eq!(summary["task"]["score_kind"], kind);
    }
}

#[test]
fn a_gauze_that_is_too_fine_for_explicit_steps_says_so_in_few_digits_and_what_helps() {
    let folder = here();
    let gauze = "schema = 1\nname = \"gauze\"\ngravity = [0.0, 0.0, 0.0]\n[[entity]]\nname = \"strip\"\n\
                 mesh = { sheet = { size = [0.020, 0.012], cells = [20, 12] } }\n\
                 mass_spring = { springs = { surface = { membrane_stiffness = 150.0, bending_stiffness = 2e-6, density = 0.05 } } }\n\
                 anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [-0.0099, 1.0, 1.0] } }] }\n\
                 [[controller]]\nname = \"strip\"\nkind = \"mass-spring\"\nrate_hz = 50\n";
    std::fs::write(folder.path().join("gauze.toml"), gauze).expect("a file");
    let run = ["run", "gauze.toml", "--lockstep", "--no-record", "--no-report", "--seconds", "0.1"];
    let message = stderr(&trocar(folder.path(), &run));
    for part in [
        "a step of 20 ms takes 137,571 parts of 0.145 µs",
        "at most 200",
        "implicit",
        "'lag'",
        "cells",
        "'rate_hz'",
    ] {
        assert!(message.contains(part), "'{part}' is not in: {message}");
    }
    let digits = message.split(|c: char| !c.is_ascii_digit()).map(str::len).max();
    assert!(digits <= Some(6), "nobody reads so many digits: {message}");
}

#[test]
fn what_is_doubtful_in_a_scenario_is_said_before_it_runs_and_once() {
    let folder = here();
    let stiff = "schema = 1\nname = \"stiff\"\n[[entity]]\nname = \"liver\"\ntissue = \"liver\"\n\
                 mesh = { block = { size = [0.1, 0.1, 0.02], cells = [2, 2, 1] } }\n\
                 dynamic_fem = { young_modulus = 5e6 }\n";
    std::fs::write(folder.path().join("stiff.toml"), stiff).expect("a file");
    let run = ["run", "stiff.toml", "--lockstep", "--no-record", "--no-report", "--seconds", "0.1"];
    let output = trocar(folder.path(), &run);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let message = stderr(&output);
    assert_eq!(message.matches("young_modulus of 5 MPa").count(), 1, "{message}");
    let known = object(&trocar(folder.path(), &[&run[..], &["--json"]].concat()));
    assert_eq!(known["losses"].as_array().map(Vec::len), Some(1), "{known}");
    // It is said although the session cannot start.
    let text = format!(
        "{stiff}[[controller]]\nname = \"a\"\nkind = \"haptics\"\nrate_hz = 10\nparams = {{ hand = \"left\" }}\n"
    );
    std::fs::write(folder.path().join("stiff.toml"), text).expect("a file");
    let output = trocar(folder.path(), &run);
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    let message = stderr(&output);
    let (doubt, error) = (message.find("young_modulus of 5 MPa"), message.find("no hand is called 'left'"));
    assert!(doubt.is_some() && doubt < error, "{message}");
}

#[test]
fn two_sessions_of_one_scenario_in_one_folder_keep_both_recordings_and_a_later_one_says_what_it_replaces() {
    let folder = here();
    let run = ["run", "wall", "--headless", "--no-report", "--seconds", "1"];
    let start = || {
        let mut command = Command::new(env!("CARGO_BIN_EXE_trocar"));
        command.args(run).current_dir(folder.path()).env("NO_COLOR", "1");
        command.env("TROCAR_RUNTIME_DIR", folder.path().join("run"));
        command.stdout(std::process::Stdio::null()).stderr(std::process::Stdio::piped());
        command.spawn().expect("the program starts")
    };
    let both = [start(), start()].map(|child| child.wait_with_output().expect("it ends"));
    let told: String = both.iter().map(stderr).collect();
    assert!(both.iter().all(|output| output.status.success()), "{told}");
    assert!(
        told.contains("wall.mcap is being written by another session: this one writes wall-2.mcap"),
        "{told}"
    );
    for name in ["wall.mcap", "wall-2.mcap"] {
        let replayed = trocar(folder.path(), &["replay", name, "--headless"]);
        assert!(replayed.status.success(), "{name}: {}", stderr(&replayed));
    }
    let later = ["run", "wall", "--lockstep", "--no-report", "--seconds", "0.1"];
    let text = stdout(&trocar(folder.path(), &later));
    assert!(text.contains("wall.mcap replaces the one of an earlier run; --record"), "{text}");
}

#[test]
fn of_a_recording_that_is_cut_short_what_is_whole_is_told() {
    let folder = here();
    let run = [
        "run",
        "peg-transfer",
        "--lockstep",
        "--seconds",
        "3",
        "--no-report",
        "--record",
        "a.mcap",
        "--json",
    ];
    assert_eq!(trocar(folder.path(), &run).status.code(), Some(0));
    let file = folder.path().join("a.mcap");
    let bytes = std::fs::read(&file).expect("a recording");
    std::fs::write(&file, &bytes[..bytes.len() * 7 / 10]).expect("a file");
    let replayed = trocar(folder.path(), &["replay", "a.mcap", "--headless"]);
    assert_eq!(replayed.status.code(), Some(1), "{}", stderr(&replayed));
    let message = stderr(&replayed);
    let whole =
        message.split("its first ").nth(1).and_then(|rest| rest.split(' ').next()?.parse::<f64>().ok());
    assert!(whole.is_some_and(|secs| (0.5..3.0).contains(&secs)), "{message}");
    let text = stdout(&replayed);
    assert!(text.contains("peg-transfer cut off") && text.contains("state hash"), "{text}");
}

/// A command that fails, its exit code, and what the message must name.
fn assert_fails(arguments: &[&str], code: i32, named: &[&str]) {
    let folder = here();
    let output = trocar(folder.path(), arguments);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    for name in named {
        assert!(message.contains(name), "{arguments:?}: '{name}' is not in: {message}");
    }
    assert!(!message.contains("panicked"), "{message}");
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0, "something was written");
    if arguments.contains(&"--json") {
        let object = object(&output);
        assert!(object["error"].as_str().is_some_and(|error| !error.is_empty()), "{object}");
    } else {
        assert_eq!(stdout(&output), "");
    }
}

#[test]
fn what_cannot_be_run_is_named_with_what_is_valid() {
    assert_fails(&["run", "peg-tranfser", "--json"], 4, &["peg-tranfser", "did you mean 'peg-transfer'"]);
    assert_fails(&["run", "missing.toml"], 4, &["missing.toml"]);
    assert_fails(&["run", "peg-transfer", "--hand", "middle=virtual"], 2, &["middle", "left", "right"]);
    assert_fails(&["run", "peg-transfer", "--hand", "left=vrtual"], 2, &["vrtual", "virtual"]);
    assert_fails(&["run", "peg-transfer", "--hand", "left=replay:no.csv"], 4, &["no.csv"]);
    assert_fails(&["run", "peg-transfer", "--faults", "no.toml"], 4, &["no.toml"]);
    assert_fails(&["run", "peg-transfer", "--record", "no/such/a.mcap"], 4, &["no/such"]);
    assert_fails(&["run", "peg-transfer", "--report", "no/such/a.html"], 4, &["no/such"]);
    assert_fails(&["run", "peg-transfer", "--seconds", "0"], 2, &["--seconds"]);
    assert_fails(&["run", "peg-transfer", "--secnds", "1", "--json"], 2, &["--secnds", "--seconds"]);
    assert_fails(&["replay", "no.mcap", "--json"], 4, &["no.mcap"]);
    assert_fails(&["bench", "kernl", "--json"], 2, &["kernl", "did you mean 'kernel'"]);
    assert_fails(&["frobnicate"], 2, &["frobnicate"]);
}

#[test]
fn a_failed_run_prints_an_object_of_the_same_schema() {
    let folder = here();
    let run = object(&trocar(folder.path(), &["run", "nope", "--lockstep", "--seed", "9", "--json"]));
    assert_valid("run", &run);
    assert_eq!((&run["mode"], &run["seed"]), (&"lockstep".into(), &9.into()));
    assert_valid("bench", &object(&trocar(folder.path(), &["bench", "nope", "--json"])));
}

#[test]
fn wrong_files_are_refused_with_their_place() {
    let folder = here();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("a file");
    write("broken.toml", "schema = 1\nname = \"x\"\ntitle = \"X\"\ncolour = \"red\"\n");
    write("faults.toml", "schema = 1\n[[fault]]\nat_secs = 1.0\ntarget = \"nobody\"\nkind = \"kill\"\n");
    write("noise.mcap", "this is no recording");
    let controller =
        "schema = 1\nname = \"x\"\n[[controller]]\nname = \"a\"\nkind = \"rapeir\"\nrate_hz = 10\n";
    write("kind.toml", controller);
    write(
        "params.toml",
        &controller.replace("rapeir", "outcome").replace("[[", "[task]\nexpect = []\nseconds = -2.0\n[["),
    );
    write("hand.csv", "t,x,y,z,qw,qx,qy,qz,gripper\n0,0,0,0,1,0,0,0,0\n0.001,NaN,0,0,1,0,0,0,0\n");
    let soft = "schema = 1\nname = \"x\"\n[[entity]]\nname = \"board\"\n[[entity]]\nname = \"liver\"\ndynamic_fem = {}\n\
                [[controller]]\nname = \"soft\"\nkind = \"dynamic-fem\"\nrate_hz = 60\n";
    write("bare.toml", soft);
    write("bench.toml", &soft.replace("dynamic_fem = {}", "").replace("dynamic-fem", "peg-transfer"));
    let gauze = "schema = 1\nname = \"x\"\n[[entity]]\nname = \"strip\"\n\
                 mesh = { sheet = { size = [0.02, 0.012], cells = [20, 12] } }\nmass_spring = {}\n\
                 [[controller]]\nname = \"springs\"\nkind = \"mass-spring\"\nrate_hz = 50\n";
    write("gauze.toml", gauze);
    let too_fine: &[&str] =
        &["gauze.toml:4:8", "'strip': a step of 20 ms", "at most 200", "method = \"implicit\"", "lag"];
    let cases: [(&[&str], &[&str]); 11] = [
        // What only a controller finds when it starts.
        (
            &["run", "bare.toml", "--lockstep"],
            &["bare.toml:6:8", "'liver' has no vertices", "give it a mesh"],
        ),
        (&["run", "bare.toml", "--headless"], &["bare.toml:6:8", "'liver' has no vertices"]),
        (&["run", "bench.toml", "--lockstep"], &["bench.toml:8:1", "soft did not start", "torus"]),
        (&["run", "gauze.toml", "--lockstep"], too_fine),
        (&["run", "gauze.toml", "--headless"], too_fine),
        (&["run", "broken.toml", "--json"], &["broken.toml:4:1", "colour"]),
        (&["run", "kind.toml"], &["kind.toml:5:8", "unknown kind 'rapeir'", "rapier"]),
        (&["run", "params.toml"], &["params.toml:5:11", "seconds", "-2 is out of range"]),
        (&["run", "peg-transfer", "--faults", "faults.toml"], &["nobody", "haptics.left"]),
        (&["replay", "noise.mcap"], &["noise.mcap"]),
        (&["run", "peg-transfer", "--hand", "left=replay:hand.csv"], &["hand.csv", "3"]),
    ];
    for (arguments, named) in cases {
        let output = trocar(folder.path(), arguments);
        let message = stderr(&output);
        assert_eq!(output.status.code(), Some(4), "{arguments:?}: {message}");
        for name in named {
            assert!(message.contains(name), "{arguments:?}: '{name}' is not in: {message}");
        }
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 9, "something was written");
}

#[test]
fn lists_graphs_schemas_and_completions_are_printed() {
    let folder = here();
    let text = |arguments: &[&str]| {
        let output = trocar(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", stderr(&output));
        stdout(&output)
    };
    let all = text(&["list"]);
    for name in ["peg-transfer", "instrument_target", "replay:FILE", "kernel"] {
        assert!(all.contains(name), "'{name}' is not in: {all}");
    }
    let devices = text(&["list", "devices"]);
    for option in
        ["arm_stiffness=0 to 20000 N/m", "start=zero|file|TIME", "time=s|ms|us|ns", "source=master|slave"]
    {
        assert!(devices.contains(option), "{option} in {devices}");
    }
    let listed: Value = serde_json::from_str(&text(&["list", "scenarios", "--json"])).expect("JSON");
    assert_eq!(listed["scenarios"][0]["name"], "peg-transfer");
    let listed: Value = serde_json::from_str(&text(&["list", "tissues", "--json"])).expect("JSON");
    let liver = listed["tissues"].as_array().expect("a list").iter().find(|tissue| tissue["name"] == "liver");
    let young = &liver.expect("one")["parameters"][0];
    assert_eq!(
        (&young["name"], &young["value"], &young["unit"]),
        (&"young_modulus".into(), &4740.0.into(), &"Pa".into())
    );
    assert!(text(&["list", "tissues"]).contains("found to be 2700 to 7800: shear-wave elastography"));
    let listed: Value = serde_json::from_str(&text(&["list", "controllers", "--json"])).expect("JSON");
    let kinds = listed["controllers"].as_array().expect("a list");
    let names: Vec<&str> = kinds.iter().filter_map(|kind| kind["name"].as_str()).collect();
    assert_eq!(
        names,
        [
            "autopilot",
            "bleeding",
            "continuous",
            "dynamic-fem",
            "dynamic-point",
            "electrosurgery",
            "finger-proxy",
            "fluid",
            "haptics",
            "instruments",
            "linear-fem",
            "manual",
            "mass-spring",
            "obb-tree",
            "outcome",
            "path",
            "peg-transfer",
            "proximity",
            "rapier",
            "rapier-soft",
            "rigid-bodies",
            "smoke",
            "spherical-hash",
            "suture",
            "thread",
            "vital-signs",
            "xpbd",
            "z-buffer"
        ]
    );
    for kind in kinds {
        assert!(kind["about"].as_str().is_some_and(|about| about.len() > 20), "{kind}");
        assert!(kind["rate_hz"].as_f64().is_some_and(|hz| hz >= 20.0), "{kind}");
        let lists = ["reads", "writes"].map(|list| kind[list].as_array().expect("a list").len());
        // What a kind reads and writes is told by the first scenario that has it.
        let is_shown = kind["name"].as_str().is_some_and(|name| name != "rapier-soft");
        assert!(!is_shown || lists.iter().all(|length| *length > 0), "{kind}");
    }
    assert!(kinds[0]["writes"].as_array().expect("a list").contains(&"hand_target".into()), "{}", kinds[0]);
    let listed = text(&["list", "controllers"]);
    assert!(
        listed.contains("usually at 1000 Hz") && listed.contains("writes autopilot_state, hand_target"),
        "{listed}"
    );

    let mermaid = text(&["graph", "peg-transfer"]);
    assert!(mermaid.contains("flowchart LR") && mermaid.contains("haptics.left<br/>1000 Hz"), "{mermaid}");
    assert!(mermaid.contains("instrument_target") && mermaid.contains("[(\"model\")]"), "{mermaid}");
    let graph: Value =
        serde_json::from_str(&text(&["graph", "peg-transfer", "--format", "json"])).expect("JSON");
    let flows = graph["flows"].as_array().expect("a list");
    let outside = |flow: &&Value| {
        [&flow["from"], &flow["to"]]
            .iter()
            .any(|end| end.as_str().is_some_and(|end| end.starts_with("device.")))
    };
    assert_eq!(flows.iter().filter(outside).count(), 4, "each of two devices and its haptics: {graph}");
    for flow in flows.iter().filter(|flow| !outside(flow)) {
        assert!(
            (flow["from"] == "model") != (flow["to"] == "model"),
            "controllers meet in the Model only: {flow}"
        );
    }
    let dot = text(&["graph", "peg-transfer", "--format", "dot"]);
    assert!(dot.contains("digraph") && dot.contains("engine"), "{dot}");
    let measured = text(&["graph", "peg-transfer", "--after", "1"]);
    assert!(measured.contains("of 1000 Hz"), "{measured}");

    assert!(text(&["completions", "bash"]).contains("trocar"));
    for of in ["scenario", "run", "bench"] {
        let schema: Value = serde_json::from_str(&text(&["schema", of])).expect("JSON");
        jsonschema::validator_for(&schema).expect("a sound schema");
    }
}

#[test]
fn the_doctor_names_what_it_found_and_how_to_mend_it() {
    let folder = here();
    let output = trocar(folder.path(), &["doctor", "--json"]);
    let found = object(&output);
    let checks = found["checks"].as_array().expect("checks");
    assert!(checks.len() >= 7);
    for check in checks {
        let is_ok = check["status"] == "ok";
        assert_eq!(check["mend"].is_null(), is_ok, "{check}");
        assert!(check["found"].as_str().is_some_and(|text| !text.is_empty()), "{check}");
    }
    assert!(found["machine"]["cores"].as_u64().is_some_and(|cores| cores > 0));
}

#[test]
fn a_fault_that_is_survived_is_told_and_a_missed_expectation_fails_the_run() {
    let folder = here();
    let plan = |limit: &str| {
        format!(
            "schema = 1\nseed = 3\n[[fault]]\nid = \"left dies\"\nat_secs = 0.5\ntarget = \"haptics.left\"\n\
             kind = \"kill\"\n[expect]\nrecovery_secs_max = {limit}\nmodel_restarts_max = 0\n"
        )
    };
    std::fs::write(folder.path().join("kill.toml"), plan("0.1")).expect("a file");
    std::fs::write(folder.path().join("strict.toml"), plan("0.0")).expect("a file");
    let run = |faults: &str| {
        let arguments = [
            "run",
            "peg-transfer",
            "--lockstep",
            "--seconds",
            "1",
            "--faults",
            faults,
            "--no-record",
            "--no-report",
            "--json",
        ];
        trocar(folder.path(), &arguments)
    };
    let survived = run("kill.toml");
    assert_eq!(survived.status.code(), Some(0), "{}", stderr(&survived));
    let summary = object(&survived);
    assert_valid("run", &summary);
    let fault = &summary["faults"][0];
    let at = |key: &str| fault[key].as_f64().unwrap_or_else(|| panic!("{key} is missing: {fault}"));
    assert!((at("injected_secs") - 0.5).abs() < 0.01);
    assert!(at("injected_secs") <= at("detected_secs") && at("detected_secs") <= at("restarted_secs"));
    assert!(at("restarted_secs") <= at("resumed_secs") && at("resumed_secs") < 0.6);

    let missed = run("strict.toml");
    assert_eq!(missed.status.code(), Some(1), "{}", stderr(&missed));
    assert!(object(&missed)["error"].as_str().is_some_and(|error| error.contains("expectation")));
}

/// The score of an exercise whose physics was too slow is not put down to the trainee.
#[test]
fn an_actor_that_was_too_slow_is_told_in_summary_report_and_json() {
    let folder = here();
    let plan = "schema = 1\n[[fault]]\nid = \"tired\"\nat_secs = 0.5\nfor_secs = 2.0\ntarget = \"engine\"\n\
                kind = \"slow\"\nstep_secs = 0.010\n";
    std::fs::write(folder.path().join("tired.toml"), plan).expect("a plan");
    let run =
        ["run", "peg-transfer", "--lockstep", "--seconds", "3", "--no-record", "--faults", "tired.toml"];
    let text = trocar(folder.path(), &run);
    let told = "under faults, actors were too slow: engine ran at";
    assert!(stdout(&text).contains(told), "{}", stdout(&text));
    assert!(stdout(&text).contains("the score is disturbed"), "{}", stdout(&text));
    let report = std::fs::read_to_string(folder.path().join("report-peg-transfer.html")).expect("a report");
    assert!(report.contains(told) && report.contains("<h2>Disturbed</h2>"));
    let json = trocar(folder.path(), &[&run[..], &["--no-report", "--json"]].concat());
    let summary = object(&json);
    assert_valid("run", &summary);
    assert_eq!(summary["task"]["disturbed"], true);
    assert_eq!(summary["slow_actors"][0]["name"], "engine");
    let calm =
        trocar(folder.path(), &["run", "wall", "--lockstep", "--seconds", "1", "--no-record", "--json"]);
    let summary = object(&calm);
    assert_eq!(
        (&summary["task"]["disturbed"], summary["slow_actors"].as_array().map(Vec::len)),
        (&false.into(), Some(0))
    );
}

#[test]
fn a_session_that_nobody_drives_yet_rests_and_says_so() {
    let folder = here();
    let quiet = ["--lockstep", "--seconds", "0.5", "--no-record", "--no-report", "--json"];
    let output = trocar(folder.path(), &[&["run", "peg-transfer", "--play"], &quiet[..]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    assert!(stderr(&output).contains("nobody drives the hands: they rest"), "{}", stderr(&output));
    let summary = object(&output);
    assert_valid("run", &summary);
    let names: Vec<&str> = summary["controllers"]
        .as_array()
        .expect("controllers")
        .iter()
        .filter_map(|row| row["name"].as_str())
        .collect();
    assert!(names.contains(&"manual") && !names.contains(&"autopilot"), "{names:?}");
    std::fs::write(folder.path().join("empty.toml"), "schema = 1\nname = \"empty\"\n").expect("a file");
    let output = trocar(folder.path(), &[&["run", "empty.toml", "--play"], &quiet[..]].concat());
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
    assert!(stderr(&output).contains("has no hands"), "{}", stderr(&output));
}

/// A cube of 40 units, as text.
const CUBE: &str = "v -20 -20 0\nv 20 -20 0\nv 20 20 0\nv -20 20 0\nv -20 -20 40\nv 20 -20 40\nv 20 20 40\nv -20 20 40\n\
    f 1 4 3 2\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";

#[test]
fn a_mesh_is_inspected_mended_and_never_overwritten_unasked() {
    let folder = here();
    // The last face is turned.
    let turned = CUBE.replace("f 4 1 5 8", "f 8 5 1 4");
    std::fs::write(folder.path().join("cube.obj"), &turned).expect("a file");
    let output = trocar(folder.path(), &["mesh", "cube.obj"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    for part in [
        "12 triangles, 8 vertices",
        "40 m × 40 m × 40 m",
        "the millimetre",
        "opposite orientation",
        "2 triangles were turned",
    ] {
        assert!(stdout(&output).contains(part), "'{part}' is missing in {}", stdout(&output));
    }
    let mend = |more: &[&str]| {
        let words = ["mesh", "cube.obj", "--scale", "0.001", "--repair", "--out", "mended.ply", "--json"];
        trocar(folder.path(), &[&words, more].concat())
    };
    let output = mend(&[]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let told = object(&output);
    assert_eq!((&told["error"], &told["written"]["left"]), (&Value::Null, &Value::Array(Vec::new())));
    assert!(told["written"]["done"].as_str().is_some_and(|done| done.contains("2 triangles were turned")));
    let again = object(&trocar(folder.path(), &["mesh", "mended.ply", "--json"]));
    assert!((again["volume_m3"].as_f64().expect("closed") / 64e-6 - 1.0).abs() < 1e-12);
    assert!(again["defects"].as_array().is_some_and(Vec::is_empty) && again["unit_doubt"].is_null());

    let refused = mend(&[]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(object(&refused)["error"].as_str().is_some_and(|error| error.contains("--force")));
    assert_eq!(mend(&["--force"]).status.code(), Some(0));
    let onto_itself = ["mesh", "cube.obj", "--repair", "--out", "cube.obj", "--force"];
    assert_eq!(trocar(folder.path(), &onto_itself).status.code(), Some(2));
    assert_eq!(std::fs::read_to_string(folder.path().join("cube.obj")).expect("a file"), turned);
    let missing = trocar(folder.path(), &["mesh", "none.obj", "--json"]);
    assert_eq!(missing.status.code(), Some(4));
    assert!(object(&missing)["error"].as_str().is_some_and(|error| error.contains("none.obj")));
}

#[test]
fn meshes_of_another_folder_are_read_when_it_is_named() {
    let folder = here();
    for below in ["meshes", "scenes"] {
        std::fs::create_dir(folder.path().join(below)).expect("a folder");
    }
    std::fs::write(folder.path().join("meshes/cube.obj"), CUBE).expect("a file");
    let scene = "schema = 1\nname = \"s\"\n[[entity]]\nname = \"cube\"\n\
        mesh = { file = \"../meshes/cube.obj\", scale = 0.001 }\nrigid_body = { motion = \"static\" }\n\
        [[controller]]\nname = \"engine\"\nkind = \"rapier\"\nrate_hz = 100\n";
    std::fs::write(folder.path().join("scenes/s.toml"), scene).expect("a file");
    let run = |more: &[&str]| {
        let words = [
            "run",
            "scenes/s.toml",
            "--lockstep",
            "--seconds",
            "0.1",
            "--no-record",
            "--no-report",
            "--json",
        ];
        trocar(folder.path(), &[&words, more].concat())
    };
    let refused = run(&[]);
    assert_eq!(refused.status.code(), Some(4));
    assert!(stderr(&refused).contains("--assets DIR"), "{}", stderr(&refused));
    let allowed = run(&["--assets", "meshes"]);
    assert_eq!(allowed.status.code(), Some(0), "{}", stderr(&allowed));
    let wrong = run(&["--assets", "nowhere"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(stderr(&wrong).contains("nowhere"), "{}", stderr(&wrong));
}
