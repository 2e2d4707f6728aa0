//! The supervisor tree for the window's panel.

use std::collections::BTreeMap;

use trocar::session::Session;
use trocar_kernel::runtime::ControllerReport;
use trocar_kernel::supervision::{Exhausted, GroupSpec, Intensity, Node};
use trocar_viewer::window::subject::Actor;

/// All actors, below their supervisors, with rates and health.
pub fn actors(session: &Session) -> Vec<Actor> {
    let known = Known {
        health: session.health().into_iter().collect(),
        rates: session.reports().into_iter().map(|row| (row.name.clone(), row)).collect(),
    };
    below(&session.tree(), &known)
}

/// Known data of the actors, by name.
struct Known {
    health: BTreeMap<String, &'static str>,
    rates: BTreeMap<String, ControllerReport>,
}

impl Known {
    fn actor(&self, name: &str, depth: usize) -> Actor {
        let health = self.health.get(name).copied().unwrap_or_default().to_owned();
        let actor = Actor { name: name.to_owned(), depth, health, ..Actor::default() };
        let Some(row) = self.rates.get(name) else { return actor };
        Actor {
            // An actor that messages wake has no rate.
            hz: (row.target_hz > 0.0).then_some([row.target_hz, row.achieved_hz]),
            on_time: row.on_time,
            late_us: [row.lateness_us.p50, row.lateness_us.p99],
            step_us: [row.step_us.p50, row.step_us.p99],
            missed: row.missed,
            restarts: u64::from(row.restarts),
            ..actor
        }
    }
}

fn below(tree: &GroupSpec, known: &Known) -> Vec<Actor> {
    let mut actors = vec![supervisor(tree, 0)];
    for (depth, node) in tree.walk() {
        actors.push(match node {
            Node::Group(group) => supervisor(group, depth),
            Node::Child(child) => known.actor(&child.id, depth),
        });
    }
    // A supervisor is as healthy as the worst of its children. Children come later in the list, so it is walked
    // backwards.
    for index in
        (0..actors.len()).rev().filter(|index| actors[*index].supervises.is_some()).collect::<Vec<_>>()
    {
        let depth = actors[index].depth;
        let own = actors[index + 1..].iter().take_while(|actor| actor.depth > depth);
        let worst = own.max_by_key(|actor| severity(&actor.health)).map(|actor| actor.health.clone());
        actors[index].health = worst.unwrap_or_default();
    }
    // Actors without a supervisor.
    let names = known.health.keys().chain(known.rates.keys());
    let mut others: Vec<&String> =
        names.filter(|name| actors.iter().all(|actor| actor.name != **name)).collect();
    others.sort();
    others.dedup();
    actors.extend(others.into_iter().map(|name| known.actor(name, 0)).collect::<Vec<_>>());
    actors
}

fn supervisor(group: &GroupSpec, depth: usize) -> Actor {
    let Intensity { restarts, period } = group.intensity;
    let then = match group.exhausted {
        Exhausted::Escalate => "gives up",
        Exhausted::Hold => "holds",
    };
    let within = period.as_secs_f64();
    let how = format!("{}; {then} after {restarts} in {within:.0} s", group.strategy.name());
    let name = group.id.strip_prefix("group.").unwrap_or(&group.id).to_owned();
    Actor { name, depth, supervises: Some(how), ..Actor::default() }
}

/// How bad a state is.
fn severity(health: &str) -> usize {
    let order = ["", "stopped", "healthy", "starting", "late", "restarting", "stalled", "held", "failed"];
    order.iter().position(|known| *known == health).unwrap_or(order.len())
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_kernel::supervision::{ChildSpec, RuntimeClass};

    #[test]
    fn everybody_stands_below_their_supervisor_which_is_as_well_as_the_worst_of_them() {
        let child = |name: &str, class| ChildSpec::new(name, class, 100.0);
        let tree = GroupSpec::default_tree([
            child("engine", RuntimeClass::Simulation),
            child("haptics.left", RuntimeClass::Haptics),
            child("haptics.right", RuntimeClass::Haptics),
            child("model", RuntimeClass::Model),
        ]);
        let health = [("engine", "healthy"), ("haptics.left", "held"), ("haptics.right", "late")];
        let health = health.into_iter().chain([("model", "healthy"), ("a-plain-actor", "healthy")]);
        let known = Known {
            health: health.map(|(name, is)| (name.to_owned(), is)).collect(),
            rates: BTreeMap::new(),
        };
        let rows: Vec<(String, usize, String)> =
            below(&tree, &known).into_iter().map(|actor| (actor.name, actor.depth, actor.health)).collect();
        let rows: Vec<(&str, usize, &str)> =
            rows.iter().map(|(a, b, c)| (a.as_str(), *b, c.as_str())).collect();
        assert_eq!(
            rows,
            [
                ("root", 0, "held"),
                ("model", 1, "healthy"),
                ("model", 2, "healthy"),
                ("simulation", 1, "healthy"),
                ("engine", 2, "healthy"),
                ("devices", 1, "held"),
                ("haptics.left", 2, "held"),
                ("haptics.right", 2, "late"),
                ("a-plain-actor", 0, "healthy"),
            ]
        );
    }
}
