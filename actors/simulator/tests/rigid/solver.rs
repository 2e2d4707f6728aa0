//! Rigid bodies against closed forms: free rotation, a struck rod, bouncing, rolling, rest.

use nalgebra::{Point3, UnitQuaternion, Vector3};
use trocar_scene::kinematics::spatial::Wrench;
use trocar_simulator::rigid::{
    ContactConfig, Integrator, RigidBodies, RigidContact, RigidMass, RigidState, RigidStepError,
};

const GRAVITY: f64 = 9.81;

fn at(x: f64, y: f64, z: f64) -> RigidState {
    RigidState {
        position: Point3::new(x, y, z),
        rotation: UnitQuaternion::identity(),
        momentum: Vector3::zeros(),
        angular_momentum: Vector3::zeros(),
    }
}

fn sphere(mass: f64, radius: f64) -> RigidMass {
    RigidMass { mass, inertia: Vector3::repeat(0.4 * mass * radius * radius) }
}

fn bodies(
    masses: &[RigidMass],
    states: &[RigidState],
    gravity: Vector3<f64>,
    integrator: Integrator,
) -> RigidBodies {
    RigidBodies::new(masses, states, gravity, integrator, ContactConfig::default()).expect("bodies")
}

fn ground(body: u32, point: Point3<f64>, depth: f64, friction: f64, restitution: f64) -> RigidContact {
    RigidContact {
        body,
        other: None,
        point_in_world: point,
        normal_in_world: Vector3::z(),
        depth,
        friction,
        restitution,
        surface_velocity: Vector3::zeros(),
    }
}

/// A body rotating about its intermediate axis: the times at which it flips, and the drift of energy and momentum.
fn flips(integrator: Integrator, dt: f64, seconds: f64) -> (Vec<f64>, f64, f64) {
    let mass = RigidMass { mass: 1.0, inertia: Vector3::new(1.0, 2.0, 3.0) };
    let mut state = at(0.0, 0.0, 0.0);
    state.angular_momentum = Vector3::new(0.01, 2.0, 0.0);
    let (energy, momentum) = (mass.kinetic_energy(&state), state.angular_momentum);
    let mut body = bodies(&[mass], &[state], Vector3::zeros(), integrator);
    let about = |state: &RigidState| (state.rotation.inverse() * mass.angular_velocity(state)).y;
    let (mut times, mut last) = (Vec::new(), about(&state));
    let mut drift = 0.0_f64;
    for step in 1..=(seconds / dt).round() as u32 {
        body.step(dt, &[], &[]).expect("a step");
        let now = about(&body.states()[0]);
        if now * last < 0.0 {
            times.push((f64::from(step) - now / (now - last)) * dt);
        }
        last = now;
        drift = drift.max((mass.kinetic_energy(&body.states()[0]) / energy - 1.0).abs());
    }
    (times, drift, (body.states()[0].angular_momentum - momentum).norm() / momentum.norm())
}

#[test]
fn a_free_body_flips_when_it_should_and_keeps_energy_and_momentum_unless_it_is_moved_explicitly() {
    for integrator in [Integrator::Symplectic, Integrator::RungeKutta4] {
        let dt = if integrator == Integrator::Symplectic { 2e-4 } else { 1e-3 };
        let (times, energy, momentum) = flips(integrator, dt, 105.0);
        assert!(times.len() >= 5, "{times:?}");
        for pair in times.windows(2) {
            assert!((pair[1] - pair[0] - 20.75460976).abs() < 1e-4, "{integrator:?}: {times:?}");
        }
        assert!(energy < 1e-6 && momentum < 1e-6, "{integrator:?}: {energy} {momentum}");
    }
    let (_, energy, _) = flips(Integrator::ExplicitEuler, 1e-3, 105.0);
    assert!(energy > 1e-4, "explicit Euler keeps no energy: {energy}");
}

#[test]
fn explicit_euler_gains_energy_on_a_spring_where_the_others_do_not() {
    let energy_after = |integrator: Integrator| {
        let mass = sphere(0.1, 0.01);
        let mut body = bodies(&[mass], &[at(0.01, 0.0, 0.0)], Vector3::zeros(), integrator);
        let energy =
            |state: &RigidState| mass.kinetic_energy(state) + 5.0 * state.position.coords.norm_squared();
        let before = energy(&body.states()[0]);
        for _ in 0..2000 {
            let force = body.states()[0].position.coords * -10.0;
            body.step(1e-3, &[Wrench { force, torque: Vector3::zeros() }], &[]).expect("a step");
        }
        energy(&body.states()[0]) / before
    };
    assert!(energy_after(Integrator::ExplicitEuler) > 1.15);
    assert!((energy_after(Integrator::Symplectic) - 1.0).abs() < 0.01);
}

#[test]
fn free_fall_is_exact_to_the_order_of_the_integrator() {
    for (integrator, tolerance) in
        [(Integrator::ExplicitEuler, 6e-3), (Integrator::Symplectic, 6e-3), (Integrator::RungeKutta4, 1e-12)]
    {
        let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
        let mut body = bodies(&[sphere(1.0, 0.1)], &[at(0.0, 0.0, 0.0)], gravity, integrator);
        for _ in 0..1000 {
            body.step(1e-3, &[], &[]).expect("a step");
        }
        let fallen = body.states()[0].position.z + GRAVITY / 2.0;
        assert!(fallen.abs() < tolerance, "{integrator:?}: {fallen}");
    }
}

#[test]
fn a_rod_struck_at_its_end_moves_and_turns() {
    let moment = 0.1 * 0.2 * 0.2 / 12.0;
    let rod = RigidMass { mass: 0.1, inertia: Vector3::new(1e-6, moment, moment) };
    let mut body = bodies(&[rod], &[at(0.0, 0.0, 0.0)], Vector3::zeros(), Integrator::default());
    body.apply_impulse(0, &Vector3::new(0.0, 0.05, 0.0), &Point3::new(0.1, 0.0, 0.0)).expect("a body");
    let state = body.states()[0];
    assert!((rod.velocity(&state) - Vector3::new(0.0, 0.5, 0.0)).norm() < 1e-12);
    assert!((rod.angular_velocity(&state) - Vector3::new(0.0, 0.0, 15.0)).norm() < 1e-9);
    assert!(body.apply_impulse(1, &Vector3::zeros(), &Point3::origin()).is_err());
}

#[test]
fn a_ball_bounces_to_the_square_of_the_restitution_each_time() {
    let (restitution, radius, dt) = (0.7_f64, 0.01, 1e-4);
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
    let mut ball =
        bodies(&[sphere(0.05, radius)], &[at(0.0, 0.0, 0.5 + radius)], gravity, Integrator::Symplectic);
    let (mut heights, mut last) = (vec![0.5], [f64::MAX, f64::MAX]);
    for _ in 0..20_000 {
        let height = ball.states()[0].position.z - radius;
        if last[0] < last[1] && last[1] > height && heights.len() < 5 {
            heights.push(last[1]);
        }
        last = [last[1], height];
        let contact = ground(0, Point3::new(0.0, 0.0, 0.0), -height, 0.0, restitution);
        ball.step(dt, &[], if height < 1e-3 { std::slice::from_ref(&contact) } else { &[] }).expect("a step");
    }
    assert_eq!(heights.len(), 5);
    for (bounce, height) in heights.iter().enumerate() {
        let expected = restitution.powi(2 * bounce as i32) * 0.5;
        assert!((height / expected - 1.0).abs() < 0.01, "bounce {bounce}: {height}, not {expected}");
    }
}

#[test]
fn a_ball_rolls_down_a_slope_by_five_sevenths_and_slides_without_friction() {
    let (radius, angle) = (0.02, 0.3_f64);
    // The slope is z = 0, gravity is tilted.
    let gravity = Vector3::new(GRAVITY * angle.sin(), 0.0, -GRAVITY * angle.cos());
    for (friction, factor) in [(0.5, 5.0 / 7.0), (0.0, 1.0)] {
        let mass = sphere(0.1, radius);
        let mut ball = bodies(&[mass], &[at(0.0, 0.0, radius)], gravity, Integrator::Symplectic);
        for _ in 0..1000 {
            let position = ball.states()[0].position;
            let point = Point3::new(position.x, position.y, 0.0);
            ball.step(1e-3, &[], &[ground(0, point, radius - position.z, friction, 0.0)]).expect("a step");
        }
        let speed = mass.velocity(&ball.states()[0]).x;
        let expected = factor * GRAVITY * angle.sin();
        assert!((speed / expected - 1.0).abs() < 1e-3, "{friction}: {speed}, not {expected}");
        if friction > 0.0 {
            let spin = mass.angular_velocity(&ball.states()[0]).y;
            assert!((spin * radius / speed - 1.0).abs() < 1e-6, "it rolls");
        }
    }
}

/// Contacts of stacked cubes: the four corners of each lower side.
fn stack_contacts(states: &[RigidState], half: f64) -> Vec<RigidContact> {
    let mut contacts = Vec::new();
    for (index, state) in states.iter().enumerate() {
        for (x, y) in [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)] {
            let corner = state.position + state.rotation * Vector3::new(x * half, y * half, -half);
            let top = if index == 0 { 0.0 } else { states[index - 1].position.z + half };
            let contact = ground(index as u32, corner, top - corner.z, 0.5, 0.0);
            contacts.push(RigidContact { other: index.checked_sub(1).map(|below| below as u32), ..contact });
        }
    }
    contacts
}

#[test]
fn a_cube_that_slides_or_spins_on_its_corners_is_rubbed_against_its_slip() {
    let (half, friction, aside) = (0.01, 0.3, 0.4_f64);
    let mass = RigidMass { mass: 0.02, inertia: Vector3::repeat(0.02 * 4.0 * half * half / 6.0) };
    let down = Vector3::new(aside.cos(), aside.sin(), 0.0);
    let rubbed = |states: &[RigidState]| -> Vec<RigidContact> {
        let contacts = stack_contacts(states, half).into_iter();
        contacts.map(|contact| RigidContact { friction, ..contact }).collect()
    };
    for (angle, spin, steps) in [(0.5_f64, 0.0, 400), (0.5, 30.0, 400), (0.0, 30.0, 40)] {
        let gravity = down * (GRAVITY * angle.sin()) - Vector3::z() * (GRAVITY * angle.cos());
        let mut state = at(0.0, 0.0, half);
        state.angular_momentum = mass.inertia.component_mul(&(Vector3::z() * spin));
        let mut cube = bodies(&[mass], &[state], gravity, Integrator::Symplectic);
        for step in 0..steps {
            let contacts = rubbed(cube.states());
            cube.step(1e-3, &[], &contacts).expect("a step");
            let state = &cube.states()[0];
            for (contact, impulse) in contacts.iter().zip(cube.impulses()) {
                let slip = mass.velocity(state)
                    + mass.angular_velocity(state).cross(&(contact.point_in_world - state.position));
                let slip = Vector3::new(slip.x, slip.y, 0.0);
                let across = Vector3::new(impulse.impulse.x, impulse.impulse.y, 0.0);
                // Coulomb's law dissipates as much energy as any friction of its magnitude could (Moreau 1988).
                let most = friction * impulse.impulse.z * slip.norm();
                assert!(
                    (across.dot(&slip) + most).abs() < 0.01 * most + 1e-12,
                    "{angle} rad, {spin} rad/s, step {step}: {across:?} against {slip:?}"
                );
            }
        }
        let (state, secs) = (&cube.states()[0], 1e-3 * f64::from(steps));
        if spin == 0.0 {
            let velocity = mass.velocity(state);
            let expected = down * (GRAVITY * (angle.sin() - friction * angle.cos()) * secs);
            assert!((velocity - expected).norm() < 1e-3 * expected.norm(), "{velocity:?}, not {expected:?}");
        } else if angle == 0.0 {
            // All corners bear the same force and are equally far from the axis.
            let slows = friction * GRAVITY * mass.mass * half * 2.0_f64.sqrt() / mass.inertia.z;
            let (left, expected) = (mass.angular_velocity(state).z, spin - slows * secs);
            assert!((left - expected).abs() < 1e-2 * spin, "{left}, not {expected} rad/s");
        }
    }
}

#[test]
fn a_stack_of_cubes_stays_at_rest_and_is_pushed_out_of_the_floor_without_a_jump() {
    let half = 0.01_f64;
    let cube = RigidMass { mass: 0.01, inertia: Vector3::repeat(0.01 * (2.0 * half).powi(2) / 6.0) };
    // Each 0.2 mm too deep.
    let states: Vec<RigidState> =
        (0..5).map(|index| at(0.0, 0.0, half + f64::from(index) * (2.0 * half - 2e-4) - 2e-4)).collect();
    let config = ContactConfig::default();
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
    let mut stack =
        RigidBodies::new(&[cube; 5], &states, gravity, Integrator::Symplectic, config).expect("bodies");
    let (mut fastest, mut halfway) = (0.0_f64, Vec::new());
    for step in 0..2000 {
        if step == 1000 {
            halfway = stack.states().to_vec();
        }
        let contacts = stack_contacts(stack.states(), half);
        stack.step(1e-3, &[], &contacts).expect("a step");
        let speed = stack.states().iter().map(|state| state.momentum.norm() / 0.01).fold(0.0, f64::max);
        if step > 200 {
            fastest = fastest.max(speed);
        }
    }
    assert!(fastest < 2e-3, "{fastest} m/s at rest");
    for (index, state) in stack.states().iter().enumerate() {
        let height = half + index as f64 * 2.0 * half;
        assert!((state.position.z - height).abs() < 1e-4, "cube {index} at {}", state.position.z);
        let (aside, tilt) = (state.position.coords.xy().norm(), state.rotation.angle());
        // It may move by as much as it penetrated while pushed out, then it is at rest.
        assert!(aside < 2e-4 && tilt < 1e-3, "cube {index}: {aside} m aside, {tilt} rad");
        let crept = (state.position - halfway[index].position).norm();
        assert!(crept < 2e-5, "cube {index} crept {crept} m in a second");
    }
    // The floor bears the weight.
    let floor: f64 = stack.impulses()[..4].iter().map(|impulse| impulse.impulse.z).sum();
    assert!((floor / (5.0 * 0.01 * GRAVITY * 1e-3) - 1.0).abs() < 0.02, "{floor}");
}

#[test]
fn in_a_collision_momentum_stays_and_energy_does_not_grow() {
    for restitution in [0.0, 0.5, 1.0] {
        let masses = [sphere(0.1, 0.01), sphere(0.3, 0.02)];
        let mut states = [at(0.0, 0.0, 0.0), at(0.03, 0.0, 0.0)];
        states[0].momentum = Vector3::new(0.2, 0.05, 0.0);
        let total = |states: &[RigidState]| {
            let linear: Vector3<f64> = states.iter().map(|state| state.momentum).sum();
            let angular: Vector3<f64> = states
                .iter()
                .map(|state| state.angular_momentum + state.position.coords.cross(&state.momentum))
                .sum();
            (linear, angular)
        };
        let energy = |states: &[RigidState]| {
            states.iter().zip(&masses).map(|(state, mass)| mass.kinetic_energy(state)).sum::<f64>()
        };
        let mut pair = bodies(&masses, &states, Vector3::zeros(), Integrator::Symplectic);
        let contact = RigidContact {
            other: Some(1),
            normal_in_world: -Vector3::x(),
            ..ground(0, Point3::new(0.01, 0.0, 0.0), 0.0, 0.3, restitution)
        };
        pair.step(1e-4, &[], &[contact]).expect("a step");
        let (before, after) = (total(&states), total(pair.states()));
        assert!((after.0 - before.0).norm() < 1e-15 && (after.1 - before.1).norm() < 1e-6);
        assert!(energy(pair.states()) <= energy(&states) * (1.0 + 1e-12));
        let apart = (masses[1].velocity(&pair.states()[1]) - masses[0].velocity(&pair.states()[0])).x;
        assert!((apart - restitution * 2.0).abs() < 1e-9, "{restitution}: {apart}");
    }
}

#[test]
fn what_is_wrong_is_named_and_changes_nothing_and_states_go_on() {
    let wrong = RigidMass { mass: -1.0, inertia: Vector3::repeat(1.0) };
    let flat = RigidMass { mass: 1.0, inertia: Vector3::new(1.0, 1.0, 3.0) };
    let error = RigidBodies::new(
        &[sphere(1.0, 0.1), wrong, flat],
        &[at(0.0, 0.0, 0.0); 3],
        Vector3::zeros(),
        Integrator::default(),
        ContactConfig::default(),
    );
    assert!(error.expect_err("bad bodies").to_string().starts_with("bodies [1, 2]"));
    let gravity = Vector3::new(0.0, 0.0, -GRAVITY);
    let mut body = bodies(&[sphere(1.0, 0.1)], &[at(0.0, 0.0, 0.1)], gravity, Integrator::default());
    let before = body.states().to_vec();
    let contact = ground(0, Point3::origin(), 0.0, 0.5, 0.5);
    let bad = [
        RigidContact { body: 1, ..contact },
        RigidContact { normal_in_world: Vector3::zeros(), ..contact },
        RigidContact { depth: f64::NAN, ..contact },
        RigidContact { other: Some(0), ..contact },
    ];
    for contact in bad {
        body.step(1e-3, &[], &[contact]).expect_err("no such contact");
    }
    assert_eq!(body.step(0.0, &[], &[]), Err(RigidStepError::Time(0.0)));
    body.step(1e-3, &[Wrench::default(); 2], &[]).expect_err("two for one");
    let huge = Wrench { force: Vector3::repeat(f64::MAX), torque: Vector3::repeat(f64::MAX) };
    assert_eq!(body.step(1.0, &[huge], &[]), Err(RigidStepError::Body { body: 0 }));
    assert_eq!(body.states(), before);
    for _ in 0..10 {
        body.step(1e-3, &[], &[contact]).expect("a step");
    }
    let mut other = bodies(body.masses(), body.states(), gravity, Integrator::default());
    other.begin_with(body.impulses());
    for _ in 0..10 {
        body.step(1e-3, &[], &[contact]).expect("a step");
        other.step(1e-3, &[], &[contact]).expect("a step");
    }
    assert_eq!(body.states(), other.states());
}
