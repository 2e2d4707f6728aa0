//! Strategy of a virtual trainee: the steps of a transfer, with distances and times.

use serde::{Deserialize, Serialize};

use crate::grasp_planner::GraspPlan;

/// Distances and times of the strategy; the same for every skill.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Strategy {
    /// Distance along the shaft from which a grasp is entered, and to which a hand withdraws \[m\].
    pub stand_off: f64,
    /// Tip tolerance before the jaws close \[m\].
    pub grasp_tolerance: f64,
    /// Tip tolerance at via points \[m\].
    pub way_tolerance: f64,
    /// Tolerance of a ring's centre from a peg's axis before it is lowered \[m\].
    pub peg_tolerance: f64,
    /// Room between a carried ring and the heads of the pegs \[m\].
    pub carry_clearance: f64,
    /// How far behind the boards' middle (away from the trainee) the hand-over takes place \[m\].
    pub hand_over_behind: f64,
    /// Height of the hand-over above the heads of the pegs \[m\].
    pub hand_over_above: f64,
    /// A grasp must last this long to count \[s\].
    pub verify_secs: f64,
    /// Time after which a pinch without a grasp is abandoned \[s\].
    pub pinch_secs: f64,
    /// Time without contact after which a ring counts as lost \[s\].
    pub loss_secs: f64,
    /// Below this speed a ring can be taken \[m/s\].
    pub rest_speed: f64,
    /// Time without a reachable ring after which the half is over \[s\].
    pub patience_secs: f64,
}

impl Default for Strategy {
    fn default() -> Self {
        Self {
            stand_off: 0.022,
            grasp_tolerance: 0.0005,
            way_tolerance: 0.003,
            peg_tolerance: 0.0015,
            carry_clearance: 0.006,
            hand_over_behind: 0.02,
            hand_over_above: 0.025,
            verify_secs: 0.1,
            pinch_secs: 1.0,
            loss_secs: 0.15,
            rest_speed: 0.01,
            patience_secs: 2.0,
        }
    }
}

/// Current step of a hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Step {
    /// Waits at its side.
    Rest,
    /// Goes to the stand-off point of a grasp, jaws open.
    Reach(GraspPlan),
    /// Goes in along the shaft.
    Enter(GraspPlan),
    /// Closes the jaws until contact.
    Pinch(GraspPlan),
    /// Raises the ring above the pegs.
    Lift,
    /// Brings it to the hand-over.
    Bring,
    /// Holds it there for the other hand.
    Offer,
    /// Has taken it; the other hand lets go.
    Take,
    /// Brings it over this peg.
    Over(usize),
    /// Puts it down around this peg.
    Lower(usize),
    /// Opens the jaws.
    Open,
    /// Withdraws along the shaft.
    Back,
}

impl Step {
    /// Name for traces.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Rest => "rest",
            Self::Reach(_) => "reach",
            Self::Enter(_) => "enter",
            Self::Pinch(_) => "pinch",
            Self::Lift => "lift",
            Self::Bring => "bring",
            Self::Offer => "offer",
            Self::Take => "take",
            Self::Over(_) => "over",
            Self::Lower(_) => "lower",
            Self::Open => "open",
            Self::Back => "back",
        }
    }
}
