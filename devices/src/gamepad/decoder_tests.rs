use super::*;
use proptest::prelude::*;

/// The bytes that the kernel writes for an event.
fn event(kind: u16, code: u16, value: i32) -> [u8; INPUT_EVENT_BYTES] {
    let mut bytes = [0; INPUT_EVENT_BYTES];
    let end = INPUT_EVENT_BYTES;
    bytes[end - 8..end - 6].copy_from_slice(&kind.to_ne_bytes());
    bytes[end - 6..end - 4].copy_from_slice(&code.to_ne_bytes());
    bytes[end - 4..].copy_from_slice(&value.to_ne_bytes());
    bytes
}
fn report() -> [u8; INPUT_EVENT_BYTES] {
    event(EV_SYN, SYN_REPORT, 0)
}
fn axis(code: u16, min: i32, max: i32) -> AbsRange {
    AbsRange { code, value: min + (max - min) / 2, min, max, flat: 0 }
}
/// The axes of the commonest pads (xpad): sticks of 16 bits, triggers of 8, a hat.
fn common_axes() -> Vec<AbsRange> {
    let sticks = [ABS_X, ABS_Y, ABS_RX, ABS_RY].map(|code| axis(code, -32_768, 32_767));
    let triggers = [ABS_Z, ABS_RZ].map(|code| AbsRange { value: 0, ..axis(code, 0, 255) });
    let hat = [ABS_HAT0X, ABS_HAT0Y].map(|code| axis(code, -1, 1));
    sticks.into_iter().chain(triggers).chain(hat).collect()
}
fn states(decoder: &mut GamepadDecoder, bytes: &[u8]) -> Vec<GamepadState> {
    let mut found = Vec::new();
    decoder.feed(bytes, |state| found.push(state));
    found
}

#[test]
fn buttons_sticks_triggers_and_the_cross_take_effect_with_their_report() {
    let mut pad = GamepadDecoder::new(&common_axes(), &[]);
    let bytes = [
        event(EV_KEY, BTN_GAMEPAD, 1),
        event(EV_ABS, ABS_X, 32_767),
        event(EV_ABS, ABS_RY, -32_768),
        event(EV_ABS, ABS_RZ, 255),
        event(EV_ABS, ABS_HAT0Y, -1),
    ]
    .concat();
    assert_eq!(states(&mut pad, &bytes), []);
    let said = states(&mut pad, &report())[0];
    assert!(said.is_pressed(GamepadButton::South) && said.is_pressed(GamepadButton::Up));
    assert!(!said.is_pressed(GamepadButton::East) && !said.is_pressed(GamepadButton::Down));
    assert!((said.left_stick[0] - 1.0).abs() < 1e-9 && said.left_stick[1].abs() < 1e-4, "{said:?}");
    assert!((said.right_stick[1] + 1.0).abs() < 1e-9, "{said:?}");
    assert_eq!(said.triggers, [0.0, 1.0]);
    let released = [event(EV_KEY, BTN_GAMEPAD, 0), event(EV_ABS, ABS_HAT0Y, 0), report()].concat();
    assert_eq!(states(&mut pad, &released)[0].buttons, 0);
}

#[test]
fn a_stick_near_its_middle_is_at_rest_and_grows_from_the_edge_of_the_dead_zone() {
    let push = |flat: i32, x: i32, y: i32| {
        let axes = [ABS_X, ABS_Y].map(|code| AbsRange { flat, ..axis(code, -1_000, 1_000) });
        let mut pad = GamepadDecoder::new(&axes, &[]);
        let bytes = [event(EV_ABS, ABS_X, x), event(EV_ABS, ABS_Y, y), report()].concat();
        states(&mut pad, &bytes)[0].left_stick
    };
    assert_eq!(push(0, 80, -80), [0.0, 0.0]);
    assert!(push(0, 121, 0)[0] > 0.0 && push(0, 121, 0)[0] < 0.01);
    assert_eq!(push(300, 250, 0), [0.0, 0.0]);
    let corner = push(0, 1_000, 1_000);
    assert!((corner[0].hypot(corner[1]) - 1.0).abs() < 1e-9, "no faster across than along: {corner:?}");
}

#[test]
fn pads_without_a_second_pair_of_turning_axes_have_their_right_stick_on_z() {
    let axes = [ABS_X, ABS_Y, ABS_Z, ABS_RZ].map(|code| axis(code, 0, 255));
    let mut pad = GamepadDecoder::new(&axes, &[]);
    let bytes = [event(EV_ABS, ABS_Z, 255), event(EV_KEY, BTN_TR2, 1), report()].concat();
    let said = states(&mut pad, &bytes)[0];
    // 256 values have no exact middle: the other axis rests half a value beside it.
    assert!((said.right_stick[0] - 1.0).abs() < 1e-4 && said.right_stick[1].abs() < 0.01, "{said:?}");
    assert_eq!(said.triggers, [0.0, 1.0]);
}

#[test]
fn what_was_down_before_is_known_and_what_was_lost_counts_as_released() {
    let mut pad = GamepadDecoder::new(&common_axes(), &[BTN_GAMEPAD, 0x13b]);
    assert!(pad.state().is_pressed(GamepadButton::South) && pad.state().is_pressed(GamepadButton::Start));
    let lost = [
        event(EV_ABS, ABS_X, 32_767),
        event(EV_ABS, ABS_RZ, 200),
        event(EV_SYN, SYN_DROPPED, 0),
        event(EV_KEY, BTN_GAMEPAD, 1),
        report(),
    ]
    .concat();
    assert_eq!(states(&mut pad, &lost), [GamepadState::default()]);
    let again = [event(EV_KEY, BTN_GAMEPAD, 1), report()].concat();
    assert!(states(&mut pad, &again)[0].is_pressed(GamepadButton::South));
}

proptest! {
    #[test]
    fn any_bytes_in_any_pieces_give_a_state_within_its_range(
        bytes in prop::collection::vec(any::<u8>(), 0..600),
        kinds in prop::collection::vec((0..5u16, 0..0x240u16, any::<i32>()), 0..40),
        ranges in prop::collection::vec((0..0x20u16, any::<i32>(), any::<i32>(), any::<i32>(), any::<i32>()), 0..12),
        piece in 1..70usize,
    ) {
        let axes: Vec<AbsRange> = ranges
            .into_iter()
            .map(|(code, value, min, max, flat)| AbsRange { code, value, min, max, flat })
            .collect();
        let known: Vec<u8> = kinds.iter().flat_map(|(kind, code, value)| event(*kind, *code, *value)).collect();
        for stream in [&bytes, &known] {
            let mut pad = GamepadDecoder::new(&axes, &[]);
            let (mut whole, mut pieces) = (pad.clone(), Vec::new());
            for part in stream.chunks(piece) {
                pieces.extend(states(&mut pad, part));
            }
            prop_assert_eq!(&states(&mut whole, stream), &pieces);
            for state in pieces {
                let amounts = state.left_stick.into_iter().chain(state.right_stick);
                prop_assert!(amounts.map(f64::abs).chain(state.triggers).all(|x| (0.0..=1.0 + 1e-12).contains(&x)));
            }
        }
    }
}
