//! A peer program for comparison: a Python script in a child process that times its own blocks on request, so that our
//! blocks alternate with the peer's. One JSON object per line, in and out.

use std::fs;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use serde_json::Value;
use tempfile::TempDir;

use crate::failure::Failure;

/// A script, running in a Python with the packages that it needs.
pub struct Peer {
    child: Child,
    requests: ChildStdin,
    answers: BufReader<ChildStdout>,
    folder: TempDir,
}

impl Peer {
    /// Starts the script.
    ///
    /// # Errors
    /// When the process does not start.
    pub fn start(python: &Path, script: &str) -> Result<Self, Failure> {
        let folder = tempfile::tempdir().map_err(Failure::internal)?;
        let file = folder.path().join("peer.py");
        fs::write(&file, script).map_err(Failure::internal)?;
        let mut child = Command::new(python)
            .arg(file)
            // Files that it leaves behind are removed with the folder.
            .current_dir(folder.path())
            // One thread, as for our blocks.
            .envs(["OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"].map(|name| (name, "1")))
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|error| Failure::usage(format!("--peers {}: {error}", python.display())))?;
        let (Some(requests), Some(answers)) = (child.stdin.take(), child.stdout.take()) else {
            return Err(Failure::internal("the peer has no input or output"));
        };
        Ok(Self { child, requests, answers: BufReader::new(answers), folder })
    }

    /// A temporary folder for its input files.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// Sends a request and waits for the answer.
    ///
    /// # Errors
    /// When it has ended, or reports an error.
    pub fn ask(&mut self, request: &Value) -> Result<Value, Failure> {
        writeln!(self.requests, "{request}").map_err(Failure::internal)?;
        let mut line = String::new();
        self.answers.read_line(&mut line).map_err(Failure::internal)?;
        if line.is_empty() {
            return Err(Failure::internal("the peer has ended; see what it said above"));
        }
        let answer: Value = serde_json::from_str(&line).map_err(Failure::internal)?;
        match answer.get("error") {
            Some(error) => Err(Failure::internal(format!("the peer answered: {error}"))),
            None => Ok(answer),
        }
    }
}

/// A list of numbers in an answer; empty where there is no such list.
pub fn numbers(answer: &Value, key: &str) -> Vec<f64> {
    answer[key].as_array().map(|list| list.iter().filter_map(Value::as_f64).collect()).unwrap_or_default()
}

impl Drop for Peer {
    fn drop(&mut self) {
        // It ends by itself when its input closes; a failure to kill it does not matter.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
