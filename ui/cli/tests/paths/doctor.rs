//! `trocar doctor --ticket-file`: each fault of a path to a real host is found at its own step, and the ticket stays good.

use std::io::{Read, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::path::Path;
use std::process::Output;

use trocar::network::ticket::{Fingerprint, HostAddress, Ticket};

use crate::support::hosting::Host;
use crate::support::{here, object, stderr, trocar};

/// What a forwarder does with datagrams.
#[derive(Clone, Copy)]
enum Datagrams {
    None,
    UpTo(usize),
}

fn carry(mut from: TcpStream, mut to: TcpStream) {
    std::thread::spawn(move || {
        let mut bytes = [0; 16 << 10];
        while let Ok(count @ 1..) = from.read(&mut bytes) {
            if to.write_all(&bytes[..count]).is_err() {
                break;
            }
        }
        // Its other end may be gone already.
        let _ = to.shutdown(Shutdown::Write);
    });
}

/// Forwards streams to a host, and its datagrams or not. Its threads end with the program of the tests.
fn forwarder(host: SocketAddr, datagrams: Datagrams) -> SocketAddr {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("some port is free");
    let address = listener.local_addr().expect("it is bound");
    std::thread::spawn(move || {
        while let Ok((station, _)) = listener.accept() {
            let Ok(there) = TcpStream::connect(host) else { continue };
            let (back, from) = (there.try_clone().expect("a socket"), station.try_clone().expect("a socket"));
            carry(from, there);
            carry(back, station);
        }
    });
    if let Datagrams::UpTo(most) = datagrams {
        let near = UdpSocket::bind(address).expect("the same port is free for datagrams");
        let far = UdpSocket::bind(("127.0.0.1", 0)).expect("some port is free");
        far.connect(host).expect("an address of this machine");
        let (station, answers) = (near.try_clone().expect("a socket"), far.try_clone().expect("a socket"));
        let (tell, asked) = std::sync::mpsc::sync_channel(256);
        std::thread::spawn(move || {
            let mut bytes = [0; 2_048];
            while let Ok((count, from)) = near.recv_from(&mut bytes) {
                if count <= most && tell.send(from).is_ok() {
                    // What the system does not take is lost, as on any path.
                    let _ = far.send(&bytes[..count]);
                }
            }
        });
        std::thread::spawn(move || {
            let mut bytes = [0; 2_048];
            while let Ok(count) = answers.recv(&mut bytes) {
                let Ok(to) = asked.recv() else { return };
                let _ = station.send_to(&bytes[..count], to);
            }
        });
    }
    address
}

/// The same ticket for another address.
fn at(ticket: &Ticket, address: &str, fingerprint: Fingerprint) -> Ticket {
    let address: HostAddress = address.parse().expect("an address");
    let (token, session) = (ticket.token().clone(), ticket.session().clone());
    Ticket::new(vec![address], fingerprint, token, ticket.role(), ticket.expires(), session)
        .expect("a ticket")
}

fn doctor(folder: &Path, ticket: &Ticket) -> Output {
    std::fs::write(folder.join("ticket"), ticket.to_string()).expect("it is written");
    trocar(folder, &["doctor", "--ticket-file", "ticket", "--json"])
}

/// The checks that are not `ok`, with their status; each that fails says how to mend it.
fn faults(output: &Output) -> Vec<(String, String)> {
    let object = object(output);
    let checks = object["checks"].as_array().expect("checks").clone();
    assert_eq!(checks.len(), 7, "{object}");
    let text = |value: &serde_json::Value| value.as_str().expect("text").to_owned();
    for check in &checks {
        assert_eq!(
            check["mend"].is_string(),
            ["warn", "fail"].contains(&text(&check["status"]).as_str()),
            "{check}"
        );
    }
    let faults = checks.iter().filter(|check| check["status"] != "ok");
    faults.map(|check| (text(&check["name"]), text(&check["status"]))).collect()
}

#[test]
fn each_fault_of_a_path_is_found_at_its_step_and_the_ticket_still_lets_in() {
    let folder = here();
    let host = Host::start(folder.path(), &["operate=Ana"]);
    let ticket: Ticket = host.tickets[0].parse().expect("a ticket");
    let pinned = *ticket.fingerprint();
    let address: SocketAddr = ticket.addresses()[0].to_string().parse().expect("an address");
    let over = |datagrams| at(&ticket, &forwarder(address, datagrams).to_string(), pinned);
    let rest = ["ticket", "UDP", "path MTU", "clock"].map(|name| (name, "skip"));
    let unreached = |steps: &[(&'static str, &'static str)]| [steps, &rest[..]].concat();
    let cases = [
        ("all well", ticket.clone(), vec![]),
        ("no datagrams", over(Datagrams::None), vec![("UDP", "fail"), ("path MTU", "skip")]),
        ("no long datagrams", over(Datagrams::UpTo(1_100)), vec![("path MTU", "fail")]),
        (
            "another certificate",
            at(&ticket, &address.to_string(), Fingerprint::from_bytes([7; 32])),
            unreached(&[("certificate", "fail")]),
        ),
        (
            "no such name",
            at(&ticket, "host.invalid:7417", pinned),
            unreached(&[("name", "fail"), ("TCP", "skip"), ("certificate", "skip")]),
        ),
        (
            "nobody listens",
            at(&ticket, "127.0.0.1:1", pinned),
            unreached(&[("TCP", "fail"), ("certificate", "skip")]),
        ),
    ];
    for (what, ticket, expected) in cases {
        let output = doctor(folder.path(), &ticket);
        let found = faults(&output);
        let found: Vec<(&str, &str)> =
            found.iter().map(|(name, status)| (name.as_str(), status.as_str())).collect();
        assert_eq!(found, expected, "{what}: {}{}", String::from_utf8_lossy(&output.stdout), stderr(&output));
        let code = i32::from(expected.iter().any(|(_, status)| *status == "fail"));
        assert_eq!(output.status.code(), Some(code), "{what}");
    }
    let listed = trocar(folder.path(), &["host", "tickets", "--tickets", "host.tickets", "--json"]);
    assert_eq!(object(&listed)["tickets"][0]["state"], "open", "nothing is spent");
    // A host that never gave the ticket out says so, and answers no datagram.
    let stranger = Ticket::new(
        ticket.addresses().to_vec(),
        pinned,
        trocar::network::ticket::Token::from_bytes([9; 16]),
        ticket.role(),
        ticket.expires(),
        ticket.session().clone(),
    );
    let refused = doctor(folder.path(), &stranger.expect("a ticket"));
    let expected = [("ticket", "fail"), ("UDP", "skip"), ("path MTU", "skip"), ("clock", "skip")];
    assert_eq!(faults(&refused), expected.map(|(name, status)| (name.to_owned(), status.to_owned())));
    assert_eq!(refused.status.code(), Some(1));
    host.end();
}

#[test]
fn a_file_without_a_ticket_is_refused_with_its_name() {
    let folder = here();
    let missing = trocar(folder.path(), &["doctor", "--ticket-file", "none", "--json"]);
    assert_eq!(missing.status.code(), Some(4));
    assert!(stderr(&missing).contains("none"), "{}", stderr(&missing));
    std::fs::write(folder.path().join("nonsense"), "trocar1nonsense").expect("it is written");
    let nonsense = trocar(folder.path(), &["doctor", "--ticket-file", "nonsense"]);
    assert_eq!(nonsense.status.code(), Some(2), "{}", stderr(&nonsense));
}
