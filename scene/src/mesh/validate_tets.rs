//! Validation of tetrahedral volumes: inverted, degenerate and duplicate tetrahedra, non-manifold faces.

use std::fmt;
use std::path::Path;

use super::data::{OUTWARD_FACES, TetData};
use super::error::MeshError;
use super::validate::Finding;
use crate::disjoint_sets::DisjointSets;

/// Six volumes over the longest edge cubed, below which a tetrahedron counts as degenerate.
const DEGENERATE: f64 = 1e-9;

/// Findings of [`validate_tets`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TetReport {
    /// Number of vertices.
    pub vertices: usize,
    /// Number of tetrahedra.
    pub tets: usize,
    /// Bodies: sets of tetrahedra connected by faces.
    pub components: usize,
    /// Sum of the signed volumes \[m³\].
    pub volume: f64,
    /// Vertices that no tetrahedron uses.
    pub unreferenced: Finding<u32>,
    /// Tetrahedra of negative volume.
    pub inverted: Finding<usize>,
    /// Tetrahedra with a repeated vertex or without volume.
    pub degenerate: Finding<usize>,
    /// Tetrahedra with the same four vertices as an earlier one.
    pub duplicates: Finding<usize>,
    /// Faces of one tetrahedron: the boundary.
    pub boundary_faces: usize,
    /// Faces of more than two tetrahedra.
    pub non_manifold_faces: Finding<[u32; 3]>,
}

impl fmt::Display for TetReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} vertices, {} tetrahedra, {} bodies, {:.6e} m³; inverted {}, degenerate {}, duplicate {}, \
             non-manifold faces {}, unreferenced vertices {}",
            self.vertices,
            self.tets,
            self.components,
            self.volume,
            self.inverted.count,
            self.degenerate.count,
            self.duplicates.count,
            self.non_manifold_faces.count,
            self.unreferenced.count
        )
    }
}

/// Defects that a caller refuses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TetPolicy {
    /// Refuse tetrahedra of negative volume.
    pub no_inverted: bool,
    /// Refuse tetrahedra without volume.
    pub no_degenerate: bool,
    /// Refuse faces of more than two tetrahedra, and duplicates.
    pub manifold: bool,
}

impl TetPolicy {
    /// Accepts everything.
    pub const ANY: Self = Self { no_inverted: false, no_degenerate: false, manifold: false };
    /// Requirements of a finite-element method.
    pub const SOLID: Self = Self { no_inverted: true, no_degenerate: true, manifold: true };

    /// Applies the policy to a report.
    ///
    /// # Errors
    /// [`MeshError::Refused`] with every finding that is not allowed.
    pub fn require(&self, name: &Path, report: &TetReport) -> Result<(), MeshError> {
        let findings = [
            report.inverted.refuse(self.no_inverted, "inverted tetrahedra (negative volume)"),
            report.degenerate.refuse(self.no_degenerate, "degenerate tetrahedra"),
            report.duplicates.refuse(self.manifold, "duplicate tetrahedra"),
            report.non_manifold_faces.refuse(self.manifold, "face(s) with more than two tetrahedra"),
        ];
        let found: Vec<String> = findings.into_iter().flatten().collect();
        if found.is_empty() {
            Ok(())
        } else {
            Err(MeshError::Refused { file: name.into(), reason: found.join("; ") })
        }
    }
}

/// Finds all defects of a volume whose indices are in range.
///
/// # Panics
/// When an index is out of range; no reader of this module returns such a volume.
pub fn validate_tets(volume: &TetData) -> TetReport {
    let mut report = TetReport {
        vertices: volume.positions.len(),
        tets: volume.tets.len(),
        volume: volume.volume(),
        ..TetReport::default()
    };
    let mut used = vec![false; volume.positions.len()];
    let mut faces = Vec::with_capacity(4 * volume.tets.len());
    let mut keys = Vec::with_capacity(volume.tets.len());
    for (t, tet) in volume.tets.iter().enumerate() {
        let mut key = *tet;
        key.sort_unstable();
        let repeats = key.windows(2).any(|pair| pair[0] == pair[1]);
        if repeats || 6.0 * volume.tet_volume(t).abs() <= DEGENERATE * longest_edge(volume, t).powi(3) {
            report.degenerate.add(t);
        } else if volume.tet_volume(t) < 0.0 {
            report.inverted.add(t);
        }
        keys.push((key, t));
        for local in OUTWARD_FACES {
            let mut face = local.map(|k| tet[k]);
            face.sort_unstable();
            faces.push((face, t));
        }
        tet.iter().for_each(|&v| used[v as usize] = true);
    }
    used.iter().enumerate().filter(|(_, used)| !**used).for_each(|(v, _)| report.unreferenced.add(v as u32));
    keys.sort_unstable();
    let mut repeated: Vec<usize> = keys.windows(2).filter(|p| p[0].0 == p[1].0).map(|p| p[1].1).collect();
    repeated.sort_unstable();
    repeated.into_iter().for_each(|t| report.duplicates.add(t));

    faces.sort_unstable();
    let mut bodies = DisjointSets::new(volume.tets.len());
    for group in faces.chunk_by(|a, b| a.0 == b.0) {
        match group.len() {
            1 => report.boundary_faces += 1,
            2 => {}
            _ => report.non_manifold_faces.add(group[0].0),
        }
        for pair in group.windows(2) {
            bodies.join(pair[0].1, pair[1].1);
        }
    }
    report.components = bodies.sets();
    report
}

fn longest_edge(volume: &TetData, t: usize) -> f64 {
    let corners = volume.tets[t].map(|v| volume.positions[v as usize]);
    let mut longest = 0f64;
    for i in 0..4 {
        for j in i + 1..4 {
            longest = longest.max((corners[i] - corners[j]).norm());
        }
    }
    longest
}
