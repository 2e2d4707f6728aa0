//! Lines that blades cut: their segments come apart at a node, of which there are two from then on.

use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::{Commands, LineMesh, Snapshot};

use super::cuts::Cuts;
use super::deformable::Deformable;
use super::soft::{Measures, Site};
use crate::cutting::{part_line, pieces};

/// What has been cut of a line, and where the blades were.
pub struct LineCuts {
    cuts: Cuts,
    changed: bool,
    pieces: usize,
}

impl LineCuts {
    /// Of a body as the scene has it.
    pub fn new(body: &Deformable, scene: &Snapshot) -> Self {
        let known = scene.get::<Cuts>(body.entity);
        Self {
            cuts: known.cloned().unwrap_or_default(),
            changed: known.is_none(),
            pieces: pieces(body.rest.len(), &body.segments),
        }
    }

    /// Lets it come apart where blades have swept since the last time; the body follows. Of which nodes the new ones are
    /// copies.
    pub fn reshape(
        &mut self,
        positions: &[Point3<f64>],
        body: &mut Deformable,
        site: &Site<'_>,
        out: &mut Commands,
    ) -> Option<Vec<u32>> {
        let sweeps = self.cuts.sweeps(site.scene, site.world_from_body, &mut self.changed);
        if sweeps.is_empty() {
            return None;
        }
        let parted = part_line(positions, &body.segments, &sweeps)?;
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

    /// Tells what a later life needs.
    pub fn publish(&mut self, body: &Deformable, out: &mut Commands) {
        if std::mem::take(&mut self.changed) {
            out.put(body.entity, self.cuts.clone());
        }
    }

    /// Tells how far it has come apart.
    pub fn measure(&self, measures: &mut Measures<'_>) {
        measures.put("pieces", self.pieces as f64);
    }
}

/// Appends what some have.
fn copy<T: Copy>(list: &mut Arc<Vec<T>>, of: &[u32]) {
    let list = Arc::make_mut(list);
    for &one in of {
        list.push(list[one as usize]);
    }
}
