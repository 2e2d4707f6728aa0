//! Picking: what the jaws of an instrument hold of a surface, the same for every method that deforms it.
//!
//! The triangles that both jaws touch when they close are flagged with the instrument, and follow its pose rigidly from
//! the start of each frame: their vertices become prescribed positions of whatever solver has the surface, and by what it
//! knows of the matter those adjacent to them follow smoothly. Opening the jaws resets the flags. Jaws that have closed on
//! nothing are a blunt rod, and take nothing until they have been opened. A triangle is held by one instrument: of two that
//! want it, the one that came first keeps it, and a vertex between triangles of two instruments follows the earlier one.

use std::collections::BTreeMap;

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A vertex that is held, and where it is in the frame of the instrument that holds it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Held {
    /// Which vertex.
    pub vertex: u32,
    /// Where the instrument has it \[m\].
    pub in_instrument: Point3<f64>,
}

/// What one instrument holds.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pick {
    /// The instrument.
    pub instrument: u64,
    /// Triangles that it holds, ascending; of a line its segments.
    pub triangles: Vec<u32>,
    /// Their vertices, ascending; without those that an earlier pick holds.
    pub vertices: Vec<Held>,
}

/// All picks on one surface, in the order in which the jaws closed: this is the state, and all of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Picks {
    /// One for each instrument that holds something.
    pub picks: Vec<Pick>,
    /// Instruments whose jaws have closed on nothing.
    #[serde(default)]
    pub shut: Vec<u64>,
}

/// An instrument at one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jaws<'a> {
    /// Which instrument.
    pub instrument: u64,
    /// Where it is: world from instrument.
    pub pose_in_world: Isometry3<f64>,
    /// Whether the jaws are as good as closed.
    pub closed: bool,
    /// Whether they still close.
    pub closing: bool,
    /// Triangles in contact with each jaw, in any order.
    pub touched: [&'a [u32]; 2],
}

/// A vertex that has to be somewhere at the end of the frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrivenVertex {
    /// Which vertex.
    pub vertex: u32,
    /// Where, in world \[m\].
    pub position_in_world: Point3<f64>,
}

/// Why an instrument was not heard.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PickError {
    /// A triangle or corner that does not exist.
    #[error(
        "triangle {triangle} touched by instrument {instrument} does not exist, or one of its corners ({triangles} triangles, {vertices} vertices)"
    )]
    Triangle {
        /// Who touched it.
        instrument: u64,
        /// Which.
        triangle: u32,
        /// How many there are.
        triangles: usize,
        /// How many vertices there are.
        vertices: usize,
    },
    /// A pose that is nowhere.
    #[error("the pose of instrument {0} is not finite")]
    Pose(u64),
}

impl Picks {
    /// Brings flags up to date at the start of a frame: jaws that are open let go; jaws that close and hold nothing take the
    /// triangles that both touch, if nobody has them. Those that are not known yet have closed just now. An instrument that
    /// is not listed lets go.
    ///
    /// # Errors
    /// When an instrument touches what does not exist or is nowhere; nothing has changed then.
    pub fn update(
        &mut self,
        triangles: &[[u32; 3]],
        positions: &[Point3<f64>],
        jaws: &[Jaws<'_>],
    ) -> Result<(), PickError> {
        for jaw in jaws {
            let pose = &jaw.pose_in_world;
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
            let vertices = vertices.into_iter().filter(|vertex| !held(vertex)).map(|vertex| Held {
                vertex,
                in_instrument: jaw.pose_in_world.inverse_transform_point(&positions[vertex as usize]),
            });
            self.picks.push(Pick {
                instrument: jaw.instrument,
                triangles: taken,
                vertices: vertices.collect(),
            });
        }
        Ok(())
    }

    /// What an instrument holds.
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

    /// Where the instruments have what they hold, in ascending order of vertices; `jaws` as in [`update`](Self::update).
    #[must_use]
    pub fn led(&self, jaws: &[Jaws<'_>]) -> Vec<DrivenVertex> {
        let mut led = Vec::new();
        for pick in &self.picks {
            let Some(jaw) = jaws.iter().find(|jaw| jaw.instrument == pick.instrument) else { continue };
            led.extend(pick.vertices.iter().map(|held| DrivenVertex {
                vertex: held.vertex,
                position_in_world: jaw.pose_in_world * held.in_instrument,
            }));
        }
        led.sort_by_key(|led| led.vertex);
        led
    }

    /// Triangles have other numbers now, or are gone; who holds none any longer holds nothing.
    pub fn renumber(&mut self, kept: &[Option<u32>]) {
        for pick in &mut self.picks {
            let now = pick.triangles.iter().filter_map(|&triangle| *kept.get(triangle as usize)?);
            pick.triangles = now.collect();
            pick.triangles.sort_unstable();
        }
        self.picks.retain(|pick| !pick.triangles.is_empty());
    }

    /// Brings the flags up to date after a change of topology: new triangles are held as those that they are a part of,
    /// new vertices with them, and what a pick's triangles no longer have it lets go. `positions` are the new ones, at the
    /// poses of `jaws`.
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
                    // New ones have the highest numbers, in this order.
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
                        Some(jaw.pose_in_world.inverse_transform_point(position))
                    };
                    let in_instrument = known.get(&vertex).copied().or_else(fresh)?;
                    Some(Held { vertex, in_instrument })
                })
                .collect();
            taken.extend(pick.vertices.iter().map(|held| held.vertex));
            taken.sort_unstable();
        }
    }
}

impl Pick {
    /// A vertex of it.
    fn held(&self, vertex: u32) -> Option<&Held> {
        self.vertices.binary_search_by_key(&vertex, |held| held.vertex).ok().map(|at| &self.vertices[at])
    }
}
