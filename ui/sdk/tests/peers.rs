//! The three architectures of a session over a network, with the same scenario and the same path: a host computes the scene,
//! peers compute it each for itself, or a host computes it and all hands go to all stations.

use std::path::Path;

use tempfile::TempDir;
use trocar::app::App;
use trocar::network::control::Architecture;
use trocar::network::impairments::Impairments;
use trocar_scene::scenario::Scenario;
use trocar_scene::{DeviceState, Hand, Pose, Repaired, SimTime, Snapshot, TaskState, VertexPositions};

use self::pair::Pair;

#[expect(dead_code, reason = "the program's tests use the rest of it")]
#[path = "../../cli/tests/support/pair.rs"]
mod pair;

/// A folder for what a session records.
fn here() -> TempDir {
    tempfile::tempdir().expect("a folder")
}

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
/// How long both take.
const ROUND: SimTime = SimTime::from_millis(8_500);

/// Two surgeons at one liver: the left one presses and strokes, the right one takes its edge and retracts it.
fn liver(rounds: usize) -> Scenario {
    let text = include_str!("peers/liver.toml")
        .replace(" # strokes", &STROKES.repeat(2 * rounds))
        .replace(" # retractions", &RETRACTIONS.repeat(rounds));
    Scenario::parse(Path::new("shared-liver.toml"), &text, App::new().registry()).expect("it is valid")
}

/// A path of 150 ms there and back that jitters and loses a fiftieth.
fn path() -> Impairments {
    Impairments {
        delay: SimTime::from_millis(75),
        jitter: SimTime::from_millis(5),
        loss: 0.02,
        ..Impairments::default()
    }
}

/// How far the vertices of the liver are apart \[m\].
fn apart(pair: &mut Pair) -> Vec<f64> {
    let [a, b] = [pair.host.snapshot(), pair.station.snapshot()].map(|scene| {
        let entity = scene.find("liver").expect("it is there");
        scene.get::<VertexPositions>(entity).expect("it has vertices").positions.clone()
    });
    assert_eq!(a.len(), b.len());
    a.iter().zip(b.iter()).map(|(a, b)| (a - b).norm()).collect()
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(share * (values.len() - 1) as f64) as usize]
}

fn repairs(scene: &Snapshot) -> u32 {
    scene.iter::<Repaired>().map(|(_, repaired)| repaired.times).sum()
}

/// A liver under two hands for so many rounds: how far it is apart at both stations, with 95 of 100 vertices and at most.
fn pulled_apart(rounds: usize) -> (f64, f64, u32) {
    let mut pair = Pair::sharing(&liver(rounds), &path(), &["left"], false, Architecture::PeerToPeer);
    let end = SimTime(rounds as u64 * ROUND.as_nanos());
    let (mut all, mut pressed) = (Vec::new(), 0.0_f64);
    while pair.now < end {
        pair.step();
        // What both have done while the station joined is over after a second.
        if pair.now >= SimTime::from_millis(1_500) && pair.now.as_nanos() % 50_000_000 == 0 {
            all.extend(apart(&mut pair));
            let scene = pair.host.snapshot();
            let moved = scene
                .iter::<trocar_scene::Measured>()
                .filter_map(|(_, measured)| measured.values.get("liver.displacement_max_m").copied());
            pressed = moved.fold(pressed, f64::max);
        }
    }
    assert!(pressed > 0.005, "the liver was pulled: {pressed}");
    let most = quantile(&mut all, 1.0);
    (quantile(&mut all, 0.95), most, repairs(&pair.station.snapshot()))
}

#[test]
fn a_liver_under_two_hands_is_the_same_at_two_peers_that_each_compute_it() {
    let (p95, most, repairs) = pulled_apart(2);
    println!("apart: {:.4} mm (95 %), {:.3} mm at most, {repairs} repairs", p95 * 1e3, most * 1e3);
    assert!(p95 <= 1e-4 && most <= 4e-3, "{p95} {most}");
    assert_eq!(repairs, 0);
}

#[test]
fn a_ring_that_lies_elsewhere_at_a_peer_is_put_where_its_owner_has_it() {
    let scenario = App::new().scenario("peg-transfer").expect("a scenario");
    let mut pair = Pair::sharing(&scenario, &path(), &["left"], false, Architecture::PeerToPeer);
    pair.run(2_000);
    let far = |pair: &mut Pair| {
        let [a, b] =
            [pair.host.snapshot(), pair.station.snapshot()].map(|scene| pair::place(&scene, "ring.6"));
        (a.translation - b.translation).norm()
    };
    assert!(far(&mut pair) < 1e-6);
    let ring = pair.station.snapshot().find("ring.6").expect("it is there");
    let mut elsewhere = pair::place(&pair.station.snapshot(), "ring.6");
    (elsewhere.translation.x, elsewhere.translation.z) =
        (elsewhere.translation.x + 0.03, elsewhere.translation.z + 0.02);
    pair.station.apply(|commands| commands.put(ring, elsewhere)).expect("an operator may");
    pair.run(200);
    assert!(far(&mut pair) > 0.01, "it lies where it has fallen");
    pair.run(3_000);
    assert!(far(&mut pair) < 1e-4, "{}", far(&mut pair));
    assert_eq!(repairs(&pair.station.snapshot()), 1);
}

/// Where a hand's device is along x, and where its instrument is shown; both begin at 0.
fn along_x(scene: &Snapshot, hand: &str, is_device: bool) -> f64 {
    let hand = scene.find(hand).expect("it is there");
    if is_device {
        return scene.get::<DeviceState>(hand).map_or(0.0, |state| state.handle_in_device.translation.x);
    }
    let instrument = scene.get::<Hand>(hand).expect("a hand").instrument;
    scene.get::<Pose>(instrument).expect("it has a place").translation.x
}

/// By how many milliseconds what is shown follows what is there: where their difference varies least.
fn lag(there: &[f64], shown: &[f64]) -> usize {
    let misfit = |lag: usize| {
        let pairs = there.iter().zip(&shown[lag..]).map(|(there, shown)| shown - there);
        let (count, sum, squares) =
            pairs.fold((0.0, 0.0, 0.0), |(n, sum, squares), x| (n + 1.0, sum + x, squares + x * x));
        squares / count - (sum / count) * (sum / count)
    };
    (0..400).min_by(|a, b| misfit(*a).total_cmp(&misfit(*b))).expect("there are some")
}

/// What a session of an architecture measures: milliseconds by which the station's own instrument and that of the host follow
/// their hands at the station, and bytes a second to the station and from it.
struct Figures {
    own: usize,
    other: usize,
    down: f64,
    up: f64,
}

fn figures(architecture: Architecture) -> Figures {
    let mut pair = Pair::sharing(&liver(2), &path(), &["left"], false, architecture);
    pair.run(1_000);
    let before = pair.wire.bytes();
    let (mut left, mut right) = ((Vec::new(), Vec::new()), (Vec::new(), Vec::new()));
    let begin = pair.now;
    while pair.now < SimTime::from_millis(16_000) {
        pair.step();
        let (host, station) = (pair.host.snapshot(), pair.station.snapshot());
        left.0.push(along_x(&station, "hand.left", true));
        left.1.push(along_x(&station, "hand.left", false));
        right.0.push(along_x(&host, "hand.right", true));
        right.1.push(along_x(&station, "hand.right", false));
    }
    let secs = pair.now.since(begin).as_secs_f64();
    let after = pair.wire.bytes();
    let bytes = |end: usize| (0..2).map(|of| after[end][of] - before[end][of]).sum::<u64>() as f64 / secs;
    Figures { own: lag(&left.0, &left.1), other: lag(&right.0, &right.1), down: bytes(0), up: bytes(1) }
}

#[test]
fn each_architecture_has_its_own_delays_and_its_own_bytes() {
    let [server, peers, hybrid] = Architecture::ALL.map(|architecture| {
        let figures = figures(architecture);
        let Figures { own, other, down, up } = figures;
        println!(
            "{:14} own {own:4} ms, other {other:4} ms, down {:.1} kB/s, up {:.1} kB/s",
            architecture.word(),
            down * 1e-3,
            up * 1e-3
        );
        figures
    });
    // A server's scene has made the round trip; peers all wait for the same time; a hand that comes directly takes one way.
    assert!((150..220).contains(&server.own) && (75..140).contains(&server.other));
    assert!((98..104).contains(&peers.own) && (98..104).contains(&peers.other));
    assert!(hybrid.own <= 4 && (70..90).contains(&hybrid.other));
    assert!(peers.down < 0.5 * server.down, "{} {}", peers.down, server.down);
}

#[test]
fn the_same_pegs_are_placed_in_all_three_architectures_and_in_the_same_time() {
    let scenario = App::new().scenario("peg-transfer").expect("a scenario");
    let times = Architecture::ALL.map(|architecture| {
        let mut pair = Pair::sharing(&scenario, &path(), &["left"], false, architecture);
        while pair.step() {
            assert!(pair.now < SimTime::from_millis(400_000), "it does not end");
        }
        let scene = pair.host.snapshot();
        let (_, state) = scene.iter::<TaskState>().next().expect("a task");
        println!("{:14} {:?} {state:?}", architecture.word(), pair.now);
        assert!(state.completed && state.errors.is_empty(), "{state:?}");
        pair.now.as_secs_f64()
    });
    let mean = times.iter().sum::<f64>() / 3.0;
    assert!(times.iter().all(|time| (time / mean - 1.0).abs() <= 0.05), "{times:?}");
}
