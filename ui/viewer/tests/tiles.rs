//! Several views in one picture.

use crate::support::{Scene, colored, front, middle_column, picture, renderer};
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{Camera, Entity, Light, Pose, Shape};
use trocar_viewer::draw_list::DrawList;
use trocar_viewer::layout::{Stereo, Tile, TileView};
use trocar_viewer::{Layout, OffscreenRenderer, Overlay, Overlays, Pane, Picture, Quality, View};

fn scene() -> Scene {
    let mut scene = Scene::new();
    scene.write(|out| {
        let light = out.spawn();
        out.put(light, Light { cone_angle: 1.2, ..Light::default() });
        let down = nalgebra::UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
        out.put(light, Pose::new(Vector3::new(0.0, -0.05, 0.3), down));
    });
    scene.shape(Shape::Sphere { radius: 0.03 }, Pose::at(-0.04, 0.0, 0.0), colored(0.9, 0.05, 0.05));
    scene.shape(
        Shape::Torus { ring_radius: 0.03, tube_radius: 0.01 },
        Pose::at(0.05, 0.0, 0.0),
        colored(0.1, 0.6, 0.9),
    );
    scene
}

fn camera(scene: &mut Scene, view: &View) -> Entity {
    scene.write(|out| {
        let camera = out.spawn();
        let View { lens, world_from_eye, .. } = view;
        let (field_of_view, near, far) = (lens.field_of_view, lens.near, lens.far);
        out.put(camera, Camera { field_of_view, near, far, ..Camera::default() });
        out.put(camera, Pose::from(*world_from_eye));
        camera
    })
}

fn part(whole: &Picture, [left, top, width, height]: [u32; 4]) -> Picture {
    let rows = (top..top + height).flat_map(|y| (left..left + width).map(move |x| (x, y)));
    let color = rows.map(|(x, y)| whole.at(x, y).expect("inside")).collect();
    Picture { width, height, color }
}

/// Share of pixels that differ by more than rounding.
fn difference(a: &Picture, b: &Picture) -> f64 {
    assert_eq!([a.width, a.height], [b.width, b.height]);
    let differ = |(a, b): &(&[u8; 4], &[u8; 4])| (0..3).any(|channel| a[channel].abs_diff(b[channel]) > 3);
    a.color.iter().zip(&b.color).filter(differ).count() as f64 / a.color.len() as f64
}

fn single(
    renderer: &mut OffscreenRenderer,
    scene: &Scene,
    view: &View,
    [width, height]: [u32; 2],
) -> Picture {
    let mut view = *view;
    view.lens.aspect = f64::from(width) / f64::from(height);
    renderer.picture(&scene.view(), &view, &Layout::Mono, [width, height]).expect("a picture")
}

fn above() -> View {
    View::looking_at(Point3::new(0.0, -0.02, 0.3), Point3::origin(), Vector3::y(), front().lens)
}

#[test]
fn each_tile_shows_what_its_own_camera_shows() {
    let (mut scene, mut renderer) = (scene(), renderer());
    let side = View::looking_at(Point3::new(0.3, 0.0, 0.1), Point3::origin(), Vector3::z(), front().lens);
    let camera = camera(&mut scene, &side);
    let pane = |x, y, width, height| Pane { x, y, width, height };
    let tiles = vec![
        Tile::new(pane(0.0, 0.0, 0.75, 0.5), TileView::Given),
        Tile::new(pane(0.75, 0.0, 0.25, 1.0), TileView::Camera(camera)),
        Tile::new(pane(0.0, 0.5, 0.75, 0.5), TileView::Free(above())),
    ];
    for (quality, overlays) in [
        (Quality::PLAIN, Overlays::default()),
        (Quality::FULL, Overlays::default()),
        (Quality::FINE, Overlays::of(&[Overlay::Wireframe, Overlay::Axes])),
    ] {
        renderer.quality = quality;
        renderer.renderer_mut().overlays = overlays;
        let layout = Layout::Tiles(tiles.clone());
        let whole = renderer.picture(&scene.view(), &front(), &layout, [256, 192]).unwrap();
        for (pixels, view) in
            [([0, 0, 192, 96], front()), ([192, 0, 64, 192], side), ([0, 96, 192, 96], above())]
        {
            let alone = single(&mut renderer, &scene, &view, [pixels[2], pixels[3]]);
            let off = difference(&part(&whole, pixels), &alone);
            assert!(off < 0.002, "{quality:?} {pixels:?}: {off}");
        }
    }
}

#[test]
fn a_tile_behind_a_lens_is_bent_and_the_others_are_not() {
    let (scene, mut renderer) = (scene(), renderer());
    let bent = View { distortion: 0.3, vignette: 0.7, ..front() };
    let layout = Layout::grid([TileView::Free(bent), TileView::Free(above())]);
    let whole = renderer.picture(&scene.view(), &front(), &layout, [256, 128]).unwrap();
    for (left, view) in [(0, bent), (128, above())] {
        let alone = single(&mut renderer, &scene, &view, [128, 128]);
        let off = difference(&part(&whole, [left, 0, 128, 128]), &alone);
        assert!(off < 0.002, "{left}: {off}");
    }
}

#[test]
fn a_tile_has_a_transform_and_two_eyes_of_its_own() {
    let (scene, mut renderer) = (scene(), renderer());
    let stereo = Stereo { interocular: 0.03, convergence: 0.3 };
    let aside = Isometry3::translation(0.02, 0.0, 0.05);
    let mut tile = Tile::new(Pane { x: 0.0, y: 0.0, width: 0.5, height: 1.0 }, TileView::Given);
    tile.view_from_eye = aside;
    let woven = Tile {
        pane: Pane { x: 0.5, ..tile.pane },
        view_from_eye: Isometry3::identity(),
        layout: Layout::Anaglyph(stereo),
        ..tile.clone()
    };
    let whole = picture(&mut renderer, &scene, &front(), &Layout::Tiles(vec![tile, woven]), 256);
    let moved = View { world_from_eye: front().world_from_eye * aside, ..front() };
    let alone = single(&mut renderer, &scene, &moved, [128, 256]);
    assert!(difference(&part(&whole, [0, 0, 128, 256]), &alone) < 0.002);
    let mut narrow = front();
    narrow.lens.aspect = 0.5;
    let anaglyph = renderer.picture(&scene.view(), &narrow, &Layout::Anaglyph(stereo), [128, 256]).unwrap();
    assert!(difference(&part(&whole, [128, 0, 128, 256]), &anaglyph) < 0.002);
}

#[test]
fn a_camera_that_is_gone_leaves_its_tile_empty_and_no_tiles_leave_all_of_it() {
    let (scene, mut renderer) = (scene(), renderer());
    let layout = Layout::grid([TileView::Given, TileView::Camera(Entity::new(7, 7, 7))]);
    let whole = renderer.picture(&scene.view(), &front(), &layout, [256, 128]).unwrap();
    let empty = part(&whole, [128, 0, 128, 128]);
    assert!(empty.color.iter().all(|pixel| *pixel == empty.color[0]));
    assert!(part(&whole, [0, 0, 128, 128]).color.iter().any(|pixel| *pixel != empty.color[0]));
    let nothing = renderer.picture(&scene.view(), &front(), &Layout::Tiles(Vec::new()), [64, 64]).unwrap();
    assert!(nothing.color.iter().all(|pixel| *pixel == empty.color[0]));
}

#[test]
fn four_views_show_a_thing_from_the_front_from_above_and_from_the_right() {
    let (scene, mut renderer) = (scene(), renderer());
    let mut draw_list = DrawList::new();
    draw_list.update(&scene.view());
    let layout = Layout::quad(&draw_list, &front());
    renderer.quality = Quality::PLAIN;
    let whole = picture(&mut renderer, &scene, &front(), &layout, 256);
    let [top, front, right] = [[128, 0], [0, 128], [128, 128]].map(|[x, y]| part(&whole, [x, y, 128, 128]));
    let is_red = |[r, g, _, _]: [u8; 4]| r > 60 && g < r / 2;
    let is_blue = |[r, _, b, _]: [u8; 4]| b > 60 && r < b / 2;
    // The ball is left of the ring from above and from the front; from the right it is behind it.
    for seen in [&top, &front] {
        let (red, blue) = (middle_column(seen, is_red).unwrap(), middle_column(seen, is_blue).unwrap());
        assert!(blue > red + 40.0, "{red} {blue}");
    }
    let blue = middle_column(&right, is_blue).unwrap();
    assert!((blue - 64.0).abs() < 3.0, "{blue}");
    // From above one sees through the ring.
    let count = |seen: &Picture| seen.color.iter().filter(|pixel| is_blue(**pixel)).count();
    assert!(count(&top) > 2 * count(&front), "{} {}", count(&top), count(&front));
}

#[test]
fn legends_stand_in_the_first_of_several_views() {
    let (scene, mut renderer) = (scene(), renderer());
    let layout = Layout::grid([TileView::Given, TileView::Free(above())]);
    let mut drawn = |legends: bool| {
        renderer.renderer_mut().overlays = Overlays { legends, ..Overlays::of(&[Overlay::Forces]) };
        renderer.picture(&scene.view(), &front(), &layout, [512, 256]).unwrap()
    };
    let (with, without) = (drawn(true), drawn(false));
    let of = |left| [&with, &without].map(|whole| part(whole, [left, 0, 256, 256]));
    let ([a, b], [c, d]) = (of(0), of(256));
    assert!(difference(&a, &b) > 0.01 && c == d, "{}", difference(&a, &b));
}

#[test]
fn a_grid_is_as_square_as_it_can_be() {
    for (count, columns, rows) in [(1, 1, 1), (2, 2, 1), (3, 2, 2), (4, 2, 2), (5, 3, 2), (9, 3, 3)] {
        let Layout::Tiles(tiles) = Layout::grid(vec![TileView::Given; count]) else { unreachable!() };
        let size = (1.0 / f64::from(columns), 1.0 / f64::from(rows));
        assert!(tiles.iter().all(|tile| (tile.pane.width, tile.pane.height) == size), "{count}");
        assert_eq!(tiles.len(), count);
    }
    assert_eq!(Layout::grid([]), Layout::Tiles(Vec::new()));
}
