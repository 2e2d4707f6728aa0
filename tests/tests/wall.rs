//! A hand on a virtual wall: the contact must be stiff, passive and stable, at any rate of the physics and any speed of
//! impact.

use trocar::run::{RunOptions, start};
use trocar_scene::{DeviceState, HapticStatus, InstrumentTarget, SimTime};
use trocar_tests::{app, edited, lockstep};

/// Friction of the virtual device [N]: within it, a hand may rest beside its equilibrium.
const FRICTION: f64 = 0.26;
const RATES_HZ: [u32; 3] = [10, 100, 500];

/// How the device meets the wall.
#[derive(Clone, Copy, Debug)]
enum Press {
    /// A free device, pushed with this force [N].
    Push(f64),
    /// An arm that aims at this depth inside the wall [m].
    Aim(f64),
}

#[derive(Debug)]
struct Felt {
    /// Force of the motors at rest [N].
    force: f64,
    depth: f64,
    speed_rms: f64,
    energy_least: f64,
}

/// Releases the device `gap` [m] above the wall, waits for 4 s and returns the final state.
fn press(physics_hz: u32, press: Press, gap: f64) -> Felt {
    let app = app();
    let mut edits = vec![
        ("kind = \"rapier\"\nrate_hz = 500".to_owned(), format!("kind = \"rapier\"\nrate_hz = {physics_hz}")),
        ("0.0, 0.0, 0.010]\nrotation".to_owned(), format!("0.0, 0.0, {gap}]\nrotation")),
        // The handle is one shaft above the tip.
        ("0.110]".to_owned(), format!("{}]", 0.1 + gap)),
    ];
    let device = match press {
        Press::Push(newtons) => format!("virtual:impedance=off,push_z={newtons}"),
        Press::Aim(depth) => {
            // The device's z axis points into the wall.
            let z = gap + depth;
            let aim = format!("hand_target = {{ handle_in_device = {{ translation = [0.0, 0.0, {z}] }} }}");
            let hand = "name = \"hand.right\"\n";
            edits.push((format!("{hand}[entity.hand]"), format!("{hand}{aim}\n[entity.hand]")));
            "virtual".to_owned()
        }
    };
    let edits: Vec<(&str, &str)> = edits.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    let scenario = edited(&app, "wall", &edits);
    let options = RunOptions { hands: vec![("right".to_owned(), device)], seconds: Some(4.0), ..lockstep(1) };
    let mut session = start(&app, &scenario, &options).expect("the session starts");
    let scene = session.snapshot();
    let find = |name: &str| scene.find(name).expect("a name of the scenario");
    let (hand, probe) = (find("hand.right"), find("probe.right"));
    let (mut force, mut depth, mut square, mut count) = (0.0, 0.0, 0.0, 0.0);
    let mut now = SimTime::from_millis(3_000);
    while now < SimTime::from_millis(3_990) {
        now += SimTime::from_millis(1);
        session.run_until(now);
        let scene = session.snapshot();
        let state = scene.get::<DeviceState>(hand).expect("a device state");
        force += state.applied_force.norm();
        depth -= scene.get::<InstrumentTarget>(probe).expect("a target").tip_in_world.translation.z;
        square += state.velocity_in_device.linear.norm_squared();
        count += 1.0;
    }
    let energy_least = session.snapshot().get::<HapticStatus>(hand).expect("a status").energy_min;
    Felt { force: force / count, depth: depth / count, speed_rms: (square / count).sqrt(), energy_least }
}

/// Whether the contact was passive and has come to rest.
fn holds(physics_hz: u32, how: Press, gap: f64) -> Felt {
    let felt = press(physics_hz, how, gap);
    let case = format!("{how:?} from {gap} m, physics at {physics_hz} Hz: {felt:?}");
    println!("{case}");
    assert!(felt.energy_least >= 0.0, "gives energy: {case}");
    assert!(felt.speed_rms < 1e-4, "limit cycle: {case}");
    assert!(felt.depth > 0.0 && felt.force > 0.1, "does not touch: {case}");
    if let Press::Push(newtons) = how {
        assert!((felt.force - newtons).abs() <= FRICTION + 1e-3, "is not held: {case}");
    }
    felt
}

fn assert_stiff(physics_hz: u32, presses: &[Felt]) {
    for pair in presses.windows(2) {
        let (light, firm) = (&pair[0], &pair[1]);
        let stiffness = (firm.force - light.force) / (firm.depth - light.depth);
        println!(
            "{physics_hz} Hz: felt stiffness {stiffness:.0} N/m, {:.2} to {:.2} N",
            light.force, firm.force
        );
        assert!(firm.force > light.force + 0.1, "the wall pushes back: {light:?}, {firm:?}");
        assert!(stiffness >= 500.0, "{stiffness} N/m at {physics_hz} Hz");
    }
}

#[test]
fn a_free_device_pushed_on_the_wall_feels_it_stiff_passive_and_still() {
    for physics_hz in RATES_HZ {
        let pushes = [0.5, 1.0, 1.5, 2.0];
        let fallen = pushes.map(|newtons| holds(physics_hz, Press::Push(newtons), 0.010));
        assert_stiff(physics_hz, &fallen);
        let laid = [0.5, 1.0].map(|newtons| holds(physics_hz, Press::Push(newtons), 0.0005));
        assert_stiff(physics_hz, &laid);
    }
}

/// Forces ramp in over 50 ms. A hand that meets the wall meanwhile penetrates deeper than its energy pays for: the wall
/// then pushes it out only as far as that energy permits, and holds there.
#[test]
fn an_impact_within_the_ramp_in_is_passive_and_comes_to_rest() {
    for physics_hz in RATES_HZ {
        for newtons in [1.5, 2.0, 3.0] {
            for gap in [0.0005, 0.005, 0.010] {
                holds(physics_hz, Press::Push(newtons), gap);
            }
        }
    }
}

#[test]
fn an_arm_that_aims_into_the_wall_feels_it_stiff_passive_and_still() {
    for physics_hz in RATES_HZ {
        let [light, firm, beyond] =
            [0.003, 0.007, 0.015].map(|depth| holds(physics_hz, Press::Aim(depth), 0.010));
        assert_stiff(physics_hz, &[light, firm]);
        assert!((beyond.force - 3.3).abs() < 1e-6, "the device's greatest force: {beyond:?}");
    }
}
