//! What scissors cut of a surface: where their closed blades sweep.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, Entity, Instrument, InstrumentKind, Snapshot};

use super::grips::is_closed;
use crate::cutting::{Sheet, SheetState, Sweep};

/// Everything about the cuts of a surface that its mesh does not say.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Cuts {
    /// Edges that have been cut and do not part yet.
    pub pending: Vec<[u32; 2]>,
    /// Ends of cuts that go on from there.
    pub tips: Vec<u32>,
    /// Limits of the first mesh, so that no sliver comes: see [`SheetState`].
    pub limits: [f64; 2],
    /// Where the edge of each pair of closed blades was, in the frame of the body.
    pub blades: Vec<(Entity, [Point3<f64>; 2])>,
    /// Length of all lips so far \[m\].
    pub length: f64,
}
impl Component for Cuts {
    const NAME: &'static str = "cuts";
}

impl Cuts {
    /// The sheet that this is the state of.
    ///
    /// # Errors
    /// The mesh is none that can be cut.
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
        swept(&mut self.blades, scene, world_from_body)
    }
}

/// What the closed blades of all scissors have swept since `blades` were told, in the frame of a body; tells them anew.
pub fn swept(
    blades: &mut Vec<(Entity, [Point3<f64>; 2])>,
    scene: &Snapshot,
    world_from_body: &Isometry3<f64>,
) -> Vec<Sweep> {
    let before: BTreeMap<Entity, [Point3<f64>; 2]> = blades.drain(..).collect();
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
        blades.push((entity, after));
    }
    sweeps
}
