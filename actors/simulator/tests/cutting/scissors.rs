//! Scissors on a scene: closing blades cut what is between them, for every method; nothing beside them, and nothing
//! while they open or stay open.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, Point3, UnitQuaternion, Vector3};
use trocar_scene::{
    BuildContext, Controller, ControllerError, Frozen, JawState, Pose, RestPositions, VertexPositions,
    VertexVelocities,
};
use trocar_simulator::controller::{
    DynamicFemController, MassSpringController, SpringFactor, XpbdController,
};

const NO_GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, 0.0);
const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);
const OPEN: f64 = 0.6;

fn springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(NO_GRAVITY, context)
}

fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(NO_GRAVITY, context)
}

fn tool(jaw_length: f64) -> String {
    format!(
        "[[entity]]\nname = \"tool\"\npose = {{ translation = [0.3, 0.0, 0.0] }}\n\
         instrument = {{ kind = \"scissors\", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = {jaw_length}, \
         jaws = 2 }}\n"
    )
}

const MEMBRANE: &str = "sheet = { size = [0.04, 0.04], cells = [16, 16] }";
const LINE: &str = "line = { length = 0.04, segments = 16, radius = 0.0003 }";

/// A membrane or a line of 4 cm, held at its ends and stretched by a twentieth.
fn taut<C: Controller>(
    mesh: &str,
    body: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) -> Stage<C> {
    let text = format!(
        "{}[[entity]]\nname = \"body\"\nmesh = {{ {mesh} }}\n{body}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [-0.0199, 1.0, 1.0] }} }},\n\
         {{ box = {{ min = [0.0199, -1.0, -1.0], max = [1.0, 1.0, 1.0] }} }}] }}\n",
        tool(0.018)
    );
    let mut stage = Stage::new(scene(&text), 500.0, build);
    let rest = stage.get::<VertexPositions>("body").positions;
    let drawn = rest.iter().map(|p| Point3::new(1.05 * p.x, p.y, p.z)).collect();
    stage.put("body", RestPositions { positions: rest });
    stage.put("body", VertexPositions { positions: Arc::new(drawn) });
    stage.rebuild(build);
    stage
}

/// Along y, one blade above the membrane and one below; where the tip is.
fn place<C: Controller>(stage: &mut Stage<C>, at: [f64; 3], angle: f64) {
    let turned = UnitQuaternion::from_basis_unchecked(&[Vector3::z(), Vector3::x(), Vector3::y()]);
    stage.put("tool", Pose::from(Isometry3::from_parts(Vector3::from(at).into(), turned)));
    stage.put("tool", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
}

fn run<C: Controller>(stage: &mut Stage<C>, ticks: u32) {
    (0..ticks).for_each(|_| stage.tick());
    assert!(!stage.has::<Frozen>("body"), "{}", stage.get::<Frozen>("body").reason);
}

/// From one opening to another within 20 ticks, where the blades are.
fn turn<C: Controller>(stage: &mut Stage<C>, at: [f64; 3], from: f64, to: f64) {
    for tick in 0..=20_u32 {
        place(stage, at, from + (to - from) * f64::from(tick) / 20.0);
        run(stage, 1);
    }
}

/// Largest opening of the lips: distance of vertices that coincide at rest.
fn gapes<C: Controller>(stage: &Stage<C>) -> f64 {
    let (rest, now) =
        (stage.get::<RestPositions>("body").positions, stage.get::<VertexPositions>("body").positions);
    let mut most: f64 = 0.0;
    for (one, place) in rest.iter().enumerate() {
        for (two, other) in rest.iter().enumerate().skip(one + 1) {
            if (place - other).norm() < 1e-12 {
                most = most.max((now[one] - now[two]).norm());
            }
        }
    }
    most
}

fn cuts_a_membrane<C: Controller>(
    body: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    // From beyond the rim: 16 mm of the blades are over the membrane.
    let at = [0.0011, -0.004, 0.0];
    let one_bite = |at: [f64; 3], from: f64, to: f64, kill: bool| {
        let mut stage = taut(MEMBRANE, body, build);
        place(&mut stage, at, from);
        run(&mut stage, 5);
        for tick in 0..=20_u32 {
            place(&mut stage, at, from + (to - from) * f64::from(tick) / 20.0);
            if kill && (tick == 9 || tick == 17) {
                stage.rebuild(build);
            }
            run(&mut stage, 1);
        }
        run(&mut stage, 200);
        stage
    };
    for height in [0.0, 0.0017, -0.0012] {
        let stage = one_bite([at[0], at[1], height], OPEN, 0.0, false);
        let (length, gap) = (stage.measured("body.cut_length_m"), gapes(&stage));
        // Nearer to the hinge than the open blade: not between the blades.
        let wanted = 0.018 - f64::max(0.002, f64::abs(height) / f64::sin((OPEN - 0.12) / 2.0));
        assert!((length - wanted).abs() < 0.0026, "{body} {height}: {length} m of {wanted} m");
        assert!(gap > 5e-4, "{body} {height}: its lips are {gap} m apart");
        assert_eq!(stage.measured("body.pieces"), 1.0);
    }
    let end = |stage: &Stage<C>| {
        (stage.get::<VertexPositions>("body").positions, stage.get::<VertexVelocities>("body").velocities)
    };
    let whole = end(&one_bite(at, OPEN, 0.0, false));
    assert_eq!(end(&one_bite(at, OPEN, 0.0, true)), whole, "another life goes on to the bit");
    // The controls: above the membrane, beyond its rim, blades that open around it, and blades that stay open.
    for (at, from, to) in [
        ([0.0011, -0.004, 0.012], OPEN, 0.0),
        ([0.0011, -0.0215, 0.0], OPEN, 0.0),
        (at, 0.0, OPEN),
        (at, 0.14, 0.14),
    ] {
        let stage = one_bite(at, from, to, false);
        assert_eq!(stage.measured("body.cut_length_m"), 0.0, "{body} {at:?} from {from} to {to}");
    }
    // Bite after bite, moving forwards in between, all the way through.
    let mut stage = taut(MEMBRANE, body, build);
    let mut tip = -0.01;
    let mut cut = 0.0;
    for bite in 0..5 {
        turn(&mut stage, [0.0011, tip, 0.0], OPEN, 0.0);
        let now = stage.measured("body.cut_length_m");
        assert!(bite == 4 || now > cut + 0.003, "bite {bite} at {tip} m: from {cut} to {now} m");
        cut = now;
        turn(&mut stage, [0.0011, tip, 0.0], 0.0, OPEN);
        for step in 0..=20_u32 {
            place(&mut stage, [0.0011, tip + 0.0005 * f64::from(step), 0.0], OPEN);
            run(&mut stage, 1);
        }
        assert_eq!(stage.measured("body.cut_length_m"), cut, "nothing is cut on the way forwards");
        tip += 0.01;
    }
    assert_eq!(stage.measured("body.pieces"), 2.0);
    assert!((0.036..0.048).contains(&cut), "{body}: {cut} m");
}

const CLOTH: &str = "membrane_stiffness = 60.0, bending_stiffness = 1e-6, density = 1.0";

#[test]
fn blades_that_close_cut_the_taut_membrane_between_them_by_springs() {
    cuts_a_membrane(
        &format!("mass_spring = {{ springs = {{ surface = {{ {CLOTH} }} }}, damping = 20.0 }}"),
        springs,
    );
}

/// In steps of 2 ms, whether or not the scenario says so.
const WARPED: &str = "mass_spring = { springs = { surface = { membrane_stiffness = 60.0, bending_stiffness = 1e-6, \
                      density = 1.0 } }, damping = 20.0, method = \"implicit\" }";

/// A bite at 0.06 s, another at the given tick, 2.2 s in all; restarts the controller in the given ticks.
fn bitten(body: &str, again: u32, lives: &[u32], mut watch: impl FnMut(u32, &Stage<MassSpringController>)) {
    let mut stage = taut(MEMBRANE, body, springs);
    for tick in 0..1_100_u32 {
        let (bite, tip) = if tick < again { (30, -0.014) } else { (again, -0.004) };
        let closed = f64::from(tick.saturating_sub(bite).min(20)) / 20.0;
        place(&mut stage, [0.0011, tip, 0.0], OPEN * (1.0 - closed));
        if lives.contains(&tick) {
            stage.rebuild(springs);
        }
        run(&mut stage, 1);
        watch(tick, &stage);
    }
}

#[test]
fn a_membrane_that_is_cut_gets_its_factor_back_beside_the_ticks_and_goes_on_to_the_bit() {
    // The second bite comes while the factor after the first one is being computed: that one is discarded.
    let (bite, again) = (30, 30 + 20 + 170);
    let mut known = Vec::new();
    let mut iterations = Vec::new();
    let mut ends = [&[][..], &[45, 120, 205, 215, 300, 395, 430, 700]].map(|lives| {
        let mut end = None;
        bitten(WARPED, again, lives, |tick, stage| {
            if lives.is_empty() {
                known.push(stage.has::<SpringFactor>("body").then(|| stage.get::<SpringFactor>("body")));
                iterations.push(stage.measured("body.iterations"));
            }
            if tick == 1_099 {
                end = Some((
                    stage.get::<VertexPositions>("body").positions,
                    stage.get::<VertexVelocities>("body").velocities,
                ));
            }
        });
        end.expect("it ends")
    });
    let lacks = |tick: u32| known[tick as usize].is_some_and(|known| known.parted_at.is_some());
    let asked = |tick: u32| known[tick as usize].is_some_and(|known| known.wanted.is_some());
    assert!(!lacks(bite) && lacks(bite + 20) && !asked(bite + 20), "it is cut, and waits");
    assert!(asked(again - 1), "it has been whole for a while: a job makes a factor");
    assert!(lacks(again + 21) && !asked(again + 21), "cut again");
    let back = (again..1_100).find(|tick| !lacks(*tick)).expect("it gets one back");
    assert!((again + 150..again + 300).contains(&back), "in tick {back}");
    assert_eq!(known[1_099].map(|known| known.jobs), Some(2));
    // With the factor a step takes fewer iterations than without, as before the cut.
    let mean = |ticks: std::ops::Range<u32>| {
        ticks.clone().map(|tick| iterations[tick as usize]).sum::<f64>() / ticks.len() as f64
    };
    let (before, without, after) = (mean(5..30), mean(back - 100..back), mean(back + 1..back + 100));
    assert!(
        without > 3.0 * after && without > 3.0 * before,
        "{before} before, {without} without, {after} after"
    );
    let [whole, killed] = &mut ends;
    assert!(whole == killed, "other lives go on to the bit");
    // The result does not depend on the solver: the same with block Jacobi.
    let blocks = WARPED.replace("\"implicit\"", "\"implicit\", solver = \"node_blocks\"");
    let mut far = f64::INFINITY;
    bitten(&blocks, again, &[], |tick, stage| {
        if tick == 1_099 {
            assert!(!stage.has::<SpringFactor>("body"));
            let positions = stage.get::<VertexPositions>("body").positions;
            far = positions.iter().zip(whole.0.iter()).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
        }
    });
    assert!(far < 2e-5, "{far} m from where it would be");
}

#[test]
fn blades_that_close_cut_the_taut_membrane_between_them_by_positions() {
    cuts_a_membrane(
        &format!("xpbd = {{ matter = {{ cloth = {{ {CLOTH} }} }}, damping = 20.0, parts = 8, cut = true }}"),
        xpbd,
    );
}

/// A hanging column of 2 cm by 2 cm by 6 cm, and blades of 10 cm around its middle.
fn cuts_a_column<C: Controller>(
    body: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let text = format!(
        "{}[[entity]]\nname = \"body\"\nmesh = {{ block = {{ size = [0.02, 0.02, 0.06], cells = [3, 3, 9] }} }}\n{body}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, 0.0299], max = [1.0, 1.0, 1.0] }} }}] }}\n",
        tool(0.1)
    );
    let lowest = |stage: &Stage<C>| {
        stage.get::<VertexPositions>("body").positions.iter().map(|p| p.z).fold(f64::INFINITY, f64::min)
    };
    let bite = |from: f64, to: f64, kill: bool| {
        let mut stage = Stage::new(scene(&text), 200.0, build);
        // They point along y and open along x.
        let turned = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        let place = Isometry3::from_parts(Vector3::new(0.0, 0.05, -0.0041).into(), turned);
        stage.put("tool", Pose::from(place));
        stage.put("tool", JawState { angle: from, rate: 0.0, pad_force: [0.0; 2] });
        run(&mut stage, 300);
        for tick in 0..=40_u32 {
            let angle = from + (to - from) * f64::from(tick) / 40.0;
            stage.put("tool", JawState { angle, rate: 0.0, pad_force: [0.0; 2] });
            if kill && tick == 23 {
                stage.rebuild(build);
            }
            run(&mut stage, 1);
        }
        run(&mut stage, 30);
        stage
    };
    let stage = bite(0.9, 0.0, false);
    assert_eq!(stage.measured("body.pieces"), 2.0, "{body}");
    assert!(lowest(&stage) < -0.06, "{body}: down to {} m", lowest(&stage));
    let end = |stage: &Stage<C>| stage.get::<VertexPositions>("body").positions;
    assert_eq!(end(&bite(0.9, 0.0, true)), end(&stage), "another life goes on to the bit");
    // Half closed, the blades are at its sides; and blades that open about it.
    for (from, to) in [(0.9, 0.45), (0.0, 0.9)] {
        let stage = bite(from, to, false);
        assert_eq!(stage.measured("body.pieces"), 1.0, "{body} from {from} to {to}");
        assert!(lowest(&stage) > -0.04, "{body} from {from} to {to}: down to {} m", lowest(&stage));
    }
}

#[test]
fn blades_that_close_cut_the_column_between_them_whichever_method_moves_it() {
    let springs = "mass_spring = { springs = { volume = { young_modulus = 2e4, density = 1000.0 } }, \
                   method = \"implicit\", damping = 5.0 }";
    let build = |context: &BuildContext<'_>| MassSpringController::new(GRAVITY, context);
    cuts_a_column(springs, build);
    cuts_a_column(&springs.replace("implicit", "explicit"), build);
    cuts_a_column(
        "xpbd = { matter = { volume = { young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0 } }, \
         parts = 30, damping = 5.0, cut = true }",
        |context: &BuildContext<'_>| XpbdController::new(GRAVITY, context),
    );
    cuts_a_column(
        "dynamic_fem = { young_modulus = 2e4, poisson_ratio = 0.3, density = 1000.0, mass_damping = 5.0, \
         cut = true }",
        |context: &BuildContext<'_>| DynamicFemController::new(GRAVITY, context),
    );
}

fn cuts_a_line<C: Controller>(
    body: &str,
    is_explicit: bool,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    // The line passes between the blades a centimetre before the hinge, not at a node.
    let at = [0.0032, 0.01, 0.0];
    let cut = |kill: Option<u32>| {
        let mut stage = taut(LINE, body, build);
        run(&mut stage, 5);
        let safe = is_explicit.then(|| stage.measured("body.safe_step_s"));
        assert_eq!(stage.measured("body.pieces"), 1.0);
        // Open blades, and blades that close beside it, cut nothing.
        (0..10).for_each(|_| {
            place(&mut stage, at, OPEN);
            run(&mut stage, 1);
        });
        turn(&mut stage, [0.0032, 0.1, 0.0], OPEN, 0.0);
        turn(&mut stage, [0.0032, 0.1, 0.0], 0.0, OPEN);
        assert_eq!(stage.measured("body.pieces"), 1.0);
        (0..10).for_each(|_| {
            place(&mut stage, at, OPEN);
            run(&mut stage, 1);
        });
        for tick in 0..=20_u32 {
            if kill == Some(tick) {
                stage.rebuild(build);
            }
            place(&mut stage, at, OPEN * (1.0 - f64::from(tick) / 20.0));
            run(&mut stage, 1);
        }
        run(&mut stage, 200);
        assert_eq!(stage.measured("body.pieces"), 2.0, "{body}");
        if let Some(safe) = safe {
            let now = stage.measured("body.safe_step_s");
            assert!(now > 0.99 * safe, "the largest safe step has become {now} s from {safe} s");
        }
        // Two nodes where there was one, half a segment from the blades at most, and each half as long as at rest.
        let rest = stage.get::<RestPositions>("body").positions;
        assert_eq!(rest.len(), 18);
        assert!((rest[17].x - 0.0032 / 1.05).abs() <= 0.5 * 0.04 / 16.0, "{}", rest[17].x);
        let gap = gapes(&stage);
        assert!((0.0015..0.0025).contains(&gap), "{body}: a gap of {gap} m of 2 mm");
        stage.get::<VertexPositions>("body").positions
    };
    let whole = cut(None);
    assert_eq!(cut(Some(12)), whole, "{body}: another life");
}

#[test]
fn blades_that_close_cut_a_taut_line_which_draws_back_and_goes_on_to_the_bit() {
    let springs_of =
        "springs = { line = { axial_stiffness = 5.0, bending_stiffness = 1e-10, density = 2e-3 } }";
    for method in ["explicit", "implicit"] {
        let body =
            format!("mass_spring = {{ {springs_of}, method = \"{method}\", lag = 1e-5, damping = 20.0 }}");
        cuts_a_line(&body, method == "explicit", springs);
    }
    let rod = "xpbd = { matter = { rod = { axial_stiffness = 5.0, bending_stiffness = 1e-10, density = 2e-3 } }, \
               parts = 20, damping = 20.0, cut = true }";
    cuts_a_line(rod, false, xpbd);
}

/// A line stretched by a twentieth tears at a limit below that, and not at one above it.
fn tears_a_line<C: Controller>(
    body: impl Fn(f64) -> String,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let mut whole = taut(LINE, &body(1.06), build);
    run(&mut whole, 100);
    assert_eq!(whole.measured("body.pieces"), 1.0);
    let mut torn = taut(LINE, &body(1.04), build);
    run(&mut torn, 100);
    assert_eq!(torn.measured("body.pieces"), 2.0);
    let gap = gapes(&torn);
    assert!((0.0015..0.0025).contains(&gap), "a gap of {gap} m of 2 mm");
}

#[test]
fn a_rod_of_positions_tears_where_it_is_drawn_too_far_and_not_before() {
    // In parts so small that sweeps leave no edge longer than the others.
    let body = |tears_at: f64| {
        format!(
            "xpbd = {{ matter = {{ rod = {{ axial_stiffness = 5.0, bending_stiffness = 1e-10, density = 2e-3 }} }}, \
             parts = 100, damping = 20.0, tears_at = {tears_at} }}"
        )
    };
    tears_a_line(body, xpbd);
}

#[test]
fn a_line_of_springs_tears_where_it_is_drawn_too_far_and_not_before() {
    // Damped, so that the recoil does not swing back as far.
    for method in ["explicit", "implicit"] {
        let body = |tears_at: f64| {
            format!(
                "mass_spring = {{ springs = {{ line = {{ axial_stiffness = 5.0, bending_stiffness = 1e-10, density = 2e-3 }} }}, \
                 method = \"{method}\", lag = 1e-5, damping = 2000.0, tears_at = {tears_at} }}"
            )
        };
        tears_a_line(body, springs);
    }
}
