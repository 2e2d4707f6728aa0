//! An arm of a robot of ITP in a session: it is stopped as any slave, and its console hears it.

use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use nalgebra::Isometry3;
use trocar::network::itp::{ConsoleArm, ConsoleConfig, ConsoleHand, LedHand, Runlevel};
use trocar::network::live::itp::ConsolePort;
use trocar::run::{RunOptions, start};
use trocar::session::Session;
use trocar_scene::{Hand, SlaveOrder, SlaveState, Teleoperation, TeleoperationEnd};
use trocar_tests::{app, edited};

/// Leads the arm until this is so; the hand goes on along x meanwhile.
fn until(
    what: &str,
    session: &mut Session,
    arm: &mut ConsoleArm,
    led: &mut LedHand,
    mut is: impl FnMut(&Teleoperation, Option<Runlevel>) -> bool,
) -> Teleoperation {
    let begun = Instant::now();
    loop {
        led.hand.pose_in_console.translation.x += 1e-5;
        arm.lead(Some(*led));
        std::thread::sleep(Duration::from_millis(1));
        let scene = session.snapshot();
        let (hand, _) = scene.iter::<Hand>().next().expect("a hand");
        let runlevel = arm.report().and_then(|report| report.robot.runlevel);
        if let Some(row) = scene.get::<Teleoperation>(hand).filter(|row| is(row, runlevel)) {
            return row.clone();
        }
        assert!(
            begun.elapsed() < Duration::from_secs(30),
            "{what}: {:?} {runlevel:?}",
            scene.get::<Teleoperation>(hand)
        );
    }
}

#[test]
fn an_emergency_stop_holds_an_arm_of_itp_and_its_console_hears_runlevel_zero_until_it_ends() {
    let app = app();
    let port = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).expect("a port").local_addr().expect("bound").port();
    let hands = vec![("right".to_owned(), format!("itp:{port}"))];
    let options = RunOptions { hands, ..RunOptions::default() };
    let mut session = start(&app, &edited(&app, "wall", &[]), &options).expect("it starts");
    let robot = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let console = ConsolePort::open(robot, None, ConsoleConfig::default()).expect("the loopback");
    let mut arm = console.take(0).expect("the left arm");
    let hand = ConsoleHand { pose_in_console: Isometry3::identity(), jaw: 0.0, squeeze: 0.0, buttons: 0 };
    let mut led = LedHand { hand, pedal_down: false };
    until("it is heard", &mut session, &mut arm, &mut led, |row, runlevel| {
        row.state == SlaveState::PedalUp && runlevel == Some(Runlevel::PedalUp)
    });
    led.pedal_down = true;
    let row = until("it follows", &mut session, &mut arm, &mut led, |row, runlevel| {
        row.state == SlaveState::Following && runlevel == Some(Runlevel::PedalDown)
    });
    assert_eq!((row.end, row.protected), (TeleoperationEnd::Slave, false));
    assert!(row.words().ends_with("unprotected"), "{}", row.words());

    let entity = session.snapshot().iter::<Hand>().next().expect("a hand").0;
    session.apply(|out| out.put(entity, SlaveOrder { stop: true })).expect("it is written");
    let stopped = until("it stops", &mut session, &mut arm, &mut led, |row, runlevel| {
        row.state == SlaveState::Stopped && runlevel == Some(Runlevel::EmergencyStop)
    });
    let begun = Instant::now();
    let later = until("it stands", &mut session, &mut arm, &mut led, |_, runlevel| {
        assert_eq!(runlevel, Some(Runlevel::EmergencyStop));
        begun.elapsed() > Duration::from_millis(200)
    });
    assert_eq!(stopped.slave_in_world.translation, later.slave_in_world.translation);
    session.apply(|out| out.put(entity, SlaveOrder { stop: false })).expect("it is written");
    until("the pedal is still down", &mut session, &mut arm, &mut led, |row, runlevel| {
        row.state == SlaveState::PedalUp && runlevel == Some(Runlevel::PedalUp)
    });
    led.pedal_down = false;
    let begun = Instant::now();
    until("it is released", &mut session, &mut arm, &mut led, |_, _| {
        begun.elapsed() > Duration::from_millis(50)
    });
    led.pedal_down = true;
    let row = until("it follows again", &mut session, &mut arm, &mut led, |row, runlevel| {
        row.state == SlaveState::Following && runlevel == Some(Runlevel::PedalDown)
    });
    assert_eq!(row.figures.stops, 1);
    session.finish();
}
