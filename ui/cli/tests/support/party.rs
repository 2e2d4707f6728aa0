//! A host and several stations that joined it, in one process and in virtual time.

use std::sync::Arc;

use trocar::app::App;
use trocar::network::impairments::Impairments;
use trocar::network::lockstep::Wire;
use trocar::network::ticket::Role;
use trocar::network::{JoinOptions, Joining, LockstepHost, Network};
use trocar::run::{self, RunOptions};
use trocar::session::Session;
use trocar_scene::SimTime;

/// A station that joins.
pub struct Guest<'a> {
    pub name: &'a str,
    pub role: Role,
    /// Hands with virtual devices, which its person moves.
    pub hands: &'a [&'a str],
}

/// A host, and the stations in the order in which they joined.
pub struct Party {
    pub host: Session,
    pub stations: Vec<Session>,
    pub wires: Vec<Wire>,
    pub now: SimTime,
}

impl Party {
    pub fn new(scenario: &str, path: &Impairments, guests: &[Guest<'_>]) -> Self {
        let app = App::new();
        let scenario = app.scenario(scenario).expect("a scenario");
        let network = Arc::new(LockstepHost::new().expect("a host"));
        // Tickets and wires are there before the session begins.
        let entries: Vec<_> = guests
            .iter()
            .zip(7_u64..)
            .map(|(guest, seed)| {
                let wire = Wire::new(path, seed);
                let number = network.wires().add(wire.clone());
                (network.ticket(guest.name, guest.role).expect("a ticket"), wire, number)
            })
            .collect();
        let options =
            RunOptions { lockstep: true, network: Network::LockstepHost(network), ..RunOptions::default() };
        let host = run::start(&app, &scenario, &options).expect("it starts");
        let mut party = Self { host, stations: Vec::new(), wires: Vec::new(), now: SimTime::ZERO };
        for (guest, (ticket, wire, number)) in guests.iter().zip(entries) {
            let hands: Vec<_> =
                guest.hands.iter().map(|hand| ((*hand).to_owned(), "virtual".to_owned())).collect();
            let play = !hands.is_empty();
            let name = Some(guest.name.to_owned());
            let join = JoinOptions { name, hands: hands.clone(), play, ..JoinOptions::default() };
            let mut joining =
                Joining::over(app.registry(), &join, &ticket, &wire, number, party.now).expect("it can join");
            while !joining.step(party.now).expect("it is let in") {
                party.run(4);
                assert!(party.now < SimTime::from_millis(20_000), "{:?}", joining.progress());
            }
            let station = Arc::new(joining.joined(&wire, number).expect("it is in the session"));
            let options = RunOptions {
                lockstep: true,
                begin: party.now,
                hands,
                play,
                network: Network::Station(station.clone()),
                ..RunOptions::default()
            };
            party.stations.push(run::start(&app, &station.scenario, &options).expect("it starts"));
            party.wires.push(wire);
        }
        party
    }

    /// A millisecond at all of them.
    pub fn step(&mut self) {
        self.now += SimTime::from_millis(1);
        self.host.run_until(self.now);
        self.stations.iter_mut().for_each(|station| {
            station.run_until(self.now);
        });
    }

    pub fn run(&mut self, millis: u64) {
        (0..millis).for_each(|_| self.step());
    }
}
