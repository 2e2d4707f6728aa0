//! What scissors have cut of a surface, and where their blades were.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::tet_mesh::Sweep;
use trocar_scene::{Component, Snapshot};

use super::scissors::{Blades, swept};
use crate::cutting::{Sheet, SheetState};

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
    /// Where the blades of all scissors were, in the frame of the body.
    pub blades: Vec<Blades>,
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

    /// What the blades of all scissors have swept since the last time, in the frame of a body; `changed` becomes true where
    /// they are elsewhere now.
    pub fn sweeps(
        &mut self,
        scene: &Snapshot,
        world_from_body: &Isometry3<f64>,
        changed: &mut bool,
    ) -> Vec<Sweep> {
        let before = self.blades.clone();
        let sweeps = swept(&mut self.blades, scene, world_from_body);
        *changed |= self.blades != before;
        sweeps
    }
}
