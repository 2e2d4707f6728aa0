//! Why a session could not be put together, started or finished.

use thiserror::Error;
use trocar_devices::{BuildError, DriverThreadError, SpecError};
use trocar_kernel::SessionError;
use trocar_kernel::live::LiveError;
use trocar_kernel::recorder::RecorderError;
use trocar_scene::scenario::ScenarioError;

use crate::recorded_hand::RecordedHandError;

/// Why a session could not be put together.
#[derive(Debug, Error)]
pub enum AssemblyError {
    /// Something in the scenario.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A hand that the scenario does not have.
    #[error("--hand {name}: the scenario has no such hand; there are: {known}")]
    UnknownHand {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A scenario that nobody can play.
    #[error("the scenario '{0}' has no hands, so nobody can play it: it needs a [[hand]]")]
    NoHands(String),
    /// A device that cannot be named like that.
    #[error("hand {hand}: {source}")]
    Spec {
        /// The hand.
        hand: String,
        /// Why.
        source: SpecError,
    },
    /// A device that there is not.
    #[error("hand {hand}: unknown device '{kind}'; there are: {known}")]
    UnknownDevice {
        /// The hand.
        hand: String,
        /// What was asked for.
        kind: String,
        /// What there is.
        known: String,
    },
    /// A device of the program's own that cannot be named like that.
    #[error("hand {hand}: {usage}: {reason}")]
    OwnDevice {
        /// The hand.
        hand: String,
        /// How it is written.
        usage: String,
        /// What is wrong.
        reason: String,
    },
    /// A device that could not be made.
    #[error("hand {hand}: {source}")]
    Device {
        /// The hand.
        hand: String,
        /// Why.
        source: BuildError,
    },
    /// A recording that holds no such hand.
    #[error("hand {hand}: {source}")]
    Recording {
        /// The hand.
        hand: String,
        /// Why.
        source: RecordedHandError,
    },
}

/// Why a run could not start or could not be finished.
#[derive(Debug, Error)]
pub enum RunError {
    /// The session could not be put together.
    #[error(transparent)]
    Assembly(#[from] AssemblyError),
    /// The kernel refused it in lock-step.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The kernel refused it live.
    #[error(transparent)]
    Live(#[from] LiveError),
    /// A device driver could not be started.
    #[error(transparent)]
    Driver(#[from] DriverThreadError),
    /// The recording could not be created.
    #[error(transparent)]
    Recorder(#[from] RecorderError),
}
