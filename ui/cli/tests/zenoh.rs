//! Sessions beyond one machine: what is refused, and what the commands tell.

use crate::support::{here, stderr, trocar};

/// A command that is refused as a wrong command line, and what its message names.
fn assert_refused(arguments: &[&str], named: &[&str]) {
    let folder = here();
    let output = trocar(folder.path(), arguments);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    for name in named {
        assert!(message.contains(name), "{arguments:?}: '{name}' is not in: {message}");
    }
}

#[cfg(not(feature = "zenoh"))]
#[test]
fn a_program_without_zenoh_says_how_to_get_it() {
    assert_refused(&["run", "wall", "--headless", "--zenoh"], &["without Zenoh", "--features zenoh"]);
    assert_refused(&["zenoh", "list"], &["without Zenoh"]);
}

#[cfg(feature = "zenoh")]
mod with_zenoh {
    use std::net::TcpListener;
    use std::process::{Command, Stdio};
    use std::time::{Duration, Instant};

    use super::assert_refused;
    use crate::support::{here, object, stderr, stdout, trocar};

    fn free_endpoint() -> String {
        let listener = TcpListener::bind("127.0.0.1:0").expect("a port");
        format!("tcp/{}", listener.local_addr().expect("an address"))
    }

    #[test]
    fn what_strangers_could_reach_is_refused_with_what_is_valid() {
        let run = |zenoh: &str, named: &[&str]| {
            assert_refused(&["run", "wall", "--headless", "--zenoh", zenoh], named)
        };
        run("tcp/0.0.0.0:7447", &["tcp/0.0.0.0:7447", "unprotected", "tls/", "docs/network.md"]);
        run("connect=tcp/192.0.2.7:7447", &["unprotected"]);
        run("tls/0.0.0.0:7447", &["certificates", "config=FILE"]);
        run("nmae=x", &["nmae", "connect, listen, name, config"]);
        run("wall", &["wall", "tcp/ADDRESS:PORT"]);
        assert_refused(&["run", "wall", "--lockstep", "--zenoh"], &["--lockstep"]);
        assert_refused(
            &["run", "wall", "--headless", "--hand", "right=zenoh:right"],
            &["--zenoh says where"],
        );
    }

    #[test]
    fn a_session_is_listed_while_it_runs() {
        let (folder, endpoint) = (here(), free_endpoint());
        let session = Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(["run", "wall", "--headless", "--zenoh", &endpoint, "--hand", "right=zenoh:right"])
            .args(["--no-record", "--no-report", "--seconds", "8", "--json"])
            .current_dir(folder.path())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("it runs");
        let begun = Instant::now();
        let found = loop {
            let listed = trocar(folder.path(), &["zenoh", "list", &endpoint, "--json"]);
            if listed.status.success() {
                let found = object(&listed);
                if found["sessions"][0]["alive"] == true {
                    break found;
                }
            }
            assert!(begun.elapsed() < Duration::from_secs(20), "{}", stderr(&listed));
        };
        let session_row = &found["sessions"][0];
        assert_eq!(
            (&session_row["name"], &session_row["info"]["hands"][0]),
            (&"wall".into(), &"right".into())
        );
        assert_eq!(session_row["info"]["protected"], false);
        let listed = trocar(folder.path(), &["zenoh", "list", &endpoint]);
        let text = stdout(&listed);
        assert!(text.contains("wall: wall, alive, unprotected; hands to command: right"), "{text}");
        let done = session.wait_with_output().expect("it ends");
        let summary = object(&done);
        let losses = summary["losses"].to_string();
        assert!(losses.contains("(unprotected)") && losses.contains("whoever reaches"), "{losses}");
        let nobody = trocar(folder.path(), &["zenoh", "list", &endpoint]);
        assert_eq!(nobody.status.code(), Some(69), "{}", stderr(&nobody));
    }

    #[test]
    fn certificates_are_made_beside_the_authority_that_signs_them() {
        let folder = here();
        let made = trocar(
            folder.path(),
            &["zenoh", "certificate", "keys", "ana", "--address", "192.0.2.7", "--json"],
        );
        assert!(made.status.success(), "{}", stderr(&made));
        assert_eq!(object(&made)["certificate"], "keys/ana.pem");
        for file in ["authority.pem", "authority.key", "ana.pem", "ana.key"] {
            assert!(folder.path().join("keys").join(file).is_file(), "{file}");
        }
        let again = trocar(folder.path(), &["zenoh", "certificate", "keys", "ana"]);
        assert_eq!(again.status.code(), Some(4), "{}", stderr(&again));
    }
}
