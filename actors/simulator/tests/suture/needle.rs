//! A needle and its thread in free flight; a needle that enters tissue, passes through it, and is withdrawn.

use crate::support::suture::*;
use nalgebra::{Isometry3, Point3, Unit, UnitQuaternion, Vector3};
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem};
use trocar_simulator::suture::needle::NeedleShape;
use trocar_simulator::suture::{Event, Resistance, StepInputs, Suture, SutureReport, Tip};

const DT: f64 = 1e-3;
const DOWN: Vector3<f64> = Vector3::new(0.0, 0.0, -1.0);

/// Momentum \[kg·m/s\], angular momentum about the origin, and energy (kinetic, stretch, bending and twist) \[J\] of
/// needle and thread.
fn motion(suture: &Suture) -> (Vector3<f64>, Vector3<f64>, f64) {
    let state = suture.state();
    let needle = &state.needle;
    let mut momentum = needle.momentum;
    let mut angular = needle.angular_momentum + needle.center.coords.cross(&needle.momentum);
    let mut energy = needle.kinetic_energy(suture.solid());
    if let Some(thread) = &state.thread {
        let material = trocar_simulator::suture_thread::ThreadMaterial::silk_2_0();
        for node in 0..thread.positions.len() {
            let before = if node > 0 { thread.rest_lengths[node - 1] } else { 0.0 };
            let after = thread.rest_lengths.get(node).copied().unwrap_or(0.0);
            let mass = 0.5 * material.mass_per_length * (before + after);
            let v = thread.velocities[node];
            momentum += v * mass;
            angular += thread.positions[node].coords.cross(&v) * mass;
            energy += 0.5 * mass * v.norm_squared();
            let inside = node > 0 && node + 1 < thread.positions.len();
            if node > 0 {
                let length = (thread.positions[node] - thread.positions[node - 1]).norm();
                energy += 0.5 * material.axial_stiffness / before * (length - before).powi(2);
            }
            if inside {
                let t = (thread.positions[node] - thread.positions[node - 1]).normalize();
                let u = (thread.positions[node + 1] - thread.positions[node]).normalize();
                let bent = t.cross(&u) * 2.0 / (1.0 + t.dot(&u));
                let span = 0.5 * (before + after);
                energy += 0.5 * material.bending_stiffness / span * bent.norm_squared();
                energy += 0.5 * material.twisting_stiffness / span * thread.twists[node].powi(2);
            }
        }
        for (spin, rest) in thread.spins.iter().zip(&thread.rest_lengths) {
            energy += 0.25 * material.mass_per_length * rest * (material.radius * spin).powi(2);
        }
    }
    (momentum, angular, energy)
}

#[test]
fn a_needle_in_flight_keeps_its_momenta_and_gains_no_energy() {
    let shape = NeedleShape::half_circle_26();
    let mut suture = bare(&shape, &Isometry3::identity(), Resistance::default(), nowhere());
    let mut state = suture.state().clone();
    state.needle.momentum = Vector3::new(2e-5, -1e-5, 3e-5);
    state.needle.angular_momentum = state.needle.inertia(suture.solid()) * Vector3::new(3.0, 20.0, -8.0);
    suture = Suture::new(&shape, None, Resistance::default(), nowhere(), state).expect("a suture");
    let (p, l, mut energy) = motion(&suture);
    let begin = energy;
    for _ in 0..500 {
        suture.step(DT, &StepInputs::default()).expect("a step");
        let now = motion(&suture);
        assert!((now.0 - p).norm() <= 1e-12 * p.norm() && (now.1 - l).norm() <= 1e-9 * l.norm());
        assert!(now.2 <= energy * (1.0 + 1e-9), "gains energy: {} after {energy}", now.2);
        energy = now.2;
    }
    // Backward Euler turns it slowly towards its axis of largest inertia, without braking it.
    assert!(energy > 0.5 * begin, "{energy} of {begin} J");
}

#[test]
fn needle_and_thread_exchange_momentum_exactly_and_gain_no_energy() {
    let shape = NeedleShape::half_circle_26();
    let mut suture = threaded(&shape, &Isometry3::identity(), 30, 2e-3, Resistance::default(), nowhere());
    let mut state = suture.state().clone();
    state.needle.momentum = Vector3::new(0.0, 1e-5, 1e-5);
    state.needle.angular_momentum = state.needle.inertia(suture.solid()) * Vector3::new(5.0, 0.0, 10.0);
    let mut material = trocar_simulator::suture_thread::ThreadMaterial::silk_2_0();
    // Drag would remove momentum.
    material.drag = 0.0;
    suture = Suture::new(&shape, Some(material), Resistance::default(), nowhere(), state).expect("a suture");
    let (p, _, mut energy) = motion(&suture);
    let alone = suture.state().needle.momentum;
    let begin = energy;
    for step in 0..300 {
        suture.step(DT, &StepInputs::default()).unwrap_or_else(|why| panic!("step {step}: {why}"));
        let now = motion(&suture);
        assert!((now.0 - p).norm() <= 1e-6 * p.norm(), "step {step}: {} of {}", (now.0 - p).norm(), p.norm());
        assert!(now.2 <= energy + 1e-6 * begin, "step {step}: {} after {energy} of {begin} J", now.2);
        energy = now.2;
    }
    let state = suture.state();
    let exchanged = (state.needle.momentum - alone).norm();
    assert!(exchanged > 0.05 * alone.norm(), "the thread took nothing: {exchanged}");
    // Swaged: the thread begins in the tail, along its tangent.
    let pose = state.needle.pose();
    let thread = state.thread.as_ref().expect("a thread");
    let tail = pose * suture.solid().point(0.0);
    let first = (thread.positions[1] - thread.positions[0]).normalize();
    assert!((thread.positions[0] - tail).norm() < 1e-6);
    assert!(first.dot(&(pose * -suture.solid().tangent(0.0))) > 1.0 - 1e-5);
}

/// A straight needle driven straight down at a speed to a target depth of its tip \[m\]; calls back in each step with
/// the target depth, the force of the jaws, and the report.
fn drive(
    suture: &mut Suture,
    shape: &NeedleShape,
    from: Isometry3<f64>,
    speed: f64,
    steps: usize,
    dt: f64,
    mut see: impl FnMut(f64, f64, &SutureReport, &Suture),
) -> Isometry3<f64> {
    let mut at = from;
    for step in 0..steps {
        let mut to = from;
        to.translation.vector += DOWN * (speed * dt * (step + 1) as f64);
        let grips = [jaws(shape, 0.5 * shape.length(), at, to)];
        let around = StepInputs { grips: &grips, ..StepInputs::default() };
        let report = suture.step(dt, &around).unwrap_or_else(|why| panic!("step {step}: {why}"));
        // Downward force of the jaws.
        see(speed * dt * (step + 1) as f64, -suture.gripped()[0].force.z, &report, suture);
        at = to;
    }
    at
}

#[test]
fn before_it_punctures_it_is_a_spring_and_then_it_cuts_and_rubs() {
    let shape = straight();
    let tip = Point3::new(1.3e-3, 0.7e-3, 0.0);
    let start = pose(&shape, tip, DOWN, Vector3::y());
    // The tip sticks to the surface, so that the contact point moves straight down.
    let resistance = Resistance {
        puncture_force: 0.3,
        cutting_force: 0.12,
        needle_grip: 20.0,
        needle_friction: 1.0,
        ..Resistance::default()
    };
    let mut suture = bare(&shape, &start, resistance, tissue(pad()));
    // The same stiffness by another method: the precomputed compliance of the surface.
    let (mesh, fixed) = pad();
    let at = suture.tissue().nearest(&tip).0;
    let corners = mesh.tets()[at.tet as usize];
    let mut organ =
        LinearFem::new(mesh, &elastic(), &fixed, &Limits::default(), &mut |_| true).expect("an organ");
    let handle = organ.hold(Attachment::barycentric(corners, at.weights, Hold::Point)).expect("held");
    organ.set_target(handle, DOWN * 1e-3).expect("a target");
    let stiffness = -organ.solve(&[]).expect("forces").reactions[0].force.z / 1e-3;
    // In series with the compliance of the jaws and of the row itself.
    let felt = 1.0 / (1.0 / stiffness + 1e-5 + 1e-6);

    let speed = 5e-3;
    let (mut before, mut punctured, mut steady) = (0, None, Vec::new());
    drive(&mut suture, &shape, start, speed, 600, DT, |depth, force, _, suture| {
        match suture.state().tip {
            Tip::Touching(..) => {
                before += 1;
                let expected = felt * depth;
                // The first steps accelerate the needle.
                assert!(
                    depth < 1e-4 || (force - expected).abs() < 0.01 * expected,
                    "{force} N for {expected} at {depth}"
                );
            }
            Tip::Inside(_) if punctured.is_none() => punctured = Some(depth),
            _ => {}
        }
    });
    let punctured = punctured.expect("it goes in");
    assert!(
        before > 20 && (punctured - 0.3 / felt).abs() < 0.01 * punctured + speed * DT,
        "{punctured} for {}",
        0.3 / felt
    );
    assert_eq!(suture.state().bites[0].entry_force, 0.3);
    // At constant speed: cutting force and friction. Without Coulomb's part, since the tissue is not symmetric.
    let smooth = Resistance { needle_friction: 0.0, ..resistance };
    let mut suture = bare(&shape, &start, smooth, tissue(pad()));
    drive(&mut suture, &shape, start, speed, 1800, DT, |depth, force, report, suture| {
        if depth > 4e-3 && matches!(suture.state().tip, Tip::Inside(_)) {
            steady.push((report.length_inside, force));
        }
    });
    assert!(steady.len() > 500);
    for (inside, force) in &steady {
        let expected = 0.12 + 20.0 * inside;
        assert!((force - expected).abs() < 0.02 * expected, "{force} N for {expected} at {inside} m");
    }
    // The target depth minus the displacement of the tissue.
    let (inside, force) = steady[steady.len() - 1];
    let drawn = suture.tissue().displacement_max();
    assert!(
        (inside - 9e-3).abs() < 2.0 * drawn + 1e-4,
        "{inside} m inside, tissue drawn by {drawn} m, {force} N"
    );
}

#[test]
fn pushed_by_no_force_that_punctures_it_only_dents() {
    let shape = straight();
    let start = pose(&shape, Point3::new(1.3e-3, 0.7e-3, 0.0), DOWN, Vector3::y());
    let resistance = Resistance { puncture_force: 1e3, ..Resistance::default() };
    let mut suture = bare(&shape, &start, resistance, tissue(pad()));
    drive(&mut suture, &shape, start, 5e-3, 600, DT, |_, _, _, suture| {
        assert!(matches!(suture.state().tip, Tip::Touching(..)) && suture.state().bites.is_empty());
    });
}

#[test]
fn the_step_does_not_matter_to_the_puncture() {
    let shape = straight();
    let start = pose(&shape, Point3::new(1.3e-3, 0.7e-3, 0.5e-3), DOWN, Vector3::y());
    let found: Vec<(f64, f64)> = [1.0, 0.5, 0.25]
        .map(|scale| {
            let mut suture = bare(&shape, &start, Resistance::default(), tissue(pad()));
            let (mut peak, mut depth) = (0.0_f64, None);
            drive(
                &mut suture,
                &shape,
                start,
                0.02,
                (400.0 / scale) as usize,
                scale * DT,
                |at, force, _, suture| {
                    if depth.is_none() {
                        peak = peak.max(force);
                    }
                    if !suture.state().bites.is_empty() {
                        depth.get_or_insert(at);
                    }
                },
            );
            (peak, depth.expect("it goes in"))
        })
        .to_vec();
    for (peak, depth) in &found {
        assert!((peak / 0.6 - 1.0).abs() < 0.03, "{peak} N for 0.6");
        assert!((depth - found[2].1).abs() <= 0.02 * DT + 1e-9, "{depth} m for {}", found[2].1);
    }
}

#[test]
fn drawn_back_it_rubs_the_other_way_and_leaves_nothing_behind() {
    let shape = straight();
    let start = pose(&shape, Point3::new(1.3e-3, 0.7e-3, 0.0), DOWN, Vector3::y());
    let resistance = Resistance { needle_friction: 0.0, ..Resistance::default() };
    let mut suture = bare(&shape, &start, resistance, tissue(pad()));
    let deep = drive(&mut suture, &shape, start, 10e-3, 800, DT, |_, _, _, _| {});
    assert!(!suture.state().channel.is_empty());
    let mut checked = 0;
    let mut withdrawn = false;
    drive(&mut suture, &shape, deep, -10e-3, 1000, DT, |back, force, report, suture| {
        if back < -2e-3 && report.length_inside > 1e-3 {
            let expected = -resistance.needle_grip * report.length_inside;
            assert!((force - expected).abs() < 0.03 * expected.abs(), "{force} N for {expected}");
            checked += 1;
        }
        withdrawn |= suture.events().contains(&Event::Withdrawn { bite: 0 });
    });
    assert!(checked > 300 && withdrawn);
    assert!(suture.state().channel.is_empty() && suture.state().tip == Tip::Free);
    assert!(suture.tissue().displacement_max() < 1e-12);
}

#[test]
fn nothing_is_missed_at_a_metre_a_second() {
    // A membrane of half a millimetre, which a step of a millimetre could skip.
    let membrane = || {
        let (mesh, _) = block([0.02, 0.02, 0.0005], [10, 10, 1], [-0.01, -0.01, -0.0005]);
        let rim = |node: &u32| mesh.rest()[*node as usize].xy().coords.amax() > 0.01 - 1e-9;
        let fixed = (0..mesh.rest().len() as u32).filter(rim).collect();
        (mesh, fixed)
    };
    let shape = straight();
    for shot in 0..24 {
        let turn = |k: usize| (shot as f64 * [0.618, 0.414, 0.732][k]).fract() - 0.5;
        let tip = Point3::new(turn(0) * 0.015, turn(1) * 0.015, 0.003 + turn(2) * 1e-3);
        let ahead = Vector3::new(turn(1) * 0.6, turn(2) * 0.6, -1.0).normalize();
        let start = pose(&shape, tip, ahead, Vector3::y());
        let resistance = Resistance { puncture_force: 1e4, ..Resistance::default() };
        let mut suture = bare(&shape, &start, resistance, tissue(membrane()));
        let mut touched = None;
        let mut at = start;
        for _ in 0..5 {
            let mut to = at;
            to.translation.vector += ahead * 1e-3;
            let grips = [jaws(&shape, 0.5 * shape.length(), at, to)];
            suture.step(DT, &StepInputs { grips: &grips, ..StepInputs::default() }).expect("a step");
            at = to;
            for event in suture.events() {
                if let Event::Touched(place) = event {
                    touched.get_or_insert(*place);
                }
            }
        }
        let expected = tip + ahead * (tip.z / -ahead.z);
        let touched = touched.unwrap_or_else(|| panic!("shot {shot} passed through"));
        assert!((touched - expected).norm() < 2e-5, "shot {shot}: {touched} for {expected}");
        // It is not punctured: so the tip is at the membrane, except for sliding along the slope of its dent in the
        // last step.
        let tip = suture.tip();
        let (place, _) = suture.tissue().nearest(&tip);
        let off = suture.tissue().now(&place) - tip;
        assert!(off.norm() < 3e-4, "shot {shot}: {off}");
    }
}

/// Height of the arc's centre over the pad, and initial height of the tip \[m\].
const HEIGHTS: [f64; 2] = [3e-3, 1e-4];

/// A half circle with its tip above the pad, and the world's rotation about the centre of its arc.
fn arc() -> (NeedleShape, Isometry3<f64>, impl Fn(f64) -> Isometry3<f64>) {
    let shape = NeedleShape::half_circle_26();
    let sin = (HEIGHTS[1] - HEIGHTS[0]) / shape.radius;
    let cos = (1.0 - sin * sin).sqrt();
    let tip = Point3::new(shape.radius * cos, 0.3e-3, HEIGHTS[1]);
    let start = pose(&shape, tip, Vector3::new(sin, 0.0, -cos), Vector3::y());
    let center = start * shape.solid().expect("a needle").center_of_arc();
    assert!((center - Point3::new(0.0, 0.3e-3, HEIGHTS[0])).norm() < 1e-9, "{center}");
    let axis = Unit::new_normalize(start * Vector3::z());
    let turned = move |angle: f64| {
        let turn = UnitQuaternion::from_axis_angle(&axis, angle);
        let rotated = turn * (start.translation.vector - center.coords) + center.coords;
        Isometry3::from_parts(rotated.into(), turn * start.rotation)
    };
    (shape, start, turned)
}

#[test]
fn along_its_own_arc_it_hardly_moves_the_tissue_and_straight_on_it_presses_across() {
    let (shape, start, turned) = arc();
    let resistance =
        Resistance { puncture_force: 0.05, cutting_force: 0.02, needle_grip: 1.0, ..Resistance::default() };
    let mut suture = bare(&shape, &start, resistance, tissue(pad()));
    let rate = 1.0;
    let mut at = turned(0.0);
    let (mut across, mut force) = (0.0_f64, 0.0_f64);
    for step in 0..1300 {
        let to = turned(rate * DT * (step + 1) as f64);
        let grips = [jaws(&shape, 0.3 * shape.length(), at, to)];
        let report = suture.step(DT, &StepInputs { grips: &grips, ..StepInputs::default() }).expect("a step");
        at = to;
        if matches!(suture.state().tip, Tip::Inside(_)) && report.length_inside > 2e-3 {
            across = across.max(report.across_max);
            force = force.max(report.force_on_tissue.norm());
        }
    }
    let moved = suture.tissue().displacement_max();
    let inside: f64 =
        suture.state().channel.last().expect("a channel").along - suture.state().channel[0].along;
    assert!(inside > 8e-3, "{inside} m");
    assert!(moved < 5e-4, "the tissue is drawn by {moved} m");
    // The same distance again, but straight down.
    let mut straight = 0.0_f64;
    let mut torn = 0.0_f64;
    for step in 0..600 {
        let mut to = at;
        to.translation.vector += DOWN * 5e-6;
        let grips = [jaws(&shape, 0.3 * shape.length(), at, to)];
        let report = suture.step(DT, &StepInputs { grips: &grips, ..StepInputs::default() }).expect("a step");
        at = to;
        straight = straight.max(report.force_on_tissue.norm());
        torn = torn.max(report.across_max);
        assert!(step < 600);
    }
    assert!(straight > 5.0 * force, "{straight} N straight, {force} N along the arc");
    assert!(torn > 5.0 * across, "{torn} N/m straight, {across} N/m along the arc");
}

#[test]
fn it_comes_out_where_its_arc_does() {
    let (shape, start, turned) = arc();
    let resistance = Resistance {
        puncture_force: 0.2,
        exit_force: 0.1,
        cutting_force: 0.05,
        needle_grip: 2.0,
        ..Resistance::default()
    };
    let mut suture = bare(&shape, &start, resistance, tissue(pad()));
    let mut at = turned(0.0);
    let mut events = Vec::new();
    for step in 0..3000 {
        let to = turned(DT * (step + 1) as f64);
        let grips = [jaws(&shape, 0.05 * shape.length(), at, to)];
        suture
            .step(DT, &StepInputs { grips: &grips, ..StepInputs::default() })
            .unwrap_or_else(|why| panic!("step {step}: {why}"));
        events.extend(suture.events().iter().copied().filter(|event| !matches!(event, Event::Touched(_))));
        at = to;
    }
    assert_eq!(events, [Event::Entered { bite: 0, force: 0.2 }, Event::Left { bite: 0, force: 0.1 }]);
    let bite = suture.state().bites[0];
    let (entry, exit) = (bite.entry.0, bite.exit.expect("an exit").0);
    let tissue = suture.tissue();
    let chord = tissue.at_rest(&exit) - tissue.at_rest(&entry);
    let plan = -2.0 * (shape.radius.powi(2) - HEIGHTS[0].powi(2)).sqrt();
    assert!(
        (chord.x - plan).abs() < 1.5e-3 && chord.y.abs() < 5e-4,
        "{} mm for {}",
        chord.x * 1e3,
        plan * 1e3
    );
    assert!(suture.tip().z > 1e-3);
}
