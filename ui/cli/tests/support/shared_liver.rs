//! Two surgeons at one liver, each of whom computes it.

use std::path::Path;

use trocar::app::App;
use trocar::network::control::Architecture;
use trocar::network::impairments::Impairments;
use trocar_scene::scenario::Scenario;
use trocar_scene::{Measured, Repaired, SimTime, Snapshot, VertexPositions};

use super::pair::Pair;

const STROKES: &str = "
    { seconds = 0.8, to = [-0.060, 0.040, 0.054] },
    { seconds = 2.4, to = [-0.025, 0.040, 0.052] },
    { seconds = 0.6, to = [-0.025, 0.040, 0.078] },
    { seconds = 1.2, to = [-0.060, 0.040, 0.078] },
";
const RETRACTIONS: &str = "
    { seconds = 0.8, to = [0.000, 0.005, 0.070], jaws = 0.7 },
    { seconds = 1.2, to = [0.000, 0.005, 0.035] },
    { seconds = 0.6, jaws = 0.0 },
    { seconds = 1.8, to = [-0.008, 0.020, 0.055] },
    { seconds = 1.0 },
    { seconds = 1.8, to = [0.000, 0.005, 0.040] },
    { seconds = 0.5, jaws = 0.7 },
    { seconds = 0.8, to = [0.000, 0.005, 0.070] },
";
/// How long both take.
const ROUND: SimTime = SimTime::from_millis(8_500);

/// Two surgeons at one liver: the left one presses and strokes, the right one takes its edge and retracts it.
pub fn liver(rounds: usize) -> Scenario {
    let text = include_str!("shared_liver.toml")
        .replace(" # strokes", &STROKES.repeat(2 * rounds))
        .replace(" # retractions", &RETRACTIONS.repeat(rounds));
    Scenario::parse(Path::new("shared-liver.toml"), &text, App::new().registry()).expect("it is valid")
}

/// A path of 150 ms there and back that jitters and loses a fiftieth.
pub fn path() -> Impairments {
    Impairments {
        delay: SimTime::from_millis(75),
        jitter: SimTime::from_millis(3),
        loss: 0.02,
        ..Impairments::default()
    }
}

/// How far the vertices of the liver are apart \[m\].
pub fn apart(a: &Snapshot, b: &Snapshot) -> Vec<f64> {
    let [a, b] = [a, b].map(|scene| {
        let entity = scene.find("liver").expect("it is there");
        scene.get::<VertexPositions>(entity).expect("it has vertices").positions.clone()
    });
    assert_eq!(a.len(), b.len());
    a.iter().zip(b.iter()).map(|(a, b)| (a - b).norm()).collect()
}

/// The value below which this share of all lies; sorts them.
pub fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    values[(share * (values.len() - 1) as f64) as usize]
}

/// How often a body of the scene was repaired.
pub fn repairs(scene: &Snapshot) -> u32 {
    scene.iter::<Repaired>().map(|(_, repaired)| repaired.times).sum()
}

/// A liver under two hands for so many rounds: how far it is apart at both stations, with 95 of 100 vertices and at most.
pub fn pulled_apart(rounds: usize) -> (f64, f64, u32) {
    let mut pair = Pair::sharing(&liver(rounds), &path(), &["left"], false, Architecture::PeerToPeer);
    let end = SimTime(rounds as u64 * ROUND.as_nanos());
    let (mut all, mut pressed) = (Vec::new(), 0.0_f64);
    while pair.now < end {
        pair.step();
        // What both have done while the station joined is over after a second.
        if pair.now >= SimTime::from_millis(1_500) && pair.now.as_nanos().is_multiple_of(50_000_000) {
            let scene = pair.host.snapshot();
            all.extend(apart(&scene, &pair.station.snapshot()));
            let moved = scene
                .iter::<Measured>()
                .filter_map(|(_, measured)| measured.values.get("liver.displacement_max_m").copied());
            pressed = moved.fold(pressed, f64::max);
        }
    }
    assert!(pressed > 0.005, "the liver was pulled: {pressed}");
    let most = quantile(&mut all, 1.0);
    (quantile(&mut all, 0.95), most, repairs(&pair.station.snapshot()))
}
