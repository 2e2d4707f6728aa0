//! Bodies that a controller cannot take up again.
//!
//! A body that cannot be built when a session starts is a mistake of whoever wrote the scenario: the controller is refused
//! with what is wrong, and so is the session. In a later life it is a body that has gone bad since, or that stands still
//! already: it alone is frozen where the scene has it, and the others go on.

use trocar_scene::{BuildContext, Commands, ControllerError, Entity, Frozen, HeatFrozen, Measured, Tick};

/// What of a body stands still.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrozenPart {
    /// All of it.
    Body,
    /// Its heat: whoever moves it says whether it moves.
    Heat,
}

/// A body that stands still because it could not be built.
pub struct Refused {
    /// Which.
    pub entity: Entity,
    name: String,
    still: FrozenPart,
    /// What is wrong with it, until the scene has been told.
    untold: Option<String>,
}

impl Refused {
    /// Takes a body that could not be built out of a later life.
    ///
    /// # Errors
    /// `error` itself in a first life, unless the scene has the body frozen already.
    pub fn of(
        context: &BuildContext<'_>,
        entity: Entity,
        still: FrozenPart,
        error: ControllerError,
    ) -> Result<Self, ControllerError> {
        let is_known = match still {
            FrozenPart::Body => context.scene.get::<Frozen>(entity).is_some(),
            FrozenPart::Heat => context.scene.get::<HeatFrozen>(entity).is_some(),
        };
        if context.epoch <= 1 && !is_known {
            return Err(error);
        }
        let untold = (!is_known).then(|| error.to_string());
        Ok(Self { entity, name: context.scene.name(entity), still, untold })
    }

    /// Tells the scene once why it stands still, and the measures always that it does.
    pub fn tell(&mut self, tick: &Tick<'_>, measured: &mut Measured, out: &mut Commands) {
        if let Some(reason) = self.untold.take() {
            freeze(self.entity, self.still, reason, tick, out);
        }
        let what = match self.still {
            FrozenPart::Body => "frozen",
            FrozenPart::Heat => "heat_frozen",
        };
        measured.values.insert(format!("{}.{what}", self.name), 1.0);
    }
}

/// Tells everybody that something of a body had to be stopped.
pub fn freeze(entity: Entity, still: FrozenPart, reason: String, tick: &Tick<'_>, out: &mut Commands) {
    let since = tick.time;
    match still {
        FrozenPart::Body => {
            out.put(entity, Frozen { reason, since });
            out.event("frozen", entity, None, since.as_secs_f64());
        }
        FrozenPart::Heat => {
            out.put(entity, HeatFrozen { reason, since });
            out.event("heat_frozen", entity, None, since.as_secs_f64());
        }
    }
}
