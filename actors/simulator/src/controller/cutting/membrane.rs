//! Topology changes of membranes, for every method: triangles that heat removes, stiffens and shrinks, cuts along blade
//! paths, and tears.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::method::{Measures, StepContext, SurfaceChange};
use trocar_dynamics::tet_mesh::NodeOrigin;
use trocar_scene::{
    Access, Commands, Component, Entity, EntitySet, Snapshot, SurfaceMesh, TextureCoordinates,
};

use super::surface::Cuts;
use crate::controller::cauterised::CauterisedBody;
use crate::controller::thermal_damage::{self, CoagulatedElement, ThermalDamage};
use crate::cutting::{Sheet, TopologyChange, VertexChange};
use crate::mass_spring::ChangedMesh;

/// State of a membrane's topology changes that its mesh does not contain.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "surface_elements")]
#[serde(default, deny_unknown_fields)]
pub struct SurfaceElements {
    /// For each triangle, the triangle of the first mesh that it is a part of.
    pub elements: Arc<Vec<u32>>,
    /// Origins of the vertices added since the first mesh, in order.
    pub births: Arc<Vec<NodeOrigin>>,
    /// How many of the elements removed by heat have been taken out.
    pub taken: u32,
}

/// Cutting and tearing criteria of a membrane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MembraneFailureCriteria {
    /// Whether blades cut it.
    pub cut: bool,
    /// Stretch (length over rest length) at which it tears.
    pub tears_at: Option<f64>,
}

/// A divisible membrane and its topology changes.
pub struct Membrane {
    sheet: Sheet,
    cuts: Cuts,
    of: SurfaceElements,
    heated: ThermalDamage,
    failure_criteria: MembraneFailureCriteria,
    /// Whether heat damages it.
    burns: bool,
    /// Areas of its pieces, largest first \[m²\].
    areas: Vec<f64>,
    cuts_changed: bool,
}

impl MembraneChange {
    /// Sets the state of new vertices.
    pub fn carry(&self, state: &mut State) {
        self.change.carry(&mut state.positions, |a, b, share| a + (b - a) * share);
        self.change.carry(&mut state.velocities, |a, b, share| a + (b - a) * share);
    }
}

/// Topology changes of a membrane in one tick.
pub struct MembraneChange {
    /// Cuts and tears.
    pub change: TopologyChange,
    /// Corners of triangles that were changed, damaged, added or removed; ascending.
    pub stale: Vec<u32>,
    /// Renumbering of the triangles, if any has changed.
    pub reshaped: Option<SurfaceChange>,
}

impl Membrane {
    /// For a body of the scene, if it is divisible; marks the body's unused vertices.
    ///
    /// # Errors
    /// It burns as a volume, or its mesh cannot be cut.
    pub fn new(
        body: &mut Deformable,
        failure_criteria: MembraneFailureCriteria,
        scene: &Snapshot,
    ) -> Result<Option<Self>, String> {
        let burns = scene.get::<CauterisedBody>(body.entity);
        if burns.is_some_and(|burns| burns.thickness.is_none()) {
            return Err("it moves as a surface: give 'cauterised' its 'thickness'".into());
        }
        let burns = burns.is_some();
        let known = scene.get::<Cuts>(body.entity);
        let of = scene.get::<SurfaceElements>(body.entity);
        if !(burns
            || failure_criteria.cut
            || failure_criteria.tears_at.is_some()
            || known.is_some()
            || of.is_some())
        {
            return Ok(None);
        }
        let of = of.filter(|of| of.elements.len() == body.triangles.len()).cloned();
        let of = of.unwrap_or_else(|| {
            let elements = (0..body.triangles.len() as u32).collect();
            SurfaceElements { elements: Arc::new(elements), ..SurfaceElements::default() }
        });
        let (rest, triangles) = (body.rest.to_vec(), body.triangles.to_vec());
        let sheet = match known {
            Some(known) => known.sheet(rest, triangles),
            None => Sheet::new(rest, triangles),
        };
        let sheet = sheet.map_err(|error| error.to_string())?;
        let mut cuts = known.cloned().unwrap_or_default();
        cuts.take(sheet.state());
        body.loose = unused(body);
        let heated = ThermalDamage::known(scene, body.entity, of.taken as usize);
        let (areas, cuts_changed) = (areas(&sheet), known.is_none());
        Ok(Some(Self { sheet, cuts, of, heated, failure_criteria, burns, areas, cuts_changed }))
    }

    /// Reads and writes of a controller of divisible membranes.
    pub fn access(access: Access, bodies: &[Entity]) -> Access {
        let all = || EntitySet::Of(bodies.to_vec());
        thermal_damage::access(access, bodies).writes::<SurfaceElements>(all()).writes::<Cuts>(all())
    }

    /// Whether blades cut it.
    #[must_use]
    pub fn is_cut(&self) -> bool {
        self.failure_criteria.cut
    }

    /// The mesh.
    #[must_use]
    pub fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    /// Thermal damage of each present triangle.
    #[must_use]
    pub fn alterations(&self) -> Vec<Alteration> {
        if self.heated.coagulated.is_empty() {
            return Vec::new();
        }
        self.of.elements.iter().map(|&element| self.heated.alteration(element)).collect()
    }

    /// The local patch that a solver has to update.
    pub fn follow<R>(&self, parted: &MembraneChange, follow: impl FnOnce(&ChangedMesh<'_, 3>) -> R) -> R {
        let altered = |triangle: u32| {
            let element = self.of.elements.get(triangle as usize);
            element.map_or(Alteration::NONE, |&element| self.heated.alteration(element))
        };
        follow(&ChangedMesh {
            rest: self.sheet.rest(),
            elements: self.sheet.triangles(),
            altered: &altered,
            about: &|vertex| self.sheet.about(vertex),
            stale: &parted.stale,
        })
    }

    /// Applies the topology changes of this tick; updates the body.
    ///
    /// # Errors
    /// Why it cannot continue.
    pub fn reshape(
        &mut self,
        positions: &[Point3<f64>],
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Option<MembraneChange>, String> {
        let (gone, changed) = self.heated.take_changes(site.scene, body.entity);
        let mut stale = Vec::new();
        let kept = (!gone.is_empty()).then(|| self.take_out(&gone, &mut stale));
        let change = self.part(positions, site)?;
        if kept.is_none() && change.is_empty() && changed.is_empty() {
            return Ok(None);
        }
        stale.extend(&change.stale);
        self.altered(&changed, &mut stale);
        stale.sort_unstable();
        stale.dedup();
        if kept.is_none() && change.is_empty() {
            return Ok(Some(MembraneChange { change, stale, reshaped: None }));
        }
        self.areas = areas(&self.sheet);
        self.cuts.take(self.sheet.state());
        self.cuts_changed = true;
        body.triangles = Arc::new(self.sheet.triangles().to_vec());
        out.put(body.entity, SurfaceMesh { triangles: body.triangles.clone() });
        if !change.is_empty() {
            self.grow(&change, &stale, body, site, out);
        }
        for &vertex in &stale {
            body.is_loose(vertex, self.sheet.about(vertex).is_empty());
        }
        if self.burns {
            self.of.taken = self.heated.removed.len() as u32;
            out.put(body.entity, self.of.clone());
        }
        let reshaped = Some(SurfaceChange { kept, parents: change.triangles.clone() });
        Ok(Some(MembraneChange { change, stale, reshaped }))
    }

    /// Adds the corners of triangles that are parts of these elements.
    fn altered(&self, changed: &[CoagulatedElement], stale: &mut Vec<u32>) {
        if changed.is_empty() {
            return;
        }
        for (corners, element) in self.sheet.triangles().iter().zip(self.of.elements.iter()) {
            if changed.binary_search_by_key(element, |of| of.element).is_ok() {
                stale.extend(corners);
            }
        }
    }

    /// Cuts where blades have swept, or else tears where overstretched. A tear propagates from tick to tick.
    fn part(&mut self, positions: &[Point3<f64>], site: &StepContext<'_>) -> Result<TopologyChange, String> {
        let mut change = TopologyChange::default();
        if self.failure_criteria.cut {
            let sweeps = self.cuts.sweeps(site.scene, site.world_from_body, &mut self.cuts_changed);
            if !sweeps.is_empty() {
                change = self.sheet.cut(positions, &sweeps).map_err(|error| error.to_string())?;
            }
        }
        if let Some(stretch) = self.failure_criteria.tears_at.filter(|_| change.is_empty()) {
            change = self.sheet.tear(positions, stretch).map_err(|error| error.to_string())?;
        }
        self.cuts.length += change.length;
        Ok(change)
    }

    /// Adds new vertices and halves of triangles.
    fn grow(
        &mut self,
        change: &TopologyChange,
        stale: &[u32],
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) {
        let vertices = body.rest.len();
        change.carry(Arc::make_mut(&mut body.positions), |a, b, share| a + (b - a) * share);
        change.carry(Arc::make_mut(&mut body.velocities), |a, b, share| a + (b - a) * share);
        change.carry_triangles(Arc::make_mut(&mut self.of.elements));
        Arc::make_mut(&mut self.of.births).extend(change.vertices.iter().filter_map(|what| match *what {
            VertexChange::Between { edge, share } => Some(NodeOrigin { of: edge, share }),
            VertexChange::Copy { of } => Some(NodeOrigin { of: [of; 2], share: 0.0 }),
            VertexChange::Moved { .. } => None,
        }));
        body.rest = Arc::new(self.sheet.rest().to_vec());
        // A restarted controller finds the same ones.
        body.anchor_again(stale);
        body.changed_topology();
        if let Some(texture) = site.scene.get::<TextureCoordinates>(body.entity) {
            let mut uv = texture.uv.to_vec();
            if uv.len() == vertices {
                change.carry(&mut uv, |a, b, share| a + (b - a) * share);
            }
            out.put(body.entity, TextureCoordinates { uv: Arc::new(uv) });
        }
    }

    /// Removes triangles; returns the new number of each remaining one, and adds the corners of the removed ones.
    fn take_out(&mut self, gone: &[u32], stale: &mut Vec<u32>) -> Vec<Option<u32>> {
        let gone: BTreeSet<u32> = gone.iter().copied().collect();
        for (corners, element) in self.sheet.triangles().iter().zip(self.of.elements.iter()) {
            if gone.contains(element) {
                stale.extend(corners);
            }
        }
        let elements = self.of.elements.clone();
        let kept = self.sheet.take_out(|triangle| gone.contains(&elements[triangle as usize]));
        self.of.elements = Arc::new(elements.iter().copied().filter(|of| !gone.contains(of)).collect());
        kept
    }

    /// Writes the state that a restart needs.
    pub fn publish(&mut self, body: &Deformable, out: &mut Commands) {
        if std::mem::take(&mut self.cuts_changed)
            && (self.failure_criteria.cut || self.failure_criteria.tears_at.is_some())
        {
            out.put(body.entity, self.cuts.clone());
        }
    }

    /// Measures of the cuts and tears.
    pub fn measure(&self, measures: &mut Measures<'_>) {
        measures.put("pieces", self.areas.len() as f64);
        measures.put("cut_area_m2", self.areas.get(1).copied().unwrap_or(0.0));
        measures.put("cut_length_m", self.cuts.length);
    }
}

/// Areas of the pieces of a sheet, the largest first \[m²\].
fn areas(sheet: &Sheet) -> Vec<f64> {
    let mut areas: BTreeMap<u32, f64> = BTreeMap::new();
    for (piece, corners) in sheet.pieces().iter().zip(sheet.triangles()) {
        let [a, b, c] = corners.map(|vertex| sheet.rest()[vertex as usize]);
        *areas.entry(*piece).or_default() += 0.5 * (b - a).cross(&(c - a)).norm();
    }
    let mut areas: Vec<f64> = areas.into_values().collect();
    areas.sort_by(|a, b| b.total_cmp(a));
    areas
}

/// Vertices that no triangle uses, ascending.
fn unused(body: &Deformable) -> Vec<u32> {
    let mut used = vec![false; body.rest.len()];
    body.triangles.iter().flatten().for_each(|&node| used[node as usize] = true);
    (0..used.len() as u32).filter(|&node| !used[node as usize]).collect()
}
