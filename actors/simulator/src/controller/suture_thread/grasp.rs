//! Grasps of a thread. Closing jaws take the thread if both touch it, hold its nodes in the instrument's frame, and
//! release when they open. Jaws that have closed on nothing act as a blunt rod, as in [`trocar_dynamics::picking`]:
//! they take nothing until they have opened. Hand and thread are coupled by the compliance of the instrument
//! (`coupling_stiffness`); a pull beyond the friction of both pads slips through the jaws.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_collision::primitive::closest_segments;
use trocar_dynamics::soft_body::jaws::{AT_REST, CLOSED, holds, opening};
use trocar_scene::{Entity, Instrument, Snapshot};

use super::obstacles::{ObstacleParts, between};
use crate::suture_thread::{Hold, IgnoredObstacle, ThreadState, TwistHold};

/// Jaws that open by more than this beyond their opening at the grasp, or beyond closed, release \[rad\].
const OPENING: f64 = 0.05;
/// Length of thread on either side of a grasp that does not collide with those jaws \[m\].
pub(crate) const SPARED: f64 = 8e-3;
/// Maximum number of edges between those that touch one jaw and those that touch the other.
const BESIDE: usize = 2;

/// A held node.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldNode {
    /// The node.
    pub node: u32,
    /// Its position in the instrument's frame \[m\].
    pub in_instrument: Point3<f64>,
}

/// An edge whose twist is held.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldEdge {
    /// The edge.
    pub edge: u32,
    /// Direction of its director in the instrument's frame.
    pub in_instrument: Vector3<f64>,
}

/// The grasp of one instrument; empty if its jaws have closed on nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grip {
    /// The instrument.
    pub instrument: Entity,
    /// Opening of its jaws at the grasp \[rad\].
    pub angle: f64,
    /// Ascending.
    pub nodes: Vec<HeldNode>,
    /// Ascending.
    pub edges: Vec<HeldEdge>,
}

impl Grip {
    /// Whether its jaws have closed on nothing.
    #[must_use]
    pub fn is_shut(&self) -> bool {
        self.nodes.is_empty()
    }

    /// First and last held node.
    fn range(&self) -> Option<[usize; 2]> {
        Some([self.nodes.first()?.node as usize, self.nodes.last()?.node as usize])
    }
}

/// Releases and takes grasps of a thread of `radius` \[m\] in this tick of `period` \[s\]; `busy` instruments take
/// nothing. Returns whether anything has changed.
pub fn update(
    grips: &mut Vec<Grip>,
    parts: &ObstacleParts,
    scene: &Snapshot,
    state: &ThreadState,
    radius: f64,
    period: f64,
    busy: &[Entity],
) -> bool {
    let mut changed = false;
    grips.retain(|grip| {
        let [angle, _] = opening(scene, grip.instrument);
        let opened = if grip.is_shut() { CLOSED } else { CLOSED.max(grip.angle) + OPENING };
        let stays = scene.get::<Instrument>(grip.instrument).is_some() && angle <= opened;
        changed |= !stays && !grip.is_shut();
        stays
    });
    for (entity, instrument) in scene.iter::<Instrument>() {
        let is_known = busy.contains(&entity) || grips.iter().any(|grip| grip.instrument == entity);
        if !holds(instrument.kind) || is_known {
            continue;
        }
        let [angle, rate] = opening(scene, entity);
        if angle > CLOSED && rate >= 0.0 {
            continue;
        }
        // What the jaws reach within this tick counts as between them already.
        let way = rate.abs() * instrument.jaw_length * period;
        if let Some(grip) = taken(grips, parts, entity, angle, (state, radius), way) {
            grips.push(grip);
            changed = true;
        } else if angle <= CLOSED && rate > -AT_REST {
            grips.push(Grip { instrument: entity, angle, nodes: Vec::new(), edges: Vec::new() });
        }
    }
    changed
}

/// The part of the thread between the jaws that touches both, or will after they have moved by `way` \[m\].
fn taken(
    grips: &[Grip],
    parts: &ObstacleParts,
    entity: Entity,
    angle: f64,
    (state, radius): (&ThreadState, f64),
    way: f64,
) -> Option<Grip> {
    let ([_, pose], [Some(a), Some(b)]) = parts.instrument(entity)? else { return None };
    let edges = state.rest_lengths.len();
    let joined = |edge: &usize| state.joins(*edge);
    let touched = [(a, -1.0), (b, 1.0)].map(|(jaw, inwards)| {
        let Some(rod) = parts.list[jaw].rod else { return Vec::new() };
        let touches = |edge: &usize| {
            let segment = [*edge, state.after(*edge)].map(|node| state.positions[node]);
            let nearest = closest_segments(&segment, &rod.ends);
            let distance = nearest.distance_squared.sqrt();
            let [on_thread, on_jaw] = nearest.along;
            let away = segment[0].lerp(&segment[1], on_thread) - rod.ends[0].lerp(&rod.ends[1], on_jaw);
            // On the side of the other jaw.
            let between = pose.rotation.inverse_transform_vector(&away).x * inwards > 0.7 * distance;
            between && distance - rod.radius - radius < 0.2 * radius + way
        };
        (0..edges).filter(joined).filter(touches).collect::<Vec<usize>>()
    });
    let [first, second] = touched;
    let apart = |a: usize, b: usize| {
        let along = a.abs_diff(b);
        if state.is_closed() { along.min(edges - along) } else { along }
    };
    let beside = |edge: &usize, others: &[usize]| others.iter().any(|other| apart(*other, *edge) <= BESIDE);
    let mut nodes: Vec<usize> = Vec::new();
    for edge in first
        .iter()
        .filter(|edge| beside(edge, &second))
        .chain(second.iter().filter(|edge| beside(edge, &first)))
    {
        nodes.extend([*edge, state.after(*edge)]);
    }
    nodes.sort_unstable();
    nodes.dedup();
    nodes.retain(|node| !grips.iter().any(|grip| grip.nodes.iter().any(|held| held.node as usize == *node)));
    if nodes.is_empty() {
        return None;
    }
    let edge = |edge: usize| {
        let end = state.after(edge);
        (state.joins(edge) && nodes.binary_search(&end).is_ok()).then_some(())?;
        let in_instrument = pose.rotation.inverse_transform_vector(&state.directors[edge]);
        Some(HeldEdge { edge: edge as u32, in_instrument })
    };
    let held = |node: &usize| HeldNode {
        node: *node as u32,
        in_instrument: pose.inverse_transform_point(&state.positions[*node]),
    };
    let edges = nodes.iter().copied().filter_map(edge).collect();
    Some(Grip { instrument: entity, angle, nodes: nodes.iter().map(held).collect(), edges })
}

/// The grasps as constraints of one solver step.
#[derive(Clone, Debug, Default)]
pub struct GraspConstraints {
    /// Prescribed nodes, grasp by grasp.
    pub holds: Vec<Hold>,
    /// Edges with a prescribed twist.
    pub twist_holds: Vec<TwistHold>,
    /// Parts of the thread that do not collide with the jaws that hold them.
    pub spared: Vec<IgnoredObstacle>,
}

/// Stiffness and maximum force of a grasp on each of its nodes \[N/m\], \[N\].
fn strength(instrument: &Instrument, grip: &Grip) -> (f64, f64) {
    let share = 1.0 / grip.nodes.len().max(1) as f64;
    let friction = 2.0 * instrument.jaw_friction * instrument.jaw_force_max;
    (instrument.coupling_stiffness * share, friction * share)
}

impl GraspConstraints {
    /// Adds the constraints of the grasps at a fraction of the tick.
    pub fn add(&mut self, grips: &[Grip], parts: &ObstacleParts, scene: &Snapshot, fraction: f64) {
        for grip in grips {
            let (Some(([from, to], _)), Some(instrument)) =
                (parts.instrument(grip.instrument), scene.get::<Instrument>(grip.instrument))
            else {
                continue;
            };
            let pose = between(&from, &to, fraction);
            let (stiffness, force_max) = strength(instrument, grip);
            self.holds.extend(grip.nodes.iter().map(|held| Hold {
                node: held.node as usize,
                to: pose * held.in_instrument,
                stiffness,
                force_max,
            }));
            self.twist_holds.extend(grip.edges.iter().map(|held| TwistHold {
                edge: held.edge as usize,
                director: pose.rotation * held.in_instrument,
            }));
        }
    }

    /// Exempts the first `length` \[m\] of the thread from collisions with an instrument.
    pub fn exempt_beginning(
        &mut self,
        instrument: Entity,
        length: f64,
        parts: &ObstacleParts,
        state: &ThreadState,
    ) {
        let mut arc = 0.0;
        let edges = state.rest_lengths.iter().take_while(|rest| {
            arc += **rest;
            arc < length
        });
        let Some(last) = edges.count().checked_sub(1) else { return };
        let own = parts.list.iter().enumerate().filter(|(_, part)| part.met.entity == instrument);
        self.spared.extend(own.map(|(obstacle, _)| IgnoredObstacle { obstacle, edges: [0, last] }));
    }

    /// Exempts the held parts from collisions with the jaws that hold them.
    pub fn exempt_held(&mut self, grips: &[Grip], parts: &ObstacleParts, state: &ThreadState) {
        self.spared.clear();
        for grip in grips {
            let (Some((_, jaws)), Some([first, last])) = (parts.instrument(grip.instrument), grip.range())
            else {
                continue;
            };
            if state.is_closed() {
                for edges in runs(&spared_around(grip, state)) {
                    for obstacle in jaws.into_iter().flatten() {
                        self.spared.push(IgnoredObstacle { obstacle, edges });
                    }
                }
                continue;
            }
            let reach = |edges: &mut dyn Iterator<Item = usize>| {
                let mut arc = 0.0;
                edges
                    .take_while(|edge| {
                        if !state.joins(*edge) {
                            return false;
                        }
                        arc += state.rest_lengths[*edge];
                        arc < SPARED
                    })
                    .last()
            };
            let edges = [
                reach(&mut (0..first).rev()).unwrap_or(first.min(state.rest_lengths.len() - 1)),
                reach(&mut (last..state.rest_lengths.len())).unwrap_or(last.max(1) - 1),
            ];
            for obstacle in jaws.into_iter().flatten() {
                self.spared.push(IgnoredObstacle { obstacle, edges });
            }
        }
    }
}

/// The edges of a closed thread that are held, or near to a held node.
fn spared_around(grip: &Grip, state: &ThreadState) -> Vec<bool> {
    let edges = state.rest_lengths.len();
    let mut spared = vec![false; edges];
    let has = |node: usize| grip.nodes.binary_search_by_key(&node, |held| held.node as usize).is_ok();
    for node in grip.nodes.iter().map(|held| held.node as usize).filter(|node| *node < edges) {
        let back = (1..edges).map(|step| (node + edges - step) % edges);
        let ahead = (0..edges).map(|step| (node + step) % edges);
        let mut mark = |way: &mut dyn Iterator<Item = usize>| {
            let mut arc = 0.0;
            for edge in way {
                arc += state.rest_lengths[edge];
                if arc >= SPARED {
                    break;
                }
                spared[edge] = true;
            }
        };
        mark(&mut { back });
        mark(&mut { ahead });
        spared[node] |= has(state.after(node));
    }
    spared
}

/// First and last of each run of marked edges.
fn runs(marked: &[bool]) -> Vec<[usize; 2]> {
    let mut runs: Vec<[usize; 2]> = Vec::new();
    for edge in (0..marked.len()).filter(|edge| marked[*edge]) {
        match runs.last_mut() {
            Some([_, last]) if *last + 1 == edge => *last = edge,
            _ => runs.push([edge, edge]),
        }
    }
    runs
}

/// Force of a grasp on the thread.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraspForce {
    /// Force on the thread, in its frame \[N\].
    pub force: Vector3<f64>,
    /// Centre of the held part, and its position in the instrument \[m\].
    pub places: [Point3<f64>; 2],
}

/// Force of each grasp on the thread, from the forces of its holds, in their order; moves nodes that have slipped
/// through the jaws, and drops those that have left them.
pub fn pulls(
    grips: &mut Vec<Grip>,
    parts: &ObstacleParts,
    scene: &Snapshot,
    state: &ThreadState,
    forces: &[Vector3<f64>],
) -> Vec<(Entity, GraspForce)> {
    let mut forces = forces.iter();
    let mut pulls = Vec::new();
    grips.retain_mut(|grip| {
        let (Some(([_, pose], _)), Some(instrument)) =
            (parts.instrument(grip.instrument), scene.get::<Instrument>(grip.instrument))
        else {
            return true;
        };
        if grip.is_shut() {
            return true;
        }
        let (stiffness, force_max) = strength(instrument, grip);
        let (mut sum, mut now, mut wanted) = (Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for held in &mut grip.nodes {
            let Some(force) = forces.next() else { break };
            let node = state.positions[held.node as usize];
            if force.norm() > 0.999 * force_max {
                held.in_instrument = pose.inverse_transform_point(&(node + force / stiffness));
            }
            sum += force;
            now += node.coords;
            wanted += (pose * held.in_instrument).coords;
        }
        let count = grip.nodes.len().max(1) as f64;
        pulls.push((
            grip.instrument,
            GraspForce { force: sum, places: [(now / count).into(), (wanted / count).into()] },
        ));
        grip.nodes.retain(|held| is_within(instrument, &held.in_instrument));
        let nodes = &grip.nodes;
        let has = |node: u32| nodes.binary_search_by_key(&node, |held| held.node).is_ok();
        grip.edges.retain(|held| has(held.edge) && has(state.after(held.edge as usize) as u32));
        // Thread beyond the part that slipped out can be taken again.
        !grip.nodes.is_empty()
    });
    pulls
}

/// Whether a point is between the pads, in side view.
fn is_within(instrument: &Instrument, place: &Point3<f64>) -> bool {
    place.y.abs() <= instrument.jaw_width
        && place.z <= instrument.jaw_thickness
        && place.z >= -instrument.jaw_length - instrument.jaw_thickness
}

/// A pull in the world: its point of application, the centre of the held part, and the force there.
#[must_use]
pub fn in_world(pull: &GraspForce, world_from_thread: &Isometry3<f64>) -> (Point3<f64>, Vector3<f64>) {
    (world_from_thread * pull.places[0], world_from_thread.rotation * pull.force)
}
