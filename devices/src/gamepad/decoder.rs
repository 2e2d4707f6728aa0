//! Gamepad decoder: from bytes of the kernel's `struct input_event` to a [`GamepadState`], by the Linux gamepad
//! specification.
//!
//! Events between two reports belong together and take effect with the second one. After a loss in the kernel
//! (`SYN_DROPPED`) all events up to the next report are discarded: the pad counts as released until later events say
//! otherwise.

use super::{GamepadButton, GamepadState};

/// Bytes of a `struct input_event` of this machine: two words of time, type, code and value.
pub const INPUT_EVENT_BYTES: usize = 2 * size_of::<std::ffi::c_long>() + 8;

const EV_SYN: u16 = 0;
const EV_KEY: u16 = 1;
const EV_ABS: u16 = 3;
const SYN_REPORT: u16 = 0;
const SYN_DROPPED: u16 = 3;

const ABS_X: u16 = 0x00;
const ABS_Y: u16 = 0x01;
const ABS_Z: u16 = 0x02;
const ABS_RX: u16 = 0x03;
const ABS_RY: u16 = 0x04;
const ABS_RZ: u16 = 0x05;
const ABS_HAT0X: u16 = 0x10;
const ABS_HAT0Y: u16 = 0x11;
const ABS_HAT2X: u16 = 0x14;
const ABS_HAT2Y: u16 = 0x15;
const BTN_TL2: u16 = 0x138;
const BTN_TR2: u16 = 0x139;

/// Axes that a gamepad may have.
pub(super) const AXES: [u16; 10] =
    [ABS_X, ABS_Y, ABS_Z, ABS_RX, ABS_RY, ABS_RZ, ABS_HAT0X, ABS_HAT0Y, ABS_HAT2X, ABS_HAT2Y];
/// The code that makes a device a gamepad: `BTN_SOUTH`, alias `BTN_GAMEPAD`.
pub(super) const BTN_GAMEPAD: u16 = 0x130;
/// Codes of the buttons.
pub(super) const BUTTONS: [(u16, GamepadButton); 14] = [
    (BTN_GAMEPAD, GamepadButton::South),
    (0x131, GamepadButton::East),
    (0x133, GamepadButton::North),
    (0x134, GamepadButton::West),
    (0x136, GamepadButton::LeftShoulder),
    (0x137, GamepadButton::RightShoulder),
    (0x13a, GamepadButton::Select),
    (0x13b, GamepadButton::Start),
    (0x13d, GamepadButton::LeftThumb),
    (0x13e, GamepadButton::RightThumb),
    (0x220, GamepadButton::Up),
    (0x221, GamepadButton::Down),
    (0x222, GamepadButton::Left),
    (0x223, GamepadButton::Right),
];

/// Dead zone as a share of a stick's range, unless the kernel reports a larger one.
const STICK_DEAD_ZONE: f64 = 0.12;
/// The same for triggers.
const TRIGGER_DEAD_ZONE: f64 = 0.04;

/// The kernel's description of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct AbsRange {
    /// Its code, such as 0 for `ABS_X`.
    pub code: u16,
    /// Current value.
    pub value: i32,
    /// Least value.
    pub min: i32,
    /// Greatest value.
    pub max: i32,
    /// Dead zone around the middle.
    pub flat: i32,
}

impl AbsRange {
    /// Value mapped to −1 to 1 over its range; 0 for an empty range.
    fn centred(&self) -> f64 {
        let (min, max) = (f64::from(self.min), f64::from(self.max));
        if max <= min {
            return 0.0;
        }
        ((2.0 * f64::from(self.value) - min - max) / (max - min)).clamp(-1.0, 1.0)
    }
    /// 0 to 1 over its range.
    fn share(&self) -> f64 {
        if self.max <= self.min { 0.0 } else { 0.5 * (self.centred() + 1.0) }
    }
    /// The kernel's dead zone, as a share of the half range.
    fn dead_zone(&self) -> f64 {
        let half = 0.5 * (f64::from(self.max) - f64::from(self.min));
        if half > 0.0 { (f64::from(self.flat) / half).clamp(0.0, 0.5) } else { 0.0 }
    }
}

/// Decodes bytes to states.
#[derive(Clone, Debug)]
pub struct GamepadDecoder {
    axes: [Option<AbsRange>; AXES.len()],
    /// As [`GamepadState::buttons`].
    pressed: u16,
    /// For pads whose triggers are buttons: left, right.
    trigger_buttons: [bool; 2],
    /// Bytes of an incomplete event.
    rest: [u8; INPUT_EVENT_BYTES],
    rest_len: usize,
    /// Events were lost: events before the next report are discarded.
    dropping: bool,
}

impl GamepadDecoder {
    /// Decoder for a pad with these axes, and the codes of the buttons already pressed. Codes that a gamepad does not
    /// have are ignored.
    pub fn new(axes: &[AbsRange], pressed: &[u16]) -> Self {
        let mut decoder = Self {
            axes: AXES.map(|code| axes.iter().find(|axis| axis.code == code).copied()),
            pressed: 0,
            trigger_buttons: [false; 2],
            rest: [0; INPUT_EVENT_BYTES],
            rest_len: 0,
            dropping: false,
        };
        pressed.iter().for_each(|code| decoder.key(*code, true));
        decoder
    }

    /// Decodes the bytes read, and calls `report` with the state at each report in them.
    pub fn feed(&mut self, mut bytes: &[u8], mut report: impl FnMut(GamepadState)) {
        while !bytes.is_empty() {
            let take = bytes.len().min(INPUT_EVENT_BYTES - self.rest_len);
            self.rest[self.rest_len..self.rest_len + take].copy_from_slice(&bytes[..take]);
            self.rest_len += take;
            bytes = &bytes[take..];
            if self.rest_len == INPUT_EVENT_BYTES {
                self.rest_len = 0;
                if self.event() {
                    report(self.state());
                }
            }
        }
    }

    /// Handles the complete event in `rest`; returns whether it was a report.
    fn event(&mut self) -> bool {
        let [.., t0, t1, c0, c1, v0, v1, v2, v3] = self.rest;
        let (kind, code) = (u16::from_ne_bytes([t0, t1]), u16::from_ne_bytes([c0, c1]));
        let value = i32::from_ne_bytes([v0, v1, v2, v3]);
        match (kind, code) {
            (EV_SYN, SYN_DROPPED) => {
                self.dropping = true;
                self.release();
                false
            }
            (EV_SYN, SYN_REPORT) => {
                self.dropping = false;
                true
            }
            _ if self.dropping => false,
            // 2 is the auto-repeat of a pressed key.
            (EV_KEY, code) => {
                self.key(code, value != 0);
                false
            }
            (EV_ABS, code) => {
                if let Some(index) = AXES.iter().position(|known| *known == code)
                    && let Some(axis) = &mut self.axes[index]
                {
                    axis.value = value;
                }
                false
            }
            _ => false,
        }
    }

    fn key(&mut self, code: u16, down: bool) {
        match code {
            BTN_TL2 => self.trigger_buttons[0] = down,
            BTN_TR2 => self.trigger_buttons[1] = down,
            _ => {
                if let Some((_, button)) = BUTTONS.iter().find(|(known, _)| *known == code) {
                    let mut state = GamepadState { buttons: self.pressed, ..GamepadState::default() };
                    state.press(*button, down);
                    self.pressed = state.buttons;
                }
            }
        }
    }

    fn release(&mut self) {
        self.pressed = 0;
        self.trigger_buttons = [false; 2];
        let triggers = self.triggers();
        for (code, axis) in AXES.iter().zip(&mut self.axes) {
            if let Some(axis) = axis {
                let middle = (i64::from(axis.min) + i64::from(axis.max)) / 2;
                let at_rest = i32::try_from(middle).unwrap_or(0);
                axis.value = if triggers.contains(code) { axis.min } else { at_rest };
            }
        }
    }

    /// Axes of the right stick: Z and RZ if the pad has no second pair of rotation axes.
    fn right_stick(&self) -> [u16; 2] {
        if self.axis(ABS_RX).is_some() { [ABS_RX, ABS_RY] } else { [ABS_Z, ABS_RZ] }
    }

    /// Axes of the left and the right trigger.
    fn triggers(&self) -> [u16; 2] {
        let by_the_book = self.axis(ABS_HAT2Y).is_some() || self.right_stick()[0] == ABS_Z;
        if by_the_book { [ABS_HAT2Y, ABS_HAT2X] } else { [ABS_Z, ABS_RZ] }
    }

    fn axis(&self, code: u16) -> Option<&AbsRange> {
        let index = AXES.iter().position(|known| *known == code)?;
        self.axes[index].as_ref()
    }

    /// The pad's current state.
    pub fn state(&self) -> GamepadState {
        let mut state = GamepadState { buttons: self.pressed, ..GamepadState::default() };
        state.left_stick = self.stick([ABS_X, ABS_Y]);
        state.right_stick = self.stick(self.right_stick());
        for (index, code) in self.triggers().into_iter().enumerate() {
            state.triggers[index] = match self.axis(code) {
                Some(axis) => beyond(axis.share(), TRIGGER_DEAD_ZONE),
                None => f64::from(u8::from(self.trigger_buttons[index])),
            };
        }
        for (code, less, more) in [
            (ABS_HAT0X, GamepadButton::Left, GamepadButton::Right),
            (ABS_HAT0Y, GamepadButton::Up, GamepadButton::Down),
        ] {
            let way = self.axis(code).map_or(0.0, AbsRange::centred);
            if way <= -0.5 {
                state.press(less, true);
            } else if way >= 0.5 {
                state.press(more, true);
            }
        }
        state
    }

    /// Both axes of a stick, zero within a round dead zone and growing from its edge.
    fn stick(&self, codes: [u16; 2]) -> [f64; 2] {
        let axes = codes.map(|code| self.axis(code));
        let [x, y] = axes.map(|axis| axis.map_or(0.0, AbsRange::centred));
        let dead = axes.iter().flatten().map(|axis| axis.dead_zone()).fold(STICK_DEAD_ZONE, f64::max);
        let way = (x * x + y * y).sqrt();
        if way <= dead {
            return [0.0; 2];
        }
        let share = beyond(way.min(1.0), dead) / way;
        [x * share, y * share]
    }
}

/// Rescales the range beyond a dead zone to 0 to 1.
fn beyond(share: f64, dead: f64) -> f64 {
    ((share - dead) / (1.0 - dead)).clamp(0.0, 1.0)
}

#[cfg(test)]
#[path = "decoder_tests.rs"]
mod tests;
