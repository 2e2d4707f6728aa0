//! Instruments whose contacts another controller models: haptics render that model, and the instrument is constrained
//! by its planes, so that it does not sink into tissue that the rigid world does not contain.

use trocar_scene::access::{Access, EntitySet};
use trocar_scene::component::Component;
use trocar_scene::components::{Instrument, InstrumentTarget, LocalContactModel, Name};
use trocar_scene::entity::Entity;
use trocar_scene::snapshot::Snapshot;

use crate::rigid_world::WorldError;

/// Projection sweeps over the planes: each moves the target closer to the feasible region.
const SWEEPS: usize = 16;

/// The instruments of these names, sorted.
///
/// # Errors
/// [`WorldError::UnknownInstrument`].
pub fn modelled_by_others(scene: &Snapshot, names: &[String]) -> Result<Vec<Entity>, WorldError> {
    let is_instrument = |entity: &Entity| scene.get::<Instrument>(*entity).is_some();
    let mut found = Vec::with_capacity(names.len());
    for name in names {
        let Some(entity) = scene.find(name).filter(is_instrument) else {
            let known = scene.iter::<Name>().filter(|(entity, _)| is_instrument(entity));
            let known: Vec<&str> = known.map(|(_, name)| name.0.as_str()).collect();
            return Err(WorldError::UnknownInstrument { name: name.clone(), known: known.join(", ") });
        };
        found.push(entity);
    }
    found.sort_unstable();
    found.dedup();
    Ok(found)
}

/// Whether the rigid world itself writes an instrument's contact model. Where others model some instruments,
/// instruments spawned later have none.
pub fn is_modelled(access: &Access, instrument: Entity) -> bool {
    let declared = access.writes.iter().find(|(name, _)| *name == LocalContactModel::NAME);
    match declared {
        Some((_, EntitySet::Of(instruments))) => instruments.contains(&instrument),
        _ => true,
    }
}

/// Projects a target onto the half-spaces above all planes of a model: the nearest feasible point, if there is one
/// (cyclic projections; Bregman, 1965). The velocity into an active plane is zero.
pub fn held_by(model: &LocalContactModel, target: &InstrumentTarget) -> InstrumentTarget {
    let mut held = *target;
    for _ in 0..SWEEPS {
        let mut moved = false;
        for plane in model.planes.iter().flatten() {
            let normal = plane.normal_in_world;
            let below = normal.dot(&(plane.point_in_world.coords - held.tip_in_world.translation));
            if below > 0.0 {
                held.tip_in_world.translation += normal * below;
                let sinking = normal.dot(&held.velocity_in_world.linear).min(0.0);
                held.velocity_in_world.linear -= normal * sinking;
                moved |= below > 1e-9;
            }
        }
        if !moved {
            break;
        }
    }
    held
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Vector3};
    use trocar_scene::components::{ContactPlane, Pose};

    use super::*;

    #[test]
    fn a_target_is_held_above_all_planes_and_free_where_there_are_none() {
        let mut target =
            InstrumentTarget { tip_in_world: Pose::at(0.001, 0.0, -0.003), ..InstrumentTarget::default() };
        target.velocity_in_world.linear = Vector3::new(0.1, 0.0, -0.2);
        let mut model = LocalContactModel::default();
        assert_eq!(held_by(&model, &target), target);
        let plane = |normal: Vector3<f64>| ContactPlane {
            point_in_world: Point3::origin(),
            normal_in_world: normal.normalize(),
            stiffness: 100.0,
            damping: 0.0,
            friction: 0.0,
        };
        model.planes[0] = Some(plane(Vector3::z()));
        let held = held_by(&model, &target);
        assert_eq!(held.tip_in_world.translation, Vector3::new(0.001, 0.0, 0.0));
        assert_eq!(held.velocity_in_world.linear, Vector3::new(0.1, 0.0, 0.0));
        // A groove: only points above its bottom line are above both planes.
        let sides = [Vector3::new(1.0, 0.0, 1.0), Vector3::new(-1.0, 0.0, 1.0)];
        for (slot, side) in model.planes.iter_mut().zip(sides) {
            *slot = Some(plane(side));
        }
        let held = held_by(&model, &target);
        for side in sides {
            assert!(held.tip_in_world.translation.dot(&side) > -1e-8, "{held:?}");
        }
        assert!(held.tip_in_world.translation.norm() < 1e-8, "{held:?}");
    }
}
