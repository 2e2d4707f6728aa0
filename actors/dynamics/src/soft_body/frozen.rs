//! Bodies that a restarted controller cannot rebuild.
//!
//! A body that cannot be built when a session starts is an error in the scenario: the controller is rejected with the
//! reason, and so is the session. After a restart it is a body that has become invalid, or is frozen already: it alone
//! is frozen at its state in the scene, and the others go on.

use trocar_scene::{BuildContext, Commands, ControllerError, Entity, Frozen, HeatFrozen, Measured, Tick};

/// The frozen part of a body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrozenPart {
    /// All of it.
    Body,
    /// Its temperature field; its soft-body controller decides about its motion.
    Heat,
}

/// A body that is frozen because it could not be built.
pub struct RejectedBody {
    /// The body.
    pub entity: Entity,
    name: String,
    still: FrozenPart,
    /// The reason, until it has been reported to the scene.
    untold: Option<String>,
}

impl RejectedBody {
    /// Excludes a body that could not be rebuilt after a restart.
    ///
    /// # Errors
    /// `error` itself at the first start, unless the scene has the body frozen already.
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

    /// Reports the reason to the scene once, and counts the body as frozen in every tick's measures.
    pub fn report(&mut self, tick: &Tick<'_>, measured: &mut Measured, out: &mut Commands) {
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

/// Reports that a part of a body had to be frozen.
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
