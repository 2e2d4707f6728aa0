//! Gamepads: their state, and the reader that finds and reads the pads of this machine.

mod decoder;
#[cfg(target_os = "linux")]
mod evdev;
#[cfg(target_os = "linux")]
mod reader;

pub use decoder::{AbsRange, GamepadDecoder, INPUT_EVENT_BYTES};
#[cfg(target_os = "linux")]
pub use reader::{GamepadReader, GamepadReaderError, GamepadSource, PluggedGamepad, RESCAN_NS};

#[cfg(target_os = "linux")]
pub use evdev::InputFolder;

/// A button of a gamepad, by its place (the kernel's gamepad specification).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum GamepadButton {
    /// Lower one of the four for the right thumb.
    South,
    /// Right one of the four.
    East,
    /// Left one of the four.
    West,
    /// Upper one of the four.
    North,
    /// Left shoulder.
    LeftShoulder,
    /// Right shoulder.
    RightShoulder,
    /// Left of the two in the middle.
    Select,
    /// Right of the two in the middle.
    Start,
    /// The left stick pressed.
    LeftThumb,
    /// The right stick pressed.
    RightThumb,
    /// Up on the cross.
    Up,
    /// Down on the cross.
    Down,
    /// Left on the cross.
    Left,
    /// Right on the cross.
    Right,
}

impl GamepadButton {
    /// Every button.
    pub const ALL: [Self; 14] = [
        Self::South,
        Self::East,
        Self::West,
        Self::North,
        Self::LeftShoulder,
        Self::RightShoulder,
        Self::Select,
        Self::Start,
        Self::LeftThumb,
        Self::RightThumb,
        Self::Up,
        Self::Down,
        Self::Left,
        Self::Right,
    ];
}

/// State of a gamepad of any make.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GamepadState {
    /// One bit per button, in the order of [`GamepadButton::ALL`].
    pub buttons: u16,
    /// The left stick: right and down, each −1 to 1; zero within its dead zone.
    pub left_stick: [f64; 2],
    /// The right stick: right and down, each −1 to 1; zero within its dead zone.
    pub right_stick: [f64; 2],
    /// Left and right trigger, 0 to 1.
    pub triggers: [f64; 2],
}

impl GamepadState {
    /// Whether the button is pressed.
    pub fn is_pressed(&self, button: GamepadButton) -> bool {
        self.buttons & (1 << button as u16) != 0
    }
    /// Presses or releases a button.
    pub fn press(&mut self, button: GamepadButton, pressed: bool) {
        let bit = 1 << button as u16;
        self.buttons = if pressed { self.buttons | bit } else { self.buttons & !bit };
    }
}
