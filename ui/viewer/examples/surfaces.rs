//! What the work of the processor on surfaces costs: medians of many runs.
//!
//! `cargo run --release -p trocar-viewer --example surfaces`

use std::time::Instant;

use nalgebra::{Point3, Vector2};
use trocar_scene::shapes;
use trocar_viewer::deform::DeformingSurface;
use trocar_viewer::edit_map::{EditMap, ScalarMap, SurfaceState};
use trocar_viewer::texture::{MapKind, procedural};
use trocar_viewer::tube::{Tube, TubeStyle};

/// Prints the median of the time that a task takes.
fn report(what: &str, runs: usize, mut task: impl FnMut()) {
    let mut times: Vec<f64> = (0..runs)
        .map(|_| {
            let start = Instant::now();
            task();
            start.elapsed().as_secs_f64() * 1e3
        })
        .collect();
    times.sort_by(f64::total_cmp);
    println!("{:8.3} ms (least {:.3})  {what}", times[runs / 2], times[0]);
}

fn main() {
    let ball = shapes::sphere(0.05, 100, 50).expect("valid sizes");
    let split = ball.split();
    let mut surface = DeformingSurface::new(&split);
    let mut positions = ball.positions.clone();
    report(
        &format!("deform {} vertices, {} triangles", split.positions.len(), split.triangles.len()),
        201,
        || {
            positions.iter_mut().for_each(|p| p.z *= 0.999);
            surface.update(&positions).expect("as many positions as before");
        },
    );

    let n = 70u32;
    let uv: Vec<Vector2<f64>> = (0..=n)
        .flat_map(|j| (0..=n).map(move |i| Vector2::new(f64::from(i), f64::from(j)) / f64::from(n)))
        .collect();
    let triangles: Vec<[u32; 3]> = (0..n)
        .flat_map(|j| (0..n).map(move |i| j * (n + 1) + i))
        .flat_map(|a| [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]])
        .collect();
    let mut map = EditMap::new(1024, 1024).expect("a valid size");
    report("edit map 1024²: a new topology of 9,800 triangles", 11, || map.set_surface(&triangles, &uv));
    let mut omega = vec![0.0; uv.len()];
    map.paint(&SurfaceState { omega: Some(&omega), blood: None });
    report("edit map 1024²: nothing changed", 201, || {
        map.paint(&SurfaceState { omega: Some(&omega), blood: None });
    });
    report("edit map 1024²: 20 vertices burned", 201, || {
        (2500..2520).for_each(|vertex| omega[vertex] += 0.05);
        map.paint(&SurfaceState { omega: Some(&omega), blood: None });
    });
    let mut heat = ScalarMap::new(256, 256, 20.0, 120.0).expect("a valid size");
    heat.set_surface(&triangles, &uv);
    let mut celsius = vec![37.0; uv.len()];
    report("temperature map 256²: every vertex changed", 51, || {
        celsius.iter_mut().for_each(|t| *t += 0.5);
        heat.paint(&celsius);
    });

    let segments: Vec<[u32; 2]> = (1..200).map(|k| [k - 1, k]).collect();
    let mut thread: Vec<Point3<f64>> = (0..200)
        .map(|k| f64::from(k) * 0.2)
        .map(|t| Point3::new(0.01 * t.cos(), 0.01 * (1.3 * t).sin(), 0.001 * t))
        .collect();
    let mut tube = Tube::new(TubeStyle::default());
    report("tube through 200 points", 201, || {
        thread.iter_mut().for_each(|p| p.x *= 0.999);
        tube.update(&segments, &thread, 0.0002);
    });
    println!("             ({} vertices)", tube.positions().len());

    for name in ["liver", "fat", "peritoneum", "skin", "gauze", "plastic"] {
        report(&format!("{name} 512²"), 5, || {
            procedural(name, 512).expect("it is in the catalogue");
        });
    }
    let liver = procedural("liver", 512).expect("it is in the catalogue");
    report("mips of a colour map of 512²", 5, || {
        liver.color.clone().mips(MapKind::Color);
    });
}
