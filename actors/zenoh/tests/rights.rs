//! Without rights nothing is read and nothing is written: certificates on both sides, and what is not allowed is denied.

use std::path::Path;
use std::time::Duration;

use serde_json::json;
use trocar_zenoh::certificates::make;
use trocar_zenoh::live::list;
use trocar_zenoh::rights::Rights;

use crate::support::{Client, Running, free_port, settings, wait_for};

/// Files of a name, for a client.
fn files(folder: &Path, name: &str) -> [String; 3] {
    ["authority.pem", &format!("{name}.pem"), &format!("{name}.key")]
        .map(|file| folder.join(file).display().to_string())
}

fn client(endpoint: &str, files: &[String; 3]) -> zenoh::Result<Client> {
    Client::try_open(endpoint, Some(files.each_ref().map(String::as_str)))
}

#[test]
fn without_rights_nothing_is_read_and_nothing_is_written() {
    let temporary = tempfile::tempdir().expect("a folder");
    let folder = temporary.path();
    for name in ["host", "ana", "bo", "eve"] {
        make(folder, name, &[]).expect("a certificate");
    }
    let elsewhere = folder.join("elsewhere");
    make(&elsewhere, "ana", &[]).expect("a certificate of another authority");
    let text = "readers = [\"bo\"]\n[tls]\nauthority = \"authority.pem\"\ncertificate = \"host.pem\"\nkey = \"host.key\"\n\
                [[hand]]\nname = \"right\"\nwho = [\"ana\"]\n";
    let config = folder.join("zenoh.toml");
    std::fs::write(&config, text).expect("a file");
    let rights = Rights::read(&config).expect("rights");
    let endpoint = format!("tls/127.0.0.1:{}", free_port());
    let running = Running::start(&endpoint, &rights, Some("right"));
    let keys = &running.keys;

    // Who has no certificate, or one that another authority has signed, gets no connection.
    let [authority, ..] = files(folder, "ana");
    let [_, certificate, key] = files(&elsewhere, "ana");
    let strangers = [[authority.clone(), String::new(), String::new()], [authority, certificate, key]];
    for stranger in strangers {
        if let Ok(stranger) = client(&endpoint, &stranger) {
            // TLS 1.3 tells a client of a refused certificate only with what it reads next.
            let heard = stranger.subscribe("**");
            assert!(stranger.ask(&keys.info()).is_err());
            assert_eq!(heard.count(Duration::from_millis(1_500)), 0);
        }
    }
    let bo = client(&endpoint, &files(folder, "bo")).expect("bo is known");
    let heard_by_bo = bo.subscribe(&keys.all());
    heard_by_bo.until("bo reads", |key, _| key == keys.pose("wall"));
    // Known, and without any right: what bo hears in this time, eve does not.
    let eve = client(&endpoint, &files(folder, "eve")).expect("eve is known");
    let heard_by_eve = eve.subscribe(&keys.all());
    assert!(heard_by_bo.count(Duration::from_millis(1_500)) > 0);
    assert_eq!(heard_by_eve.count(Duration::from_millis(10)), 0);
    assert!(eve.ask(&keys.info()).is_err() && eve.ask(&keys.hand("right", "claim")).is_err());

    // Who reads does not command, whatever number it sends.
    assert!(bo.ask(&keys.info()).is_ok());
    assert!(bo.ask(&keys.hand("right", "claim")).is_err());
    let ana = client(&endpoint, &files(folder, "ana")).expect("ana is known");
    let claim = ana.claim(&keys.hand("right", "claim"));
    let command = |from: &Client, sequence: u64| {
        let command = json!({ "claim": claim, "sequence": sequence, "position": [0.0, 0.0, 0.0] });
        from.put(&keys.hand("right", "command"), &command);
    };
    for sequence in 1_000..1_050 {
        command(&bo, sequence);
        command(&eve, sequence);
    }
    let mut sequence = 0;
    let live = wait_for("ana commands", || {
        sequence += 1;
        command(&ana, sequence);
        let of = keys.hand("right", "answer");
        heard_by_bo.next(Duration::from_millis(20), |key, value| key == of && value["presence"] == "live")
    });
    // Had one of the others' commands come, the sequence would have been above ana's.
    assert!(live.1["commands"].as_u64().is_some_and(|count| count <= sequence), "{}", live.1);
    assert_eq!(running.bridge.counts().commands_refused, 0);

    // A list for those who may.
    let calls = |name: &str| {
        let text = text.replace("host.", &format!("{name}."));
        let file = folder.join(format!("{name}.toml"));
        std::fs::write(&file, text).expect("a file");
        list(
            &settings(&format!("connect={endpoint},config={}", file.display())),
            &Rights::read(&file).expect("rights"),
        )
    };
    let found = calls("bo").expect("a list");
    assert_eq!((found.len(), &found[0].info["protected"]), (1, &json!(true)));
    assert_eq!(calls("eve").map(|found| found.len()).unwrap_or(0), 0);
    let open = list(&settings(&endpoint.replace("tls/", "connect=tls/")), &Rights::default());
    assert!(open.expect_err("no certificates").to_string().contains("certificates"));
}
