//! Repair of tetrahedral meshes: reports all repairs, and refuses meshes that cannot be repaired.

use std::fmt;

use nalgebra::Point3;

use super::tet_defects::{BadTets, Defect, MeshRules, pairs_within, tet_defects};

/// Repairs, by the indices of the input mesh.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Repairs {
    /// Inverted elements that were turned by swapping their last two corners.
    pub turned_tets: Vec<u32>,
    /// Elements that were dropped: flat, slivers, with a repeated corner, or duplicates.
    pub dropped_tets: Vec<u32>,
    /// Nodes merged into one of a smaller index: (node, target).
    pub merged_nodes: Vec<(u32, u32)>,
    /// Unused nodes that were dropped, without the merged ones.
    pub dropped_nodes: Vec<u32>,
    /// The old index of each remaining node.
    pub kept_nodes: Vec<u32>,
    /// The old index of each remaining element.
    pub kept_tets: Vec<u32>,
}

impl Repairs {
    /// Whether nothing was repaired.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.turned_tets.is_empty()
            && self.dropped_tets.is_empty()
            && self.merged_nodes.is_empty()
            && self.dropped_nodes.is_empty()
    }
}

/// Indices of each kind shown in a message; the rest are counted.
const SHOWN: usize = 8;

impl fmt::Display for Repairs {
    /// Formats the repairs, with the first few indices of each kind.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let merged: Vec<u32> = self.merged_nodes.iter().map(|(which, _)| *which).collect();
        let done = [
            (["inverted element turned", "inverted elements turned"], &self.turned_tets),
            (
                [
                    "element dropped that was flat, a sliver or there already",
                    "elements dropped that were flat, slivers or there already",
                ],
                &self.dropped_tets,
            ),
            (["node merged with another at its place", "nodes merged with others at their place"], &merged),
            (
                ["node dropped that no element uses", "nodes dropped that no element uses"],
                &self.dropped_nodes,
            ),
        ];
        if self.is_empty() {
            return write!(out, "nothing had to be mended");
        }
        let mut joint = "";
        for ([one, many], numbers) in done.into_iter().filter(|(_, numbers)| !numbers.is_empty()) {
            let what = if numbers.len() == 1 { one } else { many };
            let shown: Vec<String> = numbers.iter().take(SHOWN).map(u32::to_string).collect();
            let more = if numbers.len() > SHOWN { ", …" } else { "" };
            write!(out, "{joint}{} {what} ({}{more})", numbers.len(), shown.join(", "))?;
            joint = "; ";
        }
        Ok(())
    }
}

/// Nodes, elements, and the repairs.
pub type RepairedTets = (Vec<Point3<f64>>, Vec<[u32; 4]>, Repairs);

/// Repairs a mesh: inverted elements are flipped, coincident nodes merged; elements without volume, slivers, duplicate
/// elements and unused nodes are dropped. The rest keeps its order.
///
/// # Errors
/// [`BadTets`] with the defects that cannot be repaired: non-finite coordinates, corners that do not exist, faces of
/// more than two elements, elements that overlap, or nothing left.
pub fn repaired_tets(
    rest: &[Point3<f64>],
    tets: &[[u32; 4]],
    rules: &MeshRules,
) -> Result<RepairedTets, BadTets> {
    let beyond: Vec<_> = tet_defects(rest, tets, rules)
        .into_iter()
        .filter(|defect| {
            matches!(
                defect,
                Defect::Empty | Defect::TooMany { .. } | Defect::NotFinite { .. } | Defect::NoNode { .. }
            )
        })
        .collect();
    if !beyond.is_empty() {
        return Err(BadTets { defects: beyond });
    }
    let mut repairs = Repairs::default();
    let mut into: Vec<u32> = (0..rest.len() as u32).collect();
    if let Some(within) = rules.coincident_within {
        for [first, second] in pairs_within(rest, within) {
            into[second as usize] = into[first as usize];
            repairs.merged_nodes.push((second, into[first as usize]));
        }
    }
    let mut mended: Vec<[u32; 4]> = tets.iter().map(|tet| tet.map(|node| into[node as usize])).collect();
    // Single elements first: overlap of neighbours is defined for valid elements only.
    let unmerged = MeshRules { coincident_within: None, ..*rules };
    let mut dropped = vec![false; tets.len()];
    for defect in tet_defects(rest, &mended, &unmerged) {
        match defect {
            Defect::Inverted { tet, .. } => {
                mended[tet as usize].swap(2, 3);
                repairs.turned_tets.push(tet);
            }
            Defect::Flat { tet, .. } | Defect::Sliver { tet, .. } | Defect::RepeatedCorner { tet, .. } => {
                dropped[tet as usize] = true;
            }
            _ => {}
        }
    }
    let mut seen: Vec<([u32; 4], usize)> = (0..tets.len())
        .filter(|&tet| !dropped[tet])
        .map(|tet| {
            let mut corners = mended[tet];
            corners.sort_unstable();
            (corners, tet)
        })
        .collect();
    seen.sort_unstable();
    for same in seen.chunk_by(|one, other| one.0 == other.0) {
        for &(_, tet) in &same[1..] {
            dropped[tet] = true;
        }
    }
    repairs.turned_tets.retain(|&tet| !dropped[tet as usize]);
    let (kept_tets, dropped_tets): (Vec<u32>, Vec<u32>) =
        (0..tets.len() as u32).partition(|&tet| !dropped[tet as usize]);
    (repairs.kept_tets, repairs.dropped_tets) = (kept_tets, dropped_tets);

    let mut used = vec![false; rest.len()];
    for &tet in &repairs.kept_tets {
        for node in mended[tet as usize] {
            used[node as usize] = true;
        }
    }
    let mut number = vec![0; rest.len()];
    for node in 0..rest.len() as u32 {
        if used[node as usize] {
            number[node as usize] = repairs.kept_nodes.len() as u32;
            repairs.kept_nodes.push(node);
        } else if into[node as usize] == node {
            repairs.dropped_nodes.push(node);
        }
    }
    let nodes: Vec<_> = repairs.kept_nodes.iter().map(|&node| rest[node as usize]).collect();
    let elements: Vec<_> =
        repairs.kept_tets.iter().map(|&tet| mended[tet as usize].map(|node| number[node as usize])).collect();
    let left = tet_defects(&nodes, &elements, &unmerged);
    if left.is_empty() {
        return Ok((nodes, elements, repairs));
    }
    // In the caller's indices.
    let tet_of = |tet: u32| repairs.kept_tets[tet as usize];
    let corners_of = |corners: [u32; 3]| corners.map(|node| repairs.kept_nodes[node as usize]);
    let defects = left
        .into_iter()
        .map(|defect| match defect {
            Defect::SharedFace { corners, count, first, second } => Defect::SharedFace {
                corners: corners_of(corners),
                count,
                first: tet_of(first),
                second: tet_of(second),
            },
            Defect::Overlap { corners, first, second } => {
                Defect::Overlap { corners: corners_of(corners), first: tet_of(first), second: tet_of(second) }
            }
            other => other,
        })
        .collect();
    Err(BadTets { defects })
}
