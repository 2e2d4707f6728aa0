//! Node-to-element adjacency, updated incrementally when a mesh changes.

/// Present elements at each node, ascending: triangles or tetrahedra.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NodeAdjacency {
    about: Vec<Vec<u32>>,
}

impl NodeAdjacency {
    /// From numbered elements, in ascending order, and the node count; a node beyond it is added.
    pub fn new<const N: usize>(nodes: usize, elements: impl Iterator<Item = (u32, [u32; N])>) -> Self {
        let mut stars = Self { about: vec![Vec::new(); nodes] };
        elements.for_each(|(element, corners)| stars.add(element, &corners));
        stars
    }

    /// The elements at a node; empty for an unknown node.
    #[must_use]
    pub fn about(&self, node: u32) -> &[u32] {
        self.about.get(node as usize).map_or(&[], Vec::as_slice)
    }

    /// Adds an element.
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

    /// Removes an element.
    pub fn remove(&mut self, element: u32, corners: &[u32]) {
        for &node in corners {
            let Some(star) = self.about.get_mut(node as usize) else { continue };
            if let Ok(at) = star.binary_search(&element) {
                star.remove(at);
            }
        }
    }
}
