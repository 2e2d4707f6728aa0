//! A hand-held instrument as dynamic bodies: the *palm* (the distal shaft) on the hand's virtual coupling, and jaws on
//! a hinge.
//!
//! The instrument is weightless, because the hand carries it, but it has inertia. Its frame is that of [`Instrument`]:
//! origin at the closed tip, +z distal, jaws opening along x.

use nalgebra::{Point3, Vector3};
use rapier3d_f64::dynamics::{
    CoefficientCombineRule, GenericJointBuilder, ImpulseJointHandle, JointAxesMask, JointAxis, MotorModel,
    RigidBodyBuilder, RigidBodyHandle,
};
use rapier3d_f64::geometry::{ColliderBuilder, ColliderHandle, InteractionGroups, SharedShape};
use rapier3d_f64::math::{Pose as RapierPose, Vector};
use rapier3d_f64::pipeline::PhysicsWorld;
use rapier3d_f64::prelude::MassProperties;
use trocar_scene::components::{Instrument, InstrumentTarget, Velocity};
use trocar_scene::entity::Entity;
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::shapes::working_end;
use trocar_scene::time::SimTime;

use trocar_dynamics::instrument::coupling::CriticallyDampedCoupling;
use trocar_dynamics::instrument::grasp::Hold;
use trocar_dynamics::instrument::set_point::SetPoint;
use trocar_dynamics::instrument::state::InstrumentState;
use trocar_dynamics::instrument::target_track::TargetTrack;

use crate::conversion::{isometry_from_rapier, isometry_to_rapier, vector_from_rapier, vector_to_rapier};
use crate::jaws::{JAW_MASS_SHARE, Jaws, jaw_count};
use crate::settings::EngineSettings;

/// Radii of gyration of an instrument about its own x, y and z \[m\]: the distal shaft and a part of the hand, which
/// also keeps the solver's mass ratios small.
pub const GYRATION: [f64; 3] = [0.03, 0.03, 0.008];
/// Length of the shaft that takes part in collisions, from the hinge backwards \[m\].
const SHAFT_REACH: f64 = 0.1;
/// Stiffness of the grasp constraint \[N/m\]: soft enough for two hands to hold one ring.
const ASSIST_STIFFNESS: f64 = 2000.0;
/// Lever arm that converts the grasp constraint's linear stiffness into an angular one \[m\].
const ASSIST_LEVER: f64 = 0.004;

/// The grasp constraint, which assists friction.
#[derive(Clone, Copy, Debug)]
struct Assist {
    joint: ImpulseJointHandle,
    body: RigidBodyHandle,
}

/// The parts of an instrument that do not turn with its jaws: shaft and end effector.
fn rigid_part(instrument: &Instrument) -> SharedShape {
    let radius = instrument.shaft_radius;
    let end = working_end(instrument);
    // Without jaws and without an end effector the rod reaches to the tip.
    let front = if jaw_count(instrument) == 0 && end.is_empty() { 0.0 } else { instrument.jaw_length };
    let reach = SHAFT_REACH.min(instrument.shaft_length - front).max(2.0 * radius);
    let (near, far) = (-front - radius, -front - reach);
    let shaft = SharedShape::capsule(
        Vector::new(0.0, 0.0, near),
        Vector::new(0.0, 0.0, far.min(near - 1e-6)),
        radius,
    );
    if end.is_empty() {
        return shaft;
    }
    let pieces = end.iter().flat_map(|rod| {
        let to_rapier = |point: &Point3<f64>| vector_to_rapier(&point.coords);
        rod.axis
            .windows(2)
            .map(move |piece| SharedShape::capsule(to_rapier(&piece[0]), to_rapier(&piece[1]), rod.radius))
    });
    let parts = std::iter::once(shaft).chain(pieces).map(|part| (RapierPose::IDENTITY, part));
    SharedShape::compound(parts.collect())
}

/// An instrument in the world.
#[derive(Clone, Debug)]
pub struct Grasper {
    entity: Entity,
    instrument: Instrument,
    coupling: CriticallyDampedCoupling,
    palm: RigidBodyHandle,
    shaft: ColliderHandle,
    jaws: Jaws,
    /// Index of its pair of collision groups.
    pub(crate) slot: u32,
    /// Target samples of the hand.
    pub(crate) track: TargetTrack,
    set_point: SetPoint,
    /// The body that it holds.
    pub(crate) hold: Option<Hold>,
    /// Normal force on each pad in the last step \[N\].
    pub(crate) pad_force: [f64; 2],
    assist: Option<Assist>,
    wrench_sum: Wrench,
    wrench_steps: u32,
}

impl Grasper {
    /// Adds the instrument's bodies to the world, with the collision groups of the palm and of the jaws.
    #[allow(clippy::too_many_arguments)] // every one of them is needed once, here
    pub(crate) fn insert(
        world: &mut PhysicsWorld,
        settings: &EngineSettings,
        entity: Entity,
        instrument: &Instrument,
        state: &InstrumentState,
        slot: u32,
        groups: [InteractionGroups; 2],
        user_data: impl Fn(Option<usize>) -> u128,
    ) -> Self {
        let gyration = Vector3::from(GYRATION);
        let palm_mass = instrument.mass * (1.0 - JAW_MASS_SHARE * jaw_count(instrument) as f64);
        let hinge = Point3::new(0.0, 0.0, -instrument.jaw_length);
        let hinge_in_world = state.tip_in_world * hinge;
        let lever = hinge_in_world.coords - state.tip_in_world.translation.vector;
        let moments = gyration.component_mul(&gyration) * palm_mass;
        let (iterations, sweeps) = settings.grasp_effort(instrument.jaw_force_max);
        let body = RigidBodyBuilder::dynamic()
            .pose(isometry_to_rapier(&state.tip_in_world))
            .linvel(vector_to_rapier(&(state.velocity.linear + state.velocity.angular.cross(&lever))))
            .angvel(vector_to_rapier(&state.velocity.angular))
            .gravity_scale(0.0)
            .can_sleep(false)
            .additional_solver_iterations(iterations)
            .additional_pgs_iterations(sweeps)
            .additional_mass_properties(MassProperties::new(
                vector_to_rapier(&hinge.coords),
                palm_mass,
                vector_to_rapier(&moments),
            ));
        let shaft = ColliderBuilder::new(rigid_part(instrument))
            .density(0.0)
            .friction(instrument.jaw_friction.min(0.2))
            .friction_combine_rule(CoefficientCombineRule::GeometricMean)
            .collision_groups(groups[0])
            .user_data(user_data(None));
        let (palm, shaft) = world.insert(body, shaft);
        let jaws = Jaws::insert(
            world,
            instrument,
            palm,
            &state.tip_in_world,
            state.velocity.linear,
            state.velocity.angular,
            state.opening,
            state.drive_reference,
            groups[1],
            settings,
            |jaw| user_data(Some(jaw)),
        );
        Self {
            entity,
            instrument: instrument.clone(),
            coupling: CriticallyDampedCoupling::new(
                instrument.mass,
                gyration,
                instrument.coupling_stiffness,
                settings.coupling_force_max,
                settings.substep_secs,
            ),
            palm,
            shaft,
            jaws,
            slot,
            track: TargetTrack::default(),
            set_point: SetPoint::default(),
            hold: None,
            pad_force: [0.0; 2],
            assist: None,
            wrench_sum: Wrench::default(),
            wrench_steps: 0,
        }
    }

    /// Removes the instrument's bodies and joints from the world.
    pub(crate) fn remove(self, world: &mut PhysicsWorld) {
        for jaw in &self.jaws.jaws {
            world.remove_body_with_colliders(jaw.body, true);
        }
        world.remove_body_with_colliders(self.palm, true);
    }

    /// The instrument's entity.
    pub fn entity(&self) -> Entity {
        self.entity
    }
    /// Its geometry and mechanism.
    pub fn instrument(&self) -> &Instrument {
        &self.instrument
    }
    /// The coupling in effect.
    pub fn coupling(&self) -> &CriticallyDampedCoupling {
        &self.coupling
    }
    /// The body that it holds by opposing contacts of both jaws.
    pub fn hold(&self) -> Option<&Hold> {
        self.hold.as_ref()
    }
    /// Normal force on the pads of jaw A and jaw B in the last step \[N\].
    pub fn pad_force(&self) -> [f64; 2] {
        self.pad_force
    }
    /// The newest target sample.
    pub fn target(&self) -> Option<&InstrumentTarget> {
        self.track.newest()
    }
    /// The target sample before the newest.
    pub fn previous_target(&self) -> Option<&InstrumentTarget> {
        self.track.previous()
    }
    pub(crate) fn palm(&self) -> RigidBodyHandle {
        self.palm
    }
    /// The colliders of the shaft and of each jaw.
    pub(crate) fn colliders(&self) -> impl Iterator<Item = (Option<usize>, ColliderHandle)> + '_ {
        let jaws = self.jaws.jaws.iter().enumerate().map(|(index, jaw)| (Some(index), jaw.collider));
        std::iter::once((None, self.shaft)).chain(jaws)
    }

    /// Pose, velocity and jaw opening.
    pub(crate) fn state(&self, world: &PhysicsWorld) -> InstrumentState {
        let body = &world.bodies[self.palm];
        let tip = body.position().translation;
        InstrumentState {
            tip_in_world: isometry_from_rapier(body.position()),
            velocity: Velocity {
                linear: vector_from_rapier(body.velocity_at_point(tip)),
                angular: vector_from_rapier(body.angvel()),
            },
            opening: self.jaws.opening(world, self.palm),
            drive_reference: self.jaws.reference(),
        }
    }

    /// Applies the coupling and the drive for the step that starts at `now`.
    pub(crate) fn prepare(&mut self, world: &mut PhysicsWorld, settings: &EngineSettings, now: SimTime) {
        let state = self.state(world);
        // Without a target the instrument is braked where it is.
        let (target, velocity) = match self.track.at(now, settings.extrapolation_secs_max) {
            Some((wanted, velocity)) => {
                self.set_point.follow(&wanted, &velocity, &state.tip_in_world, settings.substep_secs)
            }
            None => (state.tip_in_world, Velocity::default()),
        };
        let wrench = self.coupling.wrench(&target, &velocity, &state.tip_in_world, &state.velocity);
        self.wrench_sum.force += wrench.force;
        self.wrench_sum.torque += wrench.torque;
        self.wrench_steps += 1;
        if let Some(body) = world.bodies.get_mut(self.palm) {
            let tip = body.position().translation;
            body.reset_forces(false);
            body.reset_torques(false);
            body.add_force_at_point(vector_to_rapier(&wrench.force), tip, false);
            body.add_torque(vector_to_rapier(&wrench.torque), false);
        }
        let wanted = self.track.newest().map_or(state.opening.angle, |target| target.jaw_angle);
        self.jaws.drive_towards(world, state.opening, wanted, settings.jaw_rate_max, settings.substep_secs);
    }

    /// The wrench that the instrument exerts on the hand at the tip, in world axes, averaged over the steps
    /// since the last call.
    pub(crate) fn take_wrench_on_hand(&mut self) -> Wrench {
        let steps = f64::from(self.wrench_steps.max(1));
        let mean = Wrench { force: -self.wrench_sum.force / steps, torque: -self.wrench_sum.torque / steps };
        self.wrench_sum = Wrench::default();
        self.wrench_steps = 0;
        mean
    }

    /// Creates or removes the grasp constraint to match the hold, where the instrument has one. `held` is the body of
    /// the hold.
    pub(crate) fn update_assist(&mut self, world: &mut PhysicsWorld, held: Option<RigidBodyHandle>) {
        let (Some(hold), Some(body)) = (self.hold.as_mut(), held) else {
            self.release_assist(world);
            return;
        };
        let opening = self.jaws.opening(world, self.palm);
        let closing = self.jaws.squeeze(opening) > 0.0;
        if self.assist.is_some_and(|assist| assist.body != body) || !closing {
            hold.assisted = false;
            self.release_assist(world);
            return;
        }
        let palm = isometry_from_rapier(world.bodies[self.palm].position());
        let now = palm.inverse() * isometry_from_rapier(world.bodies[body].position());
        let stretch = (now.translation.vector - hold.anchor.translation.vector).norm();
        if self.assist.is_some() {
            if stretch * ASSIST_STIFFNESS > self.instrument.grasp_break_force {
                hold.assisted = false;
                hold.torn = true;
                self.release_assist(world);
            }
        } else if self.instrument.grasp_assist && !hold.torn {
            // A hold restored from a snapshot keeps its anchor; a new one is anchored at the current pose.
            if !hold.assisted {
                hold.anchor = now;
            }
            hold.assisted = true;
            let mass = world.bodies[body].mass();
            let damping = 2.0 * (ASSIST_STIFFNESS * mass).sqrt();
            let mut joint = GenericJointBuilder::new(JointAxesMask::empty())
                .local_frame1(isometry_to_rapier(&hold.anchor))
                .contacts_enabled(true);
            for axis in [JointAxis::LinX, JointAxis::LinY, JointAxis::LinZ] {
                joint = joint.motor_model(axis, MotorModel::ForceBased).motor_position(
                    axis,
                    0.0,
                    ASSIST_STIFFNESS,
                    damping,
                );
            }
            let lever = ASSIST_LEVER * ASSIST_LEVER;
            for axis in [JointAxis::AngX, JointAxis::AngY, JointAxis::AngZ] {
                joint = joint.motor_model(axis, MotorModel::ForceBased).motor_position(
                    axis,
                    0.0,
                    ASSIST_STIFFNESS * lever,
                    damping * lever,
                );
            }
            let joint = world.insert_impulse_joint(self.palm, body, joint.build());
            self.assist = Some(Assist { joint, body });
        }
    }

    fn release_assist(&mut self, world: &mut PhysicsWorld) {
        if let Some(assist) = self.assist.take() {
            world.remove_impulse_joint(assist.joint);
        }
    }
}
