//! Soft bodies bear rigid ones, by every method and at every rate that a scenario may declare; what is too heavy is told
//! before the start.

use trocar::app::SCENARIOS;
use trocar::run::run;
use trocar::session::forecast;
use trocar_scene::scenario::Scenario;
use trocar_test_support::thorough;
use trocar_tests::{app, finish, lockstep};

/// The methods of soft volumes: controller and component, by Young's modulus \[Pa\] and density \[kg/m³\]; whether gravity
/// acts on it, its Poisson's ratio, and the tolerated deviation from finite elements.
const METHODS: [Method; 5] = [
    Method {
        kind: "dynamic-fem",
        component: "dynamic_fem = { young_modulus = $E, poisson_ratio = $NU, density = $D }",
        weighs: true,
        nu: 0.4,
        within: 0.1,
        young_min: 0.0,
    },
    Method {
        kind: "linear-fem",
        component: "linear_fem = { young_modulus = $E, poisson_ratio = $NU }",
        weighs: false,
        nu: 0.4,
        within: 0.1,
        young_min: 0.0,
    },
    Method {
        kind: "xpbd",
        component: "xpbd = { matter = { volume = { young_modulus = $E, poisson_ratio = $NU, density = $D } } }",
        weighs: true,
        nu: 0.4,
        within: 0.25,
        young_min: 0.0,
    },
    Method {
        kind: "rapier-soft",
        component: "engine_soft = { young_modulus = $E, poisson_ratio = $NU, density = $D }",
        weighs: true,
        nu: 0.4,
        within: 0.25,
        young_min: 0.0,
    },
    Method {
        kind: "mass-spring",
        component: "mass_spring = { method = \"explicit\", thickness = 0.0, springs = { volume = { young_modulus = $E, density = $D } } }",
        weighs: true,
        nu: 0.25,
        within: 0.25,
        young_min: 1e5,
    },
];

#[derive(Clone, Copy, Debug)]
struct Method {
    kind: &'static str,
    component: &'static str,
    weighs: bool,
    nu: f64,
    within: f64,
    /// Lowest Young's modulus at which it does so \[Pa\].
    young_min: f64,
}

/// A block of 60 × 60 × 40 mm that is held below, and a brick of 24 × 24 × 20 mm 1 mm above it.
fn brick_above_block(method: &Method, young: f64, mass: f64, [soft_hz, rigid_hz]: [f64; 2]) -> String {
    let density = if method.weighs { 1000.0 } else { 1.0 };
    let component =
        method.component.replace("$E", &format!("{young:?}")).replace("$NU", &method.nu.to_string());
    let component = component.replace("$D", &format!("{density:?}"));
    format!(
        r#"schema = 1
name = "brick"
title = "A brick on a block"
description = "A brick on a block"
gravity = [0.0, 0.0, -9.81]
[[entity]]
name = "block"
pose = {{ translation = [0.0, 0.0, 0.02] }}
mesh = {{ block = {{ size = [0.06, 0.06, 0.04], cells = [6, 6, 4] }} }}
{component}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0199] }} }}] }}
[[entity]]
name = "brick"
pose = {{ translation = [0.0, 0.0, 0.051] }}
mesh = {{ shape = {{ box = {{ half_extents = [0.012, 0.012, 0.01] }} }} }}
rigid_body = {{ motion = "dynamic", mass = {mass:?}, friction = 0.5 }}
[task]
seconds = 2.0
expect = [
    {{ measure = "brick.z_m", min = -1.0, max = 1.0 }},
    {{ measure = "brick.x_m", min = -1.0, max = 1.0 }},
    {{ measure = "brick.y_m", min = -1.0, max = 1.0 }},
]
[[controller]]
name = "block"
kind = "{}"
rate_hz = {soft_hz:?}
[[controller]]
name = "engine"
kind = "rapier"
rate_hz = {rigid_hz:?}
[[controller]]
name = "judge"
kind = "outcome"
rate_hz = 100
"#,
        method.kind
    )
}

/// How deep the brick lies, and how far aside \[m\], with the number of warnings; `None` where explicit springs refuse the
/// step.
fn rest(method: &Method, young: f64, mass: f64, rates: [f64; 2]) -> Option<(f64, f64, usize)> {
    let app = app();
    let text = brick_above_block(method, young, mass, rates);
    let scenario = Scenario::parse("brick.toml".as_ref(), &text, app.registry()).expect("valid");
    let run = match run(&app, &scenario, &lockstep(1), &mut |_| {}) {
        Ok(run) => run,
        Err(error) => {
            assert!(method.component.contains("explicit"), "{error}");
            return None;
        }
    };
    let values = &run.summary.task.metrics["outcome"];
    let aside = values["brick.x_m"].hypot(values["brick.y_m"]);
    Some((0.05 - values["brick.z_m"], aside, run.summary.warnings.len()))
}

/// How much a body may swing about its rest where the ticks of both controllers do not fit each other \[m\].
const SWING: f64 = 6e-5;

/// How far a brick may creep aside in two seconds \[m\].
const ASIDE: f64 = 6e-3;

#[test]
fn a_brick_rests_as_deep_by_every_method_at_every_rate() {
    let cells: &[(f64, f64)] = if thorough() {
        &[(8e3, 0.02), (3e4, 0.1), (1e5, 0.1), (1e5, 0.3), (1e6, 5.0)]
    } else {
        &[(1e5, 0.1)]
    };
    let rates: &[f64] = if thorough() { &[10.0, 25.0, 60.0, 150.0, 300.0, 1000.0] } else { &[20.0, 150.0] };
    let mut wrong = Vec::new();
    for &(young, mass) in cells {
        for method in METHODS.iter().filter(|method| young >= method.young_min) {
            // The same mesh by finite elements, in short steps.
            let by = Method { component: METHODS[0].component, kind: METHODS[0].kind, ..*method };
            let (known, ..) = rest(&by, young, mass, [1000.0, 1000.0]).expect("finite elements");
            for &rate in rates {
                let Some((depth, aside, told)) = rest(method, young, mass, [rate, 500.0]) else { continue };
                let case = format!("{}, {young} Pa, {mass} kg, {rate} Hz", method.component);
                let rests = (depth - known).abs() < method.within * known + SWING && aside < ASIDE;
                if told > 1 || (told == 0 && !rests) {
                    wrong.push(format!(
                        "{case}: {depth} m, known {known} m, {aside} m aside, {told} warnings"
                    ));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// A ball with a radius of 12 mm above a block that is 40 mm thick.
fn ball_above_block(material: &str, mass: f64) -> String {
    format!(
        r#"schema = 1
name = "ball"
title = "A ball on a block"
description = "A ball on a block"
gravity = [0.0, 0.0, -9.81]
[[entity]]
name = "block"
pose = {{ translation = [0.0, 0.0, 0.02] }}
mesh = {{ block = {{ size = [0.06, 0.06, 0.04], cells = [6, 6, 4] }} }}
{material}
anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0199] }} }}] }}
[[entity]]
name = "ball"
pose = {{ translation = [0.0, 0.0, 0.0521] }}
mesh = {{ shape = {{ sphere = {{ radius = 0.012 }} }}, segments = 16 }}
rigid_body = {{ motion = "dynamic", mass = {mass}, friction = 0.3 }}
[task]
seconds = 0.02
expect = [{{ measure = "ball.z_m", min = 0.0, max = 1.0 }}]
[[controller]]
name = "block"
kind = "dynamic-fem"
rate_hz = 100
[[controller]]
name = "engine"
kind = "rapier"
rate_hz = 500
[[controller]]
name = "judge"
kind = "outcome"
rate_hz = 100
"#
    )
}

#[test]
fn a_mass_that_sinks_in_too_deep_is_told_once_and_another_is_not() {
    let app = app();
    for young in [1e3, 8e3, 1e5, 1e6] {
        for mass in [1e-3, 0.05, 0.5, 5.0] {
            let material = format!(
                "dynamic_fem = {{ young_modulus = {young:?}, poisson_ratio = 0.45, density = 1000.0 }}"
            );
            let text = ball_above_block(&material, mass);
            let scenario = Scenario::parse("ball.toml".as_ref(), &text, app.registry()).expect("valid");
            let scene = scenario.spawn(app.registry()).expect("a scene").snapshot();
            let told = forecast(&scene, &scenario);
            let plane = young / (1.0 - 0.45 * 0.45);
            let hertz = (mass * 9.81 / (4.0 / 3.0 * plane * 0.012_f64.sqrt())).powf(2.0 / 3.0);
            let wanted = usize::from(hertz > 0.3 * 0.04);
            assert_eq!(told.len(), wanted, "{young} Pa, {mass} kg, {hertz} m: {told:?}");
            assert!(told.iter().all(|line| line.contains("young_modulus") && line.contains("block")));
        }
    }
}

#[test]
fn a_run_tells_its_warnings_in_the_summary() {
    let app = app();
    let material = "dynamic_fem = { young_modulus = 1e3, poisson_ratio = 0.45, density = 1000.0 }";
    let text = ball_above_block(material, 5.0);
    let scenario = Scenario::parse("ball.toml".as_ref(), &text, app.registry()).expect("valid");
    let outcome = finish(&app, &scenario, &lockstep(1));
    assert_eq!(outcome.summary.warnings.len(), 1, "{:?}", outcome.summary.warnings);
}

#[test]
fn the_shipped_scenarios_are_not_warned_of() {
    let app = app();
    for (name, _) in SCENARIOS {
        let scenario = app.scenario(name).unwrap_or_else(|error| panic!("{error}"));
        let scene = scenario.spawn(app.registry()).expect("a scene").snapshot();
        let told = forecast(&scene, &scenario);
        assert!(told.is_empty(), "{name}: {told:?}");
    }
}
