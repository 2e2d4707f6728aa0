//! `trocar recording export`: the tables hold what is stored, to the last bit, and refusals tell the valid choices.

use std::collections::BTreeMap;
use std::path::Path;

use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::record::Field;
use serde_json::Value;
use trocar::app::App;
use trocar_kernel::recorder::{Recording, Replay};
use trocar_scene::{Component, DeviceState, Entity, Name, Pose, SimTime, VertexPositions};

use crate::support::{here, object, stderr, trocar};

/// Two and a half seconds of an exercise.
fn record(folder: &Path, scenario: &str) {
    let run =
        ["run", scenario, "--lockstep", "--seconds", "2.5", "--no-report", "--json", "--record", "a.mcap"];
    let output = trocar(folder, &run);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
}

/// The entities of a recording by their names.
fn entities(recording: &Recording, app: &App) -> BTreeMap<String, Entity> {
    let replay = Replay::new(recording, app.registry()).expect("a keyframe");
    replay.view().iter::<Name>().map(|(entity, name)| (name.0.clone(), entity)).collect()
}

fn series<T: Component>(folder: &Path, entity: &str) -> Vec<(SimTime, T)> {
    let app = App::new();
    let recording = Recording::open(&folder.join("a.mcap")).expect("opens");
    recording.series::<T>(app.registry(), entities(&recording, &app)[entity]).expect("is whole")
}

/// Columns of a table and its rows, as text.
fn read_csv(file: &Path) -> (Vec<String>, Vec<BTreeMap<String, String>>) {
    let mut reader = csv::Reader::from_path(file).expect("a table");
    let columns: Vec<String> = reader.headers().expect("names").iter().map(str::to_owned).collect();
    let rows = reader.records().map(|row| {
        columns.iter().cloned().zip(row.expect("a row").iter().map(str::to_owned)).collect::<BTreeMap<_, _>>()
    });
    let rows = rows.collect();
    (columns, rows)
}

fn read_parquet(file: &Path) -> Vec<BTreeMap<String, Field>> {
    let reader = SerializedFileReader::new(std::fs::File::open(file).expect("a table")).expect("parquet");
    let rows = reader.get_row_iter(None).expect("rows");
    rows.map(|row| row.expect("a row").into_columns().into_iter().collect()).collect()
}

fn number(row: &BTreeMap<String, String>, column: &str) -> f64 {
    row[column].parse().unwrap_or_else(|_| panic!("{column}: '{}'", row[column]))
}

fn of(rows: Vec<BTreeMap<String, String>>, entity: &str) -> Vec<BTreeMap<String, String>> {
    rows.into_iter().filter(|row| row["entity"] == entity).collect()
}

#[test]
fn tables_hold_every_stored_value_to_the_last_bit() {
    let folder = here();
    record(folder.path(), "peg-transfer");
    let output = trocar(folder.path(), &["recording", "export", "a.mcap", "--json"]);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let told = object(&output);
    let names: Vec<&str> = told["tables"]
        .as_array()
        .expect("tables")
        .iter()
        .map(|table| table["name"].as_str().expect("a name"))
        .collect();
    let wanted = [
        "device_force",
        "device_state",
        "events",
        "gaps",
        "instrument_force",
        "jaw_state",
        "pose",
        "task_state",
    ];
    assert_eq!(names, wanted);
    assert_eq!((&told["empty"], &told["error"]), (&serde_json::json!(["measured"]), &Value::Null));
    assert_eq!(std::fs::read_dir(folder.path().join("a.tables")).expect("a folder").count(), names.len());

    let tables = folder.path().join("a.tables");
    let poses = series::<Pose>(folder.path(), "ring.2");
    let (columns, rows) = read_csv(&tables.join("pose.csv"));
    assert_eq!(columns[..3], ["time_secs", "entity", "rotation.0"]);
    let rows = of(rows, "ring.2");
    assert!(rows.len() == poses.len() && poses.len() > 10, "{} rows of {}", rows.len(), poses.len());
    for (row, (time, pose)) in rows.iter().zip(&poses) {
        assert_eq!(number(row, "time_secs"), time.as_nanos() as f64 / 1e9);
        assert_eq!(number(row, "translation.2"), pose.translation.z);
        assert_eq!(number(row, "rotation.0"), pose.rotation.i);
    }
    let states = series::<DeviceState>(folder.path(), "hand.left");
    let rows = of(read_csv(&tables.join("device_state.csv")).1, "hand.left");
    assert!(rows.len() == states.len() && states.len() > 2_000, "{} rows of {}", rows.len(), states.len());
    for (row, (_, state)) in rows.iter().zip(&states) {
        assert_eq!(number(row, "applied_force.1").to_bits(), state.applied_force.y.to_bits());
        assert_eq!(row["sampled_at"], state.sampled_at.as_nanos().to_string());
        assert_eq!(row["connected"], state.connected.to_string());
    }
    let (columns, events) = read_csv(&tables.join("events.csv"));
    assert_eq!(columns, ["time_secs", "name", "subject", "object", "value"]);
    assert!(events.iter().any(|row| row["name"] == "task_started"), "{events:?}");
    assert_eq!(read_csv(&tables.join("gaps.csv")).1.len(), 0);
    // Only those of one body.
    let export =
        ["recording", "export", "a.mcap", "--component", "events", "--entity", "ring.2", "--out", "few"];
    assert_eq!(trocar(folder.path(), &export).status.code(), Some(0));
    let few = read_csv(&folder.path().join("few/events.csv")).1;
    assert!(!few.is_empty() && few.len() < events.len(), "{few:?}");
    assert!(few.iter().all(|row| row["subject"] == "ring.2" || row["object"] == "ring.2"), "{few:?}");
}

#[test]
fn parquet_holds_the_same_with_types() {
    let folder = here();
    record(folder.path(), "peg-transfer");
    let export = ["recording", "export", "a.mcap", "--format", "parquet", "--out", "tables", "--json"];
    let output = trocar(folder.path(), &export);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let tables = folder.path().join("tables");
    let states = series::<DeviceState>(folder.path(), "hand.left");
    let mut rows = read_parquet(&tables.join("device_state.parquet"));
    rows.retain(|row| row["entity"] == Field::Str("hand.left".into()));
    assert_eq!(rows.len(), states.len());
    for (row, (time, state)) in rows.iter().zip(&states) {
        assert_eq!(row["time_secs"], Field::Double(time.as_nanos() as f64 / 1e9));
        assert_eq!(row["applied_force.0"], Field::Double(state.applied_force.x));
        assert_eq!(row["sampled_at"], Field::Long(state.sampled_at.as_nanos() as i64));
        assert_eq!(row["connected"], Field::Bool(state.connected));
    }
    let tasks = read_parquet(&tables.join("task_state.parquet"));
    assert_eq!(tasks.last().expect("a row")["score"], Field::Null);
    assert!(read_parquet(&tables.join("gaps.parquet")).is_empty());
}

#[test]
fn vertices_get_a_row_each_when_they_are_asked_for() {
    let folder = here();
    record(folder.path(), "cloth-cut");
    let export =
        ["recording", "export", "a.mcap", "--component", "vertex_positions", "--entity", "gauze", "--json"];
    let output = trocar(folder.path(), &export);
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let (columns, rows) = read_csv(&folder.path().join("a.tables/vertex_positions.csv"));
    assert_eq!(columns, ["time_secs", "entity", "index", "positions.0", "positions.1", "positions.2"]);
    let stored = series::<VertexPositions>(folder.path(), "gauze");
    let points = stored.iter().flat_map(|(_, vertices)| vertices.positions.iter().zip(0..));
    assert!(rows.len() > 10_000 && rows.len() == points.clone().count());
    for (row, (point, index)) in rows.iter().zip(points) {
        assert_eq!(number(row, "index") as i64, index);
        assert_eq!(number(row, "positions.0"), point.x);
    }
}

#[test]
fn names_that_are_not_there_are_refused_with_those_that_are() {
    let folder = here();
    record(folder.path(), "peg-transfer");
    let said = |arguments: &[&str]| {
        let output =
            trocar(folder.path(), &[&["recording", "export", "a.mcap", "--json"], arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{}", stderr(&output));
        assert!(!folder.path().join("a.tables").exists(), "nothing is written");
        assert!(object(&output)["error"].is_string());
        stderr(&output)
    };
    let text = said(&["--component", "posse"]);
    assert!(text.contains("'posse'; did you mean 'pose'?") && text.contains("device_state"), "{text}");
    let text = said(&["--component", "pose", "--entity", "ring2"]);
    assert!(text.contains("'ring2'; did you mean 'ring.2'?") && text.contains("grasper.left"), "{text}");
    let output = trocar(folder.path(), &["recording", "export", "b.mcap"]);
    assert_eq!(output.status.code(), Some(4), "{}", stderr(&output));
}

#[test]
fn of_a_recording_that_is_cut_everything_whole_is_exported() {
    let folder = here();
    record(folder.path(), "peg-transfer");
    let whole = series::<Pose>(folder.path(), "ring.2");
    let file = folder.path().join("a.mcap");
    let bytes = std::fs::read(&file).expect("a recording");
    std::fs::write(&file, &bytes[..bytes.len() / 2]).expect("written");
    let output = trocar(folder.path(), &["recording", "export", "a.mcap", "--force", "--json"]);
    assert_eq!(output.status.code(), Some(1), "{}", stderr(&output));
    let text = stderr(&output);
    assert!(text.contains("everything that is whole was exported") && text.contains("cut short"), "{text}");
    assert_eq!(object(&output)["missing"].as_array().expect("a list").len(), 1);
    let rows = of(read_csv(&folder.path().join("a.tables/pose.csv")).1, "ring.2");
    assert!(!rows.is_empty() && rows.len() < whole.len(), "{} rows of {}", rows.len(), whole.len());
    for (row, (time, pose)) in rows.iter().zip(&whole) {
        assert_eq!(number(row, "time_secs"), time.as_nanos() as f64 / 1e9);
        assert_eq!(number(row, "translation.0"), pose.translation.x);
    }
    let gaps = read_csv(&folder.path().join("a.tables/gaps.csv")).1;
    assert_eq!(gaps.len(), 1);
    assert_eq!(gaps[0]["kind"], "cut");
}

#[test]
fn no_damage_ends_an_export_in_a_panic() {
    let folder = here();
    record(folder.path(), "peg-transfer");
    let file = folder.path().join("a.mcap");
    let whole = std::fs::read(&file).expect("a recording");
    let mut damaged = 0;
    for place in 1..12 {
        let mut bytes = whole.clone();
        let at = bytes.len() * place / 12;
        bytes[at..at + 3].fill(0xff);
        std::fs::write(&file, &bytes).expect("written");
        let output = trocar(folder.path(), &["recording", "export", "a.mcap", "--force", "--json"]);
        let text = stderr(&output);
        assert!(
            matches!(output.status.code(), Some(0 | 1 | 4)) && !text.contains("panicked"),
            "{place}: {text}"
        );
        assert!(object(&output)["tables"].is_array(), "{place}: {text}");
        damaged += usize::from(output.status.code() == Some(1) && text.contains("damage"));
    }
    assert!(damaged > 5, "most of a recording is commits: {damaged}");
    let left = std::fs::read_dir(folder.path().join("a.tables")).expect("a folder");
    let parts = left
        .filter(|entry| entry.as_ref().expect("an entry").path().extension().is_some_and(|e| e == "part"));
    assert_eq!(parts.count(), 0);
}
