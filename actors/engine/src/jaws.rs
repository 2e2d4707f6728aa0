//! Jaw mechanism of a laparoscopic grasper: two jaws on one hinge, opened and closed together by one drive of limited
//! force, like the rod in the shaft.
//!
//! Each jaw turns on a revolute joint of the palm. The *drive* acts between the two jaws: a position servo on the full
//! opening, with limited torque; it also pins the jaws to each other. The *linkage* acts between each jaw and the palm: a stiff spring that keeps the jaws
//! symmetric, so that a squeezed body cannot swing both of them aside.

use nalgebra::{Isometry3, Vector3};
use rapier3d_f64::dynamics::{
    GenericJoint, GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MotorModel,
    RigidBodyBuilder, RigidBodyHandle,
};
use rapier3d_f64::geometry::{ColliderBuilder, ColliderHandle, InteractionGroups};
use rapier3d_f64::math::{Pose as RapierPose, Rotation, Vector};
use rapier3d_f64::pipeline::PhysicsWorld;
use rapier3d_f64::prelude::MassProperties;
use trocar_scene::components::Instrument;

pub use trocar_dynamics::instrument::jaw::{JAW_MASS_SHARE, SATURATION_ANGLE, jaw_count};
use trocar_dynamics::instrument::jaw::{TURNING_MOMENT, blade, drive_reference, instrument_from_jaw, side};
use trocar_dynamics::instrument::state::JawOpening;

use crate::conversion::{isometry_from_rapier, isometry_to_rapier, vector_from_rapier, vector_to_rapier};
use crate::settings::EngineSettings;

/// Stiffness of the linkage, at the tip of a jaw \[N/m\].
const LINKAGE_STIFFNESS: f64 = 3000.0;
/// Moment of inertia about the other axes, in the same units.
const GUIDED_MOMENT: f64 = 1.0;
/// One jaw.
#[derive(Clone, Copy, Debug)]
pub struct Jaw {
    /// Its body; the frame coincides with the instrument's when the jaw is closed.
    pub body: RigidBodyHandle,
    /// Its blade.
    pub collider: ColliderHandle,
    hinge: ImpulseJointHandle,
}

/// The jaws of one instrument.
#[derive(Clone, Debug)]
pub struct Jaws {
    /// Jaw A (at +x) and jaw B.
    pub jaws: Vec<Jaw>,
    drive: Option<ImpulseJointHandle>,
    /// Current set point of the drive, on its way to the target \[rad\].
    reference: f64,
    angle_max: f64,
    /// Torque limit of the drive about the hinge \[N·m\].
    torque_max: f64,
    /// Stiffness and damping of the linkage \[N·m/rad, N·m·s/rad\].
    linkage: [f64; 2],
    /// Stiffness and damping of the drive \[N·m/rad, N·m·s/rad\].
    servo: [f64; 2],
}

/// Frame of the hinge in both the palm and the jaw; Rapier's revolute axis is x, ours y.
fn hinge_frame(jaw_length: f64) -> RapierPose {
    RapierPose::from_parts(
        Vector::new(0.0, 0.0, -jaw_length),
        Rotation::from_rotation_z(std::f64::consts::FRAC_PI_2),
    )
}

impl Jaws {
    /// Adds the jaws to the world around `palm`, which is at `world_from_instrument` and moves with the given
    /// velocities (of the tip).
    #[allow(clippy::too_many_arguments)]
    pub fn insert(
        world: &mut PhysicsWorld,
        instrument: &Instrument,
        palm: RigidBodyHandle,
        world_from_instrument: &Isometry3<f64>,
        linear: Vector3<f64>,
        angular: Vector3<f64>,
        opening: JawOpening,
        reference: f64,
        groups: InteractionGroups,
        settings: &EngineSettings,
        user_data: impl Fn(usize) -> u128,
    ) -> Self {
        let (length, count) = (instrument.jaw_length, jaw_count(instrument));
        let mass = JAW_MASS_SHARE * instrument.mass;
        let (_, half) = blade(instrument, 0);
        let moments = Vector::new(GUIDED_MOMENT, TURNING_MOMENT, GUIDED_MOMENT) * (mass * length * length);
        let inertia_about_hinge = moments.y;
        let torque_max = instrument.jaw_force_max * length;
        let linkage_stiffness = LINKAGE_STIFFNESS * length * length;
        let servo_stiffness = torque_max / SATURATION_ANGLE;
        let critical = |stiffness: f64, inertia: f64| 2.0 * (stiffness * inertia).sqrt();
        let (iterations, sweeps) = settings.grasp_effort(instrument.jaw_force_max);
        let mut this = Self {
            jaws: Vec::with_capacity(count),
            drive: None,
            reference,
            angle_max: instrument.jaw_angle_max,
            torque_max,
            linkage: [linkage_stiffness, critical(linkage_stiffness, inertia_about_hinge)],
            // The relative motion of the two jaws has half the inertia of one.
            servo: [servo_stiffness, critical(servo_stiffness, inertia_about_hinge / 2.0)],
        };
        for jaw in 0..count {
            let angle = opening.tilt + side(jaw) * opening.angle / 2.0;
            let rate = opening.tilt_rate + side(jaw) * opening.rate / 2.0;
            let world_from_jaw = world_from_instrument * instrument_from_jaw(length, angle);
            let hinge_in_world = world_from_instrument * nalgebra::Point3::new(0.0, 0.0, -length);
            let spin = angular + world_from_instrument.rotation * Vector3::y() * rate;
            let hinge_velocity =
                linear + angular.cross(&(hinge_in_world.coords - world_from_instrument.translation.vector));
            let body = RigidBodyBuilder::dynamic()
                .pose(isometry_to_rapier(&world_from_jaw))
                .linvel(vector_to_rapier(&hinge_velocity))
                .angvel(vector_to_rapier(&spin))
                .gravity_scale(0.0)
                .can_sleep(false)
                .additional_solver_iterations(iterations)
                .additional_pgs_iterations(sweeps)
                .additional_mass_properties(MassProperties::new(
                    Vector::new(0.0, 0.0, -length),
                    mass,
                    moments,
                ));
            let (blade_in_jaw, _) = blade(instrument, jaw);
            let blade = ColliderBuilder::cuboid(half.x, half.y, half.z)
                .position(isometry_to_rapier(&blade_in_jaw))
                .density(0.0)
                .friction(instrument.jaw_friction)
                .friction_combine_rule(rapier3d_f64::dynamics::CoefficientCombineRule::GeometricMean)
                .collision_groups(groups)
                .user_data(user_data(jaw));
            let (body, collider) = world.insert(body, blade);
            let hinge = world.insert_impulse_joint(palm, body, this.hinge(length));
            this.jaws.push(Jaw { body, collider, hinge });
        }
        if let [a, b] = this.jaws[..] {
            // The pin of the hinge holds the jaws to each other too. What they squeeze pushes them apart with many times
            // the force that the palm bears, and by way of the palm alone the solver would take dozens of sweeps to
            // cancel the two: until then the jaws shift along each other, and carry the body's faces with them.
            let joint = GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
                .local_frame1(hinge_frame(length))
                .local_frame2(hinge_frame(length))
                .contacts_enabled(false)
                .limits(JointAxis::AngX, [0.0, this.angle_max])
                .motor_model(JointAxis::AngX, MotorModel::ForceBased)
                .motor_max_force(JointAxis::AngX, torque_max)
                .build();
            this.drive = Some(world.insert_impulse_joint(b.body, a.body, joint));
        }
        this
    }

    fn hinge(&self, length: f64) -> GenericJoint {
        GenericJointBuilder::new(JointAxesMask::LOCKED_REVOLUTE_AXES)
            .local_frame1(hinge_frame(length))
            .local_frame2(hinge_frame(length))
            .contacts_enabled(false)
            .motor_model(JointAxis::AngX, MotorModel::ForceBased)
            .build()
    }

    /// The measured opening.
    pub fn opening(&self, world: &PhysicsWorld, palm: RigidBodyHandle) -> JawOpening {
        let palm = &world.bodies[palm];
        let axis_in_world = isometry_from_rapier(palm.position()).rotation * Vector3::y();
        let turn = |jaw: &Jaw| {
            let body = &world.bodies[jaw.body];
            let relative = palm.rotation().inverse() * *body.rotation();
            // The relative rotation stays below half a revolution, so w > 0 picks the right branch.
            let sign = if relative.w < 0.0 { -1.0 } else { 1.0 };
            let angle = 2.0 * libm_atan2(sign * relative.y, sign * relative.w);
            let rate =
                (vector_from_rapier(body.angvel()) - vector_from_rapier(palm.angvel())).dot(&axis_in_world);
            (angle, rate)
        };
        match &self.jaws[..] {
            [a, b] => {
                let ((a, a_rate), (b, b_rate)) = (turn(a), turn(b));
                JawOpening {
                    angle: a - b,
                    rate: a_rate - b_rate,
                    tilt: (a + b) / 2.0,
                    tilt_rate: (a_rate + b_rate) / 2.0,
                }
            }
            [a] => {
                let (angle, rate) = turn(a);
                JawOpening { angle: 2.0 * angle, rate: 2.0 * rate, tilt: 0.0, tilt_rate: 0.0 }
            }
            _ => JawOpening::default(),
        }
    }

    /// Moves the drive's set point towards an opening of `target` \[rad\] at up to `rate_max` \[rad/s\] for the next
    /// step.
    pub fn drive_towards(
        &mut self,
        world: &mut PhysicsWorld,
        actual: JawOpening,
        target: f64,
        rate_max: f64,
        step_secs: f64,
    ) {
        let target = target.clamp(0.0, self.angle_max);
        let speed;
        (self.reference, speed) = drive_reference(self.reference, actual.angle, target, rate_max, step_secs);

        let [stiffness, damping] = self.servo;
        match (&self.jaws[..], self.drive) {
            ([a, b], Some(drive)) => {
                if let Some(joint) = world.impulse_joints.get_mut(drive, false) {
                    joint.data.set_motor(JointAxis::AngX, self.reference, speed, stiffness, damping);
                }
                let [stiffness, damping] = self.linkage;
                for (index, jaw) in [a, b].into_iter().enumerate() {
                    if let Some(joint) = world.impulse_joints.get_mut(jaw.hinge, false) {
                        let middle = side(index) * actual.angle / 2.0;
                        joint.data.set_motor(JointAxis::AngX, middle, 0.0, stiffness, damping);
                    }
                }
            }
            ([a], _) => {
                if let Some(joint) = world.impulse_joints.get_mut(a.hinge, false) {
                    // Half of the opening: twice the stiffness for the same torque.
                    joint.data.set_motor_max_force(JointAxis::AngX, self.torque_max);
                    joint.data.set_motor(
                        JointAxis::AngX,
                        self.reference / 2.0,
                        speed / 2.0,
                        2.0 * stiffness,
                        2.0 * damping,
                    );
                }
            }
            _ => {}
        }
    }

    /// Current set point of the drive \[rad\].
    pub fn reference(&self) -> f64 {
        self.reference
    }

    /// How far the drive's target lies inside the measured opening \[rad\]; positive while squeezing.
    pub fn squeeze(&self, actual: JawOpening) -> f64 {
        actual.angle - self.reference
    }
}

/// `atan2` with the same bits on every machine, unlike the platform's.
fn libm_atan2(y: f64, x: f64) -> f64 {
    nalgebra::RealField::atan2(y, x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::components::InstrumentKind;

    #[test]
    fn an_open_jaw_a_lies_at_positive_x() {
        let tip = instrument_from_jaw(0.018, 0.2) * nalgebra::Point3::origin();
        assert!((tip.x - 0.018 * 0.2f64.sin()).abs() < 1e-12);
        assert!(tip.y.abs() < 1e-15 && tip.z < 0.0);
    }

    #[test]
    fn probes_have_no_jaws() {
        let count = |kind, jaws| jaw_count(&Instrument { kind, jaws, ..Instrument::default() });
        assert_eq!(count(InstrumentKind::Probe, 2), 0);
        assert_eq!(count(InstrumentKind::Grasper, 2), 2);
        assert_eq!(count(InstrumentKind::Grasper, 1), 1);
    }
}
