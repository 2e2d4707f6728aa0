//! Controller of the Z-buffer method: shafts of instruments against surfaces, including the volume swept between two
//! ticks.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::components::{Detection, Instrument, Primitive};
use trocar_scene::{Access, BuildContext, Commands, Controller, ControllerError, Entity, Snapshot, Tick};

use super::bodies::{self, Body, RequiredGeometry};
use super::report::{self, FoundContact, Report};
use crate::continuous::Sweep;
use crate::primitive::closest_on_segment;
use crate::pseudonormal::face;
use crate::z_buffer::{ShaftSweep, VolumeHit, ZBuffer};

/// Configuration: instruments, bodies and resolution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ZBufferConfig {
    /// Names of instruments.
    pub instruments: Vec<String>,
    /// Names of bodies.
    pub bodies: Vec<String>,
    /// Side of a pixel \[m\]; also the tolerance of reported contacts.
    #[serde(default = "pixel")]
    pub pixel: f64,
    /// Most pixels of an image; if more are needed, pixels become larger.
    #[serde(default = "pixels_max")]
    pub pixels_max: usize,
    /// Total stiffness of a shaft against a body, shared by its contacts \[N/m\].
    #[serde(default = "report::stiffness")]
    pub stiffness: f64,
}

fn pixel() -> f64 {
    5e-4
}

fn pixels_max() -> usize {
    65_536
}

/// A body, with the last port and tip of each shaft in its frame.
struct TrackedBody {
    body: Body,
    before: Vec<Option<[Point3<f64>; 2]>>,
}

/// Finds triangles that shafts touch or have passed through.
pub struct ZBufferController {
    instruments: Vec<Entity>,
    bodies: Vec<TrackedBody>,
    image: ZBuffer,
    hits: Vec<VolumeHit>,
    report: Report,
}

impl ZBufferController {
    /// Finds instruments and bodies.
    ///
    /// # Errors
    /// One does not exist or is invalid; or the pixel parameters are invalid.
    pub fn new(config: &ZBufferConfig, context: &BuildContext<'_>) -> Result<Self, ControllerError> {
        let instruments = bodies::instruments(context, &config.instruments)?;
        let watched = |name: &String| {
            let body = Body::named(context, name, RequiredGeometry::Surface)?;
            Ok(TrackedBody { body, before: vec![None; instruments.len()] })
        };
        let image = ZBuffer::new(config.pixel, config.pixels_max);
        Ok(Self {
            bodies: config.bodies.iter().map(watched).collect::<Result<_, ControllerError>>()?,
            instruments,
            image: image.map_err(|error| ControllerError::Scene(error.to_string()))?,
            hits: Vec::new(),
            report: Report::new(Detection::ZBuffer, config.stiffness),
        })
    }
}

/// Port and tip of an instrument in world; without a port the end of its shaft.
fn shaft(scene: &Snapshot, entity: Entity, instrument: &Instrument) -> [Point3<f64>; 2] {
    let tip = scene.world_pose(entity);
    let port = match instrument.port {
        Some(port) => scene.world_pose(port).translation.vector.into(),
        None => tip * Point3::new(0.0, 0.0, -instrument.shaft_length),
    };
    [port, tip.translation.vector.into()]
}

impl Controller for ZBufferController {
    fn access(&self) -> Access {
        bodies::access().reads::<Instrument>()
    }

    fn tick(&mut self, _: &Tick<'_>, scene: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        self.report.begin();
        for watched in &mut self.bodies {
            watched.body.follow(scene, out);
            let surface = watched.body.surface();
            for (entity, before) in self.instruments.iter().zip(&mut watched.before) {
                let Some(instrument) = scene.get::<Instrument>(*entity) else { continue };
                let now = shaft(scene, *entity, instrument)
                    .map(|end| watched.body.pose.inverse_transform_point(&end));
                let was = before.replace(now).unwrap_or(now);
                let sweep = |end: usize| Sweep { from: was[end], to: now[end] };
                let swept = ShaftSweep::new(sweep(0), sweep(1), instrument.shaft_radius)
                    .map_err(|error| ControllerError::Scene(error.to_string()))?;
                self.image.draw_shaft(&swept);
                self.hits.clear();
                self.image.hits(&surface, &mut self.hits);
                for hit in &self.hits {
                    let (normal, depth) = way_out(&hit.point, &was, &now, instrument.shaft_radius);
                    // The wall that it entered through is pressed inwards; the far wall is not pushed outwards.
                    if normal.dot(&face(&surface, hit.triangle)) > 0.0 {
                        continue;
                    }
                    self.report.add(FoundContact {
                        parts: [
                            (*entity, Primitive::Shaft),
                            (watched.body.entity, Primitive::Triangle(hit.triangle)),
                        ],
                        on_second_in_world: watched.body.pose * hit.point,
                        normal_in_world: watched.body.pose * normal,
                        depth,
                    });
                }
                self.report.end_pair();
            }
        }
        self.report.send(scene.time(), out);
        Ok(())
    }
}

/// Exit of a point hit by a shaft, as unit direction and distance \[m\]: away from the axis if the shaft is still
/// there; ahead of the shaft if it has swept over the point.
fn way_out(
    point: &Point3<f64>,
    was: &[Point3<f64>; 2],
    now: &[Point3<f64>; 2],
    radius: f64,
) -> (Vector3<f64>, f64) {
    let along = closest_on_segment(point, now);
    let place = |shaft: &[Point3<f64>; 2]| shaft[0] + (shaft[1] - shaft[0]) * along;
    let axis = place(now);
    let from_axis = point - axis;
    let distance = from_axis.norm();
    let motion = (axis - place(was)).try_normalize(1e-9);
    match motion.filter(|_| distance > radius) {
        Some(motion) => (motion, (radius - from_axis.dot(&motion)).max(0.0)),
        None => {
            let aside = from_axis.try_normalize(1e-12).or(motion).unwrap_or_else(|| {
                let shaft = now[1] - now[0];
                shaft.cross(&Vector3::ith(shaft.iamin(), 1.0)).try_normalize(0.0).unwrap_or_else(Vector3::z)
            });
            (aside, radius - distance)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_shaft_is_in_goes_aside_and_what_it_has_gone_over_goes_before_it() {
        let shaft = |x: f64| [Point3::new(x, 0.0, 0.0), Point3::new(x, 0.0, 0.1)];
        let point = Point3::new(0.001, 0.0, 0.05);
        let (aside, depth) = way_out(&point, &shaft(0.0), &shaft(0.0), 0.003);
        assert_eq!(aside, Vector3::x());
        assert!((depth - 0.002).abs() < 1e-15);
        // From 20 mm on one side to 20 mm on the other within a tick.
        let (before, depth) = way_out(&point, &shaft(-0.02), &shaft(0.02), 0.003);
        assert_eq!(before, Vector3::x());
        assert!((depth - 0.022).abs() < 1e-12, "{depth}");
        // On the axis and at rest: any perpendicular direction.
        let (across, depth) = way_out(&Point3::new(0.0, 0.0, 0.05), &shaft(0.0), &shaft(0.0), 0.003);
        assert!((across.norm() - 1.0).abs() < 1e-12 && across.z.abs() < 1e-12 && depth == 0.003);
    }
}
