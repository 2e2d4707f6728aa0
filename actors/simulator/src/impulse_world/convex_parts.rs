//! Decomposition of shapes into parts with closed-form contacts: points, segments and boxes, each with a rounded skin.

use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_dynamics::rigid_world::mass_properties::UnitSolid;
use trocar_scene::Shape;

use crate::rigid::RigidMass;

/// Number of rounded segments in a ring: their chords deviate from the circle by at most 77 µm to either side for a
/// ring of 8 mm.
const RING_SEGMENTS: usize = 16;
/// Number of boxes in a cylinder: their corners lie on its circle, 12 degrees apart.
const CYLINDER_BOXES: usize = 15;

/// The core of a part, inside of its skin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Core {
    /// The origin.
    Point,
    /// Along z, half of its length to either side \[m\].
    Segment(f64),
    /// Half extents \[m\].
    Box(Vector3<f64>),
}

/// A part of a body: all points within `radius` of its core.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Part {
    /// `body_from_part`.
    pub pose: Isometry3<f64>,
    /// Its core.
    pub core: Core,
    /// Radius of the skin \[m\].
    pub radius: f64,
}

impl Part {
    /// A rounded segment between two points of the body.
    #[must_use]
    pub fn segment(from: &Point3<f64>, to: &Point3<f64>, radius: f64) -> Self {
        let along = to - from;
        let turn =
            UnitQuaternion::rotation_between(&Vector3::z(), &along).unwrap_or_else(UnitQuaternion::identity);
        let turn = if along.z < 0.0 && along.xy().norm() < 1e-12 { UnitQuaternion::identity() } else { turn };
        let middle = nalgebra::center(from, to);
        Self {
            pose: Isometry3::from_parts(middle.coords.into(), turn),
            core: Core::Segment(along.norm() / 2.0),
            radius,
        }
    }

    /// A box with these half extents \[m\] at a pose in the body.
    #[must_use]
    pub fn cuboid(pose: Isometry3<f64>, half: Vector3<f64>) -> Self {
        Self { pose, core: Core::Box(half), radius: 0.0 }
    }

    /// Radius of its bounding sphere about its own origin \[m\].
    #[must_use]
    pub fn reach(&self) -> f64 {
        let core = match self.core {
            Core::Point => 0.0,
            Core::Segment(half) => half,
            Core::Box(half) => half.norm(),
        };
        core + self.radius
    }
}

/// The parts of a shape. A ring is a closed chain of rounded segments, a cylinder a fan of boxes around its axis.
#[must_use]
pub fn parts_of(shape: &Shape) -> Vec<Part> {
    let centred = |core, radius| vec![Part { pose: Isometry3::identity(), core, radius }];
    match shape {
        Shape::Box { half_extents } => centred(Core::Box(Vector3::from(*half_extents)), 0.0),
        Shape::Sphere { radius } => centred(Core::Point, *radius),
        Shape::Capsule { radius, half_height } => centred(Core::Segment(*half_height), *radius),
        Shape::Cylinder { radius, half_height } => {
            let step = std::f64::consts::PI / CYLINDER_BOXES as f64;
            let half = Vector3::new(radius * (step / 2.0).cos(), radius * (step / 2.0).sin(), *half_height);
            let turned = |k: usize| Isometry3::rotation(Vector3::z() * (step * k as f64));
            (0..CYLINDER_BOXES).map(|k| Part::cuboid(turned(k), half)).collect()
        }
        Shape::Torus { ring_radius, tube_radius } => ring(*ring_radius, *tube_radius),
        Shape::PegBoard { half_extents: [x, y], thickness, pegs, peg_radius, peg_height } => {
            let board = Isometry3::translation(0.0, 0.0, -thickness / 2.0);
            // The round top ends at the peg's height, so that a ring slides over it.
            let top = (peg_height - peg_radius).max(0.0);
            let peg = |[x, y]: &[f64; 2]| {
                Part::segment(&Point3::new(*x, *y, 0.0), &Point3::new(*x, *y, top), *peg_radius)
            };
            std::iter::once(Part::cuboid(board, Vector3::new(*x, *y, thickness / 2.0)))
                .chain(pegs.iter().map(peg))
                .collect()
        }
    }
}

/// A ring around z whose mean radius is that of the circle.
fn ring(ring_radius: f64, tube_radius: f64) -> Vec<Part> {
    let step = std::f64::consts::TAU / RING_SEGMENTS as f64;
    // Vertices lie outside of the circle by as much as chord centres lie inside.
    let radius = 2.0 * ring_radius / (1.0 + (step / 2.0).cos());
    let vertex = |i: usize| {
        let angle = step * ((i % RING_SEGMENTS) as f64 + 0.5);
        Point3::new(radius * angle.cos(), radius * angle.sin(), 0.0)
    };
    (0..RING_SEGMENTS).map(|i| Part::segment(&vertex(i), &vertex(i + 1), tube_radius)).collect()
}

/// Mass properties of a solid, homogeneous shape, and its principal frame: `body_from_principal`.
#[must_use]
pub fn mass_of(shape: &Shape, mass: f64) -> (RigidMass, Isometry3<f64>) {
    let cuboid = |x: f64, y: f64, z: f64| Vector3::new(y * y + z * z, x * x + z * z, x * x + y * y) / 3.0;
    let (centre, per_mass) = match shape {
        Shape::Box { half_extents: [x, y, z] } => (Vector3::zeros(), cuboid(*x, *y, *z)),
        Shape::Sphere { radius } => (Vector3::zeros(), Vector3::repeat(0.4 * radius * radius)),
        Shape::Cylinder { radius, half_height } => {
            let across = radius * radius / 4.0 + half_height * half_height / 3.0;
            (Vector3::zeros(), Vector3::new(across, across, radius * radius / 2.0))
        }
        Shape::Capsule { radius, half_height } => (Vector3::zeros(), capsule(*radius, *half_height)),
        Shape::Torus { ring_radius, tube_radius } => {
            let (big, small) = (ring_radius * ring_radius, tube_radius * tube_radius);
            let across = big / 2.0 + 0.625 * small;
            (Vector3::zeros(), Vector3::new(across, across, big + 0.75 * small))
        }
        // The pegs' mass is neglected.
        Shape::PegBoard { half_extents: [x, y], thickness, .. } => {
            (Vector3::new(0.0, 0.0, -thickness / 2.0), cuboid(*x, *y, thickness / 2.0))
        }
    };
    (RigidMass { mass, inertia: per_mass * mass }, Isometry3::translation(centre.x, centre.y, centre.z))
}

/// The same for the interior of a surface: the principal axes are the eigenvectors of its inertia.
#[must_use]
pub fn mass_of_solid(solid: &UnitSolid, mass: f64) -> (RigidMass, Isometry3<f64>) {
    let eigen = solid.inertia.symmetric_eigen();
    let mut axes = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.column_mut(2).neg_mut();
    }
    let turn = UnitQuaternion::from_matrix(&axes);
    let pose = Isometry3::from_parts(solid.centre.coords.into(), turn);
    (RigidMass { mass, inertia: eigen.eigenvalues * mass }, pose)
}

/// Inertia of a capsule per mass: a cylinder and two hemispheres, each with its share of the volume.
fn capsule(radius: f64, half_height: f64) -> Vector3<f64> {
    let (square, length) = (radius * radius, 2.0 * half_height);
    let cylinder = length / (length + 4.0 / 3.0 * radius);
    let ball = 1.0 - cylinder;
    // The centroids of the hemispheres lie 3/8 r beyond the cylinder's ends.
    let offset = half_height * half_height + 0.75 * half_height * radius;
    let across = cylinder * (square / 4.0 + length * length / 12.0) + ball * (0.4 * square + offset);
    Vector3::new(across, across, cylinder * square / 2.0 + ball * 0.4 * square)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_segment_lies_between_its_ends_whichever_way_it_points() {
        for to in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.3, -0.2, -0.9]] {
            let (from, to) = (Point3::new(0.1, 0.2, 0.3), Point3::from(to));
            let part = Part::segment(&from, &to, 0.1);
            let Core::Segment(half) = part.core else { panic!("{part:?}") };
            let ends = [-half, half].map(|z| part.pose * Point3::new(0.0, 0.0, z));
            let is = |a: usize, b: usize| (ends[a] - from).norm() < 1e-12 && (ends[b] - to).norm() < 1e-12;
            assert!(is(0, 1) || is(1, 0), "{ends:?}");
        }
    }

    #[test]
    fn a_solid_box_weighs_as_one_that_is_a_surface() {
        let half = [0.01, 0.02, 0.03];
        let shape = Shape::Box { half_extents: half };
        let (mass, _) = mass_of(&shape, 0.7);
        let surface = trocar_scene::shapes::surface_of(&shape, &trocar_scene::shapes::Detail::default())
            .expect("a box");
        let solid =
            trocar_dynamics::rigid_world::mass_properties::enclosed(&surface.positions, &surface.triangles)
                .expect("a solid");
        let (same, pose) = mass_of_solid(&solid, 0.7);
        let (mut one, mut other) = (mass.inertia.as_slice().to_vec(), same.inertia.as_slice().to_vec());
        one.sort_by(f64::total_cmp);
        other.sort_by(f64::total_cmp);
        assert!(pose.translation.vector.norm() < 1e-12);
        for (a, b) in one.iter().zip(&other) {
            assert!((a / b - 1.0).abs() < 1e-9, "{one:?} {other:?}");
        }
    }
}
