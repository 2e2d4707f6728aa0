//! Axis update of boxes on a deforming surface: each node stores three distant vertices of its patch, and its axes
//! relative to the frame that they span. As the surface bends, the frame rotates and the axes with it, at a small part
//! of the cost of a new fit.

use super::lanes::{each, three};
use super::{ObbTree, WIDTH};

/// Attachment of a node's axes to its patch.
#[derive(Clone, Copy, Debug)]
pub(super) struct Anchors {
    vertices: [u32; 3],
    /// Axes of the node, and of its children that are leaves, in the frame of the patch.
    axes: [[f32; 3]; 3],
    of_leaves: [[[f32; 3]; 3]; WIDTH],
}

/// Squared sine of the angle at the first anchor below which the three span no frame.
const STRAIGHT: f32 = 1e-4;
/// Number of triangles of a patch examined for anchors, which need not be the farthest ones.
const LOOKED_AT: usize = 32;

fn product(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn vector_product(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    three(|i| a[(i + 1) % 3] * b[(i + 2) % 3] - a[(i + 2) % 3] * b[(i + 1) % 3])
}

/// Unit vectors by rows: from the first to the second, perpendicular towards the third, the normal.
#[inline]
fn frame(units: &[[f32; 3]], vertices: [u32; 3]) -> Option<[[f32; 3]; 3]> {
    let [a, b, c] = each(vertices, |vertex| units[vertex as usize]);
    let (u, v) = (three(|i| b[i] - a[i]), three(|i| c[i] - a[i]));
    let normal = vector_product(u, v);
    let (uu, nn) = (product(u, u), product(normal, normal));
    if nn <= STRAIGHT * uu * product(v, v) {
        return None;
    }
    let (along, up) = (uu.sqrt().recip(), nn.sqrt().recip());
    let (u, normal) = (each(u, |x| x * along), each(normal, |x| x * up));
    let frame = [u, vector_product(normal, u), normal];
    // Squares of very small lengths underflow `f32`.
    (along * up).is_finite().then_some(frame)
}

#[inline]
fn into_frame(frame: &[[f32; 3]; 3], axes: &[[f32; 3]; 3]) -> [[f32; 3]; 3] {
    each(*axes, |axis| each(*frame, |row| product(row, axis)))
}

#[inline]
fn out_of_frame(frame: &[[f32; 3]; 3], axes: &[[f32; 3]; 3]) -> [[f32; 3]; 3] {
    each(*axes, |axis| three(|i| frame[0][i] * axis[0] + frame[1][i] * axis[1] + frame[2][i] * axis[2]))
}

/// Finds the anchors of all nodes of a tree that has been sorted and has its axes.
pub(super) fn attach(tree: &mut ObbTree) {
    tree.anchors = Vec::with_capacity(tree.nodes.len());
    for index in 0..tree.nodes.len() {
        let node = &tree.nodes[index];
        let axes = tree.boxes[index].axes;
        let from = node.leaves[0] as usize * WIDTH;
        let to = (node.leaves[1] as usize * WIDTH).min(tree.corners.len());
        let step = (to - from).div_ceil(LOOKED_AT);
        let vertices = || tree.corners[from..to].iter().step_by(step).flatten().copied();
        let farthest = |measure: &dyn Fn([f32; 3]) -> f32| {
            let mut best = (f32::NEG_INFINITY, 0);
            for vertex in vertices() {
                let value = measure(tree.units[vertex as usize]);
                if value > best.0 {
                    best = (value, vertex);
                }
            }
            best.1
        };
        let a = farthest(&|point| -product(axes[0], point));
        let b = farthest(&|point| product(axes[0], point));
        let [at_a, at_b] = [a, b].map(|vertex| tree.units[vertex as usize]);
        let along = three(|i| at_b[i] - at_a[i]);
        let c = farthest(&|point| {
            let beside = vector_product(along, three(|i| point[i] - at_a[i]));
            product(beside, beside)
        });
        let anchors = frame(&tree.units, [a, b, c]).map(|frame| Anchors {
            vertices: [a, b, c],
            axes: into_frame(&frame, &axes),
            of_leaves: node.children.map(|child| into_frame(&frame, &tree.boxes[child as usize].axes)),
        });
        tree.anchors.push(anchors);
    }
}

/// Rotates all axes with the vertices. If three anchors have become collinear, the axes stay.
pub(super) fn carry(tree: &mut ObbTree) {
    let inner = tree.nodes.len();
    for (index, (node, anchors)) in tree.nodes.iter().zip(&tree.anchors).enumerate() {
        let Some(anchors) = anchors else { continue };
        let Some(frame) = frame(&tree.units, anchors.vertices) else { continue };
        tree.boxes[index].axes = out_of_frame(&frame, &anchors.axes);
        for (&child, axes) in node.children[..node.count as usize].iter().zip(&anchors.of_leaves) {
            if child as usize >= inner {
                tree.boxes[child as usize].axes = out_of_frame(&frame, axes);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{Point3, Rotation3, Vector3};

    use super::*;
    use crate::Surface;

    /// A wavy sheet of 2 × 40 × 40 triangles.
    fn sheet() -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        for j in 0..=40_u32 {
            for i in 0..=40_u32 {
                let (x, y) = (f64::from(i) / 40.0, f64::from(j) / 40.0);
                vertices.push(Point3::new(x, y, 0.05 * (9.0 * x).sin() * (7.0 * y).cos()));
                if i < 40 && j < 40 {
                    let corner = j * 41 + i;
                    triangles.push([corner, corner + 1, corner + 42]);
                    triangles.push([corner, corner + 42, corner + 41]);
                }
            }
        }
        (vertices, triangles)
    }

    /// Mean over the leaves of the surface of the box \[m²\].
    fn mean_surface(tree: &ObbTree) -> f64 {
        let surface = |h: &[f32; 3]| f64::from(h[0] * h[1] + h[1] * h[2] + h[2] * h[0]);
        let sum: f64 = tree.boxes[tree.nodes.len()..].iter().map(|obb| surface(&obb.half)).sum();
        sum * tree.scale * tree.scale / tree.leaves.len() as f64
    }

    #[test]
    fn boxes_stay_tight_as_a_surface_turns_and_grow_little_looser_as_it_bends() {
        let (vertices, triangles) = sheet();
        let mut tree = ObbTree::build(&Surface::new(&vertices, &triangles).expect("a surface"));
        let flat = mean_surface(&tree);
        let turn = Rotation3::from_scaled_axis(Vector3::new(0.5, 1.0, -0.7));
        let turned: Vec<_> = vertices.iter().map(|vertex| turn * vertex).collect();
        tree.refit(&turned).expect("as many vertices");
        assert!((mean_surface(&tree) / flat - 1.0).abs() < 1e-3, "{} for {flat}", mean_surface(&tree));
        // Rolled up into half a tube.
        let rolled: Vec<_> = vertices
            .iter()
            .map(|vertex| {
                let (sine, cosine) = (std::f64::consts::PI * vertex.x).sin_cos();
                Point3::new((0.32 + vertex.z) * cosine, vertex.y, (0.32 + vertex.z) * sine)
            })
            .collect();
        tree.refit(&rolled).expect("as many vertices");
        let fresh = ObbTree::build(&Surface::new(&rolled, &triangles).expect("a surface"));
        let mut held = ObbTree::build(&Surface::new(&vertices, &triangles).expect("a surface"));
        held.anchors.fill(None);
        held.refit(&rolled).expect("as many vertices");
        let [turned, held] = [&tree, &held].map(|tree| mean_surface(tree) / mean_surface(&fresh) - 1.0);
        assert!(turned < 0.5 * held, "looser by {turned}, with axes held still by {held}");
    }
}
