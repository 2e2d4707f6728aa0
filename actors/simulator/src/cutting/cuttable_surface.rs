//! Cuttable surface: triangles in the rest shape, vertex adjacency, and three operations that keep it a valid mesh:
//! split an edge, move a vertex along an edge, separate the triangles at a vertex.
//!
//! The effect on the stable step is known before an edge is split: by the mediant inequality, a node's stiffness over
//! mass is at most the largest of its triangles' at that corner, which is 3E/ρ times the sum of the inverse squares of
//! the corner's two edges. Triangles for which that sum exceeds twice the bound of the initial mesh are never made, so
//! that the stable step of the springs is never halved by cutting.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_dynamics::faulty::Faulty;

use super::topology_change::{TopologyChange, VertexChange};
use crate::mass_spring::NetworkError;

/// Least height of a new triangle, relative to the least of the initial mesh.
const HEIGHT: f64 = 0.35;

/// State of a sheet.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SheetState {
    /// Rest shape \[m\].
    pub rest: Vec<Point3<f64>>,
    /// Corners of each triangle.
    pub triangles: Vec<[u32; 3]>,
    /// Cut edges that are not open yet because the cut continues at neither end; the smaller vertex first, ascending.
    pub pending: Vec<[u32; 2]>,
    /// Ends of cuts, from which cuts continue.
    pub tips: Vec<u32>,
    /// Largest allowed sum of the inverse squares of a corner's edges \[1/m²\].
    pub corner_limit: f64,
    /// Least allowed height of a new triangle \[m\].
    pub height_limit: f64,
}

/// The mesh.
#[derive(Clone, Debug)]
pub struct Sheet {
    pub(super) state: SheetState,
    about: Vec<Vec<u32>>,
    pub(super) change: TopologyChange,
}

/// The edges of a triangle.
fn edges([a, b, c]: [u32; 3]) -> [[u32; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

pub(super) fn ordered(a: u32, b: u32) -> [u32; 2] {
    [a.min(b), a.max(b)]
}

/// For each corner the sum of the inverse squared edges, and the least height.
fn shape(corners: [Point3<f64>; 3]) -> ([f64; 3], f64) {
    let squared: [f64; 3] = std::array::from_fn(|at| (corners[(at + 1) % 3] - corners[at]).norm_squared());
    let doubled = (corners[1] - corners[0]).cross(&(corners[2] - corners[0])).norm();
    let rates = std::array::from_fn(|at| 1.0 / squared[at] + 1.0 / squared[(at + 2) % 3]);
    (rates, doubled / squared.iter().fold(0.0_f64, |most, square| most.max(*square)).sqrt())
}

impl Sheet {
    /// An uncut mesh in its rest shape.
    ///
    /// # Errors
    /// Non-finite vertices, triangles with missing corners or without area; all of a kind by index.
    pub fn new(rest: Vec<Point3<f64>>, triangles: Vec<[u32; 3]>) -> Result<Self, NetworkError> {
        let state = SheetState { rest, triangles, ..SheetState::default() };
        let mut sheet = Self::restore(state)?;
        let (mut sums, mut least) = (vec![[0.0; 2]; sheet.state.rest.len()], f64::INFINITY);
        for corners in &sheet.state.triangles {
            let (rates, height) = shape(corners.map(|vertex| sheet.state.rest[vertex as usize]));
            let area = crate::mass_spring::area(corners, &sheet.state.rest);
            least = least.min(height);
            for (vertex, rate) in corners.iter().zip(rates) {
                sums[*vertex as usize][0] += rate * area;
                sums[*vertex as usize][1] += area;
            }
        }
        let rate = |vertex: u32| sums[vertex as usize][0] / sums[vertex as usize][1];
        let of_edges = sheet.state.triangles.iter().flat_map(|corners| edges(*corners));
        let bound = of_edges.map(|[a, b]| rate(a) + rate(b)).fold(0.0, f64::max);
        sheet.state.corner_limit = 2.0 * bound;
        sheet.state.height_limit = HEIGHT * least;
        Ok(sheet)
    }

    /// Restores from a state.
    ///
    /// # Errors
    /// As [`new`](Self::new); also lists with missing vertices.
    pub fn restore(state: SheetState) -> Result<Self, NetworkError> {
        crate::mass_spring::check_elements("triangle", &state.rest, &state.triangles)?;
        Faulty::among(state.triangles.len(), |index| {
            let area = crate::mass_spring::area(&state.triangles[index], &state.rest);
            area.is_nan() || area <= 0.0
        })
        .refuse(|faulty| NetworkError::NoExtent { kind: "triangle", faulty })?;
        let nodes = state.rest.len();
        Faulty::among(state.pending.len(), |index| {
            let [a, b] = state.pending[index];
            a >= b || b as usize >= nodes
        })
        .refuse(|faulty| NetworkError::Nodes { kind: "pending edge", nodes, faulty })?;
        Faulty::among(state.tips.len(), |index| state.tips[index] as usize >= nodes)
            .refuse(|faulty| NetworkError::Nodes { kind: "tip", nodes, faulty })?;
        let mut about = vec![Vec::new(); nodes];
        for (index, corners) in state.triangles.iter().enumerate() {
            corners.iter().for_each(|&vertex| about[vertex as usize].push(index as u32));
        }
        Ok(Self { state, about, change: TopologyChange::default() })
    }

    /// The state.
    #[must_use]
    pub fn state(&self) -> &SheetState {
        &self.state
    }
    /// Rest shape \[m\].
    #[must_use]
    pub fn rest(&self) -> &[Point3<f64>] {
        &self.state.rest
    }
    /// Corners of each triangle.
    #[must_use]
    pub fn triangles(&self) -> &[[u32; 3]] {
        &self.state.triangles
    }
    /// Triangles around a vertex, ascending; none for a missing one.
    #[must_use]
    pub fn about(&self, vertex: u32) -> &[u32] {
        self.about.get(vertex as usize).map_or(&[], Vec::as_slice)
    }

    /// Removes triangles; returns the new number of each remaining one. Tips with remaining triangles, and cut edges
    /// that still are edges, are kept.
    pub fn take_out(&mut self, goes: impl Fn(u32) -> bool) -> Vec<Option<u32>> {
        let mut left = 0;
        let count = self.state.triangles.len() as u32;
        let number = |triangle| {
            let stays = !goes(triangle);
            left += u32::from(stays);
            stays.then_some(left.wrapping_sub(1))
        };
        let kept: Vec<Option<u32>> = (0..count).map(number).collect();
        let mut stays = kept.iter().map(Option::is_some);
        self.state.triangles.retain(|_| stays.next().unwrap_or(true));
        for star in &mut self.about {
            star.retain_mut(|triangle| match kept[*triangle as usize] {
                Some(number) => {
                    *triangle = number;
                    true
                }
                None => false,
            });
        }
        let mut pending = std::mem::take(&mut self.state.pending);
        pending.retain(|edge| self.about_edge(*edge).next().is_some());
        let mut tips = std::mem::take(&mut self.state.tips);
        tips.retain(|tip| !self.about(*tip).is_empty());
        (self.state.pending, self.state.tips) = (pending, tips);
        kept
    }

    /// Connected components by edges: for each triangle the lowest triangle of its component.
    #[must_use]
    pub fn pieces(&self) -> Vec<u32> {
        const NONE: u32 = u32::MAX;
        let mut piece = vec![NONE; self.state.triangles.len()];
        let mut open = Vec::new();
        for seed in 0..piece.len() as u32 {
            if piece[seed as usize] != NONE {
                continue;
            }
            piece[seed as usize] = seed;
            open.push(seed);
            while let Some(triangle) = open.pop() {
                for edge in edges(self.state.triangles[triangle as usize]) {
                    for other in self.about_edge(edge) {
                        if piece[other as usize] == NONE {
                            piece[other as usize] = seed;
                            open.push(other);
                        }
                    }
                }
            }
        }
        piece
    }

    /// Triangles on an edge, ascending.
    pub(super) fn about_edge(&self, [a, b]: [u32; 2]) -> impl Iterator<Item = u32> + '_ {
        let both = move |triangle: &&u32| self.state.triangles[**triangle as usize].contains(&b);
        self.about(a).iter().filter(both).copied()
    }
    pub(super) fn is_border(&self, edge: [u32; 2]) -> bool {
        self.about_edge(edge).take(2).count() == 1
    }
    /// Whether a vertex lies on a border of the mesh or on a cut.
    pub(super) fn on_border(&self, vertex: u32) -> bool {
        self.about(vertex).iter().any(|&triangle| {
            let around = edges(self.state.triangles[triangle as usize]);
            around.into_iter().any(|edge| edge.contains(&vertex) && self.is_border(edge))
        })
    }
    fn on_cut(&self, vertex: u32) -> bool {
        self.state.tips.contains(&vertex) || self.state.pending.iter().any(|edge| edge.contains(&vertex))
    }

    fn allowed(&self, corners: [Point3<f64>; 3], was: Vector3<f64>) -> bool {
        let (rates, height) = shape(corners);
        let normal = (corners[1] - corners[0]).cross(&(corners[2] - corners[0]));
        rates.iter().all(|&rate| rate <= self.state.corner_limit)
            && height >= self.state.height_limit
            && normal.dot(&was) > 0.0
    }
    fn normal(&self, triangle: u32) -> Vector3<f64> {
        let [a, b, c] =
            self.state.triangles[triangle as usize].map(|vertex| self.state.rest[vertex as usize]);
        (b - a).cross(&(c - a))
    }

    /// Whether an edge can be split there without making a triangle too small for its springs.
    pub(super) fn can_split(&self, [a, b]: [u32; 2], share: f64) -> bool {
        let rest = &self.state.rest;
        let point = rest[a as usize] + (rest[b as usize] - rest[a as usize]) * share;
        self.about_edge([a, b]).all(|triangle| {
            let corners = self.state.triangles[triangle as usize];
            [a, b].into_iter().all(|replaced| {
                let part =
                    corners.map(|vertex| if vertex == replaced { point } else { rest[vertex as usize] });
                self.allowed(part, self.normal(triangle))
            })
        })
    }

    /// Splits an edge; returns the new vertex.
    pub(super) fn split(&mut self, [a, b]: [u32; 2], share: f64) -> u32 {
        let rest = &mut self.state.rest;
        let new = rest.len() as u32;
        rest.push(rest[a as usize] + (rest[b as usize] - rest[a as usize]) * share);
        self.change.vertices.push(VertexChange::Between { edge: [a, b], share });
        self.about.push(Vec::new());
        let parted: Vec<u32> = self.about_edge([a, b]).collect();
        for triangle in parted {
            let corners = self.state.triangles[triangle as usize];
            let added = self.state.triangles.len() as u32;
            self.state.triangles[triangle as usize] =
                corners.map(|vertex| if vertex == b { new } else { vertex });
            self.state.triangles.push(corners.map(|vertex| if vertex == a { new } else { vertex }));
            self.change.triangles.push(triangle);
            self.change.stale.extend(corners);
            // Appended triangles have the highest index, so that all lists stay ascending.
            for vertex in corners {
                let list = &mut self.about[vertex as usize];
                if vertex == b {
                    list.retain(|&other| other != triangle);
                }
                if vertex != a {
                    list.push(added);
                }
            }
            self.about[new as usize].extend([triangle, added]);
        }
        self.about[new as usize].sort_unstable();
        self.change.stale.push(new);
        if let Ok(at) = self.state.pending.binary_search(&ordered(a, b)) {
            self.state.pending.remove(at);
            self.suspend(a, new);
            self.suspend(new, b);
        }
        new
    }

    /// Whether a vertex can move along an edge without making a triangle around it too small.
    pub(super) fn can_move(&self, vertex: u32, towards: u32, share: f64) -> bool {
        let rest = &self.state.rest;
        let point = rest[vertex as usize] + (rest[towards as usize] - rest[vertex as usize]) * share;
        !self.on_border(vertex)
            && !self.on_cut(vertex)
            && self.about(vertex).iter().all(|&triangle| {
                let corners = self.state.triangles[triangle as usize];
                let moved = corners.map(|of| if of == vertex { point } else { rest[of as usize] });
                self.allowed(moved, self.normal(triangle))
            })
    }

    pub(super) fn shift(&mut self, vertex: u32, towards: u32, share: f64) {
        let rest = &mut self.state.rest;
        let by = (rest[towards as usize] - rest[vertex as usize]) * share;
        rest[vertex as usize] += by;
        self.change.vertices.push(VertexChange::Moved { vertex, towards, share });
        for &triangle in &self.about[vertex as usize] {
            self.change.stale.extend(self.state.triangles[triangle as usize]);
        }
    }

    /// Marks an edge as cut; it opens where [`part`](Self::part) finds its triangles in different groups.
    pub(super) fn suspend(&mut self, a: u32, b: u32) {
        let edge = ordered(a, b);
        if let Err(at) = self.state.pending.binary_search(&edge) {
            self.state.pending.insert(at, edge);
        }
    }

    /// Gives each group of triangles around a vertex that is connected by uncut edges its own vertex.
    pub(super) fn part(&mut self, vertex: u32) {
        let fan = self.about[vertex as usize].clone();
        let mut group = vec![usize::MAX; fan.len()];
        let mut groups = 0;
        for seed in 0..fan.len() {
            if group[seed] != usize::MAX {
                continue;
            }
            group[seed] = groups;
            let mut open = vec![seed];
            while let Some(at) = open.pop() {
                for other in self.state.triangles[fan[at] as usize] {
                    let cut = self.state.pending.binary_search(&ordered(vertex, other)).is_ok();
                    if other == vertex || cut {
                        continue;
                    }
                    for next in 0..fan.len() {
                        let with = self.state.triangles[fan[next] as usize].contains(&other);
                        if with && group[next] == usize::MAX {
                            group[next] = groups;
                            open.push(next);
                        }
                    }
                }
            }
            groups += 1;
        }
        if groups < 2 {
            return;
        }
        let mut owners = vec![vertex];
        for of_group in 1..groups {
            let new = self.state.rest.len() as u32;
            self.state.rest.push(self.state.rest[vertex as usize]);
            self.change.vertices.push(VertexChange::Copy { of: vertex });
            let own: Vec<u32> =
                (0..fan.len()).filter(|&at| group[at] == of_group).map(|at| fan[at]).collect();
            for &triangle in &own {
                let corners = &mut self.state.triangles[triangle as usize];
                self.change.stale.extend(corners.iter());
                corners.iter_mut().filter(|corner| **corner == vertex).for_each(|corner| *corner = new);
            }
            self.about[vertex as usize].retain(|triangle| !own.contains(triangle));
            self.about.push(own);
            self.change.stale.push(new);
            owners.push(new);
        }
        for &triangle in &self.about[vertex as usize] {
            self.change.stale.extend(self.state.triangles[triangle as usize]);
        }
        // Cut edges within one group stay pending; the others are open.
        let waiting: Vec<u32> = {
            let of = self.state.pending.iter().filter(|edge| edge.contains(&vertex));
            of.map(|[a, b]| if *a == vertex { *b } else { *a }).collect()
        };
        self.state.pending.retain(|edge| !edge.contains(&vertex));
        for other in waiting {
            for &owner in &owners {
                if self.about_edge([owner, other]).take(2).count() == 2 {
                    self.suspend(owner, other);
                }
            }
        }
    }
}
