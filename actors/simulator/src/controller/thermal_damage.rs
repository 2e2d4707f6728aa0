//! Thermal damage of a body's elements, as components: the heating controller writes them, the controller that moves
//! the body reads them.
//!
//! Elements keep their numbers of the first mesh, whatever is cut later.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Alteration;
use trocar_scene::{
    Access, Component, Entity, EntitySet, Snapshot, SurfaceMesh, TetRegions, TextureCoordinates,
};

use super::region_stiffness::SoftRegions;

/// Removed elements of a body's first mesh: tetrahedra of a volume, triangles of a membrane.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "removed_elements")]
#[serde(default, deny_unknown_fields)]
pub struct RemovedElements {
    /// In the order of removal.
    pub elements: Arc<Vec<u32>>,
}

/// An element that heat has stiffened and shrunk.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CoagulatedElement {
    /// The element.
    pub element: u32,
    /// Factor of its stiffness.
    pub stiffness: f64,
    /// Factor of its rest length.
    pub length: f64,
}

/// Partly or fully coagulated elements of a body.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "coagulated_elements")]
#[serde(default, deny_unknown_fields)]
pub struct CoagulatedElements {
    /// Ascending.
    pub elements: Arc<Vec<CoagulatedElement>>,
}

/// Reads and writes of every controller that moves divisible bodies, volumes and membranes.
pub(super) fn access(access: Access, bodies: &[Entity]) -> Access {
    access
        .reads::<RemovedElements>()
        .reads::<CoagulatedElements>()
        .reads::<SoftRegions>()
        .reads::<TetRegions>()
        .writes::<SurfaceMesh>(EntitySet::Of(bodies.to_vec()))
        .writes::<TextureCoordinates>(EntitySet::Of(bodies.to_vec()))
}

/// Thermal damage of a body as last read by the controller that moves it.
#[derive(Clone, Debug, Default)]
pub struct ThermalDamage {
    /// Removed elements, in order of removal.
    pub removed: Arc<Vec<u32>>,
    /// Coagulated elements, ascending; those of regions with a stiffness of their own included.
    pub coagulated: Arc<Vec<CoagulatedElement>>,
    /// Stiffness of each element of the first mesh before any heat, as a factor; empty when all are 1.
    regions: Arc<Vec<f64>>,
    /// Coagulation as last read, without the regions.
    read: Arc<Vec<CoagulatedElement>>,
}

impl ThermalDamage {
    /// The state of a controller that had removed this many elements before a restart: later ones count as new.
    #[must_use]
    pub fn known(scene: &Snapshot, entity: Entity, taken: usize) -> Self {
        let removed = scene.get::<RemovedElements>(entity).map(|of| of.elements.clone()).unwrap_or_default();
        let coagulated = scene.get::<CoagulatedElements>(entity).map(|of| of.elements.clone());
        let removed = match taken {
            all if all >= removed.len() => removed,
            _ => Arc::new(removed[..taken].to_vec()),
        };
        let read = coagulated.unwrap_or_default();
        Self { removed, coagulated: read.clone(), regions: Arc::default(), read }
    }

    /// These elements; the coagulated ones ascending.
    #[must_use]
    pub fn listed(removed: Vec<u32>, coagulated: Vec<CoagulatedElement>) -> Self {
        let (removed, coagulated) = (Arc::new(removed), Arc::new(coagulated));
        Self { removed, coagulated, ..Self::default() }
    }

    /// With the stiffness of each element of the first mesh, as a factor; none when it is empty.
    #[must_use]
    pub fn of_regions(mut self, regions: Arc<Vec<f64>>) -> Self {
        self.coagulated = with_regions(&regions, &self.read);
        self.regions = regions;
        self
    }

    /// Reads the scene: newly removed elements, and those whose coagulation has changed, since the last call.
    pub fn take_changes(&mut self, scene: &Snapshot, entity: Entity) -> (Vec<u32>, Vec<CoagulatedElement>) {
        let (mut gone, mut changed) = (Vec::new(), Vec::new());
        if let Some(now) = scene.get::<RemovedElements>(entity)
            && now.elements.len() > self.removed.len()
        {
            gone.extend_from_slice(&now.elements[self.removed.len()..]);
            self.removed = now.elements.clone();
        }
        if let Some(now) = scene.get::<CoagulatedElements>(entity)
            && !Arc::ptr_eq(&now.elements, &self.read)
        {
            let all = with_regions(&self.regions, &now.elements);
            changed.extend(all.iter().filter(|of| self.of(of.element) != Some(**of)));
            (self.coagulated, self.read) = (all, now.elements.clone());
        }
        (gone, changed)
    }

    /// Stiffness and length of an element, if it is present.
    #[must_use]
    pub fn alteration(&self, element: u32) -> Alteration {
        self.of(element)
            .map_or(Alteration::NONE, |of| Alteration { stiffness: of.stiffness, length: of.length })
    }

    /// Coagulation of an element.
    #[must_use]
    pub fn of(&self, element: u32) -> Option<CoagulatedElement> {
        let at = self.coagulated.binary_search_by_key(&element, |of| of.element).ok()?;
        Some(self.coagulated[at])
    }
}

/// Coagulation on top of the stiffness of regions, ascending.
fn with_regions(regions: &[f64], heated: &Arc<Vec<CoagulatedElement>>) -> Arc<Vec<CoagulatedElement>> {
    if regions.is_empty() {
        return heated.clone();
    }
    let stiff = |element: u32| regions.get(element as usize).copied().unwrap_or(1.0);
    let mut all: Vec<CoagulatedElement> = heated
        .iter()
        .map(|of| CoagulatedElement { stiffness: of.stiffness * stiff(of.element), ..*of })
        .collect();
    let is_heated = |element: u32| heated.binary_search_by_key(&element, |of| of.element).is_ok();
    let cold = (0..regions.len() as u32).filter(|&element| stiff(element) != 1.0 && !is_heated(element));
    all.extend(cold.map(|element| CoagulatedElement { element, stiffness: stiff(element), length: 1.0 }));
    all.sort_unstable_by_key(|of| of.element);
    Arc::new(all)
}
