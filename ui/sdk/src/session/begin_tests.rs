//! Tests of sessions that begin at a later session time than zero.

use std::time::{Duration, Instant};

use trocar_kernel::faults::{FaultPlan, secs};
use trocar_scene::{DeviceState, SimTime, TaskState};

use crate::app::App;
use crate::run::{self, RunOptions};
use crate::session::Session;

const BEGIN: SimTime = SimTime(12_345_600_000);

fn options() -> RunOptions {
    RunOptions { lockstep: true, begin: BEGIN, seconds: Some(0.4), ..RunOptions::default() }
}

fn started() -> Session {
    let app = App::new();
    let scenario = app.scenario("wall").expect("comes with Trocar");
    run::start(&app, &scenario, &options()).expect("starts")
}

#[test]
fn a_run_is_looked_at_on_its_grid_and_is_as_long_as_it_should_be() {
    let app = App::new();
    let scenario = app.scenario("wall").expect("comes with Trocar");
    let folder = tempfile::tempdir().expect("a folder for temporary files");
    let file = folder.path().join("a.mcap");
    let record = Some(file.clone());
    let options = RunOptions { record: record.clone(), ..options() };
    let mut looks = Vec::new();
    let outcome =
        run::run(&app, &scenario, &options, &mut |progress| looks.push(progress.now)).expect("starts");
    assert_eq!(looks[..2], [secs(12.36), secs(12.38)]);
    assert_eq!(looks.len(), 20, "up to 12.74 s");
    assert!((outcome.summary.sim_secs - 0.4).abs() < 1e-9, "{}", outcome.summary.sim_secs);
    assert_eq!((outcome.kernel.begin, outcome.kernel.sim), (BEGIN, BEGIN + secs(0.4)));
    assert!(outcome.summary.slow_actors.is_empty(), "{:?}", outcome.summary.slow_actors);
    for row in &outcome.reports {
        let due = 0.4 * row.target_hz;
        assert!((row.scheduled as f64 - due).abs() <= 1.0, "{row:?}");
        assert!((row.achieved_hz / row.target_hz - 1.0).abs() < 1e-6, "{row:?}");
    }
    let sampled: Vec<f64> = outcome.trace.hands["right"].applied_force.iter().map(|(secs, _)| secs).collect();
    assert!(sampled.iter().all(|secs| *secs >= 12.345), "{sampled:?}");
    let recording = trocar_kernel::recorder::Recording::open(&file).expect("opens");
    let mut replay =
        trocar_kernel::recorder::Replay::new(&recording, app.registry()).expect("has a keyframe");
    assert_eq!(replay.time(), BEGIN);
    replay.run_to_end().expect("agrees");
}

#[test]
fn in_virtual_time_it_goes_back_to_its_begin_and_is_branched_as_any_other() {
    let mut session = started();
    assert_eq!((session.begin(), session.now()), (BEGIN, BEGIN));
    session.step(secs(0.1));
    let [mut branch, mut other] = [(); 2].map(|()| session.branch().expect("can be branched"));
    let state = |session: &Session| (session.begin(), session.now(), session.hash());
    assert_eq!(state(&branch), (BEGIN, BEGIN + secs(0.1), session.hash()));
    for session in [&mut session, &mut branch, &mut other] {
        session.step(secs(0.1));
    }
    assert_eq!(state(&branch), state(&other));
    let hash = session.hash();
    for session in [&mut session, &mut branch] {
        session.reset().expect("can begin again");
        assert_eq!((session.begin(), session.now()), (BEGIN, BEGIN));
        let scene = session.snapshot();
        assert!(scene.iter::<TaskState>().next().is_none() && scene.time() == BEGIN);
        session.step(secs(0.2));
        assert_eq!(session.hash(), hash, "the same bits");
        assert!(!session.step(secs(1.0)), "and the same end");
        assert_eq!(session.now(), BEGIN + secs(0.4));
    }
    assert_ne!(hash, Session::open("wall").expect("opens").hash());
}

#[test]
fn a_device_that_is_killed_at_the_begin_is_away_for_as_long_as_ever() {
    let app = App::new();
    let scenario = app.scenario("wall").expect("comes with Trocar");
    let plan = FaultPlan::new(1).at(BEGIN).fault(trocar_kernel::faults::FaultKind::Kill, "device.right");
    let options = RunOptions { faults: Some(plan), ..options() };
    let mut session = run::start(&app, &scenario, &options).expect("starts");
    let hand = session.hands()[0].clone();
    session.run_until(BEGIN + secs(0.09));
    assert!(!hand.monitor.sample().state.connected);
    session.run_until(BEGIN + secs(0.25));
    assert!(hand.monitor.sample().state.connected);
}

#[test]
fn in_real_time_drivers_and_controllers_show_the_same_session_time() {
    let app = App::new();
    let scenario = app.scenario("wall").expect("comes with Trocar");
    let options = RunOptions { lockstep: false, seconds: None, ..options() };
    let mut session = run::start(&app, &scenario, &options).expect("starts");
    assert_eq!(session.begin(), BEGIN);
    let hand = session.hands()[0].clone();
    let limit = Instant::now() + Duration::from_secs(20);
    let measured = loop {
        let scene = session.snapshot();
        if let Some(state) = scene.get::<DeviceState>(hand.entity).filter(|state| state.connected) {
            break *state;
        }
        assert!(Instant::now() < limit, "its device is measured");
        std::thread::sleep(Duration::from_millis(1));
    };
    assert!(measured.sampled_at >= BEGIN && measured.sampled_at <= session.now(), "{}", measured.sampled_at);
    let sample = hand.monitor.sample();
    let times = [sample.published_at_ns, sample.sampled_at_ns].map(SimTime);
    assert!(times.iter().all(|time| *time >= BEGIN && *time <= session.now()), "{times:?}");
    session.run_until(session.now() + secs(0.3));
    for row in session.reports() {
        assert!(row.achieved_hz < 1.5 * row.target_hz && row.cpu_share < 2.0, "{row:?}");
        assert!(row.scheduled as f64 <= session.now().since(BEGIN).as_secs_f64() * row.target_hz + 2.0);
    }
    assert!(session.pause());
    let (time, sample) = (session.now(), hand.monitor.sample());
    let later = loop {
        let later = hand.monitor.sample();
        if later.statistics.steps > sample.statistics.steps + 1 {
            break later;
        }
        assert!(Instant::now() < limit, "it is still read");
        std::thread::sleep(Duration::from_millis(1));
    };
    assert_eq!((SimTime(later.published_at_ns), session.now()), (time, time), "both stand still");
    assert!(session.resume());
    let finished = session.finish();
    assert!(finished.outcome.sim >= time);
    assert!(finished.outcome.snapshot.time() >= BEGIN);
}
