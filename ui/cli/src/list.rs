//! `trocar list`: what a scenario or a command line can name.

use serde_json::{Value, json};
use trocar::app::{App, SCENARIOS};
use trocar::plans::{self, PLANS};
use trocar::summary::{Exit, SCHEMA};

use crate::args::{ListArgs, Listed};
use crate::bench;
use crate::failure::Failure;
use crate::output;

/// Devices by the text that names them, and what they are.
const DEVICES: [(&str, &str); 4] = [
    ("virtual", "a virtual hand: the inertia and limits of a Phantom Omni, and a human arm"),
    ("replay:FILE", "hand motion from CSV: t,x,y,z,qw,qx,qy,qz,gripper"),
    ("jigsaws:FILE", "hand motion from JIGSAWS kinematics"),
    ("recording:FILE", "the same hand as in a recording of this program"),
];

/// Prints the lists.
pub fn list(app: &App, args: &ListArgs) -> Result<Exit, Failure> {
    let all = [
        Listed::Scenarios,
        Listed::Controllers,
        Listed::Components,
        Listed::Devices,
        Listed::Plans,
        Listed::Suites,
    ];
    let wanted: Vec<Listed> =
        all.into_iter().filter(|list| args.what.is_none_or(|what| what == *list)).collect();
    if args.json {
        let mut object = serde_json::Map::from_iter([("schema".to_owned(), json!(SCHEMA))]);
        for what in wanted {
            let rows = rows(app, what)?;
            let rows = rows.into_iter().map(|(name, about)| json!({ "name": name, "about": about }));
            object.insert(title(what).to_owned(), Value::Array(rows.collect()));
        }
        output::print_json(&Value::Object(object))?;
        return Ok(Exit::Ok);
    }
    let mut lines = Vec::new();
    for what in &wanted {
        if wanted.len() > 1 {
            lines.push(console::style(title(*what)).bold().to_string());
        }
        let rows = rows(app, *what)?;
        let width = rows.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        lines.extend(
            rows.iter().map(|(name, about)| format!("  {name:<width$}  {about}").trim_end().to_owned()),
        );
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
    }
}

fn rows(app: &App, what: Listed) -> Result<Vec<(String, String)>, Failure> {
    let pair = |(name, about): (&str, &str)| (name.to_owned(), about.to_owned());
    Ok(match what {
        Listed::Scenarios => {
            let mut rows = Vec::with_capacity(SCENARIOS.len());
            for (name, _) in SCENARIOS {
                let scenario = app.scenario(name)?;
                rows.push((name.to_owned(), scenario.description.clone()));
            }
            rows
        }
        Listed::Controllers => app.kinds().map(|kind| (kind.to_owned(), String::new())).collect(),
        Listed::Components => app
            .registry()
            .iter()
            .map(|(_, entry)| (entry.name.to_owned(), component_about((entry.schema)().as_ref())))
            .collect(),
        Listed::Devices => DEVICES.into_iter().map(pair).collect(),
        Listed::Plans => {
            PLANS.iter().map(|(name, text)| ((*name).to_owned(), plans::about(text).to_owned())).collect()
        }
        Listed::Suites => bench::SUITES.into_iter().map(pair).collect(),
    })
}

/// The first sentence of a component's description.
fn component_about(schema: Option<&Value>) -> String {
    let text = schema.and_then(|schema| schema["description"].as_str()).unwrap_or_default();
    text.split("\n\n").next().unwrap_or_default().replace('\n', " ").replace("\\[", "[").replace("\\]", "]")
}
