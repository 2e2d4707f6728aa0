//! Stability limit of explicit steps, valid for any shape of the network.
//!
//! The stiffness of a spring in any state is at most `k` in every direction (compression reduces the transverse
//! stiffness, which only slows things down). So the largest eigenvalue of M⁻¹K is at most that of a graph Laplacian,
//! which is bounded by the largest sum over the elements around one element (Anderson and Morley, *Eigenvalues of the
//! Laplacian of a graph*, 1985, with masses and weights): for a spring network `dᵢ/mᵢ + dⱼ/mⱼ` of some spring, with `d`
//! the total stiffness at a node. A symplectic Euler step is stable while `λh² + 2ch < 4`, with the damping rate `c`
//! evaluated at the end of the last step. Squeezed tetrahedra are stiffer the flatter they are: they are bounded in their
//! present shape (`collapse.rs`).

use super::contact::Contact;
use super::forces::NEARLY_FLAT;
use super::network::{Hinge, Network, Spring};

/// Largest stiffness of a hinge over all states, and its largest weight.
fn worst(hinge: &Hinge) -> (f64, f64) {
    let turned = if hinge.side * hinge.rest == 0.0 { 1.0 } else { 1.0 + 1.0 / NEARLY_FLAT };
    let largest = hinge.weights.iter().fold(0.0_f64, |largest, weight| largest.max(weight.abs()));
    (hinge.stiffness * turned, largest)
}

/// An upper bound of the eigenvalues of M⁻¹K, updated incrementally.
#[derive(Clone, Debug, Default)]
pub(super) struct EigenvalueBound {
    /// Total stiffness at each node \[N/m\].
    meeting: Vec<f64>,
    /// Largest bound among the springs and hinges that begin at each node \[1/s²\], as a tournament tree: leaves in the
    /// second half of the list, the larger of each pair above them.
    largest: Vec<f64>,
}

impl EigenvalueBound {
    /// For a network; `mobility` is the inverse mass of each node, 0 where it is held.
    pub fn new(network: &Network, mobility: &[f64]) -> Self {
        let leaves = mobility.len().next_power_of_two().max(1);
        let mut bound = Self { meeting: vec![0.0; mobility.len()], largest: vec![0.0; 2 * leaves] };
        for spring in &network.springs {
            for node in spring.nodes {
                bound.meeting[node as usize] += spring.stiffness;
            }
        }
        for hinge in &network.hinges {
            for (node, share) in stiffness(hinge) {
                bound.meeting[node as usize] += share;
            }
        }
        for spring in &network.springs {
            let largest = &mut bound.largest[leaves + spring.nodes[0] as usize];
            *largest = largest.max(of_spring(spring, &bound.meeting, mobility));
        }
        for hinge in &network.hinges {
            let largest = &mut bound.largest[leaves + hinge.nodes[0] as usize];
            *largest = largest.max(of_hinge(hinge, &bound.meeting, mobility));
        }
        for at in (1..leaves).rev() {
            bound.largest[at] = bound.largest[2 * at].max(bound.largest[2 * at + 1]);
        }
        bound
    }

    /// The upper bound \[1/s²\].
    pub fn largest(&self) -> f64 {
        self.largest.get(1).copied().unwrap_or(0.0)
    }

    /// Updates to a changed network built from a mesh: `nodes` (ascending) are those with changed elements or masses,
    /// `edges` the edges of all elements around a node, ascending. All sums are in list order, so that the result
    /// equals a new bound.
    pub fn follow(
        &mut self,
        network: &Network,
        mobility: &[f64],
        nodes: &[u32],
        edges: impl Fn(u32) -> Vec<[u32; 2]>,
    ) {
        self.meeting.resize(mobility.len(), 0.0);
        let mut first: Vec<u32> = nodes.to_vec();
        for &node in nodes {
            let edges = edges(node);
            let mut meeting = 0.0;
            for spring in
                edges.iter().filter(|edge| edge.contains(&node)).filter_map(|edge| network.spring(edge))
            {
                meeting += spring.stiffness;
            }
            for hinge in edges.iter().filter_map(|edge| network.hinge(edge)) {
                for (_, share) in stiffness(hinge).filter(|(of, _)| *of == node) {
                    meeting += share;
                }
            }
            self.meeting[node as usize] = meeting;
            first.extend(edges.iter().map(|edge| edge[0]));
        }
        first.sort_unstable();
        first.dedup();
        let leaves = mobility.len().next_power_of_two().max(1);
        if self.largest.len() != 2 * leaves {
            // Linear cost amortised over as many changes as there are nodes.
            *self = Self::new(network, mobility);
            return;
        }
        for node in first {
            let springs = network.springs_from(node).iter();
            let hinges = network.hinges_from(node).iter();
            let largest =
                springs.map(|spring| of_spring(spring, &self.meeting, mobility)).fold(0.0, f64::max);
            let largest =
                hinges.map(|hinge| of_hinge(hinge, &self.meeting, mobility)).fold(largest, f64::max);
            let mut at = leaves + node as usize;
            self.largest[at] = largest;
            while at > 1 {
                at /= 2;
                self.largest[at] = self.largest[2 * at].max(self.largest[2 * at + 1]);
            }
        }
    }
}

/// Contribution of a hinge to the stiffness at each of its nodes \[N/m\].
fn stiffness(hinge: &Hinge) -> impl Iterator<Item = (u32, f64)> {
    let (stiffness, largest) = worst(hinge);
    let shares = hinge.nodes.into_iter().zip(hinge.weights);
    shares.map(move |(node, weight)| (node, stiffness * largest * weight.abs()))
}

fn of_spring(spring: &Spring, meeting: &[f64], mobility: &[f64]) -> f64 {
    let [a, b] = spring.nodes.map(|node| meeting[node as usize] * mobility[node as usize]);
    a + b
}

fn of_hinge(hinge: &Hinge, meeting: &[f64], mobility: &[f64]) -> f64 {
    let (_, largest) = worst(hinge);
    if largest == 0.0 {
        return 0.0;
    }
    let rate = |node: u32| meeting[node as usize] * mobility[node as usize];
    let rates = hinge.nodes.into_iter().zip(hinge.weights).map(|(node, weight)| rate(node) * weight.abs());
    rates.sum::<f64>() / largest
}

/// The same bound for the contacts' stiffness, and for their damping \[1/s\].
pub(crate) fn of_contacts(contacts: &[Contact], mobility: &[f64], meeting: &mut Vec<f64>) -> (f64, f64) {
    let mut largest = |of: fn(&Contact) -> f64| {
        meeting.clear();
        meeting.resize(mobility.len(), 0.0);
        for contact in contacts {
            for (node, weight) in contact.nodes.into_iter().zip(contact.weights) {
                meeting[node as usize] += of(contact) * weight;
            }
        }
        let of_contact = |contact: &Contact| {
            let shares = contact.nodes.into_iter().zip(contact.weights);
            shares
                .map(|(node, weight)| weight * mobility[node as usize] * meeting[node as usize])
                .sum::<f64>()
        };
        contacts.iter().map(of_contact).fold(0.0, f64::max)
    };
    (largest(|contact| contact.stiffness), largest(|contact| contact.damping))
}

/// The largest step \[s\] that satisfies `λh² + 2ch ≤ 4`; infinite without stiffness and damping.
pub(crate) fn safe_step(eigenvalue: f64, damping: f64) -> f64 {
    // This form loses no digits when one of them is small.
    4.0 / (damping + (damping * damping + 4.0 * eigenvalue).sqrt())
}
