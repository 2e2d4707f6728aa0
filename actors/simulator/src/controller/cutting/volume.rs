//! Topology changes of volumes: elements that heat removes, faces that blades open, tears.
//!
//! Elements keep their numbers, including removed ones; of a split element one half keeps it. New nodes and elements
//! are numbered after all others. The solver is notified; surface, grasps and textures follow. Thermal damage refers to
//! elements of the first mesh, and holds for all parts of each.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::elasticity::{Alteration, cauchy_stress, small_stress};
use trocar_dynamics::particles::State;
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::coupling::CoupledBody;
use trocar_dynamics::soft_body::method::{Measures, StepContext, SurfaceChange};
use trocar_dynamics::tet_mesh::{
    self, MeshRules, NodeMotion, NodeOrigin, OpenCut, TetFace, Volume, VolumeChange, VolumeError, shape,
};
use trocar_scene::{
    Access, Commands, Component, ComponentError, Entity, EntitySet, Snapshot, SurfaceMesh, TetMesh,
    TextureCoordinates,
};

use super::scissors::{Blades, swept};
use crate::controller::cauterised::CauterisedBody;
use crate::controller::thermal_damage::{self, CoagulatedElement, RemovedElements, ThermalDamage};

/// State of a volume's topology changes that its mesh does not contain.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VolumeCuts {
    /// Opened interior faces.
    pub opened: Arc<Vec<TetFace>>,
    /// Origins of the nodes added since the first mesh, in order.
    pub births: Arc<Vec<NodeOrigin>>,
    /// For each added element, the element that it is a part of.
    pub parts_of: Arc<Vec<u32>>,
    /// The elements of the first mesh, if some have been split.
    pub first: Arc<Vec<[u32; 4]>>,
    /// Unfinished cuts.
    pub slit: OpenCut,
    /// How many of the elements removed by heat have been taken out.
    pub taken: u32,
    /// How many of the opened faces tore.
    pub torn: u32,
    /// Previous blades of all scissors, in the frame of the body.
    pub blades: Vec<Blades>,
}
impl Component for VolumeCuts {
    const NAME: &'static str = "volume_cuts";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}

impl VolumeCuts {
    /// Checks the state against a mesh with this many nodes and elements.
    ///
    /// # Errors
    /// The part that does not match.
    pub(crate) fn fits(&self, nodes: usize, tets: usize) -> Result<(), String> {
        let first = (nodes.checked_sub(self.births.len()), tets.checked_sub(self.parts_of.len()));
        let (Some(first_node), Some(first_tet)) = first else {
            let (births, parts) = (self.births.len(), self.parts_of.len());
            return Err(format!(
                "its 'volume_cuts' tell of {births} new nodes of {nodes} and {parts} parts of {tets} elements"
            ));
        };
        let mut births = (first_node..).zip(self.births.iter());
        if let Some((node, birth)) =
            births.find(|(node, birth)| birth.of.iter().any(|&of| of as usize >= *node))
        {
            return Err(format!(
                "its 'volume_cuts' let node {node} come from nodes {:?}: only ones before it are valid",
                birth.of
            ));
        }
        if let Some(of) = self.parts_of.iter().find(|of| **of as usize >= first_tet) {
            return Err(format!(
                "its 'volume_cuts' name a part of element {of}: the first mesh has elements 0 to {}",
                first_tet.saturating_sub(1)
            ));
        }
        if !(self.first.is_empty() || self.first.len() == first_tet) {
            let given = self.first.len();
            return Err(format!(
                "its 'volume_cuts' have a first mesh of {given} elements, not of {first_tet}"
            ));
        }
        Ok(())
    }

    /// The elements of the first mesh, given the current ones.
    #[must_use]
    pub fn first_tets(&self, nodes: usize, tets: &[[u32; 4]]) -> Vec<[u32; 4]> {
        if !self.first.is_empty() {
            return self.first.to_vec();
        }
        let count = nodes.saturating_sub(self.births.len());
        let origin = |mut node: u32| {
            while let Some(birth) = (node as usize).checked_sub(count).and_then(|at| self.births.get(at)) {
                node = birth.of[0];
            }
            node
        };
        tets.iter().map(|tet| tet.map(origin)).collect()
    }
}

/// Interface of a solver whose elements can be removed, damaged and separated.
pub trait Elements {
    /// Node positions \[m\].
    fn positions(&self) -> &[Point3<f64>];
    /// Node velocities \[m/s\].
    fn velocities(&self) -> &[Vector3<f64>];
    /// Whether the nodes are in equilibrium after the last topology change: else nothing tears yet.
    fn can_tear(&self) -> bool {
        true
    }
    /// Removes elements.
    ///
    /// # Errors
    /// Why the solver cannot continue without them.
    fn remove(&mut self, elements: &[u32]) -> Result<(), String>;
    /// Sets stiffness and rest length of damaged elements.
    ///
    /// # Errors
    /// Why the solver cannot continue.
    fn alter(&mut self, elements: &[CoagulatedElement]) -> Result<(), String>;
    /// Continues with the body's new nodes and elements.
    ///
    /// # Errors
    /// Why the solver cannot continue.
    fn split(&mut self, body: &Deformable, split: &Split<'_>) -> Result<(), String>;
}

/// A topology change with new nodes.
#[derive(Clone, Copy)]
pub struct Split<'a> {
    /// Origins of the new nodes.
    pub born: &'a [NodeOrigin],
    /// Elements with changed corners and new elements; ascending, without removed ones.
    pub changed: &'a [u32],
    /// Thermal damage of a present element.
    pub altered: &'a dyn Fn(u32) -> Alteration,
    /// All thermal damage, by current elements.
    pub heated: &'a dyn Fn() -> ThermalDamage,
}

impl Split<'_> {
    /// Sets the state of the new nodes.
    pub fn carry(&self, state: &mut State) {
        for birth in self.born {
            state.positions.push(birth.mix(&state.positions, |a, b, share| a + (b - a) * share));
            state.velocities.push(birth.mix(&state.velocities, |a, b, share| a + (b - a) * share));
        }
    }
}

/// Cutting and tearing criteria of a volume.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FailureCriteria {
    /// Whether blades cut it.
    pub cut: bool,
    /// Whether a cut splits elements along the blade's path; else it opens faces between elements.
    pub halves: bool,
    /// Whether pieces connected only by nodes stay: the solver cannot let them fall.
    pub hangs_on: bool,
    /// Tensile strength \[Pa\], and Lamé's constants \[Pa\] for the stress.
    pub tears: Option<(f64, [f64; 2])>,
    /// Whether its stress is that of linear elasticity.
    pub is_linear: bool,
}

/// A divisible volume and its topology changes.
pub struct DivisibleVolume {
    volume: Volume,
    failure_criteria: FailureCriteria,
    /// The face of each surface triangle.
    faces: Vec<TetFace>,
    /// Thermal damage, by elements of the first mesh.
    heated: ThermalDamage,
    cuts: VolumeCuts,
    /// Parts of split elements of the first mesh, without the parts that kept the number.
    parts: BTreeMap<u32, Vec<u32>>,
    pieces: usize,
    /// Inverse rest-edge matrices; needed for tearing.
    inverse_shapes: Vec<Matrix3<f64>>,
    cuts_changed: bool,
}

impl DivisibleVolume {
    /// For a body of the scene, if it is divisible; marks the body's unused vertices.
    ///
    /// # Errors
    /// What is wrong with its mesh.
    pub fn new(
        body: &mut Deformable,
        failure_criteria: FailureCriteria,
        scene: &Snapshot,
    ) -> Result<Option<Self>, String> {
        let known = scene.get::<VolumeCuts>(body.entity).cloned();
        let burns = scene.get::<CauterisedBody>(body.entity);
        if burns.is_some_and(|burns| burns.thickness.is_some()) {
            return Err("it moves as a volume: 'cauterised' has no 'thickness' then".into());
        }
        let heats = burns.is_some() || scene.get::<RemovedElements>(body.entity).is_some();
        if !(failure_criteria.cut || failure_criteria.tears.is_some() || heats || known.is_some()) {
            return Ok(None);
        }
        let rules = MeshRules { mean_ratio_min: 0.0, coincident_within: None };
        let mesh =
            tet_mesh::TetMesh::new(&body.rest, &body.tets, &rules).map_err(|error| error.to_string())?;
        let mut volume = Volume::new(&mesh);
        let cuts = known.unwrap_or_default();
        cuts.fits(body.rest.len(), body.tets.len())?;
        let mut parts: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        let first = body.tets.len().saturating_sub(cuts.parts_of.len()) as u32;
        cuts.parts_of.iter().zip(first..).for_each(|(of, part)| parts.entry(*of).or_default().push(part));
        // Their nodes are duplicated already, where necessary.
        volume.open(&cuts.opened).map_err(|error| error.to_string())?;
        let heated = ThermalDamage::known(scene, body.entity, cuts.taken as usize);
        let there = all_parts(&parts, &heated.removed).filter(|&tet| volume.tet(tet).is_some());
        let there: Vec<u32> = there.collect();
        volume.take_out(&there).map_err(|error| error.to_string())?;
        body.loose = volume.orphans();
        body.is_parted = !cuts.births.is_empty();
        let inverse_shapes = mesh.inverse_shapes().to_vec();
        let faces = faces_of(&volume, &body.triangles)
            .ok_or("its surface is not that of its volume: what comes apart needs the mesh of one")?;
        let pieces = volume.pieces();
        let has_grown = |(_, coupled): (Entity, &CoupledBody)| {
            coupled.with.iter().any(|with| with.body == body.name && with.joined.is_some())
        };
        // Joints to its elements would not follow a split.
        let halves = failure_criteria.halves && !scene.iter::<CoupledBody>().any(has_grown);
        let failure_criteria = FailureCriteria { halves, ..failure_criteria };
        Ok(Some(Self {
            volume,
            failure_criteria,
            faces,
            heated,
            cuts,
            parts,
            pieces,
            inverse_shapes,
            cuts_changed: false,
        }))
    }

    /// Reads and writes of a controller of divisible volumes.
    pub fn access(access: Access, bodies: &[Entity]) -> Access {
        let all = || EntitySet::Of(bodies.to_vec());
        thermal_damage::access(access, bodies).writes::<TetMesh>(all()).writes::<VolumeCuts>(all())
    }

    /// All thermal damage, by current elements.
    #[must_use]
    pub fn heated(&self) -> ThermalDamage {
        if self.parts.is_empty() {
            return self.heated.clone();
        }
        let removed = all_parts(&self.parts, &self.heated.removed).collect();
        let mut coagulated: Vec<CoagulatedElement> = self.all_coagulated(&self.heated.coagulated);
        coagulated.sort_unstable_by_key(|of| of.element);
        ThermalDamage { removed: Arc::new(removed), coagulated: Arc::new(coagulated) }
    }

    fn all_coagulated(&self, first: &[CoagulatedElement]) -> Vec<CoagulatedElement> {
        let parts = |of: &CoagulatedElement| {
            let of = *of;
            all_parts(&self.parts, &[of.element])
                .map(|element| CoagulatedElement { element, ..of })
                .collect::<Vec<_>>()
        };
        first.iter().flat_map(parts).collect()
    }

    /// The element of the first mesh that an element is a part of.
    fn origin(&self, tet: u32) -> u32 {
        let first = self.inverse_shapes.len() - self.cuts.parts_of.len();
        (tet as usize).checked_sub(first).map_or(tet, |at| self.cuts.parts_of[at])
    }

    /// Origins of the nodes added since the first mesh.
    #[must_use]
    pub fn births(&self) -> &[NodeOrigin] {
        &self.cuts.births
    }

    /// Whether blades open it.
    #[must_use]
    pub fn is_cut(&self) -> bool {
        self.failure_criteria.cut
    }

    /// Applies the topology changes of this tick.
    ///
    /// # Errors
    /// Why the solver cannot continue.
    pub fn reshape(
        &mut self,
        elements: &mut dyn Elements,
        body: &mut Deformable,
        site: &StepContext<'_>,
        out: &mut Commands,
    ) -> Result<Option<SurfaceChange>, String> {
        let (gone, changed) = self.heated.take_changes(site.scene, body.entity);
        let gone: Vec<u32> =
            all_parts(&self.parts, &gone).filter(|&tet| self.volume.tet(tet).is_some()).collect();
        if !changed.is_empty() {
            elements.alter(&self.all_coagulated(&changed))?;
        }
        let mut change = VolumeChange::default();
        if !gone.is_empty() {
            elements.remove(&gone)?;
            change = self.volume.take_out(&gone).map_err(|error| error.to_string())?;
            // Parts connected by a node or an edge stay so, to avoid rebuilding the solver with every element that
            // burns; pieces connected by nothing else are separated.
            if !self.failure_criteria.hangs_on && self.volume.pieces() > self.pieces {
                self.volume.separate(&mut change);
            }
        }
        let burned = change.uncovered.len();
        let opened = self.open(elements, site, &mut change).map_err(|error| error.to_string())?;
        let parts = !(gone.is_empty() && opened.is_empty() && change.halved.is_empty());
        if std::mem::take(&mut self.cuts_changed) || parts {
            self.cuts.taken = self.heated.removed.len() as u32;
            self.follow(&change, body);
            Arc::make_mut(&mut self.cuts.opened).extend(&opened);
            self.split(elements, body, site, &change, out)?;
            out.put(body.entity, self.cuts.clone());
        }
        if !parts {
            return Ok(None);
        }
        self.pieces = self.volume.pieces();
        body.loose = self.volume.orphans();
        let reshaped = self.uncover(&change, burned);
        body.triangles = Arc::new(self.faces.iter().map(|face| self.corners(face)).collect());
        out.put(body.entity, SurfaceMesh { triangles: body.triangles.clone() });
        Ok(Some(reshaped))
    }

    /// Cuts where blades have swept since the last call, or else tears.
    fn open(
        &mut self,
        elements: &dyn Elements,
        site: &StepContext<'_>,
        change: &mut VolumeChange,
    ) -> Result<Vec<TetFace>, VolumeError> {
        let mut sweeps = Vec::new();
        if self.failure_criteria.cut {
            let before = self.cuts.blades.clone();
            sweeps = swept(&mut self.cuts.blades, site.scene, site.world_from_body);
            self.cuts_changed = !sweeps.is_empty() || self.cuts.blades != before;
        }
        let faces = if sweeps.is_empty() || !self.failure_criteria.halves {
            let mut faces: Vec<TetFace> = Vec::new();
            if change.born.is_empty() {
                let positions = elements.positions();
                for sweep in sweeps {
                    faces.extend(self.volume.swept(positions, &sweep.before, &sweep.after));
                }
                if elements.can_tear() {
                    faces.extend(self.tear(positions));
                }
            }
            faces.sort_unstable();
            faces.dedup();
            faces
        } else {
            // After burning the solver does not have the new nodes yet.
            let period = site.period_secs();
            let moved = elements.velocities().iter().map(|velocity| velocity * period).collect();
            let mut nodes = NodeMotion { positions: elements.positions().to_vec(), moved };
            nodes.follow(&change.born);
            return self.volume.cut(&mut nodes, &sweeps, &mut self.cuts.slit, change);
        };
        if !faces.is_empty() {
            let more = self.volume.open(&faces)?;
            change.uncovered.extend(more.uncovered);
            change.born.extend(more.born);
            change.renamed.extend(more.renamed);
        }
        Ok(faces)
    }

    /// The face to tear: the one with the largest normal stress, if that exceeds the strength. One at a time, so that
    /// the stress around it is relieved before the next.
    fn tear(&mut self, positions: &[Point3<f64>]) -> Option<TetFace> {
        let (strength, lame) = self.failure_criteria.tears?;
        let of = if self.failure_criteria.is_linear { small_stress } else { cauchy_stress };
        let mut stresses = vec![Matrix3::zeros(); self.inverse_shapes.len()];
        for (tet, nodes) in self.volume.tets() {
            let heated = self.heated.of(self.origin(tet));
            let [stiffness, length] = heated.map_or([1.0; 2], |heated| [heated.stiffness, heated.length]);
            let gradient = shape(positions, &nodes) * self.inverse_shapes[tet as usize] / length;
            stresses[tet as usize] = of(lame, &gradient) * stiffness;
        }
        let (face, tension) = self.volume.most_pulled(positions, |tet| stresses[tet as usize])?;
        if tension <= strength {
            return None;
        }
        self.cuts.torn += 1;
        Some(face)
    }

    /// Updates the data of split elements and faces.
    fn follow(&mut self, change: &VolumeChange, body: &Deformable) {
        if change.halved.is_empty() {
            return;
        }
        if self.cuts.first.is_empty() {
            self.cuts.first = Arc::new(self.cuts.first_tets(body.rest.len(), &body.tets));
        }
        let mut opened: BTreeSet<TetFace> = self.cuts.opened.iter().copied().collect();
        for halved in &change.halved {
            let origin = self.origin(halved.tet);
            self.parts.entry(origin).or_default().push(halved.child);
            Arc::make_mut(&mut self.cuts.parts_of).push(origin);
            self.inverse_shapes.push(Matrix3::zeros());
            for (face, half) in halved.faces() {
                if opened.contains(&face) {
                    opened.insert(half);
                }
            }
            let [face, moved] = halved.moved_face();
            if opened.remove(&face) {
                opened.insert(moved);
            }
        }
        for halved in &change.halved {
            for tet in [halved.tet, halved.child] {
                let inverse =
                    self.volume.tet(tet).and_then(|nodes| shape(self.volume.rest(), &nodes).try_inverse());
                self.inverse_shapes[tet as usize] = inverse.unwrap_or_default();
            }
        }
        self.cuts.opened = Arc::new(opened.into_iter().collect());
    }

    /// Adds nodes, and the elements that use them.
    fn split(
        &mut self,
        elements: &mut dyn Elements,
        body: &mut Deformable,
        site: &StepContext<'_>,
        change: &VolumeChange,
        out: &mut Commands,
    ) -> Result<(), String> {
        if change.born.is_empty() {
            return Ok(());
        }
        let texture = site.scene.get::<TextureCoordinates>(body.entity).map(|texture| texture.uv.clone());
        let mut texture = texture.filter(|uv| uv.len() == body.rest.len());
        Arc::make_mut(&mut self.cuts.births).extend(&change.born);
        for birth in &change.born {
            let rest = birth.mix(&body.rest, |a, b, share| a + (b - a) * share);
            Arc::make_mut(&mut body.rest).push(rest);
            let position = birth.mix(&body.positions, |a, b, share| a + (b - a) * share);
            Arc::make_mut(&mut body.positions).push(position);
            let velocity = birth.mix(&body.velocities, |a, b, share| a + (b - a) * share);
            Arc::make_mut(&mut body.velocities).push(velocity);
            if let Some(uv) = &mut texture {
                let own = birth.mix(uv, |a, b, share| a + (b - a) * share);
                Arc::make_mut(uv).push(own);
            }
        }
        let tets = Arc::make_mut(&mut body.tets);
        let halves = change.halved.iter().flat_map(|halved| [halved.tet, halved.child]);
        let mut changed: Vec<u32> = change.renamed.iter().copied().chain(halves).collect();
        changed.retain(|&tet| self.volume.tet(tet).is_some());
        changed.sort_unstable();
        changed.dedup();
        for &tet in &changed {
            let nodes = self.volume.tet(tet).unwrap_or_default();
            if tets.len() <= tet as usize {
                tets.resize(tet as usize + 1, nodes);
            }
            tets[tet as usize] = nodes;
        }
        let first = (body.rest.len() - change.born.len()) as u32;
        body.anchor_again(&(first..body.rest.len() as u32).collect::<Vec<_>>());
        body.is_parted = true;
        body.changed_topology();
        out.put(body.entity, TetMesh { tets: body.tets.clone() });
        if let Some(uv) = texture {
            out.put(body.entity, TextureCoordinates { uv });
        }
        let altered = |tet| self.heated.alteration(self.origin(tet));
        let heated = || self.heated();
        elements
            .split(body, &Split { born: &change.born, changed: &changed, altered: &altered, heated: &heated })
    }

    /// The surface after a change: its remaining triangles, then the uncovered ones, the first `burned` of them from
    /// before any split, then the other halves of split triangles.
    fn uncover(&mut self, change: &VolumeChange, burned: usize) -> SurfaceChange {
        let mut old = std::mem::take(&mut self.faces);
        let mut bare = change.uncovered[..burned].to_vec();
        let mut halves: Vec<(TetFace, Triangle)> = Vec::new();
        let mut known: BTreeMap<TetFace, Triangle> = BTreeMap::new();
        if !change.halved.is_empty() {
            known.extend(old.iter().enumerate().map(|(at, face)| (*face, Triangle::Old(at))));
            known.extend(bare.iter().enumerate().map(|(at, face)| (*face, Triangle::Bare(at))));
        }
        for halved in &change.halved {
            for (face, half) in halved.faces() {
                let Some(&triangle) = known.get(&face) else { continue };
                let own = match triangle {
                    Triangle::Bare(_) => {
                        bare.push(half);
                        Triangle::Bare(bare.len() - 1)
                    }
                    Triangle::Old(_) | Triangle::Half(_) => {
                        halves.push((half, triangle));
                        Triangle::Half(halves.len() - 1)
                    }
                };
                known.insert(half, own);
            }
            let [face, moved] = halved.moved_face();
            if let Some(triangle) = known.remove(&face) {
                match triangle {
                    Triangle::Old(at) => old[at] = moved,
                    Triangle::Bare(at) => bare[at] = moved,
                    Triangle::Half(at) => halves[at].0 = moved,
                }
                known.insert(moved, triangle);
            }
        }
        let is_there = |face: &TetFace| self.volume.tet(face.0).is_some();
        let mut kept = Vec::with_capacity(old.len());
        let mut left: Vec<TetFace> = Vec::with_capacity(old.len() + change.uncovered.len() + halves.len());
        for face in &old {
            kept.push(is_there(face).then_some(left.len() as u32));
            left.extend(is_there(face).then_some(*face));
        }
        left.extend(bare.iter().chain(&change.uncovered[burned..]).filter(|face| is_there(face)));
        let first_half = left.len() as u32;
        let parents = halves.iter().map(|(_, triangle)| match *triangle {
            Triangle::Old(at) => kept[at].unwrap_or_default(),
            Triangle::Half(at) | Triangle::Bare(at) => first_half + at as u32,
        });
        let parents = parents.collect();
        left.extend(halves.iter().map(|(face, _)| *face));
        self.faces = left;
        SurfaceChange { kept: Some(kept), parents }
    }

    fn corners(&self, &(tet, corner): &TetFace) -> [u32; 3] {
        self.volume.face((tet, corner)).unwrap_or_default()
    }

    /// Measures of the cuts and tears.
    pub fn measure(&self, measures: &mut Measures<'_>) {
        measures.put("pieces", self.pieces as f64);
        measures.put("elements_left", self.volume.left() as f64);
        measures.put("opened_faces", self.cuts.opened.len() as f64);
        measures.put("torn_faces", f64::from(self.cuts.torn));
    }
}

/// Origin of a surface triangle during an update: kept, half of a split one, or uncovered.
#[derive(Clone, Copy)]
enum Triangle {
    Old(usize),
    Half(usize),
    Bare(usize),
}

/// Elements of the first mesh with all their parts.
fn all_parts<'a>(parts: &'a BTreeMap<u32, Vec<u32>>, first: &'a [u32]) -> impl Iterator<Item = u32> + 'a {
    first.iter().flat_map(|tet| std::iter::once(*tet).chain(parts.get(tet).into_iter().flatten().copied()))
}

/// The faces of the triangles, in their order; `None` if the surface is not the boundary.
fn faces_of(volume: &Volume, triangles: &[[u32; 3]]) -> Option<Vec<TetFace>> {
    let sorted = |mut nodes: [u32; 3]| {
        nodes.sort_unstable();
        nodes
    };
    let of_boundary = || volume.boundary().filter_map(|face| Some((sorted(volume.face(face)?), face)));
    // Two faces of a slit with shared nodes have the same corners: each is used once.
    let mut known: BTreeMap<[u32; 3], Vec<TetFace>> = BTreeMap::new();
    of_boundary().for_each(|(nodes, face)| known.entry(nodes).or_default().push(face));
    let same_sense = |face: &TetFace, nodes: &[u32; 3]| {
        volume
            .face(*face)
            .is_some_and(|own| (0..3).any(|k| [own[k], own[(k + 1) % 3], own[(k + 2) % 3]] == *nodes))
    };
    let faces: Option<Vec<TetFace>> = triangles
        .iter()
        .map(|nodes| {
            let faces = known.get_mut(&sorted(*nodes))?;
            let at = faces.iter().position(|face| same_sense(face, nodes))?;
            Some(faces.swap_remove(at))
        })
        .collect();
    faces.filter(|_| known.values().all(Vec::is_empty))
}
