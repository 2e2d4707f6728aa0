//! Test meshes of the collision benchmark: bumpy spheres of any number of triangles, and relative poses of two of them.

use std::f64::consts::{PI, TAU};
use std::fmt::Write as _;

use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use trocar_scene::shapes;

use crate::failure::Failure;

/// A closed surface.
pub struct Mesh {
    pub vertices: Vec<Point3<f64>>,
    pub triangles: Vec<[u32; 3]>,
}

/// Mean radius of a sphere \[m\].
pub const RADIUS: f64 = 0.05;
const BUMPS: f64 = 0.12;

impl Mesh {
    /// A sphere with bumps and hollows, of about so many triangles.
    pub fn bumpy(triangles: usize) -> Result<Self, Failure> {
        let mut mesh = Self::round(triangles)?;
        let round = mesh.vertices.clone();
        mesh.heave(&round, 0.0);
        Ok(mesh)
    }

    /// A round sphere.
    pub fn round(triangles: usize) -> Result<Self, Failure> {
        // Twice as many segments as rings: triangles are about as long as they are wide.
        let rings = ((triangles as f64 / 8.0).sqrt().round() as usize).max(3);
        let segments = (triangles / (2 * (2 * rings - 1))).max(8);
        let ball = shapes::sphere(RADIUS, segments, rings).map_err(Failure::internal)?;
        Ok(Self { vertices: ball.positions, triangles: ball.triangles })
    }

    /// Deforms the round sphere of the given vertices to its shape at a time \[s\].
    pub fn heave(&mut self, round: &[Point3<f64>], time: f64) {
        for (vertex, round) in self.vertices.iter_mut().zip(round) {
            let unit = round.coords / RADIUS;
            let wave = (5.0 * unit.x + 0.7 * time).sin() * (4.0 * unit.y - 0.4 * time).cos()
                + 0.6 * (9.0 * unit.z + 6.0 * unit.x).sin();
            *vertex = Point3::from(round.coords * (1.0 + BUMPS * wave));
        }
    }

    /// As an OBJ file, the format that the peers read.
    pub fn obj(&self) -> String {
        let mut text = String::new();
        for vertex in &self.vertices {
            let _ = writeln!(text, "v {:e} {:e} {:e}", vertex.x, vertex.y, vertex.z);
        }
        for [a, b, c] in &self.triangles {
            let _ = writeln!(text, "f {} {} {}", a + 1, b + 1, c + 1);
        }
        text
    }
}

/// Poses of a second ball in the frame of the first: every direction and rotation, about as often in contact as apart,
/// by low-discrepancy sequences (Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018).
pub fn poses(count: usize) -> Vec<Isometry3<f64>> {
    // The root of x⁷ = x + 1, for six dimensions.
    const ROOT: f64 = 1.112_775_684_278_705_5;
    (1..=count)
        .map(|index| {
            let share = |dimension: i32| (index as f64 * ROOT.powi(-dimension)).fract();
            let (height, turn) = (2.0 * share(1) - 1.0, TAU * share(2));
            let across = (1.0 - height * height).sqrt();
            let direction = Vector3::new(across * turn.cos(), across * turn.sin(), height);
            let distance = RADIUS * (1.3 + 1.3 * share(3));
            let rotation = UnitQuaternion::from_euler_angles(
                TAU * share(4),
                (2.0 * share(5) - 1.0).asin(),
                TAU * share(6) - PI,
            );
            Isometry3::from_parts(Translation3::from(direction * distance), rotation)
        })
        .collect()
}

/// As CSV for the peers: rotation by rows, translation.
pub fn poses_csv(poses: &[Isometry3<f64>]) -> String {
    let row = |pose: &Isometry3<f64>| {
        let rotation = pose.rotation.to_rotation_matrix().matrix().transpose();
        let numbers = rotation.iter().chain(pose.translation.vector.iter());
        numbers.map(|number| format!("{number:e}")).collect::<Vec<_>>().join(",")
    };
    poses.iter().map(row).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_are_as_large_as_asked_for_and_stand_about_as_often_in_contact_as_apart() {
        for wanted in [980, 9_680, 100_000] {
            let mesh = Mesh::bumpy(wanted).unwrap_or_else(|failure| panic!("{}", failure.message));
            let share = mesh.triangles.len() as f64 / wanted as f64;
            assert!((0.9..1.1).contains(&share), "{wanted}: {}", mesh.triangles.len());
            assert!(
                mesh.vertices
                    .iter()
                    .all(|vertex| { (0.75 * RADIUS..1.25 * RADIUS).contains(&vertex.coords.norm()) })
            );
        }
        let poses = poses(200);
        let near = poses.iter().filter(|pose| pose.translation.vector.norm() < 2.0 * RADIUS).count();
        assert!((80..140).contains(&near), "{near}");
        let first = poses_csv(&poses[..1]);
        assert_eq!(first.split(',').count(), 12);
        let numbers: Vec<f64> = first.split(',').map(|number| number.parse().expect("a number")).collect();
        let turned = poses[0].rotation * Vector3::x();
        let column = Vector3::new(numbers[0], numbers[3], numbers[6]);
        assert!((column - turned).norm() < 1e-12, "by rows: {numbers:?}");
    }
}
