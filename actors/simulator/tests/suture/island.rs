//! Thread in tissue: it sticks up to the friction limit, slides beyond, pulls a wound together, and action and reaction
//! with the tissue are equal.

use crate::support::suture::*;
use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::tet_mesh::TetMesh;
use trocar_simulator::suture::needle::{NeedleShape, NeedleState};
use trocar_simulator::suture::{
    Bite, ChannelPoint, Event, MaterialPoint, Resistance, StepInputs, Suture, SutureReport, SutureState, Tip,
    Tissue,
};
use trocar_simulator::suture_thread::{CutAt, Load, ThreadMaterial, ThreadState};

const DT: f64 = 1e-3;
/// Young's modulus of tissue that two newtons do not tear \[Pa\]: skin, 0.1 to 1 MPa.
const SKIN: f64 = 5e5;
/// Distance between nodes of the thread \[m\].
const EDGE: f64 = 1e-3;

/// A needle far away, with a thread along a polyline: through `bites` in a tissue, each an interval of arc length
/// \[m\].
fn sewn(line: &[Point3<f64>], bites: &[[f64; 2]], resistance: Resistance, tissue: Tissue) -> Suture {
    let shape = NeedleShape::half_circle_26();
    let solid = shape.solid().expect("a needle");
    // Points of the polyline by arc length from its beginning, the needle's tail.
    let at = |distance: f64| {
        let mut left = distance;
        for pair in line.windows(2) {
            let way = pair[1] - pair[0];
            if left <= way.norm() {
                return pair[0] + way.normalize() * left;
            }
            left -= way.norm();
        }
        let last = line[line.len() - 1];
        last + (last - line[line.len() - 2]).normalize() * left
    };
    let length: f64 = line.windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum();
    let nodes: Vec<_> = (0..=(length / EDGE) as usize).map(|i| at(i as f64 * EDGE)).collect();
    let mut state =
        SutureState::new(NeedleState::at_rest(&Isometry3::identity()), Some(ThreadState::at_rest(&nodes)));
    // The needle's tail at the beginning of the thread, along its tangent.
    let back = (nodes[1] - nodes[0]).normalize();
    let turn = nalgebra::UnitQuaternion::rotation_between(&-solid.tangent(0.0), &back).expect("a turn");
    let place = nodes[0] - turn * solid.point(0.0);
    state.needle = NeedleState::at_rest(&Isometry3::from_parts(place.into(), turn));
    for (number, [from, to]) in bites.iter().enumerate() {
        let number = number as u32;
        let count = ((to - from) / resistance.spacing).round() as usize;
        let places: Vec<(MaterialPoint, f64)> = (0..=count)
            .map(|i| {
                let distance = to - (to - from) * i as f64 / count as f64;
                (tissue.locate(&at(distance)), -distance)
            })
            .collect();
        let surface = |place: &MaterialPoint| tissue.nearest(&tissue.at_rest(place));
        state.channel.extend(places.iter().map(|(place, along)| ChannelPoint {
            place: *place,
            along: *along,
            stuck: *along,
            force: Vector3::zeros(),
            bite: number,
        }));
        state.bites.push(Bite {
            number,
            entry: surface(&places[0].0),
            exit: Some(surface(&places[count].0)),
            entry_force: 0.0,
            exit_force: 0.0,
        });
        state.bites_so_far = number + 1;
    }
    state.channel.sort_by(|a, b| a.along.total_cmp(&b.along));
    let mut suture =
        Suture::new(&shape, Some(ThreadMaterial::silk_2_0()), resistance, tissue, state).expect("a suture");
    suture.swage();
    suture
}

/// Jaws that hold the needle at its position.
fn held(suture: &Suture) -> [trocar_simulator::suture::Grip; 1] {
    let pose = suture.state().needle.pose();
    [jaws(suture.solid().shape(), 0.5 * suture.solid().shape().length(), pose, pose)]
}

/// Straight through a pad, 12 mm of it, and out at either side.
fn through_a_pad(resistance: Resistance) -> Suture {
    let line = [Point3::new(0.030, 0.2e-3, -0.004), Point3::new(-0.035, 0.2e-3, -0.004)];
    sewn(&line, &[[0.024, 0.036]], resistance, tissue(small_pad()))
}

fn small_pad() -> (TetMesh, Vec<u32>) {
    block([0.012, 0.012, 0.010], [6, 6, 5], [-0.006, -0.006, -0.010])
}

fn pull(suture: &mut Suture, force: f64, steps: usize) -> SutureReport {
    let last = suture.state().thread.as_ref().expect("a thread").positions.len() - 1;
    let mut report = SutureReport::default();
    let loads = [Load { node: last, force: Vector3::new(-force, 0.0, 0.0) }];
    // The needle is released: only the tissue holds the thread.
    for step in 0..steps {
        report = suture
            .step(DT, &StepInputs { loads: &loads, ..StepInputs::default() })
            .unwrap_or_else(|why| panic!("step {step}: {why}"));
    }
    report
}

#[test]
fn friction_holds_a_thread_at_rest_and_lets_it_slide_beyond_its_limit() {
    let resistance = Resistance { thread_grip: 30.0, thread_friction: 0.0, ..Resistance::default() };
    let limit = 30.0 * 0.012;
    let mut suture = through_a_pad(resistance);
    // The needle swings on the thread; it is stopped twice, so that it does not jerk.
    for _ in 0..2 {
        pull(&mut suture, 0.8 * limit, 400);
        let mut state = suture.state().clone();
        (state.needle.momentum, state.needle.angular_momentum) = (Vector3::zeros(), Vector3::zeros());
        state.thread.iter_mut().flat_map(|thread| &mut thread.velocities).for_each(|v| *v = Vector3::zeros());
        let (shape, fresh) = (*suture.solid().shape(), tissue(small_pad()));
        suture = Suture::new(&shape, Some(ThreadMaterial::silk_2_0()), resistance, fresh, state)
            .expect("a suture");
    }
    pull(&mut suture, 0.8 * limit, 200);
    // It still swings slightly; that moves the sticking points only by sliding.
    let places = |suture: &Suture| suture.state().channel.iter().map(|point| point.stuck).collect::<Vec<_>>();
    let tail = |suture: &Suture| {
        suture.state().thread.as_ref().expect("a thread").positions.last().expect("nodes").x
    };
    let (before, end) = (places(&suture), tail(&suture));
    let report = pull(&mut suture, 0.8 * limit, 1500);
    let crept = before.iter().zip(places(&suture)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    // A knot may creep by a tenth of a millimetre per minute.
    assert!(crept < 2.5e-6, "creeps by {crept} m");
    let tail_crept = (tail(&suture) - end).abs();
    assert!(tail_crept < 2e-6, "swings by {tail_crept} m");
    assert!((report.drag - 0.8 * limit).abs() < 5e-3 * limit, "{} N", report.drag);
    // A fifth above the friction limit: the thread runs out, a centimetre in four milliseconds, with the grip friction
    // of the remaining channel.
    let report = pull(&mut suture, 1.2 * limit, 4);
    let sliding = 30.0 * report.length_inside;
    assert!((sliding / limit - 1.0).abs() < 0.1, "{sliding} of {limit} N");
    assert!((report.drag - sliding).abs() < 0.01 * sliding, "{} of {sliding} N", report.drag);
    let slid = tail(&suture) - end;
    assert!(slid < -1e-3, "slid by {slid} m");
}

#[test]
fn without_friction_a_thread_is_drawn_through_and_out() {
    let none = Resistance {
        thread_grip: 0.0,
        thread_friction: 0.0,
        needle_grip: 0.0,
        needle_friction: 0.0,
        ..Resistance::default()
    };
    let mut suture = through_a_pad(none);
    let before = suture.state().channel[0].along;
    let report = pull(&mut suture, 0.05, 30);
    assert!(report.drag < 1e-9 && suture.state().channel[0].along - before > 1e-3);
}

/// Runs until the channels are empty, with a force along x on a node of the thread; returns the number of pass-through
/// events.
fn drawn_out(suture: &mut Suture, node: usize, force: f64) -> usize {
    let loads = [Load { node, force: Vector3::new(force, 0.0, 0.0) }];
    let mut through = 0;
    for step in 0..200 {
        suture
            .step(DT, &StepInputs { loads: &loads, ..StepInputs::default() })
            .unwrap_or_else(|why| panic!("step {step}: {why}"));
        through += suture.events().iter().filter(|event| matches!(event, Event::Through { .. })).count();
        if suture.state().channel.is_empty() {
            break;
        }
    }
    through
}

#[test]
fn a_thread_that_is_cut_stays_in_the_tissue_by_friction_and_is_drawn_out_to_either_side() {
    let resistance = Resistance { thread_grip: 30.0, thread_friction: 0.0, ..Resistance::default() };
    let limit = 30.0 * 0.012;
    for to_the_end in [true, false] {
        let mut suture = through_a_pad(resistance);
        let whole = suture.state().clone();
        // Between 24 mm and 36 mm it is in the tissue, where no blade can cut it.
        for edge in [24, 30, 35] {
            assert_eq!(suture.cut_thread(CutAt { edge, share: 0.5 }), Ok(None), "{edge}");
        }
        assert_eq!(suture.state(), &whole);
        let parted = suture.cut_thread(CutAt { edge: 12, share: 0.5 }).expect("sound").expect("a cut");
        let now = |node: usize| parted.nodes[node].expect("there") as usize;
        assert_eq!(suture.state().channel.len(), whole.channel.len());
        let nodes = whole.thread.as_ref().expect("a thread").positions.len();
        // The end beyond the pad, or the cut end.
        let (node, sign) = if to_the_end { (now(nodes - 1), -1.0) } else { (now(13), 1.0) };
        let place = |suture: &Suture| suture.state().thread.as_ref().expect("a thread").positions[node].x;
        let loads = [Load { node, force: Vector3::new(0.8 * limit * sign, 0.0, 0.0) }];
        let mut report = SutureReport::default();
        let mut begin = 0.0;
        for step in 0..600 {
            report = suture.step(DT, &StepInputs { loads: &loads, ..StepInputs::default() }).expect("a step");
            if step == 300 {
                begin = place(&suture);
            }
        }
        // Nothing pulls on it any longer: it stays once the tissue has relaxed.
        assert!((place(&suture) - begin).abs() < 5e-6, "{} m", place(&suture) - begin);
        assert!((report.drag - 0.8 * limit).abs() < 0.01 * limit, "{} N", report.drag);
        assert_eq!(drawn_out(&mut suture, node, 1.2 * limit * sign), 1, "to the end: {to_the_end}");
        assert!(suture.state().channel.is_empty());
        // The needle fell with its piece of the thread, and nothing else.
        let thread = suture.state().thread.as_ref().expect("a thread");
        let pieces: Vec<_> = thread.threads().collect();
        assert_eq!(pieces.len(), 2);
        let stub: f64 = thread.rest_lengths[..pieces[0][1]].iter().sum();
        assert!((stub - 0.0125).abs() < 3e-4, "{stub} m");
        let state = suture.state().clone();
        let again = Suture::new(
            suture.solid().shape(),
            Some(ThreadMaterial::silk_2_0()),
            resistance,
            tissue(small_pad()),
            state.clone(),
        );
        assert_eq!(again.expect("its own state").state(), &state);
    }
}

/// Two wound edges, 6 mm of tissue each and 3 mm apart; the thread enters on top of one and leaves on top of the other,
/// 4 mm deep.
fn wound(resistance: Resistance) -> Suture {
    let blocks = tissue_of(
        blocks(&[
            ([0.010, 0.012, 0.010], [5, 6, 5], [-0.0115, -0.006, -0.010]),
            ([0.010, 0.012, 0.010], [5, 6, 5], [0.0015, -0.006, -0.010]),
        ]),
        SKIN,
    );
    // From the needle, high over the right edge, in, across, out over the left one.
    let line = [
        Point3::new(0.0075, 0.3e-3, 0.025),
        Point3::new(0.0065, 0.3e-3, 0.0),
        Point3::new(0.0035, 0.3e-3, -0.004),
        Point3::new(-0.0035, 0.3e-3, -0.004),
        Point3::new(-0.0065, 0.3e-3, 0.0),
        Point3::new(-0.0075, 0.3e-3, 0.025),
    ];
    let length = |from: usize, to: usize| {
        line[from..=to].windows(2).map(|pair| (pair[1] - pair[0]).norm()).sum::<f64>()
    };
    let (first, bend) = (length(0, 1), length(0, 2));
    let bites = [[first, bend + 0.002], [bend + 0.005, length(0, 4)]];
    sewn(&line, &bites, resistance, blocks)
}

/// Distance between the middles of the two wound edges, at the surface \[m\].
fn gap(suture: &Suture) -> f64 {
    let tissue = suture.tissue();
    let at = |x: f64| {
        let near = |a: &&u32, b: &&u32| {
            let far = |node: u32| (tissue.mesh().rest()[node as usize] - Point3::new(x, 0.0, 0.0)).norm();
            far(**a).total_cmp(&far(**b))
        };
        let node = tissue.mesh().surface_nodes().iter().min_by(near).expect("nodes");
        tissue.positions()[*node as usize].x
    };
    at(0.0015) - at(-0.0015)
}

#[test]
fn a_thread_pulled_with_two_newtons_draws_the_wound_together() {
    let mut suture = wound(Resistance::default());
    let before = gap(&suture);
    assert!((before - 3e-3).abs() < 1e-9);
    let last = suture.state().thread.as_ref().expect("a thread").positions.len() - 1;
    let grips = held(&suture);
    let (mut given, mut taken) = (Vector3::zeros(), Vector3::zeros());
    let (mut exchanged, mut largest, mut earlier) = (0.0, 0.0_f64, 0.0);
    let begin = momentum(&suture);
    let mut weight = Vector3::zeros();
    for step in 0..1600 {
        let force = Vector3::new(-0.1, 0.0, 1.0).normalize() * (2.0 * ((step + 1) as f64 / 300.0).min(1.0));
        let loads = [Load { node: last, force }];
        let around = StepInputs { grips: &grips, loads: &loads, ..StepInputs::default() };
        let report = suture.step(DT, &around).unwrap_or_else(|why| panic!("step {step}: {why}"));
        taken += report.force_on_tissue * DT;
        given += (force + suture.gripped()[0].force) * DT;
        exchanged += report.force_on_tissue.norm() * DT;
        weight += dragged(&suture) * DT;
        largest = largest.max(suture.tissue().displacement_max());
        if step == 1200 {
            earlier = gap(&suture);
        }
    }
    // The impulses of load and jaws went into the tissue, are in thread and needle, or were lost to air drag.
    let left = given - taken - (momentum(&suture) - begin) - weight;
    assert!(left.norm() < 1e-6 * exchanged, "{} of {exchanged} N·s", left.norm());
    // The tissue's own stiffness confirms the same force.
    let inside = suture.tissue().forces().iter().map(|(_, force)| *force).sum::<Vector3<f64>>();
    let channel: Vector3<f64> = suture.state().channel.iter().map(|point| -point.force).sum();
    assert!((inside - channel).norm() < 1e-9 * channel.norm());
    assert!(largest < 5e-3, "{largest} m");
    let after = gap(&suture);
    assert!(after > 0.0 && after < before - 5e-4, "{after} m after {before} m");
    // At rest: points at their friction limit at the end of loading have slipped here and there, and hold by now.
    assert!((after - earlier).abs() < 0.02 * (before - after), "{after} m after {earlier} m");
}

fn momentum(suture: &Suture) -> Vector3<f64> {
    suture.state().needle.momentum + of_thread(suture)
}

fn of_thread(suture: &Suture) -> Vector3<f64> {
    let thread = suture.state().thread.as_ref().expect("a thread");
    (0..thread.positions.len())
        .map(|node| {
            let before = if node > 0 { thread.rest_lengths[node - 1] } else { 0.0 };
            let after = thread.rest_lengths.get(node).copied().unwrap_or(0.0);
            thread.velocities[node] * (0.5 * ThreadMaterial::silk_2_0().mass_per_length * (before + after))
        })
        .sum()
}

/// Air drag on the thread \[N\], which removes momentum.
fn dragged(suture: &Suture) -> Vector3<f64> {
    of_thread(suture) * -ThreadMaterial::silk_2_0().drag
}

#[test]
fn it_goes_on_bit_for_bit_from_its_state() {
    let mut suture = wound(Resistance::default());
    let last = suture.state().thread.as_ref().expect("a thread").positions.len() - 1;
    let grips = held(&suture);
    let loads = [Load { node: last, force: Vector3::new(-0.1, 0.0, 0.8) }];
    let around = StepInputs { grips: &grips, loads: &loads, ..StepInputs::default() };
    for _ in 0..40 {
        suture.step(DT, &around).expect("a step");
    }
    let state = suture.state().clone();
    assert_eq!(state.tip, Tip::Free);
    let fresh = wound(Resistance::default());
    let (mesh, shape) = (fresh.tissue().mesh().clone(), *fresh.solid().shape());
    let fixed = (0..mesh.rest().len() as u32).filter(|n| mesh.rest()[*n as usize].z < -0.01 + 1e-9).collect();
    let material = Some(ThreadMaterial::silk_2_0());
    let mut other =
        Suture::new(&shape, material, Resistance::default(), tissue_of((mesh, fixed), SKIN), state)
            .expect("a suture");
    for _ in 0..40 {
        suture.step(DT, &around).expect("a step");
        other.step(DT, &around).expect("a step");
    }
    assert_eq!(suture.state(), other.state());
}

#[test]
fn what_makes_no_sense_is_refused_and_changes_nothing() {
    let mut suture = through_a_pad(Resistance::default());
    let before = suture.state().clone();
    for force in [f64::NAN, f64::INFINITY] {
        let loads = [Load { node: 1, force: Vector3::new(force, 0.0, 0.0) }];
        assert!(suture.step(DT, &StepInputs { loads: &loads, ..StepInputs::default() }).is_err());
    }
    assert!(
        suture.step(0.0, &StepInputs::default()).is_err()
            && suture.step(0.1, &StepInputs::default()).is_err()
    );
    let loads = [Load { node: 5000, force: Vector3::zeros() }];
    assert!(suture.step(DT, &StepInputs { loads: &loads, ..StepInputs::default() }).is_err());
    // Too stiff for any step to converge: the state is unchanged.
    let loads = [Load { node: 60, force: Vector3::new(0.0, 0.0, 1e9) }];
    assert!(suture.step(DT, &StepInputs { loads: &loads, ..StepInputs::default() }).is_err());
    assert_eq!(*suture.state(), before);
    suture.step(DT, &StepInputs::default()).expect("it goes on");
}
