//! Fulcrum (remote centre of motion) of a minimally invasive instrument: a shaft through a fixed port.
//!
//! With handle point `h`, port point `p` and shaft length `L`, the shaft direction is `u = (p − h)/|p − h|` and the tip
//! `h + L u`: moving the handle sideways swings the tip the other way by the lever ratio `(L − r)/r`, `r = |p − h|`.
//! Forces are mapped back by virtual work, with the transpose of the same map (Basdogan, De, Kim, Muniyandi, Kim &
//! Srinivasan 2004, "Haptics in minimally invasive surgical simulation and training", describe the effect).
//!
//! Roll: the handle's orientation is swung by the least rotation that brings its own z axis onto the shaft,
//! so only its roll is left. With `a` the handle's axis and `c = a·u`, the instrument's spin is
//! `ω·u = ω_handle·(a + u)/(1 + c) − (a × u)·u̇/(1 + c)`.

use nalgebra::{Isometry3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

use super::spatial::{Twist, Wrench, finite, minimal_rotation};

/// Distance between handle and port below which the lever no longer grows \[m\].
pub const RADIUS_SINGULAR: f64 = 0.005;
/// Least `1 + a·u`: bounds the spin of a handle held in reverse.
const ROLL_SINGULAR: f64 = 0.05;

/// Why a fulcrum was refused.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FulcrumError {
    /// The port's position is not finite.
    #[error("the port's position is not finite")]
    Position,
    /// The shaft has no usable length.
    #[error("shaft length {0} m is out of range (valid: 0.01 to 1 m)")]
    ShaftLength(f64),
    /// The insertion limits do not describe a range inside of the shaft.
    #[error("insertion {min} to {max} m is not a range within 0 and the shaft's {shaft_length} m")]
    Insertion {
        /// Least insertion \[m\].
        min: f64,
        /// Largest insertion \[m\].
        max: f64,
        /// Length of the shaft \[m\].
        shaft_length: f64,
    },
    /// A friction parameter is negative or not finite.
    #[error("port friction '{name}' is {value}; it must be finite and not negative")]
    Friction {
        /// Which one.
        name: &'static str,
        /// Its value.
        value: f64,
    },
}

/// Friction of the seal in the port.
///
/// Coulomb friction is smoothed as `s/√(1 + s²)`, `s = v/stick_speed`: it reaches 71 % at `stick_speed`, since a
/// sampled force that switches sign with the velocity chatters. (`tanh` is not bit-identical on every machine.)
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PortFriction {
    /// Viscous, along the shaft \[N·s/m\].
    pub axial_damping: f64,
    /// Coulomb, along the shaft \[N\].
    pub axial_coulomb: f64,
    /// Viscous, turning about the port, roll included \[N·m·s/rad\].
    pub angular_damping: f64,
    /// Speed over which the Coulomb part rises \[m/s\].
    pub stick_speed: f64,
}

impl PortFriction {
    /// A frictionless seal.
    pub const NONE: Self =
        Self { axial_damping: 0.0, axial_coulomb: 0.0, angular_damping: 0.0, stick_speed: 0.02 };
}

/// A port at a fixed point of the world, and the shaft that passes it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fulcrum {
    port_in_world: Vector3<f64>,
    shaft_length: f64,
    insertion_min: f64,
    insertion_max: f64,
    friction: PortFriction,
}

/// Pose of the shaft, and the map between handle and tip at that pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passage {
    /// `world_from_tip`.
    pub tip_in_world: Isometry3<f64>,
    /// Unit direction of the shaft, from handle to tip, in world.
    pub axis_in_world: Vector3<f64>,
    /// From the port to the tip along the shaft \[m\], within the limits.
    pub insertion: f64,
    /// How far the handle is beyond a limit \[m\]: positive when pushed too deep, negative when pulled out.
    pub excess: f64,
    /// Axial gain: 1, or 0 while a limit holds the tip.
    gain: f64,
    /// Lever: tip metres per sideways handle metre, negative (the fulcrum inverts).
    lever: f64,
    /// 1/radius, bounded \[1/m\].
    inverse_radius: f64,
    /// Handle axis + shaft axis, over `1 + c`.
    roll_row: Vector3<f64>,
    /// Handle axis × shaft axis, over `1 + c`.
    roll_swing: Vector3<f64>,
}

impl Fulcrum {
    /// A port at `port_in_world` \[m\] for a shaft of `shaft_length` \[m\]; the tip stays between the two
    /// `insertion` depths \[m\] below the port.
    ///
    /// # Errors
    /// [`FulcrumError`] names the parameter.
    pub fn new(
        port_in_world: Vector3<f64>,
        shaft_length: f64,
        insertion: [f64; 2],
        friction: PortFriction,
    ) -> Result<Self, FulcrumError> {
        if !finite(&port_in_world) {
            return Err(FulcrumError::Position);
        }
        if !(0.01..=1.0).contains(&shaft_length) {
            return Err(FulcrumError::ShaftLength(shaft_length));
        }
        let [min, max] = insertion;
        if !(0.0 <= min && min < max && max <= shaft_length) {
            return Err(FulcrumError::Insertion { min, max, shaft_length });
        }
        for (name, value) in [
            ("axial_damping", friction.axial_damping),
            ("axial_coulomb", friction.axial_coulomb),
            ("angular_damping", friction.angular_damping),
        ] {
            if !(value.is_finite() && value >= 0.0) {
                return Err(FulcrumError::Friction { name, value });
            }
        }
        if !(friction.stick_speed.is_finite() && friction.stick_speed > 0.0) {
            return Err(FulcrumError::Friction { name: "stick_speed", value: friction.stick_speed });
        }
        Ok(Self { port_in_world, shaft_length, insertion_min: min, insertion_max: max, friction })
    }

    /// The port \[m\].
    pub fn port_in_world(&self) -> &Vector3<f64> {
        &self.port_in_world
    }
    /// The same shaft through a port that moved to `port_in_world` \[m\]; a position that is not finite is
    /// ignored.
    #[must_use]
    pub fn with_port_at(mut self, port_in_world: Vector3<f64>) -> Self {
        if finite(&port_in_world) {
            self.port_in_world = port_in_world;
        }
        self
    }

    /// Passes the handle pose on to the tip.
    ///
    /// `axis_before` is the shaft's direction in the tick before. It only matters while the handle is within
    /// [`RADIUS_SINGULAR`] of the port, where the handle no longer determines the shaft's direction: the direction is
    /// then blended into `axis_before`, so the result is finite everywhere.
    pub fn pass(&self, handle_in_world: &Isometry3<f64>, axis_before: &Vector3<f64>) -> Passage {
        let to_port = self.port_in_world - handle_in_world.translation.vector;
        let radius = to_port.norm();
        let hold = (RADIUS_SINGULAR - radius).max(0.0);
        let direction = to_port + axis_before * hold;
        let length = direction.norm();
        let axis = if length > 1e-9 { direction / length } else { *axis_before };

        let depth = self.shaft_length - radius;
        let insertion = depth.clamp(self.insertion_min, self.insertion_max);
        let handle_axis = handle_in_world.rotation * Vector3::z();
        let rotation = minimal_rotation(&handle_axis, &axis) * handle_in_world.rotation;
        let roll_weight = 1.0 / (1.0 + handle_axis.dot(&axis)).max(ROLL_SINGULAR);
        let inverse_radius = 1.0 / radius.max(RADIUS_SINGULAR);
        Passage {
            tip_in_world: Isometry3::from_parts((self.port_in_world + axis * insertion).into(), rotation),
            axis_in_world: axis,
            insertion,
            excess: depth - insertion,
            gain: if depth == insertion { 1.0 } else { 0.0 },
            lever: -insertion * inverse_radius,
            inverse_radius,
            roll_row: (handle_axis + axis) * roll_weight,
            roll_swing: handle_axis.cross(&axis) * roll_weight,
        }
    }

    /// The handle pose that puts the tip at `tip_in_world`; the handle's axis lies along the shaft.
    ///
    /// The tip's direction is swung onto the line through the port (its position wins over its direction);
    /// the insertion is clamped to the limits. A tip in the port itself keeps its own direction.
    pub fn handle_for_tip(&self, tip_in_world: &Isometry3<f64>) -> Isometry3<f64> {
        let inside = tip_in_world.translation.vector - self.port_in_world;
        let depth = inside.norm();
        let tip_axis = tip_in_world.rotation * Vector3::z();
        let axis = if depth > 1e-9 { inside / depth } else { tip_axis };
        let insertion = depth.clamp(self.insertion_min, self.insertion_max);
        let handle = self.port_in_world - axis * (self.shaft_length - insertion);
        Isometry3::from_parts(handle.into(), minimal_rotation(&tip_axis, &axis) * tip_in_world.rotation)
    }

    /// Friction of the seal on the *instrument* (at the tip, in world) while the handle moves with `handle_twist`; it
    /// always dissipates.
    pub fn friction(&self, passage: &Passage, handle_twist: &Twist) -> Wrench {
        let friction = &self.friction;
        let axis = &passage.axis_in_world;
        let sliding = passage.gain * axis.dot(&handle_twist.linear);
        let relative = sliding / friction.stick_speed;
        let axial = friction.axial_damping * sliding
            + friction.axial_coulomb * relative / (1.0 + relative * relative).sqrt();
        let turning = passage.tip_twist(handle_twist).angular;
        Wrench::new(axis * -axial, turning * -friction.angular_damping)
    }
}

impl Passage {
    /// Velocity of the tip when the handle point moves with `handle_twist`; both in world.
    pub fn tip_twist(&self, handle_twist: &Twist) -> Twist {
        let axis = &self.axis_in_world;
        let along = axis.dot(&handle_twist.linear);
        let sideways = handle_twist.linear - axis * along;
        let axis_rate = sideways * -self.inverse_radius;
        let spin = handle_twist.angular.dot(&self.roll_row) - self.roll_swing.dot(&axis_rate);
        Twist::new(axis * (self.gain * along) + sideways * self.lever, axis.cross(&axis_rate) + axis * spin)
    }

    /// Wrench at the handle when `tip_wrench` acts at the tip: the transpose of [`Passage::tip_twist`], so both deliver
    /// the same power.
    pub fn handle_wrench(&self, tip_wrench: &Wrench) -> Wrench {
        let axis = &self.axis_in_world;
        let along = axis.dot(&tip_wrench.force);
        let sideways = tip_wrench.force - axis * along;
        let roll_torque = axis.dot(&tip_wrench.torque);
        let swing = tip_wrench.torque.cross(axis) * -self.inverse_radius;
        let coupled = self.roll_swing * (roll_torque * self.inverse_radius);
        Wrench::new(
            axis * (self.gain * along) + sideways * self.lever + swing + coupled,
            self.roll_row * roll_torque,
        )
    }

    /// Tip metres per sideways handle metre (negative: the fulcrum inverts the motion).
    pub fn lever(&self) -> f64 {
        self.lever
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    const PORT: Vector3<f64> = Vector3::new(-0.1, -0.09, 0.17);

    fn fulcrum(friction: PortFriction) -> Fulcrum {
        Fulcrum::new(PORT, 0.33, [0.02, 0.30], friction).unwrap()
    }
    fn vector(bound: f64) -> impl Strategy<Value = Vector3<f64>> {
        prop::array::uniform3(-bound..bound).prop_map(Vector3::from)
    }
    /// Tips in a cone below the port, with a roll.
    fn tip() -> impl Strategy<Value = Isometry3<f64>> {
        (-0.8..0.8f64, -0.8..0.8f64, 0.03..0.29f64, -3.0..3.0f64).prop_map(|(x, y, depth, roll)| {
            let axis = Vector3::new(x, y, -1.0).normalize();
            let spin = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), roll);
            Isometry3::from_parts((PORT + axis * depth).into(), minimal_rotation(&Vector3::z(), &axis) * spin)
        })
    }
    fn tilted(handle: &Isometry3<f64>, tilt: &Vector3<f64>) -> Isometry3<f64> {
        Isometry3::from_parts(handle.translation, UnitQuaternion::from_scaled_axis(*tilt) * handle.rotation)
    }

    proptest! {
        #[test]
        fn a_tip_pose_returns_through_its_handle_pose(tip in tip()) {
            let fulcrum = fulcrum(PortFriction::NONE);
            let passage = fulcrum.pass(&fulcrum.handle_for_tip(&tip), &-Vector3::z());
            prop_assert!((passage.tip_in_world.translation.vector - tip.translation.vector).norm() < 1e-12);
            prop_assert!(passage.tip_in_world.rotation.angle_to(&tip.rotation) < 1e-7);
            prop_assert_eq!(passage.excess, 0.0);
        }

        #[test]
        fn power_at_the_handle_is_power_at_the_tip(
            tip in tip(), tilt in vector(1.0), linear in vector(1.0), angular in vector(5.0),
            force in vector(5.0), torque in vector(0.2),
        ) {
            let fulcrum = fulcrum(PortFriction::NONE);
            let passage = fulcrum.pass(&tilted(&fulcrum.handle_for_tip(&tip), &tilt), &-Vector3::z());
            let (twist, wrench) = (Twist::new(linear, angular), Wrench::new(force, torque));
            let at_tip = wrench.power(&passage.tip_twist(&twist));
            let at_handle = passage.handle_wrench(&wrench).power(&twist);
            prop_assert!((at_tip - at_handle).abs() < 1e-9 * (1.0 + at_tip.abs()), "{at_tip} {at_handle}");
        }

        #[test]
        fn the_tip_twist_is_the_derivative_of_the_tip_pose(
            tip in tip(), tilt in vector(0.8), linear in vector(0.5), angular in vector(1.0),
        ) {
            let fulcrum = fulcrum(PortFriction::NONE);
            let handle = tilted(&fulcrum.handle_for_tip(&tip), &tilt);
            let passage = fulcrum.pass(&handle, &-Vector3::z());
            let dt = 1e-6;
            let moved = |sign: f64| {
                let pose = Isometry3::from_parts(
                    (handle.translation.vector + linear * dt * sign).into(),
                    UnitQuaternion::from_scaled_axis(angular * dt * sign) * handle.rotation,
                );
                fulcrum.pass(&pose, &-Vector3::z()).tip_in_world
            };
            let (before, after) = (moved(-1.0), moved(1.0));
            let twist = passage.tip_twist(&Twist::new(linear, angular));
            let numeric = (after.translation.vector - before.translation.vector) / (2.0 * dt);
            // The insertion's end stops bend the path; the clamp is tested apart.
            prop_assume!(passage.insertion > 0.021 && passage.insertion < 0.299);
            prop_assert!((numeric - twist.linear).norm() < 1e-4 * (1.0 + twist.linear.norm()));
            let turned = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * dt);
            prop_assert!((turned - twist.angular).norm() < 1e-4 * (1.0 + twist.angular.norm()));
        }

        #[test]
        fn friction_takes_exactly_the_power_that_the_hand_puts_in(
            tip in tip(), tilt in vector(1.0), linear in vector(1.0), angular in vector(5.0),
        ) {
            let seal = PortFriction {
                axial_damping: 0.5, axial_coulomb: 0.1, angular_damping: 0.001, stick_speed: 0.02,
            };
            let fulcrum = fulcrum(seal);
            let passage = fulcrum.pass(&tilted(&fulcrum.handle_for_tip(&tip), &tilt), &-Vector3::z());
            let twist = Twist::new(linear, angular);
            let on_instrument = fulcrum.friction(&passage, &twist);
            let dissipated = on_instrument.power(&passage.tip_twist(&twist));
            prop_assert!(dissipated <= 0.0);
            let at_handle = passage.handle_wrench(&on_instrument).power(&twist);
            prop_assert!((at_handle - dissipated).abs() < 1e-9 * (1.0 + dissipated.abs()));
        }

        #[test]
        fn nothing_is_infinite_near_the_port(
            offset in vector(0.01), turn in vector(3.0), linear in vector(1.0), force in vector(5.0),
        ) {
            let fulcrum = fulcrum(PortFriction::NONE);
            let handle = Isometry3::from_parts((PORT + offset).into(), UnitQuaternion::from_scaled_axis(turn));
            let passage = fulcrum.pass(&handle, &-Vector3::z());
            let twist = passage.tip_twist(&Twist::new(linear, Vector3::zeros()));
            let wrench = passage.handle_wrench(&Wrench::new(force, force * 0.1));
            prop_assert!(twist.is_finite() && wrench.is_finite());
            prop_assert!(twist.linear.norm() <= linear.norm() * (1.0 + 0.30 / RADIUS_SINGULAR));
            prop_assert!((passage.axis_in_world.norm() - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn the_fulcrum_inverts_sideways_motion_by_the_lever_ratio() {
        let fulcrum = fulcrum(PortFriction::NONE);
        let tip = Isometry3::from_parts(
            (PORT - Vector3::z() * 0.22).into(),
            UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI),
        );
        let handle = fulcrum.handle_for_tip(&tip);
        assert!((handle.translation.vector - (PORT + Vector3::z() * 0.11)).norm() < 1e-12);
        let passage = fulcrum.pass(&handle, &-Vector3::z());
        assert!((passage.lever() + 2.0).abs() < 1e-12);
        let felt = passage.handle_wrench(&Wrench::new(Vector3::x(), Vector3::zeros()));
        assert!((felt.force - Vector3::new(-2.0, 0.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn the_handle_in_the_port_keeps_the_last_direction() {
        let fulcrum = fulcrum(PortFriction::NONE);
        let before = Vector3::new(0.6, 0.0, -0.8);
        let passage = fulcrum.pass(&Isometry3::from_parts(PORT.into(), UnitQuaternion::identity()), &before);
        assert!((passage.axis_in_world - before).norm() < 1e-12);
        assert!((passage.insertion - 0.30).abs() < 1e-12);
    }

    #[test]
    fn insertion_limits_hold_the_tip_and_report_the_excess() {
        let fulcrum = Fulcrum::new(PORT, 0.33, [0.05, 0.20], PortFriction::NONE).unwrap();
        let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        let deep = Isometry3::from_parts((PORT + Vector3::z() * 0.10).into(), down);
        let passage = fulcrum.pass(&deep, &-Vector3::z());
        assert!((passage.tip_in_world.translation.vector - (PORT - Vector3::z() * 0.20)).norm() < 1e-12);
        assert!((passage.excess - 0.03).abs() < 1e-12);
        // A held tip takes no axial motion, so it also returns no axial force.
        let push = Twist::new(-Vector3::z(), Vector3::zeros());
        assert_eq!(passage.tip_twist(&push).linear.z, 0.0);
        assert!(passage.handle_wrench(&Wrench::new(Vector3::z(), Vector3::zeros())).force.z.abs() < 1e-12);
        let out = Isometry3::from_parts((PORT + Vector3::z() * 0.32).into(), down);
        assert!((fulcrum.pass(&out, &-Vector3::z()).excess + 0.04).abs() < 1e-12);
    }

    #[test]
    fn bad_parameters_are_refused_by_name() {
        let make = |length, insertion| Fulcrum::new(PORT, length, insertion, PortFriction::NONE);
        assert_eq!(make(0.0, [0.02, 0.3]), Err(FulcrumError::ShaftLength(0.0)));
        assert!(matches!(make(0.33, [0.02, 0.4]), Err(FulcrumError::Insertion { .. })));
        assert!(matches!(make(0.33, [0.2, 0.1]), Err(FulcrumError::Insertion { .. })));
        let negative = PortFriction { axial_damping: -1.0, ..PortFriction::NONE };
        let text = Fulcrum::new(PORT, 0.33, [0.0, 0.3], negative).unwrap_err().to_string();
        assert!(text.contains("axial_damping"), "{text}");
    }
}
