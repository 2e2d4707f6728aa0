//! `trocar run`: what it prints, how it ends, what it leaves behind.

use serde_json::Value;

use crate::support::{assert_valid, here, object, stderr, stdout, trocar};

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
