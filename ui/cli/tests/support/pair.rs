//! A host and a station that joined it, in one process and in virtual time.

use std::path::PathBuf;
use std::sync::Arc;

use tempfile::TempDir;
use trocar::app::App;
use trocar::network::control::Architecture;
use trocar::network::impairments::Impairments;
use trocar::network::lockstep::{End, Wire};
use trocar::network::ticket::Role;
use trocar::network::{JoinOptions, Joining, LockstepHost, Network};
use trocar::run::{self, Resumed, RunOptions};
use trocar::session::Session;
use trocar_kernel::faults::{FaultKind, FaultOrder};
use trocar_scene::scenario::Scenario;
use trocar_scene::{Pose, SimTime, Snapshot};

use super::here;

const MS: SimTime = SimTime::from_millis(1);

/// A host, and a station that joined it.
pub struct Pair {
    pub host: Session,
    pub station: Session,
    /// What lies between them.
    pub wire: Wire,
    pub now: SimTime,
    /// What lets the station in and back: the token of its ticket, and its resume secret.
    pub secrets: [Vec<u8>; 2],
    /// How far a host that was killed is behind.
    lag: SimTime,
    scenario: Scenario,
    network: Arc<LockstepHost>,
    recording: TempDir,
}

impl Pair {
    /// A station with these hands (`name` or `name=device`), which follow the session's virtual trainee.
    pub fn new(scenario: &str, path: &Impairments, hands: &[&str]) -> Self {
        Self::of(&named(scenario), path, hands, false)
    }

    /// A station whose hands a person moves.
    pub fn played(scenario: &str, path: &Impairments, hands: &[&str]) -> Self {
        Self::of(&named(scenario), path, hands, true)
    }

    /// A host of this scenario and a station with these hands, which a person moves or the virtual trainee.
    pub fn of(scenario: &Scenario, path: &Impairments, hands: &[&str], play: bool) -> Self {
        Self::sharing(scenario, path, hands, play, Architecture::ClientServer)
    }

    /// The same in an architecture.
    pub fn sharing(
        scenario: &Scenario,
        path: &Impairments,
        hands: &[&str],
        play: bool,
        architecture: Architecture,
    ) -> Self {
        Self::lucky(scenario, path, hands, play, architecture, 7)
    }

    /// The same with another luck of the path.
    pub fn lucky(
        scenario: &Scenario,
        path: &Impairments,
        hands: &[&str],
        play: bool,
        architecture: Architecture,
        seed: u64,
    ) -> Self {
        let app = App::new();
        let network = Arc::new(LockstepHost::new().expect("a host").with_architecture(architecture));
        let ticket = network.ticket("Ana", Role::Operate).expect("a ticket");
        let wire = Wire::new(path, seed);
        let number = network.wires().add(wire.clone());
        let recording = here();
        let options = RunOptions {
            lockstep: true,
            record: Some(recording.path().join("host-1.mcap")),
            network: Network::LockstepHost(network.clone()),
            ..RunOptions::default()
        };
        let mut host = run::start(&app, scenario, &options).expect("it starts");
        let hands: Vec<_> = hands.iter().map(|hand| hand_and_device(hand)).collect();
        let join =
            JoinOptions { name: Some("Ana".into()), hands: hands.clone(), play, ..JoinOptions::default() };
        let mut now = SimTime::ZERO;
        let mut joining =
            Joining::over(app.registry(), &join, &ticket, &wire, number, now).expect("it can join");
        while !joining.step(now).expect("it is let in") {
            now += SimTime::from_millis(4);
            assert!(host.run_until(now), "the host goes on");
            assert!(now < SimTime::from_millis(10_000), "{:?} {:?}", joining.progress(), joining.trouble());
        }
        let station = Arc::new(joining.joined(&wire, number).expect("it is in the session"));
        let secrets = [ticket.token().as_bytes().to_vec(), station.resume.as_bytes().to_vec()];
        let options = RunOptions {
            lockstep: true,
            begin: now,
            hands,
            play,
            network: Network::Station(station.clone()),
            ..RunOptions::default()
        };
        let station = run::start(&app, &station.scenario, &options).expect("it starts");
        let lag = SimTime::ZERO;
        Self { host, station, wire, now, secrets, lag, scenario: scenario.clone(), network, recording }
    }

    /// The host's recording as it is on the disk.
    pub fn recording(&self) -> PathBuf {
        self.recording.path().join("host-1.mcap")
    }

    /// A millisecond at both; whether the host goes on.
    pub fn step(&mut self) -> bool {
        self.now += MS;
        let goes_on = self.host.run_until(SimTime(self.now.as_nanos() - self.lag.as_nanos()));
        self.station.run_until(self.now);
        goes_on
    }

    /// The host's program is killed, and another one goes on from its recording.
    pub fn kill_host(&mut self) {
        let of = |name: &str| self.recording.path().join(name);
        // What is on the disk now is what a killed program leaves.
        std::fs::copy(of("host-1.mcap"), of("killed.mcap")).expect("a recording");
        self.wire.disconnect();
        let app = App::new();
        let resumed = Resumed::read(app.registry(), &of("killed.mcap")).expect("it can go on");
        assert!(self.now.since(resumed.time()) <= SimTime::from_millis(1_100), "a second is lost at most");
        let options = RunOptions {
            lockstep: true,
            resume: Some(resumed),
            network: Network::LockstepHost(self.network.clone()),
            ..RunOptions::default()
        };
        self.host = run::start(&app, &self.scenario, &options).expect("it goes on");
        self.lag = self.now.since(self.host.now());
        // Its session clock has lost that time; the path has not grown longer by it.
        self.wire.set_behind(End::Host, self.lag);
    }

    /// The same, and the new one has caught up with the time when its station tries to come back.
    pub fn restart_host(&mut self) {
        self.kill_host();
        self.wire.set_behind(End::Host, SimTime::ZERO);
        assert!(self.host.run_until(self.now), "it goes on");
        self.lag = SimTime::ZERO;
    }

    /// The path between them is gone, or there again.
    pub fn partition(&self, begins: bool) {
        let lossy = Impairments { loss: 1.0, ..Impairments::default() };
        for order in lossy.orders(1) {
            self.wire.fault(&FaultOrder { kind: FaultKind::Partition, index: 9, begins, ..order });
        }
    }

    pub fn run(&mut self, millis: u64) {
        for _ in 0..millis {
            self.step();
        }
    }
}

/// Where an entity is.
pub fn place(scene: &Snapshot, name: &str) -> Pose {
    let entity = scene.find(name).expect("it is there");
    *scene.get::<Pose>(entity).expect("it has a place")
}

fn hand_and_device(text: &str) -> (String, String) {
    let (hand, device) = text.split_once('=').unwrap_or((text, "virtual"));
    (hand.to_owned(), device.to_owned())
}

fn named(scenario: &str) -> Scenario {
    App::new().scenario(scenario).expect("a scenario")
}
