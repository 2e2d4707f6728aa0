//! Times our queries and those of coal and FCL in turns, block by block, so that whatever slows the machine slows all
//! of them, and prints one table. One thread each; of every pose the least time of all rounds counts.
//!
//! ```text
//! python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements.txt
//! cargo run --release -p trocar-collision --example against_peers -- --python peers/bin/python [--rounds 5] [--json]
//! ```
//! Without `--python` only our own times are printed.

use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::time::Instant;

use nalgebra::Isometry3;
use serde_json::{Value, json};
use trocar_collision::Surface;
use trocar_collision::obb_tree::{ObbTree, TreeQuery};

#[path = "../tests/support/mod.rs"]
mod support;

const QUERIES: [&str; 3] = ["first", "all", "distance"];
/// Answers in a row of which one time is taken: the clock itself takes as long as a short query.
const REPEATS: usize = 3;

type Failure = Box<dyn Error>;

/// The child process that answers for the peers.
struct Peers {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Peers {
    fn start(python: &str) -> Result<Self, Failure> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/collision.py");
        let mut child = Command::new(python)
            .arg(script)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| format!("{python} does not start: {error}"))?;
        let requests = child.stdin.take().ok_or("the child has no input")?;
        let answers = BufReader::new(child.stdout.take().ok_or("the child has no output")?);
        Ok(Self { child, requests, answers })
    }

    fn ask(&mut self, request: &Value) -> Result<Value, Failure> {
        writeln!(self.requests, "{request}")?;
        let mut line = String::new();
        self.answers.read_line(&mut line)?;
        let answer: Value = serde_json::from_str(&line)?;
        match answer.get("error") {
            Some(error) => Err(format!("the peers answered: {error}").into()),
            None => Ok(answer),
        }
    }

    fn times(&mut self, peer: &str, query: &str, repeats: usize) -> Result<Vec<f64>, Failure> {
        let answer = self.ask(&json!({"peer": peer, "query": query, "repeats": repeats}))?;
        let times = answer["us"].as_array().ok_or("an answer without times")?;
        Ok(times.iter().filter_map(Value::as_f64).collect())
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn microseconds(mut work: impl FnMut()) -> f64 {
    let start = Instant::now();
    work();
    start.elapsed().as_secs_f64() * 1e6
}

/// Our time of each pose \[µs\].
fn ours(query: &str, tree: &ObbTree, poses: &[Isometry3<f64>], room: &mut TreeQuery) -> Vec<f64> {
    let mut ask = |pose: &Isometry3<f64>| match query {
        "first" => usize::from(room.first_contact(tree, tree, pose, None).is_some()),
        "all" => room.all_contacts(tree, tree, pose).len(),
        _ => usize::from(room.distance(tree, tree, pose, None).is_some_and(|near| near.distance > 0.0)),
    };
    poses
        .iter()
        .map(|pose| {
            let mut least = f64::INFINITY;
            for _ in 0..REPEATS {
                least = least.min(microseconds(|| {
                    std::hint::black_box(ask(std::hint::black_box(pose)));
                }));
            }
            least
        })
        .collect()
}

fn keep_least(kept: &mut Vec<f64>, times: Vec<f64>) {
    if kept.is_empty() {
        *kept = times;
    } else {
        for (kept, time) in kept.iter_mut().zip(times) {
            *kept = kept.min(time);
        }
    }
}

fn mean_and_p99(times: &[f64]) -> (f64, f64) {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let p99 = sorted[((sorted.len() * 99).div_ceil(100)).saturating_sub(1)];
    (times.iter().sum::<f64>() / times.len() as f64, p99)
}

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let (mut python, mut rounds, mut as_json) = (None, 5_usize, false);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--python" => python = Some(arguments.next().ok_or("--python needs a path")?),
            "--rounds" => {
                rounds = arguments.next().ok_or("--rounds needs a number")?.parse::<usize>()?.max(1)
            }
            "--json" => as_json = true,
            other => return Err(format!("{other} is none of --python, --rounds, --json").into()),
        }
    }
    let mut peers = python.as_deref().map(Peers::start).transpose()?;
    let poses = support::poses();
    let mut names: Vec<String> = Vec::new();
    let mut rows = Vec::new();
    for size in ["1k", "10k"] {
        let mesh = support::mesh(size);
        let surface = Surface::new(&mesh.vertices, &mesh.triangles)?;
        let mut tree = ObbTree::build(&surface);
        let mut room = TreeQuery::new();
        if let Some(peers) = &mut peers {
            let path = support::data(&format!("bumpy_{size}.obj"));
            let answer = peers.ask(&json!({"mesh": path}))?;
            names =
                answer["peers"].as_object().map(|peers| peers.keys().cloned().collect()).unwrap_or_default();
            peers.ask(&json!({"poses": support::data("poses.csv")}))?;
        }
        for query in QUERIES.into_iter().chain(["build"]) {
            let mut our_times = Vec::new();
            let mut their_times = vec![Vec::new(); names.len()];
            for _ in 0..rounds {
                let times = match query {
                    "build" => vec![microseconds(|| tree = ObbTree::build(&surface))],
                    _ => ours(query, &tree, &poses, &mut room),
                };
                keep_least(&mut our_times, times);
                if let Some(peers) = &mut peers {
                    for (kept, name) in their_times.iter_mut().zip(&names) {
                        keep_least(kept, peers.times(name, query, REPEATS)?);
                    }
                }
            }
            rows.push((size, mesh.triangles.len(), query, our_times, their_times));
        }
        let mut refit = Vec::new();
        for _ in 0..rounds * 20 {
            keep_least(
                &mut refit,
                vec![microseconds(|| tree.refit(&mesh.vertices).expect("the same vertices"))],
            );
        }
        rows.push((size, mesh.triangles.len(), "refit", refit, Vec::new()));
    }
    let mut results = Vec::new();
    if !as_json {
        println!("µs, mean / p99 over the poses; ratio: ours over the better of the peers\n");
        print!("{:>9} {:<9} {:>19}", "triangles", "query", "ours");
        names.iter().for_each(|name| print!(" {name:>19}"));
        println!(" {:>6} {:>6}", "mean", "p99");
    }
    for (_, triangles, query, our_times, their_times) in &rows {
        let our = mean_and_p99(our_times);
        let their: Vec<_> = their_times.iter().map(|times| mean_and_p99(times)).collect();
        let better = |of: fn(&(f64, f64)) -> f64| their.iter().map(of).reduce(f64::min);
        let (mean, p99) = (better(|t| t.0).map(|t| our.0 / t), better(|t| t.1).map(|t| our.1 / t));
        if as_json {
            let peers: serde_json::Map<String, Value> = names
                .iter()
                .zip(&their)
                .map(|(name, t)| (name.clone(), json!({"mean_us": t.0, "p99_us": t.1})))
                .collect();
            results.push(json!({
                "triangles": triangles, "query": query, "mean_us": our.0, "p99_us": our.1,
                "peers": peers, "ratio_mean": mean, "ratio_p99": p99,
            }));
        } else {
            let shown = |t: &(f64, f64)| format!("{:.1} / {:.1}", t.0, t.1);
            print!("{triangles:>9} {query:<9} {:>19}", shown(&our));
            their.iter().for_each(|t| print!(" {:>19}", shown(t)));
            let ratio = |r: Option<f64>| r.map_or(String::new(), |r| format!("{r:.2}"));
            println!(" {:>6} {:>6}", ratio(mean), ratio(p99));
        }
    }
    if as_json {
        println!("{}", json!({"rounds": rounds, "poses": poses.len(), "results": results}));
    }
    Ok(())
}
