//! The peers: MuJoCo's flexible bodies, pypbd's position-based solids, PyElastica's rods, Bullet's cloth.

use std::path::Path;

use serde_json::json;

use crate::bench::peer::{Peer, numbers};
use crate::failure::Failure;

const PYPBD: &str = include_str!("../../../../../tests/peers/simulator_xpbd.py");
const ELASTICA: &str = include_str!("../../../../../tests/peers/simulator_rod.py");
const BULLET: &str = include_str!("../../../../../tests/peers/simulator_cloth.py");
const MUJOCO: &str = include_str!("../../../../../tests/peers/simulator_fem.py");

/// The beam of [`super::fem::beam`] in MuJoCo.
pub struct MujocoBeam {
    peer: Peer,
    tip: f64,
}

impl MujocoBeam {
    /// Starts the process.
    ///
    /// # Errors
    /// When that Python has no MuJoCo, or the script reports an error.
    pub fn start(python: &Path, cells: [usize; 3], damping: f64) -> Result<Self, Failure> {
        let mut peer = Peer::start(python, MUJOCO)?;
        peer.ask(&json!({
            "cells": cells, "size": [0.1, 0.02, 0.02], "young": 1e5, "poisson": 0.3, "density": 1000.0,
            "damping": damping, "dt": 1e-3
        }))?;
        Ok(Self { peer, tip: 0.0 })
    }

    /// Mean processor time of so many steps \[ms\].
    ///
    /// # Errors
    /// When it does not answer.
    pub fn steps(&mut self, count: usize) -> Result<f64, Failure> {
        let answer = self.peer.ask(&json!({ "steps": count }))?;
        let times = numbers(&answer, "cpu_ms");
        self.tip = answer["tip"].as_f64().unwrap_or(f64::NAN);
        Ok(times.iter().sum::<f64>() / times.len() as f64)
    }

    /// Deflection of its free end \[m\].
    pub fn tip(&self) -> f64 {
        self.tip
    }
}

/// A beam of cells in pypbd.
pub struct PypbdBeam {
    peer: Peer,
    /// Deflection of its free end at rest by linear elasticity \[m\].
    pub deflection_linear: f64,
    tip: Option<f64>,
}

impl PypbdBeam {
    /// Starts the process with the same beam and so many iterations in a step.
    ///
    /// # Errors
    /// When that Python has no pypbd, or the script reports an error.
    pub fn start(python: &Path, beam: &SaggingBeam, iterations: u32) -> Result<Self, Failure> {
        let mut peer = Peer::start(python, PYPBD)?;
        let answer = peer.ask(&json!({
            "cells": beam.cells, "edge": beam.edge, "young": beam.young, "poisson": beam.poisson,
            "density": beam.density, "damping": beam.damping, "dt": beam.step_secs, "parts": 1,
            "iterations": iterations, "method": "fem"
        }))?;
        let deflection_linear = answer["deflection_linear"]
            .as_f64()
            .ok_or_else(|| Failure::internal("the peer does not say how far its beam should sag"))?;
        Ok(Self { peer, deflection_linear, tip: None })
    }

    /// Mean processor time of so many steps \[ms\].
    ///
    /// # Errors
    /// When it does not answer.
    pub fn steps(&mut self, count: usize) -> Result<f64, Failure> {
        let answer = self.peer.ask(&json!({ "steps": count }))?;
        self.tip = answer["tip"].as_f64();
        answer["ms"].as_f64().ok_or_else(|| Failure::internal("the peer tells no time"))
    }

    /// Deflection of its free end \[m\]; `None` when it has diverged.
    pub fn tip(&self) -> Option<f64> {
        self.tip
    }
}

/// A rod that is clamped at one end and sags under gravity.
#[derive(Clone, Copy, Debug)]
pub struct SaggingRod {
    /// Number of edges.
    pub edges: usize,
    /// \[m\].
    pub length: f64,
    /// \[m\].
    pub radius: f64,
    /// \[kg/m³\].
    pub density: f64,
    /// Young's modulus \[Pa\].
    pub young: f64,
    /// Share of a velocity that is lost in a second \[1/s\].
    pub damping: f64,
}

/// A rod in PyElastica.
pub struct ElasticaRod {
    peer: Peer,
    /// Deflection of its free end at rest by slender-beam theory \[m\].
    pub deflection_linear: f64,
    tip: Option<f64>,
}

impl ElasticaRod {
    /// Starts the process with the same rod.
    ///
    /// # Errors
    /// When that Python has no PyElastica, or the script reports an error.
    pub fn start(python: &Path, rod: &SaggingRod, step_secs: f64) -> Result<Self, Failure> {
        let mut peer = Peer::start(python, ELASTICA)?;
        let answer = peer.ask(&json!({
            "edges": rod.edges, "length": rod.length, "radius": rod.radius, "density": rod.density,
            "young": rod.young, "damping": rod.damping, "dt": step_secs
        }))?;
        let deflection_linear = answer["deflection_linear"]
            .as_f64()
            .ok_or_else(|| Failure::internal("the peer does not say how far its rod should sag"))?;
        Ok(Self { peer, deflection_linear, tip: None })
    }

    /// Mean processor time of a simulated millisecond, over so many seconds \[ms\].
    ///
    /// # Errors
    /// When it does not answer.
    pub fn stretch(&mut self, secs: f64) -> Result<f64, Failure> {
        let answer = self.peer.ask(&json!({ "secs": secs }))?;
        self.tip = answer["tip"].as_f64();
        answer["ms"].as_f64().ok_or_else(|| Failure::internal("the peer tells no time"))
    }

    /// Deflection of its free end \[m\]; `None` when it has diverged.
    pub fn tip(&self) -> Option<f64> {
        self.tip
    }
}

/// A mass-spring sheet in Bullet, hanging from one edge.
pub struct BulletCloth(Peer);

impl BulletCloth {
    /// Starts the process: so many squares along a side of 10 cm.
    ///
    /// # Errors
    /// When that Python has no pybullet, or the script reports an error.
    pub fn start(python: &Path, squares: u32) -> Result<Self, Failure> {
        let mut peer = Peer::start(python, BULLET)?;
        // As stiff as its explicit steps allow at half our step.
        let sheet =
            json!({ "squares": squares, "size": 0.1, "density": 0.15, "stiffness": 10.0, "dt": 5e-5 });
        peer.ask(&sheet)?;
        Ok(Self(peer))
    }

    /// Mean processor time of so many steps \[ms\].
    ///
    /// # Errors
    /// When it does not answer, or has diverged.
    pub fn steps(&mut self, count: usize) -> Result<f64, Failure> {
        let answer = self.0.ask(&json!({ "steps": count }))?;
        if answer["lowest"].is_null() {
            return Err(Failure::internal("the peer's cloth has lost its numbers"));
        }
        answer["ms"].as_f64().ok_or_else(|| Failure::internal("the peer tells no time"))
    }
}

/// A beam that is clamped at one end and sags under gravity.
#[derive(Clone, Copy, Debug)]
pub struct SaggingBeam {
    /// Cells of six tetrahedra along each axis.
    pub cells: [usize; 3],
    /// Edge length of a cell \[m\].
    pub edge: f64,
    /// Young's modulus \[Pa\].
    pub young: f64,
    /// Poisson's ratio.
    pub poisson: f64,
    /// \[kg/m³\].
    pub density: f64,
    /// Share of a velocity that is lost in a second \[1/s\].
    pub damping: f64,
    /// \[s\].
    pub step_secs: f64,
}
