//! `trocar mesh`, and meshes outside the scenario's folder.

use serde_json::Value;

use crate::support::{here, object, stderr, stdout, trocar};

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
    assert_eq!(refused.status.code(), Some(4));
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
