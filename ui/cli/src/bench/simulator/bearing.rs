//! Rigid bodies that lie on soft ones, live: what a step takes of its period.

use std::fmt::Write as _;

use trocar::app::App;
use trocar::prelude::*;
use trocar::summary::{BenchResult, Better};

use crate::failure::Failure;

/// Length of a run \[s\]: the bodies lie still in most of it.
const SECS: f64 = 4.0;

const HEAD: &str = r#"schema = 1
title = "What bears"
description = "Rigid bodies on soft ones"
gravity = [0.0, 0.0, -9.81]
[task]
seconds = 1000.0
expect = [{ measure = "ball.0.z_m", min = -1.0, max = 1.0 }]
[[controller]]
name = "engine"
kind = "rapier"
rate_hz = 500
[[controller]]
name = "judge"
kind = "outcome"
rate_hz = 100
"#;

/// A hundred balls of 5 g on a slab of finite elements, 200 × 200 × 30 mm.
fn slab() -> String {
    let mut text = format!(
        r#"name = "slab"
{HEAD}
[[controller]]
name = "soft"
kind = "dynamic-fem"
rate_hz = 60
[[entity]]
name = "slab"
mesh = {{ block = {{ size = [0.2, 0.2, 0.03], cells = [16, 16, 2] }} }}
dynamic_fem = {{ young_modulus = 8000.0, poisson_ratio = 0.45, density = 1000.0 }}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0149] }} }}] }}
"#
    );
    for index in 0..100 {
        let [x, y] = [index % 10, index / 10].map(|at| 0.018 * (f64::from(at) - 4.5));
        let _ = write!(
            text,
            r#"[[entity]]
name = "ball.{index}"
pose = {{ translation = [{x}, {y}, 0.0211] }}
mesh = {{ shape = {{ sphere = {{ radius = 0.006 }} }}, segments = 12 }}
rigid_body = {{ motion = "dynamic", mass = 0.005, friction = 0.3 }}
"#
        );
    }
    text
}

/// A weight of 20 g in a sling of silk, which touches it at ten places or more.
fn sling() -> String {
    let arc: Vec<String> = (0..=12)
        .map(|k| std::f64::consts::PI * (1.0 + f64::from(k) / 12.0))
        .map(|angle| format!("[{}, 0.0, {}]", 0.0058 * angle.cos(), 0.0058 * angle.sin()))
        .collect();
    format!(
        r#"name = "sling"
{HEAD}
[[controller]]
name = "soft"
kind = "thread"
rate_hz = 500
[[entity]]
name = "ball.0"
pose = {{ translation = [0.0, 0.0, 0.0], rotation = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476] }}
shape = {{ capsule = {{ radius = 0.005, half_height = 0.012 }} }}
rigid_body = {{ motion = "dynamic", mass = 0.02, friction = 0.2 }}
[[entity]]
name = "thread"
mesh = {{ line = {{ length = 0.10, segments = 20, radius = 0.00025 }} }}
anchors = {{ regions = [{{ ball = {{ center = [-0.0058, 0.0, 0.03], radius = 0.002 }} }}, {{ ball = {{ center = [0.0058, 0.0, 0.03], radius = 0.002 }} }}] }}
[entity.thread]
suture = "silk2"
edges = [2.0, 1e-3]
[entity.thread.laid.through]
places = [[-0.0058, 0.0, 0.03], {}, [0.0058, 0.0, 0.03]]
"#,
        arc.join(", ")
    )
}

/// Steps of a slab under a hundred bodies and of a sling, against their periods.
pub fn bearing() -> Result<Vec<BenchResult>, Failure> {
    let app = App::new();
    let options = RunOptions { seconds: Some(SECS), ..RunOptions::default() };
    let row = |name: &str, text: String| -> Result<BenchResult, Failure> {
        let scenario = app.scenario_from(format!("{name}.toml").as_ref(), &text)?;
        let outcome = trocar::run::run(&app, &scenario, &options, &mut |_| {})?;
        let row = outcome.reports.iter().find(|row| row.name == "soft");
        let row = row.ok_or_else(|| Failure::internal(format!("{name}: its solver did not run")))?;
        let share = (row.step_us.p50 * 1e-6 * row.target_hz, 0.0);
        Ok(BenchResult::on_value(format!("simulator_{name}"), "share", share, Some(1.0), Better::Lower))
    };
    Ok(vec![row("bearing_100_on_slab", slab())?, row("bearing_sling", sling())?])
}
