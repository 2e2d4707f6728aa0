//! `trocar recording export`: what a recording holds, as tables.
//!
//! A recording is read twice: first to find the columns, then to write the rows. So a long one takes no more memory than
//! a short one.

mod columns;
mod csv;
mod flatten;
mod parquet;
mod part_file;
mod tables;
mod walk;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use indicatif::{ProgressBar, ProgressStyle};
use serde_json::{Value, json};
use trocar::app::App;
use trocar::summary::{Exit, SCHEMA};
use trocar_kernel::recorder::Recording;
use trocar_scene::{ComponentId, Registry, SimTime};

use columns::Kind;
use tables::{Survey, Tables, Written};
use walk::{Met, walk};

use super::{ExportArgs, TableFormat};
use crate::escape::printable;
use crate::failure::{Failure, did_you_mean};
use crate::output;

/// The table of events, and that of gaps and damage: they are named like components.
const EVENTS: &str = "events";
const GAPS: &str = "gaps";

/// Their columns.
const OWN: [(&str, &[(&str, Kind)]); 2] = [
    (
        EVENTS,
        &[("name", Kind::Text), ("subject", Kind::Text), ("object", Kind::Text), ("value", Kind::Number)],
    ),
    (
        GAPS,
        &[
            ("kind", Kind::Text),
            ("after_revision", Kind::Whole),
            ("until_revision", Kind::Whole),
            ("reason", Kind::Text),
        ],
    ),
];

/// What is written unless something else is asked for.
const USUAL: [&str; 9] = [
    "pose",
    "device_state",
    "device_force",
    "instrument_force",
    "jaw_state",
    "task_state",
    "measured",
    EVENTS,
    GAPS,
];

/// Most names in a message.
const NAMES_MAX: usize = 200;

/// What is exported.
struct Selection {
    /// Names of components, `events` and `gaps`.
    names: BTreeSet<String>,
    components: BTreeMap<ComponentId, &'static str>,
    /// Empty: all of them.
    entities: BTreeSet<String>,
}

impl Selection {
    fn new(args: &ExportArgs, registry: &Registry) -> Result<Self, Failure> {
        let usual = || USUAL.iter().map(|name| (*name).to_owned()).collect();
        let names: BTreeSet<String> =
            if args.components.is_empty() { usual() } else { args.components.iter().cloned().collect() };
        let mut components = BTreeMap::new();
        for name in &names {
            match registry.by_name(name) {
                Ok(id) => drop(components.insert(id, registry.entry(id).name)),
                Err(_) if [EVENTS, GAPS].contains(&name.as_str()) => {}
                Err(_) => {
                    let known: Vec<&str> =
                        registry.iter().map(|(_, entry)| entry.name).chain([EVENTS, GAPS]).collect();
                    return Err(unknown("--component: there is no component", name, &known));
                }
            }
        }
        Ok(Self { names, components, entities: args.entities.iter().cloned().collect() })
    }

    /// Whether something of these entities is asked for.
    fn has(&self, entities: &[&str]) -> bool {
        self.entities.is_empty() || entities.iter().any(|entity| self.entities.contains(*entity))
    }

    /// The table and the row of what was met, if it is asked for.
    fn row<'a>(&self, met: &'a Met<'_>) -> Option<(&'a str, SimTime, Option<&'a str>, Value)> {
        match met {
            Met::Value { time, entity, component, value } => {
                self.has(&[entity]).then(|| (*component, *time, Some(entity.as_str()), (*value).clone()))
            }
            Met::Event { time, subject, object, event } => {
                let concerned = [subject.as_str(), object.as_deref().unwrap_or(subject)];
                let row = json!({
                    "name": event.name, "subject": subject, "object": object, "value": event.value
                });
                (self.names.contains(EVENTS) && self.has(&concerned)).then_some((EVENTS, *time, None, row))
            }
            Met::Missing { time, kind, after, until, what } => {
                let row =
                    json!({"kind": kind, "after_revision": after, "until_revision": until, "reason": what});
                self.names.contains(GAPS).then_some((GAPS, *time, None, row))
            }
        }
    }
}

/// What became of it.
#[derive(Default)]
struct Outcome {
    written: Vec<Written>,
    /// What was asked for, and of which there is nothing.
    empty: Vec<String>,
    missing: Vec<String>,
}

/// Writes the tables.
pub fn export(app: &App, args: &ExportArgs) -> Result<Exit, Failure> {
    let folder = args.out.clone().unwrap_or_else(|| args.file.with_extension("tables"));
    let mut outcome = Outcome::default();
    let mut result = attempt(app, args, &folder, &mut outcome);
    if result.is_ok() && !outcome.missing.is_empty() {
        let missing = outcome.missing.join("; ");
        result = Err(Failure {
            exit: Exit::Failed,
            message: format!(
                "{}: everything that is whole was exported; missing: {missing}",
                args.file.display()
            ),
        });
    }
    if args.json {
        let error = result.as_ref().err().map(|failure| failure.message.clone());
        output::print_json(&object(args, &folder, &outcome, error.as_deref()))?;
    } else if !outcome.written.is_empty() {
        output::print_text(&text(&folder, &outcome).join("\n"))?;
    }
    result
}

fn attempt(app: &App, args: &ExportArgs, folder: &Path, outcome: &mut Outcome) -> Result<Exit, Failure> {
    let registry = app.registry();
    let selection = Selection::new(args, registry)?;
    let recording = Recording::open(&args.file).map_err(Failure::invalid)?;
    recording.check_components(registry).map_err(Failure::invalid)?;
    let bar = progress_bar(&recording, args.json);
    let mut survey = Survey::default();
    for (name, columns) in OWN {
        // A table of events is there even when nothing happened.
        if selection.names.contains(name) {
            survey.expect(name, columns);
        }
    }
    let mut names = BTreeSet::new();
    walk(&recording, registry, &selection.components, &mut |met| {
        bar.set_position(met.time().as_nanos() / 2);
        match met {
            Met::Value { entity, .. } if !names.contains(entity) => drop(names.insert(entity.clone())),
            Met::Event { subject, object, .. } if selection.names.contains(EVENTS) => {
                names.extend(std::iter::once(subject).chain(object).cloned());
            }
            Met::Missing { what, .. } => outcome.missing.push(what.clone()),
            _ => {}
        }
        if let Some((table, _, entity, value)) = selection.row(met) {
            survey.row(table, entity.is_some(), &value);
        }
        Ok(())
    })?;
    check_entities(&selection, &names)?;
    outcome.empty = selection.names.iter().filter(|name| !survey.has(name)).cloned().collect();
    if !args.components.is_empty() {
        for name in &outcome.empty {
            tracing::warn!("the recording has no value of '{name}'");
        }
    }
    std::fs::create_dir_all(folder)
        .map_err(|error| Failure::invalid(format!("{}: cannot be written: {error}", folder.display())))?;
    let mut tables = Tables::create(survey, folder, args.format, output::replace(args.force))?;
    let half = recording.duration().as_nanos() / 2;
    walk(&recording, registry, &selection.components, &mut |met| {
        bar.set_position(half + met.time().as_nanos() / 2);
        match selection.row(met) {
            Some((table, time, entity, value)) => tables.row(table, time, entity, &value),
            None => Ok(()),
        }
    })?;
    outcome.written = tables.finish()?;
    bar.finish_and_clear();
    Ok(Exit::Ok)
}

/// Refuses names of entities of which there is no value.
fn check_entities(selection: &Selection, names: &BTreeSet<String>) -> Result<(), Failure> {
    for name in &selection.entities {
        if !names.contains(name) {
            let known: Vec<&str> = names.iter().map(String::as_str).collect();
            return Err(unknown("--entity: these tables have no entity", name, &known));
        }
    }
    Ok(())
}

/// A refusal that tells the valid names.
fn unknown(what: &str, name: &str, known: &[&str]) -> Failure {
    let alike = did_you_mean(name, known.iter().copied());
    let mut list = known.iter().take(NAMES_MAX).copied().collect::<Vec<_>>().join(", ");
    if known.len() > NAMES_MAX {
        list.push_str(", …");
    }
    Failure::usage(printable(&format!("{what} '{name}'{alike}; there are: {list}")))
}

/// How much of the recording has been read, where stderr is a terminal.
fn progress_bar(recording: &Recording, silent: bool) -> ProgressBar {
    if silent {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(recording.duration().as_nanos());
    let style = ProgressStyle::with_template("{spinner} {bar:32} {percent} % of the export  {elapsed}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

fn object(args: &ExportArgs, folder: &Path, outcome: &Outcome, error: Option<&str>) -> Value {
    let table = |table: &Written| {
        json!({
            "name": table.name,
            "file": table.file.display().to_string(),
            "rows": table.rows,
            "columns": table.columns,
            "bytes": table.bytes,
        })
    };
    json!({
        "schema": SCHEMA,
        "recording": args.file.display().to_string(),
        "folder": folder.display().to_string(),
        "format": match args.format {
            TableFormat::Csv => "csv",
            TableFormat::Parquet => "parquet",
        },
        "tables": outcome.written.iter().map(table).collect::<Vec<_>>(),
        "empty": outcome.empty,
        "missing": outcome.missing,
        "error": error,
    })
}

fn text(folder: &Path, outcome: &Outcome) -> Vec<String> {
    let row = |table: &Written| {
        let name = table.file.file_name().unwrap_or_default().to_string_lossy();
        let megabytes = format!("{:.2}", table.bytes as f64 / 1e6);
        vec![printable(&name), table.rows.to_string(), table.columns.len().to_string(), megabytes]
    };
    let rows: Vec<_> = outcome.written.iter().map(row).collect();
    let mut lines = vec![format!("tables in {}", printable(&folder.display().to_string())), String::new()];
    lines.extend(output::columns(&["table", "rows", "columns", "MB"], &rows));
    lines
}
