//! Viscosity and walls of a liquid against closed forms: tubes, plates, a decaying vortex, a pool at rest.

use std::f64::consts::PI;

use crate::support::basin::{smooth_tank, tank, walls};
use nalgebra::{Point3, Vector3};
use trocar_simulator::fluid::{Ends, Fluid, FluidConfig};

const DENSITY: f64 = 1060.0;
/// Length of a piece of a channel, in spacings.
const LENGTH: i32 = 8;

/// Zeros of the Bessel function J₀, and J₁ there.
const BESSEL: [(f64, f64); 5] = [
    (2.404_825_557_695_773, 0.519_147_497_3),
    (5.520_078_110_286_311, -0.340_264_806_6),
    (8.653_727_912_911_013, 0.271_452_299_9),
    (11.791_534_439_014_281, -0.232_459_831_4),
    (14.930_917_708_487_787, 0.206_546_433_1),
];

fn bessel_j0(x: f64) -> f64 {
    let steps = 200;
    let angle = |step: i32| PI * (f64::from(step) + 0.5) / f64::from(steps);
    (0..steps).map(|step| (x * angle(step).sin()).cos()).sum::<f64>() / f64::from(steps)
}

/// Velocity over that at the axis in the end, at a time in terms of R²/ν and a distance from the axis in terms of R, of a
/// liquid in a tube that starts from rest (Szymanski 1932).
fn tube(time: f64, at: f64) -> f64 {
    let series =
        BESSEL.map(|(zero, j1)| (-zero * zero * time).exp() * bessel_j0(zero * at) / (zero.powi(3) * j1));
    1.0 - at * at - 8.0 * series.iter().sum::<f64>()
}

/// The same between plates, with half of their distance for R.
fn plates(time: f64, at: f64) -> f64 {
    let term = |index: i32| {
        let (k, sign) = (f64::from(2 * index + 1), if index % 2 == 0 { 1.0 } else { -1.0 });
        sign * (k * PI * at / 2.0).cos() / k.powi(3) * (-(k * PI / 2.0).powi(2) * time).exp()
    };
    1.0 - at * at - 32.0 / PI.powi(3) * (0..20).map(term).sum::<f64>()
}

/// Velocity over that of the lower plate, which has begun to slide.
fn couette(time: f64, at: f64) -> f64 {
    let up = 0.5 * (at + 1.0);
    let term = |k: i32| {
        let k = f64::from(k) * PI;
        (k * up).sin() / k * (-k * k * time / 4.0).exp()
    };
    1.0 - up - 2.0 * (1..40).map(term).sum::<f64>()
}

#[derive(Clone, Copy, PartialEq)]
enum Channel {
    Tube,
    Plates,
    /// Plates, the lower of which slides.
    Couette,
}

impl Channel {
    fn exact(self, time: f64, at: f64) -> f64 {
        match self {
            Self::Tube => tube(time, at),
            Self::Plates => plates(time, at),
            Self::Couette => couette(time, at),
        }
    }
}

/// A channel along x of this radius, or half of this distance, with `across` particles along that.
fn channel(kind: Channel, radius: f64, across: i32, viscosity: f64, speed: f64) -> Fluid {
    let spacing = radius / f64::from(across);
    let length = f64::from(LENGTH) * spacing;
    let drop = match kind {
        Channel::Tube => 4.0,
        Channel::Plates => 2.0,
        Channel::Couette => 0.0,
    } * DENSITY
        * viscosity
        * speed
        / (radius * radius)
        * length;
    let beyond = radius + 4.0 * spacing;
    let side = if kind == Channel::Tube { [-beyond, beyond] } else { [0.0, 4.0 * spacing] };
    let config = FluidConfig {
        spacing,
        viscosity,
        gravity: Vector3::zeros(),
        ends: Some(Ends { axis: 0, pressure_drop: drop }),
        min: Point3::new(0.0, side[0], -beyond),
        max: Point3::new(length, side[1], beyond),
        parts_max: 10_000,
        ..FluidConfig::default()
    };
    let mut fluid = Fluid::new(config).expect("a liquid");
    let (mut samples, mut velocities, mut normals) = (Vec::new(), Vec::new(), Vec::new());
    let mut add = |sample: Point3<f64>, velocity: f64, normal: Vector3<f64>| {
        samples.push(sample);
        velocities.push(Vector3::x() * velocity);
        normals.push(normal);
    };
    let middle = |index: i32| (f64::from(index) + 0.5) * spacing;
    for i in -3..LENGTH + 3 {
        if kind == Channel::Tube {
            let wall = radius + 0.5 * spacing;
            let around = (2.0 * PI * wall / spacing).ceil() as i32;
            for step in 0..around {
                let (sin, cos) = (2.0 * PI * f64::from(step) / f64::from(around)).sin_cos();
                add(Point3::new(middle(i), wall * cos, wall * sin), 0.0, Vector3::zeros());
            }
        } else {
            for j in -1..5 {
                let slides = if kind == Channel::Couette { speed } else { 0.0 };
                add(Point3::new(middle(i), middle(j), -radius - 0.5 * spacing), slides, Vector3::zeros());
                add(Point3::new(middle(i), middle(j), radius + 0.5 * spacing), 0.0, Vector3::zeros());
            }
            // Smooth sides.
            for k in -across - 2..across + 2 {
                add(Point3::new(middle(i), middle(-1), middle(k)), 0.0, Vector3::y());
                add(Point3::new(middle(i), middle(4), middle(k)), 0.0, Vector3::y());
            }
        }
    }
    fluid.set_walls(&samples, &velocities).expect("walls");
    fluid.set_wall_normals(&normals).expect("one for each");
    let sides = if kind == Channel::Tube { -across..across } else { 0..4 };
    for (i, j, k) in
        (0..LENGTH).flat_map(|i| sides.clone().flat_map(move |j| (-across..across).map(move |k| (i, j, k))))
    {
        let place = Point3::new(middle(i), middle(j), middle(k));
        if kind != Channel::Tube || place.y.hypot(place.z) < radius {
            fluid.add(place, Vector3::zeros()).expect("in the box");
        }
    }
    fluid
}

/// Runs to times in terms of R²/ν; for each, the velocities over those of the closed form, by least squares, less 1.
fn errors(kind: Channel, [radius, viscosity, speed]: [f64; 3], times: &[f64]) -> (Fluid, Vec<f64>) {
    let mut fluid = channel(kind, radius, 5, viscosity, speed);
    let scale = radius * radius / viscosity;
    let (mut time, mut errors) = (0.0, Vec::new());
    for until in times {
        let steps = ((until - time) * 60.0_f64).round();
        for _ in 0..steps as u32 {
            fluid.step((until - time) / steps * scale).expect("a step");
        }
        time = *until;
        let state = fluid.state();
        let (mut off, mut whole) = (0.0, 0.0);
        for (place, velocity) in state.positions.iter().zip(&state.velocities) {
            let at = if kind == Channel::Tube { place.y.hypot(place.z) } else { place.z } / radius;
            let exact = kind.exact(time, at);
            off += (velocity.x / speed - exact) * exact;
            whole += exact * exact;
        }
        errors.push(off / whole);
    }
    (fluid, errors)
}

#[test]
fn the_closed_form_of_a_tube_is_that_of_the_reference() {
    // Blood, R 1 mm, after 0.05, 0.1 and 0.2 s.
    let scale = 3.5e-3 / 1060.0 / 1e-6;
    for (seconds, expected) in [(0.05, 0.574), (0.1, 0.836), (0.2, 0.976)] {
        assert!((tube(seconds * scale, 0.0) - expected).abs() < 5e-4, "{seconds}");
    }
}

#[test]
fn a_liquid_in_a_tube_starts_as_bessels_series_has_it_and_its_walls_bear_the_drop() {
    // Blood in an artery, an oil, honey at 10 Pa s; five particles across the radius.
    for case in [[1e-3, 3.3e-6, 0.01], [3e-3, 1e-4, 0.1], [5e-3, 10.0 / DENSITY, 1.0]] {
        let (fluid, errors) = errors(Channel::Tube, case, &[0.1651, 0.3302, 0.6604]);
        assert!(errors.iter().all(|error| error.abs() < 0.08), "{case:?}: {errors:?}");
        let ends = fluid.config().ends.expect("ends");
        let held: f64 = fluid.wall_forces().iter().map(|force| force.x).sum();
        let spacing = fluid.config().spacing;
        let area =
            fluid.state().numbers.len() as f64 * fluid.particle_volume() / (f64::from(LENGTH) * spacing);
        assert!((held / (ends.pressure_drop * area) - 1.0).abs() < 0.08, "{case:?}: {held} N");
        // The pressure at the two ends differs by the drop.
        let mean = |near: f64| {
            let state = fluid.state();
            let at = |place: &Point3<f64>| (place.x - near).abs() < spacing;
            let all: Vec<f64> = state
                .positions
                .iter()
                .zip(fluid.pressures())
                .filter(|(p, _)| at(p))
                .map(|(_, p)| *p)
                .collect();
            all.iter().sum::<f64>() / all.len() as f64
        };
        let length = f64::from(LENGTH) * spacing;
        let between = mean(0.5 * spacing) - mean(length - 0.5 * spacing);
        assert!(
            (between / ends.pressure_drop - 0.82).abs() < 0.35,
            "{case:?}: {between} Pa of {} Pa",
            ends.pressure_drop
        );
    }
}

#[test]
fn a_liquid_between_plates_starts_as_the_closed_forms_have_it() {
    for case in [[1e-3, 3.3e-6, 0.01], [2e-3, 1e-4, 0.1]] {
        let errors_of = |kind: Channel| errors(kind, case, &[0.1651, 0.4, 1.0]).1;
        let (pressed, dragged) = (errors_of(Channel::Plates), errors_of(Channel::Couette));
        assert!(pressed.iter().all(|error| error.abs() < 0.1), "{case:?}: {pressed:?} driven by pressure");
        assert!(dragged.iter().all(|error| error.abs() < 0.08), "{case:?}: {dragged:?} dragged by a plate");
    }
}

/// Decay of a vortex that fills a closed smooth box, `across` particles wide, until it has turned once, as a viscosity
/// \[m²/s\]; and the spacing \[m\].
fn vortex(across: i32, width: f64, speed: f64, viscosity: f64, steps: i32) -> (f64, f64) {
    let (spacing, layers) = (width / f64::from(across), 4);
    let config =
        FluidConfig { viscosity, gravity: Vector3::zeros(), parts_max: 1000, ..FluidConfig::default() };
    let mut fluid = tank([across, across, layers], [0; 3], spacing, config);
    // Its sides and its lid.
    let (samples, normals) = walls([across, across, layers], spacing);
    let sides = samples.into_iter().zip(normals).filter(|(sample, _)| sample.z < f64::from(layers) * spacing);
    let (mut samples, mut normals): (Vec<_>, Vec<_>) = sides.unzip();
    for (i, j) in (-1..=across).flat_map(|i| (-1..=across).map(move |j| (i, j))) {
        samples.push(Point3::from([i, j, layers].map(|index| (f64::from(index) + 0.5) * spacing)));
        normals.push(Vector3::z());
    }
    fluid.set_walls(&samples, &vec![Vector3::zeros(); samples.len()]).expect("walls");
    fluid.set_wall_normals(&normals).expect("one for each");
    let wave = PI / width;
    let shape = |place: &Point3<f64>| {
        let [(sx, cx), (sy, cy)] = [(wave * place.x).sin_cos(), (wave * place.y).sin_cos()];
        Vector3::new(sx * cy, -cx * sy, 0.0)
    };
    for (i, j, k) in
        (0..across).flat_map(|i| (0..across).flat_map(move |j| (0..layers).map(move |k| (i, j, k))))
    {
        let place = Point3::from([i, j, k].map(|index| (f64::from(index) + 0.5) * spacing));
        fluid.add(place, shape(&place) * speed).expect("in the box");
    }
    let amplitude = |fluid: &Fluid| {
        let state = fluid.state();
        let each =
            state.positions.iter().zip(&state.velocities).map(|(place, velocity)| (shape(place), velocity));
        let (along, whole) = each.fold((0.0, 0.0), |(along, whole), (shape, velocity)| {
            (along + shape.dot(velocity), whole + shape.norm_squared())
        });
        along / whole
    };
    let seconds = width / speed;
    let before = amplitude(&fluid);
    for _ in 0..steps {
        fluid.step(seconds / f64::from(steps)).expect("a step");
    }
    let rate = -(amplitude(&fluid) / before).ln() / seconds;
    (rate / (2.0 * wave * wave), spacing)
}

/// Particles exchange momentum as they make way for each other, as a viscosity of at most half of their size times the
/// velocity would. (Before, a vortex in blood of 50 particles across decayed fifteen times too fast.)
#[test]
fn a_vortex_decays_by_the_viscosity_where_particles_carry_it_and_by_no_more_than_their_size_elsewhere() {
    let speed = 0.1;
    for (viscosity, across, steps) in [(1e-4, 16, 100), (3.3e-5, 24, 50), (3.3e-6, 24, 50)] {
        let (is, spacing) = vortex(across, 0.01, speed, viscosity, steps);
        let excess = (is - viscosity) / (spacing * speed);
        assert!(
            (-0.1..0.5).contains(&excess),
            "{viscosity} m²/s is {is} m²/s: {excess} spacings times speed"
        );
        if viscosity > spacing * speed {
            assert!((is / viscosity - 1.0).abs() < 0.25, "{viscosity} m²/s is {is} m²/s");
        }
    }
}

#[test]
fn a_pool_comes_to_rest_within_a_second_and_its_surface_stays() {
    let n = 12;
    for (make, dt, viscosity) in [
        (tank as fn([i32; 3], [i32; 3], f64, FluidConfig) -> Fluid, 0.005, 3.3e-6),
        (smooth_tank, 1.0 / 60.0, 3.3e-6),
        (tank, 1.0 / 60.0, 10.0 / DENSITY),
    ] {
        let config = FluidConfig { viscosity, ..FluidConfig::default() };
        let mut fluid = make([n, n, n + 6], [n; 3], 2e-3, config);
        let count = f64::from(n * n * n);
        let (mut square, mut height, mut steps) = (0.0, 0.0, 0.0);
        let all = (1.2 / dt) as u32;
        for step in 0..all {
            fluid.step(dt).expect("a step");
            if f64::from(step) * dt >= 1.0 {
                let state = fluid.state();
                square += state.velocities.iter().map(Vector3::norm_squared).sum::<f64>() / count;
                height += 2.0 * state.positions.iter().map(|place| place.z).sum::<f64>() / count;
                steps += 1.0;
            }
        }
        let (rest, height) = ((square / steps).sqrt(), height / steps / (f64::from(n) * 2e-3));
        assert_eq!(fluid.state().absorbed, 0, "nothing leaks");
        assert!(rest < 5e-3, "{viscosity} m²/s in steps of {dt} s: {rest} m/s");
        assert!(
            (0.975..1.01).contains(&height),
            "{viscosity} m²/s: the surface is at {height} of its height"
        );
    }
}

#[test]
fn a_liquid_of_any_viscosity_falls_freely_and_keeps_its_turn() {
    for viscosity in [0.0, 3.3e-6, 1e-3, 1.0] {
        let config = FluidConfig { viscosity, gravity: Vector3::zeros(), ..FluidConfig::default() };
        let mut fluid = Fluid::new(config).expect("a liquid");
        let spacing = fluid.config().spacing;
        let (turn, speed) = (20.0, Vector3::new(0.05, 0.0, -0.1));
        for (i, j, k) in (-3..3).flat_map(|i| (-3..3).flat_map(move |j| (-3..3).map(move |k| (i, j, k)))) {
            let place = Point3::from([i, j, k].map(|index| (f64::from(index) + 0.5) * spacing));
            fluid.add(place, speed + Vector3::new(-place.y, place.x, 0.0) * turn).expect("in the box");
        }
        let moments = |fluid: &Fluid| {
            let state = fluid.state();
            let middle = state.positions.iter().map(|place| place.coords).sum::<Vector3<f64>>() / 216.0;
            let each = || state.positions.iter().zip(&state.velocities);
            let momentum = each().map(|(_, velocity)| velocity).sum::<Vector3<f64>>();
            (
                momentum,
                each()
                    .map(|(place, velocity)| (place.coords - middle).cross(velocity))
                    .sum::<Vector3<f64>>()
                    .z,
            )
        };
        let before = moments(&fluid);
        for _ in 0..20 {
            fluid.step(0.005).expect("a step");
        }
        let after = moments(&fluid);
        assert!(
            (after.0 - before.0).norm() < 1e-6 * before.0.norm(),
            "{viscosity}: {after:?} from {before:?}"
        );
        assert!(
            (after.1 / before.1 - 1.0).abs() < 0.02,
            "{viscosity}: it turns by {} of before",
            after.1 / before.1
        );
    }
}

#[test]
fn ends_out_of_range_are_refused() {
    let with = |axis: usize, max: f64| {
        let ends = Some(Ends { axis, pressure_drop: 1.0 });
        Fluid::new(FluidConfig { ends, max: Point3::new(max, 0.1, 0.1), ..FluidConfig::default() })
    };
    assert!(with(0, 0.1).is_ok() && with(3, 0.1).is_err() && with(0, -0.095).is_err());
}

/// Liquid that comes out of a wound is crowded at first: what damps its noise adds no energy there.
#[test]
fn crowded_liquid_spreads_without_being_thrown_about() {
    for (crowd, viscosity) in [(0.3, 3.3e-6), (0.3, 0.0), (0.15, 1e-6)] {
        let config = FluidConfig { gravity: Vector3::zeros(), viscosity, ..FluidConfig::default() };
        let spacing = config.spacing;
        let mut fluid = Fluid::new(config).expect("a box");
        for index in 0..40 {
            let turn = f64::from(index);
            let place = Vector3::new(turn.sin(), (1.7 * turn).cos(), (2.3 * turn).sin());
            fluid.add(Point3::from(place * (crowd * spacing)), Vector3::zeros()).expect("inside");
        }
        let mut fastest = 0.0_f64;
        for _ in 0..50 {
            fluid.step(4e-3).unwrap_or_else(|error| panic!("{crowd} {viscosity}: {error}"));
            let speeds = fluid.state().velocities.iter().map(Vector3::norm);
            fastest = speeds.fold(fastest, f64::max);
        }
        // The release of the compression is that of a spacing in some hundredths of a second.
        assert!(fastest < 0.5, "{crowd} {viscosity}: {fastest} m/s");
    }
}
