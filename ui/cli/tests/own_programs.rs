//! Programs of one's own, built beside these tests as examples.

use std::path::Path;
use std::process::Command;

use crate::support::{here, object, stderr, stdout};

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
