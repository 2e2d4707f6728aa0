//! Discrete elastic rods (Bergou, Wardetzky, Robinson, Audoly, Grinspun 2008; Bergou, Audoly, Vouga, Wardetzky,
//! Grinspun 2010): forces of stretch, bending and twist of an isotropic, naturally straight rod, and the matrix of an
//! implicit step.
//!
//! The matrix is the Gauss–Newton approximation of the bending and twisting energy's Hessian, so it is positive
//! definite at any shape. Tensions are additional unknowns (the primal–dual form of Macklin, Müller, *XPBD*, 2016,
//! solved directly for the whole rod as in Deul et al. 2018): the geometric stiffness across a stretched edge comes
//! from the solved tension, not from the strain of an unconverged iterate.
// One index runs over several arrays.
#![allow(clippy::needless_range_loop)]

use nalgebra::{Matrix3, Point3, Vector3};

use super::ThreadMaterial;
use super::bishop_frame::{angle_about, perpendicular, transport, turn, unwrapped};
use super::state::ThreadState;
use crate::linear_algebra::block_banded::{Block, BlockBand, Cell};

/// `1 + cos` of the angle between two edges is clamped below at this value: bending stiffness no longer grows beyond
/// 169°.
const FOLD: f64 = 0.02;

/// A Newton iterate of the shape at the end of the step.
#[derive(Clone, Debug, Default)]
pub(crate) struct RodIterate {
    pub positions: Vec<Point3<f64>>,
    /// Rotation of each edge about its own axis since the beginning of the step \[rad\].
    pub turns: Vec<f64>,
    pub tangents: Vec<Vector3<f64>>,
    pub lengths: Vec<f64>,
    pub directors: Vec<Vector3<f64>>,
    pub twists: Vec<f64>,
    pub tensions: Vec<f64>,
}

impl RodIterate {
    /// Starts from the state.
    pub fn begin(&mut self, state: &ThreadState) {
        self.positions.clone_from(&state.positions);
        self.twists.clone_from(&state.twists);
        self.directors.clone_from(&state.directors);
        self.tensions.clone_from(&state.tensions);
        let edges = state.rest_lengths.len();
        self.turns.clear();
        self.turns.resize(edges, 0.0);
        self.tangents.resize(edges, Vector3::zeros());
        self.lengths.resize(edges, 0.0);
        self.measure(state);
    }

    fn measure(&mut self, state: &ThreadState) {
        for edge in 0..state.rest_lengths.len() {
            if !state.joins(edge) {
                (self.lengths[edge], self.tangents[edge]) = (1.0, Vector3::z());
                continue;
            }
            let along = self.positions[state.after(edge)] - self.positions[edge];
            let length = along.norm();
            self.lengths[edge] = length;
            self.tangents[edge] = along / length;
        }
    }

    /// Updates the directors after positions and turns have changed: time-parallel transport from the beginning of the
    /// step, then the turn.
    pub fn follow(&mut self, start: &ThreadState) {
        self.measure(start);
        for edge in 0..self.tangents.len() {
            if !start.joins(edge) {
                continue;
            }
            let before = (start.positions[start.after(edge)] - start.positions[edge]).normalize();
            let tangent = self.tangents[edge];
            let carried = transport(&before, &tangent, &start.directors[edge]);
            self.directors[edge] = perpendicular(&turn(&carried, &tangent, self.turns[edge]), &tangent);
        }
        for node in 0..self.tangents.len() {
            let Some(before) = start.bends(node) else { continue };
            let carried = transport(&self.tangents[before], &self.tangents[node], &self.directors[before]);
            let angle = angle_about(&carried, &self.directors[node], &self.tangents[node]);
            self.twists[node] = unwrapped(angle, self.twists[node]);
        }
    }
}

/// Lumped mass of a node: half of each adjacent edge \[kg\].
pub(crate) fn node_mass(material: &ThreadMaterial, state: &ThreadState, node: usize) -> f64 {
    let before = state.before(node).map_or(0.0, |edge| state.rest_lengths[edge]);
    let after = state.rest_lengths.get(node).copied().unwrap_or(0.0);
    0.5 * material.mass_per_length * (before + after)
}

/// Moment of inertia of an edge about its own axis \[kg·m²\].
pub(crate) fn edge_inertia(material: &ThreadMaterial, rest_length: f64) -> f64 {
    0.5 * material.mass_per_length * rest_length * material.radius * material.radius
}

/// Curvature binormal at a node, and its derivatives by the edge before and after it.
pub(crate) struct Curvature {
    pub binormal: Vector3<f64>,
    pub by_before: Matrix3<f64>,
    pub by_after: Matrix3<f64>,
}

#[inline]
pub(crate) fn curvature(t: &Vector3<f64>, u: &Vector3<f64>, le: f64, lf: f64) -> Curvature {
    let reach = (1.0 + t.dot(u)).max(FOLD);
    let scale = 1.0 / reach;
    let binormal = t.cross(u) * (2.0 * scale);
    // With dt across t and du across u.
    let by_t = (u.cross_matrix() * -2.0 - binormal * u.transpose()) * scale;
    let by_u = (t.cross_matrix() * 2.0 - binormal * t.transpose()) * scale;
    let across =
        |by: Matrix3<f64>, axis: &Vector3<f64>, length: f64| (by - (by * axis) * axis.transpose()) / length;
    Curvature { binormal, by_before: across(by_t, t, le), by_after: across(by_u, u, lf) }
}

/// Adds the rod's internal and body forces at the iterate to `right`, and the implicit matrix of a step of `dt` to
/// `matrix`: inertia, drag, gravity, stretch, bending, twist, damping.
pub(crate) fn assemble(
    material: &ThreadMaterial,
    start: &ThreadState,
    at: &RodIterate,
    dt: f64,
    gravity: &Vector3<f64>,
    matrix: &mut BlockBand,
    right: &mut [Cell],
) {
    inertia(material, start, at, dt, gravity, matrix, right);
    for edge in (0..at.tangents.len()).filter(|edge| start.joins(*edge)) {
        stretch(material, start, at, edge, matrix, right);
    }
    for node in 0..at.tangents.len() {
        let Some(before) = start.bends(node) else { continue };
        bend(material, start, at, dt, [before, node], matrix, right);
    }
}

fn inertia(
    material: &ThreadMaterial,
    start: &ThreadState,
    at: &RodIterate,
    dt: f64,
    gravity: &Vector3<f64>,
    matrix: &mut BlockBand,
    right: &mut [Cell],
) {
    let rate = 1.0 / (dt * dt);
    for node in 0..at.positions.len() {
        let mass = node_mass(material, start, node);
        let moved = at.positions[node] - start.positions[node];
        let drag = material.drag / dt;
        let force =
            (start.velocities[node] * dt - moved) * (mass * rate) + gravity * mass - moved * (mass * drag);
        let stiffness = mass * (rate + drag);
        for k in 0..3 {
            right[node][k] += force[k];
            matrix.diagonal[node][(k, k)] += stiffness;
        }
        if start.joins(node) {
            let inertia = edge_inertia(material, start.rest_lengths[node]);
            right[node][3] +=
                inertia * rate * (start.spins[node] * dt - at.turns[node]) - inertia * drag * at.turns[node];
            matrix.diagonal[node][(3, 3)] += inertia * (rate + drag);
        } else {
            matrix.diagonal[node][(3, 3)] += 1.0;
        }
    }
}

fn stretch(
    material: &ThreadMaterial,
    start: &ThreadState,
    at: &RodIterate,
    edge: usize,
    matrix: &mut BlockBand,
    right: &mut [Cell],
) {
    let (t, length, rest) = (at.tangents[edge], at.lengths[edge], start.rest_lengths[edge]);
    let along = material.axial_stiffness / rest;
    let force = t * (along * (length - rest));
    let across = at.tensions[edge].max(0.0) / length;
    let block = t * t.transpose() * (along - across) + Matrix3::identity() * across;
    let end = start.after(edge);
    for k in 0..3 {
        right[edge][k] += force[k];
        right[end][k] -= force[k];
    }
    for column in 0..3 {
        for row in 0..3 {
            let value = block[(row, column)];
            matrix.diagonal[edge][(row, column)] += value;
            matrix.diagonal[end][(row, column)] += value;
            matrix.first[end][(row, column)] -= value;
        }
    }
}

fn bend(
    material: &ThreadMaterial,
    start: &ThreadState,
    at: &RodIterate,
    dt: f64,
    // The edges before and after a node, which begin at the node before it and at itself.
    [before, after]: [usize; 2],
    matrix: &mut BlockBand,
    right: &mut [Cell],
) {
    let (first, node, last) = (before, after, start.after(after));
    let (le, lf) = (at.lengths[before], at.lengths[after]);
    let found = curvature(&at.tangents[before], &at.tangents[after], le, lf);
    let span = 0.5 * (start.rest_lengths[before] + start.rest_lengths[after]);
    let (bending, twisting) = (material.bending_stiffness / span, material.twisting_stiffness / span);
    let viscous = material.damping / dt;
    let moved = |i: usize| at.positions[i] - start.positions[i];
    let (e_moved, f_moved) = (moved(node) - moved(first), moved(last) - moved(node));
    let bent = found.by_before * e_moved + found.by_after * f_moved;
    let moment = (found.binormal + bent * viscous) * bending;
    let (twist_e, twist_f) = (found.binormal / (2.0 * le), found.binormal / (2.0 * lf));
    let twisted = at.turns[after] - at.turns[before] + twist_e.dot(&e_moved) + twist_f.dot(&f_moved);
    let torque = twisting * (at.twists[node] + twisted * viscous);
    let force_e = found.by_before.tr_mul(&moment) + twist_e * torque;
    let force_f = found.by_after.tr_mul(&moment) + twist_f * torque;
    for k in 0..3 {
        right[first][k] += force_e[k];
        right[node][k] += force_f[k] - force_e[k];
        right[last][k] -= force_f[k];
    }
    right[before][3] += torque;
    right[after][3] -= torque;

    let bending = bending * (1.0 + viscous);
    let twisting = twisting * (1.0 + viscous);
    let ee = found.by_before.tr_mul(&found.by_before) * bending;
    let fe = found.by_after.tr_mul(&found.by_before) * bending;
    let ff = found.by_after.tr_mul(&found.by_after) * bending;
    let ef = fe.transpose();
    let middle = twist_e - twist_f;
    let arms = [
        Cell::new(-twist_e.x, -twist_e.y, -twist_e.z, -1.0),
        Cell::new(middle.x, middle.y, middle.z, 1.0),
        Cell::new(twist_f.x, twist_f.y, twist_f.z, 0.0),
    ];
    let put = |block: &mut Block, bending: Matrix3<f64>, p: usize, q: usize| {
        *block += arms[p] * (arms[q] * twisting).transpose();
        for column in 0..3 {
            for row in 0..3 {
                block[(row, column)] += bending[(row, column)];
            }
        }
    };
    put(&mut matrix.diagonal[first], ee, 0, 0);
    put(&mut matrix.diagonal[node], ee - ef - fe + ff, 1, 1);
    put(&mut matrix.diagonal[last], ff, 2, 2);
    put(&mut matrix.first[node], fe - ee, 1, 0);
    put(&mut matrix.first[last], fe - ff, 2, 1);
    put(&mut matrix.second[last], -fe, 2, 0);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn energy(material: &ThreadMaterial, start: &ThreadState, at: &RodIterate) -> f64 {
        let mut sum = 0.0;
        for edge in 0..at.tangents.len() {
            let rest = start.rest_lengths[edge];
            sum += 0.5 * material.axial_stiffness / rest * (at.lengths[edge] - rest).powi(2);
        }
        for node in 0..at.tangents.len() {
            let Some(before) = start.bends(node) else { continue };
            let span = 0.5 * (start.rest_lengths[before] + start.rest_lengths[node]);
            let found =
                curvature(&at.tangents[before], &at.tangents[node], at.lengths[before], at.lengths[node]);
            sum += 0.5 * material.bending_stiffness / span * found.binormal.norm_squared();
            sum += 0.5 * material.twisting_stiffness / span * at.twists[node].powi(2);
        }
        sum
    }

    /// A bent and twisted rod, open or closed.
    fn shape(is_closed: bool) -> (ThreadMaterial, ThreadState) {
        let points: Vec<_> = (0..7)
            .map(|i| {
                let s = i as f64 * 0.45;
                Point3::new(s.cos(), s.sin() * 1.1, 0.2 * s * s)
            })
            .collect();
        let mut material = ThreadMaterial::silk_2_0();
        (material.axial_stiffness, material.bending_stiffness, material.twisting_stiffness) = (3.0, 0.7, 0.4);
        (material.drag, material.mass_per_length) = (0.0, 1e-12);
        let mut state =
            if is_closed { ThreadState::closed_at_rest(&points) } else { ThreadState::at_rest(&points) };
        for (i, rest) in state.rest_lengths.iter_mut().enumerate() {
            *rest *= 0.9 + 0.05 * i as f64;
        }
        let mut at = RodIterate::default();
        at.begin(&state);
        for edge in 0..at.turns.len() {
            at.turns[edge] = 0.3 * (edge * edge) as f64 * 0.2;
        }
        at.follow(&state);
        (state.directors, state.twists) = (at.directors.clone(), at.twists.clone());
        (material, state)
    }

    #[test]
    fn forces_are_the_slope_of_the_energy() {
        [false, true].into_iter().for_each(check_slope);
    }

    fn check_slope(is_closed: bool) {
        let (material, state) = shape(is_closed);
        let n = state.positions.len();
        let mut at = RodIterate::default();
        at.begin(&state);
        let mut matrix = BlockBand::default();
        matrix.clear(n);
        let mut right = vec![Cell::zeros(); n];
        assemble(&material, &state, &at, 1.0, &Vector3::zeros(), &mut matrix, &mut right);
        let step = 1e-6;
        for node in 0..n {
            for k in 0..4 {
                if !is_closed && (node, k) == (n - 1, 3) {
                    continue;
                }
                let moved = |by: f64| {
                    let mut at = RodIterate::default();
                    at.begin(&state);
                    if k < 3 {
                        at.positions[node][k] += by
                    } else {
                        at.turns[node] += by
                    }
                    at.follow(&state);
                    energy(&material, &state, &at)
                };
                let slope = (moved(step) - moved(-step)) / (2.0 * step);
                let found = right[node][k];
                assert!((found + slope).abs() < 1e-8, "node {node} axis {k}: {found} for {}", -slope);
            }
        }
    }

    #[test]
    fn inner_forces_have_neither_sum_nor_moment() {
        [false, true].into_iter().for_each(check_sums);
    }

    fn check_sums(is_closed: bool) {
        let (material, state) = shape(is_closed);
        let n = state.positions.len();
        let mut at = RodIterate::default();
        at.begin(&state);
        let mut matrix = BlockBand::default();
        matrix.clear(n);
        let mut right = vec![Cell::zeros(); n];
        assemble(&material, &state, &at, 1.0, &Vector3::zeros(), &mut matrix, &mut right);
        let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
        for node in 0..n {
            let of = right[node].fixed_rows::<3>(0).into_owned();
            force += of;
            moment += state.positions[node].coords.cross(&of);
            if node + 1 < n || is_closed {
                moment += at.tangents[node] * right[node][3];
            }
        }
        assert!(force.norm() < 1e-14 && moment.norm() < 1e-13, "{force} {moment}");
    }
}
