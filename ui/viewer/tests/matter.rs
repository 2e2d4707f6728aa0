//! Smoke veils by its thickness and ends softly at surfaces; drops of a fluid are one surface that hides and is hidden.

use crate::support as common;
use std::sync::Arc;

use crate::support::{Scene, colored, front, mean, picture, renderer};
use nalgebra::{Point3, Vector3};
use trocar_scene::{Entity, Light, ParticleKind, Particles, Pose, Shape};
use trocar_viewer::layout::{Pane, Stereo, Tile, TileView};
use trocar_viewer::pacing::Pace;
use trocar_viewer::picture::Probe;
use trocar_viewer::{Layout, OffscreenRenderer, Picture, Quality, View};

const SIDE: u32 = 192;

/// A wall behind the origin, lit from the eye.
fn wall() -> Scene {
    let mut scene = Scene::new();
    scene.light();
    let wall = Shape::Box { half_extents: [0.3, 0.005, 0.3] };
    scene.shape(wall, Pose::at(0.0, 0.105, 0.0), colored(0.75, 0.75, 0.75));
    scene
}

fn put(scene: &mut Scene, particles: Particles, pose: Pose) -> Entity {
    scene.write(|out| {
        let entity = out.spawn();
        out.put(entity, particles);
        out.put(entity, pose);
        entity
    })
}

/// Black puffs in one place: what is seen through them is what they leave.
fn soot(count: usize) -> Particles {
    Particles {
        positions: Arc::new(vec![Point3::origin(); count]),
        radius: 0.03,
        color: [0.0; 3],
        extinction: 8.0,
        ..Particles::default()
    }
}

/// A sheet of drops across the line of sight, one radius from each other.
fn sheet(layers: u32, radius: f64) -> Particles {
    let mut positions = Vec::new();
    for layer in 0..layers {
        for row in -14..=14 {
            for column in -14..=14 {
                let [x, z] = [column, row].map(|index| f64::from(index) * 1.1 * radius);
                // Layers behind the first leave the front as it is.
                positions.push(Point3::new(x, f64::from(layer) * radius, z));
            }
        }
    }
    Particles {
        kind: ParticleKind::Fluid,
        positions: Arc::new(positions),
        radius,
        color: [0.25, 0.01, 0.01],
        extinction: 150.0,
        ..Particles::default()
    }
}

fn seen(renderer: &mut OffscreenRenderer, scene: &Scene) -> Picture {
    picture(renderer, scene, &front(), &Layout::Mono, SIDE)
}

fn middle(picture: &Picture) -> [f64; 3] {
    mean(picture, SIDE / 2 - 4, SIDE / 2 - 4, 8, 8)
}

/// From a stored colour to light.
fn linear(stored: f64) -> f64 {
    let share = stored / 255.0;
    if share <= 0.04045 { share / 12.92 } else { ((share + 0.055) / 1.055).powf(2.4) }
}

fn whole(scene: &Scene, renderer: &mut OffscreenRenderer, view: &View) -> Probe {
    renderer.probe(&scene.view(), view, [SIDE, SIDE]).expect("a probe")
}

/// Scenes of their own are told apart by who looks: each has an eye of its own.
fn anew(quality: Quality, scene: &Scene) -> Picture {
    let mut renderer = renderer();
    renderer.quality = quality;
    seen(&mut renderer, scene)
}

const QUALITIES: [Quality; 3] = [Quality::PLAIN, Quality::FULL, Quality::FINE];

#[test]
fn smoke_weakens_what_is_behind_it_by_its_thickness() {
    for quality in QUALITIES {
        // Without a texture the optical depth is known.
        let quality = Quality { wet: false, ..quality };
        let through = |count: usize| {
            let mut scene = wall();
            put(&mut scene, soot(count), Pose::default());
            linear(middle(&anew(quality, &scene))[0])
        };
        let clear = linear(middle(&anew(quality, &wall()))[0]);
        // A ball of Gaussian density: extinction · σ · √(2π), σ half of the radius.
        let depth = 8.0 * 0.015 * (2.0 * std::f64::consts::PI).sqrt();
        for count in [1, 2, 4] {
            let left = through(count) / clear;
            let expected = (-depth * count as f64).exp();
            assert!((left - expected).abs() < 0.03, "{quality:?}, {count}: {left}, expected {expected}");
        }
    }
}

#[test]
fn smoke_is_lit_by_the_lights_of_the_scene() {
    let lit = |color: [f64; 3]| {
        let mut scene = Scene::new();
        scene.write(|out| {
            let light = out.spawn();
            out.put(light, Light { color, shadows: false, ..Light::default() });
            out.put(light, Pose::at(0.1, -0.2, 0.2));
        });
        let white = Particles { color: [0.9; 3], extinction: 200.0, ..soot(3) };
        put(&mut scene, white, Pose::default());
        middle(&seen(&mut renderer(), &scene))
    };
    let (red, blue) = (lit([1.0, 0.1, 0.1]), lit([0.1, 0.1, 1.0]));
    assert!(red[0] > 60.0 && red[0] > 1.3 * red[2], "{red:?}");
    assert!(blue[2] > 60.0 && blue[2] > 1.3 * blue[0], "{blue:?}");
}

#[test]
fn smoke_is_hidden_by_what_is_in_front_and_fades_where_it_meets_a_surface() {
    for quality in QUALITIES {
        let clear = anew(quality, &wall());
        let at = |y: f64| {
            let mut scene = wall();
            put(&mut scene, Particles { extinction: 100.0, ..soot(1) }, Pose::at(0.0, y, 0.0));
            anew(quality, &scene)
        };
        // Behind the wall, whose front is at 0.1.
        assert!(at(0.2) == clear, "{quality:?}");
        // The nearer the middle of a puff comes to the wall, and beyond, the less of it is seen: never all at once.
        let left: Vec<f64> = [0.05, 0.09, 0.1, 0.11, 0.15].map(|y| middle(&at(y))[0]).into();
        assert!(left.is_sorted(), "{quality:?}: {left:?}");
        let bright = middle(&clear)[0];
        assert!(left[0] < 0.6 * bright && left[4] > 0.97 * bright, "{quality:?}: {left:?}, {bright}");
        assert!(left[2] > left[0] + 5.0 && left[2] < left[4] - 5.0, "{quality:?}: {left:?}");
        // No edge along a surface that a puff is cut by: a floor that runs through its middle. From row to row of pixels the
        // puff itself changes by 0.03; one that ended at a plane of its own would do so by 0.2.
        let mut scene = Scene::new();
        scene.light();
        let floor = Shape::Box { half_extents: [0.3, 0.3, 0.005] };
        scene.shape(floor, Pose::at(0.0, 0.0, -0.005), colored(0.75, 0.75, 0.75));
        let view =
            View::looking_at(Point3::new(0.0, -0.25, 0.15), Point3::origin(), Vector3::z(), front().lens);
        let mut renderer = common::renderer();
        renderer.quality = quality;
        let before = picture(&mut renderer, &scene, &view, &Layout::Mono, SIDE);
        put(&mut scene, Particles { extinction: 30.0, ..soot(1) }, Pose::default());
        let after = picture(&mut renderer, &scene, &view, &Layout::Mono, SIDE);
        let veil = |y: u32| {
            let [before, after] =
                [&before, &after].map(|picture| linear(mean(picture, SIDE / 2 - 6, y, 12, 1)[0]));
            after / before
        };
        let steps: Vec<f64> = (1..SIDE).map(|y| (veil(y) - veil(y - 1)).abs()).collect();
        let steepest = steps.iter().fold(0.0, |a: f64, b| a.max(*b));
        assert!(veil(SIDE / 2) < 0.9, "{quality:?}: {}", veil(SIDE / 2));
        assert!(steepest < 0.06, "{quality:?}: {steepest}");
    }
}

#[test]
fn smoke_lies_between_what_is_before_and_behind_it() {
    let ball = |scene: &mut Scene, y: f64| {
        scene.shape(Shape::Sphere { radius: 0.01 }, Pose::at(0.0, y, 0.0), colored(0.8, 0.02, 0.02));
    };
    let red = |y: f64, smoke: bool| {
        let mut scene = wall();
        ball(&mut scene, y);
        if smoke {
            put(&mut scene, Particles { extinction: 100.0, ..soot(1) }, Pose::default());
        }
        middle(&anew(Quality::FINE, &scene))[0]
    };
    let (before, before_clear) = (red(-0.06, true), red(-0.06, false));
    assert!((before - before_clear).abs() < 2.0, "{before} {before_clear}");
    let (behind, behind_clear) = (red(0.06, true), red(0.06, false));
    assert!(behind < 0.6 * behind_clear, "{behind} {behind_clear}");
}

/// Mean angle between normals of neighbouring pixels in the middle of a probe [rad].
fn roughness(probe: &Probe, view: &View) -> f64 {
    let point = |x: u32, y: u32| {
        let at = [x, y].map(|pixel| (f64::from(pixel) + 0.5) / f64::from(SIDE));
        let (origin, direction) = view.ray(at);
        let forward = view.world_from_eye.rotation * Vector3::z();
        let depth = f64::from(probe.depth[(y * SIDE + x) as usize]);
        origin + direction * (depth / direction.dot(&forward))
    };
    let normal = |x: u32, y: u32| {
        let (right, down) = (point(x + 1, y) - point(x - 1, y), point(x, y + 1) - point(x, y - 1));
        right.cross(&down).normalize()
    };
    let (mut sum, mut count) = (0.0, 0.0);
    for y in 80..112 {
        for x in 80..112 {
            sum += normal(x, y).angle(&normal(x + 1, y)) + normal(x, y).angle(&normal(x, y + 1));
            count += 2.0;
        }
    }
    sum / count
}

#[test]
fn drops_are_one_smooth_surface() {
    let radius = 0.004;
    let drops = sheet(1, radius);
    let mut balls = Scene::new();
    for position in drops.positions.iter() {
        balls.shape(
            Shape::Sphere { radius },
            Pose::at(position.x, position.y, position.z),
            colored(1.0, 1.0, 1.0),
        );
    }
    let mut fluid = Scene::new();
    let entity = put(&mut fluid, drops, Pose::default());
    let view = front();
    let (of_balls, of_fluid) = (whole(&balls, &mut renderer(), &view), whole(&fluid, &mut renderer(), &view));
    let (rough, smooth) = (roughness(&of_balls, &view), roughness(&of_fluid, &view));
    assert!(rough > 0.05 && smooth < 0.25 * rough, "{smooth} {rough}");
    // It is where the drops are, and everywhere between them.
    for (x, y) in (80..112).flat_map(|y| (80..112).map(move |x| (x, y))) {
        assert_eq!(of_fluid.entity(x, y), Some(entity));
        let depth = f64::from(of_fluid.depth[(y * SIDE + x) as usize]);
        assert!((depth - 0.3).abs() < 1.2 * radius, "{depth}");
    }
    assert_eq!(of_fluid.entity(2, 2), None);
}

#[test]
fn a_probe_sees_fluids_and_sees_through_smoke() {
    let (mut renderer, view) = (renderer(), front());
    let mut scene = wall();
    let ball = scene.shape(Shape::Sphere { radius: 0.02 }, Pose::at(0.0, -0.05, 0.0), colored(1.0, 1.0, 1.0));
    let fluid = put(&mut scene, sheet(1, 0.004), Pose::default());
    put(&mut scene, Particles { extinction: 1e3, ..soot(4) }, Pose::at(0.0, -0.1, 0.0));
    let probe = whole(&scene, &mut renderer, &view);
    let middle = SIDE / 2;
    assert_eq!(probe.entity(middle, middle), Some(ball), "what is before a fluid hides it");
    assert_eq!(probe.entity(middle + 30, middle), Some(fluid), "it hides the wall");
    let depth = probe.depth[(middle * SIDE + middle + 30) as usize];
    assert!((depth - 0.297).abs() < 0.004, "{depth}");
}

#[test]
fn a_fluid_hides_what_is_behind_and_is_hidden_by_what_is_in_front() {
    for quality in QUALITIES {
        let ball = |y: f64| {
            let mut scene = wall();
            let sphere = Shape::Sphere { radius: 0.01 };
            scene.shape(sphere, Pose::at(0.0, y, 0.0), colored(0.05, 0.2, 0.9));
            let thick = Particles { extinction: 3e3, ..sheet(1, 0.004) };
            put(&mut scene, thick, Pose::default());
            scene
        };
        let [r, _, b] = middle(&anew(quality, &ball(-0.05)));
        assert!(b > 1.5 * r, "{quality:?}, in front: {r} {b}");
        let [r, _, b] = middle(&anew(quality, &ball(0.05)));
        assert!(r > 1.5 * b, "{quality:?}, behind: {r} {b}");
    }
}

#[test]
fn a_fluid_is_darker_where_it_is_thicker() {
    for quality in QUALITIES {
        let through = |layers: u32| {
            let mut scene = wall();
            put(&mut scene, sheet(layers, 0.004), Pose::default());
            // Beside the highlight.
            mean(&anew(quality, &scene), SIDE / 2 - 8, SIDE / 2 + 24, 16, 8)
        };
        let clear = mean(&anew(quality, &wall()), SIDE / 2 - 8, SIDE / 2 + 24, 16, 8);
        let [one, two, four] = [1, 2, 4].map(through);
        for channel in 0..3 {
            let row = [clear, one, two, four].map(|color| color[channel]);
            assert!(row.windows(2).all(|pair| pair[1] < pair[0]), "{quality:?}: {row:?}");
        }
        assert!(one[0] > 1.5 * one[1] && four[0] > 1.5 * four[1], "red: {one:?} {four:?}");
    }
}

#[test]
fn every_tile_eye_and_lens_sees_them() {
    let mut scene = wall();
    put(&mut scene, Particles { extinction: 60.0, ..soot(2) }, Pose::at(0.04, 0.0, 0.04));
    put(&mut scene, Particles { extinction: 2e3, ..sheet(1, 0.002) }, Pose::at(-0.04, 0.0, -0.04));
    let (mut renderer, view) = (renderer(), front());
    for quality in [Quality::FULL, Quality::FINE] {
        renderer.quality = quality;
        let close = |a: [u8; 4], b: [u8; 4]| (0..3).all(|channel| a[channel].abs_diff(b[channel]) <= 6);
        let alone = seen(&mut renderer, &scene);
        let pane = |x: f64, y: f64| Pane { x, y, width: 0.5, height: 0.5 };
        let tiles = [pane(0.0, 0.0), pane(0.5, 0.5)].map(|pane| Tile::new(pane, TileView::Given));
        let tiled = picture(&mut renderer, &scene, &view, &Layout::Tiles(tiles.into()), 2 * SIDE);
        for (left, top) in [(0, 0), (SIDE, SIDE)] {
            for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
                let (a, b) = (tiled.at(left + x, top + y).unwrap(), alone.at(x, y).unwrap());
                assert!(close(a, b), "{quality:?}, {x} {y}: {a:?} {b:?}");
            }
        }
        let stereo = Stereo { interocular: 0.02, convergence: 0.3 };
        let woven = picture(&mut renderer, &scene, &view, &Layout::RowInterleaved(stereo), SIDE);
        let [first, second] = view.stereo(stereo.interocular, stereo.convergence);
        for (parity, one) in [(0, first), (1, second)] {
            let alone = picture(&mut renderer, &scene, &one, &Layout::Mono, SIDE);
            for (x, y) in (0..SIDE).filter(|y| y % 2 == parity).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
                let (a, b) = (woven.at(x, y).unwrap(), alone.at(x, y).unwrap());
                assert!(close(a, b), "{quality:?}, {x} {y}: {a:?} {b:?}");
            }
        }
    }
}

#[test]
fn without_particles_nothing_is_drawn_for_them_and_only_changed_ones_are_sent() {
    let (mut renderer, view) = (renderer(), front());
    let mut scene = wall();
    seen(&mut renderer, &scene);
    let counts = |renderer: &OffscreenRenderer| {
        (renderer.renderer().particle_passes(), renderer.renderer().particle_bytes_sent())
    };
    assert_eq!(counts(&renderer), (0, 0));
    let empty = put(&mut scene, soot(0), Pose::default());
    let clear = seen(&mut renderer, &scene);
    assert_eq!(counts(&renderer), (0, 0), "a list of none is none");
    let smoke = put(&mut scene, soot(100), Pose::default());
    put(&mut scene, sheet(1, 0.002), Pose::default());
    seen(&mut renderer, &scene);
    let (passes, sent) = counts(&renderer);
    assert!(passes > 0 && sent >= 32 * (100 + 841), "{passes} {sent}");
    // The same again, from elsewhere, and something else moved: they lie where they are.
    scene.write(|out| out.put(smoke, Pose::at(0.01, 0.0, 0.0)));
    seen(&mut renderer, &scene);
    assert_eq!(counts(&renderer).1, sent);
    scene.write(|out| out.put(smoke, soot(90)));
    seen(&mut renderer, &scene);
    assert_eq!(counts(&renderer).1, sent + 32 * 90, "only the smoke has changed");
    // A picture that would be the same need not be drawn.
    let target =
        trocar_viewer::gpu::targets::target(renderer.gpu(), [64, 64], trocar_viewer::gpu::targets::COLOR, 1);
    let (gpu, snapshot, pace) =
        (renderer.gpu().clone(), scene.view(), Pace { quality: Quality::PLAIN, scale: 1.0 });
    let inner = renderer.renderer_mut();
    inner.update(&gpu, &snapshot);
    inner.draw_scaled(&gpu, &snapshot, &view, &Layout::Mono, pace, &target);
    assert!(!inner.needs_draw(&snapshot, &view, &Layout::Mono, pace, &target));
    scene.write(|out| out.put(smoke, soot(80)));
    assert!(inner.needs_draw(&scene.view(), &view, &Layout::Mono, pace, &target));
    // What is gone is gone.
    let all: Vec<Entity> = scene.view().iter::<Particles>().map(|(entity, _)| entity).collect();
    scene.write(|out| all.iter().filter(|entity| **entity != empty).for_each(|entity| out.despawn(*entity)));
    let before = counts(&renderer);
    assert!(seen(&mut renderer, &scene) == clear);
    assert_eq!(counts(&renderer), before);
}
