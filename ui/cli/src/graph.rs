//! `trocar graph`: draws the actor graph of a scenario with its rates and data flows.

use std::fmt::Write as _;

use trocar::app::App;
use trocar::graph::{ActorGraph, Flow, Node, NodeKind};
use trocar::run::{RunOptions, accesses};
use trocar::summary::Exit;
use trocar_scene::scenario::Scenario;

use crate::args::{GraphArgs, GraphFormat};
use crate::escape::escape;
use crate::failure::Failure;
use crate::live_table::Display;
use crate::report::short;
use crate::startup::{READING, Startup};
use crate::{output, run, signals, tune};

/// Draws a scenario.
pub fn graph(app: &App, args: &GraphArgs) -> Result<Exit, Failure> {
    let startup = Startup::new(&args.session.scenario, READING, false);
    let (scenario, _) = tune::scenario(app, &args.session)?;
    let options = run::options(&args.session)?;
    let mut graph = match args.after {
        Some(seconds) => {
            drop(startup);
            let options = RunOptions { seconds: Some(seconds), ..options };
            let mut display = Display::new(&scenario, &options, false);
            let outcome =
                trocar::run::run(app, &scenario, &options, &mut |progress| display.update(progress));
            display.clear();
            outcome?.graph
        }
        None => {
            startup.stage("the controllers");
            let graph = declared(app, &scenario, &options)?;
            drop(startup);
            graph
        }
    };
    add_devices(&mut graph, &scenario);
    match args.format {
        GraphFormat::Mermaid => output::print_text(&mermaid(&graph))?,
        GraphFormat::Dot => output::print_text(&dot(&graph))?,
        GraphFormat::Json => output::print_json(&graph)?,
    }
    // Rates that were measured for less than was asked.
    Ok(signals::catch()?.arrived().map_or(Exit::Ok, |(_, exit)| exit))
}

/// Every controller's declared access, without a tick.
fn declared(app: &App, scenario: &Scenario, options: &RunOptions) -> Result<ActorGraph, Failure> {
    let accesses = accesses(app, scenario, options)?;
    Ok(ActorGraph::from_access(
        &scenario.name,
        accesses.iter().map(|(name, hz, access)| (name.as_str(), *hz, access)),
    ))
}

/// Devices are outside the scene: their drivers exchange data with haptics directly.
fn add_devices(graph: &mut ActorGraph, scenario: &Scenario) {
    for hand in &scenario.hands {
        let (device, haptics) = (format!("device.{}", hand.name), format!("haptics.{}", hand.name));
        let served = graph.nodes.iter().find(|node| node.name == haptics);
        let Some(rate) = served.map(|node| node.target_hz) else { continue };
        graph.add(&device, NodeKind::Device, None);
        graph.flow(&device, &haptics, vec!["device sample".to_owned()], rate);
        graph.flow(&haptics, &device, vec!["wrench".to_owned()], rate);
    }
}

fn rate(node: &Node) -> String {
    match (node.target_hz, node.achieved_hz) {
        (Some(target), Some(achieved)) => format!("{achieved:.1} of {} Hz", short(target)),
        (Some(target), None) => format!("{} Hz", short(target)),
        (None, _) => String::new(),
    }
}

fn index(graph: &ActorGraph, name: &str) -> Option<usize> {
    graph.nodes.iter().position(|node| node.name == name)
}

fn label(flow: &Flow, line_break: &str) -> String {
    let mut label = flow.components.join(line_break);
    if let Some(hz) = flow.hz {
        let _ = write!(label, "{line_break}{} Hz", short(hz));
    }
    label
}

/// As Mermaid, for Markdown pages.
pub fn mermaid(graph: &ActorGraph) -> String {
    let mut out = String::from("%% Batches go into the Model, snapshots come out of it.\nflowchart LR\n");
    for (i, node) in graph.nodes.iter().enumerate() {
        let (open, close) = match node.kind {
            NodeKind::Model => ("[(", ")]"),
            NodeKind::Controller => ("[", "]"),
            NodeKind::Device => ("([", "])"),
        };
        let text = lines(&[&node.name, &rate(node)]).map(|line| escape_mermaid(&line)).collect::<Vec<_>>();
        let _ = writeln!(out, "    n{i}{open}\"{}\"{close}", text.join("<br/>"));
    }
    for flow in &graph.flows {
        if let (Some(from), Some(to)) = (index(graph, &flow.from), index(graph, &flow.to)) {
            let label: Vec<String> = label(flow, "\n").lines().map(escape_mermaid).collect();
            let _ = writeln!(out, "    n{from} -->|\"{}\"| n{to}", label.join("<br/>"));
        }
    }
    out
}

/// As DOT, for Graphviz.
pub fn dot(graph: &ActorGraph) -> String {
    let mut out = format!(
        "// Batches go into the Model, snapshots come out of it.\ndigraph \"{}\" {{\n    \
         rankdir=LR;\n    node [shape=box, style=rounded, fontname=\"sans-serif\"];\n    \
         edge [fontname=\"sans-serif\", fontsize=10];\n",
        escape_dot(&graph.scenario)
    );
    for (i, node) in graph.nodes.iter().enumerate() {
        let shape = match node.kind {
            NodeKind::Model => ", shape=cylinder, style=bold",
            NodeKind::Controller => "",
            NodeKind::Device => ", shape=ellipse",
        };
        let text = lines(&[&node.name, &rate(node)]).map(|line| escape_dot(&line)).collect::<Vec<_>>();
        let _ = writeln!(out, "    n{i} [label=\"{}\"{shape}];", text.join("\\n"));
    }
    for flow in &graph.flows {
        if let (Some(from), Some(to)) = (index(graph, &flow.from), index(graph, &flow.to)) {
            let label: Vec<String> = label(flow, "\n").lines().map(escape_dot).collect();
            let _ = writeln!(out, "    n{from} -> n{to} [label=\"{}\"];", label.join("\\n"));
        }
    }
    out.push_str("}\n");
    out
}

fn lines<'a>(texts: &'a [&'a str]) -> impl Iterator<Item = String> + 'a {
    texts.iter().filter(|text| !text.is_empty()).map(|text| (*text).to_owned())
}

/// Mermaid takes HTML entities with `#` instead of `&`.
fn escape_mermaid(text: &str) -> String {
    escape(text).replace('#', "").replace('&', "#")
}

fn escape_dot(text: &str) -> String {
    let safe: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    safe.replace('\\', "\\\\").replace('"', "\\\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph() -> ActorGraph {
        let mut graph = ActorGraph { scenario: "s".into(), ..ActorGraph::default() };
        graph.add("model", NodeKind::Model, None);
        graph.add("engine", NodeKind::Controller, Some(500.0));
        graph.add("bad\"]; x[\"", NodeKind::Controller, Some(100.0));
        graph.flow("engine", "model", vec!["pose".into(), "velocity".into()], Some(500.0));
        graph.flow("model", "bad\"]; x[\"", vec!["pose".into()], Some(100.0));
        graph.achieved("engine", 499.9);
        graph
    }

    #[test]
    fn mermaid_has_nodes_rates_and_flows_and_names_cannot_break_out() {
        let text = mermaid(&graph());
        assert!(text.contains("n1[\"engine<br/>499.9 of 500 Hz\"]"), "{text}");
        assert!(text.contains("n0[(\"model\")]"), "{text}");
        assert!(text.contains("n1 -->|\"pose<br/>velocity<br/>500 Hz\"| n0"), "{text}");
        assert!(text.contains("n0 -->|\"pose<br/>100 Hz\"| n2"), "{text}");
        assert!(!text.contains("bad\"]"), "{text}");
    }

    #[test]
    fn dot_has_nodes_rates_and_flows_and_names_cannot_break_out() {
        let text = dot(&graph());
        assert!(text.contains("n1 [label=\"engine\\n499.9 of 500 Hz\"];"), "{text}");
        assert!(text.contains("n0 [label=\"model\", shape=cylinder"), "{text}");
        assert!(text.contains("n0 -> n2 [label=\"pose\\n100 Hz\"];"), "{text}");
        assert!(text.contains("bad\\\"]; x[\\\""), "{text}");
        assert!(text.trim_end().ends_with('}'));
    }
}
