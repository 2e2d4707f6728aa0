//! Contacts between parts of bodies, with depth and force, as rigid-body worlds report them.

use nalgebra::{Point3, Vector3};
use trocar_scene::{Entity, Primitive};

/// A contact between two parts: mean position of its points, sum of their forces and maximum depth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// First entity and its part.
    pub a: (Entity, Primitive),
    /// Second entity and its part.
    pub b: (Entity, Primitive),
    /// Position \[m\].
    pub point_in_world: Point3<f64>,
    /// Unit direction from `a` to `b`.
    pub normal_in_world: Vector3<f64>,
    /// Penetration depth \[m\]; negative while separated.
    pub depth: f64,
    /// Normal force on `b` \[N\].
    pub normal_force: f64,
    /// Friction on `b`, in world \[N\].
    pub friction_in_world: Vector3<f64>,
    /// Coulomb friction coefficient in effect.
    pub friction_coefficient: f64,
    /// Whether `a` is immovable.
    pub a_is_fixed: bool,
    /// Whether `b` is immovable.
    pub b_is_fixed: bool,
}

impl Contact {
    /// Force on `b`: normal and friction \[N\].
    #[must_use]
    pub fn force_on_b_in_world(&self) -> Vector3<f64> {
        self.normal_in_world * self.normal_force + self.friction_in_world
    }

    /// The same contact with the bodies swapped.
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

    /// Orders contacts independently of which body is first.
    #[must_use]
    pub fn key(&self) -> (Entity, u64, Entity, u64) {
        (self.a.0, primitive_code(self.a.1), self.b.0, primitive_code(self.b.1))
    }
}

/// A sort key for a part of a body or of an instrument.
#[must_use]
pub fn primitive_code(primitive: Primitive) -> u64 {
    match primitive {
        Primitive::Shape(index) => u64::from(index),
        Primitive::Jaw(jaw) => (1 << 32) | u64::from(jaw),
        Primitive::Shaft => 2 << 32,
        // Rigid bodies have no such primitives.
        Primitive::Triangle(_) | Primitive::Tetrahedron(_) | Primitive::Segment(_) | Primitive::Vertex(_) => {
            0
        }
    }
}
