//! An instrument's volume in image space: what it meets is reported, and nothing that is further than the tolerance.

use crate::support::shapes::Shape;
use nalgebra::{Isometry3, Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_collision::Surface;
use trocar_collision::continuous::Sweep;
use trocar_collision::primitive::{Triangle, closest_on_triangle, closest_segment_triangle};
use trocar_collision::z_buffer::{ShaftSweep, VolumeHit, ZBuffer, ZBufferError};

fn vector(random: &mut Pcg64Mcg, size: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| random.random_range(-size..=size))
}

fn corners(shape: &Shape, index: usize) -> Triangle {
    shape.triangles[index].map(|corner| shape.vertices[corner as usize])
}

/// Triangles of all sizes at places, some of them needles and points.
fn scene(
    random: &mut Pcg64Mcg,
    count: usize,
    scale: f64,
    place: impl Fn(&mut Pcg64Mcg) -> Vector3<f64>,
) -> Shape {
    let mut shape = Shape::default();
    for triangle in 0..count as u32 {
        let middle = place(random);
        let size = 10.0_f64.powf(random.random_range(-3.0..0.0));
        let mut corners: [Vector3<f64>; 3] = std::array::from_fn(|_| middle + vector(random, size));
        match random.random_range(0..10) {
            0 => corners[2] = corners[0] + (corners[1] - corners[0]) * 0.3,
            1 => corners = [corners[0]; 3],
            _ => {}
        }
        shape.vertices.extend(corners.map(|corner| Point3::from(corner * scale)));
        shape.triangles.push([3 * triangle, 3 * triangle + 1, 3 * triangle + 2]);
    }
    shape
}

/// How far a triangle is from the axis of a shaft, at the best of many moments, and how much further it may seem.
fn from_shaft(shaft: &ShaftSweep, triangle: &Triangle) -> (f64, f64) {
    let moments = 400;
    let mut least = f64::INFINITY;
    let mut between = 0.0_f64;
    let mut last = shaft.at(0.0);
    for moment in 0..=moments {
        let axis = shaft.at(f64::from(moment) / f64::from(moments));
        between = between.max((axis[0] - last[0]).norm()).max((axis[1] - last[1]).norm());
        least = least.min(closest_segment_triangle(&axis, triangle).distance_squared.sqrt());
        last = axis;
    }
    (least, 0.5 * between)
}

fn check(hits: &[VolumeHit], count: usize, mut judge: impl FnMut(usize, Option<&VolumeHit>)) {
    assert!(hits.is_sorted_by(|a, b| a.triangle < b.triangle));
    let mut next = hits.iter().peekable();
    for triangle in 0..count {
        let hit = next.next_if(|hit| hit.triangle as usize == triangle);
        if let Some(hit) = hit {
            assert!(hit.pixels > 0 && hit.depths[0] <= hit.depths[1], "{hit:?}");
        }
        judge(triangle, hit);
    }
    assert!(next.next().is_none());
}

#[test]
fn what_a_fast_shaft_passes_between_two_frames_is_hit() {
    let mut random = Pcg64Mcg::seed_from_u64(1);
    let (mut met, mut passed, mut missed) = (0, 0, 0);
    for round in 0..60 {
        let scale = 10.0_f64.powi(-(round % 4));
        let pixel = [0.01, 0.03, 0.1][round as usize % 3] * scale;
        let mut image = ZBuffer::new(pixel, 1 << 20).expect("an image");
        let port = Point3::from(vector(&mut random, 0.5));
        let carried = if round % 5 == 4 { vector(&mut random, 0.02) } else { Vector3::zeros() };
        let first = vector(&mut random, 1.0);
        let turn = match round % 6 {
            0 => 0.0,
            5 => 1.5,
            _ => 0.3,
        };
        let second = first + vector(&mut random, turn);
        let (port, tip) = (
            Sweep { from: port * scale, to: (port + carried) * scale },
            Sweep { from: (port + first) * scale, to: (port + carried + second) * scale },
        );
        let radius = if round % 7 == 0 { 0.0 } else { 0.05 * scale };
        let shaft = ShaftSweep::new(port, tip, radius).expect("a shaft");
        let scene = scene(&mut random, 250, scale, |random| {
            let [port, tip] = shaft.at(random.random_range(0.0..1.0));
            let on_axis = port + (tip - port) * random.random_range(-0.1..1.1);
            on_axis.coords / scale + vector(random, 0.2)
        });
        image.draw_shaft(&shaft);
        assert_eq!(image.pixel(), pixel);
        assert!(round % 5 == 4 || image.tolerance() <= 1.7 * pixel, "{} of {pixel}", image.tolerance());
        assert!(image.tolerance() <= 1.8 * pixel + carried.norm() * scale);
        let mut hits = Vec::new();
        image.hits(&scene.surface(), &mut hits);
        check(&hits, 250, |triangle, hit| {
            let corners = corners(&scene, triangle);
            let (apart, uncertain) = from_shaft(&shaft, &corners);
            if apart <= radius {
                met += 1;
                assert!(hit.is_some(), "round {round}: {apart} from the axis, {corners:?}");
                let at_ends = [0.0, 1.0].map(|time| closest_segment_triangle(&shaft.at(time), &corners));
                passed += usize::from(at_ends.iter().all(|at| at.distance_squared.sqrt() > radius));
            }
            let Some(hit) = hit else {
                missed += 1;
                return;
            };
            let limit = radius + image.tolerance() + uncertain;
            assert!(apart <= limit, "round {round}: {apart} exceeds {limit}");
            let on = closest_on_triangle(&hit.point, &corners).point;
            assert!((on - hit.point).norm() < 1e-8 * scale);
            assert!(from_shaft(&shaft, &[hit.point; 3]).0 <= limit, "round {round}: {hit:?}");
        });
    }
    assert!(
        met > 1_500 && passed > 200 && missed > 5_000,
        "{met} met, {passed} of them only in passing, {missed}"
    );
}

fn is_inside(shape: &Shape, point: &Point3<f64>) -> bool {
    let angle = |triangle: Triangle| {
        let [a, b, c] = triangle.map(|corner| corner - point);
        let (x, y, z) = (a.norm(), b.norm(), c.norm());
        a.dot(&b.cross(&c)).atan2(x * y * z + a.dot(&b) * z + b.dot(&c) * x + c.dot(&a) * y)
    };
    (0..shape.triangles.len()).map(|index| angle(corners(shape, index))).sum::<f64>().abs()
        > std::f64::consts::PI
}

/// Distance of a triangle to a closed volume; 0 where they have a point in common.
fn from_volume(volume: &Shape, triangle: &Triangle) -> f64 {
    if is_inside(volume, &triangle[0]) {
        return 0.0;
    }
    let mut least = f64::INFINITY;
    for index in 0..volume.triangles.len() {
        let other = corners(volume, index);
        for i in 0..3 {
            let one =
                closest_segment_triangle(&[triangle[i], triangle[(i + 1) % 3]], &other).distance_squared;
            let two = closest_segment_triangle(&[other[i], other[(i + 1) % 3]], triangle).distance_squared;
            least = least.min(one).min(two);
        }
    }
    least.sqrt()
}

#[test]
fn a_closed_volume_meets_what_is_in_it_and_what_crosses_it() {
    let mut random = Pcg64Mcg::seed_from_u64(2);
    let hollow = Shape::organ(2, 0.1).joined(&Shape::organ(1, 0.0).mapped(|point| point * 0.7).inverted());
    let volumes = [
        Shape::organ(2, 0.1),
        Shape::torus(12, 8, 0.3),
        Shape::horseshoe(12, 6),
        hollow,
        Shape::cuboid([1.0; 3]),
    ];
    let (mut met, mut inside, mut hollows) = (0, 0, 0);
    for round in 0..20 {
        let scale = 10.0_f64.powi(-(round as i32 % 5));
        let pixel = [0.02, 0.05, 0.15][round % 3] * scale;
        // Also along its edges, where everything is seen edge-on or in the middle of pixels.
        let motion = if round % 2 == 0 {
            Isometry3::new(vector(&mut random, 0.5), vector(&mut random, 3.0))
        } else {
            Isometry3::identity()
        };
        let direction = if round % 4 < 2 { Vector3::z() } else { vector(&mut random, 1.0) };
        let mut volume = volumes[round % 5].mapped(|point| motion * point * scale);
        if round % 7 == 6 {
            volume = volume.inverted();
        }
        let mut image = ZBuffer::new(pixel, 1 << 20).expect("an image");
        image.draw_surface(&volume.surface(), &(direction * 7.0)).expect("a direction");
        assert!(image.pixel() == pixel && image.tolerance() <= 1.5 * pixel);
        let scene = scene(&mut random, 120, scale, |random| vector(random, 1.3));
        let mut hits = Vec::new();
        image.hits(&scene.surface(), &mut hits);
        check(&hits, 120, |triangle, hit| {
            let corners = corners(&scene, triangle);
            let apart = from_volume(&volume, &corners);
            met += usize::from(apart == 0.0);
            inside += usize::from(corners.iter().all(|corner| is_inside(&volume, corner)));
            hollows += usize::from(round % 5 == 3 && apart > 0.0 && corners[0].coords.norm() < 0.6 * scale);
            assert!(apart > 1e-9 * scale || hit.is_some(), "round {round}: {corners:?} not seen");
            let Some(hit) = hit else { return };
            assert!(apart <= image.tolerance(), "round {round}: {apart} exceeds {}", image.tolerance());
            assert!((closest_on_triangle(&hit.point, &corners).point - hit.point).norm() < 1e-8 * scale);
            assert!(from_volume(&volume, &[hit.point; 3]) <= image.tolerance());
            let along = direction.normalize().dot(&hit.point.coords);
            assert!(hit.depths[0] - 1e-9 * scale <= along && along <= hit.depths[1] + 1e-9 * scale);
        });
    }
    assert!(met > 400 && inside > 100 && hollows > 5, "{met} met, {inside} inside, {hollows} in the hollow");
}

#[test]
fn depths_and_points_of_a_box() {
    let volume = Shape::cuboid([0.02, 0.02, 0.01]);
    let mut image = ZBuffer::new(0.001, 1 << 16).expect("an image");
    image.draw_surface(&volume.surface(), &Vector3::z()).expect("a direction");
    // A plate across it, one through it, one beside it, one behind it.
    let plate = |at: Vector3<f64>, normal_is_z: bool| {
        let [u, v] = if normal_is_z { [Vector3::x(), Vector3::y()] } else { [Vector3::z(), Vector3::y()] };
        [at - u * 0.1 - v * 0.1, at + u * 0.1 - v * 0.1, at + v * 0.2].map(Point3::from)
    };
    let plates = [
        plate(Vector3::z() * 0.004, true),
        plate(Vector3::zeros(), false),
        plate(Vector3::x() * 0.03, false),
        plate(Vector3::z() * 0.0101, true),
    ];
    let vertices = plates.concat();
    let triangles: Vec<_> = (0..4).map(|plate| [3 * plate, 3 * plate + 1, 3 * plate + 2]).collect();
    let mut hits = Vec::new();
    image.hits(&Surface::new(&vertices, &triangles).expect("plates"), &mut hits);
    assert_eq!(hits.iter().map(|hit| hit.triangle).collect::<Vec<_>>(), [0, 1]);
    assert!(hits[0].depths.iter().all(|depth| (depth - 0.004).abs() < 1e-12));
    assert!((hits[1].depths[0] + 0.01).abs() < 1e-12 && (hits[1].depths[1] - 0.01).abs() < 1e-12);
    assert!(hits[1].point.x.abs() < 1e-12 && hits[1].point.z.abs() < 1e-12);
    // 40 × 40 pixels, and those on whose border it ends.
    assert!((1_600..=1_764).contains(&hits[0].pixels), "{}", hits[0].pixels);
}

#[test]
fn nothing_open_and_what_is_no_image() {
    for pixel in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(ZBuffer::new(pixel, 1_000), Err(ZBufferError::Pixel { .. })), "{pixel}");
    }
    assert_eq!(ZBuffer::new(0.1, 1).err(), Some(ZBufferError::Pixels { pixels: 1 }));
    assert!(ZBuffer::new(0.1, usize::MAX).is_err());
    let mut image = ZBuffer::new(0.01, 10_000).expect("an image");
    let mut hits = Vec::new();
    let organ = Shape::organ(2, 0.1);
    image.hits(&organ.surface(), &mut hits);
    image.draw_surface(&Shape::default().surface(), &Vector3::z()).expect("a direction");
    image.hits(&organ.surface(), &mut hits);
    assert!(hits.is_empty());
    for direction in [Vector3::zeros(), Vector3::new(f64::NAN, 0.0, 1.0), Vector3::repeat(f64::INFINITY)] {
        assert_eq!(image.draw_surface(&organ.surface(), &direction), Err(ZBufferError::Direction));
    }
    // An image of the size of a room holds 10,000 pixels all the same, which are as large as the tolerance says.
    image.draw_surface(&organ.mapped(|point| point * 100.0).surface(), &Vector3::x()).expect("a direction");
    assert!(image.pixel() > 1.0 && image.size().iter().product::<usize>() <= 10_000);
    assert!(image.tolerance() < 1.5 * image.pixel());
    // Of an open surface the sheets count, and what lies between two.
    let mut open = Shape::cuboid([1.0, 1.0, 1.0]);
    open.triangles.retain(|corners| corners.iter().all(|&corner| open.vertices[corner as usize].z < 0.0));
    assert_eq!(open.triangles.len(), 2);
    image.draw_surface(&open.surface(), &Vector3::z()).expect("a direction");
    image.hits(&open.surface(), &mut hits);
    assert_eq!(hits.len(), 2);
    hits.clear();
    image.hits(&open.mapped(|point| point + Vector3::z() * 0.5).surface(), &mut hits);
    assert!(hits.is_empty());
    // The image of before is gone.
    let still = Sweep { from: Point3::origin(), to: Point3::origin() };
    image.draw_shaft(&ShaftSweep::new(still, still, 0.01).expect("a ball"));
    image.hits(&organ.surface(), &mut hits);
    assert!(hits.is_empty());
    image.draw_shaft(
        &ShaftSweep::new(still, Sweep { from: still.from, to: Point3::new(2.0, 0.0, 0.0) }, 0.01)
            .expect("a shaft"),
    );
    image.hits(&organ.surface(), &mut hits);
    assert!(!hits.is_empty());
}
