//! A controller on another machine is one more writer: declared, checked by the Model, fenced, watched.

use serde_json::{Value, json};
use trocar_scene::{Pose, Snapshot};
use trocar_zenoh::rights::Rights;

use crate::support::{Client, Running, free_port, wait_for};

const RIGHTS: &str = r#"
    [[controller]]
    name = "crane"
    reads = ["instrument_target", "pose"]
    writes = ["pose"]
    entities = ["camera"]
    silence_secs = 1.0
    rest = [{ entity = "camera", component = "pose", value = { translation = [0.0, 0.0, 9.0] } }]
"#;

fn camera_z(scene: &Snapshot) -> Option<f64> {
    Some(scene.get::<Pose>(scene.find("camera")?)?.translation.z)
}

fn put(entity: &str, component: &str, value: Value) -> Value {
    json!([{ "entity": entity, "component": component, "value": value }])
}

#[test]
fn a_controller_elsewhere_writes_what_it_declared_and_nothing_else() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let rights = Rights::parse(RIGHTS).expect("rights");
    let running = Running::start(&endpoint, &rights, None);
    let client = Client::open(&endpoint);
    let keys = running.keys.clone();
    let (rows, status) =
        (client.subscribe("trocar/wall/row/**"), client.subscribe(&keys.controller("crane", "status")));
    rows.until("rows that it reads", |key, row| {
        key == keys.row("pose", "wall") && row["translation"].is_array()
    });

    let claim = client.claim(&keys.controller("crane", "claim"));
    let mut sequence = 0;
    let mut batch = |put: Value| {
        sequence += 1;
        client.put(
            &keys.controller("crane", "batch"),
            &json!({ "claim": claim, "sequence": sequence, "put": put }),
        );
    };
    let pose = |z: f64| json!({ "translation": [0.0, 0.0, z] });
    wait_for("what it declared is applied", || {
        batch(put("camera", "pose", pose(5.0)));
        (camera_z(&running.live.snapshot()) == Some(5.0)).then_some(())
    });
    // The Model itself refuses the rest, whole batches at a time, and says what.
    let told = wait_for("the Model's refusal", || {
        batch(json!([
            { "entity": "camera", "component": "pose", "value": pose(6.0) },
            { "entity": "wall", "component": "pose", "value": pose(7.0) },
        ]));
        let (_, told) = status.until("a status", |_, value| value["claimed"] == true);
        told["last_refusal"].as_str().map(str::to_owned)
    });
    assert!(told.contains("pose") && told.contains("0:0:"), "{told}");
    assert_ne!(camera_z(&running.live.snapshot()), Some(6.0), "none of it is applied");

    // Silence: fenced, and the row is what it rests at.
    wait_for("it rests", || (camera_z(&running.live.snapshot()) == Some(9.0)).then_some(()));
    batch(put("camera", "pose", pose(5.0)));
    status.until("an old claim is refused", |_, value| {
        value["last_refusal"].as_str().is_some_and(|told| told.contains("silence")) && value["silences"] == 1
    });
    assert_eq!(camera_z(&running.live.snapshot()), Some(9.0));
    client.claim(&keys.controller("crane", "claim"));
}

#[test]
fn rows_that_another_writer_has_are_not_given_away() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let running = Running::start(&endpoint, &Rights::default(), None);
    let text = RIGHTS.replace("entities = [\"camera\"]", "entities = [\"probe.right\"]");
    let right = Rights::parse(&text).expect("rights").controllers.remove(0);
    let controller = trocar_zenoh::remote_controller::RemoteController::new(right);
    let access = controller.access(&running.live.snapshot()).expect("names that there are");
    let refused = running
        .live
        .guest_with_answers("zenoh.crane", trocar_scene::WriterId(300), &access, 4)
        .expect_err("the engine has it");
    let told = refused.to_string();
    assert!(told.contains("zenoh.crane") && told.contains("engine") && told.contains("pose"), "{told}");
}
