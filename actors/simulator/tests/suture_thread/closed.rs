//! Closed threads: rings against closed forms (Love, *A treatise on the mathematical theory of elasticity*, 1927; Michell,
//! *On the stability of a bent and twisted wire*, 1889), the seam, cuts, loops that hang.

use std::f64::consts::{PI, TAU};

use crate::support::stage::{Stage, context, scene};
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_scene::{BuildContext, Component, ControllerError, LineMesh, SimTime, VertexPositions};
use trocar_simulator::controller::{KnotState, Laid, LiesOn, ThreadBody, ThreadController};
use trocar_simulator::suture_thread::{
    CutAt, Hold, Load, Obstacle, Shape, Surroundings, Thread, ThreadMaterial, ThreadState,
};

const RADIUS: f64 = 0.02;

fn circle(nodes: usize) -> Vec<Point3<f64>> {
    let at = |node: usize| TAU * node as f64 / nodes as f64;
    (0..nodes).map(|node| Point3::new(RADIUS * at(node).cos(), RADIUS * at(node).sin(), 0.0)).collect()
}

/// A wire of 2 mm that is bent easily and comes to rest soon.
fn wire(twisting_over_bending: f64) -> ThreadMaterial {
    ThreadMaterial {
        radius: 1e-3,
        mass_per_length: 1e-4,
        axial_stiffness: 1e3,
        bending_stiffness: 1e-7,
        twisting_stiffness: 1e-7 * twisting_over_bending,
        damping: 1e-3,
        drag: 100.0,
        ..ThreadMaterial::silk_2_0()
    }
}

/// Bending energy \[J\], from the positions.
fn bending_energy(material: &ThreadMaterial, state: &ThreadState) -> f64 {
    let n = state.positions.len();
    let edge = |k: usize| state.positions[(k + 1) % n] - state.positions[k % n];
    let of = |node: usize| {
        let (before, after) = (edge(node + n - 1), edge(node));
        let span = 0.5 * (state.rest_lengths[(node + n - 1) % n] + state.rest_lengths[node]);
        let (t, u) = (before.normalize(), after.normalize());
        let curved = 2.0 * t.cross(&u).norm() / (1.0 + t.dot(&u));
        0.5 * material.bending_stiffness / span * curved * curved
    };
    (0..n).map(of).sum()
}

/// Largest and smallest distance from the middle.
fn radii(positions: &[Point3<f64>]) -> [f64; 2] {
    let middle = positions.iter().map(|at| at.coords).sum::<Vector3<f64>>() / positions.len() as f64;
    let all = positions.iter().map(|at| (at.coords - middle).norm());
    [all.clone().fold(0.0, f64::max), all.fold(f64::INFINITY, f64::min)]
}

fn settle(thread: &mut Thread, steps: usize, around: &Surroundings<'_>) {
    (0..steps).for_each(|_| {
        thread.step(2e-3, around).expect("a step");
    });
}

#[test]
fn a_ring_that_was_pressed_to_an_ellipse_becomes_a_circle_again_with_the_energy_of_the_closed_form() {
    let mut errors = Vec::new();
    for nodes in [20, 40, 80] {
        let material = wire(1.5);
        let mut state = ThreadState::closed_at_rest(&circle(nodes));
        assert!(state.is_closed() && state.twists.iter().all(|twist| twist.abs() < 1e-12), "a plane curve");
        for place in &mut state.positions {
            *place = Point3::new(1.1 * place.x, place.y / 1.1, 0.1 * place.x);
        }
        let mut thread = Thread::restore(material, state).expect("a ring");
        settle(&mut thread, 1500, &Surroundings::default());
        let [most, least] = radii(thread.positions());
        let round = most / least - 1.0;
        assert!(round < 1e-7, "{nodes} edges: {round:.2e} from round");
        // Of the same length.
        let radius = thread.state().rest_length() / TAU;
        let energy = bending_energy(&material, thread.state());
        errors.push(energy / (PI * material.bending_stiffness / radius) - 1.0);
        println!("{nodes} edges: {round:.2e} from round, energy off by {:.3e}", errors[errors.len() - 1]);
        // Of a regular polygon: 2/3 (π/n)².
        let polygon = 2.0 / 3.0 * (PI / nodes as f64).powi(2);
        assert!((errors[errors.len() - 1] / polygon - 1.0).abs() < 0.03, "{errors:?}");
    }
    let orders = errors.windows(2).map(|pair| (pair[0] / pair[1]).log2());
    orders.for_each(|order| assert!((order - 2.0).abs() < 0.02, "order {order}"));
}

/// Change of the diameter along two opposite forces and across them, over F R³/B.
fn pulled(nodes: usize) -> [f64; 2] {
    let material = wire(1.5);
    let mut thread = Thread::closed(material, &circle(nodes)).expect("a ring");
    let radius = thread.state().rest_length() / TAU;
    // A thousandth of B/R²: the ring stays nearly a circle.
    let force = 1e-3 * material.bending_stiffness / (radius * radius);
    let loads =
        [(0, 1.0), (nodes / 2, -1.0)].map(|(node, sign)| Load { node, force: Vector3::x() * (sign * force) });
    let around = Surroundings { loads: &loads, ..Surroundings::default() };
    let width = |thread: &Thread| {
        let at = thread.positions();
        [at[0].x - at[nodes / 2].x, at[nodes / 4].y - at[3 * nodes / 4].y]
    };
    let before = width(&thread);
    settle(&mut thread, 2500, &around);
    let after = width(&thread);
    let unit = force * radius.powi(3) / material.bending_stiffness;
    [0, 1].map(|k| (after[k] - before[k]) / unit)
}

#[test]
fn a_ring_that_is_pulled_at_opposite_points_widens_and_narrows_as_love_says() {
    let love = [PI / 4.0 - 2.0 / PI, 0.5 - 2.0 / PI];
    assert!((love[0] - 0.149).abs() < 5e-4 && (love[1] + 0.137).abs() < 5e-4);
    let mut errors = Vec::new();
    for nodes in [20, 40, 80] {
        let found = pulled(nodes);
        errors.push([0, 1].map(|k| found[k] / love[k] - 1.0));
        println!("{nodes} edges: {found:?}, off by {:?}", errors[errors.len() - 1]);
    }
    assert!(errors[2].iter().all(|error| error.abs() < 4e-3), "{errors:?}");
    for k in [0, 1] {
        let order = (errors[0][k] / errors[1][k]).abs().log2();
        assert!((order - 2.0).abs() < 0.3, "order {order}: {errors:?}");
    }
}

/// How far a ring with one whole turn of twist leaves its plane, over how far it was displaced at first.
fn buckled(twisting_over_bending: f64) -> f64 {
    let nodes = 60;
    let mut state = ThreadState::closed_with_turns(&circle(nodes), 1);
    assert!((state.twists.iter().sum::<f64>() - TAU).abs() < 1e-12);
    let first = 1e-6;
    for (node, place) in state.positions.iter_mut().enumerate() {
        place.z = first * (2.0 * TAU * node as f64 / nodes as f64).cos();
    }
    let mut thread = Thread::restore(wire(twisting_over_bending), state).expect("a ring");
    settle(&mut thread, 3000, &Surroundings::default());
    let heights = thread.positions().iter().map(|at| at.z);
    (heights.clone().fold(0.0, f64::max) - heights.fold(0.0, f64::min)) / (2.0 * first)
}

/// The critical twist of a ring is 2π√3 B/C: with one turn it stays plane up to C = √3 B.
#[test]
fn a_twisted_ring_leaves_its_plane_where_michell_says() {
    let critical = 3.0_f64.sqrt();
    let [below, above] = [0.98, 1.02].map(|share| buckled(share * critical));
    println!("2 % below: {below:.2e}, above: {above:.2e}");
    assert!(below < 0.5, "{below}");
    assert!(above > 3.0, "{above}");
}

/// Writhe of a closed polygon: the solid angles under which each two edges see each other (Klenin, Langowski 2000).
fn writhe(points: &[Point3<f64>]) -> f64 {
    let n = points.len();
    let mut sum = 0.0;
    for i in 0..n {
        for j in i + 2..n {
            if i == 0 && j + 1 == n {
                continue;
            }
            let [a, b, c, d] = [points[i], points[i + 1], points[j], points[(j + 1) % n]];
            let (ac, ad, bc, bd) = (c - a, d - a, c - b, d - b);
            let normals = [ac.cross(&ad), ad.cross(&bd), bd.cross(&bc), bc.cross(&ac)];
            let Some(normals) = normals.iter().map(|of| of.try_normalize(1e-30)).collect::<Option<Vec<_>>>()
            else {
                continue;
            };
            let angle: f64 =
                (0..4).map(|k| normals[k].dot(&normals[(k + 1) % 4]).clamp(-1.0, 1.0).asin()).sum();
            sum += angle * (d - c).cross(&(b - a)).dot(&ac).signum();
        }
    }
    sum / TAU
}

/// A curve that is not plane turns what is carried around it: the material is twisted by that at the seam. Twist and
/// writhe add up to a whole number of turns (Călugăreanu 1961; White 1969; Fuller 1971).
#[test]
fn a_loop_that_is_not_plane_is_twisted_by_its_holonomy() {
    let nodes = 200;
    // Coils about a ring, left-handed and right-handed.
    for coil in [-0.2, 0.1, 0.3] {
        let size: f64 = f64::abs(coil) * RADIUS;
        let points: Vec<_> = (0..nodes)
            .map(|node| {
                let around = TAU * node as f64 / nodes as f64;
                let (out, up) =
                    (size * (3.0 * around).cos(), size * (3.0 * around).sin() * f64::signum(coil));
                Point3::new((RADIUS + out) * around.cos(), (RADIUS + out) * around.sin(), up)
            })
            .collect();
        let state = ThreadState::closed_at_rest(&points);
        let twist = state.twists.iter().sum::<f64>() / TAU;
        let whole = twist + writhe(&points);
        println!("coil {coil}: twist {twist:.6}, with the writhe {whole:.9}");
        assert!((whole - whole.round()).abs() < 1e-7, "{whole}");
        assert!(twist.abs() <= 0.5 && twist.abs() > 0.01);
        // In equal parts of the length.
        let length = state.rest_length();
        for node in 0..nodes {
            let span = 0.5 * (state.rest_lengths[(node + nodes - 1) % nodes] + state.rest_lengths[node]);
            assert!((state.twists[node] / (TAU * twist) - span / length).abs() < 1e-12);
        }
        // A whole turn more is as well glued: the solver reads the same angle at the seam.
        let turned = ThreadState::closed_with_turns(&points, 1);
        let mut thread = Thread::restore(wire(1.0), turned.clone()).expect("a loop");
        thread.step(1e-6, &Surroundings::default()).expect("a step");
        let after: f64 = thread.state().twists.iter().sum();
        assert!((after - turned.twists.iter().sum::<f64>()).abs() < 1e-3, "{after}");
    }
}

#[test]
fn a_ring_that_flies_keeps_its_momentum_and_its_angular_momentum() {
    let material = ThreadMaterial { drag: 0.0, damping: 0.0, ..wire(1.5) };
    let mut state = ThreadState::closed_with_turns(&circle(40), 1);
    for (node, velocity) in state.velocities.iter_mut().enumerate() {
        let around = TAU * node as f64 / 40.0;
        *velocity = Vector3::new(0.1, -0.05, 0.02 + 0.03 * (2.0 * around).cos())
            + Vector3::new(1.0, -2.0, 6.0).cross(&state.positions[node].coords);
    }
    let momenta = |state: &ThreadState| {
        let n = state.positions.len();
        let mut sums = [Vector3::zeros(); 2];
        for node in 0..n {
            let span = 0.5 * (state.rest_lengths[(node + n - 1) % n] + state.rest_lengths[node]);
            let momentum = state.velocities[node] * (material.mass_per_length * span);
            sums[0] += momentum;
            sums[1] += state.positions[node].coords.cross(&momentum);
            let inertia = 0.5 * material.mass_per_length * state.rest_lengths[node] * material.radius.powi(2);
            let along = state.positions[(node + 1) % n] - state.positions[node];
            sums[1] += along.normalize() * (inertia * state.spins[node]);
        }
        sums
    };
    let [before, turning] = momenta(&state);
    let mut thread = Thread::restore(material, state).expect("a ring");
    for _ in 0..500 {
        thread.step(1e-4, &Surroundings::default()).expect("a step");
    }
    let [after, turned] = momenta(thread.state());
    let off = [(after - before).norm() / before.norm(), (turned - turning).norm() / turning.norm()];
    println!("off by {off:?}");
    // As an open thread; the second is of first order in the step.
    assert!(off[0] < 1e-7, "{off:?}");
    assert!(off[1] < 0.02, "{off:?}");
}

#[test]
fn a_loop_over_a_peg_carries_half_of_the_weight_in_each_strand() {
    let nodes = 80;
    let material = ThreadMaterial { drag: 100.0, ..ThreadMaterial::silk_2_0() };
    let points: Vec<_> = circle(nodes).iter().map(|at| Point3::new(at.y, 0.0, at.x)).collect();
    let mut thread = Thread::closed(material, &points).expect("a loop");
    // A smooth peg along y, inside the loop at its top.
    let peg = Shape::Capsule { ends: [-1.0, 1.0].map(|y| Point3::new(0.0, 0.05 * y, 0.0)), radius: 0.004 };
    let peg = Obstacle::fixed(peg, Isometry3::translation(0.0, 0.0, RADIUS - 0.004 - 2e-4), 0.0);
    let weight = 0.5;
    let loads = [Load { node: nodes / 2, force: Vector3::new(0.0, 0.0, -weight) }];
    let (obstacles, gravity) = ([peg], Vector3::new(0.0, 0.0, -9.81));
    let around = Surroundings { gravity, loads: &loads, obstacles: &obstacles, ..Surroundings::default() };
    settle(&mut thread, 1500, &around);
    let state = thread.state();
    let own = material.mass_per_length * state.rest_length() * 9.81;
    // Half-way down each strand; below it hangs a quarter of the thread.
    let strands = [nodes / 4, 3 * nodes / 4].map(|edge| {
        let along = (state.positions[(edge + 1) % nodes] - state.positions[edge]).normalize();
        state.tensions[edge] * along.z.abs()
    });
    for strand in strands {
        assert!((strand / (0.5 * (weight + 0.5 * own)) - 1.0).abs() < 2e-4, "{strand} N");
    }
    let borne = thread.reactions()[0].force;
    println!("strands {strands:?}, peg {borne:?}");
    assert!((borne + Vector3::new(0.0, 0.0, weight + own)).norm() < 1e-3 * weight, "{borne}");
    // The same wherever the seam is: over the peg, or at the weight.
    let mut turned = points.clone();
    turned.rotate_left(nodes / 2);
    let mut other = Thread::closed(material, &turned).expect("a loop");
    let loads = [Load { node: 0, force: Vector3::new(0.0, 0.0, -weight) }];
    let around = Surroundings { loads: &loads, ..around };
    settle(&mut other, 1500, &around);
    let lowest = |thread: &Thread| thread.positions().iter().map(|at| at.z).fold(f64::INFINITY, f64::min);
    assert!((lowest(&thread) - lowest(&other)).abs() < 1e-6, "{} and {}", lowest(&thread), lowest(&other));
}

/// Edges of one radius: neighbours along the thread are nearer than a diameter, also over the seam.
#[test]
fn neighbours_over_the_seam_do_not_touch_and_strands_across_it_do() {
    let nodes = (TAU * RADIUS / 1e-3).round() as usize;
    let rough = ThreadMaterial { friction: 1.0, ..wire(1.5) };
    let mut thread = Thread::closed(rough, &circle(nodes)).expect("a ring");
    let report = thread.step(1e-3, &Surroundings::default()).expect("a step");
    assert_eq!((report.contacts, report.penetration_max), (0, 0.0));
    // A ring that is drawn flat touches itself at the seam, and does not pass through.
    let drawn = |node: usize| Hold { node, to: Point3::origin(), stiffness: 1e3, force_max: 5e-3 };
    let holds = [drawn(0), drawn(nodes / 2)];
    let around = Surroundings { holds: &holds, ..Surroundings::default() };
    settle(&mut thread, 1000, &around);
    let at = thread.positions();
    let gap = at[0].x - at[nodes / 2].x;
    let aside = (at[0] - at[nodes / 2]).yz().norm();
    println!("drawn to {gap:.3e} m, {aside:.1e} m aside");
    assert!((gap - 2e-3).abs() < 1e-4, "{gap} m, of two threads of 2 mm");
    assert!(thread.state().contacts.iter().any(|contact| contact.force.norm() > 0.0));
}

#[test]
fn a_cut_opens_a_ring_to_one_thread_wherever_it_is_made() {
    let nodes = 40;
    for (edge, share) in [(0, 0.5), (17, 0.0), (nodes - 1, 0.3), (nodes - 1, 1.0), (nodes - 2, 0.9)] {
        let mut state = ThreadState::closed_with_turns(&circle(nodes), 1);
        for (node, velocity) in state.velocities.iter_mut().enumerate() {
            velocity.z = node as f64;
        }
        let material = wire(1.5);
        let mut thread = Thread::restore(material, state.clone()).expect("a ring");
        let cut = thread.cut(CutAt { edge, share }).expect("valid").expect("long enough");
        let open = thread.state();
        assert!(!open.is_closed());
        assert_eq!(open.threads().count(), 1, "edge {edge}");
        let gap = (state.rest_length() - open.rest_length()) / material.diameter();
        assert!((0.45..=1.55).contains(&gap), "{gap} diameters are gone");
        assert_eq!((open.twists[0], open.twists[open.twists.len() - 1]), (0.0, 0.0));
        // What was kept is where it was, turned by as much, and as fast.
        let kept: Vec<(usize, usize)> =
            cut.nodes.iter().enumerate().filter_map(|(node, now)| Some((node, (*now)? as usize))).collect();
        assert!(kept.len() >= nodes - 2, "{kept:?}");
        for &(node, now) in &kept {
            assert_eq!(open.positions[now], state.positions[node]);
            assert_eq!(open.velocities[now], state.velocities[node]);
            let is_end = now == 0 || now + 1 == open.positions.len();
            assert!(is_end || open.twists[now] == state.twists[node]);
        }
        // One after the other, over the former seam.
        assert!(kept.windows(2).all(|pair| pair[1].1 == pair[0].1 + 1 || pair[1].1 < pair[0].1));
        // It springs open.
        settle(&mut thread, 300, &Surroundings::default());
        let at = thread.positions();
        let ends = (at[0] - at[at.len() - 1]).norm();
        assert!(ends > 0.02, "its ends are {ends} m apart");
    }
}

fn build(context: &BuildContext<'_>) -> Result<ThreadController, ControllerError> {
    ThreadController::new(Vector3::new(0.0, 0.0, -9.81), None, context)
}

fn places(points: &[Point3<f64>]) -> String {
    let of = |at: &Point3<f64>| format!("[{:.6}, {:.6}, {:.6}]", at.x, at.y, at.z);
    points.iter().map(of).collect::<Vec<_>>().join(", ")
}

/// A ring upright about a peg.
fn hanging(more: &str) -> String {
    let upright: Vec<_> = circle(24).iter().map(|at| Point3::new(at.y, 0.0, at.x)).collect();
    format!(
        "[[entity]]\nname = \"ring\"\nmesh = {{ line = {{ length = 0.1, segments = 10, radius = 1.5e-4 }} }}\n\
         thread = {{ closed = true, edges = [8.0, 0.002], laid = {{ through = {{ places = [{}] }} }}{more} }}\n\
         [[entity]]\nname = \"peg\"\npose = {{ translation = [0.0, 0.0, 0.0155], rotation = [0.7071067811865476, 0.0, 0.0, 0.7071067811865476] }}\n\
         shape = {{ capsule = {{ radius = 0.004, half_height = 0.05 }} }}\nrigid_body = {{}}\n",
        places(&upright)
    )
}

#[test]
fn a_scenario_closes_a_thread_and_another_life_goes_on_to_the_bit() {
    let start = || Stage::new(scene(&hanging("")), 500.0, build);
    let (mut whole, mut killed) = (start(), start());
    (0..100).for_each(|_| whole.tick());
    (0..60).for_each(|_| killed.tick());
    killed.rebuild(build);
    (0..40).for_each(|_| killed.tick());
    let at = |stage: &Stage<ThreadController>| stage.get::<VertexPositions>("ring").positions;
    assert_eq!(at(&whole), at(&killed));
    let nodes = at(&whole).len() as u32;
    let line = whole.get::<LineMesh>("ring");
    assert_eq!((line.segments.len() as u32, line.segments.last()), (nodes, Some(&[nodes - 1, 0])));
    (0..900).for_each(|_| whole.tick());
    let top = at(&whole).iter().map(|at| at.z).fold(f64::NEG_INFINITY, f64::max);
    assert!((top - 0.0155 - 0.004 - 1.5e-4).abs() < 2e-4, "it hangs on the peg: {top} m");
    assert_eq!(whole.measured("ring.pieces"), 1.0);
    assert_eq!(whole.measured("ring.knot"), 0.0, "a ring has no knot");
}

/// A curve that is knotted in itself has its knot without any closure of ends; its mirror image has the other one.
#[test]
fn the_knot_of_a_closed_thread_is_that_of_the_curve() {
    let found = [1.0, -1.0].map(|mirrored| {
        let trefoil: Vec<_> = (0..90)
            .map(|k| {
                let t = TAU * f64::from(k) / 90.0;
                let (x, y) = (t.sin() + 2.0 * (2.0 * t).sin(), t.cos() - 2.0 * (2.0 * t).cos());
                Point3::new(x, y, -mirrored * (3.0 * t).sin()) * 0.01
            })
            .collect();
        let text = format!(
            "[[entity]]\nname = \"ring\"\nmesh = {{ line = {{ length = 0.1, segments = 10, radius = 1.5e-4 }} }}\n\
             thread = {{ closed = true, edges = [10.0, 0.003], laid = {{ through = {{ places = [{}] }} }} }}\n",
            places(&trefoil)
        );
        let free = |context: &BuildContext<'_>| ThreadController::new(Vector3::zeros(), None, context);
        let mut stage = Stage::new(scene(&text), 500.0, free);
        (0..20).for_each(|_| stage.tick());
        stage.get::<KnotState>("ring")
    });
    for knot in &found {
        assert_eq!((knot.code, knot.determinant, knot.signature.abs()), (1.0, 3, 2), "{}", knot.name);
    }
    assert_eq!(found[0].signature, -found[1].signature);
}

/// Its own weight, made heavy, is more than it bears.
#[test]
fn a_closed_thread_that_breaks_goes_on_as_one_open_thread() {
    let breaks = ", breaks_at = { value = 1e-3, source = \"for this test\" }";
    let heavy =
        |context: &BuildContext<'_>| ThreadController::new(Vector3::new(0.0, 0.0, -500.0), None, context);
    let mut stage = Stage::new(scene(&hanging(breaks)), 500.0, heavy);
    let is_open = |stage: &Stage<ThreadController>| {
        let line = stage.get::<LineMesh>("ring");
        line.segments.len() < stage.get::<VertexPositions>("ring").positions.len()
    };
    let breaks_after = (0..500).find(|_| {
        stage.tick();
        is_open(&stage)
    });
    assert!(breaks_after.is_some(), "it carries its weight");
    for _ in 0..2 {
        let line = stage.get::<LineMesh>("ring");
        assert!(line.segments.iter().all(|ends| ends[1] == ends[0] + 1), "{:?}", line.segments);
        assert!(stage.measured("ring.pieces") >= 1.0 && stage.measured("ring.frozen") == 0.0);
        stage.rebuild(heavy);
        (0..5).for_each(|_| stage.tick());
    }
}

#[test]
fn what_no_closed_thread_can_be_is_refused_by_name() {
    let closed = || ThreadBody { closed: true, ..ThreadBody::default() };
    let on = LiesOn { body: "pad".into(), friction: 0.3 };
    let throws = Laid::Throws {
        half_turns: vec![3],
        around: vec![[0.0, 0.0, -0.01]],
        apart: 0.0,
        arm: 0.01,
        ear: 0.01,
    };
    for (thread, says) in [
        (ThreadBody { adaptive: true, ..closed() }, "'adaptive'"),
        (ThreadBody { together_with: vec!["other".into()], ..closed() }, "'together_with'"),
        (ThreadBody { lies_on: Some(on), ..closed() }, "'lies_on'"),
        (ThreadBody { tied_around: Some("pad".into()), ..closed() }, "'tied_around'"),
        (ThreadBody { laid: Some(throws), ..closed() }, "'laid'"),
    ] {
        let told = thread.check().expect_err("refused").to_string();
        assert!(told.contains("'closed'") && told.contains(says), "{told}");
    }
    assert_eq!(closed().check(), Ok(()));
    let few = Thread::closed(wire(1.0), &circle(4)).expect_err("too few").to_string();
    assert!(few.contains("closed thread of 4 nodes") && few.contains("5 to"), "{few}");
    let text = hanging("").replace("name = \"ring\"", "name = \"other\"")
        + "[[entity]]\nname = \"first\"\nmesh = { line = { length = 0.1, segments = 10, radius = 1.5e-4 } }\n\
           thread = { together_with = [\"other\"] }\n";
    let store = scene(&text);
    let told = build(&context(&store, SimTime::ZERO, 1)).err().expect("refused").to_string();
    assert!(told.contains("'other'") && told.contains("is closed"), "{told}");
}
