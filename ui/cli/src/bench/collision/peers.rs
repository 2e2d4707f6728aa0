//! The peers coal and FCL, which time the same queries.

use std::fs;
use std::path::Path;

use nalgebra::Isometry3;
use serde_json::json;

use super::meshes::{Mesh, poses_csv};
use crate::bench::peer::{Peer, numbers};
use crate::failure::Failure;

/// The peers' script.
const SCRIPT: &str = include_str!("../../../../../tests/peers/collision.py");

/// A Python process with coal and FCL.
pub struct Peers {
    peer: Peer,
    names: Vec<String>,
}

impl Peers {
    /// Starts the process.
    ///
    /// # Errors
    /// When it does not start.
    pub fn start(python: &Path) -> Result<Self, Failure> {
        Ok(Self { peer: Peer::start(python, SCRIPT)?, names: Vec::new() })
    }

    /// Sets the meshes and poses of the next blocks.
    ///
    /// # Errors
    /// When a peer is missing or returns an error.
    pub fn prepare(&mut self, mesh: &Mesh, poses: &[Isometry3<f64>]) -> Result<(), Failure> {
        let folder = self.peer.folder();
        let (mesh_file, poses_file) = (folder.join("mesh.obj"), folder.join("poses.csv"));
        fs::write(&mesh_file, mesh.obj()).map_err(Failure::internal)?;
        fs::write(&poses_file, poses_csv(poses)).map_err(Failure::internal)?;
        let answer = self.peer.ask(&json!({ "mesh": mesh_file }))?;
        let peers = answer["peers"].as_object();
        self.names = peers.map(|peers| peers.keys().cloned().collect()).unwrap_or_default();
        if self.names.is_empty() {
            let hint = "install what tests/peers/requirements.txt names";
            return Err(Failure::usage(format!("that Python has neither coal nor FCL: {hint}")));
        }
        self.peer.ask(&json!({ "poses": poses_file }))?;
        Ok(())
    }

    /// Times of one block of each peer \[µs\]: one for each pose, or a single one.
    ///
    /// # Errors
    /// When a peer does not answer.
    pub fn block(&mut self, query: &str) -> Result<Vec<(String, Vec<f64>)>, Failure> {
        let mut blocks = Vec::new();
        for name in self.names.clone() {
            let answer = self.peer.ask(&json!({ "peer": name, "query": query, "repeats": 1 }))?;
            blocks.push((name, numbers(&answer, "us")));
        }
        Ok(blocks)
    }
}
