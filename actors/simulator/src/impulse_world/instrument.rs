//! Instruments of the impulse world: distal shaft and end effector, coupled to the hand by a spring (virtual coupling),
//! with jaws that open and close together.
//!
//! It has no weight, as the hand carries it, but it has inertia. Its frame is that of [`Instrument`]: origin at the
//! closed tip, +z distal, jaws opening along x.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::instrument::coupling::CriticallyDampedCoupling;
use trocar_dynamics::instrument::grasp::Hold;
use trocar_dynamics::instrument::jaw::{
    JAW_MASS_SHARE, SATURATION_ANGLE, TURNING_MOMENT, blade, drive_reference, instrument_from_jaw, jaw_count,
    side,
};
use trocar_dynamics::instrument::set_point::SetPoint;
use trocar_dynamics::instrument::state::{InstrumentState, JawOpening};
use trocar_dynamics::instrument::target_track::TargetTrack;
use trocar_scene::kinematics::spatial::Wrench;
use trocar_scene::shapes::working_end;
use trocar_scene::{Instrument, Primitive, SimTime, Velocity};

use super::bodies::{PoseHistory, Solid, origin, state_of};
use super::convex_parts::Part;
use super::settings::RigidSettings;
use crate::rigid::{Arm, Joint, RigidMass, RigidState};

/// Radii of gyration about its own x, y and z \[m\]: the distal shaft with a part of the hand.
const GYRATION: [f64; 3] = [0.03, 0.03, 0.008];
/// Length of the shaft with collisions, from the hinge backwards \[m\].
const SHAFT_REACH: f64 = 0.1;

/// An instrument.
#[derive(Clone, Debug)]
pub(super) struct Tool {
    pub instrument: Instrument,
    pub coupling: CriticallyDampedCoupling,
    /// Index of its body in the solver.
    pub slot: usize,
    pub mass: RigidMass,
    /// `instrument_from_principal`: its centre is at the hinge.
    pub principal: Isometry3<f64>,
    pub state: InstrumentState,
    pub solid: Solid,
    /// The jaw of each part, if any.
    pub jaw_of: Vec<Option<usize>>,
    pub joint: Option<Joint>,
    pub track: TargetTrack,
    pub set_point: SetPoint,
    pub hold: Option<Hold>,
    pub pad_force: [f64; 2],
    pub trail: PoseHistory,
    /// Wrench of the coupling in this step, about the tip.
    pub wrench: Wrench,
    wrench_sum: Wrench,
    wrench_steps: u32,
}

impl Tool {
    pub fn new(
        instrument: &Instrument,
        settings: &RigidSettings,
        slot: usize,
        state: &InstrumentState,
        hold: Option<Hold>,
    ) -> Self {
        let gyration = Vector3::from(GYRATION);
        let jaws = jaw_count(instrument);
        let end = working_end(instrument);
        let front = if jaws == 0 && end.is_empty() { 0.0 } else { instrument.jaw_length };
        let radius = instrument.shaft_radius;
        let reach = SHAFT_REACH.min(instrument.shaft_length - front).max(2.0 * radius);
        let near = -front - radius;
        let at = |z: f64| Point3::new(0.0, 0.0, z);
        let mut parts = vec![Part::segment(&at(near), &at((-front - reach).min(near - 1e-6)), radius)];
        for rod in &end {
            parts.extend(rod.axis.windows(2).map(|piece| Part::segment(&piece[0], &piece[1], rod.radius)));
        }
        let mut names = vec![Primitive::Shaft; parts.len()];
        let mut jaw_of = vec![None; parts.len()];
        for jaw in 0..jaws {
            let (pose, half) = blade(instrument, jaw);
            parts.push(Part::cuboid(pose, half));
            names.push(Primitive::Jaw(jaw as u8));
            jaw_of.push(Some(jaw));
        }
        let mut tool = Self {
            coupling: CriticallyDampedCoupling::new(
                instrument.mass,
                gyration,
                instrument.coupling_stiffness,
                settings.coupling_force_max,
                settings.substep_secs,
            ),
            slot,
            mass: RigidMass {
                mass: instrument.mass,
                inertia: gyration.component_mul(&gyration) * instrument.mass,
            },
            principal: Isometry3::translation(0.0, 0.0, -instrument.jaw_length),
            state: *state,
            solid: Solid::new(parts, names),
            jaw_of,
            joint: (jaws > 0).then(|| joint(instrument, jaws, state)),
            track: TargetTrack::default(),
            set_point: SetPoint::default(),
            hold,
            pad_force: [0.0; 2],
            trail: PoseHistory::default(),
            wrench: Wrench::default(),
            wrench_sum: Wrench::default(),
            wrench_steps: 0,
            instrument: instrument.clone(),
        };
        tool.place();
        tool
    }

    /// Its state for the solver.
    pub fn motion(&self) -> RigidState {
        state_of(&self.mass, &self.principal, &self.state.tip_in_world, &self.state.velocity)
    }

    /// Takes over the solver's state.
    pub fn follow(&mut self, state: &RigidState, joint: Option<Joint>) {
        (self.state.tip_in_world, self.state.velocity) = origin(&self.mass, state, &self.principal);
        self.joint = joint;
        if let Some(joint) = joint {
            self.state.opening = JawOpening { angle: joint.angle, rate: joint.rate, ..JawOpening::default() };
        }
        self.place();
    }

    fn place(&mut self) {
        let angle = self.state.opening.angle;
        for (index, part) in self.solid.parts.iter().enumerate() {
            let instrument_from_part = match self.jaw_of[index] {
                Some(jaw) => {
                    instrument_from_jaw(self.instrument.jaw_length, side(jaw) * angle / 2.0) * part.pose
                }
                None => part.pose,
            };
            self.solid.placed[index] = self.state.tip_in_world * instrument_from_part;
        }
        self.solid.measure();
    }

    /// Sets the targets of hand and drive for the step that starts at `now`.
    pub fn prepare(&mut self, settings: &RigidSettings, now: SimTime) {
        let state = self.state;
        // Without a hand, it is braked at its position.
        let (target, velocity) = match self.track.at(now, settings.extrapolation_secs_max) {
            Some((wanted, velocity)) => {
                self.set_point.follow(&wanted, &velocity, &state.tip_in_world, settings.substep_secs)
            }
            None => (state.tip_in_world, Velocity::default()),
        };
        self.wrench = self.coupling.wrench(&target, &velocity, &state.tip_in_world, &state.velocity);
        self.wrench_sum.force += self.wrench.force;
        self.wrench_sum.torque += self.wrench.torque;
        self.wrench_steps += 1;
        let Some(joint) = &mut self.joint else { return };
        let wanted = self.track.newest().map_or(joint.angle, |target| target.jaw_angle);
        let wanted = wanted.clamp(0.0, self.instrument.jaw_angle_max);
        let (reference, speed) = drive_reference(
            self.state.drive_reference,
            joint.angle,
            wanted,
            settings.jaw_rate_max,
            settings.substep_secs,
        );
        self.state.drive_reference = reference;
        joint.wanted = [reference, speed];
    }

    /// Its centre of mass in the solver, in world.
    pub fn centre(&self) -> Point3<f64> {
        self.state.tip_in_world * Point3::from(self.principal.translation.vector)
    }

    /// Velocity of a point of one of its parts per rate of the opening.
    pub fn arm(&self, part: usize, point: &Point3<f64>, joint: u32) -> Option<Arm> {
        let jaw = self.jaw_of[part]?;
        let axis = self.state.tip_in_world.rotation * Vector3::y();
        Some(Arm { joint, arm: axis.cross(&(point - self.centre())) * (0.5 * side(jaw)) })
    }

    /// Whether its drive squeezes.
    pub fn is_closing(&self) -> bool {
        self.joint.is_some_and(|joint| joint.angle > self.state.drive_reference)
    }

    /// Wrench on the hand at the tip, averaged over the steps since the last call.
    pub fn take_wrench_on_hand(&mut self) -> Wrench {
        let steps = f64::from(self.wrench_steps.max(1));
        let mean = Wrench { force: -self.wrench_sum.force / steps, torque: -self.wrench_sum.torque / steps };
        self.wrench_sum = Wrench::default();
        self.wrench_steps = 0;
        mean
    }
}

/// The joint of an instrument's jaws. With one moving jaw, the opening is twice its angle.
fn joint(instrument: &Instrument, jaws: usize, state: &InstrumentState) -> Joint {
    let length = instrument.jaw_length;
    let share = jaws as f64 / 2.0;
    // Each blade rotates by half of the opening.
    let inertia = share * TURNING_MOMENT * JAW_MASS_SHARE * instrument.mass * length * length / 2.0;
    let torque_max = share * instrument.jaw_force_max * length;
    let stiffness = torque_max / SATURATION_ANGLE;
    Joint {
        inertia,
        angle: state.opening.angle,
        rate: state.opening.rate,
        range: [0.0, instrument.jaw_angle_max],
        wanted: [state.drive_reference, 0.0],
        servo: [stiffness, 2.0 * (stiffness * inertia).sqrt()],
        torque_max,
        drive_impulse: 0.0,
    }
}
