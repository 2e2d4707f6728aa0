//! Errors of rigid bodies and of their steps.

use nalgebra::{Isometry3, Vector3};
use thiserror::Error;
use trocar_scene::kinematics::spatial::Wrench;

use super::{Arm, BodyJoint, ContactConfig, Joint, JointEnd, RigidContact, RigidMass, RigidState};

/// Maximum number of bodies, and of contacts in a step.
const COUNT_MAX: usize = 1_000_000;

/// Why bodies were rejected.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RigidError {
    /// Lists of different lengths, or too long.
    #[error("{masses} inertias for {states} states: as many of both, at most 1,000,000, are valid")]
    Count {
        /// Number of inertias.
        masses: usize,
        /// Number of states.
        states: usize,
    },
    /// Bodies with invalid mass, inertia or state.
    #[error(
        "bodies {0:?}: a mass and moments above 0, each moment at most the sum of the others, and finite states are valid"
    )]
    Bodies(Vec<usize>),
    /// A joint that joins nothing.
    #[error(
        "joint {joint}: finite frames and two different bodies of 0 to {bodies} - 1, or one and the world, are valid"
    )]
    Joint {
        /// The joint.
        joint: usize,
        /// Number of bodies.
        bodies: usize,
    },
    /// Joints that hang together too densely.
    #[error(
        "the joints take {products} products of blocks a step, at most {most} are valid: join fewer to one body"
    )]
    Joints {
        /// How many they take.
        products: usize,
        /// The limit.
        most: usize,
    },
    /// A parameter out of range.
    #[error("{what} of {value}: {valid} is valid")]
    Parameter {
        /// Its name.
        what: &'static str,
        /// Its value.
        value: f64,
        /// Its valid range.
        valid: &'static str,
    },
}

/// Whether a joint is one between these bodies.
pub(super) fn is_joint(joint: &BodyJoint, bodies: usize) -> bool {
    let is_body = |body: u32| (body as usize) < bodies;
    let is_finite = |frame: &Isometry3<f64>| {
        frame.translation.vector.iter().chain(frame.rotation.coords.iter()).all(|x| x.is_finite())
    };
    is_body(joint.body)
        && is_finite(&joint.body_from_joint)
        && match &joint.other {
            JointEnd::Body { body, body_from_joint } => {
                is_body(*body) && *body != joint.body && is_finite(body_from_joint)
            }
            JointEnd::World(frames) => frames.iter().all(is_finite),
        }
}

/// Why a step was rejected; the bodies are unchanged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RigidStepError {
    /// An invalid time step.
    #[error("a step of {0} s: 1e-9 to 1 s is valid")]
    Time(f64),
    /// A number of wrenches other than that of bodies.
    #[error("{found} wrenches for {bodies} bodies: one for each, or none, is valid")]
    Wrenches {
        /// Number of wrenches.
        found: usize,
        /// Number of bodies.
        bodies: usize,
    },
    /// A body that does not exist.
    #[error("contact {contact} names body {body}: 0 to {bodies} - 1 are valid")]
    NoBody {
        /// The contact.
        contact: usize,
        /// The body that it names.
        body: u32,
        /// Number of bodies.
        bodies: usize,
    },
    /// An invalid contact.
    #[error(
        "contact {0}: two bodies, finite numbers, a unit normal, friction from 0, restitution from 0 to 1 are valid"
    )]
    Contact(usize),
    /// A body whose state would become non-finite, or a non-finite force.
    #[error(
        "the state of body {body} would become non-finite: take a shorter step, or check its mass and the forces on it"
    )]
    Body {
        /// The body.
        body: usize,
    },
}

pub(super) fn is_finite(state: &RigidState) -> bool {
    let numbers = state.position.iter().chain(state.momentum.iter()).chain(state.angular_momentum.iter());
    numbers.chain(state.rotation.coords.iter()).all(|x| x.is_finite())
}

pub(super) fn check(
    masses: &[RigidMass],
    states: &[RigidState],
    gravity: &Vector3<f64>,
    config: &ContactConfig,
) -> Result<(), RigidError> {
    if masses.len() != states.len() || masses.len() > COUNT_MAX {
        return Err(RigidError::Count { masses: masses.len(), states: states.len() });
    }
    let is_mass = |mass: &RigidMass| {
        let moments = mass.inertia;
        let all = moments.sum();
        let is_valid = |x: f64| x.is_finite() && x > 0.0;
        is_valid(mass.mass) && moments.iter().all(|m| is_valid(*m) && 2.0 * m <= all * (1.0 + 1e-9))
    };
    let is_state = |state: &RigidState| is_finite(state) && (state.rotation.norm() - 1.0).abs() < 1e-6;
    let bad: Vec<usize> =
        (0..masses.len()).filter(|body| !is_mass(&masses[*body]) || !is_state(&states[*body])).collect();
    if !bad.is_empty() {
        return Err(RigidError::Bodies(bad));
    }
    let parameter = |what, value: f64, least: f64, most: f64, valid| {
        if (least..=most).contains(&value) {
            Ok(())
        } else {
            Err(RigidError::Parameter { what, value, valid })
        }
    };
    gravity.iter().try_for_each(|g| parameter("gravity", *g, -1e4, 1e4, "-10000 to 10000 m/s²"))?;
    parameter("iterations", f64::from(config.iterations), 1.0, 1e4, "1 to 10000")?;
    parameter("tolerance", config.tolerance, 0.0, 1.0, "0 to 1 m/s")?;
    parameter("correction", config.correction, 0.0, 1.0, "0 to 1")?;
    parameter("slop", config.slop, 0.0, 1.0, "0 to 1 m")?;
    parameter("rest_speed", config.rest_speed, 0.0, 1e3, "0 to 1000 m/s")
}

pub(super) fn check_step(
    dt: f64,
    wrenches: &[Wrench],
    contacts: &[RigidContact],
    states: &[RigidState],
) -> Result<(), RigidStepError> {
    if !(1e-9..=1.0).contains(&dt) {
        return Err(RigidStepError::Time(dt));
    }
    if !wrenches.is_empty() && wrenches.len() != states.len() || contacts.len() > COUNT_MAX {
        return Err(RigidStepError::Wrenches { found: wrenches.len(), bodies: states.len() });
    }
    let is_push = |wrench: &Wrench| wrench.force.iter().chain(wrench.torque.iter()).all(|x| x.is_finite());
    if let Some(body) = wrenches.iter().position(|wrench| !is_push(wrench)) {
        return Err(RigidStepError::Body { body });
    }
    for (index, contact) in contacts.iter().enumerate() {
        for body in [Some(contact.body), contact.other].into_iter().flatten() {
            if body as usize >= states.len() {
                return Err(RigidStepError::NoBody { contact: index, body, bodies: states.len() });
            }
        }
        let mut numbers = contact.point_in_world.iter().chain(contact.surface_velocity.iter());
        let is_valid = numbers.all(|x| x.is_finite())
            && (contact.normal_in_world.norm() - 1.0).abs() < 1e-6
            && contact.depth.is_finite()
            && contact.friction >= 0.0
            && contact.friction.is_finite()
            && (0.0..=1.0).contains(&contact.restitution)
            && contact.other != Some(contact.body);
        if !is_valid {
            return Err(RigidStepError::Contact(index));
        }
    }
    Ok(())
}

pub(super) fn check_arms(
    contacts: &[RigidContact],
    arms: &[[Option<Arm>; 2]],
    joints: &[Joint],
) -> Result<(), RigidStepError> {
    if !arms.is_empty() && arms.len() != contacts.len() {
        return Err(RigidStepError::Contact(arms.len().min(contacts.len())));
    }
    let is_arm = |arm: &Arm| (arm.joint as usize) < joints.len() && arm.arm.iter().all(|x| x.is_finite());
    match arms.iter().position(|arms| !arms.iter().flatten().all(is_arm)) {
        Some(contact) => Err(RigidStepError::Contact(contact)),
        None => Ok(()),
    }
}
