//! Edge splits: a new node on an edge splits every element at the edge in two. The mesh stays conforming after any
//! number of splits.

use super::mean_ratio;
use super::topology::{NodeOrigin, SplitTet, Volume, VolumeChange};

impl Volume {
    /// The elements at an edge, ascending.
    fn about([a, b]: [u32; 2], volume: &Self) -> Vec<u32> {
        let has_both = |tet: &u32| volume.tet(*tet).is_some_and(|nodes| nodes.contains(&b));
        let mut star: Vec<u32> = volume.around[a as usize].iter().copied().filter(has_both).collect();
        star.sort_unstable();
        star
    }

    /// Minimum mean ratio of the elements that splitting an edge would make.
    pub(super) fn quality_of_halves(&self, [a, b]: [u32; 2], share: f64) -> f64 {
        let between = self.rest[a as usize] + (self.rest[b as usize] - self.rest[a as usize]) * share;
        let mut least = f64::INFINITY;
        for nodes in Self::about([a, b], self).into_iter().filter_map(|tet| self.tet(tet)) {
            for end in [a, b] {
                let places = nodes.map(|node| if node == end { between } else { self.rest[node as usize] });
                least = least.min(mean_ratio(&places, &[0, 1, 2, 3]));
            }
        }
        least
    }

    /// Inserts a node at a fraction of an edge. Of every element at the edge the half at the first end keeps the
    /// number; the other half is numbered after all others. Returns the new node.
    pub(super) fn halve(&mut self, [a, b]: [u32; 2], share: f64, change: &mut VolumeChange) -> u32 {
        let node = self.rest.len() as u32;
        let star = Self::about([a, b], self);
        let first = self.tets.len() as u32;
        let other_half = |tet: u32| star.binary_search(&tet).ok().map(|at| first + at as u32);
        self.rest.push(self.rest[a as usize] + (self.rest[b as usize] - self.rest[a as usize]) * share);
        self.shares.push(0.0);
        self.around.push(Vec::with_capacity(2 * star.len()));
        change.born.push(NodeOrigin { of: [a, b], share });
        for &tet in &star {
            let Some(nodes) = self.tets[tet as usize] else { continue };
            let child = self.tets.len() as u32;
            let sides = self.neighbours[tet as usize];
            let mut halves = [sides; 2];
            let mut ends = [0; 2];
            for (corner, &at) in nodes.iter().enumerate() {
                let face = corner as u8;
                if at == a {
                    // The face opposite to the first end belongs to the other half.
                    ends[0] = face;
                    halves[0][corner] = Some(child);
                    if let Some(beyond) = sides[corner] {
                        let back = &mut self.neighbours[beyond as usize];
                        back.iter_mut()
                            .filter(|side| **side == Some(tet))
                            .for_each(|side| *side = Some(child));
                    } else if self.boundary.remove(&(tet, face)) {
                        self.boundary.insert((child, face));
                    }
                } else if at == b {
                    ends[1] = face;
                    halves[1][corner] = Some(tet);
                } else {
                    halves[1][corner] = sides[corner].and_then(other_half);
                    if self.boundary.contains(&(tet, face)) {
                        self.boundary.insert((child, face));
                    }
                }
            }
            self.neighbours[tet as usize] = halves[0];
            self.neighbours.push(halves[1]);
            let replaced = |end: u32| nodes.map(|other| if other == end { node } else { other });
            self.tets[tet as usize] = Some(replaced(b));
            self.tets.push(Some(replaced(a)));
            let whole = self.volumes[tet as usize];
            self.volumes[tet as usize] = share * whole;
            self.volumes.push(whole - share * whole);
            self.around[b as usize].retain(|other| *other != tet);
            for at in nodes {
                self.shares[at as usize] -= 0.25 * whole;
                if at != a {
                    self.around[at as usize].push(child);
                }
            }
            self.around[node as usize].extend([tet, child]);
            for half in [tet, child] {
                let corners = replaced(if half == tet { b } else { a });
                corners.iter().for_each(|&at| self.shares[at as usize] += 0.25 * self.volumes[half as usize]);
            }
            self.left += 1;
            change.halved.push(SplitTet { tet, child, ends });
        }
        node
    }
}
