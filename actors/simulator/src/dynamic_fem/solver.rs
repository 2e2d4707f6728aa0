//! Quasi-Newton time step of a dynamic body.

use nalgebra::{Matrix3, Point3, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::soft_body::bearing::rigid_response::RigidResponse;
use trocar_dynamics::tet_mesh::TetMesh;

use super::config::{Config, DynamicFemError, Energies, Report, StepError};
use super::constitutive::Material;
use super::incremental_potential::{
    Coupling, Damping, Element, ElementForces, Inputs, Mass, add_couplings, add_hessian, add_rigid,
    add_springs, couplings, frames,
};
use super::lbfgs::{Memory, dot};
use super::stale_factor::{self, StaleFactor};
use crate::linear_algebra::{BlockMatrix, FactorError, SupernodalCholesky};

/// Where the factor was computed: a restored body recomputes it there, bit for bit.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FactoredAt {
    pub positions: Vec<Point3<f64>>,
    pub dt: f64,
    pub couplings: Vec<Coupling>,
}

/// Iterations of a step that do not count as debt.
const FREE_ITERATIONS: u32 = 2;
/// Accumulated extra iterations that cost as much as a new factor.
const DEBT_MAX: u32 = 8;
/// Iterations within one step after which the factor is recomputed.
const REFACTOR_AFTER: u32 = 12;
/// Relative residual beyond which an initial guess is compared with others.
const GUESS: f64 = 0.1;
/// Maximum halvings in the line search.
const HALVINGS_MAX: u32 = 40;

/// A dynamic elastic body.
pub struct DynamicFem {
    pub(super) mesh: TetMesh,
    pub(super) config: Config,
    pub(super) elements: Vec<Element>,
    pub(super) material: Material,
    pub(super) lame: [f64; 2],
    pub(super) mass: Mass,
    /// Number of elements at each node; a node without any keeps its position.
    pub(super) around: Vec<u32>,
    pub(super) fixed: Vec<bool>,
    /// Row of each node in elimination order; `None` for fixed ones, and for new ones while the factor is stale.
    pub(super) numbers: Vec<Option<u32>>,
    pub(super) positions: Vec<Point3<f64>>,
    pub(super) velocities: Vec<Vector3<f64>>,
    pub(super) accelerations: Vec<Vector3<f64>>,
    pub(super) debt: u32,
    pub(super) factored_at: FactoredAt,
    pub(super) hessian: BlockMatrix,
    pub(super) factor: SupernodalCholesky,
    /// Set while the factor is that of the former mesh.
    pub(super) lent: Option<StaleFactor>,
    /// See [`Self::analysed`].
    pub(super) analysed: u32,
    pub(super) memory: Memory,
    /// Rounding error of the elastic energy \[J\]: it is a difference of terms as large as the stiffness.
    pub(super) rounding: f64,
    /// Rounding error of the forces \[N\], from the rounding of positions.
    pub(super) floor: f64,
    pub(super) work: Workspace,
}

/// Workspace kept between steps.
#[derive(Default)]
pub(super) struct Workspace {
    pub held: Vec<bool>,
    reactions: Vec<(u32, Vector3<f64>)>,
    before: Vec<(Matrix3<f64>, Matrix3<f64>)>,
    outer: Vec<Vector3<f64>>,
    aim: Vec<Point3<f64>>,
    pub now: Vec<Point3<f64>>,
    trial: Vec<Point3<f64>>,
    pub gradient: Vec<Vector3<f64>>,
    pub next: Vec<Vector3<f64>>,
    pub direction: Vec<Vector3<f64>>,
    apart: Vec<Vector3<f64>>,
    pub(super) product: Vec<Vector3<f64>>,
    pub flat: Vec<f64>,
    /// The last evaluation was that of a rejected trial.
    refused: bool,
    /// Of the rigid bodies to contacts, in the last evaluation.
    rigid: RigidResponse,
}

/// The potential at an iterate.
#[derive(Clone, Copy)]
pub(super) struct PotentialValue {
    energy: f64,
    /// Sum of the magnitudes in `energy`, to which its rounding error is relative.
    magnitude: f64,
    /// Norms of internal, external and inertial forces \[N\].
    scale: f64,
    /// Norm of the residual force \[N\].
    residual: f64,
}

impl DynamicFem {
    /// A body at rest.
    ///
    /// # Errors
    /// Parameters out of range, missing nodes, no free node, not enough memory.
    pub fn new(
        mesh: TetMesh,
        elastic: &Elastic,
        config: &Config,
        fixed: &[u32],
    ) -> Result<Self, DynamicFemError> {
        let range = |what, value: f64, fits: bool, valid| {
            if fits { Ok(()) } else { Err(DynamicFemError::OutOfRange { what, value, valid }) }
        };
        let Config { density, mass_damping, stiffness_damping, tolerance, .. } = *config;
        range("density", density, density > 0.0 && density.is_finite(), "a number above 0")?;
        range("mass damping", mass_damping, (0.0..1e6).contains(&mass_damping), "0 to 1e6 1/s")?;
        range("stiffness damping", stiffness_damping, (0.0..1e3).contains(&stiffness_damping), "0 to 1e3 s")?;
        range("tolerance", tolerance, (1e-12..0.1).contains(&tolerance), "1e-12 to 0.1")?;
        let iterations = f64::from(config.iterations_max);
        range("iterations_max", iterations, (1.0..=1e4).contains(&iterations), "1 to 10,000")?;

        let nodes = mesh.rest().len();
        let mut is_fixed = vec![false; nodes];
        for &node in fixed {
            *is_fixed.get_mut(node as usize).ok_or(DynamicFemError::NoNode { node, nodes })? = true;
        }
        if is_fixed.iter().all(|fixed| *fixed) {
            return Err(DynamicFemError::NothingFree(nodes));
        }
        let (numbers, hessian, factor) = Self::analyse(&mesh, &is_fixed)?;
        let still = vec![Vector3::zeros(); nodes];
        let mut body = Self {
            elements: Vec::new(),
            around: Vec::new(),
            material: Material::new(config.constitution, elastic),
            lame: [elastic.lambda(), elastic.mu()],
            mass: Mass { lumped: Vec::new(), consistent: None },
            fixed: Vec::new(),
            numbers,
            positions: mesh.rest().to_vec(),
            velocities: still.clone(),
            accelerations: still,
            debt: 0,
            factored_at: FactoredAt::default(),
            hessian,
            factor,
            lent: None,
            analysed: 0,
            memory: Memory::default(),
            rounding: 0.0,
            floor: 0.0,
            work: Workspace::default(),
            mesh,
            config: *config,
        };
        body.derive_from_mesh(fixed);
        body.work.flat.resize(body.factor.rows(), 0.0);
        Ok(body)
    }

    /// Its mesh at rest.
    #[must_use]
    pub fn mesh(&self) -> &TetMesh {
        &self.mesh
    }

    /// Node positions \[m\].
    #[must_use]
    pub fn positions(&self) -> &[Point3<f64>] {
        &self.positions
    }

    /// Node velocities \[m/s\].
    #[must_use]
    pub fn velocities(&self) -> &[Vector3<f64>] {
        &self.velocities
    }

    /// Reactions of the prescribed and fixed nodes in the last step \[N\], by node.
    #[must_use]
    pub fn reactions(&self) -> &[(u32, Vector3<f64>)] {
        &self.work.reactions
    }

    /// Forces of the contacts with rigid bodies in the last step, along their normals \[N\].
    #[must_use]
    pub fn rigid_forces(&self) -> &[f64] {
        &self.work.rigid.forces
    }

    /// Number of entries of the factor: what a solve reads.
    #[must_use]
    pub fn factor_entries(&self) -> usize {
        self.factor.entries()
    }

    /// Kinetic and elastic energy.
    #[must_use]
    pub fn energies(&self) -> Energies {
        let mut product = vec![Vector3::zeros(); self.velocities.len()];
        self.mass.multiply(&self.velocities, &mut product);
        let mut forces = vec![Vector3::zeros(); self.velocities.len()];
        let elastic = self.element_forces(1.0, &[]).add(&self.positions, &mut forces);
        Energies { kinetic: 0.5 * dot(&self.velocities, &product), elastic }
    }

    pub(super) fn element_forces<'a>(
        &'a self,
        dt: f64,
        before: &'a [(Matrix3<f64>, Matrix3<f64>)],
    ) -> ElementForces<'a> {
        let damping = Damping { mass: self.config.mass_damping, stiffness: self.config.stiffness_damping };
        ElementForces {
            elements: &self.elements,
            material: self.material,
            lame: self.lame,
            damping,
            before,
            dt,
        }
    }

    /// Whether a node is neither fixed nor without elements.
    pub(super) fn moves(&self, node: usize) -> bool {
        !self.fixed[node] && self.around[node] > 0
    }

    /// One step of `dt` \[s\].
    ///
    /// # Errors
    /// Invalid inputs, or a diverged step; the body is unchanged then.
    pub fn step(&mut self, dt: f64, inputs: &Inputs) -> Result<Report, StepError> {
        if !(dt > 0.0 && dt <= 1.0) {
            return Err(StepError::Dt(dt));
        }
        // Taken out, so that it can be written while the body is read.
        let mut work = std::mem::take(&mut self.work);
        let done = self.checked_step(dt, inputs, &mut work);
        self.work = work;
        done
    }

    fn checked_step(&mut self, dt: f64, inputs: &Inputs, work: &mut Workspace) -> Result<Report, StepError> {
        self.check(inputs, work)?;
        self.begin(dt, inputs, work);
        let mut report = Report {
            residual: 0.0,
            solved: false,
            iterations: 0,
            evaluations: 0,
            factorisations: 0,
            inverted: 0,
            first_inverted: None,
        };
        let is_none = self.factored_at.dt != dt || self.factored_at.positions.is_empty();
        if is_none && self.lent.is_some() {
            self.settle()?;
        }
        if is_none || (self.debt >= DEBT_MAX && self.lent.is_none()) {
            // Which contacts press, of this step's.
            inputs.rigid.answer(dt, |_| 0.0, &mut work.rigid);
            let begin = FactoredAt { positions: self.positions.clone(), dt, couplings: Vec::new() };
            self.refactor(begin, inputs, &work.rigid)?;
            report.factorisations += 1;
        }
        let value = self.minimise(dt, inputs, work, &mut report)?;
        if inputs.springs.is_empty() && inputs.contacts.is_empty() && !work.held.contains(&true) {
            self.balance(dt, work);
        }
        if let Some(node) = work.now.iter().position(|point| !point.iter().all(|x| x.is_finite())) {
            return Err(StepError::NotFinite { node: node as u32 });
        }
        if !value.residual.is_finite() {
            return Err(StepError::NotFinite { node: 0 });
        }
        let beyond = (value.residual - self.floor).max(0.0);
        report.residual = if beyond > 0.0 { beyond / value.scale } else { 0.0 };
        report.solved = self.solved(&value);
        self.debt += report.iterations.saturating_sub(FREE_ITERATIONS);
        for node in 0..self.positions.len() {
            let velocity = (work.now[node] - self.positions[node]) / dt;
            self.accelerations[node] = (velocity - self.velocities[node]) / dt;
            self.velocities[node] = velocity;
        }
        self.positions.clone_from(&work.now);
        for (index, element) in self.elements.iter().enumerate().filter(|(_, element)| !element.is_gone()) {
            if trocar_dynamics::tet_mesh::shape(&self.positions, &element.nodes).determinant() <= 0.0 {
                report.inverted += 1;
                report.first_inverted.get_or_insert(index as u32);
            }
        }
        Ok(report)
    }

    /// Validates the inputs, and marks held nodes.
    fn check(&self, inputs: &Inputs, work: &mut Workspace) -> Result<(), StepError> {
        let nodes = self.positions.len();
        let number = |what, index, fits: bool| {
            if fits { Ok(()) } else { Err(StepError::Number { what, index }) }
        };
        number("acceleration", 0, inputs.acceleration.iter().all(|x| x.is_finite()))?;
        for (index, (node, force)) in inputs.forces.iter().enumerate() {
            if *node as usize >= nodes {
                return Err(StepError::Node { what: "force", index, node: *node, nodes });
            }
            number("force", index, force.iter().all(|x| x.is_finite()))?;
        }
        let weighted = |what, index, weights: &[(u32, f64); 4]| match weights
            .iter()
            .find(|(node, weight)| *weight != 0.0 && *node as usize >= nodes)
        {
            Some(&(node, _)) => Err(StepError::Node { what, index, node, nodes }),
            None => number(what, index, weights.iter().all(|(_, weight)| weight.is_finite())),
        };
        for (index, spring) in inputs.springs.iter().enumerate() {
            weighted("spring", index, &spring.weights)?;
            let stiff = spring.stiffness >= 0.0 && spring.stiffness.is_finite();
            number("spring", index, stiff && spring.target.iter().all(|x| x.is_finite()))?;
        }
        for (index, contact) in inputs.contacts.iter().enumerate() {
            weighted("contact", index, &contact.weights)?;
            let stiff = contact.stiffness >= 0.0 && contact.stiffness.is_finite();
            let unit = (contact.normal.norm_squared() - 1.0).abs() < 1e-6;
            number("contact", index, stiff && unit && contact.point.iter().all(|x| x.is_finite()))?;
        }
        work.held.clear();
        work.held.extend((0..nodes).map(|node| !self.moves(node)));
        for (index, (node, place)) in inputs.prescribed.iter().enumerate() {
            match work.held.get_mut(*node as usize) {
                Some(held) if !*held => *held = true,
                _ => return Err(StepError::Node { what: "prescribed node", index, node: *node, nodes }),
            }
            number("prescribed node", index, place.iter().all(|x| x.is_finite()))?;
        }
        Ok(())
    }

    /// Inertial target positions, external forces, and the initial guess: constant acceleration.
    pub(super) fn begin(&self, dt: f64, inputs: &Inputs, work: &mut Workspace) {
        let nodes = self.positions.len();
        work.aim.clear();
        work.now.clear();
        for node in 0..nodes {
            let aim = self.positions[node] + self.velocities[node] * dt;
            work.aim.push(aim);
            let free = self.moves(node);
            work.now.push(if free {
                aim + self.accelerations[node] * (dt * dt)
            } else {
                self.positions[node]
            });
        }
        inputs.prescribed.iter().for_each(|(node, place)| work.now[*node as usize] = *place);
        work.outer.clear();
        work.outer.extend(self.mass.lumped.iter().map(|mass| inputs.acceleration * *mass));
        inputs.forces.iter().for_each(|(node, force)| work.outer[*node as usize] += force);
        for buffer in [&mut work.gradient, &mut work.next, &mut work.direction, &mut work.apart] {
            buffer.resize(nodes, Vector3::zeros());
        }
        work.trial.clone_from(&work.now);
        work.before.clear();
        if self.config.stiffness_damping > 0.0 {
            frames(&self.elements, &self.positions, &mut work.before);
        }
    }

    /// Computes the factor at a state, with the couplings that fit the sparsity pattern.
    pub(super) fn refactor(
        &mut self,
        at: FactoredAt,
        inputs: &Inputs,
        rigid: &RigidResponse,
    ) -> Result<(), FactorError> {
        let mut at = at;
        if !(inputs.springs.is_empty() && inputs.contacts.is_empty() && inputs.rigid.contacts.is_empty()) {
            couplings(inputs, &at.positions, (at.dt, rigid), &mut at.couplings);
        }
        let mut hessian = std::mem::replace(&mut self.hessian, BlockMatrix::zeros(Default::default()));
        hessian.values_mut().fill(0.0);
        add_hessian(&self.element_forces(at.dt, &[]), &self.mass, &at.positions, &self.numbers, &mut hessian);
        add_couplings(&at.couplings, &self.numbers, &mut hessian);
        let mut done = self.factor.factor(hessian.pattern(), hessian.values());
        if done.is_err() {
            // Too distorted to factorise: the rest shape always works, though with slower convergence.
            at = FactoredAt { positions: self.mesh.rest().to_vec(), dt: at.dt, couplings: Vec::new() };
            hessian.values_mut().fill(0.0);
            add_hessian(
                &self.element_forces(at.dt, &[]),
                &self.mass,
                &at.positions,
                &self.numbers,
                &mut hessian,
            );
            done = self.factor.factor(hessian.pattern(), hessian.values());
        }
        self.hessian = hessian;
        self.factored_at = if done.is_ok() { at } else { FactoredAt::default() };
        self.debt = 0;
        done
    }

    /// The potential and its gradient at positions; gradients at held nodes become the reactions.
    pub(super) fn evaluate(
        &self,
        dt: f64,
        inputs: &Inputs,
        work: &mut Workspace,
        at: impl Fn(&Workspace) -> &Vec<Point3<f64>>,
    ) -> PotentialValue {
        let mut gradient = std::mem::take(&mut work.next);
        gradient.fill(Vector3::zeros());
        let mut rigid = std::mem::take(&mut work.rigid);
        let place = at(work);
        let inner = self.element_forces(dt, &work.before).add(place, &mut gradient)
            + add_springs(inputs, place, &mut gradient)
            + add_rigid(&inputs.rigid, dt, &self.positions, place, &mut rigid, &mut gradient);
        work.rigid = rigid;
        let inner_norm = dot(&gradient, &gradient).sqrt();
        let mut apart = std::mem::take(&mut work.apart);
        for (node, apart) in apart.iter_mut().enumerate() {
            *apart = (at(work)[node] - work.aim[node]) / (dt * dt);
        }
        self.mass.multiply(&apart, &mut work.product);
        let inertia = 0.5 * dt * dt * dot(&apart, &work.product);
        gradient.iter_mut().zip(&work.product).for_each(|(to, force)| *to += force);
        let mut scale = inner_norm + dot(&work.product, &work.product).sqrt();
        let mut drag = 0.0;
        if self.config.mass_damping > 0.0 {
            for (node, apart) in apart.iter_mut().enumerate() {
                *apart = (at(work)[node] - self.positions[node]) / dt;
            }
            self.mass.multiply(&apart, &mut work.product);
            let factor = self.config.mass_damping;
            drag = 0.5 * dt * factor * dot(&apart, &work.product);
            gradient.iter_mut().zip(&work.product).for_each(|(to, force)| *to += force * factor);
        }
        let mut work_done = 0.0;
        for (node, force) in work.outer.iter().enumerate() {
            gradient[node] -= force;
            work_done += force.dot(&(at(work)[node] - self.positions[node]));
        }
        scale += dot(&work.outer, &work.outer).sqrt();
        work.reactions.clear();
        for (node, held) in work.held.iter().enumerate() {
            if *held {
                work.reactions.push((node as u32, gradient[node]));
                gradient[node] = Vector3::zeros();
            }
        }
        let residual = dot(&gradient, &gradient).sqrt();
        (work.next, work.apart) = (gradient, apart);
        let magnitude = inner.abs() + inertia + drag + work_done.abs();
        PotentialValue { energy: inner + inertia + drag - work_done, magnitude, scale, residual }
    }

    /// Quasi-Newton iterations, starting from `work.now` and ending there.
    fn minimise(
        &mut self,
        dt: f64,
        inputs: &Inputs,
        work: &mut Workspace,
        report: &mut Report,
    ) -> Result<PotentialValue, StepError> {
        self.memory.forget();
        work.refused = false;
        let mut value = self.evaluate(dt, inputs, work, |work| &work.now);
        report.evaluations += 1;
        std::mem::swap(&mut work.gradient, &mut work.next);
        if !(value.residual <= GUESS * value.scale) {
            value = self.better_guess(dt, inputs, work, report, value);
        }
        let mut since_factor = 0;
        let (mut fresh, mut stuck) = (false, false);
        while !self.solved(&value) && report.iterations < self.config.iterations_max {
            if self.lent.is_some() && stuck {
                // With another factor about to be used, the L-BFGS memory is discarded.
                self.memory.forget();
                (stuck, fresh) = (false, true);
            } else if self.lent.is_none() && (stuck || since_factor >= REFACTOR_AFTER) {
                let here = FactoredAt { positions: work.now.clone(), dt, couplings: Vec::new() };
                self.refactor(here, inputs, &work.rigid)?;
                self.memory.forget();
                report.factorisations += 1;
                (since_factor, fresh, stuck) = (0, true, false);
            }
            report.iterations += 1;
            since_factor += 1;
            self.descend(work);
            let slope = dot(&work.direction, &work.gradient);
            let found = if slope < 0.0 { self.search(dt, inputs, work, report, &value, slope) } else { None };
            match found {
                Some((length, next)) => {
                    self.memory.remember(&work.direction, length, &work.gradient, &work.next);
                    std::mem::swap(&mut work.gradient, &mut work.next);
                    std::mem::swap(&mut work.now, &mut work.trial);
                    value = next;
                    fresh = false;
                }
                // No descent with this factor: try a new one; if that fails, it is rounding.
                None if fresh => break,
                None => stuck = true,
            }
        }
        if work.refused {
            // Recompute the reactions at the final iterate, not at a rejected trial.
            report.evaluations += 1;
            value = self.evaluate(dt, inputs, work, |work| &work.now);
        }
        Ok(value)
    }

    /// Moves an unsupported body by the resultant force, however large the internal residual: its momentum is conserved
    /// independently of the tolerance.
    fn balance(&self, dt: f64, work: &mut Workspace) {
        let mass: f64 = self.mass.lumped.iter().sum();
        let resists = mass * (1.0 / dt + self.config.mass_damping) / dt;
        let apart = work.gradient.iter().sum::<Vector3<f64>>() / resists;
        work.now.iter_mut().for_each(|place| *place -= apart);
    }

    /// The acceleration has changed: start at the least potential of the guess with it, the one without it, and the
    /// present position.
    fn better_guess(
        &self,
        dt: f64,
        inputs: &Inputs,
        work: &mut Workspace,
        report: &mut Report,
        value: PotentialValue,
    ) -> PotentialValue {
        let mut best = value;
        for moving in [true, false] {
            for node in 0..work.trial.len() {
                let free = self.moves(node) && moving;
                work.trial[node] = if free { work.aim[node] } else { self.positions[node] };
            }
            inputs.prescribed.iter().for_each(|(node, place)| work.trial[*node as usize] = *place);
            let other = self.evaluate(dt, inputs, work, |work| &work.trial);
            report.evaluations += 1;
            if !(best.energy <= other.energy) {
                best = other;
                std::mem::swap(&mut work.now, &mut work.trial);
                std::mem::swap(&mut work.gradient, &mut work.next);
            } else {
                work.refused = true;
            }
        }
        best
    }

    /// Whether the residual is within the tolerance, allowing for rounding.
    fn solved(&self, value: &PotentialValue) -> bool {
        value.residual <= self.config.tolerance * value.scale + self.floor
    }

    /// The descent direction: minus the approximate inverse Hessian times the gradient.
    pub(super) fn descend(&mut self, work: &mut Workspace) {
        work.direction.clone_from(&work.gradient);
        let (factor, numbers, lent) = (&mut self.factor, &self.numbers, &mut self.lent);
        let (flat, held) = (&mut work.flat, &work.held);
        self.memory.apply(&mut work.direction, |vector| {
            stale_factor::solve(factor, numbers, lent.as_mut(), flat, vector);
            vector.iter_mut().zip(held).filter(|(_, held)| **held).for_each(|(own, _)| own.fill(0.0));
        });
        work.direction.iter_mut().for_each(|direction| direction.neg_mut());
    }

    /// Line search: halves the step until the potential decreases by a fraction of its slope (Armijo) or, where that is
    /// below its rounding error, until the residual decreases.
    fn search(
        &self,
        dt: f64,
        inputs: &Inputs,
        work: &mut Workspace,
        report: &mut Report,
        value: &PotentialValue,
        slope: f64,
    ) -> Option<(f64, PotentialValue)> {
        let mut length = 1.0;
        for _ in 0..HALVINGS_MAX {
            for node in 0..work.now.len() {
                work.trial[node] = work.now[node] + work.direction[node] * length;
            }
            let next = self.evaluate(dt, inputs, work, |work| &work.trial);
            report.evaluations += 1;
            let falls = next.energy <= value.energy + 1e-4 * length * slope;
            let rounding = 1e-13 * (value.magnitude + next.magnitude) + self.rounding;
            let settles = next.energy <= value.energy + rounding && next.residual < value.residual;
            if falls || settles {
                work.refused = false;
                return Some((length, next));
            }
            length *= 0.5;
        }
        work.refused = true;
        None
    }
}
