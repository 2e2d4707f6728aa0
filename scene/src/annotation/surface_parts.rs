//! Whether the surface of a body still has a place: after a cut, or a burn, some of its triangles are others.

use std::borrow::Cow;

use crate::components::{LineMesh, SurfaceMesh, SurfacePlace, SurfacePoint, TetMesh};
use crate::entity::Entity;
use crate::mesh::TetData;
use crate::snapshot::Snapshot;
use crate::time::Revision;

/// The triangles of a body, as it is drawn: those of its surface, or else the boundary of its volume.
pub(super) fn triangles(scene: &Snapshot, entity: Entity) -> Option<Cow<'_, [[u32; 3]]>> {
    if let Some(surface) = scene.get::<SurfaceMesh>(entity) {
        return Some(Cow::Borrowed(&surface.triangles));
    }
    let volume = scene.get::<TetMesh>(entity)?;
    let data = TetData { positions: Vec::new(), tets: volume.tets.to_vec(), tags: Vec::new() };
    Some(Cow::Owned(data.boundary_triangles()))
}

/// The triangles and segments of one body, to look places up in. Reading it takes a sort of all triangles, so it is kept
/// until [`SurfaceParts::is_of`] tells that the body has others.
#[derive(Clone, Debug)]
pub struct SurfaceParts {
    entity: Entity,
    read_at: [Option<Revision>; 3],
    /// Corners of each triangle in ascending order; the list sorted.
    triangles: Vec<[u32; 3]>,
    /// Ends of each segment in ascending order; the list sorted.
    segments: Vec<[u32; 2]>,
}

impl SurfaceParts {
    /// Reads the parts of a body; none if it has no mesh, or is not there.
    pub fn read(scene: &Snapshot, entity: Entity) -> Self {
        let mut triangles = triangles(scene, entity).unwrap_or_default().into_owned();
        triangles.iter_mut().for_each(|corners| corners.sort_unstable());
        triangles.sort_unstable();
        let mut segments = scene.get::<LineMesh>(entity).map_or_else(Vec::new, |line| line.segments.to_vec());
        segments.iter_mut().for_each(|ends| ends.sort_unstable());
        segments.sort_unstable();
        Self { entity, read_at: changes(scene, entity), triangles, segments }
    }

    /// Whether these are still the parts of the body.
    pub fn is_of(&self, scene: &Snapshot) -> bool {
        self.read_at == changes(scene, self.entity)
    }

    /// Whether the body has the place: its triangle, or its segment. Of a body without a mesh every place is there.
    pub fn has(&self, place: &SurfacePlace) -> bool {
        if place.entity != self.entity {
            return false;
        }
        match place.on {
            SurfacePoint::Triangle { mut corners, .. } => {
                corners.sort_unstable();
                self.triangles.binary_search(&corners).is_ok()
            }
            SurfacePoint::Segment { mut ends, .. } => {
                ends.sort_unstable();
                self.segments.binary_search(&ends).is_ok()
            }
            SurfacePoint::Body { .. } => true,
        }
    }
}

/// When the parts of a body last changed.
fn changes(scene: &Snapshot, entity: Entity) -> [Option<Revision>; 3] {
    let volume = match scene.changed::<SurfaceMesh>(entity) {
        // The surface is what counts.
        Some(_) => None,
        None => scene.changed::<TetMesh>(entity),
    };
    [scene.changed::<SurfaceMesh>(entity), volume, scene.changed::<LineMesh>(entity)]
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::{Commands, EntityAllocator, Registry, SimTime, Store};

    fn place(entity: Entity, corners: [u32; 3]) -> SurfacePlace {
        let barycentric = [0.5, 0.25, 0.25];
        SurfacePlace { entity, on: SurfacePoint::Triangle { corners, barycentric } }
    }

    #[test]
    fn a_triangle_is_known_by_its_vertices_whatever_its_number_and_the_side_that_is_seen() {
        let registry = Registry::standard();
        let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let mut store = Store::new(registry);
        let body = out.spawn();
        out.put(body, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [2, 1, 3]]) });
        store.apply(&mut out, SimTime::ZERO);
        out.clear();
        let parts = SurfaceParts::read(store.view(), body);
        assert!(parts.has(&place(body, [1, 2, 0])) && parts.has(&place(body, [0, 2, 1])));
        assert!(parts.has(&place(body, [1, 2, 3])) && !parts.has(&place(body, [0, 1, 3])));
        assert!(!parts.has(&place(Entity::new(1, 1, 1), [0, 1, 2])));
        assert!(parts.is_of(store.view()));
        // The first one burns, and the second gets its number.
        out.put(body, SurfaceMesh { triangles: Arc::new(vec![[3, 2, 1]]) });
        store.apply(&mut out, SimTime::ZERO);
        assert!(!parts.is_of(store.view()));
        let parts = SurfaceParts::read(store.view(), body);
        assert!(!parts.has(&place(body, [0, 1, 2])) && parts.has(&place(body, [1, 2, 3])));
    }

    #[test]
    fn volumes_without_a_surface_have_their_boundary_and_threads_their_segments() {
        let registry = Registry::standard();
        let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let mut store = Store::new(registry);
        let [volume, thread] = [out.spawn(), out.spawn()];
        out.put(volume, TetMesh { tets: Arc::new(vec![[0, 1, 2, 3], [1, 2, 3, 4]]) });
        out.put(thread, LineMesh { segments: Arc::new(vec![[0, 1], [2, 1]]), radius: 0.001 });
        store.apply(&mut out, SimTime::ZERO);
        let parts = SurfaceParts::read(store.view(), volume);
        assert!(parts.has(&place(volume, [0, 1, 2])) && parts.has(&place(volume, [4, 3, 1])));
        assert!(!parts.has(&place(volume, [1, 2, 3])), "it is inside");
        let parts = SurfaceParts::read(store.view(), thread);
        let on = |ends| SurfacePlace { entity: thread, on: SurfacePoint::Segment { ends, along: 0.5 } };
        assert!(parts.has(&on([1, 0])) && parts.has(&on([1, 2])) && !parts.has(&on([0, 2])));
    }
}
