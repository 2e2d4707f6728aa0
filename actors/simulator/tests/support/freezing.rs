//! Two identical bodies, of which one is to fail.
#![allow(dead_code)] // every test uses another part

use nalgebra::{Point3, Vector3};
use trocar_scene::{BuildContext, Controller, ControllerError, VertexPositions};

use super::stage::Stage;

pub const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// How a controller is built.
pub type Build<C> = fn(&BuildContext<'_>) -> Result<C, ControllerError>;

/// Two identical bodies of a mesh and a kind.
pub fn two(mesh: &str, kind: &str) -> String {
    ["good", "bad"]
        .map(|name| format!("[[entity]]\nname = \"{name}\"\nmesh = {{ {mesh} }}\n{kind}\n"))
        .concat()
}

pub fn positions<C: Controller>(stage: &Stage<C>, name: &str) -> Vec<Point3<f64>> {
    stage.get::<VertexPositions>(name).positions.to_vec()
}
