//! Addresses that do not lead to a host, each for its own reason, and one that does.

use std::io;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicBool, Ordering};

use super::reach::{Reached, Step, reach_with};
use super::tls_testing::{Clock, Host, Nobody, place};
use crate::ticket::{Fingerprint, HostAddress, HostPlace};

/// Knows one name, which is the loopback's.
fn resolver(place: &HostPlace, port: u16) -> io::Result<Vec<SocketAddr>> {
    match place {
        HostPlace::Name(name) if name == "host.example" => Ok(vec![SocketAddr::from(([127, 0, 0, 1], port))]),
        _ => Err(io::Error::other("no such name")),
    }
}

/// Tries the addresses while the host works.
fn tried(host: &mut Host, addresses: &[HostAddress], fingerprint: Fingerprint) -> Vec<Reached> {
    let (clock, is_done) = (Clock::new(), AtomicBool::new(false));
    std::thread::scope(|scope| {
        let trying = scope.spawn(|| {
            let reached = reach_with(addresses, fingerprint, resolver).expect("it knows TLS 1.3");
            is_done.store(true, Ordering::Release);
            reached
        });
        clock.wait("an end", |now| {
            host.work(now);
            is_done.load(Ordering::Acquire).then_some(())
        });
        trying.join().expect("it does not panic")
    })
}

fn name(text: &str, port: u16) -> HostAddress {
    format!("{text}:{port}").parse().expect("an address")
}

#[test]
fn each_address_is_told_with_the_step_at_which_it_ended() {
    let (mut host, nobody) = (Host::new(), Nobody::new());
    let port = host.address.port();
    let addresses = [
        name("nowhere.example", port),
        place(&nobody.address),
        name("host.example", port),
        place(&host.address),
    ];
    let fingerprint = host.identity.fingerprint();
    let reached = tried(&mut host, &addresses, fingerprint);
    let steps: Vec<Option<Step>> =
        reached.iter().map(|reached| reached.trouble.as_ref().map(|(step, _)| *step)).collect();
    assert_eq!(steps, [Some(Step::Name), Some(Step::Connection), None, None]);
    let troubles: Vec<&str> =
        reached.iter().filter_map(|reached| reached.trouble.as_ref().map(|(_, why)| why.as_str())).collect();
    assert!(troubles[0].contains("no such name") && troubles[1].contains("nobody listens"), "{troubles:?}");
    for reached in &reached[2..] {
        assert_eq!(reached.host.map(|(socket, _)| socket), Some(host.address), "{}", reached.address);
    }
}

#[test]
fn another_certificate_is_told_apart_from_another_protocol() {
    let mut host = Host::new();
    let addresses = [place(&host.address)];
    let reached = tried(&mut host, &addresses, Fingerprint::from_bytes([7; 32]));
    assert!(matches!(&reached[0].trouble, Some((Step::Certificate, _))), "{reached:?}");
    // Somebody else's server, which closes what it does not understand.
    let other = std::net::TcpListener::bind(("127.0.0.1", 0)).expect("some port is free");
    let address = other.local_addr().expect("it is bound");
    let serving = std::thread::spawn(move || {
        use std::io::Write;
        let (mut stream, _) = other.accept().expect("somebody comes");
        // Who does not read it is told by the closed stream.
        let _ = stream.write_all(b"220 mail.example ready\r\n");
    });
    let reached = tried(&mut host, &[place(&address)], Fingerprint::from_bytes([7; 32]));
    serving.join().expect("it served");
    assert!(matches!(&reached[0].trouble, Some((Step::Protocol, _))), "{reached:?}");
}
