//! The peg transfer with eight seeds, on all cores at once: `cargo run --release -p trocar --example parallel`.
//!
//! Sessions share nothing that changes, so each gives the bits that it gives alone.

use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Instant;

use trocar::prelude::*;

const SEEDS: u64 = 8;

struct Attempt {
    seed: u64,
    completed: bool,
    score: f64,
    seconds: f64,
    errors: usize,
    hash: String,
}

/// One attempt at the exercise, from start to end.
fn attempt(seed: u64) -> Result<Attempt, OpenError> {
    let mut session = Session::builder().seed(seed).open("peg-transfer")?;
    while session.step(SimTime::from_millis(100)) {}
    let task = session.task();
    Ok(Attempt {
        seed,
        completed: task.completed,
        score: task.score.unwrap_or(0.0),
        seconds: task.seconds,
        errors: task.errors.len(),
        hash: session.hash().map_or_else(String::new, |hash| hash.to_string()),
    })
}

fn main() -> Result<(), OpenError> {
    let cores = thread::available_parallelism().map_or(1, usize::from);
    let begun = Instant::now();
    let (next, attempts) = (AtomicU64::new(1), Mutex::new(Vec::new()));
    thread::scope(|scope| {
        for _ in 0..cores {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, Ordering::Relaxed);
                    if seed > SEEDS {
                        break;
                    }
                    let attempt = attempt(seed);
                    attempts.lock().expect("no thread panics").push(attempt);
                }
            });
        }
    });
    let attempts: Result<Vec<Attempt>, OpenError> =
        attempts.into_inner().expect("no thread panics").into_iter().collect();
    let mut attempts = attempts?;
    attempts.sort_by_key(|attempt| attempt.seed);
    println!("seed  completed  score  seconds  errors  state hash");
    for attempt in &attempts {
        let Attempt { seed, completed, score, seconds, errors, hash } = attempt;
        println!("{seed:4}  {completed:9}  {score:5.1}  {seconds:7.1}  {errors:6}  {}…", &hash[..12]);
    }
    let simulated: f64 = attempts.iter().map(|attempt| attempt.seconds).sum();
    let wall = begun.elapsed().as_secs_f64();
    println!(
        "{simulated:.0} s of exercise in {wall:.1} s on {cores} cores: {:.0} × real time",
        simulated / wall
    );
    Ok(())
}
