//! A shaft that a hand leads against a held soft body is stopped by a bounded force, whichever method moves the body: it is
//! never on its other side.

use nalgebra::Vector3;
use trocar_dynamics::instrument::deflection::{InstrumentDeflection, InstrumentYields};
use trocar_scene::{
    BuildContext, Controller, ControllerError, Frozen, InstrumentForce, InstrumentTarget, OutOfValidity,
    Pose, RestPositions, Velocity, VertexPositions,
};
use trocar_simulator::controller::{
    DynamicFemController, InstrumentsConfig, InstrumentsController, MassSpringController, XpbdController,
};

use crate::support::stage::other::Other;
use crate::support::stage::{Stage, scene};

const RADIUS: f64 = 0.0025;
/// The shaft's mass \[kg\].
const MASS: f64 = 0.03;

fn springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(Vector3::zeros(), context)
}
fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(Vector3::zeros(), context)
}
fn fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(Vector3::zeros(), context)
}

/// A shaft along z, and a body across its way along y.
struct Session<C> {
    stage: Stage<C>,
    instruments: Other,
    hz: f64,
    hand: f64,
    way: f64,
    hardest: f64,
}

impl<C: Controller> Session<C> {
    fn new(
        body: &str,
        (hz, bound): (f64, f64),
        build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError>,
    ) -> Self {
        let text = format!(
            "[[entity]]\nname = \"probe\"\npose = {{ translation = [0.0, -0.03, 0.03] }}\n\
             instrument = {{ kind = \"probe\", shaft_length = 0.1, shaft_radius = {RADIUS}, mass = {MASS} }}\n\
             [[entity]]\nname = \"body\"\n{body}\n"
        );
        let stage = Stage::new(scene(&text), hz, build);
        let instruments = Other::new(&stage, 9, 1, |context| {
            let config = InstrumentsConfig { coupling_force_max: bound, ..InstrumentsConfig::default() };
            InstrumentsController::new(config, context)
        });
        Self { stage, instruments, hz, hand: -0.03, way: 0.0, hardest: 0.0 }
    }

    fn tick(&mut self, way: f64) {
        (self.hand, self.way) = (self.hand + way, way);
        let target = InstrumentTarget {
            tip_in_world: Pose::at(0.0, self.hand, 0.03),
            velocity_in_world: Velocity { linear: Vector3::y() * (way * self.hz), angular: Vector3::zeros() },
            sampled_at: self.stage.now(),
            ..InstrumentTarget::default()
        };
        self.stage.put("probe", target);
        self.instruments.tick(&mut self.stage);
        self.stage.tick();
        self.hardest = self.hardest.max(self.stage.measured("body.contact_force_n"));
    }

    /// Where the body's tick has left it along its way: led on from where its hand was, and held back \[m\].
    fn probe(&self) -> f64 {
        let held = self.stage.get::<InstrumentYields>("body");
        self.hand + self.way + held.list.first().map_or(0.0, |held| held.offset.y)
    }

    /// The lowest place of what was in the middle of the body, relative to the shaft's axis, along its way \[m\].
    fn before(&self) -> f64 {
        let pose = self.stage.store.view().world_pose(self.stage.entity("body"));
        let rest = self.stage.get::<RestPositions>("body").positions;
        let all = self.stage.get::<VertexPositions>("body").positions;
        let middle = all.iter().zip(rest.iter()).filter(|(_, rest)| rest.x.abs() < 1e-6);
        middle.map(|(point, _)| (pose * point).y).fold(f64::INFINITY, f64::min) - self.probe()
    }
}

/// Rates of the body's controller and the instruments' \[Hz\].
const FAST: &[f64] = &[1000.0];
const MIDDLE: &[f64] = &[1000.0, 200.0];
const ALL: &[f64] = &[1000.0, 200.0, 50.0];

/// Led 30 mm beyond where the body is, at each of these rates.
fn is_stopped<C: Controller>(
    body: &str,
    bound: f64,
    rates: &[f64],
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
) {
    let speeds = [0.05, 0.2, 1.0];
    for (hz, speed) in rates.iter().flat_map(|hz| speeds.map(|speed| (*hz, speed))) {
        let mut session = Session::new(body, (hz, bound), build);
        session.tick(0.0);
        let mut nearest = f64::INFINITY;
        let mut look = |session: &Session<C>| {
            assert!(
                !session.stage.has::<Frozen>("body"),
                "{body} {hz} Hz {speed} m/s: {}",
                session.stage.get::<Frozen>("body").reason
            );
            nearest = nearest.min(session.before());
        };
        while session.hand < 0.03 - 1e-9 {
            let step = (speed / hz).min(0.03 - session.hand);
            session.tick(step);
            look(&session);
        }
        for _ in 0..(0.3 * hz) as usize {
            session.tick(0.0);
            look(&session);
        }
        let offset = session.stage.get::<InstrumentDeflection>("probe").total().offset.norm();
        let felt = session.stage.get::<InstrumentForce>("probe").force.norm();
        // What stops it within a millisecond, and the springs of the body's own contacts, of at most 300 N/m.
        let impact = MASS * speed / 1e-3;
        let springs = 300.0 * 0.5 * RADIUS * 20.0;
        println!(
            "{hz} Hz {speed} m/s: nearest {nearest} m, at the end {} m, held back by {offset} m, felt {felt} N, hardest {} N; {body}",
            session.before(),
            session.hardest
        );
        assert!(nearest > 0.1 * RADIUS, "{body} {hz} Hz {speed} m/s: it is through: {nearest} m");
        assert!(
            session.hardest < 1.1 * bound + impact + springs,
            "{body} {hz} Hz {speed} m/s: {} N",
            session.hardest
        );
    }
}

const ENDS: &str = "anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [-0.0199, 1.0, 1.0] } }, \
    { box = { min = [0.0199, -1.0, -1.0], max = [1.0, 1.0, 1.0] } }] }\n";
const LINE: &str = "mesh = { line = { length = 0.04, segments = 20, radius = 0.0005 } }\n";
/// A band that faces the shaft, and a sheet whose edge meets it.
const BAND: &str = "pose = { rotation = [0.7071067811865476, 0.0, 0.0, 0.7071067811865476] }\n\
    mesh = { sheet = { size = [0.04, 0.008], cells = [20, 4] } }\n";
const SHEET: &str = "mesh = { sheet = { size = [0.04, 0.02], cells = [20, 10] } }\n";
const STIFF: &str = "membrane_stiffness = 20000.0, bending_stiffness = 2e-5, density = 0.5";
const ROPE: &str = "axial_stiffness = 500.0, bending_stiffness = 1e-7, density = 2e-3";

/// What is told of a body against which a shaft is led at this speed \[m/s\] with at most `bound` \[N\].
fn told<C: Controller>(
    body: &str,
    (hz, bound): (f64, f64),
    speed: f64,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError>,
) -> Option<String> {
    let mut session = Session::new(body, (hz, bound), build);
    session.tick(0.0);
    while session.hand < 0.03 - 1e-9 {
        let step = (speed / hz).min(0.03 - session.hand);
        session.tick(step);
    }
    session.stage.has::<OutOfValidity>("body").then(|| session.stage.get::<OutOfValidity>("body").reason)
}

#[test]
fn what_goes_too_far_in_a_step_to_be_stopped_is_told() {
    let slab = "mesh = { block = { size = [0.04, 0.004, 0.008], cells = [20, 2, 4] } }\n";
    let body = format!(
        "{slab}{ENDS}dynamic_fem = {{ young_modulus = 5e6, poisson_ratio = 0.3, density = 1000.0, mass_damping = 20.0 }}"
    );
    let why = told(&body, (20.0, 20.0), 0.6, fem).expect("30 mm in a step");
    assert!(why.contains("probe goes by 30 mm in each of its steps of 50 ms"), "{why}");
    assert!(why.contains("take a 'rate_hz' of 40 or more"), "{why}");
    // It goes by a diameter, and it is followed within the step.
    assert_eq!(told(&body, (20.0, 20.0), 0.09, fem), None);
    assert_eq!(told(&body, (50.0, 20.0), 1.0, fem), None);
}

#[test]
fn what_is_too_fast_or_too_strong_for_a_position_based_cloth_is_told() {
    let stiff = STIFF.split(", density").next().unwrap_or_default();
    let body = format!(
        "{BAND}{ENDS}xpbd = {{ matter = {{ cloth = {{ {stiff}, density = 0.1 }} }}, parts = 4, damping = 20.0 }}"
    );
    let fast = told(&body, (100.0, 1.0), 1.0, xpbd).expect("1 m/s");
    assert!(fast.contains("probe meets it at") && fast.contains("'rate_hz' of 500 or more"), "{fast}");
    let strong = told(&body, (200.0, 12.0), 0.05, xpbd).expect("12 N");
    assert!(strong.contains("probe presses it with") && strong.contains("'mass_spring'"), "{strong}");
    assert_eq!(told(&body, (100.0, 1.0), 0.2, xpbd), None);
    assert_eq!(told(&body, (1000.0, 12.0), 1.0, xpbd), None);
}

#[test]
fn springs_stop_a_shaft_at_any_speed() {
    let implicit = "method = \"implicit\", damping = 20.0";
    let line = format!("{LINE}{ENDS}mass_spring = {{ springs = {{ line = {{ {ROPE} }} }}, {implicit} }}");
    is_stopped(&line, 20.0, ALL, springs);
    for mesh in [BAND, SHEET] {
        let body =
            format!("{mesh}{ENDS}mass_spring = {{ springs = {{ surface = {{ {STIFF} }} }}, {implicit} }}");
        is_stopped(&body, 5.0, ALL, springs);
    }
}

#[test]
fn explicit_springs_stop_a_shaft_at_any_speed() {
    // As stiff as steps of 5 µs allow.
    let (rope, stiff) = (ROPE.replace("500.0", "50.0"), STIFF.replace("20000.0", "2000.0"));
    let line = format!(
        "{LINE}{ENDS}mass_spring = {{ springs = {{ line = {{ {rope} }} }}, lag = 1e-7, damping = 20.0 }}"
    );
    is_stopped(&line, 20.0, FAST, springs);
    for mesh in [BAND, SHEET] {
        let body = format!(
            "{mesh}{ENDS}mass_spring = {{ springs = {{ surface = {{ {stiff} }} }}, lag = 1e-7, damping = 20.0 }}"
        );
        is_stopped(&body, 5.0, FAST, springs);
    }
}

#[test]
fn position_based_rods_stop_a_shaft_at_any_speed() {
    let line =
        format!("{LINE}{ENDS}xpbd = {{ matter = {{ rod = {{ {ROPE} }} }}, parts = 20, damping = 20.0 }}");
    is_stopped(&line, 20.0, ALL, xpbd);
}

#[test]
fn finite_elements_stop_a_shaft_at_any_speed() {
    let slab = "mesh = { block = { size = [0.04, 0.004, 0.008], cells = [20, 2, 4] } }\n";
    let body = format!(
        "{slab}{ENDS}dynamic_fem = {{ young_modulus = 5e6, poisson_ratio = 0.3, density = 1000.0, mass_damping = 20.0 }}"
    );
    is_stopped(&body, 20.0, ALL, fem);
}

#[test]
fn position_based_cloths_stop_a_shaft_at_any_speed() {
    let stiff = STIFF.split(", density").next().unwrap_or_default();
    for (mesh, density, parts, bounds) in
        [(BAND, 0.1, 4, &[1.0, 12.0][..]), (BAND, 1.0, 40, &[1.0, 12.0]), (SHEET, 0.3, 8, &[5.0])]
    {
        let body = format!(
            "{mesh}{ENDS}xpbd = {{ matter = {{ cloth = {{ {stiff}, density = {density} }} }}, parts = {parts}, damping = 20.0 }}"
        );
        for bound in bounds {
            // docs/limits.md says what comes through at low rates.
            let rates = if *bound > 5.0 { FAST } else { MIDDLE };
            is_stopped(&body, *bound, rates, xpbd);
        }
    }
}

#[test]
fn a_position_based_cloth_that_a_shaft_is_too_strong_for_tears() {
    let body = format!(
        "{BAND}{ENDS}xpbd = {{ matter = {{ cloth = {{ {STIFF} }} }}, parts = 20, damping = 20.0, tears_at = 1.08 }}"
    );
    let torn = |bound: f64| {
        let mut session = Session::new(&body, (1000.0, bound), xpbd);
        (0..600).for_each(|_| session.tick(1e-4));
        (session.stage.measured("body.pieces"), session.before())
    };
    let (pieces, before) = torn(1.0);
    assert!(pieces == 1.0 && before > 0.0, "held: {pieces} pieces, {before} m");
    let (pieces, before) = torn(200.0);
    assert!(pieces > 1.0 && before < 0.0, "torn: {pieces} pieces, {before} m");
}
