//! Grasp detection of instruments, and the optional constraint that assists friction.

use nalgebra::{Isometry3, Vector3};
use trocar_dynamics::instrument::grasp::{PadContact, carry_on, opposed_body};
use trocar_scene::Entity;
use trocar_scene::kinematics::spatial::Wrench;

use super::instrument::Tool;
use super::narrow_phase::ContactPoint;
use crate::rigid::RigidMass;

/// Stiffness of the grasp constraint \[N/m\]: soft enough that two hands may hold one ring.
const ASSIST_STIFFNESS: f64 = 2000.0;
/// Lever arm that converts its linear stiffness to an angular one \[m\].
const ASSIST_LEVER: f64 = 0.004;

/// Updates an instrument's grasp from the contacts of the last step of `step_secs`. `body` gives the poses of those
/// that can be lifted.
pub(super) fn update(
    tool: &mut Tool,
    entity: Entity,
    contact_points: &[ContactPoint],
    step_secs: f64,
    pads: &mut Vec<PadContact>,
    body: impl Fn(Entity) -> Option<Isometry3<f64>>,
) {
    pads.clear();
    let instrument_from_world = tool.state.tip_in_world.inverse();
    for contact_point in contact_points.iter().filter(|contact_point| !contact_point.by_others) {
        for (own, other, sign) in [(0, 1, 1.0), (1, 0, -1.0)] {
            if contact_point.sides[own].entity != entity {
                continue;
            }
            let Some(jaw) = tool.jaw_of[contact_point.sides[own].part] else { continue };
            let along = contact_point.impulse.dot(&contact_point.point.normal) / step_secs;
            let force = instrument_from_world * (contact_point.point.normal * (sign * along));
            let held = contact_point.sides[other].entity;
            match pads.iter_mut().find(|pad| pad.jaw == jaw && pad.body == held) {
                Some(pad) => pad.normal_force_in_instrument += force,
                None => pads.push(PadContact { jaw, body: held, normal_force_in_instrument: force }),
            }
        }
    }
    tool.pad_force = [0.0; 2];
    for pad in pads.iter() {
        tool.pad_force[pad.jaw] += pad.normal_force_in_instrument.norm();
    }
    // Only liftable bodies can be grasped; pegs and boards may be squeezed all the same.
    pads.retain(|pad| body(pad.body).is_some());
    tool.hold = carry_on(tool.hold, opposed_body(pads), step_secs, |held| {
        body(held).map(|pose| instrument_from_world * pose)
    });
    assist(tool, &body);
}

/// Forms, keeps or releases the grasp constraint.
fn assist(tool: &mut Tool, body: &impl Fn(Entity) -> Option<Isometry3<f64>>) {
    let squeezes = tool.is_closing();
    let Some(hold) = &mut tool.hold else { return };
    let Some(pose) = body(hold.held).filter(|_| squeezes) else {
        hold.assisted = false;
        return;
    };
    let now = tool.state.tip_in_world.inverse() * pose;
    if hold.assisted {
        let stretch = (now.translation.vector - hold.anchor.translation.vector).norm();
        if stretch * ASSIST_STIFFNESS > tool.instrument.grasp_break_force {
            hold.assisted = false;
            hold.torn = true;
        }
    } else if tool.instrument.grasp_assist && !hold.torn {
        hold.anchor = now;
        hold.assisted = true;
    }
}

/// Wrench of the grasp constraint on the held body, at its centre, and the reaction on the instrument, at its own. The
/// spring is implicit, so that it is stable for any body mass.
pub(super) fn pull(
    tool: &Tool,
    mass: &RigidMass,
    pose: &Isometry3<f64>,
    centre: &nalgebra::Point3<f64>,
    velocities: [[Vector3<f64>; 2]; 2],
    step_secs: f64,
) -> Option<[Wrench; 2]> {
    let hold = tool.hold.filter(|hold| hold.assisted)?;
    let wanted = tool.state.tip_in_world * hold.anchor;
    let [[linear, angular], [of_tool, turn_of_tool]] = velocities;
    let lever = pose.translation.vector - tool.state.tip_in_world.translation.vector;
    let slip = of_tool + turn_of_tool.cross(&lever) - linear;
    let damping = 2.0 * (ASSIST_STIFFNESS * mass.mass).sqrt();
    let soft = |inertia: f64, stiffness: f64, damping: f64| {
        1.0 / (1.0 + step_secs * (damping + step_secs * stiffness) / inertia)
    };
    let stretch = wanted.translation.vector - pose.translation.vector;
    let force = (stretch * ASSIST_STIFFNESS + slip * damping) * soft(mass.mass, ASSIST_STIFFNESS, damping);
    let square = ASSIST_LEVER * ASSIST_LEVER;
    let turn = (wanted.rotation * pose.rotation.inverse()).scaled_axis();
    let (stiff, damped) = (ASSIST_STIFFNESS * square, damping * square);
    let torque = (turn * stiff + (turn_of_tool - angular) * damped) * soft(mass.inertia.min(), stiff, damped);
    let arm = pose.translation.vector - centre.coords;
    let back = pose.translation.vector - tool.centre().coords;
    Some([
        Wrench { force, torque: torque + arm.cross(&force) },
        Wrench { force: -force, torque: -torque - back.cross(&force) },
    ])
}
