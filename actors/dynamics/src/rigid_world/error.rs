//! Errors of a world of rigid bodies.

use thiserror::Error;
use trocar_scene::{ComponentError, ControllerError, Entity};

/// A body, an instrument or a setting that cannot be simulated.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum WorldError {
    /// A component of an entity is out of range.
    #[error("{entity}: {component}: {source}")]
    InvalidComponent {
        /// The entity.
        entity: Entity,
        /// Name of the component.
        component: &'static str,
        /// What is wrong with it.
        source: ComponentError,
    },
    /// A setting is out of range.
    #[error("setting {field} = {value} is out of range ({valid})")]
    InvalidSetting {
        /// The setting.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// A setting names an instrument that does not exist.
    #[error("contact_models_by_others: no instrument is called '{name}'; there are: {known}")]
    UnknownInstrument {
        /// The name in the setting.
        name: String,
        /// The instruments that exist.
        known: String,
    },
    /// More instruments than the world allows.
    #[error("{entity}: there are already {max} instruments, which is the limit")]
    TooManyInstruments {
        /// The rejected instrument.
        entity: Entity,
        /// The limit.
        max: usize,
    },
    /// More bodies than the world allows.
    #[error("{entity}: there are already {max} bodies, which is the limit")]
    TooManyBodies {
        /// The rejected body.
        entity: Entity,
        /// The limit.
        max: usize,
    },
    /// More joints than the world allows, or more that hang together.
    #[error("{entity}: {joints} joints {what}, and {max} are the limit")]
    TooManyJoints {
        /// A body with one of them.
        entity: Entity,
        /// How many.
        joints: usize,
        /// In all, or in one piece.
        what: &'static str,
        /// The limit.
        max: usize,
    },
    /// A dynamic body needs a closed surface.
    #[error("{entity}: its surface encloses no volume; a dynamic body needs a closed one, or a shape")]
    NoVolume {
        /// The rejected body.
        entity: Entity,
    },
    /// The entity is not in the simulation.
    #[error("{entity} is not simulated")]
    Unknown {
        /// The entity.
        entity: Entity,
    },
    /// A step would have given some bodies a non-finite pose or velocity: they keep their previous state. The world can
    /// continue without them.
    #[error(
        "a step took {} to a state that is not finite: take a shorter step, or check masses and forces",
        named(entities)
    )]
    Diverged {
        /// These bodies and instruments; empty if they are not known.
        entities: Vec<Entity>,
    },
}

impl From<WorldError> for ControllerError {
    fn from(error: WorldError) -> Self {
        match error {
            WorldError::Diverged { .. } => Self::Failed(error.to_string()),
            _ => Self::Scene(error.to_string()),
        }
    }
}

fn named(entities: &[Entity]) -> String {
    let names: Vec<String> = entities.iter().map(Entity::to_string).collect();
    if names.is_empty() { "the world".to_string() } else { names.join(", ") }
}
