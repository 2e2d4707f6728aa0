//! Contacts with rigid bodies in the matrix of a step: a stiffness along each normal, less what the bodies give way. The
//! bodies' own unknowns are eliminated (Schur complement): `N (K − K J S⁻¹ Jᵀ K) Nᵀ` with `S = M / h² + Jᵀ K J`.

use nalgebra::{DMatrix, Matrix6, Vector3, Vector6};
use trocar_dynamics::soft_body::bearing::rigid_response::{RigidPresses, RigidResponse};

use crate::simd::f64x4::Quad;

#[derive(Clone, Debug)]
struct Row {
    nodes: [u32; 3],
    weights: [f64; 3],
    axis: Vector3<f64>,
    stiffness: f64,
    /// Change of the depth by a displacement of the body.
    motion: Vector6<f64>,
    /// Index of the contact in the input.
    contact: usize,
}

/// The contacts that press, body by body.
#[derive(Clone, Debug, Default)]
pub(super) struct RigidOperator {
    rows: Vec<Row>,
    /// The end of each body's rows, and its S⁻¹.
    bodies: Vec<(usize, Matrix6<f64>)>,
    squared_step: f64,
}

impl RigidOperator {
    /// Takes the contacts that press in a response at the end of a step of `h` \[s\].
    pub fn take(&mut self, rigid: &RigidPresses<'_>, response: &RigidResponse, h: f64) {
        self.rows.clear();
        self.bodies.clear();
        self.squared_step = h * h;
        for body in 0..rigid.bodies.len() {
            let own = rigid.contacts.iter().zip(&response.forces).enumerate();
            let own = own.filter(|(_, (contact, force))| contact.body as usize == body && **force > 0.0);
            let mut sum = rigid.inertia(body, h);
            let first = self.rows.len();
            self.rows.extend(own.map(|(index, (contact, _))| {
                let motion = contact.motion();
                sum += motion * motion.transpose() * contact.stiffness;
                let joint = contact.joint();
                Row {
                    nodes: joint.map(|of| of.0),
                    weights: joint.map(|of| of.1),
                    axis: contact.normal,
                    stiffness: contact.stiffness,
                    motion,
                    contact: index,
                }
            }));
            if self.rows.len() > first {
                let inverse = sum.try_inverse().unwrap_or_else(Matrix6::zeros);
                self.bodies.push((self.rows.len(), inverse));
            }
        }
    }

    /// Adds the product with `vector`.
    #[inline(always)]
    pub fn apply(&self, vector: &[Quad], product: &mut [Quad]) {
        let mut begin = 0;
        for (end, inverse) in &self.bodies {
            let rows = &self.rows[begin..*end];
            begin = *end;
            let mut together = Vector6::zeros();
            for row in rows {
                together += row.motion * (row.stiffness * row.along(vector));
            }
            let gives = inverse * together;
            for row in rows {
                let force = row.stiffness * (row.along(vector) - row.motion.dot(&gives)) * self.squared_step;
                let force = Quad::from(&(row.axis * force));
                for (node, weight) in row.nodes.into_iter().zip(row.weights) {
                    product[node as usize] += force * weight;
                }
            }
        }
    }

    /// Each contact's force after a change of the velocities \[m/s\] in a step of `h` \[s\], to first order; 0 for those
    /// that do not press.
    pub fn change(&self, change: &[Vector3<f64>], h: f64, forces: &mut [f64]) {
        let along = |row: &Row| -> f64 {
            let shares = row.nodes.into_iter().zip(row.weights);
            shares.map(|(node, weight)| row.axis.dot(&change[node as usize]) * weight).sum()
        };
        let mut begin = 0;
        for (end, inverse) in &self.bodies {
            let rows = &self.rows[begin..*end];
            begin = *end;
            let together = rows
                .iter()
                .fold(Vector6::zeros(), |sum, row| sum + row.motion * (row.stiffness * along(row)));
            let gives = inverse * together;
            for row in rows {
                forces[row.contact] -= row.stiffness * (along(row) - row.motion.dot(&gives)) * h;
            }
        }
    }

    /// How the bodies make the matrix with held bodies less stiff: it is less by `U D⁻¹ Uᵀ`; `U`, by node and axis, and
    /// `D`. Rows of held nodes, of mass 0, are zero. `None` without contacts.
    pub fn gives_way(&self, masses: &[f64]) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
        if self.bodies.is_empty() {
            return None;
        }
        let unknowns = 6 * self.bodies.len();
        let (mut columns, mut less) =
            (DMatrix::zeros(3 * masses.len(), unknowns), DMatrix::zeros(unknowns, unknowns));
        let mut begin = 0;
        for (body, (end, inverse)) in self.bodies.iter().enumerate() {
            for row in &self.rows[begin..*end] {
                for (node, weight) in row.nodes.into_iter().zip(row.weights) {
                    if masses[node as usize] == 0.0 {
                        continue;
                    }
                    let block =
                        row.axis * row.motion.transpose() * (row.stiffness * weight * self.squared_step);
                    let mut own = columns.fixed_view_mut::<3, 6>(3 * node as usize, 6 * body);
                    own += block;
                }
            }
            begin = *end;
            let own = inverse.try_inverse()? * self.squared_step;
            less.fixed_view_mut::<6, 6>(6 * body, 6 * body).copy_from(&own);
        }
        Some((columns, less))
    }

    /// Each contact that presses: nodes with weights, direction, and stiffness times the squared step.
    pub fn contacts(&self) -> impl Iterator<Item = ([(u32, f64); 3], Vector3<f64>, f64)> {
        self.rows.iter().map(|row| {
            let joint = [0, 1, 2].map(|k| (row.nodes[k], row.weights[k]));
            (joint, row.axis, row.stiffness * self.squared_step)
        })
    }
}

impl Row {
    #[inline(always)]
    fn along(&self, vector: &[Quad]) -> f64 {
        let mut sum = Quad::default();
        for (node, weight) in self.nodes.into_iter().zip(self.weights) {
            sum += vector[node as usize] * weight;
        }
        Quad::from(&self.axis).times(sum).sum()
    }
}
