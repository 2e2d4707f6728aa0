//! What moves slowly is shown as if it moved all the time.

use crate::support as common;
use std::collections::BTreeMap;
use std::sync::Arc;

use crate::support::{Scene, colored, front, middle_column, renderer};
use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_scene::{
    Entity, JawState, Parent, Particles, Pose, Shape, SimTime, Snapshot, SurfaceMesh, VertexPositions,
};
use trocar_viewer::draw_list::DrawList;
use trocar_viewer::{Layout, Motion};

const FRAME: f64 = 1.0 / 60.0;

fn at(secs: f64) -> SimTime {
    SimTime::from_secs_f64(secs)
}

/// Writes what `write` says every `interval`, gives every state to a `Motion` (at once, or with every frame), and what is
/// shown to `see`: at 60 frames a second, with the time.
fn play(
    interval: f64,
    polled: bool,
    secs: f64,
    scene: &mut Scene,
    mut write: impl FnMut(&mut Scene, f64),
    mut see: impl FnMut(&Snapshot, f64),
) {
    let mut motion = Motion::new();
    motion.feed(&scene.view(), SimTime::ZERO);
    let (mut frames, mut steps) = (1, 1);
    while f64::from(frames) * FRAME < secs {
        let frame = f64::from(frames) * FRAME;
        // A step at the time of a frame comes before it.
        while f64::from(steps) * interval <= frame + 1e-9 {
            let time = f64::from(steps) * interval;
            scene.at_secs(time);
            write(scene, time);
            if !polled {
                motion.feed(&scene.view(), at(time));
            }
            steps += 1;
        }
        if polled {
            motion.feed(&scene.view(), at(frame));
        }
        see(&motion.at(at(frame)).expect("a scene"), frame);
        frames += 1;
    }
}

fn body(scene: &mut Scene) -> Entity {
    scene.shape(Shape::Sphere { radius: 0.01 }, Pose::default(), colored(0.9, 0.1, 0.1))
}

/// What is shown of a body that goes at 0.1 m/s, in metres.
fn places_of_a_mover(interval: f64, polled: bool) -> Vec<(f64, f64)> {
    let mut scene = Scene::new();
    let body = body(&mut scene);
    let mut places = Vec::new();
    let go = |scene: &mut Scene, time: f64| scene.write(|out| out.put(body, Pose::at(0.1 * time, 0.0, 0.0)));
    play(interval, polled, 3.0, &mut scene, go, |shown, time| {
        places.push((time, shown.get::<Pose>(body).unwrap().translation.x));
    });
    places
}

#[test]
fn a_mover_at_15_hz_makes_equal_steps_at_60_and_is_one_interval_late() {
    for polled in [false, true] {
        let places = places_of_a_mover(1.0 / 15.0, polled);
        let step = 0.1 * FRAME;
        // Never a jump, from the first movement on, and never back.
        for pair in places.windows(2) {
            let moved = pair[1].1 - pair[0].1;
            assert!((-1e-12..1.05 * step).contains(&moved), "{polled} {pair:?}");
        }
        for pair in places[20..].windows(2) {
            assert!((pair[1].1 - pair[0].1 - step).abs() < 0.01 * step, "{polled} {pair:?}");
        }
        let (time, place) = places[100];
        assert!((0.1 * time - place - 0.1 / 15.0).abs() < 1e-4, "{polled} {time} {place}");
    }
}

#[test]
fn rates_that_do_not_divide_that_of_the_display_move_smoothly_too() {
    for hz in [10.0, 13.0, 25.0, 37.0] {
        for polled in [false, true] {
            let places = places_of_a_mover(1.0 / hz, polled);
            let step = 0.1 * FRAME;
            let shown: Vec<f64> =
                places[60..].windows(2).map(|pair| (pair[1].1 - pair[0].1) / step).collect();
            let (least, most) =
                (shown.iter().copied().fold(f64::MAX, f64::min), shown.iter().copied().fold(0.0, f64::max));
            // Shown as they come, at 10 Hz it would be 0 and 6.
            let bounds = if polled { (0.3, 1.8) } else { (0.85, 1.15) };
            assert!(least > bounds.0 && most < bounds.1, "{hz} Hz, {polled}: {least} to {most}");
        }
    }
}

#[test]
fn a_mover_at_1_khz_is_not_delayed() {
    for polled in [false, true] {
        for (time, place) in &places_of_a_mover(1e-3, polled)[3..] {
            assert!((0.1 * time - place).abs() < 0.11e-3, "{polled} {time} {place}");
        }
    }
}

#[test]
fn a_mesh_that_deforms_at_10_hz_moves_all_the_time_and_is_sent_only_then() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    scene.light();
    let body = body(&mut scene);
    let corners = |height: f64| {
        let positions = [[-0.05, 0.0, 0.0], [0.05, 0.0, 0.0], [0.05, 0.0, 0.01 + height], [-0.05, 0.0, 0.01]];
        VertexPositions { positions: Arc::new(positions.map(Point3::from).to_vec()) }
    };
    let mesh = scene.write(|out| {
        let mesh = out.spawn();
        out.put(mesh, SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [0, 2, 3]]) });
        out.put(mesh, corners(0.0));
        out.put(mesh, Pose::default());
        mesh
    });
    let mut heights = Vec::new();
    let mut sent = Vec::new();
    let deform = |scene: &mut Scene, time: f64| {
        // It stops after a second; something else goes on.
        scene.write(|out| out.put(body, Pose::at(0.0, 0.1, 0.01 * time)));
        if time < 1.0 + 1e-9 {
            scene.write(|out| out.put(mesh, corners(0.05 * time)));
        }
    };
    play(0.1, false, 2.0, &mut scene, deform, |shown, time| {
        heights.push((time, shown.get::<VertexPositions>(mesh).unwrap().positions[2].z));
        renderer.picture(shown, &front(), &Layout::Mono, [16, 16]).unwrap();
        sent.push((time, renderer.renderer().bytes_sent()));
    });
    let step = 0.05 * FRAME;
    for pair in heights.windows(2).filter(|pair| pair[0].0 > 0.4 && pair[1].0 < 1.1) {
        assert!((pair[1].1 - pair[0].1 - step).abs() < 0.01 * step, "{pair:?}");
    }
    let last = heights.last().unwrap().1;
    assert!((last - 0.06).abs() < 1e-12, "{last}");
    let moving = sent.windows(2).filter(|pair| pair[0].0 > 0.4 && pair[1].0 < 1.05);
    assert!(moving.clone().count() > 30 && moving.clone().all(|pair| pair[1].1 > pair[0].1));
    let still = sent.windows(2).filter(|pair| pair[0].0 > 1.2);
    assert!(still.clone().count() > 30 && still.clone().all(|pair| pair[1].1 == pair[0].1));
}

/// A plume at 10 Hz: each puff rises at its own speed, the oldest one goes, a new one comes.
#[test]
fn puffs_are_told_apart_by_their_numbers_and_rise_all_the_time() {
    let mut scene = Scene::new();
    let speed = |number: u64| 0.02 + 0.001 * (number % 7) as f64;
    let plume = |time: f64| {
        let step = (time / 0.1).round() as u64;
        let numbers = step..step + 5;
        // The youngest one is where it comes from.
        let place = |number: u64| speed(number) * 0.1 * (step + 4 - number) as f64;
        Particles {
            first: step,
            positions: Arc::new(numbers.clone().map(|number| Point3::new(0.0, 0.0, place(number))).collect()),
            ages: Arc::new(numbers.map(|number| 0.1 * (step + 4 - number) as f64).collect()),
            ..Particles::default()
        }
    };
    let smoke = scene.write(|out| {
        let smoke = out.spawn();
        out.put(smoke, plume(0.0));
        smoke
    });
    let mut seen: BTreeMap<u64, Vec<(f64, f64, f64)>> = BTreeMap::new();
    let puff = |scene: &mut Scene, time: f64| scene.write(|out| out.put(smoke, plume(time)));
    play(0.1, false, 2.0, &mut scene, puff, |shown, time| {
        let smoke = shown.get::<Particles>(smoke).unwrap();
        for (index, (place, age)) in smoke.positions.iter().zip(smoke.ages.iter()).enumerate() {
            seen.entry(smoke.first + index as u64).or_default().push((time, place.z, *age));
        }
    });
    let mut compared = 0;
    for (number, places) in &seen {
        for pair in places.windows(2).filter(|pair| pair[0].0 > 0.4 && pair[1].0 < 1.9) {
            let ((before, low, young), (after, high, old)) = (pair[0], pair[1]);
            // It rests where it comes from until the second time that it is known.
            if low == 0.0 {
                continue;
            }
            compared += 1;
            let passed = after - before;
            assert!(
                (high - low - speed(*number) * passed).abs() < 0.02 * speed(*number) * passed,
                "{pair:?}"
            );
            assert!((old - young - passed).abs() < 0.02 * passed, "{pair:?}");
        }
    }
    assert!(compared > 200, "{compared}");
}

#[test]
fn what_is_drawn_in_the_end_is_what_is_there_in_the_end() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    scene.light();
    let body = body(&mut scene);
    let is_red = |[r, g, _, _]: [u8; 4]| r > 60 && g < r / 2;
    let mut column = 0.0;
    let go = |scene: &mut Scene, time: f64| {
        if time < 0.5 {
            scene.write(|out| out.put(body, Pose::at(0.1 * time, 0.0, 0.0)));
        }
    };
    let mut drawn = renderer;
    play(0.1, false, 1.0, &mut scene, go, |shown, _| {
        let picture = drawn.picture(shown, &front(), &Layout::Mono, [128, 128]).unwrap();
        column = middle_column(&picture, is_red).unwrap();
    });
    renderer = common::renderer();
    let picture = renderer.picture(&scene.view(), &front(), &Layout::Mono, [128, 128]).unwrap();
    assert_eq!(column, middle_column(&picture, is_red).unwrap());
}

#[test]
fn turns_and_jaws_are_blended_and_children_go_with_their_parents() {
    let mut scene = Scene::new();
    let (parent, child) = (body(&mut scene), body(&mut scene));
    scene.write(|out| {
        out.put(child, Parent(parent));
        out.put(child, Pose::at(0.1, 0.0, 0.0));
        out.put(parent, JawState::default());
    });
    let (mut angles, mut jaws, mut children) = (Vec::new(), Vec::new(), Vec::new());
    let turn = |scene: &mut Scene, time: f64| {
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.5 * time);
        scene.write(|out| {
            out.put(parent, Pose::new(Vector3::zeros(), rotation));
            out.put(parent, JawState { angle: 0.2 * time, ..JawState::default() });
        });
    };
    play(0.1, false, 2.0, &mut scene, turn, |shown, _| {
        let pose = shown.get::<Pose>(parent).unwrap();
        angles.push(pose.rotation.angle());
        jaws.push(shown.get::<JawState>(parent).unwrap().angle);
        let place = shown.world_pose(child).translation.vector;
        children.push(place.y.atan2(place.x));
        assert!((place.norm() - 0.1).abs() < 1e-12);
    });
    for (values, rate) in [(angles, 0.5), (jaws, 0.2), (children, 0.5)] {
        for pair in values[30..].windows(2) {
            assert!((pair[1] - pair[0] - rate * FRAME).abs() < 0.01 * rate * FRAME, "{pair:?}");
        }
    }
}

#[test]
fn nothing_overshoots_and_what_is_put_elsewhere_does_not_fly_there() {
    let mut scene = Scene::new();
    let body = body(&mut scene);
    let mut places = Vec::new();
    let go = |scene: &mut Scene, time: f64| {
        let x = if time < 1.0 { 0.1 * time } else { 0.9 };
        scene.write(|out| out.put(body, Pose::at(x, 0.0, 0.0)));
    };
    play(0.1, false, 2.0, &mut scene, go, |shown, _| {
        places.push(shown.get::<Pose>(body).unwrap().translation.x);
    });
    assert!(places.iter().all(|x| *x <= 0.1 || *x == 0.9), "{places:?}");
    assert_eq!(places.last(), Some(&0.9));
}

#[test]
fn a_reset_and_another_parent_are_shown_at_once() {
    let mut scene = Scene::new();
    let (body, parent) = (body(&mut scene), body(&mut scene));
    let mut motion = Motion::new();
    let mut x = |scene: &Scene, secs: f64| {
        motion.feed(&scene.view(), at(secs));
        motion.at(at(secs)).unwrap().get::<Pose>(body).unwrap().translation.x
    };
    for step in 0..5 {
        let secs = 0.1 * f64::from(step);
        scene.at_secs(secs);
        scene.write(|out| out.put(body, Pose::at(0.01 * secs, 0.0, 0.0)));
        x(&scene, secs);
    }
    scene.at_secs(0.5);
    scene.write(|out| {
        out.put(body, Pose::at(-0.02, 0.0, 0.0));
        out.put(body, Parent(parent));
    });
    assert_eq!(x(&scene, 0.5), -0.02);
    // The session begins again.
    let mut again = Scene::new();
    let same = again.shape(Shape::Sphere { radius: 0.01 }, Pose::at(0.005, 0.0, 0.0), colored(1.0, 1.0, 1.0));
    assert_eq!(same, body);
    assert_eq!(x(&again, 0.6), 0.005);
}

#[test]
fn while_nothing_moves_nothing_changes() {
    let mut scene = Scene::new();
    let body = body(&mut scene);
    let (mut draw_list, mut changes) = (DrawList::new(), Vec::new());
    let once = |scene: &mut Scene, time: f64| {
        if time < 0.15 {
            scene.write(|out| out.put(body, Pose::at(0.01, 0.0, 0.0)));
        }
    };
    play(0.1, false, 1.0, &mut scene, once, |shown, time| {
        if draw_list.update(shown) {
            changes.push(time);
        }
    });
    assert!(changes.len() > 3 && *changes.last().unwrap() < 0.3, "{changes:?}");
    assert!(Motion::new().at(SimTime::ZERO).is_none());
}

#[test]
fn whoever_draws_is_told_whether_another_frame_would_show_something_else() {
    let mut scene = Scene::new();
    let body = body(&mut scene);
    let mut motion = Motion::new();
    motion.feed(&scene.view(), SimTime::ZERO);
    motion.at(SimTime::ZERO);
    assert!(!motion.is_moving());
    scene.write(|out| out.put(body, Pose::at(0.01, 0.0, 0.0)));
    motion.feed(&scene.view(), at(0.1));
    let told = (0..12).map(|frame| {
        motion.at(at(0.1 + f64::from(frame) * FRAME));
        motion.is_moving()
    });
    let told: Vec<bool> = told.collect();
    // A fifteenth of a second, and the frame that shows its end.
    assert_eq!(told.iter().filter(|moving| **moving).count(), 5, "{told:?}");
    assert!(told[..5].iter().all(|moving| *moving));
}
