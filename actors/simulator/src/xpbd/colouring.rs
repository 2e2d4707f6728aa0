//! Constraints in groups of which no two share a node: within a group their order does not matter, so that it can be taken
//! on any number of threads with the same result.
//!
//! Which group a constraint is in is a matter of all that came before it. So those that come later, where a mesh comes apart,
//! take the first group that is free about them and leave all others where they are; and whoever goes on from there has
//! to be told the groups.

use trocar_dynamics::faulty::Faulty;

use super::constraint::Constraint;
use crate::mass_spring::{Edits, NetworkError};

/// The group of what is no constraint.
pub(super) const NONE: u16 = u16::MAX;
/// Groups at most; a node that is of more constraints than that makes no body.
pub(super) const GROUPS_MAX: usize = 4096;

/// Groups that are taken, 64 to a word.
#[derive(Clone, Debug, Default)]
pub(super) struct Taken {
    words: Vec<u64>,
}

impl Taken {
    /// Takes one.
    pub fn take(&mut self, group: u16) {
        let word = group as usize / 64;
        self.words.resize(self.words.len().max(word + 1), 0);
        self.words[word] |= 1 << (group % 64);
    }
    fn has(&self, group: u16) -> bool {
        self.words.get(group as usize / 64).is_some_and(|word| word & (1 << (group % 64)) != 0)
    }
    /// The first that none of them has.
    pub fn first_free<'a>(of: impl Iterator<Item = &'a Self> + Clone) -> u16 {
        let used = |word: usize| {
            of.clone().fold(0, |used, taken| used | taken.words.get(word).copied().unwrap_or(0))
        };
        let word = (0..).find(|&word| used(word) != u64::MAX).unwrap_or(0);
        (64 * word + used(word).trailing_ones() as usize) as u16
    }
}

/// The group of each element: the first that has none of its nodes yet, for each in turn; or as they are `known`, where those
/// that are gone are in nobody's way.
///
/// # Errors
/// One has as many neighbours as there are groups; known groups of another number of elements, or one that has a node
/// twice.
pub(super) fn groups<const N: usize>(
    kind: &'static str,
    nodes: usize,
    elements: &[[u32; N]],
    known: &[u16],
    is_gone: impl Fn(usize) -> bool,
) -> Result<Vec<u16>, NetworkError> {
    let mut taken: Vec<Taken> = vec![Taken::default(); nodes];
    let expected = elements.len();
    if !(known.is_empty() || known.len() == expected) {
        return Err(NetworkError::Length { what: "groups", given: known.len(), expected });
    }
    let mut groups = Vec::with_capacity(expected);
    let mut twice = Vec::new();
    for (index, element) in elements.iter().enumerate() {
        let group = match known.get(index) {
            Some(&group) if is_gone(index) => {
                groups.push(group.min(GROUPS_MAX as u16 - 1));
                continue;
            }
            Some(&group) => {
                if element.iter().any(|&node| taken[node as usize].has(group)) {
                    twice.push(index as u32);
                }
                group
            }
            None => Taken::first_free(element.iter().map(|&node| &taken[node as usize])),
        };
        if group as usize >= GROUPS_MAX {
            twice.push(index as u32);
        } else {
            element.iter().for_each(|&node| taken[node as usize].take(group));
        }
        groups.push(group);
    }
    Faulty { count: twice.len(), first: twice.into_iter().take(16).collect() }
        .refuse(|faulty| NetworkError::Groups { kind, faulty })?;
    Ok(groups)
}

/// Constraints group by group, in each in the order of the list that they were given in.
#[derive(Clone, Debug, Default)]
pub(super) struct Coloured<C> {
    pub groups: Vec<Vec<C>>,
    /// The group of each of the list.
    pub of: Vec<u16>,
}

/// A constraint that a mesh made.
pub(super) trait OfMesh<const N: usize>: Constraint + Copy + PartialEq {
    /// For messages.
    const KIND: &'static str;
    fn nodes(&self) -> [u32; N];
    /// The edge that it is along or across; on a mesh there is one of a kind at each.
    fn edge(&self) -> [u32; 2] {
        let nodes = self.nodes();
        [nodes[0], nodes[1]]
    }
}

impl<C> Coloured<C> {
    /// Of a list; `known` are the groups of each, if somebody has said so.
    ///
    /// # Errors
    /// As [`groups`].
    pub fn new<const N: usize>(nodes: usize, all: &[C], known: &[u16]) -> Result<Self, NetworkError>
    where
        C: OfMesh<N>,
    {
        let elements: Vec<[u32; N]> = all.iter().map(OfMesh::nodes).collect();
        let of = groups(C::KIND, nodes, &elements, known, |_| false)?;
        let mut coloured = Self { groups: Vec::new(), of };
        for (one, &group) in all.iter().zip(&coloured.of) {
            if coloured.groups.len() <= group as usize {
                coloured.groups.resize(group as usize + 1, Vec::new());
            }
            coloured.groups[group as usize].push(*one);
        }
        Ok(coloured)
    }

    /// All of them, group by group.
    pub fn all(&self) -> impl Iterator<Item = &C> {
        self.groups.iter().flatten()
    }

    /// Follows the list `all`, which is in ascending order of edges, of which something has become. `edges` are those of the
    /// elements about a node.
    pub fn follow<const N: usize, T>(
        &mut self,
        all: &[T],
        made: impl Fn(&T) -> C,
        edits: &Edits<T>,
        edges: impl Fn(u32) -> Vec<[u32; 2]>,
    ) where
        C: OfMesh<N>,
        T: Copy + PartialEq,
    {
        for (at, was) in &edits.gone {
            self.take_out(self.of[*at], &made(was).edge());
        }
        edits.carry(&mut self.of, NONE);
        // What reaches to other nodes than before may have to be of another group.
        let mut come = edits.come.clone();
        for (at, was) in &edits.changed {
            let (was, is) = (made(was), made(&all[*at]));
            let group = self.of[*at];
            if was.nodes() == is.nodes() {
                if let Ok(place) = self.place(group, &is.edge()) {
                    self.groups[group as usize][place] = is;
                }
            } else {
                self.take_out(group, &was.edge());
                self.of[*at] = NONE;
                come.push(*at);
            }
        }
        come.sort_unstable();
        for at in come {
            let one = made(&all[at]);
            let mut taken = Taken::default();
            for node in one.nodes() {
                for edge in edges(node) {
                    let Ok(other) = all.binary_search_by_key(&edge, |of| made(of).edge()) else { continue };
                    let group = self.of[other];
                    if group != NONE && made(&all[other]).nodes().contains(&node) {
                        taken.take(group);
                    }
                }
            }
            let group = Taken::first_free(std::iter::once(&taken));
            if self.groups.len() <= group as usize {
                self.groups.resize(group as usize + 1, Vec::new());
            }
            if let Err(place) = self.place(group, &one.edge()) {
                self.groups[group as usize].insert(place, one);
            }
            self.of[at] = group;
        }
    }

    fn place<const N: usize>(&self, group: u16, edge: &[u32; 2]) -> Result<usize, usize>
    where
        C: OfMesh<N>,
    {
        let group = self.groups.get(group as usize).map_or(&[][..], Vec::as_slice);
        group.binary_search_by_key(edge, OfMesh::edge)
    }

    fn take_out<const N: usize>(&mut self, group: u16, edge: &[u32; 2])
    where
        C: OfMesh<N>,
    {
        if let Ok(place) = self.place(group, edge) {
            self.groups[group as usize].remove(place);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_two_of_a_group_share_a_node_and_none_is_lost() {
        let mut elements: Vec<[u32; 3]> =
            (0..200_u32).map(|i| [i * 7 % 60, 60 + i * 11 % 40, 100 + i % 90]).collect();
        // A node with more neighbours than a word has bits.
        elements.extend((0..100_u32).map(|i| [200, 201 + 2 * i, 202 + 2 * i]));
        let of = groups("triangle", 402, &elements, &[], |_| false).expect("groups");
        assert_eq!(of.len(), 300);
        for group in 0..=of.iter().copied().max().expect("some") {
            let own = elements.iter().zip(&of).filter(|(_, of)| **of == group);
            let mut nodes: Vec<u32> = own.flat_map(|(element, _)| *element).collect();
            nodes.sort_unstable();
            assert!(!nodes.is_empty() && nodes.windows(2).all(|pair| pair[0] != pair[1]));
        }
        assert_eq!(groups("triangle", 402, &elements, &of, |_| false).expect("the same"), of);
        let mut wrong = of.clone();
        wrong[299] = of[298];
        let error = groups("triangle", 402, &elements, &wrong, |_| false).expect_err("they share node 200");
        assert!(error.to_string().contains("299"), "{error}");
        assert!(groups("triangle", 402, &elements, &wrong, |at| at == 299).is_ok(), "it is gone");
        assert!(groups("triangle", 402, &elements, &of[1..], |_| false).is_err());
    }
}
