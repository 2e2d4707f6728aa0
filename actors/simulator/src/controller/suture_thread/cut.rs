//! Cuts of threads by closing scissors, and breaks; grasps are updated.

use nalgebra::Isometry3;
use trocar_scene::Snapshot;

use super::grasp::Grip;
use crate::controller::cutting::scissors::{Blades, swept};
use crate::cutting::crossed;
use crate::suture_thread::{CutAt, CutNumbering, ThreadState};

/// Cuts in one tick closer to each other along the thread than this are merged, in radii: the two blades pass each
/// other at the cut.
const SAME: f64 = 8.0;

/// Cuts or break of a thread in this tick, and the event's name. Ordered so that no cut changes the numbers of the
/// following ones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThreadCutter {
    /// Highest edge number first.
    pub cuts: Vec<CutAt>,
    /// Whether the first one is a break.
    pub breaks: bool,
}

impl ThreadCutter {
    /// Name of the event.
    #[must_use]
    pub fn event(&self) -> &'static str {
        if self.breaks { "thread_broken" } else { "thread_cut" }
    }
}

/// Where blades have swept through a thread of `radius` \[m\] since `blades`, which is updated; if nothing is cut, the
/// edge with the largest tension above `breaks_at` \[N\].
pub fn parted_at(
    blades: &mut Vec<Blades>,
    scene: &Snapshot,
    world_from_thread: &Isometry3<f64>,
    (state, radius): (&ThreadState, f64),
    breaks_at: Option<f64>,
) -> ThreadCutter {
    let sweeps = swept(blades, scene, world_from_thread);
    let mut cuts: Vec<CutAt> = Vec::new();
    if !sweeps.is_empty() {
        let spans: Vec<(usize, [f64; 2])> = state.spans().collect();
        let mut last = f64::INFINITY;
        let mut points = std::borrow::Cow::from(&state.positions);
        if state.is_closed() {
            // The edge that leads back to the first node.
            points.to_mut().extend(state.positions.first());
        }
        for (edge, share) in crossed(&points, &sweeps).into_iter().rev() {
            let Ok(at) = spans.binary_search_by_key(&edge, |(edge, _)| *edge) else { continue };
            let [begin, end] = spans[at].1;
            let arc = begin + share * (end - begin);
            if last - arc > SAME * radius {
                cuts.push(CutAt { edge, share });
                last = arc;
            }
        }
    }
    let hardest = || {
        let limit = breaks_at?;
        let pulled = state.spans().map(|(edge, _)| (edge, state.tensions[edge]));
        let (edge, _) = pulled.filter(|(_, tension)| *tension > limit).max_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(CutAt { edge, share: 0.5 })
    };
    match cuts.is_empty().then(hardest).flatten() {
        Some(at) => ThreadCutter { cuts: vec![at], breaks: true },
        None => ThreadCutter { cuts, breaks: false },
    }
}

/// Renumbers the grasps, and drops those of removed nodes.
pub fn follow(grips: &mut Vec<Grip>, parted: &CutNumbering) {
    let now = |list: &[Option<u32>], index: u32| list.get(index as usize).copied().flatten();
    grips.retain_mut(|grip| {
        let was_shut = grip.is_shut();
        grip.nodes.retain_mut(|held| {
            let node = now(&parted.nodes, held.node);
            held.node = node.unwrap_or(held.node);
            node.is_some()
        });
        grip.edges.retain_mut(|held| {
            let edge = now(&parted.edges, held.edge);
            held.edge = edge.unwrap_or(held.edge);
            edge.is_some()
        });
        // A closed thread that was cut is numbered from the cut.
        grip.nodes.sort_unstable_by_key(|held| held.node);
        grip.edges.sort_unstable_by_key(|held| held.edge);
        was_shut || !grip.is_shut()
    });
}
