//! Tearing: a surface splits where its stretch exceeds a limit, with the operations of cutting.

use nalgebra::{Matrix2, Point3, Vector2};

use super::swept_path::SurfacePath;
use super::{CutError, Sheet, TopologyChange};

impl Sheet {
    /// Tears at the vertex of the most stretched triangle, if its stretch exceeds `stretch_max` (length over rest
    /// length, above 1): perpendicular to the direction of the largest stretch, one or two triangles to either side.
    /// Called once per step, so that the tear propagates as fast as the stretch that it relieves.
    ///
    /// # Errors
    /// A number of positions other than that of vertices, or a non-finite one.
    pub fn tear(&mut self, positions: &[Point3<f64>], stretch_max: f64) -> Result<TopologyChange, CutError> {
        let (given, expected) = (positions.len(), self.rest().len());
        if given != expected {
            return Err(CutError::Positions { given, expected });
        }
        let nowhere = |point: &Point3<f64>| !point.iter().all(|value| value.is_finite());
        if let Some(index) = positions.iter().position(nowhere) {
            return Err(CutError::NotFinite { what: "vertex", index });
        }
        let mut worst: Option<(f64, u32, Vector2<f64>)> = None;
        for triangle in 0..self.triangles().len() as u32 {
            let (stretch, direction) = self.stretch(triangle, positions);
            if stretch > stretch_max && worst.is_none_or(|(most, ..)| stretch > most) {
                worst = Some((stretch, triangle, direction));
            }
        }
        let Some((_, triangle, direction)) = worst else { return Ok(TopologyChange::default()) };
        let corners = self.triangles()[triangle as usize];
        // Tears propagate: from a tip, else from a border, else from the most stretched place. There is nothing to tear
        // along a border.
        let rank = |vertex: &u32| (!self.state.tips.contains(vertex), !self.on_border(*vertex), *vertex);
        let mut starts = corners;
        starts.sort_unstable_by_key(rank);
        for start in starts {
            self.tear_from(start, triangle, &direction);
            let change = self.take_change();
            if !change.is_empty() {
                return Ok(change);
            }
        }
        Ok(TopologyChange::default())
    }

    /// Perpendicular to the direction in which a triangle is stretched, from one of its corners.
    fn tear_from(&mut self, start: u32, triangle: u32, direction: &Vector2<f64>) {
        let [first, second] = self.frame(triangle);
        let across = first * -direction.y + second * direction.x;
        let [a, b, c] = self.triangles()[triangle as usize].map(|vertex| self.rest()[vertex as usize]);
        let reach = (b - a).norm().max((c - b).norm()).max((a - c).norm());
        let from = self.rest()[start as usize];
        // From the end of a cut it continues away from the existing lips.
        let behind = self.lips(start) - from.coords;
        let ways: &[f64] = match behind.dot(&across) {
            _ if !self.on_border(start) && !self.state.tips.contains(&start) => &[1.0, -1.0],
            toward if toward > 0.0 => &[-1.0],
            _ => &[1.0],
        };
        for way in ways.iter().map(|way| across * *way) {
            self.run(start, triangle, vec![from, from + way * (1.5 * reach)]);
        }
    }

    fn run(&mut self, start: u32, triangle: u32, points: Vec<Point3<f64>>) {
        let added = !self.state.tips.contains(&start);
        if added {
            self.state.tips.push(start);
        }
        self.follow(SurfacePath { points, triangles: [triangle; 2] });
        // A vertex on a border is no tip of its own.
        if added && self.on_border(start) {
            self.state.tips.retain(|tip| *tip != start);
        }
    }

    /// Centre of the vertices along the border or cut next to this one.
    fn lips(&self, vertex: u32) -> nalgebra::Vector3<f64> {
        let (mut sum, mut count) = (nalgebra::Vector3::zeros(), 0);
        for &triangle in self.about(vertex) {
            for other in self.triangles()[triangle as usize] {
                if other != vertex && self.is_border([vertex, other]) {
                    sum += self.rest()[other as usize].coords;
                    count += 1;
                }
            }
        }
        if count == 0 { self.rest()[vertex as usize].coords } else { sum / f64::from(count) }
    }

    /// Two orthogonal unit vectors in the plane of a triangle at rest.
    fn frame(&self, triangle: u32) -> [nalgebra::Vector3<f64>; 2] {
        let [a, b, c] = self.triangles()[triangle as usize].map(|vertex| self.rest()[vertex as usize]);
        let first = (b - a).normalize();
        let second = ((c - a) - first * first.dot(&(c - a))).normalize();
        [first, second]
    }

    /// The largest stretch of a triangle, and its direction in [`frame`](Self::frame).
    fn stretch(&self, triangle: u32, positions: &[Point3<f64>]) -> (f64, Vector2<f64>) {
        let corners = self.triangles()[triangle as usize];
        let [first, second] = self.frame(triangle);
        let [a, b, c] = corners.map(|vertex| self.rest()[vertex as usize]);
        let flat = |edge: nalgebra::Vector3<f64>| Vector2::new(edge.dot(&first), edge.dot(&second));
        let rest = Matrix2::from_columns(&[flat(b - a), flat(c - a)]);
        let [p, q, r] = corners.map(|vertex| positions[vertex as usize]);
        let (u, v) = (q - p, r - p);
        let gram = Matrix2::new(u.dot(&u), u.dot(&v), u.dot(&v), v.dot(&v));
        let Some(inverse) = rest.try_inverse() else { return (1.0, Vector2::x()) };
        let eigen = (inverse.transpose() * gram * inverse).symmetric_eigen();
        let most = eigen.eigenvalues.imax();
        (eigen.eigenvalues[most].max(0.0).sqrt(), eigen.eigenvectors.column(most).into_owned())
    }
}
