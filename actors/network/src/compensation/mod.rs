//! Delay compensation of a remote force: what one feels of a scene or a robot at the other side of a network.
//!
//! A delayed force is active. A hand that presses a spring over a delay has gone on before the force comes, and is still
//! pushed after it has gone back: the spring returns more energy than it was given, and hand and spring swing. On the
//! bench of this module, without compensation, 50 ms of round trip suffice. Energy is therefore what every method counts:
//! hands, devices and tissues are passive, and what couples them must be passive as well.
//!
//! A coupling has two ends, each stepped at its own local rate with whatever has arrived: a [`MasterEnd`] at a device that
//! shows forces, a [`SlaveEnd`] at a port in the scene whose position is commanded. Neither waits for the other.
//!
//! - **Passivity** ([`MasterPort`], [`SlavePort`]): each end puts out what its tank holds. Tanks share their energy by
//!   counters that only grow. In a gap of more than 50 ms the hand leans on the contact that is known here, as the remote
//!   force fades; a long silence takes that away as well.
//! - **Wave variables** ([`WaveMaster`], [`WaveSlave`]): what is sent is a wave whose energy a delay only stores. No energy
//!   has to be collected beforehand; instead the hand feels a drag at all times.
//! - **Model-mediated** ([`ContactEstimator`], [`RenderedContact`]): the slave tells what it touches, and the master
//!   renders that. As stiff as without delay, but of what was true a delay ago.
//! - **Automatic**: passivity up to a round trip of [`LONG_ROUND_TRIP`], model-mediated above, back below
//!   [`SHORT_ROUND_TRIP`]; both only after [`CHANGE_AFTER`]. The difference of the forces is blended over [`HAND_OVER`].
//!
//! The force of every method passes the master's [`MasterPort`], which gives the hand no more than is in the tank.
//!
//! # What is felt
//!
//! Zero force is no stability: the bench prints the felt stiffness over the undelayed one. An arm of 300 N/m presses walls
//! of 100, 500 and 2,000 N/m and a liver of 300 N/m that relaxes, for 60 s, over 0, 5, 20 % loss and 10 % in bursts of 40,
//! with 20 % jitter that reorders. The ranges are those of all matters and losses, at the end of the last press (24 s):
//!
//! | round trip | passivity | wave variables | model-mediated |
//! |---:|---|---|---|
//! | 0 ms | 0.99 to 1.00 | 0.98 to 1.00 | 0.99 to 1.01 |
//! | 50 ms | 0.99 to 1.00 | 0.98 to 1.00 | 0.99 to 1.01 |
//! | 100 ms | 0.98 to 0.99 | 0.99 to 1.00 | 0.99 to 1.01 |
//! | 300 ms | 0.95 to 0.99 | 0.53 to 1.00 | 0.99 to 1.01 |
//! | 1,000 ms | 0.17 to 0.99 | 0.23 to 1.00 | 0.99 to 1.01 |
//! | drag in the free [N·s/m] | 1.6 to 3.8 | 7.0 to 8.9 | 0.9 |
//!
//! The limits, and their causes:
//! - A force that comes late must push the hand back, and a hand must have put that energy in before. Where the tanks are
//!   empty, the hand stays as deep as it got, with little force, until it moves: passivity on a wall of 2,000 N/m at
//!   1,000 ms, where 2.3 N were withheld at the master. With a loose arm (100 N/m) the worst case is 0.41 at 50 ms and 0.24
//!   at 300 ms, with a stiff one (800 N/m) 0.14 at 300 ms.
//! - The line of waves is a spring in series; the slave's position is only corrected by what its matching damper took, and
//!   a hand at rest gives it nothing. The worst cases are a stiff arm on a wall of 2,000 N/m in bursts, 0.38 at 100 ms and
//!   0.55 without delay.
//! - A model is true where the matter is a plane that stays. It comes a round trip late at the first touch, contacts below
//!   0.3 N are not seen, and next to that limit its stiffness is up to 1.4 times the real one (loose arm, bursts). A liver
//!   that relaxes is felt up to 1.13 times as stiff.
//! - The bar at the operator's port counts from the start of a session, and the damper that fills the tanks is in it. Where
//!   a hand touches at once, the least energy was -0.4 mJ: the tank's [`CAPITAL`].
//! - Only translations are compensated, no torques.

mod block;
mod ends;
mod energy_tank;
mod model_mediated;
mod passivity;
mod wave_variables;

#[cfg(test)]
mod bench_tests;
#[cfg(test)]
mod teleoperation_testing;

pub use block::*;
pub use ends::*;
pub use energy_tank::*;
pub use model_mediated::*;
pub use passivity::*;
pub use wave_variables::*;

use serde::{Deserialize, Serialize};

/// How the delay between the two ends is compensated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Compensation {
    /// Time-domain passivity.
    Passivity,
    /// Wave variables.
    WaveVariables,
    /// Model-mediated.
    ModelMediated,
    /// Passivity up to a round trip of [`LONG_ROUND_TRIP`], model-mediated above.
    #[default]
    Automatic,
}

impl Compensation {
    /// The method at the start of a session.
    pub fn first_method(self) -> Method {
        match self {
            Self::Passivity | Self::Automatic => Method::Passivity,
            Self::WaveVariables => Method::WaveVariables,
            Self::ModelMediated => Method::ModelMediated,
        }
    }
}

/// Method that is rendered at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Time-domain passivity.
    #[default]
    Passivity,
    /// Wave variables.
    WaveVariables,
    /// Model-mediated.
    ModelMediated,
}

impl Method {
    /// Number in the datagram.
    pub fn number(self) -> u8 {
        match self {
            Self::Passivity => 0,
            Self::WaveVariables => 1,
            Self::ModelMediated => 2,
        }
    }

    /// The method of a number in the datagram.
    pub fn from_number(number: u8) -> Option<Self> {
        [Self::Passivity, Self::WaveVariables, Self::ModelMediated].into_iter().nth(number.into())
    }
}
