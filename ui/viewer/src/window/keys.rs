//! Key bindings of a window. They follow MuJoCo's `simulate` where it has the same function.

use winit::event::Modifiers;
use winit::keyboard::{KeyCode, ModifiersState};

use crate::overlay::Overlay;

/// The action of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Show the list of keys.
    Help,
    /// Toggle the left panel.
    LeftPanel,
    /// Toggle the right panel.
    RightPanel,
    /// Toggle the table of actors.
    Actors,
    /// Toggle full screen.
    FullScreen,
    /// Next stereo layout.
    Layout,
    /// Next quality.
    Quality,
    /// Take or release control of the instruments.
    Hands,
    /// Pause or resume.
    Pause,
    /// Single step.
    Step,
    /// Single step back.
    StepBack,
    /// Faster.
    Faster,
    /// Slower.
    Slower,
    /// Reset.
    Reset,
    /// Toggle looping of a recording.
    Loop,
    /// Previous camera.
    CameraBefore,
    /// Next camera.
    CameraNext,
    /// The mouse's own camera.
    FreeCamera,
    /// Save a picture.
    Screenshot,
    /// Open another window.
    NewWindow,
    /// Close this window.
    Close,
    /// Close all windows.
    Quit,
    /// Show the others something, or hand an instrument over.
    Mentor(MentorKey),
    /// Toggle an overlay.
    Show(Overlay),
}

/// Actions of telementoring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MentorKey {
    /// Take the pen up, or lay it down.
    Pen,
    /// Erase the last stroke.
    EraseLast,
    /// Erase everything of one's own.
    EraseAll,
    /// Put a label.
    Label,
    /// Freeze the pictures, or let them go on.
    Freeze,
    /// Ask for the instrument of the left hand, or give it back.
    AskLeft,
    /// Ask for that of the right one, or give it back.
    AskRight,
    /// Hand over what is asked for, or take it back.
    Accept,
    /// Keep it.
    Decline,
}

/// A key with its modifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chord {
    /// The key.
    pub code: KeyCode,
    /// Control.
    pub control: bool,
    /// Shift.
    pub shift: bool,
}

const fn key(code: KeyCode) -> Chord {
    Chord { code, control: false, shift: false }
}
const fn control(code: KeyCode) -> Chord {
    Chord { code, control: true, shift: false }
}

/// All key bindings, in the order of the help.
pub const KEYS: &[(Chord, Action, &str)] = &[
    (key(KeyCode::F1), Action::Help, "this list"),
    (key(KeyCode::Tab), Action::LeftPanel, "the panel at the left"),
    (
        Chord { code: KeyCode::Tab, control: false, shift: true },
        Action::RightPanel,
        "the panel at the right: inspect and tune",
    ),
    (key(KeyCode::F3), Action::Actors, "the actors: rates, lateness, health"),
    (key(KeyCode::F5), Action::FullScreen, "all of the screen"),
    (key(KeyCode::F6), Action::Layout, "the next way in which two eyes share the picture"),
    (key(KeyCode::F7), Action::Quality, "the next quality"),
    (key(KeyCode::F8), Action::Hands, "take the instruments in hand; Escape gives them back"),
    (key(KeyCode::Space), Action::Pause, "pause, go on"),
    (key(KeyCode::ArrowRight), Action::Step, "a step, while paused"),
    (key(KeyCode::ArrowLeft), Action::StepBack, "a step back, in a recording"),
    (key(KeyCode::Equal), Action::Faster, "faster"),
    (key(KeyCode::Minus), Action::Slower, "slower"),
    (key(KeyCode::Backspace), Action::Reset, "from the beginning"),
    (key(KeyCode::KeyL), Action::Loop, "a recording begins anew at its end"),
    (key(KeyCode::BracketLeft), Action::CameraBefore, "the camera before"),
    (key(KeyCode::BracketRight), Action::CameraNext, "the next camera"),
    (key(KeyCode::Escape), Action::FreeCamera, "a free camera"),
    (key(KeyCode::KeyC), Action::Show(Overlay::Contacts), "show what touches"),
    (key(KeyCode::KeyN), Action::Show(Overlay::Normals), "show the directions of contacts"),
    (key(KeyCode::KeyF), Action::Show(Overlay::Forces), "show the forces of contacts"),
    (key(KeyCode::KeyH), Action::Show(Overlay::HandForces), "show what the hands feel"),
    (key(KeyCode::KeyW), Action::Show(Overlay::Wireframe), "show edges of triangles"),
    (key(KeyCode::KeyB), Action::Show(Overlay::Boxes), "show bounding volumes"),
    (key(KeyCode::KeyT), Action::Show(Overlay::Trails), "show where tips have been"),
    (key(KeyCode::KeyA), Action::Show(Overlay::Axes), "show frames of reference"),
    (key(KeyCode::KeyM), Action::Show(Overlay::Names), "show names"),
    (key(KeyCode::KeyE), Action::Show(Overlay::Temperature), "show temperatures"),
    (key(KeyCode::KeyU), Action::Show(Overlay::Burn), "show burns"),
    (key(KeyCode::KeyS), Action::Show(Overlay::Field), "show stress, strain, or what a simulator gives"),
    (key(KeyCode::F4), Action::Mentor(MentorKey::Pen), "draw for the others: the mouse points and draws"),
    (control(KeyCode::KeyZ), Action::Mentor(MentorKey::EraseLast), "erase one's last stroke"),
    (control(KeyCode::KeyE), Action::Mentor(MentorKey::EraseAll), "erase all of one's strokes and labels"),
    (control(KeyCode::KeyL), Action::Mentor(MentorKey::Label), "a label where the mouse is"),
    (control(KeyCode::KeyF), Action::Mentor(MentorKey::Freeze), "freeze the pictures of all, let them go on"),
    (key(KeyCode::F9), Action::Mentor(MentorKey::AskLeft), "ask for the left instrument, give it back"),
    (key(KeyCode::F10), Action::Mentor(MentorKey::AskRight), "ask for the right instrument, give it back"),
    (key(KeyCode::F11), Action::Mentor(MentorKey::Accept), "hand over what is asked for, take it back"),
    (key(KeyCode::F12), Action::Mentor(MentorKey::Decline), "keep what is asked for"),
    (control(KeyCode::KeyP), Action::Screenshot, "a picture (PNG) in the working folder"),
    (control(KeyCode::KeyN), Action::NewWindow, "one more window"),
    (control(KeyCode::KeyW), Action::Close, "close this window"),
    (control(KeyCode::KeyQ), Action::Quit, "end"),
];

/// Mouse and wheel bindings, for the help.
pub const MOUSE: &[(&str, &str)] = &[
    ("left drag", "turn the camera about what it looks at"),
    ("right drag", "move the camera along the picture"),
    ("wheel", "closer, farther away"),
    ("double click", "select what is there"),
];

/// The action of this key.
pub fn action(code: KeyCode, modifiers: &Modifiers) -> Option<Action> {
    let state = modifiers.state();
    let chord = Chord {
        code,
        control: state.contains(ModifiersState::CONTROL),
        shift: state.contains(ModifiersState::SHIFT),
    };
    if state.intersects(ModifiersState::ALT | ModifiersState::SUPER) {
        return None;
    }
    KEYS.iter().find(|(known, ..)| *known == chord).map(|(_, action, _)| *action)
}

/// Whether the window keeps a key even while the player controls the instruments.
pub fn is_reserved(code: KeyCode, modifiers: &Modifiers) -> bool {
    let function = matches!(
        code,
        KeyCode::F1
            | KeyCode::F2
            | KeyCode::F3
            | KeyCode::F4
            | KeyCode::F5
            | KeyCode::F6
            | KeyCode::F7
            | KeyCode::F8
            | KeyCode::F9
            | KeyCode::F10
            | KeyCode::F11
            | KeyCode::F12
            | KeyCode::Escape
    );
    function || modifiers.state().contains(ModifiersState::CONTROL)
}

/// The name of a key for people.
pub fn name(chord: &Chord) -> String {
    let code = format!("{:?}", chord.code);
    let bare = match chord.code {
        KeyCode::Equal => "=",
        KeyCode::Minus => "-",
        KeyCode::BracketLeft => "[",
        KeyCode::BracketRight => "]",
        KeyCode::ArrowLeft => "←",
        KeyCode::ArrowRight => "→",
        _ => code.strip_prefix("Key").unwrap_or(&code),
    };
    let mut name = String::new();
    if chord.control {
        name.push_str("Ctrl+");
    }
    if chord.shift {
        name.push_str("Shift+");
    }
    name + bare
}

/// The key of an action, as a hint.
pub fn hint(action: Action) -> String {
    KEYS.iter().find(|(_, known, _)| *known == action).map(|(chord, ..)| name(chord)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_means_two_things_and_every_one_has_a_name_of_its_own() {
        let mut names: Vec<String> = KEYS.iter().map(|(chord, ..)| name(chord)).collect();
        let count = names.len();
        names.sort();
        names.dedup();
        assert_eq!(names.len(), count);
        assert!(names.contains(&"Ctrl+P".to_owned()) && names.contains(&"Shift+Tab".to_owned()));
    }

    #[test]
    fn everything_that_can_be_shown_has_a_key() {
        for overlay in Overlay::ALL {
            assert!(KEYS.iter().any(|(_, action, _)| *action == Action::Show(overlay)), "{overlay:?}");
        }
    }

    #[test]
    fn what_is_held_down_beside_a_key_counts() {
        let none = Modifiers::default();
        let control = Modifiers::from(ModifiersState::CONTROL);
        assert_eq!(action(KeyCode::KeyP, &none), None);
        assert_eq!(action(KeyCode::KeyP, &control), Some(Action::Screenshot));
        assert_eq!(action(KeyCode::Space, &none), Some(Action::Pause));
        assert_eq!(action(KeyCode::Space, &Modifiers::from(ModifiersState::ALT)), None);
        assert!(is_reserved(KeyCode::Escape, &none) && is_reserved(KeyCode::KeyQ, &control));
        assert!(!is_reserved(KeyCode::KeyW, &none));
    }
}
