//! `trocar list`: the names that scenarios and command lines can use.

use std::collections::BTreeSet;

use serde::Serialize;
use serde_json::{Value, json};
use trocar::app::{App, SCENARIOS};
use trocar::plans::{self, PLANS};
use trocar::run::{RunError, RunOptions, accesses};
use trocar::summary::{Exit, SCHEMA};
use trocar::templates::TEMPLATES;
use trocar_scene::tissue::{TISSUES, TissueEntry, TissueParameter};

use crate::args::{ListArgs, Listed};
use crate::bench;
use crate::failure::Failure;
use crate::output;
use crate::report::short;

/// A listed item.
struct Listing {
    name: String,
    about: String,
    /// For controllers only.
    controller: Option<Usage>,
    /// For components only: how a recording keeps the values.
    recorded: Option<String>,
    /// For tissues only.
    parameters: &'static [TissueParameter],
    /// For devices only: key, values and meaning of each option.
    options: Vec<[&'static str; 3]>,
}

/// Rate and access of a kind of controller.
#[derive(Serialize)]
struct Usage {
    /// Usual rate \[Hz\]; null when unknown.
    rate_hz: Option<f64>,
    /// NAMEs of components, in order.
    reads: Vec<String>,
    /// NAMEs of components, contributions included, in order.
    writes: Vec<String>,
}

impl Listing {
    fn new(name: impl Into<String>, about: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            about: about.into(),
            controller: None,
            recorded: None,
            parameters: &[],
            options: Vec::new(),
        }
    }

    fn json(&self) -> Result<Value, Failure> {
        let mut object = json!({ "name": self.name, "about": self.about });
        if let Some(usage) = &self.controller {
            let usage = serde_json::to_value(usage).map_err(Failure::internal)?;
            if let (Some(object), Value::Object(usage)) = (object.as_object_mut(), usage) {
                object.extend(usage);
            }
        }
        if let Some(recorded) = &self.recorded {
            object["recorded"] = json!(recorded);
        }
        if !self.parameters.is_empty() {
            let parameter = |TissueParameter { name, unit, value, range, source }: &TissueParameter| json!({ "name": name, "unit": unit, "value": value, "range": range, "source": source });
            object["parameters"] = self.parameters.iter().map(parameter).collect();
        }
        if !self.options.is_empty() {
            let option =
                |[key, values, about]: &[&str; 3]| json!({ "key": key, "values": values, "about": about });
            object["options"] = self.options.iter().map(option).collect();
        }
        Ok(object)
    }

    fn lines(&self, width: usize) -> Vec<String> {
        let mut lines = vec![format!("  {:<width$}  {}", self.name, self.about).trim_end().to_owned()];
        if let Some(usage) = &self.controller {
            let indent = " ".repeat(width + 4);
            lines.extend(usage.rate_hz.map(|hz| format!("{indent}usually at {} Hz", short(hz))));
            for (verb, names) in [("reads", &usage.reads), ("writes", &usage.writes)] {
                if !names.is_empty() {
                    lines.push(format!("{indent}{verb} {}", names.join(", ")));
                }
            }
        }
        let recorded = self.recorded.iter().filter(|recorded| *recorded != "exact");
        lines.extend(recorded.map(|recorded| format!("{}recorded: {recorded}", " ".repeat(width + 4))));
        lines.extend(self.options.iter().map(|[key, values, about]| format!("    {key}={values}: {about}")));
        for TissueParameter { name, unit, value, range: [low, high], source } in self.parameters {
            let about = format!("{value} {unit}").trim_end().to_owned();
            lines.push(format!("    {name} {about}, found to be {low} to {high}: {source}"));
        }
        lines
    }
}

/// Prints the lists.
pub fn list(app: &App, args: &ListArgs) -> Result<Exit, Failure> {
    let all = [
        Listed::Scenarios,
        Listed::Controllers,
        Listed::Components,
        Listed::Devices,
        Listed::Plans,
        Listed::Suites,
        Listed::Tissues,
        Listed::Templates,
    ];
    let wanted: Vec<Listed> =
        all.into_iter().filter(|list| args.what.is_none_or(|what| what == *list)).collect();
    if args.json {
        let mut object = serde_json::Map::from_iter([("schema".to_owned(), json!(SCHEMA))]);
        for what in wanted {
            let rows = listings(app, what)?.iter().map(Listing::json).collect::<Result<_, _>>()?;
            object.insert(title(what).to_owned(), Value::Array(rows));
        }
        output::print_json(&Value::Object(object))?;
        return Ok(Exit::Ok);
    }
    let mut lines = Vec::new();
    for what in &wanted {
        if wanted.len() > 1 {
            lines.push(console::style(title(*what)).bold().to_string());
        }
        let rows = listings(app, *what)?;
        let width = rows.iter().map(|row| row.name.chars().count()).max().unwrap_or(0);
        lines.extend(rows.iter().flat_map(|row| row.lines(width)));
        lines.push(String::new());
    }
    output::print_text(&lines.join("\n"))?;
    Ok(Exit::Ok)
}

fn title(what: Listed) -> &'static str {
    match what {
        Listed::Scenarios => "scenarios",
        Listed::Controllers => "controllers",
        Listed::Components => "components",
        Listed::Devices => "devices",
        Listed::Plans => "plans",
        Listed::Suites => "suites",
        Listed::Tissues => "tissues",
        Listed::Templates => "templates",
    }
}

fn listings(app: &App, what: Listed) -> Result<Vec<Listing>, Failure> {
    let pair = |(name, about): (&str, &str)| Listing::new(name, about);
    Ok(match what {
        Listed::Scenarios => {
            let mut rows = Vec::with_capacity(SCENARIOS.len());
            for (name, _) in SCENARIOS {
                rows.push(Listing::new(name, app.scenario(name)?.description));
            }
            rows
        }
        Listed::Controllers => controllers(app)?,
        Listed::Components => app
            .registry()
            .iter()
            .map(|(_, entry)| Listing {
                recorded: Some(entry.record.to_string()),
                ..Listing::new(entry.name, component_about((entry.schema)().as_ref()))
            })
            .collect(),
        Listed::Devices => {
            let device = |(usage, about): (&str, &str)| {
                let options =
                    app.device_options(usage).iter().map(|option| [option.key, option.values, option.about]);
                Listing { options: options.collect(), ..Listing::new(usage, about) }
            };
            app.devices().map(device).collect()
        }
        Listed::Plans => PLANS.iter().map(|(name, text)| Listing::new(*name, plans::about(text))).collect(),
        Listed::Suites => bench::SUITES.into_iter().map(pair).collect(),
        Listed::Tissues => {
            let tissue = |tissue: &TissueEntry| Listing {
                parameters: tissue.parameters,
                ..Listing::new(tissue.name, "")
            };
            TISSUES.iter().map(tissue).collect()
        }
        Listed::Templates => {
            TEMPLATES.iter().map(|template| Listing::new(template.name, template.about)).collect()
        }
    })
}

/// Every kind with its access in the first of our scenarios that uses it.
fn controllers(app: &App) -> Result<Vec<Listing>, Failure> {
    let mut rows: Vec<Listing> = app
        .kinds()
        .map(|kind| {
            let (about, rate_hz) =
                app.kind_info(kind).map_or(("", None), |info| (info.about.as_str(), Some(info.rate_hz)));
            let usage = Usage { rate_hz, reads: Vec::new(), writes: Vec::new() };
            Listing { controller: Some(usage), ..Listing::new(kind, about) }
        })
        .collect();
    let mut scenarios = Vec::with_capacity(2 * SCENARIOS.len());
    for (name, _) in SCENARIOS {
        let scenario = app.scenario(name)?;
        // Some kinds take part only when a person plays.
        let played = trocar::play::played(&scenario).map_err(RunError::from)?;
        scenarios.extend([scenario, played]);
    }
    for scenario in scenarios {
        let accesses = accesses(app, &scenario, &RunOptions::default())?;
        for entry in &scenario.controllers {
            let usage =
                rows.iter_mut().find(|row| row.name == entry.kind).and_then(|row| row.controller.as_mut());
            let access = accesses.iter().find(|(name, ..)| *name == entry.name);
            let (Some(usage), Some((.., access))) = (usage, access) else { continue };
            if usage.reads.is_empty() && usage.writes.is_empty() {
                usage.reads = names(access.reads.iter().copied());
                let written = access.writes.iter().map(|(name, _)| *name);
                usage.writes = names(written.chain(access.contributes.iter().copied()));
            }
        }
    }
    Ok(rows)
}

/// Sorted, without duplicates.
fn names<'a>(names: impl Iterator<Item = &'a str>) -> Vec<String> {
    names.collect::<BTreeSet<_>>().into_iter().map(str::to_owned).collect()
}

/// The first sentence of a component's description.
fn component_about(schema: Option<&Value>) -> String {
    let text = schema.and_then(|schema| schema["description"].as_str()).unwrap_or_default();
    text.split("\n\n").next().unwrap_or_default().replace('\n', " ").replace("\\[", "[").replace("\\]", "]")
}
