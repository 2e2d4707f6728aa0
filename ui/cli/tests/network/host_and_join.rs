//! `trocar host`, `join` and `watch` from outside: programs on one machine, over real sockets.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

use trocar::network::ticket::Ticket;
use trocar_kernel::recorder::Recording;

use crate::support::hosting::Host;
use crate::support::{here, object, stderr, trocar};

/// A station that is given its ticket by stdin.
fn begun(folder: &Path, ticket: &str, arguments: &[&str]) -> Child {
    let mut child = Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(arguments)
        .args(["--ticket-file", "-", "--headless"])
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let written = writeln!(child.stdin.take().expect("piped"), "{ticket}");
    // A program that refuses its arguments reads nothing.
    let _ = written;
    child
}

/// The same to its end.
fn station(folder: &Path, ticket: &str, arguments: &[&str]) -> Output {
    begun(folder, ticket, &[arguments, &["--json"]].concat()).wait_with_output().expect("an end")
}

fn controllers(output: &Output) -> Vec<String> {
    let object = object(output);
    let rows = object["controllers"].as_array().expect("rows").clone();
    rows.iter().map(|row| row["name"].as_str().expect("a name").to_owned()).collect()
}

#[test]
fn a_second_program_joins_with_its_own_hand_and_a_third_looks_on() {
    let folder = here();
    let host = Host::start(folder.path(), &["operate=Ana", "watch=Bo"]);
    let join = ["join", "--name", "Ana", "--hand", "left=virtual", "--seconds", "4"];
    let joined = station(folder.path(), &host.tickets[0], &join);
    assert_eq!(joined.status.code(), Some(0), "{}", stderr(&joined));
    assert_eq!(controllers(&joined), ["network", "network.touch", "haptics.left"]);
    let watched = station(folder.path(), &host.tickets[1], &["watch", "--name", "Bo", "--seconds", "2"]);
    assert_eq!(watched.status.code(), Some(0), "{}", stderr(&watched));
    assert_eq!(controllers(&watched), ["network"]);
    // A ticket lets in once.
    let again = station(folder.path(), &host.tickets[1], &["watch", "--seconds", "2"]);
    assert_eq!(again.status.code(), Some(77), "{}", stderr(&again));
    assert!(stderr(&again).contains("used"), "{}", stderr(&again));
    // A further one, from another terminal.
    let port = "1";
    let further = ["host", "ticket", "--role", "watch", "--person", "Cy", "--tickets", "host.tickets"];
    let further = trocar(folder.path(), &[&further[..], &["--port", port, "--json"]].concat());
    assert_eq!(further.status.code(), Some(0), "{}", stderr(&further));
    assert!(object(&further)["ticket"].as_str().is_some_and(|ticket| ticket.starts_with("trocar1")));
    let listed = trocar(folder.path(), &["host", "tickets", "--tickets", "host.tickets", "--json"]);
    let states: Vec<String> = object(&listed)["tickets"]
        .as_array()
        .expect("tickets")
        .iter()
        .map(|row| row["state"].as_str().expect("a state").to_owned())
        .collect();
    assert_eq!(states, ["redeemed", "redeemed", "open"]);
    let ended = host.end();
    assert_eq!(ended.status.code(), Some(130), "{}", stderr(&ended));
    assert!(controllers(&ended).contains(&"network".to_owned()));
}

/// A station that stays, once it is in the session.
fn stays(folder: &Path, ticket: &str) -> Child {
    let mut child = begun(folder, ticket, &["watch", "--seconds", "60"]);
    let mut lines = BufReader::new(child.stderr.take().expect("piped"));
    let (mut line, mut told) = (String::new(), String::new());
    while !line.starts_with("in the session") {
        line.clear();
        assert!(lines.read_line(&mut line).expect("text") > 0, "the station ended: {told}");
        told.push_str(&line);
    }
    child.stderr = Some(lines.into_inner());
    child
}

#[test]
fn a_station_ends_with_its_host_or_as_it_is_sent_away_and_says_which() {
    let folder = here();
    let host = Host::start(folder.path(), &["watch=Bo", "watch=Cy"]);
    let [bo, cy] = [0, 1].map(|k| stays(folder.path(), &host.tickets[k]));
    let revoke = trocar(folder.path(), &["host", "revoke", "Cy", "--tickets", "host.tickets"]);
    assert_eq!(revoke.status.code(), Some(0), "{}", stderr(&revoke));
    let cy = cy.wait_with_output().expect("an end");
    assert_eq!(cy.status.code(), Some(77), "{}", stderr(&cy));
    let text = String::from_utf8_lossy(&cy.stdout).into_owned();
    assert!(text.contains("the host withdrew the ticket"), "{text}");
    host.end();
    let bo = bo.wait_with_output().expect("an end");
    let text = String::from_utf8_lossy(&bo.stdout).into_owned();
    assert_eq!(bo.status.code(), Some(0), "{text}{}", stderr(&bo));
    assert!(text.contains("the host ended the session"), "{text}");
    // Neither was made again in vain.
    assert!(!stderr(&bo).contains("restart") && !stderr(&cy).contains("restart"), "{}", stderr(&bo));
}

#[test]
fn a_ticket_that_is_none_a_port_that_is_taken_and_a_hand_that_is_not_there_are_told() {
    let folder = here();
    let wrong = station(folder.path(), "trocar1nonsense", &["join"]);
    assert_eq!(wrong.status.code(), Some(2), "{}", stderr(&wrong));
    let nobody = trocar(folder.path(), &["host", "ticket", "--port", "1", "--tickets", "nobody.tickets"]);
    let nobody = String::from_utf8_lossy(&nobody.stdout).trim().to_owned();
    let unreached = station(folder.path(), &nobody, &["join"]);
    assert_eq!(unreached.status.code(), Some(69), "{}", stderr(&unreached));
    let host = Host::start(folder.path(), &["operate=Ana"]);
    let unknown = station(folder.path(), &host.tickets[0], &["join", "--hand", "third=virtual"]);
    assert_eq!(unknown.status.code(), Some(2), "{}", stderr(&unknown));
    assert!(stderr(&unknown).contains("valid are left, right"), "{}", stderr(&unknown));
    let second = trocar(folder.path(), &["host", "peg-transfer", "--tickets", "host.tickets", "--port", "0"]);
    assert_eq!(second.status.code(), Some(4), "{}", stderr(&second));
    assert!(stderr(&second).contains("another host runs"), "{}", stderr(&second));
    host.end();
}

#[test]
fn a_ticket_is_in_no_output_of_its_station_and_one_on_the_command_line_is_warned_of() {
    let folder = here();
    let host = Host::start(folder.path(), &["operate=Ana", "watch=Bo"]);
    let files = ["--record", "station.mcap", "--report", "station.html"];
    let join = [&["join", "--hand", "left=virtual", "--seconds", "2"][..], &files].concat();
    let joined = station(folder.path(), &host.tickets[0], &join);
    assert_eq!(joined.status.code(), Some(0), "{}", stderr(&joined));
    let watch = ["watch", host.tickets[1].as_str(), "--seconds", "1", "--headless", "--json"];
    let warned = trocar(folder.path(), &watch);
    assert_eq!(warned.status.code(), Some(0), "{}", stderr(&warned));
    assert!(stderr(&warned).contains("others on this machine can read the ticket"), "{}", stderr(&warned));
    let read = |name: &str| std::fs::read(folder.path().join(name)).expect("a file");
    let mut written = ["station.mcap", "station.html", "host.tickets"].map(read).to_vec();
    let recording = Recording::open(&folder.path().join("station.mcap")).expect("a recording");
    written.extend(recording.bodies().expect("they unpack"));
    let printed = [&joined, &warned].map(|output| [&output.stdout[..], &output.stderr].concat());
    let tickets = host.tickets.clone();
    let ended = host.end();
    for ticket in tickets {
        let parsed: Ticket = ticket.parse().expect("a ticket");
        let token = parsed.token().as_bytes().to_vec();
        let digits: String = token.iter().map(|byte| format!("{byte:02x}")).collect();
        for form in [ticket.as_bytes(), &token, digits.as_bytes()] {
            // The host has printed its tickets, to stderr; what it keeps are hashes.
            for text in written.iter().chain(&printed).chain([&ended.stdout]) {
                assert!(
                    !text.windows(form.len()).any(|part| part == form),
                    "{}",
                    String::from_utf8_lossy(form)
                );
            }
        }
    }
}
