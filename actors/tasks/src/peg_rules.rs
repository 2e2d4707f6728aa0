//! Rules of the peg-transfer exercise: set-up, thresholds, observations and kinds of error.

use nalgebra::{Point3, Vector3};
use serde::{Deserialize, Serialize};
use trocar_scene::Side;

use crate::fls_score::FlsWeights;
use crate::motion_metrics::IDLE_SPEED_DEFAULT;
use crate::peg_geometry::{FieldOfView, Peg, RingPlacement, RingShape};

/// Thresholds of the judgement.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rules {
    /// From this clearance above the board on a held ring counts as lifted \[m\].
    pub lift_clearance: f64,
    /// A hand-over below this clearance is not in mid-air \[m\].
    pub mid_air_clearance: f64,
    /// How long after the last opposing contact a hand still counts as holding \[s\].
    pub release_secs: f64,
    /// Below this speed a ring rests \[m/s\].
    pub rest_speed: f64,
    /// How long a ring must rest until it is judged \[s\].
    pub settle_secs: f64,
    /// Below this speed a hand is idle \[m/s\].
    pub idle_speed: f64,
    /// A ring that rests this far below the face of the boards has fallen off them, out of reach \[m\].
    pub fallen_below: f64,
}

impl Default for Rules {
    fn default() -> Self {
        Self {
            lift_clearance: 0.002,
            mid_air_clearance: 0.005,
            release_secs: 0.05,
            rest_speed: 0.02,
            settle_secs: 0.15,
            idle_speed: IDLE_SPEED_DEFAULT,
            fallen_below: 0.02,
        }
    }
}

/// The constant set-up of the exercise.
#[derive(Clone, Debug, PartialEq)]
pub struct PegTransferSetup {
    /// All pegs of both boards.
    pub pegs: Vec<Peg>,
    /// The rings' shape.
    pub ring: RingShape,
    /// The board on which the rings start.
    pub first_board: usize,
    /// The field of view.
    pub view: FieldOfView,
    /// Thresholds.
    pub rules: Rules,
    /// Score.
    pub weights: FlsWeights,
}

impl PegTransferSetup {
    /// Height of the ring's lowest point above the board face of the nearest peg \[m\]; without any peg, above
    /// the world's z = 0.
    pub fn clearance(&self, ring: &RingPlacement) -> f64 {
        let distance = |peg: &Peg| (ring.center_in_world - peg.foot_in_world).norm_squared();
        let nearest = self.pegs.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
        let (foot, up) =
            nearest.map_or((Point3::origin(), Vector3::z()), |peg| (peg.foot_in_world, peg.axis_in_world));
        self.ring.clearance(ring, &foot, &up)
    }
}

/// A ring as seen at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RingObservation {
    /// Its placement.
    pub placement: RingPlacement,
    /// Speed of its centre \[m/s\].
    pub speed: f64,
    /// Held by opposing contacts of the left, the right hand's jaws.
    pub held_by: [bool; 2],
    /// Touched by the left, the right hand's instrument.
    pub touched_by: [bool; 2],
}

/// An instrument's tip as seen at one moment, in world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipObservation {
    /// The tip \[m\].
    pub tip_in_world: Point3<f64>,
    /// Unit direction of the shaft from handle to tip.
    pub shaft_in_world: Vector3<f64>,
}

/// Kind of an error. [`ErrorKind::as_str`] gives the names in files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum ErrorKind {
    /// A ring was released in view, but not on a peg.
    DropInView,
    /// A ring left the field of view.
    DropOutOfView,
    /// A ring fell off the boards, out of the instruments' reach.
    DropOutOfReach,
    /// A ring was lifted by the receiving hand.
    WrongHand,
    /// A ring was handed over on the board or around a peg.
    NotInMidAir,
    /// A ring was placed on the other board without a valid hand-over.
    NoHandOver,
    /// A ring was placed on an occupied peg.
    PegOccupied,
    /// A placed ring was knocked off its peg.
    Displaced,
}

impl ErrorKind {
    /// Name in reports and scenario files.
    pub fn as_str(self) -> &'static str {
        match self {
            Self::DropInView => "drop_in_view",
            Self::DropOutOfView => "drop_out_of_view",
            Self::DropOutOfReach => "drop_out_of_reach",
            Self::WrongHand => "wrong_hand",
            Self::NotInMidAir => "not_in_mid_air",
            Self::NoHandOver => "no_hand_over",
            Self::PegOccupied => "peg_occupied",
            Self::Displaced => "displaced",
        }
    }
    /// Every kind, for checking names in files.
    pub const ALL: [Self; 8] = [
        Self::DropInView,
        Self::DropOutOfView,
        Self::DropOutOfReach,
        Self::WrongHand,
        Self::NotInMidAir,
        Self::NoHandOver,
        Self::PegOccupied,
        Self::Displaced,
    ];
}

/// One error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExerciseError {
    /// Its kind.
    pub kind: ErrorKind,
    /// When, on the observations' clock \[s\].
    pub at_secs: f64,
    /// Index of the ring.
    pub ring: usize,
}

/// An event of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TaskEvent {
    /// The clock started.
    Started,
    /// A ring was lifted.
    Lifted {
        /// Index of the ring.
        ring: usize,
        /// The lifting hand.
        by: Side,
    },
    /// A ring changed hands in mid-air.
    HandedOver {
        /// Index of the ring.
        ring: usize,
        /// The receiving hand.
        to: Side,
    },
    /// A ring rests on a free peg of the other board.
    Placed {
        /// Index of the ring.
        ring: usize,
        /// Index of the peg.
        peg: usize,
    },
    /// All rings were transferred; the second half (back) begins.
    Returning,
    /// An error.
    Error(ExerciseError),
    /// The exercise is over.
    Finished,
}
