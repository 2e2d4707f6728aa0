//! Remeshing of an XPBD body: constraints at changed elements are rebuilt and take the first free colours; all others
//! are kept.

use nalgebra::Point3;
use trocar_dynamics::faulty::Faulty;
use trocar_dynamics::particles::State;

use super::constraint::{Bend, Distance};
use super::{Xpbd, tetrahedra};
use crate::mass_spring::{ChangedMesh, Network, NetworkChange, NetworkError};

/// Tetrahedra that are new or have other corners.
#[derive(Clone, Copy)]
pub struct SplitTets<'a> {
    /// Rest positions of all nodes \[m\].
    pub rest: &'a [Point3<f64>],
    /// Corners of all tetrahedra.
    pub tets: &'a [[u32; 4]],
    /// Changed tetrahedra, ascending; new ones are numbered after all others, and all of them are listed.
    pub changed: &'a [u32],
}

impl Xpbd {
    /// Updates the body to a network updated to its mesh: cloth that is cut, torn or burned. `carry` gives new nodes a
    /// state, `stays` tells which nodes are pinned. Returns the number of constraints added, removed or renumbered.
    ///
    /// # Errors
    /// A state that does not fit.
    pub fn follow_network(
        &mut self,
        network: &Network,
        followed: &NetworkChange,
        patch: &ChangedMesh<'_, 3>,
        stays: impl Fn(u32) -> bool,
        carry: impl FnOnce(&mut State),
    ) -> Result<usize, NetworkError> {
        let masses = &network.masses;
        self.own.resize(masses.len(), 0.0);
        patch.stale.iter().for_each(|&node| self.own[node as usize] = masses[node as usize]);
        self.grow(masses.len(), patch.stale, stays, carry)?;
        let edges = |node: u32| patch.edges(node);
        self.distances.follow(&network.springs, |spring| Distance::from(spring), &followed.springs, edges);
        self.bends.follow(&network.hinges, |hinge: &Bend| *hinge, &followed.hinges, edges);
        Ok(followed.springs.count() + followed.hinges.count())
    }

    /// Updates the body to tetrahedra that were subdivided or separated. Their stiffness and rest length follow from
    /// their rest shape; `carry` gives new nodes a state, `stays` tells which nodes are pinned. Returns the number of
    /// tetrahedra added.
    ///
    /// # Errors
    /// Tetrahedra without volume or with missing corners; nothing has changed then. A state that does not fit.
    pub fn split(
        &mut self,
        split: &SplitTets<'_>,
        stays: impl Fn(u32) -> bool,
        carry: impl FnOnce(&mut State),
    ) -> Result<usize, NetworkError> {
        let SplitTets { rest, changed, tets } = *split;
        let nodes = rest.len();
        let among = |bad: &dyn Fn(&[u32; 4]) -> bool| {
            let is_bad = |number: &u32| tets.get(*number as usize).is_none_or(bad);
            let all: Vec<u32> = changed.iter().copied().filter(is_bad).collect();
            Faulty { count: all.len(), first: all.into_iter().take(16).collect() }
        };
        among(&|tet| tet.iter().any(|&node| node as usize >= nodes))
            .refuse(|faulty| NetworkError::Nodes { kind: "tetrahedron", nodes, faulty })?;
        among(&|tet| {
            let volume = tetrahedra::volume_of(rest, tet);
            volume.is_nan() || volume <= tetrahedra::LEAST
        })
        .refuse(|faulty| NetworkError::NoExtent { kind: "tetrahedron", faulty })?;
        let mut stale = Vec::new();
        for &number in changed {
            let tet = tets[number as usize];
            stale.extend(self.tets.put(rest, number, tet).into_iter().flatten());
            stale.extend(tet);
        }
        stale.sort_unstable();
        stale.dedup();
        self.grow(nodes, &stale, stays, carry)?;
        Ok(changed.len())
    }

    /// Adds new nodes, and updates nodes whose mass changed.
    fn grow(
        &mut self,
        nodes: usize,
        stale: &[u32],
        stays: impl Fn(u32) -> bool,
        carry: impl FnOnce(&mut State),
    ) -> Result<(), NetworkError> {
        self.network = None;
        carry(&mut self.state);
        let State { positions, velocities } = &self.state;
        for (what, given) in [("positions", positions.len()), ("velocities", velocities.len())] {
            if given != nodes {
                return Err(NetworkError::Length { what, given, expected: nodes });
            }
        }
        self.masses.resize(nodes, 0.0);
        self.mobility.resize(nodes, 0.0);
        for &node in stale {
            match (self.pinned.binary_search(&node), stays(node)) {
                (Err(at), true) => self.pinned.insert(at, node),
                (Ok(at), false) => drop(self.pinned.remove(at)),
                _ => {}
            }
            self.weigh(node);
        }
        Ok(())
    }
}
