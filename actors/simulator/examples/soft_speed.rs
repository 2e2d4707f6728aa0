//! A position-based beam as a child process that times its steps when asked: the other side of
//! `tests/peers/simulator_xpbd.py`. One JSON object per line in and out; an object with "error" says what was wrong.
//!   {"cells": [20, 7, 3], "edge": 0.005, "young": 1e6, "poisson": 0.3, "density": 1000, "damping": 20, "dt": 5e-3,
//!    "parts": 5, "iterations": 1} -> {"tets": 2520}
//!   {"steps": 40} -> {"ms": processor time of a step, "tip": mean deflection of the end [m]}

use std::io::BufRead;
use std::time::Instant;

use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use serde_json::{Value, json};
use trocar_simulator::xpbd::{Body, Elasticity, Xpbd, XpbdConfig, XpbdInput};

#[derive(Deserialize)]
struct Ask {
    cells: [u32; 3],
    edge: f64,
    young: f64,
    poisson: f64,
    density: f64,
    damping: f64,
    dt: f64,
    parts: u32,
    iterations: u32,
}

struct Beam {
    solver: Xpbd,
    dt: f64,
    rest: Vec<Point3<f64>>,
    end: Vec<usize>,
}

impl Beam {
    fn new(ask: &Ask) -> Result<Self, String> {
        let [nx, ny, nz] = ask.cells;
        let node = |i: u32, j: u32, k: u32| (i * (ny + 1) + j) * (nz + 1) + k;
        let mut rest = Vec::new();
        let mut tets = Vec::new();
        let six = [[0, 4, 6, 7], [0, 6, 2, 7], [0, 2, 3, 7], [0, 3, 1, 7], [0, 1, 5, 7], [0, 5, 4, 7]];
        for i in 0..=nx {
            for j in 0..=ny {
                for k in 0..=nz {
                    rest.push(Point3::new(f64::from(i), f64::from(j), f64::from(k)) * ask.edge);
                    if i < nx && j < ny && k < nz {
                        let corner = |c: u32| node(i + (c >> 2), j + (c >> 1 & 1), k + (c & 1));
                        tets.extend(six.map(|tet: [u32; 4]| tet.map(corner)));
                    }
                }
            }
        }
        let elasticity =
            Elasticity { young_modulus: ask.young, poisson_ratio: ask.poisson, density: ask.density };
        let body = Body { rest: &rest, tets: &tets, elasticity: Some(elasticity), ..Body::default() };
        let clamped: Vec<u32> = (0..(ny + 1) * (nz + 1)).collect();
        let config = XpbdConfig {
            parts: ask.parts,
            iterations: ask.iterations,
            damping: ask.damping,
            ..XpbdConfig::default()
        };
        let solver = Xpbd::new(&body, &clamped, config).map_err(|error| error.to_string())?;
        let end = (node(nx, 0, 0) as usize..rest.len()).collect();
        Ok(Self { solver, dt: ask.dt, rest, end })
    }

    fn steps(&mut self, count: u32) -> Result<Value, String> {
        let input = XpbdInput { gravity: Vector3::new(0.0, 0.0, -9.81), ..XpbdInput::default() };
        let (begun, on_processor) = (Instant::now(), processor_time());
        for _ in 0..count {
            self.solver.step(self.dt, &input).map_err(|error| error.to_string())?;
        }
        let wall = begun.elapsed().as_secs_f64();
        let spent = match (on_processor, processor_time()) {
            (Some(before), Some(after)) => after - before,
            _ => wall,
        };
        let positions = &self.solver.state().positions;
        let sunk = self.end.iter().map(|&node| self.rest[node].z - positions[node].z).sum::<f64>();
        Ok(json!({ "ms": 1e3 * spent / f64::from(count), "tip": sunk / self.end.len() as f64 }))
    }
}

/// What this thread has had of the processor \[s\], where the system tells.
fn processor_time() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    Some(text.split_whitespace().next()?.parse::<f64>().ok()? * 1e-9)
}

fn answer(line: &str, beam: &mut Option<Beam>) -> Result<Value, String> {
    let request: Value = serde_json::from_str(line).map_err(|error| error.to_string())?;
    if let Some(steps) = request.get("steps") {
        let steps = steps.as_u64().and_then(|steps| u32::try_from(steps).ok()).ok_or("steps is no number")?;
        return beam.as_mut().ok_or("no beam yet")?.steps(steps.max(1));
    }
    let ask: Ask = serde_json::from_value(request).map_err(|error| error.to_string())?;
    let made = Beam::new(&ask)?;
    let tets = made.solver.tets();
    *beam = Some(made);
    Ok(json!({ "tets": tets }))
}

fn main() {
    let mut beam = None;
    for line in std::io::stdin().lock().lines().map_while(Result::ok) {
        let told = answer(&line, &mut beam).unwrap_or_else(|error| json!({ "error": error }));
        println!("{told}");
    }
}
