//! Surface of a divisible volume: the face of an element under each triangle, before and after topology changes.

use std::collections::BTreeMap;

use trocar_dynamics::soft_body::method::SurfaceChange;
use trocar_dynamics::tet_mesh::{TetFace, Volume, VolumeChange};

/// The surface `old` after a change, as faces of elements: its remaining triangles, then the uncovered ones, the first
/// `burned` of them from before any split, then the other halves of split triangles.
pub(super) fn after_change(
    volume: &Volume,
    mut old: Vec<TetFace>,
    change: &VolumeChange,
    burned: usize,
) -> (Vec<TetFace>, SurfaceChange) {
    let mut bare = change.uncovered[..burned].to_vec();
    let mut halves: Vec<(TetFace, Triangle)> = Vec::new();
    let mut known: BTreeMap<TetFace, Triangle> = BTreeMap::new();
    if !change.halved.is_empty() {
        known.extend(old.iter().enumerate().map(|(at, face)| (*face, Triangle::Old(at))));
        known.extend(bare.iter().enumerate().map(|(at, face)| (*face, Triangle::Bare(at))));
    }
    for halved in &change.halved {
        for (face, half) in halved.faces() {
            let Some(&triangle) = known.get(&face) else { continue };
            let own = match triangle {
                Triangle::Bare(_) => {
                    bare.push(half);
                    Triangle::Bare(bare.len() - 1)
                }
                Triangle::Old(_) | Triangle::Half(_) => {
                    halves.push((half, triangle));
                    Triangle::Half(halves.len() - 1)
                }
            };
            known.insert(half, own);
        }
        let [face, moved] = halved.moved_face();
        if let Some(triangle) = known.remove(&face) {
            match triangle {
                Triangle::Old(at) => old[at] = moved,
                Triangle::Bare(at) => bare[at] = moved,
                Triangle::Half(at) => halves[at].0 = moved,
            }
            known.insert(moved, triangle);
        }
    }
    let is_there = |face: &TetFace| volume.tet(face.0).is_some();
    let mut kept = Vec::with_capacity(old.len());
    let mut left: Vec<TetFace> = Vec::with_capacity(old.len() + change.uncovered.len() + halves.len());
    for face in &old {
        kept.push(is_there(face).then_some(left.len() as u32));
        left.extend(is_there(face).then_some(*face));
    }
    left.extend(bare.iter().chain(&change.uncovered[burned..]).filter(|face| is_there(face)));
    let first_half = left.len() as u32;
    let parents = halves.iter().map(|(_, triangle)| match *triangle {
        Triangle::Old(at) => kept[at].unwrap_or_default(),
        Triangle::Half(at) | Triangle::Bare(at) => first_half + at as u32,
    });
    let parents = parents.collect();
    left.extend(halves.iter().map(|(face, _)| *face));
    (left, SurfaceChange { kept: Some(kept), parents })
}

/// Origin of a surface triangle during an update: kept, half of a split one, or uncovered.
#[derive(Clone, Copy)]
enum Triangle {
    Old(usize),
    Half(usize),
    Bare(usize),
}

/// The faces of the triangles, in their order; `None` if the surface is not the boundary.
pub(super) fn faces_of(volume: &Volume, triangles: &[[u32; 3]]) -> Option<Vec<TetFace>> {
    let sorted = |mut nodes: [u32; 3]| {
        nodes.sort_unstable();
        nodes
    };
    let of_boundary = || volume.boundary().filter_map(|face| Some((sorted(volume.face(face)?), face)));
    // Two faces of a slit with shared nodes have the same corners: each is used once.
    let mut known: BTreeMap<[u32; 3], Vec<TetFace>> = BTreeMap::new();
    of_boundary().for_each(|(nodes, face)| known.entry(nodes).or_default().push(face));
    let same_sense = |face: &TetFace, nodes: &[u32; 3]| {
        volume
            .face(*face)
            .is_some_and(|own| (0..3).any(|k| [own[k], own[(k + 1) % 3], own[(k + 2) % 3]] == *nodes))
    };
    let faces: Option<Vec<TetFace>> = triangles
        .iter()
        .map(|nodes| {
            let faces = known.get_mut(&sorted(*nodes))?;
            let at = faces.iter().position(|face| same_sense(face, nodes))?;
            Some(faces.swap_remove(at))
        })
        .collect();
    faces.filter(|_| known.values().all(Vec::is_empty))
}
