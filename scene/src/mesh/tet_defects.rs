//! Defects of tetrahedral meshes: all of them are listed, not only the first.

#![expect(clippy::neg_cmp_op_on_partial_ord, reason = "what is not a number passes no test")]

use std::cmp::Ordering;
use std::fmt;

use nalgebra::{Matrix3, Point3};
use thiserror::Error;

use super::tet_faces::faces;

/// Criteria for bad elements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshRules {
    /// The least mean ratio of an element, in (0, 1]: 12 (3 V)^(2/3) over the sum of its squared edges, 1 for a regular
    /// tetrahedron (Liu, Joe 1994). Below it an element is called a sliver.
    pub mean_ratio_min: f64,
    /// Nodes closer than this count as coincident \[m\]; `None` where a cut may have duplicated them.
    pub coincident_within: Option<f64>,
}

impl Default for MeshRules {
    fn default() -> Self {
        Self { mean_ratio_min: 0.02, coincident_within: Some(0.0) }
    }
}

/// One defect of a mesh, with nodes and elements by their indices in the input.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum Defect {
    /// The mesh is empty.
    #[error("there are no tetrahedra")]
    Empty,
    /// Too many nodes or elements for the index type.
    #[error("{nodes} nodes and {tets} tetrahedra are more than {} can be told apart", u32::MAX / 4)]
    TooMany {
        /// Nodes.
        nodes: usize,
        /// Elements.
        tets: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("node {node} has a coordinate that is not a finite number")]
    NotFinite {
        /// The node.
        node: u32,
    },
    /// An element refers to a node that does not exist.
    #[error("tetrahedron {tet} names node {node}, but there are {nodes}: 0 to {nodes} - 1 are valid")]
    NoNode {
        /// The element.
        tet: u32,
        /// The index it refers to.
        node: u32,
        /// Number of nodes.
        nodes: usize,
    },
    /// An element refers to a node twice.
    #[error("tetrahedron {tet} names node {node} more than once")]
    RepeatedCorner {
        /// The element.
        tet: u32,
        /// The node.
        node: u32,
    },
    /// An element is inverted.
    #[error("tetrahedron {tet} is inverted: its volume is {volume:e} m³")]
    Inverted {
        /// The element.
        tet: u32,
        /// Its volume \[m³\].
        volume: f64,
    },
    /// An element has no volume, relative to its edges.
    #[error("tetrahedron {tet} is flat: its volume is {volume:e} m³")]
    Flat {
        /// The element.
        tet: u32,
        /// Its volume \[m³\].
        volume: f64,
    },
    /// An element is too badly shaped (a sliver).
    #[error(
        "tetrahedron {tet} is a sliver: its mean ratio is {mean_ratio:.2e}, at least {least} is asked for"
    )]
    Sliver {
        /// The element.
        tet: u32,
        /// Its mean ratio.
        mean_ratio: f64,
        /// The required minimum.
        least: f64,
    },
    /// Two elements have the same four corners.
    #[error("tetrahedra {first} and {second} have the same corners")]
    SameCorners {
        /// The first element.
        first: u32,
        /// The second element.
        second: u32,
    },
    /// More than two elements share a face.
    #[error(
        "face {corners:?} belongs to {count} tetrahedra, {first} and {second} among them: at most two can share it"
    )]
    SharedFace {
        /// Its corners, ascending.
        corners: [u32; 3],
        /// How many share it.
        count: usize,
        /// The first of them.
        first: u32,
        /// The second.
        second: u32,
    },
    /// Two elements lie on the same side of the face that they share.
    #[error("tetrahedra {first} and {second} overlap: they lie on the same side of face {corners:?}")]
    Overlap {
        /// Corners of the face, ascending.
        corners: [u32; 3],
        /// The first element.
        first: u32,
        /// The second element.
        second: u32,
    },
    /// Two nodes at the same place.
    #[error("nodes {first} and {second} are at the same place")]
    Coincident {
        /// The smaller.
        first: u32,
        /// The larger.
        second: u32,
    },
    /// A node without any element.
    #[error("node {node} belongs to no tetrahedron")]
    Unreferenced {
        /// The node.
        node: u32,
    },
}

/// Error for an unusable mesh, with all its defects.
#[derive(Clone, Debug, PartialEq)]
pub struct BadTets {
    /// Every defect: of nodes, of elements, of faces.
    pub defects: Vec<Defect>,
}

/// Defects of a kind that a message shows; the rest are counted.
const SHOWN: usize = 4;

impl fmt::Display for BadTets {
    /// Shows some of every kind, so that frequent kinds do not hide rare ones.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let count = self.defects.len();
        write!(out, "the tetrahedral mesh has {count} defect{}", if count == 1 { "" } else { "s" })?;
        let mut told = Vec::new();
        for defect in &self.defects {
            let kind = std::mem::discriminant(defect);
            if told.contains(&kind) {
                continue;
            }
            let alike = || self.defects.iter().filter(|other| std::mem::discriminant(*other) == kind);
            for one in alike().take(SHOWN) {
                let first = told.is_empty() && std::ptr::eq(one, defect);
                write!(out, "{} {one}", if first { ":" } else { ";" })?;
            }
            match alike().count().saturating_sub(SHOWN) {
                0 => {}
                more => write!(out, "; and {more} more of this kind")?,
            }
            told.push(kind);
        }
        Ok(())
    }
}

impl BadTets {
    /// One sentence for each kind, with the first few of it.
    #[must_use]
    pub fn by_kind(&self) -> Vec<String> {
        let mut kinds: Vec<(std::mem::Discriminant<Defect>, Vec<&Defect>)> = Vec::new();
        for defect in &self.defects {
            let kind = std::mem::discriminant(defect);
            match kinds.iter_mut().find(|(known, _)| *known == kind) {
                Some((_, alike)) => alike.push(defect),
                None => kinds.push((kind, vec![defect])),
            }
        }
        let told = |(_, alike): (_, Vec<&Defect>)| {
            let shown: Vec<String> = alike.iter().take(SHOWN).map(ToString::to_string).collect();
            let more = match alike.len().saturating_sub(SHOWN) {
                0 => String::new(),
                more => format!("; and {more} more of this kind"),
            };
            shown.join("; ") + &more
        };
        kinds.into_iter().map(told).collect()
    }
}

impl std::error::Error for BadTets {}

/// Volume over the cube of the longest edge below which a tetrahedron counts as flat, because its orientation depends
/// on rounding.
const FLAT: f64 = 1e-12;

/// All defects: of nodes, then of elements, then of faces. Elements with invalid nodes are left out of the later tests.
#[must_use]
pub fn tet_defects(rest: &[Point3<f64>], tets: &[[u32; 4]], rules: &MeshRules) -> Vec<Defect> {
    let most = (u32::MAX / 4) as usize;
    if rest.len() > most || tets.len() > most {
        return vec![Defect::TooMany { nodes: rest.len(), tets: tets.len() }];
    }
    if tets.is_empty() {
        return vec![Defect::Empty];
    }
    let mut found = Vec::new();
    let finite: Vec<bool> = rest.iter().map(|point| point.iter().all(|x| x.is_finite())).collect();
    found.extend((0..rest.len()).filter(|&i| !finite[i]).map(|node| Defect::NotFinite { node: node as u32 }));
    coincident(rest, rules, &mut found);
    let mut used = vec![false; rest.len()];
    for node in tets.iter().flatten() {
        if let Some(used) = used.get_mut(*node as usize) {
            *used = true;
        }
    }
    found
        .extend((0..rest.len()).filter(|&i| !used[i]).map(|node| Defect::Unreferenced { node: node as u32 }));

    let mut sound = Vec::with_capacity(tets.len());
    for (index, tet) in tets.iter().enumerate() {
        let before = found.len();
        element(rest, &finite, index as u32, tet, rules, &mut found);
        // An inverted element may still be repaired: its faces count, but with separate orientation from its valid
        // neighbours.
        if found.len() == before {
            sound.push((index as u32, *tet));
        }
    }
    between(&sound, &mut found);
    found
}

/// Tests of a single element.
fn element(
    rest: &[Point3<f64>],
    finite: &[bool],
    tet: u32,
    corners: &[u32; 4],
    rules: &MeshRules,
    found: &mut Vec<Defect>,
) {
    let before = found.len();
    for (i, &node) in corners.iter().enumerate() {
        if node as usize >= rest.len() {
            found.push(Defect::NoNode { tet, node, nodes: rest.len() });
        } else if corners[..i].contains(&node) {
            found.push(Defect::RepeatedCorner { tet, node });
        }
    }
    if found.len() > before || corners.iter().any(|&node| !finite[node as usize]) {
        return;
    }
    let shape = tet_shape(rest, corners);
    let volume = shape.determinant() / 6.0;
    let longest = shape.column_iter().map(|edge| edge.norm()).fold(0.0, f64::max);
    // The negation holds for an overflow too.
    if !(volume.abs() > FLAT * longest.powi(3)) {
        found.push(Defect::Flat { tet, volume });
        return;
    }
    if volume < 0.0 {
        found.push(Defect::Inverted { tet, volume });
    }
    let mean_ratio = mean_ratio(rest, corners).abs();
    if !(mean_ratio >= rules.mean_ratio_min) {
        found.push(Defect::Sliver { tet, mean_ratio, least: rules.mean_ratio_min });
    }
}

/// Tests between elements: equal corners, faces shared by too many.
fn between(sound: &[(u32, [u32; 4])], found: &mut Vec<Defect>) {
    let mut by_corners: Vec<_> = sound
        .iter()
        .map(|&(index, mut corners)| {
            corners.sort_unstable();
            (corners, index)
        })
        .collect();
    by_corners.sort_unstable();
    let mut repeated = Vec::new();
    for same in by_corners.chunk_by(|one, other| one.0 == other.0) {
        for &(_, second) in &same[1..] {
            found.push(Defect::SameCorners { first: same[0].1, second });
            repeated.push(second);
        }
    }
    repeated.sort_unstable();
    let apart: Vec<_> =
        sound.iter().filter(|(index, _)| repeated.binary_search(index).is_err()).copied().collect();
    let corners: Vec<_> = apart.iter().map(|&(_, corners)| corners).collect();
    for same in faces(&corners).chunk_by(|one, other| one.sorted == other.sorted) {
        let number = |which: usize| apart[same[which].tet as usize].0;
        if same.len() > 2 {
            let (first, second) = (number(0), number(1));
            found.push(Defect::SharedFace { corners: same[0].sorted, count: same.len(), first, second });
        } else if same.len() == 2 && same[0].ascending() == same[1].ascending() {
            let (first, second) = (number(0), number(1));
            found.push(Defect::Overlap { corners: same[0].sorted, first, second });
        }
    }
}

/// Nodes at the same place, each with the smallest number there.
fn coincident(rest: &[Point3<f64>], rules: &MeshRules, found: &mut Vec<Defect>) {
    let Some(within) = rules.coincident_within else { return };
    found.extend(
        pairs_within(rest, within).into_iter().map(|[first, second]| Defect::Coincident { first, second }),
    );
}

/// Pairs (smaller, larger) of nodes that are within a distance, each larger one once, ascending by the larger.
pub(super) fn pairs_within(rest: &[Point3<f64>], within: f64) -> Vec<[u32; 2]> {
    let mut order: Vec<u32> =
        (0..rest.len() as u32).filter(|&i| rest[i as usize].iter().all(|x| x.is_finite())).collect();
    let key = |node: u32| rest[node as usize];
    let by_place = |one: &u32, other: &u32| {
        let (one, other) = (key(*one), key(*other));
        let axes = one.iter().zip(other.iter()).map(|(a, b)| a.partial_cmp(b).unwrap_or(Ordering::Equal));
        axes.fold(Ordering::Equal, Ordering::then)
    };
    // Stable: of nodes at the same place the smaller number stays first.
    order.sort_by(by_place);
    let mut pairs = Vec::new();
    if within <= 0.0 {
        for same in order.chunk_by(|one, other| by_place(one, other).is_eq()) {
            pairs.extend(same[1..].iter().map(|&other| [same[0], other]));
        }
    } else {
        for (at, &one) in order.iter().enumerate() {
            // Along x only nodes within the distance are candidates.
            let near = order[at + 1..].iter().take_while(|&&other| key(other).x - key(one).x <= within);
            let same = near.filter(|&&other| (key(other) - key(one)).norm() <= within);
            pairs.extend(same.map(|&other| [one.min(other), one.max(other)]));
        }
    }
    pairs.sort_unstable_by_key(|&[first, second]| (second, first));
    pairs.dedup_by_key(|pair| pair[1]);
    pairs
}

/// Edges of a tetrahedron from its first corner, as columns \[m\].
///
/// # Panics
/// When a corner is out of range.
#[inline]
#[must_use]
pub fn tet_shape(positions: &[Point3<f64>], tet: &[u32; 4]) -> Matrix3<f64> {
    let [a, b, c, d] = tet.map(|node| positions[node as usize]);
    Matrix3::from_columns(&[b - a, c - a, d - a])
}

/// Mean ratio of a tetrahedron, with the sign of its volume: see [`MeshRules::mean_ratio_min`].
///
/// # Panics
/// When a corner is out of range.
#[inline]
#[must_use]
pub fn mean_ratio(positions: &[Point3<f64>], tet: &[u32; 4]) -> f64 {
    let volume = tet_shape(positions, tet).determinant() / 6.0;
    let corners = tet.map(|node| positions[node as usize]);
    let mut squares = 0.0;
    for i in 0..4 {
        for j in i + 1..4 {
            squares += (corners[j] - corners[i]).norm_squared();
        }
    }
    if squares > 0.0 { volume.signum() * 12.0 * (3.0 * volume.abs()).powf(2.0 / 3.0) / squares } else { 0.0 }
}
