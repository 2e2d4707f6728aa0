//! What a world of rigid bodies refuses.

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
    /// A setting names an instrument that there is none of.
    #[error("contact_models_by_others: no instrument is called '{name}'; there are: {known}")]
    UnknownInstrument {
        /// What it says.
        name: String,
        /// What there is.
        known: String,
    },
    /// More instruments than the world admits.
    #[error("{entity}: there are already {max} instruments, which is the limit")]
    TooManyInstruments {
        /// The instrument that was refused.
        entity: Entity,
        /// The limit.
        max: usize,
    },
    /// More bodies than the world admits.
    #[error("{entity}: there are already {max} bodies, which is the limit")]
    TooManyBodies {
        /// The body that was refused.
        entity: Entity,
        /// The limit.
        max: usize,
    },
    /// A body that falls needs an inside.
    #[error("{entity}: its surface encloses no volume; a dynamic body needs a closed one, or a shape")]
    NoVolume {
        /// The body that was refused.
        entity: Entity,
    },
    /// The entity is not in the simulation.
    #[error("{entity} is not simulated")]
    Unknown {
        /// The entity.
        entity: Entity,
    },
    /// A step would have taken some to a pose or a velocity that is not a number: they are where they were before it.
    /// Without them the world can go on.
    #[error("a step took {} to a state that is not finite", named(entities))]
    Diverged {
        /// Bodies and instruments; none where it is not known which.
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
