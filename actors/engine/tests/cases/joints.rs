//! Joints of bodies against closed forms: pendulums, chains, welds, bodies that spin freely.

use std::f64::consts::TAU;

use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};
use trocar_dynamics::rigid_bodies::RigidBodiesController;
use trocar_dynamics::rigid_world::{BodyJoint, World};
use trocar_scene::components::{
    Joint, JointFrames, JointKind, JointLoad, JointState, Motion, Pose, RigidBody, Shape, Velocity,
};
use trocar_scene::{BuildContext, ControllerError, Entity, SimTime};

use super::{JOINT_BOUNDS, W, settings};
use crate::stage::{Stage, scene};

const G: f64 = 9.81;
const STEP: f64 = 0.001;
const A: Entity = Entity::new(0, 0, 101);
const B: Entity = Entity::new(0, 0, 102);

/// How exact a world is.
pub struct JointBounds {
    /// Relative error of a pendulum's period.
    pub period: f64,
    /// Relative loss of a pendulum's energy in 30 s.
    pub energy: f64,
    /// Distance between the two sides of a joint \[m\]: of bodies of the same mass, and of a mass ratio of 1 to 100.
    pub gap: f64,
    pub gap_uneven: f64,
    /// Share of its energy that a chain that whips loses in 2 s.
    pub whip: f64,
    /// Angle between the two sides \[rad\].
    pub angle: f64,
    /// Relative error of a force at rest.
    pub force: f64,
    /// Angle between the links of a hanging chain and those of the closed form \[rad\].
    pub chain: f64,
    /// Relative change of the momentum of two bodies that spin freely, and of their angular momentum.
    pub momentum: [f64; 2],
    /// Acceleration of a body that leads another one, as far as it is seen in the force between them \[m/s²\].
    pub led: f64,
    /// How far a body that goes on after a restart is from one without \[m\].
    pub restart: f64,
}

fn under(gravity: f64) -> W {
    <W as World>::new(settings(Vector3::new(0.0, 0.0, -gravity), None), SimTime::ZERO).unwrap()
}

fn add(world: &mut W, entity: Entity, shape: &Shape, mass: f64, pose: Isometry3<f64>, motion: Motion) {
    let body = RigidBody { motion, mass, ..RigidBody::default() };
    world.insert_body(entity, &body, shape, &pose.into(), &Velocity::default()).unwrap();
}

/// A joint of bodies where they are, given in world.
fn joint(world: &W, body: Entity, other: Option<Entity>, kind: JointKind, at: [f64; 3]) -> BodyJoint {
    let axis = (kind == JointKind::Hinge).then(Vector3::y);
    let frame = Joint { kind, at: at.into(), axis, to: other }.frame_in_world();
    let within = |of: Entity| world.pose(of).unwrap().isometry().inverse() * frame;
    let other_from_joint = other.map_or(frame, within);
    BodyJoint { body, other, kind, body_from_joint: within(body), other_from_joint }
}

fn loads(world: &W) -> Vec<JointLoad> {
    let mut loads = Vec::new();
    world.joint_loads(&mut loads);
    loads
}

fn place(world: &W, entity: Entity) -> Vector3<f64> {
    world.pose(entity).unwrap().translation
}

/// A rod of 10 cm that hangs from a hinge along y at the origin, displaced by an angle.
fn pendulum(kind: JointKind, angle: f64) -> W {
    let mut world = under(G);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), angle);
    let pose = Isometry3::from_parts((turn * Vector3::new(0.0, 0.0, -0.05)).into(), turn);
    add(&mut world, A, &Shape::Box { half_extents: [0.005, 0.005, 0.05] }, 0.05, pose, Motion::Dynamic);
    let hung = joint(&world, A, None, kind, [0.0; 3]);
    world.set_joints(&[hung]).unwrap();
    world
}

/// Period of the rod with that amplitude: with the elliptic integral, by the arithmetic-geometric mean.
fn period_of(amplitude: f64) -> f64 {
    // Per mass, about the hinge.
    let inertia = (0.01_f64.powi(2) + 0.1_f64.powi(2)) / 12.0 + 0.05_f64.powi(2);
    let small = TAU * (inertia / (G * 0.05)).sqrt();
    let (mut a, mut b) = (1.0, (amplitude / 2.0).cos());
    for _ in 0..30 {
        (a, b) = ((a + b) / 2.0, f64::sqrt(a * b));
    }
    small / a
}

fn swing_of(world: &W) -> f64 {
    let at = place(world, A);
    (-at.x).atan2(-at.z)
}

/// Mean period over so many swings, from the zeros of the angle.
fn measured_period(world: &mut W, swings: usize) -> f64 {
    let (mut zeros, mut before) = (Vec::new(), swing_of(world));
    for step in 1.. {
        world.step().unwrap();
        let now = swing_of(world);
        if before < 0.0 && now >= 0.0 {
            zeros.push(STEP * (f64::from(step) - now / (now - before)));
        }
        if zeros.len() > swings {
            break;
        }
        before = now;
    }
    (zeros[swings] - zeros[0]) / swings as f64
}

#[test]
fn a_pendulum_swings_in_the_period_of_the_closed_form_at_small_and_large_amplitudes() {
    for degrees in [2.0_f64, 60.0] {
        for kind in [JointKind::Hinge, JointKind::Ball] {
            let mut world = pendulum(kind, degrees.to_radians());
            let error = measured_period(&mut world, 8) / period_of(degrees.to_radians()) - 1.0;
            println!("{degrees}°, {kind:?}: the period is off by {error:.2e}");
            assert!(error.abs() < JOINT_BOUNDS.period, "{degrees}°, {kind:?}: {error:.2e}");
        }
    }
}

#[test]
fn a_pendulum_keeps_its_energy_and_its_hinge_its_axis() {
    let mut world = pendulum(JointKind::Hinge, 1.0);
    let mut highest = |seconds: f64| {
        let (mut highest, mut open, mut tilt) = (f64::NEG_INFINITY, 0.0_f64, 0.0_f64);
        for _ in 0..(seconds / STEP) as usize {
            world.step().unwrap();
            let load = loads(&world)[0];
            (open, tilt) = (open.max(load.position_error), tilt.max(load.angle_error));
            let up = world.pose(A).unwrap().rotation * Vector3::y();
            tilt = tilt.max(up.cross(&Vector3::y()).norm());
            highest = highest.max(place(&world, A).z);
        }
        (highest, open, tilt)
    };
    let (before, ..) = highest(2.0);
    let (mut open, mut tilt) = (0.0_f64, 0.0_f64);
    for _ in 0..14 {
        let (_, a, b) = highest(2.0);
        (open, tilt) = (open.max(a), tilt.max(b));
    }
    let (after, ..) = highest(2.0);
    let lost = (before - after) / (before + 0.05);
    println!("lost in 30 s: {lost:.2e}, joint open by {open:.2e} m, {tilt:.2e} rad");
    assert!(lost.abs() < JOINT_BOUNDS.energy, "{lost:.2e}");
    assert!(open < JOINT_BOUNDS.gap, "{open:.2e} m");
    assert!(tilt < JOINT_BOUNDS.angle && JOINT_BOUNDS.angle < 0.1_f64.to_radians(), "{tilt:.2e} rad");
}

/// A hinge whose body pulls it askew: an arm that sticks out along the axis, under its weight.
#[test]
fn a_hinge_bears_a_moment_across_its_axis() {
    let mut world = under(G);
    let arm = Shape::Box { half_extents: [0.01, 0.05, 0.01] };
    add(&mut world, A, &arm, 0.1, Isometry3::translation(0.0, 0.05, -0.02), Motion::Dynamic);
    let hinge = joint(&world, A, None, JointKind::Hinge, [0.0; 3]);
    world.set_joints(&[hinge]).unwrap();
    let mut worst = 0.0_f64;
    for _ in 0..1000 {
        world.step().unwrap();
        worst = worst.max(loads(&world)[0].angle_error);
    }
    let load = loads(&world)[0];
    let (force, torque) = (0.1 * G, 0.1 * G * 0.05);
    println!("askew by {worst:.2e} rad, force {:?}, torque {:?}", load.force, load.torque);
    assert!(worst < JOINT_BOUNDS.angle, "{worst:.2e}");
    let off = [
        (load.force - Vector3::z() * force).norm() / force,
        (load.torque - Vector3::x() * torque).norm() / torque,
    ];
    assert!(off.iter().all(|off| *off < JOINT_BOUNDS.force), "{off:?}");
}

#[test]
fn at_rest_a_joint_bears_the_weight_and_a_weld_its_moment_too() {
    let mut world = pendulum(JointKind::Ball, 0.0);
    (0..500).for_each(|_| world.step().unwrap());
    let load = loads(&world)[0];
    let off = (load.force - Vector3::z() * 0.05 * G).norm() / (0.05 * G);
    println!("hanging: off by {off:.2e}");
    assert!(off < JOINT_BOUNDS.force && load.torque == Vector3::zeros(), "{load:?}");
    // A beam of two welded halves that sticks out of the world along x.
    let mut world = under(G);
    let half = Shape::Box { half_extents: [0.05, 0.01, 0.01] };
    add(&mut world, A, &half, 0.1, Isometry3::translation(0.05, 0.0, 0.0), Motion::Dynamic);
    add(&mut world, B, &half, 0.2, Isometry3::translation(0.15, 0.0, 0.0), Motion::Dynamic);
    let welds = [
        joint(&world, A, None, JointKind::Fixed, [0.0; 3]),
        joint(&world, B, Some(A), JointKind::Fixed, [0.1, 0.0, 0.0]),
    ];
    world.set_joints(&welds).unwrap();
    (0..500).for_each(|_| world.step().unwrap());
    let wanted = [(0.3, 0.1 * 0.05 + 0.2 * 0.15), (0.2, 0.2 * 0.05)];
    for (load, (mass, moment)) in loads(&world).iter().zip(wanted) {
        let off = [
            (load.force - Vector3::z() * mass * G).norm() / (mass * G),
            (load.torque + Vector3::y() * moment * G).norm() / (moment * G),
        ];
        println!("weld: off by {off:?}, open by {:.2e} m, {:.2e} rad", load.position_error, load.angle_error);
        assert!(off.iter().all(|off| *off < JOINT_BOUNDS.force), "{off:?}: {load:?}");
        assert!(load.position_error < JOINT_BOUNDS.gap && load.angle_error < JOINT_BOUNDS.angle, "{load:?}");
    }
}

/// Links of 2 cm and 1 g along x from the origin, joined by balls; returns its joints, the first to the world.
fn chain(
    world: &mut W,
    links: u32,
    damping: f64,
    from: Point3<f64>,
    direction: impl Fn(u32) -> Vector3<f64>,
) -> Vec<BodyJoint> {
    let shape = Shape::Capsule { radius: 0.002, half_height: 0.008 };
    let mut at = from;
    let mut joints = Vec::new();
    for index in 0..links {
        let (entity, along) = (Entity::new(0, 0, 200 + index), direction(index));
        let turn = UnitQuaternion::rotation_between(&Vector3::z(), &along).unwrap();
        let pose = Isometry3::from_parts((at.coords + along * 0.01).into(), turn);
        let body = RigidBody {
            motion: Motion::Dynamic,
            mass: 0.001,
            linear_damping: damping,
            angular_damping: damping,
            ..RigidBody::default()
        };
        world.insert_body(entity, &body, &shape, &pose.into(), &Velocity::default()).unwrap();
        let before = (index > 0).then(|| Entity::new(0, 0, 199 + index));
        joints.push(joint(world, entity, before, JointKind::Ball, at.coords.into()));
        at += along * 0.02;
    }
    joints
}

/// Ten links between two points: each bears the weight of those below it, and all the same horizontal pull. The tangent of
/// a link's slope is its number from the middle times weight over pull.
#[test]
fn a_chain_of_ten_links_hangs_as_a_chain() {
    let mut world = under(G);
    let tan = |index: u32, ratio: f64| (f64::from(index) - 4.5) * ratio;
    // Span of 14 cm: the pull by bisection.
    let span = |ratio: f64| (0..10).map(|link| 0.02 / (1.0 + tan(link, ratio).powi(2)).sqrt()).sum::<f64>();
    let (mut low, mut high) = (0.0, 10.0);
    for _ in 0..100 {
        let middle = (low + high) / 2.0;
        if span(middle) > 0.14 { low = middle } else { high = middle }
    }
    // It begins as a tent of the same span.
    let rise = (1.0_f64 - 0.49).sqrt();
    let tent = |link: u32| Vector3::new(0.7, 0.0, if link < 5 { -rise } else { rise });
    let mut joints = chain(&mut world, 10, 20.0, Point3::origin(), tent);
    joints.push(joint(&world, Entity::new(0, 0, 209), None, JointKind::Ball, [0.14, 0.0, 0.0]));
    world.set_joints(&joints).unwrap();
    (0..6000).for_each(|_| world.step().unwrap());
    let mut worst = 0.0_f64;
    for link in 0..10 {
        let along = world.pose(Entity::new(0, 0, 200 + link)).unwrap().rotation * Vector3::z();
        let wanted = Vector3::new(1.0, 0.0, tan(link, low)).normalize();
        worst = worst.max(along.cross(&wanted).norm());
    }
    let loads = loads(&world);
    let open = loads.iter().map(|load| load.position_error).fold(0.0, f64::max);
    // At each end, half of the weight and the horizontal pull.
    let (weight, pull) = (0.01 * G, 0.001 * G / low);
    let ends = [Vector3::new(-pull, 0.0, weight / 2.0), Vector3::new(pull, 0.0, weight / 2.0)];
    let off = [(loads[0].force - ends[0]).norm() / weight, (loads[10].force - ends[1]).norm() / weight];
    println!("links off by {worst:.2e} rad, forces by {off:?}, open by {open:.2e} m");
    assert!(worst < JOINT_BOUNDS.chain, "{worst:.2e} rad");
    assert!(off.iter().all(|off| *off < JOINT_BOUNDS.chain), "{off:?}");
    assert!(open < JOINT_BOUNDS.gap, "{open:.2e} m");
}

/// A chain of ten links of 1 g falls from the horizontal with 100 g at its end.
#[test]
fn a_light_chain_that_swings_a_hundredfold_mass_stays_closed() {
    let mut world = under(G);
    let mut joints = chain(&mut world, 10, 0.0, Point3::origin(), |_| Vector3::x());
    add(
        &mut world,
        A,
        &Shape::Sphere { radius: 0.01 },
        0.1,
        Isometry3::translation(0.21, 0.0, 0.0),
        Motion::Dynamic,
    );
    joints.push(joint(&world, A, Some(Entity::new(0, 0, 209)), JointKind::Ball, [0.2, 0.0, 0.0]));
    world.set_joints(&joints).unwrap();
    let bodies: Vec<Entity> = (200..210).map(|index| Entity::new(0, 0, index)).chain([A]).collect();
    // Rapier computes masses in its first step.
    world.step().unwrap();
    let (mut open, mut strongest, mut highest) = (0.0_f64, 0.0_f64, f64::NEG_INFINITY);
    let began = energy(&world, &bodies);
    for _ in 0..2000 {
        world.step().unwrap();
        let loads = loads(&world);
        open = loads.iter().fold(open, |open, load| open.max(load.position_error));
        strongest = strongest.max(loads[0].force.norm());
        highest = highest.max(energy(&world, &bodies));
    }
    // The fall of 100 g over 21 cm.
    let gained = (highest - began) / (0.1 * G * 0.21);
    let left = (energy(&world, &bodies) - began) / (0.1 * G * 0.21);
    println!(
        "open by {open:.2e} m under up to {strongest:.2} N, energy up to {gained:.2e}, at the end {left:.2e}"
    );
    assert!(open < JOINT_BOUNDS.gap_uneven, "{open:.2e} m");
    assert!(gained < 0.01 && -left < JOINT_BOUNDS.whip, "{gained:.2e}, {left:.2e}");
    // At the lowest point of a pendulum that fell from the horizontal: three times the weight.
    assert!(strongest > 2.5 * 0.1 * G, "{strongest} N");
}

/// Kinetic and potential energy of bodies whose origin is their centre \[J\].
fn energy(world: &W, bodies: &[Entity]) -> f64 {
    let of = |entity: Entity| {
        let (pose, velocity) = (world.pose(entity).unwrap(), world.velocity(entity).unwrap());
        let (mass, tensor) = mass_of(world, entity);
        let turning = velocity.angular.dot(&(tensor * velocity.angular));
        0.5 * (mass * velocity.linear.norm_squared() + turning) + mass * G * pose.translation.z
    };
    bodies.iter().map(|entity| of(*entity)).sum()
}

/// Mass \[kg\], and inertia in world axes \[kg·m²\].
fn mass_of(world: &W, entity: Entity) -> (f64, Matrix3<f64>) {
    let inertia = world.inertia(entity).unwrap();
    let turn = world.pose(entity).unwrap().rotation.to_rotation_matrix();
    let own = inertia.inertia_inverse_in_body.try_inverse().unwrap();
    (inertia.mass_inverse.recip(), turn.matrix() * own * turn.matrix().transpose())
}

/// Mass times velocity, and angular momentum about the origin, of boxes and balls (their origin is their centre).
fn momenta(world: &W, bodies: &[Entity]) -> [Vector3<f64>; 2] {
    let mut sums = [Vector3::zeros(); 2];
    for &entity in bodies {
        let (pose, velocity) = (world.pose(entity).unwrap(), world.velocity(entity).unwrap());
        let (mass, tensor) = mass_of(world, entity);
        let momentum = velocity.linear * mass;
        sums[0] += momentum;
        sums[1] += pose.translation.cross(&momentum) + tensor * velocity.angular;
    }
    sums
}

#[test]
fn two_joined_bodies_that_spin_freely_keep_their_momenta() {
    for kind in [JointKind::Ball, JointKind::Hinge, JointKind::Fixed] {
        let mut world = under(0.0);
        let body = |mass: f64| RigidBody { motion: Motion::Dynamic, mass, ..RigidBody::default() };
        let plate = Shape::Box { half_extents: [0.02, 0.01, 0.005] };
        let spin =
            |linear: [f64; 3], angular: [f64; 3]| Velocity { linear: linear.into(), angular: angular.into() };
        // Both move so that the joint's two sides begin with the same velocity.
        let (linear, angular) = (Vector3::new(0.1, -0.2, 0.05), Vector3::new(3.0, 5.0, -4.0));
        let at = |x: f64| linear + angular.cross(&Vector3::new(x, 0.0, 0.0));
        world
            .insert_body(
                A,
                &body(0.01),
                &plate,
                &Pose::at(-0.03, 0.0, 0.0),
                &spin(at(-0.03).into(), angular.into()),
            )
            .unwrap();
        world
            .insert_body(
                B,
                &body(0.03),
                &plate,
                &Pose::at(0.03, 0.0, 0.0),
                &spin(at(0.03).into(), angular.into()),
            )
            .unwrap();
        let own = joint(&world, A, Some(B), kind, [0.0; 3]);
        world.set_joints(&[own]).unwrap();
        // Rapier computes masses in its first step.
        world.step().unwrap();
        let [before, turning] = momenta(&world, &[A, B]);
        let (mut off, mut open) = ([0.0_f64; 2], 0.0_f64);
        for _ in 0..2000 {
            world.step().unwrap();
            let [p, l] = momenta(&world, &[A, B]);
            off = [
                off[0].max((p - before).norm() / before.norm()),
                off[1].max((l - turning).norm() / turning.norm()),
            ];
            open = open.max(loads(&world)[0].position_error);
        }
        println!(
            "{kind:?}: momentum changes by {:.2e}, angular momentum by {:.2e}, open by {open:.2e} m",
            off[0], off[1]
        );
        assert!(off[0] < JOINT_BOUNDS.momentum[0] && off[1] < JOINT_BOUNDS.momentum[1], "{kind:?}: {off:?}");
        assert!(open < JOINT_BOUNDS.gap, "{open:.2e} m");
    }
}

#[test]
fn joined_bodies_do_not_collide_with_each_other_until_the_joint_is_gone() {
    let mut world = under(0.0);
    for (entity, x) in [(A, 0.0), (B, 0.006)] {
        add(
            &mut world,
            entity,
            &Shape::Sphere { radius: 0.005 },
            0.01,
            Isometry3::translation(x, 0.0, 0.0),
            Motion::Dynamic,
        );
    }
    let own = joint(&world, A, Some(B), JointKind::Fixed, [0.003, 0.0, 0.0]);
    world.set_joints(&[own]).unwrap();
    for _ in 0..100 {
        world.step().unwrap();
        assert!(world.contacts().is_empty());
    }
    assert!(
        ((place(&world, B) - place(&world, A)).norm() - 0.006).abs() < 1e-9,
        "they stay within each other"
    );
    world.set_joints(&[]).unwrap();
    (0..300).for_each(|_| world.step().unwrap());
    assert!((place(&world, B) - place(&world, A)).norm() > 0.0098, "they are pushed apart");
}

/// A weld to a kinematic body follows it; so does one whose owner is the kinematic body.
#[test]
fn a_body_that_is_joined_to_a_moving_one_goes_with_it() {
    for is_owner in [false, true] {
        let mut world = under(G);
        let cube = Shape::Box { half_extents: [0.01; 3] };
        add(&mut world, A, &cube, 0.02, Isometry3::translation(0.03, 0.0, 0.0), Motion::Dynamic);
        add(&mut world, B, &cube, 0.02, Isometry3::identity(), Motion::Kinematic);
        let (own, other) = if is_owner { (B, A) } else { (A, B) };
        let weld = joint(&world, own, Some(other), JointKind::Fixed, [0.015, 0.0, 0.0]);
        world.set_joints(&[weld]).unwrap();
        let before = world.pose(B).unwrap().isometry().inverse() * world.pose(A).unwrap().isometry();
        let mut worst = 0.0_f64;
        for tick in 1..=200 {
            let at = 0.1 * (f64::from(tick) / 200.0).powi(2);
            let pose = Isometry3::new(Vector3::new(at, 0.0, at), Vector3::z() * (10.0 * at));
            world.move_body(B, &pose.into(), &Velocity::default(), STEP).unwrap();
            world.step().unwrap();
            let now = world.pose(B).unwrap().isometry().inverse() * world.pose(A).unwrap().isometry();
            worst = worst.max((now.translation.vector - before.translation.vector).norm());
        }
        let load = loads(&world)[0];
        println!("it lags by {worst:.2e} m; {load:?}");
        assert!(worst < JOINT_BOUNDS.gap, "{worst:.2e} m");
        // It is led at 5 m/s² along x and z: the weight of 20 g, and that acceleration.
        let up = load.force.z * if is_owner { -1.0 } else { 1.0 };
        let wanted = 0.02 * (G + JOINT_BOUNDS.led);
        assert!((up / wanted - 1.0).abs() < 1e-9, "{up} N");
    }
}

/// A door on two hinges of one axis, and a frame of four bars: more is locked than moves.
#[test]
fn what_is_locked_twice_bears_its_load_all_the_same() {
    let mut world = under(G);
    let door = Shape::Box { half_extents: [0.05, 0.08, 0.005] };
    add(&mut world, A, &door, 0.1, Isometry3::translation(0.05, 0.0, 0.0), Motion::Dynamic);
    let hinges = [-0.06, 0.06].map(|y| joint(&world, A, None, JointKind::Hinge, [0.0, y, 0.0]));
    world.set_joints(&hinges).unwrap();
    let mut open = 0.0_f64;
    for _ in 0..1000 {
        world.step().unwrap();
        open = loads(&world).iter().fold(open, |open, load| open.max(load.position_error));
    }
    println!("a door: open by {open:.2e} m");
    assert!(open < JOINT_BOUNDS.gap, "{open:.2e} m");
    // Four bars of 10 cm, hinged to a square that stands on two of its corners.
    let mut world = under(G);
    let bar = |i: u32| Entity::new(0, 0, 300 + i);
    let [flat, tall] =
        [[0.05, 0.004, 0.004], [0.004, 0.004, 0.05]].map(|half_extents| Shape::Box { half_extents });
    for (i, (shape, x, z)) in
        [(&flat, 0.05, 0.0), (&tall, 0.1, 0.05), (&flat, 0.05, 0.1), (&tall, 0.0, 0.05)].iter().enumerate()
    {
        add(&mut world, bar(i as u32), shape, 0.02, Isometry3::translation(*x, 0.0, *z), Motion::Dynamic);
    }
    let corners =
        [(0, 1, [0.1, 0.0, 0.0]), (1, 2, [0.1, 0.0, 0.1]), (2, 3, [0.0, 0.0, 0.1]), (3, 0, [0.0, 0.0, 0.0])];
    let mut joints: Vec<BodyJoint> = corners
        .iter()
        .map(|(a, b, at)| joint(&world, bar(*a), Some(bar(*b)), JointKind::Hinge, *at))
        .collect();
    joints.extend([0.0, 0.1].map(|x| joint(&world, bar(0), None, JointKind::Ball, [x, 0.0, 0.0])));
    // Without it, the frame would fold.
    joints.push(joint(&world, bar(2), Some(bar(3)), JointKind::Fixed, [0.0, 0.0, 0.1]));
    world.set_joints(&joints).unwrap();
    (0..1000).for_each(|_| world.step().unwrap());
    let all = loads(&world);
    let borne = all[4].force + all[5].force;
    let open = all.iter().map(|load| load.position_error).fold(0.0, f64::max);
    println!("a frame: borne {borne:?}, open by {open:.2e} m");
    assert!((borne - Vector3::z() * 0.08 * G).norm() < JOINT_BOUNDS.force * 0.08 * G, "{borne:?}");
    assert!(open < JOINT_BOUNDS.gap, "{open:.2e} m");
}

const SCENE: &str = r#"
[[entity]]
name = "upper"
shape = { box = { half_extents = [0.03, 0.004, 0.004] } }
pose = { translation = [0.03, 0.0, 0.0] }
rigid_body = { motion = "dynamic", mass = 0.02 }
joint = { kind = "hinge", at = [0.0, 0.0, 0.0], axis = [0.0, 1.0, 0.0] }
[[entity]]
name = "lower"
shape = { box = { half_extents = [0.03, 0.004, 0.004] } }
pose = { translation = [0.09, 0.0, 0.0] }
rigid_body = { motion = "dynamic", mass = 0.01 }
joint = [{ kind = "ball", at = [0.06, 0.0, 0.0], to = "upper" }]
"#;

fn build(context: &BuildContext<'_>) -> Result<RigidBodiesController<W>, ControllerError> {
    let settings = settings(Vector3::new(0.0, 0.0, -G), None);
    RigidBodiesController::new(context, settings).map_err(ControllerError::from)
}

#[test]
fn a_controller_that_is_killed_keeps_its_joints_to_the_bit_and_the_scene_has_their_loads() {
    let start = || Stage::new(scene(SCENE), 500.0, build);
    let (mut whole, mut killed) = (start(), start());
    let ticks = |stage: &mut Stage<_>, count: usize| (0..count).for_each(|_| stage.tick());
    ticks(&mut whole, 150);
    ticks(&mut killed, 150);
    let frames = killed.get::<JointFrames>("lower");
    assert_eq!((frames.joints[0].in_body.translation - Vector3::new(-0.03, 0.0, 0.0)).norm(), 0.0);
    for _ in 0..3 {
        killed.rebuild(build);
        ticks(&mut whole, 50);
        ticks(&mut killed, 50);
    }
    for name in ["upper", "lower"] {
        assert_eq!(killed.get::<JointFrames>(name), whole.get::<JointFrames>(name), "to the bit");
        let [a, b] = [&whole, &killed].map(|stage| stage.get::<Pose>(name).translation);
        println!("{name} is {:.2e} m off after three restarts", (a - b).norm());
        assert!((a - b).norm() < JOINT_BOUNDS.restart, "{name}: {:.2e} m", (a - b).norm());
        let load = killed.get::<JointState>(name).joints[0];
        let same = whole.get::<JointState>(name).joints[0];
        assert!(load.position_error < JOINT_BOUNDS.gap && load.force.norm() > 0.01, "{load:?}");
        assert!((load.force - same.force).norm() < 0.01 * same.force.norm(), "{load:?}, {same:?}");
    }
    // Without joints they fall.
    whole.put("upper", trocar_scene::Joints::default());
    whole.put("lower", trocar_scene::Joints::default());
    let before = whole.get::<Pose>("lower").translation.z;
    ticks(&mut whole, 100);
    assert!(before - whole.get::<Pose>("lower").translation.z > 0.05);
    assert!(whole.get::<JointFrames>("lower").joints.is_empty());
}
