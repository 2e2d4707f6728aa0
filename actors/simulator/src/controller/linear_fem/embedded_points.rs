//! Pinned points inside a linear organ that move with another entity: a needle, a hook or an anchor.
//!
//! Each point is constrained in all directions within an element, by barycentric weights (W = C K⁻¹ Cᵀ). The reaction
//! force is reported for the entity, as for jaws.

use nalgebra::{Isometry3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_collision::primitive::closest_on_triangle;
use trocar_dynamics::soft_body::{Deformable, PinnedBody, PinnedWith};
use trocar_dynamics::tet_mesh::TetMesh;
use trocar_scene::{Component, Entity, Snapshot};

use crate::linear_fem::{Attachment, Hold};

/// Tolerance by which a point may be outside its nearest element, relative to its size.
const OUTSIDE: f64 = 1e-9;

/// The points in the frames of their entities \[m\]; a restart continues with them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "pin_places")]
#[serde(default, deny_unknown_fields)]
pub struct PinPlaces {
    /// In the order of [`PinnedBody::with`].
    pub in_entity: Vec<Point3<f64>>,
}

/// A pinned point.
#[derive(Clone, Debug)]
pub(crate) struct Pin {
    pub entity: Entity,
    /// Its rest position in the organ \[m\], and its element.
    pub rest: Point3<f64>,
    pub tet: u32,
    pub weights: [f64; 4],
}

/// All pinned points of an organ.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pins {
    pub pins: Vec<Pin>,
    pub places: PinPlaces,
    told: bool,
}

impl Pins {
    /// Reads them from the scene.
    ///
    /// # Errors
    /// An entity that does not exist, or a point outside the organ, with its distance.
    pub fn read(scene: &Snapshot, body: &Deformable, mesh: &TetMesh) -> Result<Self, String> {
        let Some(pinned) = scene.get::<PinnedBody>(body.entity) else { return Ok(Self::default()) };
        let mut pins = Vec::new();
        for PinnedWith { entity: name, points } in &pinned.with {
            let entity = scene.find(name).filter(|entity| *entity != body.entity);
            let entity = entity.ok_or_else(|| {
                format!("it is 'pinned' to '{name}', which is no other entity of the scene: name one that has a pose")
            })?;
            for point in points {
                let (tet, weights) = inside(mesh, point).map_err(|far| {
                    format!(
                        "it is 'pinned' to '{name}' at [{}, {}, {}], which is {:.1} mm outside of it: points inside of it are \
                         valid, in its frame and at rest",
                        point.x,
                        point.y,
                        point.z,
                        1e3 * far
                    )
                })?;
                let corners = mesh.tets()[tet as usize].iter().zip(weights);
                let mut borne = corners.filter(|(_, weight)| *weight != 0.0).map(|(node, _)| *node);
                if borne.all(|node| body.pinned.binary_search(&node).is_ok()) {
                    return Err(format!(
                        "it is 'pinned' to '{name}' at [{}, {}, {}], where its anchors hold it: points that move are valid",
                        point.x, point.y, point.z
                    ));
                }
                pins.push(Pin { entity, rest: *point, tet, weights });
            }
        }
        let places = scene.get::<PinPlaces>(body.entity).cloned().unwrap_or_default();
        if !(places.in_entity.is_empty() || places.in_entity.len() == pins.len()) {
            let (known, given) = (places.in_entity.len(), pins.len());
            return Err(format!("its 'pin_places' are {known}, and it is 'pinned' at {given} points"));
        }
        let told = !places.in_entity.is_empty();
        Ok(Self { pins, places, told })
    }

    /// Records the points in the frames of their entities, unless already recorded.
    pub fn record_points(&mut self, scene: &Snapshot, world_from_body: &Isometry3<f64>) {
        if self.places.in_entity.len() == self.pins.len() {
            return;
        }
        let place = |pin: &Pin| scene.world_pose(pin.entity).inverse() * (world_from_body * pin.rest);
        self.places.in_entity = self.pins.iter().map(place).collect();
    }

    /// The present constraints, each with its point's number: attachment and displacement from rest \[m\]. `is_gone`
    /// tells whether an element was removed.
    pub fn driven<'a>(
        &'a self,
        scene: &'a Snapshot,
        world_from_body: &'a Isometry3<f64>,
        mesh: &'a TetMesh,
        is_gone: impl Fn(u32) -> bool + 'a,
    ) -> impl Iterator<Item = (usize, Attachment, Vector3<f64>)> + 'a {
        let there = move |pin: &Pin| scene.contains(pin.entity) && !is_gone(pin.tet);
        let all = self.pins.iter().zip(&self.places.in_entity).enumerate();
        all.filter(move |(_, (pin, _))| there(pin)).map(move |(number, (pin, in_entity))| {
            let corners = mesh.tets()[pin.tet as usize];
            let now = world_from_body.inverse() * (scene.world_pose(pin.entity) * in_entity);
            (number, Attachment::barycentric(corners, pin.weights, Hold::Point), now - pin.rest)
        })
    }

    /// The state that a restart needs, once.
    pub fn take_changes(&mut self) -> Option<PinPlaces> {
        let is_news = !self.told && !self.places.in_entity.is_empty();
        self.told |= is_news;
        is_news.then(|| self.places.clone())
    }
}

/// The element that contains a point, with barycentric weights; else the point's distance from the body \[m\].
fn inside(mesh: &TetMesh, point: &Point3<f64>) -> Result<(u32, [f64; 4]), f64> {
    let far = || {
        let away = |nodes: &[u32; 3]| {
            (closest_on_triangle(point, &nodes.map(|node| mesh.rest()[node as usize])).point - point).norm()
        };
        mesh.surface().iter().map(away).fold(f64::INFINITY, f64::min)
    };
    let (tet, weights) = mesh.locate(point).ok_or_else(far)?;
    // Written so that NaN is outside.
    if !weights.iter().all(|weight| *weight >= -OUTSIDE) {
        return Err(far());
    }
    // On a face, an edge or a corner the opposite nodes have weight zero.
    let weights = weights.map(|weight| if weight < OUTSIDE { 0.0 } else { weight });
    let sum: f64 = weights.iter().sum();
    Ok((tet as u32, weights.map(|weight| weight / sum)))
}
