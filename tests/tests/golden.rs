//! Every scenario in lock-step gives the digests in `tests/golden.toml`.
//!
//! `TROCAR_GOLDEN=record cargo test --release -p trocar-tests golden` measures the rows anew and writes the file.
//! Commit such a change alone, with the reason.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use trocar::app::{App, SCENARIOS};
use trocar::run::{RunOptions, start};
use trocar_tests::golden::{Golden, GoldenRun, LOOK_EVERY, MotionDigest, arithmetic, by_run};
use trocar_tests::{app, edited, lockstep};

/// The recorded runs: scenario, seed, seconds. Each is long enough for the purpose of its scene.
const RUNS: [(&str, u64, f64); 19] = [
    ("peg-transfer", 1, 12.0),
    ("peg-transfer", 2, 12.0),
    ("peg-transfer", 3, 12.0),
    ("wall", 1, 3.0),
    ("collision-gallery", 1, 3.0),
    ("cautery", 1, 3.0),
    ("instruments", 1, 4.0),
    ("bleeding", 1, 2.5),
    ("cloth-cut", 1, 5.0),
    ("fem-liver", 1, 3.0),
    ("knot", 1, 2.0),
    ("needle-tissue", 1, 4.0),
    ("soft-stomach", 1, 3.0),
    ("tube-loop", 1, 3.0),
    ("omentum", 1, 2.0),
    ("band", 1, 2.0),
    ("two-rates", 1, 3.0),
    ("tele-liver", 1, 2.0),
    ("tele-palpation", 1, 2.0),
];

fn file() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden.toml")
}

fn known() -> Golden {
    let text = std::fs::read_to_string(file()).expect("tests/golden.toml");
    toml::from_str(&text).expect("rows of runs")
}

fn measure(app: &App, scenario: &str, seed: u64, seconds: f64, arithmetic: &str) -> GoldenRun {
    let options = RunOptions { seconds: Some(seconds), ..lockstep(seed) };
    let mut session = start(app, &edited(app, scenario, &[]), &options).expect("the session starts");
    let mut motion = MotionDigest::default();
    motion.look(&session.snapshot());
    let mut next = LOOK_EVERY;
    while session.run_until(next) {
        motion.look(&session.snapshot());
        next += LOOK_EVERY;
    }
    motion.look(&session.snapshot());
    let state = session.finish().outcome.hash.to_string()[..32].to_owned();
    let (scenario, arithmetic) = (scenario.to_owned(), arithmetic.to_owned());
    GoldenRun { scenario, seed, seconds, arithmetic, state, motion: motion.finish() }
}

/// Applies `work` to all of them on two threads; results in order.
fn on_two_threads<T: Sync, R: Send>(all: &[T], work: impl Fn(&T) -> R + Sync) -> Vec<R> {
    let (next, results) = (AtomicUsize::new(0), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                while let Some(item) = all.get(next.fetch_add(1, Ordering::Relaxed)).map(|item| (item, ())) {
                    let result = work(item.0);
                    results.lock().expect("no run panics").push(result);
                }
            });
        }
    });
    results.into_inner().expect("no run panics")
}

fn record(arithmetic: &str) {
    let app = app();
    let mut rows = on_two_threads(&RUNS, |(scenario, seed, seconds)| {
        measure(&app, scenario, *seed, *seconds, arithmetic)
    });
    // Rows of other arithmetics are kept; rows equal on all of them are stored once.
    let before = if file().exists() { known().run } else { Vec::new() };
    let is_run = |row: &GoldenRun| {
        RUNS.iter().any(|(scenario, seed, seconds)| {
            *scenario == row.scenario && *seed == row.seed && *seconds == row.seconds
        })
    };
    rows.extend(
        before
            .into_iter()
            .filter(|row| is_run(row) && row.arithmetic != arithmetic && row.arithmetic != "any"),
    );
    let place =
        |row: &GoldenRun| RUNS.iter().position(|(name, seed, _)| *name == row.scenario && *seed == row.seed);
    rows.sort_by(|a, b| (place(a), &a.arithmetic).cmp(&(place(b), &b.arithmetic)));
    let head = "# What each scenario does in lock-step, for the code of today: written by\n\
                #   TROCAR_GOLDEN=record cargo test --release -p trocar-tests golden\n\
                # `state` is the session's own hash, `motion` the digest of poses, vertices and the exercise (tests/src/golden.rs).\n\
                # Moving or renaming code changes no `motion`; a change of it stands alone in its commit, with the reason.\n\n";
    let text = toml::to_string(&Golden { run: rows }).expect("rows are plain data");
    std::fs::write(file(), format!("{head}{text}")).expect("tests/golden.toml is writable");
}

#[test]
fn every_scenario_gives_the_bits_that_it_gave() {
    let arithmetic = arithmetic();
    if std::env::var("TROCAR_GOLDEN").is_ok_and(|value| value == "record") {
        record(&arithmetic);
    }
    let golden = known();
    let sorted = by_run(&golden.run);
    for (name, _) in SCENARIOS {
        assert!(sorted.keys().any(|(scenario, _)| scenario == name), "no row for the scenario '{name}'");
    }
    let holds_here = |row: &&&GoldenRun| row.arithmetic == arithmetic || row.arithmetic == "any";
    let rows: Vec<&GoldenRun> =
        sorted.values().filter_map(|rows| rows.iter().find(holds_here).copied()).collect();
    if rows.len() < sorted.len() {
        println!(
            "this processor computes like none on record ({arithmetic}): {} of {} runs are compared; \
             TROCAR_GOLDEN=record adds its rows",
            rows.len(),
            sorted.len()
        );
    }
    assert!(!rows.is_empty(), "no row holds for this arithmetic, {arithmetic}");
    let app = app();
    let wrong: Vec<String> = on_two_threads(&rows, |row| {
        let found = measure(&app, &row.scenario, row.seed, row.seconds, &row.arithmetic);
        let (scenario, seed) = (&row.scenario, row.seed);
        if found.motion != row.motion {
            Some(format!(
                "{scenario}, seed {seed}: it moves otherwise: {} instead of {}",
                found.motion, row.motion
            ))
        } else if found.state != row.state {
            Some(format!(
                "{scenario}, seed {seed}: same motion, other state: {} instead of {}",
                found.state, row.state
            ))
        } else {
            None
        }
    })
    .into_iter()
    .flatten()
    .collect();
    assert!(wrong.is_empty(), "{} of {} runs changed:\n  {}", wrong.len(), rows.len(), wrong.join("\n  "));
}

#[test]
fn the_digest_of_motion_tells_other_seeds_and_other_times_apart() {
    let app = app();
    let digest = |seed, seconds| measure(&app, "peg-transfer", seed, seconds, "any");
    let [one, same, other, longer] = [digest(1, 1.0), digest(1, 1.0), digest(2, 1.0), digest(1, 1.1)];
    assert_eq!((&one.motion, &one.state), (&same.motion, &same.state));
    assert_ne!(one.motion, other.motion, "another seed");
    assert_ne!(one.motion, longer.motion, "another time");
}
