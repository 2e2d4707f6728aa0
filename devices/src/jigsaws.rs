//! Reader of JIGSAWS kinematics (Gao et al., "JHU-ISI gesture and skill assessment working set", 2014).
//!
//! One row per frame at 30 Hz, 76 numbers, separated by white space or by commas (then with a header): master left
//! 1–19, master right 20–38, slave left 39–57, slave right 58–76; each position (3, m), rotation matrix row-major (9),
//! linear velocity (3), angular velocity (3), gripper angle (rad). The velocities of the file are not used: they are
//! filtered differently from the poses, and a replayed motion must be consistent.

use std::io::{BufRead, BufReader, Read};
use std::path::Path;

use nalgebra::{Isometry3, Matrix3, Rotation3, UnitQuaternion, Vector3};

use crate::device::DeviceState;
use crate::reader::{
    self, MAX_FILE_BYTES, MAX_ROWS, ReadError, RowProblem, check_gripper, check_position, parse_number,
};
use crate::trajectory::{Trajectory, TrajectoryPoint};

/// Numbers per row.
const COLUMNS: usize = 76;
/// Numbers per manipulator.
const BLOCK: usize = 19;
/// Frames per second.
const FRAME_RATE: u64 = 30;
/// Longest line that is read: 76 numbers of 100 characters \[bytes\].
const LINE_MAX: u64 = 8 * 1024;
/// How far a matrix may be from a rotation.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// Left or right hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JigsawsSide {
    /// The left hand.
    #[default]
    Left,
    /// The right hand.
    Right,
}

/// Which manipulator of a hand.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum JigsawsSource {
    /// The manipulator moved by the surgeon.
    #[default]
    Master,
    /// The manipulator in the patient.
    Slave,
}

/// Which of the four manipulators is read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct JigsawsSelection {
    /// Left or right hand.
    pub side: JigsawsSide,
    /// Master or slave.
    pub source: JigsawsSource,
}

impl JigsawsSelection {
    /// Index of the first of the 19 columns, from 0.
    fn first_column(self) -> usize {
        let source = if self.source == JigsawsSource::Master { 0 } else { 2 };
        let side = usize::from(self.side == JigsawsSide::Right);
        (source + side) * BLOCK
    }

    /// Name of a column, such as "52 (slave left, rotation 11)".
    fn column_name(self, within: usize) -> String {
        let source = if self.source == JigsawsSource::Master { "master" } else { "slave" };
        let side = if self.side == JigsawsSide::Left { "left" } else { "right" };
        let what = match within {
            0..=2 => format!("position {}", ["x", "y", "z"][within]),
            3..=11 => format!("rotation {}{}", (within - 3) / 3 + 1, (within - 3) % 3 + 1),
            12..=14 => "linear velocity".to_owned(),
            15..=17 => "angular velocity".to_owned(),
            _ => "gripper".to_owned(),
        };
        format!("{} ({source} {side}, {what})", self.first_column() + within + 1)
    }
}

/// Reads one manipulator of a file of kinematics. The first frame is at time zero.
///
/// Negative gripper angles, by which the recorded robot squeezes, count as closed.
///
/// # Errors
/// [`ReadError`] names file, line and column.
pub fn read_jigsaws(path: &Path, selection: JigsawsSelection) -> Result<Trajectory, ReadError> {
    let (file, name) = reader::open(path)?;
    read_jigsaws_from(file, &name, selection)
}

/// As [`read_jigsaws`], from any reader; `name` is used in messages.
///
/// # Errors
/// [`ReadError`] names file, line and column.
pub fn read_jigsaws_from(
    input: impl Read,
    name: &str,
    selection: JigsawsSelection,
) -> Result<Trajectory, ReadError> {
    let mut input = BufReader::new(input.take(MAX_FILE_BYTES + 1));
    let mut buffer = Vec::new();
    let mut points: Vec<TrajectoryPoint> = Vec::new();
    let (mut line, mut bytes) = (0_u64, 0_u64);
    let mut header_allowed = true;
    loop {
        buffer.clear();
        let read = (&mut input)
            .take(LINE_MAX + 1)
            .read_until(b'\n', &mut buffer)
            .map_err(|source| ReadError::Io { file: name.to_owned(), source })?;
        if read == 0 {
            break;
        }
        line += 1;
        bytes += read as u64;
        if bytes > MAX_FILE_BYTES {
            return Err(ReadError::TooBig { file: name.to_owned() });
        }
        let row_error = |problem| ReadError::Row { file: name.to_owned(), line, problem };
        if read as u64 > LINE_MAX {
            return Err(row_error(RowProblem::LineTooLong { limit: LINE_MAX }));
        }
        let text = buffer.trim_ascii();
        if text.is_empty() {
            continue;
        }
        let mut fields = [&[][..]; COLUMNS];
        let found = split(text, &mut fields);
        if found != COLUMNS {
            return Err(row_error(RowProblem::ColumnCount { found, expected: COLUMNS }));
        }
        let is_header = header_allowed
            && text.contains(&b',')
            && fields.iter().all(|field| matches!(parse_number(field), Err(RowProblem::NotANumber { .. })));
        header_allowed = false;
        if is_header {
            continue;
        }
        if points.len() >= MAX_ROWS {
            return Err(ReadError::TooManyRows { file: name.to_owned(), line });
        }
        let time_ns = points.len() as u64 * 1_000_000_000 / FRAME_RATE;
        let state = state(&fields, selection).map_err(|(within, problem)| ReadError::Value {
            file: name.to_owned(),
            line,
            column: selection.column_name(within),
            problem,
        })?;
        points.push(TrajectoryPoint { time_ns, state });
    }
    if points.is_empty() {
        return Err(ReadError::Empty { file: name.to_owned() });
    }
    Trajectory::with_differentiated_velocities(points)
        .map_err(|source| ReadError::Trajectory { file: name.to_owned(), source })
}

/// Splits a line at commas, or else at white space; returns the total number of fields.
fn split<'a>(text: &'a [u8], fields: &mut [&'a [u8]; COLUMNS]) -> usize {
    let mut found = 0;
    let mut take = |field: &'a [u8]| {
        if let Some(place) = fields.get_mut(found) {
            *place = field;
        }
        found += 1;
    };
    if text.contains(&b',') {
        text.split(|&byte| byte == b',').for_each(&mut take);
    } else {
        text.split(u8::is_ascii_whitespace).filter(|field| !field.is_empty()).for_each(&mut take);
    }
    found
}

fn state(fields: &[&[u8]; COLUMNS], selection: JigsawsSelection) -> Result<DeviceState, (usize, RowProblem)> {
    let first = selection.first_column();
    let mut values = [0.0; BLOCK];
    for (within, value) in values.iter_mut().enumerate() {
        *value = parse_number(fields[first + within]).map_err(|problem| (within, problem))?;
    }
    let position = Vector3::new(values[0], values[1], values[2]);
    check_position(&position)?;
    let rotation = rotation(&Matrix3::from_row_slice(&values[3..12])).map_err(|problem| (3, problem))?;
    let gripper = values[18];
    check_gripper(gripper).map_err(|problem| (18, problem))?;
    Ok(DeviceState {
        pose_in_device: Isometry3::from_parts(position.into(), rotation),
        gripper: gripper.max(0.0),
        connected: true,
        ..DeviceState::unknown()
    })
}

/// The rotation closest to a matrix that was printed with few digits (Gram–Schmidt).
fn rotation(matrix: &Matrix3<f64>) -> Result<UnitQuaternion<f64>, RowProblem> {
    let departure = (matrix.transpose() * matrix - Matrix3::identity()).amax();
    // Also rejects an overflow to NaN.
    if departure > ROTATION_TOLERANCE || !departure.is_finite() || matrix.determinant() <= 0.0 {
        return Err(RowProblem::NotARotation { departure });
    }
    let x = matrix.column(0).normalize();
    let across = matrix.column(1).into_owned();
    let y = (across - x * x.dot(&across)).normalize();
    let orthonormal = Matrix3::from_columns(&[x, y, x.cross(&y)]);
    Ok(UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(orthonormal)))
}
