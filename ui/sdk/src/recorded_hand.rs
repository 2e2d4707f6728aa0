//! Recorded hands: a device's measured states, read from a recording.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;
use thiserror::Error;
use trocar_devices::{Capabilities, Dofs, TrajectoryError, TrajectoryPoint, Workspace};
use trocar_kernel::recorder::{Recording, RecordingError, Replay};
use trocar_scene::{DeviceInfo, DeviceState, Entity, Registry};

use crate::hands::measured;

/// Why a recording cannot drive a hand.
#[derive(Debug, Error)]
pub enum RecordedHandError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] RecordingError),
    /// The file has no such hand.
    #[error("{file}: the recording has no device states of this hand")]
    NoHand {
        /// The file.
        file: String,
    },
    /// Its states are no valid motion.
    #[error(transparent)]
    Trajectory(#[from] TrajectoryError),
}

/// Every measured state of `hand`'s device, with the time of the driver's step, and the device's capabilities.
///
/// # Errors
/// [`RecordedHandError`].
pub fn read(
    registry: &Arc<Registry>,
    file: &Path,
    hand: Entity,
) -> Result<(Vec<TrajectoryPoint>, Capabilities), RecordedHandError> {
    let recording = Recording::open(file)?;
    let none = || RecordedHandError::NoHand { file: file.display().to_string() };
    recording.check_components(registry)?;
    let first = Replay::new(&recording, registry)?;
    let info = first.view().get::<DeviceInfo>(hand).cloned().ok_or_else(none)?;
    let mut points: Vec<TrajectoryPoint> = Vec::new();
    for (_, state) in recording.series::<DeviceState>(registry, hand)? {
        let point = TrajectoryPoint { time_ns: state.sampled_at.as_nanos(), state: measured(&state) };
        // A haptic controller that is faster than the driver records the same sample several times.
        if points.last().is_none_or(|last| last.time_ns < point.time_ns) {
            points.push(point);
        }
    }
    if points.is_empty() {
        return Err(none());
    }
    Ok((points, capabilities(&info)))
}

fn capabilities(info: &DeviceInfo) -> Capabilities {
    let dofs = |count: u8| match count {
        0 => Dofs::Zero,
        1..=3 => Dofs::Three,
        _ => Dofs::Six,
    };
    Capabilities {
        name: info.model.clone(),
        workspace: Workspace::centred(Vector3::from(info.workspace)),
        max_force_newtons: info.max_force,
        max_torque: info.max_torque,
        max_stiffness: info.max_stiffness,
        input_dofs: dofs(info.input_dofs),
        output_dofs: dofs(info.output_dofs),
        apparent_mass: info.apparent_mass,
    }
}
