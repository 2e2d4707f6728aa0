//! A hand that is commanded by Zenoh, and what a session tells meanwhile.

use std::time::Duration;

use serde_json::json;
use trocar_zenoh::live::list;
use trocar_zenoh::rights::Rights;

use crate::support::{Client, Running, free_port, settings, wait_for};

#[test]
fn a_client_reads_poses_and_commands_a_hand_within_its_limits() {
    let endpoint = format!("tcp/127.0.0.1:{}", free_port());
    let running = Running::start(&endpoint, &Rights::default(), Some("right"));
    let client = Client::open(&endpoint);
    let heard = client.subscribe(&running.keys.all());
    let (_, wall) = heard.until("the wall's pose", |key, _| key == running.keys.pose("wall"));
    assert_eq!(wall["translation"]["z"], json!(-0.01));
    heard.until("health", |key, value| key == running.keys.health() && value["engine"] == "healthy");
    heard.until("forces", |key, _| key == running.keys.hand("right", "force"));
    let info = client.ask(&running.keys.info()).expect("it answers");
    assert_eq!((&info["hands"], &info["protected"]), (&json!(["right"]), &json!(false)));

    // Without the claim nothing moves.
    let command = |claim: &str, sequence: u64, x: f64| {
        client.put(
            &running.keys.hand("right", "command"),
            &json!({ "claim": claim, "sequence": sequence, "position": [x, 0.0, 0.0] }),
        );
    };
    command("0000000000000000", 1, 0.0);
    wait_for("it is refused", || (running.bridge.counts().commands_refused == 1).then_some(()));
    let claim = client.claim(&running.keys.hand("right", "claim"));
    assert!(
        client.ask(&running.keys.hand("right", "claim")).is_err_and(|told| told.contains("somebody else"))
    );
    let mut sequence = 0;
    let answer = heard_while(&heard, &running, "the hand is where it was told", || {
        sequence += 1;
        // A metre away: it goes to the wall of the workspace, at 1 m/s at most.
        command(&claim, sequence, if sequence < 20 { 0.0 } else { 1.0 });
    });
    assert!((answer["position"][0].as_f64().expect("a number") - 0.08).abs() < 1e-6, "{answer}");
    // It is silent now: the hand holds still, and says so.
    heard.until("silence", |key, value| {
        key == running.keys.hand("right", "answer") && value["presence"] == "silent"
    });
    let found = list(&settings(&endpoint), &Rights::default()).expect("a list");
    assert_eq!((found.len(), found[0].alive, found[0].name.as_str()), (1, true, "wall"));
    drop(running);
}

/// Commands until the hand is at the wall of its workspace.
fn heard_while(
    heard: &crate::support::Heard,
    running: &Running,
    what: &str,
    mut command: impl FnMut(),
) -> serde_json::Value {
    let key = running.keys.hand("right", "answer");
    wait_for(what, || {
        command();
        let mut newest = None;
        while let Some((_, value)) = heard.next(Duration::from_millis(5), |of, _| of == key) {
            newest = Some(value);
        }
        newest.filter(|value| value["position"][0].as_f64().is_some_and(|x| x > 0.079_999_9))
    })
}
