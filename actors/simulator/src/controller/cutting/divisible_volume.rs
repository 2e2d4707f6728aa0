//! A volume that heat, blades and tears divide, of one body: its topology changes in a tick.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use nalgebra::{Matrix3, Point3};
use trocar_dynamics::elasticity::{cauchy_stress, small_stress};
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::coupling::CoupledBody;
use trocar_dynamics::soft_body::method::{Measures, StepContext, SurfaceChange};
use trocar_dynamics::tet_mesh::{
    self, MeshRules, NodeMotion, NodeOrigin, TetFace, Volume, VolumeChange, VolumeError, shape,
};
use trocar_scene::{Access, Commands, Entity, EntitySet, Snapshot, SurfaceMesh, TetMesh, TextureCoordinates};

use super::scissors::swept;
use super::volume::{Elements, FailureCriteria, Split, VolumeCuts};
use super::volume_surface::{after_change, faces_of};
use crate::controller::cauterised::CauterisedBody;
use crate::controller::region_stiffness;
use crate::controller::thermal_damage::{self, CoagulatedElement, RemovedElements, ThermalDamage};

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
        let regions = region_stiffness::factors(scene, body.entity, failure_criteria.young_modulus)?;
        let heats = burns.is_some() || scene.get::<RemovedElements>(body.entity).is_some();
        let heats = heats || !regions.is_empty();
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
        let heated = ThermalDamage::known(scene, body.entity, cuts.taken as usize).of_regions(regions);
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
        ThermalDamage::listed(removed, coagulated)
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
        let old = std::mem::take(&mut self.faces);
        let (faces, reshaped) = after_change(&self.volume, old, &change, burned);
        self.faces = faces;
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

/// Elements of the first mesh with all their parts.
fn all_parts<'a>(parts: &'a BTreeMap<u32, Vec<u32>>, first: &'a [u32]) -> impl Iterator<Item = u32> + 'a {
    first.iter().flat_map(|tet| std::iter::once(*tet).chain(parts.get(tet).into_iter().flatten().copied()))
}
