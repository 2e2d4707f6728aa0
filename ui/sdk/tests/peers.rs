//! A session among peers: each computes the scene for itself, by the same hands at the same time.

use std::path::Path;
use std::sync::Arc;

use trocar::app::App;
use trocar::network::control::Architecture;
use trocar::network::impairments::Impairments;
use trocar::network::lockstep::Wire;
use trocar::network::ticket::Role;
use trocar::network::{JoinOptions, Joining, LockstepHost, Network};
use trocar::run::{self, RunOptions};
use trocar::session::Session;
use trocar_scene::scenario::Scenario;
use trocar_scene::{SimTime, Snapshot, VertexPositions};

const STROKES: &str = "
    { seconds = 0.8, to = [-0.060, 0.040, 0.054] },
    { seconds = 2.4, to = [-0.025, 0.040, 0.052] },
    { seconds = 0.6, to = [-0.025, 0.040, 0.078] },
    { seconds = 1.2, to = [-0.060, 0.040, 0.078] },
";
const RETRACTIONS: &str = "
    { seconds = 0.8, to = [0.000, 0.002, 0.070], jaws = 0.7 },
    { seconds = 1.2, to = [0.000, 0.002, 0.037] },
    { seconds = 0.6, jaws = 0.0 },
    { seconds = 1.8, to = [-0.008, 0.020, 0.055] },
    { seconds = 1.0 },
    { seconds = 1.8, to = [0.000, 0.002, 0.040] },
    { seconds = 0.5, jaws = 0.7 },
    { seconds = 0.8, to = [0.000, 0.002, 0.070] },
";

fn liver(times: usize) -> Scenario {
    let text = include_str!("peers/liver.toml")
        .replace(" # strokes", &STROKES.repeat(2 * times))
        .replace(" # retractions", &RETRACTIONS.repeat(times));
    Scenario::parse(Path::new("shared-liver.toml"), &text, App::new().registry()).expect("it is valid")
}

struct Pair {
    host: Session,
    station: Session,
    wire: Wire,
    now: SimTime,
}

impl Pair {
    fn new(scenario: &Scenario, path: &Impairments, hands: &[&str], architecture: Architecture) -> Self {
        let app = App::new();
        let network = Arc::new(LockstepHost::new().expect("a host").with_architecture(architecture));
        let ticket = network.ticket("Ana", Role::Operate).expect("a ticket");
        let wire = Wire::new(path, 7);
        let number = network.wires().add(wire.clone());
        let options =
            RunOptions { lockstep: true, network: Network::LockstepHost(network), ..RunOptions::default() };
        let mut host = run::start(&app, scenario, &options).expect("it starts");
        let hands: Vec<(String, String)> =
            hands.iter().map(|hand| ((*hand).to_owned(), "virtual".to_owned())).collect();
        let join = JoinOptions { name: Some("Ana".into()), hands: hands.clone(), ..JoinOptions::default() };
        let mut now = SimTime::ZERO;
        let mut joining =
            Joining::over(app.registry(), &join, &ticket, &wire, number, now).expect("it can join");
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
        Self { host, station, wire, now }
    }

    fn step(&mut self) -> bool {
        self.now += SimTime::from_millis(1);
        let goes_on = self.host.run_until(self.now);
        self.station.run_until(self.now);
        goes_on
    }
}

/// How far the vertices of a body are apart \[m\].
fn apart(a: &Snapshot, b: &Snapshot, body: &str) -> Vec<f64> {
    let [a, b] = [a, b].map(|scene| {
        let entity = scene.find(body).expect("it is there");
        scene.get::<VertexPositions>(entity).expect("it has vertices").positions.clone()
    });
    assert_eq!(a.len(), b.len());
    a.iter().zip(b.iter()).map(|(a, b)| (a - b).norm()).collect()
}

#[test]
fn look() {
    let path = Impairments { delay: SimTime::from_millis(75), loss: 0.02, ..Impairments::default() };
    let architecture = match std::env::var("ARCH").as_deref() {
        Ok("cs") => Architecture::ClientServer,
        _ => Architecture::PeerToPeer,
    };
    let mut pair = Pair::new(&liver(2), &path, &["left"], architecture);
    let mut all = Vec::new();
    let mut far = Vec::new();
    while pair.now < SimTime::from_millis(17_000) && pair.step() {
        if pair.now.as_nanos() % 100_000_000 == 0 {
            let (a, b) = (pair.host.snapshot(), pair.station.snapshot());
            let now = apart(&a, &b, "liver");
            let most = now.iter().copied().fold(0.0, f64::max);
            all.extend(now);
            far.push(most);
            if pair.now.as_nanos() % 500_000_000 == 0 {
                let at = |scene: &Snapshot, name: &str| {
                    scene.world_pose(scene.find(name).expect("there")).translation.vector
                };
                println!(
                    "{:?} most {:.3} mm, left {:?} {:?} right {:?}",
                    pair.now,
                    most * 1e3,
                    at(&a, "grasper.left").as_slice(),
                    (at(&a, "grasper.left") - at(&b, "grasper.left")).norm() * 1e3,
                    (at(&a, "grasper.right") - at(&b, "grasper.right")).norm() * 1e3
                );
            }
        }
    }
    for list in [&mut all, &mut far] {
        list.sort_by(f64::total_cmp);
        let of = |share: f64| list[(share * (list.len() - 1) as f64) as usize] * 1e3;
        println!("p50 {:.4} p95 {:.4} p99 {:.4} most {:.4} mm", of(0.5), of(0.95), of(0.99), of(1.0));
    }
    let sent = pair.wire.clone();
    let _ = sent;
}

fn place(scene: &Snapshot, name: &str) -> trocar_scene::Pose {
    *scene.get::<trocar_scene::Pose>(scene.find(name).expect("it is there")).expect("it has a place")
}

#[test]
fn a_ring_that_lies_elsewhere_at_a_peer_is_put_where_its_owner_has_it() {
    let path = Impairments { delay: SimTime::from_millis(75), loss: 0.02, ..Impairments::default() };
    let scenario = App::new().scenario("peg-transfer").expect("a scenario");
    let mut pair = Pair::new(&scenario, &path, &["left"], Architecture::PeerToPeer);
    while pair.now < SimTime::from_millis(2_000) {
        pair.step();
    }
    let far = |pair: &mut Pair| {
        let (a, b) = (place(&pair.host.snapshot(), "ring.6"), place(&pair.station.snapshot(), "ring.6"));
        (a.translation - b.translation).norm()
    };
    println!("before {:.6}", far(&mut pair));
    let ring = pair.station.snapshot().find("ring.6").expect("it is there");
    let mut elsewhere = place(&pair.station.snapshot(), "ring.6");
    elsewhere.translation.x += 0.03;
    elsewhere.translation.z += 0.02;
    pair.station.apply(|commands| commands.put(ring, elsewhere)).expect("an operator may");
    for _ in 0..40 {
        for _ in 0..100 {
            pair.step();
        }
        let times = pair.station.snapshot().get::<trocar_scene::Repaired>(ring).map_or(0, |it| it.times);
        let now = pair.now;
        println!("{now:?} {:.6} {times}", far(&mut pair));
    }
}
