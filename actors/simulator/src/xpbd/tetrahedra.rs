//! Tetrahedral constraints, four at a time with SIMD: one for shape, one for volume.
//!
//! The shape constraint is the norm of the deviatoric strain, ‖E − tr(E)/3‖ with Green's strain E; the volume
//! constraint is the volume ratio less one. What the solver minimises is therefore the energy per volume
//! ψ = μ ‖dev E‖² + K/2 (J − 1)²: St. Venant and Kirchhoff's law for the shape, with the bulk modulus on the volume ratio
//! instead of on tr E, so that a flattened element resists (a *modified St. Venant–Kirchhoff* law). For small strains it is
//! the isotropic material; in a large shear it stiffens, μ (γ + 2/3 γ³). Both constraints are zero at rest.
//! The pair of Macklin and Müller (*A constraint-based formulation of stable neo-Hookean materials*, 2021), ‖F‖ and det
//! F − γ, is not: at rest each of the two pulls with the full modulus against the other, and the residual of that
//! difference in an unconverged sweep is noise and softness that no load has caused.

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_dynamics::tet_mesh::NodeAdjacency;

use super::colouring::{UsedColours, groups};
use super::constraint::{Constraint, Elasticity, Nodes};
use crate::mass_spring::NetworkError;
use crate::simd::f32x4::{LANES, Vectors, Wide, cross, dot, plus, sum, times};

/// Four tetrahedra without common nodes. Padding tetrahedra exert nothing, whatever their corners.
#[derive(Clone, Debug)]
pub(super) struct TetPack {
    nodes: [[u32; LANES]; 4],
    /// Rows of the inverse rest edge matrix.
    inverse: [Vectors; 3],
    /// Compliances of shape and of volume \[1/J\].
    compliance: [Wide; 2],
}

/// Impulses on the last three corners by axis, times the substep \[N·s²\], and the multipliers. The first corner gets
/// the opposite of their sum in double precision, so that rounding creates no momentum.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Correction {
    impulses: [Vectors; 3],
    multipliers: [Wide; 2],
}

/// Packs in their order of projection, colour by colour.
#[derive(Clone, Debug, Default)]
pub(super) struct Tets {
    pub packs: Vec<Vec<TetPack>>,
    /// Number of tetrahedra without padding.
    pub count: usize,
    /// Colour of each tetrahedron, including removed ones.
    pub groups: Vec<u16>,
    /// Tetrahedron number in each lane.
    numbers: Vec<Vec<[u32; LANES]>>,
    /// Number of used lanes of each colour.
    given: Vec<usize>,
    /// Pack and lane of each tetrahedron within its colour; `None` when removed.
    lanes: Vec<Option<(u32, u8)>>,
    /// Corners, and rest edges from the first one \[m\], of each.
    matter: Vec<([u32; 4], Matrix3<f64>)>,
    /// Tetrahedra around each node.
    stars: NodeAdjacency,
    /// Shape and volume moduli \[Pa\].
    moduli: [f64; 2],
}

/// Node of padding lanes: nothing moves it, so that it may be any.
const SPARE: u32 = 0;

impl Tets {
    /// From positively oriented tetrahedra; `known` are saved colours, if any.
    pub fn new(
        rest: &[Point3<f64>],
        tets: &[[u32; 4]],
        elasticity: &Elasticity,
        known: &[u16],
        is_gone: impl Fn(usize) -> bool,
    ) -> Result<Self, NetworkError> {
        let Elasticity { young_modulus, poisson_ratio, .. } = *elasticity;
        let shear = 0.5 * young_modulus / (1.0 + poisson_ratio);
        let bulk = young_modulus / (3.0 * (1.0 - 2.0 * poisson_ratio));
        let groups = groups("tetrahedron", rest.len(), tets, known, is_gone)?;
        let mut all = Self {
            stars: NodeAdjacency::new(rest.len(), (0..).zip(tets.iter().copied())),
            moduli: [2.0 * shear, bulk],
            ..Self::default()
        };
        for (tet, group) in tets.iter().zip(groups) {
            all.add(*tet, edges(rest, tet), group);
        }
        Ok(all)
    }

    /// Appends one to a colour.
    fn add(&mut self, tet: [u32; 4], edges: Matrix3<f64>, group: u16) {
        let number = self.matter.len() as u32;
        let at = group as usize;
        if self.packs.len() <= at {
            self.packs.resize(at + 1, Vec::new());
            self.numbers.resize(at + 1, Vec::new());
            self.given.resize(at + 1, 0);
        }
        let (pack, lane) = (self.given[at] / LANES, self.given[at] % LANES);
        self.given[at] += 1;
        if lane == 0 {
            self.packs[at].push(TetPack {
                nodes: [[SPARE; LANES]; 4],
                inverse: [[Wide::default(); 3]; 3],
                compliance: [Wide::all(1.0); 2],
            });
            self.numbers[at].push([u32::MAX; LANES]);
        }
        self.packs[at][pack].fill(lane, &tet, &edges, self.moduli);
        self.numbers[at][pack][lane] = number;
        self.lanes.push(Some((pack as u32, lane as u8)));
        self.matter.push((tet, edges));
        self.groups.push(group);
        self.count += 1;
    }

    /// Removes one; returns its corners, or `None` when it did not exist.
    pub fn remove(&mut self, number: u32) -> Option<[u32; 4]> {
        let (pack, lane) = self.lanes.get_mut(number as usize)?.take()?;
        let (tet, _) = self.matter[number as usize];
        let group = self.groups[number as usize] as usize;
        self.packs[group][pack as usize].clear(lane as usize);
        self.numbers[group][pack as usize][lane as usize] = u32::MAX;
        self.stars.remove(number, &tet);
        self.count -= 1;
        Some(tet)
    }

    /// Sets stiffness and rest length of one, as factors of the original values.
    pub fn alter(&mut self, number: u32, stiffness: f64, length: f64) {
        let Some(Some((pack, lane))) = self.lanes.get(number as usize) else { return };
        let (tet, edges) = &self.matter[number as usize];
        let moduli = self.moduli.map(|modulus| modulus * stiffness);
        let group = self.groups[number as usize] as usize;
        self.packs[group][*pack as usize].fill(*lane as usize, tet, &(edges * length), moduli);
    }

    /// Replaces the corners of one, or appends the next one, in the first colour free at its nodes; one that exchanged
    /// some of its own corners gets no new neighbours there. Returns its previous corners.
    pub fn put(&mut self, rest: &[Point3<f64>], number: u32, tet: [u32; 4]) -> Option<[u32; 4]> {
        let index = number as usize;
        let Some(lane) = self.lanes.get(index) else {
            let mut taken = UsedColours::default();
            for other in tet.iter().flat_map(|&node| self.stars.about(node)) {
                taken.take(self.groups[*other as usize]);
            }
            let group = UsedColours::first_free(std::iter::once(&taken));
            self.stars.add(number, &tet);
            self.add(tet, edges(rest, &tet), group);
            return None;
        };
        let (pack, lane) = (*lane)?;
        let was = std::mem::replace(&mut self.matter[index], (tet, edges(rest, &tet)));
        self.stars.remove(number, &was.0);
        self.stars.add(number, &tet);
        let group = self.groups[index] as usize;
        self.packs[group][pack as usize].fill(lane as usize, &tet, &self.matter[index].1, self.moduli);
        Some(was.0)
    }

    /// Mass of a node: its own plus its share of the tetrahedra around it \[kg\].
    pub fn mass(&self, node: u32, own: f64, density: f64) -> f64 {
        let share = |tet: &u32| 0.25 * density * extent(&self.matter[*tet as usize].1);
        self.stars.about(node).iter().map(share).fold(own, |sum, share| sum + share)
    }

    /// Inverted tetrahedra, ascending.
    pub fn inverted(&self, positions: &[Point3<f64>]) -> Vec<u32> {
        let mut inverted: Vec<u32> = Vec::new();
        for (pack, numbers) in self.packs.iter().flatten().zip(self.numbers.iter().flatten()) {
            let f = pack.gradient(&pack.edges(|node| place(positions, node)));
            let ratio = dot(&f[0], &cross(&f[1], &f[2]));
            let turned =
                numbers.iter().zip(ratio.0).filter(|(number, ratio)| **number != u32::MAX && *ratio <= 0.0);
            inverted.extend(turned.map(|(number, _)| *number));
        }
        inverted.sort_unstable();
        inverted
    }

    /// Elastic energy \[J\].
    pub fn energy(&self, positions: &[Point3<f64>]) -> f64 {
        let mut energy = 0.0;
        for (pack, numbers) in self.packs.iter().flatten().zip(self.numbers.iter().flatten()) {
            let f = pack.gradient(&pack.edges(|node| place(positions, node)));
            for (constraint, compliance) in [shape(&f).0, volume(&f).0].into_iter().zip(pack.compliance) {
                let of = (constraint * constraint / compliance).doubled();
                energy += numbers
                    .iter()
                    .zip(of)
                    .filter(|(n, _)| **n != u32::MAX)
                    .map(|(_, e)| 0.5 * e)
                    .sum::<f64>();
            }
        }
        energy
    }
}

/// Rest edges from the first corner \[m\].
fn edges(rest: &[Point3<f64>], tet: &[u32; 4]) -> Matrix3<f64> {
    let [a, b, c, d] = tet.map(|node| rest[node as usize]);
    Matrix3::from_columns(&[b - a, c - a, d - a])
}

/// Smallest valid rest volume \[m³\].
pub(super) const LEAST: f64 = 1e-30;

/// Rest volume \[m³\].
pub(super) fn volume_of(rest: &[Point3<f64>], tet: &[u32; 4]) -> f64 {
    extent(&edges(rest, tet))
}

/// Volume from the edges \[m³\].
fn extent(edges: &Matrix3<f64>) -> f64 {
    edges.column(0).cross(&edges.column(1)).dot(&edges.column(2)) / 6.0
}

fn place(positions: &[Point3<f64>], node: usize) -> [f64; 3] {
    let point = &positions[node];
    [point.x, point.y, point.z]
}

/// A constraint and its gradient by the columns of the deformation gradient.
type Strain = (Wide, [Vectors; 3]);

#[inline(always)]
fn shape(f: &[Vectors; 3]) -> Strain {
    let (half, one) = (Wide::all(0.5), Wide::all(1.0));
    let [x, y, z] = f;
    let [xx, yy, zz] = [half * (dot(x, x) - one), half * (dot(y, y) - one), half * (dot(z, z) - one)];
    let [xy, yz, zx] = [half * dot(x, y), half * dot(y, z), half * dot(z, x)];
    let mean = (xx + yy + zz) * Wide::all(1.0 / 3.0);
    let [xx, yy, zz] = [xx - mean, yy - mean, zz - mean];
    let two = Wide::all(2.0);
    let size = (xx * xx + yy * yy + zz * zz + two * (xy * xy + yz * yz + zx * zx)).root();
    // Without strain there is no direction, and none is needed.
    let inverse = one / (size + Wide::all(1e-30));
    let slope = [
        sum(xx * inverse, &f[0], xy * inverse, &f[1], zx * inverse, &f[2]),
        sum(xy * inverse, &f[0], yy * inverse, &f[1], yz * inverse, &f[2]),
        sum(zx * inverse, &f[0], yz * inverse, &f[1], zz * inverse, &f[2]),
    ];
    (size, slope)
}

#[inline(always)]
fn volume(f: &[Vectors; 3]) -> Strain {
    let slope = [cross(&f[1], &f[2]), cross(&f[2], &f[0]), cross(&f[0], &f[1])];
    (dot(&f[0], &slope[0]) - Wide::all(1.0), slope)
}

impl TetPack {
    fn fill(&mut self, lane: usize, tet: &[u32; 4], edges: &Matrix3<f64>, moduli: [f64; 2]) {
        let volume = edges.determinant() / 6.0;
        let inverse = edges.try_inverse().unwrap_or_else(Matrix3::zeros);
        for (corner, &node) in tet.iter().enumerate() {
            self.nodes[corner][lane] = node;
        }
        for row in 0..3 {
            for column in 0..3 {
                self.inverse[row][column].0[lane] = inverse[(row, column)] as f32;
            }
        }
        for (compliance, modulus) in self.compliance.iter_mut().zip(moduli) {
            compliance.0[lane] = (1.0 / (modulus * volume)) as f32;
        }
    }

    fn clear(&mut self, lane: usize) {
        self.nodes.iter_mut().for_each(|nodes| nodes[lane] = SPARE);
        self.inverse.iter_mut().flatten().for_each(|of| of.0[lane] = 0.0);
        self.compliance.iter_mut().for_each(|of| of.0[lane] = 1.0);
    }

    /// Edges from the first corner.
    #[inline(always)]
    fn edges(&self, place: impl Fn(usize) -> [f64; 3]) -> [Vectors; 3] {
        let first = corner(&self.nodes[0], &place);
        let edge = |at: usize| {
            let other = corner(&self.nodes[at], &place);
            [
                Wide::between(&first[0], &other[0]),
                Wide::between(&first[1], &other[1]),
                Wide::between(&first[2], &other[2]),
            ]
        };
        [edge(1), edge(2), edge(3)]
    }

    /// Impulses of one constraint on the last three corners, and the change of its multiplier.
    #[inline(always)]
    fn pull(
        &self,
        (value, slope): Strain,
        soft: Wide,
        multiplier: Wide,
        mobility: &[Wide; 4],
    ) -> ([Vectors; 3], Wide) {
        let i = &self.inverse;
        let other = |z: usize| sum(i[z][0], &slope[0], i[z][1], &slope[1], i[z][2], &slope[2]);
        let others = [other(0), other(1), other(2)];
        let first = plus(&plus(&others[0], &others[1]), &others[2]);
        let yields = (mobility[0] * dot(&first, &first) + mobility[1] * dot(&others[0], &others[0]))
            + (mobility[2] * dot(&others[1], &others[1]) + mobility[3] * dot(&others[2], &others[2]));
        let change = (-value - soft * multiplier) / (yields + soft);
        ([times(&others[0], change), times(&others[1], change), times(&others[2], change)], change)
    }

    /// Columns of the deformation gradient.
    #[inline(always)]
    fn gradient(&self, [p, q, r]: &[Vectors; 3]) -> [Vectors; 3] {
        let i = &self.inverse;
        let column = |c: usize| sum(i[0][c], p, i[1][c], q, i[2][c], r);
        [column(0), column(1), column(2)]
    }
}

/// Coordinates of four nodes, as structure of arrays.
#[inline(always)]
fn corner(of: &[u32; LANES], place: &impl Fn(usize) -> [f64; 3]) -> [[f64; LANES]; 3] {
    let [a, b] = [place(of[0] as usize), place(of[1] as usize)];
    let [c, d] = [place(of[2] as usize), place(of[3] as usize)];
    [[a[0], b[0], c[0], d[0]], [a[1], b[1], c[1], d[1]], [a[2], b[2], c[2], d[2]]]
}

impl Constraint for TetPack {
    type Multiplier = [Wide; 2];
    type Correction = Correction;

    /// Projects shape, then volume, each from the positions left by the previous one.
    #[inline(always)]
    fn project(&self, nodes: &Nodes<'_>, multipliers: [Wide; 2]) -> Correction {
        let mut edges = self.edges(|node| {
            let [x, y, z, _] = nodes.places[node];
            [x, y, z]
        });
        let yields = |of: &[u32; LANES]| {
            let yields = |lane: usize| nodes.places[of[lane] as usize][3] as f32;
            Wide([yields(0), yields(1), yields(2), yields(3)])
        };
        let [a, b, c, d] = &self.nodes;
        let mobility = [yields(a), yields(b), yields(c), yields(d)];
        let rate = Wide::all(nodes.rate as f32);
        let strain = shape(&self.gradient(&edges));
        let (first, of_shape) = self.pull(strain, self.compliance[0] * rate, multipliers[0], &mobility);
        let back = times(&plus(&plus(&first[0], &first[1]), &first[2]), mobility[0]);
        for at in 0..3 {
            edges[at] = plus(&edges[at], &plus(&times(&first[at], mobility[at + 1]), &back));
        }
        let strain = volume(&self.gradient(&edges));
        let (second, of_volume) = self.pull(strain, self.compliance[1] * rate, multipliers[1], &mobility);
        let impulses =
            [plus(&first[0], &second[0]), plus(&first[1], &second[1]), plus(&first[2], &second[2])];
        Correction { impulses, multipliers: [multipliers[0] + of_shape, multipliers[1] + of_volume] }
    }

    #[inline(always)]
    fn apply(&self, moved: &Correction, nodes: &mut Nodes<'_>, multipliers: &mut [Wide; 2]) {
        *multipliers = moved.multipliers;
        let doubled = |of: &Vectors| [of[0].doubled(), of[1].doubled(), of[2].doubled()];
        let [second, third, fourth] = &moved.impulses;
        let impulses = [doubled(second), doubled(third), doubled(fourth)];
        for lane in 0..LANES {
            let mut all = [0.0; 3];
            for (of, impulse) in self.nodes[1..].iter().zip(&impulses) {
                let place = &mut nodes.places[of[lane] as usize];
                for axis in 0..3 {
                    all[axis] += impulse[axis][lane];
                    place[axis] += place[3] * impulse[axis][lane];
                }
            }
            let place = &mut nodes.places[self.nodes[0][lane] as usize];
            for axis in 0..3 {
                place[axis] -= place[3] * all[axis];
            }
        }
    }

    fn impulses(&self, nodes: &Nodes<'_>, multipliers: &[Wide; 2], each: &mut dyn FnMut(u32, Vector3<f64>)) {
        let edges = self.edges(|node| {
            let [x, y, z, _] = nodes.places[node];
            [x, y, z]
        });
        let f = self.gradient(&edges);
        let (slope, other) = (shape(&f).1, volume(&f).1);
        for z in 0..3 {
            let i = &self.inverse[z];
            let of = |slope: &[Vectors; 3]| sum(i[0], &slope[0], i[1], &slope[1], i[2], &slope[2]);
            let all = plus(&times(&of(&slope), multipliers[0]), &times(&of(&other), multipliers[1]));
            for lane in 0..LANES {
                let impulse = Vector3::from_fn(|axis, _| f64::from(all[axis].0[lane]));
                each(self.nodes[z + 1][lane], impulse);
                each(self.nodes[0][lane], -impulse);
            }
        }
    }
}
