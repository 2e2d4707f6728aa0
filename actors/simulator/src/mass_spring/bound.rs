//! How large an explicit step may be, whatever shape the network takes.
//!
//! The stiffness of a spring in any state is at most `k` in every direction (what compression takes away from it across
//! its axis only slows things down). So the largest eigenvalue of M⁻¹K is at most that of a graph's Laplacian, and this
//! is at most the largest sum over the elements about one element (Anderson and Morley, *Eigenvalues of the Laplacian of
//! a graph*, 1985, with masses and weights): for a network of springs `dᵢ/mᵢ + dⱼ/mⱼ` of some spring, with `d` the
//! stiffness that meets in a node. A symplectic Euler step is stable while `λh² + 2ch < 4`, with the damping rate `c`
//! taken at the end of the last step.

use super::contact::Contact;
use super::forces::NEARLY_FLAT;
use super::network::{Hinge, Network};

/// Stiffness by which a hinge can resist in its worst state, and its largest weight.
fn worst(hinge: &Hinge) -> (f64, f64) {
    let turned = if hinge.side * hinge.rest == 0.0 { 1.0 } else { 1.0 + 1.0 / NEARLY_FLAT };
    let largest = hinge.weights.iter().fold(0.0_f64, |largest, weight| largest.max(weight.abs()));
    (hinge.stiffness * turned, largest)
}

/// No eigenvalue of M⁻¹K is larger \[1/s²\]; `mobility` is one over each node's mass, 0 where it is held.
pub(crate) fn largest_eigenvalue(network: &Network, mobility: &[f64], meeting: &mut Vec<f64>) -> f64 {
    meeting.clear();
    meeting.resize(mobility.len(), 0.0);
    for spring in &network.springs {
        for node in spring.nodes {
            meeting[node as usize] += spring.stiffness;
        }
    }
    for hinge in &network.hinges {
        let (stiffness, largest) = worst(hinge);
        for (node, weight) in hinge.nodes.into_iter().zip(hinge.weights) {
            meeting[node as usize] += stiffness * largest * weight.abs();
        }
    }
    let rate = |node: u32| meeting[node as usize] * mobility[node as usize];
    let mut bound = 0.0_f64;
    for spring in &network.springs {
        bound = bound.max(rate(spring.nodes[0]) + rate(spring.nodes[1]));
    }
    for hinge in &network.hinges {
        let (_, largest) = worst(hinge);
        if largest > 0.0 {
            let rates =
                hinge.nodes.into_iter().zip(hinge.weights).map(|(node, weight)| rate(node) * weight.abs());
            bound = bound.max(rates.sum::<f64>() / largest);
        }
    }
    bound
}

/// The same of the contacts' stiffness, and of their damping \[1/s\].
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
    // The form that loses no digits when one of them is small.
    4.0 / (damping + (damping * damping + 4.0 * eigenvalue).sqrt())
}
