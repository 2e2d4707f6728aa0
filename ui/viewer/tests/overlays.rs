//! Seeing the simulation: what touches, which forces act, how hot tissue is, where tips have been.

use std::sync::Arc;

use crate::support::{Scene, colored, front, grid, mean, picture, renderer};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_scene::{
    BoundingVolumeNode, BoundingVolumeTree, Burn, Collision, CollisionList, Detection, DeviceState, Entity,
    Hand, Instrument, Name, Pose, Primitive, ScalarField, ScalarFields, Shape, Side, SimTime, SurfaceMesh,
    Temperature, VertexPositions,
};
use trocar_viewer::colormap::Colormap;
use trocar_viewer::{Layout, OffscreenRenderer, Overlay, Overlays, Picture, View};

const SIDE: u32 = 256;

/// A wall of 0.2 m in front of the eye: `cells` × `cells` squares, two triangles each.
fn wall(scene: &mut Scene, cells: u32) -> Entity {
    let (corners, triangles) = grid(cells);
    let positions = corners.iter().map(|[u, v]| Point3::new((u - 0.5) * 0.2, 0.0, (v - 0.5) * 0.2)).collect();
    scene.write(|out| {
        let entity = out.spawn();
        out.put(entity, VertexPositions { positions: Arc::new(positions) });
        out.put(entity, SurfaceMesh { triangles: Arc::new(triangles) });
        out.put(entity, Pose::default());
        out.put(entity, colored(0.3, 0.35, 0.4));
        entity
    })
}

fn contact(a: (Entity, Primitive), b: (Entity, Primitive), point: [f64; 3], force: [f64; 3]) -> Collision {
    Collision {
        a: a.0,
        primitive_a: a.1,
        b: b.0,
        primitive_b: b.1,
        points_in_world: [point.into(); 2],
        normal_in_world: Vector3::x(),
        depth: 1e-4,
        force_in_world: force.into(),
        velocity_constraint: 0.0,
        method: Detection::default(),
        detected_at: SimTime::ZERO,
    }
}

fn touch(scene: &mut Scene, collisions: Vec<Collision>) {
    scene.write(|out| {
        let detector = out.spawn();
        out.put(detector, CollisionList { collisions, penetration_max: 0.0 });
    });
}

fn shown(renderer: &mut OffscreenRenderer, scene: &Scene, overlays: &Overlays) -> Picture {
    renderer.renderer_mut().overlays = Overlays { legends: false, ..overlays.clone() };
    picture(renderer, scene, &front(), &Layout::Mono, SIDE)
}

fn pixels() -> impl Iterator<Item = (u32, u32)> {
    (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y)))
}

fn differs(a: [u8; 4], b: [u8; 4]) -> bool {
    (0..3).any(|channel| a[channel].abs_diff(b[channel]) > 8)
}

fn is_red([r, g, b, _]: [u8; 4]) -> bool {
    r > 100 && g < r / 3 && b < r / 3
}

/// How far a point is inside of a triangle \[pixels\]; below 0 outside.
fn depth_in(corners: &[[f64; 2]; 3], [x, y]: [f64; 2]) -> f64 {
    let edge = |a: [f64; 2], b: [f64; 2]| {
        let along = [b[0] - a[0], b[1] - a[1]];
        (along[0] * (y - a[1]) - along[1] * (x - a[0])) / along[0].hypot(along[1])
    };
    let [a, b, c] = *corners;
    let depths = [edge(a, b), edge(b, c), edge(c, a)];
    let turned = edge(a, b).min(edge(b, c)).min(edge(c, a));
    let other = depths.map(|depth| -depth).into_iter().fold(f64::MAX, f64::min);
    turned.max(other)
}

fn in_picture(view: &View, point: Point3<f64>) -> [f64; 2] {
    view.project(&point).expect("in front").0.map(|share| share * f64::from(SIDE))
}

#[test]
fn exactly_the_triangles_that_touch_are_red() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    scene.light();
    let (wall, ball) = (wall(&mut scene, 5), scene.write(|out| out.spawn()));
    let before = shown(&mut renderer, &scene, &Overlays::default());
    // Square (3, 1): its first triangle; named twice, as two contacts of one triangle are.
    let index = 2 * (5 + 3);
    let touching =
        contact((wall, Primitive::Triangle(index)), (ball, Primitive::Shape(0)), [0.0; 3], [0.0; 3]);
    touch(&mut scene, vec![touching, touching]);
    let after = shown(&mut renderer, &scene, &Overlays::of(&[Overlay::Contacts]));
    let at = |column: f64, row: f64| Point3::new((column / 5.0 - 0.5) * 0.2, 0.0, (row / 5.0 - 0.5) * 0.2);
    let corners = [at(3.0, 1.0), at(4.0, 1.0), at(4.0, 2.0)].map(|point| in_picture(&front(), point));
    let (mut inside, mut outside) = (0, 0);
    for (x, y) in pixels() {
        let depth = depth_in(&corners, [f64::from(x) + 0.5, f64::from(y) + 0.5]);
        let (old, new) = (before.at(x, y).unwrap(), after.at(x, y).unwrap());
        if depth > 1.0 {
            assert!(is_red(new) && !is_red(old), "{x} {y}: {new:?}");
            inside += 1;
        } else if depth < -1.0 {
            assert_eq!(old, new, "{x} {y}");
            outside += 1;
        }
    }
    assert!(inside > 500 && outside > 50_000, "{inside} {outside}");
}

#[test]
fn what_touches_a_smooth_shape_is_a_red_spot_on_its_surface() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    scene.light();
    let ball = scene.shape(Shape::Sphere { radius: 0.05 }, Pose::default(), colored(0.3, 0.35, 0.4));
    let other = scene.write(|out| out.spawn());
    let point = [0.0, -0.05, 0.0];
    touch(&mut scene, vec![contact((ball, Primitive::Shape(0)), (other, Primitive::Shaft), point, [0.0; 3])]);
    let overlays = Overlays { spot_radius: 0.01, ..Overlays::of(&[Overlay::Contacts]) };
    let seen = shown(&mut renderer, &scene, &overlays);
    let red = pixels().filter(|(x, y)| seen.at(*x, *y).is_some_and(is_red)).count();
    // A disc of 1 cm at 0.25 m; the picture is 2 tan(0.4) × 0.25 m high.
    let radius = 0.01 / (2.0 * 0.4_f64.tan() * 0.25) * f64::from(SIDE);
    let expected = std::f64::consts::PI * radius * radius;
    assert!((red as f64 / expected - 1.0).abs() < 0.2, "{red} {expected}");
    let [x, y] = in_picture(&view, point.into()).map(|part| part as u32);
    assert!(is_red(seen.at(x, y).unwrap()));
}

#[test]
fn a_contact_inside_of_matter_shows_through_faintly() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    scene.light();
    let back = scene.shape(Shape::Sphere { radius: 0.02 }, Pose::at(0.0, 0.1, 0.0), colored(0.3, 0.35, 0.4));
    let other = scene.write(|out| out.spawn());
    let point = [0.0, 0.08, 0.0];
    touch(&mut scene, vec![contact((back, Primitive::Shape(0)), (other, Primitive::Shaft), point, [0.0; 3])]);
    let overlays = Overlays { spot_radius: 0.01, ..Overlays::of(&[Overlay::Contacts]) };
    let reddened = |picture: &Picture| {
        let [r, g, _] = mean(picture, 126, 126, 4, 4);
        r - g
    };
    let open = reddened(&shown(&mut renderer, &scene, &overlays));
    scene.shape(Shape::Box { half_extents: [0.2, 0.01, 0.2] }, Pose::default(), colored(0.4, 0.4, 0.4));
    let plain = reddened(&shown(&mut renderer, &scene, &Overlays::default()));
    let through = reddened(&shown(&mut renderer, &scene, &overlays));
    assert!(through > plain + 25.0 && through < 0.8 * open, "{plain} {through} {open}");
}

#[test]
fn an_arrow_is_as_long_as_the_force_is_strong() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    let [a, b] = [0, 1].map(|_| scene.write(|out| out.spawn()));
    let force = [2.0, 0.0, 0.0];
    touch(&mut scene, vec![contact((a, Primitive::Shape(0)), (b, Primitive::Shape(0)), [0.0; 3], force)]);
    let overlays = Overlays { metres_per_newton: 0.02, ..Overlays::of(&[Overlay::Forces]) };
    let empty = shown(&mut renderer, &scene, &Overlays::default());
    let seen = shown(&mut renderer, &scene, &overlays);
    let columns: Vec<u32> = pixels()
        .filter(|(x, y)| differs(empty.at(*x, *y).unwrap(), seen.at(*x, *y).unwrap()))
        .map(|(x, _)| x)
        .collect();
    let (first, last) =
        (f64::from(*columns.iter().min().unwrap()), f64::from(*columns.iter().max().unwrap()));
    let [from, to] = [0.0, 0.04].map(|x| in_picture(&view, Point3::new(x, 0.0, 0.0))[0]);
    // Lines end in half their width.
    assert!((first - from).abs() < 3.0 && (last + 1.0 - to).abs() < 2.0, "{first} {last}, {from} {to}");
    assert_eq!(renderer.renderer().legends()[0].unit, "1 N = 20 mm");
}

#[test]
fn the_hands_force_stands_at_the_tip_in_the_axes_of_the_world() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    scene.write(|out| {
        let (instrument, hand) = (out.spawn(), out.spawn());
        out.put(instrument, Pose::at(0.0, 0.0, -0.05));
        // The device's x axis points upwards in the world.
        let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -std::f64::consts::FRAC_PI_2);
        let world_from_device = Pose::new(Vector3::new(0.5, 0.0, 0.0), turned);
        out.put(hand, Hand { side: Side::Left, instrument, world_from_device, scale: 1.0 });
        out.put(hand, DeviceState { applied_force: Vector3::new(3.0, 0.0, 0.0), ..DeviceState::default() });
    });
    let empty = shown(&mut renderer, &scene, &Overlays::default());
    let seen = shown(&mut renderer, &scene, &Overlays::of(&[Overlay::HandForces]));
    let drawn: Vec<(u32, u32)> =
        pixels().filter(|(x, y)| differs(empty.at(*x, *y).unwrap(), seen.at(*x, *y).unwrap())).collect();
    let [x, lower] = in_picture(&view, Point3::new(0.0, 0.0, -0.05));
    let [_, upper] = in_picture(&view, Point3::new(0.0, 0.0, -0.02));
    let rows = drawn.iter().map(|(_, y)| f64::from(*y) + 0.5);
    assert!((rows.clone().fold(f64::MAX, f64::min) - upper).abs() < 2.0);
    assert!((rows.fold(0.0, f64::max) - lower).abs() < 3.0);
    assert!(drawn.iter().all(|(column, _)| (f64::from(*column) + 0.5 - x).abs() < 4.0));
}

#[test]
fn a_wireframe_lies_on_the_edges_and_nowhere_else() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    wall(&mut scene, 2);
    let before = shown(&mut renderer, &scene, &Overlays::default());
    let overlays = Overlays { line_width: 4.0, ..Overlays::of(&[Overlay::Wireframe]) };
    let after = shown(&mut renderer, &scene, &overlays);
    let changed = |point: Point3<f64>| {
        let [x, y] = in_picture(&view, point).map(|part| part as u32);
        differs(before.at(x, y).unwrap(), after.at(x, y).unwrap())
    };
    for [x, z] in [[0.0, 0.05], [0.05, 0.0], [0.05, 0.05], [-0.05, -0.05], [-0.1, 0.03]] {
        assert!(changed(Point3::new(x, 0.0, z)), "{x} {z}");
    }
    for [x, z] in [[0.07, 0.03], [0.03, 0.07], [-0.03, -0.07]] {
        assert!(!changed(Point3::new(x, 0.0, z)), "{x} {z}");
    }
}

#[test]
fn temperatures_have_the_colours_of_their_scale_and_the_scale_stands_in_the_picture() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    scene.light();
    let (cells, map) = (10_u32, Colormap::Inferno);
    let tissue = wall(&mut scene, cells);
    let row = cells + 1;
    let celsius = (0..row * row).map(|vertex| 20.0 + 80.0 * f64::from(vertex % row) / f64::from(cells));
    scene.write(|out| out.put(tissue, Temperature { celsius: Arc::new(celsius.collect()) }));
    let seen = shown(&mut renderer, &scene, &Overlays::of(&[Overlay::Temperature]));
    // Shaded a little, so by hue: the proportions of the channels, in light rather than in bytes.
    let light = |color: [u8; 3]| {
        let linear = color.map(|byte| (f64::from(byte) / 255.0).powf(2.2));
        linear.map(|channel| channel / linear.iter().sum::<f64>().max(1e-9))
    };
    for share in [0.3, 0.5, 0.7, 0.9] {
        let [x, y] = in_picture(&view, Point3::new((share - 0.5) * 0.2, 0.0, 0.03)).map(|part| part as u32);
        let [r, g, b, _] = seen.at(x, y).unwrap();
        let (found, expected) = (light([r, g, b]), light(map.color(share)));
        let off = (0..3).map(|channel| (found[channel] - expected[channel]).abs()).fold(0.0, f64::max);
        assert!(off < 0.05, "{share}: {found:?} {expected:?}");
    }
    renderer.renderer_mut().overlays.legends = true;
    let with_legend = picture(&mut renderer, &scene, &view, &Layout::Mono, SIDE);
    let legend = &renderer.renderer().legends()[0];
    assert_eq!((legend.caption().as_str(), legend.range), ("temperature [°C]", Some([20.0, 100.0])));
    let lower_left = |(x, y): &(u32, u32)| *x < SIDE * 3 / 4 && *y > SIDE * 3 / 4;
    for color in [map.color(0.25), map.color(0.5), map.color(0.75)] {
        let near = |picture: &Picture| {
            pixels()
                .filter(lower_left)
                .filter(|(x, y)| (0..3).all(|k| picture.at(*x, *y).unwrap()[k].abs_diff(color[k]) <= 6))
                .count()
        };
        assert!(near(&with_legend) >= 4, "{color:?}");
    }
    let differ = |(x, y): &(u32, u32)| differs(seen.at(*x, *y).unwrap(), with_legend.at(*x, *y).unwrap());
    let changed: Vec<(u32, u32)> = pixels().filter(differ).collect();
    assert!(changed.len() > 500 && changed.iter().all(lower_left));
}

#[test]
fn burns_and_named_fields_are_shown_with_ranges_of_their_own() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    let tissue = wall(&mut scene, 1);
    let field = |name: &str, unit: &str, values: [f64; 4], range| ScalarField {
        name: name.into(),
        unit: unit.into(),
        values: Arc::new(values.to_vec()),
        range,
    };
    scene.write(|out| {
        out.put(tissue, Burn { omega: Arc::new(vec![0.0, 1.0, 1e3, 0.0]) });
        let stress = field("stress", "kPa", [0.0, 10.0, 30.0, 5.0], None);
        let strain = field("strain", "", [0.0; 4], Some([0.0, 0.5]));
        out.put(tissue, ScalarFields { fields: vec![stress, strain] });
    });
    let plain = shown(&mut renderer, &scene, &Overlays::default());
    let mut told = |overlays: &Overlays| {
        let seen = shown(&mut renderer, &scene, overlays);
        assert_ne!(seen.color, plain.color);
        let legends = renderer.renderer().legends();
        legends.iter().map(|legend| (legend.caption(), legend.range)).collect::<Vec<_>>()
    };
    assert_eq!(
        told(&Overlays::parse("burn").unwrap()),
        [("denatured protein [%]".to_owned(), Some([0.0, 100.0]))]
    );
    assert_eq!(told(&Overlays::parse("field").unwrap()), [("stress [kPa]".to_owned(), Some([0.0, 30.0]))]);
    assert_eq!(told(&Overlays::parse("field=strain").unwrap()), [("strain".to_owned(), Some([0.0, 0.5]))]);
}

#[test]
fn a_trail_lies_where_the_tip_has_been_and_ends_with_its_time() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    let tool = scene.write(|out| {
        let tool = out.spawn();
        out.put(tool, Instrument::default());
        out.put(tool, Pose::at(-0.06, 0.0, 0.05));
        tool
    });
    renderer.renderer_mut().overlays = Overlays { trail_secs: 1.0, ..Overlays::of(&[Overlay::Trails]) };
    let aside = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    for step in 0..=60 {
        let x = -0.06 + 0.002 * f64::from(step);
        scene.at_secs(f64::from(step) * 0.02);
        scene.write(|out| out.put(tool, Pose::new(Vector3::new(x, 0.0, 0.05), aside)));
        renderer.renderer_mut().watch(&scene.view());
    }
    let overlays = renderer.renderer().overlays.clone();
    let seen = shown(&mut renderer, &scene, &overlays);
    let plain = shown(&mut renderer, &scene, &Overlays::default());
    let drawn = |picture: &Picture, x: f64| {
        let [x, y] = in_picture(&view, Point3::new(x, 0.0, 0.05)).map(|part| part as u32);
        let difference = |row: u32| {
            let (a, b) = (plain.at(x, row).unwrap(), picture.at(x, row).unwrap());
            (0..3).map(|channel| u32::from(a[channel].abs_diff(b[channel]))).sum::<u32>()
        };
        (y - 1..=y + 1).map(difference).max().unwrap()
    };
    // It began at −0.06 m, 1.2 s ago; a second reaches back to −0.04 m.
    assert_eq!(drawn(&seen, -0.05), 0);
    let (old, new) = (drawn(&seen, -0.02), drawn(&seen, 0.03));
    assert!(old > 20 && new > old + 50, "{old} {new}");
}

#[test]
fn boxes_axes_and_names_stand_where_things_are() {
    let (mut scene, mut renderer, view) = (Scene::new(), renderer(), front());
    let cube = Shape::Box { half_extents: [0.03, 0.03, 0.03] };
    let body = scene.shape(cube, Pose::at(0.02, 0.0, 0.0), colored(0.2, 0.2, 0.2));
    scene.write(|out| out.put(body, Name("liver".into())));
    let plain = shown(&mut renderer, &scene, &Overlays::default());
    let changed_at = |picture: &Picture, point: [f64; 3]| {
        let [x, y] = in_picture(&view, point.into()).map(|part| part as u32);
        (y - 1..=y + 1).any(|row| differs(plain.at(x, row).unwrap(), picture.at(x, row).unwrap()))
    };
    let boxes = shown(&mut renderer, &scene, &Overlays::of(&[Overlay::Boxes]));
    // The upper front edge of the box around it, and not the middle of its face.
    assert!(changed_at(&boxes, [0.02, -0.03, 0.03]) && !changed_at(&boxes, [0.03, -0.03, 0.01]));
    // A tree is shown instead, down to its leaves.
    let node = |x: [f64; 2], first, primitives| BoundingVolumeNode {
        min: Point3::new(x[0], -0.03, -0.03),
        max: Point3::new(x[1], 0.03, 0.03),
        first,
        primitives,
    };
    let nodes = vec![node([-0.03, 0.03], 1, 0), node([-0.03, 0.005], 0, 2), node([0.005, 0.03], 2, 2)];
    scene.write(|out| out.put(body, BoundingVolumeTree { nodes: Arc::new(nodes) }));
    let tree = shown(&mut renderer, &scene, &Overlays::of(&[Overlay::Boxes]));
    assert!(changed_at(&tree, [0.025, -0.03, 0.01]), "the edge between the leaves");
    let axes =
        shown(&mut renderer, &scene, &Overlays { axis_length: 0.05, ..Overlays::of(&[Overlay::Axes]) });
    assert!(changed_at(&axes, [0.065, 0.0, 0.0]) && changed_at(&axes, [0.02, 0.0, 0.045]));
    let names = shown(&mut renderer, &scene, &Overlays::of(&[Overlay::Names]));
    let written: Vec<(u32, u32)> =
        pixels().filter(|(x, y)| differs(plain.at(*x, *y).unwrap(), names.at(*x, *y).unwrap())).collect();
    let [x, y] = in_picture(&view, Point3::new(0.02, 0.0, 0.0));
    let middle = |pick: fn(&(u32, u32)) -> u32| {
        let all = written.iter().map(pick);
        0.5 * f64::from(all.clone().min().unwrap() + all.max().unwrap() + 1)
    };
    assert!((middle(|at| at.0) - x).abs() < 3.0 && (middle(|at| at.1) - y).abs() < 3.0);
}

#[test]
fn what_is_hidden_costs_nothing_and_what_is_still_is_sent_once() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    let wall = wall(&mut scene, 4);
    let values = Arc::new(vec![50.0; 25]);
    scene.write(|out| out.put(wall, Temperature { celsius: values }));
    let plain = shown(&mut renderer, &scene, &Overlays::default());
    assert_eq!(renderer.renderer().overlay_bytes_sent(), 0);
    let all = Overlays::of(&Overlay::ALL);
    shown(&mut renderer, &scene, &all);
    let sent = renderer.renderer().overlay_bytes_sent();
    assert!(sent > 0);
    shown(&mut renderer, &scene, &all);
    assert_eq!(renderer.renderer().overlay_bytes_sent(), sent);
    // A pose that changes sends no quantity and no edges again: a line of a frame of reference has 40 bytes.
    scene.write(|out| out.put(wall, Pose::at(0.0, 0.01, 0.0)));
    shown(&mut renderer, &scene, &Overlays::of(&[Overlay::Temperature, Overlay::Wireframe, Overlay::Axes]));
    let moved = renderer.renderer().overlay_bytes_sent() - sent;
    assert!((40..400).contains(&moved), "{moved}");
    scene.write(|out| out.put(wall, Pose::default()));
    assert_eq!(shown(&mut renderer, &scene, &Overlays::default()).color, plain.color);
}

#[test]
fn contacts_of_what_does_not_exist_are_left_out() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    let wall = wall(&mut scene, 1);
    let gone = Entity::new(9, 9, 9);
    let primitives = [
        Primitive::Triangle(u32::MAX),
        Primitive::Tetrahedron(3),
        Primitive::Segment(0),
        Primitive::Vertex(u32::MAX),
        Primitive::Jaw(7),
    ];
    let collisions =
        primitives.map(|primitive| contact((wall, primitive), (gone, primitive), [0.5; 3], [0.0; 3]));
    touch(&mut scene, collisions.to_vec());
    let plain = shown(&mut renderer, &scene, &Overlays::default());
    let seen = shown(&mut renderer, &scene, &Overlays::of(&[Overlay::Contacts]));
    assert_eq!(plain.color, seen.color);
}
