//! A hand on a wall: what is felt must be stiff, passive and still, however slow the physics is.

use trocar::run::{RunOptions, start};
use trocar_scene::{DeviceForce, DeviceState, HapticStatus, InstrumentTarget, SimTime};
use trocar_tests::{app, edited, lockstep};

struct Felt {
    force: f64,
    depth: f64,
    speed_rms: f64,
    energy_least: f64,
}

/// Presses the probe on the wall for 4 s and looks at the last second.
fn press(physics_hz: u32, device: &str, aim_depth: Option<f64>) -> Felt {
    let app = app();
    let rate = format!("kind = \"rapier\"\nrate_hz = {physics_hz}");
    let mut edits = vec![("kind = \"rapier\"\nrate_hz = 500".to_owned(), rate)];
    if let Some(depth) = aim_depth {
        // The tip starts 10 mm above the wall and the device's z axis points into it.
        let aim = format!(
            "hand_target = {{ handle_in_device = {{ translation = [0.0, 0.0, {}] }} }}",
            0.01 + depth
        );
        edits.push((
            "name = \"hand.right\"\n[entity.hand]".to_owned(),
            format!("name = \"hand.right\"\n{aim}\n[entity.hand]"),
        ));
    }
    if aim_depth.is_none() {
        // Nobody holds it, so from further away than half a millimetre it would be thrown at the wall.
        for (from, to) in
            [("0.0, 0.0, 0.010]\nrotation", "0.0, 0.0, 0.0005]\nrotation"), ("0.110]", "0.1005]")]
        {
            edits.push((from.to_owned(), to.to_owned()));
        }
    }
    let edits: Vec<(&str, &str)> = edits.iter().map(|(a, b)| (a.as_str(), b.as_str())).collect();
    let scenario = edited(&app, "wall", &edits);
    let options = RunOptions {
        hands: vec![("right".to_owned(), device.to_owned())],
        seconds: Some(4.0),
        ..lockstep(1)
    };
    let mut session = start(&app, &scenario, &options).expect("the session starts");
    let scene = session.snapshot();
    let find = |name: &str| scene.find(name).expect("a name of the scenario");
    let (hand, probe) = (find("hand.right"), find("probe.right"));
    let (mut force, mut depth, mut square, mut count) = (0.0, 0.0, 0.0, 0.0);
    let mut energy_least = f64::INFINITY;
    let mut now = SimTime::ZERO;
    while now < SimTime::from_millis(3_990) {
        now += SimTime::from_millis(1);
        session.run_until(now);
        let scene = session.snapshot();
        if let Some(status) = scene.get::<HapticStatus>(hand) {
            energy_least = energy_least.min(status.energy);
        }
        if now > SimTime::from_millis(3_000) {
            let state = scene.get::<DeviceState>(hand).expect("a device state");
            force += scene.get::<DeviceForce>(hand).expect("a force").force.norm();
            depth -= scene.get::<InstrumentTarget>(probe).expect("a target").tip_in_world.translation.z;
            square += state.velocity_in_device.linear.norm_squared();
            count += 1.0;
        }
    }
    Felt { force: force / count, depth: depth / count, speed_rms: (square / count).sqrt(), energy_least }
}

fn holds(physics_hz: u32, light: Felt, firm: Felt) {
    let stiffness = (firm.force - light.force) / (firm.depth - light.depth);
    println!(
        "{physics_hz} Hz: felt stiffness {stiffness:.0} N/m, speed rms {:.2e} m/s, least energy {:.2e} J, {:.2} to {:.2} N",
        firm.speed_rms, firm.energy_least, light.force, firm.force
    );
    assert!(firm.force > light.force + 0.2, "the wall pushes back: {} N, {} N", light.force, firm.force);
    assert!(stiffness >= 500.0, "{stiffness} N/m at {physics_hz} Hz");
    for felt in [&light, &firm] {
        assert!(felt.energy_least >= 0.0, "energy {} J at {physics_hz} Hz", felt.energy_least);
        assert!(felt.speed_rms < 2e-3, "limit cycle of {} m/s at {physics_hz} Hz", felt.speed_rms);
    }
}

#[test]
fn a_free_device_pushed_on_the_wall_feels_it_stiff_passive_and_still() {
    for physics_hz in [10, 100, 500] {
        let push = |newtons: f64| press(physics_hz, &format!("virtual:impedance=off,push_z={newtons}"), None);
        holds(physics_hz, push(0.5), push(1.0));
    }
}

#[test]
fn an_arm_that_aims_into_the_wall_feels_it_stiff_passive_and_still() {
    for physics_hz in [10, 100, 500] {
        let aim = |depth: f64| press(physics_hz, "virtual", Some(depth));
        holds(physics_hz, aim(0.003), aim(0.007));
    }
}
