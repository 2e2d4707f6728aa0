//! Constraints in groups of which no two share a node: within a group their order does not matter, so that it can be taken
//! on any number of threads with the same result.

/// The order in which to take elements, and where each group ends.
#[derive(Clone, Debug, Default)]
pub(super) struct Colouring {
    pub order: Vec<u32>,
    pub ends: Vec<usize>,
}

impl Colouring {
    /// The first group that has none of its nodes yet, for each element in turn.
    pub fn new<const N: usize>(nodes: usize, elements: &[[u32; N]]) -> Self {
        // Of each node the groups that have it, 64 to a word.
        let mut taken: Vec<Vec<u64>> = vec![Vec::new(); nodes];
        let mut groups: Vec<Vec<u32>> = Vec::new();
        for (index, element) in elements.iter().enumerate() {
            let mut word = 0;
            let group = loop {
                let used = element
                    .iter()
                    .fold(0, |used, &node| used | taken[node as usize].get(word).copied().unwrap_or(0));
                if used != u64::MAX {
                    break 64 * word + used.trailing_ones() as usize;
                }
                word += 1;
            };
            for &node in element {
                let words = &mut taken[node as usize];
                words.resize(words.len().max(word + 1), 0);
                words[word] |= 1 << (group % 64);
            }
            groups.resize(groups.len().max(group + 1), Vec::new());
            groups[group].push(index as u32);
        }
        let mut colouring = Self::default();
        for group in groups {
            colouring.order.extend(group);
            colouring.ends.push(colouring.order.len());
        }
        colouring
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
        let colouring = Colouring::new(402, &elements);
        let mut seen = colouring.order.clone();
        seen.sort_unstable();
        assert_eq!(seen, (0..300).collect::<Vec<_>>());
        let mut from = 0;
        for &end in &colouring.ends {
            let mut nodes: Vec<u32> =
                colouring.order[from..end].iter().flat_map(|&at| elements[at as usize]).collect();
            nodes.sort_unstable();
            assert!(nodes.windows(2).all(|pair| pair[0] != pair[1]));
            from = end;
        }
    }
}
