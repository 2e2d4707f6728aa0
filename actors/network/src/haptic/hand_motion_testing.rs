//! Hand motion for tests: reaches, rests, contacts, grasps and tremor from a seed.
//!
//! Reaches have the profile of least jerk (Flash and Hogan, "The coordination of arm movements", 1985).
//! Between them the hand rests, free or leaning on a plane of stiffness [`STIFFNESS`]; tremor of [`TREMOR`]
//! never ends.

use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::Entity;
use trocar_scene::random::SplitMix64;

use crate::hand_sample::HandSample;

/// Of what the hand leans on [N/m].
const STIFFNESS: f64 = 300.0;
/// Height of its plane \[m\].
const PLANE: f64 = -0.02;
/// Amplitude \[m\] and frequency \[Hz\] of tremor.
const TREMOR: (f64, f64) = (3e-5, 9.0);
const STEP: f64 = 1e-3;

/// Share of a reach that is done at `s` of its time, and its derivative.
fn least_jerk(s: f64) -> (f64, f64) {
    let s = s.clamp(0.0, 1.0);
    let done = s.powi(3) * (10.0 - 15.0 * s + 6.0 * s * s);
    (done, 30.0 * s * s * (1.0 - s) * (1.0 - s))
}

/// A hand for so many milliseconds, one sample each.
pub(super) fn hand_motion(hand: u8, seed: u64, millis: usize) -> Vec<HandSample> {
    let mut random = SplitMix64::new(seed);
    let mut within = |low: f64, high: f64| low + (high - low) * random.unit();
    let mut motion = Vec::with_capacity(millis);
    let (mut place, mut turn, mut gripper) = (Vector3::zeros(), Vector3::zeros(), 0.8);
    let (mut buttons, mut grabbed) = (0, None);
    while motion.len() < millis {
        let goal = Vector3::new(within(-0.08, 0.08), within(-0.08, 0.08), within(-0.03, 0.05));
        let turned = Vector3::new(within(-0.6, 0.6), 0.0, 0.0);
        let opened = if within(0.0, 1.0) < 0.5 { gripper } else { within(0.05, 0.8) };
        let (reach, rest) = (within(0.5, 1.2), within(0.3, 1.0));
        let ticks = ((reach + rest) / STEP) as usize;
        for tick in 0..ticks {
            let time = motion.len() as f64 * STEP;
            let (done, speed) = least_jerk(tick as f64 * STEP / reach);
            let speed = speed / reach;
            let phase = std::f64::consts::TAU * TREMOR.1 * time;
            let omega = std::f64::consts::TAU * TREMOR.1;
            let (swing, swung) = (TREMOR.0 * phase.sin(), TREMOR.0 * omega * phase.cos());
            let mut sample = HandSample::unknown(hand);
            let position = place + (goal - place) * done + Vector3::repeat(swing);
            let rotation = UnitQuaternion::from_scaled_axis(turn + (turned - turn) * done);
            sample.state.connected = true;
            sample.state.pose_in_device = Isometry3::from_parts(position.into(), rotation);
            sample.state.linear_velocity = (goal - place) * speed + Vector3::repeat(swung);
            sample.state.angular_velocity = (turned - turn) * speed;
            sample.state.gripper = gripper + (opened - gripper) * done;
            sample.wrench.force.z = STIFFNESS * (PLANE - position.z).max(0.0);
            (sample.state.buttons, sample.grabbed) = (buttons, grabbed);
            motion.push(sample);
        }
        (place, turn, gripper) = (goal, turned, opened);
        buttons = u32::from(within(0.0, 1.0) < 0.3);
        grabbed = (gripper < 0.3).then_some((Entity::from_bits(7), 3));
    }
    motion.truncate(millis);
    motion
}
