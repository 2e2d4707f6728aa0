//! The device with its emulator at the other end of the cable, in live sessions and alone. The tests wait for events
//! without measuring how long they take: that would fail on a busy machine. There a device may also be silent for longer
//! than its driver waits, so connections are counted where the test gives the driver its time.

use std::time::{Duration, Instant};

use template_device::emulator::Emulator;
use template_device::{Stylus, app};
use trocar::devices::{DeviceError, HapticDevice};
use trocar::prelude::*;

/// The driver's stated limit, which the safety layer enforces \[N\].
const FORCE_MAX: f64 = 3.0;

fn emulator() -> Emulator {
    Emulator::start("127.0.0.1:0").expect("a free port")
}

/// The scenario `wall` with the stylus in its hand: a hand presses a rod on a plate, 10 mm below.
fn press_the_wall(emulator: &Emulator) -> Session {
    let app = app();
    let scenario = app.scenario("wall").expect("it comes with Trocar");
    let hands = vec![("right".to_owned(), format!("stylus:{}", emulator.address()))];
    start(&app, &scenario, &RunOptions { hands, ..RunOptions::default() }).expect("it starts")
}

fn eventually(why: &str, session: &Session, mut what: impl FnMut(&trocar::devices::DeviceState) -> bool) {
    let until = Instant::now() + Duration::from_secs(20);
    while !what(&session.hands()[0].monitor.sample().state) {
        assert!(Instant::now() < until, "{why}: {:?}", session.hands()[0].monitor.sample());
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn depth(state: &trocar::devices::DeviceState) -> f64 {
    state.pose_in_device.translation.z
}

#[test]
fn a_hand_feels_the_wall_through_the_cable_and_never_more_than_the_device_bears() {
    let emulator = emulator();
    let session = press_the_wall(&emulator);
    eventually("it moves", &session, |state| state.connected && depth(state) > 0.005);
    eventually("the wall pushes back", &session, |_| emulator.force_max() > 0.3);
    // The arm aims 10 mm behind the wall; the wall stops it.
    let until = Instant::now() + Duration::from_millis(500);
    while Instant::now() < until {
        assert!(depth(&session.hands()[0].monitor.sample().state) < 0.018, "the wall does not hold");
        std::thread::sleep(Duration::from_millis(1));
    }
    let finished = session.finish();
    assert_eq!(finished.driver_errors, Vec::<String>::new());
    assert!(emulator.force_max() <= FORCE_MAX + 1e-3, "{} N", emulator.force_max());
    assert!(finished.force_newtons_max <= FORCE_MAX + 1e-9, "{} N", finished.force_newtons_max);
}

#[test]
fn a_pulled_cable_is_noticed_and_a_plugged_one_found_again() {
    let emulator = emulator();
    let session = press_the_wall(&emulator);
    eventually("it moves", &session, |state| state.connected && depth(state) > 0.005);
    emulator.set_unplugged(true);
    eventually("it is gone", &session, |state| !state.connected);
    emulator.set_unplugged(false);
    eventually("it is back", &session, |state| state.connected && depth(state) > 0.005);
    assert!(emulator.connections() >= 2);
    assert!(session.finish().outcome.incidents.is_empty(), "no actor noticed");
}

#[test]
fn a_bad_cable_lets_no_nonsense_through() {
    let emulator = emulator();
    emulator.set_garbled(true);
    let session = press_the_wall(&emulator);
    let (mut deepest, mut seen) = (0.0_f64, 0);
    eventually("it moves all the same", &session, |state| {
        assert!((-0.001..0.03).contains(&depth(state)), "{state:?}");
        assert!(state.linear_velocity.norm() < 1.0, "{state:?}");
        (deepest, seen) = (deepest.max(depth(state)), seen + 1);
        deepest > 0.009 && seen > 200
    });
}

/// Reads states; a millisecond of the driver's time passes with each of them.
fn read(stylus: &mut Stylus, states: u64) -> Result<(), DeviceError> {
    let mut read = 0;
    while read < states {
        match stylus.read(1_000_000 * read) {
            Ok(_) => read += 1,
            Err(DeviceError::Transfer(_)) => std::thread::sleep(Duration::from_millis(1)),
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

#[test]
fn it_connects_once_for_each_time_that_the_cable_is_plugged_in() {
    let emulator = emulator();
    let mut stylus = Stylus::new(emulator.address());
    stylus.open(0).expect("it is there");
    emulator.set_garbled(true);
    read(&mut stylus, 200).expect("noise is no reason to hang up");
    emulator.set_garbled(false);
    for plugged_again in 1..=3 {
        emulator.set_unplugged(true);
        assert_eq!(read(&mut stylus, u64::MAX), Err(DeviceError::Disconnected));
        stylus.open(0).expect("the terminal server is there");
        assert_eq!(read(&mut stylus, 1), Err(DeviceError::Disconnected), "the device is not");
        emulator.set_unplugged(false);
        stylus.open(0).expect("it is there again");
        read(&mut stylus, 10).expect("it tells where it is");
        assert_eq!(emulator.connections(), 1 + plugged_again);
    }
}

#[test]
fn the_text_that_names_it_is_checked() {
    let app = app();
    let scenario = app.scenario("wall").expect("it comes with Trocar");
    let hands = vec![("right".to_owned(), "stylus:COM1".to_owned())];
    let options = RunOptions { lockstep: true, hands, ..RunOptions::default() };
    let error = start(&app, &scenario, &options).err().expect("refused").to_string();
    assert!(error.contains("stylus:ADDRESS:PORT") && error.contains("127.0.0.1:7700"), "{error}");
}
