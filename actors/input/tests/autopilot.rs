//! The trainee's strategy on a kinematic double: whole exercises in milliseconds.

use crate::support::Double;
use nalgebra::Vector3;
use trocar_input::motor_model::{MotorParameters, Skill};
use trocar_input::strategy::Step;
use trocar_scene::Side;

#[test]
fn every_skill_and_both_handednesses_carry_all_rings_over_and_back() {
    for skill in [Skill::Novice, Skill::Intermediate, Skill::Expert] {
        for giver in [Side::Left, Side::Right] {
            let mut double = Double::new(giver, MotorParameters::of(skill), 1);
            let first = double.bench.first_board;
            let mut over = 0;
            while double.secs < 300.0 && !double.trainee.finished() {
                double.tick();
                over = over.max(double.on_board(1 - first));
            }
            assert!(double.trainee.finished(), "{skill:?} {giver:?}: {:?}", double.trainee.steps());
            assert_eq!((over, double.on_board(first)), (6, 6), "{skill:?} {giver:?}");
        }
    }
}

#[test]
fn the_faster_hand_is_done_sooner_over_twenty_seeds() {
    let median = |skill| {
        let mut times: Vec<f64> = (0..20)
            .map(|seed| {
                let mut double = Double::new(Side::Left, MotorParameters::of(skill), seed);
                assert!(double.run(300.0), "{skill:?} seed {seed}");
                double.secs
            })
            .collect();
        times.sort_by(f64::total_cmp);
        0.5 * (times[9] + times[10])
    };
    let (novice, intermediate, expert) =
        (median(Skill::Novice), median(Skill::Intermediate), median(Skill::Expert));
    assert!(expert < 0.8 * intermediate && intermediate < 0.8 * novice, "{expert} {intermediate} {novice}");
}

#[test]
fn pinches_that_hold_nothing_are_tried_again() {
    let mut double = Double::new(Side::Left, MotorParameters::of(Skill::Expert), 4);
    double.slips = |closing| closing % 3 == 1;
    assert!(double.run(300.0), "{:?}", double.trainee.steps());
    assert_eq!(double.on_board(0), 6);
    assert!(double.closings >= 36, "{}", double.closings);
}

#[test]
fn a_ring_that_slips_away_is_picked_up_where_it_lies() {
    // Once from the giver, before the hand-over, and once from the receiver, after it.
    for (hand, at) in [(0, "bring"), (1, "over")] {
        let mut double = Double::new(Side::Left, MotorParameters::of(Skill::Expert), 5);
        let mut snatched = None;
        let mut lifted_by = Vec::new();
        let mut before = ["", ""];
        while double.secs < 300.0 && !double.trainee.finished() {
            double.tick();
            let steps = double.trainee.steps().map(|step| step.name());
            let ring = double.trainee.rings()[hand];
            let half_way = double.moment.hands[hand].tip.translation.vector.x.abs() < 0.03;
            if snatched.is_none() && steps[hand] == at && half_way {
                snatched = ring;
                double.release(hand);
            }
            for side in 0..2 {
                if snatched.is_some()
                    && double.trainee.rings()[side] == snatched
                    && steps[side] == "lift"
                    && before[side] != "lift"
                    && !double.trainee.returning()
                {
                    lifted_by.push(side);
                }
            }
            before = steps;
        }
        assert!(snatched.is_some() && double.trainee.finished(), "{at}: {:?}", double.trainee.steps());
        assert_eq!(lifted_by, [hand], "whoever dropped it picks it up: {at}");
        assert_eq!(double.on_board(0), 6);
    }
}

#[test]
fn a_ring_out_of_reach_does_not_keep_the_others_waiting() {
    let mut double = Double::new(Side::Left, MotorParameters::of(Skill::Expert), 6);
    // On the floor beside the boards.
    double.moment.rings[3].pose.translation.vector = Vector3::new(0.0, 0.2, -0.05);
    assert!(double.run(300.0));
    assert_eq!(double.on_board(0), 5);
}

#[test]
fn a_trainee_from_the_stored_state_continues_with_the_same_bits() {
    let parameters = MotorParameters::of(Skill::Novice);
    let mut whole = Double::new(Side::Left, parameters, 7);
    let mut stored = Double::new(Side::Left, parameters, 7);
    for tick in 0..4000 {
        whole.tick();
        if tick % 97 == 0 {
            stored.trainee = postcard::from_bytes(&postcard::to_stdvec(&stored.trainee).unwrap()).unwrap();
        }
        stored.tick();
        assert_eq!(whole.moment, stored.moment, "tick {tick}");
    }
    assert_eq!(whole.trainee, stored.trainee);
}

#[test]
fn a_receiver_does_not_chase_a_ring_that_is_no_longer_offered() {
    let mut double = Double::new(Side::Left, MotorParameters::of(Skill::Expert), 8);
    while !matches!(double.trainee.steps()[1], Step::Enter(_)) {
        double.tick();
        assert!(double.secs < 20.0);
    }
    double.release(0);
    for _ in 0..40 {
        double.tick();
    }
    let receiver = double.trainee.steps()[1].name();
    assert!(matches!(receiver, "open" | "back" | "rest"), "{receiver}");
    assert!(double.run(300.0));
    assert_eq!(double.on_board(0), 6);
}

#[test]
fn shafts_keep_apart_and_tips_stay_above_the_boards() {
    let mut double = Double::new(Side::Left, MotorParameters::of(Skill::Expert), 9);
    let (mut nearest, mut lowest) = (f64::INFINITY, f64::INFINITY);
    while double.secs < 300.0 && !double.trainee.finished() {
        double.tick();
        let [left, right] = double.moment.hands.map(|hand| hand.tip);
        // Behind the jaws, where the shafts are.
        for along in (0..20).map(|i| 0.018 + 0.005 * f64::from(i)) {
            for across in (0..20).map(|i| 0.018 + 0.005 * f64::from(i)) {
                let on_left = left * nalgebra::Point3::new(0.0, 0.0, -along);
                let on_right = right * nalgebra::Point3::new(0.0, 0.0, -across);
                nearest = nearest.min((on_left - on_right).norm());
            }
        }
        lowest = lowest.min(left.translation.vector.z).min(right.translation.vector.z);
    }
    assert!(nearest > 0.006, "{nearest}");
    assert!(lowest > -0.001, "{lowest}");
}
