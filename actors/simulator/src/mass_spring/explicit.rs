//! Symplectic Euler: velocities from the current forces, positions from the new velocities.

use nalgebra::Vector3;
use trocar_dynamics::particles::{State, StepError};
use trocar_dynamics::soft_body::bearing::rigid_motion::{PressedNodes, RigidMotion, press, press_as_before};

use super::{Input, MassSpring, Report, TooLarge, forces, stability};

/// After how many substeps the tetrahedra that resist are found anew.
const FOUND_EVERY: u32 = 8;

/// Share of its volume at rest that a resisting tetrahedron loses in a substep at most.
const SHARE_MAX: f64 = 0.1;

impl MassSpring {
    pub(super) fn step_explicit(
        &mut self,
        dt: f64,
        input: &Input<'_>,
        too_large: TooLarge,
    ) -> Result<Report, StepError> {
        let (mobility, meeting) = (&self.scratch.mobility, &mut self.scratch.meeting);
        let (stiff, damped) = stability::of_contacts(input.contacts, mobility, meeting);
        let eigenvalue = self.bound.largest();
        let mut moving: Vec<RigidMotion> =
            input.rigid.bodies.iter().map(|body| RigidMotion::of(body, dt)).collect();
        let damping = self.config.damping + self.config.lag * eigenvalue + damped;
        let known = eigenvalue + stiff;
        let (mut done, mut since, mut safe_least) = (0, 0.0, f64::INFINITY);
        let mut found = 0;
        loop {
            let left = dt - since;
            if done >= found {
                let ahead = f64::from(FOUND_EVERY) * stability::safe_step(known, damping).min(left);
                self.scratch.resisting.find(&self.network, &self.scratch.next, ahead);
                found = done + FOUND_EVERY;
            }
            let (safe, count) = self.resist(left, done, known, damping, too_large)?;
            safe_least = safe_least.min(safe);
            let part = left / f64::from(count);
            let now = match (self.network.tets.is_empty(), self.scratch.resisting.is_empty()) {
                (true, _) => count,
                (_, true) => count.min(found - done),
                _ => 1,
            };
            for index in 0..now {
                self.explicit_part(part, since + f64::from(index) * part, input, &mut moving);
            }
            done += now;
            if now == count {
                break;
            }
            since += f64::from(now) * part;
        }
        let (parts, safe) = (done, safe_least);
        // Prescribed nodes end exactly at their target, without the rounding of the substeps.
        for (place, driven) in input.prescribed.iter().enumerate() {
            let watched = input.jaws.watched(place);
            if !watched.is_some_and(|(grip, _)| self.scratch.grips[grip].slipped) {
                self.scratch.next.positions[driven.node as usize] = driven.position;
            }
        }
        self.scratch.grips.iter_mut().for_each(|grip| grip.force /= dt);
        for force in &mut self.scratch.contact_forces {
            *force /= dt;
        }
        self.scratch.rigid.forces.iter_mut().for_each(|force| *force /= dt);
        Ok(Report { parts, safe_step: safe, iterations: 0, residual: 0.0 })
    }

    /// The largest safe step \[s\] in the present shape, and in how many parts the rest of a step is taken, `left` seconds.
    /// `known` bounds the eigenvalues of everything but squeezed tetrahedra \[1/s²\]. Where a step may not be divided so
    /// often, these resist less.
    fn resist(
        &mut self,
        left: f64,
        done: u32,
        known: f64,
        damping: f64,
        too_large: TooLarge,
    ) -> Result<(f64, u32), StepError> {
        let scratch = &mut self.scratch;
        let positions = &scratch.next.positions;
        let squeezed = scratch.resisting.largest(&self.network, &scratch.mobility, positions);
        let fastest = scratch.resisting.fastest(&self.network, &scratch.next);
        let safe = stability::safe_step(known + squeezed, damping).min(SHARE_MAX / fastest);
        if let TooLarge::Divide { most } = too_large
            && squeezed + fastest > 0.0
        {
            let most = most.saturating_sub(done).max(1);
            let bare = parts(left, stability::safe_step(known, damping), too_large)?;
            let count = (left / safe).ceil().min(f64::from(most.max(bare)));
            let part = left / count;
            // The largest eigenvalue that is stable in such parts.
            let borne = (4.0 / part - 2.0 * damping) / part - known;
            scratch.resisting.scale = if squeezed > borne { (borne / squeezed).max(0.0) } else { 1.0 };
            return Ok((safe, count as u32));
        }
        Ok((safe, parts(left, safe, too_large)?))
    }

    /// One substep; `since` is its beginning.
    fn explicit_part(&mut self, part: f64, since: f64, input: &Input<'_>, moving: &mut [RigidMotion]) {
        let scratch = &mut self.scratch;
        let (positions, velocities) = (&mut scratch.next.positions, &mut scratch.next.velocities);
        scratch.forces.fill(Vector3::zeros());
        forces::add_forces(&self.network, self.config.lag, positions, velocities, &mut scratch.forces);
        let (resisting, mobility) = (&scratch.resisting, &scratch.mobility);
        resisting.add_forces(&self.network, mobility, part, positions, &mut scratch.forces);
        for force in input.forces {
            scratch.forces[force.node as usize] += force.force;
        }
        for ((contact, began), total) in
            input.contacts.iter().zip(&scratch.touched).zip(&mut scratch.contact_forces)
        {
            let out = contact.normal.dot(&(contact.point(positions) - began - contact.velocity * since));
            let leaving = contact.normal.dot(&contact.slip(velocities));
            let force = contact.normal * contact.pressing(contact.depth - out, leaving);
            for (node, share) in contact.joint() {
                scratch.forces[node as usize] += force * share;
            }
            *total += force * part;
        }
        let damping = self.config.damping;
        for ((velocity, force), mobility) in velocities.iter_mut().zip(&scratch.forces).zip(&scratch.mobility)
        {
            if *mobility > 0.0 {
                *velocity += (force * *mobility + input.gravity - *velocity * damping) * part;
            }
        }
        if input.jaws.is_watching() {
            self.hold(part, input);
        }
        let scratch = &mut self.scratch;
        let velocities = &mut scratch.next.velocities;
        let positions = &mut scratch.next.positions;
        // Friction stops or slows a slip and never reverses it: at rest it holds against any smaller pull.
        for ((contact, began), total) in
            input.contacts.iter().zip(&scratch.touched).zip(&mut scratch.contact_forces)
        {
            let out = contact.normal.dot(&(contact.point(positions) - began - contact.velocity * since));
            let yields = contact.mobility(&scratch.mobility);
            if contact.friction == 0.0 || contact.depth <= out || yields == 0.0 {
                continue;
            }
            let slip = contact.slip(velocities);
            let slip = slip - contact.normal * contact.normal.dot(&slip);
            let speed = slip.norm();
            let pressed = contact.stiffness * (contact.depth - out) * part;
            let impulse = (speed / yields).min(contact.friction * pressed);
            if impulse > 0.0 {
                let impulse = slip * (-impulse / speed);
                for (node, share) in contact.joint() {
                    velocities[node as usize] += impulse * (share * scratch.mobility[node as usize]);
                }
                *total += impulse;
            }
        }
        let mut nodes = Moved { state: &mut scratch.next, mobility: &scratch.mobility, part };
        let (touched, forces) = (&scratch.rigid_touched, &mut scratch.rigid_pressed);
        press_as_before(input.rigid.contacts, forces, moving, &mut nodes);
        press(input.rigid.contacts, touched, forces, moving, part, &mut nodes);
        let totals = scratch.rigid.forces.iter_mut().zip(&scratch.rigid_pressed);
        totals.for_each(|(total, force)| *total += force * part);
        let (positions, velocities) = (&mut scratch.next.positions, &scratch.next.velocities);
        for (position, velocity) in positions.iter_mut().zip(velocities) {
            *position += velocity * part;
        }
        moving.iter_mut().for_each(|motion| motion.end(part));
    }
}

/// Number of equal parts of a step of `dt` seconds, when the largest safe step is `safe`.
pub(super) fn parts(dt: f64, safe: f64, too_large: TooLarge) -> Result<u32, StepError> {
    match too_large {
        _ if dt <= safe => Ok(1),
        TooLarge::Accept => Ok(1),
        TooLarge::Refuse => Err(StepError::TooLarge { step: dt, safe }),
        TooLarge::Divide { most } => {
            let parts = (dt / safe).ceil();
            if parts > f64::from(most) {
                return Err(StepError::TooManyParts { step: dt, parts, safe, most });
            }
            Ok(parts as u32)
        }
    }
}

/// The nodes between the substep's own forces and its motion.
struct Moved<'a> {
    state: &'a mut State,
    mobility: &'a [f64],
    part: f64,
}

impl PressedNodes for Moved<'_> {
    fn at_end(&self, node: u32) -> (Vector3<f64>, Vector3<f64>, f64) {
        let node = node as usize;
        let velocity = self.state.velocities[node];
        (self.state.positions[node].coords + velocity * self.part, velocity, self.mobility[node])
    }

    fn push(&mut self, node: u32, force: &Vector3<f64>) {
        let node = node as usize;
        self.state.velocities[node] += force * (self.part * self.mobility[node]);
    }
}
