//! Lists, schemas, completions and the doctor.

use serde_json::Value;

use crate::support::{here, object, stderr, stdout, trocar};

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
