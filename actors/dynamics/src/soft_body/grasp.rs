//! Grasps of soft bodies, for every method.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, Instrument, RecordPolicy};

use super::jaws::{AT_REST, holds, is_closed, opening};
use super::method::{StepContext, SurfaceChange};
use super::rod_contact::RodContact;
use crate::picking::{Jaws, Picks};

/// The grasps on a body: saved in the scene, so that they survive a restart.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, Component)]
#[component(name = "grips", record = RecordPolicy::sampled(10.0, 1e-6))]
#[serde(default, deny_unknown_fields)]
pub struct Grips {
    /// By instrument.
    pub picks: Picks,
}

impl Grips {
    /// Checks the grasps against a body with this many vertices and holdable parts.
    ///
    /// # Errors
    /// A held part that does not exist.
    pub(crate) fn fit(&self, vertices: usize, parts: usize) -> Result<(), String> {
        for pick in &self.picks.picks {
            let vertex =
                pick.vertices.iter().map(|held| held.vertex).find(|&vertex| vertex as usize >= vertices);
            let part = pick.triangles.iter().copied().find(|&part| part as usize >= parts);
            let (what, which, there) = match (vertex, part) {
                (Some(vertex), _) => ("vertex", vertex, vertices),
                (None, Some(part)) => ("triangle or segment", part, parts),
                (None, None) => continue,
            };
            return Err(format!("its 'grips' hold {what} {which}, and it has {there}"));
        }
        Ok(())
    }

    /// Updates the grasps after a change of topology.
    pub fn follow(
        &mut self,
        reshaped: &SurfaceChange,
        site: &StepContext<'_>,
        triangles: &[[u32; 3]],
        positions: &[Point3<f64>],
    ) {
        if let Some(kept) = &reshaped.kept {
            self.picks.renumber(kept);
        }
        let holders = Holder::all(site, &[], triangles);
        let jaws: Vec<Jaws<'_>> = holders.iter().map(Holder::jaws).collect();
        self.picks.follow(&reshaped.parents, triangles, positions, &jaws);
    }

    /// Number of held vertices.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.picks.picks.iter().map(|pick| pick.vertices.len()).sum()
    }
}

/// A grasping instrument: its number, its pose in a body's frame, whether it is closed, the triangles at each jaw.
pub struct Holder {
    instrument: u64,
    body_from_instrument: Isometry3<f64>,
    closed: bool,
    closing: bool,
    touched: [Vec<u32>; 2],
}

impl Holder {
    /// All grasping instruments, with the triangles that their jaws touch; rods as
    /// [`super::instrument_rods::rods_of_all`] lists them.
    #[must_use]
    pub fn all(site: &StepContext<'_>, touches: &[RodContact], triangles: &[[u32; 3]]) -> Vec<Self> {
        let holders = site.scene.iter::<Instrument>().filter(|(_, instrument)| holds(instrument.kind));
        holders
            .map(|(entity, _)| {
                let closed = is_closed(site.scene, entity);
                // The first rod of an instrument is its shaft.
                let first = site.rods.iter().position(|rod| rod.instrument == entity);
                let by_jaw = |side: usize| {
                    let rod = first.map(|first| first + 1 + side).filter(|_| closed);
                    touched(touches.iter().filter(|touch| Some(touch.rod) == rod), triangles)
                };
                Self {
                    instrument: entity.to_bits(),
                    body_from_instrument: site.world_from_body.inverse() * site.scene.world_pose(entity),
                    closed,
                    closing: opening(site.scene, entity)[1] < -AT_REST,
                    touched: [by_jaw(0), by_jaw(1)],
                }
            })
            .collect()
    }

    /// In the form that [`Picks`] takes.
    #[must_use]
    pub fn jaws(&self) -> Jaws<'_> {
        Jaws {
            instrument: self.instrument,
            body_from_instrument: self.body_from_instrument,
            closed: self.closed,
            closing: self.closing,
            touched: [&self.touched[0], &self.touched[1]],
        }
    }
}

/// The triangles that rods touch, and those at the vertices that rods touch.
fn touched<'a>(touches: impl Iterator<Item = &'a RodContact>, triangles: &[[u32; 3]]) -> Vec<u32> {
    let (mut touched, mut vertices) = (Vec::new(), Vec::new());
    for touch in touches {
        match touch.element {
            Some(triangle) => touched.push(triangle),
            None => vertices.push(touch.nodes[0]),
        }
    }
    if !vertices.is_empty() {
        vertices.sort_unstable();
        let about = |corners: &[u32; 3]| corners.iter().any(|corner| vertices.binary_search(corner).is_ok());
        touched.extend((0..triangles.len() as u32).filter(|&triangle| about(&triangles[triangle as usize])));
    }
    touched
}
