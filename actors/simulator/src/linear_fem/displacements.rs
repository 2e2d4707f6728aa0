//! Displacements of a linear body: at the surface from the precomputed inverse, in every cycle; inside by a sparse
//! solve.

use nalgebra::Vector3;

use super::solver::{LinearFem, add, spread};
use super::strain_check::Deformation;

impl LinearFem {
    /// Displacements of the free surface nodes \[m\], in the order of [`Self::nodes`], after the last cycle.
    pub fn surface_displacements(&mut self, out: &mut Vec<Vector3<f64>>) {
        self.single.fill(0.0);
        for (row, multiplier) in self.rows.iter().zip(&self.multipliers) {
            if *multiplier != 0.0 {
                add(&mut self.single, &row.compliance, *multiplier as f32);
            }
        }
        for (node, force) in &self.loads {
            let Some(index) = self.boundary.surface_row(*node) else { continue };
            for axis in 0..3 {
                add(&mut self.single, self.compliance.row(index, axis), force[axis] as f32);
            }
        }
        let through = self.correction.through(&self.boundary, self.loads.iter().copied());
        let mut unknowns = through.map(|through| through.shares);
        for (row, multiplier) in self.rows.iter().zip(&self.multipliers) {
            if let (Some(sum), Some(own)) = (&mut unknowns, &row.through) {
                sum.axpy(*multiplier, &own.shares, 1.0);
            }
        }
        if let Some(unknowns) = &unknowns {
            self.correction.add_to_surface(&self.boundary, unknowns, &mut self.single);
        }
        out.clear();
        out.extend(self.single.chunks_exact(3).zip(self.boundary.rows_of_surface()).map(|(moved, row)| {
            Vector3::from_fn(|axis, _| f64::from(moved[axis]) + self.dead[3 * row + axis])
        }));
        for &node in &self.touched[out.len()..] {
            let with = self.boundary.surface_row(node).map_or_else(Vector3::zeros, |row| out[row]);
            let own = unknowns.iter().map(|unknowns| self.correction.own(node, unknowns.as_slice()));
            let dead = self.correction.own(node, &self.dead_unknowns);
            out.push(with + own.sum::<Vector3<f64>>() + dead);
        }
    }

    /// Displacements of all nodes \[m\], interior and fixed ones too, by a sparse solve in f64; too slow for every
    /// cycle.
    pub fn displacements(&mut self, out: &mut Vec<Vector3<f64>>) {
        let mut full = vec![0.0; 3 * self.boundary.free()];
        let mut pulls = self.correction.pulls(self.loads.iter().copied());
        for (row, multiplier) in self.rows.iter().zip(&self.multipliers) {
            let weights = &self.held[row.held].attachment.weights;
            let force = row.direction * *multiplier;
            spread(&self.boundary, &mut full, weights, &force);
            pulls += self.correction.pulls(weights.iter().map(|&(node, weight)| (node, force * weight)));
        }
        for (node, force) in &self.loads {
            spread(&self.boundary, &mut full, &[(*node, 1.0)], force);
        }
        self.factor.solve(&mut full);
        let mut unknowns = self.correction.correct(&mut full, pulls);
        unknowns.iter_mut().zip(&self.dead_unknowns).for_each(|(own, dead)| *own += dead);
        full.iter_mut().zip(&self.dead).for_each(|(u, dead)| *u += dead);
        out.clear();
        out.extend((0..).zip(&self.boundary.numbers).map(|(node, number)| {
            number.map_or_else(Vector3::zeros, |number| {
                Vector3::from_column_slice(&full[3 * number as usize..][..3])
                    + self.correction.own(node, unknowns.as_slice())
            })
        }));
    }

    /// Largest rotation and strain over all elements; costs as much as [`Self::displacements`] and a pass over the
    /// elements.
    pub fn deformation(&mut self) -> Deformation {
        let mut displacements = Vec::new();
        self.displacements(&mut displacements);
        Deformation::without(&self.mesh, &displacements, self.removed())
    }
}
