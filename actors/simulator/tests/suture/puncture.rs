//! Puncture of a held membrane by a rod: it tears around the tip where stretched too far, and the rod goes on through
//! the hole; a blunt rod, or one that moves less, only dents it.

use crate::support::stage::{Stage, scene};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};
use trocar_scene::{BuildContext, Controller, ControllerError, Frozen, Pose, Velocity};
use trocar_simulator::controller::{MassSpringController, XpbdController};

const SPEED: f64 = 0.05;
const HZ: f64 = 1000.0;
const MATTER: &str = "membrane_stiffness = 100.0, bending_stiffness = 1e-6, density = 0.3";

/// A membrane of 4 cm held at its rim, and a rod upright over its middle.
fn text(body: &str, radius: f64) -> String {
    let rim = |axis: &str, sign: f64| {
        let (mut min, mut max) = ([-1.0; 2], [1.0; 2]);
        let axis = usize::from(axis == "y");
        if sign > 0.0 {
            min[axis] = 0.0199
        } else {
            max[axis] = -0.0199
        }
        format!(
            "{{ box = {{ min = [{:?}, {:?}, -1.0], max = [{:?}, {:?}, 1.0] }} }}",
            min[0], min[1], max[0], max[1]
        )
    };
    let regions: Vec<String> = [("x", 1.0), ("x", -1.0), ("y", 1.0), ("y", -1.0)]
        .iter()
        .map(|(axis, sign)| rim(axis, *sign))
        .collect();
    format!(
        "[[entity]]\nname = \"probe\"\npose = {{ translation = [0.0, 0.0, 0.01] }}\n\
         instrument = {{ kind = \"probe\", shaft_length = 0.2, shaft_radius = {radius}, jaw_length = 0.004, jaws = 0 }}\n\
         [[entity]]\nname = \"sheet\"\nmesh = {{ sheet = {{ size = [0.04, 0.04], cells = [24, 24] }} }}\n{body}\n\
         anchors = {{ regions = [{}] }}\n",
        regions.join(", ")
    )
}

/// Depth of the tip below the membrane and the force on it, tick by tick, as the tip moves down to `depth` and stays.
fn pressed<C: Controller>(
    body: &str,
    radius: f64,
    depth: f64,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) -> (Stage<C>, Vec<[f64; 2]>) {
    let mut stage = Stage::new(scene(&text(body, radius)), HZ, build);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
    let mut curve = Vec::new();
    let begin = radius + 5e-4;
    let ticks = ((depth + begin) / SPEED * HZ) as u32;
    for tick in 0..ticks + 100 {
        let z = begin - SPEED / HZ * f64::from(tick.min(ticks));
        stage.put("probe", Pose::from(Isometry3::from_parts(Vector3::new(2e-4, 1e-4, z).into(), turn)));
        let down = if tick < ticks { -SPEED } else { 0.0 };
        stage.put("probe", Velocity { linear: Vector3::new(0.0, 0.0, down), angular: Vector3::zeros() });
        stage.tick();
        assert!(!stage.has::<Frozen>("sheet"), "{}", stage.get::<Frozen>("sheet").reason);
        curve.push([-z, stage.measured("sheet.contact_force_n")]);
    }
    (stage, curve)
}

const THIN: f64 = 0.8e-3;
/// Half the thickness of the membrane \[m\], and the stiffness of its contacts \[N/m\].
const THICKNESS: f64 = 5e-4;
const STIFFNESS: f64 = 200.0;
const SKIN: &str = "thickness = 0.0005, contact_stiffness = 200.0";
const BLUNT: f64 = 4e-3;
/// Depth that the rods go to \[m\].
const DEEP: f64 = 0.014;

/// Force at a depth: the mean over half a millimetre.
fn at(curve: &[[f64; 2]], depth: f64) -> f64 {
    let near: Vec<f64> = curve.iter().filter(|of| (of[0] - depth).abs() < 2.5e-4).map(|of| of[1]).collect();
    near.iter().sum::<f64>() / near.len() as f64
}

fn is_punctured<C: Controller>(
    kind: impl Fn(&str) -> String,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    // Without a tearing limit, a thin rod stretches the membrane as far as it moves, and never passes through.
    let (whole, curve) = pressed(&kind(""), THIN, DEEP, build);
    assert_eq!(whole.measured("sheet.cut_length_m"), 0.0);
    // The membrane stays ahead of the tip by at least both thicknesses minus the penetration.
    let lowest = whole.measured("sheet.lowest_m");
    let gives = whole.measured("sheet.contact_force_n") / STIFFNESS;
    let most = THIN + THICKNESS - DEEP + gives + 1e-5;
    assert!(lowest < most, "the membrane is at {lowest} m, above {most} m");
    // The force comes from stretch, quadratic in depth, times its slope: almost cubic.
    let grows = at(&curve, 0.010) / at(&curve, 0.005);
    assert!((4.0..10.0).contains(&grows), "twice as deep, {grows} times the force");

    let weak = kind(", tears_at = 1.4");
    let (torn, curve) = pressed(&weak, THIN, DEEP, build);
    let most = curve.iter().map(|of| of[1]).fold(0.0, f64::max);
    let end = curve[curve.len() - 50..].iter().map(|of| of[1]).sum::<f64>() / 50.0;
    assert!(torn.measured("sheet.cut_length_m") > 2.0 * THIN, "a hole for it");
    assert!(most > 0.01 && end < 0.3 * most, "{end} N after {most} N");
    // The hole is around the tip: the membrane is still one piece, connected all around.
    let blunt = pressed(&weak, BLUNT, 0.008, build).0;
    assert_eq!(blunt.measured("sheet.cut_length_m"), 0.0, "the blunt one only dents it");
}

/// Relative change of the force from tick to tick, where there is contact.
fn trembles(curve: &[[f64; 2]], from: f64) -> f64 {
    let felt: Vec<f64> = curve.iter().filter(|of| of[0] > from).map(|of| of[1]).collect();
    let changes = felt.windows(2).map(|pair| (pair[1] - pair[0]).abs() / pair[0].max(pair[1]).max(1e-12));
    let mut changes: Vec<f64> = changes.collect();
    changes.sort_by(f64::total_cmp);
    changes[changes.len() * 95 / 100]
}

#[test]
fn a_thin_rod_punctures_a_membrane_of_springs_and_its_force_does_not_tremble_before() {
    let kind = |tears: &str| {
        format!(
            "mass_spring = {{ springs = {{ surface = {{ {MATTER} }} }}, method = \"implicit\", damping = 10.0, {SKIN}{tears} }}"
        )
    };
    let build = |context: &BuildContext<'_>| MassSpringController::new(Vector3::zeros(), context);
    is_punctured(kind, build);
    // Contact with a light membrane used to alternate from tick to tick: a hand felt all of it or nothing.
    for radius in [THIN, BLUNT] {
        let (_, curve) = pressed(&kind(""), radius, 0.010, build);
        let most = trembles(&curve, 0.003);
        assert!(most < 0.1, "radius {radius}: it changes by {most} of itself from tick to tick");
    }
}

#[test]
fn a_thin_rod_punctures_a_membrane_of_positions() {
    let kind = |tears: &str| {
        format!(
            "xpbd = {{ matter = {{ cloth = {{ {MATTER} }} }}, cut = true, damping = 10.0, {SKIN}{tears} }}"
        )
    };
    is_punctured(kind, |context: &BuildContext<'_>| XpbdController::new(Vector3::zeros(), context));
}

#[test]
fn a_rod_that_goes_far_in_a_tick_takes_the_membrane_along_and_does_not_pass_it() {
    // Through the membrane at 60 Hz: in each tick five times its thickness.
    const RADIUS: f64 = 1e-3;
    const FAST: f64 = 0.6;
    let body = format!(
        "mass_spring = {{ springs = {{ surface = {{ {MATTER} }} }}, method = \"implicit\", damping = 10.0, \
         contact_stiffness = 1000.0 }}"
    );
    let build = |context: &BuildContext<'_>| MassSpringController::new(Vector3::zeros(), context);
    // A detector does not know its velocity, so that it passes the membrane before they meet.
    for (told, lowest) in [(true, -0.011), (false, -0.001)] {
        let mut stage = Stage::new(scene(&text(&body, RADIUS)), 60.0, build);
        let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
        let way = FAST / 60.0;
        for tick in 0..4_u32 {
            // Its last tick stops it 13 mm below.
            let z = 0.017 - way * f64::from(tick.min(3));
            stage.put("probe", Pose::from(Isometry3::from_parts(Vector3::new(0.0, 0.06, z).into(), turn)));
            let down = if told && tick < 3 { -FAST } else { 0.0 };
            stage.put("probe", Velocity { linear: Vector3::new(0.0, 0.0, down), angular: Vector3::zeros() });
            stage.tick();
        }
        (0..20).for_each(|_| stage.tick());
        assert!(!stage.has::<Frozen>("sheet"));
        let found = stage.measured("sheet.lowest_m");
        assert!(if told { found < lowest } else { found > lowest }, "told {told}: {found} m");
    }
}
