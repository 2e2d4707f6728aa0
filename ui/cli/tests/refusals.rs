//! Wrong arguments and wrong files: the message names the place and what is valid, and nothing is written.

use crate::support::{assert_valid, here, object, stderr, stdout, trocar};

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
    std::fs::write(&file, &bytes[..bytes.len() * 4 / 10]).expect("a file");
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
