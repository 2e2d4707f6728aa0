//! Incremental update of a network after remeshing: springs, hinges and masses at changed elements are rebuilt, all
//! else is kept. The lists equal those of a network built from the whole mesh bit for bit, so that a solver rebuilt
//! from its mesh continues identically.
//!
//! A spring depends on the elements around its edge, a hinge on the two triangles at its edge, a mass on the elements
//! around its node. Anything that can change therefore has all its nodes among the corners of changed elements, and
//! nothing else is visited; the rest of the lists moves as a block.

use nalgebra::Point3;
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::faulty::Faulty;

use super::collapse::Tet;
use super::error::NetworkError;
use super::network::{Hinge, LEAST, LOOSE, Network, Spring};

/// A changed mesh, as its owner describes it.
#[derive(Clone, Copy)]
pub struct ChangedMesh<'a, const N: usize> {
    /// Rest positions of all nodes \[m\].
    pub rest: &'a [Point3<f64>],
    /// Corners of all elements, by their numbers.
    pub elements: &'a [[u32; N]],
    /// Alteration of an existing element.
    pub altered: &'a dyn Fn(u32) -> Alteration,
    /// Existing elements around a node, ascending.
    pub about: &'a dyn Fn(u32) -> &'a [u32],
    /// Former and present corners of the elements that changed, were altered, are new or were removed; ascending. They
    /// include all new nodes.
    pub stale: &'a [u32],
}

impl<const N: usize> ChangedMesh<'_, N> {
    /// Edges of all elements around a node, ascending.
    pub(crate) fn edges(&self, node: u32) -> Vec<[u32; 2]> {
        let about = (self.about)(node).iter();
        let mut edges: Vec<[u32; 2]> =
            about.flat_map(|&element| edges_of(&self.elements[element as usize])).collect();
        edges.sort_unstable();
        edges.dedup();
        edges
    }
}

/// The edges between the corners of an element, the smaller node first.
fn edges_of<const N: usize>(corners: &[u32; N]) -> impl Iterator<Item = [u32; 2]> {
    let corners = *corners;
    (0..N)
        .flat_map(move |at| (0..at).map(move |with| (corners[at], corners[with])))
        .map(|(a, b)| [a.min(b), a.max(b)])
}

/// Changes of a list sorted by edge.
#[derive(Clone, Debug, PartialEq)]
pub struct Edits<T> {
    /// Removed items and their former indices; ascending.
    pub gone: Vec<(usize, T)>,
    /// Present indices of changed items, and their former values; ascending.
    pub changed: Vec<(usize, T)>,
    /// Present indices of new items; ascending.
    pub come: Vec<usize>,
}

impl<T> Default for Edits<T> {
    fn default() -> Self {
        Self { gone: Vec::new(), changed: Vec::new(), come: Vec::new() }
    }
}

impl<T> Edits<T> {
    /// Number of changes of all kinds.
    #[must_use]
    pub fn count(&self) -> usize {
        self.gone.len() + self.changed.len() + self.come.len()
    }
}

impl<T: Copy + PartialEq> Edits<T> {
    /// Replaces the items at `old` by `fresh`; both sorted by key.
    fn make<K: Ord>(list: &mut Vec<T>, old: &[usize], fresh: &[T], key: impl Fn(&T) -> K) -> Self {
        let mut edits = Self::default();
        let mut come: Vec<(usize, T)> = Vec::new();
        let (mut old, mut fresh) = (old.iter().copied().peekable(), fresh.iter().peekable());
        loop {
            let is = old.peek().map(|&at| key(&list[at]));
            let wanted = fresh.peek().map(|of| key(of));
            match (is, wanted) {
                (None, None) => break,
                (Some(is), wanted) if wanted.as_ref().is_none_or(|wanted| is < *wanted) => {
                    edits.gone.extend(old.next().map(|at| (at, list[at])));
                }
                (is, Some(wanted)) if is.as_ref().is_none_or(|is| wanted < *is) => {
                    let at = list.partition_point(|of| key(of) < wanted);
                    come.extend(fresh.next().map(|of| (at, *of)));
                }
                _ => {
                    if let (Some(at), Some(of)) = (old.next(), fresh.next())
                        && list[at] != *of
                    {
                        let was = std::mem::replace(&mut list[at], *of);
                        // Its final index.
                        let to = at + come.len() - edits.gone.len();
                        edits.changed.push((to, was));
                    }
                }
            }
        }
        let gone: Vec<usize> = edits.gone.iter().map(|(at, _)| *at).collect();
        edits.come = splice(list, &gone, &come);
        edits
    }

    /// Applies the same changes to a parallel list, with `new` for new items.
    pub(crate) fn carry<U: Copy>(&self, list: &mut Vec<U>, new: U) {
        let gone: Vec<usize> = self.gone.iter().map(|(at, _)| *at).collect();
        // Former index: counts removed items before it, and skips new ones.
        let mut left = gone.iter().copied().peekable();
        let mut come = Vec::with_capacity(self.come.len());
        let mut passed = 0;
        for (count, &at) in self.come.iter().enumerate() {
            let mut before = at - count + passed;
            while left.next_if(|gone| *gone <= before).is_some() {
                passed += 1;
                before += 1;
            }
            come.push((before, new));
        }
        splice(list, &gone, &come);
    }
}

/// Removes the items at `gone` and inserts each of `come` before its index, both ascending and in terms of the former
/// list. Returns the final indices of the inserted items.
fn splice<T: Copy>(list: &mut Vec<T>, gone: &[usize], come: &[(usize, T)]) -> Vec<usize> {
    let mut places = Vec::with_capacity(come.len());
    let first = gone.first().copied().into_iter().chain(come.first().map(|(at, _)| *at)).min();
    let Some(first) = first else { return places };
    let tail = list.split_off(first);
    let (mut gone, mut come) = (gone.iter().peekable(), come.iter().peekable());
    let mut at = first;
    loop {
        let next = gone.peek().map(|gone| **gone).into_iter().chain(come.peek().map(|come| come.0)).min();
        list.extend_from_slice(&tail[at - first..next.map_or(tail.len(), |next| next - first)]);
        let Some(next) = next else { return places };
        at = next;
        while let Some((_, of)) = come.next_if(|come| come.0 == next) {
            places.push(list.len());
            list.push(*of);
        }
        if gone.next_if(|gone| **gone == next).is_some() {
            at += 1;
        }
    }
}

/// Changes of a network.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct NetworkChange {
    /// Changed springs, by index.
    pub springs: Edits<Spring>,
    /// Changed hinges.
    pub hinges: Edits<Hinge>,
    /// Changed tetrahedra.
    pub tets: Edits<Tet>,
    /// Number of edges visited.
    pub edges: usize,
    /// Number of node masses recomputed.
    pub nodes: usize,
}

impl NetworkChange {
    /// Former and present nodes of everything that changed, and the stale ones; ascending.
    pub(super) fn nodes<const N: usize>(&self, network: &Network, patch: &ChangedMesh<'_, N>) -> Vec<u32> {
        let mut nodes = patch.stale.to_vec();
        let Edits { gone, changed, come } = &self.springs;
        gone.iter().chain(changed).for_each(|(_, of)| nodes.extend(of.nodes));
        let now = changed.iter().map(|(at, _)| at).chain(come);
        now.for_each(|&at| nodes.extend(network.springs[at].nodes));
        let Edits { gone, changed, come } = &self.hinges;
        gone.iter().chain(changed).for_each(|(_, of)| nodes.extend(of.nodes));
        let now = changed.iter().map(|(at, _)| at).chain(come);
        now.for_each(|&at| nodes.extend(network.hinges[at].nodes));
        nodes.sort_unstable();
        nodes.dedup();
        nodes
    }
}

/// Spring and hinge of an edge.
pub(super) type EdgeElements = (Spring, Option<Hinge>);

impl Network {
    /// Updates to a mesh: `extent` is that of an element, `share` a node's mass from an element by its extent, `edge`
    /// builds the spring and hinge from the elements around an edge, `tet` what keeps an element from collapsing.
    pub(super) fn follow<const N: usize>(
        &mut self,
        kind: &'static str,
        patch: &ChangedMesh<'_, N>,
        extent: impl Fn(&[u32; N]) -> f64,
        share: impl Fn(f64) -> f64,
        tet: impl Fn(u32) -> Option<Tet>,
        edge: impl Fn([u32; 2], &[u32]) -> EdgeElements,
    ) -> Result<NetworkChange, NetworkError> {
        let ChangedMesh { rest, elements, about, stale, .. } = *patch;
        let nodes = rest.len();
        Faulty::among(stale.len(), |at| stale[at] as usize >= nodes)
            .refuse(|faulty| NetworkError::Nodes { kind: "changed node", nodes, faulty })?;
        let is_stale = |node: &u32| stale.binary_search(node).is_ok();
        let mut touched: Vec<u32> = stale.iter().flat_map(|&node| about(node)).copied().collect();
        touched.sort_unstable();
        touched.dedup();
        let bad = |element: &u32| {
            let extent = extent(&elements[*element as usize]);
            extent.is_nan() || extent <= LEAST
        };
        let first: Vec<u32> = touched.iter().copied().filter(bad).collect();
        let count = first.len();
        Faulty { first, count }.refuse(|faulty| NetworkError::NoExtent { kind, faulty })?;

        let all = touched.iter().flat_map(|&element| edges_of(&elements[element as usize]));
        let mut edges: Vec<[u32; 2]> = all.filter(|edge| edge.iter().all(is_stale)).collect();
        edges.sort_unstable();
        edges.dedup();
        let mut fresh = Self::default();
        let mut around: Vec<u32> = Vec::new();
        for &nodes in &edges {
            around.clear();
            let has_both = |element: &&u32| elements[**element as usize].contains(&nodes[1]);
            around.extend(about(nodes[0]).iter().filter(has_both));
            let (spring, hinge) = edge(nodes, &around);
            fresh.springs.push(spring);
            fresh.hinges.extend(hinge);
        }
        let whole = touched.iter().filter(|element| elements[**element as usize].iter().all(is_stale));
        fresh.tets.extend(whole.filter_map(|&element| tet(element)));
        fresh.tets.sort_by_key(|tet| tet.nodes);
        fresh.check_numbers()?;
        let mut followed =
            NetworkChange { edges: edges.len(), nodes: stale.len(), ..NetworkChange::default() };
        let old = between(&self.springs, stale, |spring| spring.nodes);
        followed.springs = Edits::make(&mut self.springs, &old, &fresh.springs, |spring| spring.nodes);
        let old = between(&self.hinges, stale, Hinge::edge);
        followed.hinges = Edits::make(&mut self.hinges, &old, &fresh.hinges, Hinge::edge);
        let old = between(&self.tets, stale, |tet| tet.nodes);
        followed.tets = Edits::make(&mut self.tets, &old, &fresh.tets, |tet| tet.nodes);
        let known = self.rest.len();
        self.rest.extend_from_slice(&rest[known.min(nodes)..]);
        self.masses.resize(nodes, LOOSE);
        for &node in stale {
            self.rest[node as usize] = rest[node as usize];
            let of = about(node).iter().map(|&element| share(extent(&elements[element as usize])));
            let mass: f64 = of.fold(0.0, |sum, share| sum + share);
            self.masses[node as usize] = if mass > 0.0 { mass } else { LOOSE };
        }
        Ok(followed)
    }
}

/// Indices of list items with all their nodes among the stale ones.
fn between<T, const N: usize>(list: &[T], stale: &[u32], key: impl Fn(&T) -> [u32; N]) -> Vec<usize> {
    let mut found = Vec::new();
    for &node in stale {
        let first = list.partition_point(|of| key(of)[0] < node);
        let count = list[first..].partition_point(|of| key(of)[0] == node);
        let is_stale = |at: &usize| key(&list[*at])[1..].iter().all(|node| stale.binary_search(node).is_ok());
        found.extend((first..first + count).filter(is_stale));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Removals, changes and insertions apply to the list and to its parallel list.
    #[test]
    fn a_list_and_one_that_goes_with_it_follow() {
        let key = |of: &([u32; 2], u32)| of.0;
        let before: Vec<([u32; 2], u32)> = [1, 3, 4, 7, 9].map(|at| ([at, at], at)).to_vec();
        for (old, fresh) in [
            (vec![1, 2, 3], vec![0, 3, 5, 6, 7]),
            (vec![0, 4], vec![10, 11]),
            (vec![], vec![2, 8]),
            (vec![0, 1, 2, 3, 4], vec![]),
            (vec![2, 3], vec![4, 5, 7, 8]),
        ] {
            let fresh: Vec<([u32; 2], u32)> = fresh.into_iter().map(|at| ([at, at], 100 + at)).collect();
            let mut list = before.clone();
            let edits = Edits::make(&mut list, &old, &fresh, key);
            let mut anew: Vec<_> = (0..5).filter(|at| !old.contains(at)).map(|at| before[at]).collect();
            anew.extend(&fresh);
            anew.sort_unstable();
            assert_eq!(list, anew);
            let mut with: Vec<[u32; 2]> = before.iter().map(key).collect();
            edits.carry(&mut with, [u32::MAX; 2]);
            for (at, of) in with.iter().enumerate() {
                let is_new = edits.come.contains(&at);
                assert_eq!(*of, if is_new { [u32::MAX; 2] } else { list[at].0 });
            }
            assert_eq!(with.len(), list.len());
            edits.changed.iter().for_each(|(at, was)| assert_eq!((was.0, was.1 + 100), list[*at]));
        }
    }
}
