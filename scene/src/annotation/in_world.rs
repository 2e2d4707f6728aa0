//! Where a place on a surface is in the world.

use nalgebra::{Isometry3, Point3, UnitVector3, Vector3};

use crate::components::{LineMesh, SurfacePlace, SurfacePoint, VertexPositions};
use crate::entity::Entity;
use crate::snapshot::Snapshot;

/// A place in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlaceInWorld {
    /// Where it is \[m\].
    pub point: Point3<f64>,
    /// Outwards from the surface, of unit length.
    pub normal: Vector3<f64>,
}

/// Finds places of one scene in the world. What the places of one body share is looked up once.
pub struct PlaceReader<'a> {
    scene: &'a Snapshot,
    body: Option<Body<'a>>,
}

/// What places of a body need.
struct Body<'a> {
    entity: Entity,
    world_from_body: Isometry3<f64>,
    vertices: &'a [Point3<f64>],
    /// Radius of its segments \[m\].
    radius: f64,
}

impl<'a> PlaceReader<'a> {
    /// Of this scene.
    pub fn new(scene: &'a Snapshot) -> Self {
        Self { scene, body: None }
    }

    /// Where a place is now; `None` if the scene has no such body, or the body no such vertices.
    ///
    /// A place on a triangle follows its vertices. That the vertices still form a triangle is not asked here: see
    /// [`SurfaceParts`](super::SurfaceParts). A place on a thread lies on the upper side of it, whichever way the thread
    /// turns.
    pub fn find(&mut self, place: &SurfacePlace) -> Option<PlaceInWorld> {
        let body = self.body(place.entity)?;
        let vertex = |index: u32| body.vertices.get(index as usize).copied();
        let (point, normal) = match place.on {
            SurfacePoint::Triangle { corners: [a, b, c], barycentric } => {
                let (a, b, c) = (vertex(a)?, vertex(b)?, vertex(c)?);
                let [u, v, w] = barycentric.map(f64::from);
                // The weights are rounded: without their sum the point would be off by a share of its coordinates.
                let point = (a.coords * u + b.coords * v + c.coords * w) / (u + v + w);
                (Point3::from(point), (b - a).cross(&(c - a)))
            }
            SurfacePoint::Segment { ends: [from, to], along } => {
                let (from, to) = (vertex(from)?, vertex(to)?);
                let up = body.world_from_body.inverse_transform_vector(&Vector3::z());
                let outwards = across(&up, &(to - from));
                (from + (to - from) * f64::from(along) + outwards * body.radius, outwards)
            }
            SurfacePoint::Body { point, normal } => {
                (Point3::from(point.map(f64::from)), Vector3::from(normal.map(f64::from)))
            }
        };
        let normal = body.world_from_body * normal;
        // A triangle without area has no normal of its own.
        let normal = normal.try_normalize(f64::MIN_POSITIVE).unwrap_or_else(Vector3::z);
        let point = body.world_from_body * point;
        point.iter().all(|part| part.is_finite()).then_some(PlaceInWorld { point, normal })
    }

    fn body(&mut self, entity: Entity) -> Option<&Body<'a>> {
        if self.body.as_ref().is_none_or(|body| body.entity != entity) {
            self.body = self.scene.contains(entity).then(|| Body {
                entity,
                world_from_body: self.scene.world_pose(entity),
                vertices: self
                    .scene
                    .get::<VertexPositions>(entity)
                    .map_or(&[], |vertices| &vertices.positions),
                radius: self.scene.get::<LineMesh>(entity).map_or(0.0, |line| line.radius),
            });
        }
        self.body.as_ref()
    }
}

/// The unit vector nearest to `up` that is across a direction.
fn across(up: &Vector3<f64>, direction: &Vector3<f64>) -> Vector3<f64> {
    let Some(along) = UnitVector3::try_new(*direction, f64::MIN_POSITIVE) else { return *up };
    let part = |wish: &Vector3<f64>| (wish - along.scale(along.dot(wish))).try_normalize(1e-6);
    // Along a thread that points upwards, any direction across it will do.
    part(up).or_else(|| part(&Vector3::x())).or_else(|| part(&Vector3::y())).unwrap_or(*up)
}

/// Where one place is now, and the unit normal there; see [`PlaceReader::find`].
pub fn place_in_world(scene: &Snapshot, place: &SurfacePlace) -> Option<(Point3<f64>, Vector3<f64>)> {
    let PlaceInWorld { point, normal } = PlaceReader::new(scene).find(place)?;
    Some((point, normal))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::UnitQuaternion;

    use super::*;
    use crate::{Commands, EntityAllocator, Parent, Pose, Registry, SimTime, Store, SurfaceMesh};

    struct Scene {
        store: Store,
        commands: Commands,
    }

    impl Scene {
        fn new() -> Self {
            let registry = Registry::standard();
            let commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
            Self { store: Store::new(registry), commands }
        }

        fn write<T>(&mut self, write: impl FnOnce(&mut Commands) -> T) -> T {
            let value = write(&mut self.commands);
            self.store.apply(&mut self.commands, SimTime::ZERO);
            self.commands.clear();
            value
        }

        fn find(&self, place: &SurfacePlace) -> Option<PlaceInWorld> {
            PlaceReader::new(self.store.view()).find(place)
        }
    }

    fn vertices(points: &[[f64; 3]]) -> VertexPositions {
        VertexPositions { positions: Arc::new(points.iter().map(|point| Point3::from(*point)).collect()) }
    }

    fn on_triangle(entity: Entity, corners: [u32; 3]) -> SurfacePlace {
        let barycentric = [0.5, 0.25, 0.25];
        SurfacePlace { entity, on: SurfacePoint::Triangle { corners, barycentric } }
    }

    #[test]
    fn a_place_follows_the_tissue_and_the_poses_of_all_its_parents() {
        let mut scene = Scene::new();
        let body = scene.write(|out| {
            let (table, body) = (out.spawn(), out.spawn());
            out.put(table, Pose::at(0.0, 0.0, 1.0));
            let quarter = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
            out.put(body, Pose::new(Vector3::new(0.1, 0.0, 0.0), quarter));
            out.put(body, Parent(table));
            out.put(body, vertices(&[[0.0; 3], [0.4, 0.0, 0.0], [0.0, 0.4, 0.0]]));
            out.put(body, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]]) });
            body
        });
        let place = on_triangle(body, [0, 1, 2]);
        let found = scene.find(&place).expect("it is there");
        assert!((found.point - Point3::new(0.2, 0.0, 1.1)).norm() < 1e-12, "{found:?}");
        assert!((found.normal - Vector3::new(0.0, -1.0, 0.0)).norm() < 1e-12, "{found:?}");
        // Seen from the other side.
        let behind = scene.find(&on_triangle(body, [0, 2, 1])).expect("it is there");
        assert!((behind.normal - Vector3::new(0.0, 1.0, 0.0)).norm() < 1e-12);
        scene.write(|out| out.put(body, vertices(&[[0.0; 3], [0.4, 0.0, 0.8], [0.0, 0.4, 0.0]])));
        let moved = scene.find(&place).expect("it is there");
        assert!((moved.point - Point3::new(0.2, -0.2, 1.1)).norm() < 1e-12, "{moved:?}");
        assert_eq!(place_in_world(scene.store.view(), &place), Some((moved.point, moved.normal)));
    }

    #[test]
    fn a_place_that_is_nowhere_is_none() {
        let mut scene = Scene::new();
        let body = scene.write(|out| {
            let body = out.spawn();
            out.put(body, vertices(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]]));
            body
        });
        assert_eq!(scene.find(&on_triangle(body, [0, 1, u32::MAX])), None);
        assert_eq!(scene.find(&on_triangle(Entity::new(9, 9, 9), [0, 1, 2])), None);
        // Without area: a place, with some normal.
        let flat = scene.find(&on_triangle(body, [0, 1, 2])).expect("it is there");
        assert_eq!(flat.normal.norm(), 1.0);
        scene.write(|out| out.despawn(body));
        assert_eq!(scene.find(&on_triangle(body, [0, 1, 2])), None);
    }

    #[test]
    fn a_place_on_a_thread_lies_on_its_upper_side() {
        let mut scene = Scene::new();
        let thread = scene.write(|out| {
            let thread = out.spawn();
            out.put(thread, vertices(&[[0.0; 3], [0.1, 0.0, 0.0], [0.1, 0.0, 0.1]]));
            let segments = Arc::new(vec![[0, 1], [1, 2]]);
            out.put(thread, LineMesh { segments, radius: 0.001 });
            thread
        });
        let on = |ends, along| SurfacePlace { entity: thread, on: SurfacePoint::Segment { ends, along } };
        let found = scene.find(&on([0, 1], 0.25)).expect("it is there");
        assert!((found.point - Point3::new(0.025, 0.0, 0.001)).norm() < 1e-12);
        assert_eq!(found.normal, Vector3::z());
        // One that points upwards has no upper side, but a place beside it.
        let upright = scene.find(&on([1, 2], 0.5)).expect("it is there");
        assert!((upright.point - Point3::new(0.101, 0.0, 0.05)).norm() < 1e-12);
    }

    #[test]
    fn a_place_on_a_rigid_body_is_fixed_in_its_frame() {
        let mut scene = Scene::new();
        let body = scene.write(|out| {
            let body = out.spawn();
            out.put(body, crate::Shape::Sphere { radius: 0.1 });
            body
        });
        let on = SurfacePoint::Body { point: [0.0, 0.0, 0.5], normal: [0.0, 0.0, 1.0] };
        let place = SurfacePlace { entity: body, on };
        assert_eq!(scene.find(&place).map(|found| found.point.z), Some(0.5));
        let half = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        scene.write(|out| out.put(body, Pose::new(Vector3::new(1.0, 0.0, 0.0), half)));
        let found = scene.find(&place).expect("it is there");
        assert!((found.point - Point3::new(1.0, 0.0, -0.5)).norm() < 1e-12);
        assert!((found.normal + Vector3::z()).norm() < 1e-12);
    }
}
