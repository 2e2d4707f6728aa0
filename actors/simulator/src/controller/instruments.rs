//! Controller of kinematic instruments: they follow their hands; tissue yields and pushes back.
//!
//! For scenes without a rigid world that simulates instruments. The simulators report contact forces in the collision
//! list; this controller sums them into the force on the instrument, and into the plane that haptics evaluates between
//! two ticks: an intermediate representation (Adachi, Kumano, Ogino 1995).

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_scene::{
    Access, BuildContext, CollisionList, Commands, ContactPlane, Controller, ControllerError, Entity,
    EntitySet, Instrument, InstrumentForce, InstrumentTarget, JawState, LocalContactModel, Parent, Pose,
    Snapshot, Tick, Velocity,
};

/// Smaller forces count as zero \[N\].
const FORCE_MIN: f64 = 1e-6;
/// Stiffness range of the plane \[N/m\]: not stiffer than hands can hold, nor too soft to notice.
const STIFFNESS: std::ops::RangeInclusive<f64> = 5.0..=1500.0;

/// How instruments follow their hands.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InstrumentsConfig {
    /// Maximum rate of opening and closing the jaws \[rad/s\].
    pub jaw_rate_max: f64,
    /// Maximum force on a hand \[N\].
    pub force_max: f64,
    /// Damping of the plane, as a fraction of critical damping for `mass`.
    pub damping_ratio: f64,
}

impl Default for InstrumentsConfig {
    fn default() -> Self {
        Self { jaw_rate_max: 6.0, force_max: 10.0, damping_ratio: 0.3 }
    }
}

impl InstrumentsConfig {
    /// Rejects values out of range.
    ///
    /// # Errors
    /// The name of the value and its range.
    pub fn check(&self) -> Result<(), String> {
        for (name, value, range) in [
            ("jaw_rate_max", self.jaw_rate_max, 0.01..=100.0),
            ("force_max", self.force_max, 0.0..=100.0),
            ("damping_ratio", self.damping_ratio, 0.0..=2.0),
        ] {
            if !range.contains(&value) {
                return Err(format!(
                    "{name}: {value} is out of range ({} to {})",
                    range.start(),
                    range.end()
                ));
            }
        }
        Ok(())
    }
}

/// Moves every instrument that has a target.
pub struct InstrumentsController {
    config: InstrumentsConfig,
    instruments: Vec<Entity>,
    /// Per instrument, in order.
    pushes: Vec<ContactLoad>,
}

/// Total contact load on an instrument.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct ContactLoad {
    force: Vector3<f64>,
    torque: Vector3<f64>,
    /// Sum of the force magnitudes \[N\], and the same weighted by depth \[N·m\].
    size: f64,
    size_by_depth: f64,
}

impl InstrumentsController {
    /// Finds the instruments of the scene.
    ///
    /// # Errors
    /// There is none.
    pub fn new(config: InstrumentsConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let mut instruments: Vec<Entity> =
            context.scene.iter::<Instrument>().map(|(entity, _)| entity).collect();
        instruments.sort_unstable();
        if instruments.is_empty() {
            return Err(ControllerError::Scene("instruments: the scene has none".into()));
        }
        Ok(Self { config, instruments, pushes: Vec::new() })
    }

    /// Sums the contact forces on each instrument, in one pass over all collision lists.
    fn add_pushes(&mut self, scene: &Snapshot) {
        self.pushes.clear();
        self.pushes.resize(self.instruments.len(), ContactLoad::default());
        for collision in scene.iter::<CollisionList>().flat_map(|(_, list)| &list.collisions) {
            // A collision stores the force on its second entity.
            for (entity, force) in
                [(collision.a, -collision.force_in_world), (collision.b, collision.force_in_world)]
            {
                if collision.a == collision.b {
                    continue;
                }
                let Some(at) = self.instruments.iter().position(|instrument| *instrument == entity) else {
                    continue;
                };
                let Some(target) = scene.get::<InstrumentTarget>(entity) else { continue };
                let tip = nalgebra::Point3::from(target.tip_in_world.translation);
                let push = &mut self.pushes[at];
                push.force += force;
                push.torque += (collision.middle_in_world() - tip).cross(&force);
                push.size += force.norm();
                push.size_by_depth += force.norm() * collision.depth.max(0.0);
            }
        }
    }

    fn model(
        &self,
        target: &InstrumentTarget,
        mass: f64,
        push: &ContactLoad,
        tick: &Tick<'_>,
    ) -> LocalContactModel {
        let mut model = LocalContactModel {
            proxy_in_world: target.tip_in_world,
            proxy_velocity: target.velocity_in_world,
            at: tick.time,
            ..LocalContactModel::default()
        };
        let force = push.force.norm().min(self.config.force_max);
        if force > FORCE_MIN {
            let normal = push.force.normalize();
            // Combined stiffness of the contacts: total force over mean depth.
            let depth = push.size_by_depth / push.size;
            let stiffness = (force / depth.max(1e-6)).clamp(*STIFFNESS.start(), *STIFFNESS.end());
            let tip = target.tip_in_world.translation;
            model.planes[0] = Some(ContactPlane {
                point_in_world: (tip + normal * (force / stiffness)).into(),
                normal_in_world: normal,
                stiffness,
                damping: self.config.damping_ratio * 2.0 * (stiffness * mass).sqrt(),
                friction: 0.0,
            });
        }
        model
    }
}

impl Controller for InstrumentsController {
    fn access(&self) -> Access {
        let all = || EntitySet::Of(self.instruments.clone());
        Access::new()
            .reads::<Instrument>()
            .reads::<InstrumentTarget>()
            .reads::<Parent>()
            .reads::<CollisionList>()
            .reads::<JawState>()
            .writes::<Pose>(all())
            .writes::<Velocity>(all())
            .writes::<JawState>(all())
            .writes::<InstrumentForce>(all())
            .writes::<LocalContactModel>(all())
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.add_pushes(scene);
        for (&entity, push) in self.instruments.iter().zip(&self.pushes) {
            let (Some(instrument), Some(target)) =
                (scene.get::<Instrument>(entity), scene.get::<InstrumentTarget>(entity))
            else {
                continue;
            };
            let pose = match scene.get::<Parent>(entity) {
                Some(parent) => {
                    (scene.world_pose(parent.0).inverse() * target.tip_in_world.isometry()).into()
                }
                None => target.tip_in_world,
            };
            out.put(entity, pose);
            out.put(entity, target.velocity_in_world);
            let wanted = target.jaw_angle.clamp(0.0, instrument.jaw_angle_max);
            let before = scene.get::<JawState>(entity).map_or(wanted, |jaws| jaws.angle);
            let step = self.config.jaw_rate_max * tick.period.as_secs_f64();
            let angle = before + (wanted - before).clamp(-step, step);
            let rate = (angle - before) / tick.period.as_secs_f64();
            let shorter = (self.config.force_max / push.force.norm().max(FORCE_MIN)).min(1.0);
            out.put(entity, JawState { angle, rate, pad_force: [0.0; 2] });
            let (force, torque) = (push.force * shorter, push.torque * shorter);
            out.put(entity, InstrumentForce { force, torque, at: tick.time });
            out.put(entity, self.model(target, instrument.mass, push, tick));
        }
        Ok(())
    }
}
