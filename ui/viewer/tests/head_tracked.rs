//! A screen as a window into the scene: whoever writes the pose of the head moves the eye.

use crate::support::{Scene, middle_column, renderer};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_scene::{Pose, Scenario};
use trocar_viewer::layout::{Stereo, Tile, TileView};
use trocar_viewer::{Layout, Pane, View, ViewError};

/// A screen of 0.48 m × 0.32 m that shows 0.12 m × 0.08 m of the scene; it stands upright in the world's origin, seen along
/// +y. A red ball is 2 cm behind it, a blue one 1 cm before it, both a centimetre to the right,
/// the red one above the blue one.
const SCENARIO: &str = r#"
schema = 1
name = "window"
title = "A window"
description = "Two balls behind and before a screen."

[[entity]]
name = "window"
camera = { near = 0.01, far = 1.0, field_of_view = 0.5 }
pose = { translation = [0.0, 0.0, 0.0], rotation = [-0.7071067811865476, 0.0, 0.0, 0.7071067811865476] }
head_tracked = { head = "head", screen = [0.48, 0.32], scale = 0.25, interocular = 0.06 }

[[entity]]
name = "head"
parent = "window"
pose = { translation = [0.0, 0.0, -0.6] }

[[entity]]
name = "behind"
shape = { sphere = { radius = 0.003 } }
pose = { translation = [0.01, 0.02, 0.012] }
visual_material = { base_color = [1.0, 0.02, 0.02, 1.0] }

[[entity]]
name = "before"
shape = { sphere = { radius = 0.003 } }
pose = { translation = [0.01, -0.01, -0.012] }
visual_material = { base_color = [0.02, 0.02, 1.0, 1.0] }

[[entity]]
name = "light"
light = { intensity = 1.0, shadows = false }
pose = { translation = [0.0, -0.3, 0.2] }
"#;

/// What the scene has for the screen's width and height \[m\].
const SHOWN: [f64; 2] = [0.12, 0.08];

fn scene() -> (Scene, Scenario) {
    Scene::of_scenario(SCENARIO)
}

fn view(scene: &Scene) -> View {
    View::named(&scene.view(), "window", None).expect("a view")
}

fn move_head(scene: &mut Scene, scenario: &Scenario, pose: Pose) {
    let head = scenario.entity("head").expect("a head");
    scene.write(|out| out.put(head, pose));
}

/// The column, from 0 to 1, in which an eye in the frame of the shrunken screen sees a point of that frame.
fn column(renderer: Vector3<f64>, point: Vector3<f64>) -> f64 {
    let on_screen = renderer.x + (point.x - renderer.x) * renderer.z / (renderer.z - point.z);
    0.5 + on_screen / SHOWN[0]
}

#[test]
fn moving_the_head_moves_what_is_seen_as_a_window_would() {
    let (mut scene, scenario) = scene();
    let mut renderer = renderer();
    let is_red = |[r, _, b, _]: [u8; 4]| r > 60 && b < r / 2;
    let is_blue = |[r, _, b, _]: [u8; 4]| b > 60 && r < b / 2;
    let size = [384, 256];
    let mut seen = Vec::new();
    for x in [0.0, 0.15, -0.3] {
        move_head(&mut scene, &scenario, Pose::at(x, 0.02, -0.6));
        let view = view(&scene);
        let picture = renderer.picture(&scene.view(), &view, &Layout::Mono, size).expect("a picture");
        // A quarter of the size: so is the head's distance.
        let renderer = 0.25 * Vector3::new(x, 0.02, -0.6);
        let columns = [
            (middle_column(&picture, is_red).expect("the red ball"), 0.02),
            (middle_column(&picture, is_blue).expect("the blue ball"), -0.01),
        ];
        for (middle, depth) in columns {
            let expected = column(renderer, Vector3::new(0.01, 0.0, depth)) * f64::from(size[0]);
            assert!((middle - expected).abs() < 1.0, "{x} {depth}: {middle}, expected {expected}");
        }
        seen.push(columns.map(|(middle, _)| middle));
    }
    // What is behind goes along with the head, what is before goes against it.
    assert!(seen[1][0] > seen[0][0] + 4.0 && seen[2][0] < seen[0][0] - 8.0, "{seen:?}");
    assert!(seen[1][1] < seen[0][1] - 4.0 && seen[2][1] > seen[0][1] + 8.0, "{seen:?}");
}

#[test]
fn the_two_eyes_of_the_head_look_through_the_same_window() {
    let (mut scene, scenario) = scene();
    let turned = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 0.6);
    move_head(&mut scene, &scenario, Pose::new(Vector3::new(0.1, 0.0, -0.5), turned));
    let snapshot = scene.view();
    let layout = Layout::SideBySide(Stereo { interocular: 9.0, convergence: 0.1 });
    let shots = layout.shots(&snapshot, &view(&scene), [400, 200]);
    for (shot, side) in shots.iter().zip([-1.0, 1.0]) {
        let [seen] = shot.eyes.as_slice() else { panic!("one eye in each half") };
        let in_head = Vector3::new(side * 0.03, 0.0, 0.0);
        let renderer = 0.25 * (Vector3::new(0.1, 0.0, -0.5) + turned * in_head);
        // The world's axes: x is the screen's, −z its y, y its z.
        let point = Vector3::new(0.01, 0.0, 0.02);
        let ([x, _], _) = seen.project(&Point3::new(point.x, point.z, -point.y)).expect("in front");
        assert!((x - column(renderer, point)).abs() < 1e-12, "{x}");
        for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)] {
            let corner = Point3::new((x - 0.5) * SHOWN[0], 0.0, (0.5 - y) * SHOWN[1]);
            let (at, _) = seen.project(&corner).expect("in front");
            assert!((at[0] - x).abs() < 1e-9 && (at[1] - y).abs() < 1e-9, "{at:?}");
        }
    }
}

#[test]
fn a_screen_in_a_pane_of_another_shape_keeps_its_height() {
    let (mut scene, scenario) = scene();
    move_head(&mut scene, &scenario, Pose::at(0.2, -0.1, -0.6));
    let window = scenario.entity("window").expect("a camera");
    let half = Tile::new(Pane { x: 0.5, y: 0.0, width: 0.5, height: 1.0 }, TileView::Camera(window));
    let shots = Layout::Tiles(vec![half]).shots(&scene.view(), &view(&scene), [300, 200]);
    let asked = View::through(&scene.view(), window, Some(0.75)).expect("a view");
    for view in [shots[0].centre, asked] {
        let corner = Point3::new(0.5 * 0.75 * SHOWN[1], 0.0, 0.5 * SHOWN[1]);
        let (at, _) = view.project(&corner).expect("in front");
        assert!((at[0] - 1.0).abs() < 1e-9 && at[1].abs() < 1e-9, "{at:?}");
    }
}

#[test]
fn without_a_head_one_looks_from_the_middle() {
    let (mut scene, scenario) = scene();
    let head = scenario.entity("head").expect("a head");
    scene.write(|out| out.despawn(head));
    let view = view(&scene);
    assert_eq!(view.lens.shift, [0.0; 2]);
    assert!((view.lens.field_of_view - 0.5).abs() < 1e-12 && (view.lens.aspect - 1.5).abs() < 1e-12);
    let [left, right] = view.stereo(1.0, 1.0);
    let between = left.world_from_eye.translation.vector - right.world_from_eye.translation.vector;
    assert!((between.norm() - 0.25 * 0.06).abs() < 1e-12);
    let refused = View::named(&scene.view(), "door", None).expect_err("no such camera");
    assert!(
        matches!(refused, ViewError::NoCamera { .. }) && refused.to_string().contains("window"),
        "{refused}"
    );
}
