//! Disjoint sets of elements 0, 1, 2 …: what is connected with what.

/// Union-find with path halving (Tarjan, van Leeuwen 1984). The root of a set is its lowest element, so that it does not
/// depend on the order of the joins.
#[derive(Clone, Debug, Default)]
pub struct DisjointSets {
    /// An element of the same set, no higher; of a root itself.
    parents: Vec<u32>,
}

impl DisjointSets {
    /// Every element alone.
    ///
    /// # Panics
    /// When there are 2³² elements or more.
    #[must_use]
    pub fn new(elements: usize) -> Self {
        let mut sets = Self::default();
        sets.reset(elements);
        sets
    }

    /// Every element alone again, in the memory that is already there.
    ///
    /// # Panics
    /// When there are 2³² elements or more.
    pub fn reset(&mut self, elements: usize) {
        let elements = u32::try_from(elements).expect("elements have numbers of 32 bits");
        self.parents.clear();
        self.parents.extend(0..elements);
    }

    /// Number of elements.
    #[must_use]
    pub fn elements(&self) -> usize {
        self.parents.len()
    }

    /// Number of sets.
    #[must_use]
    pub fn sets(&self) -> usize {
        (0..self.elements()).filter(|&element| self.is_root(element)).count()
    }

    /// Whether an element is the lowest of its set.
    ///
    /// # Panics
    /// When there is no such element.
    #[must_use]
    pub fn is_root(&self, element: usize) -> bool {
        self.parents[element] as usize == element
    }

    /// The lowest element of the set of an element.
    ///
    /// # Panics
    /// When there is no such element.
    pub fn root(&mut self, mut element: usize) -> usize {
        while !self.is_root(element) {
            let next = self.parents[element] as usize;
            self.parents[element] = self.parents[next];
            element = self.parents[element] as usize;
        }
        element
    }

    /// Joins the sets of two elements; returns whether they were different ones.
    ///
    /// # Panics
    /// When there is no such element.
    pub fn join(&mut self, a: usize, b: usize) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        self.parents[a.max(b)] = a.min(b) as u32;
        a != b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_element_is_the_root_whatever_the_order_of_the_joins() {
        let pairs = [(7, 3), (3, 5), (8, 2), (5, 7), (2, 9)];
        for turn in 0..pairs.len() {
            let mut sets = DisjointSets::new(10);
            for at in 0..pairs.len() {
                let (a, b) = pairs[(at + turn) % pairs.len()];
                if at % 2 == 0 {
                    sets.join(a, b)
                } else {
                    sets.join(b, a)
                };
            }
            let roots: Vec<usize> = (0..10).map(|element| sets.root(element)).collect();
            assert_eq!(roots, [0, 1, 2, 3, 4, 3, 6, 3, 2, 2]);
            assert_eq!((sets.elements(), sets.sets()), (10, 6));
            assert!(sets.is_root(3) && !sets.is_root(5));
        }
    }

    #[test]
    fn a_join_says_whether_it_joined_and_a_reset_takes_all_apart() {
        let mut sets = DisjointSets::new(3);
        assert!(sets.join(2, 1) && sets.join(0, 2));
        assert!(!sets.join(0, 1) && !sets.join(1, 1));
        assert_eq!(sets.sets(), 1);
        sets.reset(2);
        assert_eq!((sets.elements(), sets.sets()), (2, 2));
        assert_eq!(DisjointSets::new(0).sets(), 0);
    }
}
