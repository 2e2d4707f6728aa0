//! A command's failure: a message for people and an exit code for scripts.

use std::fmt::Display;

use trocar::app::AppError;
use trocar::assembly::AssemblyError;
use trocar::network::NetworkError;
use trocar::run::RunError;
use trocar::summary::Exit;
use trocar_kernel::live::LiveError;
use trocar_scene::output_file::OutputError;
use trocar_viewer::ViewError;

/// Why a command failed.
#[derive(Debug)]
pub struct Failure {
    /// The exit code.
    pub exit: Exit,
    /// The error, its place, and the valid choices.
    pub message: String,
}

impl Failure {
    /// An invalid command line.
    pub fn usage(message: impl Display) -> Self {
        Self { exit: Exit::Usage, message: message.to_string() }
    }
    /// An invalid scenario or file.
    pub fn invalid(message: impl Display) -> Self {
        Self { exit: Exit::Invalid, message: message.to_string() }
    }
    /// A fault of the program or the machine.
    pub fn internal(message: impl Display) -> Self {
        Self { exit: Exit::Internal, message: message.to_string() }
    }
}

/// The name among `known` that is most like `name`, if any is alike.
pub fn closest<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    known
        .into_iter()
        .map(|candidate| (strsim::jaro_winkler(name, candidate), candidate))
        .filter(|(likeness, _)| *likeness > 0.75)
        .max_by(|(a, _), (b, _)| a.total_cmp(b))
        .map(|(_, candidate)| candidate)
}

/// `; did you mean 'x'?` or nothing.
pub fn did_you_mean<'a>(name: &str, known: impl IntoIterator<Item = &'a str>) -> String {
    closest(name, known).map_or_else(String::new, |best| format!("; did you mean '{best}'?"))
}

impl From<AppError> for Failure {
    fn from(error: AppError) -> Self {
        match &error {
            AppError::UnknownScenario { name, .. } => {
                let names = trocar::app::SCENARIOS.iter().map(|(known, _)| *known);
                Self::invalid(format!("{error}{}", did_you_mean(name, names)))
            }
            AppError::Scenario(_) => Self::invalid(error),
            AppError::Setup(_) => Self::internal(error),
        }
    }
}

impl From<NetworkError> for Failure {
    fn from(error: NetworkError) -> Self {
        Self { exit: Exit::of_network(error.exit_class()), message: error.to_string() }
    }
}

impl From<OutputError> for Failure {
    fn from(error: OutputError) -> Self {
        Self::invalid(error)
    }
}

impl From<ViewError> for Failure {
    fn from(error: ViewError) -> Self {
        match &error {
            ViewError::NoAdapter(_) | ViewError::Refused { .. } | ViewError::DeviceLost(_) => {
                Self { exit: Exit::DeviceMissing, message: error.to_string() }
            }
            ViewError::NoCamera { .. } => Self::usage(error),
            ViewError::Size { .. } | ViewError::File { .. } => Self::invalid(error),
        }
    }
}

impl From<RunError> for Failure {
    fn from(error: RunError) -> Self {
        match &error {
            RunError::Assembly(
                AssemblyError::UnknownHand { .. }
                | AssemblyError::UnknownDevice { .. }
                | AssemblyError::OwnDevice { .. }
                | AssemblyError::Spec { .. },
            ) => Self::usage(error),
            RunError::Assembly(AssemblyError::Network(network)) => {
                Self { exit: Exit::of_network(network.exit_class()), message: error.to_string() }
            }
            RunError::Assembly(_) | RunError::Recorder(_) | RunError::Session(_) => Self::invalid(error),
            RunError::Live(LiveError::Thread(_)) | RunError::Driver(_) | RunError::Network(_) => {
                Self::internal(error)
            }
            RunError::Live(_) => Self::invalid(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_of_the_pen_finds_its_word_and_nonsense_finds_none() {
        let known = ["peg-transfer", "wall"];
        assert_eq!(closest("peg-tranfser", known), Some("peg-transfer"));
        assert_eq!(closest("pegtransfer", known), Some("peg-transfer"));
        assert_eq!(closest("zzz", known), None);
    }
}
