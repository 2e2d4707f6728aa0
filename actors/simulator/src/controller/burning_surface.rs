//! Membranes that burn in a scene: triangles that go, triangles that stiffen and shrink. Blades do not cut them.

use std::collections::BTreeSet;
use std::sync::Arc;

use serde::{Deserialize, Serialize};
use trocar_scene::{Access, Commands, Component, Entity, EntitySet, Snapshot, SurfaceMesh};

use super::deformable::Deformable;
use super::electrosurgery::CauterisedBody;
use super::heat::{CoagulatedElements, Heated, RemovedElements};
use super::soft::{Reshaped, Site};
use crate::elasticity::Alteration;

/// Of each triangle of a surface that burns, which of the first mesh it was.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceElements {
    /// Ascending.
    pub elements: Arc<Vec<u32>>,
    /// Of the elements that heat has removed, how many have been taken out.
    pub taken: u32,
}
impl Component for SurfaceElements {
    const NAME: &'static str = "surface_elements";
}

/// A membrane, and how far it has burned.
pub struct BurningSurface {
    elements: Arc<Vec<u32>>,
    heated: Heated,
}

impl BurningSurface {
    /// Of a body as the scene has it, if it burns; tells the body which of its vertices are of nothing.
    ///
    /// # Errors
    /// It burns as a volume.
    pub fn new(body: &mut Deformable, scene: &Snapshot) -> Result<Option<Self>, String> {
        let Some(burns) = scene.get::<CauterisedBody>(body.entity) else { return Ok(None) };
        if burns.thickness.is_none() {
            return Err("it moves as a surface: give 'cauterised' its 'thickness'".into());
        }
        let known = scene.get::<SurfaceElements>(body.entity);
        let known = known.filter(|known| known.elements.len() == body.triangles.len());
        let elements = match known {
            Some(known) => known.elements.clone(),
            None => Arc::new((0..body.triangles.len() as u32).collect()),
        };
        let taken = known.map_or(0, |known| known.taken as usize);
        let this = Self { elements, heated: Heated::known(scene, body.entity, taken) };
        body.loose = unused(body);
        Ok(Some(this))
    }

    /// What a controller of membranes that burn reads and writes.
    pub fn access(access: Access, bodies: &[Entity]) -> Access {
        let all = || EntitySet::Of(bodies.to_vec());
        access
            .reads::<RemovedElements>()
            .reads::<CoagulatedElements>()
            .writes::<SurfaceMesh>(all())
            .writes::<SurfaceElements>(all())
    }

    /// Takes over what heat has done since the last time: whether anything has changed, and what became of the triangles if
    /// some of them went.
    pub fn burn(
        &mut self,
        body: &mut Deformable,
        site: &Site<'_>,
        out: &mut Commands,
    ) -> (bool, Option<Reshaped>) {
        let (gone, changed) = self.heated.news(site.scene, body.entity);
        if gone.is_empty() {
            return (!changed.is_empty(), None);
        }
        let kept = self.take_out(&gone, body);
        out.put(body.entity, SurfaceMesh { triangles: body.triangles.clone() });
        let taken = self.heated.removed.len() as u32;
        out.put(body.entity, SurfaceElements { elements: self.elements.clone(), taken });
        (true, Some(Reshaped { kept: Some(kept), parents: Vec::new() }))
    }

    /// What heat has made of each triangle that is there.
    #[must_use]
    pub fn altered(&self) -> Vec<Alteration> {
        let of = |element: &u32| match self.heated.of(*element) {
            Some(of) => Alteration { stiffness: of.stiffness, length: of.length },
            None => Alteration::NONE,
        };
        self.elements.iter().map(of).collect()
    }

    /// The new number of each triangle, where it is still there.
    fn take_out(&mut self, gone: &[u32], body: &mut Deformable) -> Vec<Option<u32>> {
        let gone: BTreeSet<u32> = gone.iter().copied().collect();
        let (mut kept, mut triangles, mut elements) = (Vec::new(), Vec::new(), Vec::new());
        for (triangle, element) in body.triangles.iter().zip(self.elements.iter()) {
            let stays = !gone.contains(element);
            kept.push(stays.then_some(triangles.len() as u32));
            if stays {
                triangles.push(*triangle);
                elements.push(*element);
            }
        }
        body.triangles = Arc::new(triangles);
        body.loose = unused(body);
        self.elements = Arc::new(elements);
        kept
    }
}

/// Vertices that are of no triangle, ascending.
fn unused(body: &Deformable) -> Vec<u32> {
    let mut used = vec![false; body.rest.len()];
    body.triangles.iter().flatten().for_each(|&node| used[node as usize] = true);
    (0..used.len() as u32).filter(|&node| !used[node as usize]).collect()
}
