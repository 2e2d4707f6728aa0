//! What jaws do to a surface: graspers hold what is between them, scissors cut where their closed blades sweep.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, Entity, Instrument, InstrumentKind, JawState, Snapshot};

use super::tools::Rod;
use super::touch::Touch;
use crate::cutting::{Sheet, SheetState, Sweep};
use crate::picking::{Jaws, Picks};

/// Full opening below which jaws hold, and blades cut \[rad\].
const CLOSED: f64 = 0.12;

/// Everything about the cuts and grips of a surface that its mesh does not say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceState {
    /// Edges that have been cut and do not part yet.
    pub pending: Vec<[u32; 2]>,
    /// Ends of cuts that go on from there.
    pub tips: Vec<u32>,
    /// Limits of the first mesh, so that no sliver comes: see [`SheetState`].
    pub limits: [f64; 2],
    /// Where the edge of each pair of closed blades was, in the frame of the body.
    pub blades: Vec<(Entity, [Point3<f64>; 2])>,
    /// What is held.
    pub picks: Picks,
    /// Length of all lips so far \[m\].
    pub cut_length: f64,
}
impl Component for SurfaceState {
    const NAME: &'static str = "surface_state";
}

impl SurfaceState {
    /// The sheet that this is the state of.
    pub fn sheet(
        &self,
        rest: Vec<Point3<f64>>,
        triangles: Vec<[u32; 3]>,
    ) -> Result<Sheet, crate::mass_spring::NetworkError> {
        let [corner_limit, height_limit] = self.limits;
        Sheet::restore(SheetState {
            rest,
            triangles,
            pending: self.pending.clone(),
            tips: self.tips.clone(),
            corner_limit,
            height_limit,
        })
    }

    /// Takes over what a sheet says.
    pub fn take(&mut self, sheet: &SheetState) {
        self.pending.clone_from(&sheet.pending);
        self.tips.clone_from(&sheet.tips);
        self.limits = [sheet.corner_limit, sheet.height_limit];
    }

    /// What the closed blades of all scissors have swept since the last time, in the frame of a body.
    pub fn sweeps(&mut self, scene: &Snapshot, world_from_body: &Isometry3<f64>) -> Vec<Sweep> {
        let before: BTreeMap<Entity, [Point3<f64>; 2]> = self.blades.drain(..).collect();
        let mut sweeps = Vec::new();
        for (entity, instrument) in scene.iter::<Instrument>() {
            if instrument.kind != InstrumentKind::Scissors || !is_closed(scene, entity) {
                continue;
            }
            let body_from_tip = world_from_body.inverse() * scene.world_pose(entity);
            let hinge = Point3::new(0.0, 0.0, -instrument.jaw_length);
            let after = [body_from_tip * hinge, body_from_tip * Point3::origin()];
            if let Some(before) = before.get(&entity) {
                sweeps.push(Sweep { before: *before, after });
            }
            self.blades.push((entity, after));
        }
        sweeps
    }
}

fn is_closed(scene: &Snapshot, instrument: Entity) -> bool {
    scene.get::<JawState>(instrument).is_some_and(|jaws| jaws.angle < CLOSED)
}

/// An instrument that holds: its number, its pose in the frame of a body, whether it is closed, what each jaw touches.
pub struct Holder {
    instrument: u64,
    body_from_instrument: Isometry3<f64>,
    closed: bool,
    touched: [Vec<u32>; 2],
}

impl Holder {
    /// All instruments that hold, with the triangles that their jaws touch; rods as [`super::tools::rods_of_all`] lists them.
    pub fn all(
        scene: &Snapshot,
        world_from_body: &Isometry3<f64>,
        rods: &[Rod],
        touches: &[Touch],
        about: impl Fn(u32) -> Vec<u32>,
    ) -> Vec<Self> {
        let holds = |kind| {
            matches!(
                kind,
                InstrumentKind::Grasper | InstrumentKind::NeedleDriver | InstrumentKind::SutureGrasper
            )
        };
        let holders = scene.iter::<Instrument>().filter(|(_, instrument)| holds(instrument.kind));
        holders
            .map(|(entity, _)| {
                let mut touched = [Vec::new(), Vec::new()];
                // The first rod of an instrument is its shaft.
                let first = rods.iter().position(|rod| rod.instrument == entity).unwrap_or(rods.len());
                for touch in touches.iter().filter(|touch| touch.rod > first && touch.rod <= first + 2) {
                    let jaw = &mut touched[touch.rod - first - 1];
                    match touch.element {
                        Some(triangle) => jaw.push(triangle),
                        None => jaw.extend(about(touch.nodes[0])),
                    }
                }
                Self {
                    instrument: entity.to_bits(),
                    body_from_instrument: world_from_body.inverse() * scene.world_pose(entity),
                    closed: is_closed(scene, entity),
                    touched,
                }
            })
            .collect()
    }

    /// As [`Picks`] wants it; "world" is the frame of the body.
    pub fn jaws(&self) -> Jaws<'_> {
        Jaws {
            instrument: self.instrument,
            pose_in_world: self.body_from_instrument,
            closed: self.closed,
            touched: [&self.touched[0], &self.touched[1]],
        }
    }
}
