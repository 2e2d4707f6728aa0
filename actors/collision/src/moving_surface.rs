//! A deforming surface with the data for methods with temporal coherence: a refitted tree, adjacency, and a bound of
//! its motion since a method's last query.

use nalgebra::{Point3, Vector3};
use thiserror::Error;

use crate::Surface;
use crate::aabb_tree::AabbTree;
use crate::topology::Topology;

/// Result of a surface update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SurfaceChange {
    /// The same triangles; the largest vertex displacement \[m\].
    Moved(f64),
    /// Other triangles or another number of vertices: everything was rebuilt.
    Remeshed,
}

/// Why an update was refused; the surface stays as it was.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
pub enum UpdateError {
    /// The interval is negative or not finite.
    #[error("{0} s have passed between two updates: 0 or more are valid, and finite")]
    Time(f64),
}

/// A copy of a surface in its own frame, its tree and its neighbours, updated together.
#[derive(Clone, Debug)]
pub struct MovingSurface {
    vertices: Vec<Point3<f64>>,
    before: Vec<Point3<f64>>,
    triangles: Vec<[u32; 3]>,
    tree: AabbTree,
    topology: Topology,
    /// Sum over all updates of the largest vertex displacement \[m\].
    motion: f64,
    last_motion: f64,
    interval_secs: f64,
    updates: u64,
    topology_revision: u64,
}

impl MovingSurface {
    /// Copies a surface and builds its tree and adjacency.
    #[must_use]
    pub fn new(surface: &Surface) -> Self {
        Self {
            vertices: surface.vertices().to_vec(),
            before: surface.vertices().to_vec(),
            triangles: surface.triangles().to_vec(),
            tree: AabbTree::new(surface),
            topology: Topology::new(surface),
            motion: 0.0,
            last_motion: 0.0,
            interval_secs: 0.0,
            updates: 0,
            topology_revision: 0,
        }
    }

    /// Updates the surface, `interval_secs` after the previous update (0 if unknown). The tree is refitted, without
    /// allocating; if the triangles have changed (a cut, another mesh), everything is rebuilt.
    ///
    /// # Errors
    /// [`UpdateError::Time`].
    pub fn update(&mut self, surface: &Surface, interval_secs: f64) -> Result<SurfaceChange, UpdateError> {
        if !(interval_secs >= 0.0 && interval_secs.is_finite()) {
            return Err(UpdateError::Time(interval_secs));
        }
        let change = self.follow(surface);
        self.interval_secs = interval_secs;
        Ok(change)
    }

    /// As [`update`](Self::update) with an unknown interval: velocities are 0.
    pub fn follow(&mut self, surface: &Surface) -> SurfaceChange {
        self.interval_secs = 0.0;
        self.updates += 1;
        let same = self.vertices.len() == surface.vertices().len() && self.triangles == surface.triangles();
        if same {
            std::mem::swap(&mut self.vertices, &mut self.before);
            self.vertices.copy_from_slice(surface.vertices());
            let mut furthest_squared = 0.0_f64;
            for (now, before) in self.vertices.iter().zip(&self.before) {
                furthest_squared = furthest_squared.max((now - before).norm_squared());
            }
            if self.tree.refit(&Surface::trusted(&self.vertices, &self.triangles)).is_ok() {
                self.last_motion = furthest_squared.sqrt();
                self.motion += self.last_motion;
                return SurfaceChange::Moved(self.last_motion);
            }
        }
        self.vertices.clear();
        self.vertices.extend_from_slice(surface.vertices());
        self.before.clone_from(&self.vertices);
        self.triangles.clear();
        self.triangles.extend_from_slice(surface.triangles());
        self.tree = AabbTree::new(surface);
        self.topology = Topology::new(surface);
        self.last_motion = 0.0;
        self.topology_revision += 1;
        SurfaceChange::Remeshed
    }

    /// The surface as of the last update.
    #[must_use]
    pub fn surface(&self) -> Surface<'_> {
        Surface::trusted(&self.vertices, &self.triangles)
    }

    /// Its vertices before the last update; the same as now after a change of triangles \[m\].
    #[must_use]
    pub fn vertices_before(&self) -> &[Point3<f64>] {
        &self.before
    }

    /// Its tree.
    #[must_use]
    pub fn tree(&self) -> &AabbTree {
        &self.tree
    }

    /// Its neighbours.
    #[must_use]
    pub fn topology(&self) -> &Topology {
        &self.topology
    }

    /// Upper bound of the path length of any of its points since it was created \[m\]: the difference of two readings
    /// bounds the motion in between, as long as the [topology revision](Self::topology_revision) is the same.
    #[must_use]
    pub fn motion(&self) -> f64 {
        self.motion
    }

    /// Largest vertex displacement of the last update \[m\].
    #[must_use]
    pub fn last_motion(&self) -> f64 {
        self.last_motion
    }

    /// Number of updates.
    #[must_use]
    pub fn updates(&self) -> u64 {
        self.updates
    }

    /// Number of replacements of its triangles.
    #[must_use]
    pub fn topology_revision(&self) -> u64 {
        self.topology_revision
    }

    /// Velocity over the last update of the point of a triangle with these weights \[m/s\]; 0 if the interval is
    /// unknown.
    ///
    /// # Panics
    /// When the triangle does not exist.
    #[must_use]
    pub fn velocity(&self, triangle: u32, weights: &[f64; 3]) -> Vector3<f64> {
        if self.interval_secs > 0.0 {
            self.displacement(triangle, weights) / self.interval_secs
        } else {
            Vector3::zeros()
        }
    }

    /// Displacement in the last update of the point of a triangle with these weights \[m\].
    pub(crate) fn displacement(&self, triangle: u32, weights: &[f64; 3]) -> Vector3<f64> {
        let corners = self.triangles[triangle as usize].map(|vertex| vertex as usize);
        corners.iter().zip(weights).fold(Vector3::zeros(), |sum, (&vertex, &weight)| {
            sum + (self.vertices[vertex] - self.before[vertex]) * weight
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_adds_up_and_other_triangles_are_another_surface() {
        let mut vertices = vec![Point3::origin(), Point3::new(1.0, 0.0, 0.0), Point3::new(0.0, 1.0, 0.0)];
        let triangles = [[0, 1, 2]];
        let mut moving = MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"));
        vertices[2].y += 0.25;
        let now = Surface::new(&vertices, &triangles).expect("a surface");
        assert_eq!(moving.update(&now, 0.5), Ok(SurfaceChange::Moved(0.25)));
        assert_eq!(moving.velocity(0, &[0.0, 0.0, 1.0]), Vector3::new(0.0, 0.5, 0.0));
        vertices[2].y -= 0.25;
        let now = Surface::new(&vertices, &triangles).expect("a surface");
        assert_eq!(moving.update(&now, 0.0), Ok(SurfaceChange::Moved(0.25)));
        assert_eq!((moving.motion(), moving.velocity(0, &[0.0, 0.0, 1.0])), (0.5, Vector3::zeros()));
        let turned = [[0, 2, 1]];
        let other = Surface::new(&vertices, &turned).expect("a surface");
        assert_eq!(moving.update(&other, 0.1), Ok(SurfaceChange::Remeshed));
        assert_eq!((moving.topology_revision(), moving.updates()), (1, 3));
        assert_eq!(moving.update(&other, f64::NAN).map_err(|error| error.to_string().len() > 10), Err(true));
        assert_eq!(moving.update(&other, 0.1), Ok(SurfaceChange::Moved(0.0)));
    }
}
