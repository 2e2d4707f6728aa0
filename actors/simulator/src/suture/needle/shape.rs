//! Shape of a needle: an arc of round wire. The origin of its frame is the centre of mass; the arc lies in the x–y
//! plane, bulges towards +x, and runs from the tail (−y) to the tip (+y).

use nalgebra::{Matrix3, Point3, Vector3};
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Number of pieces for the integrals along the wire.
const PIECES: usize = 512;

/// An arc of round wire. Needles are named by their arc length and fraction of a circle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct NeedleShape {
    /// Radius of the arc, to the axis of the wire \[m\].
    pub radius: f64,
    /// Angle of the arc \[rad\].
    pub angle: f64,
    /// Radius of the wire \[m\].
    pub wire_radius: f64,
    /// Length of the taper at the tip, over which the wire grows from zero to its radius \[m\].
    pub taper: f64,
    /// Density \[kg/m³\].
    pub density: f64,
}

/// Why a needle was rejected.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("a needle with {what} {value}: valid is {valid}")]
pub struct NeedleError {
    /// The parameter.
    pub what: &'static str,
    /// Its value.
    pub value: f64,
    /// Its valid range.
    pub valid: &'static str,
}

impl NeedleShape {
    /// A half circle of 26 mm of 0.6 mm wire with a taper of 5 mm, such as is swaged to 2-0 silk for soft tissue; steel of
    /// 7.9 g/cm³.
    #[must_use]
    pub fn half_circle_26() -> Self {
        Self {
            radius: 0.026 / std::f64::consts::PI,
            angle: std::f64::consts::PI,
            wire_radius: 3e-4,
            taper: 5e-3,
            density: 7900.0,
        }
    }

    /// Length of the arc \[m\].
    #[must_use]
    pub fn length(&self) -> f64 {
        self.radius * self.angle
    }

    /// Rejects invalid parameters.
    ///
    /// # Errors
    /// The first parameter out of range, and its range.
    pub fn check(&self) -> Result<(), NeedleError> {
        let within = |what, value: f64, least: f64, most: f64, valid| {
            if value >= least && value <= most { Ok(()) } else { Err(NeedleError { what, value, valid }) }
        };
        within("radius", self.radius, 1e-3, 10.0, "1 mm to 10 m")?;
        within("angle", self.angle, 1e-3, 5.0, "0.001 to 5 rad")?;
        within("length", self.length(), 2e-3, 0.3, "an arc of 2 mm to 0.3 m")?;
        let thick = 0.2 * self.radius.min(self.length());
        within("wire_radius", self.wire_radius, 2e-5, thick, "20 µm to a fifth of radius and length")?;
        within("taper", self.taper, 0.0, 0.9 * self.length(), "0 to nine tenths of the length")?;
        within("density", self.density, 100.0, 3e4, "100 to 30,000 kg/m³")
    }

    /// Radius of the wire at an arc length from the tail \[m\].
    #[must_use]
    pub fn wire_radius_at(&self, along: f64) -> f64 {
        let from_tip = (self.length() - along).max(0.0);
        if from_tip < self.taper { self.wire_radius * from_tip / self.taper } else { self.wire_radius }
    }

    /// Mass properties of the shape, by integration along the wire.
    ///
    /// # Errors
    /// As [`NeedleShape::check`].
    pub fn solid(&self) -> Result<Solid, NeedleError> {
        self.check()?;
        let step = self.length() / PIECES as f64;
        let pieces = || {
            (0..PIECES).map(|piece| {
                let along = (piece as f64 + 0.5) * step;
                let radius = self.wire_radius_at(along);
                let mass = self.density * std::f64::consts::PI * radius * radius * step;
                let (sin, cos) = (along / self.radius - 0.5 * self.angle).sin_cos();
                (
                    mass,
                    radius,
                    Vector3::new(self.radius * cos, self.radius * sin, 0.0),
                    Vector3::new(-sin, cos, 0.0),
                )
            })
        };
        let mass: f64 = pieces().map(|(mass, ..)| mass).sum();
        let center = pieces().map(|(mass, _, at, _)| at * mass).sum::<Vector3<f64>>() / mass;
        let mut inertia = Matrix3::zeros();
        for (mass, radius, at, tangent) in pieces() {
            let arm = at - center;
            // A short cylinder: ½ m r² about its axis, ¼ m r² and m h²/12 across.
            let across = mass * (0.25 * radius * radius + step * step / 12.0);
            let along = mass * 0.5 * radius * radius;
            let own = Matrix3::identity() * across + tangent * tangent.transpose() * (along - across);
            inertia += own + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * mass;
        }
        Ok(Solid { shape: *self, mass, center, inertia })
    }
}

/// A shape with its mass properties. Points are in the frame of the needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solid {
    shape: NeedleShape,
    mass: f64,
    /// Centre of mass, from the centre of the arc.
    center: Vector3<f64>,
    inertia: Matrix3<f64>,
}

impl Solid {
    /// The shape.
    #[must_use]
    pub fn shape(&self) -> &NeedleShape {
        &self.shape
    }

    /// Mass \[kg\].
    #[must_use]
    pub fn mass(&self) -> f64 {
        self.mass
    }

    /// Inertia about the centre of mass \[kg·m²\].
    #[must_use]
    pub fn inertia(&self) -> &Matrix3<f64> {
        &self.inertia
    }

    /// The centre of the arc.
    #[must_use]
    pub fn center_of_arc(&self) -> Point3<f64> {
        Point3::from(-self.center)
    }

    /// The point on the axis at an arc length from the tail \[m\]; the circle is continued beyond the ends.
    #[must_use]
    pub fn point(&self, along: f64) -> Point3<f64> {
        let (sin, cos) = self.turn(along).sin_cos();
        Point3::from(Vector3::new(cos, sin, 0.0) * self.shape.radius - self.center)
    }

    /// The unit tangent towards the tip there.
    #[must_use]
    pub fn tangent(&self, along: f64) -> Vector3<f64> {
        let (sin, cos) = self.turn(along).sin_cos();
        Vector3::new(-sin, cos, 0.0)
    }

    fn turn(&self, along: f64) -> f64 {
        along / self.shape.radius - 0.5 * self.shape.angle
    }

    /// Arc length of the circle's closest point to a point \[m\]: below 0 behind the tail, above the length beyond the
    /// tip. The circle is cut opposite the middle of the arc.
    #[must_use]
    pub fn nearest(&self, point: &Point3<f64>) -> f64 {
        let from = point.coords + self.center;
        (from.y.atan2(from.x) + 0.5 * self.shape.angle) * self.shape.radius
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mass_and_inertia_are_those_of_a_half_ring() {
        let shape = NeedleShape { taper: 0.0, wire_radius: 1e-4, ..NeedleShape::half_circle_26() };
        let solid = shape.solid().expect("a needle");
        let (r, m) = (shape.radius, solid.mass());
        let expected = shape.density * std::f64::consts::PI * 1e-8 * shape.length();
        assert!((m / expected - 1.0).abs() < 1e-12);
        // Centroid 2 r/π from the centre; about it m r² (1 − 4/π²) across the plane, m r²/2 about x, the rest about y.
        let pi = std::f64::consts::PI;
        assert!((solid.center_of_arc().x + 2.0 * r / pi).abs() < 1e-6 * r);
        for (axis, share) in [(0, 0.5), (1, 0.5 - 4.0 / (pi * pi)), (2, 1.0 - 4.0 / (pi * pi))] {
            let found = solid.inertia()[(axis, axis)] / (m * r * r);
            assert!((found - share).abs() < 2e-4, "axis {axis}: {found} for {share}");
        }
    }

    #[test]
    fn the_nearest_place_is_found_along_the_arc_and_beyond_its_ends() {
        let solid = NeedleShape::half_circle_26().solid().expect("a needle");
        for along in [-2e-3, 0.0, 7e-3, 0.026, 0.028] {
            let beside = solid.point(along) + Vector3::z() * 1e-3;
            assert!((solid.nearest(&beside) - along).abs() < 1e-12);
            let ahead = solid.point(along + 1e-7) - solid.point(along - 1e-7);
            assert!((ahead / 2e-7 - solid.tangent(along)).norm() < 1e-6);
        }
    }

    #[test]
    fn what_is_no_needle_is_refused() {
        let needle = NeedleShape::half_circle_26();
        for wrong in [
            NeedleShape { radius: f64::NAN, ..needle },
            NeedleShape { angle: 7.0, ..needle },
            NeedleShape { wire_radius: 0.0, ..needle },
            NeedleShape { taper: 0.1, ..needle },
            NeedleShape { density: -1.0, ..needle },
        ] {
            assert!(wrong.solid().is_err(), "{wrong:?}");
        }
        assert!(needle.solid().is_ok());
    }
}
