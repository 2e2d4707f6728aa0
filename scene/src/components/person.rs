//! A person at a mouse, a keyboard or a gamepad: what it has asked of its two hands, as state.
//!
//! Everything that moves is a *total* since the source of the input began, kept per hand and after whatever
//! changes its meaning (the hand in charge, the clutch, the button that rolls, fine motion) has been taken into
//! account. So whoever reads it late, twice, or anew after a failure, misses nothing and puts nothing down to the
//! wrong hand: it takes the difference from the totals that it had seen. No key, button or axis of a device
//! stands here, only what it means.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::component::{Component, ComponentError};
use crate::components::device::Side;
use crate::components::graph::{Pose, check_rotation};
use crate::components::instrument::ActivationMode;
use crate::finite;
use crate::time::SimTime;

/// Largest total of a motion: days of an unresting hand. A source that reaches it begins anew, under another number.
pub const PERSON_TOTAL_MAX: f64 = 1e6;

macro_rules! actions {
    ($($variant:ident, $field:ident, $about:literal;)*) => {
        /// What a person can ask for by holding something down.
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
        )]
        #[serde(rename_all = "snake_case")]
        pub enum PersonAction {
            $(#[doc = $about] $variant,)*
        }

        impl PersonAction {
            /// Every action, in the order in which people are told about them.
            pub const ALL: &'static [Self] = &[$(Self::$variant,)*];

            /// Its name in files.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => stringify!($field),)* }
            }
            /// What it does, in a line.
            pub fn about(self) -> &'static str {
                match self { $(Self::$variant => $about,)* }
            }
        }

        /// How far each action is asked for: 1 for a key that is down, anything between 0 and 1 for a stick or a
        /// trigger.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(default, deny_unknown_fields)]
        pub struct PersonActions {
            $(#[doc = $about] pub $field: f64,)*
        }

        impl PersonActions {
            /// How far this action is asked for, 0 to 1.
            pub fn get(&self, action: PersonAction) -> f64 {
                match action { $(PersonAction::$variant => self.$field,)* }
            }
            /// Asks for it, as far as `amount` says: 0 to 1.
            pub fn set(&mut self, action: PersonAction, amount: f64) {
                match action { $(PersonAction::$variant => self.$field = amount,)* }
            }
        }
    };
}
actions! {
    MoveLeft, move_left, "moves the tip to the left in the picture";
    MoveRight, move_right, "moves the tip to the right in the picture";
    MoveUp, move_up, "moves the tip up in the picture";
    MoveDown, move_down, "moves the tip down in the picture";
    MoveAway, move_away, "moves the tip away from the viewer";
    MoveCloser, move_closer, "moves the tip closer to the viewer";
    RollLeft, roll_left, "rolls the instrument about its shaft, anticlockwise as its holder sees it";
    RollRight, roll_right, "rolls the instrument about its shaft, clockwise as its holder sees it";
    Grip, grip, "closes the jaws, as far as it is pressed; they open again when it is released";
    JawClose, jaw_close, "makes the opening of the released jaws smaller";
    JawOpen, jaw_open, "makes the opening of the released jaws larger";
    Activate, activate, "switches the instrument on, as a pedal does, until it is released";
    Coagulate, coagulate, "switches the instrument on to coagulate, as the second pedal does, until it is released";
    Turn, turn, "makes the pointer roll the instrument instead of moving it";
    Clutch, clutch, "lets pointer and wheel move without the hand";
    Fine, fine, "makes every motion a fifth as large";
    SwitchHand, switch_hand, "puts the other hand in charge; this one stays as it is";
}

/// What has been asked of one hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PersonHand {
    /// Motion of the tip in the picture, in all: to the right, down, and away from the viewer. One unit across is the
    /// height of the picture; one unit away multiplies the distance from the eye by *e*.
    pub moved: [f64; 3],
    /// Turn about the shaft in all, clockwise as its holder sees it \[rad\].
    pub rolled: f64,
    /// How far the jaws shall be open, as a share of their largest opening; none: as they are.
    pub opening: Option<f64>,
    /// How far the instrument is switched on, 0 to 1: only ever while something is held down.
    pub activation: f64,
    /// Which of two currents; none: the one that the instrument is set to.
    pub mode: Option<ActivationMode>,
}

/// From where a person looks.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PersonView {
    /// `world_from_view`: as a camera's, z along the line of sight, x to the right and y down in the picture.
    pub world_from_view: Pose,
    /// Vertical field of view \[rad\].
    pub field_of_view: f64,
}

/// What a person without a haptic device has asked for, by pointer, keyboard and gamepad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PersonInput {
    /// Whose totals these are. Under a new number they begin at zero again: a window that is opened anew moves
    /// nothing.
    pub source: u32,
    /// The hand in charge.
    pub in_charge: Side,
    /// What has been asked of the left hand.
    pub left: PersonHand,
    /// What has been asked of the right hand.
    pub right: PersonHand,
    /// What is held down now.
    pub held: PersonActions,
    /// From where the person looks; none: as the scene's first camera.
    pub view: Option<PersonView>,
    /// When this was so.
    pub sampled_at: SimTime,
}

impl Default for PersonInput {
    fn default() -> Self {
        Self {
            source: 0,
            in_charge: Side::Left,
            left: PersonHand::default(),
            right: PersonHand::default(),
            held: PersonActions::default(),
            view: None,
            sampled_at: SimTime::ZERO,
        }
    }
}

impl PersonInput {
    /// What has been asked of that hand.
    pub fn hand(&self, side: Side) -> &PersonHand {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }
    /// What has been asked of that hand, to be changed.
    pub fn hand_mut(&mut self, side: Side) -> &mut PersonHand {
        match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        }
    }
}

impl Component for PersonInput {
    const NAME: &'static str = "person_input";
    fn check(&self) -> Result<(), ComponentError> {
        finite::check(self)?;
        for hand in [&self.left, &self.right] {
            let totals = -PERSON_TOTAL_MAX..=PERSON_TOTAL_MAX;
            for moved in hand.moved {
                ComponentError::range("moved", moved, totals.clone(), "-1e6 to 1e6 heights of the picture")?;
            }
            ComponentError::range("rolled", hand.rolled, totals, "-1e6 to 1e6 rad")?;
            ComponentError::range("opening", hand.opening.unwrap_or(0.0), 0.0..=1.0, "0 to 1")?;
            ComponentError::range("activation", hand.activation, 0.0..=1.0, "0 to 1")?;
        }
        for action in PersonAction::ALL {
            ComponentError::range(action.name(), self.held.get(*action), 0.0..=1.0, "0 to 1")?;
        }
        if let Some(view) = &self.view {
            check_rotation(&view.world_from_view.rotation)?;
            ComponentError::range("field_of_view", view.field_of_view, 0.01..=3.0, "0.01 to 3 rad")?;
        }
        Ok(())
    }
    fn schema() -> Option<serde_json::Value> {
        super::schema_of::<Self>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_action_has_a_name_that_reads_back_and_a_place_of_its_own() {
        let mut held = PersonActions::default();
        for (index, action) in PersonAction::ALL.iter().enumerate() {
            held.set(*action, index as f64);
            let quoted = format!("\"{}\"", action.name());
            assert_eq!(serde_json::from_str::<PersonAction>(&quoted).ok(), Some(*action));
        }
        for (index, action) in PersonAction::ALL.iter().enumerate() {
            assert_eq!(held.get(*action), index as f64, "{}", action.name());
        }
    }

    #[test]
    fn what_no_person_can_ask_for_is_refused_by_name() {
        let refused = |change: &dyn Fn(&mut PersonInput)| {
            let mut input = PersonInput::default();
            change(&mut input);
            input.check().expect_err("refused").to_string()
        };
        assert!(PersonInput::default().check().is_ok());
        assert!(refused(&|input| input.left.moved[2] = 2e6).contains("moved: 2000000 is out of range"));
        assert!(refused(&|input| input.right.rolled = -1e7).contains("rolled"));
        assert!(refused(&|input| input.right.rolled = f64::NAN).contains("not finite"));
        assert!(refused(&|input| input.left.opening = Some(1.5)).contains("opening"));
        assert!(refused(&|input| input.right.activation = -0.1).contains("activation"));
        assert!(refused(&|input| input.held.fine = 2.0).contains("fine"));
        let view = |field_of_view| PersonView { world_from_view: Pose::default(), field_of_view };
        assert!(refused(&|input| input.view = Some(view(0.0))).contains("field_of_view"));
        let unknown = serde_json::from_str::<PersonInput>(r#"{ "left": { "moves": [0, 0, 0] } }"#);
        assert!(unknown.expect_err("refused").to_string().contains("moves"));
    }
}
