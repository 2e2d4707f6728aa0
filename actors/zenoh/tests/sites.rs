//! Two sites, each with a router: what one tells, the other sees.

use serde_json::json;
use trocar_zenoh::live::{Router, list};
use trocar_zenoh::rights::Rights;

use crate::support::{Client, Running, free_port, settings, wait_for};

#[test]
fn two_sites_see_each_other_through_their_routers() {
    let (a, b) = (free_port(), free_port());
    let none = Rights::default();
    let at_a = Router::open(&settings(&format!("tcp/127.0.0.1:{a}")), &none).expect("a router");
    let joined = format!("listen=tcp/127.0.0.1:{b},connect=tcp/127.0.0.1:{a}");
    let at_b = Router::open(&settings(&joined), &none).expect("a router");
    let first = Running::start(&format!("connect=tcp/127.0.0.1:{a},name=site-a"), &none, Some("right"));
    let second = Running::start(&format!("connect=tcp/127.0.0.1:{b},name=site-b"), &none, None);

    // Either router shows both.
    for port in [a, b] {
        let names = wait_for("both sessions", || {
            let found = list(&settings(&format!("tcp/127.0.0.1:{port}")), &none).ok()?;
            let names: Vec<String> =
                found.iter().filter(|one| one.alive).map(|one| one.name.clone()).collect();
            (names.len() == 2).then_some(names)
        });
        assert_eq!(names, ["site-a", "site-b"]);
    }
    // Somebody at site B sees what happens at site A, and commands its hand.
    let client = Client::open(&format!("tcp/127.0.0.1:{b}"));
    let heard = client.subscribe(&first.keys.all());
    heard.until("the wall at site A", |key, _| key == first.keys.pose("wall"));
    let claim = client.claim(&first.keys.hand("right", "claim"));
    let mut sequence = 0;
    wait_for("the hand at site A follows", || {
        sequence += 1;
        let command = json!({ "claim": claim, "sequence": sequence, "position": [0.0, 0.01, 0.0] });
        client.put(&first.keys.hand("right", "command"), &command);
        let within = std::time::Duration::from_millis(20);
        heard.next(within, |key, value| {
            key == first.keys.hand("right", "answer") && value["presence"] == "live"
        })
    });
    drop((client, first, second, at_b, at_a));
}
