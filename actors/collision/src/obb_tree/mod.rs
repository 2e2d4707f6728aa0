//! A tree of oriented boxes over a triangle surface (Gottschalk, Lin, Manocha, *OBBTree: A Hierarchical Structure for
//! Rapid Interference Detection*, 1996), four children to a node and four triangles to a leaf, so that one box is
//! tested against four at once with SIMD.
//!
//! Boxes and the triangles of the leaves are kept in `f32`, in the unit of the tree: the centre of the surface is 0 and
//! its extent 1. They are only used for culling, with a margin for all their rounding; `f64` tests of triangles
//! ([`crate::primitive`]) decide the rest. A refit keeps the structure and rotates the axes with the surface.

mod axis_update;
mod build;
mod descend;
mod f64_traversal;
mod fit;
mod front;
mod lanes;
mod leaf;
mod obb;
mod query;
mod self_contacts;

pub use front::{FrontCost, TreeFront};
pub use query::{Proximity, TouchingPair, TreeQuery};

use nalgebra::Point3;

use crate::generation::Identity;
use crate::primitive::Triangle;
use crate::{Surface, SurfaceError, check_finite};
use fit::AxisExtents;
use lanes::{each, three};
use leaf::Leaf;
use obb::{Obb, ObbQuad};

/// Children of a node, and triangles of a leaf.
const WIDTH: usize = 4;
/// Levels up to which boxes are fitted to the triangles themselves; above, they are fitted to small boxes of nodes
/// below.
const FITTED_LEVELS: u32 = 3;
/// Level of those nodes.
const SMALL_LEVELS: u32 = 2;

/// An inner node: four boxes with their contents.
#[derive(Clone, Debug)]
struct Node {
    quad: ObbQuad,
    /// Indices of inner nodes, then of leaves (from the number of inner nodes on).
    children: [u32; WIDTH],
    /// Number of children; the other lanes are empty.
    count: u32,
    /// First leaf and the one after the last.
    leaves: [u32; 2],
    /// Levels below, the leaves being 0.
    height: u32,
    /// The node after the last one below.
    end: u32,
}

/// The boxes of one surface. It keeps a copy of the surface, so that a query needs nothing else.
#[derive(Clone, Debug, Default)]
pub struct ObbTree {
    /// Centre and extent of the surface \[m\]: 0 and 1 in the unit of the tree.
    origin: Point3<f64>,
    scale: f64,
    vertices: Vec<Point3<f64>>,
    /// Corners and number of each triangle, in the order of the leaves.
    corners: Vec<[u32; 3]>,
    numbers: Vec<u32>,
    /// Position of each triangle in that order.
    places: Vec<u32>,
    /// Vertices in the unit of the tree.
    units: Vec<[f32; 3]>,
    /// Children after their parents; the root is the first, unless one leaf is all.
    nodes: Vec<Node>,
    /// Anchors of each node; `None` for a degenerate patch.
    anchors: Vec<Option<axis_update::Anchors>>,
    leaves: Vec<Leaf>,
    /// Box of each node, then of each leaf.
    boxes: Vec<Obb>,
    identity: Identity,
    /// Sum over all refits of the largest vertex displacement \[m\].
    motion: f64,
    /// Number of refits with any vertex displacement.
    refits: u64,
}

impl ObbTree {
    /// Builds the tree of a surface.
    #[must_use]
    pub fn build(surface: &Surface<'_>) -> Self {
        let mut tree = Self {
            vertices: surface.vertices().to_vec(),
            corners: surface.triangles().to_vec(),
            numbers: (0..surface.triangles().len() as u32).collect(),
            ..Self::default()
        };
        tree.rescale();
        build::sort(&mut tree);
        tree.places = vec![0; tree.numbers.len()];
        for (place, &number) in tree.numbers.iter().enumerate() {
            tree.places[number as usize] = place as u32;
        }
        axis_update::attach(&mut tree);
        tree.refit_boxes();
        tree
    }

    /// Refits the boxes to new vertex positions \[m\] of the same triangles. The structure stays and the axes rotate
    /// with the surface, so boxes become looser as it folds: results stay exact, and a rebuild makes the boxes tight
    /// again.
    ///
    /// # Errors
    /// For another number of vertices, or a non-finite coordinate; the tree is then unchanged.
    pub fn refit(&mut self, vertices: &[Point3<f64>]) -> Result<(), SurfaceError> {
        if vertices.len() != self.vertices.len() {
            return Err(SurfaceError::OtherVertices { expected: self.vertices.len(), found: vertices.len() });
        }
        check_finite(vertices)?;
        let mut furthest_squared = 0.0_f64;
        for (before, now) in self.vertices.iter_mut().zip(vertices) {
            let squared = (*now - *before).norm_squared();
            furthest_squared = if squared > furthest_squared { squared } else { furthest_squared };
            *before = *now;
        }
        self.motion += furthest_squared.sqrt();
        self.refits += u64::from(furthest_squared > 0.0);
        self.rescale();
        axis_update::carry(self);
        self.refit_boxes();
        Ok(())
    }

    /// Number of triangles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.numbers.len()
    }

    /// Whether there is no triangle.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.numbers.is_empty()
    }

    /// The last given vertices \[m\].
    #[must_use]
    pub fn vertices(&self) -> &[Point3<f64>] {
        &self.vertices
    }

    /// Updates centre and unit of the surface, and its vertices in that unit.
    fn rescale(&mut self) {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for vertex in &self.vertices {
            for axis in 0..3 {
                let at = vertex[axis];
                low[axis] = if at < low[axis] { at } else { low[axis] };
                high[axis] = if at > high[axis] { at } else { high[axis] };
            }
        }
        let reach = (0..3).map(|axis| 0.5 * high[axis] - 0.5 * low[axis]).fold(0.0, f64::max);
        // A single point may have any unit; without points the centre is the origin.
        self.scale = if reach > f64::MIN_POSITIVE && reach.is_finite() { reach } else { 1.0 };
        self.origin = Point3::from([0, 1, 2].map(|axis| 0.5 * low[axis] + 0.5 * high[axis]));
        if self.vertices.is_empty() {
            self.origin = Point3::origin();
        }
        let (origin, inverse) = (self.origin, self.scale.recip());
        self.units.clear();
        self.units.extend(
            self.vertices.iter().map(|vertex| three(|axis| ((vertex[axis] - origin[axis]) * inverse) as f32)),
        );
    }

    fn triangle(&self, place: usize) -> Triangle {
        each(self.corners[place], |vertex| self.vertices[vertex as usize])
    }

    /// Triangles of a leaf, by position.
    fn places_of(&self, leaf: usize) -> std::ops::Range<usize> {
        leaf * WIDTH..((leaf + 1) * WIDTH).min(self.numbers.len())
    }

    fn refit_boxes(&mut self) {
        let inner = self.nodes.len();
        for (index, leaf) in self.leaves.iter_mut().enumerate() {
            let first = index * WIDTH;
            let last = self.corners.len() - 1;
            let triangle = |lane: usize| {
                let [a, b, c] = self.corners[(first + lane).min(last)];
                [self.units[a as usize], self.units[b as usize], self.units[c as usize]]
            };
            *leaf = Leaf::of([triangle(0), triangle(1), triangle(2), triangle(3)]);
            let axes = self.boxes[inner + index].axes;
            let mut reach = AxisExtents::new(&axes);
            reach.add(&leaf.corners);
            self.boxes[inner + index] = reach.into_box(&axes);
        }
        // Children come after their parents.
        for index in (0..inner).rev() {
            let node = &mut self.nodes[index];
            for (lane, &child) in node.children[..node.count as usize].iter().enumerate() {
                node.quad.set(lane, &self.boxes[child as usize]);
            }
            self.boxes[index] = self.fitted(index);
        }
    }

    /// The box of a node in its axes, around the triangles or the small boxes below.
    fn fitted(&self, index: usize) -> Obb {
        let node = &self.nodes[index];
        let axes = self.boxes[index].axes;
        let mut reach = AxisExtents::new(&axes);
        if node.height <= FITTED_LEVELS {
            for leaf in &self.leaves[node.leaves[0] as usize..node.leaves[1] as usize] {
                reach.add(&leaf.corners);
            }
        } else {
            let mut next = index + 1;
            while next < node.end as usize {
                let below = &self.nodes[next];
                if below.height <= SMALL_LEVELS {
                    reach.add_boxes(&below.quad);
                    next = below.end as usize;
                } else {
                    // Children have about equal height, so that no child is a leaf here.
                    debug_assert!(
                        below.children[..below.count as usize]
                            .iter()
                            .all(|&c| (c as usize) < self.nodes.len())
                    );
                    next += 1;
                }
            }
        }
        reach.into_box(&axes)
    }
}
