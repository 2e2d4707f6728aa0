//! Detectors as controllers of a live session with two hands: their achieved rates on organs in contact, rigid and
//! soft, beside bare timer loops of the same run.

use std::f64::consts::TAU;
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Isometry3, Point3};
use serde::Deserialize;
use trocar::app::App;
use trocar::prelude::*;
use trocar::summary::{BenchResult, Better};
use trocar_collision::Surface;
use trocar_collision::obb_tree::{ObbTree, TreeQuery};
use trocar_kernel::bench::{bare_rates, median_and_spread};

use super::meshes::Mesh;
use crate::failure::Failure;

/// Length of a block \[s\], and number of blocks of each scene.
const BLOCK_SECS: f64 = 3.0;
const BLOCKS: usize = 3;
/// A detector is scheduled at this multiple of its required rate, so that the achieved rate shows the margin.
const ABOVE: f64 = 1.05;
/// Mean penetration of the organs, and its amplitude \[m\].
const DEEP: f64 = 0.0008;
const SWAY: f64 = 0.0004;

/// Two organs and the detector that watches them.
struct Scene {
    name: &'static str,
    kind: &'static str,
    /// Triangles of each organ.
    triangles: usize,
    /// Rates at which their vertices are written \[Hz\]; `None` for a rigid organ.
    waves: [Option<f64>; 2],
    /// Rate at which a rigid organ moves \[Hz\].
    moves_hz: f64,
    /// Required rate of the detector \[Hz\].
    asked_hz: f64,
    /// Whether the rate has a bar, or is only reported.
    is_judged: bool,
}

/// Rate at which hands move their organ \[Hz\].
const HANDS_HZ: f64 = 1_000.0;

const SCENES: [Scene; 5] = [
    Scene {
        name: "rigid_rigid",
        kind: "obb-tree",
        triangles: 10_000,
        waves: [None, None],
        moves_hz: HANDS_HZ,
        asked_hz: 4_000.0,
        is_judged: true,
    },
    // As if hands were as fast as the detector: every query sees a new pose.
    Scene {
        name: "rigid_rigid_restless",
        kind: "obb-tree",
        triangles: 10_000,
        waves: [None, None],
        moves_hz: ABOVE * 4_000.0,
        asked_hz: 4_000.0,
        is_judged: false,
    },
    Scene {
        name: "soft_rigid",
        kind: "obb-tree",
        triangles: 10_000,
        waves: [Some(300.0), None],
        moves_hz: HANDS_HZ,
        asked_hz: 1_000.0,
        is_judged: true,
    },
    Scene {
        name: "soft_soft",
        kind: "obb-tree",
        triangles: 5_000,
        waves: [Some(100.0), Some(60.0)],
        moves_hz: HANDS_HZ,
        asked_hz: 100.0,
        is_judged: true,
    },
    Scene {
        name: "soft_soft_hash",
        kind: "spherical-hash",
        triangles: 5_000,
        waves: [Some(100.0), Some(60.0)],
        moves_hz: HANDS_HZ,
        asked_hz: 100.0,
        is_judged: true,
    },
];

/// Moves an organ: a rigid one up and down into the other, a soft one by waves through its vertices.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct MoverConfig {
    body: String,
    triangles: usize,
    soft: bool,
    /// Height at which the organs touch \[m\]; `None` if it does not move.
    touches_at: Option<f64>,
}

struct Mover {
    config: MoverConfig,
    body: Entity,
    mesh: Mesh,
    round: Vec<Point3<f64>>,
    begun: bool,
}

impl Mover {
    fn new(config: &MoverConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let made =
            |mesh: Result<Mesh, Failure>| mesh.map_err(|failure| ControllerError::Failed(failure.message));
        let mesh = made(Mesh::bumpy(config.triangles))?;
        let round = made(Mesh::round(config.triangles))?.vertices;
        let body = context.scene.find(&config.body);
        let body = body.ok_or_else(|| ControllerError::Scene(format!("no '{}'", config.body)))?;
        Ok(Self { config: config.clone(), body, mesh, round, begun: false })
    }
}

impl Controller for Mover {
    fn access(&self) -> Access {
        let on = || EntitySet::Of(vec![self.body]);
        Access::new().writes::<SurfaceMesh>(on()).writes::<VertexPositions>(on()).writes::<Pose>(on())
    }

    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let time = tick.time.as_secs_f64();
        if !std::mem::replace(&mut self.begun, true) {
            out.put(self.body, SurfaceMesh { triangles: Arc::new(self.mesh.triangles.clone()) });
            out.put(self.body, VertexPositions { positions: Arc::new(self.mesh.vertices.clone()) });
        }
        if self.config.soft {
            // The waves are as deep as the penetration, and no deeper.
            let wave = |round: &Point3<f64>, rest: &Point3<f64>| {
                rest + round.coords * (0.008 * (90.0 * round.x - 6.0 * time).sin() * (70.0 * round.y).cos())
            };
            let vertices = self.round.iter().zip(&self.mesh.vertices);
            let positions = Arc::new(vertices.map(|(round, rest)| wave(round, rest)).collect());
            out.put(self.body, VertexPositions { positions });
        }
        if let Some(touches_at) = self.config.touches_at {
            // Sideways as well, so that the contact covers different triangles.
            let side = 0.002 * (0.7 * TAU * time).sin();
            let height = touches_at - DEEP + SWAY * (TAU * time).sin();
            out.put(self.body, Pose::at(side, 0.5 * side, height));
        }
        Ok(())
    }
}

/// Height of the second organ above the first at which they begin to touch \[m\].
fn touches_at(triangles: usize) -> Result<f64, Failure> {
    let mesh = Mesh::bumpy(triangles)?;
    let surface = Surface::new(&mesh.vertices, &mesh.triangles).map_err(Failure::internal)?;
    let (tree, mut query) = (ObbTree::build(&surface), TreeQuery::new());
    let mut height = 0.2;
    // Never further than their distance.
    for _ in 0..200 {
        let near = query.distance(&tree, &tree, &Isometry3::translation(0.0, 0.0, height), None);
        let Some(near) = near.filter(|near| near.distance > 1e-7) else { break };
        height -= near.distance;
    }
    Ok(height)
}

fn scenario(scene: &Scene, touches_at: f64) -> String {
    let mut text = String::from(
        "schema = 1\nname = \"organs\"\ntitle = \"Organs\"\ndescription = \"Two organs in contact, and two hands.\"\n\
         gravity = [0.0, 0.0, -9.81]\n",
    );
    for organ in ["first", "second"] {
        text += &format!(
            "[[entity]]\nname = \"{organ}\"\npose = {{ translation = [0.0, 0.0, 0.0] }}\n\
             mesh = {{ shape = {{ sphere = {{ radius = 0.02 }} }}, segments = 8 }}\n"
        );
    }
    for side in ["left", "right"] {
        text += &format!(
            "[[entity]]\nname = \"probe.{side}\"\npose = {{ translation = [0.0, 0.3, 0.0] }}\n\
             [entity.instrument]\nkind = \"probe\"\njaws = 0\n\
             [[entity]]\nname = \"hand.{side}\"\n[entity.hand]\nside = \"{side}\"\ninstrument = \"probe.{side}\"\n\
             [[controller]]\nname = \"haptics.{side}\"\nkind = \"haptics\"\nrate_hz = 1000\n\
             params = {{ hand = \"{side}\" }}\n\
             [[hand]]\nname = \"{side}\"\nentity = \"hand.{side}\"\ndevice = \"virtual\"\n"
        );
    }
    let triangles = scene.triangles;
    for ((organ, wave), height) in ["first", "second"].iter().zip(scene.waves).zip([None, Some(touches_at)]) {
        let height = height.map_or(String::new(), |height| format!(", touches_at = {height}"));
        text += &format!(
            "[[controller]]\nname = \"mover.{organ}\"\nkind = \"mover\"\nrate_hz = {}\nparams = {{ body = \"{organ}\", \
             triangles = {triangles}, soft = {}{height} }}\n",
            wave.unwrap_or(scene.moves_hz),
            wave.is_some()
        );
    }
    let watched = match scene.kind {
        "obb-tree" => "pairs = [[\"first\", \"second\"]]",
        _ => "body = \"first\", others = [\"second\"]",
    };
    let hz = ABOVE * scene.asked_hz;
    text += &format!(
        "[[controller]]\nname = \"detector\"\nkind = \"{}\"\nrate_hz = {hz}\nparams = {{ {watched} }}\n",
        scene.kind
    );
    text
}

/// Every scene: the detector's achieved rate, step time and results, and the punctuality of the two hands beside it.
pub fn live() -> Result<Vec<BenchResult>, Failure> {
    let mut rows = Vec::new();
    for scene in &SCENES {
        rows.extend(measure(scene)?);
    }
    Ok(rows)
}

fn measure(scene: &Scene) -> Result<Vec<BenchResult>, Failure> {
    let app = App::new().controller_with("mover", Mover::new);
    let text = scenario(scene, touches_at(scene.triangles)?);
    let scenario = app.scenario_from("organs.toml".as_ref(), &text)?;
    let span = Duration::from_secs_f64(BLOCK_SECS);
    let target = ABOVE * scene.asked_hz;
    let (mut achieved, mut bare, mut hands, mut bare_hands) = (vec![], vec![], vec![], vec![]);
    let (mut p50, mut p99, mut hits) = (vec![], vec![], vec![]);
    for _ in 0..BLOCKS {
        bare.push(bare_rates(1, target, span).ran);
        bare_hands.push(bare_rates(2, 1_000.0, span).on_time);
        let options = RunOptions { seconds: Some(BLOCK_SECS), ..RunOptions::default() };
        let outcome = trocar::run::run(&app, &scenario, &options, &mut |_| {})?;
        let row = |name: &str| {
            let row = outcome.reports.iter().find(|row| row.name == name);
            row.ok_or_else(|| Failure::internal(format!("'{name}' did not run")))
        };
        let detector = row("detector")?;
        let found = detector.hits.unwrap_or_default();
        // Of the ticks that ran: ticks missed on a busy machine say nothing about the detector.
        if found.ticks < (detector.scheduled - detector.missed) / 4 {
            let reason = format!("{}: the organs met in {} ticks only", scene.name, found.ticks);
            return Err(Failure::internal(reason));
        }
        achieved.push(detector.achieved_hz);
        p50.push(detector.step_us.p50);
        p99.push(detector.step_us.p99);
        hits.push(found.mean);
        hands.push(row("haptics.left")?.on_time.min(row("haptics.right")?.on_time));
    }
    let name = |what: &str| format!("collision_live_{}_{what}", scene.name);
    let floor = median_and_spread(&bare).0;
    // The required rate, scaled by what a bare loop at that rate achieves here.
    let bar = scene.is_judged.then_some(scene.asked_hz * floor);
    let mut rate = BenchResult::on_value(name("hz"), "Hz", median_and_spread(&achieved), bar, Better::Higher);
    rate.floor = Some(target * floor);
    rate.ratio = Some(rate.value / (target * floor)).filter(|ratio| ratio.is_finite());
    let floor = median_and_spread(&bare_hands).0;
    let bar = Some((floor - 0.005).max(0.99));
    let on_time = median_and_spread(&hands);
    let mut on_time = BenchResult::on_value(name("hands_on_time"), "share", on_time, bar, Better::Higher);
    on_time.floor = Some(floor);
    on_time.ratio = Some(on_time.value / floor).filter(|ratio| ratio.is_finite());
    let told = |what: &str, unit: &str, values: &[f64], better| {
        BenchResult::on_value(name(what), unit, median_and_spread(values), None, better)
    };
    Ok(vec![
        rate,
        on_time,
        told("step_p50", "µs", &p50, Better::Lower),
        told("step_p99", "µs", &p99, Better::Lower),
        told("hits", "contacts per tick", &hits, Better::Higher),
    ])
}
