//! `trocar relay` from outside: a host that has dialled out is joined by its port there, and by nobody without a ticket.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use trocar::network::ticket::Ticket;

use crate::support::hosting::Host;
use crate::support::{here, object, stderr, trocar};

/// A relay as a program of its own, with one port for a session.
struct Relay {
    child: Child,
    port: u16,
}

impl Relay {
    fn start(folder: &Path) -> Self {
        // A port of a session that nobody else has: the system's choice, which is free a moment later.
        let free = std::net::TcpListener::bind(("127.0.0.1", 0)).expect("some port is free");
        let session = free.local_addr().expect("it is bound").port();
        drop(free);
        let ports = format!("{session}-{session}");
        let arguments = ["relay", "--bind", "127.0.0.1", "--port", "0", "--ports", &ports];
        let mut child = Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(arguments)
            .args(["--key-file", "relay.key", "--seconds", "120", "--json"])
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut lines = BufReader::new(child.stderr.take().expect("piped")).lines();
        let port = lines.find_map(|line| {
            let line = line.expect("text");
            let (_, rest) = line.split_once("THIS_MACHINE:")?;
            rest.split_whitespace().next()?.parse().ok()
        });
        // What it says later is not read, and is little.
        Self { child, port: port.expect("it tells its port") }
    }
}

impl Drop for Relay {
    fn drop(&mut self) {
        // It may have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
fn a_host_behind_a_relay_is_reached_by_name_tcp_udp_and_long_datagrams_and_joined() {
    let folder = here();
    let relay = Relay::start(folder.path());
    let at = format!("127.0.0.1:{}", relay.port);
    let host = Host::start_with(folder.path(), &["watch=Bo"], &["--relay", &at, "--relay-key", "relay.key"]);
    let ticket: Ticket = host.tickets[0].parse().expect("a ticket");
    let there = ticket.addresses().last().expect("the relay's").clone();
    assert_ne!(there.port(), ticket.addresses()[0].port());
    let (token, session) = (ticket.token().clone(), ticket.session().clone());
    let only =
        Ticket::new(vec![there], *ticket.fingerprint(), token, ticket.role(), ticket.expires(), session);
    std::fs::write(folder.path().join("ticket"), only.expect("a ticket").to_string()).expect("it is written");
    let looked = trocar(folder.path(), &["doctor", "--ticket-file", "ticket", "--json"]);
    let checks = object(&looked)["checks"].as_array().expect("checks").clone();
    assert!(checks.iter().all(|check| check["status"] == "ok"), "{checks:#?}");
    let arguments = ["watch", "--ticket-file", "ticket", "--headless", "--json", "--seconds", "1"];
    let watched = trocar(folder.path(), &arguments);
    assert_eq!(watched.status.code(), Some(0), "{}", stderr(&watched));
    host.end();
}

#[test]
fn a_relay_that_is_not_there_and_a_key_that_is_none_are_told() {
    let folder = here();
    let host = |relay: &str, key: &str| {
        let arguments = ["host", "peg-transfer", "--headless", "--port", "0", "--bind", "127.0.0.1"];
        let tickets = ["--tickets", "host.tickets", "--relay", relay, "--relay-key", key];
        trocar(folder.path(), &[&arguments[..], &tickets[..]].concat())
    };
    let missing = host("127.0.0.1:1", "relay.key");
    assert_eq!(missing.status.code(), Some(4), "{}", stderr(&missing));
    assert!(stderr(&missing).contains("relay.key"), "{}", stderr(&missing));
    let _relay = Relay::start(folder.path());
    let nobody = host("127.0.0.1:1", "relay.key");
    assert_eq!(nobody.status.code(), Some(69), "{}", stderr(&nobody));
    assert!(stderr(&nobody).contains("127.0.0.1:1"), "{}", stderr(&nobody));
}
