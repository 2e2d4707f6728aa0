//! Low-rank correction of an inverse for a body that has changed: removed elements, split nodes. Each change adds
//! unknowns w to the displacements u of the inverse, in a system
//!
//! ```text
//! K   G     u     f
//! Gᵀ  H  ·  w  =  p
//! ```
//!
//! with known K⁻¹, so that with Y = K⁻¹ G and T = H − Gᵀ Y, first T w = p − Yᵀ f and then u = K⁻¹ f − Y w. This is
//! exact (the bordering method; the formula of Woodbury 1950 is its case of removed elements); it only becomes slower
//! with every unknown.
//!
//! For a removed element with stiffness U Uᵀ of rank six, w = −Uᵀ u, G = U, H = 1 and p = 0. For a split node, w is its
//! displacement relative to the original node, G and H are the stiffness of the elements attached to the copy, and p is
//! the force on it.

use nalgebra::{DVector, SMatrix, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::TetMesh;

use super::active_set::{ActiveSet, Packed};
use super::bounds::{BATCH, RANK, REMNANT, UNKNOWNS_MAX};
use super::compliance::Boundary;
use super::element_removal::root_of_stiffness;
use crate::linear_algebra::SupernodalCholesky;
use crate::stiffness::stiffness_block;

/// Least pivot of T as a fraction of its diagonal: below, it is dominated by rounding.
const PIVOT_MIN: f64 = 1e-14;

/// One change of a body with respect to its inverse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// A removed element.
    Gone(u32),
    /// A split node, released from its original.
    Apart(u32),
}

/// Three rows of G.
type Block = SMatrix<f64, 3, RANK>;

/// The unknowns of one change.
struct Border {
    change: Change,
    /// Index of the first one, and their number: six or three.
    first: usize,
    count: usize,
    /// Square root of an element's stiffness.
    root: Option<SMatrix<f64, 12, RANK>>,
    /// Non-zero rows of G, by node rows; for a node, the first three columns.
    g: Vec<(u32, Block)>,
}

/// All corrections of an inverse.
#[derive(Default)]
pub(super) struct Correction {
    /// Stiffness factor of each element in the factorisation; empty for 1 everywhere.
    pub weights: Vec<f64>,
    /// Removed elements, in order of removal.
    pub tets: Vec<u32>,
    /// Number of nodes in the factor.
    pub known: usize,
    /// Original node of each copy.
    pub parents: Vec<u32>,
    /// Number of released copies; the others still move with their originals.
    pub released: usize,
    /// For each copy, the first unknowns that its displacement adds to that of its root node.
    homes: Vec<Vec<usize>>,
    borders: Vec<Border>,
    /// Number of changes in each batch.
    batches: Vec<usize>,
    /// Y, over all free nodes, column by column.
    y: Vec<Vec<f64>>,
    t: Packed,
    factored: ActiveSet,
}

/// A force in terms of the correction: p − Yᵀ f, and T⁻¹ times that. The correction of the compliance between two
/// forces is the product of the first of one and the second of the other.
#[derive(Clone, Debug)]
pub(super) struct CorrectedForce {
    pub parts: DVector<f64>,
    pub shares: DVector<f64>,
}

/// Inputs of a correction.
pub(super) struct CorrectionInputs<'a> {
    pub mesh: &'a TetMesh,
    pub material: &'a Elastic,
    pub boundary: &'a Boundary,
    pub factor: &'a mut SupernodalCholesky,
}

impl Correction {
    /// No correction, for an inverse with this many nodes.
    pub fn of(known: usize) -> Self {
        Self { known, ..Self::default() }
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.y.len()
    }

    /// The changes in order, grouped by batch.
    pub fn changes(&self) -> Vec<Vec<Change>> {
        let mut all = self.borders.iter().map(|border| border.change);
        self.batches.iter().map(|count| all.by_ref().take(*count).collect()).collect()
    }

    pub fn weight(&self, tet: u32) -> f64 {
        self.weights.get(tet as usize).copied().unwrap_or(1.0)
    }

    /// Whether an element is removed, or never was in the factor.
    pub fn is_out(&self, tet: u32) -> bool {
        self.weight(tet) <= REMNANT || self.tets.contains(&tet)
    }

    /// Undoes all changes, back to the body of the factor.
    pub fn put_back(&mut self) {
        let (weights, known) = (std::mem::take(&mut self.weights), self.known);
        *self = Self { weights, known, ..Self::default() };
    }

    /// Adds split nodes, which move with their originals until they are released.
    pub fn bear(&mut self, parents: &[u32]) {
        for &parent in parents {
            self.homes.push(self.first_unknowns(parent).to_vec());
            self.parents.push(parent);
        }
    }

    /// The root node that a copy descends from.
    pub fn root(&self, mut node: u32) -> u32 {
        while let Some(born) = (node as usize).checked_sub(self.known) {
            node = self.parents[born];
        }
        node
    }

    /// First unknowns that a node's displacement adds to that of the factor.
    fn first_unknowns(&self, node: u32) -> &[usize] {
        (node as usize).checked_sub(self.known).map_or(&[], |born| &self.homes[born])
    }

    /// The unknowns' contribution to a node's displacement \[m\].
    pub fn own(&self, node: u32, unknowns: &[f64]) -> Vector3<f64> {
        self.first_unknowns(node)
            .iter()
            .map(|&first| Vector3::from_column_slice(&unknowns[first..first + 3]))
            .sum()
    }

    /// Removes elements, up to [`BATCH`] unknowns at once; returns how many: all before one that makes the correction
    /// singular.
    pub fn take(&mut self, tets: &[u32], of: &mut CorrectionInputs<'_>) -> usize {
        let mut borders = Vec::new();
        for (&tet, first) in tets.iter().zip((self.unknowns()..).step_by(RANK)) {
            let root = root_of_stiffness(of.mesh, of.material, tet as usize) * self.weight(tet).sqrt();
            let mut g = Vec::new();
            let mut h = Rows::new(first, RANK);
            for (corner, &node) in of.mesh.tets()[tet as usize].iter().enumerate() {
                let block: Block = root.fixed_rows::<3>(3 * corner).into();
                if let Some(row) = of.boundary.numbers[node as usize] {
                    g.push((row, block));
                }
                self.first_unknowns(node).iter().for_each(|&first| h.add(first, &block));
            }
            h.add_identity(1.0);
            let border = Border { change: Change::Gone(tet), first, count: RANK, root: Some(root), g };
            borders.push((border, h));
        }
        let done = self.append(borders, of.factor);
        self.tets.extend_from_slice(&tets[..done]);
        done
    }

    /// Releases the next split nodes, each with its later copies, at most `most` and up to [`BATCH`] unknowns at once;
    /// returns how many. Fewer where there are no more, no room, or a singular pivot.
    pub fn release(&mut self, most: usize, bond: f64, of: &mut CorrectionInputs<'_>) -> usize {
        let (before, mut next) = (self.released, self.unknowns());
        let mut borders = Vec::new();
        // Index among all released nodes, for each that moves.
        let mut going = Vec::new();
        for born in before..self.parents.len().min(before.saturating_add(most)) {
            let node = (self.known + born) as u32;
            if of.boundary.numbers[node as usize].is_none() {
                // A copy of a fixed node is fixed too.
                continue;
            }
            if next + 3 > UNKNOWNS_MAX || borders.len() == BATCH / 3 {
                break;
            }
            self.add_unknowns(born, next);
            borders.push(self.border(node, next, bond, of));
            going.push((born, next));
            next += 3;
        }
        let wanted = going.len();
        let done = self.append(borders, of.factor);
        if done < wanted {
            let least = going[done].1;
            self.homes.iter_mut().for_each(|first_unknowns| first_unknowns.retain(|at| *at < least));
        }
        // Fixed copies are released together with the ones before them.
        let stays = |born: &usize| of.boundary.numbers[self.known + born].is_none();
        let mut end = going.get(done.wrapping_sub(1)).map_or(before, |(born, _)| born + 1);
        while end < self.parents.len() && stays(&end) {
            end += 1;
        }
        self.released = end;
        end - before
    }

    /// Adds three unknowns to a node and its later copies.
    fn add_unknowns(&mut self, first_born: usize, unknown: usize) {
        let mut descends = vec![false; self.parents.len()];
        for born in first_born..self.parents.len() {
            let parent = (self.parents[born] as usize).checked_sub(self.known);
            descends[born] = born == first_born || parent.is_some_and(|parent| descends[parent]);
            if descends[born] {
                self.homes[born].push(unknown);
            }
        }
    }

    /// Number of copies not yet released.
    pub fn waiting(&self) -> usize {
        self.parents.len() - self.released
    }

    /// G and H for releasing a node, from the elements attached to it and to copies still moving with it.
    fn border(&self, node: u32, first: usize, bond: f64, of: &CorrectionInputs<'_>) -> (Border, Rows) {
        let mut g: Vec<(u32, Block)> = Vec::new();
        let mut h = Rows::new(first, 3);
        let goes = |other: u32| other >= node && self.first_unknowns(other).contains(&first);
        for (tet, nodes) in of.mesh.tets().iter().enumerate() {
            if !nodes.iter().any(|&other| goes(other)) {
                continue;
            }
            let gradients = of.mesh.gradients(tet);
            let volume = of.mesh.volumes()[tet] * self.weight(tet as u32);
            for l in (0..4).filter(|&l| goes(nodes[l])) {
                for (k, &other) in nodes.iter().enumerate() {
                    let mut block = Block::zeros();
                    let own = stiffness_block(of.material, volume, &gradients[k], &gradients[l]);
                    block.fixed_columns_mut::<3>(0).copy_from(&own);
                    if let Some(row) = of.boundary.numbers[other as usize] {
                        match g.iter_mut().find(|(known, _)| *known == row) {
                            Some((_, sum)) => *sum += block,
                            None => g.push((row, block)),
                        }
                    }
                    self.first_unknowns(other).iter().for_each(|&at| h.add(at, &block));
                }
            }
        }
        for border in &self.borders {
            let (Change::Gone(tet), Some(root)) = (border.change, &border.root) else { continue };
            for (corner, &other) in of.mesh.tets()[tet as usize].iter().enumerate() {
                if goes(other) {
                    h.add_turned(border.first, &root.fixed_rows::<3>(3 * corner).into());
                }
            }
        }
        h.add_identity(bond);
        (Border { change: Change::Apart(node), first, count: 3, root: None, g }, h)
    }

    /// Adds the unknowns of changes, solving for all columns at once; returns how many: all before one with a singular
    /// pivot.
    fn append(&mut self, borders: Vec<(Border, Rows)>, factor: &mut SupernodalCholesky) -> usize {
        let rows = factor.rows();
        let columns: usize = borders.iter().map(|(border, _)| border.count).sum();
        if columns == 0 || rows == 0 {
            return 0;
        }
        let mut all = vec![0.0; columns * rows];
        let mut columns = all.chunks_exact_mut(rows);
        for (border, _) in &borders {
            for (own, column) in columns.by_ref().take(border.count).enumerate() {
                for (row, block) in &border.g {
                    (0..3).for_each(|axis| column[3 * *row as usize + axis] += block[(axis, own)]);
                }
            }
        }
        factor.solve(&mut all);
        let (mut solved, mut done) = (all.chunks_exact(rows), 0);
        for (border, h) in borders {
            let own: Vec<Vec<f64>> = solved.by_ref().take(border.count).map(<[f64]>::to_vec).collect();
            if !self.extend(border, &h, own) {
                break;
            }
            done += 1;
        }
        if done > 0 {
            self.batches.push(done);
        }
        done
    }

    /// Adds the unknowns of one change with its columns of Y; `false`, with nothing changed, where a pivot is singular.
    fn extend(&mut self, border: Border, h: &Rows, y: Vec<Vec<f64>>) -> bool {
        let (first, count) = (border.first, border.count);
        self.y.extend(y);
        self.borders.push(border);
        for row in first..first + count {
            let begin = self.t.values.len();
            self.t.values.extend((0..=row).map(|other| h.at(row - first, other)));
            let entries = &mut self.t.values[begin..];
            for border in &self.borders {
                for of in (border.first..border.first + border.count).take_while(|of| *of <= row) {
                    entries[of] -= border.against(of - border.first, &self.y[row]);
                }
            }
            self.t.size += 1;
            if !self.factored.append_above(row, &self.t, PIVOT_MIN) {
                self.forget(first);
                return false;
            }
        }
        true
    }

    /// Removes the unknowns from `first` on, those of the last change.
    fn forget(&mut self, first: usize) {
        while self.factored.rows.len() > first {
            self.factored.delete(self.factored.rows.len() - 1);
        }
        while self.t.size > first {
            self.t.remove(self.t.size - 1);
        }
        self.y.truncate(first);
        self.borders.pop();
    }

    /// A force, given by nodes, in terms of the correction. `None` without changes.
    pub fn through(
        &self,
        boundary: &Boundary,
        forces: impl Iterator<Item = (u32, Vector3<f64>)> + Clone,
    ) -> Option<CorrectedForce> {
        if self.y.is_empty() {
            return None;
        }
        let mut parts = self.pulls(forces.clone());
        for (part, y) in parts.iter_mut().zip(&self.y) {
            for (node, force) in forces.clone() {
                if let Some(row) = boundary.numbers[node as usize] {
                    *part -= (0..3).map(|axis| y[3 * row as usize + axis] * force[axis]).sum::<f64>();
                }
            }
        }
        let mut shares = parts.clone();
        self.factored.solve(shares.as_mut_slice());
        Some(CorrectedForce { parts, shares })
    }

    /// Forces on the unknowns: p.
    pub fn pulls(&self, forces: impl Iterator<Item = (u32, Vector3<f64>)>) -> DVector<f64> {
        let mut pulls = DVector::zeros(self.y.len());
        for (node, force) in forces {
            for &first in self.first_unknowns(node) {
                (0..3).for_each(|axis| pulls[first + axis] += force[axis]);
            }
        }
        pulls
    }

    /// Corrects a solution of the factor over all free nodes for forces on the unknowns; returns the unknowns.
    pub fn correct(&self, x: &mut [f64], pulls: DVector<f64>) -> DVector<f64> {
        let mut unknowns = pulls;
        for border in &self.borders {
            (0..border.count).for_each(|of| unknowns[border.first + of] -= border.against(of, x));
        }
        self.factored.solve(unknowns.as_mut_slice());
        for (y, own) in self.y.iter().zip(unknowns.iter()) {
            x.iter_mut().zip(y).for_each(|(x, y)| *x -= own * y);
        }
        unknowns
    }

    /// Adds the unknowns' contribution to the free surface nodes of the inverse.
    pub fn add_to_surface(&self, boundary: &Boundary, unknowns: &DVector<f64>, to: &mut [f32]) {
        for (y, own) in self.y.iter().zip(unknowns.iter()) {
            for (to, row) in to.chunks_exact_mut(3).zip(boundary.rows_of_surface()) {
                (0..3).for_each(|axis| to[axis] -= (own * y[3 * row + axis]) as f32);
            }
        }
    }
}

impl Border {
    /// Product of one column of G with a vector of the free nodes.
    fn against(&self, of: usize, x: &[f64]) -> f64 {
        let rows = self.g.iter().map(|(row, block)| {
            (0..3).map(|axis| block[(axis, of)] * x[3 * *row as usize + axis]).sum::<f64>()
        });
        rows.sum()
    }
}

/// Rows of H: the unknowns of one change with all earlier ones and with themselves.
struct Rows {
    first: usize,
    count: usize,
    values: Vec<f64>,
}

impl Rows {
    fn new(first: usize, count: usize) -> Self {
        Self { first, count, values: vec![0.0; count * (first + count)] }
    }

    fn at(&self, own: usize, other: usize) -> f64 {
        self.values[own * (self.first + self.count) + other]
    }

    /// Adds a block of three unknowns starting at `at`.
    fn add(&mut self, at: usize, block: &Block) {
        let stride = self.first + self.count;
        for own in 0..self.count {
            (0..3).for_each(|axis| self.values[own * stride + at + axis] += block[(axis, own)]);
        }
    }

    /// Adds the transposed block with an element's unknowns starting at `at`.
    fn add_turned(&mut self, at: usize, block: &Block) {
        let stride = self.first + self.count;
        for own in 0..self.count {
            (0..RANK).for_each(|mode| self.values[own * stride + at + mode] += block[(own, mode)]);
        }
    }

    fn add_identity(&mut self, times: f64) {
        let stride = self.first + self.count;
        (0..self.count).for_each(|own| self.values[own * stride + self.first + own] += times);
    }
}
