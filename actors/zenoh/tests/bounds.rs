//! Whatever floods a session from elsewhere costs who does it, and is counted.

use std::time::Duration;

use serde_json::json;
use trocar_zenoh::rights::Rights;

use crate::support::{Client, Running, free_port, wait_for};

#[test]
fn a_flood_of_batches_commands_and_questions_is_bounded_and_the_session_goes_on() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let rights = Rights::parse(
        "[[controller]]\nname = \"crane\"\nwrites = [\"pose\"]\nentities = [\"camera\"]\nsilence_secs = 5.0",
    )
    .expect("rights");
    let running = Running::start(&endpoint, &rights, Some("right"));
    let client = Client::open(&endpoint);
    let keys = running.keys.clone();
    let heard = client.subscribe(&keys.health());
    heard.until("the session", |_, _| true);
    let claim = client.claim(&keys.controller("crane", "claim"));
    let put =
        json!([{ "entity": "camera", "component": "pose", "value": { "translation": [0.0, 0.0, 1.0] } }]);
    let long = "x".repeat(1 << 20);
    for sequence in 0..20_000_u64 {
        let batch = json!({ "claim": claim, "sequence": sequence, "put": put });
        client.put(&keys.controller("crane", "batch"), &batch);
        client.put(&keys.hand("right", "command"), &json!({}));
        if sequence % 1_000 == 0 {
            client.put(&keys.hand("right", "command"), &json!(long));
        }
    }
    let before = running.live.elapsed();
    let status = client.subscribe(&keys.controller("crane", "status"));
    let (_, told) =
        status.until("it is judged", |_, value| value["accepted"].as_u64().is_some_and(|count| count > 0));
    let counts = running.bridge.counts();
    println!("{counts:?}, {told}");
    assert!(counts.commands_refused > 0 && counts.restarts == 0);
    wait_for("the session goes on", || (running.live.elapsed() > before).then_some(()));
    heard.until("and tells", |_, _| true);
    assert!(heard.count(Duration::from_millis(2_500)) <= 8, "at its own rate");
    assert!(!running.live.has_ended());
}
