//! Errors of assembling, starting and finishing a session.

use thiserror::Error;
use trocar_devices::{BuildError, DriverThreadError, SpecError};
use trocar_kernel::SessionError;
use trocar_kernel::live::LiveError;
use trocar_kernel::recorder::RecorderError;
use trocar_scene::scenario::ScenarioError;

use crate::network::NetworkError;
use crate::options::ResumeError;
use crate::recorded_hand::RecordedHandError;

/// Why a session could not be assembled.
#[derive(Debug, Error)]
pub enum AssemblyError {
    /// The scenario is invalid.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A recording from whose end the session cannot go on.
    #[error(transparent)]
    Resume(#[from] ResumeError),
    /// A hand that the scenario does not have.
    #[error("--hand {name}: the scenario has no such hand; there are: {known}")]
    UnknownHand {
        /// The name that was asked for.
        name: String,
        /// The valid names.
        known: String,
    },
    /// A scenario without hands cannot be played.
    #[error("the scenario '{0}' has no hands, so nobody can play it: it needs a [[hand]]")]
    NoHands(String),
    /// The device's text is invalid.
    #[error("hand {hand}: {source}")]
    Spec {
        /// The hand.
        hand: String,
        /// Why.
        source: SpecError,
    },
    /// An unknown kind of device.
    #[error("hand {hand}: unknown device '{kind}'; there are: {known}")]
    UnknownDevice {
        /// The hand.
        hand: String,
        /// The kind that was asked for.
        kind: String,
        /// The valid kinds.
        known: String,
    },
    /// The text for one of the program's own devices is invalid.
    #[error("hand {hand}: {usage}: {reason}")]
    OwnDevice {
        /// The hand.
        hand: String,
        /// Its usage.
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
    /// The session cannot take part in a network.
    #[error(transparent)]
    Network(#[from] NetworkError),
}

/// Why a run could not start or could not be finished.
#[derive(Debug, Error)]
pub enum RunError {
    /// The session could not be assembled.
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
    /// The thread of the network's hands could not be started.
    #[error("the network's hands: {0}")]
    Network(std::io::Error),
}
