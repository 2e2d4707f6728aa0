//! Backward Euler: M Δv = h f at the end of the step, linearised at the current iterate. The first iteration linearises
//! at the beginning of the step (Baraff and Witkin 1998); further ones are Newton iterations.

pub(crate) mod block_jacobi;
mod conjugate_gradients;
mod network_cholesky;
mod operator;
mod rigid_operator;
mod search;
mod warped;

use nalgebra::Vector3;
use trocar_dynamics::particles::StepError;
use trocar_dynamics::soft_body::bearing::rigid_response::{RigidPresses, RigidResponse};

use super::matrix::StepMatrix;
use super::{Config, Input, LinearSolver, MassSpring, Network, Report, forces};
use block_jacobi::NodeBlocks;
use conjugate_gradients::ConjugateGradients;
use network_cholesky::NetworkCholesky;
use operator::Operator;
use search::SEARCHES_MAX;
use warped::Warped;

/// Maximum number of repeated solutions after a change of the active contacts: without repetition, a light sheet on a
/// rod would alternately bounce off and come back.
const CHANGES_MAX: u32 = 3;

/// Data of an implicit step besides the state.
#[derive(Clone, Debug)]
pub(super) struct Implicit {
    matrix: StepMatrix,
    operator: Operator,
    solver: Solver,
    /// Right-hand side, and the unknowns: change of velocity \[m/s\].
    right: Vec<Vector3<f64>>,
    change: Vec<Vector3<f64>>,
    /// Residual at a trial.
    trial: Vec<Vector3<f64>>,
    /// Difference of the positions from those implied by the velocities.
    lead: Vec<Vector3<f64>>,
}

#[derive(Clone, Debug)]
enum Solver {
    NodeBlocks(ConjugateGradients, NodeBlocks),
    Warped(ConjugateGradients, Box<Warped>, NodeBlocks),
    Cholesky(NetworkCholesky),
}

impl Implicit {
    /// Adapts to a changed network: nothing of the former one can be reused. A new factor takes longer than a step and
    /// is computed elsewhere; until then the block Jacobi preconditioner is used.
    pub fn follow(&mut self, network: &Network) {
        self.operator.forget();
        for list in [&mut self.right, &mut self.change, &mut self.trial, &mut self.lead] {
            list.resize(network.masses.len(), Vector3::zeros());
        }
        match &mut self.solver {
            Solver::NodeBlocks(..) => {}
            Solver::Warped(_, warped, _) => **warped = Warped::default(),
            Solver::Cholesky(solver) => *solver = NetworkCholesky::new(network),
        }
    }

    pub fn new(network: &Network, solver: LinearSolver) -> Self {
        let zeros = vec![Vector3::zeros(); network.masses.len()];
        let solver = match solver {
            LinearSolver::ConjugateGradients { tolerance, iterations_max } => {
                Solver::NodeBlocks(ConjugateGradients::new(tolerance, iterations_max), NodeBlocks::default())
            }
            LinearSolver::Warped { tolerance, iterations_max } => Solver::Warped(
                ConjugateGradients::new(tolerance, iterations_max),
                Box::new(Warped::new(network)),
                NodeBlocks::default(),
            ),
            LinearSolver::Cholesky => Solver::Cholesky(NetworkCholesky::new(network)),
        };
        Self {
            matrix: StepMatrix::default(),
            operator: Operator::default(),
            solver,
            right: zeros.clone(),
            change: zeros.clone(),
            trial: zeros.clone(),
            lead: zeros,
        }
    }
}

/// Factor of the rest-state matrix of a sheet, computed in parallel to the steps as their preconditioner.
#[derive(Clone, Debug)]
pub struct SheetFactor(Box<Warped>);

impl SheetFactor {
    /// For a network built from a mesh with inverse masses `mobility` \[1/kg\] (0: held), steps of `dt` \[s\] and the
    /// damping of a configuration.
    #[must_use]
    pub fn new(network: &Network, mobility: &[f64], dt: f64, config: &Config) -> Self {
        Self(Box::new(Warped::made(network, mobility, (dt, config.lag, config.damping))))
    }
}

impl MassSpring {
    /// Continues without a factor, as after a change of the network.
    pub fn forget_factor(&mut self) {
        if let Some(Implicit { solver: Solver::Warped(_, warped, _), .. }) = self.implicit.as_deref_mut() {
            **warped = Warped::default();
        }
    }

    /// Continues with a factor of the current network; a factor with another number of nodes or springs is ignored.
    pub fn take_factor(&mut self, factor: SheetFactor) {
        let fits = factor.0.fits(&self.network);
        if let Some(Implicit { solver: Solver::Warped(_, warped, _), .. }) = self.implicit.as_deref_mut()
            && fits
        {
            *warped = factor.0;
        }
    }

    /// Number of entries of the factor used as preconditioner; 0 without one.
    #[must_use]
    pub fn factor_entries(&self) -> usize {
        match self.implicit.as_deref() {
            Some(Implicit { solver: Solver::Warped(_, warped, _), .. }) => warped.factor_entries(),
            _ => 0,
        }
    }

    pub(super) fn step_implicit(
        &mut self,
        h: f64,
        input: &Input<'_>,
        newton: u32,
    ) -> Result<Report, StepError> {
        // Taken out during the step, so that solver and state can be borrowed separately.
        let Some(mut implicit) = self.implicit.take() else { return Err(StepError::Factorisation) };
        let mut report = Report { parts: 1, safe_step: f64::INFINITY, ..Report::default() };
        let mut result = Ok(());
        let mut search = None;
        for iteration in 1.. {
            self.linearise(&mut implicit, h, input);
            let is_pressed = !(input.rigid.contacts.is_empty() && implicit.matrix.squeezed.is_empty());
            let searches = is_pressed && !self.network.tets.is_empty();
            self.prepare_solver(&mut implicit, h, input);
            result = self.solve(&mut implicit, input, &mut report);
            if result.is_err() {
                break;
            }
            self.advance(&implicit, h, input);
            if searches {
                let search = search.get_or_insert_with(|| self.begin_search(&implicit, h, input));
                self.search(search, &mut implicit, h, input);
            }
            let is_settled = self.press(&implicit, h, input);
            let (most, is_solved) = match &search {
                Some(search) => (newton + SEARCHES_MAX, search.is_solved()),
                None => (newton + CHANGES_MAX, true),
            };
            if iteration >= most || (iteration >= newton && is_settled && is_solved) {
                break;
            }
        }
        self.implicit = Some(implicit);
        result?;
        Ok(report)
    }

    /// Matrix and right-hand side at the current iterate.
    fn linearise(&mut self, implicit: &mut Implicit, h: f64, input: &Input<'_>) {
        let scratch = &mut self.scratch;
        if !input.rigid.contacts.is_empty() {
            answer_rigid(scratch, &input.rigid, h);
        }
        let (positions, velocities) = (&scratch.next.positions, &scratch.next.velocities);
        let matrix = &mut implicit.matrix;
        matrix.linearise(&self.network, h, self.config.lag, positions);
        scratch.forces.fill(Vector3::zeros());
        forces::add_all_forces(&self.network, self.config.lag, positions, velocities, &mut scratch.forces);
        for force in input.forces {
            scratch.forces[force.node as usize] += force.force;
        }

        // f(x₀ + h v) is linearised at the positions of this iteration: their difference, times h K.
        let began = &self.state.positions;
        for (((lead, velocity), position), began) in
            implicit.lead.iter_mut().zip(velocities).zip(positions).zip(began)
        {
            *lead = velocity - (position - began) / h;
        }
        matrix.contacts.clear();
        for ((contact, touched), total) in
            input.contacts.iter().zip(&scratch.touched).zip(&mut scratch.contact_forces)
        {
            let ahead: Vector3<f64> =
                contact.joint().into_iter().map(|(node, share)| implicit.lead[node as usize] * share).sum();
            let (force, [pressing, drag]) = contact.force_at_end(positions, velocities, touched, h, &ahead);
            matrix.press(contact, h, pressing, drag);
            *total = force;
            for (node, share) in contact.joint() {
                scratch.forces[node as usize] += *total * share;
            }
        }

        let pressing = input.rigid.contacts.iter().zip(&scratch.rigid.forces);
        for (contact, force) in pressing.filter(|(_, force)| **force > 0.0) {
            for (node, share) in contact.joint() {
                scratch.forces[node as usize] += contact.normal * (force * share);
            }
        }
        implicit.operator.rigid.take(&input.rigid, &scratch.rigid, h);

        let damping = self.config.damping;
        matrix.masses.clear();
        for (node, right) in implicit.right.iter_mut().enumerate() {
            let mass = self.network.masses[node];
            let (velocity, before) = (velocities[node], self.state.velocities[node]);
            *right = (before - velocity + (input.gravity - velocity * damping) * h) * mass
                + scratch.forces[node] * h;
            let held = scratch.mobility[node] == 0.0;
            matrix.masses.push(if held { 0.0 } else { mass * (1.0 + h * damping) });
        }
        // Springs only: the contacts' depth is already that at the end. Damping does not act on the lead.
        let lag = self.config.lag;
        for (spring, block) in self.network.springs.iter().zip(&matrix.springs) {
            let [a, b] = spring.nodes.map(|node| node as usize);
            let stiff = super::matrix::Block { along: block.along - h * lag * spring.stiffness, ..*block };
            let force = stiff.matrix() * (implicit.lead[b] - implicit.lead[a]);
            implicit.right[a] += force;
            implicit.right[b] -= force;
        }
        for (hinge, block) in self.network.hinges.iter().zip(&matrix.hinges) {
            let stiff = super::matrix::Block { along: block.along - h * lag * hinge.stiffness, ..*block };
            let sum: Vector3<f64> =
                (0..4).map(|at| implicit.lead[hinge.nodes[at] as usize] * hinge.weights[at]).sum();
            let force = stiff.matrix() * sum;
            for (node, weight) in hinge.nodes.into_iter().zip(hinge.weights) {
                implicit.right[node as usize] -= force * weight;
            }
        }
        for of in &matrix.squeezed {
            let all = || of.nodes.into_iter().zip(&of.along);
            let sum: f64 = all().map(|(node, along)| along.dot(&implicit.lead[node as usize])).sum();
            all().for_each(|(node, along)| implicit.right[node as usize] -= along * sum);
        }
        for (right, mass) in implicit.right.iter_mut().zip(&matrix.masses) {
            if *mass == 0.0 {
                *right = Vector3::zeros();
            }
        }
    }

    fn solve(
        &mut self,
        implicit: &mut Implicit,
        input: &Input<'_>,
        report: &mut Report,
    ) -> Result<(), StepError> {
        let Implicit { matrix, operator, solver, right, change, .. } = implicit;
        let (iterations, residual) = match solver {
            Solver::Cholesky(solver) => {
                return solver.solve(matrix, &self.network, input.contacts, &operator.rigid, right, change);
            }
            Solver::Warped(solver, warped, _) if warped.is_ready() => {
                solver.solve(&mut **warped, operator, right, change)
            }
            Solver::NodeBlocks(solver, blocks) | Solver::Warped(solver, _, blocks) => {
                solver.solve(blocks, operator, right, change)
            }
        };
        report.iterations += iterations;
        report.residual = residual;
        Ok(())
    }

    /// Updates the preconditioner to the current iterate.
    fn prepare_solver(&self, implicit: &mut Implicit, h: f64, input: &Input<'_>) {
        let Implicit { matrix, operator, solver, .. } = implicit;
        if !matches!(solver, Solver::Cholesky(_)) {
            operator.take(matrix, &self.network, input.contacts, (h, self.config.lag));
        }
        let Config { lag, damping, .. } = self.config;
        match solver {
            Solver::Cholesky(_) => {}
            Solver::NodeBlocks(_, blocks) => {
                blocks.update(matrix, &self.network, input.contacts, &operator.rigid);
            }
            Solver::Warped(_, warped, blocks) => {
                let positions = &self.scratch.next.positions;
                if !warped.update(&self.network, &self.mobility, (h, lag, damping), positions) {
                    blocks.update(matrix, &self.network, input.contacts, &operator.rigid);
                }
            }
        }
    }

    /// Velocities and positions at the end of the step for the current iterate.
    fn advance(&mut self, implicit: &Implicit, h: f64, input: &Input<'_>) {
        let scratch = &mut self.scratch;
        let next = &mut scratch.next;
        for (velocity, change) in next.velocities.iter_mut().zip(&implicit.change) {
            *velocity += change;
        }
        for ((position, began), velocity) in
            next.positions.iter_mut().zip(&self.state.positions).zip(&next.velocities)
        {
            *position = began + velocity * h;
        }
        for driven in input.prescribed {
            next.positions[driven.node as usize] = driven.position;
        }
    }

    /// Sets the contact forces to those of the linear system, which are the impulses applied. Returns whether exactly
    /// the contacts assumed active are active.
    fn press(&mut self, implicit: &Implicit, h: f64, input: &Input<'_>) -> bool {
        let scratch = &mut self.scratch;
        let mut is_settled = true;
        let acted = input.contacts.iter().zip(&implicit.matrix.contacts).zip(&scratch.touched);
        for (((contact, block), touched), total) in acted.zip(&mut scratch.contact_forces) {
            let nodes = contact.joint();
            let change: Vector3<f64> =
                nodes.iter().map(|(node, share)| implicit.change[*node as usize] * *share).sum();
            // A normal term is present where the contact was active when linearised.
            let pressed = block.along + block.all > 0.0;
            *total -= block.matrix() * change / h;
            is_settled &= if pressed {
                contact.normal.dot(total) >= 0.0
            } else {
                let now = contact.point(&scratch.next.positions);
                contact.depth <= contact.normal.dot(&(now - touched - contact.velocity * h))
            };
        }
        if !input.rigid.contacts.is_empty() {
            let mut forces = std::mem::take(&mut scratch.rigid.forces);
            implicit.operator.rigid.change(&implicit.change, h, &mut forces);
            answer_rigid(scratch, &input.rigid, h);
            let both = forces.iter().zip(&scratch.rigid.forces);
            is_settled &= both.clone().all(|(linear, now)| (*linear > 0.0) == (*now > 0.0));
            // The impulses applied are those of the linear system.
            scratch.rigid.forces = forces;
        }
        is_settled
    }
}

/// The response of the rigid bodies at the end of a step of `h` \[s\] with the current velocities.
fn answer_rigid(scratch: &mut super::Scratch, rigid: &RigidPresses<'_>, h: f64) {
    answer_to(&scratch.next.velocities, rigid, h, &mut scratch.rigid);
}

fn answer_to(velocities: &[Vector3<f64>], rigid: &RigidPresses<'_>, h: f64, response: &mut RigidResponse) {
    let moved = |index: usize| {
        let contact = &rigid.contacts[index];
        let shares = contact.joint().into_iter();
        let along = shares.map(|(node, share)| contact.normal.dot(&velocities[node as usize]) * share);
        h * along.sum::<f64>()
    };
    rigid.answer(h, moved, response);
}
