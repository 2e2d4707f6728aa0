//! A tree of axis-aligned boxes over the triangles of a surface, four children to a node, refitted as it deforms
//! (van den Bergen, *Efficient collision detection of complex deformable models using AABB trees*, 1997; nodes of four
//! boxes side by side: Wald, Benthin and Boulos, *Getting rid of packets*, 2008).
//!
//! The boxes are `f32`, rounded outwards: they are only used for culling; results come from the exact primitives on the
//! `f64` vertices. The triangles are split at their median, so that the depth of the tree and of every traversal is
//! bounded by the logarithm of their number for any mesh. Coordinates beyond 1e18 m may lose triangles.

mod bound;
mod build;
mod query;

pub use bound::Aabb;
pub use query::{NearestToPoint, NearestToSegment, QueryCost};

use std::sync::Arc;

use nalgebra::Point3;
use trocar_scene::components::{BoundingVolumeNode, BoundingVolumeTree};

use crate::{Surface, SurfaceError};

/// Boxes of a node.
const LANES: usize = 4;
/// A lane without a child.
const NONE: u32 = u32::MAX;

/// Four boxes side by side, one lane each; a lane without a child has an inverted box.
#[derive(Clone, Copy, Debug)]
#[repr(align(64))]
struct Node {
    min: [[f32; LANES]; 3],
    max: [[f32; LANES]; 3],
    /// A node, a triangle, or [`NONE`].
    child: [u32; LANES],
    /// One bit for each lane whose child is a triangle.
    leaves: u32,
}

impl Node {
    const EMPTY: Self = Self {
        min: [[f32::INFINITY; LANES]; 3],
        max: [[f32::NEG_INFINITY; LANES]; 3],
        child: [NONE; LANES],
        leaves: 0,
    };

    fn is_leaf(&self, lane: usize) -> bool {
        self.leaves & (1 << lane) != 0
    }

    fn set(&mut self, lane: usize, (low, high): &([f32; 3], [f32; 3])) {
        for axis in 0..3 {
            self.min[axis][lane] = low[axis];
            self.max[axis][lane] = high[axis];
        }
    }

    /// The box of all lanes.
    #[inline]
    fn whole(&self) -> ([f32; 3], [f32; 3]) {
        let low = self.min.map(|[a, b, c, d]| bound::smaller(bound::smaller(a, b), bound::smaller(c, d)));
        let high = self.max.map(|[a, b, c, d]| bound::larger(bound::larger(a, b), bound::larger(c, d)));
        (low, high)
    }

    /// The box of some lanes.
    fn union(&self, lanes: impl Iterator<Item = usize> + Clone) -> ([f32; 3], [f32; 3]) {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for axis in 0..3 {
            for lane in lanes.clone() {
                low[axis] = low[axis].min(self.min[axis][lane]);
                high[axis] = high[axis].max(self.max[axis][lane]);
            }
        }
        (low, high)
    }
}

/// The tree; it stores triangle indices and is queried together with the surface that it was last fitted to.
#[derive(Clone, Debug)]
pub struct AabbTree {
    /// Parents before their children, the root first.
    nodes: Vec<Node>,
    triangles: usize,
    /// Largest coordinate, which scales the error of `f32` arithmetic on boxes \[m\].
    scale: f32,
    /// Rounded vertices; buffer reused between refits.
    rounded: Vec<[f32; 4]>,
}

impl AabbTree {
    /// Builds it in O(n log n).
    #[must_use]
    pub fn new(surface: &Surface) -> Self {
        let mut tree =
            Self { nodes: Vec::new(), triangles: surface.triangles().len(), scale: 0.0, rounded: Vec::new() };
        build::build(&mut tree.nodes, surface);
        tree.fit(surface);
        tree
    }

    /// Refits the boxes to new vertex positions of the same triangles, in O(n), without allocating.
    ///
    /// # Errors
    /// [`SurfaceError::OtherTriangles`]: the number of triangles differs, so that the tree must be rebuilt.
    pub fn refit(&mut self, surface: &Surface) -> Result<(), SurfaceError> {
        let found = surface.triangles().len();
        if found != self.triangles {
            return Err(SurfaceError::OtherTriangles { expected: self.triangles, found });
        }
        self.fit(surface);
        Ok(())
    }

    /// Number of triangles.
    #[must_use]
    pub fn triangles(&self) -> usize {
        self.triangles
    }

    /// The bounding box; `None` without triangles.
    #[must_use]
    pub fn bounds(&self) -> Option<Aabb> {
        let (low, high) = self.nodes.first()?.whole();
        Some(Aabb { min: point(low), max: point(high) })
    }

    /// Its boxes as a binary tree, for the scene and the viewer; every leaf is one triangle.
    #[must_use]
    pub fn to_component(&self) -> BoundingVolumeTree {
        let mut boxes = vec![];
        if !self.nodes.is_empty() {
            boxes.push(Part { node: 0, lanes: self.occupied(0) });
        }
        let mut nodes = Vec::new();
        // Breadth first: the two parts of a box are adjacent, in the order in which they were found.
        let mut next = 0;
        while next < boxes.len() {
            let mut part = boxes[next];
            next += 1;
            let own = self.nodes[part.node].union(part.lanes());
            let mut node =
                BoundingVolumeNode { min: point(own.0), max: point(own.1), first: 0, primitives: 0 };
            if let (1, Some(lane)) = (part.lanes().count(), part.lanes().next()) {
                let child = self.nodes[part.node].child[lane];
                if self.nodes[part.node].is_leaf(lane) {
                    (node.first, node.primitives) = (child, 1);
                    nodes.push(node);
                    continue;
                }
                // A box with a single node is that node.
                part = Part { node: child as usize, lanes: self.occupied(child as usize) };
            }
            node.first = boxes.len() as u32;
            boxes.extend(part.halves());
            nodes.push(node);
        }
        BoundingVolumeTree { nodes: Arc::new(nodes) }
    }

    fn occupied(&self, node: usize) -> [bool; LANES] {
        self.nodes[node].child.map(|child| child != NONE)
    }

    fn fit(&mut self, surface: &Surface) {
        self.rounded.clear();
        self.rounded.extend(surface.vertices().iter().map(bound::rounded));
        let triangles = surface.triangles();
        for index in (0..self.nodes.len()).rev() {
            // Children come after their parents.
            let (front, behind) = self.nodes.split_at_mut(index + 1);
            let node = &mut front[index];
            for lane in 0..LANES {
                let child = node.child[lane];
                if child == NONE {
                    continue;
                }
                let bounds = if node.is_leaf(lane) {
                    bound::triangle(&triangles[child as usize], &self.rounded)
                } else {
                    behind[child as usize - index - 1].whole()
                };
                node.set(lane, &bounds);
            }
        }
        self.scale = self.nodes.first().map_or(0.0, |root| {
            let (low, high) = root.whole();
            low.iter().chain(&high).fold(0.0, |most: f32, coordinate| most.max(coordinate.abs()))
        });
    }
}

/// Some lanes of a node.
#[derive(Clone, Copy)]
struct Part {
    node: usize,
    lanes: [bool; LANES],
}

impl Part {
    fn lanes(self) -> impl Iterator<Item = usize> + Clone {
        (0..LANES).filter(move |&lane| self.lanes[lane])
    }

    /// The first and the second half of its lanes. There are at least two: only a surface of one triangle has a node
    /// with one child, and that is a leaf.
    fn halves(self) -> [Self; 2] {
        let first = self.lanes().count().div_ceil(2);
        let mut halves = [Self { node: self.node, lanes: [false; LANES] }; 2];
        for (place, lane) in self.lanes().enumerate() {
            halves[usize::from(place >= first)].lanes[lane] = true;
        }
        halves
    }
}

fn point(coordinates: [f32; 3]) -> Point3<f64> {
    Point3::from(coordinates.map(f64::from))
}
