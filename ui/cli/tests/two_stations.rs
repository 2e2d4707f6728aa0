//! Sessions of a host and its stations in virtual time.

use std::sync::Arc;

use trocar::app::App;
use trocar::network::impairments::Impairments;
use trocar::network::lockstep::Wire;
use trocar::network::ticket::Role;
use trocar::network::{JoinOptions, Joining, LockstepHost, Network};
use trocar::run::{self, RunOptions};
use trocar::session::Session;
use trocar_scene::{Name, Pose, SimTime, Snapshot, Station as StationRow};

const MS: SimTime = SimTime::from_millis(1);

/// A host, and a station that joined it.
struct Pair {
    host: Session,
    station: Session,
    now: SimTime,
}

impl Pair {
    fn new(scenario: &str, path: &Impairments, hands: &[&str]) -> Self {
        let app = App::new();
        let scenario = app.scenario(scenario).expect("a scenario");
        let network = Arc::new(LockstepHost::new().expect("a host"));
        let ticket = network.ticket("Ana", Role::Operate).expect("a ticket");
        let wire = Wire::new(path, 7);
        let number = network.wires().add(wire.clone());
        let options =
            RunOptions { lockstep: true, network: Network::LockstepHost(network), ..RunOptions::default() };
        let mut host = run::start(&app, &scenario, &options).expect("it starts");
        let hands: Vec<_> = hands.iter().map(|hand| ((*hand).to_owned(), "virtual".to_owned())).collect();
        let join = JoinOptions { name: Some("Ana".into()), hands: hands.clone(), ..JoinOptions::default() };
        let mut now = SimTime::ZERO;
        let mut joining = Joining::over(&app, &join, &ticket, &wire, number, now).expect("it can join");
        while !joining.step(now).expect("it is let in") {
            now += SimTime::from_millis(4);
            assert!(host.run_until(now), "the host goes on");
            assert!(now < SimTime::from_millis(10_000), "{:?} {:?}", joining.progress(), joining.trouble());
        }
        let station = Arc::new(joining.joined(&wire, number).expect("it is in the session"));
        let options = RunOptions {
            lockstep: true,
            begin: now,
            hands,
            network: Network::Station(station.clone()),
            ..RunOptions::default()
        };
        let station = run::start(&app, &station.scenario, &options).expect("it starts");
        Self { host, station, now }
    }

    fn step(&mut self) -> bool {
        self.now += MS;
        let goes_on = self.host.run_until(self.now);
        self.station.run_until(self.now);
        goes_on
    }

    fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.step();
        }
    }
}

fn place(scene: &Snapshot, name: &str) -> Pose {
    let entity = scene.find(name).expect("it is there");
    *scene.get::<Pose>(entity).expect("it has a place")
}

#[test]
fn a_station_has_the_hosts_scene_and_follows_it() {
    let path = Impairments { loss: 0.02, ..Impairments::delay(SimTime::from_millis(75)) };
    let mut pair = Pair::new("peg-transfer", &path, &["left"]);
    pair.run(3_000);
    let (host, station) = (pair.host.snapshot(), pair.station.snapshot());
    let named = |scene: &Snapshot| scene.iter::<Name>().filter(|(entity, _)| entity.station() == 0).count();
    assert_eq!(named(&host), named(&station));
    for name in ["ring.1", "ring.6", "board.left", "grasper.right"] {
        let (here, there) = (place(&host, name), place(&station, name));
        // 0.3 m/s over 100 ms.
        assert!((here.translation - there.translation).norm() < 0.03, "{name}");
    }
    let rows: Vec<&StationRow> = host.iter::<StationRow>().map(|(_, row)| row).collect();
    assert_eq!((rows.len(), rows[0].name.as_str(), rows[0].here), (1, "Ana", true));
    assert_eq!(rows[0].hands, ["left"]);
    let own = station.iter::<StationRow>().find(|(entity, _)| entity.station() == 1).expect("its own row").1;
    assert!(own.here && (0.149..0.17).contains(&own.link.round_trip), "{own:?}");
}

#[test]
fn the_left_hand_at_a_station_and_the_right_one_at_the_host_transfer_the_pegs() {
    let path = Impairments {
        loss: 0.02,
        jitter: SimTime::from_millis(5),
        ..Impairments::delay(SimTime::from_millis(75))
    };
    let mut pair = Pair::new("peg-transfer", &path, &["left"]);
    while pair.step() && pair.now < SimTime::from_millis(300_000) {}
    let task = pair.host.task();
    assert!(task.completed, "{task:?} at {}", pair.now);
}
