//! `trocar reflect` from outside: a real program, real datagrams, and what it refuses.

use std::io::{BufRead, BufReader};
use std::net::{Ipv4Addr, UdpSocket};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use crate::support::{here, object, stderr, stdout, trocar};

#[test]
fn a_reflector_says_its_port_returns_datagrams_late_and_tells_what_became_of_them() {
    let folder = here();
    std::fs::write(folder.path().join("trace.csv"), "time,delay\n0,0.05\n1,0.05\n").expect("written");
    let mut child = Command::new(env!("CARGO_BIN_EXE_trocar"))
        .args(["reflect", "--port", "0", "--delay", "trace.csv", "--seconds", "3", "--json"])
        .current_dir(folder.path())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut line = String::new();
    BufReader::new(child.stderr.as_mut().expect("piped")).read_line(&mut line).expect("a line");
    let port = line.split("port ").nth(1).and_then(|rest| rest.split_whitespace().next()).expect("a port");
    let port: u16 = port.parse().expect("a number");
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a socket");
    socket.set_read_timeout(Some(Duration::from_secs(20))).expect("a limit");
    let begun = Instant::now();
    let mut bytes = [0; 16];
    for number in 0..3_u8 {
        socket.send_to(&[number], (Ipv4Addr::LOCALHOST, port)).expect("sends");
        let (length, _) = socket.recv_from(&mut bytes).expect("it comes back");
        assert_eq!(bytes[..length], [number]);
    }
    assert!(begun.elapsed() >= Duration::from_millis(150), "three times 50 ms");
    let output = child.wait_with_output().expect("an end");
    assert_eq!(output.status.code(), Some(0), "{}", stderr(&output));
    let told = object(&output);
    assert_eq!((told["port"].as_u64(), told["received"].as_u64()), (Some(u64::from(port)), Some(3)));
    assert_eq!((told["sent"].as_u64(), told["lost"].as_u64()), (Some(3), Some(0)));
}

#[test]
fn a_path_that_cannot_be_is_refused_with_what_is_valid() {
    let folder = here();
    std::fs::write(folder.path().join("bad.csv"), "0.1\nsoon\n").expect("written");
    for (arguments, code, expected) in [
        (&["reflect", "--delay", "61"][..], 2, "0 to 60 seconds"),
        (&["reflect", "--delay", "bad.csv"], 4, "line 2: 'soon'"),
        (&["reflect", "--delay", "nowhere.csv"], 4, "nowhere.csv"),
        (&["reflect", "--loss", "1.5"], 2, "a share from 0 to 1"),
        (&["reflect", "--to", "nobody"], 2, "ADDRESS:PORT is expected"),
    ] {
        let output = trocar(folder.path(), arguments);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {}", stderr(&output));
        assert!(stderr(&output).contains(expected), "{arguments:?}: {}", stderr(&output));
    }
    // The port of the first one is refused to the second, with the way out.
    let taken = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).expect("a socket");
    let port = taken.local_addr().expect("bound").port().to_string();
    let output = trocar(folder.path(), &["reflect", "--port", &port, "--seconds", "1"]);
    assert_eq!(output.status.code(), Some(4), "{}{}", stdout(&output), stderr(&output));
    assert!(stderr(&output).contains(&port) && stderr(&output).contains("--port"), "{}", stderr(&output));
}
