//! Sessions from a researcher's program: opened, stepped, written to, reset, branched, and many in parallel.

use nalgebra::Vector3;
use trocar::prelude::*;
use trocar::run::RunOptions;
use trocar_kernel::recorder::{Recording, Replay};
use trocar_tests::{Names, app, finish, for_seeds, lockstep, names, peg_transfer};

const MS: SimTime = SimTime::from_millis(1);

/// The ring that some instrument holds above the board.
fn carried(scene: &Snapshot, names: &Names) -> Option<Entity> {
    let held = names.instruments.iter().find_map(|instrument| scene.get::<Grasp>(*instrument));
    held.map(|grasp| grasp.held).filter(|ring| scene.world_pose(*ring).translation.z > 0.02)
}

/// Runs until a ring has been carried for `milliseconds`.
fn carry(session: &mut Session, milliseconds: u64) -> Entity {
    let names = names(&session.snapshot());
    let mut since = 0;
    while session.now() < SimTime::from_millis(30_000) {
        session.step(MS);
        since = if carried(&session.snapshot(), &names).is_some() { since + 1 } else { 0 };
        if since >= milliseconds {
            return carried(&session.snapshot(), &names).expect("just seen");
        }
    }
    panic!("no ring was carried within 30 s");
}

fn open(seed: u64) -> Session {
    Session::builder().seed(seed).open("peg-transfer").expect("opens")
}

fn hash_after(session: &mut Session, milliseconds: u64) -> String {
    session.step(SimTime::from_millis(milliseconds));
    session.hash().expect("in virtual time").to_string()
}

#[test]
fn branches_of_one_moment_are_alike_and_their_parent_is_as_it_was() {
    let mut unbranched = open(3);
    let ring = carry(&mut unbranched, 300);
    let mut parent = open(3);
    assert_eq!(carry(&mut parent, 300), ring);
    let names = names(&parent.snapshot());
    let (mut one, mut other) = (parent.branch().expect("branches"), parent.branch().expect("branches"));
    assert_eq!((one.hash(), one.now()), (parent.hash(), parent.now()));
    assert_eq!(hash_after(&mut one, 700), hash_after(&mut other, 700));
    // A branch of a branch, and one from the moment of the first two branches.
    let mut grandchild = other.branch().expect("branches");
    let mut twin = other.branch().expect("branches");
    assert_eq!(hash_after(&mut grandchild, 500), hash_after(&mut twin, 500));
    let snapshot = parent.snapshot();
    assert_eq!(hash_after(&mut parent, 2_000), hash_after(&mut unbranched, 2_000));
    let past = |session: &Session| session.branch_from(&snapshot).expect("branches");
    let (mut late, mut later) = (past(&parent), past(&parent));
    assert_eq!(carried(&late.snapshot(), &names), Some(ring));
    assert_eq!(hash_after(&mut late, 700), hash_after(&mut later, 700));
    // A write into one of them makes it differ.
    let lighter = |out: &mut Commands, scene: &Snapshot| {
        let mut body = scene.get::<RigidBody>(ring).cloned().expect("a body");
        body.mass *= 0.5;
        out.put(ring, body);
    };
    let mut written = past(&parent);
    let scene = written.snapshot();
    written.apply(|out| lighter(out, &scene)).expect("applied");
    assert_ne!(hash_after(&mut written, 700), late.hash().expect("in virtual time").to_string());
}

#[test]
fn a_branch_taken_while_a_ring_is_carried_completes_the_exercise() {
    let seeds = [(1, false), (2, true)];
    for_seeds(&[0, 1], |index| {
        let (seed, from_the_past) = seeds[index as usize];
        let mut parent = open(seed);
        let ring = carry(&mut parent, 400);
        let names = names(&parent.snapshot());
        let done = parent.task();
        let mut branch = if from_the_past {
            let snapshot = parent.snapshot();
            parent.step(SimTime::from_millis(50));
            parent.branch_from(&snapshot).expect("branches")
        } else {
            parent.branch().expect("branches")
        };
        branch.step(SimTime::from_millis(20));
        assert_eq!(carried(&branch.snapshot(), &names), Some(ring), "it is still held");
        assert!(branch.task().seconds >= done.seconds, "the clock of the exercise goes on");
        while branch.step(SimTime::from_millis(500)) {}
        let task = branch.task();
        assert!(task.completed && task.score.is_some() && task.errors.is_empty(), "{task:?}");
        assert!(task.seconds > 40.0 && task.seconds < 120.0, "{task:?}");
    });
}

/// Largest change of the carried ring's position \[m\] and of a hand's force \[N\] from one millisecond to the next.
fn jumps(session: &mut Session, ring: Entity, before: &Snapshot, milliseconds: u64) -> (f64, f64) {
    let names = names(before);
    let look = |scene: &Snapshot| {
        let force = |hand: Entity| scene.get::<DeviceForce>(hand).map_or(Vector3::zeros(), |f| f.force);
        let felt =
            |hand: Entity| scene.get::<DeviceState>(hand).map_or(Vector3::zeros(), |s| s.applied_force);
        (scene.world_pose(ring).translation.vector, names.hands.map(force), names.hands.map(felt))
    };
    let (mut last, mut jump) = (look(before), (0.0_f64, 0.0_f64));
    for _ in 0..milliseconds {
        session.step(MS);
        let now = look(&session.snapshot());
        jump.0 = jump.0.max((now.0 - last.0).norm());
        for side in 0..2 {
            jump.1 = jump.1.max((now.1[side] - last.1[side]).norm());
            jump.1 = jump.1.max((now.2[side] - last.2[side]).norm());
        }
        last = now;
    }
    jump
}

#[test]
fn a_hand_feels_no_jump_where_a_session_is_branched() {
    let seeds: Vec<u64> = (1..=12).collect();
    let figures = for_seeds(&seeds, |seed| {
        let mut parent = open(seed);
        let ring = carry(&mut parent, 100 + 97 * seed);
        let before = parent.snapshot();
        let mut branch = parent.branch().expect("branches");
        parent.step(SimTime::from_millis(30));
        let mut past = parent.branch_from(&before).expect("branches");
        let present = jumps(&mut branch, ring, &before, 100);
        let past = jumps(&mut past, ring, &before, 100);
        (present, past)
    });
    let worst = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
    let pose = [worst(&mut figures.iter().map(|f| f.0.0)), worst(&mut figures.iter().map(|f| f.1.0))];
    let force = [worst(&mut figures.iter().map(|f| f.0.1)), worst(&mut figures.iter().map(|f| f.1.1))];
    println!(
        "present, past: pose jump {:.3}, {:.3} mm; force jump {force:.3?} N",
        pose[0] * 1e3,
        pose[1] * 1e3
    );
    // As after a restart of the engine.
    assert!(pose.iter().all(|jump| *jump <= 1e-3), "pose jump {pose:?} m");
    assert!(force.iter().all(|jump| *jump <= 0.5), "force jump {force:?} N");
}

#[test]
fn beginning_again_gives_the_same_bits_and_another_seed_those_of_that_seed() {
    let mut session = open(5);
    let first = hash_after(&mut session, 3_000);
    session.apply(|out| out.event("told", Entity::new(0, 0, 1), None, 1.0)).expect("applied");
    session.reset().expect("begins again");
    assert_eq!((session.now(), session.snapshot().events().next()), (SimTime::ZERO, 0));
    assert_eq!(hash_after(&mut session, 3_000), first);
    session.reset_with_seed(6).expect("begins again");
    assert_eq!(hash_after(&mut session, 3_000), hash_after(&mut open(6), 3_000));
    // A reset branch restarts at time zero, not where it branched off.
    let mut branch = session.branch().expect("branches");
    branch.reset_with_seed(5).expect("begins again");
    assert_eq!(hash_after(&mut branch, 3_000), first);
    let app = app();
    let options = RunOptions { seconds: Some(3.0), ..lockstep(5) };
    let run = finish(&app, &peg_transfer(&app, &[]), &options).summary.state_hash;
    assert_eq!(run.as_deref(), Some(first.as_str()), "the same as a run of the program");
}

#[test]
fn sessions_side_by_side_give_the_bits_that_each_gives_alone() {
    let simulate = |seed: u64| hash_after(&mut open(seed), 4_000);
    let alone: Vec<String> = (1..=4).map(simulate).collect();
    let together = std::thread::scope(|scope| {
        let threads: Vec<_> = (1..=4).map(|seed| scope.spawn(move || simulate(seed))).collect();
        threads.into_iter().map(|thread| thread.join().expect("no panic")).collect::<Vec<_>>()
    });
    assert_eq!(alone, together);
    // Branches on threads of their own, while their parent goes on.
    let mut parent = open(1);
    carry(&mut parent, 200);
    let branches: Vec<Session> = (0..3).map(|_| parent.branch().expect("branches")).collect();
    let hashes = std::thread::scope(|scope| {
        let ends = branches.into_iter().map(|mut branch| scope.spawn(move || hash_after(&mut branch, 1_000)));
        let ends: Vec<_> = ends.collect();
        parent.step(SimTime::from_millis(1_000));
        ends.into_iter().map(|end| end.join().expect("no panic")).collect::<Vec<_>>()
    });
    assert!(hashes.iter().all(|hash| *hash == hashes[0]), "{hashes:?}");
}

#[test]
fn what_is_written_from_outside_is_recorded_replayed_and_can_be_branched_from() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("operated.mcap");
    let app = app();
    let builder = || Session::builder().app(&app).seed(4);
    let mut session = builder().record(&file).open("peg-transfer").expect("opens");
    let ring = carry(&mut session, 300);
    // Teleported out of the jaws: the engine continues from there.
    let pose = Pose::at(0.0, 0.0, 0.05);
    session.apply(|out| out.put(ring, pose)).expect("applied");
    session.step(SimTime::from_millis(300));
    let fallen = session.snapshot().world_pose(ring).translation.vector;
    assert!((fallen - pose.translation).norm() > 0.01 && fallen.z < 0.05, "it falls from there: {fallen:?}");
    let (until, hash) = (session.now(), session.hash().expect("in virtual time"));
    assert_eq!(session.finish().outcome.recording_complete, Some(true));
    let recording = Recording::open(&file).expect("opens");
    let mut replay = Replay::new(&recording, app.registry()).expect("has a keyframe");
    replay.run_to_end().expect("agrees");
    assert_eq!(recording.end().expect("closed").state_hash, hash.to_string());
    // A snapshot of a recording is as good as one of a session.
    let live = builder().open("peg-transfer").expect("opens");
    let branch = || live.branch_from(replay.view()).expect("branches");
    let (mut one, mut other) = (branch(), branch());
    assert!(one.now() <= until && one.now() + SimTime::from_millis(5) > until);
    assert_eq!(hash_after(&mut one, 500), hash_after(&mut other, 500));
}

#[test]
fn what_cannot_be_opened_or_branched_is_named() {
    fn sendable<T: Send>(value: T) -> T {
        value
    }
    let live =
        trocar::run::start(&app(), &peg_transfer(&app(), &[]), &RunOptions::default()).expect("starts");
    assert!(matches!(live.branch(), Err(BranchError::Live)));
    sendable(live).finish();
    let error = |result: Result<Session, OpenError>| result.err().expect("refused").to_string();
    assert!(error(Session::open("peg-transfe")).contains("peg-transfer, wall"));
    let unknown = Session::builder().without("auto").open("peg-transfer");
    assert!(error(unknown).contains("autopilot"), "it lists what there is");
    assert!(error(Session::builder().hand("third", "virtual").open("wall")).contains("third"));
}
