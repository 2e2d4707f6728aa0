//! A hand that is commanded from elsewhere: claims, the door, and what is answered.

use super::*;

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
