//! Hand rig: the map between device and instrument tip, built from the scene. Haptics evaluates it in every tick, and a
//! virtual trainee inverts it to find its hand pose.

use nalgebra::{Isometry3, Vector3};
use thiserror::Error;

use super::coupling::InstrumentCoupling;
use super::fulcrum::{Fulcrum, FulcrumError, PortFriction};
use super::registration::{Registration, RegistrationError};
use crate::components::{Hand, Instrument, Port};
use crate::entity::Entity;
use crate::snapshot::Snapshot;

/// Speed over which the Coulomb friction of a seal rises \[m/s\].
const STICK_SPEED: f64 = 0.02;

/// Why a hand cannot be rigged.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum HandRigError {
    /// A component that the rig needs is missing.
    #[error("entity {entity} has no '{component}'")]
    Missing {
        /// The entity.
        entity: Entity,
        /// Name of the component.
        component: &'static str,
    },
    /// The hand's registration is invalid.
    #[error("hand {entity}: {error}")]
    Registration {
        /// The hand.
        entity: Entity,
        /// Why.
        error: RegistrationError,
    },
    /// Instrument and port do not fit together.
    #[error("instrument {instrument} in port {port}: {error}")]
    Fulcrum {
        /// The instrument.
        instrument: Entity,
        /// The port.
        port: Entity,
        /// Why.
        error: FulcrumError,
    },
}

/// Device → world → instrument for one hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HandRig {
    /// Device → world.
    pub registration: Registration,
    /// Handle → tip.
    pub coupling: InstrumentCoupling,
    /// The instrument in the hand.
    pub instrument: Entity,
    /// The port that its shaft passes.
    pub port: Option<Entity>,
    /// Largest full opening of the jaws \[rad\].
    pub jaw_angle_max: f64,
}

impl HandRig {
    /// Reads [`Hand`], [`Instrument`] and [`Port`] of a snapshot.
    ///
    /// # Errors
    /// [`HandRigError`] names what is missing or does not fit.
    pub fn read(scene: &Snapshot, hand: Entity) -> Result<Self, HandRigError> {
        let missing = |entity, component| HandRigError::Missing { entity, component };
        let setup = scene.get::<Hand>(hand).ok_or(missing(hand, "hand"))?;
        let entity = setup.instrument;
        let instrument = scene.get::<Instrument>(entity).ok_or(missing(entity, "instrument"))?;
        let registration = Registration::new(setup.world_from_device.isometry(), setup.scale)
            .map_err(|error| HandRigError::Registration { entity: hand, error })?;
        let coupling = match instrument.port {
            None => InstrumentCoupling::free_shaft(instrument.shaft_length),
            Some(port_entity) => {
                let port = scene.get::<Port>(port_entity).ok_or(missing(port_entity, "port"))?;
                let friction = PortFriction {
                    axial_damping: port.axial_damping,
                    axial_coulomb: port.axial_friction,
                    angular_damping: port.angular_damping,
                    stick_speed: STICK_SPEED,
                };
                let insertion = [port.insertion_min, port.insertion_max.min(instrument.shaft_length)];
                let position = scene.world_pose(port_entity).translation.vector;
                Fulcrum::new(position, instrument.shaft_length, insertion, friction)
                    .map(InstrumentCoupling::Fulcrum)
                    .map_err(|error| HandRigError::Fulcrum { instrument: entity, port: port_entity, error })?
            }
        };
        Ok(Self {
            registration,
            coupling,
            instrument: entity,
            port: instrument.port,
            jaw_angle_max: instrument.jaw_angle_max,
        })
    }

    /// Tip pose `world_from_tip` for a handle pose `device_from_handle`. `axis_before` as in [`Fulcrum::pass`].
    pub fn tip_in_world(
        &self,
        handle_in_device: &Isometry3<f64>,
        axis_before: &Vector3<f64>,
    ) -> Isometry3<f64> {
        let handle_in_world = self.registration.pose_to_world(handle_in_device);
        *self.coupling.transmit(&handle_in_world, axis_before).tip_in_world()
    }

    /// Handle pose `device_from_handle` for a tip pose `world_from_tip`.
    pub fn handle_in_device(&self, tip_in_world: &Isometry3<f64>) -> Isometry3<f64> {
        self.registration.pose_to_device(&self.coupling.handle_for_tip(tip_in_world))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::commands::Commands;
    use crate::components::{Pose, Side};
    use crate::entity::EntityAllocator;
    use crate::registry::Registry;
    use crate::store::Store;
    use crate::time::SimTime;

    const HAND: Entity = Entity::new(0, 1, 1);
    const INSTRUMENT: Entity = Entity::new(0, 1, 2);
    const PORT: Entity = Entity::new(0, 1, 3);

    fn scene(port: Option<Entity>, shaft_length: f64) -> Snapshot {
        let registry = Registry::standard();
        let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 1));
        assert_eq!([commands.spawn(), commands.spawn(), commands.spawn()], [HAND, INSTRUMENT, PORT]);
        let hand = Hand {
            side: Side::Left,
            instrument: INSTRUMENT,
            world_from_device: Pose::at(-0.12, -0.12, 0.30),
            scale: 1.5,
        };
        commands.put(HAND, hand);
        commands.put(INSTRUMENT, Instrument { port, shaft_length, ..Instrument::default() });
        commands.put(PORT, Port::default());
        commands.put(PORT, Pose::at(-0.10, -0.09, 0.17));
        let mut store = Store::new(registry);
        store.apply(&mut commands, SimTime::ZERO);
        store.snapshot()
    }

    #[test]
    fn a_tip_returns_through_the_device() {
        for port in [Some(PORT), None] {
            let rig = HandRig::read(&scene(port, 0.33), HAND).unwrap();
            let start = Isometry3::translation(0.01, -0.02, 0.005);
            let tip = rig.tip_in_world(&start, &-Vector3::z());
            let again = rig.tip_in_world(&rig.handle_in_device(&tip), &-Vector3::z());
            assert!((again.translation.vector - tip.translation.vector).norm() < 1e-12);
            assert!(again.rotation.angle_to(&tip.rotation) < 1e-7);
        }
    }

    #[test]
    fn what_is_missing_or_does_not_fit_is_named() {
        let scene_ok = scene(Some(PORT), 0.33);
        let error = HandRig::read(&scene_ok, PORT).unwrap_err();
        assert_eq!(error, HandRigError::Missing { entity: PORT, component: "hand" });
        let error = HandRig::read(&scene(Some(HAND), 0.33), HAND).unwrap_err();
        assert_eq!(error, HandRigError::Missing { entity: HAND, component: "port" });
        let error = HandRig::read(&scene(Some(PORT), 0.015), HAND).unwrap_err();
        assert!(matches!(error, HandRigError::Fulcrum { port: PORT, .. }), "{error}");
    }
}
