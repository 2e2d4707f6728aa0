//! The engine dies in the middle of a hand-over: the ring is still held after the restart.

use trocar::run::{RunOptions, start};
use trocar::session::Session;
use trocar_kernel::faults::FaultPlan;
use trocar_scene::{DeviceForce, Entity, Grasp, Pose, SimTime, Snapshot};
use trocar_test_support::thorough;
use trocar_tests::{Names, app, for_seeds, lockstep, names, peg_transfer};

const TICK: SimTime = SimTime::from_millis(2);

/// The ring that both instruments hold.
fn held_by_both(scene: &Snapshot, names: &Names) -> Option<Entity> {
    let held = names.instruments.map(|instrument| scene.get::<Grasp>(instrument).map(|grasp| grasp.held));
    if held[0] == held[1] { held[0] } else { None }
}

fn forces(scene: &Snapshot, names: &Names) -> [nalgebra::Vector3<f64>; 2] {
    names.hands.map(|hand| scene.get::<DeviceForce>(hand).map_or_else(Default::default, |force| force.force))
}

/// Runs to the first hand-over and returns the times at which both hands hold the ring.
fn first_hand_over(session: &mut Session) -> Vec<SimTime> {
    let names = names(&session.snapshot());
    let mut times = Vec::new();
    let mut now = SimTime::ZERO;
    while now < SimTime::from_millis(30_000) {
        now += TICK;
        session.run_until(now);
        match held_by_both(&session.snapshot(), &names) {
            Some(_) => times.push(now),
            None if !times.is_empty() => break,
            None => {}
        }
    }
    times
}

#[test]
fn the_ring_stays_in_both_hands_when_the_engine_dies_during_a_hand_over() {
    survives(&[], if thorough() { 50 } else { 12 });
}

#[test]
fn so_it_does_with_rigid_bodies_of_our_own() {
    survives(&[(r#"kind = "rapier""#, r#"kind = "rigid-bodies""#)], if thorough() { 20 } else { 6 });
}

fn survives(replacements: &[(&str, &str)], seeds: u64) {
    let app = app();
    let scenario = peg_transfer(&app, replacements);
    let seeds: Vec<u64> = (1..=seeds).collect();
    let figures = for_seeds(&seeds, |seed| {
        let times = first_hand_over(&mut start(&app, &scenario, &lockstep(seed)).expect("starts"));
        assert!(times.len() > 10, "seed {seed}: no hand-over within 30 s");
        // A tick in the middle of it, spread over the seeds without favouring a phase.
        let at = times[(seed as usize * 7_919) % (times.len() - 5)];
        let faults = Some(FaultPlan::new(seed).at(at).kill("engine"));
        let mut session = start(&app, &scenario, &RunOptions { faults, ..lockstep(seed) }).expect("starts");
        session.run_until(SimTime(at.0 - 1));
        let before = session.snapshot();
        let names = names(&before);
        let ring = held_by_both(&before, &names).expect("both hold the ring");
        let (mut pose, mut force) = (before.world_pose(ring).translation.vector, forces(&before, &names));
        let changed = before.changed::<Pose>(ring);
        let (mut pose_jump, mut force_jump, mut resumed) = (0.0_f64, 0.0_f64, false);
        let mut now = at;
        while now < at + SimTime::from_millis(100) {
            session.run_until(now);
            let scene = session.snapshot();
            if scene.changed::<Pose>(ring) != changed && !resumed {
                resumed = true;
                assert!(now - at <= SimTime::from_millis(50), "seed {seed}: resumed only after {}", now - at);
                assert_eq!(held_by_both(&scene, &names), Some(ring), "seed {seed}: dropped by the restart");
            }
            let (pose_now, force_now) = (scene.world_pose(ring).translation.vector, forces(&scene, &names));
            pose_jump = pose_jump.max((pose_now - pose).norm());
            for side in 0..2 {
                force_jump = force_jump.max((force_now[side] - force[side]).norm());
            }
            (pose, force) = (pose_now, force_now);
            now += SimTime::from_millis(1);
        }
        assert!(resumed, "seed {seed}: the engine never came back");
        let held = session.snapshot();
        let still = names.instruments.iter().any(|i| held.get::<Grasp>(*i).is_some_and(|g| g.held == ring));
        assert!(still, "seed {seed}: lost within 100 ms");
        (pose_jump, force_jump)
    });
    let pose_jump = figures.iter().map(|f| f.0).fold(0.0, f64::max);
    let force_jump = figures.iter().map(|f| f.1).fold(0.0, f64::max);
    println!(
        "largest pose jump {:.3} mm, force jump {force_jump:.3} N over {} seeds",
        pose_jump * 1e3,
        seeds.len()
    );
    assert!(pose_jump <= 1e-3, "pose jump {pose_jump} m");
    assert!(force_jump <= 0.5, "force jump {force_jump} N");
}
