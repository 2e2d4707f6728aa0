//! Random strokes: whatever the hand does, the proxy stays on its side of the surface.

use crate::support::organ::Organ;
use crate::support::organ::shapes::{Mesh, burr, cuboid, hollow, inverted, joined, sphere, winding};
use nalgebra::{Point3, Vector3};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64;
use trocar_collision::Surface;
use trocar_collision::finger_proxy::{FingerProxy, ProxyConfig};
use trocar_collision::moving_surface::MovingSurface;
use trocar_collision::primitive::closest_on_triangle;

/// Strokes on each surface; a long run sets `TROCAR_PROXY_STROKES`.
fn strokes() -> usize {
    std::env::var("TROCAR_PROXY_STROKES").ok().and_then(|strokes| strokes.parse().ok()).unwrap_or(1_800)
}

/// Steps of a stroke.
const STEPS: usize = 10;

struct Hand {
    random: Pcg64,
    reach: f64,
    device: Point3<f64>,
}

impl Hand {
    fn new(seed: u64, reach: f64) -> Self {
        Self { random: Pcg64::seed_from_u64(seed), reach, device: Point3::origin() }
    }

    fn somewhere(&mut self, reach: f64) -> Point3<f64> {
        let mut coordinate = || self.random.random_range(-reach..reach);
        Point3::new(coordinate(), coordinate(), coordinate())
    }

    /// Where the next stroke goes: through everything, into something, or a little aside.
    fn goal(&mut self) -> Point3<f64> {
        match self.random.random_range(0..4) {
            0 => self.somewhere(2.0 * self.reach),
            1 => self.somewhere(self.reach),
            2 => self.device + self.somewhere(0.2 * self.reach).coords,
            _ => self.device + self.somewhere(0.02 * self.reach).coords,
        }
    }

    /// In how many steps: at a blow, or slowly.
    fn steps(&mut self) -> usize {
        [1, STEPS, 3 * STEPS][self.random.random_range(0..3)]
    }
}

fn nearest(vertices: &[Point3<f64>], triangles: &[[u32; 3]], point: &Point3<f64>) -> f64 {
    let distance = |corners: &[u32; 3]| {
        let triangle = corners.map(|vertex| vertices[vertex as usize]);
        (closest_on_triangle(point, &triangle).point - point).norm()
    };
    triangles.iter().map(distance).fold(f64::INFINITY, f64::min)
}

/// Surfaces that a proxy may fall through, each with how far a hand reaches about it.
fn surfaces() -> Vec<(&'static str, Mesh, f64)> {
    let nested = joined(hollow(Vector3::repeat(0.03), 0.0005), cuboid(Vector3::new(0.01, 0.02, 1e-4)));
    vec![
        ("a block", cuboid(Vector3::new(0.03, 0.02, 0.01)), 0.03),
        ("a room", inverted(cuboid(Vector3::new(0.03, 0.02, 0.015))), 0.03),
        ("a sheet thinner than the skin", cuboid(Vector3::new(0.03, 0.03, 1e-6)), 0.03),
        ("a hollow block with a sheet inside", nested, 0.03),
        ("a burr", burr(2, 0.03, 0.0), 0.03),
        ("a room of spikes", inverted(burr(2, 0.05, 0.0)), 0.04),
        ("a ball", sphere(2, |_| 0.02), 0.02),
        ("a tiny burr", burr(1, 3e-4, 0.0), 3e-4),
    ]
}

#[test]
fn no_stroke_brings_it_through_a_closed_surface() {
    let mut done = 0;
    for (index, (name, (vertices, triangles), reach)) in surfaces().into_iter().enumerate() {
        let mesh = MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"));
        for (radius, friction) in [(0.08 * reach, 0.0), (0.01 * reach, 0.5), (0.0, 0.0), (0.0, 0.3)] {
            let config = ProxyConfig {
                radius,
                skin: 2e-4 * reach,
                static_friction: friction,
                dynamic_friction: 0.8 * friction,
            };
            let mut finger = FingerProxy::new(config).expect("a valid proxy");
            let mut hand = Hand::new(index as u64, reach);
            hand.device = hand.somewhere(reach);
            let start = finger.step(&mesh, &hand.device, 0.001).expect("a finite device");
            let side = winding(&vertices, &triangles, &start).round();
            for stroke in 0..strokes() / 4 {
                let (from, to, steps) = (hand.device, hand.goal(), hand.steps());
                for step in 1..=steps {
                    hand.device = from + (to - from) * (step as f64 / steps as f64);
                    let place = finger.step(&mesh, &hand.device, 0.001).expect("a finite device");
                    let now = winding(&vertices, &triangles, &place).round();
                    assert_eq!(now, side, "{name}, {config:?}, stroke {stroke} step {step}: {place:?}");
                }
                // Nothing comes nearer than the sweep allows, but where it began in too narrow a place.
                let clearance = nearest(&vertices, &triangles, &finger.position());
                let least = config.radius + 0.4 * config.skin;
                let began = nearest(&vertices, &triangles, &start);
                assert!(clearance >= least.min(0.3 * began), "{name}, {config:?}, {stroke}: {clearance}");
                done += 1;
            }
            // It does get somewhere: freely where there is room.
            assert!(finger.statistics().moves > finger.statistics().steps, "{name}");
        }
    }
    assert!(done >= 10_000);
}

#[test]
fn a_hand_in_front_of_a_ball_reaches_what_is_free() {
    // That nothing is passed would be easy for a proxy that never moves.
    let (vertices, triangles) = sphere(3, |_| 0.02);
    let mesh = MovingSurface::new(&Surface::new(&vertices, &triangles).expect("a surface"));
    let mut finger = FingerProxy::new(ProxyConfig::default()).expect("a valid proxy");
    let mut hand = Hand::new(5, 0.02);
    finger.step(&mesh, &Point3::new(0.05, 0.0, 0.0), 0.001).expect("a finite device");
    for stroke in 0..500 {
        let goal = hand.somewhere(0.06);
        // Along a circle about the ball, and then straight out or in.
        for step in 0..400 {
            let (from, to) = (finger.position().coords, goal.coords);
            let direction = (from.normalize() * (1.0 - f64::from(step) / 400.0)
                + to.normalize() * (f64::from(step) / 400.0))
                .normalize();
            let device = Point3::from(direction * if step < 399 { 0.03 } else { to.norm() });
            finger.step(&mesh, &device, 0.001).expect("a finite device");
        }
        let place = finger.step(&mesh, &goal, 0.001).expect("a finite device");
        if goal.coords.norm() > 0.0222 {
            assert!((place - goal).norm() < 1e-9, "{stroke}: {place:?} {goal:?}");
        } else {
            assert!((0.0214..0.0222).contains(&place.coords.norm()), "{stroke}: {place:?}");
        }
    }
}

/// Strokes over a surface that is another at each step; how often walls met about the proxy.
fn strokes_over(
    what: &str,
    vertices_at: impl Fn(f64) -> Vec<Point3<f64>>,
    triangles: &[[u32; 3]],
    config: ProxyConfig,
    hand: &mut Hand,
    interval_secs: f64,
) -> u64 {
    let mut time = 0.0;
    let mut vertices = vertices_at(time);
    let mut mesh = MovingSurface::new(&Surface::new(&vertices, triangles).expect("a surface"));
    let mut finger = FingerProxy::new(config).expect("a valid proxy");
    finger.step(&mesh, &hand.device, 0.001).expect("a finite device");
    let mut side = winding(&vertices, triangles, &finger.position()).round();
    let mut squeezed = 0;
    for stroke in 0..strokes() / 10 {
        let (from, to, steps) = (hand.device, hand.goal(), hand.steps());
        for step in 1..=steps {
            time += interval_secs;
            vertices = vertices_at(time);
            mesh.update(&Surface::new(&vertices, triangles).expect("a surface"), interval_secs)
                .expect("a time");
            hand.device = from + (to - from) * (step as f64 / steps as f64);
            let place = finger.step(&mesh, &hand.device, 0.001).expect("a finite device");
            let now = winding(&vertices, triangles, &place).round();
            if finger.statistics().squeezed > squeezed {
                // It says so when it is lost.
                (squeezed, side) = (finger.statistics().squeezed, now);
            }
            assert_eq!(now, side, "{what}, {config:?}, stroke {stroke} step {step}: {place:?}");
        }
    }
    squeezed
}

#[test]
fn no_stroke_brings_it_through_a_burr_that_heaves() {
    for (seed, radius, interval) in [(1, 0.002, 0.001), (2, 0.0, 0.001), (3, 0.0, 0.03), (4, 0.001, 0.1)] {
        for flip in [false, true] {
            let (vertices, triangles) = if flip { inverted(burr(2, 0.03, 0.0)) } else { burr(2, 0.03, 0.0) };
            let mut hand = Hand::new(seed, 0.03);
            // In front of it: in its middle, or outside.
            hand.device = if flip { Point3::origin() } else { Point3::new(0.0, 0.0, 0.05) };
            let config = ProxyConfig { radius, ..ProxyConfig::default() };
            let at = |time: f64| burr(2, 0.03, time).0;
            assert_eq!(at(0.0), vertices);
            let squeezed = strokes_over("a burr", at, &triangles, config, &mut hand, interval);
            assert_eq!(squeezed, 0, "{config:?} {flip}");
        }
    }
}

#[test]
fn no_stroke_brings_it_through_an_organ_that_heaves_unless_its_folds_meet() {
    let organ = Organ::with_triangles(700);
    let triangles = organ.triangles();
    for (seed, radius, interval) in [(1, 0.002, 0.002), (2, 0.0, 0.002), (3, 0.001, 0.05)] {
        let config = ProxyConfig { radius, ..ProxyConfig::default() };
        let mut hand = Hand::new(seed, 0.06);
        hand.device = Point3::new(0.0, 0.0, 0.05);
        let at = |time: f64| organ.vertices(time);
        let squeezed = strokes_over("an organ", at, &triangles, config, &mut hand, interval);
        // In the narrowest bends so coarse a tube passes through itself.
        assert!(squeezed <= 1 + strokes() as u64 / 1000, "{squeezed}");
    }
}
