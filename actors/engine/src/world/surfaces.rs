//! Bodies with a surface mesh, whose contacts external detectors find.

use std::collections::BTreeMap;

use nalgebra::{ComplexField, Matrix3, Point3};
use rapier3d_f64::dynamics::RigidBodyHandle;
use trocar_scene::components::{Collision, Motion, Pose, RigidBody, Velocity};
use trocar_scene::entity::Entity;
use trocar_scene::kinematics::spatial::Wrench;

use trocar_dynamics::rigid_world::{Inertia, mass_properties};

use super::{Body, RigidWorld};
use crate::conversion::{point_from_rapier, pose_to_rapier, rotation_from_rapier, vector_to_rapier};
use crate::penalty::{self, KnownEntity, PenaltyParams, PoseHistory};
use crate::{EngineError, shapes};

impl RigidWorld {
    /// Adds a body with a surface mesh; replaces the entity's previous one. Its mass properties are those of the
    /// enclosed volume. It has no colliders: detectors find its contacts ([`Self::set_penalties`]).
    ///
    /// # Errors
    /// A component that is out of range, a dynamic body whose surface encloses nothing, or
    /// [`EngineError::TooManyBodies`].
    pub fn insert_surface_body(
        &mut self,
        entity: Entity,
        body: &RigidBody,
        (vertices, triangles): (&[Point3<f64>], &[[u32; 3]]),
        pose: &Pose,
        velocity: &Velocity,
    ) -> Result<(), EngineError> {
        let solid = match (mass_properties::enclosed(vertices, triangles), body.motion) {
            (Some(solid), _) => shapes::solid_properties(&solid, body.mass),
            (None, Motion::Dynamic) => return Err(EngineError::NoVolume { entity }),
            (None, _) => Default::default(),
        };
        let handle = self.insert_rigid(entity, body, solid, pose, velocity)?;
        if let Some(rigid) = self.physics.bodies.get_mut(handle) {
            // It may rest on detected contacts, which vanish without an event; so it never sleeps.
            rigid.activation_mut().normalized_linear_threshold = -1.0;
        }
        let mut trail = PoseHistory::default();
        trail.push(self.now, pose_to_rapier(pose));
        let (motion, friction) = (body.motion, body.friction);
        let (colliders, travel, trail, push) = (Vec::new(), None, Some(trail), Wrench::default());
        self.bodies.insert(entity, Body { handle, colliders, motion, travel, trail, friction, push });
        Ok(())
    }

    /// Replaces all detected contacts between bodies of which at least one is a surface mesh
    /// ([`Self::insert_surface_body`]). They act until the next call. Only the
    /// [`PENALTIES_MAX`](penalty::PENALTIES_MAX) deepest ones act.
    pub fn set_penalties<'a>(&mut self, found: impl IntoIterator<Item = &'a Collision>) {
        let is_surface = |entity: &Entity| self.bodies.get(entity).is_some_and(|body| body.trail.is_some());
        let mut found: Vec<&Collision> = found
            .into_iter()
            .filter(|found| is_surface(&found.a) || is_surface(&found.b))
            .filter(|found| !self.joints.joins(found.a, found.b))
            .collect();
        if found.len() > penalty::PENALTIES_MAX {
            found.sort_by(|a, b| b.depth.total_cmp(&a.depth));
            found.truncate(penalty::PENALTIES_MAX);
        }
        let mut pairs: BTreeMap<(Entity, Entity), u32> = BTreeMap::new();
        for contact in &found {
            *pairs.entry((contact.a, contact.b)).or_default() += 1;
        }
        let friction = |entity: Entity| self.bodies.get(&entity).map(|body| body.friction);
        let known = |entity: Entity| match (self.bodies.get(&entity), self.graspers.get(&entity)) {
            (Some(body), _) => KnownEntity::Body(body.handle, body.trail.as_ref()),
            (None, Some(grasper)) => KnownEntity::Body(grasper.palm(), self.tools.get(&entity)),
            (None, None) => KnownEntity::Fixed,
        };
        self.penalties.clear();
        for contact in &found {
            // Mixed as Rapier does; a body without friction uses the other's.
            let friction = match (friction(contact.a), friction(contact.b)) {
                (Some(a), Some(b)) => ComplexField::sqrt(a * b),
                (one, other) => one.or(other).unwrap_or_default(),
            };
            let stiffness = self.settings.penalty_stiffness;
            let sharing = f64::from(pairs[&(contact.a, contact.b)]);
            let terms = PenaltyParams { stiffness, friction, sharing };
            self.penalties.add(contact, &self.physics.bodies, known, &terms);
        }
    }

    /// Applies the detected contacts to the bodies for the next step.
    pub(super) fn press_surfaces(&mut self) {
        let step_secs = self.settings.substep_secs;
        for body in self.bodies.values().filter(|body| body.trail.is_some()) {
            if let Some(rigid) = self.physics.bodies.get_mut(body.handle) {
                rigid.reset_forces(false);
                rigid.reset_torques(false);
            }
        }
        self.penalties.press(&mut self.physics.bodies, self.physics.gravity, step_secs);
    }

    /// Applies a constant wrench to a body from the next step on, until the next call: force \[N\], and torque about
    /// its centre of mass \[N·m\].
    ///
    /// # Errors
    /// [`EngineError::Unknown`]; a non-finite force.
    pub fn push(&mut self, entity: Entity, push: &Wrench) -> Result<(), EngineError> {
        let body = self.bodies.get_mut(&entity).ok_or(EngineError::Unknown { entity })?;
        if !push.force.iter().chain(push.torque.iter()).all(|x| x.is_finite()) {
            return Err(EngineError::Diverged { entities: vec![entity] });
        }
        body.push = *push;
        Ok(())
    }

    /// Mass and inertia of a body as seen by contacts; `None` for an immovable or unknown body.
    pub fn inertia(&self, entity: Entity) -> Option<Inertia> {
        let body = self.bodies.get(&entity).filter(|body| body.motion == Motion::Dynamic)?;
        let properties = &self.physics.bodies.get(body.handle)?.mass_properties().local_mprops;
        if properties.inv_mass <= 0.0 {
            // Rapier computes its mass in its first step.
            return None;
        }
        let turn = rotation_from_rapier(properties.principal_inertia_local_frame).to_rotation_matrix();
        let inverse = properties.inv_principal_inertia;
        let inverse = Matrix3::from_diagonal(&nalgebra::Vector3::new(inverse.x, inverse.y, inverse.z));
        Some(Inertia {
            mass_inverse: properties.inv_mass,
            centre_in_body: point_from_rapier(properties.local_com),
            inertia_inverse_in_body: turn.matrix() * inverse * turn.matrix().transpose(),
        })
    }

    /// Applies the external wrenches for the next step.
    pub(super) fn press_pushed(&mut self) {
        for body in self.bodies.values().filter(|body| body.push != Wrench::default()) {
            let Some(rigid) = self.physics.bodies.get_mut(body.handle) else { continue };
            let force = vector_to_rapier(&body.push.force);
            let torque = vector_to_rapier(&body.push.torque);
            rigid.add_force(force, true);
            rigid.add_torque(torque, true);
        }
    }

    /// Removes the external wrenches; detected contacts are evaluated anew in every step.
    pub(super) fn release_pushed(&mut self) {
        let pushed = |body: &&Body| body.push != Wrench::default() && body.trail.is_none();
        for body in self.bodies.values().filter(pushed) {
            if let Some(rigid) = self.physics.bodies.get_mut(body.handle) {
                rigid.reset_forces(false);
                rigid.reset_torques(false);
            }
        }
    }

    /// Whether external detectors find contacts of any of its bodies.
    pub fn has_surfaces(&self) -> bool {
        self.bodies.values().any(|body| body.trail.is_some())
    }

    /// Records the poses of all bodies that take part in detected contacts.
    pub(super) fn leave_trails(&mut self) {
        let (now, bodies) = (self.now, &self.physics.bodies);
        let mut surfaces = false;
        for body in self.bodies.values_mut() {
            if let (Some(trail), Some(rigid)) = (&mut body.trail, bodies.get(body.handle)) {
                trail.push(now, *rigid.position());
                surfaces = true;
            }
        }
        if !surfaces {
            return;
        }
        for (entity, grasper) in &self.graspers {
            if let Some(palm) = bodies.get(grasper.palm()) {
                self.tools.entry(*entity).or_default().push(now, *palm.position());
            }
        }
    }

    /// Drops the contacts of a body that was removed.
    pub(super) fn forget(&mut self, handle: RigidBodyHandle) {
        self.penalties.forget(handle);
    }
}
