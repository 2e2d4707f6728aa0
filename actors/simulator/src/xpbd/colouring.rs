//! Graph colouring of constraints: no two constraints of one colour share a node. Within a colour their order does not
//! matter, so that any number of threads gives the same result.
//!
//! A constraint's colour depends on all constraints before it. Constraints added later, where a mesh is cut, take the
//! first free colour at their nodes and leave all others unchanged. A solver that continues from a saved state
//! therefore has to be given the colours.

use trocar_dynamics::faulty::Faulty;

use super::constraint::Constraint;
use crate::mass_spring::{Edits, NetworkError};

/// The colour of a missing constraint.
pub(super) const NONE: u16 = u16::MAX;
/// Maximum number of colours; a node with more constraints is rejected.
pub(super) const GROUPS_MAX: usize = 4096;

/// Set of used colours, 64 to a word.
#[derive(Clone, Debug, Default)]
pub(super) struct UsedColours {
    words: Vec<u64>,
}

impl UsedColours {
    /// Marks one as used.
    pub fn take(&mut self, group: u16) {
        let word = group as usize / 64;
        self.words.resize(self.words.len().max(word + 1), 0);
        self.words[word] |= 1 << (group % 64);
    }
    fn has(&self, group: u16) -> bool {
        self.words.get(group as usize / 64).is_some_and(|word| word & (1 << (group % 64)) != 0)
    }
    /// The first colour free in all of the sets.
    pub fn first_free<'a>(of: impl Iterator<Item = &'a Self> + Clone) -> u16 {
        let used = |word: usize| {
            of.clone().fold(0, |used, taken| used | taken.words.get(word).copied().unwrap_or(0))
        };
        let word = (0..).find(|&word| used(word) != u64::MAX).unwrap_or(0);
        (64 * word + used(word).trailing_ones() as usize) as u16
    }
}

/// Colour of each element: greedily the first that is free at its nodes, in order; or the `known` ones, where removed
/// elements block none.
///
/// # Errors
/// An element with as many neighbours as there are colours; known colours for another number of elements, or two
/// elements of one colour at a node.
pub(super) fn groups<const N: usize>(
    kind: &'static str,
    nodes: usize,
    elements: &[[u32; N]],
    known: &[u16],
    is_gone: impl Fn(usize) -> bool,
) -> Result<Vec<u16>, NetworkError> {
    let mut taken: Vec<UsedColours> = vec![UsedColours::default(); nodes];
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
            None => UsedColours::first_free(element.iter().map(|&node| &taken[node as usize])),
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

/// Constraints colour by colour, within each in the order of the given list.
#[derive(Clone, Debug, Default)]
pub(super) struct Coloured<C> {
    pub groups: Vec<Vec<C>>,
    /// The colour of each constraint of the list.
    pub of: Vec<u16>,
}

/// A constraint derived from a mesh.
pub(super) trait MeshConstraint<const N: usize>: Constraint + Copy + PartialEq {
    /// Name of the kind, for messages.
    const KIND: &'static str;
    fn nodes(&self) -> [u32; N];
    /// Its edge; a mesh has at most one of a kind at each.
    fn edge(&self) -> [u32; 2] {
        let nodes = self.nodes();
        [nodes[0], nodes[1]]
    }
}

impl<C> Coloured<C> {
    /// From a list; `known` are saved colours, if any.
    ///
    /// # Errors
    /// As [`groups`].
    pub fn new<const N: usize>(nodes: usize, all: &[C], known: &[u16]) -> Result<Self, NetworkError>
    where
        C: MeshConstraint<N>,
    {
        let elements: Vec<[u32; N]> = all.iter().map(MeshConstraint::nodes).collect();
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

    /// All constraints, colour by colour.
    pub fn all(&self) -> impl Iterator<Item = &C> {
        self.groups.iter().flatten()
    }

    /// Updates to the changed list `all`, which is sorted by edge. `edges` gives the edges of the elements around a
    /// node.
    pub fn follow<const N: usize, T>(
        &mut self,
        all: &[T],
        made: impl Fn(&T) -> C,
        edits: &Edits<T>,
        edges: impl Fn(u32) -> Vec<[u32; 2]>,
    ) where
        C: MeshConstraint<N>,
        T: Copy + PartialEq,
    {
        for (at, was) in &edits.gone {
            self.take_out(self.of[*at], &made(was).edge());
        }
        edits.carry(&mut self.of, NONE);
        // A constraint with other nodes may need another colour.
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
            let mut taken = UsedColours::default();
            for node in one.nodes() {
                for edge in edges(node) {
                    let Ok(other) = all.binary_search_by_key(&edge, |of| made(of).edge()) else { continue };
                    let group = self.of[other];
                    if group != NONE && made(&all[other]).nodes().contains(&node) {
                        taken.take(group);
                    }
                }
            }
            let group = UsedColours::first_free(std::iter::once(&taken));
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
        C: MeshConstraint<N>,
    {
        let group = self.groups.get(group as usize).map_or(&[][..], Vec::as_slice);
        group.binary_search_by_key(edge, MeshConstraint::edge)
    }

    fn take_out<const N: usize>(&mut self, group: u16, edge: &[u32; 2])
    where
        C: MeshConstraint<N>,
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
