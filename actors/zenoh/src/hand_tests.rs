//! A hand that is commanded from elsewhere: claims, the door, and what is answered.

use proptest::prelude::*;

use super::*;
use crate::json_testing::any_value;

const MS: u64 = 1_000_000;
const CODE: ClaimCode = ClaimCode(7);

fn command(sequence: u64, x: f64) -> Vec<u8> {
    json!({ "claim": CODE.to_string(), "sequence": sequence, "position": [x, 0.0, 0.0] })
        .to_string()
        .into_bytes()
}

/// Steps the device for `millis`, a command `x(ms)` each 10 ms if there is one; returns the fastest motion [m/s].
fn run(
    hand: &mut ZenohHand,
    lane: &mut HandLane,
    ms: &mut u64,
    millis: u64,
    x: impl Fn(u64) -> Option<f64>,
) -> f64 {
    let (mut fastest, mut before) = (0.0_f64, None);
    for _ in 0..millis {
        *ms += 1;
        if let Some(x) = x(*ms).filter(|_| ms.is_multiple_of(10)) {
            lane.command(SimTime(*ms * MS), &command(*ms, x)).expect("it is admitted");
        }
        let x = hand.read(*ms * MS).expect("it is open").pose_in_device.translation.x;
        fastest = fastest.max(before.map_or(0.0, |before: f64| (x - before).abs() * 1e3));
        before = Some(x);
    }
    fastest
}

#[test]
fn a_hand_follows_who_has_claimed_it_and_passes_the_door() {
    let (mut hand, mut lane) = ZenohHand::new(false).expect("a hand");
    hand.open(0).expect("it opens");
    assert!(!hand.read(MS).expect("it is open").connected, "nobody has it");
    assert!(lane.command(SimTime(MS), &command(1, 0.0)).is_err_and(|told| told.contains("claim")));
    lane.claim(SimTime(MS), CODE).expect("it is free");
    let mut ms = 1;
    run(&mut hand, &mut lane, &mut ms, 200, |_| Some(0.0));
    assert!(hand.read(ms * MS).expect("open").connected);
    // A jump of a metre: an approach at the door's speed, to the wall of the workspace.
    let fastest = run(&mut hand, &mut lane, &mut ms, 500, |_| Some(1.0));
    assert!(fastest > 0.3 && fastest <= 1.0 + 1e-6, "{fastest} m/s");
    let answer = lane.answer().expect("it answers");
    assert_eq!(answer["presence"], "live");
    let at = answer["position"][0].as_f64().expect("a number");
    assert!((at - 0.08).abs() < 1e-6, "{at}");
    assert!(answer["clamped"].as_u64().is_some_and(|count| count > 0));
}

#[test]
fn silence_stops_the_hand_and_releases_its_buttons() {
    let (mut hand, mut lane) = ZenohHand::new(false).expect("a hand");
    hand.open(0).expect("it opens");
    lane.claim(SimTime(0), CODE).expect("it is free");
    let mut ms = 0;
    run(&mut hand, &mut lane, &mut ms, 100, |_| Some(0.0));
    let pressed =
        json!({ "claim": CODE.to_string(), "sequence": 1_000, "position": [0, 0, 0], "buttons": 1 });
    lane.command(SimTime(ms * MS), pressed.to_string().as_bytes()).expect("admitted");
    run(&mut hand, &mut lane, &mut ms, 5, |_| None);
    assert_eq!(hand.read(ms * MS).expect("open").buttons, 1);
    run(&mut hand, &mut lane, &mut ms, 120, |_| None);
    let still = hand.read(ms * MS).expect("open");
    assert_eq!((still.buttons, still.connected), (0, true));
    assert_eq!(lane.answer().expect("an answer")["presence"], "silent");
    assert_eq!(run(&mut hand, &mut lane, &mut ms, 300, |_| None), 0.0, "it holds still");
}

#[test]
fn what_is_no_command_is_refused_and_counted() {
    let (mut hand, mut lane) = ZenohHand::new(true).expect("a hand");
    hand.open(0).expect("it opens");
    lane.claim(SimTime(0), CODE).expect("it is free");
    let long = vec![b' '; COMMAND_MAX + 1];
    let other =
        json!({ "claim": ClaimCode(8).to_string(), "sequence": 1, "position": [0, 0, 0] }).to_string();
    for wrong in [&b"{}"[..], b"\xff", b"null", &long, other.as_bytes()] {
        assert!(lane.command(SimTime(MS), wrong).is_err());
    }
    // Numbers that are none pass JSON as null only; a rotation that is none is the door's affair.
    let turned =
        json!({ "claim": CODE.to_string(), "sequence": 1, "position": [0, 0, 0], "rotation": [0, 0, 0, 9] });
    lane.command(SimTime(MS), turned.to_string().as_bytes()).expect("the door judges");
    hand.read(2 * MS).expect("open");
    assert_eq!(lane.answer().expect("an answer")["refused"], 6);
}

#[test]
fn a_hand_needs_a_node_and_a_name_of_its_own_and_says_who_reaches_it() {
    let board = HandBoard::default();
    assert!(board.device("right").err().expect("refused").contains("--zenoh"));
    board.open(false);
    let hand = board.device("right").expect("a hand");
    assert!(hand.capabilities().name.ends_with("(unprotected)"));
    assert!(board.device("right").err().expect("refused").contains("two hands"));
    assert!(board.device("a/b").is_err());
    assert_eq!(board.names(), ["right"]);
    board.open(true);
    assert!(board.names().is_empty(), "the next session begins anew");
    assert_eq!(board.device("right").expect("a hand").capabilities().name, MODEL);
}

/// What somebody sends who has the claim, or not: numbers of any size, JSON of any form, any bytes.
fn any_command() -> impl Strategy<Value = Vec<u8>> {
    let numbers = (any::<[f64; 3]>(), any::<[f64; 4]>(), any::<f64>(), any::<u32>(), any::<u8>());
    let near = any::<[f64; 3]>().prop_map(|place| place.map(|x| x.sin() * 0.2));
    let command = |position: [f64; 3], rotation: [f64; 4], gripper: f64, buttons: u32, sequence: u8| {
        json!({
            "claim": CODE.to_string(), "sequence": sequence, "position": position, "rotation": rotation,
            "gripper": gripper, "buttons": buttons,
        })
        .to_string()
        .into_bytes()
    };
    prop_oneof![
        numbers.prop_map(move |(position, rotation, gripper, buttons, sequence)| {
            command(position, rotation, gripper, buttons, sequence)
        }),
        (near, any::<u32>(), any::<u8>()).prop_map(move |(at, buttons, sequence)| command(
            at,
            upright(),
            0.3,
            buttons,
            sequence
        )),
        any_value().prop_map(|value| value.to_string().into_bytes()),
        prop::collection::vec(any::<u8>(), 0..200),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(200) })]

    #[test]
    fn whatever_is_commanded_the_hand_is_within_its_workspace_and_its_speed(
        commands in prop::collection::vec((any_command(), 0..150_u64), 1..20),
    ) {
        let (mut hand, mut lane) = ZenohHand::new(false).expect("a hand");
        hand.open(0).expect("it opens");
        lane.claim(SimTime(0), CODE).expect("it is free");
        let (mut ms, mut before, mut sent) = (0, None::<Vector3<f64>>, 0);
        for (payload, millis) in commands {
            sent += 1;
            // Taken, or refused in words.
            let _ = lane.command(SimTime(ms * MS), &payload);
            for _ in 0..=millis {
                ms += 1;
                let state = hand.read(ms * MS).expect("it is open");
                prop_assert!(state.is_valid(), "{state:?}");
                let place = state.pose_in_device.translation.vector;
                prop_assert!(place.iter().zip([0.08, 0.06, 0.035]).all(|(x, edge)| x.abs() <= edge + 1e-9));
                prop_assert!((0.0..=DoorLimits::default().gripper_max).contains(&state.gripper));
                if let Some(before) = before.filter(|_| state.connected) {
                    let moved = (place - before).norm();
                    prop_assert!(moved <= 1e-3 + 1e-9, "{moved} m in a millisecond");
                }
                before = state.connected.then_some(place);
            }
        }
        let answer = lane.answer().expect("it answers");
        let refused = answer["refused"].as_u64().expect("a number");
        let posted = answer["commands"].as_u64().expect("a number");
        // A command that the device never saw was overtaken by a newer one.
        prop_assert!(refused <= sent && posted <= sent, "{answer}");
    }
}
