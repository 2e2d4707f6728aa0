//! Joints of bodies in Rapier's world.

use std::collections::BTreeSet;

use nalgebra::{Isometry3, Matrix3, Point3, Vector3};
use rapier3d_f64::dynamics::{
    GenericJointBuilder, ImpulseJointHandle, JointAxesMask, RigidBodyBuilder, RigidBodyHandle,
};
use rapier3d_f64::math::SpatialVector;
use trocar_dynamics::rigid_world::BodyJoint;
use trocar_scene::components::{JointKind, JointLoad, Motion};
use trocar_scene::entity::Entity;

use super::RigidWorld;
use crate::EngineError;
use crate::conversion::{isometry_from_rapier, isometry_to_rapier};

/// Maximum number of joints.
pub const JOINTS_MAX: usize = 4096;
/// Additional solver iterations of joined bodies at least. In Rapier each is a shorter step of all bodies that hang
/// together.
const JOINT_ITERATIONS: usize = 16;

/// The joints of a world.
#[derive(Default)]
pub(super) struct WorldJoints {
    given: Vec<BodyJoint>,
    /// Of each, the joint in Rapier, if it joins anything.
    active: Vec<Option<ImpulseJointHandle>>,
    /// A body that never moves, for joints to the world.
    ground: Option<RigidBodyHandle>,
    /// Bodies with additional iterations.
    eased: BTreeSet<Entity>,
    /// Pairs that do not collide, in ascending order.
    joined: BTreeSet<(Entity, Entity)>,
}

/// A row of a joint in Rapier: its impulse, its direction, and its levers on both bodies.
#[derive(Clone, Copy)]
struct Row {
    impulse: f64,
    along: Vector3<f64>,
    levers: [Vector3<f64>; 2],
}

impl WorldJoints {
    /// Whether a joint joins these.
    pub(super) fn joins(&self, a: Entity, b: Entity) -> bool {
        !self.joined.is_empty() && self.joined.contains(&(a.min(b), a.max(b)))
    }
}

impl RigidWorld {
    /// Replaces all joints.
    ///
    /// # Errors
    /// [`EngineError::TooManyJoints`].
    pub fn set_joints(&mut self, joints: &[BodyJoint]) -> Result<(), EngineError> {
        if let Some(first) = joints.get(JOINTS_MAX) {
            return Err(EngineError::TooManyJoints {
                entity: first.body,
                joints: joints.len(),
                what: "are in the scene",
                max: JOINTS_MAX,
            });
        }
        for handle in self.joints.active.drain(..).flatten() {
            self.physics.remove_impulse_joint(handle);
        }
        for entity in std::mem::take(&mut self.joints.eased) {
            let body = self.bodies.get(&entity).and_then(|body| self.physics.bodies.get_mut(body.handle));
            if let Some(body) = body {
                body.set_additional_solver_iterations(0);
            }
        }
        self.joints.given = joints.to_vec();
        let pairs = joints.iter().filter_map(|joint| Some((joint.body, joint.other?)));
        self.joints.joined = pairs.map(|(a, b)| (a.min(b), a.max(b))).collect();
        for joint in joints {
            let active = self.insert_joint(joint);
            self.joints.active.push(active);
        }
        Ok(())
    }

    fn insert_joint(&mut self, joint: &BodyJoint) -> Option<ImpulseJointHandle> {
        let moves = |entity: Entity| self.bodies.get(&entity).map(|body| body.motion == Motion::Dynamic);
        let (own, other) = (moves(joint.body)?, joint.other.map_or(Some(false), moves)?);
        if !own && !other {
            return None;
        }
        let handle = self.bodies.get(&joint.body)?.handle;
        let to = match joint.other {
            Some(other) => self.bodies.get(&other)?.handle,
            None => {
                *self.joints.ground.get_or_insert_with(|| self.physics.insert_body(RigidBodyBuilder::fixed()))
            }
        };
        let locked = match joint.kind {
            JointKind::Ball => JointAxesMask::LIN_AXES,
            JointKind::Hinge => JointAxesMask::LIN_AXES | JointAxesMask::ANG_X | JointAxesMask::ANG_Y,
            JointKind::Fixed => JointAxesMask::LOCKED_FIXED_AXES,
        };
        let data = GenericJointBuilder::new(locked)
            .local_frame1(isometry_to_rapier(&joint.other_from_joint))
            .local_frame2(isometry_to_rapier(&joint.body_from_joint))
            .contacts_enabled(false);
        let iterations = self.joint_iterations();
        for entity in [Some(joint.body), joint.other].into_iter().flatten() {
            let body = self.bodies.get(&entity).and_then(|body| self.physics.bodies.get_mut(body.handle));
            if let Some(body) = body.filter(|body| body.is_dynamic()) {
                body.set_additional_solver_iterations(iterations);
                self.joints.eased.insert(entity);
            }
        }
        Some(self.physics.insert_impulse_joint(to, handle, data.build()))
    }

    /// Additional iterations of joined bodies: as many as any instrument has, so that all that hangs together has those.
    fn joint_iterations(&self) -> usize {
        let of_jaws = self.graspers.values().map(|grasper| {
            let instrument = grasper.instrument();
            self.settings.grasp_effort(instrument.jaw_force_max).0
        });
        of_jaws.fold(JOINT_ITERATIONS, usize::max)
    }

    /// Instruments were added or removed.
    pub(super) fn ease_joints(&mut self) {
        let iterations = self.joint_iterations();
        for entity in &self.joints.eased {
            let body = self.bodies.get(entity).and_then(|body| self.physics.bodies.get_mut(body.handle));
            if let Some(body) = body {
                body.set_additional_solver_iterations(iterations);
            }
        }
    }

    /// What each joint bore in the last step, in their order.
    pub fn joint_loads(&self, loads: &mut Vec<JointLoad>) {
        loads.clear();
        let all = self.joints.given.iter().zip(&self.joints.active);
        loads.extend(all.map(|(joint, active)| self.load(joint, *active).unwrap_or_default()));
    }

    fn load(&self, joint: &BodyJoint, active: Option<ImpulseJointHandle>) -> Option<JointLoad> {
        let found = self.physics.impulse_joints.get(active?)?;
        let frame = |body: RigidBodyHandle, frame: &Isometry3<f64>| {
            Some(isometry_from_rapier(self.physics.bodies.get(body)?.position()) * frame)
        };
        let own = frame(found.body2(), &joint.body_from_joint)?;
        let other = frame(found.body1(), &joint.other_from_joint)?;
        // The impulses are those of the last of the shorter steps.
        let shorter = self.settings.solver_iterations + self.joint_iterations();
        let step_secs = self.settings.substep_secs / shorter as f64;
        let [force, torque] = self.wrench_on_own(joint, [own, other], &found.impulses)?;
        Some(JointLoad {
            force: force / step_secs,
            torque: torque / step_secs,
            position_error: (own.translation.vector - other.translation.vector).norm(),
            angle_error: match joint.kind {
                JointKind::Ball => 0.0,
                JointKind::Hinge => {
                    let [a, b] = [own, other].map(|frame| frame.rotation * Vector3::z());
                    a.cross(&b).norm().atan2(a.dot(&b))
                }
                JointKind::Fixed => own.rotation.angle_to(&other.rotation),
            },
        })
    }

    /// The impulse and the angular impulse about the joint's point on the body of a joint. Rapier makes the rows of a joint
    /// orthogonal to each other before it solves them (modified Gram-Schmidt): its impulses belong to such rows, angular
    /// ones first.
    fn wrench_on_own(
        &self,
        joint: &BodyJoint,
        [own, other]: [Isometry3<f64>; 2],
        impulses: &SpatialVector,
    ) -> Option<[Vector3<f64>; 2]> {
        let body = |entity: Option<Entity>| {
            let known =
                entity.and_then(|entity| Some((self.pose(entity)?.isometry(), self.inertia(entity)?)));
            // A body that is not moved by forces.
            known.map_or((0.0, Matrix3::zeros(), None), |(pose, inertia)| {
                let turn = pose.rotation.to_rotation_matrix();
                let inverse = turn.matrix() * inertia.inertia_inverse_in_body * turn.matrix().transpose();
                (inertia.mass_inverse, inverse, Some(pose * inertia.centre_in_body))
            })
        };
        let (first, second) = (body(joint.other), body(Some(joint.body)));
        let point = own.translation.vector;
        let arm =
            |centre: Option<Point3<f64>>| centre.map_or_else(Vector3::zeros, |centre| point - centre.coords);
        let arms = [arm(first.2), arm(second.2)];
        let angular = match joint.kind {
            JointKind::Ball => 0,
            JointKind::Hinge => 2,
            JointKind::Fixed => 3,
        };
        let mut rows: Vec<Row> = Vec::with_capacity(6);
        for k in 0..angular {
            // The derivative of a quaternion is half of the rotation.
            let axis = other.rotation * Vector3::ith(k, 0.5);
            rows.push(Row { impulse: impulses[3 + k], along: Vector3::zeros(), levers: [axis; 2] });
        }
        for (k, impulse) in impulses.iter().enumerate().take(3) {
            let along = other.rotation * Vector3::ith(k, 1.0);
            rows.push(Row { impulse: *impulse, along, levers: arms.map(|arm| arm.cross(&along)) });
        }
        let dot = |a: &Row, b: &Row| {
            a.along.dot(&b.along) * (first.0 + second.0)
                + a.levers[0].dot(&(first.1 * b.levers[0]))
                + a.levers[1].dot(&(second.1 * b.levers[1]))
        };
        for done in 0..rows.len() {
            let row = rows[done];
            let own = dot(&row, &row);
            for later in &mut rows[done + 1..] {
                let share = if own > 0.0 { dot(later, &row) / own } else { 0.0 };
                later.along -= row.along * share;
                for (lever, of) in later.levers.iter_mut().zip(row.levers) {
                    *lever -= of * share;
                }
            }
        }
        let (mut force, mut about_centre) = (Vector3::zeros(), Vector3::zeros());
        for Row { impulse, along, levers } in &rows {
            force -= along * *impulse;
            about_centre -= levers[1] * *impulse;
        }
        let torque = if angular == 0 { Vector3::zeros() } else { about_centre - arms[1].cross(&force) };
        Some([force, torque])
    }
}
