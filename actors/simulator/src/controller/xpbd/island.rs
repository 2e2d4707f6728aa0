//! Island of coupled position-based bodies: bodies that have grown onto each other are stepped as one problem.

use nalgebra::Vector3;
use trocar_dynamics::coupling::external_nodes::{
    ExternalNodes, ExternalNodesState, GhostImpulses, GhostNode, NodeContact, Tie,
};
use trocar_dynamics::particles::StepError;
use trocar_dynamics::soft_body::jaw_friction::JawFriction;
use trocar_dynamics::soft_body::method::Step;

use super::{XpbdMethod, is_loaded};
use crate::controller::coupling::fast_side::FastSide;
use crate::xpbd::{Member, XpbdInput, step_together};

/// Offsets of one body's entries in the island's lists: nodes, ghost nodes, ties, contacts.
#[derive(Clone, Copy, Default)]
struct ListOffsets {
    node: u32,
    ghost_node: usize,
    tie: usize,
    press: usize,
}

/// All nodes, ties and contacts of the island.
#[derive(Default)]
struct Island {
    ghost_nodes: Vec<GhostNode>,
    ties: Vec<Tie>,
    presses: Vec<NodeContact>,
    begins: Vec<ListOffsets>,
}

impl Island {
    /// Adds the external nodes of a body.
    fn add(&mut self, external_nodes: &ExternalNodes<'_>, node: u32) {
        let Self { ghost_nodes, ties, presses, begins } = self;
        begins.push(ListOffsets {
            node,
            ghost_node: ghost_nodes.len(),
            tie: ties.len(),
            press: presses.len(),
        });
        let first = ghost_nodes.len() as u32;
        ghost_nodes.extend_from_slice(external_nodes.ghost_nodes);
        ties.extend(external_nodes.ties.iter().map(|tie| Tie {
            node: node + tie.node,
            ghost_nodes: tie.ghost_nodes.map(|(ghost_node, weight)| (first + ghost_node, weight)),
            ..*tie
        }));
        presses.extend(external_nodes.presses.iter().map(|press| NodeContact {
            node: node + press.node,
            ghost_nodes: press.ghost_nodes.map(|(ghost_node, weight)| (first + ghost_node, weight)),
            anchor: press.anchor.map(|(ghost_node, weight)| (first + ghost_node, weight)),
            ..*press
        }));
    }

    fn external_nodes(&self) -> ExternalNodes<'_> {
        ExternalNodes { ghost_nodes: &self.ghost_nodes, ties: &self.ties, presses: &self.presses }
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
        let external_nodes = step.method.coupled.as_ref().map(FastSide::external_nodes).unwrap_or_default();
        let nodes = step.method.of.solver.masses().len() + 1;
        if let Err(error) = external_nodes.check(nodes) {
            step.done = Err(error.to_string());
            return;
        }
        island.add(&external_nodes, node);
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
            ghost_node: island.ghost_nodes.len(),
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
            Err(_)
                if moved.ties.len() != island.ties.len()
                    || moved.ghost_nodes.len() != island.ghost_nodes.len() =>
            {
                continue;
            }
            _ => step.done = Ok(()),
        }
        step.forces.clear();
        step.forces.extend_from_slice(of.solver.contact_forces());
        let rigid = step.site.rigid.contacts.iter().zip(of.solver.rigid_forces(dt));
        step.forces.extend(rigid.map(|(contact, force)| contact.normal * force));
        tied.clear();
        let of_body = |node: u32| node.checked_sub(begins.node).filter(|_| node < ends.node);
        let all = island.ties.iter().zip(&moved.ties);
        tied.extend(all.filter_map(|(tie, moved)| Some((of_body(tie.node)?, moved.force))));
        let Some(coupled) = coupled else { continue };
        let own = GhostImpulses {
            ghost_nodes: moved.ghost_nodes[begins.ghost_node..ends.ghost_node].to_vec(),
            ties: moved.ties[begins.tie..ends.tie].to_vec(),
            presses: moved.presses[begins.press..ends.press].to_vec(),
        };
        coupled.end_step(&own, &of.solver.state().positions, dt);
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
            let XpbdMethod { of, contacts, prescribed, forces, grips, bearing_substep, .. } =
                &mut *step.method;
            let jaws = JawFriction { grips, limits: step.site.grip_limits };
            let gravity: Vector3<f64> = step.site.gravity;
            let (rigid, external_nodes) = (step.site.rigid, ExternalNodes::default());
            let parts_min = if rigid.contacts.is_empty() { 0 } else { (dt / *bearing_substep).ceil() as u32 };
            let input = XpbdInput {
                gravity,
                forces,
                contacts,
                prescribed,
                rigid,
                parts_min,
                external_nodes,
                jaws,
                direct: is_loaded(&step.site),
            };
            Member { body: &mut of.solver, input }
        })
        .collect();
    step_together(dt, &mut members, &island.external_nodes(), state)
}
