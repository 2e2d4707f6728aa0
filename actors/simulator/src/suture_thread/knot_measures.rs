//! Measures of a knot: where along the thread its strands lie, and how far apart they are.

use nalgebra::Vector3;
use trocar_collision::primitive::closest_segments;

use super::contact::nearest_segments;
use super::state::PARTED;
use super::{Thread, ThreadState};

/// The two strands of a knot, each as the mean position of its contacts weighted by contact force; in rest arc length
/// from the first node \[m\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Strands {
    /// Arc lengths of the first and of the second strand.
    pub middles: [f64; 2],
    /// Sum of all self-contact forces of the thread \[N\].
    pub pressed: f64,
}

impl Strands {
    /// Length of the loop between the strands \[m\]: it grows by the length that slips through the knot. For two
    /// threads tied together: the end of the first plus the beginning of the second, that is their length beyond the
    /// knot.
    #[must_use]
    pub fn loop_length(&self) -> f64 {
        self.middles[1] - self.middles[0]
    }
}

impl ThreadState {
    /// The threads in the knot, as first and last node of each: of the groups of threads that touch each other,
    /// directly or through others, the group with most contacts. Pieces that were cut off and lie elsewhere do not
    /// belong to it.
    #[must_use]
    pub fn tangled(&self) -> Vec<[usize; 2]> {
        let threads: Vec<[usize; 2]> = self.threads().collect();
        if threads.len() == 1 {
            return threads;
        }
        let of = |edge: u32| threads.partition_point(|[first, _]| *first <= edge as usize).saturating_sub(1);
        // Each group is named by its first thread.
        let mut tangle: Vec<usize> = (0..threads.len()).collect();
        let pairs: Vec<[usize; 2]> = self
            .contacts
            .iter()
            .filter(|contact| contact.key.with == 0 && contact.force != Vector3::zeros())
            .map(|contact| [of(contact.key.edge), of(contact.key.feature)])
            .collect();
        for pair in &pairs {
            let [a, b] = pair.map(|thread| tangle[thread]);
            tangle.iter_mut().filter(|of| **of == a.max(b)).for_each(|of| *of = a.min(b));
        }
        let count = |first: usize| pairs.iter().filter(|pair| tangle[pair[0]] == first).count();
        let most = (0..threads.len()).max_by_key(|first| (count(*first), std::cmp::Reverse(*first)));
        let chosen = (0..threads.len()).filter(|thread| Some(tangle[*thread]) == most);
        chosen.map(|thread| threads[thread]).collect()
    }

    /// The strands of a thread that touches itself; the loop is the longest part between two contacts.
    #[must_use]
    pub fn strands(&self) -> Option<Strands> {
        let state = self;
        let mut arcs = vec![0.0];
        for rest in &state.rest_lengths {
            arcs.push(arcs[arcs.len() - 1] + rest);
        }
        let mut places: Vec<(f64, f64)> = Vec::with_capacity(2 * state.contacts.len());
        for contact in state.contacts.iter().filter(|contact| contact.key.with == 0) {
            let edges = [contact.key.edge, contact.key.feature].map(|edge| edge as usize);
            let segment = |edge: usize| [edge, state.after(edge)].map(|node| state.positions[node]);
            let along = nearest_segments(&segment(edges[0]), &segment(edges[1]));
            let weight = contact.force.norm();
            for (edge, along) in edges.into_iter().zip(along) {
                places.push((arcs[edge] + along * state.rest_lengths[edge], weight));
            }
        }
        places.retain(|place| place.1 > 0.0);
        places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let widest = (1..places.len())
            .max_by(|&a, &b| (places[a].0 - places[a - 1].0).total_cmp(&(places[b].0 - places[b - 1].0)))?;
        let middle = |side: &[(f64, f64)]| {
            let weight: f64 = side.iter().map(|place| place.1).sum();
            side.iter().map(|place| place.0 * place.1).sum::<f64>() / weight
        };
        let pressed = 0.5 * places.iter().map(|place| place.1).sum::<f64>();
        Some(Strands { middles: [middle(&places[..widest]), middle(&places[widest..])], pressed })
    }
}

/// Least distance between centre lines of strands \[m\]. Edges nearer along the thread than half a turn of the tightest
/// bend belong to the same strand.
#[must_use]
pub fn nearest_edges(thread: &Thread) -> f64 {
    let (points, state) = (thread.positions(), thread.state());
    let (edges, arcs) = (state.rest_lengths.len(), state.arcs());
    let mut least = f64::INFINITY;
    for first in (0..edges).filter(|edge| state.joins(*edge)) {
        for second in (first + 2..edges).filter(|edge| state.joins(*edge)) {
            let apart = arcs[second] - arcs[first + 1];
            let is_beside = second < first + 3 && apart < 0.5 * PARTED;
            if is_beside || apart < std::f64::consts::PI * thread.material().radius {
                continue;
            }
            let edge = |k: usize| [points[k], points[state.after(k)]];
            if state.is_closed()
                && (edges + first < second + 3
                    || arcs[edges] - arcs[second + 1] + arcs[first]
                        < std::f64::consts::PI * thread.material().radius)
            {
                continue;
            }
            least = least.min(closest_segments(&edge(first), &edge(second)).distance_squared);
        }
    }
    least.sqrt()
}
