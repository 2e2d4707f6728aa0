//! Needles and threads at 1 m/s against a membrane of 1 mm that deforms: no crossing goes unregistered.

use std::collections::BTreeSet;

use nalgebra::{Point3, Rotation3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use trocar_collision::continuous::{ImpactFinder, Sweep, SweptLine, SweptSurface};
use trocar_collision::primitive::closest_segment_triangle;
use trocar_collision::{Line, Part, Surface};

/// Cells of the membrane along each side.
const CELLS: usize = 24;
/// Distance of the two layers \[m\].
const THICKNESS: f64 = 1e-3;

/// A membrane above a plane: each layer is the graph of a height over a triangulated square, at both ends of the step
/// and so all the time in between.
struct Membrane {
    cell: f64,
    layers: usize,
    triangles: Vec<[u32; 3]>,
    vertices: Sweep<Vec<Point3<f64>>>,
}

impl Membrane {
    fn new(random: &mut Pcg64Mcg, width: f64) -> Self {
        let (cell, layers) = (width / CELLS as f64, random.random_range(1..=2));
        let mut triangles = Vec::new();
        for layer in 0..layers {
            let first = layer * (CELLS + 1) * (CELLS + 1);
            for (row, column) in (0..CELLS).flat_map(|row| (0..CELLS).map(move |column| (row, column))) {
                let a = (first + row * (CELLS + 1) + column) as u32;
                let (b, c, d) = (a + 1, a + CELLS as u32 + 1, a + CELLS as u32 + 2);
                triangles.extend(if random.random_bool(0.5) {
                    [[a, b, d], [a, d, c]]
                } else {
                    [[a, b, c], [b, d, c]]
                });
            }
        }
        let from = Self::shape(random, cell, layers);
        let to = if random.random_bool(0.2) { from.clone() } else { Self::shape(random, cell, layers) };
        Self { cell, layers, triangles, vertices: Sweep { from, to } }
    }

    /// Waves of up to 2 mm, and sideways as much as keeps every triangle the right way up.
    fn shape(random: &mut Pcg64Mcg, cell: f64, layers: usize) -> Vec<Point3<f64>> {
        let wave: [f64; 4] = std::array::from_fn(|_| random.random_range(-1e-3..1e-3));
        let mut vertices = Vec::new();
        for layer in 0..layers {
            for (row, column) in (0..=CELLS).flat_map(|row| (0..=CELLS).map(move |column| (row, column))) {
                let [x, y] = [column, row].map(|place| (place as f64 - CELLS as f64 / 2.0) * cell);
                let height = wave[0] * (x * 300.0).sin()
                    + wave[1] * (y * 200.0 + 1.0).cos()
                    + wave[2] * (x + y) * 50.0;
                let noise = Vector3::from_fn(|_, _| random.random_range(-0.2..0.2));
                let sideways = Vector3::new(noise.x * cell, noise.y * cell, noise.z * THICKNESS);
                vertices.push(Point3::new(x, y, height + wave[3] - layer as f64 * THICKNESS) + sideways);
            }
        }
        vertices
    }

    fn at(&self, time: f64) -> Vec<Point3<f64>> {
        self.vertices.from.iter().zip(&self.vertices.to).map(|(from, to)| from + (to - from) * time).collect()
    }

    /// Triangles of a layer that can lie above or below a rectangle.
    fn near(&self, layer: usize, low: [f64; 2], high: [f64; 2]) -> impl Iterator<Item = [u32; 3]> + '_ {
        let cell = |place: f64, more: f64| {
            (place / self.cell + CELLS as f64 / 2.0 + more).floor().clamp(0.0, CELLS as f64 - 1.0) as usize
        };
        let [[x0, x1], [y0, y1]] = [0, 1].map(|axis| [cell(low[axis], -0.5), cell(high[axis], 0.5)]);
        (y0..=y1).flat_map(move |row| {
            let first = 2 * (layer * CELLS * CELLS + row * CELLS);
            self.triangles[first + 2 * x0..first + 2 * x1 + 2].iter().copied()
        })
    }

    /// How high a point is above each layer \[m\]; nothing beside the membrane.
    fn height(&self, vertices: &[Point3<f64>], layer: usize, point: &Point3<f64>) -> Option<f64> {
        let beside = [point.x, point.y];
        self.near(layer, beside, beside).find_map(|corners| {
            let [a, b, c] = corners.map(|corner| vertices[corner as usize]);
            let area = |p: &Point3<f64>, q: &Point3<f64>, r: &Point3<f64>| {
                (q.x - p.x) * (r.y - p.y) - (q.y - p.y) * (r.x - p.x)
            };
            let weights = [area(&b, &c, point), area(&c, &a, point), area(&a, &b, point)];
            let whole = area(&a, &b, &c);
            assert!(whole > 0.0, "a layer is a graph");
            weights
                .iter()
                .all(|weight| *weight >= 0.0)
                .then(|| point.z - (weights[0] * a.z + weights[1] * b.z + weights[2] * c.z) / whole)
        })
    }
}

/// A needle of a few segments, or a thread of many, at 1 m/s for one step of a solver.
fn line(random: &mut Pcg64Mcg, reach: f64) -> Sweep<Vec<Point3<f64>>> {
    let step = [1.0 / 60.0, 0.005, 0.002, 0.001][random.random_range(0..4)];
    let is_needle = random.random_bool(0.5);
    let (count, length) = if is_needle {
        (random.random_range(2..5), random.random_range(0.001..0.01))
    } else {
        (random.random_range(10..40), random.random_range(0.0002..0.0008))
    };
    let unit = |random: &mut Pcg64Mcg| loop {
        let vector = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0_f64));
        if vector.norm() > 0.1 && vector.norm() < 1.0 {
            return vector.normalize();
        }
    };
    let mut place = Point3::from(Vector3::from_fn(|axis, _| {
        if axis == 2 { random.random_range(-0.01..0.01) } else { random.random_range(-reach..reach) }
    }));
    let mut heading = unit(random);
    let from: Vec<_> = (0..count)
        .map(|_| {
            let here = place;
            if !is_needle {
                heading = (heading + unit(random) * 0.5).normalize();
            }
            place += heading * length;
            here
        })
        .collect();
    let motion = unit(random) * step;
    let turn = Rotation3::new(unit(random) * random.random_range(0.0..0.3));
    let whip = if is_needle { 0.0 } else { 0.3 * step };
    let to =
        from.iter().map(|point| from[0] + turn * (point - from[0]) + motion + unit(random) * whip).collect();
    Sweep { from, to }
}

fn chain(count: usize) -> Vec<[u32; 2]> {
    (1..count as u32).map(|end| [end - 1, end]).collect()
}

fn trials(count: usize) -> usize {
    count * std::env::var("TROCAR_TRIALS").ok().and_then(|factor| factor.parse().ok()).unwrap_or(1)
}

/// Which segments a layer is passed through by.
fn crossings(membrane: &Membrane, vertices: &[Point3<f64>], line: &[Point3<f64>]) -> BTreeSet<(usize, u32)> {
    let mut found = BTreeSet::new();
    for layer in 0..membrane.layers {
        for (segment, ends) in line.windows(2).enumerate() {
            let (low, high) = (ends[0].inf(&ends[1]), ends[0].sup(&ends[1]));
            let crossed = membrane.near(layer, [low.x, low.y], [high.x, high.y]).any(|corners| {
                let triangle = corners.map(|corner| vertices[corner as usize]);
                closest_segment_triangle(&[ends[0], ends[1]], &triangle).distance_squared == 0.0
            });
            if crossed {
                found.insert((layer, segment as u32));
            }
        }
    }
    found
}

/// Runs trials over a membrane of some width; returns sides changed and segments that began to cross.
fn run(width: f64, seed: u64, count: usize, moments: usize) -> (usize, usize) {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut finder = ImpactFinder::new();
    let (mut changed, mut begun) = (0, 0);
    for trial in 0..count {
        let membrane = Membrane::new(&mut random, width);
        let thread = line(&mut random, 0.008);
        let segments = chain(thread.from.len());
        let moving = Line::new(&thread.from, &segments, 0.0).expect("a line");
        let moving = SweptLine::new(moving, &thread.to).expect("a line");
        let surface = Surface::new(&membrane.vertices.from, &membrane.triangles).expect("a surface");
        let surface = SweptSurface::new(surface, &membrane.vertices.to).expect("a surface");
        let impacts = finder.line_surface(&moving, &surface, 0.0);
        let of_layer = |part: Part| {
            let vertex = match part {
                Part::Triangle(triangle) => membrane.triangles[triangle as usize][0],
                Part::Edge([vertex, _]) => vertex,
                other => panic!("a surface has no {other:?}"),
            };
            vertex as usize / ((CELLS + 1) * (CELLS + 1))
        };
        for layer in 0..membrane.layers {
            for vertex in 0..thread.from.len() {
                let before = membrane.height(&membrane.vertices.from, layer, &thread.from[vertex]);
                let after = membrane.height(&membrane.vertices.to, layer, &thread.to[vertex]);
                let (Some(before), Some(after)) = (before, after) else {
                    assert!(width < 0.05, "beside a membrane that is wide enough");
                    continue;
                };
                // Within a wide membrane, who is on the other side has gone through it.
                if width >= 0.05 && (before > 0.0) != (after > 0.0) {
                    changed += 1;
                    let registered = impacts.iter().any(|found| {
                        found.first == Part::Vertex(vertex as u32) && of_layer(found.second) == layer
                    });
                    assert!(registered, "trial {trial}: vertex {vertex} went through layer {layer} unseen");
                }
            }
        }
        let already = crossings(&membrane, &membrane.vertices.from, &thread.from);
        let mut seen = already.clone();
        for moment in 1..=moments {
            let time = moment as f64 / moments as f64;
            let line: Vec<_> =
                thread.from.iter().zip(&thread.to).map(|(from, to)| from + (to - from) * time).collect();
            for (layer, segment) in crossings(&membrane, &membrane.at(time), &line) {
                if !seen.insert((layer, segment)) {
                    continue;
                }
                begun += 1;
                let ends = [Part::Segment(segment), Part::Vertex(segment), Part::Vertex(segment + 1)];
                let registered = impacts.iter().any(|found| {
                    ends.contains(&found.first)
                        && of_layer(found.second) == layer
                        && found.impact.time <= time + 1e-9
                });
                assert!(
                    registered,
                    "trial {trial}: segment {segment} came into layer {layer} unseen by {time}"
                );
            }
        }
    }
    (changed, begun)
}

#[test]
fn nothing_goes_through_a_wide_membrane_unregistered() {
    let (changed, begun) = run(0.13, 1, trials(10_000), 8);
    assert!(changed > 20_000 && begun > 10_000, "{changed} sides changed, {begun} crossings begun");
}

#[test]
fn nothing_goes_over_the_border_of_a_small_one_unregistered() {
    let (_, begun) = run(0.01, 2, trials(2_000), 16);
    assert!(begun > 1_000, "{begun} crossings begun");
}

/// How far a line is from the membrane \[m\], where that is less than `reach`.
fn distance(membrane: &Membrane, line: &[Point3<f64>], reach: f64) -> f64 {
    let mut least = reach;
    for layer in 0..membrane.layers {
        for ends in line.windows(2) {
            let (low, high) = (ends[0].inf(&ends[1]), ends[0].sup(&ends[1]));
            for corners in
                membrane.near(layer, [low.x - reach, low.y - reach], [high.x + reach, high.y + reach])
            {
                let triangle = corners.map(|corner| membrane.vertices.from[corner as usize]);
                let apart = closest_segment_triangle(&[ends[0], ends[1]], &triangle).distance_squared.sqrt();
                least = least.min(apart);
            }
        }
    }
    least
}

#[test]
fn a_solver_that_stops_at_the_first_impact_stays_on_its_side() {
    let mut random = Pcg64Mcg::seed_from_u64(5);
    let mut finder = ImpactFinder::new();
    let (mut stops, mut near) = (0, 0);
    for trial in 0..trials(400) {
        let radius = if trial % 2 == 0 { 0.0 } else { 2e-4 };
        let mut membrane = Membrane::new(&mut random, 0.4);
        let mut thread = line(&mut random, 0.008);
        let segments = chain(thread.from.len());
        if distance(&membrane, &thread.from, 2.0 * radius + 1e-6) <= radius {
            continue;
        }
        let side = |membrane: &Membrane, thread: &[Point3<f64>]| -> Vec<bool> {
            let heights = (0..membrane.layers).flat_map(|layer| {
                thread.iter().map(move |point| membrane.height(&membrane.vertices.from, layer, point))
            });
            heights.map(|height| height.expect("a membrane that is wide enough") > 0.0).collect()
        };
        let before = side(&membrane, &thread.from);
        for _ in 0..15 {
            let moving = Line::new(&thread.from, &segments, radius).expect("a line");
            let moving = SweptLine::new(moving, &thread.to).expect("a line");
            let surface = Surface::new(&membrane.vertices.from, &membrane.triangles).expect("a surface");
            let surface = SweptSurface::new(surface, &membrane.vertices.to).expect("a surface");
            let impacts = finder.line_surface(&moving, &surface, 0.0);
            assert!(impacts.is_sorted_by(|a, b| a.impact.time <= b.impact.time));
            let first = impacts.first().map(|found| found.impact.time);
            stops += usize::from(first.is_some());
            let time = first.unwrap_or(1.0);
            let vertices = membrane.at(time);
            let stopped: Vec<_> =
                thread.from.iter().zip(&thread.to).map(|(from, to)| from + (to - from) * time).collect();
            membrane.vertices = Sweep { from: vertices, to: membrane.at(1.0) };
            // Back towards the middle, so that it stays above the membrane.
            let next = line(&mut random, 0.008);
            let home = (Point3::origin() - stopped[0]) * 0.1;
            let motion = next.to[0] - next.from[0] + home;
            thread.to = stopped.iter().map(|point| point + motion).collect();
            thread.from = stopped;
            assert_eq!(side(&membrane, &thread.from), before, "trial {trial}");
            let apart = distance(&membrane, &thread.from, 2.0 * radius + 1e-6);
            assert!(apart > 0.0 && apart >= radius * (1.0 - 1e-9), "trial {trial}: {apart} apart");
            near += usize::from(radius > 0.0 && apart < radius * (1.0 + 1e-6));
        }
    }
    assert!(stops > 500 && near > 200, "{stops} stops, {near} of a tube that touches");
}
