//! Joints between bodies that have grown onto each other, and the ties of bodies that one controller steps as one
//! island.

use nalgebra::Isometry3;
use trocar_collision::primitive::closest_on_triangle;
use trocar_dynamics::coupling::external_nodes::{OF_BODY, Tie};
use trocar_dynamics::soft_body::Deformable;
use trocar_dynamics::soft_body::coupling::components::{JOINED_MAX, VertexAttachment};
use trocar_dynamics::soft_body::coupling::{CoupledWith, Joined};
use trocar_dynamics::tet_mesh::{MeshRules, TetMesh};
use trocar_scene::soft_body::one_of;
use trocar_scene::{Entity, Snapshot};

/// A body of the same controller, onto which a body has grown.
pub struct FusedBody {
    /// The body.
    pub entity: Entity,
    rule: Joined,
    grafts: Vec<VertexAttachment>,
}

impl FusedBody {
    pub(crate) fn new(
        body: &Deformable,
        other: &Deformable,
        rule: &CoupledWith,
        scene: &Snapshot,
    ) -> Result<Self, String> {
        let Some(joined) = rule.joined.filter(|_| rule.lies.is_none()) else {
            let valid = one_of(&scene.registry().soft_bodies_that(|of| of.answers_couplings));
            return Err(format!("'lies' goes with bodies of {valid} only"));
        };
        let body_from_other = scene.world_pose(body.entity).inverse() * scene.world_pose(other.entity);
        let apart = body_from_other.translation.vector.norm() + body_from_other.rotation.angle();
        if apart > 1e-9 {
            return Err("the two are stepped as one and need the same pose".into());
        }
        let grafts = grafts(body, other, &body_from_other, &joined)?;
        Ok(Self { entity: other.entity, rule: joined, grafts })
    }

    /// Vertices joined to it.
    #[must_use]
    pub fn count(&self) -> usize {
        self.grafts.len()
    }

    /// The ties of the joint: nodes of the body are numbered from `first`, those of the other one, with these elements,
    /// from `others`. Unused vertices and removed elements are no longer joined.
    pub fn ties(&self, body: &Deformable, first: u32, other: &Deformable, others: u32, ties: &mut Vec<Tie>) {
        let Joined { stiffness, damping, .. } = self.rule;
        ties.extend(self.grafts.iter().filter_map(|graft| {
            let corners = other.tets.get(graft.element as usize)?;
            let is_loose = |body: &Deformable, vertex: u32| body.loose.binary_search(&vertex).is_ok();
            if is_loose(body, graft.vertex) || corners.iter().any(|corner| is_loose(other, *corner)) {
                return None;
            }
            let ghost_nodes = [0, 1, 2, 3].map(|k| (OF_BODY + others + corners[k], graft.weights[k]));
            Some(Tie { node: first + graft.vertex, ghost_nodes, stiffness, damping })
        }));
    }
}

/// Vertices of a body that are joined to another, both at rest.
pub(crate) fn grafts(
    body: &Deformable,
    other: &Deformable,
    body_from_other: &Isometry3<f64>,
    joined: &Joined,
) -> Result<Vec<VertexAttachment>, String> {
    let rules = MeshRules { mean_ratio_min: 0.0, coincident_within: None };
    let mesh = TetMesh::new(&other.rest, &other.tets, &rules).map_err(|error| error.to_string())?;
    let mut grafts = Vec::new();
    let of_body: std::collections::BTreeSet<u32> =
        body.triangles.iter().flatten().chain(body.segments.iter().flatten()).copied().collect();
    for vertex in of_body {
        let place = body_from_other.inverse_transform_point(&body.rest[vertex as usize]);
        let near = |corners: &[u32; 3]| {
            let corners = corners.map(|node| other.rest[node as usize]);
            (closest_on_triangle(&place, &corners).point - place).norm() <= joined.within
        };
        if !other.triangles.iter().any(near) {
            continue;
        }
        if let Some((element, weights)) = mesh.locate(&place) {
            grafts.push(VertexAttachment { vertex, element: element as u32, weights });
        }
    }
    match grafts.len() {
        0 => Err(format!("none of its vertices is within {} m of that at rest", joined.within)),
        1..=JOINED_MAX => Ok(grafts),
        more => Err(format!(
            "{more} of its vertices are within {} m of that at rest: up to {JOINED_MAX} are valid",
            joined.within
        )),
    }
}
