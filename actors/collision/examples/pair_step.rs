//! Prints what each part of a step costs of two organs that move in each other as in `trocar bench collision`, each asked
//! anew and with the front of the step before, the first one rigid or (`-- soft`) heaving at every third step:
//! `cargo run --release -p trocar-collision --example pair_step`.

use std::f64::consts::TAU;
use std::time::Instant;

use nalgebra::{Isometry3, Point3};
use trocar_collision::Surface;
use trocar_collision::moving_surface::MovingSurface;
use trocar_collision::obb_tree::{ObbTree, TreeFront, TreeQuery};
use trocar_collision::penetration::PenetrationSearch;
use trocar_scene::shapes;

const STEPS: usize = 4_000;
const RADIUS: f64 = 0.05;

fn bumpy(triangles: usize) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
    let rings = ((triangles as f64 / 8.0).sqrt().round() as usize).max(3);
    let segments = (triangles / (2 * (2 * rings - 1))).max(8);
    let ball = shapes::sphere(RADIUS, segments, rings).expect("a ball");
    let bump = |vertex: &Point3<f64>| {
        let unit = vertex.coords / RADIUS;
        let wave = (5.0 * unit.x).sin() * (4.0 * unit.y).cos() + 0.6 * (9.0 * unit.z + 6.0 * unit.x).sin();
        Point3::from(vertex.coords * (1.0 + 0.12 * wave))
    };
    (ball.positions.iter().map(bump).collect(), ball.triangles)
}

fn micros(mut times: Vec<f64>) -> String {
    times.sort_unstable_by(f64::total_cmp);
    let at = |share: f64| times[((times.len() - 1) as f64 * share) as usize];
    let mean = times.iter().sum::<f64>() / times.len() as f64;
    format!("p50 {:7.2}  mean {:7.2}  p99 {:7.2}  max {:7.2} us", at(0.5), mean, at(0.99), at(1.0))
}

fn timed<T>(times: &mut Vec<f64>, work: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = work();
    times.push(start.elapsed().as_secs_f64() * 1e6);
    result
}

fn main() {
    let (vertices, triangles) = bumpy(10_000);
    let surface = Surface::new(&vertices, &triangles).expect("a surface");
    let (mut tree, other) = (ObbTree::build(&surface), ObbTree::build(&surface));
    let (mut soft, moving) = (MovingSurface::new(&surface), MovingSurface::new(&surface));
    let heaves = std::env::args().nth(1).is_some();
    let (mut query, mut front) = (TreeQuery::new(), TreeFront::new());
    let mut search = [PenetrationSearch::new(), PenetrationSearch::new()];
    let mut touches_at = 0.2;
    for _ in 0..200 {
        let near = query.distance(&tree, &tree, &Isometry3::translation(0.0, 0.0, touches_at), None);
        let Some(near) = near.filter(|near| near.distance > 1e-7) else { break };
        touches_at -= near.distance;
    }
    let (mut anew, mut kept, mut first, mut second) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let (mut pairs, mut inside) = (0, 0);
    let mut refits = Vec::new();
    for step in 0..STEPS {
        let time = step as f64 * 1e-3;
        if heaves && step % 3 == 0 {
            let wave = |at: &Point3<f64>| {
                at + at.coords * (0.008 * (90.0 * at.x - 6.0 * time).sin() * (70.0 * at.y).cos())
            };
            let now: Vec<Point3<f64>> = vertices.iter().map(wave).collect();
            timed(&mut refits, || {
                tree.refit(&now).expect("as many vertices");
                soft.follow(&Surface::new(&now, &triangles).expect("a surface"));
            });
        }
        let side = 0.002 * (0.7 * TAU * time).sin();
        let height = touches_at - 0.0008 + 0.0004 * (TAU * time).sin();
        let pose = Isometry3::translation(side, 0.5 * side, height);
        let touching = timed(&mut anew, || query.all_contacts(&tree, &other, &pose)).len();
        assert_eq!(timed(&mut kept, || front.all_contacts(&tree, &other, &pose)).len(), touching);
        let touching = front.pairs();
        pairs += touching.len();
        let seeds = |side: usize| touching.iter().map(move |pair| pair.triangles[side]);
        inside += timed(&mut first, || {
            search[0].vertices_inside(&moving, &soft, &pose, seeds(1), f64::INFINITY, 256).len()
        });
        inside += timed(&mut second, || {
            search[1].vertices_inside(&soft, &moving, &pose.inverse(), seeds(0), f64::INFINITY, 256).len()
        });
    }
    println!(
        "pairs per step {:.1}, vertices inside {:.1}",
        pairs as f64 / STEPS as f64,
        inside as f64 / STEPS as f64
    );
    if heaves {
        println!("both trees follow           {}", micros(refits));
    }
    println!("all contacts, anew          {}", micros(anew));
    println!("all contacts, by the front  {}  {:?}", micros(kept), front.cost());
    println!("second inside of the first  {}", micros(first));
    println!("first inside of the second  {}", micros(second));
}
