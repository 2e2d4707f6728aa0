//! Sparse Cholesky factorisation of the step's matrix of a network of springs: symbolic once per network, numeric in
//! each step. It orders the rows itself, and lets the library choose between supernodes and columns, unlike
//! [`crate::linear_algebra::SupernodalCholesky`].

use std::sync::Arc;

use faer::dyn_stack::{MemBuffer, MemStack};
use faer::linalg::cholesky::llt::factor::LltRegularization;
use faer::perm::PermRef;
use faer::sparse::linalg::cholesky::{
    CholeskySymbolicParams, SymbolicCholesky, SymmetricOrdering, factorize_symbolic_cholesky,
};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Conj, MatMut, Par, Side, Spec};
use nalgebra::{DVector, Matrix3, Vector3};
use trocar_dynamics::particles::StepError;

use super::StepMatrix;
use super::rigid_operator::RigidOperator;
use crate::linear_algebra::nested_dissection;
use crate::mass_spring::matrix::pairs;
use crate::mass_spring::{Contact, Network};

/// The lower triangle, by columns.
pub(super) struct NetworkCholesky {
    pattern: Arc<SymbolicSparseColMat<usize>>,
    symbolic: Option<Arc<SymbolicCholesky<usize>>>,
    /// Blocks of each block column, as (row, column) sorted by column, then row; the diagonal block first.
    starts: Vec<usize>,
    rows: Vec<u32>,
    values: Vec<f64>,
    factor: Vec<f64>,
    right: Vec<f64>,
    scratch: MemBuffer,
}

impl std::fmt::Debug for NetworkCholesky {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("NetworkCholesky").field("blocks", &self.rows.len()).finish_non_exhaustive()
    }
}

impl Clone for NetworkCholesky {
    fn clone(&self) -> Self {
        Self {
            pattern: Arc::clone(&self.pattern),
            symbolic: self.symbolic.clone(),
            starts: self.starts.clone(),
            rows: self.rows.clone(),
            values: self.values.clone(),
            factor: self.factor.clone(),
            right: self.right.clone(),
            scratch: scratch(self.symbolic.as_deref()),
        }
    }
}

/// Elimination order of a network with a known rest shape, since minimum degree is poor on large grids; empty without
/// one.
fn order(network: &Network, starts: &[usize], rows: &[u32]) -> Vec<usize> {
    if network.rest.len() != network.masses.len() {
        return Vec::new();
    }
    let edges = (0..network.rest.len())
        .flat_map(|node| rows[starts[node]..starts[node + 1]].iter().map(move |&row| (node as u32, row)));
    let nodes = nested_dissection(&network.rest, edges);
    nodes.into_iter().flat_map(|node| (0..3).map(move |axis| 3 * node as usize + axis)).collect()
}

fn scratch(symbolic: Option<&SymbolicCholesky<usize>>) -> MemBuffer {
    let needed = symbolic.map(|symbolic| {
        symbolic
            .factorize_numeric_llt_scratch::<f64>(Par::Seq, Spec::default())
            .or(symbolic.solve_in_place_scratch::<f64>(1, Par::Seq))
    });
    MemBuffer::new(needed.unwrap_or_default())
}

impl NetworkCholesky {
    pub fn new(network: &Network) -> Self {
        let nodes = network.masses.len();
        let mut blocks: Vec<(u32, u32)> = (0..nodes as u32).map(|node| (node, node)).collect();
        let mut add = |a: u32, b: u32| blocks.push((a.min(b), a.max(b)));
        network.springs.iter().for_each(|spring| add(spring.nodes[0], spring.nodes[1]));
        for hinge in &network.hinges {
            pairs(&hinge.nodes, &hinge.weights, |a, b, _| add(a, b));
        }
        network.tets.iter().for_each(|tet| pairs(&tet.nodes, &[1.0; 4], |a, b, _| add(a, b)));
        blocks.sort_unstable();
        blocks.dedup();
        let mut starts = vec![0; nodes + 1];
        blocks.iter().for_each(|&(column, _)| starts[column as usize + 1] += 1);
        (0..nodes).for_each(|node| starts[node + 1] += starts[node]);
        let rows: Vec<u32> = blocks.into_iter().map(|(_, row)| row).collect();

        let (mut column_starts, mut scalar_rows) = (vec![0], Vec::with_capacity(9 * rows.len()));
        for node in 0..nodes {
            for axis in 0..3 {
                for &row in &rows[starts[node]..starts[node + 1]] {
                    let from = if row as usize == node { axis } else { 0 };
                    scalar_rows.extend((from..3).map(|of| 3 * row as usize + of));
                }
                column_starts.push(scalar_rows.len());
            }
        }
        let values = vec![0.0; scalar_rows.len()];
        let pattern =
            SymbolicSparseColMat::new_checked(3 * nodes, 3 * nodes, column_starts, None, scalar_rows);
        let order = order(network, &starts, &rows);
        let mut inverse = vec![0; order.len()];
        order.iter().enumerate().for_each(|(place, &row)| inverse[row] = place);
        let ordering = if order.is_empty() {
            SymmetricOrdering::Amd
        } else {
            SymmetricOrdering::Custom(PermRef::new_checked(&order, &inverse, order.len()))
        };
        // Out of memory is the only failure; the first step reports it.
        let symbolic = factorize_symbolic_cholesky(
            pattern.as_ref(),
            Side::Lower,
            ordering,
            CholeskySymbolicParams::default(),
        )
        .ok()
        .map(Arc::new);
        let factor = vec![0.0; symbolic.as_ref().map_or(0, |symbolic| symbolic.len_val())];
        let scratch = scratch(symbolic.as_deref());
        Self {
            pattern: Arc::new(pattern),
            symbolic,
            starts,
            rows,
            values,
            factor,
            right: vec![0.0; 3 * nodes],
            scratch,
        }
    }

    /// Index of the first number in each of a block's three columns; `None` for a pair outside the pattern.
    fn place(&self, row: u32, column: u32) -> Option<[usize; 3]> {
        let from = self.starts[column as usize];
        let blocks = &self.rows[from..self.starts[column as usize + 1]];
        let at = blocks.binary_search(&row).ok()?;
        let starts = self.pattern.col_ptr();
        // The diagonal block lacks 0, 1 and 2 numbers in its columns.
        let place = |axis: usize| {
            let skipped = if at == 0 { 0 } else { 3 * at - axis };
            starts[3 * column as usize + axis] + skipped
        };
        Some([place(0), place(1), place(2)])
    }

    pub fn solve(
        &mut self,
        matrix: &StepMatrix,
        network: &Network,
        contacts: &[Contact],
        rigid: &RigidOperator,
        right: &[Vector3<f64>],
        solution: &mut [Vector3<f64>],
    ) -> Result<(), StepError> {
        self.assemble(matrix, network, contacts, rigid);
        let Some(symbolic) = &self.symbolic else { return Err(StepError::Factorisation) };
        for (slot, right) in self.right.chunks_exact_mut(3).zip(right) {
            slot.copy_from_slice(right.as_slice());
        }
        let stack = MemStack::new(&mut self.scratch);
        let factor = symbolic
            .factorize_numeric_llt(
                &mut self.factor,
                SparseColMatRef::new(self.pattern.as_ref().as_ref(), &self.values),
                Side::Lower,
                LltRegularization::default(),
                Par::Seq,
                stack,
                Spec::default(),
            )
            .map_err(|_| StepError::Factorisation)?;
        let rows = self.right.len();
        let vector = MatMut::from_column_major_slice_mut(&mut self.right, rows, 1);
        factor.solve_in_place_with_conj(Conj::No, vector, Par::Seq, stack);
        if let Some((columns, less)) = rigid.gives_way(&matrix.masses) {
            // The rigid bodies give way: a change of low rank (Woodbury 1950).
            let mut solved = columns.clone();
            let many = MatMut::from_column_major_slice_mut(solved.as_mut_slice(), rows, columns.ncols());
            factor.solve_in_place_with_conj(Conj::No, many, Par::Seq, stack);
            let inner = less - columns.tr_mul(&solved);
            let own = columns.tr_mul(&DVector::from_column_slice(&self.right));
            let change = inner.lu().solve(&own).ok_or(StepError::Factorisation)?;
            let change = solved * change;
            self.right.iter_mut().zip(change.iter()).for_each(|(own, change)| *own += change);
        }
        for (slot, solution) in self.right.chunks_exact(3).zip(solution) {
            *solution = Vector3::from_column_slice(slot);
        }
        Ok(())
    }

    fn assemble(
        &mut self,
        matrix: &StepMatrix,
        network: &Network,
        contacts: &[Contact],
        rigid: &RigidOperator,
    ) {
        let mut values = std::mem::take(&mut self.values);
        values.fill(0.0);
        let starts = self.pattern.col_ptr();
        for (node, &mass) in matrix.masses.iter().enumerate() {
            // A held node has a row of its own, with a zero change of velocity.
            let diagonal = if mass > 0.0 { mass } else { network.masses[node] };
            (0..3).for_each(|axis| values[starts[3 * node + axis]] += diagonal);
        }
        let mut add = |a: u32, b: u32, own: Matrix3<f64>| {
            let held = |node: u32| matrix.masses[node as usize] == 0.0;
            if held(a) || held(b) {
                return;
            }
            // Of the lower triangle.
            let own = if a < b { own.transpose() } else { own };
            let Some(places) = self.place(a.max(b), a.min(b)) else { return };
            for (axis, place) in places.into_iter().enumerate() {
                let from = if a == b { axis } else { 0 };
                (from..3).for_each(|of| values[place + of - from] += own[(of, axis)]);
            }
        };
        matrix.for_each_pair(network, contacts, |a, b, weight, block| add(a, b, block.matrix() * weight));
        matrix.squeezed.iter().for_each(|of| of.for_each_pair(&mut add));
        for (joint, axis, stiffness) in rigid.contacts() {
            for (index, (a, share)) in joint.into_iter().enumerate().filter(|(_, (_, share))| *share != 0.0) {
                for (b, weight) in joint[index..].iter().filter(|(_, weight)| *weight != 0.0) {
                    add(a, *b, axis * axis.transpose() * (stiffness * share * weight));
                }
            }
        }
        self.values = values;
    }
}
