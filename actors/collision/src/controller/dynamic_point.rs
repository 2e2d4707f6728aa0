//! Controller of the dynamic point: shafts of instruments against surfaces.

use nalgebra::Point3;
use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, Instrument, Primitive};
use trocar_scene::{Access, BuildContext, Commands, Controller, ControllerError, Entity, Snapshot, Tick};

use super::bodies::{self, Body, Change, RequiredGeometry};
use super::report::{self, FoundContact, Report};
use crate::dynamic_point::{DynamicPoint, LineConfig, LineContact};
use crate::moving_surface::MovingSurface;

/// Configuration: instruments and bodies.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DynamicPointConfig {
    /// Names of instruments.
    pub instruments: Vec<String>,
    /// Names of bodies.
    pub bodies: Vec<String>,
    /// Number of segments of a shaft, and so of its possible contacts with a body.
    #[serde(default = "segments")]
    pub segments: usize,
    /// Distance from which on contacts are reported \[m\].
    #[serde(default)]
    pub margin: f64,
    /// Total stiffness of a shaft against a body, shared by its contacts \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
}

fn segments() -> usize {
    4
}

/// A body, with a detector for each shaft.
struct TrackedBody {
    body: Body,
    moving: MovingSurface,
    watches: Vec<DynamicPoint>,
}

/// Finds contacts of shafts with surfaces.
pub struct DynamicPointController {
    instruments: Vec<Entity>,
    bodies: Vec<TrackedBody>,
    report: Report,
}

impl DynamicPointController {
    /// Finds instruments and bodies.
    ///
    /// # Errors
    /// One does not exist or is invalid; or the number of segments or the margin is out of range.
    pub fn new(config: &DynamicPointConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let scene = context.scene;
        let instruments = bodies::instruments(context, &config.instruments)?;
        let mut lines = Vec::with_capacity(instruments.len());
        for (name, entity) in config.instruments.iter().zip(&instruments) {
            let radius = scene.get::<Instrument>(*entity).map_or(0.0, |instrument| instrument.shaft_radius);
            let line = LineConfig { segments: config.segments, radius, margin: config.margin };
            let watch = DynamicPoint::new(line);
            lines.push(watch.map_err(|error| ControllerError::Scene(format!("'{name}': {error}")))?);
        }
        let bodies = config.bodies.iter().map(|name| {
            let body = Body::named(context, name, RequiredGeometry::Surface)?;
            let moving = MovingSurface::new(&body.surface());
            Ok(TrackedBody { body, moving, watches: lines.clone() })
        });
        let bodies = bodies.collect::<Result<_, ControllerError>>()?;
        Ok(Self { instruments, bodies, report: Report::new(Detection::DynamicPoint, config.stiffness) })
    }
}

impl Controller for DynamicPointController {
    fn access(&self) -> Access {
        bodies::access().reads::<Instrument>()
    }

    fn tick(&mut self, tick: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.report.begin();
        for watched in &mut self.bodies {
            let refused = |error: &dyn std::fmt::Display| ControllerError::Scene(error.to_string());
            if watched.body.follow(scene, out) != Change::None {
                let update = watched.moving.update(&watched.body.surface(), tick.period.as_secs_f64());
                update.map_err(|error| refused(&error))?;
            }
            for (entity, watch) in self.instruments.iter().zip(&mut watched.watches) {
                let Some(instrument) = scene.get::<Instrument>(*entity) else { continue };
                let body_from_tip = watched.body.pose.inv_mul(&scene.world_pose(*entity));
                // The shaft comes from behind the tip.
                let shaft = [Point3::origin(), Point3::new(0.0, 0.0, -instrument.shaft_length)];
                let line = shaft.map(|end| body_from_tip * end);
                let contacts = watch.update(&watched.moving, &line).map_err(|error| refused(&error))?;
                for contact in contacts.iter().flatten() {
                    self.report.add(found(*entity, &watched.body, contact));
                }
                self.report.end_pair();
            }
        }
        self.report.send(scene.time(), out);
        Ok(())
    }
}

fn found(shaft: Entity, body: &Body, contact: &LineContact) -> FoundContact {
    FoundContact {
        parts: [(shaft, Primitive::Shaft), (body.entity, Primitive::Triangle(contact.triangle))],
        on_second_in_world: body.pose * contact.on_surface,
        normal_in_world: body.pose * -contact.direction,
        depth: contact.depth,
    }
}
