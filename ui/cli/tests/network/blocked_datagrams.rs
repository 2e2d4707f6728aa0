//! A host that only TCP reaches, as behind many firewalls: sessions in real time over sockets of this machine.

use std::io;
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use trocar::app::App;
use trocar::network::ticket::{HostAddress, Role};
use trocar::network::{HostOptions, JoinOptions, Network, NetworkHost, join};
use trocar::run::{self, RunOptions};
use trocar::session::Session;
use trocar_scene::{DeviceState, SimTime, Station};

use crate::support::here;

/// Passes TCP on to a port of this machine. Nobody listens for datagrams at its own.
fn firewall(listener: TcpListener, to: u16) {
    let copy = |mut from: TcpStream, mut to: TcpStream| {
        std::thread::spawn(move || {
            // An end on either side ends both.
            let _ = io::copy(&mut from, &mut to);
            let _ = to.shutdown(std::net::Shutdown::Both);
        });
    };
    std::thread::spawn(move || {
        for taken in listener.incoming() {
            let Ok(taken) = taken else { continue };
            let Ok(onward) = TcpStream::connect((Ipv4Addr::LOCALHOST, to)) else { continue };
            let _ = (taken.set_nodelay(true), onward.set_nodelay(true));
            if let (Ok(from), Ok(back)) = (taken.try_clone(), onward.try_clone()) {
                copy(from, onward);
                copy(back, taken);
            }
        }
    });
}

/// Waits until it is so, at most 20 seconds.
fn wait_until(what: &str, mut is_so: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !is_so() {
        assert!(begun.elapsed() < Duration::from_secs(20), "{what}: never");
        std::thread::sleep(Duration::from_millis(20));
    }
}

fn own_row(session: &mut Session, station: u16) -> Option<Station> {
    let scene = session.snapshot();
    let own = |(entity, _): &(trocar_scene::Entity, &Station)| entity.station() == station;
    scene.iter::<Station>().find(own).map(|(_, row)| row.clone())
}

fn hand_x(session: &mut Session) -> f64 {
    let scene = session.snapshot();
    let hand = scene.find("hand.left").expect("a left hand");
    scene.get::<DeviceState>(hand).expect("its device").handle_in_device.translation.x
}

#[test]
fn a_station_that_only_tcp_reaches_moves_its_hand_and_says_over_tcp() {
    let folder = here();
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port");
    let address: SocketAddr = listener.local_addr().expect("bound");
    let options = HostOptions {
        bind: Some(Ipv4Addr::LOCALHOST.into()),
        port: 0,
        addresses: vec![HostAddress::of_socket(address).expect("an address")],
        book: folder.path().join("host.tickets"),
        ..HostOptions::default()
    };
    let network = Arc::new(NetworkHost::open(&options).expect("a host"));
    firewall(listener, network.port());
    let ticket = network.ticket("Ana", Role::Operate, 3_600, "peg-transfer").expect("a ticket");
    let app = App::new();
    let scenario = app.scenario("peg-transfer").expect("a scenario");
    let hosted = RunOptions { network: Network::Host(network), ..RunOptions::default() };
    let mut host = run::start(&app, &scenario, &hosted).expect("it starts");

    let hands = vec![("left".to_owned(), "virtual".to_owned())];
    let options = JoinOptions { name: Some("Ana".into()), hands: hands.clone(), ..JoinOptions::default() };
    let stop = AtomicBool::new(false);
    let station =
        Arc::new(join(app.registry(), &ticket, &options, &stop, &mut |_, _| ()).expect("it is let in"));
    let joined = RunOptions {
        begin: station.now(),
        hands,
        network: Network::Station(station.clone()),
        ..RunOptions::default()
    };
    let mut own = run::start(&app, &station.scenario, &joined).expect("it starts");

    wait_until("the station says that its link is over TCP", || {
        own_row(&mut own, station.number).is_some_and(|row| row.link.over_tcp && row.link.rate > 50.0)
    });
    wait_until("the host says so", || {
        own_row(&mut host, 0).is_some_and(|row| row.here && row.link.over_tcp && row.link.rate > 50.0)
    });
    // The trainee's wishes go to the station, whose hand follows them, and the host's instrument follows the hand.
    let before = hand_x(&mut host);
    wait_until("the host's instrument has moved", || (hand_x(&mut host) - before).abs() > 0.01);
    let row = own_row(&mut host, 0).expect("it is there");
    assert_eq!((row.name.as_str(), &row.hands[..]), ("Ana", &["left".to_owned()][..]));
    assert!(row.protected && row.link.loss == 0.0, "{row:?}");
    // What is shown is old by the steps of both ends and little more: no queue.
    wait_until("what the host shows is new", || {
        own_row(&mut host, 0).is_some_and(|row| row.link.over_tcp && row.link.age < 0.1)
    });
    assert!(own.now() > SimTime::ZERO);
    own.finish();
    host.finish();
}
