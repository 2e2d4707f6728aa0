//! Picking: the triangles and vertices that an instrument's jaws hold, for every method that deforms the surface.
//!
//! The triangles that both jaws touch while closing are flagged with the instrument, and follow its pose rigidly from
//! the start of each frame. Their vertices become prescribed positions of the surface's solver, so the adjacent tissue
//! follows smoothly by the solver's own mechanics. Opening the jaws clears the flags. Jaws that have closed on nothing
//! act as a blunt rod, and take nothing until they have opened. One instrument holds a triangle: the first that took it
//! keeps it, and a vertex between triangles of two instruments follows the earlier one.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_collision::primitive::{closest_segment_triangle, closest_segments};

/// A held vertex, and its position in the frame of the instrument that holds it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldVertex {
    /// The vertex.
    pub vertex: u32,
    /// Its position in the instrument's frame \[m\].
    pub in_instrument: Point3<f64>,
}

/// The part of the surface that one instrument holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pick {
    /// The instrument.
    pub instrument: u64,
    /// Held triangles, ascending; of a line its segments.
    pub triangles: Vec<u32>,
    /// Their vertices, ascending, without those that an earlier pick holds.
    pub vertices: Vec<HeldVertex>,
}

/// All picks on one surface, in the order in which the jaws closed. This is the complete state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Picks {
    /// One for each instrument that holds something.
    pub picks: Vec<Pick>,
    /// Instruments whose jaws have closed on nothing.
    #[serde(default)]
    pub shut: Vec<u64>,
}

/// An instrument in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jaws<'a> {
    /// The instrument.
    pub instrument: u64,
    /// Its pose in the frame of the surface's vertices.
    pub body_from_instrument: Isometry3<f64>,
    /// Whether the jaws are nearly closed.
    pub closed: bool,
    /// Whether the jaws are closing.
    pub closing: bool,
    /// Triangles in contact with each jaw, in any order.
    pub touched: [&'a [u32]; 2],
}

/// A vertex with a prescribed position at the end of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrivenVertex {
    /// The vertex.
    pub vertex: u32,
    /// The prescribed position, in the frame of the surface's vertices \[m\].
    pub position_in_body: Point3<f64>,
    /// The pick that holds it, by its place among them.
    pub grip: u32,
}

/// Why an instrument was rejected.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PickError {
    /// A triangle or corner that does not exist.
    #[error(
        "triangle {triangle} touched by instrument {instrument} does not exist, or one of its corners ({triangles} triangles, {vertices} vertices)"
    )]
    Triangle {
        /// The instrument that touched it.
        instrument: u64,
        /// The triangle.
        triangle: u32,
        /// Number of triangles.
        triangles: usize,
        /// Number of vertices.
        vertices: usize,
    },
    /// A non-finite pose.
    #[error("the pose of instrument {0} is not finite")]
    Pose(u64),
}

impl Picks {
    /// Updates the flags at the start of a frame: open jaws release; closing jaws that hold nothing take the triangles
    /// that both touch, unless another instrument holds them. A new instrument counts as just closed. An instrument
    /// that is not listed releases.
    ///
    /// # Errors
    /// When an instrument touches an element that does not exist or has a non-finite pose; nothing has changed then.
    pub fn update(
        &mut self,
        triangles: &[[u32; 3]],
        positions: &[Point3<f64>],
        jaws: &[Jaws<'_>],
    ) -> Result<(), PickError> {
        for jaw in jaws {
            let pose = &jaw.body_from_instrument;
            let numbers = pose.translation.vector.iter().chain(pose.rotation.coords.iter());
            if !numbers.copied().all(f64::is_finite) {
                return Err(PickError::Pose(jaw.instrument));
            }
            for &triangle in jaw.touched.into_iter().flatten() {
                let corners = triangles.get(triangle as usize);
                if corners.is_none_or(|corners| corners.iter().any(|&at| at as usize >= positions.len())) {
                    return Err(PickError::Triangle {
                        instrument: jaw.instrument,
                        triangle,
                        triangles: triangles.len(),
                        vertices: positions.len(),
                    });
                }
            }
        }
        let is_closed = |instrument: u64| jaws.iter().any(|jaw| jaw.instrument == instrument && jaw.closed);
        self.picks.retain(|pick| is_closed(pick.instrument));
        self.shut.retain(|instrument| is_closed(*instrument));
        for jaw in jaws.iter().filter(|jaw| jaw.closed) {
            if self.of(jaw.instrument).is_some() || self.shut.contains(&jaw.instrument) {
                continue;
            }
            let [first, second] = jaw.touched;
            let mut taken: Vec<u32> = first
                .iter()
                .copied()
                .filter(|triangle| second.contains(triangle) && self.holder(*triangle).is_none())
                .collect();
            taken.sort_unstable();
            taken.dedup();
            if taken.is_empty() {
                if !jaw.closing {
                    self.shut.push(jaw.instrument);
                }
                continue;
            }
            let mut vertices: Vec<u32> =
                taken.iter().flat_map(|&triangle| triangles[triangle as usize]).collect();
            vertices.sort_unstable();
            vertices.dedup();
            let held = |vertex: &u32| self.picks.iter().any(|pick| pick.held(*vertex).is_some());
            let vertices = vertices.into_iter().filter(|vertex| !held(vertex)).map(|vertex| HeldVertex {
                vertex,
                in_instrument: jaw.body_from_instrument.inverse_transform_point(&positions[vertex as usize]),
            });
            self.picks.push(Pick {
                instrument: jaw.instrument,
                triangles: taken,
                vertices: vertices.collect(),
            });
        }
        Ok(())
    }

    /// The pick of an instrument.
    #[must_use]
    pub fn of(&self, instrument: u64) -> Option<&Pick> {
        self.picks.iter().find(|pick| pick.instrument == instrument)
    }

    /// The instrument that a triangle is flagged with.
    #[must_use]
    pub fn holder(&self, triangle: u32) -> Option<u64> {
        let holds = |pick: &&Pick| pick.triangles.binary_search(&triangle).is_ok();
        self.picks.iter().find(holds).map(|pick| pick.instrument)
    }

    /// Prescribed positions of all held vertices, in ascending order of vertices; `jaws` as in
    /// [`update`](Self::update).
    #[must_use]
    pub fn driven(&self, jaws: &[Jaws<'_>]) -> Vec<DrivenVertex> {
        let mut driven = Vec::new();
        for (grip, pick) in (0..).zip(&self.picks) {
            let Some(jaw) = jaws.iter().find(|jaw| jaw.instrument == pick.instrument) else { continue };
            driven.extend(pick.vertices.iter().map(|held| DrivenVertex {
                vertex: held.vertex,
                position_in_body: jaw.body_from_instrument * held.in_instrument,
                grip,
            }));
        }
        driven.sort_by_key(|driven| driven.vertex);
        driven
    }

    /// Jaws in which something slips hold what comes between them as well: the triangles that both touch.
    pub fn take_more(&mut self, triangles: &[[u32; 3]], positions: &[Point3<f64>], jaw: &Jaws<'_>) {
        let [first, second] = jaw.touched;
        let new = first.iter().filter(|part| second.contains(part) && self.holder(**part).is_none());
        let mut new: Vec<u32> = new.copied().collect();
        new.sort_unstable();
        new.dedup();
        if new.is_empty() {
            return;
        }
        let mut vertices: Vec<u32> =
            new.iter().filter_map(|&part| triangles.get(part as usize)).flatten().copied().collect();
        vertices.sort_unstable();
        vertices.dedup();
        vertices.retain(|vertex| !self.picks.iter().any(|pick| pick.held(*vertex).is_some()));
        let held = vertices.into_iter().filter_map(|vertex| {
            let position = positions.get(vertex as usize)?;
            let in_instrument = jaw.body_from_instrument.inverse_transform_point(position);
            Some(HeldVertex { vertex, in_instrument })
        });
        let Some(pick) = self.picks.iter_mut().find(|pick| pick.instrument == jaw.instrument) else { return };
        pick.vertices.extend(held);
        pick.vertices.sort_by_key(|held| held.vertex);
        pick.triangles.extend(new);
        pick.triangles.sort_unstable();
    }

    /// Renumbers or removes triangles; a pick without triangles is dropped.
    pub fn renumber(&mut self, kept: &[Option<u32>]) {
        for pick in &mut self.picks {
            let now = pick.triangles.iter().filter_map(|&triangle| *kept.get(triangle as usize)?);
            pick.triangles = now.collect();
            pick.triangles.sort_unstable();
        }
        self.picks.retain(|pick| !pick.triangles.is_empty());
    }

    /// Updates the flags after a change of topology: new triangles and their vertices are held like their parents, and
    /// vertices that a pick's triangles no longer use are released. `positions` are the new ones, at the poses of
    /// `jaws`.
    pub fn follow(
        &mut self,
        parents: &[u32],
        triangles: &[[u32; 3]],
        positions: &[Point3<f64>],
        jaws: &[Jaws<'_>],
    ) {
        let first_new = triangles.len().saturating_sub(parents.len());
        let mut taken: Vec<u32> = Vec::new();
        for pick in &mut self.picks {
            for (index, parent) in parents.iter().enumerate() {
                if pick.triangles.binary_search(parent).is_ok() {
                    // New triangles have the highest numbers, in this order.
                    pick.triangles.push((first_new + index) as u32);
                }
            }
            let corners = pick.triangles.iter().filter_map(|&triangle| triangles.get(triangle as usize));
            let mut vertices: Vec<u32> = corners.flatten().copied().collect();
            vertices.sort_unstable();
            vertices.dedup();
            let Some(jaw) = jaws.iter().find(|jaw| jaw.instrument == pick.instrument) else { continue };
            let known: BTreeMap<u32, Point3<f64>> =
                pick.vertices.iter().map(|held| (held.vertex, held.in_instrument)).collect();
            let free = vertices.into_iter().filter(|vertex| taken.binary_search(vertex).is_err());
            pick.vertices = free
                .filter_map(|vertex| {
                    let fresh = || {
                        let position = positions.get(vertex as usize)?;
                        Some(jaw.body_from_instrument.inverse_transform_point(position))
                    };
                    let in_instrument = known.get(&vertex).copied().or_else(fresh)?;
                    Some(HeldVertex { vertex, in_instrument })
                })
                .collect();
            taken.extend(pick.vertices.iter().map(|held| held.vertex));
            taken.sort_unstable();
        }
    }
}

impl Pick {
    /// Its vertices have slipped in the jaws: their present places there are the held ones. Returns by how much, in the
    /// mean \[m\].
    pub fn slip(&mut self, body_from_instrument: &Isometry3<f64>, positions: &[Point3<f64>]) -> f64 {
        let mut way = 0.0;
        for held in &mut self.vertices {
            let Some(position) = positions.get(held.vertex as usize) else { continue };
            let now = body_from_instrument.inverse_transform_point(position);
            way += (now - held.in_instrument).norm();
            held.in_instrument = now;
        }
        way / self.vertices.len().max(1) as f64
    }

    /// Lets go of triangles that are farther from the middle between the pads, a segment in the instrument's frame,
    /// than this reach \[m\], and of vertices that no held triangle uses any longer.
    pub fn let_go(
        &mut self,
        (body_from_instrument, midline, reach): (&Isometry3<f64>, &[Point3<f64>; 2], f64),
        triangles: &[[u32; 3]],
        positions: &[Point3<f64>],
    ) {
        let midline = midline.map(|end| body_from_instrument * end);
        let before = self.triangles.len();
        self.triangles.retain(|&part| {
            let Some(corners) = triangles.get(part as usize) else { return false };
            let [Some(a), Some(b), Some(c)] = corners.map(|corner| positions.get(corner as usize)) else {
                return false;
            };
            let distance_squared = if b == c {
                closest_segments(&midline, &[*a, *b]).distance_squared
            } else {
                closest_segment_triangle(&midline, &[*a, *b, *c]).distance_squared
            };
            distance_squared <= reach * reach
        });
        if self.triangles.len() == before {
            return;
        }
        let corners = self.triangles.iter().filter_map(|&part| triangles.get(part as usize));
        let mut used: Vec<u32> = corners.flatten().copied().collect();
        used.sort_unstable();
        self.vertices.retain(|held| used.binary_search(&held.vertex).is_ok());
    }

    /// The held vertex of that number, if it is held.
    fn held(&self, vertex: u32) -> Option<&HeldVertex> {
        self.vertices.binary_search_by_key(&vertex, |held| held.vertex).ok().map(|at| &self.vertices[at])
    }
}
