//! Ready fault plans for the peg transfer, by name: `trocar run peg-transfer --faults bad-day`.

use std::path::Path;

use thiserror::Error;
use trocar_kernel::faults::{FaultPlan, FaultPlanError};

/// Built-in plans: (name, text).
pub const PLANS: [(&str, &str); 21] = [
    ("bad-day", include_str!("../../../faults/bad-day.toml")),
    ("bad-network-day", include_str!("../../../faults/bad-network-day.toml")),
    ("device-stalled", include_str!("../../../faults/device-stalled.toml")),
    ("disk-full", include_str!("../../../faults/disk-full.toml")),
    ("dying-hand", include_str!("../../../faults/dying-hand.toml")),
    ("engine-killed", include_str!("../../../faults/engine-killed.toml")),
    ("engine-stalled", include_str!("../../../faults/engine-stalled.toml")),
    ("flaky-network", include_str!("../../../faults/flaky-network.toml")),
    ("haptics-killed", include_str!("../../../faults/haptics-killed.toml")),
    ("haptics-stalled", include_str!("../../../faults/haptics-stalled.toml")),
    ("model-killed", include_str!("../../../faults/model-killed.toml")),
    ("model-stalled", include_str!("../../../faults/model-stalled.toml")),
    ("nan-from-device", include_str!("../../../faults/nan-from-device.toml")),
    ("nan-from-physics", include_str!("../../../faults/nan-from-physics.toml")),
    ("queue-full", include_str!("../../../faults/queue-full.toml")),
    ("recorder-killed", include_str!("../../../faults/recorder-killed.toml")),
    ("slow-disk", include_str!("../../../faults/slow-disk.toml")),
    ("slow-physics", include_str!("../../../faults/slow-physics.toml")),
    ("task-killed", include_str!("../../../faults/task-killed.toml")),
    ("trainee-killed", include_str!("../../../faults/trainee-killed.toml")),
    ("unplugged", include_str!("../../../faults/unplugged.toml")),
];

/// Why a plan cannot be loaded.
#[derive(Debug, Error)]
pub enum PlanError {
    /// It is invalid.
    #[error(transparent)]
    Plan(#[from] FaultPlanError),
    /// No such plan.
    #[error("no fault plan is called '{name}', and there is no such file; there are: {known}")]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The valid names.
        known: String,
    },
}

/// The description in a plan's first line.
pub fn about(text: &str) -> &str {
    text.lines().next().unwrap_or_default().trim_start_matches('#').trim()
}

/// Loads a plan: a built-in name, or a file.
///
/// # Errors
/// When it does not exist or is invalid; the message names the place.
pub fn plan(name_or_file: &str) -> Result<FaultPlan, PlanError> {
    if let Some((name, text)) = PLANS.iter().find(|(name, _)| *name == name_or_file) {
        return Ok(FaultPlan::parse(text, &format!("{name}.toml"))?);
    }
    let path = Path::new(name_or_file);
    if path.exists() || path.extension().is_some() {
        return Ok(FaultPlan::read(path)?);
    }
    Err(PlanError::Unknown {
        name: name_or_file.to_owned(),
        known: PLANS.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", "),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_ready_plan_can_be_read_and_says_what_it_is() {
        for (name, text) in PLANS {
            let plan = plan(name).unwrap_or_else(|error| panic!("{error}"));
            assert!(!plan.faults.is_empty(), "{name}");
            assert!(about(text).ends_with('.') && plan.expect.force_newtons_max.is_some(), "{name}");
        }
    }

    #[test]
    fn an_unknown_name_lists_the_known_ones_and_a_missing_file_is_named() {
        assert!(plan("bad-dy").unwrap_err().to_string().contains("bad-day, bad-network-day, device-stalled"));
        assert!(plan("nowhere.toml").unwrap_err().to_string().contains("nowhere.toml"));
    }
}
