//! Controller of kinematic instruments: they follow their hands; tissue yields and pushes back.
//!
//! For scenes without a rigid world that simulates instruments. The simulators report contact forces in the collision
//! list; this controller sums them into the force on the instrument, and into the plane that haptics evaluates between
//! two ticks: an intermediate representation (Adachi, Kumano, Ogino 1995).
//!
//! A body that lets no instrument through, such as a thread, holds it back: its simulator couples the instrument to the
//! hand, and the instrument stands where all of them together displace it to
//! ([`deflection`](trocar_dynamics::instrument::deflection)). The force on the hand is then that of the coupling.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use trocar_dynamics::instrument::deflection::{Displacement, InstrumentDeflection, InstrumentYields};
use trocar_scene::{
    Access, BuildContext, CollisionList, Commands, ContactPlane, Controller, ControllerError, Entity,
    EntitySet, Instrument, InstrumentForce, InstrumentTarget, JawState, LocalContactModel, Parent, Pose,
    SimTime, Snapshot, Tick, Velocity,
};

/// A displacement that nobody renews fades from this age on, and is gone at twice it \[s\].
const FADE: f64 = 0.25;
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
    /// Maximum force of the coupling between a hand and its instrument \[N\]: the hand pulls an instrument that is held
    /// back with its `coupling_stiffness`, and never harder than this.
    pub coupling_force_max: f64,
}

impl Default for InstrumentsConfig {
    fn default() -> Self {
        Self { jaw_rate_max: 6.0, force_max: 10.0, damping_ratio: 0.3, coupling_force_max: 20.0 }
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
            ("coupling_force_max", self.coupling_force_max, 0.1..=200.0),
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
    deflections: Vec<InstrumentDeflection>,
}

/// Where an instrument is that its hand leads to a target and that bodies hold back.
fn pose(target: &InstrumentTarget, deflection: &InstrumentDeflection) -> Pose {
    let wanted = target.tip_in_world;
    Pose { translation: wanted.translation + deflection.total().offset, ..wanted }
}

/// Its velocity.
fn velocity(target: &InstrumentTarget, deflection: &InstrumentDeflection) -> Velocity {
    let wanted = target.velocity_in_world;
    Velocity { linear: wanted.linear + deflection.total().velocity, ..wanted }
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
        Ok(Self { config, instruments, pushes: Vec::new(), deflections: Vec::new() })
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

    /// Sums how far bodies hold each instrument back. Their contacts move it, and the coupling pulls at the hand: the
    /// forces differ by what accelerates the instrument.
    fn add_held_back(&mut self, scene: &Snapshot, now: SimTime) {
        let force_max = self.config.coupling_force_max;
        self.deflections.clear();
        let none = InstrumentDeflection { by: Vec::new(), force_max };
        self.deflections.resize(self.instruments.len(), none);
        for (body, yields) in scene.iter::<InstrumentYields>() {
            let age: f64 = now.since(yields.at).as_secs_f64();
            let share = (2.0 - age / FADE).clamp(0.0, 1.0);
            for of in yields.list.iter().filter(|_| share > 0.0) {
                let Some(at) = self.instruments.iter().position(|known| *known == of.instrument) else {
                    continue;
                };
                let by = Displacement { offset: of.offset * share, velocity: of.velocity * share };
                self.deflections[at].by.push((body, by));
                self.pushes[at].force += of.coupling_force * share - of.contact_force;
            }
        }
    }

    fn model(
        &self,
        target: &InstrumentTarget,
        held: &InstrumentDeflection,
        mass: f64,
        push: &ContactLoad,
        tick: &Tick<'_>,
    ) -> LocalContactModel {
        let mut model = LocalContactModel {
            proxy_in_world: pose(target, held),
            proxy_velocity: velocity(target, held),
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
            .reads::<InstrumentYields>()
            .reads::<InstrumentDeflection>()
            .writes::<InstrumentDeflection>(all())
            .writes::<Pose>(all())
            .writes::<Velocity>(all())
            .writes::<JawState>(all())
            .writes::<InstrumentForce>(all())
            .writes::<LocalContactModel>(all())
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.add_pushes(scene);
        self.add_held_back(scene, tick.time);
        let is_held = scene.iter::<InstrumentYields>().next().is_some();
        for ((&entity, push), held) in self.instruments.iter().zip(&self.pushes).zip(&self.deflections) {
            let (Some(instrument), Some(target)) =
                (scene.get::<Instrument>(entity), scene.get::<InstrumentTarget>(entity))
            else {
                continue;
            };
            let pose = match scene.get::<Parent>(entity) {
                Some(parent) => (scene.world_pose(parent.0).inverse() * pose(target, held).isometry()).into(),
                None => pose(target, held),
            };
            out.put(entity, pose);
            out.put(entity, velocity(target, held));
            if is_held && scene.get::<InstrumentDeflection>(entity) != Some(held) {
                out.put(entity, held.clone());
            }
            let wanted = target.jaw_angle.clamp(0.0, instrument.jaw_angle_max);
            let before = scene.get::<JawState>(entity).map_or(wanted, |jaws| jaws.angle);
            let step = self.config.jaw_rate_max * tick.period.as_secs_f64();
            let angle = before + (wanted - before).clamp(-step, step);
            let rate = (angle - before) / tick.period.as_secs_f64();
            let shorter = (self.config.force_max / push.force.norm().max(FORCE_MIN)).min(1.0);
            out.put(entity, JawState { angle, rate, pad_force: [0.0; 2] });
            let (force, torque) = (push.force * shorter, push.torque * shorter);
            out.put(entity, InstrumentForce { force, torque, at: tick.time });
            out.put(entity, self.model(target, held, instrument.mass, push, tick));
        }
        Ok(())
    }
}
