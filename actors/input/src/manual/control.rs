//! Named controls: keys, pointer buttons, and the parts of a gamepad.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A key, a button, or a direction of a stick.
///
/// Keys have the names of the W3C's `KeyboardEvent.code`: the physical position on the keyboard, independent of the
/// layout.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Control(u8);

/// All controls, in groups.
const NAMES: &[&str] = &[
    "KeyA",
    "KeyB",
    "KeyC",
    "KeyD",
    "KeyE",
    "KeyF",
    "KeyG",
    "KeyH",
    "KeyI",
    "KeyJ",
    "KeyK",
    "KeyL",
    "KeyM",
    "KeyN",
    "KeyO",
    "KeyP",
    "KeyQ",
    "KeyR",
    "KeyS",
    "KeyT",
    "KeyU",
    "KeyV",
    "KeyW",
    "KeyX",
    "KeyY",
    "KeyZ",
    "Digit0",
    "Digit1",
    "Digit2",
    "Digit3",
    "Digit4",
    "Digit5",
    "Digit6",
    "Digit7",
    "Digit8",
    "Digit9",
    "ArrowLeft",
    "ArrowRight",
    "ArrowUp",
    "ArrowDown",
    "PageUp",
    "PageDown",
    "Home",
    "End",
    "Insert",
    "Delete",
    "Backspace",
    "Enter",
    "Space",
    "Tab",
    "ShiftLeft",
    "ShiftRight",
    "ControlLeft",
    "ControlRight",
    "AltLeft",
    "AltRight",
    "CapsLock",
    "Backquote",
    "Minus",
    "Equal",
    "BracketLeft",
    "BracketRight",
    "Backslash",
    "IntlBackslash",
    "Semicolon",
    "Quote",
    "Comma",
    "Period",
    "Slash",
    "Numpad0",
    "Numpad1",
    "Numpad2",
    "Numpad3",
    "Numpad4",
    "Numpad5",
    "Numpad6",
    "Numpad7",
    "Numpad8",
    "Numpad9",
    "NumpadAdd",
    "NumpadSubtract",
    "NumpadMultiply",
    "NumpadDivide",
    "NumpadDecimal",
    "NumpadEnter",
    "MouseLeft",
    "MouseMiddle",
    "MouseRight",
    "MouseBack",
    "MouseForward",
    "PadSouth",
    "PadEast",
    "PadWest",
    "PadNorth",
    "PadLeftShoulder",
    "PadRightShoulder",
    "PadLeftTrigger",
    "PadRightTrigger",
    "PadSelect",
    "PadStart",
    "PadLeftThumb",
    "PadRightThumb",
    "PadUp",
    "PadDown",
    "PadLeft",
    "PadRight",
    "PadLeftStickLeft",
    "PadLeftStickRight",
    "PadLeftStickUp",
    "PadLeftStickDown",
    "PadRightStickLeft",
    "PadRightStickRight",
    "PadRightStickUp",
    "PadRightStickDown",
];

/// Error for an unknown control name.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error(
    "no key, button or stick is called '{0}'; valid: keys by their place (KeyA to KeyZ, Digit0 to Digit9, ArrowUp, \
     PageDown, Space, Tab, ShiftLeft, Comma, Numpad1, …), MouseLeft, MouseMiddle, MouseRight, MouseBack, \
     MouseForward, and a gamepad's PadSouth, PadEast, PadWest, PadNorth, PadLeftShoulder, PadRightTrigger, \
     PadSelect, PadStart, PadLeftThumb, PadUp, PadLeftStickRight, …"
)]
pub struct UnknownControl(pub String);

impl Control {
    /// Number of controls.
    pub const COUNT: usize = NAMES.len();

    /// The control of that name.
    pub fn named(name: &str) -> Option<Self> {
        let index = NAMES.iter().position(|known| *known == name)?;
        u8::try_from(index).ok().map(Self)
    }
    /// Its name.
    pub fn name(self) -> &'static str {
        NAMES[usize::from(self.0)]
    }
    /// Its number, below [`Control::COUNT`].
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
    /// All controls.
    pub fn all() -> impl Iterator<Item = Self> {
        (0..NAMES.len()).filter_map(|index| u8::try_from(index).ok().map(Self))
    }
}

impl TryFrom<String> for Control {
    type Error = UnknownControl;
    fn try_from(name: String) -> Result<Self, UnknownControl> {
        Self::named(&name).ok_or_else(|| UnknownControl(name.chars().take(40).collect()))
    }
}
impl From<Control> for String {
    fn from(control: Control) -> Self {
        control.name().to_owned()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_control_is_found_by_its_name_and_no_name_is_given_twice() {
        assert_eq!(Control::all().count(), Control::COUNT);
        for control in Control::all() {
            assert_eq!(Control::named(control.name()), Some(control));
        }
        let error = Control::try_from("KeyÄ".to_owned()).unwrap_err().to_string();
        assert!(error.contains("'KeyÄ'") && error.contains("MouseLeft"), "{error}");
    }
}
