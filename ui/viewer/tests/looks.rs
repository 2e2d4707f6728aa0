//! What surfaces look like: each map, burns where they are, threads, materials with shaders of their own.

use std::sync::Arc;

use crate::support::{Scene, colored, front, grid, mean, picture, renderer};
use nalgebra::{Point3, Vector2};
use trocar_scene::{
    Burn, Entity, LineMesh, Pose, Shape, SurfaceMesh, Texture, TextureCoordinates, VertexPositions,
    VisualMaterial,
};
use trocar_viewer::{Layout, OffscreenRenderer, Picture};

const SIDE: u32 = 128;

/// A wall in front of the eye, `cells` × `cells` squares of 0.2 m in all.
fn wall(scene: &mut Scene, cells: u32, material: VisualMaterial) -> Entity {
    let (corners, triangles) = grid(cells);
    let positions = corners.iter().map(|[u, v]| Point3::new((u - 0.5) * 0.2, 0.0, (v - 0.5) * 0.2)).collect();
    let uvs = corners.into_iter().map(Vector2::from).collect();
    scene.write(|out| {
        let entity = out.spawn();
        out.put(entity, VertexPositions { positions: Arc::new(positions) });
        out.put(entity, SurfaceMesh { triangles: Arc::new(triangles) });
        out.put(entity, TextureCoordinates { uv: Arc::new(uvs) });
        out.put(entity, Pose::default());
        out.put(entity, material);
        entity
    })
}

fn lit_wall(material: VisualMaterial) -> Picture {
    let mut scene = Scene::new();
    scene.light();
    wall(&mut scene, 4, material);
    picture(&mut renderer(), &scene, &front(), &Layout::Mono, SIDE)
}

/// How much brightness varies over the middle of the picture.
fn contrast(picture: &Picture) -> f64 {
    let values: Vec<f64> = (32..96)
        .flat_map(|y| (32..96).map(move |x| (x, y)))
        .map(|(x, y)| picture.at(x, y).map_or(0.0, |[r, g, b, _]| f64::from(r) + f64::from(g) + f64::from(b)))
        .collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    (values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64).sqrt()
}

fn procedural(name: &str) -> Option<Texture> {
    Some(Texture::Procedural(name.into()))
}

#[test]
fn each_map_changes_what_is_seen() {
    let plain = VisualMaterial { base_color: [0.6, 0.3, 0.3, 1.0], ..VisualMaterial::default() };
    let flat = lit_wall(plain.clone());
    let with = |change: fn(&mut VisualMaterial)| {
        let mut material = plain.clone();
        change(&mut material);
        lit_wall(material)
    };
    let colour = with(|material| material.color_map = procedural("checker"));
    assert!(contrast(&colour) > 3.0 * contrast(&flat), "{} {}", contrast(&colour), contrast(&flat));
    let bumpy = with(|material| material.normal_map = procedural("stomach"));
    assert!(contrast(&bumpy) > 2.0 * contrast(&flat), "{} {}", contrast(&bumpy), contrast(&flat));
    let free = with(|material| material.free_map = procedural("stomach"));
    assert_ne!(free.color, flat.color);
    let wet = with(|material| material.wetness = 1.0);
    let brightest = |picture: &Picture| picture.color.iter().map(|pixel| pixel[1]).max();
    assert!(brightest(&wet) > brightest(&flat));
    let edited = with(|material| material.edit_map = procedural("checker"));
    assert_ne!(edited.color, flat.color);
    let deep = with(|material| {
        material.normal_map = procedural("stomach");
        material.relief = 0.01;
    });
    assert_ne!(deep.color, bumpy.color);
}

#[test]
fn maps_repeat_as_often_as_the_material_says() {
    let checkered = |tiling| {
        let color_map = procedural("checker");
        lit_wall(VisualMaterial { color_map, tiling: [tiling, tiling], ..colored(1.0, 1.0, 1.0) })
    };
    // Along a row, from one edge of the wall to the other, dark squares alternate with light ones.
    let white = lit_wall(colored(1.0, 1.0, 1.0));
    let changes = |picture: &Picture| {
        let green = |picture: &Picture, x| f64::from(picture.at(x, 70).unwrap()[1]);
        let shares: Vec<f64> = (15..113).map(|x| green(picture, x) / green(&white, x)).collect();
        let middle = 0.5
            * (shares.iter().copied().fold(f64::MAX, f64::min) + shares.iter().copied().fold(0.0, f64::max));
        shares.windows(2).filter(|pair| (pair[0] > middle) != (pair[1] > middle)).count()
    };
    let counted = [0.5, 1.0].map(|tiling| changes(&checkered(tiling)));
    // Of n squares, n − 1 edges are inside.
    assert_eq!(counted[1] + 1, 2 * (counted[0] + 1), "{counted:?}");
    assert!(counted[0] > 2, "{counted:?}");
}

fn burned(scene: &mut Scene, entity: Entity, cells: u32, is: impl Fn(u32, u32) -> bool) {
    let row = cells + 1;
    let omega = (0..row * row).map(|vertex| if is(vertex % row, vertex / row) { 1e4 } else { 0.0 });
    let omega = Arc::new(omega.collect());
    scene.write(|out| out.put(entity, Burn { omega }));
}

#[test]
fn burns_are_where_the_tissue_was_burned_and_nowhere_else() {
    let (mut scene, mut renderer, cells) = (Scene::new(), renderer(), 10);
    scene.light();
    let tissue = wall(&mut scene, cells, colored(0.8, 0.3, 0.3));
    burned(&mut scene, tissue, cells, |_, _| false);
    let before = picture(&mut renderer, &scene, &front(), &Layout::Mono, SIDE);
    // The upper right corner of the wall, as seen.
    burned(&mut scene, tissue, cells, |column, row| column >= 8 && row >= 8);
    let after = picture(&mut renderer, &scene, &front(), &Layout::Mono, SIDE);
    let view = front();
    let (mut blackened, mut kept) = (0, 0);
    for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
        let at = [x, y].map(|pixel| (f64::from(pixel) + 0.5) / f64::from(SIDE));
        let (origin, direction) = view.ray(at);
        let point = origin - direction * (origin.y / direction.y);
        let [u, v] = [point.x / 0.2 + 0.5, point.z / 0.2 + 0.5];
        let (a, b) = (before.at(x, y).unwrap(), after.at(x, y).unwrap());
        // Between burned and sound vertices the damage fades over one cell; a texel or two on either side.
        if u > 0.82 && v > 0.82 && u < 0.99 && v < 0.99 {
            assert!(u32::from(b[0]) * 2 < u32::from(a[0]), "{x} {y}: {a:?} {b:?}");
            blackened += 1;
        } else if u < 0.68 || v < 0.68 {
            assert_eq!(a, b, "{x} {y}");
            kept += 1;
        }
    }
    assert!(blackened > 50 && kept > 1000, "{blackened} {kept}");
}

#[test]
fn only_the_burned_part_of_an_edit_map_is_sent() {
    let (mut scene, mut renderer, cells) = (Scene::new(), renderer(), 20);
    let tissue = wall(&mut scene, cells, colored(0.8, 0.3, 0.3));
    burned(&mut scene, tissue, cells, |_, _| false);
    picture(&mut renderer, &scene, &front(), &Layout::Mono, 16);
    let (whole, geometry) = (renderer.renderer().texels_sent(), renderer.renderer().bytes_sent());
    burned(&mut scene, tissue, cells, |column, row| column == 3 && row == 4);
    picture(&mut renderer, &scene, &front(), &Layout::Mono, 16);
    let part = renderer.renderer().texels_sent() - whole;
    // Two cells in each direction of twenty.
    assert!(part > 0 && part < whole / 50, "{part} of {whole}");
    assert_eq!(renderer.renderer().bytes_sent(), geometry);
}

#[test]
fn a_thread_is_a_smooth_tube_and_follows_its_points() {
    let (mut scene, mut renderer) = (Scene::new(), renderer());
    scene.light();
    let points = |height: f64| {
        let bow = |index: i32| {
            let x = f64::from(index) * 0.02;
            Point3::new(x, 0.0, height - 4.0 * x * x)
        };
        VertexPositions { positions: Arc::new((-4..=4).map(bow).collect()) }
    };
    let thread = scene.write(|out| {
        let entity = out.spawn();
        let segments = Arc::new((0..8).map(|index| [index, index + 1]).collect());
        out.put(entity, LineMesh { segments, radius: 0.004 });
        out.put(entity, points(0.05));
        out.put(entity, Pose::default());
        out.put(entity, colored(1.0, 1.0, 1.0));
        entity
    });
    let highest = |renderer: &mut OffscreenRenderer, scene: &Scene| {
        let probe = renderer.probe(&scene.view(), &front(), [SIDE, SIDE]).unwrap();
        let middle = SIDE / 2;
        let rows: Vec<u32> = (0..SIDE).filter(|y| probe.entity(middle, *y) == Some(thread)).collect();
        (rows[0], rows.len())
    };
    let (top, thick) = highest(&mut renderer, &scene);
    // 8 mm at 0.3 m: the picture is 2 tan(0.4) × 0.3 m high.
    let expected = 0.008 / (2.0 * 0.4_f64.tan() * 0.3) * f64::from(SIDE);
    assert!((thick as f64 - expected).abs() <= 1.5, "{thick} {expected}");
    scene.write(|out| out.put(thread, points(0.0)));
    let (lower, _) = highest(&mut renderer, &scene);
    assert!(lower > top + 10, "{top} {lower}");
}

#[test]
fn a_material_brings_its_own_shader_and_one_that_is_wrong_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let shader = "fn surface(before: Surface, at: At) -> Surface {\n    var s = before;\n    s.color = vec3f(0.0);\n    \
                  s.glow = vec3f(0.0, 1.0, 0.0);\n    return s;\n}\n";
    std::fs::write(folder.path().join("glow.wgsl"), shader).unwrap();
    std::fs::write(folder.path().join("broken.wgsl"), "fn surface(").unwrap();
    for (file, glows) in [("glow.wgsl", true), ("broken.wgsl", false), ("missing.wgsl", false)] {
        let mut scene = Scene::new();
        scene.light();
        let shape = Shape::Sphere { radius: 0.05 };
        let material = VisualMaterial { shader: Some(file.into()), ..colored(1.0, 0.02, 0.02) };
        scene.shape(shape, Pose::default(), material);
        let mut renderer = OffscreenRenderer::new(Some(folder.path().to_owned())).unwrap();
        let [r, g, _] = mean(&picture(&mut renderer, &scene, &front(), &Layout::Mono, 64), 28, 28, 8, 8);
        assert_eq!(g > r, glows, "{file}: {r} {g}");
    }
}
