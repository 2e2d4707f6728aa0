//! Which faces a blade's path opens: those between elements on different sides of it.
//!
//! Once a path has passed through an element, all corners of each part of the element are on the path or on the same
//! side of it. A part with a corner that is not on the path is on this corner's side. Faces that open have all their
//! corners on the path, so elements at a corner that is not on the path stay connected around it. An element with all
//! corners on the path goes with the neighbours that it shares most area with: so none is cut off on its own.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;

use super::cut_path::{OpenCut, PathNode};
use super::topology::{TetFace, Volume};
use trocar_scene::mesh::tet_faces::OPPOSITE;

/// Number of elements above which no more are looked at for one sweep.
const AT_ONCE_MAX: usize = 1 << 16;

/// Volume of the largest crumb, relative to the cube of the shortest edge: a third of an element of a box mesh.
const CRUMB: f64 = 4.0;

/// Minimum cosine between the normals of the path and of a face that lies along it.
const ALONG: f64 = 0.85;

/// An element at the path.
#[derive(Clone, Copy, Debug)]
struct AtPath {
    /// Which corners are on the path.
    on: [bool; 4],
    /// Normal of the path nearby.
    normal: Vector3<f64>,
    /// Which corners the blade has come to.
    reached: [bool; 4],
    /// Whether it is above the path; unknown if all its corners are on it.
    above: Option<bool>,
}

impl AtPath {
    /// Whether all corners of the face opposite to a corner are on the path.
    fn has_face(&self, corner: usize) -> bool {
        OPPOSITE[corner].iter().all(|&at| self.on[at])
    }

    /// Whether the blade has come to all of them.
    fn opens(&self, corner: usize) -> bool {
        OPPOSITE[corner].iter().all(|&at| self.reached[at])
    }
}

impl Volume {
    /// Faces that a path opens at nodes which it has reached now, with the path's planes there, all facing the same
    /// side.
    pub(super) fn passed(&self, reached: &BTreeMap<u32, PathNode>, slit: &OpenCut) -> Vec<TetFace> {
        let about: BTreeSet<u32> =
            reached.keys().flat_map(|&node| self.around[node as usize].iter().copied()).collect();
        let mut at_path: BTreeMap<u32, AtPath> = BTreeMap::new();
        let mut next: Vec<(u32, PathNode)> = Vec::new();
        for tet in about {
            let Some(nodes) = self.tet(tet) else { continue };
            let Some(plane) = nodes.iter().find_map(|node| reached.get(node)) else { continue };
            next.push((tet, *plane));
        }
        // An element with all corners on the path is decided with all of them around it.
        let first = next.len();
        let mut at = 0;
        while let Some(&(tet, plane)) = next.get(at) {
            at += 1;
            let Some(nodes) = self.tet(tet).filter(|_| !at_path.contains_key(&tet)) else { continue };
            let own = self.at_path(&nodes, &plane, slit);
            at_path.insert(tet, own);
            if (at <= first || own.above.is_none()) && at_path.len() < AT_ONCE_MAX {
                let faces = (0..4).filter(|&corner| own.has_face(corner));
                next.extend(faces.filter_map(|corner| Some((self.neighbours[tet as usize][corner]?, plane))));
            }
        }
        self.decide(&mut at_path);
        let mut faces = Vec::new();
        for (&tet, own) in &at_path {
            for (corner, next) in self.neighbours[tet as usize].iter().enumerate() {
                let Some(beyond) = next.filter(|&next| next > tet).and_then(|next| at_path.get(&next)) else {
                    continue;
                };
                let differ = matches!((own.above, beyond.above), (Some(a), Some(b)) if a != b);
                if own.opens(corner) && (differ || self.lies_along(own, beyond, (tet, corner as u8))) {
                    faces.push((tet, corner as u8));
                }
            }
        }
        self.spare_crumbs(&mut faces, CRUMB * slit.edge_min.powi(3));
        faces
    }

    /// Whether a face lies along the path between two elements that are not all on it: then one is above, the other
    /// below, also where the path bends so much that its planes do not tell.
    fn lies_along(&self, one: &AtPath, other: &AtPath, face: TetFace) -> bool {
        let Some([a, b, c]) = self.face(face).map(|nodes| nodes.map(|node| self.rest[node as usize])) else {
            return false;
        };
        let normal = (b - a).cross(&(c - a));
        let all_on = [one, other].iter().any(|of| of.on == [true; 4]);
        !all_on && normal.dot(&one.normal).abs() > ALONG * normal.norm()
    }

    /// Leaves out faces so that nothing smaller than this comes off \[m³\]: a crumb stays at its largest face.
    fn spare_crumbs(&self, faces: &mut Vec<TetFace>, volume_max: f64) {
        faces.sort_unstable();
        let beyond = |tet: u32, corner: usize| {
            let next = self.neighbours[tet as usize][corner]?;
            let back = self.neighbours[next as usize].iter().position(|side| *side == Some(tet))?;
            Some((next, (tet, corner as u8).min((next, back as u8))))
        };
        let sides: BTreeSet<u32> = faces
            .iter()
            .flat_map(|&(tet, corner)| [Some(tet), self.neighbours[tet as usize][corner as usize]])
            .flatten()
            .filter(|&tet| self.volumes[tet as usize] < volume_max)
            .collect();
        for first in sides {
            let (mut part, mut at, mut volume) = (vec![first], 0, 0.0);
            let mut largest: Option<(f64, TetFace)> = None;
            while let Some(&tet) = part.get(at) {
                at += 1;
                volume += self.volumes[tet as usize];
                if volume >= volume_max {
                    break;
                }
                for (next, face) in (0..4).filter_map(|corner| beyond(tet, corner)) {
                    if faces.binary_search(&face).is_err() {
                        if !part.contains(&next) {
                            part.push(next);
                        }
                    } else if largest.is_none_or(|(area, _)| self.area(face) > area) {
                        largest = Some((self.area(face), face));
                    }
                }
            }
            if volume < volume_max
                && let Some((_, face)) = largest
                && let Ok(at) = faces.binary_search(&face)
            {
                faces.remove(at);
            }
        }
    }

    fn at_path(&self, nodes: &[u32; 4], plane: &PathNode, slit: &OpenCut) -> AtPath {
        let place = self.rest[plane.node as usize];
        let planes = nodes.map(|node| slit.same_path(&self.rest, node, plane, &place));
        let on = planes.map(|plane| plane.is_some());
        // Where the path bends upwards it is the highest of its planes, where it bends downwards the lowest.
        let (mut up, mut down) = (0.0_f64, 0.0_f64);
        for one in planes.iter().flatten() {
            for other in planes.iter().flatten() {
                let over = one.above(&self.rest, &other.foot(&self.rest[other.node as usize]));
                (up, down) = (up.max(over), down.max(-over));
            }
        }
        let mut height = 0.0;
        for (_, node) in planes.iter().zip(nodes).filter(|(plane, _)| plane.is_none()) {
            let place = self.rest[*node as usize];
            let above = planes.iter().flatten().map(|plane| plane.above(&self.rest, &place));
            height += if up.min(down) > slit.near() {
                above.sum::<f64>()
            } else if up > down {
                above.fold(f64::INFINITY, f64::min)
            } else {
                above.fold(f64::NEG_INFINITY, f64::max)
            };
        }
        let reached = planes.map(|plane| plane.is_some_and(|plane| !plane.ahead));
        AtPath {
            on,
            normal: plane.normal_in_rest,
            reached,
            above: on.contains(&false).then_some(height > 0.0),
        }
    }

    /// Decides on which side the elements are that have all corners on the path.
    fn decide(&self, at_path: &mut BTreeMap<u32, AtPath>) {
        let undecided = |at_path: &BTreeMap<u32, AtPath>| {
            let them = at_path.iter().filter(|(_, own)| own.above.is_none());
            them.map(|(tet, _)| *tet).collect::<Vec<u32>>()
        };
        let mut left = undecided(at_path);
        loop {
            let before = left.len();
            for &tet in &left {
                let mut areas = [0.0; 2];
                for (corner, next) in self.neighbours[tet as usize].iter().enumerate() {
                    let above = next.and_then(|next| at_path.get(&next)).and_then(|beyond| beyond.above);
                    if let Some(above) = above {
                        areas[usize::from(above)] += self.area((tet, corner as u8));
                    }
                }
                if areas[0] != areas[1]
                    && let Some(own) = at_path.get_mut(&tet)
                {
                    own.above = Some(areas[1] > areas[0]);
                } else if areas[0] > 0.0
                    && let Some(own) = at_path.get_mut(&tet)
                {
                    own.above = Some(true);
                }
            }
            left = undecided(at_path);
            if left.is_empty() || left.len() == before {
                return;
            }
        }
    }

    fn area(&self, face: TetFace) -> f64 {
        let Some(corners) = self.face(face) else { return 0.0 };
        let [a, b, c] = corners.map(|node| self.rest[node as usize]);
        (b - a).cross(&(c - a)).norm() / 2.0
    }
}
