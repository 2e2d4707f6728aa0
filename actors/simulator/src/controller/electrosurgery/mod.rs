//! The controller of electrosurgery: electrodes at instrument tips heat, coagulate and ablate tissue.
//!
//! Temperatures and burns are written to the body's vertices, for the edit map. The controller that moves the body
//! reads which elements were removed ([`RemovedElements`]) and which are stiffer and shorter ([`CoagulatedElements`]),
//! and removes them from the surface; for a static body this controller does it. Heat is computed on the rest shape: an
//! electrode's position is mapped there.

pub mod plume;
pub(crate) mod remesh;

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::frozen::{FrozenPart, RejectedBody, freeze};
use trocar_dynamics::tet_mesh::NodeOrigin;
use trocar_scene::disjoint_sets::DisjointSets;
use trocar_scene::mesh::TetData;
use trocar_scene::soft_body::one_of;
use trocar_scene::{
    Access, Activation, ActivationMode, BuildContext, Burn, Commands, Component, Controller, ControllerError,
    Entity, EntitySet, Frozen, HeatFrozen, Measured, Pose, RecordPolicy, RestPositions, Snapshot,
    SurfaceMesh, Temperature, TetMesh, Tick, VertexPositions,
};

use super::cauterised::{CauterisedBody, ElectrodeTip};
use super::cutting::membrane::SurfaceElements;
use super::cutting::volume::VolumeCuts;
use super::rest_position::rest_place;
use super::thermal_damage::{CoagulatedElement, CoagulatedElements, RemovedElements};
use crate::electrosurgery::{
    Contact, Electrode, Electrosurgery, ElectrosurgeryState, LatticeConfig, Mode, Tissue, shares,
};
use plume::Plume;
use remesh::{PartedMesh, births};

/// Ticks between two saved states (removals are saved at once), and between two checks for cuts, after which heat is
/// transferred to the new mesh.
const STATE_EVERY: u64 = 10;
/// Relative change of an element's stiffness, with respect to its original one, that is worth a new factorisation.
const COAGULATED_CHANGE: f64 = 0.05;

/// Damage integral Ω that stands for denatured tissue (all but 0.005 % of it) and for char: a third-degree burn
/// (Henriques and Moritz, *Studies of thermal injury*, 1947).
const DENATURED: f64 = 10.0;
const CHARRED: f64 = 1e4;

/// State for a restart. Too large to be recorded; it is derived from recorded data.
#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "heat_state", record = RecordPolicy::Derived)]
pub struct HeatState {
    /// The surface of the first mesh.
    pub triangles: Arc<Vec<[u32; 3]>>,
    /// Rest positions of the first mesh \[m\].
    pub rest: Arc<Vec<Point3<f64>>>,
    /// State of the tissue.
    pub state: Arc<ElectrosurgeryState>,
}

struct Body {
    body: Deformable,
    kind: CauterisedBody,
    tissue: Electrosurgery,
    triangles: Arc<Vec<[u32; 3]>>,
    removed: Vec<u32>,
    coagulated: Arc<Vec<CoagulatedElement>>,
    /// Whether a controller moves it: that one then owns its surface, and decides whether it is frozen.
    is_moved: bool,
    plume: Plume,
    volume_removed: f64,
    hottest: f64,
    /// Surface area of the first mesh, and of the current pieces \[m²\].
    area_before: f64,
    areas: Vec<f64>,
    frozen: bool,
    /// Number of vertices added by cuts that the heat solver has.
    births: usize,
    /// Electrodes active on it in this tick.
    electrodes: Vec<Electrode>,
}

impl Body {
    fn read(scene: &Snapshot, entity: Entity, kind: CauterisedBody) -> Result<Self, ControllerError> {
        let mut body = Deformable::read(scene, entity)?;
        // The first mesh, whatever was cut later.
        if let Some(cuts) = scene.get::<VolumeCuts>(entity) {
            body.tets = Arc::new(cuts.first_tets(body.rest.len(), &body.tets));
            let count = body.rest.len().saturating_sub(cuts.births.len());
            body.rest = Arc::new(body.rest[..count].to_vec());
            let volume = TetData { positions: Vec::new(), tets: body.tets.to_vec(), tags: Vec::new() };
            body.triangles = Arc::new(volume.boundary_triangles());
        }
        let known = scene.get::<HeatState>(entity);
        if let Some(known) = known {
            // Cuts may have moved some vertices of a membrane.
            body.rest = known.rest.clone();
        }
        let body = body;
        let wrong = |what: String| ControllerError::Scene(format!("'{}': {what}", body.name));
        let triangles = known.map_or_else(|| body.triangles.clone(), |known| known.triangles.clone());
        let tissue = match kind.thickness {
            Some(thickness) => Tissue::Membrane { positions: &body.rest, triangles: &triangles, thickness },
            None => Tissue::Volume { positions: &body.rest, tets: &body.tets },
        };
        if tissue.element_count() == 0 {
            let what =
                if kind.thickness.is_some() { "surface" } else { "volume; a membrane has a 'thickness'" };
            return Err(wrong(format!("'cauterised' needs a mesh with a {what}")));
        }
        let material = kind.material();
        let lattice = LatticeConfig { spacing: kind.spacing, ..LatticeConfig::default() };
        let membrane = kind.thickness.map(|thickness| (thickness, triangles.as_slice()));
        // For a membrane without a known first mesh, this is the first mesh.
        let is_first = kind.thickness.is_some() && known.is_none();
        let parted = if is_first { Ok(None) } else { PartedMesh::read(scene, entity, membrane) };
        let parted = parted.map_err(wrong)?;
        let parted = parted.as_ref().map(PartedMesh::parted);
        let heated = match known {
            Some(known) => {
                Electrosurgery::restore_parted(&tissue, parted.as_ref(), material, lattice, &known.state)
            }
            None => Electrosurgery::new(&tissue, material, lattice).and_then(|mut heated| {
                parted.as_ref().map_or(Ok(()), |parted| heated.part(parted))?;
                Ok(heated)
            }),
        };
        let births = births(scene, entity).map_or(0, |births| births.len());
        let tissue = heated.map_err(|error| wrong(error.to_string()))?;
        let removed = known.map(|known| known.state.removed.clone()).unwrap_or_default();
        let is_moved = is_moved(scene, entity).map_err(wrong)?;
        let frozen =
            scene.get::<HeatFrozen>(entity).is_some() || (!is_moved && scene.get::<Frozen>(entity).is_some());
        let plume = scene.get::<Plume>(entity).copied().unwrap_or_default();
        let coagulated = scene.get::<CoagulatedElements>(entity).cloned().unwrap_or_default().elements;
        let area_before = pieces(&triangles, &body.rest).iter().sum();
        let (volume_removed, hottest, areas) = (0.0, 0.0, Vec::new());
        let mut this = Self {
            body,
            kind,
            tissue,
            triangles,
            removed,
            coagulated,
            is_moved,
            plume,
            volume_removed,
            hottest,
            area_before,
            areas,
            frozen,
            births,
            electrodes: Vec::new(),
        };
        this.areas = pieces(&this.surface(), &this.body.rest);
        Ok(this)
    }

    /// Transfers heat to the mesh that cuts since the last check have made.
    fn part(&mut self, tick: &Tick<'_>, scene: &Snapshot) -> Result<(), String> {
        let entity = self.body.entity;
        let born = births(scene, entity).map_or(0, |births| births.len());
        if born == self.births || !tick.number.is_multiple_of(STATE_EVERY) {
            return Ok(());
        }
        self.births = born;
        let membrane = self.kind.thickness.map(|thickness| (thickness, self.triangles.as_slice()));
        match PartedMesh::read(scene, entity, membrane)? {
            Some(mesh) => self.tissue.part(&mesh.parted()).map_err(|error| error.to_string()),
            None => Ok(()),
        }
    }

    /// Its surface without removed elements.
    fn surface(&self) -> Vec<[u32; 3]> {
        let gone = self.tissue.removed();
        if self.kind.thickness.is_some() {
            let all = self.triangles.iter().enumerate();
            return all.filter(|(index, _)| !gone[*index]).map(|(_, triangle)| *triangle).collect();
        }
        let left = self.body.tets.iter().enumerate().filter(|(index, _)| !gone[*index]);
        let tets = left.map(|(_, tet)| *tet).collect();
        TetData { positions: Vec::new(), tets, tags: Vec::new() }.boundary_triangles()
    }

    fn write(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) {
        let vertices = 0..self.tissue.vertex_count() as u32;
        let (mut celsius, mut omega): (Vec<f64>, Vec<f64>) =
            vertices.filter_map(|vertex| self.tissue.vertex(vertex)).unzip();
        // Above complete denaturation Ω carries no information; char is stored in the lattice.
        for (vertex, omega) in omega.iter_mut().enumerate() {
            let is_charred = self.tissue.is_charred(vertex as u32);
            *omega = if is_charred { omega.max(CHARRED) } else { omega.min(DENATURED) };
        }
        // Vertices added since the last check: duplicates take their parent's temperature, others interpolate.
        if let (Some(births), Some(rest)) =
            (births(scene, self.body.entity), scene.get::<RestPositions>(self.body.entity))
        {
            let first = rest.positions.len().saturating_sub(births.len());
            let known = celsius.len().saturating_sub(first).min(births.len());
            grow(&births[known..], [&mut celsius, &mut omega]);
        }
        out.put(self.body.entity, Temperature { celsius: Arc::new(celsius) });
        out.put(self.body.entity, Burn { omega: Arc::new(omega) });
        let went = !self.tissue.removed_in_step().is_empty();
        if went {
            let surface = self.surface();
            self.areas = pieces(&surface, &self.body.rest);
            if !self.is_moved {
                out.put(self.body.entity, SurfaceMesh { triangles: Arc::new(surface) });
            }
            out.put(self.body.entity, RemovedElements { elements: Arc::new(self.removed.clone()) });
        }
        if self.is_moved && (went || tick.number.is_multiple_of(STATE_EVERY)) && self.coagulates() {
            out.put(self.body.entity, CoagulatedElements { elements: self.coagulated.clone() });
        }
        if went || tick.number.is_multiple_of(STATE_EVERY) {
            let state = Arc::new(self.tissue.state());
            out.put(
                self.body.entity,
                HeatState { triangles: self.triangles.clone(), rest: self.body.rest.clone(), state },
            );
        }
    }

    /// Updates the coagulated elements; returns whether the change is worth publishing.
    fn coagulates(&mut self) -> bool {
        let elements = 0..self.tissue.removed().len() as u32;
        let now: Vec<CoagulatedElement> = elements
            .filter_map(|element| {
                let factors = self.tissue.factors(element);
                let is_changed = factors.stiffness > 1.0 + COAGULATED_CHANGE && !factors.is_removed;
                is_changed.then_some(CoagulatedElement {
                    element,
                    stiffness: factors.stiffness,
                    length: factors.length,
                })
            })
            .collect();
        let same = now.len() == self.coagulated.len()
            && now.iter().zip(self.coagulated.iter()).all(|(now, before)| {
                now.element == before.element && (now.stiffness - before.stiffness).abs() < COAGULATED_CHANGE
            });
        if !same {
            self.coagulated = Arc::new(now);
        }
        !same
    }

    /// Maps a point in the body's frame to the rest shape.
    fn at_rest(&self, place: &Point3<f64>, scene: &Snapshot) -> Point3<f64> {
        let entity = self.body.entity;
        let (Some(now), Some(rest), Some(surface)) = (
            scene.get::<VertexPositions>(entity),
            scene.get::<RestPositions>(entity),
            scene.get::<SurfaceMesh>(entity),
        ) else {
            return *place;
        };
        rest_place(place, &surface.triangles, &now.positions, &rest.positions)
    }

    fn measure(&self, values: &mut BTreeMap<String, f64>) {
        let name = &self.body.name;
        let ledger = self.tissue.ledger();
        let mut put = |what: &str, value: f64| values.insert(format!("{name}.{what}"), value);
        put("heat_supplied_j", ledger.supplied);
        put("heat_missing_share", ledger.missing(self.tissue.stored()).abs() / ledger.supplied.max(1e-9));
        put("removed_volume_m3", self.volume_removed);
        put("removed_elements", self.removed.len() as f64);
        put("hottest_celsius", self.hottest);
        put("smoke_kg", self.plume.emitted);
        put("heat_frozen", f64::from(u8::from(self.frozen)));
        let (cells, area) = self.tissue.char();
        put("charred_cells", cells as f64);
        put("charred_area_m2", area);
        put("coagulated_elements", self.coagulated.len() as f64);
        put("pieces", self.areas.len() as f64);
        put("largest_piece_share", self.areas.first().unwrap_or(&0.0) / self.area_before.max(1e-12));
    }
}

/// Interpolates vertex values of the first mesh to the added vertices.
fn grow(births: &[NodeOrigin], values: [&mut Vec<f64>; 2]) {
    for values in values {
        births.iter().for_each(|birth| values.push(birth.mix(values, |a, b, share| a + (b - a) * share)));
    }
}

/// Whether a method moves a body; an error if that method does not support removed elements.
fn is_moved(scene: &Snapshot, entity: Entity) -> Result<bool, String> {
    match scene.soft_body(entity) {
        Some((method, of)) if !of.loses_elements => {
            let valid = one_of(&scene.registry().soft_bodies_that(|of| of.loses_elements));
            Err(format!(
                "it is 'cauterised' and moved by '{method}', which burns no elements; valid: {valid}"
            ))
        }
        moved => Ok(moved.is_some()),
    }
}

/// Areas of the connected parts of a surface, largest first \[m²\].
fn pieces(triangles: &[[u32; 3]], positions: &[Point3<f64>]) -> Vec<f64> {
    let mut parts = DisjointSets::new(positions.len());
    for &[a, b, c] in triangles {
        parts.join(a as usize, b as usize);
        parts.join(a as usize, c as usize);
    }
    let mut areas: BTreeMap<usize, f64> = BTreeMap::new();
    for triangle in triangles {
        let [a, b, c] = triangle.map(|vertex| positions[vertex as usize]);
        let area = 0.5 * (b - a).cross(&(c - a)).norm();
        *areas.entry(parts.root(triangle[0] as usize)).or_default() += area;
    }
    let mut areas: Vec<f64> = areas.into_values().collect();
    areas.sort_by(|a, b| b.total_cmp(a));
    areas
}

/// Heats every body that carries [`CauterisedBody`]. Only one such controller is allowed: a second one would write the
/// same temperatures.
pub struct ElectrosurgeryController {
    bodies: Vec<Body>,
    /// Contact of the current electrode with each body.
    contacts: Vec<Contact>,
    refused: Vec<RejectedBody>,
}

impl ElectrosurgeryController {
    /// Reads the bodies, and resumes their state from the scene.
    ///
    /// # Errors
    /// The name of the body, and what is wrong with it.
    pub fn new(context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let (mut bodies, mut refused) = (Vec::new(), Vec::new());
        for entity in Deformable::carriers::<CauterisedBody>(context.scene) {
            let Some(kind) = context.scene.get::<CauterisedBody>(entity).copied() else { continue };
            let mut body = match Body::read(context.scene, entity, kind) {
                Ok(body) => body,
                Err(error) => {
                    refused.push(RejectedBody::of(context, entity, FrozenPart::Heat, error)?);
                    continue;
                }
            };
            if let Some(before) = context.scene.get::<Measured>(context.me) {
                let of = |what: &str| before.values.get(&format!("{}.{what}", body.body.name)).copied();
                (body.volume_removed, body.hottest) =
                    (of("removed_volume_m3").unwrap_or_default(), of("hottest_celsius").unwrap_or_default());
            }
            bodies.push(body);
        }
        if bodies.is_empty() && refused.is_empty() {
            return Err(ControllerError::Scene("electrosurgery: no entity is 'cauterised'".into()));
        }
        Ok(Self { bodies, contacts: Vec::new(), refused })
    }

    /// Finds the active electrodes at each body; a tip at several bodies splits the generator's power.
    fn switch_on(&mut self, scene: &Snapshot) {
        self.bodies.iter_mut().for_each(|body| body.electrodes.clear());
        for (entity, tip) in scene.iter::<ElectrodeTip>() {
            let Activation { level, mode, .. } = scene.get::<Activation>(entity).copied().unwrap_or_default();
            let mode = match mode {
                Some(ActivationMode::Cut) => Mode::Cut,
                Some(ActivationMode::Coagulate) => Mode::Coagulate,
                None if tip.coagulates => Mode::Coagulate,
                None => Mode::Cut,
            };
            if level <= 0.0 {
                continue;
            }
            let tip_in_world = Point3::from(scene.world_pose(entity).translation.vector);
            self.contacts.clear();
            for body in &mut self.bodies {
                let tip_in_body = scene.world_pose(body.body.entity).inverse() * tip_in_world;
                // Its contact does not depend on its power.
                let electrode = Electrode {
                    tip_in_rest: body.at_rest(&tip_in_body, scene),
                    power: 0.0,
                    mode,
                    contact_area: tip.contact_area,
                };
                let contact = if body.frozen { Contact::NONE } else { body.tissue.contact(&electrode) };
                self.contacts.push(contact);
                body.electrodes.push(electrode);
            }
            // A body without contact gets no electrode, so an invalid contact fails only the body that it concerns.
            for (body, share) in self.bodies.iter_mut().zip(shares(&self.contacts)) {
                match body.electrodes.last_mut() {
                    Some(electrode) if share > 0.0 => electrode.power = tip.power * level * share,
                    _ => {
                        body.electrodes.pop();
                    }
                }
            }
        }
    }
}

impl Controller for ElectrosurgeryController {
    fn access(&self) -> Access {
        let refused = self.refused.iter().map(|body| body.entity);
        let bodies: Vec<Entity> = self.bodies.iter().map(|body| body.body.entity).chain(refused).collect();
        let all = || EntitySet::Of(bodies.clone());
        let still = self.bodies.iter().filter(|body| !body.is_moved).map(|body| body.body.entity);
        let still: Vec<Entity> = still.collect();
        Access::new()
            .reads::<CauterisedBody>()
            .reads::<ElectrodeTip>()
            .reads::<Activation>()
            .reads::<Pose>()
            .writes::<Temperature>(all())
            .writes::<Burn>(all())
            .reads::<VertexPositions>()
            .reads::<RestPositions>()
            .reads::<VolumeCuts>()
            .reads::<TetMesh>()
            .reads::<SurfaceElements>()
            .reads::<SurfaceMesh>()
            .writes::<SurfaceMesh>(EntitySet::Of(still.clone()))
            .writes::<Frozen>(EntitySet::Of(still))
            .reads::<HeatFrozen>()
            .writes::<HeatFrozen>(all())
            .writes::<CoagulatedElements>(all())
            .writes::<RemovedElements>(all())
            .writes::<HeatState>(all())
            .writes::<Plume>(all())
            .writes::<Measured>(EntitySet::Own)
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let mut measured = Measured::default();
        self.switch_on(scene);
        for body in &mut self.bodies {
            if !body.frozen {
                let parted = body.part(tick, scene);
                let stepped = parted.and_then(|()| {
                    let stepped = body.tissue.step(tick.period.as_secs_f64(), &body.electrodes);
                    stepped.map_err(|error| error.to_string())
                });
                match stepped {
                    Ok(report) => {
                        body.volume_removed += report.removed_volume;
                        body.hottest = body.hottest.max(report.hottest);
                        body.removed.extend_from_slice(body.tissue.removed_in_step());
                        if let Some(place) = body.tissue.plume_in_rest() {
                            let more = report.smoke_rate * tick.period.as_secs_f64();
                            body.plume = Plume { emitted: body.plume.emitted + more, place };
                            out.put(body.body.entity, body.plume);
                        }
                        body.write(tick, scene, out);
                    }
                    Err(error) => {
                        body.frozen = true;
                        if body.is_moved {
                            // The controller that moves it decides about its motion; only its heating stops.
                            freeze(body.body.entity, FrozenPart::Heat, error, tick, out);
                        } else {
                            body.body.freeze(&error, tick, out);
                        }
                    }
                }
            }
            body.measure(&mut measured.values);
        }
        self.refused.iter_mut().for_each(|body| body.report(tick, &mut measured, out));
        out.put(tick.me, measured);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_a_surface_that_share_no_vertex_are_pieces() {
        let points: Vec<Point3<f64>> =
            (0..8).map(|k| Point3::new(f64::from(k), f64::from(k * k), 0.0)).collect();
        let area = |triangle: [u32; 3]| pieces(&[triangle], &points)[0];
        assert!(pieces(&[], &points).is_empty());
        let two = pieces(&[[0, 1, 2], [2, 3, 4], [5, 6, 7]], &points);
        assert_eq!(two, [area([0, 1, 2]) + area([2, 3, 4]), area([5, 6, 7])]);
        assert_eq!(pieces(&[[0, 1, 2], [5, 6, 7], [4, 7, 2]], &points).len(), 1);
    }
}
