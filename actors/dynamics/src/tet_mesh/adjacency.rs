//! Who is about each node: what follows a mesh where it has changed asks for nothing else of it.

/// Elements about each node, ascending: triangles or tetrahedra that are there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Stars {
    about: Vec<Vec<u32>>,
}

impl Stars {
    /// Of elements by their numbers, ascending, over so many nodes; a node that there is none of is one more.
    pub fn new<const N: usize>(nodes: usize, elements: impl Iterator<Item = (u32, [u32; N])>) -> Self {
        let mut stars = Self { about: vec![Vec::new(); nodes] };
        elements.for_each(|(element, corners)| stars.add(element, &corners));
        stars
    }

    /// The elements about a node; none about one that there is none of.
    #[must_use]
    pub fn about(&self, node: u32) -> &[u32] {
        self.about.get(node as usize).map_or(&[], Vec::as_slice)
    }

    /// An element that there is now.
    pub fn add(&mut self, element: u32, corners: &[u32]) {
        let nodes = corners.iter().map(|&node| node as usize + 1).max().unwrap_or(0);
        if self.about.len() < nodes {
            self.about.resize(nodes, Vec::new());
        }
        for &node in corners {
            let star = &mut self.about[node as usize];
            if let Err(at) = star.binary_search(&element) {
                star.insert(at, element);
            }
        }
    }

    /// An element that there is no longer.
    pub fn remove(&mut self, element: u32, corners: &[u32]) {
        for &node in corners {
            let Some(star) = self.about.get_mut(node as usize) else { continue };
            if let Ok(at) = star.binary_search(&element) {
                star.remove(at);
            }
        }
    }
}
