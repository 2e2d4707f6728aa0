//! Axis-aligned bounding boxes for the broad phase.

use nalgebra::{Isometry3, Vector3};

use super::convex_parts::{Core, Part};

/// Lower and upper corner \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub min: Vector3<f64>,
    pub max: Vector3<f64>,
}

impl Default for Bounds {
    /// An empty box.
    fn default() -> Self {
        Self { min: Vector3::repeat(f64::INFINITY), max: Vector3::repeat(f64::NEG_INFINITY) }
    }
}

impl Bounds {
    /// Box of a part at a pose in world.
    pub fn of(part: &Part, world_from_part: &Isometry3<f64>) -> Self {
        let axes = world_from_part.rotation.to_rotation_matrix();
        let core = match part.core {
            Core::Point => Vector3::zeros(),
            Core::Segment(half) => axes.matrix().column(2).abs() * half,
            Core::Box(half) => axes.matrix().abs() * half,
        };
        let (middle, half) = (world_from_part.translation.vector, core.add_scalar(part.radius));
        Self { min: middle - half, max: middle + half }
    }

    /// Union of both.
    pub fn with(&self, other: &Self) -> Self {
        Self { min: self.min.inf(&other.min), max: self.max.sup(&other.max) }
    }

    /// The box, translated.
    pub fn moved(&self, by: &Vector3<f64>) -> Self {
        Self { min: self.min + by, max: self.max + by }
    }

    /// Whether the boxes are further apart than a distance.
    #[inline]
    pub fn is_apart(&self, other: &Self, distance: f64) -> bool {
        (0..3).any(|axis| {
            self.min[axis] - other.max[axis] > distance || other.min[axis] - self.max[axis] > distance
        })
    }

    /// Length of the diagonal \[m\]; 0 when empty.
    pub fn diagonal(&self) -> f64 {
        let edges = self.max - self.min;
        if edges.min() < 0.0 { 0.0 } else { edges.norm() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::impulse_world::closest_features::touch;
    use nalgebra::{Point3, UnitQuaternion};
    use rand::{Rng, SeedableRng};

    /// Parts within contact distance are never reported as further apart.
    #[test]
    fn who_is_apart_has_no_contact_and_most_that_have_none_are() {
        let mut random = rand_pcg::Pcg64::seed_from_u64(3);
        let mut of = |number: usize| {
            let [x, y, z] = std::array::from_fn(|_| random.random_range(-0.015..0.015));
            let turn = Vector3::from_fn(|_, _| random.random_range(-3.0..3.0));
            let pose = Isometry3::from_parts(Vector3::new(x, y, z).into(), UnitQuaternion::new(turn));
            let half = random.random_range(0.001..0.02);
            let core = match number % 3 {
                0 => Core::Point,
                1 => Core::Segment(half),
                _ => Core::Box(Vector3::new(half, 0.004, 0.002)),
            };
            (Part { pose: Isometry3::identity(), core, radius: random.random_range(0.0..0.004) }, pose)
        };
        let (mut apart, mut touching, mut points) = (0, 0, Vec::new());
        for number in 0..4000 {
            let [(a, at), (b, bt)] = [of(number), of(number / 3)];
            points.clear();
            touch((&a, &at), (&b, &bt), 1e-3, &mut points);
            let is_apart = Bounds::of(&a, &at).is_apart(&Bounds::of(&b, &bt), 1e-3);
            assert!(!is_apart || points.is_empty(), "{a:?} {at} {b:?} {bt}: {points:?}");
            touching += usize::from(!points.is_empty());
            apart += usize::from(is_apart);
        }
        assert!(touching > 400 && apart > (4000 - touching) / 2, "{touching} touch, {apart} are apart");
    }

    #[test]
    fn a_box_is_about_what_it_holds_and_no_larger() {
        let ball = Part { pose: Isometry3::identity(), core: Core::Point, radius: 0.01 };
        let rod = Part::segment(&Point3::new(0.0, 0.0, 0.0), &Point3::new(0.04, 0.0, 0.0), 0.001);
        let bounds =
            Bounds::of(&rod, &rod.pose).with(&Bounds::of(&ball, &Isometry3::translation(0.0, 0.0, 0.1)));
        let wanted = [Vector3::new(-0.01, -0.01, -0.001), Vector3::new(0.041, 0.01, 0.11)];
        assert!(
            (bounds.min - wanted[0]).norm() < 1e-12 && (bounds.max - wanted[1]).norm() < 1e-12,
            "{bounds:?}"
        );
        assert_eq!(Bounds::default().diagonal(), 0.0);
        assert!(bounds.is_apart(&bounds.moved(&Vector3::new(0.0, 0.03, 0.0)), 0.005));
        assert!(!bounds.is_apart(&bounds.moved(&Vector3::new(0.0, 0.03, 0.0)), 0.015));
    }
}
