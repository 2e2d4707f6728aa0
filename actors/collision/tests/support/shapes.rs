//! Bodies to test with: closed surfaces, not all of them star-shaped.

use nalgebra::{Point3, Vector3};
use trocar_collision::Surface;

/// A surface that owns its slices.
#[derive(Clone, Debug, Default)]
pub struct Shape {
    pub vertices: Vec<Point3<f64>>,
    pub triangles: Vec<[u32; 3]>,
}

impl Shape {
    pub fn surface(&self) -> Surface<'_> {
        Surface::new(&self.vertices, &self.triangles).expect("a surface")
    }

    pub fn mapped(&self, map: impl Fn(Point3<f64>) -> Point3<f64>) -> Self {
        Self { vertices: self.vertices.iter().copied().map(map).collect(), triangles: self.triangles.clone() }
    }

    pub fn inverted(mut self) -> Self {
        self.triangles.iter_mut().for_each(|corners| corners.swap(1, 2));
        self
    }

    pub fn joined(mut self, other: &Self) -> Self {
        let first = self.vertices.len() as u32;
        self.vertices.extend(&other.vertices);
        self.triangles.extend(other.triangles.iter().map(|corners| corners.map(|corner| corner + first)));
        self
    }

    /// A grid that is closed around both ways.
    fn wrapped(rows: usize, columns: usize, place: impl Fn(f64, f64) -> Point3<f64>) -> Self {
        let mut shape = Self::default();
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            shape.vertices.push(place(row as f64 / rows as f64, column as f64 / columns as f64));
            let at = |row: usize, column: usize| (row % rows * columns + column % columns) as u32;
            let (a, b) = (at(row, column), at(row, column + 1));
            let (c, d) = (at(row + 1, column), at(row + 1, column + 1));
            shape.triangles.extend([[a, c, b], [b, c, d]]);
        }
        shape
    }

    /// A ring of radius 1 around z, its tube of radius `tube`: 2 × rows × columns triangles.
    pub fn torus(rows: usize, columns: usize, tube: f64) -> Self {
        Self::wrapped(rows, columns, |u, v| {
            let (u, v) = (u * std::f64::consts::TAU, v * std::f64::consts::TAU);
            let out = 1.0 + tube * v.cos();
            Point3::new(out * u.cos(), out * u.sin(), tube * v.sin())
        })
    }

    /// A sphere of radius 1 with bumps of `bump`, from an octahedron whose edges are halved `levels` times:
    /// 8 × 4^levels triangles.
    pub fn organ(levels: usize, bump: f64) -> Self {
        let mut faces: Vec<[Vector3<f64>; 3]> = Vec::new();
        for x in [1.0, -1.0] {
            for y in [1.0, -1.0] {
                for z in [1.0, -1.0] {
                    let (a, b, c) = (Vector3::x() * x, Vector3::y() * y, Vector3::z() * z);
                    faces.push(if x * y * z > 0.0 { [a, b, c] } else { [a, c, b] });
                }
            }
        }
        for _ in 0..levels {
            faces = faces
                .iter()
                .flat_map(|&[a, b, c]| {
                    let (ab, bc, ca) = ((a + b).normalize(), (b + c).normalize(), (c + a).normalize());
                    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
                })
                .collect();
        }
        let mut shape = Self::default();
        let mut known = std::collections::BTreeMap::new();
        for face in faces {
            let corners = face.map(|corner| {
                let key = [corner.x, corner.y, corner.z].map(|coordinate| (coordinate * 1e9).round() as i64);
                *known.entry(key).or_insert_with(|| {
                    let wave = (5.0 * corner.x).sin() + (4.0 * corner.y + 1.0).cos() + (6.0 * corner.z).sin();
                    shape.vertices.push(Point3::from(corner * (1.0 + bump * wave)));
                    shape.vertices.len() as u32 - 1
                })
            });
            shape.triangles.push(corners);
        }
        shape
    }

    /// A tube bent into three quarters of a ring, its ends closed: no centre sees all of it.
    pub fn horseshoe(rows: usize, columns: usize) -> Self {
        let mut shape = Self::default();
        let place = |u: f64, v: f64, tube: f64| {
            let (u, v) = (u * 1.5 * std::f64::consts::PI, v * std::f64::consts::TAU);
            let out = 1.0 + tube * v.cos();
            Point3::new(out * u.cos(), out * u.sin(), tube * v.sin())
        };
        for row in 0..=rows {
            shape.vertices.extend(
                (0..columns)
                    .map(|column| place(row as f64 / rows as f64, column as f64 / columns as f64, 0.3)),
            );
        }
        let at = |row: usize, column: usize| (row * columns + column % columns) as u32;
        for (row, column) in (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))) {
            let (a, b) = (at(row, column), at(row, column + 1));
            let (c, d) = (at(row + 1, column), at(row + 1, column + 1));
            shape.triangles.extend([[a, c, b], [b, c, d]]);
        }
        for (row, flip) in [(0, false), (rows, true)] {
            let middle = shape.vertices.len() as u32;
            shape.vertices.push(place(row as f64 / rows as f64, 0.0, 0.0));
            for column in 0..columns {
                let (a, b) = (at(row, column), at(row, column + 1));
                shape.triangles.push(if flip { [middle, b, a] } else { [middle, a, b] });
            }
        }
        shape
    }

    /// A box of these half lengths.
    pub fn cuboid(half: [f64; 3]) -> Self {
        let (vertices, triangles) = super::cuboid::cuboid(half.map(|half| -half), half);
        Self { vertices, triangles }
    }

    /// Six times the enclosed volume \[m³\].
    pub fn volume(&self) -> f64 {
        let of = |&[a, b, c]: &[u32; 3]| {
            let [a, b, c] = [a, b, c].map(|corner| self.vertices[corner as usize].coords);
            a.cross(&b).dot(&c) / 6.0
        };
        self.triangles.iter().map(of).sum()
    }
}
