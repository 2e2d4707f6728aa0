//! Cuts as barriers to heat.
//!
//! The mesh temperatures move to the cut mesh, in which a vertex on a cut becomes two, one on each side; the lattice
//! keeps its cells, but no heat flows between cells on opposite sides of a cut. Burns are still counted by the elements
//! of the original mesh.

use std::collections::BTreeMap;

use nalgebra::{Point3, Vector3};
use trocar_dynamics::tet_mesh::NodeOrigin;

use super::bioheat_fem::{OrganHeat, element_conduction};
use super::error::ElectrosurgeryError;
use super::material::BODY;
use super::voxelisation::{Tissue, TissueLattice};
use super::{Electrosurgery, ElectrosurgeryState};

/// Tissue after cutting.
#[derive(Clone, Copy, Debug)]
pub struct CutTissue<'a> {
    /// All vertices at rest \[m\], original ones first, and all elements, including removed ones.
    pub tissue: Tissue<'a>,
    /// The original element that each element is a part of.
    pub of: &'a [u32],
    /// Parents of the added vertices, in order; if there are more births than added vertices, the last ones apply.
    pub births: &'a [NodeOrigin],
}

impl CutTissue<'_> {
    fn check(&self, vertices: usize, elements: usize) -> Result<(), ElectrosurgeryError> {
        let wrong = |what: String| Err(ElectrosurgeryError::Parted(what));
        let (all, count) = (self.tissue.positions().len(), self.tissue.element_count());
        if self.of.len() != count {
            return wrong(format!(
                "{} elements are told to be parts of others, {count} are valid",
                self.of.len()
            ));
        }
        if all < vertices || all - vertices > self.births.len() {
            return wrong(format!(
                "{all} vertices, of which {} were born: {vertices} were there",
                self.births.len()
            ));
        }
        if let Some(of) = self.of.iter().find(|of| **of as usize >= elements) {
            return wrong(format!("a part of element {of}: 0 to {elements} - 1 are valid"));
        }
        let first = all - self.births.len();
        for (vertex, birth) in (first..).zip(self.births) {
            if birth.of.iter().any(|of| *of as usize >= vertex) || !(0.0..=1.0).contains(&birth.share) {
                return wrong(format!(
                    "vertex {vertex} comes from {:?}: only ones before it are valid",
                    birth.of
                ));
            }
        }
        self.tissue.check_places()
    }

    /// Births of the vertices after the first `count`.
    fn births_from(&self, count: usize) -> &[NodeOrigin] {
        let first = self.tissue.positions().len() - self.births.len();
        &self.births[count.saturating_sub(first).min(self.births.len())..]
    }
}

/// Quantities at an organ's vertices.
#[derive(Clone, Debug)]
pub(super) struct NodalQuantities {
    pub celsius: Vec<f64>,
    pub damage: Vec<f64>,
    pub capacity: Vec<f64>,
    pub perfusion: Vec<f64>,
    pub held: Vec<bool>,
    /// Original volume of each \[m³\].
    pub whole: Vec<f64>,
}

impl NodalQuantities {
    fn stored(&self) -> f64 {
        self.capacity.iter().zip(&self.celsius).map(|(capacity, celsius)| capacity * (celsius - BODY)).sum()
    }

    /// Transfers to the vertices of `organ`, the last of which are new. Heat is conserved: a vertex between two others
    /// gets the temperature of a linear field, which is exact except where part of the capacity has been removed.
    fn grow(&mut self, births: &[NodeOrigin], organ: &OrganHeat) {
        let before = self.stored();
        let mut shares: Vec<[f64; 2]> = (0..self.whole.len())
            .map(|vertex| {
                let whole = self.whole[vertex].max(f64::MIN_POSITIVE);
                [self.capacity[vertex] / whole, self.perfusion[vertex] / whole]
            })
            .collect();
        let mix = |a: &f64, b: &f64, share: f64| a + (b - a) * share;
        for birth in births {
            self.celsius.push(birth.mix(&self.celsius, mix));
            self.damage.push(birth.mix(&self.damage, mix));
            self.held.push(birth.mix(&self.held, |a, b, share| if share < 0.5 { *a } else { *b }));
            shares.push(birth.mix(&shares, |a, b, share| [0, 1].map(|k| mix(&a[k], &b[k], share))));
        }
        let changed =
            |vertex: usize| self.whole.get(vertex).is_none_or(|whole| *whole != organ.whole[vertex]);
        let changed: Vec<usize> = (0..organ.whole.len()).filter(|vertex| changed(*vertex)).collect();
        self.capacity.resize(organ.whole.len(), 0.0);
        self.perfusion.resize(organ.whole.len(), 0.0);
        for &vertex in &changed {
            let whole = organ.whole[vertex];
            self.capacity[vertex] = (shares[vertex][0] * whole).max(organ.capacity_least[vertex]);
            self.perfusion[vertex] = shares[vertex][1] * whole;
        }
        self.whole.clone_from(&organ.whole);
        let missing = before - self.stored();
        let capacity: f64 = changed.iter().map(|vertex| self.capacity[*vertex]).sum();
        if capacity > 0.0 {
            changed.iter().for_each(|vertex| self.celsius[*vertex] += missing / capacity);
        }
    }
}

impl Electrosurgery {
    /// Transfers heat to tissue that was cut further. Call it after each cut; its cost is proportional to the number of
    /// elements.
    ///
    /// # Errors
    /// Cuts that do not fit the original mesh; nothing has changed then.
    pub fn part(&mut self, parted: &CutTissue<'_>) -> Result<(), ElectrosurgeryError> {
        let nodal = self.nodal();
        self.part_from(parted, nodal)
    }

    pub(super) fn nodal(&self) -> NodalQuantities {
        NodalQuantities {
            celsius: self.organ.celsius.clone(),
            damage: self.organ_damage.clone(),
            capacity: self.organ.capacity.clone(),
            perfusion: self.organ.perfusion.clone(),
            held: self.organ.held.clone(),
            whole: self.organ.whole.clone(),
        }
    }

    fn part_from(
        &mut self,
        parted: &CutTissue<'_>,
        mut nodal: NodalQuantities,
    ) -> Result<(), ElectrosurgeryError> {
        parted.check(self.organ.celsius.len(), self.burns.is_removed.len())?;
        let lattice = TissueLattice::new(&parted.tissue, self.grid.spacing)?
            .parted(parted.of, &cuts(&parted.tissue, &self.rim));
        let mut organ = OrganHeat::new(&parted.tissue, &self.material);
        nodal.grow(parted.births_from(nodal.celsius.len()), &organ);
        self.organ_damage = nodal.damage;
        organ.celsius = nodal.celsius;
        organ.capacity = nodal.capacity;
        organ.perfusion = nodal.perfusion;
        organ.held = nodal.held;
        self.positions = parted.tissue.positions().to_vec();
        self.elements = (0..parted.of.len())
            .map(|element| {
                let mut corners = [0; 4];
                let found = parted.tissue.corners(element);
                corners[..found.len()].copy_from_slice(found);
                (corners, element_conduction(&parted.tissue, element, self.material.conductivity))
            })
            .collect();
        self.parts = parted.of.iter().zip(0..).map(|(of, element)| (*of, element)).collect();
        self.parts.sort_unstable();
        self.organ = organ;
        for element in self.burns.order.clone() {
            self.disconnect(element);
        }
        self.grid.part(lattice);
        Ok(())
    }

    /// Removes the conduction of an original element.
    pub(super) fn disconnect(&mut self, element: u32) {
        let from = self.parts.partition_point(|(of, _)| *of < element);
        for (_, part) in self.parts[from..].iter().take_while(|(of, _)| *of == element) {
            let (corners, conduction) = &self.elements[*part as usize];
            self.organ.disconnect(&corners[..self.corners], conduction);
        }
    }

    /// Restores the state of a mesh that may have been cut further since: the tissue is updated to the present cuts,
    /// with the state's values at its vertices.
    pub(super) fn restore_nodes(
        &mut self,
        state: &ElectrosurgeryState,
        parted: Option<&CutTissue<'_>>,
    ) -> Result<(), ElectrosurgeryError> {
        let nodal = NodalQuantities {
            celsius: state.celsius.clone(),
            damage: state.damage.clone(),
            capacity: state.capacity.clone(),
            perfusion: state.perfusion.clone(),
            held: state.held.clone(),
            whole: if state.whole.is_empty() { self.organ.whole.clone() } else { state.whole.clone() },
        };
        if let Some(parted) = parted {
            return self.part_from(parted, nodal);
        }
        self.organ_damage = nodal.damage;
        self.organ.celsius = nodal.celsius;
        self.organ.capacity = nodal.capacity;
        self.organ.perfusion = nodal.perfusion;
        self.organ.held = nodal.held;
        for element in self.burns.order.clone() {
            self.disconnect(element);
        }
        Ok(())
    }
}

/// A position bit for bit, to find coincident points.
type PointBits = [u64; 3];

fn place_of(point: &Point3<f64>) -> PointBits {
    // Makes −0 equal to 0.
    [point.x, point.y, point.z].map(|x| (x + 0.0).to_bits())
}

/// Boundary of the original mesh: facets, as the positions of their corners, and for a membrane the segments of its
/// rim.
#[derive(Clone, Debug, Default)]
pub(super) struct OriginalBoundary {
    facets: Vec<Vec<Point3<f64>>>,
}

impl OriginalBoundary {
    pub(super) fn of(tissue: &Tissue<'_>) -> Self {
        let positions = tissue.positions();
        let facets = open_facets(tissue);
        Self {
            facets: facets
                .iter()
                .map(|facet| facet.iter().map(|vertex| positions[*vertex as usize]).collect())
                .collect(),
        }
    }

    /// Whether a facet lies on the boundary, by its centre.
    fn has(&self, middle: &Point3<f64>, reach: f64) -> bool {
        self.facets.iter().any(|facet| match facet.as_slice() {
            [a, b] => {
                let along = b - a;
                let share = (along.dot(&(middle - a)) / along.norm_squared()).clamp(0.0, 1.0);
                (a + along * share - middle).norm() < reach
            }
            [a, b, c] => {
                let normal = (b - a).cross(&(c - a));
                let off = normal.dot(&(middle - a)) / normal.norm();
                let sides = [(a, b), (b, c), (c, a)];
                off.abs() < reach
                    && sides.iter().all(|(from, to)| {
                        (*to - *from).cross(&(middle - *from)).dot(&normal) >= -reach * normal.norm()
                    })
            }
            _ => false,
        })
    }
}

/// Facets of a single element, by their vertices: triangles of a volume, edges of a membrane.
fn open_facets(tissue: &Tissue<'_>) -> Vec<Vec<u32>> {
    let mut open: BTreeMap<Vec<u32>, u32> = BTreeMap::new();
    for element in 0..tissue.element_count() {
        let corners = tissue.corners(element);
        for left_out in 0..corners.len() {
            let mut facet: Vec<u32> = (0..corners.len())
                .filter(|corner| *corner != left_out)
                .map(|corner| corners[corner])
                .collect();
            facet.sort_unstable();
            *open.entry(facet).or_default() += 1;
        }
    }
    open.into_iter().filter(|(_, count)| *count == 1).map(|(facet, _)| facet).collect()
}

/// The triangles of cuts, which separate tissue; for a membrane, those across its thickness.
fn cuts(tissue: &Tissue<'_>, rim: &OriginalBoundary) -> Vec<[Point3<f64>; 3]> {
    let positions = tissue.positions();
    let mut twins: BTreeMap<PointBits, u32> = BTreeMap::new();
    positions.iter().for_each(|point| *twins.entry(place_of(point)).or_default() += 1);
    let is_twin = |vertex: &u32| twins[&place_of(&positions[*vertex as usize])] > 1;
    let mut cuts = Vec::new();
    let normals = vertex_normals(tissue);
    for facet in open_facets(tissue) {
        let corners: Vec<Point3<f64>> = facet.iter().map(|vertex| positions[*vertex as usize]).collect();
        let middle = corners.iter().map(|corner| corner.coords).sum::<Vector3<f64>>() / corners.len() as f64;
        // On the original boundary no vertex has a copy, except where a cut ends there.
        let size = (corners[0] - corners[1]).norm();
        if !facet.iter().any(is_twin) || rim.has(&Point3::from(middle), 1e-6 * size) {
            continue;
        }
        match (corners.as_slice(), tissue) {
            (&[a, b, c], _) => cuts.push([a, b, c]),
            (&[a, b], Tissue::Membrane { thickness, .. }) => {
                // Half as thick again, so that it separates in any bend.
                let [na, nb] = [0, 1].map(|end| normals[facet[end] as usize] * (0.75 * thickness));
                cuts.extend([[a - na, b - nb, b + nb], [a - na, b + nb, a + na]]);
            }
            _ => {}
        }
    }
    cuts
}

fn vertex_normals(tissue: &Tissue<'_>) -> Vec<Vector3<f64>> {
    let Tissue::Membrane { positions, triangles, .. } = tissue else { return Vec::new() };
    let mut normals = vec![Vector3::zeros(); positions.len()];
    for triangle in *triangles {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
        let normal = (b - a).cross(&(c - a));
        triangle.iter().for_each(|vertex| normals[*vertex as usize] += normal);
    }
    normals.iter().map(|normal| normal.try_normalize(0.0).unwrap_or_else(Vector3::zeros)).collect()
}
