//! Random surfaces of the kinds that trees and triangle tests go wrong on.

use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::Mesh;

/// Names of the kinds, for messages.
pub const KINDS: [&str; 11] = [
    "folded",
    "thin",
    "cut",
    "many parts",
    "nested",
    "coplanar",
    "touching",
    "degenerate",
    "empty",
    "non-manifold",
    "inverted",
];

fn sheet(columns: u32, rows: u32, place: impl Fn(f64, f64) -> Point3<f64>) -> Mesh {
    let mut mesh = Mesh { vertices: Vec::new(), triangles: Vec::new() };
    for j in 0..=rows {
        for i in 0..=columns {
            mesh.vertices.push(place(f64::from(i) / f64::from(columns), f64::from(j) / f64::from(rows)));
        }
    }
    for j in 0..rows {
        for i in 0..columns {
            let corner = j * (columns + 1) + i;
            let above = corner + columns + 1;
            mesh.triangles.push([corner, corner + 1, above + 1]);
            mesh.triangles.push([corner, above + 1, above]);
        }
    }
    mesh
}

fn join(parts: Vec<Mesh>) -> Mesh {
    let mut mesh = Mesh { vertices: Vec::new(), triangles: Vec::new() };
    for part in parts {
        let base = mesh.vertices.len() as u32;
        mesh.vertices.extend(part.vertices);
        mesh.triangles.extend(part.triangles.iter().map(|corners| corners.map(|corner| corner + base)));
    }
    mesh
}

/// A closed bumpy ball.
pub fn ball(center: Point3<f64>, radius: f64, bump: f64, columns: u32, rows: u32) -> Mesh {
    sheet(columns, rows, |u, v| {
        let (around, down) = (u * std::f64::consts::TAU, v * std::f64::consts::PI);
        let direction = Vector3::new(around.cos() * down.sin(), around.sin() * down.sin(), down.cos());
        center + direction * (radius * (1.0 + bump * (5.0 * around).sin() * (4.0 * down).sin()))
    })
}

/// A box on whole numbers, of twelve triangles.
fn block(at: [i32; 3], size: [i32; 3]) -> Mesh {
    let low = at.map(f64::from);
    let high = [0, 1, 2].map(|axis| low[axis] + f64::from(size[axis]));
    let (vertices, triangles) = super::cuboid::cuboid(low, high);
    Mesh { vertices, triangles }
}

/// About one unit large. Those on whole numbers touch others on whole numbers exactly.
pub fn surface(kind: &str, seed: u64) -> Mesh {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut near = move |reach: f64| rng.random_range(-reach..=reach);
    match kind {
        "folded" => {
            let (folds, depth) = (3.0 + near(2.0), 0.25 + near(0.2));
            let lean = near(0.5);
            sheet(9, 6, |u, v| {
                let zigzag = (2.0 * (u * folds).fract() - 1.0).abs();
                Point3::new(0.3 * u + depth * lean * zigzag, v - 0.5, depth * zigzag - 0.1)
            })
        }
        "thin" => {
            let mut mesh = sheet(30, 1, |u, v| Point3::new(2.0 * u - 1.0, 1e-5 * v, 0.1 * (7.0 * u).sin()));
            for vertex in &mut mesh.vertices {
                vertex.y += near(1e-6);
            }
            mesh
        }
        "cut" => {
            let mut mesh = ball(Point3::origin(), 0.8, 0.2, 10, 8);
            // Some triangles gone, others with vertices of their own at the same places.
            let triangles = std::mem::take(&mut mesh.triangles);
            for mut corners in triangles {
                let fate = near(1.0);
                if fate > 0.8 {
                    continue;
                }
                if fate < -0.5 {
                    for corner in &mut corners {
                        mesh.vertices.push(mesh.vertices[*corner as usize]);
                        *corner = mesh.vertices.len() as u32 - 1;
                    }
                }
                mesh.triangles.push(corners);
            }
            mesh
        }
        "many parts" => join(
            (0..6)
                .map(|_| ball(Point3::new(near(1.0), near(1.0), near(1.0)), 0.3 + near(0.2), 0.3, 5, 4))
                .collect(),
        ),
        "nested" => {
            let ball_of = |radius| ball(Point3::origin(), radius, 0.05, 8, 6);
            join(vec![ball_of(1.0), ball_of(0.6 + near(0.2)), ball_of(0.2 + near(0.1))])
        }
        "coplanar" => {
            let columns = 4;
            let mut mesh = sheet(columns, 4, |u, v| Point3::new((4.0 * u).round(), (4.0 * v).round(), 0.0));
            for vertex in &mut mesh.vertices {
                vertex.x += near(2.0).round();
            }
            mesh
        }
        "touching" => join(
            (0..4)
                .map(|_| {
                    let mut whole = |reach: f64| near(reach).round() as i32;
                    let at = [whole(2.0), whole(2.0), whole(2.0)];
                    block(at, [1 + whole(1.0).abs(), 1, 1 + whole(1.0).abs()])
                })
                .collect(),
        ),
        "degenerate" => {
            let mut mesh = ball(Point3::origin(), 0.9, 0.1, 6, 5);
            for triangle in &mut mesh.triangles {
                if near(1.0) > 0.3 {
                    triangle[0] = triangle[1];
                }
                if near(1.0) > 0.8 {
                    triangle[2] = triangle[1];
                }
            }
            mesh.vertices.push(Point3::new(0.5, 0.5, 0.5));
            mesh
        }
        "empty" => Mesh { vertices: vec![Point3::origin(); 3], triangles: Vec::new() },
        "non-manifold" => {
            // Pages of a book, and random triangles over the same few vertices.
            let mut mesh = Mesh {
                vertices: vec![Point3::new(0.0, 0.0, -0.7), Point3::new(0.0, 0.0, 0.7)],
                triangles: Vec::new(),
            };
            for _ in 0..12 {
                mesh.vertices.push(Point3::new(near(1.0), near(1.0), near(1.0)));
                let last = mesh.vertices.len() as u32 - 1;
                mesh.triangles.push([0, 1, last]);
                if last > 4 {
                    mesh.triangles.push([last - 2, last - 1, last]);
                }
            }
            mesh
        }
        _ => {
            let mut mesh = ball(Point3::origin(), 0.7, 0.3, 9, 7);
            for (index, triangle) in mesh.triangles.iter_mut().enumerate() {
                if index % 3 != 0 {
                    triangle.swap(1, 2);
                }
            }
            mesh
        }
    }
}

/// Bends, twists and shakes a surface.
pub fn deformed(mesh: &Mesh, amount: f64, seed: u64) -> Vec<Point3<f64>> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    mesh.vertices
        .iter()
        .map(|vertex| {
            let angle = amount * (1.5 * vertex.x + vertex.z);
            let (sine, cosine) = angle.sin_cos();
            let twisted = Point3::new(
                vertex.x + 0.3 * amount * vertex.y * vertex.y,
                cosine * vertex.y - sine * vertex.z,
                sine * vertex.y + cosine * vertex.z,
            );
            let mut shake = || rng.random_range(-0.05..=0.05) * amount;
            twisted + Vector3::new(shake(), shake(), shake())
        })
        .collect()
}
