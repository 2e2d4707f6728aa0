//! Who acts in a session and what flows between them, from what everyone declares: the figure of the
//! framework, drawn by the program.

use serde::{Deserialize, Serialize};
use trocar_scene::Access;

/// What a node is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum NodeKind {
    /// The owner of the scene.
    Model,
    /// Something that reads snapshots and writes commands at a rate of its own.
    Controller,
    /// A device in a hand, with its driver.
    Device,
}

/// One actor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Node {
    /// Its name, unique in the graph.
    pub name: String,
    /// What it is.
    pub kind: NodeKind,
    /// Ticks per second that it should make; `None` for who is woken by messages.
    pub target_hz: Option<f64>,
    /// Ticks per second that it made; `None` before a run.
    pub achieved_hz: Option<f64>,
}

/// What flows from one actor to another.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Flow {
    /// Writer.
    pub from: String,
    /// Reader.
    pub to: String,
    /// NAMEs of the components, in order.
    pub components: Vec<String>,
    /// Exchanges per second: the slower of the two rates; `None` when neither has one.
    pub hz: Option<f64>,
}

/// Actors and flows of a session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ActorGraph {
    /// Name of the scenario.
    pub scenario: String,
    /// Actors in the order in which they were added.
    pub nodes: Vec<Node>,
    /// Flows, by writer and reader in the order of `nodes`.
    pub flows: Vec<Flow>,
}

impl ActorGraph {
    /// The controllers of a scenario (name, rate in Hz, access) with the Model between them.
    ///
    /// A component that one writes (or contributes) and another reads flows from the one to the other,
    /// through the Model; a controller that reads what it wrote itself is no flow.
    pub fn from_access<'a>(
        scenario: impl Into<String>,
        controllers: impl IntoIterator<Item = (&'a str, f64, &'a Access)>,
    ) -> Self {
        let controllers: Vec<_> = controllers.into_iter().collect();
        let mut graph = Self { scenario: scenario.into(), ..Self::default() };
        graph.add("model", NodeKind::Model, None);
        for (name, hz, _) in &controllers {
            graph.add(name, NodeKind::Controller, Some(*hz));
        }
        for (from, from_hz, writer) in &controllers {
            for (to, to_hz, reader) in controllers.iter().filter(|(to, ..)| to != from) {
                let written = writer.writes.iter().map(|(name, _)| *name).chain(writer.contributes.clone());
                let mut components: Vec<String> =
                    written.filter(|name| reader.reads.contains(name)).map(str::to_owned).collect();
                components.sort_unstable();
                components.dedup();
                if !components.is_empty() {
                    graph.flow(from, to, components, Some(from_hz.min(*to_hz)));
                }
            }
        }
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

    /// Notes the rate that an actor reached.
    pub fn achieved(&mut self, name: &str, hz: f64) {
        if let Some(node) = self.nodes.iter_mut().find(|node| node.name == name) {
            node.achieved_hz = Some(hz);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::{CollisionList, EntitySet, HandTarget, Pose};

    #[test]
    fn what_one_writes_and_another_reads_flows_at_the_slower_rate() {
        let engine =
            Access::new().reads::<HandTarget>().writes::<Pose>(EntitySet::All).contributes::<CollisionList>();
        let pilot =
            Access::new().reads::<Pose>().reads::<CollisionList>().writes::<HandTarget>(EntitySet::All);
        let graph = ActorGraph::from_access("x", [("engine", 500.0, &engine), ("autopilot", 100.0, &pilot)]);
        assert_eq!(graph.nodes.len(), 3);
        assert_eq!(graph.flows.len(), 2);
        assert_eq!(graph.flows[0].components, ["collision_list", "pose"]);
        assert_eq!((graph.flows[0].to.as_str(), graph.flows[0].hz), ("autopilot", Some(100.0)));
        assert_eq!(graph.flows[1].components, ["hand_target"]);
    }
}
