//! Controls: maps pressed keys, buttons and motions to actions. A window, a gamepad or a test reports input events in
//! order, and takes the resulting [`PersonInput`] to write into the session.
//!
//! Modifiers of a motion (the active hand, the clutch, the roll button, fine motion) take effect here, at the moment of
//! the press, and not when the result is read. Only [`Controls::advance`] advances time, in which held keys and sticks
//! move the hand at their rate.

use trocar_devices::gamepad::{GamepadButton, GamepadState};
use trocar_scene::{
    ActivationMode, Hand, PERSON_TOTAL_MAX, PersonAction, PersonHand, PersonInput, PersonView, Side, SimTime,
    Snapshot,
};

use super::bindings::Bindings;
use super::control::Control;

/// Longest time advanced at once \[s\], so that a window that hung does not move a hand afterwards.
const ADVANCE_MAX_SECS: f64 = 0.1;
/// Largest motion of one pointer or wheel event \[heights of the image; notches\].
const EVENT_MAX: f64 = 4.0;
/// Amount from which a stick or trigger counts as pressed.
const DOWN_FROM: f64 = 0.5;
/// Amount below which a trigger counts as released.
const RELEASED_BELOW: f64 = 0.02;

/// State of all controls, and the totals of their motions.
#[derive(Clone, Debug)]
pub struct Controls {
    bindings: Bindings,
    amounts: [f64; Control::COUNT],
    input: PersonInput,
    /// Which hands exist, left and right.
    hands: [bool; 2],
    /// Opening of the jaws while they are released, left and right, as a share.
    released: [f64; 2],
    /// Whether the grip press belongs to the active hand; a press begun for the other hand is ignored.
    owns_grip: bool,
    /// Likewise for the press that activates the instrument: of two pedals the last one pressed.
    owns_activation: Option<PersonAction>,
    pad: GamepadState,
}

impl Controls {
    /// A source of input that continues from an earlier one's state in the scene, for the scene's hands. Its first
    /// [`Controls::input`] must be written at once.
    pub fn new(bindings: Bindings, scene: &Snapshot) -> Self {
        let before = PersonInput::of(scene).map(|(_, input)| *input).unwrap_or_default();
        let has = |side| scene.iter::<Hand>().any(|(_, hand)| hand.side == side);
        Self::resuming(bindings, &before, [has(Side::Left), has(Side::Right)])
    }

    /// A source of input that continues after `before`, for these hands: left, right.
    pub fn resuming(bindings: Bindings, before: &PersonInput, hands: [bool; 2]) -> Self {
        let anew = |hand: &PersonHand| PersonHand { opening: hand.opening, ..PersonHand::default() };
        let mut input = PersonInput {
            source: before.source.wrapping_add(1),
            in_charge: before.in_charge,
            left: anew(&before.left),
            right: anew(&before.right),
            ..PersonInput::default()
        };
        if !hands[input.in_charge as usize] && hands[input.in_charge.other() as usize] {
            input.in_charge = input.in_charge.other();
        }
        // Jaws that were left open stay so until the next jaw input.
        let released = [&before.left, &before.right]
            .map(|hand| hand.opening.filter(|opening| *opening > 0.0).unwrap_or(bindings.opening));
        Self {
            bindings,
            amounts: [0.0; Control::COUNT],
            input,
            hands,
            released,
            owns_grip: false,
            owns_activation: None,
            pad: GamepadState::default(),
        }
    }

    /// The bindings of controls to actions.
    pub fn bindings(&self) -> &Bindings {
        &self.bindings
    }
    /// The active hand.
    pub fn in_charge(&self) -> Side {
        self.input.in_charge
    }

    /// Sets a control's amount, 0 to 1; returns whether it is bound.
    pub fn press(&mut self, control: Control, amount: f64) -> bool {
        let amount = if amount.is_finite() { amount.clamp(0.0, 1.0) } else { 0.0 };
        self.amounts[control.index()] = amount;
        let Some(action) = self.bindings.action_of(control) else { return false };
        let others = &self.bindings.controls[&action];
        let asked = others.iter().map(|control| self.amounts[control.index()]).fold(0.0, f64::max);
        let before = self.input.held.get(action);
        self.input.held.set(action, asked);
        match action {
            PersonAction::SwitchHand if before < DOWN_FROM && asked >= DOWN_FROM => self.switch_hand(),
            PersonAction::Grip => self.grip(before, asked),
            PersonAction::Activate | PersonAction::Coagulate => self.activate(action, before, asked),
            _ => {}
        }
        true
    }

    /// Releases all controls, as when a window loses the keyboard focus. The jaws stay as they are; an active
    /// instrument is switched off.
    pub fn release_all(&mut self) {
        self.amounts = [0.0; Control::COUNT];
        self.input.held = Default::default();
        self.owns_grip = false;
        self.switch_off();
        self.pad = GamepadState::default();
    }

    /// Moves the pointer, in heights of the image.
    pub fn pointer_moved(&mut self, right: f64, down: f64) {
        if !(right.is_finite() && down.is_finite()) || self.holds(PersonAction::Clutch) {
            return;
        }
        let (right, down) = (right.clamp(-EVENT_MAX, EVENT_MAX), down.clamp(-EVENT_MAX, EVENT_MAX));
        if self.holds(PersonAction::Turn) {
            self.roll(right * self.bindings.roll_per_height);
        } else {
            self.go([right, down, 0.0]);
        }
    }

    /// Turns the wheel by `notches`, away from the person.
    pub fn scrolled(&mut self, notches: f64) {
        if notches.is_finite() && !self.holds(PersonAction::Clutch) {
            let away = notches.clamp(-EVENT_MAX, EVENT_MAX) * self.bindings.depth_per_notch;
            self.go([0.0, 0.0, away]);
        }
    }

    /// Takes the gamepad's current state; `None` without one. An unplugged pad stops all its motions, and leaves the
    /// jaws as they are.
    pub fn gamepad(&mut self, pad: Option<&GamepadState>) {
        if pad.is_none() && self.pad != GamepadState::default() {
            self.owns_grip = false;
            self.switch_off();
        }
        let (pad, before) = (pad.copied().unwrap_or_default(), self.pad);
        // Only changes, because another control of the same action may be pressed.
        for (button, name) in GamepadButton::ALL.into_iter().zip(PAD_BUTTONS) {
            if pad.is_pressed(button) != before.is_pressed(button) {
                self.press_named(name, f64::from(u8::from(pad.is_pressed(button))));
            }
        }
        for (name, now, then) in [
            ("PadLeftTrigger", pad.triggers[0], before.triggers[0]),
            ("PadRightTrigger", pad.triggers[1], before.triggers[1]),
            ("PadLeftStickRight", pad.left_stick[0], before.left_stick[0]),
            ("PadLeftStickLeft", -pad.left_stick[0], -before.left_stick[0]),
            ("PadLeftStickDown", pad.left_stick[1], before.left_stick[1]),
            ("PadLeftStickUp", -pad.left_stick[1], -before.left_stick[1]),
            ("PadRightStickRight", pad.right_stick[0], before.right_stick[0]),
            ("PadRightStickLeft", -pad.right_stick[0], -before.right_stick[0]),
            ("PadRightStickDown", pad.right_stick[1], before.right_stick[1]),
            ("PadRightStickUp", -pad.right_stick[1], -before.right_stick[1]),
        ] {
            if now != then {
                self.press_named(name, now);
            }
        }
        self.pad = pad;
    }

    /// Advances by `secs`, in which held controls continue to act.
    pub fn advance(&mut self, secs: f64) {
        // Written so that NaN advances nothing.
        let secs = if secs > 0.0 { secs.min(ADVANCE_MAX_SECS) } else { return };
        let held = self.input.held;
        let way = self.bindings.speed * secs;
        let moved = [
            (held.move_right - held.move_left) * way,
            (held.move_down - held.move_up) * way,
            (held.move_away - held.move_closer) * way,
        ];
        if moved != [0.0; 3] {
            self.go(moved);
        }
        let turn = held.roll_right - held.roll_left;
        if turn != 0.0 {
            self.roll(turn * self.bindings.roll_speed * secs);
        }
        let wider = held.jaw_open - held.jaw_close;
        if wider != 0.0 {
            let index = self.input.in_charge as usize;
            let share = self.released[index] + wider * self.bindings.jaw_speed * secs;
            self.released[index] = share.clamp(0.0, 1.0);
            self.set_jaws(if self.owns_grip { held.grip } else { 0.0 });
        }
    }

    /// The input so far, to be written into the session at `now`.
    pub fn input(&mut self, view: Option<PersonView>, now: SimTime) -> PersonInput {
        let far = |total: &f64| total.abs() > 0.5 * PERSON_TOTAL_MAX;
        let hands = [self.input.left, self.input.right];
        if hands.iter().any(|hand| hand.moved.iter().chain([&hand.rolled]).any(far)) {
            // Happens only after days, and loses the motion of the last few milliseconds.
            self.input.source = self.input.source.wrapping_add(1);
            for hand in [&mut self.input.left, &mut self.input.right] {
                let PersonHand { opening, activation, mode, .. } = *hand;
                *hand = PersonHand { opening, activation, mode, ..PersonHand::default() };
            }
        }
        self.input.view = view;
        self.input.sampled_at = now;
        self.input
    }

    fn press_named(&mut self, name: &str, amount: f64) {
        if let Some(control) = Control::named(name) {
            self.press(control, amount);
        }
    }

    fn holds(&self, action: PersonAction) -> bool {
        self.input.held.get(action) >= DOWN_FROM
    }

    fn fineness(&self) -> f64 {
        if self.holds(PersonAction::Fine) { self.bindings.fine } else { 1.0 }
    }

    fn go(&mut self, way: [f64; 3]) {
        let fineness = self.fineness();
        let hand = self.input.hand_mut(self.input.in_charge);
        for (total, way) in hand.moved.iter_mut().zip(way) {
            *total += way * fineness;
        }
    }

    fn roll(&mut self, angle: f64) {
        let fineness = self.fineness();
        self.input.hand_mut(self.input.in_charge).rolled += angle * fineness;
    }

    /// Switches the active hand. The previous hand stays as it is, but is deactivated; controls pressed now neither
    /// move jaws nor activate instruments until they are released.
    fn switch_hand(&mut self) {
        let other = self.input.in_charge.other();
        if self.hands[other as usize] {
            self.switch_off();
            self.input.in_charge = other;
            self.owns_grip = false;
        }
    }

    fn activate(&mut self, pedal: PersonAction, before: f64, asked: f64) {
        if before < RELEASED_BELOW && asked >= RELEASED_BELOW {
            self.owns_activation = Some(pedal);
        }
        if self.owns_activation == Some(pedal) {
            let level = if asked < RELEASED_BELOW { 0.0 } else { asked };
            let coagulates = level > 0.0 && pedal == PersonAction::Coagulate;
            let hand = self.input.hand_mut(self.input.in_charge);
            (hand.activation, hand.mode) = (level, coagulates.then_some(ActivationMode::Coagulate));
            self.owns_activation = (level > 0.0).then_some(pedal);
        }
    }

    /// Deactivates the instrument, because its press is no longer tracked.
    fn switch_off(&mut self) {
        self.owns_activation = None;
        for hand in [&mut self.input.left, &mut self.input.right] {
            (hand.activation, hand.mode) = (0.0, None);
        }
    }

    fn grip(&mut self, before: f64, asked: f64) {
        if before < RELEASED_BELOW && asked >= RELEASED_BELOW {
            self.owns_grip = true;
        }
        if self.owns_grip {
            self.set_jaws(if asked < RELEASED_BELOW { 0.0 } else { asked });
            self.owns_grip = asked >= RELEASED_BELOW;
        }
    }

    fn set_jaws(&mut self, grip: f64) {
        let released = self.released[self.input.in_charge as usize];
        self.input.hand_mut(self.input.in_charge).opening = Some(released * (1.0 - grip));
    }
}

/// The buttons of a gamepad as controls, in the order of [`GamepadButton::ALL`].
const PAD_BUTTONS: [&str; 14] = [
    "PadSouth",
    "PadEast",
    "PadWest",
    "PadNorth",
    "PadLeftShoulder",
    "PadRightShoulder",
    "PadSelect",
    "PadStart",
    "PadLeftThumb",
    "PadRightThumb",
    "PadUp",
    "PadDown",
    "PadLeft",
    "PadRight",
];

#[cfg(test)]
mod tests {
    use super::*;

    fn controls() -> Controls {
        Controls::resuming(Bindings::default(), &PersonInput::default(), [true, true])
    }
    fn control(name: &str) -> Control {
        Control::named(name).expect("a control")
    }
    fn state(controls: &mut Controls) -> PersonInput {
        controls.input(None, SimTime::ZERO)
    }

    #[test]
    fn the_pointer_moves_the_hand_in_charge_and_modes_count_from_the_moment_of_their_press() {
        let mut controls = controls();
        controls.pointer_moved(0.1, -0.2);
        controls.press(control("ShiftLeft"), 1.0);
        controls.pointer_moved(0.1, 0.0);
        controls.press(control("ShiftLeft"), 0.0);
        controls.press(control("Space"), 1.0);
        controls.pointer_moved(3.0, 3.0);
        controls.scrolled(2.0);
        controls.press(control("Space"), 0.0);
        controls.press(control("MouseRight"), 1.0);
        controls.pointer_moved(0.5, 1.0);
        controls.press(control("MouseRight"), 0.0);
        controls.press(control("Tab"), 1.0);
        controls.press(control("Tab"), 0.0);
        controls.scrolled(1.0);
        let input = state(&mut controls);
        let left = input.left;
        assert!((left.moved[0] - 0.12).abs() < 1e-12 && (left.moved[1] + 0.2).abs() < 1e-12, "{left:?}");
        assert!((left.rolled - 1.5).abs() < 1e-12 && left.moved[2] == 0.0, "{left:?}");
        assert_eq!((input.in_charge, input.right.moved), (Side::Right, [0.0, 0.0, 0.02]));
    }

    #[test]
    fn a_press_between_two_writes_is_not_lost() {
        let mut controls = controls();
        controls.press(control("KeyD"), 1.0);
        controls.advance(0.004);
        controls.press(control("KeyD"), 0.0);
        controls.advance(0.012);
        let input = state(&mut controls);
        assert!((input.left.moved[0] - 0.25 * 0.004).abs() < 1e-15);
        assert_eq!(input.held.move_right, 0.0);
    }

    #[test]
    fn of_two_pedals_the_one_that_was_pressed_last_says_which_current_and_its_release_ends_it() {
        let mut controls = controls();
        let mut after = |name: &str, amount: f64| {
            controls.press(control(name), amount);
            let left = state(&mut controls).left;
            (left.activation, left.mode)
        };
        assert_eq!(after("KeyB", 1.0), (1.0, None));
        assert_eq!(after("KeyN", 1.0), (1.0, Some(ActivationMode::Coagulate)));
        assert_eq!(after("KeyB", 0.0), (1.0, Some(ActivationMode::Coagulate)));
        assert_eq!(after("KeyN", 0.0), (0.0, None));
    }

    #[test]
    fn what_is_switched_on_belongs_to_the_hand_that_it_was_pressed_for_and_to_no_other() {
        let mut controls = controls();
        controls.press(control("KeyB"), 1.0);
        assert_eq!(state(&mut controls).left.activation, 1.0);
        controls.press(control("Tab"), 1.0);
        controls.press(control("Tab"), 0.0);
        let input = state(&mut controls);
        assert_eq!((input.left.activation, input.right.activation), (0.0, 0.0), "no hand inherits it");
        controls.press(control("KeyB"), 0.0);
        controls.press(control("KeyB"), 0.5);
        assert_eq!(state(&mut controls).right.activation, 0.5);
        controls.release_all();
        assert_eq!(state(&mut controls).right.activation, 0.0);
        let pad = GamepadState { buttons: 1, ..GamepadState::default() };
        controls.gamepad(Some(&pad));
        assert_eq!(state(&mut controls).right.activation, 1.0);
        controls.gamepad(None);
        assert_eq!(state(&mut controls).right.activation, 0.0, "a pad that is unplugged holds nothing down");
    }

    #[test]
    fn two_controls_of_one_action_are_one() {
        let mut controls = controls();
        controls.press(control("KeyD"), 1.0);
        controls.press(control("ArrowRight"), 1.0);
        controls.advance(0.1);
        controls.press(control("KeyD"), 0.0);
        controls.advance(0.1);
        assert!((state(&mut controls).left.moved[0] - 0.05).abs() < 1e-15);
        assert!(!controls.press(control("KeyP"), 1.0), "means nothing");
    }

    #[test]
    fn a_hand_that_is_left_keeps_its_jaws_however_the_button_goes_on() {
        let mut controls = controls();
        let opening = |controls: &mut Controls, side| state(controls).hand(side).opening;
        assert_eq!(opening(&mut controls, Side::Left), None);
        controls.press(control("MouseLeft"), 1.0);
        assert_eq!(opening(&mut controls, Side::Left), Some(0.0));
        // The left hand keeps its grip when the button is released during the right hand's turn.
        controls.press(control("Tab"), 1.0);
        controls.press(control("MouseLeft"), 0.0);
        assert_eq!(opening(&mut controls, Side::Left), Some(0.0));
        assert_eq!(opening(&mut controls, Side::Right), None);
        controls.press(control("Tab"), 0.0);
        controls.press(control("MouseLeft"), 1.0);
        assert_eq!(opening(&mut controls, Side::Right), Some(0.0));
        controls.press(control("Tab"), 1.0);
        controls.press(control("MouseLeft"), 0.0);
        assert_eq!([Side::Left, Side::Right].map(|side| opening(&mut controls, side)), [Some(0.0); 2]);
        // A separate press and release opens it.
        controls.press(control("MouseLeft"), 1.0);
        controls.press(control("MouseLeft"), 0.0);
        assert_eq!(opening(&mut controls, Side::Left), Some(0.5));
        assert_eq!(opening(&mut controls, Side::Right), Some(0.0));
    }

    #[test]
    fn keys_change_the_opening_and_a_trigger_closes_by_degrees() {
        let mut controls = controls();
        controls.press(control("KeyX"), 1.0);
        controls.advance(0.1);
        controls.press(control("KeyX"), 0.0);
        assert!((state(&mut controls).left.opening.expect("told") - 0.58).abs() < 1e-12);
        let pad = |trigger| GamepadState { triggers: [0.0, trigger], ..GamepadState::default() };
        controls.gamepad(Some(&pad(0.5)));
        assert!((state(&mut controls).left.opening.expect("told") - 0.29).abs() < 1e-12);
        controls.gamepad(Some(&pad(0.0)));
        assert!((state(&mut controls).left.opening.expect("told") - 0.58).abs() < 1e-12);
        // It keeps its grip when the pad is unplugged.
        controls.gamepad(Some(&pad(1.0)));
        controls.gamepad(None);
        assert_eq!(state(&mut controls).left.opening, Some(0.0));
    }

    #[test]
    fn a_stick_moves_at_a_rate_and_its_buttons_do_what_their_keys_do() {
        let mut controls = controls();
        let mut pad = GamepadState { left_stick: [-0.5, 0.25], ..GamepadState::default() };
        controls.gamepad(Some(&pad));
        controls.advance(0.1);
        let moved = state(&mut controls).left.moved;
        assert!((moved[0] + 0.0125).abs() < 1e-15 && (moved[1] - 0.00625).abs() < 1e-15, "{moved:?}");
        pad.press(GamepadButton::North, true);
        controls.gamepad(Some(&pad));
        assert_eq!(controls.in_charge(), Side::Right);
        // Unplugged: all motions stop.
        controls.gamepad(None);
        controls.advance(0.1);
        assert_eq!(state(&mut controls).right.moved, [0.0; 3]);
    }

    #[test]
    fn a_source_that_is_replaced_leaves_the_jaws_and_a_lost_focus_everything() {
        let mut first = controls();
        first.pointer_moved(0.3, 0.3);
        first.press(control("MouseLeft"), 1.0);
        first.press(control("KeyW"), 1.0);
        first.release_all();
        first.advance(0.1);
        let left = state(&mut first);
        assert_eq!((left.left.moved[1], left.left.opening), (0.3, Some(0.0)));
        let second = state(&mut Controls::resuming(Bindings::default(), &left, [true, true]));
        assert_ne!(second.source, left.source);
        assert_eq!(second.left, PersonHand { opening: Some(0.0), ..PersonHand::default() });
    }

    #[test]
    fn what_no_device_says_is_ignored_and_a_single_hand_stays_in_charge() {
        let mut controls = Controls::resuming(Bindings::default(), &PersonInput::default(), [false, true]);
        assert_eq!(controls.in_charge(), Side::Right);
        controls.press(control("Tab"), 1.0);
        assert_eq!(controls.in_charge(), Side::Right);
        controls.pointer_moved(f64::NAN, 0.1);
        controls.scrolled(f64::INFINITY);
        controls.advance(f64::NAN);
        controls.press(control("KeyW"), f64::NAN);
        controls.advance(1e9);
        assert_eq!(state(&mut controls).right, PersonHand::default());
        for _ in 0..300_000 {
            controls.pointer_moved(4.0, 0.0);
        }
        let input = state(&mut controls);
        assert!(trocar_scene::Component::check(&input).is_ok() && input.source == 2);
    }
}
