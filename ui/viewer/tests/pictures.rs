//! Pictures of small scenes: what is where, in which colour, how far away.

use crate::support::{Scene, colored, front, mean, middle_column, picture, renderer};
use trocar_scene::{Light, Pose, Shape};
use trocar_viewer::gpu::{Gpu, targets};
use trocar_viewer::layout::Stereo;
use trocar_viewer::pacing::Pace;
use trocar_viewer::{Layout, Picture, Quality, Renderer, View, ViewError};

const SPHERE: Shape = Shape::Sphere { radius: 0.03 };

#[test]
fn the_nearer_of_two_things_is_seen_whatever_the_order_in_which_they_came() {
    for near_first in [true, false] {
        let mut scene = Scene::new();
        scene.light();
        let mut spheres = [(-0.1, colored(1.0, 0.02, 0.02)), (0.1, colored(0.02, 0.02, 1.0))];
        if !near_first {
            spheres.reverse();
        }
        for (y, material) in spheres {
            scene.shape(SPHERE, Pose::at(0.0, y, 0.0), material);
        }
        let picture = picture(&mut renderer(), &scene, &front(), &Layout::Mono, 128);
        let [r, _, b] = mean(&picture, 60, 60, 8, 8);
        assert!(r > 2.0 * b, "{r} {b}");
    }
}

#[test]
fn depth_and_segmentation_say_how_far_away_what_is() {
    let mut scene = Scene::new();
    let left = scene.shape(SPHERE, Pose::at(-0.05, 0.0, 0.0), colored(1.0, 1.0, 1.0));
    let right = scene.shape(SPHERE, Pose::at(0.05, 0.1, 0.0), colored(1.0, 1.0, 1.0));
    let (view, side) = (front(), 256);
    let probe = renderer().probe(&scene.view(), &view, [side, side]).unwrap();
    for (entity, centre) in [(left, [-0.05, 0.0, 0.0]), (right, [0.05, 0.1, 0.0])] {
        let (at, depth) = view.project(&centre.into()).unwrap();
        let [x, y] = at.map(|share| (share * f64::from(side)) as u32);
        assert_eq!(probe.entity(x, y), Some(entity));
        // Along the line to its centre the surface is one radius before it; the ray is not far from the axis.
        let seen = f64::from(probe.depth[(y * side + x) as usize]);
        let along = (nalgebra::Point3::from(centre) - view.ray(at).0).norm();
        let expected = depth * (along - 0.03) / along;
        assert!((seen - expected).abs() < 5e-4, "{seen} {expected}");
    }
    assert_eq!(probe.entity(0, 0), None);
    assert_eq!(probe.depth[0], f32::INFINITY);
}

#[test]
fn what_moves_is_seen_elsewhere_and_what_is_gone_is_not_seen() {
    let mut scene = Scene::new();
    scene.light();
    let ball = scene.shape(SPHERE, Pose::at(-0.06, 0.0, 0.0), colored(1.0, 0.02, 0.02));
    let (mut renderer, view) = (renderer(), front());
    let is_red = |[r, g, _, _]: [u8; 4]| r > 60 && g < r / 2;
    let before = middle_column(&picture(&mut renderer, &scene, &view, &Layout::Mono, 128), is_red).unwrap();
    scene.write(|out| out.put(ball, Pose::at(0.06, 0.0, 0.0)));
    let after = middle_column(&picture(&mut renderer, &scene, &view, &Layout::Mono, 128), is_red).unwrap();
    assert!((before + after - 128.0).abs() < 2.0 && after - before > 40.0, "{before} {after}");
    scene.write(|out| out.despawn(ball));
    assert_eq!(middle_column(&picture(&mut renderer, &scene, &view, &Layout::Mono, 128), is_red), None);
}

#[test]
fn eyes_side_by_side_and_above_each_other_see_the_parallax_of_the_formula() {
    let mut scene = Scene::new();
    scene.light();
    scene.shape(Shape::Sphere { radius: 0.01 }, Pose::at(0.0, -0.1, 0.0), colored(1.0, 0.02, 0.02));
    let view = front();
    let stereo = Stereo { interocular: 0.03, convergence: 0.3 };
    let is_red = |[r, g, _, _]: [u8; 4]| r > 60 && g < r / 2;
    let (side, mut renderer) = (256, renderer());
    let depth: f64 = 0.2;
    let width_at_1 = 2.0 * (0.5 * view.lens.field_of_view).tan() * view.lens.aspect;
    let expected = stereo.interocular * (1.0 / stereo.convergence - 1.0 / depth) / width_at_1;
    for (layout, panes) in [
        (Layout::SideBySide(stereo), [[0, 0, 128, 256], [128, 0, 128, 256]]),
        (Layout::TopBottom(stereo), [[0, 0, 256, 128], [0, 128, 256, 128]]),
    ] {
        let picture = picture(&mut renderer, &scene, &view, &layout, side);
        let seen = panes.map(|[left, top, width, height]| {
            let (mut sum, mut count) = (0.0, 0.0);
            for (x, y) in (left..left + width).flat_map(|x| (top..top + height).map(move |y| (x, y))) {
                if picture.at(x, y).is_some_and(is_red) {
                    sum += f64::from(x - left) + 0.5;
                    count += 1.0;
                }
            }
            sum / count / f64::from(width)
        });
        assert!((seen[1] - seen[0] - expected).abs() < 0.01, "{layout:?}: {seen:?}, expected {expected}");
    }
}

#[test]
fn interleaved_rows_alternate_between_the_eyes() {
    let mut scene = Scene::new();
    scene.light();
    scene.shape(Shape::Sphere { radius: 0.01 }, Pose::at(0.0, -0.1, 0.0), colored(1.0, 0.02, 0.02));
    let (view, mut renderer) = (front(), renderer());
    let stereo = Stereo { interocular: 0.05, convergence: 0.3 };
    let woven = picture(&mut renderer, &scene, &view, &Layout::RowInterleaved(stereo), 128);
    let [left, right] = view.stereo(stereo.interocular, stereo.convergence);
    for (parity, one) in [(0, left), (1, right)] {
        let alone = picture(&mut renderer, &scene, &one, &Layout::Mono, 128);
        for y in (0..128).filter(|y| y % 2 == parity) {
            for x in 0..128 {
                let (a, b) = (woven.at(x, y).unwrap(), alone.at(x, y).unwrap());
                let close = (0..3).all(|channel| a[channel].abs_diff(b[channel]) <= 3);
                assert!(close, "row {y}, column {x}: {a:?} {b:?}");
            }
        }
    }
}

#[test]
fn an_anaglyph_is_red_from_the_left_and_cyan_from_the_right() {
    let mut scene = Scene::new();
    scene.light();
    scene.shape(Shape::Sphere { radius: 0.01 }, Pose::at(0.0, -0.1, 0.0), colored(1.0, 1.0, 1.0));
    let stereo = Stereo { interocular: 0.08, convergence: 0.3 };
    let picture = picture(&mut renderer(), &scene, &front(), &Layout::Anaglyph(stereo), 256);
    let is_red = |[r, g, _, _]: [u8; 4]| r > 90 && g < 60;
    let is_cyan = |[r, g, b, _]: [u8; 4]| g > 90 && b > 90 && r < 60;
    let (red, cyan) = (middle_column(&picture, is_red).unwrap(), middle_column(&picture, is_cyan).unwrap());
    // Nearer than the convergence: the left eye sees it further to the right.
    assert!(red > cyan + 10.0, "{red} {cyan}");
}

#[test]
fn a_shadow_lies_behind_what_throws_it() {
    let mut scene = Scene::new();
    let floor = Shape::Box { half_extents: [0.3, 0.3, 0.005] };
    scene.shape(floor, Pose::at(0.0, 0.0, -0.055), colored(0.8, 0.8, 0.8));
    scene.shape(Shape::Sphere { radius: 0.015 }, Pose::at(0.0, 0.0, 0.0), colored(0.8, 0.8, 0.8));
    let down = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), std::f64::consts::PI);
    scene.write(|out| {
        let light = out.spawn();
        out.put(light, Light { cone_angle: 0.8, ..Light::default() });
        out.put(light, Pose::new(nalgebra::Vector3::new(0.0, 0.0, 0.25), down));
    });
    let eye_at = nalgebra::Point3::new(0.0, -0.25, 0.12);
    let view = View::looking_at(
        eye_at,
        nalgebra::Point3::new(0.0, 0.0, -0.05),
        nalgebra::Vector3::z(),
        front().lens,
    );
    let (mut renderer, side) = (renderer(), 256);
    let brightness = |renderer: &mut trocar_viewer::OffscreenRenderer, point: [f64; 3]| {
        let picture = picture(renderer, &scene, &view, &Layout::Mono, side);
        let [x, y] = view.project(&point.into()).unwrap().0.map(|share| (share * f64::from(side)) as u32);
        mean(&picture, x - 1, y - 1, 3, 3).iter().sum::<f64>()
    };
    // Under the ball, seen past it, and the same distance from the light beside it.
    let (shaded, lit) = ([0.0, -0.012, -0.05], [0.05, -0.012, -0.05]);
    assert!(brightness(&mut renderer, shaded) < 0.6 * brightness(&mut renderer, lit));
    renderer.quality = Quality { shadows: false, ..renderer.quality };
    assert!(brightness(&mut renderer, shaded) > 0.8 * brightness(&mut renderer, lit));
}

#[test]
fn shadows_follow_what_throws_them_from_frame_to_frame() {
    let mut scene = Scene::new();
    let floor = Shape::Box { half_extents: [0.3, 0.3, 0.005] };
    let gray = || colored(0.8, 0.8, 0.8);
    scene.shape(floor, Pose::at(0.0, 0.0, -0.055), gray());
    scene.shape(Shape::Sphere { radius: 0.01 }, Pose::at(-0.06, 0.0, 0.0), gray());
    let ball = scene.shape(Shape::Sphere { radius: 0.015 }, Pose::at(0.0, 0.0, 0.0), gray());
    let down = nalgebra::UnitQuaternion::from_axis_angle(&nalgebra::Vector3::x_axis(), std::f64::consts::PI);
    scene.write(|out| {
        let light = out.spawn();
        out.put(light, Light { cone_angle: 0.8, ..Light::default() });
        out.put(light, Pose::new(nalgebra::Vector3::new(0.0, 0.0, 0.25), down));
    });
    let eye_at = nalgebra::Point3::new(0.0, -0.25, 0.12);
    let middle = nalgebra::Point3::new(0.0, 0.0, -0.05);
    let view = View::looking_at(eye_at, middle, nalgebra::Vector3::z(), front().lens);
    let mut kept = renderer();
    // It moves, rests long enough to count as still, and moves on: an eye that has looked on all the time sees what one sees
    // that has just come.
    let places = (0..14).map(|step| 0.004 * f64::from(step));
    let places = places.chain([0.052; 14]).chain((0..6).map(|step| 0.052 - 0.012 * f64::from(step)));
    for (step, x) in places.enumerate() {
        scene.write(|out| out.put(ball, Pose::at(x, 0.0, 0.0)));
        let seen = picture(&mut kept, &scene, &view, &Layout::Mono, 96);
        if step % 3 == 0 || step > 27 {
            let anew = picture(&mut renderer(), &scene, &view, &Layout::Mono, 96);
            assert_eq!(seen.color, anew.color, "step {step}");
        }
    }
}

#[test]
fn a_lens_bends_the_picture_as_it_says_and_darkens_its_corners() {
    let mut scene = Scene::new();
    scene.light();
    scene.shape(
        Shape::Box { half_extents: [0.5, 0.005, 0.5] },
        Pose::at(0.0, 0.2, 0.0),
        colored(0.8, 0.8, 0.8),
    );
    scene.shape(Shape::Sphere { radius: 0.006 }, Pose::at(0.06, 0.0, 0.0), colored(1.0, 0.02, 0.02));
    let (mut renderer, side, view) = (renderer(), 256, front());
    let is_red = |[r, g, _, _]: [u8; 4]| r > 60 && g < r / 2;
    let straight = picture(&mut renderer, &scene, &view, &Layout::Mono, side);
    let bent =
        picture(&mut renderer, &scene, &View { distortion: 0.3, vignette: 0.8, ..view }, &Layout::Mono, side);
    let offset = |picture| middle_column(picture, is_red).unwrap() / f64::from(side) * 2.0 - 1.0;
    let (before, after) = (offset(&straight), offset(&bent));
    // What is seen at `after` comes from `after (1 + d r²) / (1 + d)`; the half diagonal of a square is √2.
    let source = after * (1.0 + 0.3 * after * after / 2.0) / 1.3;
    assert!((source - before).abs() < 0.01, "{before} {after} {source}");
    let corner = |picture| mean(picture, 2, 2, 4, 4).iter().sum::<f64>();
    assert!(corner(&bent) < 0.6 * corner(&straight));
}

#[test]
fn pictures_without_pixels_or_with_too_many_are_refused() {
    let (scene, mut renderer) = (Scene::new(), renderer());
    for size in [[0, 10], [10, 0], [1 << 20, 10]] {
        let refused = renderer.picture(&scene.view(), &front(), &Layout::Mono, size);
        assert!(matches!(refused, Err(ViewError::Size { .. })), "{size:?}");
    }
    assert!(renderer.picture(&scene.view(), &front(), &Layout::Mono, [1, 1]).is_ok());
}

#[test]
fn only_what_changed_is_sent() {
    let mut scene = Scene::new();
    let ball = scene.shape(SPHERE, Pose::default(), colored(1.0, 1.0, 1.0));
    let mut renderer = renderer();
    picture(&mut renderer, &scene, &front(), &Layout::Mono, 32);
    let first = renderer.renderer().bytes_sent();
    assert!(first > 10_000);
    // Another of the same shape, and a pose: nothing of a surface.
    scene.shape(SPHERE, Pose::at(0.1, 0.0, 0.0), colored(1.0, 0.0, 0.0));
    scene.write(|out| out.put(ball, Pose::at(0.0, 0.1, 0.0)));
    picture(&mut renderer, &scene, &front(), &Layout::Mono, 32);
    assert_eq!(renderer.renderer().bytes_sent(), first);
}

#[test]
fn a_lost_device_is_an_error_and_the_eye_can_begin_again() {
    let mut scene = Scene::new();
    scene.light();
    scene.shape(SPHERE, Pose::default(), colored(1.0, 0.02, 0.02));
    let mut renderer = renderer();
    renderer.quality = Quality::FULL;
    let before = picture(&mut renderer, &scene, &front(), &Layout::Mono, 64);
    renderer.gpu().device.destroy();
    for _ in 0..2 {
        let lost = renderer.picture(&scene.view(), &front(), &Layout::Mono, [64, 64]);
        assert!(matches!(lost, Err(ViewError::DeviceLost(_))), "{:?}", lost.err());
        let lost = renderer.probe(&scene.view(), &front(), [8, 8]);
        assert!(matches!(lost, Err(ViewError::DeviceLost(_))), "{:?}", lost.err());
    }
    renderer.renew().expect("the adapter is still there");
    assert_eq!(renderer.quality, Quality::FULL);
    assert_eq!(picture(&mut renderer, &scene, &front(), &Layout::Mono, 64).color, before.color);
}

#[test]
fn a_picture_with_fewer_pixels_shows_the_same_in_the_same_places() {
    let mut scene = Scene::new();
    scene.light();
    scene.shape(Shape::Sphere { radius: 0.02 }, Pose::at(0.05, 0.0, 0.0), colored(1.0, 0.02, 0.02));
    let gpu = Gpu::headless().expect("a graphics adapter: tests/run installs a software one");
    let (mut renderer, view, side) = (Renderer::new(&gpu, None), front(), 200);
    let target = targets::target(&gpu, [side; 2], targets::COLOR, 1);
    let snapshot = scene.view();
    renderer.update(&gpu, &snapshot);
    let stereo = Stereo { interocular: 0.03, convergence: 0.3 };
    for layout in [Layout::Mono, Layout::SideBySide(stereo), Layout::RowInterleaved(stereo)] {
        let [whole, fewer] = [1.0, 0.5].map(|scale| {
            let pace = Pace { quality: Quality::FULL, scale };
            assert!(renderer.needs_draw(&snapshot, &view, &layout, pace, &target));
            renderer.draw_scaled(&gpu, &snapshot, &view, &layout, pace, &target);
            assert!(!renderer.needs_draw(&snapshot, &view, &layout, pace, &target));
            let bytes = targets::read(&gpu, &target).expect("pixels");
            Picture { width: side, height: side, color: bytes.as_chunks().0.to_vec() }
        });
        assert_ne!(whole.color, fewer.color);
        // Blocks of pixels have the same mean colour, but where an edge passes.
        let mut apart = 0;
        for (x, y) in (0..20).flat_map(|x| (0..20).map(move |y| (10 * x, 10 * y))) {
            let (a, b) = (mean(&whole, x, y, 10, 10), mean(&fewer, x, y, 10, 10));
            apart += usize::from((0..3).any(|channel| (a[channel] - b[channel]).abs() > 12.0));
        }
        assert!(apart <= 8, "{layout:?}: {apart} of 400");
    }
    scene.shape(SPHERE, Pose::default(), colored(1.0, 1.0, 1.0));
    let pace = Pace { quality: Quality::FULL, scale: 1.0 };
    assert!(renderer.needs_draw(&scene.view(), &view, &Layout::Mono, pace, &target));
}
