//! Analytic shapes as Rapier colliders, and the closed-form inertia of each.

use nalgebra::{ComplexField, Vector3};
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::math::{Pose as RapierPose, Rotation, Vector};
use rapier3d_f64::prelude::MassProperties;
use trocar_scene::components::Shape;

use trocar_dynamics::rigid_world::mass_properties::UnitSolid;

use crate::conversion::matrix_to_rapier;

/// Capsules that make up one ring.
///
/// Their chords leave the circle by at most 77 µm either way for a ring of 8 mm.
pub const RING_SEGMENTS: usize = 16;

/// A part of a body: a collider and where it sits in the body's frame.
pub struct Part {
    /// `body_from_part`.
    pub pose: RapierPose,
    /// Its geometry.
    pub shape: SharedShape,
}

/// Parry's cylinders and capsules stand along y, ours along z.
fn z_from_y() -> Rotation {
    Rotation::from_rotation_x(std::f64::consts::FRAC_PI_2)
}

/// The colliders of a shape. A ring is one compound of capsules (a dynamic trimesh has no inside); a peg
/// board is a box and one capsule per peg, so that the broad phase tells the pegs apart.
pub fn parts(shape: &Shape) -> Vec<Part> {
    let centred = |shape| vec![Part { pose: RapierPose::identity(), shape }];
    match shape {
        Shape::Box { half_extents: [x, y, z] } => centred(SharedShape::cuboid(*x, *y, *z)),
        Shape::Sphere { radius } => centred(SharedShape::ball(*radius)),
        Shape::Cylinder { radius, half_height } => vec![Part {
            pose: RapierPose::from_rotation(z_from_y()),
            shape: SharedShape::cylinder(*half_height, *radius),
        }],
        Shape::Capsule { radius, half_height } => centred(SharedShape::capsule(
            Vector::new(0.0, 0.0, -half_height),
            Vector::new(0.0, 0.0, *half_height),
            *radius,
        )),
        Shape::Torus { ring_radius, tube_radius } => centred(ring(*ring_radius, *tube_radius)),
        Shape::PegBoard { half_extents: [x, y], thickness, pegs, peg_radius, peg_height } => {
            let mut parts = vec![Part {
                pose: RapierPose::translation(0.0, 0.0, -thickness / 2.0),
                shape: SharedShape::cuboid(*x, *y, thickness / 2.0),
            }];
            // The round top ends at the peg's height, so that a ring can slide over it.
            let top = (peg_height - peg_radius).max(0.0);
            parts.extend(pegs.iter().map(|[px, py]| Part {
                pose: RapierPose::translation(*px, *py, 0.0),
                shape: SharedShape::capsule(Vector::ZERO, Vector::new(0.0, 0.0, top), *peg_radius),
            }));
            parts
        }
    }
}

/// A ring about z as a closed chain of capsules, whose mean radius is that of the circle.
fn ring(ring_radius: f64, tube_radius: f64) -> SharedShape {
    let step = std::f64::consts::TAU / RING_SEGMENTS as f64;
    // Vertices lie outside the circle by as much as the chords' midpoints lie inside.
    let vertex_radius = 2.0 * ring_radius / (1.0 + ComplexField::cos(step / 2.0));
    let vertex = |i: usize| {
        let angle = step * ((i % RING_SEGMENTS) as f64 + 0.5);
        Vector::new(vertex_radius * ComplexField::cos(angle), vertex_radius * ComplexField::sin(angle), 0.0)
    };
    SharedShape::compound(
        (0..RING_SEGMENTS)
            .map(|i| {
                let (a, b) = (vertex(i), vertex(i + 1));
                let middle = (a + b) / 2.0;
                (
                    RapierPose::from_translation(middle),
                    SharedShape::capsule(a - middle, b - middle, tube_radius),
                )
            })
            .collect(),
    )
}

/// Mass properties of a homogeneous solid of that shape: centre, mass and principal moments.
pub fn mass_properties(shape: &Shape, mass: f64) -> MassProperties {
    let (com, moments) = match shape {
        Shape::Box { half_extents: [x, y, z] } => {
            (Vector3::zeros(), Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y) * (mass / 3.0))
        }
        Shape::Sphere { radius } => (Vector3::zeros(), Vector3::repeat(0.4 * mass * radius * radius)),
        Shape::Cylinder { radius, half_height } => {
            let transverse = mass * (radius * radius / 4.0 + half_height * half_height / 3.0);
            (Vector3::zeros(), Vector3::new(transverse, transverse, mass * radius * radius / 2.0))
        }
        Shape::Capsule { radius, half_height } => {
            (Vector3::zeros(), capsule_moments(*radius, *half_height, mass))
        }
        Shape::Torus { ring_radius, tube_radius } => {
            let (big, small) = (ring_radius * ring_radius, tube_radius * tube_radius);
            let transverse = mass * (big / 2.0 + 0.625 * small);
            (Vector3::zeros(), Vector3::new(transverse, transverse, mass * (big + 0.75 * small)))
        }
        // The mass of the pegs is negligible.
        Shape::PegBoard { half_extents: [x, y], thickness, .. } => {
            let z = thickness / 2.0;
            (
                Vector3::new(0.0, 0.0, -z),
                Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y) * (mass / 3.0),
            )
        }
    };
    MassProperties::new(Vector::new(com.x, com.y, com.z), mass, Vector::new(moments.x, moments.y, moments.z))
}

/// Mass properties of the volume that a surface encloses.
pub fn solid_properties(solid: &UnitSolid, mass: f64) -> MassProperties {
    let centre = Vector::new(solid.centre.x, solid.centre.y, solid.centre.z);
    MassProperties::with_inertia_matrix(centre, mass, matrix_to_rapier(&(solid.inertia * mass)))
}

/// A cylinder and two hemispheres, each with its fraction of the volume.
fn capsule_moments(radius: f64, half_height: f64, mass: f64) -> Vector3<f64> {
    let (r2, length) = (radius * radius, 2.0 * half_height);
    let (cylinder_volume, ball_volume) = (length, 4.0 / 3.0 * radius);
    let cylinder = mass * cylinder_volume / (cylinder_volume + ball_volume);
    let ball = mass - cylinder;
    // The centroid of a hemisphere is 3/8 r beyond the cylinder's end.
    let offset = half_height * half_height + 0.75 * half_height * radius;
    let transverse = cylinder * (r2 / 4.0 + length * length / 12.0) + ball * (0.4 * r2 + offset);
    Vector3::new(transverse, transverse, cylinder * r2 / 2.0 + ball * 0.4 * r2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ring_of_capsules_follows_the_torus() {
        let shape = Shape::Torus { ring_radius: 0.008, tube_radius: 0.0015 };
        let parts = parts(&shape);
        assert_eq!(parts.len(), 1);
        let mut worst: f64 = 0.0;
        for i in 0..720 {
            let angle = f64::from(i) * std::f64::consts::PI / 360.0;
            let on_top = Vector::new(0.008 * angle.cos(), 0.008 * angle.sin(), 0.01);
            let distance = parts[0].shape.distance_to_local_point(on_top, true);
            worst = worst.max((distance - (0.01 - 0.0015)).abs());
        }
        assert!(worst < 1e-6, "top of the tube is off by {worst} m");
        let hole = parts[0].shape.distance_to_local_point(Vector::ZERO, true);
        assert!((hole - 0.0065).abs() < 80e-6, "hole of radius {hole} m");
    }

    #[test]
    fn moments_match_parry_where_parry_has_them() {
        for shape in [
            Shape::Box { half_extents: [0.01, 0.02, 0.03] },
            Shape::Sphere { radius: 0.01 },
            Shape::Cylinder { radius: 0.01, half_height: 0.03 },
            Shape::Capsule { radius: 0.01, half_height: 0.03 },
        ] {
            let part = &parts(&shape)[0];
            let theirs = part.shape.mass_properties(1000.0).transform_by(&part.pose);
            let ours = mass_properties(&shape, theirs.mass()).reconstruct_inertia_matrix();
            let theirs = theirs.reconstruct_inertia_matrix();
            for (a, b) in ours.to_cols_array().iter().zip(theirs.to_cols_array()) {
                assert!((a - b).abs() < 1e-9, "{shape:?}: {ours:?} is not {theirs:?}");
            }
        }
    }

    #[test]
    fn torus_moment_about_its_axis_is_near_that_of_a_hoop() {
        let moments = mass_properties(&Shape::Torus { ring_radius: 0.008, tube_radius: 0.0015 }, 0.005)
            .principal_inertia();
        assert!((moments.z / (0.005 * (0.008f64.powi(2) + 0.75 * 0.0015f64.powi(2))) - 1.0).abs() < 1e-9);
        assert!(moments.x > moments.z / 2.0 && moments.x < 0.52 * moments.z);
    }
}
