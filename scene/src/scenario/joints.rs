//! Joints of a scenario: each has a body that moves, and leads to another body or to a point of the world.

use std::collections::BTreeMap;

use toml::Spanned;

use super::document::{Table, named_in};
use super::error::ScenarioError;
use crate::component::Component;
use crate::components::{Joints, Motion, RigidBody};
use crate::entity::{Entity, with_entity_names};

/// Refuses joints that join nothing.
pub(super) fn check(root: &Table, names: &BTreeMap<String, Entity>) -> Result<(), ScenarioError> {
    with_entity_names(names.clone(), || check_all(root, names))
}

fn check_all(root: &Table, names: &BTreeMap<String, Entity>) -> Result<(), ScenarioError> {
    let tables = root.tables("entity")?;
    if tables.iter().all(|(_, table)| table.get(Joints::NAME).is_none()) {
        return Ok(());
    }
    let mut bodies: BTreeMap<Entity, (&str, Motion)> = BTreeMap::new();
    for (span, table) in &tables {
        let table = Table::new(root.source, "entity", span.clone(), table);
        let name = table.string("name")?.map_or("", |(name, _)| name);
        if let (Some(entity), Some(body)) = (names.get(name), table.value::<RigidBody>(RigidBody::NAME)?) {
            bodies.insert(*entity, (name, body.motion));
        }
    }
    for (span, table) in tables {
        let Some(value) = table.get(Joints::NAME) else { continue };
        let table = Table::new(root.source, "entity", span, table);
        let name = table.string("name")?.map_or("", |(name, _)| name);
        let key = format!("entity '{name}'");
        let table = Table { key: &key, ..table };
        let Some(own) = names.get(name) else { continue };
        let joints = table.value::<Joints>(Joints::NAME)?.unwrap_or_default();
        for (index, joint) in joints.0.iter().enumerate() {
            // The place of this joint among several.
            let at = value.get_ref().get(index).unwrap_or(value);
            joined(*own, joint.to, &bodies, names).map_err(|reason| {
                let span = named_in(at, &reason).unwrap_or_else(|| Spanned::span(at));
                table.error(span, Joints::NAME, reason)
            })?;
        }
    }
    Ok(())
}

/// Whether a joint of a body joins anything.
fn joined(
    own: Entity,
    to: Option<Entity>,
    bodies: &BTreeMap<Entity, (&str, Motion)>,
    names: &BTreeMap<String, Entity>,
) -> Result<(), String> {
    let name_of = |of: Entity| names.iter().find(|(_, entity)| **entity == of).map_or("", |(name, _)| name);
    let Some((_, motion)) = bodies.get(&own) else {
        return Err(format!("a joint is of a rigid body: give '{}' a 'rigid_body'", name_of(own)));
    };
    let Some(to) = to else {
        return match motion {
            Motion::Dynamic => Ok(()),
            _ => Err(format!(
                "'{}' does not move by forces, nor does a point of the world: make its 'motion' \"dynamic\", or let 'to' \
                 name a body that is",
                name_of(own)
            )),
        };
    };
    if to == own {
        return Err(format!(
            "'to' leads from '{}' to itself: another rigid body is valid, or none",
            name_of(own)
        ));
    }
    match bodies.get(&to) {
        None => {
            let others: Vec<&str> =
                bodies.iter().filter(|(body, _)| **body != own).map(|(_, (name, _))| *name).collect();
            Err(format!("'{}' is no rigid body; there are: {}", name_of(to), others.join(", ")))
        }
        Some((_, Motion::Static | Motion::Kinematic)) if *motion != Motion::Dynamic => Err(format!(
            "neither '{}' nor '{}' moves by forces: one of the two needs 'motion' \"dynamic\"",
            name_of(own),
            name_of(to)
        )),
        Some(_) => Ok(()),
    }
}
