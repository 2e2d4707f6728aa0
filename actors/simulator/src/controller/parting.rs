//! Volumes that come apart in a scene: what heat takes away, what blades open, what tears.
//!
//! Elements keep their numbers, those that are gone too. A node that comes apart gives its new parts numbers behind all
//! others. Who moves the volume is told; the surface, what holds it and what is drawn on it follow.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::{Matrix3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::{
    Access, Commands, Component, ComponentError, Entity, EntitySet, Snapshot, SurfaceMesh, TetMesh,
    TextureCoordinates,
};

use super::cuts::swept;
use super::deformable::Deformable;
use super::electrosurgery::CauterisedBody;
use super::heat::{Coagulated, CoagulatedElements, Heated, RemovedElements};
use super::soft::{Measures, Reshaped, Site};
use crate::elasticity::cauchy_stress;
use crate::tet_mesh::{self, FaceOf, MeshRules, Volume, VolumeChange, shape};

/// What the mesh of a volume does not say about how it came apart.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VolumeCuts {
    /// Faces between elements that were opened.
    pub opened: Arc<Vec<FaceOf>>,
    /// Of the nodes that the first mesh did not have: the one of the first mesh that each of them was.
    pub origins: Arc<Vec<u32>>,
    /// Of the elements that heat has removed, how many have been taken out.
    pub taken: u32,
    /// Of the opened faces, how many tore.
    pub torn: u32,
    /// Where the edge of each pair of closed blades was, in the frame of the body.
    pub blades: Vec<(Entity, [Point3<f64>; 2])>,
}
impl Component for VolumeCuts {
    const NAME: &'static str = "volume_cuts";
    fn check(&self) -> Result<(), ComponentError> {
        trocar_scene::finite::check(self)
    }
}

/// Who moves elements that go, change and come apart.
pub trait Elements {
    /// Where the nodes are \[m\].
    fn positions(&self) -> &[Point3<f64>];
    /// These elements are gone.
    fn remove(&mut self, elements: &[u32]);
    /// These are as stiff and as long as that.
    fn alter(&mut self, elements: &[Coagulated]);
    /// The body has new nodes, where their parents are: pairs of a node and its parent. It is to be moved with the elements
    /// that it has now; `heated` is all that has happened to them.
    ///
    /// # Errors
    /// Why it cannot be.
    fn split(&mut self, body: &Deformable, split: &[(u32, u32)], heated: &Heated) -> Result<(), String>;
}

/// By what else than heat a volume comes apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Weakness {
    /// Whether blades open it.
    pub cut: bool,
    /// Whether pieces that hang by nothing but nodes stay there: who moves them cannot let them fall.
    pub hangs_on: bool,
    /// Tension that tears it \[Pa\], and Lamé's constants \[Pa\] by which the tension is known.
    pub tears: Option<(f64, [f64; 2])>,
}

/// A volume, and how far it has come apart.
pub struct Parting {
    volume: Volume,
    weakness: Weakness,
    /// The face that each triangle of the surface is.
    faces: Vec<FaceOf>,
    heated: Heated,
    cuts: VolumeCuts,
    pieces: usize,
    /// Edges at rest, inverse; what tears needs them.
    inverse_shapes: Vec<Matrix3<f64>>,
    told_blades: bool,
}

impl Parting {
    /// Of a body as the scene has it, if it can come apart at all; tells the body which of its vertices are of nothing.
    ///
    /// # Errors
    /// What is wrong with its mesh.
    pub fn new(body: &mut Deformable, weakness: Weakness, scene: &Snapshot) -> Result<Option<Self>, String> {
        let known = scene.get::<VolumeCuts>(body.entity).cloned();
        let burns = scene.get::<CauterisedBody>(body.entity);
        if burns.is_some_and(|burns| burns.thickness.is_some()) {
            return Err("it moves as a volume: 'cauterised' has no 'thickness' then".into());
        }
        let heats = burns.is_some() || scene.get::<RemovedElements>(body.entity).is_some();
        if !(weakness.cut || weakness.tears.is_some() || heats || known.is_some()) {
            return Ok(None);
        }
        let rules = MeshRules { mean_ratio_min: 0.0, coincident_within: None };
        let mesh =
            tet_mesh::TetMesh::new(&body.rest, &body.tets, &rules).map_err(|error| error.to_string())?;
        let mut volume = Volume::new(&mesh);
        let cuts = known.unwrap_or_default();
        // Their nodes have parted already, where they do.
        volume.open(&cuts.opened).map_err(|error| error.to_string())?;
        let heated = Heated::known(scene, body.entity, cuts.taken as usize);
        let there = heated.removed.iter().copied().filter(|&tet| volume.tet(tet).is_some());
        let there: Vec<u32> = there.collect();
        volume.take_out(&there).map_err(|error| error.to_string())?;
        body.loose = volume.orphans();
        body.is_parted = !cuts.origins.is_empty();
        let inverse_shapes = mesh.inverse_shapes().to_vec();
        let faces = faces_of(&volume, &body.triangles)
            .ok_or("its surface is not that of its volume: what comes apart needs the mesh of one")?;
        let pieces = volume.pieces();
        let told_blades = !cuts.blades.is_empty();
        Ok(Some(Self { volume, weakness, faces, heated, cuts, pieces, inverse_shapes, told_blades }))
    }

    /// What a controller of volumes that come apart reads and writes.
    pub fn access(access: Access, bodies: &[Entity]) -> Access {
        let all = || EntitySet::Of(bodies.to_vec());
        access
            .reads::<RemovedElements>()
            .reads::<CoagulatedElements>()
            .writes::<SurfaceMesh>(all())
            .writes::<TetMesh>(all())
            .writes::<TextureCoordinates>(all())
            .writes::<VolumeCuts>(all())
    }

    /// All that heat has done.
    #[must_use]
    pub fn heated(&self) -> &Heated {
        &self.heated
    }

    /// Whether blades open it.
    #[must_use]
    pub fn is_cut(&self) -> bool {
        self.weakness.cut
    }

    /// Lets it come apart as far as it does now.
    ///
    /// # Errors
    /// Why it cannot be moved on.
    pub fn reshape(
        &mut self,
        elements: &mut dyn Elements,
        body: &mut Deformable,
        site: &Site<'_>,
        out: &mut Commands,
    ) -> Result<Option<Reshaped>, String> {
        let (mut gone, changed) = self.heated.news(site.scene, body.entity);
        gone.retain(|&tet| self.volume.tet(tet).is_some());
        if !changed.is_empty() {
            elements.alter(&changed);
        }
        let mut change = VolumeChange::default();
        if !gone.is_empty() {
            elements.remove(&gone);
            change = self.volume.take_out(&gone).map_err(|error| error.to_string())?;
            // What hangs by a node or an edge goes on to, so that its solver need not be made anew with every element
            // that burns; but not what hangs by nothing else.
            if !self.weakness.hangs_on && self.volume.pieces() > self.pieces {
                self.volume.separate(&mut change);
            }
        }
        let cut = self.cut(elements.positions(), site);
        let torn = self.tear(elements.positions());
        let opened: Vec<FaceOf> = cut.into_iter().chain(torn).collect();
        if !opened.is_empty() {
            let more = self.volume.open(&opened).map_err(|error| error.to_string())?;
            Arc::make_mut(&mut self.cuts.opened).extend(&opened);
            change.uncovered.extend(more.uncovered);
            change.split.extend(more.split);
            change.renamed.extend(more.renamed);
        }
        let parts = !(gone.is_empty() && opened.is_empty());
        if parts || self.told_blades || !self.cuts.blades.is_empty() {
            self.told_blades = !self.cuts.blades.is_empty();
            self.cuts.taken = self.heated.removed.len() as u32;
            self.split(elements, body, site, &change, out)?;
            out.put(body.entity, self.cuts.clone());
        }
        if !parts {
            return Ok(None);
        }
        self.pieces = self.volume.pieces();
        body.loose = self.volume.orphans();
        let kept = self.uncover(&change);
        body.triangles = Arc::new(self.faces.iter().map(|face| self.corners(face)).collect());
        out.put(body.entity, SurfaceMesh { triangles: body.triangles.clone() });
        Ok(Some(Reshaped { kept: Some(kept), parents: Vec::new() }))
    }

    /// Faces that blades have passed between since the last time.
    fn cut(&mut self, positions: &[Point3<f64>], site: &Site<'_>) -> Vec<FaceOf> {
        if !self.weakness.cut {
            return Vec::new();
        }
        let sweeps = swept(&mut self.cuts.blades, site.scene, site.world_from_body);
        let mut faces: Vec<FaceOf> = Vec::new();
        for sweep in sweeps {
            faces.extend(self.volume.swept(positions, &sweep.before, &sweep.after));
        }
        faces.sort_unstable();
        faces.dedup();
        faces
    }

    /// The face that tears now: the most pulled one, if that is more than it bears. One at a time, so that what is about it
    /// is relieved before more goes.
    fn tear(&mut self, positions: &[Point3<f64>]) -> Option<FaceOf> {
        let (strength, lame) = self.weakness.tears?;
        let mut stresses = vec![Matrix3::zeros(); self.inverse_shapes.len()];
        for (tet, nodes) in self.volume.tets() {
            let heated = self.heated.of(tet);
            let [stiffness, length] = heated.map_or([1.0; 2], |heated| [heated.stiffness, heated.length]);
            let gradient = shape(positions, &nodes) * self.inverse_shapes[tet as usize] / length;
            stresses[tet as usize] = cauchy_stress(lame, &gradient) * stiffness;
        }
        let (face, tension) = self.volume.most_pulled(positions, |tet| stresses[tet as usize])?;
        if tension <= strength {
            return None;
        }
        self.cuts.torn += 1;
        Some(face)
    }

    /// New nodes, and elements that have them.
    fn split(
        &mut self,
        elements: &mut dyn Elements,
        body: &mut Deformable,
        site: &Site<'_>,
        change: &VolumeChange,
        out: &mut Commands,
    ) -> Result<(), String> {
        if change.split.is_empty() {
            return Ok(());
        }
        let first = self.volume.origins().len() - change.split.len() - self.cuts.origins.len();
        let origins = Arc::make_mut(&mut self.cuts.origins);
        let texture = site.scene.get::<TextureCoordinates>(body.entity).map(|texture| texture.uv.clone());
        let mut texture = texture.filter(|uv| uv.len() == body.rest.len());
        for &(_, parent) in &change.split {
            let of_parent = (parent as usize).checked_sub(first).map_or(parent, |at| origins[at]);
            origins.push(of_parent);
            copy_last(&mut body.rest, parent);
            copy_last(&mut body.positions, parent);
            copy_last(&mut body.velocities, parent);
            texture.as_mut().into_iter().for_each(|uv| copy_last(uv, parent));
        }
        let tets = Arc::make_mut(&mut body.tets);
        for &tet in &change.renamed {
            if let Some(nodes) = self.volume.tet(tet) {
                tets[tet as usize] = nodes;
            }
        }
        body.anchor();
        body.is_parted = true;
        body.changed_topology();
        out.put(body.entity, TetMesh { tets: body.tets.clone() });
        if let Some(uv) = texture {
            out.put(body.entity, TextureCoordinates { uv });
        }
        elements.split(body, &change.split, &self.heated)
    }

    /// The surface after a change: those of its triangles that stay first, then what came to light; the new number of
    /// each of the old ones.
    fn uncover(&mut self, change: &VolumeChange) -> Vec<Option<u32>> {
        let mut kept = Vec::with_capacity(self.faces.len());
        let mut left: Vec<FaceOf> = Vec::with_capacity(self.faces.len() + change.uncovered.len());
        for face in &self.faces {
            let stays = self.volume.tet(face.0).is_some();
            kept.push(stays.then_some(left.len() as u32));
            left.extend(stays.then_some(*face));
        }
        let there = change.uncovered.iter().filter(|(tet, _)| self.volume.tet(*tet).is_some());
        left.extend(there);
        self.faces = left;
        kept
    }

    fn corners(&self, &(tet, corner): &FaceOf) -> [u32; 3] {
        self.volume.face((tet, corner)).unwrap_or_default()
    }

    /// Tells how far it has come apart.
    pub fn measure(&self, measures: &mut Measures<'_>) {
        measures.put("pieces", self.pieces as f64);
        measures.put("elements_left", self.volume.left() as f64);
        measures.put("opened_faces", self.cuts.opened.len() as f64);
        measures.put("torn_faces", f64::from(self.cuts.torn));
    }
}

/// What the last vertices of a list become: copies of their parents.
fn copy_last<T: Copy>(of: &mut Arc<Vec<T>>, parent: u32) {
    let of = Arc::make_mut(of);
    of.push(of[parent as usize]);
}

/// The faces that triangles are, in their order; `None` of a surface that is not the boundary.
fn faces_of(volume: &Volume, triangles: &[[u32; 3]]) -> Option<Vec<FaceOf>> {
    let sorted = |mut nodes: [u32; 3]| {
        nodes.sort_unstable();
        nodes
    };
    let of_boundary = || volume.boundary().filter_map(|face| Some((sorted(volume.face(face)?), face)));
    // Two faces of a slit whose nodes are shared have the same corners: each of them is taken once.
    let mut known: BTreeMap<[u32; 3], Vec<FaceOf>> = BTreeMap::new();
    of_boundary().for_each(|(nodes, face)| known.entry(nodes).or_default().push(face));
    let same_sense = |face: &FaceOf, nodes: &[u32; 3]| {
        volume
            .face(*face)
            .is_some_and(|own| (0..3).any(|k| [own[k], own[(k + 1) % 3], own[(k + 2) % 3]] == *nodes))
    };
    let faces: Option<Vec<FaceOf>> = triangles
        .iter()
        .map(|nodes| {
            let faces = known.get_mut(&sorted(*nodes))?;
            let at = faces.iter().position(|face| same_sense(face, nodes))?;
            Some(faces.swap_remove(at))
        })
        .collect();
    faces.filter(|_| known.values().all(Vec::is_empty))
}
