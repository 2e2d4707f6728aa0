//! The peers, coal and FCL, in a child process that times its own blocks when asked.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use nalgebra::Isometry3;
use serde_json::{Value, json};
use tempfile::TempDir;

use super::meshes::{Mesh, poses_csv};
use crate::failure::Failure;

/// What runs there.
const SCRIPT: &str = include_str!("../../../../../tests/peers/collision.py");

/// A Python that has them.
pub struct Peers {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    names: Vec<String>,
    folder: TempDir,
}

impl Peers {
    /// Starts it.
    ///
    /// # Errors
    /// When it does not start.
    pub fn start(python: &Path) -> Result<Self, Failure> {
        let folder = tempfile::tempdir().map_err(Failure::internal)?;
        let script = folder.path().join("collision.py");
        fs::write(&script, SCRIPT).map_err(Failure::internal)?;
        let mut child = Command::new(python)
            .arg(script)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| Failure::usage(format!("--peers {}: {error}", python.display())))?;
        let (Some(requests), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(Failure::internal("the peers have no input or output"));
        };
        Ok(Self { child, requests, answers: BufReader::new(answers), names: Vec::new(), folder })
    }

    fn ask(&mut self, request: &Value) -> Result<Value, Failure> {
        writeln!(self.requests, "{request}").map_err(Failure::internal)?;
        let mut line = String::new();
        self.answers.read_line(&mut line).map_err(Failure::internal)?;
        if line.is_empty() {
            return Err(Failure::internal("the peers have ended; see what they said above"));
        }
        let answer: Value = serde_json::from_str(&line).map_err(Failure::internal)?;
        match answer.get("error") {
            Some(error) => Err(Failure::internal(format!("the peers answered: {error}"))),
            None => Ok(answer),
        }
    }

    /// What the next blocks are about.
    ///
    /// # Errors
    /// When there are none, or they do not understand.
    pub fn prepare(&mut self, mesh: &Mesh, poses: &[Isometry3<f64>]) -> Result<(), Failure> {
        let (mesh_file, poses_file) =
            (self.folder.path().join("mesh.obj"), self.folder.path().join("poses.csv"));
        fs::write(&mesh_file, mesh.obj()).map_err(Failure::internal)?;
        fs::write(&poses_file, poses_csv(poses)).map_err(Failure::internal)?;
        let answer = self.ask(&json!({ "mesh": mesh_file }))?;
        let peers = answer["peers"].as_object();
        self.names = peers.map(|peers| peers.keys().cloned().collect()).unwrap_or_default();
        if self.names.is_empty() {
            let hint = "install what tests/peers/requirements.txt names";
            return Err(Failure::usage(format!("that Python has neither coal nor FCL: {hint}")));
        }
        self.ask(&json!({ "poses": poses_file }))?;
        Ok(())
    }

    /// Times of one block of each peer \[µs\]: one for each pose, or a single one.
    ///
    /// # Errors
    /// When one does not answer.
    pub fn block(&mut self, query: &str) -> Result<Vec<(String, Vec<f64>)>, Failure> {
        let mut blocks = Vec::new();
        for name in self.names.clone() {
            let answer = self.ask(&json!({ "peer": name, "query": query, "repeats": 1 }))?;
            let times = answer["us"].as_array().map(|times| times.iter().filter_map(Value::as_f64).collect());
            blocks.push((name, times.unwrap_or_default()));
        }
        Ok(blocks)
    }
}

impl Drop for Peers {
    fn drop(&mut self) {
        // It ends by itself when nobody asks any more; whether it does is nobody's concern.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
