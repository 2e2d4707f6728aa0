//! What touches what, how deep, and with what force, as those tell it who move rigid bodies.

use nalgebra::{Point3, Vector3};
use trocar_scene::{Entity, Primitive};

/// A contact between two parts of bodies: of all its points the mean position, the sum of forces and the largest
/// depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// First entity and its part.
    pub a: (Entity, Primitive),
    /// Second entity and its part.
    pub b: (Entity, Primitive),
    /// Where \[m\].
    pub point_in_world: Point3<f64>,
    /// Unit direction from `a` to `b`.
    pub normal_in_world: Vector3<f64>,
    /// Penetration \[m\]; negative while apart.
    pub depth: f64,
    /// Normal force on `b` \[N\].
    pub normal_force: f64,
    /// Friction on `b`, in world \[N\].
    pub friction_in_world: Vector3<f64>,
    /// Coulomb coefficient in effect.
    pub friction_coefficient: f64,
    /// Whether `a` cannot give way.
    pub a_is_fixed: bool,
    /// Whether `b` cannot give way.
    pub b_is_fixed: bool,
}

impl Contact {
    /// Force on `b`: normal and friction \[N\].
    #[must_use]
    pub fn force_on_b_in_world(&self) -> Vector3<f64> {
        self.normal_in_world * self.normal_force + self.friction_in_world
    }

    /// The same, seen from the other body.
    #[must_use]
    pub fn swapped(self) -> Self {
        Self {
            a: self.b,
            b: self.a,
            normal_in_world: -self.normal_in_world,
            friction_in_world: -self.friction_in_world,
            a_is_fixed: self.b_is_fixed,
            b_is_fixed: self.a_is_fixed,
            ..self
        }
    }

    /// Orders contacts, whoever is first in them.
    #[must_use]
    pub fn key(&self) -> (Entity, u64, Entity, u64) {
        (self.a.0, primitive_code(self.a.1), self.b.0, primitive_code(self.b.1))
    }
}

/// A number for a part of a body or of an instrument.
#[must_use]
pub fn primitive_code(primitive: Primitive) -> u64 {
    match primitive {
        Primitive::Shape(index) => u64::from(index),
        Primitive::Jaw(jaw) => (1 << 32) | u64::from(jaw),
        Primitive::Shaft => 2 << 32,
        // Rigid bodies have none of these.
        Primitive::Triangle(_) | Primitive::Tetrahedron(_) | Primitive::Segment(_) | Primitive::Vertex(_) => {
            0
        }
    }
}
