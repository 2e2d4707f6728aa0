//! A host of a session, as a program of its own.

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};

/// A host of the peg transfer that has printed its tickets.
pub struct Host {
    child: Child,
    /// The tickets, one for each wish.
    pub tickets: Vec<String>,
    lines: BufReader<std::process::ChildStderr>,
}

impl Host {
    /// Starts it in a folder, at any port of the loopback; its file of tickets is `host.tickets`.
    pub fn start(folder: &Path, tickets: &[&str]) -> Self {
        Self::start_with(folder, tickets, &[])
    }

    /// The same, with further arguments.
    pub fn start_with(folder: &Path, tickets: &[&str], further: &[&str]) -> Self {
        let mut arguments =
            vec!["host", "peg-transfer", "--headless", "--json", "--no-record", "--no-report"];
        arguments.extend(["--port", "0", "--bind", "127.0.0.1", "--tickets", "host.tickets"]);
        arguments.extend(["--seconds", "120"]);
        arguments.extend(further);
        tickets.iter().for_each(|wish| arguments.extend(["--ticket", wish]));
        let mut child = Command::new(env!("CARGO_BIN_EXE_trocar"))
            .args(arguments)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let mut lines = BufReader::new(child.stderr.take().expect("piped"));
        let mut found = Vec::new();
        let mut told = String::new();
        while found.len() < tickets.len() {
            let mut line = String::new();
            let bytes = lines.read_line(&mut line).expect("a line");
            assert!(bytes > 0, "the host ended: {told}");
            told.push_str(&line);
            found.extend(line.starts_with("trocar1").then(|| line.trim().to_owned()));
        }
        Self { child, tickets: found, lines }
    }

    /// Ends it as Ctrl-C does, and gives what it printed.
    pub fn end(mut self) -> Output {
        let pid = rustix::process::Pid::from_child(&self.child);
        rustix::process::kill_process(pid, rustix::process::Signal::INT).expect("it runs");
        let mut told = String::new();
        let mut line = String::new();
        while self.lines.read_line(&mut line).expect("text") > 0 {
            told.push_str(&line);
            line.clear();
        }
        let mut output = self.child.wait_with_output().expect("an end");
        output.stderr = told.into_bytes();
        output
    }
}
