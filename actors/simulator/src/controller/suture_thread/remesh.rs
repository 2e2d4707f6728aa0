//! Adaptive edges of a thread: as short as its knots need and no shorter. Grasps, anchors and saved state follow the
//! nodes.

use nalgebra::Point3;

use super::component::ThreadBody;
use super::grasp::Grip;
use super::group::ThreadGroup;
use crate::suture_thread::{Fineness, Renumbered, Thread};

/// Ticks between two adaptations.
pub const EDGES_EVERY: u64 = 10;
/// Strands whose surfaces are within this distance count as close \[m\]: no strand moves further between two
/// adaptations.
const REACH: f64 = 2e-3;
/// Factor by which an edge may exceed its target length before it is split.
const TOLERATED: f64 = 1.15;
/// Maximum number of nodes.
const NODES_MAX: usize = 1024;

/// Splits and merges edges where necessary. Returns whether any was.
///
/// # Errors
/// Why the thread could not be remeshed.
pub fn adapt(
    kind: &ThreadBody,
    thread: &mut Thread,
    lines: &mut ThreadGroup,
    grips: &mut [Grip],
) -> Result<bool, String> {
    let fineness = fineness(kind.edges, thread.material().diameter());
    let pinned = lines.anchored().iter().map(|anchored| anchored.node);
    let keep: Vec<usize> = held(grips).chain(pinned).collect();
    let Some(now) = thread.adapt(&fineness, &keep).map_err(|error| error.to_string())? else {
        return Ok(false);
    };
    follow(grips, &now);
    lines.replace_line(&rest(&lines.rest(), &now), &now.nodes, thread.state());
    Ok(true)
}

/// Target lengths of edges: where strands are close, in diameters \[m\], and elsewhere \[m\].
pub fn fineness(edges: [f64; 2], diameter: f64) -> Fineness {
    let fine = edges[0] * diameter / TOLERATED;
    Fineness { fine, coarse: edges[1].max(fine), reach: REACH, nodes_max: NODES_MAX }
}

/// Held nodes.
pub fn held(grips: &[Grip]) -> impl Iterator<Item = usize> {
    grips.iter().flat_map(|grip| &grip.nodes).map(|held| held.node as usize)
}

/// Renumbers the grasps.
pub fn follow(grips: &mut [Grip], now: &Renumbered) {
    for grip in grips {
        grip.nodes.retain_mut(|held| match now.nodes.get(held.node as usize) {
            Some(Some(node)) => {
                held.node = *node;
                true
            }
            _ => false,
        });
        for held in &mut grip.edges {
            held.edge = now.edges.get(held.edge as usize).map_or(held.edge, |[first, _]| *first);
        }
    }
}

/// New rest positions: kept nodes keep theirs, new ones are spaced evenly between them.
fn rest(before: &[Point3<f64>], now: &Renumbered) -> Vec<Point3<f64>> {
    let mut nodes: Vec<Point3<f64>> = before.first().copied().into_iter().collect();
    for (edge, [first, last]) in now.edges.iter().enumerate() {
        let (Some(from), Some(to)) = (before.get(edge), before.get(edge + 1)) else { continue };
        let parts = 1 + last - first;
        nodes.extend((1..parts).map(|part| from.lerp(to, f64::from(part) / f64::from(parts))));
        if now.nodes.get(edge + 1).is_some_and(Option::is_some) {
            nodes.push(*to);
        }
    }
    nodes
}
