//! The exercise's rules, one test each, on scripted observations.

use nalgebra::{Point3, Vector3};
use trocar_scene::Side;
use trocar_tasks::fls_score::FlsWeights;
use trocar_tasks::peg_geometry::{FieldOfView, Peg, RingPlacement, RingShape};
use trocar_tasks::peg_rules::{
    ErrorKind, PegTransferSetup, RingObservation, Rules, TaskEvent, TipObservation,
};
use trocar_tasks::peg_transfer::{Outcome, PegTransfer};

const DT: f64 = 0.01;
const REST: f64 = 0.0015;

fn setup(first_giver: Side) -> PegTransferSetup {
    let peg = |board: usize, column: i32, row: i32| Peg {
        board,
        foot_in_world: Point3::new(
            if board == 0 { -0.04 } else { 0.04 } + 0.028 * f64::from(column),
            0.015 * f64::from(row),
            0.0,
        ),
        axis_in_world: Vector3::z(),
        height: 0.02,
    };
    let board = |board| [-1, 0, 1].into_iter().flat_map(move |c| [-1, 1].map(|r| peg(board, c, r)));
    PegTransferSetup {
        pegs: board(0).chain(board(1)).collect(),
        ring: RingShape { ring_radius: 0.008, tube_radius: 0.0015 },
        first_board: if first_giver == Side::Left { 0 } else { 1 },
        view: FieldOfView::Box { min: Point3::new(-0.1, -0.1, -0.01), max: Point3::new(0.1, 0.1, 0.15) },
        rules: Rules::default(),
        weights: FlsWeights::default(),
    }
}

/// Rings that go where they are told, and hands that hold what they are told.
struct Script {
    setup: PegTransferSetup,
    exercise: PegTransfer,
    secs: f64,
    rings: Vec<RingObservation>,
    happened: Vec<TaskEvent>,
}

impl Script {
    fn new(first_giver: Side) -> Self {
        let setup = setup(first_giver);
        let rings = setup
            .pegs
            .iter()
            .filter(|peg| peg.board == setup.first_board)
            .map(|peg| RingObservation {
                placement: RingPlacement {
                    center_in_world: peg.foot_in_world + Vector3::z() * REST,
                    axis_in_world: Vector3::z(),
                },
                speed: 0.0,
                held_by: [false; 2],
                touched_by: [false; 2],
            })
            .collect::<Vec<_>>();
        let exercise = PegTransfer::new(rings.len(), first_giver);
        Self { setup, exercise, secs: 0.0, rings, happened: Vec::new() }
    }

    fn wait(&mut self, secs: f64) -> &mut Self {
        for _ in 0..(secs / DT).round() as usize {
            self.secs += DT;
            let tip = TipObservation {
                tip_in_world: Point3::new(0.01 * self.secs.sin(), 0.0, 0.05),
                shaft_in_world: -Vector3::z(),
            };
            let happened = self.exercise.observe(&self.setup, self.secs, &self.rings, &[tip; 2]);
            self.happened.extend(happened);
        }
        self
    }
    fn hold(&mut self, ring: usize, hands: &[Side]) -> &mut Self {
        self.rings[ring].held_by = [hands.contains(&Side::Left), hands.contains(&Side::Right)];
        self.wait(0.1)
    }
    fn go(&mut self, ring: usize, x: f64, y: f64, z: f64) -> &mut Self {
        self.rings[ring].placement.center_in_world = Point3::new(x, y, z);
        self.wait(0.1)
    }
    fn go_to_peg(&mut self, ring: usize, peg: usize, z: f64) -> &mut Self {
        let foot = self.setup.pegs[peg].foot_in_world;
        self.go(ring, foot.x, foot.y, z)
    }
    fn free_peg(&self, board: usize) -> usize {
        let free = |peg: &Peg| {
            peg.board == board
                && !self.rings.iter().any(|ring| self.setup.ring.is_around(&ring.placement, peg))
        };
        self.setup.pegs.iter().position(free).expect("a free peg")
    }
    /// A faultless transfer.
    fn transfer(&mut self, ring: usize, giver: Side, board: usize) -> &mut Self {
        let peg = self.free_peg(board);
        self.hold(ring, &[giver]).go(ring, 0.0, 0.0, 0.04).hold(ring, &[giver, giver.other()]);
        self.hold(ring, &[giver.other()]).go_to_peg(ring, peg, REST).hold(ring, &[]).wait(0.3)
    }
    fn errors(&self) -> Vec<ErrorKind> {
        self.exercise.errors().iter().map(|error| error.kind).collect()
    }
    fn count(&self, matches: impl Fn(&TaskEvent) -> bool) -> usize {
        self.happened.iter().filter(|happening| matches(happening)).count()
    }
}

#[test]
fn a_faultless_exercise_completes_with_a_score() {
    for first_giver in [Side::Left, Side::Right] {
        let mut script = Script::new(first_giver);
        let (here, there) = (script.setup.first_board, 1 - script.setup.first_board);
        script.wait(5.0);
        assert_eq!((script.exercise.seconds(), script.exercise.phase()), (0.0, "waiting"));
        for ring in 0..6 {
            script.transfer(ring, first_giver, there);
            assert_eq!(script.exercise.done(), ring as u32 + 1);
        }
        assert_eq!(script.exercise.giver(), first_giver.other());
        assert_eq!(script.exercise.phase(), "back.lift");
        for ring in 0..6 {
            script.transfer(ring, first_giver.other(), here);
        }
        let exercise = &script.exercise;
        assert_eq!(exercise.outcome(), Some(Outcome::Completed));
        assert_eq!((exercise.done(), exercise.steps(), exercise.phase()), (12, 12, "finished"));
        assert_eq!(script.errors(), []);
        assert_eq!(script.count(|h| matches!(h, TaskEvent::Lifted { .. })), 12);
        assert_eq!(script.count(|h| matches!(h, TaskEvent::HandedOver { .. })), 12);
        assert_eq!(script.count(|h| matches!(h, TaskEvent::Placed { .. })), 12);
        assert_eq!(script.count(|h| matches!(h, TaskEvent::Returning)), 1);
        // The clock ran from the first touch at 5 s to the last rest.
        let seconds = exercise.seconds();
        assert!((seconds - (script.secs - 5.0)).abs() < 0.3, "{seconds}");
        let score = exercise.score(&script.setup).unwrap();
        assert!((score - 100.0 * (300.0 - seconds) / 300.0).abs() < 1e-9);
        assert!(exercise.metrics().iter().all(|metrics| metrics.path_length() > 0.0));
    }
}

#[test]
fn a_drop_in_view_is_an_error_and_the_receiver_may_go_on() {
    let mut script = Script::new(Side::Left);
    let both = [Side::Left, Side::Right];
    script.hold(0, &[Side::Left]).go(0, 0.0, 0.0, 0.04).hold(0, &both).hold(0, &[Side::Right]);
    let dropped_after = script.secs;
    script.hold(0, &[]).go(0, 0.0, 0.03, REST).wait(0.5);
    assert_eq!(script.errors(), [ErrorKind::DropInView]);
    let at = script.exercise.errors()[0].at_secs;
    assert!(at > dropped_after && at < dropped_after + 0.1, "{at}");
    script.hold(0, &[Side::Right]).go(0, 0.0, 0.0, 0.04).go_to_peg(0, 6, REST).hold(0, &[]).wait(0.3);
    assert_eq!((script.errors().len(), script.exercise.done()), (1, 1));
}

#[test]
fn a_ring_dropped_before_the_hand_over_must_be_handed_over() {
    let mut script = Script::new(Side::Left);
    script.hold(0, &[Side::Left]).go(0, 0.0, 0.0, 0.04).hold(0, &[]).go(0, 0.0, 0.0, REST).wait(0.5);
    script.hold(0, &[Side::Right]).go(0, 0.0, 0.0, 0.04).go_to_peg(0, 6, REST).hold(0, &[]).wait(0.3);
    assert_eq!(script.errors(), [ErrorKind::DropInView, ErrorKind::WrongHand, ErrorKind::NoHandOver]);
    assert_eq!(script.exercise.done(), 0);
    // From where it lies, done properly.
    script.transfer(0, Side::Left, 1);
    assert_eq!((script.errors().len(), script.exercise.done()), (3, 1));
}

#[test]
fn a_ring_out_of_view_is_lost_and_costs_its_share() {
    let mut script = Script::new(Side::Left);
    script.hold(2, &[Side::Left]).go(2, -0.15, 0.0, 0.04).wait(0.5);
    assert_eq!(script.errors(), [], "held out of view is not lost");
    script.hold(2, &[]).wait(0.1);
    assert_eq!(script.errors(), [ErrorKind::DropOutOfView]);
    for ring in [0, 1, 3, 4, 5] {
        script.transfer(ring, Side::Left, 1);
    }
    for ring in [0, 1, 3, 4, 5] {
        script.transfer(ring, Side::Right, 0);
    }
    let exercise = &script.exercise;
    assert_eq!(exercise.outcome(), Some(Outcome::SomeLost));
    assert_eq!((exercise.done(), exercise.lost()), (10, 1));
    let expected = (300.0 - exercise.seconds() - 100.0 / 6.0) / 3.0;
    assert!((exercise.score(&script.setup).unwrap() - expected).abs() < 1e-9);
}

#[test]
fn a_ring_that_fell_off_the_boards_is_lost_once_it_rests() {
    let mut script = Script::new(Side::Left);
    script.setup.view =
        FieldOfView::Box { min: Point3::new(-0.1, -0.1, -0.1), max: Point3::new(0.1, 0.1, 0.15) };
    script.hold(1, &[Side::Left]).go(1, 0.0, 0.05, 0.04).hold(1, &[]);
    script.rings[1].speed = 0.9;
    script.go(1, 0.0, 0.05, -0.03);
    assert_eq!(script.errors(), [], "it may still bounce");
    script.rings[1].speed = 0.0;
    script.go(1, 0.0, 0.05, -0.05).wait(0.5);
    assert_eq!(script.errors(), [ErrorKind::DropOutOfReach]);
    assert_eq!(script.exercise.lost(), 1);
}

#[test]
fn changing_hands_on_the_board_is_no_hand_over() {
    let mut script = Script::new(Side::Left);
    let both = [Side::Left, Side::Right];
    script.hold(0, &[Side::Left]).go(0, 0.0, 0.0, 0.04).go(0, 0.0, 0.0, 0.004);
    script.hold(0, &both).hold(0, &[Side::Right]).go(0, 0.0, 0.0, 0.04);
    script.go_to_peg(0, 6, REST).hold(0, &[]).wait(0.3);
    assert_eq!(script.errors(), [ErrorKind::NotInMidAir, ErrorKind::NoHandOver]);
}

#[test]
fn a_hand_over_that_is_taken_back_does_not_count() {
    let mut script = Script::new(Side::Left);
    let both = [Side::Left, Side::Right];
    script.hold(0, &[Side::Left]).go(0, 0.0, 0.0, 0.04).hold(0, &both).hold(0, &[Side::Right]);
    script.hold(0, &both).hold(0, &[Side::Left]).go_to_peg(0, 6, REST).hold(0, &[]).wait(0.3);
    assert_eq!(script.errors(), [ErrorKind::NoHandOver]);
}

#[test]
fn one_peg_carries_one_ring() {
    let mut script = Script::new(Side::Left);
    script.transfer(0, Side::Left, 1);
    let both = [Side::Left, Side::Right];
    script.hold(1, &[Side::Left]).go(1, 0.0, 0.0, 0.04).hold(1, &both).hold(1, &[Side::Right]);
    script.go_to_peg(1, 6, 3.0 * REST).hold(1, &[]).wait(0.3);
    assert_eq!((script.errors(), script.exercise.done()), (vec![ErrorKind::PegOccupied], 1));
    script.hold(1, &[Side::Right]).go(1, 0.04, 0.0, 0.04).go_to_peg(1, 7, REST).hold(1, &[]).wait(0.3);
    assert_eq!((script.errors().len(), script.exercise.done()), (1, 2));
}

#[test]
fn a_placed_ring_that_is_knocked_off_must_be_done_again() {
    let mut script = Script::new(Side::Left);
    script.transfer(0, Side::Left, 1);
    script.go(0, 0.0, 0.0, REST);
    assert_eq!((script.errors(), script.exercise.done()), (vec![ErrorKind::Displaced], 0));
    script.transfer(0, Side::Left, 1);
    assert_eq!(script.exercise.done(), 1);
}

#[test]
fn putting_a_ring_back_costs_only_time() {
    let mut script = Script::new(Side::Left);
    script.hold(0, &[Side::Left]).go(0, -0.068, -0.015, 0.03).go(0, -0.068, -0.015, REST).hold(0, &[]);
    script.wait(0.5);
    assert_eq!((script.errors(), script.exercise.done()), (vec![], 0));
    assert_eq!(script.transfer(0, Side::Left, 1).exercise.done(), 1);
}

#[test]
fn short_gaps_in_the_contacts_are_not_a_drop() {
    let mut script = Script::new(Side::Left);
    script.hold(0, &[Side::Left]).go(0, 0.0, 0.0, 0.04);
    for _ in 0..10 {
        script.rings[0].held_by = [false; 2];
        script.wait(0.04);
        script.rings[0].held_by = [true, false];
        script.wait(0.02);
    }
    assert_eq!(script.count(|h| matches!(h, TaskEvent::Lifted { .. })), 1);
    assert_eq!(script.exercise.phase(), "over.hand_over");
}

#[test]
fn the_cutoff_ends_the_exercise_with_score_zero() {
    let mut script = Script::new(Side::Left);
    script.transfer(0, Side::Left, 1).wait(300.0);
    let exercise = &script.exercise;
    assert_eq!((exercise.outcome(), exercise.score(&script.setup)), (Some(Outcome::CutOff), Some(0.0)));
    assert!((exercise.seconds() - 300.0).abs() < 2.0 * DT);
    let (done, seconds) = (exercise.done(), exercise.seconds());
    script.transfer(1, Side::Left, 1);
    assert_eq!(
        (script.exercise.done(), script.exercise.seconds()),
        (done, seconds),
        "nothing counts after it"
    );
}

#[test]
fn a_restart_from_the_stored_state_changes_nothing() {
    let mut script = Script::new(Side::Left);
    let mut twin = Script::new(Side::Left);
    for (step, ring) in [0usize, 1, 2].into_iter().enumerate() {
        script.transfer(ring, Side::Left, 1);
        twin.transfer(ring, Side::Left, 1);
        if step == 1 {
            twin.hold(2, &[Side::Left]).go(2, 0.0, 0.0, 0.04);
            script.hold(2, &[Side::Left]).go(2, 0.0, 0.0, 0.04);
        }
        let bytes = postcard::to_stdvec(&twin.exercise).unwrap();
        twin.exercise = postcard::from_bytes(&bytes).unwrap();
    }
    assert_eq!(script.exercise, twin.exercise);
    assert_eq!(script.happened, twin.happened);
}
