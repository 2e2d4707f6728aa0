//! Soft bodies bear rigid ones, by every method and at every rate that a scenario may declare; what is too heavy is told
//! before the start.

use trocar::app::SCENARIOS;
use trocar::run::{Progress, run};
use trocar::session::forecast;
use trocar_scene::SimTime;
use trocar_scene::scenario::Scenario;
use trocar_test_support::thorough;
use trocar_tests::{app, finish, lockstep};

/// How far aside a brick comes to rest on springs \[m\]: a lattice of cells that are all cut along one diagonal gives way
/// along it when it is pressed.
const LEANS: f64 = 7e-3;

/// The methods of soft volumes: controller and component, by Young's modulus \[Pa\] and density \[kg/m³\]; whether gravity
/// acts on it, its Poisson's ratio, and the tolerated deviation from finite elements.
const METHODS: [Method; 6] = [
    Method {
        kind: "dynamic-fem",
        component: "dynamic_fem = { young_modulus = $E, poisson_ratio = $NU, density = $D }",
        weighs: true,
        nu: 0.4,
        within: 0.1,
        aside: 5e-3,
    },
    Method {
        kind: "linear-fem",
        component: "linear_fem = { young_modulus = $E, poisson_ratio = $NU }",
        weighs: false,
        nu: 0.4,
        within: 0.1,
        aside: 5e-3,
    },
    Method {
        kind: "xpbd",
        component: "xpbd = { matter = { volume = { young_modulus = $E, poisson_ratio = $NU, density = $D } } }",
        weighs: true,
        nu: 0.4,
        within: 0.25,
        aside: 5e-3,
    },
    Method {
        kind: "rapier-soft",
        component: "engine_soft = { young_modulus = $E, poisson_ratio = $NU, density = $D }",
        weighs: true,
        nu: 0.4,
        within: 0.25,
        aside: 5e-3,
    },
    Method {
        kind: "mass-spring",
        component: "mass_spring = { method = \"explicit\", thickness = 0.0, springs = { volume = { young_modulus = $E, density = $D } } }",
        weighs: true,
        nu: 0.25,
        within: 0.25,
        aside: LEANS,
    },
    Method {
        kind: "mass-spring",
        component: "mass_spring = { method = \"implicit\", thickness = 0.0, springs = { volume = { young_modulus = $E, density = $D } } }",
        weighs: true,
        nu: 0.25,
        within: 0.25,
        aside: LEANS,
    },
];

#[derive(Clone, Copy, Debug)]
struct Method {
    kind: &'static str,
    component: &'static str,
    weighs: bool,
    nu: f64,
    within: f64,
    /// How far aside the brick may come to rest \[m\].
    aside: f64,
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

/// How a brick lies.
struct Rest {
    /// \[m\]
    depth: f64,
    /// From where it was let go \[m\], and in the last half second.
    aside: f64,
    crept: f64,
    /// Number of warnings.
    told: usize,
}

/// How the brick lies; `None` where explicit springs refuse the step.
fn rest(method: &Method, young: f64, mass: f64, rates: [f64; 2]) -> Option<Rest> {
    let app = app();
    let text = brick_above_block(method, young, mass, rates);
    let scenario = Scenario::parse("brick.toml".as_ref(), &text, app.registry()).expect("valid");
    let mut before = None;
    let mut observe = |progress: &mut Progress<'_>| {
        if before.is_none() && progress.now >= SimTime::from_millis(1500) {
            let brick = progress.scene.find("brick").expect("the brick");
            before = Some(progress.scene.world_pose(brick).translation.vector);
        }
    };
    let run = match run(&app, &scenario, &lockstep(1), &mut observe) {
        Ok(run) => run,
        Err(error) => {
            assert!(method.component.contains("explicit"), "{error}");
            return None;
        }
    };
    let values = &run.summary.task.metrics["outcome"];
    let [x, y, z] = ["brick.x_m", "brick.y_m", "brick.z_m"].map(|name| values[name]);
    let before = before.expect("an observation");
    Some(Rest {
        depth: 0.05 - z,
        aside: x.hypot(y),
        crept: (x - before.x).hypot(y - before.y),
        told: run.summary.warnings.len(),
    })
}

/// How much a body may swing about its rest where the ticks of both controllers do not fit each other \[m\].
const SWING: f64 = 6e-5;

/// What the block's weight presses with on its anchors \[Pa\].
const PRESSURE: f64 = 1000.0 * 9.81 * 0.04;

/// How far a brick may creep aside in half a second \[m\]; one of 5 kg, 35 times the weight of the block, slides by jerks.
const CREEP: f64 = 3e-4;
const JERKS: f64 = 4e-3;

#[test]
fn a_brick_rests_as_deep_by_every_method_at_every_rate() {
    let cells: &[(f64, f64)] = if thorough() {
        &[(2e3, 1e-3), (8e3, 1e-3), (8e3, 0.02), (3e4, 0.1), (1e5, 0.1), (1e5, 0.3), (1e6, 5.0)]
    } else {
        &[(1e5, 0.1)]
    };
    let rates: &[f64] =
        if thorough() { &[10.0, 25.0, 60.0, 150.0, 300.0, 1000.0] } else { &[20.0, 150.0, 1000.0] };
    let mut wrong = Vec::new();
    for &(young, mass) in cells {
        for method in &METHODS {
            // The same mesh by finite elements, in short steps.
            let by = Method { component: METHODS[0].component, kind: METHODS[0].kind, ..*method };
            let known = rest(&by, young, mass, [1000.0, 1000.0]).expect("finite elements").depth;
            for &rate in rates {
                let Some(Rest { depth, aside, crept, told }) = rest(method, young, mass, [rate, 500.0])
                else {
                    continue;
                };
                let rests = (depth - known).abs() < method.within * known + SWING
                    && aside < method.aside
                    && crept < if mass > 1.0 { JERKS } else { CREEP };
                // What is told to fold under its own weight need not rest.
                let folds = method.kind == "mass-spring" && young < 10.0 * PRESSURE;
                if told != usize::from(folds) || !(rests || folds) {
                    wrong.push(format!(
                        "{}, {young} Pa, {mass} kg, {rate} Hz: {depth} m, known {known} m, {aside} m aside, {crept} m in \
                         half a second, {told} warnings",
                        method.component
                    ));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

/// At the first ticks of a slow body nobody knows yet how long the rigid body's steps are.
#[test]
fn a_light_brick_rests_on_rapiers_volume_at_ten_hertz() {
    let rapier = METHODS.iter().find(|method| method.kind == "rapier-soft").expect("Rapier's");
    let Rest { depth, aside, told, .. } = rest(rapier, 8e3, 1e-3, [10.0, 500.0]).expect("a run");
    // By finite elements in steps of 1 ms.
    let known = 8.25e-4;
    assert!((depth - known).abs() < rapier.within * known + SWING && told == 0, "{depth} m");
    assert!(aside < rapier.aside, "{aside} m");
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
            let wanted = usize::from(hertz > 0.3 * 0.04 || young < 3.0 * PRESSURE);
            assert_eq!(told.len(), wanted, "{young} Pa, {mass} kg, {hertz} m: {told:?}");
            assert!(told.iter().all(|line| line.contains("young_modulus") && line.contains("block")));
        }
    }
}

/// A block that folds under its own weight, alone or under a ball, is told once; one that stands on nothing, hangs or is
/// light is not.
#[test]
fn a_volume_that_folds_under_its_own_weight_is_told_once() {
    let app = app();
    let told = |text: &str| {
        let scenario = Scenario::parse("ball.toml".as_ref(), text, app.registry()).expect("valid");
        let scene = scenario.spawn(app.registry()).expect("a scene").snapshot();
        forecast(&scene, &scenario)
    };
    let mut folding = 0;
    for method in METHODS.iter().filter(|method| method.kind != "linear-fem") {
        let is_springs = method.kind == "mass-spring";
        for young in [1e3, 2e3, 3.9e3, 4e3, 8e3, 1e5, 1e6] {
            for mass in [1e-3, 0.02, 0.5, 5.0] {
                for density in [1000.0, 1.0] {
                    let component = method.component.replace("$E", &format!("{young:?}"));
                    let component = component.replace("$NU", &method.nu.to_string());
                    let component = component.replace("$D", &format!("{density:?}"));
                    let text = ball_above_block(&component, mass);
                    let pressure = PRESSURE * density / 1000.0;
                    let folds = young < pressure * if is_springs { 10.0 } else { 3.0 };
                    let plane = young / (1.0 - method.nu * method.nu);
                    let hertz = (mass * 9.81 / (4.0 / 3.0 * plane * 0.012_f64.sqrt())).powf(2.0 / 3.0);
                    // Of springs a quarter of a cell, of 9.7 mm.
                    let is_deep = hertz > if is_springs { 2.43e-3 } else { 0.012 };
                    let lines = told(&text);
                    let case = format!("{component}, {mass} kg, {hertz} m: {lines:?}");
                    assert_eq!(lines.len(), usize::from(folds || is_deep), "{case}");
                    let names = |line: &String| line.contains("young_modulus") && line.contains("block");
                    assert!(lines.iter().all(names), "{case}");
                    assert!(lines.iter().all(|line| line.contains("own weight") == folds), "{case}");
                    folding += usize::from(folds);
                    // Without the ball, and hanging.
                    let alone = text.replace("motion = \"dynamic\"", "motion = \"static\"");
                    assert_eq!(told(&alone).len(), usize::from(folds), "{case}");
                    let hangs = alone.replace(
                        "min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0199]",
                        "min = [-1.0, -1.0, 0.0199], max = [1.0, 1.0, 1.0]",
                    );
                    assert_ne!(hangs, alone);
                    assert!(told(&hangs).is_empty(), "{case}");
                }
            }
        }
    }
    assert_eq!(folding, 4 * (2 * 3 + 3));
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
