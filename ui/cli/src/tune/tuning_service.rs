//! The session's side of `trocar tune`: answers requests between two looks at the scene.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::Value;
use trocar::app::App;
use trocar::session::Session;
use trocar::tuning::{self, Change, TuneError, Tuned, Tuner};
use trocar_scene::Snapshot;
use trocar_scene::output_file::{self, Replace};
use trocar_scene::scenario::{FILE_BYTES_MAX, Scenario};

use super::protocol::{FieldRow, Reply, Request};
use super::socket::Server;

/// Most fields in an answer.
const FIELDS_MAX: usize = 10_000;

/// Tunes a session on request.
pub struct TuningService<'a> {
    app: &'a App,
    scenario: &'a Scenario,
    /// The scenario's own file, if it came from one.
    file: Option<PathBuf>,
    /// The working folder at the start.
    folder: PathBuf,
    tuner: Tuner,
    server: Option<Server>,
}

impl<'a> TuningService<'a> {
    /// For a session of this scenario; its socket is not open yet.
    pub fn new(app: &'a App, scenario: &'a Scenario, tuner: Tuner) -> Self {
        // An absolute path, since the working folder may change.
        let file = std::fs::canonicalize(&scenario.file).ok().filter(|file| file.is_file());
        let folder = std::env::current_dir().unwrap_or_default();
        Self { app, scenario, file, folder, tuner, server: None }
    }

    /// Opens the socket of this process; without one the session runs, but cannot be tuned.
    pub fn open(&mut self) {
        self.server = Server::open()
            .map_err(|error| tracing::warn!("the session cannot be tuned while it runs: {error}"))
            .ok();
    }

    /// Closes the socket.
    pub fn close(&mut self) {
        self.server = None;
    }

    /// The values that differ from the scenario.
    pub fn tuned(&self, scene: &Snapshot) -> BTreeMap<String, Value> {
        self.tuner.values(scene).into_iter().collect()
    }

    /// Answers the requests since the last call.
    pub fn serve(&mut self, session: &mut Session) {
        while let Some(asked) = self.server.as_ref().and_then(Server::question) {
            let reply = self.ask(session, &asked.request);
            asked.answer(reply);
        }
    }

    /// Carries out a request and returns its answer.
    pub fn ask(&mut self, session: &mut Session, request: &Request) -> Reply {
        match self.answer(session, request) {
            Ok(reply) => reply,
            Err(error) => Reply { error: Some(error), ..self.reply(session) },
        }
    }

    fn reply(&self, session: &Session) -> Reply {
        Reply {
            scenario: self.scenario.name.clone(),
            folder: self.folder.clone(),
            session_secs: session.now().as_secs_f64(),
            in_use: self.tuner.in_use().map(str::to_owned),
            sets: self.tuner.sets().names().map(str::to_owned).collect(),
            ..Reply::default()
        }
    }

    fn answer(&mut self, session: &mut Session, request: &Request) -> Result<Reply, String> {
        let scene = session.snapshot();
        let words = |error: TuneError| error.to_string();
        let mut fields = Vec::new();
        let (mut file, mut text, mut left_out) = (None, None, Vec::new());
        match request {
            Request::List { pattern } => {
                let found = tuning::list(&scene, pattern).map_err(|error| error.to_string())?;
                if found.len() > FIELDS_MAX {
                    return Err(format!("{} fields are called like that; ask for fewer", found.len()));
                }
                let row = |(field, value): (tuning::Field, Value)| FieldRow {
                    field: field.to_string(),
                    value,
                    before: None,
                };
                fields = found.into_iter().map(row).collect();
            }
            Request::Set { values } => {
                let values = values.iter().map(|(name, value)| (name.as_str(), value));
                let change = self.tuner.set(&scene, values).map_err(words)?;
                fields = self.apply(session, change)?;
            }
            Request::Use { set } => {
                let change = self.tuner.switch(&scene, set).map_err(words)?;
                fields = self.apply(session, change)?;
            }
            Request::Keep { set } => {
                self.tuner.keep(&scene, set).map_err(words)?;
                fields = self.tuner.changed(&scene).into_iter().map(row).collect();
            }
            Request::Status {} => fields = self.tuner.changed(&scene).into_iter().map(row).collect(),
            Request::Save { file: wanted } => {
                let saved = self.save(&scene, wanted.as_deref())?;
                (file, left_out) = (Some(saved.0), saved.1);
            }
            Request::Sets {} => text = Some(self.tuner.sets().text()),
        }
        Ok(Reply { fields, file, text, left_out, ..self.reply(session) })
    }

    /// Lets the Model apply a change and returns the answer.
    fn apply(&mut self, session: &mut Session, change: Change) -> Result<Vec<FieldRow>, String> {
        let tuned = self.tuner.apply(session, change).map_err(|error| error.to_string())?;
        Ok(tuned.into_iter().map(row).collect())
    }

    /// Writes the tuned values into the scenario's own file, or a new one.
    fn save(&self, scene: &Snapshot, wanted: Option<&Path>) -> Result<(PathBuf, Vec<String>), String> {
        let own = self.file.as_deref();
        let file = match (wanted, own) {
            (Some(wanted), _) if wanted.exists() && std::fs::canonicalize(wanted).ok().as_deref() != own => {
                return Err(format!(
                    "{}: exists already, and is not the scenario of the session",
                    wanted.display()
                ));
            }
            (Some(wanted), _) => wanted,
            (None, Some(own)) => own,
            (None, None) => {
                return Err("the scenario comes with the program: name a file to save it to".to_owned());
            }
        };
        // The file as it is on the disk now: it may have been edited since the start.
        let is_there = file.exists();
        let text = match is_there {
            true => read(file)?,
            false => self.scenario.text().to_owned(),
        };
        let values = self.tuner.values(scene);
        let saved = tuning::save(self.app, file, &text, &values).map_err(|error| error.to_string())?;
        // A new file, or the scenario's own one, which is edited.
        let replace = if is_there { Replace::Writable } else { Replace::Never };
        output_file::write(file, saved.text.as_bytes(), replace).map_err(|error| error.to_string())?;
        Ok((file.to_owned(), saved.left_out))
    }
}

fn row(tuned: Tuned) -> FieldRow {
    FieldRow { field: tuned.field.to_string(), value: tuned.after, before: Some(tuned.before) }
}

fn read(file: &Path) -> Result<String, String> {
    use std::io::Read;
    let mut text = String::new();
    std::fs::File::open(file)
        .and_then(|opened| opened.take(FILE_BYTES_MAX + 1).read_to_string(&mut text))
        .map_err(|error| format!("{}: {error}", file.display()))?;
    Ok(text)
}
