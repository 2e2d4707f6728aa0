//! The peers: MuJoCo's flexible bodies, pypbd's position-based solids.

use std::path::Path;

use serde_json::json;

use crate::bench::peer::{Peer, numbers};
use crate::failure::Failure;

const MUJOCO: &str = include_str!("../../../../../tests/peers/simulator_fem.py");

/// The beam of [`super::fem::beam`] in MuJoCo.
pub struct MujocoBeam {
    peer: Peer,
    tip: f64,
}

impl MujocoBeam {
    /// Starts it.
    ///
    /// # Errors
    /// When that Python has no MuJoCo, or it does not understand.
    pub fn start(python: &Path, cells: [usize; 3]) -> Result<Self, Failure> {
        let mut peer = Peer::start(python, MUJOCO)?;
        peer.ask(&json!({
            "cells": cells, "size": [0.1, 0.02, 0.02], "young": 1e5, "poisson": 0.3, "density": 1000.0,
            "damping": 1e-3, "dt": 1e-3
        }))?;
        Ok(Self { peer, tip: 0.0 })
    }

    /// Mean time of so many steps \[ms\].
    ///
    /// # Errors
    /// When it does not answer.
    pub fn steps(&mut self, count: usize) -> Result<f64, Failure> {
        let answer = self.peer.ask(&json!({ "steps": count }))?;
        let times = numbers(&answer, "ms");
        self.tip = answer["tip"].as_f64().unwrap_or(f64::NAN);
        Ok(times.iter().sum::<f64>() / times.len() as f64)
    }

    /// How far its end has come down \[m\].
    pub fn tip(&self) -> f64 {
        self.tip
    }
}
