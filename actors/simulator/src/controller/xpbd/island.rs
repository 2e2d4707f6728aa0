//! Island of coupled position-based bodies: bodies that have grown onto each other are stepped as one problem.

use nalgebra::Vector3;
use trocar_dynamics::coupling::external_nodes::{
    ExternalNodes, ExternalNodesState, GhostImpulses, GhostNode, NodeContact, Tie,
};
use trocar_dynamics::particles::StepError;
use trocar_dynamics::soft_body::method::Step;

use super::XpbdMethod;
use crate::controller::coupling::fast_side::FastSide;
use crate::xpbd::{Member, XpbdInput, step_together};

/// Offsets of one body's entries in the island's lists: nodes, guests, ties, contacts.
#[derive(Clone, Copy, Default)]
struct ListOffsets {
    node: u32,
    guest: usize,
    tie: usize,
    press: usize,
}

/// All nodes, ties and contacts of the island.
#[derive(Default)]
struct Island {
    guests: Vec<GhostNode>,
    ties: Vec<Tie>,
    presses: Vec<NodeContact>,
    begins: Vec<ListOffsets>,
}

impl Island {
    /// Adds the external nodes of a body.
    fn add(&mut self, company: &ExternalNodes<'_>, node: u32) {
        let Self { guests, ties, presses, begins } = self;
        begins.push(ListOffsets { node, guest: guests.len(), tie: ties.len(), press: presses.len() });
        let first = guests.len() as u32;
        guests.extend_from_slice(company.guests);
        ties.extend(company.ties.iter().map(|tie| Tie {
            node: node + tie.node,
            guests: tie.guests.map(|(guest, weight)| (first + guest, weight)),
            ..*tie
        }));
        presses.extend(company.presses.iter().map(|press| NodeContact {
            node: node + press.node,
            guests: press.guests.map(|(guest, weight)| (first + guest, weight)),
            anchor: press.anchor.map(|(guest, weight)| (first + guest, weight)),
            ..*press
        }));
    }

    fn company(&self) -> ExternalNodes<'_> {
        ExternalNodes { guests: &self.guests, ties: &self.ties, presses: &self.presses }
    }
}

/// Steps coupled bodies. A body with invalid input or a non-finite result keeps its state and reports the error. After
/// invalid input the others wait for the next tick, in which they are stepped without it.
pub(crate) fn step_island(steps: &mut [&mut Step<'_, XpbdMethod>]) {
    let mut island = Island::default();
    let mut node = 0;
    for step in steps.iter_mut() {
        if let Err(reason) = step.method.set_up(step.body, &step.site) {
            step.done = Err(reason);
            return;
        }
        let company = step.method.coupled.as_ref().map(FastSide::company).unwrap_or_default();
        let nodes = step.method.of.solver.masses().len() + 1;
        if let Err(error) = company.check(nodes) {
            step.done = Err(error.to_string());
            return;
        }
        island.add(&company, node);
        node += nodes as u32;
    }
    let own_ties = island.ties.len();
    for (step, begins) in steps.iter().zip(&island.begins) {
        for fused in step.method.coupled.iter().flat_map(FastSide::fused) {
            let other = steps.iter().zip(&island.begins).find(|(other, _)| other.body.entity == fused.entity);
            // A body that was frozen by its solver holds nothing any longer.
            if let Some((other, others)) = other {
                fused.ties(step.body, begins.node, other.body, others.node, &mut island.ties);
            }
        }
    }
    let Some(dt) = steps.first().map(|step| step.site.period_secs()) else { return };
    let mut state = steps.first_mut().map(|step| std::mem::take(&mut step.method.island)).unwrap_or_default();
    let done = step_all(dt, steps, &island, &mut state);
    let moved = state.moved();
    for (index, step) in steps.iter_mut().enumerate() {
        let begins = island.begins[index];
        let ends = island.begins.get(index + 1).copied();
        let ends = ends.unwrap_or(ListOffsets {
            node,
            guest: island.guests.len(),
            tie: own_ties,
            press: island.presses.len(),
        });
        let XpbdMethod { of, coupled, tied, .. } = &mut *step.method;
        match &done {
            Err((failed, error)) if *failed == index => {
                step.done = Err(error.to_string());
                continue;
            }
            // With invalid input no body has been stepped.
            Err(_) if moved.ties.len() != island.ties.len() || moved.guests.len() != island.guests.len() => {
                continue;
            }
            _ => step.done = Ok(()),
        }
        step.forces.clear();
        step.forces.extend_from_slice(of.solver.contact_forces());
        tied.clear();
        let of_body = |node: u32| node.checked_sub(begins.node).filter(|_| node < ends.node);
        let all = island.ties.iter().zip(&moved.ties);
        tied.extend(all.filter_map(|(tie, moved)| Some((of_body(tie.node)?, moved.force))));
        let Some(coupled) = coupled else { continue };
        let own = GhostImpulses {
            guests: moved.guests[begins.guest..ends.guest].to_vec(),
            ties: moved.ties[begins.tie..ends.tie].to_vec(),
            presses: moved.presses[begins.press..ends.press].to_vec(),
        };
        coupled.met(&own, &of.solver.state().positions, dt);
        let fused = island.ties.iter().zip(&moved.ties).skip(own_ties);
        let fused = fused.filter(|(tie, _)| of_body(tie.node).is_some());
        coupled.fused_by(fused.map(|(_, moved): (_, _)| moved.force.norm()).sum());
    }
    if let Some(step) = steps.first_mut() {
        step.method.island = state;
    }
}

fn step_all(
    dt: f64,
    steps: &mut [&mut Step<'_, XpbdMethod>],
    island: &Island,
    state: &mut ExternalNodesState,
) -> Result<(), (usize, StepError)> {
    let mut members: Vec<Member<'_>> = steps
        .iter_mut()
        .map(|step| {
            let XpbdMethod { of, contacts, prescribed, forces, .. } = &mut *step.method;
            let gravity: Vector3<f64> = step.site.gravity;
            let input =
                XpbdInput { gravity, forces, contacts, prescribed, company: ExternalNodes::default() };
            Member { body: &mut of.solver, input }
        })
        .collect();
    step_together(dt, &mut members, &island.company(), state)
}
