//! Removal and alteration of elements of a dynamic body, as by a burn.

use nalgebra::Matrix3;

use super::solver::{DynamicFem, FactoredAt};

impl DynamicFem {
    /// Removes elements and their masses; missing or already removed ones are ignored. A node without remaining
    /// elements keeps its position. The next step begins with a new factor of the same pattern.
    pub fn remove(&mut self, elements: &[u32]) {
        for &index in elements {
            let Some(element) = self.elements.get_mut(index as usize).filter(|element| !element.is_gone())
            else {
                continue;
            };
            element.volume = 0.0;
            let nodes = element.nodes;
            let mass = self.config.density * self.mesh.volumes()[index as usize];
            nodes.iter().for_each(|&node| self.around[node as usize] -= 1);
            // A node without elements keeps its last mass: it does not move, and the matrix stays positive definite.
            let keeps = |node: u32| self.around[node as usize] == 0;
            for &node in nodes.iter().filter(|node| !keeps(**node)) {
                self.mass.lumped[node as usize] -= 0.25 * mass;
            }
            if let Some(matrix) = &mut self.mass.consistent {
                for &row in &nodes {
                    for &column in nodes.iter().filter(|&&column| row >= column) {
                        if !keeps(row) && !keeps(column) {
                            let share = if row == column { 0.1 } else { 0.05 };
                            matrix.add(row, column, &Matrix3::from_diagonal_element(-share * mass));
                        }
                    }
                }
            }
        }
        self.factored_at = FactoredAt::default();
    }

    /// Sets stiffness and rest length of an element, as factors of the original values; removed ones are ignored. The
    /// next step begins with a new factor.
    pub fn alter(&mut self, element: u32, stiffness: f64, length: f64) {
        let index = element as usize;
        let Some(element) = self.elements.get_mut(index).filter(|element| !element.is_gone()) else { return };
        element.inverse_shape = self.mesh.inverse_shapes()[index] / length;
        element.volume = self.mesh.volumes()[index] * length.powi(3) * stiffness;
        self.factored_at = FactoredAt::default();
    }
}
