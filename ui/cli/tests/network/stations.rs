//! Sessions of a host and a station, in virtual time.

use std::sync::Arc;

use trocar::app::App;
use trocar::network::impairments::Impairments;
use trocar::play::person;
use trocar::run::{self, RunOptions};
use trocar_kernel::recorder::Recording;
use trocar_scene::{
    Activation, ActivationMode, DeviceForce, DeviceState, Name, PersonInput, SimTime, Snapshot, Station,
};

use crate::support::here;
use crate::support::pair::{Pair, place};
use crate::support::soak::soak;

#[test]
fn a_station_has_the_hosts_scene_and_follows_it() {
    let path = Impairments { loss: 0.02, ..Impairments::delay(SimTime::from_millis(75)) };
    let mut pair = Pair::new("peg-transfer", &path, &["left"]);
    pair.run(3_000);
    let (host, station) = (pair.host.snapshot(), pair.station.snapshot());
    let named = |scene: &Snapshot| scene.iter::<Name>().filter(|(entity, _)| entity.station() == 0).count();
    assert_eq!(named(&host), named(&station));
    for name in ["ring.1", "ring.6", "board.left", "grasper.right"] {
        let (here, there) = (place(&host, name), place(&station, name));
        // 0.3 m/s over 100 ms.
        assert!((here.translation - there.translation).norm() < 0.03, "{name}");
    }
    let rows: Vec<&Station> = host.iter::<Station>().map(|(_, row)| row).collect();
    assert_eq!((rows.len(), rows[0].name.as_str(), rows[0].here), (1, "Ana", true));
    assert_eq!(rows[0].hands, ["left"]);
    let own = station.iter::<Station>().find(|(entity, _)| entity.station() == 1).expect("its own row").1;
    assert!(own.here && (0.149..0.17).contains(&own.link.round_trip), "{own:?}");
}

/// What the person at the station does with the pedal for coagulation.
fn press(pair: &mut Pair, level: f64) {
    let scene = pair.station.snapshot();
    let me = person(&scene).expect("somebody plays");
    let mut input = *scene.get::<PersonInput>(me).expect("a person");
    let mode = (level > 0.0).then_some(ActivationMode::Coagulate);
    (input.right.activation, input.right.mode) = (level, mode);
    pair.station.apply(|out| out.put(me, input)).expect("a person's input");
}

/// What the hook at the host does.
fn current(pair: &mut Pair) -> (f64, Option<ActivationMode>) {
    let scene = pair.host.snapshot();
    let hook = scene.find("hook.right").expect("a hook");
    scene.get::<Activation>(hook).map_or((0.0, None), |asked| (asked.level, asked.mode))
}

#[test]
fn a_pedal_at_a_station_switches_the_current_at_the_host_and_silence_switches_it_off() {
    const OFF: (f64, Option<ActivationMode>) = (0.0, None);
    const ON: (f64, Option<ActivationMode>) = (1.0, Some(ActivationMode::Coagulate));
    let path = Impairments::delay(SimTime::from_millis(20));
    let mut pair = Pair::played("cautery", &path, &["right"]);
    // The trainee of the scenario, who would have switched on the current by now, does not have the hand.
    pair.run(1_500);
    assert_eq!(current(&mut pair), OFF);
    press(&mut pair, 1.0);
    pair.run(200);
    assert_eq!(current(&mut pair), ON);
    press(&mut pair, 0.0);
    pair.run(200);
    assert_eq!(current(&mut pair), OFF);
    press(&mut pair, 1.0);
    pair.run(200);
    assert_eq!(current(&mut pair), ON);
    pair.partition(true);
    pair.run(300);
    assert_eq!(current(&mut pair), OFF, "silence of 100 ms");
    pair.partition(false);
    pair.run(1_500);
    assert_eq!(current(&mut pair), OFF, "a pedal that is still pressed has to be released first");
    press(&mut pair, 0.0);
    pair.run(200);
    press(&mut pair, 1.0);
    pair.run(200);
    assert_eq!(current(&mut pair), ON);
}

/// What a hand feels that goes 2 mm into the wall at 60 mm/s, stays there, and slides 10 mm: each millisecond, how deep its
/// handle is \[m\] and the force that pushes it out \[N\].
fn pressed(mut step: impl FnMut() -> Arc<Snapshot>) -> Vec<(f64, f64)> {
    let felt = |scene: &Snapshot| {
        let hand = scene.find("hand.right").expect("a hand");
        let state = scene.get::<DeviceState>(hand)?;
        let force = scene.get::<DeviceForce>(hand)?;
        Some((state.handle_in_device.translation.z - 0.010, -force.force.z))
    };
    let all: Vec<_> = (0..7_000).filter_map(|_| felt(&step())).collect();
    let begin = all.iter().position(|(depth, _)| *depth > 0.0).expect("it reaches the wall");
    all[begin..(begin + 1_500).min(all.len())].to_vec()
}

#[test]
fn a_wall_feels_the_same_at_every_delay() {
    let folder = here();
    let file = folder.path().join("press.csv");
    let rows = [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.2, 0.0, 0.012), (5.2, 0.0, 0.012), (5.7, 0.010, 0.012)];
    let rows: String =
        rows.iter().map(|(t, x, z)| format!("{t},{x},0.0,{z},1.0,0.0,0.0,0.0,0.0\n")).collect();
    std::fs::write(&file, format!("t,x,y,z,qw,qx,qy,qz,gripper\n{rows}")).expect("a file");
    let device = format!("right=replay:{}", file.display());
    let mut alone = {
        let hand = device.split_once('=').map(|(name, device)| (name.to_owned(), device.to_owned()));
        let options =
            RunOptions { lockstep: true, hands: hand.into_iter().collect(), ..RunOptions::default() };
        let app = App::new();
        run::start(&app, &app.scenario("wall").expect("a scenario"), &options).expect("it starts")
    };
    let mut now = SimTime::ZERO;
    let here = pressed(|| {
        now += SimTime::from_millis(1);
        alone.run_until(now);
        alone.snapshot()
    });
    assert!(here[500].1 > 1.0, "{:?}", here[500]);
    for round_trip in [0, 150, 1_000] {
        let path = Impairments { loss: 0.02, ..Impairments::delay(SimTime::from_millis(round_trip / 2)) };
        let mut pair = Pair::new("wall", &path, &[&device]);
        let there = pressed(|| {
            pair.step();
            pair.station.snapshot()
        });
        for (millis, ((depth, force), (_, expected))) in there.iter().zip(&here).enumerate() {
            // The first contact's damping depends on when a tick falls.
            let tolerance = if *depth < 0.001 { 0.3 } else { 0.05 * expected };
            assert!(
                (force - expected).abs() <= tolerance,
                "{round_trip} ms: {force} N instead of {expected} at {depth} m, {millis} ms after contact"
            );
        }
    }
}

#[test]
fn a_station_holds_the_state_of_its_host_each_second_in_spite_of_breaks() {
    // An hour of it is among what runs before a release.
    let soaked = soak(20);
    println!("{soaked:?}");
    assert!(
        soaked.agreed == 20 && soaked.differed == 20 && soaked.breaks == 2 && soaked.bodies > 50,
        "{soaked:?}"
    );
}

#[test]
fn a_station_is_back_within_a_second_of_its_hosts_restart() {
    let path = Impairments { loss: 0.02, ..Impairments::delay(SimTime::from_millis(75)) };
    let mut pair = Pair::new("peg-transfer", &path, &["left"]);
    pair.run(3_000);
    pair.restart_host();
    let killed_at = pair.now;
    // What was under way comes; then the instrument of the host's hand stands at the station until it is back.
    pair.run(120);
    let shown = |pair: &mut Pair| place(&pair.station.snapshot(), "grasper.right");
    let stands = shown(&mut pair);
    pair.run(30);
    assert_eq!(shown(&mut pair), stands, "the host is gone");
    while shown(&mut pair) == stands {
        assert!(pair.step() && pair.now.since(killed_at) < SimTime::from_millis(1_000));
    }
    println!("back after {}", pair.now.since(killed_at));
    // Its hand comes back from where it went meanwhile.
    pair.run(2_000);
    let (host, station) = (pair.host.snapshot(), pair.station.snapshot());
    let row = host.iter::<Station>().next().expect("the host's row of it").1;
    assert!(row.here && row.hands == ["left"], "{row:?}");
    let far = (place(&host, "grasper.left").translation - place(&station, "grasper.left").translation).norm();
    // 0.3 m/s over 100 ms.
    assert!(far < 0.03, "{far} m");
}

#[test]
fn no_secret_is_in_a_recording_or_in_a_scene() {
    let mut pair = Pair::new("wall", &Impairments::delay(SimTime::from_millis(20)), &["right"]);
    pair.run(1_200);
    pair.wire.disconnect();
    // Back by the resume secret.
    pair.run(3_000);
    let mut texts: Vec<Vec<u8>> = Vec::new();
    for scene in [pair.host.snapshot(), pair.station.snapshot()] {
        assert!(scene.iter::<Station>().any(|(_, row)| row.here));
        for (id, _) in scene.registry().iter() {
            let column = scene.erased_column(id);
            column.for_each_entity(&mut |entity| {
                let row = column.row_json(entity).map(|row| row.to_string().into_bytes());
                texts.extend(row);
            });
        }
    }
    let file = pair.recording();
    let recording = Recording::open(&file).expect("it is whole so far");
    texts.extend(recording.bodies().expect("they unpack"));
    texts.push(std::fs::read(&file).expect("it is there"));
    assert!(texts.len() > 50);
    for secret in &pair.secrets {
        let digits: String = secret.iter().map(|byte| format!("{byte:02x}")).collect();
        let list = format!("{secret:?}").replace(' ', "");
        for form in [&secret[..], digits.as_bytes(), list.as_bytes()] {
            let has = |text: &&Vec<u8>| text.windows(form.len()).any(|part| part == form);
            assert!(!texts.iter().any(|text| has(&text)), "a secret of {} bytes", secret.len());
        }
    }
}
