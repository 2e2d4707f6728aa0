//! A host and a station in real time, over sockets of this machine, both in the process of the test.

use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

use tempfile::TempDir;
use trocar::app::App;
use trocar::network::control::Architecture;
use trocar::network::ticket::Role;
use trocar::network::{HostOptions, JoinOptions, Network, NetworkHost, join};
use trocar::run::{self, RunOptions};
use trocar::session::Session;
use trocar_kernel::faults::FaultPlan;
use trocar_scene::{DeviceState, Snapshot, Station};

use super::here;

/// A host of the peg transfer, and the station of Ana, who serves the left hand.
pub struct LivePair {
    pub host: Session,
    pub station: Session,
    _tickets: TempDir,
}

impl LivePair {
    /// With this plan of faults at the host.
    pub fn start(faults: Option<FaultPlan>) -> Self {
        Self::sharing(faults, None)
    }

    /// The same in an architecture, if it is not the scenario's own.
    pub fn sharing(faults: Option<FaultPlan>, architecture: Option<Architecture>) -> Self {
        let tickets = here();
        let options = HostOptions {
            bind: Some(Ipv4Addr::LOCALHOST.into()),
            port: 0,
            book: tickets.path().join("host.tickets"),
            architecture,
            ..HostOptions::default()
        };
        let network = Arc::new(NetworkHost::open(&options).expect("a host"));
        let ticket = network.ticket("Ana", Role::Operate, 3_600, "peg-transfer").expect("a ticket");
        let app = App::new();
        let scenario = app.scenario("peg-transfer").expect("a scenario");
        let hosted = RunOptions { network: Network::Host(network), faults, ..RunOptions::default() };
        let host = run::start(&app, &scenario, &hosted).expect("it starts");

        let hands = vec![("left".to_owned(), "virtual".to_owned())];
        let options =
            JoinOptions { name: Some("Ana".into()), hands: hands.clone(), ..JoinOptions::default() };
        let stop = AtomicBool::new(false);
        let joined = join(app.registry(), &ticket, &options, &stop, &mut |_, _| ()).expect("it is let in");
        let joined = Arc::new(joined);
        let options = RunOptions {
            begin: joined.now(),
            hands,
            network: Network::Station(joined.clone()),
            ..RunOptions::default()
        };
        let station = run::start(&app, &joined.scenario, &options).expect("it starts");
        Self { host, station, _tickets: tickets }
    }

    /// Ana's row at the host.
    pub fn row(&mut self) -> Option<Station> {
        let scene = self.host.snapshot();
        let of_host = |(entity, _): &(trocar_scene::Entity, &Station)| entity.station() == 0;
        scene.iter::<Station>().find(of_host).map(|(_, row)| row.clone())
    }

    /// How far the left hand is from where the other end shows it \[m\].
    pub fn apart(&mut self) -> f64 {
        let at = |session: &mut Session| {
            let scene = session.snapshot();
            let hand = scene.find("hand.left").expect("a left hand");
            scene.get::<DeviceState>(hand).expect("its device").handle_in_device.translation
        };
        (at(&mut self.host) - at(&mut self.station)).norm()
    }

    /// How far the rings are from where the other end has them, the furthest \[m\].
    pub fn rings_apart(&mut self) -> f64 {
        let [host, station] = [&mut self.host, &mut self.station].map(Session::snapshot);
        let at = |scene: &Snapshot, name: &str| {
            scene.world_pose(scene.find(name).expect("a ring")).translation.vector
        };
        let apart =
            (1..=6).map(|k| format!("ring.{k}")).map(|ring| (at(&host, &ring) - at(&station, &ring)).norm());
        apart.fold(0.0, f64::max)
    }

    /// Goes on at both until it is so, at most 20 seconds.
    pub fn wait_until(&mut self, what: &str, mut is_so: impl FnMut(&mut Self) -> bool) {
        let begun = Instant::now();
        while !is_so(self) {
            assert!(begun.elapsed() < Duration::from_secs(20), "{what}: never; {:?}", self.row());
            self.run(Duration::from_millis(20));
        }
    }

    /// Goes on at both for this time, as their programs do: a station follows a pause of its host meanwhile.
    pub fn run(&mut self, span: Duration) {
        let begun = Instant::now();
        while begun.elapsed() < span {
            let until = self.station.now() + Duration::from_millis(10).into();
            self.station.run_until(until);
        }
    }
}
