//! The step's matrix as a compact operator for iterative solvers: built once, multiplied many times, with only the data
//! of a product, in few bytes, four numbers at a time.
//!
//! Stiffness and direction of springs are rounded to 32 bits, once per step: the operator stays symmetric and definite,
//! and forces on both ends of a spring stay opposite.

use super::StepMatrix;
use super::rigid_operator::RigidOperator;
use crate::mass_spring::matrix::Block;
use crate::mass_spring::{Contact, Network};
use crate::simd::f64x4::Quad;

/// A spring: `all·I + u uᵀ` between two nodes.
#[derive(Clone, Copy, Debug)]
struct SpringBlock {
    nodes: [u32; 2],
    all: f32,
    along: [f32; 4],
}

/// A hinge or a contact: `all·I + along·u uᵀ` on the weighted sum of its nodes.
#[derive(Clone, Copy, Debug)]
struct HingeBlock<const N: usize> {
    nodes: [u32; N],
    weights: [f64; N],
    all: f64,
    along: f64,
    axis: Quad,
}

/// Hinges that are flat at rest and undamped: their coupling of two nodes is isotropic and independent of the shape
/// (Bergou et al., *A quadratic bending model for inextensible surfaces*, 2006), so that all of them together are one
/// constant scalar matrix. It is stored by rows, without the diagonal: each row sums to zero.
#[derive(Clone, Debug, Default)]
struct Flat {
    starts: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f64>,
}

/// The compact operator; see the module.
#[derive(Clone, Debug, Default)]
pub(super) struct Operator {
    /// Mass of each node, including damping; 0 where it is held \[kg\].
    pub masses: Vec<f64>,
    struts: Vec<SpringBlock>,
    hinges: Vec<HingeBlock<4>>,
    contacts: Vec<HingeBlock<3>>,
    squeezed: Vec<([u32; 4], [Quad; 4])>,
    flat: Option<Flat>,
    /// Contacts with rigid bodies.
    pub rigid: RigidOperator,
    squared_step: f64,
}

impl Flat {
    fn new(network: &Network) -> Self {
        let nodes = network.masses.len();
        let flat = || network.hinges.iter().filter(|hinge| hinge.rest == 0.0);
        let mut starts = vec![0_u32; nodes + 1];
        for hinge in flat() {
            hinge.nodes.iter().for_each(|&node| starts[node as usize + 1] += 4);
        }
        (0..nodes).for_each(|node| starts[node + 1] += starts[node]);
        let mut next = starts.clone();
        let mut all = vec![(0_u32, 0.0); starts[nodes] as usize];
        for hinge in flat() {
            for (row, by) in hinge.nodes.into_iter().zip(hinge.weights) {
                for (column, weight) in hinge.nodes.into_iter().zip(hinge.weights) {
                    let place = &mut next[row as usize];
                    all[*place as usize] = (column, hinge.stiffness * (by * weight));
                    *place += 1;
                }
            }
        }
        let mut sum = Self { starts: vec![0], ..Self::default() };
        for row in 0..nodes {
            let own = &mut all[starts[row] as usize..starts[row + 1] as usize];
            // A stable sort, so that both halves of the matrix are summed in one order.
            own.sort_by_key(|entry| entry.0);
            for same in own.chunk_by(|first, next| first.0 == next.0) {
                let value: f64 = same.iter().map(|entry| entry.1).sum();
                if same[0].0 as usize != row && value != 0.0 {
                    sum.columns.push(same[0].0);
                    sum.values.push(value);
                }
            }
            sum.starts.push(sum.columns.len() as u32);
        }
        sum
    }
}

impl Operator {
    /// Discards the data of a changed network.
    pub fn forget(&mut self) {
        self.flat = None;
    }

    /// Takes over the current matrix.
    pub fn take(
        &mut self,
        matrix: &StepMatrix,
        network: &Network,
        contacts: &[Contact],
        (h, lag): (f64, f64),
    ) {
        self.masses.clone_from(&matrix.masses);
        self.struts.clear();
        self.struts.extend(network.springs.iter().zip(&matrix.springs).map(|(spring, block)| {
            let along = block.axis * block.along.max(0.0).sqrt();
            let along = [along.x as f32, along.y as f32, along.z as f32, 0.0];
            SpringBlock { nodes: spring.nodes, all: block.all as f32, along }
        }));
        self.squared_step = h * h;
        if lag == 0.0 {
            self.flat.get_or_insert_with(|| Flat::new(network));
        } else {
            self.flat = None;
        }
        let is_flat = |rest: f64| rest == 0.0 && lag == 0.0;
        let others = network.hinges.iter().zip(&matrix.hinges).filter(|(hinge, _)| !is_flat(hinge.rest));
        self.hinges.clear();
        self.hinges.extend(others.map(|(hinge, block)| HingeBlock::new(hinge.nodes, hinge.weights, block)));
        self.squeezed.clear();
        self.squeezed.reserve(network.tets.len());
        let squeezed = matrix.squeezed.iter();
        self.squeezed.extend(squeezed.map(|of| (of.nodes, of.along.map(|along| Quad::from(&along)))));
        self.contacts.clear();
        self.contacts.extend(contacts.iter().zip(&matrix.contacts).map(|(contact, block)| {
            let joint = contact.joint();
            HingeBlock::new(joint.map(|of| of.0), joint.map(|of| of.1), block)
        }));
    }

    /// The product with `vector`.
    #[inline(always)]
    pub fn apply(&self, vector: &[Quad], product: &mut [Quad]) {
        for ((product, vector), mass) in product.iter_mut().zip(vector).zip(&self.masses) {
            *product = *vector * *mass;
        }
        if let Some(flat) = &self.flat {
            for (row, product) in product.iter_mut().enumerate() {
                let of = flat.starts[row] as usize..flat.starts[row + 1] as usize;
                let own = vector[row];
                let others = flat.columns[of.clone()].iter().zip(&flat.values[of]);
                let sum = others.fold(Quad::default(), |sum, (column, value)| {
                    sum + (vector[*column as usize] - own) * *value
                });
                *product += sum * self.squared_step;
            }
        }
        for strut in &self.struts {
            let [a, b] = strut.nodes.map(|node| node as usize);
            let by = vector[b] - vector[a];
            let along = Quad(strut.along.map(f64::from));
            let force = by * f64::from(strut.all) + along * along.times(by).sum();
            product[a] -= force;
            product[b] += force;
        }
        // Plain loops: `for_each` is not always inlined, and would then run in registers of two numbers.
        for joint in &self.hinges {
            joint.add_product(vector, product);
        }
        for joint in &self.contacts {
            joint.add_product(vector, product);
        }
        for (nodes, along) in &self.squeezed {
            let mut sum = Quad::default();
            for (node, along) in nodes.iter().zip(along) {
                sum += along.times(vector[*node as usize]);
            }
            let sum = sum.sum();
            for (node, along) in nodes.iter().zip(along) {
                product[*node as usize] += *along * sum;
            }
        }
        self.rigid.apply(vector, product);
    }
}

impl<const N: usize> HingeBlock<N> {
    fn new(nodes: [u32; N], weights: [f64; N], block: &Block) -> Self {
        Self { nodes, weights, all: block.all, along: block.along, axis: Quad::from(&block.axis) }
    }

    #[inline(always)]
    fn add_product(&self, vector: &[Quad], product: &mut [Quad]) {
        let mut sum = Quad::default();
        for (node, weight) in self.nodes.into_iter().zip(self.weights) {
            sum += vector[node as usize] * weight;
        }
        let force = sum * self.all + self.axis * (self.along * self.axis.times(sum).sum());
        for (node, weight) in self.nodes.into_iter().zip(self.weights) {
            product[node as usize] += force * weight;
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};
    use rand::{Rng, SeedableRng};

    use super::*;
    use crate::mass_spring::SurfaceMaterial;

    /// A bent sheet on a table, with and without damping along its springs: the product equals the sum of its terms.
    #[test]
    fn a_product_is_the_sum_of_what_each_part_gives() {
        let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(5);
        let n = 6_u32;
        let mut points = Vec::new();
        for j in 0..=n {
            points.extend((0..=n).map(|i| Point3::new(1e-2 * f64::from(i), 1e-2 * f64::from(j), 0.0)));
        }
        // One row stands up: hinges with and without a rest angle.
        points.iter_mut().filter(|point| point.y > 0.055).for_each(|point| point.z = 5e-3);
        let squares = (0..n).flat_map(|j| (0..n).map(move |i| (i, j)));
        let triangles: Vec<[u32; 3]> = squares
            .flat_map(|(i, j)| {
                let [a, b, c, d] =
                    [[i, j], [i + 1, j], [i, j + 1], [i + 1, j + 1]].map(|[i, j]| j * (n + 1) + i);
                [[a, b, d], [a, d, c]]
            })
            .collect();
        let material = SurfaceMaterial { membrane_stiffness: 500.0, bending_stiffness: 1e-6, density: 0.15 };
        let mut network = Network::from_surface(&points, &triangles, &material).expect("a network");
        // Two that are squeezed or inside out, and one that is not.
        network.tets.extend(
            [([0, 1, 7, 45], 1.0), ([8, 9, 20, 44], -1.0), ([2, 3, 10, 46], 1e-20)]
                .map(|(nodes, rest)| crate::mass_spring::Tet { nodes, rest: 1e-5 * rest, stiffness: 1e-4 }),
        );
        let mut any = || Vector3::from_fn(|_, _| random.random_range(-1.0..1.0));
        let positions: Vec<_> = points.iter().map(|point| point + any() * 1e-3).collect();
        let vector: Vec<Vector3<f64>> = points.iter().map(|_| any()).collect();
        let contact = Contact::at_node(3, Vector3::z(), 1e-3, 100.0);
        let h = 2e-3;
        let mut operator = Operator::default();
        for lag in [0.0, 1e-3, 0.0] {
            let mut matrix = StepMatrix::default();
            matrix.linearise(&network, h, lag, &positions);
            matrix.press(&contact, h, 0.1, 0.5);
            matrix.masses = network.masses.clone();
            matrix.masses[7] = 0.0;
            operator.take(&matrix, &network, &[contact], (h, lag));
            let mut expected: Vec<_> =
                vector.iter().zip(&matrix.masses).map(|(vector, mass)| vector * *mass).collect();
            matrix.for_each_pair(&network, &[contact], |a, b, weight, block| {
                let block = block.matrix() * weight;
                expected[a as usize] += block * vector[b as usize];
                if a != b {
                    expected[b as usize] += block * vector[a as usize];
                }
            });
            assert!(matrix.squeezed.len() >= 2);
            for of in &matrix.squeezed {
                of.for_each_pair(|a, b, block| {
                    expected[a as usize] += block * vector[b as usize];
                    if a != b {
                        expected[b as usize] += block.transpose() * vector[a as usize];
                    }
                });
            }
            let quads: Vec<Quad> = vector.iter().map(Quad::from).collect();
            let mut product = vec![Quad::default(); quads.len()];
            operator.apply(&quads, &mut product);
            let largest = expected.iter().fold(0.0, |most, vector| f64::max(most, vector.norm()));
            for (node, (found, expected)) in product.iter().zip(&expected).enumerate() {
                // Within the rounding of 24-bit mantissas.
                assert!((found.vector() - expected).norm() < 1e-6 * largest, "node {node}, damping {lag} s");
                assert_eq!(found.0[3], 0.0);
            }
        }
    }
}
