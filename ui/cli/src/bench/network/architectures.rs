//! The three architectures of a session beside each other, in virtual time over one path; and a thin client beside its server.

use std::sync::Arc;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use trocar::app::App;
use trocar::network::control::Architecture;
use trocar::network::impairments::Impairments;
use trocar::network::lockstep::Wire;
use trocar::network::ticket::Role;
use trocar::network::{JoinOptions, Joining, LockstepHost, Network};
use trocar::run::{self, RunOptions};
use trocar::session::Session;
use trocar::summary::{BenchResult, Better};
use trocar_scene::{DeviceState, Hand, Pose, SimTime, Snapshot};

use super::Rows;
use crate::failure::Failure;

/// A hand at the station, and one at the host.
const HANDS: [&str; 2] = ["left", "right"];
/// From when on is measured, and how long.
const SETTLED: SimTime = SimTime::from_millis(1_500);
const SPAN_MS: usize = 8_000;
/// Longest delay that is looked for \[ms\].
const LAG_MAX: usize = 400;
/// Speeds are over so long \[ms\]: rows of a scene come 60 times a second.
const SPEED_MS: usize = 34;
/// Bar on the time that a thin client computes, over that of its server.
const THIN_BAR: f64 = 0.5;

/// A host and a station that joined it.
struct Pair {
    host: Session,
    station: Session,
    wire: Wire,
    now: SimTime,
    /// Time that each has computed.
    spent: [Duration; 2],
}

impl Pair {
    fn new(scenario: &str, hand: &str, architecture: Architecture) -> Result<Self, Failure> {
        let app = App::new();
        let path = Impairments {
            loss: 0.02,
            jitter: SimTime::from_millis(3),
            ..Impairments::delay(SimTime::from_millis(75))
        };
        let network = Arc::new(LockstepHost::new()?.with_architecture(architecture));
        let ticket = network.ticket("Ana", Role::Operate)?;
        let wire = Wire::new(&path, 7);
        let number = network.wires().add(wire.clone());
        let options =
            RunOptions { lockstep: true, network: Network::LockstepHost(network), ..RunOptions::default() };
        let mut host = run::start(&app, &app.scenario(scenario)?, &options)?;
        let hands = vec![(hand.to_owned(), "virtual".to_owned())];
        let join = JoinOptions { hands: hands.clone(), ..JoinOptions::default() };
        let mut now = SimTime::ZERO;
        let mut joining = Joining::over(app.registry(), &join, &ticket, &wire, number, now)?;
        while !joining.step(now)? {
            now += SimTime::from_millis(4);
            host.run_until(now);
            if now > SimTime::from_millis(10_000) {
                return Err(Failure::internal("the station does not join in virtual time"));
            }
        }
        let lost = || Failure::internal("the station has joined no session");
        let station = Arc::new(joining.joined(&wire, number).ok_or_else(lost)?);
        let options = RunOptions {
            lockstep: true,
            begin: now,
            hands,
            network: Network::Station(station.clone()),
            ..RunOptions::default()
        };
        let station = run::start(&app, &station.scenario, &options)?;
        Ok(Self { host, station, wire, now, spent: [Duration::ZERO; 2] })
    }

    /// A millisecond at both.
    fn step(&mut self) {
        self.now += SimTime::from_millis(1);
        for (session, spent) in [&mut self.host, &mut self.station].into_iter().zip(&mut self.spent) {
            let begun = Instant::now();
            session.run_until(self.now);
            *spent += begun.elapsed();
        }
    }

    fn bytes(&self) -> [u64; 2] {
        self.wire.bytes().map(|of| of.iter().sum())
    }
}

/// Where a hand's device is, or where its instrument is \[m\].
fn place(scene: &Snapshot, hand: &str, is_device: bool) -> Vector3<f64> {
    let Some(hand) = scene.find(&format!("hand.{hand}")) else { return Vector3::zeros() };
    if is_device {
        let state = scene.get::<DeviceState>(hand);
        return state.map_or_else(Vector3::zeros, |state| state.handle_in_device.translation);
    }
    let instrument = scene.get::<Hand>(hand).map(|hand| hand.instrument);
    instrument.and_then(|tool| scene.get::<Pose>(tool)).map_or_else(Vector3::zeros, |pose| pose.translation)
}

/// By how many milliseconds what is shown follows what is there: where a line through the speeds of both fits best, since a
/// port turns and scales a motion.
fn lag(there: &[Vector3<f64>], shown: &[Vector3<f64>]) -> f64 {
    let speeds = |places: &[Vector3<f64>]| -> Vec<f64> {
        places.windows(SPEED_MS).map(|places| (places[SPEED_MS - 1] - places[0]).norm()).collect()
    };
    let (there, shown) = (speeds(there), speeds(shown));
    let fit = |lag: usize| {
        let pairs: Vec<(f64, f64)> = there.iter().copied().zip(shown[lag..].iter().copied()).collect();
        let mean = |of: fn(&(f64, f64)) -> f64| pairs.iter().map(of).sum::<f64>() / pairs.len() as f64;
        let (a, b) = (mean(|pair| pair.0), mean(|pair| pair.1));
        let (mut both, mut of_a, mut of_b) = (0.0, 0.0, 0.0);
        for (x, y) in pairs {
            (both, of_a, of_b) = (both + (x - a) * (y - b), of_a + (x - a).powi(2), of_b + (y - b).powi(2));
        }
        both * both / (of_a * of_b).max(f64::MIN_POSITIVE)
    };
    (0..LAG_MAX).max_by(|a, b| fit(*a).total_cmp(&fit(*b))).unwrap_or(0) as f64
}

/// How late instruments follow their hands at a station, and the bytes to it and from it.
pub fn architectures() -> Rows {
    let mut rows = Vec::new();
    for architecture in Architecture::ALL {
        let mut pair = Pair::new("peg-transfer", HANDS[0], architecture)?;
        while pair.now < SETTLED {
            pair.step();
        }
        let before = pair.bytes();
        let mut seen: [Vec<Vector3<f64>>; 4] = Default::default();
        for _ in 0..SPAN_MS {
            pair.step();
            let (host, station) = (pair.host.snapshot(), pair.station.snapshot());
            seen[0].push(place(&station, HANDS[0], true));
            seen[1].push(place(&station, HANDS[0], false));
            seen[2].push(place(&host, HANDS[1], true));
            seen[3].push(place(&station, HANDS[1], false));
        }
        let after = pair.bytes();
        let per_sec = |end: usize| (after[end] - before[end]) as f64 / (SPAN_MS as f64 * 1e-3);
        let word = architecture.word().replace('-', "_");
        let mut row = |what: &str, unit: &str, value: f64| {
            let name = format!("network_{word}_{what}");
            rows.push(BenchResult::on_value(name, unit, (value, 0.0), None, Better::Lower));
        };
        row("own_instrument", "ms", lag(&seen[0], &seen[1]));
        row("other_instrument", "ms", lag(&seen[2], &seen[3]));
        row("bytes_to_station", "B/s", per_sec(0));
        row("bytes_from_station", "B/s", per_sec(1));
    }
    Ok(rows)
}

/// What a laptop without a simulator computes while it shows and feels a liver, over what its server computes.
pub fn thin_client() -> Rows {
    let mut pair = Pair::new("fem-liver", "right", Architecture::ClientServer)?;
    while pair.now < SETTLED {
        pair.step();
    }
    pair.spent = [Duration::ZERO; 2];
    for _ in 0..SPAN_MS {
        pair.step();
    }
    let [host, station] = pair.spent.map(|spent| spent.as_secs_f64() / (SPAN_MS as f64 * 1e-3));
    let (value, bar) = ((station, 0.0), Some(THIN_BAR));
    Ok(vec![BenchResult::on_ratio("network_thin_client", "s/s", value, host, bar, Better::Lower)])
}
