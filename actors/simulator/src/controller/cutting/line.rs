//! Cutting and tearing of lines: segments separate at a node, which is duplicated.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::method::{Measures, StepContext};
use trocar_scene::{Commands, LineMesh, Snapshot};

use super::surface::Cuts;
use crate::cutting::{part_line, pieces, tear_line};

/// Cutting and tearing criteria of a line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LineFailureCriteria {
    /// Whether blades cut them.
    pub cut: bool,
    /// Stretch (length over rest length) at which a segment tears; absent: none tears.
    pub tears_at: Option<f64>,
}

/// Cuts of a line, and the previous blades.
pub struct LineCuts {
    failure_criteria: LineFailureCriteria,
    cuts: Cuts,
    changed: bool,
    pieces: usize,
}

impl LineCuts {
    /// For a body of the scene.
    pub fn new(body: &Deformable, failure_criteria: LineFailureCriteria, scene: &Snapshot) -> Self {
        let known = scene.get::<Cuts>(body.entity);
        Self {
            failure_criteria,
            cuts: known.cloned().unwrap_or_default(),
            changed: known.is_none(),
            pieces: pieces(body.rest.len(), &body.segments),
        }
    }

    /// Whether blades cut it.
    #[must_use]
    pub fn is_cut(&self) -> bool {
        self.failure_criteria.cut
    }

    /// Cuts where blades have swept since the last call, or tears an overstretched segment; updates the body. Returns
    /// the nodes that the new ones duplicate.
    pub fn reshape(
        &mut self,
        positions: &[Point3<f64>],
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Option<Vec<u32>> {
        let LineFailureCriteria { cut, tears_at } = self.failure_criteria;
        let cut = cut.then(|| self.cuts.sweeps(site.scene, site.world_from_body, &mut self.changed));
        let cut = cut.filter(|sweeps| !sweeps.is_empty());
        let parted = cut.and_then(|sweeps| part_line(positions, &body.segments, &sweeps));
        let torn = || tear_line([&body.rest, positions], &body.segments, tears_at?);
        let parted = parted.or_else(torn)?;
        body.segments = Arc::new(parted.segments);
        out.put(body.entity, LineMesh { segments: body.segments.clone(), radius: body.radius });
        copy(&mut body.rest, &parted.copies);
        copy(&mut body.positions, &parted.copies);
        copy(&mut body.velocities, &parted.copies);
        body.anchor();
        body.changed_topology();
        self.pieces = pieces(body.rest.len(), &body.segments);
        self.changed = true;
        Some(parted.copies)
    }

    /// Writes the state that a restart needs.
    pub fn publish(&mut self, body: &Deformable, out: &mut Commands) {
        if std::mem::take(&mut self.changed) {
            out.put(body.entity, self.cuts.clone());
        }
    }

    /// Measures of the cuts.
    pub fn measure(&self, measures: &mut Measures<'_>) {
        measures.put("pieces", self.pieces as f64);
    }
}

/// Appends copies of these entries.
fn copy<T: Copy>(list: &mut Arc<Vec<T>>, of: &[u32]) {
    let list = Arc::make_mut(list);
    for &one in of {
        list.push(list[one as usize]);
    }
}
