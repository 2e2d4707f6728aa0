//! State of the cuts of a surface, and the previous blades.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::tet_mesh::Sweep;
use trocar_scene::{Component, Snapshot};

use super::scissors::{Blades, swept};
use crate::cutting::{Sheet, SheetState};

/// State of the cuts that the mesh does not contain.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "cuts")]
#[serde(default, deny_unknown_fields)]
pub struct Cuts {
    /// Cut edges that have not opened yet.
    pub pending: Vec<[u32; 2]>,
    /// Cut tips: vertices from which a cut can go on.
    pub tips: Vec<u32>,
    /// Size limits from the first mesh that prevent slivers: see [`SheetState`].
    pub limits: [f64; 2],
    /// Previous blades of all scissors, in the frame of the body.
    pub blades: Vec<Blades>,
    /// Total length of all cut lips \[m\].
    pub length: f64,
}

impl Cuts {
    /// The sheet with this state.
    ///
    /// # Errors
    /// The mesh cannot be cut.
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

    /// Copies a sheet's state.
    pub fn take(&mut self, sheet: &SheetState) {
        self.pending.clone_from(&sheet.pending);
        self.tips.clone_from(&sheet.tips);
        self.limits = [sheet.corner_limit, sheet.height_limit];
    }

    /// Areas that the blades of all scissors have swept since the last call, in the frame of a body; sets `changed` if
    /// the blades have moved.
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
