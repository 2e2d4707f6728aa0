//! Bioheat equation on the organ's mesh: linear finite elements with heat capacities lumped at the vertices (Pennes,
//! *Analysis of tissue and arterial blood temperatures in the resting human forearm*, 1948), stepped by backward Euler.
//! Unconditionally stable on any mesh. Conjugate gradients need no new factorisation when elements are removed, and
//! converge in a few iterations at the diffusion of one step.
//!
//! The residual cannot violate the energy balance: the solution only determines the fluxes, and these move the heat.

use nalgebra::{Point3, Vector3};

use super::error::HeatStepError;
use super::material::{BODY, ThermalMaterial};
use super::voxelisation::{CellLocation, Tissue};

/// Tolerance of the fluxes, as a fraction of the temperatures \[K\].
const RESIDUAL: f64 = 1e-8;
const ITERATIONS_MAX: u32 = 2_000;
/// Largest share of the difference of the mass matrices that is taken back from a deposit.
const EXCHANGED_MAX: f64 = 0.75;
/// Fraction of its capacity that a vertex always keeps, so that the mesh has a temperature there.
const CAPACITY_KEPT: f64 = 1e-3;

/// Temperatures at an organ's vertices.
#[derive(Clone, Debug)]
pub(super) struct OrganHeat {
    /// Temperatures \[°C\].
    pub celsius: Vec<f64>,
    /// Heat capacities \[J/K\].
    pub capacity: Vec<f64>,
    pub capacity_least: Vec<f64>,
    /// Volume of each vertex, removed tissue included \[m³\].
    pub whole: Vec<f64>,
    /// Perfusion loss \[W/K\].
    pub perfusion: Vec<f64>,
    arterial: f64,
    /// Whether a vertex has a prescribed temperature.
    pub held: Vec<bool>,
    conduction: Conduction,
    /// Heat deposited since the last step \[J\], and whether there is any.
    deposits: Vec<f64>,
    has_deposits: bool,
    /// Vertices with deposits and their neighbours; a buffer.
    reached: Vec<u32>,
    /// By how much depositing has moved them, and their square of the distance from the origin, times the heat \[J·m\],
    /// \[J·m²\].
    scatter: (Vector3<f64>, f64),
    positions: Vec<Point3<f64>>,
    rest: [Vec<f64>; 6],
}

/// Conduction matrix \[W/K\]: a diagonal, and off-diagonal rows.
#[derive(Clone, Debug)]
struct Conduction {
    diagonal: Vec<f64>,
    rows: Vec<u32>,
    columns: Vec<u32>,
    values: Vec<f64>,
    /// Off-diagonal capacities of linear elements \[J/K\], of the mesh without removed elements.
    masses: Vec<f64>,
}

/// Losses of an organ in a step \[J\].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct OrganStep {
    pub perfusion: f64,
    pub held: f64,
    pub iterations: u32,
}

impl Conduction {
    fn new(vertices: usize, elements: impl Iterator<Item = (Vec<u32>, [[f64; 4]; 4])> + Clone) -> Self {
        let mut pairs: Vec<(u32, u32)> = Vec::new();
        for (nodes, _) in elements.clone() {
            for a in &nodes {
                pairs.extend(nodes.iter().filter(|b| *b != a).map(|b| (*a, *b)));
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut rows = vec![0_u32; vertices + 1];
        pairs.iter().for_each(|(row, _)| rows[*row as usize + 1] += 1);
        for row in 0..vertices {
            rows[row + 1] += rows[row];
        }
        let columns: Vec<u32> = pairs.iter().map(|(_, column)| *column).collect();
        let entries = columns.len();
        let mut matrix = Self {
            diagonal: vec![0.0; vertices],
            rows,
            values: vec![0.0; entries],
            masses: vec![0.0; entries],
            columns,
        };
        for (nodes, local) in elements {
            matrix.add(&nodes, &local, 1.0);
        }
        matrix
    }

    /// Adds the capacities of an element \[J/K\] off the diagonal.
    fn add_mass(&mut self, nodes: &[u32], capacity: f64) {
        let corners = nodes.len() as f64;
        for row in nodes {
            let from = self.rows[*row as usize] as usize;
            let columns = &self.columns[from..self.rows[*row as usize + 1] as usize];
            for column in nodes.iter().filter(|column| *column != row) {
                if let Ok(at) = columns.binary_search(column) {
                    self.masses[from + at] += capacity / (corners * (corners + 1.0));
                }
            }
        }
    }

    fn add(&mut self, nodes: &[u32], local: &[[f64; 4]; 4], sign: f64) {
        for (a, &row) in nodes.iter().enumerate() {
            self.diagonal[row as usize] += sign * local[a][a];
            let from = self.rows[row as usize] as usize;
            let columns = &self.columns[from..self.rows[row as usize + 1] as usize];
            for (b, column) in nodes.iter().enumerate().filter(|(b, _)| *b != a) {
                if let Ok(at) = columns.binary_search(column) {
                    self.values[from + at] += sign * local[a][b];
                }
            }
        }
    }

    /// y = −K x: heat flow into each vertex. The diagonal is minus the sum of its row: what leaves one vertex arrives
    /// at another.
    fn apply(&self, x: &[f64], y: &mut [f64]) {
        for (row, y) in y.iter_mut().enumerate() {
            let entries = self.rows[row] as usize..self.rows[row + 1] as usize;
            let own = x[row];
            let entries = self.columns[entries.clone()].iter().zip(&self.values[entries]);
            *y = entries.fold(0.0, |sum, (column, value)| sum + value * (own - x[*column as usize]));
        }
    }
}

/// Conduction matrix of an element \[W/K\]: k V ∇λa·∇λb.
pub(super) fn element_conduction(tissue: &Tissue<'_>, element: usize, conductivity: f64) -> [[f64; 4]; 4] {
    // A blade may leave slivers; a degenerate element would conduct without limit.
    if tissue.is_flat(element) {
        return [[0.0; 4]; 4];
    }
    let at = |vertex: u32| tissue.positions()[vertex as usize];
    let gradients = match tissue {
        Tissue::Volume { tets, .. } => {
            let [a, b, c, d] = tets[element].map(at);
            let six = (b - a).cross(&(c - a)).dot(&(d - a));
            let [gb, gc, gd] = [(c - a).cross(&(d - a)), (d - a).cross(&(b - a)), (b - a).cross(&(c - a))];
            [-(gb + gc + gd) / six, gb / six, gc / six, gd / six]
        }
        Tissue::Membrane { triangles, .. } => {
            let [a, b, c] = triangles[element].map(at);
            let normal = (b - a).cross(&(c - a));
            let across = normal / normal.norm_squared();
            [
                across.cross(&(c - b)),
                across.cross(&(a - c)),
                across.cross(&(b - a)),
                nalgebra::Vector3::zeros(),
            ]
        }
    };
    let scale = conductivity * tissue.volume(element);
    gradients.map(|a| gradients.map(|b| scale * a.dot(&b)))
}

impl OrganHeat {
    /// A validated tissue at body temperature.
    pub(super) fn new(tissue: &Tissue<'_>, material: &ThermalMaterial) -> Self {
        let vertices = tissue.positions().len();
        let mut volume = vec![0.0; vertices];
        for element in 0..tissue.element_count() {
            let corners = tissue.corners(element);
            let share = tissue.volume(element) / corners.len() as f64;
            corners.iter().for_each(|vertex| volume[*vertex as usize] += share);
        }
        let elements = (0..tissue.element_count()).map(|element| {
            (tissue.corners(element).to_vec(), element_conduction(tissue, element, material.conductivity))
        });
        let mut conduction = Conduction::new(vertices, elements);
        for element in 0..tissue.element_count() {
            conduction.add_mass(tissue.corners(element), tissue.volume(element) * material.wet_capacity());
        }
        let capacity: Vec<f64> = volume.iter().map(|volume| volume * material.wet_capacity()).collect();
        Self {
            celsius: vec![BODY; vertices],
            capacity_least: capacity.iter().map(|capacity| capacity * CAPACITY_KEPT).collect(),
            capacity,
            perfusion: volume.iter().map(|volume| volume * material.perfusion_loss()).collect(),
            arterial: material.arterial,
            held: vec![false; vertices],
            conduction,
            deposits: vec![0.0; vertices],
            has_deposits: false,
            reached: Vec::new(),
            scatter: (Vector3::zeros(), 0.0),
            positions: tissue.positions().to_vec(),
            whole: volume,
            rest: std::array::from_fn(|_| vec![0.0; vertices]),
        }
    }

    /// Removes an element's conduction.
    pub(super) fn disconnect(&mut self, nodes: &[u32], local: &[[f64; 4]; 4]) {
        self.conduction.add(nodes, local, -1.0);
    }

    /// Heat above body temperature \[J\].
    pub(super) fn stored(&self) -> f64 {
        self.capacity.iter().zip(&self.celsius).map(|(capacity, celsius)| capacity * (celsius - BODY)).sum()
    }

    /// Adds heat \[J\] to the vertices around a cell. Heat into vertices with prescribed temperature is lost.
    pub(super) fn deposit(&mut self, site: &CellLocation, joules: f64) -> f64 {
        let mut lost = 0.0;
        for (node, weight) in site.nodes.iter().zip(site.weights()) {
            let node = *node as usize;
            if self.held[node] {
                lost += joules * weight;
            } else {
                self.celsius[node] += joules * weight / self.capacity[node];
            }
        }
        lost
    }

    /// The same, taken by the mesh all at once ([`Self::take_deposits`]).
    pub(super) fn deposit_later(&mut self, site: &CellLocation, place: &Point3<f64>, joules: f64) -> f64 {
        let mut lost = 0.0;
        for (node, weight) in site.nodes.iter().zip(site.weights()) {
            let node = *node as usize;
            if self.held[node] {
                lost += joules * weight;
            } else {
                self.deposits[node] += joules * weight;
                self.scatter.0 += (self.positions[node] - place) * (joules * weight);
                self.scatter.1 += joules
                    * weight
                    * (self.positions[node].coords.norm_squared() - place.coords.norm_squared());
                self.has_deposits = true;
            }
        }
        lost
    }

    /// Takes the heat that was deposited. Shared among the vertices around it, heat is spread by the size of an element;
    /// so as much is taken back from between neighbours, along the difference between the elements' mass matrix and the
    /// lumped one: its mean square distance is that of the heat that was deposited. What one vertex gives, another gets.
    pub(super) fn take_deposits(&mut self) {
        if !self.has_deposits {
            return;
        }
        self.has_deposits = false;
        // Heat arrives in the vertices around a few blocks, of all those of an organ.
        let (rows, columns) = (&self.conduction.rows, &self.conduction.columns);
        self.reached.clear();
        for node in (0..self.deposits.len()).filter(|node| self.deposits[*node] != 0.0) {
            self.reached.push(node as u32);
            self.reached.extend_from_slice(&columns[rows[node] as usize..rows[node + 1] as usize]);
        }
        self.reached.sort_unstable();
        self.reached.dedup();
        let reached = || self.reached.iter().map(|node| *node as usize);
        let [rise, moved, ..] = &mut self.rest;
        rise.fill(0.0);
        for node in reached() {
            rise[node] = self.deposits[node] / self.capacity[node];
        }
        // Where tissue is gone, less is exchanged.
        let left = |node: usize| CAPACITY_KEPT * self.capacity[node] / self.capacity_least[node];
        let exchanged = |node: usize, rise: &[f64]| -> f64 {
            let entries = self.conduction.rows[node] as usize..self.conduction.rows[node + 1] as usize;
            let mut joules = 0.0;
            for entry in entries {
                let other = self.conduction.columns[entry] as usize;
                if !self.held[other] && rise[node] != rise[other] {
                    let mass = self.conduction.masses[entry] * left(node).min(left(other)).min(1.0);
                    joules += mass * (rise[node] - rise[other]);
                }
            }
            joules
        };
        let (mut whole, mut middle) = (0.0, Vector3::zeros());
        for node in reached() {
            whole += self.deposits[node];
            middle += self.positions[node].coords * self.deposits[node];
        }
        let middle = if whole == 0.0 { Vector3::zeros() } else { middle / whole };
        let mut gathered = 0.0;
        for node in reached().filter(|node| !self.held[*node]) {
            moved[node] = exchanged(node, rise);
            gathered -= moved[node] * (self.positions[node].coords - middle).norm_squared();
        }
        let scattered = self.scatter.1 - 2.0 * self.scatter.0.dot(&middle);
        let share = if gathered > 0.0 { (scattered / gathered).clamp(0.0, EXCHANGED_MAX) } else { 0.0 };
        self.scatter = (Vector3::zeros(), 0.0);
        for node in reached() {
            let joules = std::mem::take(&mut self.deposits[node]);
            if !self.held[node] {
                self.celsius[node] += (joules + share * moved[node]) / self.capacity[node];
            }
        }
    }

    /// Removes heat capacity \[J/K\] together with its heat, which is returned \[J\].
    pub(super) fn shrink(&mut self, site: &CellLocation, capacity: f64) -> f64 {
        let mut gone = 0.0;
        for (node, weight) in site.nodes.iter().zip(site.weights()) {
            let node = *node as usize;
            let most = self.capacity[node] - self.capacity_least[node];
            let taken = (capacity * weight).clamp(0.0, most.max(0.0));
            self.capacity[node] -= taken;
            gone += taken * (self.celsius[node] - BODY);
        }
        gone
    }

    /// Removes the perfusion at a cell \[W/K\].
    pub(super) fn stop_perfusion(&mut self, site: &CellLocation, loss: f64) {
        for (node, weight) in site.nodes.iter().zip(site.weights()) {
            let perfusion = &mut self.perfusion[*node as usize];
            *perfusion = (*perfusion - loss * weight).max(0.0);
        }
    }

    /// One step of conduction and perfusion. On an error nothing has changed.
    pub(super) fn step(&mut self, dt: f64) -> Result<OrganStep, HeatStepError> {
        let vertices = self.celsius.len();
        let [change, residual, direction, image, inverse, flow] = &mut self.rest;
        // (C/dt + K + P) Δ = −K T − P (T − Ta), with K's rows as flows into a vertex.
        self.conduction.apply(&self.celsius, flow);
        for node in 0..vertices {
            let out = self.perfusion[node] * (self.celsius[node] - self.arterial);
            residual[node] = if self.held[node] { 0.0 } else { flow[node] - out };
            let diagonal = self.capacity[node] / dt + self.perfusion[node] + self.conduction.diagonal[node];
            inverse[node] = if self.held[node] || diagonal <= 0.0 { 0.0 } else { 1.0 / diagonal };
        }
        change.fill(0.0);
        let worst = |residual: &[f64]| {
            let off = residual.iter().zip(&self.capacity).map(|(off, capacity)| off.abs() * dt / capacity);
            off.enumerate()
                .filter(|(_, off)| !off.is_nan())
                .fold((0, 0.0), |most, now| if now.1 > most.1 { now } else { most })
        };
        let mut iterations = 0;
        let mut product: f64 = 0.0;
        loop {
            let (vertex, off) = worst(residual);
            if off <= RESIDUAL {
                break;
            }
            if iterations == ITERATIONS_MAX || !off.is_finite() {
                return Err(HeatStepError::NotConverged { vertex: vertex as u32, residual: off, iterations });
            }
            iterations += 1;
            let last = product;
            product = (0..vertices).map(|node| residual[node] * residual[node] * inverse[node]).sum();
            let keep = if iterations == 1 { 0.0 } else { product / last };
            for node in 0..vertices {
                direction[node] = residual[node] * inverse[node]
                    + if iterations == 1 { 0.0 } else { keep * direction[node] };
            }
            self.conduction.apply(direction, image);
            for node in 0..vertices {
                let own = self.capacity[node] / dt + self.perfusion[node];
                image[node] = if self.held[node] { 0.0 } else { own * direction[node] - image[node] };
            }
            let curvature: f64 = (0..vertices).map(|node| direction[node] * image[node]).sum();
            let length = product / curvature;
            for node in 0..vertices {
                change[node] += length * direction[node];
                residual[node] -= length * image[node];
            }
        }
        // The fluxes at the end of the step move the heat.
        for node in 0..vertices {
            direction[node] = self.celsius[node] + change[node];
        }
        self.conduction.apply(direction, flow);
        let mut step = OrganStep { iterations, ..OrganStep::default() };
        for node in 0..vertices {
            let out = self.perfusion[node] * (direction[node] - self.arterial);
            let gain = dt * (flow[node] - out);
            step.perfusion += dt * out;
            if self.held[node] {
                step.held += gain;
                image[node] = self.celsius[node];
            } else {
                image[node] = self.celsius[node] + if gain == 0.0 { 0.0 } else { gain / self.capacity[node] };
            }
            if !image[node].is_finite() {
                return Err(HeatStepError::NotConverged {
                    vertex: node as u32,
                    residual: f64::INFINITY,
                    iterations,
                });
            }
        }
        std::mem::swap(&mut self.celsius, image);
        Ok(step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::electrosurgery::testing::{bar, grid_of_triangles};

    fn liver() -> ThermalMaterial {
        ThermalMaterial::default()
    }

    #[test]
    fn a_half_space_that_is_held_at_100_degrees_warms_as_the_error_function() {
        let bloodless = ThermalMaterial { perfusion: 0.0, ..liver() };
        for (depth, seconds, expected, spacing) in [
            (1e-3, 1.0, 40.4845, 0.0625e-3),
            (2e-3, 5.0, 42.4499, 0.125e-3),
            (5e-3, 30.0, 42.0533, 0.3125e-3),
        ] {
            let (positions, tets) = bar([64, 1, 1], spacing);
            let tissue = Tissue::Volume { positions: &positions, tets: &tets };
            let mut organ = OrganHeat::new(&tissue, &bloodless);
            for (node, position) in positions.iter().enumerate().filter(|(_, position)| position.x == 0.0) {
                assert_eq!(position.x, 0.0);
                (organ.held[node], organ.celsius[node]) = (true, 100.0);
            }
            let steps = 1000;
            for _ in 0..steps {
                organ.step(seconds / f64::from(steps)).expect("a step");
            }
            let node =
                positions.iter().position(|position| (position.x - depth).abs() < 1e-9).expect("a vertex");
            let is = organ.celsius[node];
            assert!((is - expected).abs() < 0.01 * (expected - BODY), "{is}, not {expected}");
        }
    }

    #[test]
    fn where_blood_passes_heat_decays_within_the_length_of_pennes() {
        let spacing = 0.4e-3;
        let (positions, tets) = bar([100, 1, 1], spacing);
        let mut organ = OrganHeat::new(&Tissue::Volume { positions: &positions, tets: &tets }, &liver());
        for (node, position) in positions.iter().enumerate() {
            if position.x == 0.0 {
                (organ.held[node], organ.celsius[node]) = (true, 60.0);
            }
        }
        for _ in 0..40 {
            organ.step(100.0).expect("a step");
        }
        let at = |cells: f64| {
            let x = cells * spacing;
            let node = positions.iter().position(|position| (position.x - x).abs() < 1e-9).expect("a vertex");
            organ.celsius[node] - BODY
        };
        let length = 10.0 * spacing / (at(10.0) / at(20.0)).ln();
        assert!((length / 4.40883e-3 - 1.0).abs() < 0.005, "{length} m");
    }

    #[test]
    fn any_step_on_any_mesh_is_stable_and_keeps_the_heat() {
        let bloodless = ThermalMaterial { perfusion: 0.0, ..liver() };
        let (mut positions, triangles) = grid_of_triangles(12, 1e-3);
        // A sliver: one vertex almost on its neighbour.
        positions[40] = positions[41] + (positions[40] - positions[41]) * 1e-4;
        let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 1e-3 };
        tissue.check().expect("thin, but with an area");
        for dt in [1e-3, 0.1, 10.0, 1e4] {
            let mut organ = OrganHeat::new(&tissue, &bloodless);
            organ.celsius[80] = 99.0;
            let before = organ.stored();
            for _ in 0..20 {
                organ.step(dt).expect("a step");
            }
            let (least, most) =
                organ.celsius.iter().fold((f64::MAX, f64::MIN), |(l, m), t| (l.min(*t), m.max(*t)));
            assert!(least > BODY - 1.0 && most <= 99.0, "{dt}: {least} to {most}");
            assert!((organ.stored() / before - 1.0).abs() < 1e-9, "{dt}");
        }
    }

    #[test]
    fn a_membrane_conducts_as_a_slab_of_its_thickness() {
        let bloodless = ThermalMaterial { perfusion: 0.0, ..liver() };
        let (positions, triangles) = grid_of_triangles(40, 0.25e-3);
        let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 2e-3 };
        let mut organ = OrganHeat::new(&tissue, &bloodless);
        for (node, position) in positions.iter().enumerate() {
            organ.held[node] = position.x == 0.0;
            if organ.held[node] {
                organ.celsius[node] = 100.0;
            }
        }
        let mut given = 0.0;
        for _ in 0..500 {
            given += organ.step(0.01).expect("a step").held;
        }
        let at = positions.iter().position(|p: &Point3<f64>| (p.x - 2e-3).abs() < 1e-9 && p.y > 4e-3);
        let is = organ.celsius[at.expect("a vertex")];
        assert!((is - 42.4499).abs() < 0.1, "{is}");
        assert!(given < 0.0, "the held edge gives heat");
    }
}
