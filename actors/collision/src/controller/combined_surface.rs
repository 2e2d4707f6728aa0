//! Combined surface: several bodies as one surface for a proxy.

use nalgebra::{Isometry3, Point3};
use trocar_scene::{BuildContext, Commands, ControllerError, Entity, Snapshot};

use super::bodies::{Body, Change, RequiredGeometry};
use crate::Surface;
use crate::moving_surface::MovingSurface;

/// Bodies in the frame of the first one, so that common rigid motion causes no change.
pub struct CombinedSurface {
    bodies: Vec<Body>,
    /// Pose of each in that frame.
    places: Vec<Isometry3<f64>>,
    /// Number of triangles of each.
    sizes: Vec<usize>,
    world_from_surface: Isometry3<f64>,
    vertices: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    moving: MovingSurface,
}

impl CombinedSurface {
    /// The bodies of these names.
    ///
    /// # Errors
    /// A body does not exist or is invalid.
    pub fn named(context: &BuildContext<'_>, names: &[String]) -> Result<Self, ControllerError> {
        let bodies = names.iter().map(|name| Body::named(context, name, RequiredGeometry::Surface));
        let bodies: Vec<Body> = bodies.collect::<Result<_, _>>()?;
        let Some(first) = bodies.first() else {
            return Err(ControllerError::Scene("surfaces: none is named; one at least is needed".to_owned()));
        };
        let mut felt = Self {
            world_from_surface: first.pose,
            places: vec![Isometry3::identity(); bodies.len()],
            sizes: vec![0; bodies.len()],
            bodies,
            vertices: Vec::new(),
            triangles: Vec::new(),
            moving: MovingSurface::new(&Surface::trusted(&[], &[])),
        };
        felt.take_places();
        felt.join();
        felt.moving = MovingSurface::new(&felt.surface());
        Ok(felt)
    }

    /// Reads all of them again, `period_secs` after the last time.
    ///
    /// # Errors
    /// The period is invalid.
    pub fn follow(
        &mut self,
        scene: &Snapshot,
        out: &mut Commands,
        period_secs: f64,
    ) -> Result<(), ControllerError> {
        let mut changed = false;
        for (body, triangles) in self.bodies.iter_mut().zip(&self.sizes) {
            changed |= match body.follow(scene, out) {
                Change::None => false,
                Change::Deformed | Change::Remeshed => true,
                // An empty surface has no motion.
                Change::Absent => *triangles > 0,
            };
        }
        if self.take_places() || changed {
            self.join();
            let surface = Surface::new(&self.vertices, &self.triangles);
            let surface = surface.unwrap_or_else(|_| Surface::trusted(&[], &[]));
            let update = self.moving.update(&surface, period_secs);
            update.map_err(|error| ControllerError::Failed(error.to_string()))?;
        }
        Ok(())
    }

    /// Updates the poses; returns whether one of them has moved relative to the first.
    fn take_places(&mut self) -> bool {
        // While the first is absent, its last frame is kept.
        self.world_from_surface = self.bodies[0].pose;
        let surface_from_world = self.world_from_surface.inverse();
        let mut changed = false;
        for (place, body) in self.places.iter_mut().zip(&self.bodies).skip(1) {
            let now = surface_from_world * body.pose;
            changed |= std::mem::replace(place, now) != now;
        }
        changed
    }

    fn join(&mut self) {
        self.vertices.clear();
        self.triangles.clear();
        for ((body, place), size) in self.bodies.iter().zip(&self.places).zip(&mut self.sizes) {
            let (first, surface) = (self.vertices.len() as u32, body.surface());
            self.vertices.extend(surface.vertices().iter().map(|vertex| place * vertex));
            let moved = |corners: &[u32; 3]| corners.map(|corner| first + corner);
            self.triangles.extend(surface.triangles().iter().map(moved));
            *size = surface.triangles().len();
        }
    }

    fn surface(&self) -> Surface<'_> {
        Surface::trusted(&self.vertices, &self.triangles)
    }

    /// The combined surface, in the frame of the first.
    pub fn moving(&self) -> &MovingSurface {
        &self.moving
    }

    /// `world_from_surface`.
    pub fn pose(&self) -> &Isometry3<f64> {
        &self.world_from_surface
    }

    /// The body of a triangle, and its index in that body.
    pub fn owner(&self, triangle: u32) -> (Entity, u32) {
        let mut number = triangle as usize;
        for (body, triangles) in self.bodies.iter().zip(&self.sizes) {
            match number.checked_sub(*triangles) {
                Some(rest) => number = rest,
                None => return (body.entity, number as u32),
            }
        }
        (self.bodies[0].entity, triangle)
    }
}
