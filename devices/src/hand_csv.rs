//! Reader of hand motion as `t,x,y,z,qw,qx,qy,qz,gripper`: seconds, metres, radians, any rate.

use std::io::{BufReader, Read};
use std::path::Path;

use csv::{ByteRecord, ReaderBuilder, Trim};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use crate::device::DeviceState;
use crate::reader::{
    self, MAX_FILE_BYTES, MAX_ROWS, ReadError, RowProblem, StartTime, check_gripper, check_position,
    check_range, parse_number, quote,
};
use crate::trajectory::{Trajectory, TrajectoryPoint};

const COLUMNS: [&str; 9] = ["t", "x", "y", "z", "qw", "qx", "qy", "qz", "gripper"];
/// Latest time \[s\]: 100 years, so that Unix times fit and nanoseconds do not overflow.
const TIME_MAX: f64 = 3.2e9;
/// How far a quaternion may be from unit length.
const NORM_TOLERANCE: f64 = 1e-3;

/// Reads a file of hand motion. The header is required; its columns may come in any order. Velocities follow
/// from the poses.
///
/// # Errors
/// [`ReadError`] names file, line and column.
pub fn read_hand_csv(path: &Path, start: StartTime) -> Result<Trajectory, ReadError> {
    let (file, name) = reader::open(path)?;
    read_hand_csv_from(file, &name, start)
}

/// As [`read_hand_csv`], from any reader; `name` is used in messages.
///
/// # Errors
/// [`ReadError`] names file, line and column.
pub fn read_hand_csv_from(input: impl Read, name: &str, start: StartTime) -> Result<Trajectory, ReadError> {
    let mut csv = ReaderBuilder::new()
        .has_headers(false)
        .flexible(true)
        .trim(Trim::All)
        .from_reader(BufReader::new(input.take(MAX_FILE_BYTES + 1)));
    let mut record = ByteRecord::new();
    let io_error = |error: csv::Error| {
        let source = match error.into_kind() {
            csv::ErrorKind::Io(source) => source,
            other => std::io::Error::new(std::io::ErrorKind::InvalidData, format!("{other:?}")),
        };
        ReadError::Io { file: name.to_owned(), source }
    };
    if !csv.read_byte_record(&mut record).map_err(io_error)? {
        return Err(ReadError::Empty { file: name.to_owned() });
    }
    let order = column_order(&record, name)?;

    let mut points: Vec<TrajectoryPoint> = Vec::new();
    let mut first_secs = 0.0;
    let mut previous_secs = None;
    while csv.read_byte_record(&mut record).map_err(io_error)? {
        let position = csv.position();
        let line = record.position().map_or(position.line(), csv::Position::line);
        if position.byte() > MAX_FILE_BYTES {
            return Err(ReadError::TooBig { file: name.to_owned() });
        }
        if points.len() >= MAX_ROWS {
            return Err(ReadError::TooManyRows { file: name.to_owned(), line });
        }
        let values = row(&record, &order, name, line)?;
        let time_secs = values[0];
        if previous_secs.is_none() && start == StartTime::Zero {
            first_secs = time_secs;
        }
        let time_ns = ((time_secs - first_secs) * 1e9).round() as u64;
        if let Some(previous_secs) = previous_secs
            && points.last().is_some_and(|point| time_ns <= point.time_ns || time_secs <= previous_secs)
        {
            let problem = RowProblem::TimeNotIncreasing { time_secs, previous_secs };
            return Err(value_error(name, line, 0, problem));
        }
        previous_secs = Some(time_secs);
        points.push(TrajectoryPoint { time_ns, state: state(&values, name, line)? });
    }
    if points.is_empty() {
        return Err(ReadError::Empty { file: name.to_owned() });
    }
    Trajectory::with_differentiated_velocities(points)
        .map_err(|source| ReadError::Trajectory { file: name.to_owned(), source })
}

/// For each of [`COLUMNS`], its position in the file.
fn column_order(header: &ByteRecord, name: &str) -> Result<[usize; 9], ReadError> {
    let error = |problem: String| ReadError::Header {
        file: name.to_owned(),
        line: header.position().map_or(1, csv::Position::line),
        problem,
        valid: COLUMNS.join(","),
    };
    let mut order = [None; 9];
    for (index, field) in header.iter().enumerate() {
        // Spreadsheets write a byte order mark.
        let field = field.strip_prefix(b"\xef\xbb\xbf").unwrap_or(field);
        let Some(column) = COLUMNS.iter().position(|column| column.as_bytes() == field) else {
            return Err(error(format!("has an unknown column {}", quote(field))));
        };
        if order[column].replace(index).is_some() {
            return Err(error(format!("has the column {} twice", COLUMNS[column])));
        }
    }
    let mut found = [0; 9];
    for (column, place) in order.iter().enumerate() {
        found[column] = place.ok_or_else(|| error(format!("lacks the column {}", COLUMNS[column])))?;
    }
    Ok(found)
}

fn row(record: &ByteRecord, order: &[usize; 9], name: &str, line: u64) -> Result<[f64; 9], ReadError> {
    if record.len() != COLUMNS.len() {
        let problem = RowProblem::ColumnCount { found: record.len(), expected: COLUMNS.len() };
        return Err(ReadError::Row { file: name.to_owned(), line, problem });
    }
    let mut values = [0.0; 9];
    for (column, value) in values.iter_mut().enumerate() {
        *value = parse_number(&record[order[column]])
            .map_err(|problem| value_error(name, line, column, problem))?;
    }
    check_range(values[0], 0.0, TIME_MAX, "s").map_err(|problem| value_error(name, line, 0, problem))?;
    Ok(values)
}

fn state(values: &[f64; 9], name: &str, line: u64) -> Result<DeviceState, ReadError> {
    let [_, x, y, z, qw, qx, qy, qz, gripper] = *values;
    let position = Vector3::new(x, y, z);
    check_position(&position).map_err(|(axis, problem)| value_error(name, line, 1 + axis, problem))?;
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let norm = quaternion.norm();
    // Also rejects an overflow to infinity.
    if (norm - 1.0).abs() > NORM_TOLERANCE || !norm.is_finite() {
        let problem = RowProblem::NotNormalised { norm };
        return Err(ReadError::Value { file: name.to_owned(), line, column: "qw..qz".to_owned(), problem });
    }
    check_gripper(gripper).map_err(|problem| value_error(name, line, 8, problem))?;
    Ok(DeviceState {
        pose_in_device: Isometry3::from_parts(position.into(), UnitQuaternion::new_normalize(quaternion)),
        gripper,
        connected: true,
        ..DeviceState::unknown()
    })
}

fn value_error(name: &str, line: u64, column: usize, problem: RowProblem) -> ReadError {
    ReadError::Value { file: name.to_owned(), line, column: COLUMNS[column].to_owned(), problem }
}
