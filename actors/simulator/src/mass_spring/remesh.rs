//! A network that follows its mesh: where elements have changed, their springs, hinges and masses are derived anew, and all
//! else is kept. The lists are those of a network made of the whole mesh, to the bit, so that a solver rebuilt from its mesh
//! goes on as this one does.
//!
//! A spring is of the elements about its edge, a hinge of the two triangles about its own, a mass of the elements about its
//! node. So what can have changed has both its ends among the corners of changed elements, and nothing else is looked at;
//! behind it the lists move as a block.

use nalgebra::Point3;
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::faulty::Faulty;

use super::error::NetworkError;
use super::network::{Hinge, LEAST, LOOSE, Network, Spring};

/// A mesh that has changed, as whoever keeps it knows it.
#[derive(Clone, Copy)]
pub struct Patch<'a, const N: usize> {
    /// All nodes at rest \[m\].
    pub rest: &'a [Point3<f64>],
    /// Corners of all elements, by their numbers.
    pub elements: &'a [[u32; N]],
    /// What has become of an element that is there.
    pub altered: &'a dyn Fn(u32) -> Alteration,
    /// Elements about a node that are there, ascending.
    pub about: &'a dyn Fn(u32) -> &'a [u32],
    /// Corners of the elements that are others than before, are altered otherwise, are new or are gone, as they were and as they
    /// are; ascending. What is new among the nodes is among them.
    pub stale: &'a [u32],
}

impl<const N: usize> Patch<'_, N> {
    /// Edges of all elements about a node, ascending.
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

/// What has become of a list that is in ascending order of edges.
#[derive(Clone, Debug, PartialEq)]
pub struct Edits<T> {
    /// What is gone, and where in the list it was; ascending.
    pub gone: Vec<(usize, T)>,
    /// Where in the list what is now another is, and what it was; ascending.
    pub changed: Vec<(usize, T)>,
    /// Where in the list what is new is; ascending.
    pub come: Vec<usize>,
}

impl<T> Default for Edits<T> {
    fn default() -> Self {
        Self { gone: Vec::new(), changed: Vec::new(), come: Vec::new() }
    }
}

impl<T> Edits<T> {
    /// How many there are of all kinds.
    #[must_use]
    pub fn count(&self) -> usize {
        self.gone.len() + self.changed.len() + self.come.len()
    }
}

impl<T: Copy + PartialEq> Edits<T> {
    /// Puts `fresh` into a list in the place of those at `old`; both ascending by their keys.
    fn make(list: &mut Vec<T>, old: &[usize], fresh: &[T], key: impl Fn(&T) -> [u32; 2]) -> Self {
        let mut edits = Self::default();
        let mut come: Vec<(usize, T)> = Vec::new();
        let (mut old, mut fresh) = (old.iter().copied().peekable(), fresh.iter().peekable());
        loop {
            let is = old.peek().map(|&at| key(&list[at]));
            let wanted = fresh.peek().map(|of| key(of));
            match (is, wanted) {
                (None, None) => break,
                (Some(is), wanted) if wanted.is_none_or(|wanted| is < wanted) => {
                    edits.gone.extend(old.next().map(|at| (at, list[at])));
                }
                (is, Some(wanted)) if is.is_none_or(|is| wanted < is) => {
                    let at = list.partition_point(|of| key(of) < wanted);
                    come.extend(fresh.next().map(|of| (at, *of)));
                }
                _ => {
                    if let (Some(at), Some(of)) = (old.next(), fresh.next())
                        && list[at] != *of
                    {
                        let was = std::mem::replace(&mut list[at], *of);
                        // Where it will be.
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

    /// Lets another list that goes with it follow, with `new` for what is new.
    pub(crate) fn carry<U: Copy>(&self, list: &mut Vec<U>, new: U) {
        let gone: Vec<usize> = self.gone.iter().map(|(at, _)| *at).collect();
        // Where in the list before: what is gone before it counts again, and what is new does not.
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

/// Takes out what is at `gone` and puts in each of `come` before what is at its place, both ascending and by the list as it
/// was. Where those that have come are then.
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

/// What a network has derived anew.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Followed {
    /// Of its springs, by their place in its list.
    pub springs: Edits<Spring>,
    /// Of its hinges.
    pub hinges: Edits<Hinge>,
    /// Edges that were looked at.
    pub edges: usize,
    /// Nodes whose mass was.
    pub nodes: usize,
}

impl Followed {
    /// Nodes of whatever has changed, as it was and as it is, and the stale ones; ascending.
    pub(super) fn nodes<const N: usize>(&self, network: &Network, patch: &Patch<'_, N>) -> Vec<u32> {
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

/// What the elements about an edge make.
pub(super) type OfEdge = (Spring, Option<Hinge>);

impl Network {
    /// Follows a mesh: `extent` of each element, `share` the mass that a node has of one, by its extent, `edge` what those about an
    /// edge make.
    pub(super) fn follow<const N: usize>(
        &mut self,
        kind: &'static str,
        patch: &Patch<'_, N>,
        extent: impl Fn(&[u32; N]) -> f64,
        share: impl Fn(f64) -> f64,
        edge: impl Fn([u32; 2], &[u32]) -> OfEdge,
    ) -> Result<Followed, NetworkError> {
        let Patch { rest, elements, about, stale, .. } = *patch;
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
        fresh.check_numbers()?;
        let mut followed = Followed { edges: edges.len(), nodes: stale.len(), ..Followed::default() };
        let old = between(&self.springs, stale, |spring| spring.nodes);
        followed.springs = Edits::make(&mut self.springs, &old, &fresh.springs, |spring| spring.nodes);
        let old = between(&self.hinges, stale, Hinge::edge);
        followed.hinges = Edits::make(&mut self.hinges, &old, &fresh.hinges, Hinge::edge);
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

/// Where in a list are those with both ends among the stale nodes.
fn between<T>(list: &[T], stale: &[u32], key: impl Fn(&T) -> [u32; 2]) -> Vec<usize> {
    let mut found = Vec::new();
    for &node in stale {
        let first = list.partition_point(|of| key(of)[0] < node);
        let count = list[first..].partition_point(|of| key(of)[0] == node);
        let is_stale = |at: &usize| stale.binary_search(&key(&list[*at])[1]).is_ok();
        found.extend((first..first + count).filter(is_stale));
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What goes, changes and comes does so in the list and in one that goes with it.
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
