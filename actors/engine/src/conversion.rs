//! Conversions between the scene's nalgebra types and Rapier's glam types; nothing else converts.

use nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};
use rapier3d_f64::math::{Matrix, Pose as RapierPose, Rotation, Vector};
use trocar_scene::components::Pose;

/// A free or bound vector for Rapier.
pub fn vector_to_rapier(v: &Vector3<f64>) -> Vector {
    Vector::new(v.x, v.y, v.z)
}

/// A vector from Rapier.
pub fn vector_from_rapier(v: Vector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}

/// A position from Rapier, which has no type of its own for points.
pub fn point_from_rapier(v: Vector) -> Point3<f64> {
    Point3::new(v.x, v.y, v.z)
}

/// A rotation for Rapier.
pub fn rotation_to_rapier(q: &UnitQuaternion<f64>) -> Rotation {
    Rotation::from_xyzw(q.i, q.j, q.k, q.w)
}

/// A rotation from Rapier, renormalised: the scene refuses quaternions that drifted off unit length.
pub fn rotation_from_rapier(q: Rotation) -> UnitQuaternion<f64> {
    UnitQuaternion::new_normalize(Quaternion::new(q.w, q.x, q.y, q.z))
}

/// A rigid transform for Rapier.
pub fn isometry_to_rapier(iso: &Isometry3<f64>) -> RapierPose {
    RapierPose::from_parts(vector_to_rapier(&iso.translation.vector), rotation_to_rapier(&iso.rotation))
}

/// A rigid transform from Rapier.
pub fn isometry_from_rapier(pose: &RapierPose) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::from(vector_from_rapier(pose.translation)),
        rotation_from_rapier(pose.rotation),
    )
}

/// A pose of the scene for Rapier.
pub fn pose_to_rapier(pose: &Pose) -> RapierPose {
    RapierPose::from_parts(vector_to_rapier(&pose.translation), rotation_to_rapier(&pose.rotation))
}

/// A pose of the scene from Rapier.
pub fn pose_from_rapier(pose: &RapierPose) -> Pose {
    Pose::new(vector_from_rapier(pose.translation), rotation_from_rapier(pose.rotation))
}

/// A 3×3 matrix for Rapier (both sides store columns).
pub fn matrix_to_rapier(m: &Matrix3<f64>) -> Matrix {
    Matrix::from_cols(
        Vector::new(m.m11, m.m21, m.m31),
        Vector::new(m.m12, m.m22, m.m32),
        Vector::new(m.m13, m.m23, m.m33),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn isometries_survive_the_round_trip() {
        let iso = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.4, 1.1, -0.7));
        let back = isometry_from_rapier(&isometry_to_rapier(&iso));
        assert!((back.translation.vector - iso.translation.vector).norm() < 1e-15);
        assert!(back.rotation.angle_to(&iso.rotation) < 1e-12);
    }

    #[test]
    fn both_sides_turn_a_vector_alike() {
        let iso = Isometry3::new(Vector3::new(0.1, -0.2, 0.3), Vector3::new(0.4, 1.1, -0.7));
        let v = Vector3::new(1.0, 2.0, 3.0);
        let ours = iso.transform_point(&v.into()).coords;
        let theirs = vector_from_rapier(isometry_to_rapier(&iso).transform_point(vector_to_rapier(&v)));
        assert!((ours - theirs).norm() < 1e-14);
        let m = *iso.rotation.to_rotation_matrix().matrix();
        let turned = vector_from_rapier(matrix_to_rapier(&m) * vector_to_rapier(&v));
        assert!((m * v - turned).norm() < 1e-14);
    }
}
