//! Times steps of our implicit finite elements and of MuJoCo's flexible bodies in turns, block by block, so that whatever
//! slows the machine slows both, and prints one table: a beam that is held at one end swings under its weight.
//!
//! ```text
//! python3 -m venv peers && peers/bin/pip install -r tests/peers/requirements-simulator.txt
//! cargo run --release -p trocar-simulator --example fem_against_peers -- --python peers/bin/python [--blocks 160] [--json]
//! ```
//! Times are of the processor, of one thread each; a ratio is taken within each block, and its median is told. Where the
//! ends are is compared by its mean over the second half of the blocks: what is left of the swinging, which each method
//! damps in its own way, cancels in it.

use std::error::Error;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use nalgebra::{Point3, Vector3};
use serde_json::{Value, json};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::dynamic_fem::{Config, DynamicFem, Inputs};

type Failure = Box<dyn Error>;

const SIZE: [f64; 3] = [0.1, 0.02, 0.02];
const DT: f64 = 1e-3;
/// Steps of a block.
const STEPS: usize = 25;

/// The child process that steps MuJoCo's beam.
struct Peer {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
}

impl Peer {
    fn start(python: &str) -> Result<Self, Failure> {
        let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/peers/simulator_fem.py");
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
            Some(error) => Err(format!("the peer answered: {error}").into()),
            None => Ok(answer),
        }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Time that this thread has had a processor for \[ms\].
fn processor_ms() -> Result<f64, Failure> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanoseconds: f64 = text.split_whitespace().next().ok_or("no scheduler statistics")?.parse()?;
    Ok(nanoseconds * 1e-6)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// Our beam, and what it has cost.
struct Ours {
    body: DynamicFem,
    end: Vec<usize>,
    residual: f64,
    iterations: u32,
    factorisations: u32,
}

impl Ours {
    fn new(cells: [usize; 3]) -> Result<Self, Failure> {
        let (nodes, tets) = box_cells(&BoxCells { cells, size: SIZE.into(), origin: Point3::origin() });
        let mesh = TetMesh::new(&nodes, &tets, &MeshRules::default())?;
        let at = |x: f64| -> Vec<usize> {
            (0..nodes.len()).filter(|&node| (nodes[node].x - x).abs() < 1e-9).collect()
        };
        let wall: Vec<u32> = at(0.0).into_iter().map(|node| node as u32).collect();
        let end = at(SIZE[0]);
        let config = Config { stiffness_damping: 1e-3, ..Config::default() };
        let body = DynamicFem::new(mesh, &Elastic::new(1e5, 0.3)?, &config, &wall)?;
        Ok(Self { body, end, residual: 0.0, iterations: 0, factorisations: 0 })
    }

    /// Time of a step \[ms\].
    fn block(&mut self) -> Result<f64, Failure> {
        let inputs = Inputs { acceleration: Vector3::new(0.0, 0.0, -9.81), ..Inputs::default() };
        let begin = processor_ms()?;
        for _ in 0..STEPS {
            let report = self.body.step(DT, &inputs)?;
            self.residual = self.residual.max(report.residual);
            self.iterations += report.iterations;
            self.factorisations += report.factorisations;
        }
        Ok((processor_ms()? - begin) / STEPS as f64)
    }

    /// Mean deflection of the end \[m\].
    fn tip(&self) -> f64 {
        let (now, rest) = (self.body.positions(), self.body.mesh().rest());
        self.end.iter().map(|&node| rest[node].z - now[node].z).sum::<f64>() / self.end.len() as f64
    }
}

fn compare(peer: &mut Peer, cells: [usize; 3], blocks: usize) -> Result<Value, Failure> {
    let mut ours = Ours::new(cells)?;
    let about = peer.ask(&json!({
        "cells": cells, "size": SIZE, "young": 1e5, "poisson": 0.3, "density": 1000, "damping": 1e-3, "dt": DT,
    }))?;
    let tets = ours.body.mesh().tets().len();
    if about["tets"].as_u64() != Some(tets as u64) {
        return Err(format!("the peer has {} elements, we have {tets}", about["tets"]).into());
    }
    let (mut mine, mut theirs, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
    let mut tips = [0.0, 0.0];
    for block in 0..blocks {
        let own = ours.block()?;
        let answer = peer.ask(&json!({ "steps": STEPS }))?;
        let times: Vec<f64> =
            answer["cpu_ms"].as_array().into_iter().flatten().filter_map(Value::as_f64).collect();
        let other = times.iter().sum::<f64>() / times.len().max(1) as f64;
        mine.push(own);
        theirs.push(other);
        ratios.push(own / other);
        if block >= blocks / 2 {
            tips[0] += ours.tip();
            tips[1] += answer["tip"].as_f64().ok_or("an answer without a tip")?;
        }
    }
    let [here, there] = tips.map(|sum| sum / (blocks - blocks / 2) as f64);
    let steps = (blocks * STEPS) as f64;
    Ok(json!({
        "tets": tets, "mujoco": about["version"], "steps": steps,
        "ours_ms": median(&mut mine), "mujoco_ms": median(&mut theirs), "ratio": median(&mut ratios),
        "tip_apart_share": (here - there).abs() / there, "tip_m": here, "mujoco_tip_m": there, "residual_max": ours.residual,
        "iterations_per_step": f64::from(ours.iterations) / steps, "factorisations": ours.factorisations,
    }))
}

fn main() -> Result<(), Failure> {
    let (mut python, mut blocks, mut as_json) = (None, 160, false);
    let mut arguments = std::env::args().skip(1);
    while let Some(argument) = arguments.next() {
        match argument.as_str() {
            "--python" => python = arguments.next(),
            "--blocks" => blocks = arguments.next().ok_or("--blocks needs a number")?.parse()?,
            "--json" => as_json = true,
            other => return Err(format!("{other}: --python, --blocks and --json are valid").into()),
        }
    }
    let mut peer = Peer::start(&python.ok_or("--python PATH: a Python that has MuJoCo")?)?;
    let mut rows = Vec::new();
    for cells in [[20, 3, 3], [32, 5, 5]] {
        rows.push(compare(&mut peer, cells, blocks.max(1))?);
    }
    if as_json {
        println!("{}", json!({ "fem_against_mujoco": rows }));
        return Ok(());
    }
    println!("| tetrahedra | ours ms | MuJoCo ms | ratio | ends apart | residual | iterations |");
    println!("|---|---|---|---|---|---|---|");
    for row in &rows {
        let number = |key: &str| row[key].as_f64().unwrap_or(f64::NAN);
        println!(
            "| {} | {:.3} | {:.3} | {:.2} | {:.1} % | {:.1e} | {:.1} |",
            row["tets"],
            number("ours_ms"),
            number("mujoco_ms"),
            number("ratio"),
            100.0 * number("tip_apart_share"),
            number("residual_max"),
            number("iterations_per_step"),
        );
    }
    Ok(())
}
