//! The controller of suturing: grasps drive needle and thread, the island of needle, thread and tissue is stepped, and
//! the results are written back.
//!
//! Closing jaws take what lies between them, the needle in preference to the thread. A held part is coupled to the
//! instrument by its compliance, and slips beyond the jaws' maximum force; the force is reported to the instrument. The
//! thread collides with itself, the tissue, instruments and rigid bodies. A failure freezes the whole island.

pub mod components;
pub(crate) mod session;

use nalgebra::Vector3;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::frozen::{FrozenPart, RejectedBody};
use trocar_scene::components::LineMesh;
use trocar_scene::{
    Access, BuildContext, CollisionList, Commands, Controller, ControllerError, Entity, EntitySet,
    Instrument, JawState, Measured, OutOfValidity, Pose, RigidBody, Shape, Snapshot, SurfaceMesh, Tick,
};

use super::suture_thread::knot::KnotState;
use super::suture_thread::led_instruments::LedInstruments;
use components::{SewnTissue, SutureMemory, SutureNeedle};
use session::Sewing;

/// The sewing session, or why it cannot be built.
enum Sewn {
    Going(Box<Sewing>),
    /// Needle and tissue.
    RejectedBody([RejectedBody; 2]),
}

/// Steps the needle with [`SutureNeedle`], and the tissue with [`SewnTissue`].
pub struct SutureController {
    needle: Entity,
    tissue: Entity,
    sewn: Sewn,
}

impl SutureController {
    /// Reads needle and tissue, and resumes their state from the scene.
    ///
    /// # Errors
    /// There is not exactly one of each; at the first start, also what is wrong with them.
    pub fn new(gravity_in_world: Vector3<f64>, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let scene = context.scene;
        let (needles, tissues) =
            (Deformable::carriers::<SutureNeedle>(scene), Deformable::carriers::<SewnTissue>(scene));
        let (&[needle], &[tissue]) = (&needles[..], &tissues[..]) else {
            return Err(ControllerError::Scene(format!(
                "suture: there are {} entities with a 'needle' and {} with 'sewn'; one of each is valid",
                needles.len(),
                tissues.len()
            )));
        };
        let sewn = match Sewing::new(gravity_in_world, [needle, tissue], scene) {
            Ok(sewing) => Sewn::Going(Box::new(sewing)),
            Err(error) => {
                let of = |entity| RejectedBody::of(context, entity, FrozenPart::Body, error.clone());
                Sewn::RejectedBody([of(needle)?, of(tissue)?])
            }
        };
        Ok(Self { needle, tissue, sewn })
    }
}

impl Controller for SutureController {
    fn access(&self) -> Access {
        let needle = EntitySet::Of(vec![self.needle]);
        LedInstruments::access(Deformable::access(&[self.needle, self.tissue]), &[self.needle])
            .reads::<SutureNeedle>()
            .reads::<SewnTissue>()
            .reads::<Pose>()
            .reads::<Instrument>()
            .reads::<JawState>()
            .reads::<RigidBody>()
            .reads::<Shape>()
            .reads::<SurfaceMesh>()
            .writes::<LineMesh>(needle.clone())
            .writes::<SutureMemory>(needle.clone())
            .writes::<KnotState>(needle)
            .writes::<OutOfValidity>(EntitySet::Of(vec![self.tissue]))
            .writes::<Measured>(EntitySet::Own)
            .contributes::<CollisionList>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let mut measured = Measured::default();
        let list = match &mut self.sewn {
            Sewn::Going(sewing) => {
                let list = sewing.tick(scene, tick, out);
                sewing.measure(&scene.world_pose(self.needle), &mut measured);
                list
            }
            Sewn::RejectedBody(parts) => {
                parts.iter_mut().for_each(|part| part.report(tick, &mut measured, out));
                CollisionList { collisions: Vec::new(), penetration_max: 0.0 }
            }
        };
        out.contribute(list);
        out.put(tick.me, measured);
        Ok(())
    }
}
