//! The mesh of an entity as its scenario declares it, for components that refer to parts of it: boxes that hold vertices,
//! regions by name, points inside.

use nalgebra::{Matrix3, Point3};

/// The mesh of an entity at rest, in its frame.
#[derive(Clone, Copy, Debug, Default)]
pub struct EntityMesh<'a> {
    /// The vertices \[m\].
    pub vertices: &'a [Point3<f64>],
    /// The tetrahedra of a volume, as indices of its vertices.
    pub tets: &'a [[u32; 4]],
    /// The names of a volume's regions, if its file has some.
    pub regions: Option<&'a [String]>,
}

impl EntityMesh<'_> {
    /// For messages: the box that the mesh spans.
    #[must_use]
    pub fn span(&self) -> String {
        let Some(first) = self.vertices.first() else { return "the mesh has no vertices".to_owned() };
        let (min, max) =
            self.vertices.iter().fold((*first, *first), |(min, max), p| (min.inf(p), max.sup(p)));
        format!("the mesh spans {} to {} m in its own frame", shown(&min), shown(&max))
    }

    /// How far inside a volume a point is: the smallest of its barycentric coordinates in the element in which that is
    /// largest. It is zero on the surface, and falls by 0.5 to 1 with each height of an element outside of it. `None` without
    /// elements.
    #[must_use]
    pub fn depth(&self, point: &Point3<f64>) -> Option<f64> {
        let depth_in = |tet: &[u32; 4]| {
            let [a, b, c, d] = tet.map(|node| self.vertices.get(node as usize).copied().unwrap_or_default());
            let inverse = Matrix3::from_columns(&[b - a, c - a, d - a]).try_inverse()?;
            let weights = inverse * (point - a);
            Some(weights.min().min(1.0 - weights.sum()))
        };
        self.tets.iter().filter_map(depth_in).max_by(f64::total_cmp)
    }
}

/// A point with four significant digits.
pub(crate) fn shown(point: &Point3<f64>) -> String {
    let [x, y, z] = [point.x, point.y, point.z].map(|value| {
        let digits = if value == 0.0 { 0.0 } else { 3.0 - value.abs().log10().floor() };
        // Short numbers print short: 0.06, not 0.060000000000000005.
        let rounded: f64 = format!("{value:.*}", digits.clamp(0.0, 12.0) as usize).parse().unwrap_or(value);
        rounded + 0.0
    });
    format!("[{x}, {y}, {z}]")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_depth_of_a_point_is_measured_in_elements() {
        let vertices = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0]].map(Point3::from);
        let mesh = EntityMesh { vertices: &vertices, tets: &[[0, 1, 2, 3]], regions: None };
        for (point, depth) in [
            ([0.25, 0.5, 0.75], 0.25),
            ([0.0, 0.5, 0.5], 0.0),
            ([0.5, 0.5, -3.0], -1.0),
            ([-0.5, 1.0, 1.0], -0.5),
        ] {
            let found = mesh.depth(&Point3::from(point)).expect("an element");
            assert!((found - depth).abs() < 1e-12, "{point:?}: {found}");
        }
        assert_eq!(mesh.span(), "the mesh spans [0, 0, 0] to [1, 2, 3] m in its own frame");
        assert_eq!(EntityMesh::default().depth(&Point3::origin()), None);
    }

    #[test]
    fn points_are_shown_with_four_digits() {
        assert_eq!(shown(&Point3::new(0.06 + 1e-17, -0.012_345_678, 1234.567)), "[0.06, -0.01235, 1235]");
        assert_eq!(shown(&Point3::new(-0.0, 1e-9, -1e-14)), "[0, 0.000000001, 0]");
    }
}
