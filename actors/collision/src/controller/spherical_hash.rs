//! Controller of the local spherical hash: a deforming body against deforming bodies, bands and threads.

use nalgebra::{Isometry3, Point3};
use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, LineMesh};
use trocar_scene::{Access, BuildContext, Commands, Controller, ControllerError, Snapshot, Tick};

use super::bodies::{self, Body, Change, RequiredGeometry};
use super::report::{self, FoundContact, Report, primitive};
use crate::spherical_hash::{SphericalContact, SphericalHash};
use crate::{Line, Part, Surface};

/// Configuration: the hashed body and its possible contact partners.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SphericalHashConfig {
    /// Name of the hashed body.
    pub body: String,
    /// Names of the bodies, bands and threads that may touch it.
    pub others: Vec<String>,
    /// Total stiffness of two bodies, shared by their contacts \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
}

/// A possible contact partner: another body, a band or a thread.
struct Partner {
    body: Body,
    hash: SphericalHash,
}

/// Finds contacts of other bodies with the hashed body.
pub struct SphericalHashController {
    body: Body,
    hash: SphericalHash,
    hashed: bool,
    others: Vec<Partner>,
    /// Vertices of the current partner, in the body's frame.
    moved: Vec<Point3<f64>>,
    contacts: Vec<SphericalContact>,
    report: Report,
}

impl SphericalHashController {
    /// Finds the bodies.
    ///
    /// # Errors
    /// One does not exist or is invalid.
    pub fn new(config: &SphericalHashConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let other = |name: &String| {
            let body = Body::named(context, name, RequiredGeometry::SurfaceOrLine)?;
            Ok(Partner { body, hash: SphericalHash::new() })
        };
        Ok(Self {
            body: Body::named(context, &config.body, RequiredGeometry::Surface)?,
            hash: SphericalHash::new(),
            hashed: false,
            others: config.others.iter().map(other).collect::<Result<_, ControllerError>>()?,
            moved: Vec::new(),
            contacts: Vec::new(),
            report: Report::new(Detection::SphericalHash, config.stiffness),
        })
    }
}

/// Transforms vertices to the frame of the hashed body.
fn take(vertices: &[Point3<f64>], body_from_other: &Isometry3<f64>, moved: &mut Vec<Point3<f64>>) {
    moved.clear();
    moved.extend(vertices.iter().map(|vertex| body_from_other * vertex));
}

impl Controller for SphericalHashController {
    fn access(&self) -> Access {
        bodies::access().reads::<LineMesh>()
    }

    fn tick(&mut self, _: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        if self.body.follow(scene, out) != Change::None || !self.hashed {
            self.hash.rebuild(&self.body.surface());
            self.hashed = true;
        }
        self.report.begin();
        let Self { body, hash, others, moved, contacts, report, .. } = self;
        for other in others {
            contacts.clear();
            other.body.follow(scene, out);
            let entity = other.body.entity;
            take(other.body.vertices(), &body.pose.inv_mul(&other.body.pose), moved);
            match other.body.segments() {
                Some((segments, radius)) => {
                    let refused = |error: &dyn std::fmt::Display| ControllerError::Failed(error.to_string());
                    let line = Line::new(moved, segments, radius).map_err(|error| refused(&error))?;
                    hash.line(&line, contacts);
                    let inside = hash.spheres(line.vertices(), line.radius(), contacts);
                    inside.map_err(|error| refused(&error))?;
                }
                None => {
                    let surface = Surface::new(moved, other.body.surface().triangles());
                    other.hash.rebuild(&surface.unwrap_or_else(|_| Surface::trusted(&[], &[])));
                    hash.bodies(&mut other.hash, 0.0, contacts);
                    keep_corners(contacts);
                }
            }
            for contact in contacts.iter() {
                report.add(FoundContact {
                    parts: [(body.entity, primitive(contact.a)), (entity, primitive(contact.b))],
                    on_second_in_world: body.pose * contact.points[1],
                    normal_in_world: body.pose * contact.direction,
                    depth: contact.depth,
                });
            }
            report.end_pair();
        }
        report.send(scene.time(), out);
        Ok(())
    }
}

/// Corners inside define the depth; crossing triangles are used only without such corners.
fn keep_corners(contacts: &mut Vec<SphericalContact>) {
    let is_corner = |contact: &SphericalContact| {
        matches!(contact.a, Part::Vertex(_)) || matches!(contact.b, Part::Vertex(_))
    };
    if contacts.iter().any(is_corner) {
        contacts.retain(is_corner);
    }
}
