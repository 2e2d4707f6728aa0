//! What heat has made of the elements of a body, as it is in the scene: who heats the body writes it, who moves it reads it.
//!
//! Elements keep the numbers that they had in the first mesh, whatever comes apart.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Alteration;
use trocar_scene::{
    Access, Component, ComponentError, Entity, EntitySet, Snapshot, SurfaceMesh, TextureCoordinates,
};

/// Elements of a body's mesh at rest that are gone: tetrahedra of a volume, triangles of a membrane.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct RemovedElements {
    /// In the order in which they went.
    pub elements: Arc<Vec<u32>>,
}
impl Component for RemovedElements {
    const NAME: &'static str = "removed_elements";
}

/// An element that heat has stiffened and shrunk.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Coagulated {
    /// Which.
    pub element: u32,
    /// Times the stiffness it had.
    pub stiffness: f64,
    /// Times the length at rest that it had.
    pub length: f64,
}

/// Elements of a body that are coagulated, in part or wholly.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CoagulatedElements {
    /// Ascending.
    pub elements: Arc<Vec<Coagulated>>,
}
impl Component for CoagulatedElements {
    const NAME: &'static str = "coagulated_elements";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}

/// What whoever moves bodies that come apart reads and writes of them, volumes and membranes.
pub(super) fn access(access: Access, bodies: &[Entity]) -> Access {
    access
        .reads::<RemovedElements>()
        .reads::<CoagulatedElements>()
        .writes::<SurfaceMesh>(EntitySet::Of(bodies.to_vec()))
        .writes::<TextureCoordinates>(EntitySet::Of(bodies.to_vec()))
}

/// What somebody who moves a body knows of that.
#[derive(Clone, Debug, Default)]
pub struct Heated {
    /// All that went, in their order.
    pub removed: Arc<Vec<u32>>,
    /// All that are coagulated, ascending.
    pub coagulated: Arc<Vec<Coagulated>>,
}

impl Heated {
    /// What an earlier life knew that had taken out so many elements: the others come as news.
    #[must_use]
    pub fn known(scene: &Snapshot, entity: Entity, taken: usize) -> Self {
        let removed = scene.get::<RemovedElements>(entity).map(|of| of.elements.clone()).unwrap_or_default();
        let coagulated = scene.get::<CoagulatedElements>(entity).map(|of| of.elements.clone());
        let removed = match taken {
            all if all >= removed.len() => removed,
            _ => Arc::new(removed[..taken].to_vec()),
        };
        Self { removed, coagulated: coagulated.unwrap_or_default() }
    }

    /// Takes over what the scene says: elements that went, and those that are coagulated otherwise, since the last time.
    pub fn news(&mut self, scene: &Snapshot, entity: Entity) -> (Vec<u32>, Vec<Coagulated>) {
        let (mut gone, mut changed) = (Vec::new(), Vec::new());
        if let Some(now) = scene.get::<RemovedElements>(entity)
            && now.elements.len() > self.removed.len()
        {
            gone.extend_from_slice(&now.elements[self.removed.len()..]);
            self.removed = now.elements.clone();
        }
        if let Some(now) = scene.get::<CoagulatedElements>(entity)
            && !Arc::ptr_eq(&now.elements, &self.coagulated)
        {
            changed.extend(now.elements.iter().filter(|of| self.of(of.element) != Some(**of)));
            self.coagulated = now.elements.clone();
        }
        (gone, changed)
    }

    /// As stiff and as long as an element is, if it is there.
    #[must_use]
    pub fn alteration(&self, element: u32) -> Alteration {
        self.of(element)
            .map_or(Alteration::NONE, |of| Alteration { stiffness: of.stiffness, length: of.length })
    }

    /// What is known of an element.
    #[must_use]
    pub fn of(&self, element: u32) -> Option<Coagulated> {
        let at = self.coagulated.binary_search_by_key(&element, |of| of.element).ok()?;
        Some(self.coagulated[at])
    }
}
