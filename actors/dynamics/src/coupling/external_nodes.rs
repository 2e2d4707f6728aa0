//! External nodes in a step: nodes of other bodies that the stepped body is tied to or lies on.
//!
//! A ghost node is a mass point that another solver moves between steps. Within a step it moves freely, and responds to
//! the body's impulses with its own mobility. The impulses are reported afterwards, so that the other solver applies
//! exactly the same numbers.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};

use crate::particles::StepError;

/// In ties, numbers from here on refer to nodes of the bodies that are stepped together, not to ghost nodes.
pub const OF_BODY: u32 = 1 << 31;

/// A node of another body: a mass, attached by a spring to its predicted path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GhostNode {
    /// Position \[m\].
    pub position: Point3<f64>,
    /// Velocity \[m/s\].
    pub velocity: Vector3<f64>,
    /// Inverse mass \[1/kg\]; 0: immovable.
    pub mobility: f64,
    /// External force \[N\], in addition to what moves it along its path.
    pub pull: Vector3<f64>,
    /// Its predicted path.
    pub path: PredictedPath,
    /// Stiffness of the spring to the path \[N/m\].
    pub stiffness: f64,
    /// Damping of its motion relative to the path \[N·s/m\].
    pub damping: f64,
}

/// A motion with constant acceleration for a while, then with constant velocity.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PredictedPath {
    /// Current position \[m\].
    pub position: Point3<f64>,
    /// Current velocity \[m/s\].
    pub velocity: Vector3<f64>,
    /// Acceleration \[m/s²\].
    pub acceleration: Vector3<f64>,
    /// Remaining time of the acceleration \[s\].
    pub lasts: f64,
}

impl GhostNode {
    /// An immovable one.
    #[must_use]
    pub fn as_wall(self) -> Self {
        let path = PredictedPath { position: self.position, ..PredictedPath::default() };
        Self {
            velocity: Vector3::zeros(),
            mobility: 0.0,
            pull: Vector3::zeros(),
            path,
            stiffness: 0.0,
            damping: 0.0,
            ..self
        }
    }

    /// Advances by `h` seconds with an impulse \[N·s\].
    pub fn go(&mut self, h: f64, impulse: &Vector3<f64>) {
        let mut path = self.path;
        let (velocity, mobility) = self.free_velocity(h, self.position.coords, self.velocity, &mut path);
        self.velocity = velocity + impulse * mobility;
        self.position += self.velocity * h;
        self.path = path;
    }

    /// What it yields to an impulse in a substep of `h` seconds \[1/kg\].
    #[must_use]
    pub fn mobility_in(&self, h: f64) -> f64 {
        self.mobility / (1.0 + h * h * self.stiffness * self.mobility + h * self.damping * self.mobility)
    }

    /// Its velocity after a substep without contact forces, and its mobility \[1/kg\]. Spring and damper to its path are
    /// implicit; the path advances by the substep.
    fn free_velocity(
        &self,
        h: f64,
        was: Vector3<f64>,
        moved: Vector3<f64>,
        path: &mut PredictedPath,
    ) -> (Vector3<f64>, f64) {
        let velocity = moved + path.go(h) + self.pull * (self.mobility * h);
        let drag = h * self.damping * self.mobility;
        let loose = 1.0 / (1.0 + h * h * self.stiffness * self.mobility + drag);
        // With the damper alone.
        let dragged = (velocity + path.velocity * drag) / (1.0 + drag);
        let now = path.position.coords.lerp(&(was + dragged * h), loose * (1.0 + drag));
        ((now - was) / h, self.mobility * loose)
    }
}

impl PredictedPath {
    /// Advances by `h` seconds; returns the change of velocity.
    pub fn go(&mut self, h: f64) -> Vector3<f64> {
        let change = self.acceleration * h.min(self.lasts);
        self.lasts -= h.min(self.lasts);
        self.velocity += change;
        self.position += self.velocity * h;
        change
    }
}

/// A zero-length spring and damper between a node of the body and a point among ghost nodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tie {
    /// The node.
    pub node: u32,
    /// The ghost nodes, or nodes from [`OF_BODY`] on, with their weights; the sum is 1.
    pub ghost_nodes: [(u32, f64); 4],
    /// Stiffness: force per stretch \[N/m\], above 0.
    pub stiffness: f64,
    /// Damping \[N·s/m\].
    pub damping: f64,
}

/// A contact that keeps a node of the body on one side of a triangle of ghost nodes: a one-sided spring with friction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NodeContact {
    /// The node.
    pub node: u32,
    /// The ghost nodes, with their weights; the sum is 1.
    pub ghost_nodes: [(u32, f64); 3],
    /// The point where friction makes it stick.
    pub anchor: [(u32, f64); 3],
    /// Unit normal towards the allowed side.
    pub normal: Vector3<f64>,
    /// Distance kept from the triangle \[m\].
    pub thickness: f64,
    /// Stiffness: force per penetration depth \[N/m\], above 0.
    pub stiffness: f64,
    /// Coulomb friction coefficient.
    pub friction: f64,
}

/// All external nodes, ties and contacts of a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct ExternalNodes<'a> {
    /// Nodes of other bodies.
    pub ghost_nodes: &'a [GhostNode],
    /// Ties between the body and the ghost nodes.
    pub ties: &'a [Tie],
    /// Contacts with the ghost nodes' surface.
    pub presses: &'a [NodeContact],
}

/// Result of a step for a ghost node.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GhostMoved {
    /// Position \[m\].
    pub position: Point3<f64>,
    /// Velocity \[m/s\].
    pub velocity: Vector3<f64>,
    /// Its path, advanced by the step.
    pub path: PredictedPath,
    /// Impulse by ties and contacts \[N·s\].
    pub impulse: Vector3<f64>,
    /// Work of that impulse \[J\].
    pub work: f64,
}

/// Results of a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GhostImpulses {
    /// For each ghost node.
    pub ghost_nodes: Vec<GhostMoved>,
    /// For each tie.
    pub ties: Vec<TieResult>,
    /// For each contact.
    pub presses: Vec<NodeContactResult>,
}

/// Result of a step for a tie.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TieResult {
    /// Force on the body, averaged over the step \[N\].
    pub force: Vector3<f64>,
    /// Dissipated energy \[J\]: by damping and by implicit integration.
    pub lost: f64,
}

/// Result of a step for a contact.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct NodeContactResult {
    /// Force on the body, averaged over the step \[N\].
    pub force: Vector3<f64>,
    /// Whether it was active at the end.
    pub holds: bool,
    /// Whether it was sliding at the end.
    pub slides: bool,
    /// Displacement of the tangential spring ahead of the node \[m\].
    pub drawn: Vector3<f64>,
    /// Dissipated energy \[J\]: by friction and by implicit integration.
    pub lost: f64,
}

/// Work arrays and results of a step with external nodes.
#[derive(Clone, Debug, Default)]
pub struct ExternalNodesState {
    /// Ghost nodes as nodes.
    places: Vec<[f64; 4]>,
    /// Their positions at the beginning of the substep.
    before: Vec<[f64; 4]>,
    /// The node of each tie.
    tied: Vec<u32>,
    /// Impulses by ties and contacts in the substep \[N·s\].
    given: Vec<Vector3<f64>>,
    /// Lagrange multipliers of the substep \[N·s²\]: of ties, and of contacts in normal and tangential direction.
    ties: Vec<Vector3<f64>>,
    presses: Vec<(f64, Vector3<f64>)>,
    /// Separation at the beginning of the substep \[m\]: ties, then contacts.
    aparts: Vec<Vector3<f64>>,
    moved: GhostImpulses,
}

/// All nodes of a substep: those of one body after another, then the ghost nodes.
pub(crate) struct SubstepNodes<'a> {
    pub bodies: Vec<&'a mut [[f64; 4]]>,
    pub ghost_nodes: &'a mut [[f64; 4]],
    /// One over the squared substep \[1/s²\].
    pub rate: f64,
}

impl SubstepNodes<'_> {
    fn body(&mut self, node: u32) -> &mut [f64; 4] {
        let mut node = node as usize;
        for body in &mut self.bodies {
            if node < body.len() {
                return &mut body[node];
            }
            node -= body.len();
        }
        unreachable!("ties are checked before a step")
    }

    fn at(&mut self, number: u32) -> &mut [f64; 4] {
        if number < OF_BODY { &mut self.ghost_nodes[number as usize] } else { self.body(number - OF_BODY) }
    }

    /// Separation of a node from a point among ghost nodes, and the sum of their mobilities \[1/kg\].
    fn apart<const N: usize>(&mut self, node: u32, ghost_nodes: &[(u32, f64); N]) -> (Vector3<f64>, f64) {
        let [x, y, z, mut yields] = *self.body(node);
        let mut apart = Vector3::new(x, y, z);
        for &(ghost_node, weight) in ghost_nodes {
            let [x, y, z, mobility] = *self.at(ghost_node);
            apart -= Vector3::new(x, y, z) * weight;
            yields += mobility * weight * weight;
        }
        (apart, yields)
    }

    fn push<const N: usize>(&mut self, node: u32, ghost_nodes: &[(u32, f64); N], by: &Vector3<f64>) {
        let shift = |place: &mut [f64; 4], share: f64| {
            let mobility = place[3];
            (0..3).for_each(|axis| place[axis] += by[axis] * share * mobility);
        };
        shift(self.body(node), 1.0);
        ghost_nodes.iter().for_each(|&(ghost_node, weight)| shift(self.at(ghost_node), -weight));
    }
}

impl ExternalNodesState {
    /// Results of the last step.
    #[must_use]
    pub fn moved(&self) -> &GhostImpulses {
        &self.moved
    }

    /// Resets the results, before a step that may fail.
    pub fn forget(&mut self) {
        self.moved.ghost_nodes.clear();
        self.moved.ties.clear();
        self.moved.presses.clear();
    }

    /// Force of the ties on these nodes (ascending) in the last step \[N\].
    pub fn pull_on(&self, nodes: &[u32]) -> Vector3<f64> {
        let held =
            self.tied.iter().zip(&self.moved.ties).filter(|(node, _)| nodes.binary_search(node).is_ok());
        held.map(|(_, tied)| tied.force).sum()
    }
}

impl ExternalNodes<'_> {
    /// Validates it for bodies with this many nodes, a spare node of each counted.
    ///
    /// # Errors
    /// The invalid entry.
    pub fn check(&self, nodes: usize) -> Result<(), StepError> {
        let wrong = |what, index, problem| Err(StepError::Input { what, index, problem });
        let ghost_nodes = self.ghost_nodes.len();
        for (index, ghost_node) in self.ghost_nodes.iter().enumerate() {
            let path = ghost_node
                .path
                .velocity
                .iter()
                .chain(&ghost_node.path.acceleration)
                .chain([&ghost_node.path.lasts]);
            let vectors = ghost_node.velocity.iter().chain(&ghost_node.pull).chain(path);
            let places = ghost_node.position.iter().chain(ghost_node.path.position.iter());
            let numbers = [ghost_node.mobility, ghost_node.stiffness];
            let is_number = |value: &f64| value.is_finite();
            if !(vectors.chain(places).chain(&numbers).all(is_number) && numbers.iter().all(|of| *of >= 0.0))
            {
                return wrong(
                    "guest",
                    index,
                    "has a number that is not finite, or a mass or stiffness below 0",
                );
            }
        }
        let is_known = |number: u32| match number.checked_sub(OF_BODY) {
            Some(node) => (node as usize) < nodes,
            None => (number as usize) < ghost_nodes,
        };
        let known =
            |of: &[(u32, f64)]| of.iter().all(|(ghost_node, w)| is_known(*ghost_node) && w.is_finite());
        for (index, tie) in self.ties.iter().enumerate() {
            let soft = [tie.stiffness, tie.damping].iter().all(|value| *value >= 0.0 && value.is_finite());
            if tie.node as usize >= nodes || !known(&tie.ghost_nodes) {
                return wrong("tie", index, "names a node or a guest that does not exist");
            } else if !(soft && tie.stiffness > 0.0) {
                return wrong("tie", index, "has a stiffness that is not above 0, or damping below 0");
            }
        }
        for (index, press) in self.presses.iter().enumerate() {
            let finite =
                [press.thickness, press.friction].iter().all(|value| *value >= 0.0 && value.is_finite());
            let unit = (press.normal.norm_squared() - 1.0).abs() < 1e-6;
            let of_guests =
                press.ghost_nodes.iter().chain(&press.anchor).all(|(ghost_node, _)| *ghost_node < OF_BODY);
            if press.node as usize >= nodes
                || !of_guests
                || !known(&press.ghost_nodes)
                || !known(&press.anchor)
            {
                return wrong("press", index, "names a node or a guest that does not exist");
            } else if !(finite && unit && press.stiffness > 0.0 && press.stiffness.is_finite()) {
                return wrong(
                    "press",
                    index,
                    "has a stiffness that is not above 0, or a normal that is not unit",
                );
            }
        }
        Ok(())
    }

    /// Prepares a step.
    pub fn prepare(&self, scratch: &mut ExternalNodesState) {
        scratch.places.clear();
        scratch.places.extend(self.ghost_nodes.iter().map(|ghost_node| {
            let [x, y, z] = ghost_node.position.into();
            [x, y, z, ghost_node.mobility]
        }));
        let moved = &mut scratch.moved;
        moved.ghost_nodes.clear();
        let still = |ghost_node: &GhostNode| GhostMoved {
            velocity: ghost_node.velocity,
            path: ghost_node.path,
            ..GhostMoved::default()
        };
        moved.ghost_nodes.extend(self.ghost_nodes.iter().map(still));
        moved.ties.clear();
        moved.ties.resize(self.ties.len(), TieResult::default());
        moved.presses.clear();
        moved.presses.resize(self.presses.len(), NodeContactResult::default());
        scratch.tied.clear();
        scratch.tied.extend(self.ties.iter().map(|tie| tie.node));
    }

    /// Begins a substep of length `h` \[s\], before anything has moved.
    pub fn begin(&self, bodies: Vec<&mut [[f64; 4]]>, scratch: &mut ExternalNodesState) {
        let ExternalNodesState { places, before, aparts, given, ties, presses, .. } = scratch;
        before.clone_from(places);
        let mut all = SubstepNodes { bodies, ghost_nodes: places, rate: 0.0 };
        aparts.clear();
        aparts.extend(self.ties.iter().map(|tie| all.apart(tie.node, &tie.ghost_nodes).0));
        aparts.extend(self.presses.iter().map(|press| all.apart(press.node, &press.ghost_nodes).0));
        given.clear();
        given.resize(self.ghost_nodes.len(), Vector3::zeros());
        ties.clear();
        ties.resize(self.ties.len(), Vector3::zeros());
        presses.clear();
        presses.resize(self.presses.len(), (0.0, Vector3::zeros()));
    }

    /// Predicts the ghost nodes' positions.
    pub fn predict(&self, h: f64, scratch: &mut ExternalNodesState) {
        let moving = self.ghost_nodes.iter().zip(&mut scratch.moved.ghost_nodes);
        for (place, (ghost_node, moved)) in scratch.places.iter_mut().zip(moving) {
            let was = Vector3::new(place[0], place[1], place[2]);
            let (velocity, mobility) = ghost_node.free_velocity(h, was, moved.velocity, &mut moved.path);
            let now = was + velocity * h;
            *place = [now.x, now.y, now.z, mobility];
        }
    }

    /// One constraint iteration.
    pub fn project(&self, h: f64, bodies: Vec<&mut [[f64; 4]]>, scratch: &mut ExternalNodesState) {
        let ExternalNodesState { places, aparts, ties, presses, .. } = scratch;
        let mut all = SubstepNodes { bodies, ghost_nodes: places, rate: 1.0 / (h * h) };
        for ((tie, multiplier), then) in self.ties.iter().zip(ties).zip(&*aparts) {
            let (stretch, yields) = all.apart(tie.node, &tie.ghost_nodes);
            if yields == 0.0 {
                continue;
            }
            let soft = all.rate / tie.stiffness;
            let drag = tie.damping / (tie.stiffness * h);
            let slip = stretch - then;
            let change = (-stretch - *multiplier * soft - slip * drag) / ((1.0 + drag) * yields + soft);
            all.push(tie.node, &tie.ghost_nodes, &change);
            *multiplier += change;
        }
        for (press, (along, across)) in self.presses.iter().zip(presses) {
            let (over, yields) = all.apart(press.node, &press.ghost_nodes);
            if yields == 0.0 {
                continue;
            }
            let soft = all.rate / press.stiffness;
            let gap = press.normal.dot(&over) - press.thickness;
            let pressed = (*along - (gap + soft * *along) / (yields + soft)).max(0.0);
            all.push(press.node, &press.ghost_nodes, &(press.normal * (pressed - *along)));
            *along = pressed;
            let (slip, yields) = all.apart(press.node, &press.anchor);
            let slip = slip - press.normal * press.normal.dot(&slip);
            let wanted = *across - (slip + *across * soft) / (yields + soft);
            let (size, most) = (wanted.norm(), press.friction * pressed);
            let held = if size > most { wanted * (most / size) } else { wanted };
            all.push(press.node, &press.anchor, &(held - *across));
            *across = held;
        }
    }

    /// Ends a substep.
    pub fn end(&self, h: f64, bodies: Vec<&mut [[f64; 4]]>, scratch: &mut ExternalNodesState, parts: f64) {
        let ExternalNodesState { places, before, given, ties, presses, aparts, moved, .. } = scratch;
        let mut all = SubstepNodes { bodies, ghost_nodes: places, rate: 1.0 / (h * h) };
        // Work of the impulses on everything they act on; with the springs' energy its negative is the dissipated
        // energy. Computed from displacements of the ends: opposing forces on a light node cancel within a substep.
        let taken =
            |impulse: &Vector3<f64>, then: &Vector3<f64>, now: &Vector3<f64>| impulse.dot(&(now - then)) / h;
        for (index, (tie, multiplier)) in self.ties.iter().zip(&*ties).enumerate() {
            let impulse = multiplier / h;
            for &(ghost_node, weight) in
                tie.ghost_nodes.iter().filter(|(ghost_node, _)| *ghost_node < OF_BODY)
            {
                given[ghost_node as usize] -= impulse * weight;
            }
            let tied = &mut moved.ties[index];
            tied.force += impulse / (h * parts);
            let now = all.apart(tie.node, &tie.ghost_nodes).0;
            let kept = 0.5 * tie.stiffness * (now.norm_squared() - aparts[index].norm_squared());
            tied.lost -= taken(&impulse, &aparts[index], &now) + kept;
        }
        for (index, (press, (along, across))) in self.presses.iter().zip(&*presses).enumerate() {
            let (pushing, holding) = (press.normal * (along / h), across / h);
            press
                .ghost_nodes
                .iter()
                .for_each(|&(ghost_node, weight)| given[ghost_node as usize] -= pushing * weight);
            press
                .anchor
                .iter()
                .for_each(|&(ghost_node, weight)| given[ghost_node as usize] -= holding * weight);
            let pressed = &mut moved.presses[index];
            pressed.force += (pushing + holding) / (h * parts);
            pressed.holds = *along > 0.0;
            pressed.slides = across.norm() >= press.friction * along * (1.0 - 1e-9);
            pressed.drawn = across * (all.rate / press.stiffness);
            let now = all.apart(press.node, &press.ghost_nodes).0;
            let then = &aparts[self.ties.len() + index];
            let depth = |apart: &Vector3<f64>| (press.thickness - press.normal.dot(apart)).max(0.0);
            let kept = 0.5 * press.stiffness * (depth(&now).powi(2) - depth(then).powi(2));
            pressed.lost -= taken(&(pushing + holding), then, &now) + kept;
        }
        let places = all.ghost_nodes.iter().zip(before);
        for ((ghost_node, impulse), (place, was)) in moved.ghost_nodes.iter_mut().zip(given).zip(places) {
            ghost_node.velocity = Vector3::from_fn(|axis, _| (place[axis] - was[axis]) / h);
            ghost_node.position = Point3::new(place[0], place[1], place[2]);
            ghost_node.impulse += *impulse;
            ghost_node.work += impulse.dot(&ghost_node.velocity);
        }
    }
}
