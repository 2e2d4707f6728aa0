//! The haptic proxy against what can be worked out by hand.

use crate::support::organ::shapes::{Mesh, cuboid, inverted, joined, plate, sphere};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_collision::Surface;
use trocar_collision::finger_proxy::{FingerProxy, PlaneProperties, ProxyConfig, ProxyError};
use trocar_collision::moving_surface::MovingSurface;
use trocar_scene::time::SimTime;

const FINGER: ProxyConfig =
    ProxyConfig { radius: 0.002, skin: 1e-5, static_friction: 0.0, dynamic_friction: 0.0 };
const POINT: ProxyConfig = ProxyConfig { radius: 0.0, ..FINGER };

fn moving((vertices, triangles): &Mesh) -> MovingSurface {
    MovingSurface::new(&Surface::new(vertices, triangles).expect("a surface"))
}

fn proxy(config: ProxyConfig) -> FingerProxy {
    FingerProxy::new(config).expect("a valid proxy")
}

fn hold(config: &ProxyConfig) -> f64 {
    config.radius + config.skin
}

/// From free space along a line, in steps.
fn stroke(finger: &mut FingerProxy, mesh: &MovingSurface, from: Point3<f64>, to: Point3<f64>, steps: u32) {
    for step in 0..=steps {
        let device = from + (to - from) * (f64::from(step) / f64::from(steps));
        finger.step(mesh, &device, 0.001).expect("a finite device");
    }
}

#[test]
fn a_plane_holds_it_straight_above_the_device_and_pulls_with_the_depth() {
    let mesh = moving(&plate(9, 0.1));
    for config in [FINGER, POINT] {
        for steps in [1, 10, 1000] {
            let mut finger = proxy(config);
            let device = Point3::new(0.0031, 0.0123, -0.005);
            stroke(&mut finger, &mesh, Point3::new(0.001, 0.01, 0.01), device, steps);
            let expected = Point3::new(device.x, device.y, hold(&config));
            assert!((finger.position() - expected).norm() < 1e-7, "{steps}: {finger:?}");
            let force = finger.force(800.0);
            assert!((force - Vector3::z() * 800.0 * (0.005 + hold(&config))).norm() < 1e-4, "{force:?}");
            assert_eq!(finger.contacts().count(), 1);
            // And it lets go where it was met.
            let free = Point3::new(0.003, 0.012, 0.004);
            stroke(&mut finger, &mesh, device, free, steps);
            finger.step(&mesh, &free, 0.001).expect("a finite device");
            assert_eq!((finger.position(), finger.contacts().count()), (free, 0));
            assert_eq!(finger.force(800.0), Vector3::zeros());
        }
    }
}

#[test]
fn sliding_over_a_flat_triangulation_meets_no_bump() {
    let mesh = moving(&plate(40, 0.1));
    for config in [FINGER, POINT] {
        for depth in [1e-5, 0.001, 0.01] {
            let mut finger = proxy(config);
            let start = Point3::new(-0.04, -0.03, -depth);
            stroke(&mut finger, &mesh, Point3::new(-0.04, -0.03, 0.01), start, 50);
            let mut work = 0.0;
            let mut last = start;
            for step in 0..4000 {
                let turn = f64::from(step) * 0.002;
                let device = Point3::new(-0.04 + f64::from(step) * 2e-5, -0.03 * turn.cos(), -depth);
                let place = finger.step(&mesh, &device, 0.001).expect("a finite device");
                assert!((place.z - hold(&config)).abs() < 2e-8, "{step}: {place:?}");
                let sideways = place - device - Vector3::z() * (hold(&config) + depth);
                assert!(sideways.norm() < 5e-8, "{step}: {sideways:?}");
                work += finger.force(1000.0).dot(&(device - last));
                last = device;
            }
            // No energy is made or lost on the way.
            assert!(work.abs() < 1e-7, "{work}");
        }
    }
}

#[test]
fn a_sphere_holds_it_on_the_way_from_the_middle_to_the_device() {
    // Faceted, so that it is known to within the height of a facet.
    let mesh = moving(&sphere(4, |_| 0.05));
    let flat = 0.05 * 0.002;
    for direction in [Vector3::new(0.3, 0.5, 0.8), Vector3::new(-1.0, 0.1, 0.05), Vector3::x()] {
        let direction = direction.normalize();
        let mut finger = proxy(FINGER);
        let device = Point3::from(direction * 0.04);
        stroke(&mut finger, &mesh, Point3::from(direction * 0.08), device, 40);
        let from_middle = finger.position().coords.norm();
        assert!((0.05 - flat..=0.05 + 1e-9).contains(&(from_middle - hold(&FINGER))), "{from_middle}");
        assert!(finger.position().coords.normalize().dot(&direction) > 0.999, "{:?}", finger.position());
    }
}

#[test]
fn three_walls_of_an_inner_corner_hold_it_and_two_hold_it_in_an_edge() {
    let room = moving(&inverted(cuboid(Vector3::repeat(0.05))));
    for config in [FINGER, POINT] {
        for steps in [1, 7, 300] {
            let inner = 0.05 - hold(&config);
            let mut finger = proxy(config);
            let device = Point3::new(0.056, 0.07, 0.061);
            stroke(&mut finger, &room, Point3::new(0.001, 0.002, 0.003), device, steps);
            assert!((finger.position() - Point3::new(inner, inner, inner)).norm() < 1e-7, "{finger:?}");
            let normals: Vec<_> = finger.contacts().map(|contact| contact.normal).collect();
            assert_eq!(normals.len(), 3);
            for wall in [-Vector3::x(), -Vector3::y(), -Vector3::z()] {
                assert!(normals.iter().any(|normal| (normal - wall).norm() < 1e-8), "{normals:?}");
            }
            // The shares of the force are those of the walls.
            let force: Vector3<f64> = finger.contacts().map(|contact| contact.normal * contact.push).sum();
            assert!((force - (finger.position() - device)).norm() < 1e-7);

            // Along the edge: the third wall lets go, two remain.
            let along = Point3::new(0.056, 0.07, -0.02);
            stroke(&mut finger, &room, device, along, steps);
            assert!((finger.position() - Point3::new(inner, inner, -0.02)).norm() < 1e-7, "{finger:?}");
            assert_eq!(finger.contacts().count(), 2);
        }
    }
}

#[test]
fn it_slides_along_an_outer_edge_and_falls_off_behind_it() {
    let block = moving(&cuboid(Vector3::repeat(0.02)));
    let mut finger = proxy(FINGER);
    let over = Point3::new(0.0, 0.0, 0.015);
    stroke(&mut finger, &block, Point3::new(0.0, 0.0, 0.04), over, 100);
    assert!((finger.position().z - (0.02 + hold(&FINGER))).abs() < 1e-8);
    // Sideways beyond the edge, below the top: round the edge, to the device.
    let mut last = finger.position();
    for step in 0..=300 {
        let device = over + Vector3::x() * (0.0001 * f64::from(step));
        let place = finger.step(&block, &device, 0.001).expect("a finite device");
        assert!((place - last).norm() < 0.01, "{step}: a leap from {last:?} to {place:?}");
        last = place;
    }
    assert!((last - Point3::new(0.03, 0.0, 0.015)).norm() < 1e-7, "{last:?}");
}

#[test]
fn a_wedge_narrower_than_the_finger_holds_it_at_its_mouth() {
    // Two walls that meet in the y axis with 20° between them.
    let half = 10.0_f64.to_radians();
    let depth = 0.1;
    let (sine, cosine) = half.sin_cos();
    let right = vec![
        Point3::new(0.0, -0.05, 0.0),
        Point3::new(0.0, 0.05, 0.0),
        Point3::new(depth * sine, -0.05, depth * cosine),
        Point3::new(depth * sine, 0.05, depth * cosine),
    ];
    let left = right.iter().map(|point| Point3::new(-point.x, point.y, point.z)).collect();
    let faces = vec![[0, 1, 2], [2, 1, 3]];
    let wedge = moving(&joined(inverted((right, faces.clone())), (left, faces)));
    for steps in [1, 100] {
        let mut finger = proxy(FINGER);
        stroke(&mut finger, &wedge, Point3::new(0.0, 0.0, 0.05), Point3::new(0.003, 0.001, -0.02), steps);
        let expected = Point3::new(0.0, 0.001, hold(&FINGER) / sine);
        assert!((finger.position() - expected).norm() < 1e-6, "{finger:?}");
        assert_eq!(finger.contacts().count(), 2);
    }
}

#[test]
fn friction_holds_it_within_the_cone_and_lets_it_slide_beyond() {
    let rough = ProxyConfig { static_friction: 0.6, dynamic_friction: 0.4, ..FINGER };
    let mesh = moving(&plate(12, 0.1));
    let mut finger = proxy(rough);
    let down = Point3::new(0.001, 0.002, -0.002);
    stroke(&mut finger, &mesh, Point3::new(0.001, 0.002, 0.01), down, 100);
    let pressed = 0.002 + hold(&FINGER);
    let slide = |finger: &mut FingerProxy, by: f64| {
        finger.step(&mesh, &(down + Vector3::x() * by), 0.001).expect("a finite device")
    };
    let inside = slide(&mut finger, 0.59 * pressed);
    assert!((inside.x - down.x).abs() < 1e-7 && finger.is_sticking(), "{inside:?}");
    // Beyond: it lags by what the sliding friction takes.
    for by in [0.7, 2.0, 9.0] {
        let beyond = slide(&mut finger, by * pressed);
        let lag = down.x + by * pressed - beyond.x;
        assert!((lag - 0.4 * pressed).abs() < 1e-6 || by < 1.0, "{by}: {beyond:?}");
        let force = finger.force(500.0);
        assert!(-force.x <= 0.6 * force.z + 1e-6, "outside of the cone: {force:?}");
    }
    // And back a little: it sticks again where it is.
    let stuck = finger.position();
    assert!((slide(&mut finger, 8.9 * pressed) - stuck).norm() < 1e-7 && finger.is_sticking());
}

#[test]
fn a_wall_that_sweeps_over_it_carries_it_along_however_fast() {
    for config in [FINGER, POINT] {
        for advance in [1e-6, 1e-4, 0.003, 0.05] {
            let (start, triangles) = plate(6, 2.0);
            let mut mesh = moving(&(start.clone(), triangles.clone()));
            let mut finger = proxy(config);
            // The hand rests above the wall; the wall rises past it.
            let device = Point3::new(0.011, 0.007, 0.01);
            finger.step(&mesh, &device, 0.001).expect("a finite device");
            for update in 1..40 {
                let height = advance * f64::from(update);
                // It tilts as well, so that no triangle moves as another does.
                let vertices: Vec<_> = start
                    .iter()
                    .map(|vertex| vertex + Vector3::z() * (height * (1.0 + 0.5 * vertex.x)))
                    .collect();
                mesh.update(&Surface::new(&vertices, &triangles).expect("a surface"), 0.01).expect("a time");
                let place = finger.step(&mesh, &device, 0.01).expect("a finite device");
                let normal = Vector3::new(-0.5 * height, 0.0, 1.0).normalize();
                let above = normal.dot(&(place - Point3::new(0.0, 0.0, height)));
                assert!(above > 0.99 * config.radius + 1e-7, "{advance} {update}: {above}");
                let is_past = normal.dot(&(device - Point3::new(0.0, 0.0, height))) < hold(&config);
                assert_eq!(finger.contacts().count(), usize::from(is_past), "{advance} {update}");
                if is_past {
                    assert!((above - hold(&config)).abs() < 1e-6, "{advance} {update}: {above}");
                    let told = finger.contacts().next().expect("a contact").surface_velocity;
                    let rises = advance * (1.0 + 0.5 * place.x) / 0.01;
                    assert!((told.z - rises).abs() < 0.05 * rises + 1e-9, "{told:?} {rises}");
                }
            }
            assert_eq!(finger.statistics().squeezed, 0);
        }
    }
}

#[test]
fn a_rough_wall_that_moves_sideways_takes_it_along_and_a_smooth_one_does_not() {
    for (friction, share) in [(0.5, 1.0), (0.0, 0.0)] {
        let config = ProxyConfig { static_friction: friction, dynamic_friction: friction, ..FINGER };
        let (start, triangles) = plate(30, 0.2);
        let mut mesh = moving(&(start.clone(), triangles.clone()));
        let mut finger = proxy(config);
        let device = Point3::new(0.0, 0.0, -0.004);
        stroke(&mut finger, &mesh, Point3::new(0.0, 0.0, 0.01), device, 20);
        for update in 1..=20 {
            let shift = 5e-5 * f64::from(update);
            let vertices: Vec<_> = start.iter().map(|vertex| vertex + Vector3::x() * shift).collect();
            mesh.update(&Surface::new(&vertices, &triangles).expect("a surface"), 0.001).expect("a time");
            let place = finger.step(&mesh, &device, 0.001).expect("a finite device");
            assert!((place.x - share * shift).abs() < 1e-6, "{friction} {update}: {place:?}");
        }
    }
}

#[test]
fn closing_walls_keep_it_between_them_as_long_as_there_is_room() {
    let walls = |gap: f64| -> Mesh {
        let (mut upper, faces) = plate(5, 0.1);
        let mut lower = upper.clone();
        upper.iter_mut().for_each(|vertex| vertex.z = 0.5 * gap + 0.1 * gap * (90.0 * vertex.x).sin());
        lower.iter_mut().for_each(|vertex| vertex.z = -0.5 * gap);
        joined((lower, faces.clone()), inverted((upper, faces)))
    };
    for closing in [0.9, 0.3] {
        let mut gap = 0.02;
        let mut mesh = moving(&walls(gap));
        let mut finger = proxy(FINGER);
        finger.step(&mesh, &Point3::new(0.003, 0.001, 0.0), 0.001).expect("a finite device");
        for _ in 0..40 {
            gap = (gap * closing).max(1e-4);
            let (vertices, triangles) = walls(gap);
            mesh.update(&Surface::new(&vertices, &triangles).expect("a surface"), 0.01).expect("a time");
            // The hand pulls at it from outside of the lower wall.
            let place = finger.step(&mesh, &Point3::new(0.003, 0.001, -0.03), 0.001).expect("finite");
            assert!(place.z > -0.5 * gap && place.z < 0.7 * gap, "{closing} {gap}: {place:?}");
        }
        assert_eq!(finger.statistics().squeezed, 0);
    }
}

#[test]
fn it_begins_in_front_of_what_the_device_is_behind_and_survives_other_triangles() {
    let mesh = moving(&cuboid(Vector3::repeat(0.02)));
    let mut finger = proxy(FINGER);
    let inside = Point3::new(0.003, 0.0, 0.015);
    let place = finger.step(&mesh, &inside, 0.0).expect("a finite device");
    assert!((place.z - (0.02 + hold(&FINGER))).abs() < 1e-7, "{place:?}");
    // The block is remeshed as a finer one that stands a little higher.
    let mut mesh = mesh;
    let (vertices, triangles) = sphere(3, |direction| 0.0201 / direction.amax());
    mesh.update(&Surface::new(&vertices, &triangles).expect("a surface"), 0.001).expect("a time");
    let place = finger.step(&mesh, &inside, 0.001).expect("a finite device");
    assert!(place.coords.amax() > 0.0201 && place.z > 0.02, "{place:?}");
    let none = MovingSurface::new(&Surface::new(&[], &[]).expect("an empty surface"));
    let mut free = proxy(FINGER);
    assert_eq!(free.step(&none, &inside, 0.001), Ok(inside));
}

#[test]
fn the_local_model_has_the_planes_that_hold_it_first_and_then_those_ahead() {
    let room = moving(&inverted(cuboid(Vector3::repeat(0.05))));
    let mut finger = proxy(ProxyConfig { static_friction: 0.3, ..FINGER });
    let device = Point3::new(0.056, 0.045, 0.0);
    stroke(&mut finger, &room, Point3::new(0.0, 0.045, 0.0), device, 60);
    let world_from_surface = Isometry3::from_parts(
        Vector3::new(0.1, -0.2, 0.3).into(),
        UnitQuaternion::from_euler_angles(0.4, -0.2, 1.0),
    );
    let feel = PlaneProperties { stiffness: 420.0, damping: 1.5 };
    let model = finger.local_contact_model(&room, &world_from_surface, &feel, 0.01, SimTime::from_millis(7));
    let tip = model.proxy_in_world.translation;
    assert!((tip - (world_from_surface * finger.position()).coords).norm() < 1e-12);
    let planes: Vec<_> = model.planes.iter().flatten().collect();
    assert_eq!(planes.len(), 2, "{planes:?}");
    for (plane, (wall, gap)) in
        planes.iter().zip([(Vector3::x(), 0.0), (Vector3::y(), 0.005 - hold(&FINGER))])
    {
        assert!((plane.normal_in_world + world_from_surface * wall).norm() < 1e-9);
        // As far above the plane as the finger is from the wall.
        let above = plane.normal_in_world.dot(&(tip - plane.point_in_world.coords));
        assert!((above - gap).abs() < 1e-6, "{above} {gap}");
        assert_eq!((plane.stiffness, plane.damping, plane.friction), (420.0, 1.5, 0.3));
    }
    assert_eq!(model.at, SimTime::from_millis(7));
    let near_sighted =
        finger.local_contact_model(&room, &world_from_surface, &feel, 0.001, SimTime::from_millis(7));
    assert_eq!(near_sighted.planes.iter().flatten().count(), 1);
}

#[test]
fn what_cannot_be_is_named() {
    let refused = |config| FingerProxy::new(config).map(|_| ()).expect_err("refused").to_string();
    let wrong = refused(ProxyConfig { radius: -1.0, ..FINGER });
    assert_eq!(wrong, "a radius of -1: 0 or more, and finite, is valid");
    assert!(refused(ProxyConfig { skin: 0.0, ..FINGER }).contains("a skin of 0"));
    assert!(refused(ProxyConfig { dynamic_friction: 0.1, ..FINGER }).contains("dynamic friction"));
    assert!(refused(ProxyConfig { static_friction: f64::NAN, ..FINGER }).contains("NaN"));
    let mesh = moving(&plate(2, 0.1));
    let mut finger = proxy(FINGER);
    let here = Point3::new(0.0, 0.0, 0.01);
    finger.step(&mesh, &here, 0.001).expect("a finite device");
    let nowhere = finger.step(&mesh, &Point3::new(f64::NAN, 0.0, 0.0), 0.001);
    assert!(matches!(nowhere, Err(ProxyError::NotFinite(_))));
    assert!(finger.step(&mesh, &here, -1.0).is_err());
    assert_eq!(finger.position(), here);
}
