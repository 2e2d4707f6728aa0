//! The actor graph of a session: its actors and the data flows between them, from their declared access.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};
use trocar_kernel::spec::MODEL;
use trocar_scene::Access;

/// What a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeKind {
    /// The owner of the scene.
    Model,
    /// A controller: reads snapshots and writes commands at its own rate.
    Controller,
    /// A haptic device with its driver.
    Device,
}

/// One actor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Its name, unique in the graph.
    pub name: String,
    /// What it is.
    pub kind: NodeKind,
    /// Target ticks per second; `None` for an actor that messages wake.
    pub target_hz: Option<f64>,
    /// Achieved ticks per second; `None` before a run.
    pub achieved_hz: Option<f64>,
}

/// A data flow from one actor to another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flow {
    /// Writer.
    pub from: String,
    /// Reader.
    pub to: String,
    /// NAMEs of the components, in order.
    pub components: Vec<String>,
    /// Exchanges per second, at the rate of the ticked end; `None` when neither end has a rate.
    pub hz: Option<f64>,
}

/// Actors and flows of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActorGraph {
    /// Name of the scenario.
    pub scenario: String,
    /// Actors in the order in which they were added.
    pub nodes: Vec<Node>,
    /// Flows: for each actor in the order of `nodes` its outputs, then its inputs.
    pub flows: Vec<Flow>,
}

impl ActorGraph {
    /// The controllers of a scenario (name, rate in Hz, access) around the Model.
    ///
    /// Each controller sends the Model the components that it writes or contributes, and receives from snapshots those
    /// that it reads and others write, each at its own rate. Components that no controller writes are constant and give
    /// no flow.
    pub fn from_access<'a>(
        scenario: impl Into<String>,
        controllers: impl IntoIterator<Item = (&'a str, f64, &'a Access)>,
    ) -> Self {
        let controllers: Vec<_> = controllers.into_iter().collect();
        let mut graph = Self { scenario: scenario.into(), ..Self::default() };
        graph.add(MODEL, NodeKind::Model, None);
        for (name, hz, _) in &controllers {
            graph.add(name, NodeKind::Controller, Some(*hz));
        }
        for (name, hz, access) in &controllers {
            graph.flow(name, MODEL, to_strings(written_names(access).collect()), Some(*hz));
            let others = controllers.iter().filter(|(other, ..)| other != name);
            let moving: BTreeSet<&str> = others.flat_map(|(.., access)| written_names(access)).collect();
            let read: BTreeSet<&str> =
                access.reads.iter().copied().filter(|name| moving.contains(name)).collect();
            graph.flow(MODEL, name, to_strings(read), Some(*hz));
        }
        graph.flows.retain(|flow| !flow.components.is_empty());
        graph
    }

    /// Adds an actor.
    pub fn add(&mut self, name: &str, kind: NodeKind, target_hz: Option<f64>) {
        self.nodes.push(Node { name: name.to_owned(), kind, target_hz, achieved_hz: None });
    }

    /// Adds a flow.
    pub fn flow(&mut self, from: &str, to: &str, components: Vec<String>, hz: Option<f64>) {
        self.flows.push(Flow { from: from.to_owned(), to: to.to_owned(), components, hz });
    }

    /// Sets the achieved rate of an actor.
    pub fn achieved(&mut self, name: &str, hz: f64) {
        if let Some(node) = self.nodes.iter_mut().find(|node| node.name == name) {
            node.achieved_hz = Some(hz);
        }
    }
}

/// NAMEs of the components that a controller writes or contributes.
fn written_names(access: &Access) -> impl Iterator<Item = &'static str> + '_ {
    access.writes.iter().map(|(name, _)| *name).chain(access.contributes.iter().copied())
}

fn to_strings(names: BTreeSet<&str>) -> Vec<String> {
    names.into_iter().map(str::to_owned).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{CollisionList, EntitySet, HandTarget, Pose, Shape};

    #[test]
    fn everything_passes_the_model_and_each_controller_exchanges_at_its_own_rate() {
        let engine = Access::new()
            .reads::<HandTarget>()
            .reads::<Shape>()
            .reads::<Pose>()
            .writes::<Pose>(EntitySet::All)
            .contributes::<CollisionList>();
        let pilot =
            Access::new().reads::<Pose>().reads::<CollisionList>().writes::<HandTarget>(EntitySet::All);
        let idle = Access::new();
        let all = [("engine", 500.0, &engine), ("autopilot", 100.0, &pilot), ("idle", 1.0, &idle)];
        let graph = ActorGraph::from_access("x", all);
        assert_eq!(graph.nodes.len(), 4);
        let flows: Vec<(&str, &str, Vec<&str>, Option<f64>)> = graph
            .flows
            .iter()
            .map(|f| (&*f.from, &*f.to, f.components.iter().map(String::as_str).collect(), f.hz))
            .collect();
        // Components that only the engine itself writes, or that are constant, give no flow to it.
        assert_eq!(
            flows,
            [
                ("engine", "model", vec!["collision_list", "pose"], Some(500.0)),
                ("model", "engine", vec!["hand_target"], Some(500.0)),
                ("autopilot", "model", vec!["hand_target"], Some(100.0)),
                ("model", "autopilot", vec!["collision_list", "pose"], Some(100.0)),
            ]
        );
    }
}
