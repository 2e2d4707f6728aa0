//! The mesh of a heated body after cuts, read from the scene; heat is transferred to it.

use std::collections::BTreeSet;
use std::sync::Arc;

use nalgebra::Point3;
use trocar_dynamics::tet_mesh::NodeOrigin;
use trocar_scene::{Entity, RestPositions, Snapshot, SurfaceMesh, TetMesh};

use crate::controller::cutting::membrane::SurfaceElements;
use crate::controller::cutting::volume::VolumeCuts;
use crate::electrosurgery::{CutTissue, Tissue};

/// The current mesh of a body, with the mapping to the first one.
pub(crate) struct PartedMesh {
    rest: Arc<Vec<Point3<f64>>>,
    births: Arc<Vec<NodeOrigin>>,
    elements: Elements,
    of: Vec<u32>,
}

enum Elements {
    Tets(Arc<Vec<[u32; 4]>>),
    Triangles { triangles: Vec<[u32; 3]>, thickness: f64 },
}

/// Origins of the vertices added since a body's first mesh; `None` if it was never cut.
pub(crate) fn births(scene: &Snapshot, entity: Entity) -> Option<&Arc<Vec<NodeOrigin>>> {
    let of_volume = scene.get::<VolumeCuts>(entity).map(|cuts| &cuts.births);
    of_volume
        .or_else(|| scene.get::<SurfaceElements>(entity).map(|of| &of.births))
        .filter(|all| !all.is_empty())
}

impl PartedMesh {
    /// Reads it from the scene, if the body was cut. A membrane has a thickness and its original triangles, of which
    /// some were removed.
    ///
    /// # Errors
    /// Which data does not match.
    pub(crate) fn read(
        scene: &Snapshot,
        entity: Entity,
        membrane: Option<(f64, &[[u32; 3]])>,
    ) -> Result<Option<Self>, String> {
        let (Some(births), Some(rest)) = (births(scene, entity), scene.get::<RestPositions>(entity)) else {
            return Ok(None);
        };
        let (rest, births) = (rest.positions.clone(), births.clone());
        let Some((thickness, first)) = membrane else {
            let (Some(cuts), Some(volume)) = (scene.get::<VolumeCuts>(entity), scene.get::<TetMesh>(entity))
            else {
                return Ok(None);
            };
            cuts.fits(rest.len(), volume.tets.len())?;
            let count = (volume.tets.len() - cuts.parts_of.len()) as u32;
            let of = (0..count).chain(cuts.parts_of.iter().copied()).collect();
            return Ok(Some(Self { rest, births, elements: Elements::Tets(volume.tets.clone()), of }));
        };
        let (Some(known), Some(surface)) =
            (scene.get::<SurfaceElements>(entity), scene.get::<SurfaceMesh>(entity))
        else {
            return Ok(None);
        };
        if known.elements.len() != surface.triangles.len() {
            let (told, there) = (known.elements.len(), surface.triangles.len());
            return Err(format!("its 'surface_elements' tell of {told} triangles of {there}"));
        }
        let (mut triangles, mut of) = (surface.triangles.to_vec(), known.elements.to_vec());
        // Removed elements do not belong to the surface any longer, but keep the remaining heat.
        let there: BTreeSet<u32> = of.iter().copied().collect();
        for (element, corners) in (0..).zip(first).filter(|(element, _)| !there.contains(element)) {
            triangles.push(*corners);
            of.push(element);
        }
        Ok(Some(Self { rest, births, elements: Elements::Triangles { triangles, thickness }, of }))
    }

    /// In the form that the method takes.
    pub(crate) fn parted(&self) -> CutTissue<'_> {
        let positions: &[Point3<f64>] = &self.rest;
        let tissue = match &self.elements {
            Elements::Tets(tets) => Tissue::Volume { positions, tets },
            Elements::Triangles { triangles, thickness } => {
                Tissue::Membrane { positions, triangles, thickness: *thickness }
            }
        };
        CutTissue { tissue, of: &self.of, births: &self.births }
    }
}
