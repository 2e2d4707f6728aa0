//! `trocar tune`: reads and changes values of a running session from another terminal.

pub mod protocol;
mod socket;
mod tuning_service;

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use trocar::app::App;
use trocar::summary::{Exit, SCHEMA};
use trocar::tuning::{self, BASE, TuneError, Tuner, TuningSets};
use trocar_scene::output_file::Claim;
use trocar_scene::scenario::Scenario;

use protocol::{FieldRow, Reply, Request};
pub use tuning_service::TuningService;

use crate::args::{SessionArgs, TuneArgs, TuneCommand};
use crate::escape::printable;
use crate::failure::{Failure, did_you_mean};
use crate::output::{self, replace};

/// The scenario of the command line with its assigned values, and a tuner that knows the original ones.
pub fn scenario(app: &App, args: &SessionArgs) -> Result<(Scenario, Tuner), Failure> {
    let scenario = app.scenario(&args.scenario)?;
    let sets = match &args.tuning {
        Some(file) => TuningSets::read(file).map_err(Failure::invalid)?,
        None => TuningSets::default(),
    };
    let mut values = Vec::new();
    if let Some(name) = args.use_set.as_deref().filter(|name| *name != BASE) {
        let set = sets.get(name).map_err(|error| {
            let hint = did_you_mean(name, sets.names());
            Failure::invalid(format!("--use {name}: {error}{hint}"))
        })?;
        values.extend(set.iter().map(|(field, value)| (field.clone(), value.clone())));
    }
    values.extend(args.set.iter().cloned());
    let mut tuner = Tuner::new(sets);
    if values.is_empty() {
        return Ok((scenario, tuner));
    }
    let wrong = |error: &dyn std::fmt::Display| Failure::invalid(format!("--set: {error}"));
    let tuned = tuning::tuned_scenario(app, &scenario, &values).map_err(|error| wrong(&error))?;
    let scene = scenario.spawn(app.registry()).map_err(|error| wrong(&error))?.snapshot();
    let in_use = args.use_set.as_deref().filter(|_| args.set.is_empty());
    tuner.began_with(&scene, &values, in_use).map_err(|error: TuneError| wrong(&error))?;
    Ok((tuned, tuner))
}

/// Sends the command to a running session.
pub fn tune(args: &TuneArgs) -> Result<Exit, Failure> {
    let result = attempt(args);
    if args.json
        && let Err(failure) = &result
    {
        output::print_json(&json!({ "schema": SCHEMA, "error": failure.message }))?;
    }
    result
}

fn attempt(args: &TuneArgs) -> Result<Exit, Failure> {
    let (export, stdout_is_taken) = match &args.command {
        TuneCommand::Export { file: Some(file), force } => {
            let is_stdout = output::takes_stdout(args.json, [Some(file.as_path())])?;
            (Some(Claim::take(file, replace(*force))?), is_stdout)
        }
        _ => (None, false),
    };
    let socket = session(args.session)?;
    let reply = ask(&socket, &request(&args.command)?)?;
    if let (Some(claim), Some(text)) = (export, &reply.text) {
        claim.write(text.as_bytes())?;
    }
    if args.json {
        let mut object = serde_json::to_value(&reply).map_err(Failure::internal)?;
        object["schema"] = json!(SCHEMA);
        output::print_json(&object)?;
    } else if stdout_is_taken {
        output::tell(&text(&args.command, &reply));
    } else {
        output::print_text(&text(&args.command, &reply))?;
    }
    Ok(Exit::Ok)
}

/// The socket of the session: that of the given process, or the only one that was started in this folder.
fn session(wanted: Option<u32>) -> Result<PathBuf, Failure> {
    let sessions = socket::sessions().map_err(Failure::invalid)?;
    if sessions.is_empty() {
        return Err(Failure::invalid("no session of yours is running; `trocar run SCENARIO` starts one"));
    }
    if let Some(pid) = wanted {
        let found = sessions.iter().find(|(running, _)| *running == pid);
        return found.map(|(_, socket)| socket.clone()).ok_or_else(|| {
            let known: Vec<String> = sessions.iter().map(|(pid, _)| pid.to_string()).collect();
            Failure::invalid(format!("no session has process {pid}; there are: {}", known.join(", ")))
        });
    }
    let mut told = Vec::with_capacity(sessions.len());
    for (pid, socket) in sessions {
        let reply = socket::ask(&socket, &Request::Status {}).ok();
        told.push(RunningSession { pid, socket, reply });
    }
    let here = std::env::current_dir().map_err(Failure::invalid)?;
    of_folder(&told, &here).cloned()
}

/// A session of this user, and what it tells of itself.
struct RunningSession {
    pid: u32,
    socket: PathBuf,
    /// `None` when it does not answer.
    reply: Option<Reply>,
}

/// The only session of a folder. One that runs elsewhere is another piece of work: it has to be named.
fn of_folder<'a>(sessions: &'a [RunningSession], here: &Path) -> Result<&'a PathBuf, Failure> {
    let whole = |folder: &Path| std::fs::canonicalize(folder).unwrap_or_else(|_| folder.to_owned());
    let here = whole(here);
    let is_here =
        |session: &&RunningSession| session.reply.as_ref().is_some_and(|reply| whole(&reply.folder) == here);
    let found: Vec<&RunningSession> = sessions.iter().filter(is_here).collect();
    let list = |sessions: &[&RunningSession]| {
        let line = |session: &&RunningSession| match &session.reply {
            Some(reply) => {
                let folder = printable(&reply.folder.display().to_string());
                format!("  --session {}  '{}' in {folder}", session.pid, printable(&reply.scenario))
            }
            None => format!("  --session {}  does not answer", session.pid),
        };
        sessions.iter().map(line).collect::<Vec<_>>().join("\n")
    };
    match found.as_slice() {
        [only] => Ok(&only.socket),
        [] => {
            let all: Vec<&RunningSession> = sessions.iter().collect();
            let what = "no session of yours was started in this folder; say which one is meant:";
            Err(Failure::invalid(format!("{what}\n{}", list(&all))))
        }
        several => {
            let what = "several sessions were started in this folder; say which one is meant:";
            Err(Failure::invalid(format!("{what}\n{}", list(several))))
        }
    }
}

fn request(command: &TuneCommand) -> Result<Request, Failure> {
    Ok(match command {
        TuneCommand::List { pattern } => Request::List { pattern: pattern.clone() },
        TuneCommand::Set { values } => Request::Set { values: values.clone() },
        TuneCommand::Use { set } => Request::Use { set: set.clone() },
        TuneCommand::Keep { set } => Request::Keep { set: set.clone() },
        TuneCommand::Status => Request::Status {},
        TuneCommand::Export { .. } => Request::Sets {},
        TuneCommand::Save { file } => {
            let absolute = file.as_deref().map(std::path::absolute).transpose().map_err(Failure::invalid)?;
            Request::Save { file: absolute }
        }
    })
}

fn ask(socket: &Path, request: &Request) -> Result<Reply, Failure> {
    let reply = socket::ask(socket, request)
        .map_err(|error| Failure::invalid(format!("the session does not answer: {error}")))?;
    match reply.error {
        Some(error) => Err(Failure::invalid(error)),
        None => Ok(reply),
    }
}

/// The answer as text for people.
fn text(command: &TuneCommand, reply: &Reply) -> String {
    let value = |value: &Value| match value {
        Value::String(word) => printable(word),
        other => other.to_string(),
    };
    let cells = |row: &FieldRow| {
        let mut cells = vec![printable(&row.field), value(&row.value)];
        cells.extend(row.before.as_ref().map(value));
        cells
    };
    let rows: Vec<Vec<String>> = reply.fields.iter().map(cells).collect();
    let table = |head: &[&str]| output::columns(head, &rows).join("\n");
    let in_use = || match reply.in_use.as_deref() {
        Some(set) => format!("set '{}' is in use", printable(set)),
        None => "single fields were set".to_owned(),
    };
    let sets = || {
        let names: Vec<String> = reply.sets.iter().map(|set| printable(set)).collect();
        format!("sets: {BASE}{}{}", if names.is_empty() { "" } else { ", " }, names.join(", "))
    };
    match command {
        TuneCommand::List { .. } => table(&["field", "value"]),
        TuneCommand::Set { .. } | TuneCommand::Use { .. } if rows.is_empty() => {
            format!("nothing changed; {}", in_use())
        }
        TuneCommand::Set { .. } | TuneCommand::Use { .. } => {
            format!("{}\n{} at {:.2} s", table(&["field", "value", "before"]), in_use(), reply.session_secs)
        }
        TuneCommand::Keep { set } => {
            format!("{}\nkept as '{}'; {}", table(&["field", "value", "scenario"]), printable(set), sets())
        }
        TuneCommand::Status if rows.is_empty() => format!("nothing is tuned; {}", sets()),
        TuneCommand::Status => {
            format!("{}\n{}; {}", table(&["field", "value", "scenario"]), in_use(), sets())
        }
        TuneCommand::Export { file: Some(file), .. } => format!("{}: {}", file.display(), sets()),
        TuneCommand::Export { file: None, .. } => reply.text.clone().unwrap_or_default(),
        TuneCommand::Save { .. } => {
            let file = reply.file.as_ref().map_or_else(String::new, |file| file.display().to_string());
            let left = reply.left_out.iter().map(|what| format!("\nleft out: {}", printable(what)));
            format!("saved to {file}{}", left.collect::<String>())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn running(pid: u32, scenario: &str, folder: &Path) -> RunningSession {
        let reply = Reply { scenario: scenario.into(), folder: folder.to_owned(), ..Reply::default() };
        RunningSession { pid, socket: format!("/run/{pid}.sock").into(), reply: Some(reply) }
    }

    #[test]
    fn a_session_of_another_folder_is_tuned_only_when_it_is_named() {
        let place = tempfile::tempdir().unwrap();
        let (here, elsewhere) = (place.path().join("a"), place.path().join("b"));
        std::fs::create_dir_all(&here).unwrap();
        std::fs::create_dir_all(&elsewhere).unwrap();
        let refused = |sessions: &[RunningSession]| of_folder(sessions, &here).unwrap_err().message;

        let one = [running(11, "peg-transfer", &elsewhere)];
        let message = refused(&one);
        for part in ["--session 11", "peg-transfer", &*elsewhere.display().to_string()] {
            assert!(message.contains(part), "'{part}' is not in: {message}");
        }
        // Of several sessions the one of this folder is meant, also by another way to it.
        let way = elsewhere.join("../a");
        let two = [running(11, "peg-transfer", &elsewhere), running(12, "knot", &way)];
        assert_eq!(of_folder(&two, &here).unwrap(), Path::new("/run/12.sock"));
        let message = refused(&[running(12, "knot", &here), running(13, "wall", &here)]);
        assert!(message.contains("several") && message.contains("--session 13"), "{message}");
        // One that does not answer may be of any folder.
        let silent = RunningSession { pid: 14, socket: "/run/14.sock".into(), reply: None };
        assert!(refused(&[silent]).contains("does not answer"));
    }
}
