//! Pictures and films from the command line, without a window.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn trocar(folder: &Path, arguments: &[&str], environment: &[(&str, &str)]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(arguments)
        .current_dir(folder)
        .env("NO_COLOR", "1")
        .envs(environment.iter().copied())
        .output()
        .expect("the program starts")
}

fn object(output: &Output) -> Value {
    let stderr = String::from_utf8_lossy(&output.stderr);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|error| panic!("{error}: {stderr}"))
}

/// Width and height of a PNG file.
fn size_of_png(file: &Path) -> [u32; 2] {
    let bytes = std::fs::read(file).expect("a file");
    assert_eq!(&bytes[..8], b"\x89PNG\r\n\x1a\n");
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().expect("four bytes")))
}

const SHORT: [&str; 7] = ["run", "peg-transfer", "--lockstep", "--no-report", "--json", "--seconds", "0.4"];

#[test]
fn a_run_leaves_a_picture_and_a_film_and_a_replay_of_it_the_same_picture() {
    let folder = tempfile::tempdir().expect("a folder");
    let small = ["--size", "64x48", "--fps", "10", "--quality", "full"];
    let run = [
        &SHORT[..],
        &small,
        &["--picture", "run.png", "--film", "run.gif", "--record", "run.mcap", "--record-exact"],
    ]
    .concat();
    let summary = object(&trocar(folder.path(), &run, &[]));
    assert_eq!(summary["pictures"], serde_json::json!(["run.png", "run.gif"]), "{summary}");
    assert_eq!(size_of_png(&folder.path().join("run.png")), [64, 48]);
    let gif = std::fs::read(folder.path().join("run.gif")).expect("a film");
    assert!(gif.starts_with(b"GIF89a"));
    // Frames begin with the extension that holds their delay.
    let frames = gif
        .windows(4)
        .filter(|window| *window == [0x21, 0xf9, 4, 0] || *window == [0x21, 0xf9, 4, 4])
        .count();
    assert!((4..=5).contains(&frames), "{frames}");

    let replay =
        [&["replay", "run.mcap", "--json", "--picture", "replay.png", "--film", "frames"], &small[..]]
            .concat();
    let summary = object(&trocar(folder.path(), &replay, &[]));
    assert_eq!(summary["pictures"], serde_json::json!(["replay.png", "frames"]), "{summary}");
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect("a picture");
    assert_eq!(read("run.png"), read("replay.png"));
    assert!(folder.path().join("frames/frame-00004.png").is_file());
}

#[test]
fn what_happens_is_shown_over_the_scene_and_several_views_share_a_picture() {
    let folder = tempfile::tempdir().expect("a folder");
    let picture = |name: &str, more: &[&str]| {
        let small = ["--size", "160x120", "--quality", "plain", "--no-record", "--picture", name];
        let output = trocar(folder.path(), &[&SHORT[..], &small, more].concat(), &[]);
        assert_eq!(object(&output)["pictures"], serde_json::json!([name]), "{more:?}");
        assert_eq!(size_of_png(&folder.path().join(name)), [160, 120]);
        std::fs::read(folder.path().join(name)).expect("a picture")
    };
    let plain = picture("plain.png", &[]);
    for (name, more) in [
        ("show.png", ["--show", "contacts,forces,wireframe"]),
        ("trails.png", ["--show", "trails"]),
        ("quad.png", ["--eyes", "quad"]),
        ("tiles.png", ["--camera", "camera,camera"]),
    ] {
        assert_ne!(picture(name, &more), plain, "{more:?}");
    }
}

#[test]
fn without_a_graphics_adapter_pictures_are_refused_before_anything_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("face.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("a file");
    let nothing = [("VK_DRIVER_FILES", "/dev/null"), ("VK_ICD_FILENAMES", "/dev/null")];
    for arguments in [
        [&SHORT[..], &["--picture", "run.png"]].concat(),
        [&SHORT[..], &["--film", "run.gif"]].concat(),
        vec!["mesh", "face.obj", "--picture", "face.png", "--json"],
        vec!["gallery", "--scenario", "wall", "--json"],
    ] {
        let output = trocar(folder.path(), &arguments, &nothing);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(3), "{arguments:?}: {stderr}");
        assert!(stderr.contains("no graphics adapter") && stderr.contains("mesa-vulkan-drivers"), "{stderr}");
        assert!(object(&output)["error"].as_str().is_some_and(|error| error.contains("no graphics adapter")));
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1, "{arguments:?}");
    }
}

#[test]
fn an_impossible_picture_is_refused_with_the_largest_one_and_an_unknown_ending_with_the_valid_ones() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("face.obj"), "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").expect("a file");
    let short = |more: &[&'static str]| [&SHORT[..], more].concat();
    for (arguments, says) in [
        (short(&["--picture", "a.png", "--size", "4000000x3000000"]), "the largest of its shape is "),
        (short(&["--film", "a.gif", "--size", "16384x16384"]), "the largest of its shape is 8192 × 8192"),
        (
            vec!["mesh", "face.obj", "--picture", "a.png", "--size", "70000x70000"],
            "the largest of its shape is ",
        ),
        (vec!["gallery", "--scenario", "wall", "--size", "70000x70000"], "the largest of its shape is "),
        (short(&["--picture", "a.jpg"]), "'.jpg' is no picture that can be written; valid is .png"),
        (short(&["--picture", "a.tiff"]), "valid is .png"),
        (vec!["mesh", "face.obj", "--picture", "a.JPEG"], "valid is .png"),
        (short(&["--film", "a.jpg"]), "'.jpg' is no film: .png, .gif, or a folder for frames"),
    ] {
        let output = trocar(folder.path(), &arguments, &[]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(4), "{arguments:?}: {stderr}");
        assert!(stderr.contains(says), "{arguments:?}: {stderr}");
        assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 1, "{arguments:?}");
    }
}

#[test]
fn a_picture_that_is_drawn_leaves_nothing_on_stderr_about_displays() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = [&SHORT[..], &["--picture", "run.png", "--no-record", "--size", "64x48", "--quality", "plain"]];
    let output = Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(run.concat())
        .current_dir(folder.path())
        .env("NO_COLOR", "1")
        .env_remove("XDG_RUNTIME_DIR")
        .env_remove("WAYLAND_DISPLAY")
        .env_remove("DISPLAY")
        .output()
        .expect("the program starts");
    assert_eq!(output.status.code(), Some(0));
    assert!(folder.path().join("run.png").is_file());
    assert_eq!(String::from_utf8_lossy(&output.stderr), "", "nothing went wrong");
}

#[test]
fn what_cannot_be_shown_is_refused_before_anything_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    for (arguments, says) in [
        (["--picture", "run.png", "--camera", "endoscope"], "camera"),
        (["--film", "run.mp4", "--fps", "25"], ".gif"),
        (["--picture", "run.png", "--size", "0x10"], "WIDTHxHEIGHT"),
        (["--film", "run.gif", "--fps", "1000"], "240"),
        (["--picture", "run.png", "--show", "contact"], "did you mean 'contacts'?"),
    ] {
        let output = trocar(folder.path(), &[&SHORT[..5], &arguments[..]].concat(), &[]);
        let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(matches!(output.status.code(), Some(2 | 4)), "{arguments:?}: {:?}", output.status);
        let told = format!("{stderr}{}", String::from_utf8_lossy(&output.stdout));
        assert!(told.contains(says), "{arguments:?}: {told}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("a folder").count(), 0);
}
