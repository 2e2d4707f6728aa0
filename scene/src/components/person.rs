//! Manual input by mouse, keyboard or gamepad for two hands, as state.
//!
//! Motions are *totals* since the start of the input source, kept per hand, after modifiers (the active hand, the
//! clutch, the roll button, fine motion) are applied. A reader that is late, reads twice or restarts takes the
//! difference from the totals that it saw last, so it loses no motion and assigns none to the wrong hand. The component
//! holds actions, not keys, buttons or axes of a device.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::components::device::Side;
use crate::components::graph::{Pose, check_rotation};
use crate::components::instrument::ActivationMode;
use crate::entity::Entity;
use crate::snapshot::Snapshot;
use crate::time::SimTime;
use crate::{Component, ComponentError};

/// Largest total of a motion: days of continuous motion. A source that reaches it restarts under a new number.
pub const PERSON_TOTAL_MAX: f64 = 1e6;

macro_rules! actions {
    ($($variant:ident, $field:ident, $about:literal;)*) => {
        /// Actions triggered by holding a key or button.
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema,
        )]
        #[serde(rename_all = "snake_case")]
        pub enum PersonAction {
            $(#[doc = $about] $variant,)*
        }

        impl PersonAction {
            /// Every action, in display order.
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

        /// Amount of each action: 1 for a pressed key, between 0 and 1 for a stick or a trigger.
        #[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(default, deny_unknown_fields)]
        pub struct PersonActions {
            $(#[doc = $about] pub $field: f64,)*
        }

        impl PersonActions {
            /// Amount of this action, 0 to 1.
            pub fn get(&self, action: PersonAction) -> f64 {
                match action { $(PersonAction::$variant => self.$field,)* }
            }
            /// Sets the amount of an action, 0 to 1.
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

/// Input for one hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PersonHand {
    /// Total motion of the tip in the image: to the right, down, and away from the viewer. One unit across is the
    /// height of the picture; one unit away multiplies the distance from the eye by *e*.
    pub moved: [f64; 3],
    /// Total roll about the shaft, clockwise as its holder sees it \[rad\].
    pub rolled: f64,
    /// Target jaw opening, as a share of the largest opening; none: unchanged.
    pub opening: Option<f64>,
    /// Activation of the instrument, 0 to 1; only while a key or button is held.
    pub activation: f64,
    /// Electrosurgical mode; none: the instrument's own setting.
    pub mode: Option<ActivationMode>,
}

/// Viewpoint of a person.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PersonView {
    /// `world_from_view`: as a camera's, z along the line of sight, x to the right and y down in the picture.
    pub world_from_view: Pose,
    /// Vertical field of view \[rad\].
    pub field_of_view: f64,
}

/// Input of a person without a haptic device, by pointer, keyboard and gamepad.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "person_input", check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct PersonInput {
    /// Number of the input source. Under a new number the totals restart at zero, so that reopening a window moves
    /// nothing.
    pub source: u32,
    /// The active hand.
    pub in_charge: Side,
    /// Input for the left hand.
    pub left: PersonHand,
    /// Input for the right hand.
    pub right: PersonHand,
    /// Actions held now.
    pub held: PersonActions,
    /// The person's viewpoint; none: the scene's first camera.
    pub view: Option<PersonView>,
    /// Time of the sample.
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
    /// The person of a scene. Of several it is the one of the station with the highest number: a station sees itself and
    /// its host, and its own person comes first.
    pub fn of(scene: &Snapshot) -> Option<(Entity, &Self)> {
        scene.iter::<Self>().max_by_key(|(entity, _)| (entity.station(), std::cmp::Reverse(*entity)))
    }
    /// Input for a hand.
    pub fn hand(&self, side: Side) -> &PersonHand {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }
    /// Mutable input for a hand.
    pub fn hand_mut(&mut self, side: Side) -> &mut PersonHand {
        match side {
            Side::Left => &mut self.left,
            Side::Right => &mut self.right,
        }
    }

    fn validate(&self) -> Result<(), ComponentError> {
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
