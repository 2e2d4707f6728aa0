//! Sessions with reflected hands are reset and branched in virtual time, with what is under way on the path.

use trocar::session::Session;
use trocar_scene::{Hand, SimTime, Teleoperation};

use super::{over, starting, steps};

/// A hand that goes to and fro, with its foot on the pedal for a while.
const SWING: &str = "
    { seconds = 0.4, to = [-0.040, -0.005, 0.060], jaws = 0.5 },
    { seconds = 0.4, to = [0.010, -0.005, 0.060], level = 1.0 },
    { seconds = 0.4, to = [-0.040, -0.005, 0.060], level = 0.0, jaws = 0.0 },
    { seconds = 0.4, to = [0.010, -0.005, 0.060] },
    { seconds = 0.4, to = [-0.040, -0.005, 0.060] },
";

fn swinging() -> Session {
    starting(&[steps(SWING), over("loss = 0.05\nburst = 3.0\nreorder = 0.05", 0.15057)])
}

fn row(session: &mut Session) -> Teleoperation {
    let scene = session.snapshot();
    let (hand, _) = scene.iter::<Hand>().next().expect("a hand");
    scene.get::<Teleoperation>(hand).cloned().expect("it is told")
}

#[test]
fn a_session_that_is_reset_does_the_same_again() {
    let mut session = swinging();
    session.step(SimTime::from_millis(1_200));
    let (hash, told) = (session.hash(), row(&mut session));
    session.reset().expect("it can begin again");
    assert_eq!(session.now(), SimTime::ZERO);
    session.step(SimTime::from_millis(100));
    assert_eq!(row(&mut session).figures.received, 0, "nothing of before is under way");
    session.step(SimTime::from_millis(1_100));
    assert_eq!((session.hash(), row(&mut session)), (hash, told));
}

#[test]
fn a_branch_goes_on_as_the_session_does_and_they_share_no_path() {
    let mut session = swinging();
    session.step(SimTime::from_millis(700));
    let (mut one, mut other) = (session.branch().expect("a branch"), session.branch().expect("another"));
    session.step(SimTime::from_millis(600));
    one.step(SimTime::from_millis(600));
    assert_eq!((one.hash(), row(&mut one)), (session.hash(), row(&mut session)));
    assert!(row(&mut one).figures.received > 900);
    // A branch of a branch, and the one that waited meanwhile.
    let mut further = one.branch().expect("a branch of a branch");
    other.step(SimTime::from_millis(800));
    further.step(SimTime::from_millis(200));
    session.step(SimTime::from_millis(200));
    assert_eq!((other.hash(), further.hash()), (session.hash(), session.hash()));
    one.reset().expect("a branch can begin again");
    one.step(SimTime::from_millis(1_500));
    assert_eq!(one.hash(), session.hash());
}

#[test]
fn from_a_past_scene_the_slave_stands_for_a_round_trip_and_comes_back_to_its_master() {
    let mut session = swinging();
    session.step(SimTime::from_millis(900));
    let past = session.snapshot();
    session.step(SimTime::from_millis(300));
    let mut branch = session.branch_from(&past).expect("a branch");
    branch.step(SimTime::from_millis(10));
    let from = row(&mut branch).slave_in_world.translation;
    branch.step(SimTime::from_millis(130));
    let stood = row(&mut branch).slave_in_world.translation;
    assert!((stood - from).norm() < 1e-6, "{}", (stood - from).norm());
    // At the end of the movement both are where the master rests.
    branch.step(SimTime::from_millis(2_000));
    let told = row(&mut branch);
    let apart = (told.slave_in_world.translation - told.master_in_world.translation).norm();
    assert!(apart < 1e-4, "{apart} m");
}
