//! `trocar recording`, and replays of recordings that are not whole.

use std::path::Path;

use crate::support::{assert_valid, here, object, stderr, stdout, trocar};

/// Records some seconds of a scenario in a folder.
fn recorded(folder: &Path, scenario: &str, more: &[&str]) -> serde_json::Value {
    let line = [
        "run",
        scenario,
        "--lockstep",
        "--seconds",
        "3",
        "--no-report",
        "--json",
        "--force",
        "--record",
        "a.mcap",
    ];
    let output = trocar(folder, &[&line[..], more].concat());
    assert!(output.status.success(), "{}", stderr(&output));
    object(&output)
}

#[test]
fn the_bytes_of_a_recording_are_counted_by_component_writer_rate_and_framing() {
    let folder = here();
    let run = recorded(folder.path(), "wall", &[]);
    let counted = object(&trocar(folder.path(), &["recording", "stats", "a.mcap", "--json"]));
    assert_eq!(counted["bytes"], run["recording_bytes"]);
    let component = |name: &str| {
        let all = counted["components"].as_array().expect("a list");
        all.iter().find(|component| component["name"] == name).expect("it is there").clone()
    };
    let (state, pose) = (component("device_state"), component("pose"));
    assert_eq!(state["policy"], "exact");
    assert_eq!(state["committed"]["count"], state["blocks"]["count"], "every state of a hand");
    assert!(pose["policy"].as_str().expect("a text").starts_with("sampled 60 Hz"));
    let haptics = counted["writers"]["haptics.right"]["count"].as_u64().expect("a count");
    assert!((2_990..=3_010).contains(&haptics), "{haptics} commits in 3 s at 1 kHz");
    let topics = counted["topics"].as_object().expect("by topic");
    let all: u64 = topics.values().map(|topic| topic["bytes"].as_u64().expect("bytes")).sum();
    assert_eq!(all + counted["framing_bytes"].as_u64().expect("bytes"), counted["bytes"].as_u64().unwrap());
    assert!(counted["committed_bytes"].as_u64() > counted["bytes"].as_u64(), "less than was committed");
    let text = stdout(&trocar(folder.path(), &["recording", "stats", "a.mcap"]));
    for word in ["MB a minute", "times as much", "framing", "device_state", "haptics.right", "commits/s"] {
        assert!(text.contains(word), "'{word}' is missing in:\n{text}");
    }
}

#[test]
fn an_exact_recording_is_larger_and_replays_to_the_hash_of_the_session() {
    let folder = here();
    let sampled = recorded(folder.path(), "peg-transfer", &[]);
    let exact = recorded(folder.path(), "peg-transfer", &["--record-exact"]);
    assert_eq!(exact["state_hash"], sampled["state_hash"], "recording changes no hash");
    assert!(exact["recording_bytes"].as_u64() > sampled["recording_bytes"].as_u64());
    let replayed = object(&trocar(folder.path(), &["replay", "a.mcap", "--json"]));
    assert_valid("run", &replayed);
    assert_eq!(replayed["stored_hash"], exact["state_hash"]);
}

#[test]
fn a_damaged_recording_is_played_told_and_recovered() {
    let folder = here();
    let run = recorded(folder.path(), "wall", &[]);
    let file = folder.path().join("a.mcap");
    let mut bytes = std::fs::read(&file).expect("written");
    // As many bytes as reach into some chunk, whatever lies there.
    let at = bytes.len() / 2;
    bytes[at..at + 3_000].fill(0x55);
    std::fs::write(&file, &bytes).expect("written");

    let replayed = trocar(folder.path(), &["replay", "a.mcap", "--json"]);
    assert_eq!(replayed.status.code(), Some(1), "{}", stderr(&replayed));
    let summary = object(&replayed);
    assert_valid("run", &summary);
    assert!(summary["error"].as_str().expect("an error").contains("damaged at byte"), "{summary}");
    let (whole, played) = (run["sim_secs"].as_f64().unwrap(), summary["sim_secs"].as_f64().unwrap());
    assert!((whole - played).abs() < 0.05, "{played} s of {whole}");
    let text = trocar(folder.path(), &["replay", "a.mcap", "--headless"]);
    assert!(stderr(&text).contains("damaged at byte") && !stdout(&text).is_empty(), "{}", stderr(&text));

    let told = trocar(folder.path(), &["recording", "recover", "a.mcap"]);
    assert!(told.status.success(), "{}", stderr(&told));
    assert!(stdout(&told).contains("at byte") && stdout(&told).contains("whole chunks"), "{}", stdout(&told));
    let recovered = trocar(folder.path(), &["replay", "a-recovered.mcap", "--json"]);
    let error = object(&recovered)["error"].as_str().expect("an error").to_owned();
    assert!(error.contains("gap") && !error.contains("damaged at"), "{error}");
    let again = trocar(folder.path(), &["recording", "recover", "a.mcap", "--json"]);
    assert_eq!(again.status.code(), Some(4), "an earlier result stays");
    let forced = trocar(folder.path(), &["recording", "recover", "a.mcap", "--json", "--force"]);
    assert!(object(&forced)["damaged_chunks"].as_u64() >= Some(1));
}

#[test]
fn what_is_no_recording_or_of_another_version_is_refused_with_a_word() {
    let folder = here();
    std::fs::write(folder.path().join("a.mcap"), "a text").expect("written");
    for command in [&["recording", "stats"][..], &["recording", "recover"], &["replay"]] {
        let output = trocar(folder.path(), &[command, &["a.mcap"]].concat());
        assert_eq!(output.status.code(), Some(4), "{command:?}");
        assert!(stderr(&output).contains("not a recording of trocar"), "{}", stderr(&output));
    }
}

#[test]
fn a_session_goes_on_where_its_recording_was_cut_and_completes() {
    let folder = here();
    // A thread that is tied bears no rounding.
    recorded(folder.path(), "tube-loop", &["--record-exact"]);
    let whole = std::fs::read(folder.path().join("a.mcap")).expect("a recording");
    std::fs::write(folder.path().join("cut.mcap"), &whole[..whole.len() * 4 / 5]).expect("a file");
    let line = ["run", "tube-loop", "--lockstep", "--resume", "cut.mcap", "--no-report", "--json"];
    let output = trocar(folder.path(), &line);
    assert!(output.status.success(), "{}", stderr(&output));
    let resumed = object(&output);
    let line = ["run", "tube-loop", "--lockstep", "--no-record", "--no-report", "--json"];
    let alone = object(&trocar(folder.path(), &line));
    for key in ["completed", "score"] {
        assert_eq!(resumed["task"][key], alone["task"][key], "{key}");
    }
    let seconds = |run: &serde_json::Value| run["sim_secs"].as_f64().expect("a time");
    let rest = seconds(&alone) - seconds(&resumed);
    assert!((1.0..3.0).contains(&rest), "it goes on after {rest} s");
    // The new recording has the end, and nothing that was there is gone.
    let replayed = object(&trocar(folder.path(), &["replay", "tube-loop.mcap", "--json"]));
    assert_eq!(replayed["task"]["over"], resumed["task"]["over"]);
    for (line, why) in [
        (["run", "wall", "--lockstep", "--resume", "cut.mcap"], "'tube-loop'"),
        (["run", "tube-loop", "--lockstep", "--resume", "tube-loop.mcap"], "was over"),
        (["run", "tube-loop", "--lockstep", "--resume", "none.mcap"], "none.mcap"),
    ] {
        let output = trocar(folder.path(), &line);
        assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
        assert!(stderr(&output).contains(why), "{}", stderr(&output));
    }
}
