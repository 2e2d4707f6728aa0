//! The place on a surface that a ray hits first: what a person's mouse points at.
//!
//! The surfaces are those that a viewer draws: meshes with their vertices, threads as tubes, instruments and shapes as
//! they are tessellated. Rays and triangles are intersected after Möller and Trumbore, "Fast, minimum storage
//! ray/triangle intersection" (1997).

use nalgebra::{Isometry3, Point3, Vector3};

use super::surface_parts::triangles;
use crate::components::{Instrument, JawState, LineMesh, Shape, SurfacePlace, SurfacePoint, VertexPositions};
use crate::entity::Entity;
use crate::shapes::{Detail, instrument_surface, surface_of};
use crate::snapshot::Snapshot;

/// Segments around the shaft of an instrument.
const SHAFT_SEGMENTS: usize = 24;
/// Slack of barycentric coordinates, so that a ray along the edge of two triangles hits one of them.
const EDGE_SLACK: f64 = 1e-9;

/// Where a ray hits a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SurfaceHit {
    /// The place.
    pub place: SurfacePlace,
    /// Where it is in the world \[m\].
    pub point: Point3<f64>,
    /// Along the ray \[m\].
    pub distance: f64,
}

/// The first surface place that a ray from `origin` along `direction` (both in world) hits; `None` if it hits nothing, or
/// has no direction.
///
/// Thin tissue is hit from both sides, and the place lies on the side that the ray comes from. The time that it takes is
/// that of a look at each triangle of the scene.
pub fn nearest_place(scene: &Snapshot, origin: &Point3<f64>, direction: &Vector3<f64>) -> Option<SurfaceHit> {
    let direction = direction.try_normalize(f64::MIN_POSITIVE)?;
    let mut nearest = Nearest { ray: Ray { origin: *origin, direction }, found: None };
    for (entity, vertices) in scene.iter::<VertexPositions>() {
        nearest.try_mesh(scene, entity, &vertices.positions);
    }
    for (entity, instrument) in scene.iter::<Instrument>().filter(|(entity, _)| !is_mesh(scene, *entity)) {
        let opening = scene.get::<JawState>(entity).map_or(0.0, |jaws| jaws.angle);
        if let Ok(surface) = instrument_surface(instrument, SHAFT_SEGMENTS) {
            let whole = surface.assembled(opening);
            nearest.try_body(scene, entity, &whole.positions, &whole.triangles);
        }
    }
    for (entity, shape) in scene.iter::<Shape>() {
        if is_mesh(scene, entity) || scene.get::<Instrument>(entity).is_some() {
            continue;
        }
        let ray = nearest.ray.in_frame(&scene.world_pose(entity));
        // Tessellating takes longer than everything else: most rays miss most shapes.
        if ray.comes_within(radius(shape))
            && let Ok(surface) = surface_of(shape, &Detail::default())
        {
            nearest.try_body(scene, entity, &surface.positions, &surface.triangles);
        }
    }
    nearest.found
}

/// Whether a viewer draws the entity's mesh, and no shape that it has as well.
fn is_mesh(scene: &Snapshot, entity: Entity) -> bool {
    scene.get::<VertexPositions>(entity).is_some()
        && (scene.get::<LineMesh>(entity).is_some() || triangles(scene, entity).is_some())
}

#[derive(Clone, Copy, Debug)]
struct Ray {
    origin: Point3<f64>,
    /// Of unit length.
    direction: Vector3<f64>,
}

struct Nearest {
    /// In world.
    ray: Ray,
    found: Option<SurfaceHit>,
}

/// The first triangle of some that a ray hits.
struct TriangleHit {
    corners: [u32; 3],
    barycentric: [f64; 3],
    distance: f64,
    /// Not normalised; towards where the ray comes from.
    normal: Vector3<f64>,
}

impl Nearest {
    /// Distance that a hit has to be below \[m\].
    fn limit(&self) -> f64 {
        self.found.map_or(f64::INFINITY, |hit| hit.distance)
    }

    fn keep(&mut self, place: SurfacePlace, distance: f64) {
        let point = self.ray.origin + self.ray.direction * distance;
        // Rounded to single precision, weights and normals may leave their ranges where a body is out of all proportion.
        if place.check().is_ok() {
            self.found = Some(SurfaceHit { place, point, distance });
        }
    }

    fn try_mesh(&mut self, scene: &Snapshot, entity: Entity, vertices: &[Point3<f64>]) {
        let ray = self.ray.in_frame(&scene.world_pose(entity));
        if let Some(line) = scene.get::<LineMesh>(entity) {
            for ends in line.segments.iter() {
                let vertex = |index: u32| vertices.get(index as usize);
                let Some((from, to)) = vertex(ends[0]).zip(vertex(ends[1])) else { continue };
                let Some((distance, along)) = ray.tube(from, to, line.radius) else { continue };
                if distance < self.limit() {
                    let on = SurfacePoint::Segment { ends: *ends, along: along as f32 };
                    self.keep(SurfacePlace { entity, on }, distance);
                }
            }
        } else if let Some(triangles) = triangles(scene, entity)
            && let Some(hit) = ray.first_of(vertices, &triangles, self.limit())
        {
            let barycentric = hit.barycentric.map(|weight| weight as f32);
            let on = SurfacePoint::Triangle { corners: hit.corners, barycentric };
            self.keep(SurfacePlace { entity, on }, hit.distance);
        }
    }

    /// A body whose surface is not in the scene: its places are in its own frame.
    fn try_body(
        &mut self,
        scene: &Snapshot,
        entity: Entity,
        vertices: &[Point3<f64>],
        triangles: &[[u32; 3]],
    ) {
        let ray = self.ray.in_frame(&scene.world_pose(entity));
        let Some(hit) = ray.first_of(vertices, triangles, self.limit()) else { return };
        let Some(normal) = hit.normal.try_normalize(f64::MIN_POSITIVE) else { return };
        let point = ray.origin + ray.direction * hit.distance;
        let on = SurfacePoint::Body {
            point: point.coords.map(|part| part as f32).into(),
            normal: normal.map(|part| part as f32).into(),
        };
        self.keep(SurfacePlace { entity, on }, hit.distance);
    }
}

impl Ray {
    fn in_frame(&self, world_from_frame: &Isometry3<f64>) -> Self {
        Self {
            origin: world_from_frame.inverse_transform_point(&self.origin),
            direction: world_from_frame.inverse_transform_vector(&self.direction),
        }
    }

    /// Whether it comes as near to the origin of its frame as that.
    fn comes_within(&self, radius: f64) -> bool {
        let along = (-self.origin.coords.dot(&self.direction)).max(0.0);
        (self.origin.coords + self.direction * along).norm() <= radius
    }

    /// The first triangle below a distance. Those with vertices that do not exist are left out.
    fn first_of(&self, vertices: &[Point3<f64>], triangles: &[[u32; 3]], limit: f64) -> Option<TriangleHit> {
        let mut first: Option<TriangleHit> = None;
        for corners in triangles {
            let vertex = |corner: usize| vertices.get(corners[corner] as usize);
            let (Some(a), Some(b), Some(c)) = (vertex(0), vertex(1), vertex(2)) else { continue };
            let Some((distance, [u, v, w])) = self.triangle(a, b, c) else { continue };
            if distance >= first.as_ref().map_or(limit, |first| first.distance) {
                continue;
            }
            let normal = (b - a).cross(&(c - a));
            let [one, two, three] = *corners;
            first = Some(if normal.dot(&self.direction) <= 0.0 {
                TriangleHit { corners: *corners, barycentric: [u, v, w], distance, normal }
            } else {
                let corners = [one, three, two];
                TriangleHit { corners, barycentric: [u, w, v], distance, normal: -normal }
            });
        }
        first
    }

    /// Distance of a triangle, and the weights of its corners where it is hit, from either side.
    fn triangle(&self, a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>) -> Option<(f64, [f64; 3])> {
        let (ab, ac) = (b - a, c - a);
        let across = self.direction.cross(&ac);
        let inverse = 1.0 / ab.dot(&across);
        if !inverse.is_finite() {
            return None;
        }
        let from_a = self.origin - a;
        let v = from_a.dot(&across) * inverse;
        let other = from_a.cross(&ab);
        let w = self.direction.dot(&other) * inverse;
        let u = 1.0 - v - w;
        if u.min(v).min(w) < -EDGE_SLACK {
            return None;
        }
        let distance = ac.dot(&other) * inverse;
        // Written so that a distance that is no number is no hit.
        (distance >= 0.0).then(|| (distance, [u, v, w].map(|weight| weight.clamp(0.0, 1.0))))
    }

    /// Distance of a tube around a segment, and the share along the segment. Where the ray comes nearest to the segment
    /// counts as where it hits.
    fn tube(&self, from: &Point3<f64>, to: &Point3<f64>, radius: f64) -> Option<(f64, f64)> {
        let segment = to - from;
        let to_start = from - self.origin;
        let (length, slope) = (segment.norm_squared(), segment.dot(&self.direction));
        // The nearest points of two lines; of parallel ones the start.
        let spread = length - slope * slope;
        let along = (slope * to_start.dot(&self.direction) - segment.dot(&to_start)) / spread;
        let along = if along.is_finite() { along.clamp(0.0, 1.0) } else { 0.0 };
        let nearest = to_start + segment * along;
        let distance = nearest.dot(&self.direction);
        let beside = (nearest - self.direction * distance).norm();
        (distance >= 0.0 && beside <= radius).then_some((distance, along))
    }
}

/// Radius about the origin of its frame in which a shape lies \[m\].
fn radius(shape: &Shape) -> f64 {
    match shape {
        Shape::Box { half_extents: [x, y, z] } => Vector3::new(*x, *y, *z).norm(),
        Shape::Sphere { radius } => *radius,
        Shape::Cylinder { radius, half_height } => radius.hypot(*half_height),
        Shape::Capsule { radius, half_height } => radius + half_height,
        Shape::Torus { ring_radius, tube_radius } => ring_radius + tube_radius,
        Shape::PegBoard { half_extents: [x, y], thickness, peg_height, .. } => {
            Vector3::new(*x, *y, thickness.max(*peg_height)).norm()
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use nalgebra::UnitQuaternion;
    use proptest::prelude::*;

    use super::*;
    use crate::annotation::PlaceReader;
    use crate::{Commands, EntityAllocator, Pose, Registry, SimTime, Store, SurfaceMesh, TetMesh};

    fn scene(write: impl FnOnce(&mut Commands)) -> Snapshot {
        let registry = Registry::standard();
        let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let mut store = Store::new(registry);
        write(&mut out);
        store.apply(&mut out, SimTime::ZERO);
        store.snapshot()
    }

    fn mesh(out: &mut Commands, points: &[[f64; 3]]) -> Entity {
        let entity = out.spawn();
        let positions = points.iter().map(|point| Point3::from(*point)).collect();
        out.put(entity, VertexPositions { positions: Arc::new(positions) });
        entity
    }

    /// Downwards from 1 m above a point of the plane z = 0.
    fn down(scene: &Snapshot, x: f64, y: f64) -> Option<SurfaceHit> {
        nearest_place(scene, &Point3::new(x, y, 1.0), &-Vector3::z())
    }

    /// A place is where the ray hit, and its normal points to where the ray came from.
    fn agrees(scene: &Snapshot, hit: &SurfaceHit, direction: &Vector3<f64>, within: f64) {
        let found = PlaceReader::new(scene).find(&hit.place).expect("it is there");
        assert!((found.point - hit.point).norm() < within, "{hit:?} {found:?}");
        assert!(found.normal.dot(direction) <= 0.0, "{hit:?} {found:?}");
    }

    #[test]
    fn the_first_of_several_surfaces_is_hit_from_whichever_side() {
        let corners = |height: f64| [[0.0, 0.0, height], [1.0, 0.0, height], [0.0, 1.0, height]];
        let scene = scene(|out| {
            for height in [0.0, 0.5, 0.25] {
                let entity = mesh(out, &corners(height));
                out.put(entity, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]]) });
                out.put(entity, Pose::at(0.0, 0.0, 0.1));
            }
        });
        let hit = down(&scene, 0.25, 0.25).expect("a hit");
        assert_eq!(hit.place.entity, Entity::new(0, 0, 2));
        assert!((hit.distance - 0.4).abs() < 1e-12);
        agrees(&scene, &hit, &-Vector3::z(), 1e-7);
        let up = nearest_place(&scene, &Point3::new(0.25, 0.25, -1.0), &(Vector3::z() * 7.0)).expect("a hit");
        assert!(up.place.entity == Entity::new(0, 0, 1) && (up.point.z - 0.1).abs() < 1e-12, "{up:?}");
        agrees(&scene, &up, &Vector3::z(), 1e-7);
        assert_eq!(down(&scene, 0.75, 0.75), None);
        assert_eq!(nearest_place(&scene, &Point3::new(0.25, 0.25, 2.0), &Vector3::z()), None, "behind it");
        assert_eq!(nearest_place(&scene, &Point3::new(0.25, 0.25, 2.0), &Vector3::zeros()), None);
        let nowhere = Vector3::new(f64::NAN, 0.0, 1.0);
        assert_eq!(nearest_place(&scene, &Point3::origin(), &nowhere), None);
    }

    #[test]
    fn volumes_threads_instruments_and_shapes_are_hit_where_they_are_drawn() {
        let scene = scene(|out| {
            let volume = mesh(out, &[[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]);
            out.put(volume, TetMesh { tets: Arc::new(vec![[0, 1, 2, 3]]) });
            let thread = mesh(out, &[[1.0, 0.0, 0.0], [1.1, 0.0, 0.0]]);
            out.put(thread, LineMesh { segments: Arc::new(vec![[0, 1]]), radius: 0.002 });
            let instrument = out.spawn();
            out.put(instrument, Instrument::default());
            let lying = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::FRAC_PI_2);
            out.put(instrument, Pose::new(Vector3::new(2.0, 0.0, 0.0), lying));
            let ball = out.spawn();
            out.put(ball, Shape::Sphere { radius: 0.05 });
            out.put(ball, Pose::at(3.0, 0.0, 0.02));
        });
        let at = |x, y| down(&scene, x, y).expect("a hit");
        let volume = at(0.02, 0.03);
        assert!((volume.point.z - 0.05).abs() < 1e-12);
        agrees(&scene, &volume, &-Vector3::z(), 1e-7);
        let thread = at(1.025, 0.001);
        assert!(
            matches!(thread.place.on, SurfacePoint::Segment { ends: [0, 1], along } if (along - 0.25).abs() < 1e-6)
        );
        agrees(&scene, &thread, &-Vector3::z(), 0.003);
        assert_eq!(down(&scene, 1.025, 0.003), None, "beside the thread");
        assert_eq!(down(&scene, 1.11, 0.0), None, "beyond its end");
        let ball = at(3.0, 0.0);
        assert!((ball.point.z - 0.07).abs() < 1e-4 && ball.place.entity == Entity::new(0, 0, 4));
        agrees(&scene, &ball, &-Vector3::z(), 1e-6);
        let radius = Instrument::default().shaft_radius;
        let instrument = at(2.0, 0.1);
        assert!((instrument.point.z - radius).abs() < 0.02 * radius, "{instrument:?}");
        agrees(&scene, &instrument, &-Vector3::z(), 1e-6);
    }

    #[test]
    fn what_has_a_mesh_is_hit_there_and_not_at_its_shape() {
        let scene = scene(|out| {
            let body = mesh(out, &[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
            out.put(body, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [0, 1, 9]]) });
            out.put(body, Shape::Sphere { radius: 0.5 });
        });
        assert_eq!(down(&scene, 0.1, 0.1).map(|hit| hit.distance), Some(1.0));
    }

    proptest! {
        #[test]
        fn a_ray_towards_a_point_of_a_triangle_hits_it_there(
            corners in prop::array::uniform3(prop::array::uniform3(-1.0..1.0_f64)),
            weights in prop::array::uniform3(0.01..1.0_f64),
            eye in prop::array::uniform3(-3.0..3.0_f64),
        ) {
            let [a, b, c] = corners.map(Point3::from);
            let normal = (b - a).cross(&(c - a));
            let sum: f64 = weights.iter().sum();
            let target = Point3::from(
                (a.coords * weights[0] + b.coords * weights[1] + c.coords * weights[2]) / sum,
            );
            let towards = target - Point3::from(eye);
            // Not along the triangle's plane.
            prop_assume!(normal.dot(&towards).abs() > 1e-2 * normal.norm() * towards.norm() && normal.norm() > 1e-2);
            let scene = scene(|out| {
                let body = mesh(out, &corners);
                out.put(body, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2]]) });
            });
            let hit = nearest_place(&scene, &eye.into(), &towards).expect("a hit");
            prop_assert!((hit.point - target).norm() < 1e-9);
            let found = PlaceReader::new(&scene).find(&hit.place).expect("it is there");
            prop_assert!((found.point - target).norm() < 1e-6);
            prop_assert!(found.normal.dot(&towards) < 0.0);
        }

        #[test]
        fn a_shape_lies_within_its_radius(x in 0.001..0.1_f64, y in 0.001..0.1_f64, z in 0.001..0.1_f64) {
            for shape in [
                Shape::Box { half_extents: [x, y, z] },
                Shape::Sphere { radius: x },
                Shape::Cylinder { radius: x, half_height: y },
                Shape::Capsule { radius: x, half_height: y },
                Shape::Torus { ring_radius: x + y, tube_radius: x },
                Shape::PegBoard {
                    half_extents: [0.1, 0.1],
                    thickness: x,
                    pegs: vec![[0.0, 0.0]],
                    peg_radius: 0.002,
                    peg_height: z,
                },
            ] {
                let surface = surface_of(&shape, &Detail::default()).expect("a surface");
                let most = surface.positions.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
                prop_assert!(most <= radius(&shape) * (1.0 + 1e-9), "{shape:?}: {most}");
            }
        }
    }
}
