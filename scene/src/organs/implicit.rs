//! Implicit bodies: functions that are positive inside, zero on the surface, and about the distance to it nearby. Parts
//! blend smoothly into each other (Quilez 2013: polynomial smooth minimum).

use nalgebra::{Isometry3, Point3, Vector3};

/// A part of a body.
#[derive(Clone, Debug, PartialEq)]
pub enum Part {
    /// An ellipsoid with its own axes.
    Ellipsoid {
        /// `body_from_part`.
        pose: Isometry3<f64>,
        /// Half lengths of its axes \[m\].
        radii: Vector3<f64>,
    },
    /// A rod between two points, each with a radius of its own.
    Cone {
        /// Its ends \[m\].
        ends: [Point3<f64>; 2],
        /// Radii at the ends \[m\].
        radii: [f64; 2],
    },
    /// A box with rounded edges.
    Block {
        /// `body_from_part`.
        pose: Isometry3<f64>,
        /// Half lengths of its edges \[m\].
        half: Vector3<f64>,
        /// Radius of the edges \[m\], at most the smallest half length.
        rounding: f64,
    },
}

/// A body of blended parts, minus half spaces and hollows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Implicit {
    /// Its parts.
    pub parts: Vec<Part>,
    /// Half spaces that are cut away, each by a point and the normal towards the removed side.
    pub cuts: Vec<(Point3<f64>, Vector3<f64>)>,
    /// Parts that are hollowed out.
    pub hollows: Vec<Part>,
    /// Length over which parts blend \[m\]; 0 for sharp seams.
    pub blend: f64,
    /// Thickness of the wall of a hollow body \[m\]; a solid one has none.
    pub wall: Option<f64>,
}

impl Part {
    /// About the distance to its surface \[m\], positive inside.
    pub fn depth(&self, point: &Point3<f64>) -> f64 {
        match self {
            Self::Ellipsoid { pose, radii } => {
                let p = pose.inverse_transform_point(point).coords;
                let unit = p.component_div(radii).norm();
                let gradient = p.component_div(&radii.component_mul(radii)).norm();
                if gradient < 1e-12 { radii.min() } else { unit * (1.0 - unit) / gradient }
            }
            Self::Cone { ends: [a, b], radii } => {
                let axis = b - a;
                let length = axis.norm_squared();
                let along =
                    if length > 0.0 { ((point - a).dot(&axis) / length).clamp(0.0, 1.0) } else { 0.0 };
                radii[0] + (radii[1] - radii[0]) * along - (point - (a + axis * along)).norm()
            }
            Self::Block { pose, half, rounding } => {
                let p = pose.inverse_transform_point(point).coords.abs() - half.add_scalar(-rounding);
                let outside = p.map(|x| x.max(0.0)).norm();
                rounding - outside - p.max().min(0.0)
            }
        }
    }

    /// A box around it, along the body's axes \[m\].
    pub fn bounds(&self) -> [Point3<f64>; 2] {
        match self {
            Self::Ellipsoid { pose, radii } => around(pose, radii),
            Self::Block { pose, half, .. } => around(pose, half),
            Self::Cone { ends: [a, b], radii } => {
                let [r, s] = radii.map(Vector3::repeat);
                [(a - r).inf(&(b - s)), (a + r).sup(&(b + s))]
            }
        }
    }
}

fn around(pose: &Isometry3<f64>, half: &Vector3<f64>) -> [Point3<f64>; 2] {
    // Bounds of a rotated box; larger than necessary for an ellipsoid.
    let reach = pose.rotation.to_rotation_matrix().matrix().abs() * half;
    let middle = Point3::from(pose.translation.vector);
    [middle - reach, middle + reach]
}

impl Implicit {
    /// About the distance to the surface \[m\], positive inside.
    pub fn depth(&self, point: &Point3<f64>) -> f64 {
        let mut depth = f64::NEG_INFINITY;
        for part in &self.parts {
            depth = smooth_max(depth, part.depth(point), self.blend);
        }
        for (place, normal) in &self.cuts {
            depth = -smooth_max(-depth, (point - place).dot(normal), self.blend);
        }
        for hollow in &self.hollows {
            depth = -smooth_max(-depth, hollow.depth(point), self.blend);
        }
        match self.wall {
            Some(wall) => depth.min(wall - depth),
            None => depth,
        }
    }

    /// A box around it \[m\]; `None` without parts.
    pub fn bounds(&self) -> Option<[Point3<f64>; 2]> {
        let boxes = self.parts.iter().map(Part::bounds);
        let [low, high] = boxes.reduce(|[a, b], [c, d]| [a.inf(&c), b.sup(&d)])?;
        // A blend bulges by a quarter of its length.
        let bulge = Vector3::repeat(0.25 * self.blend);
        Some([low - bulge, high + bulge])
    }
}

/// Smooth maximum of two values.
fn smooth_max(a: f64, b: f64, blend: f64) -> f64 {
    let apart = (a - b).abs();
    let larger = a.max(b);
    if blend <= 0.0 || apart >= blend {
        return larger;
    }
    let overlap = blend - apart;
    larger + overlap * overlap / (4.0 * blend)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ball(x: f64, radius: f64) -> Part {
        Part::Ellipsoid { pose: Isometry3::translation(x, 0.0, 0.0), radii: Vector3::repeat(radius) }
    }

    #[test]
    fn depths_of_parts_are_distances() {
        assert!((ball(0.0, 0.05).depth(&Point3::new(0.02, 0.0, 0.0)) - 0.03).abs() < 1e-15);
        assert!((ball(0.0, 0.05).depth(&Point3::origin()) - 0.05).abs() < 1e-15);
        let cone = Part::Cone { ends: [Point3::origin(), Point3::new(0.1, 0.0, 0.0)], radii: [0.02, 0.01] };
        assert!((cone.depth(&Point3::new(0.05, 0.0, 0.0)) - 0.015).abs() < 1e-15);
        let half = Vector3::new(0.03, 0.02, 0.01);
        let block = Part::Block { pose: Isometry3::identity(), half, rounding: 0.004 };
        assert!((block.depth(&Point3::new(0.04, 0.0, 0.0)) + 0.01).abs() < 1e-15);
        assert!((block.depth(&Point3::origin()) - 0.01).abs() < 1e-15);
    }

    #[test]
    fn a_blend_is_smooth_and_within_its_bounds() {
        let body =
            Implicit { parts: vec![ball(-0.03, 0.04), ball(0.03, 0.04)], blend: 0.03, ..Default::default() };
        let [low, high] = body.bounds().unwrap();
        for k in 0..2000 {
            let angle = f64::from(k) * 0.01;
            let far = f64::from(k % 37) * 0.004;
            let p = Point3::new(far * angle.cos(), far * angle.sin(), far * (3.0 * angle).sin());
            if body.depth(&p) > 0.0 {
                assert!(p >= low && p <= high, "{p} is inside of the body and outside of its box");
            }
        }
        // The seam is filled.
        assert!(body.depth(&Point3::new(0.0, 0.028, 0.0)) > 0.0);
        assert!(ball(0.03, 0.04).depth(&Point3::new(0.0, 0.028, 0.0)) < 0.0);
    }

    #[test]
    fn a_wall_is_hollow() {
        let bag = Implicit { parts: vec![ball(0.0, 0.05)], wall: Some(0.004), ..Default::default() };
        assert!(bag.depth(&Point3::origin()) < 0.0);
        assert!((bag.depth(&Point3::new(0.048, 0.0, 0.0)) - 0.002).abs() < 1e-12);
        assert!(bag.depth(&Point3::new(0.051, 0.0, 0.0)) < 0.0);
    }
}
