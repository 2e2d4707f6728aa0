//! Reader of hand motion as `t,x,y,z,qw,qx,qy,qz,gripper`: any clock and rate, metres, radians.

use std::io::{BufReader, Read};
use std::path::Path;

use csv::{ByteRecord, ReaderBuilder, Trim};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use crate::clock::{TimeUnit, out_of_range, parse_time, seconds};
use crate::device::DeviceState;
use crate::reader::{
    self, MAX_FILE_BYTES, MAX_ROWS, ReadError, RowProblem, StartTime, check_gripper, check_position,
    parse_number, quote,
};
use crate::trajectory::{Trajectory, TrajectoryPoint};

const COLUMNS: [&str; 9] = ["t", "x", "y", "z", "qw", "qx", "qy", "qz", "gripper"];
/// Latest first row of a file whose times are session times: a day \[ns\].
const SESSION_MAX: i64 = 86_400_000_000_000;
/// From so many rows on, their mean distance tells whether the unit of time is right …
const ROWS_MANY: usize = 50;
/// … for people move their hands faster than this \[ns\].
const APART_MAX: i64 = 500_000_000;
/// How far a quaternion may be from unit length.
const NORM_TOLERANCE: f64 = 1e-3;

/// Reads a file of hand motion. The header is required; its columns may come in any order. Velocities follow
/// from the poses.
///
/// Times are dates, times of day, or numbers of the unit: if none is given, that of the column's name (`t_s`, `t_ms`,
/// `t_us`, `t_ns`), or else the one in which the first number is a Unix time, or else seconds.
///
/// # Errors
/// [`ReadError`] names file, line and column.
pub fn read_hand_csv(path: &Path, start: StartTime, unit: Option<TimeUnit>) -> Result<Trajectory, ReadError> {
    let (file, name) = reader::open(path)?;
    read_hand_csv_from(file, &name, start, unit)
}

/// As [`read_hand_csv`], from any reader; `name` is used in messages.
///
/// # Errors
/// [`ReadError`] names file, line and column.
pub fn read_hand_csv_from(
    input: impl Read,
    name: &str,
    start: StartTime,
    unit: Option<TimeUnit>,
) -> Result<Trajectory, ReadError> {
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
    let (order, unit_of_column) = column_order(&record, name)?;
    let mut rows =
        Rows { name, start, unit: unit.or(unit_of_column), guessed: false, first: None, last: None };

    // The parser ends a row at a carriage return and counts the line with the line feed that follows.
    let ends_early = record.position().is_some_and(|at| at.line() == csv.position().line());
    let mut points: Vec<TrajectoryPoint> = Vec::new();
    let mut count = 0;
    while csv.read_byte_record(&mut record).map_err(io_error)? {
        let position = csv.position();
        let line = record.position().map_or(position.line(), csv::Position::line) + u64::from(ends_early);
        if position.byte() > MAX_FILE_BYTES {
            return Err(ReadError::TooBig { file: name.to_owned() });
        }
        if count >= MAX_ROWS {
            return Err(ReadError::TooManyRows { file: name.to_owned(), line });
        }
        count += 1;
        let values = row(&record, &order, name, line)?;
        let time_ns = rows.time(&record[order[0]], line)?;
        let state = state(&values, name, line)?;
        // Earlier ones are left out, but checked.
        if let Some(time_ns) = time_ns {
            points.push(TrajectoryPoint { time_ns, state });
        }
    }
    rows.check(count, points.len())?;
    Trajectory::with_differentiated_velocities(points)
        .map_err(|source| ReadError::Trajectory { file: name.to_owned(), source })
}

/// The times of a file's rows.
struct Rows<'a> {
    name: &'a str,
    start: StartTime,
    /// Unit of numbers, once it is known.
    unit: Option<TimeUnit>,
    /// Whether it follows from the first number.
    guessed: bool,
    first: Option<i64>,
    /// Time and line of the last row.
    last: Option<(i64, u64)>,
}

impl Rows<'_> {
    fn error(&self, line: u64, problem: RowProblem) -> ReadError {
        value_error(self.name, line, 0, problem)
    }

    /// Session time of the next row \[ns\]; none before the start of the session.
    fn time(&mut self, field: &[u8], line: u64) -> Result<Option<u64>, ReadError> {
        let time = parse_time(field, self.unit).map_err(|problem| self.error(line, problem))?;
        if self.unit.is_none() {
            (self.unit, self.guessed) = (time.unit, time.unit.is_some());
        }
        let ns = time.ns;
        if self.start == StartTime::File && ns < 0 {
            return Err(self.error(line, out_of_range(seconds(ns), 0.0)));
        }
        if let Some((previous, _)) = self.last
            && ns <= previous
        {
            let (time_secs, previous_secs) = (seconds(ns), seconds(previous));
            return Err(self.error(line, RowProblem::TimeNotIncreasing { time_secs, previous_secs }));
        }
        self.last = Some((ns, line));
        let first = *self.first.get_or_insert(ns);
        match self.start {
            StartTime::Zero => Ok(u64::try_from(ns - first).ok()),
            StartTime::At(start) => Ok(u64::try_from(ns.saturating_sub(start)).ok()),
            StartTime::File if ns == first && ns > SESSION_MAX => {
                Err(self.error(line, RowProblem::NotSessionTime { time_secs: seconds(ns) }))
            }
            StartTime::File => Ok(u64::try_from(ns).ok()),
        }
    }

    /// Checks the file as a whole, of which so many rows are played.
    fn check(&self, count: usize, played: usize) -> Result<(), ReadError> {
        let (Some(first), Some((last, line))) = (self.first, self.last) else {
            return Err(ReadError::Empty { file: self.name.to_owned() });
        };
        if let (0, StartTime::At(start)) = (played, self.start) {
            let (start_secs, time_secs) = (seconds(start), seconds(last));
            return Err(self.error(line, RowProblem::OverBeforeStart { start_secs, time_secs }));
        }
        let apart = (last - first) / (count as i64 - 1).max(1);
        if self.guessed && count >= ROWS_MANY && apart >= APART_MAX {
            return Err(self.error(line, RowProblem::TooSlow { rows: count, apart_secs: seconds(apart) }));
        }
        Ok(())
    }
}

/// The column of a heading, and the unit of time that the heading names.
fn column_of(heading: &[u8]) -> Option<(usize, Option<TimeUnit>)> {
    let unit = TimeUnit::ALL.into_iter().find(|unit| heading == format!("t_{}", unit.symbol()).as_bytes());
    let column = COLUMNS.iter().position(|column| column.as_bytes() == heading);
    column.or(unit.map(|_| 0)).map(|column| (column, unit))
}

/// For each of [`COLUMNS`], its position in the file, and the unit of time that the header names.
fn column_order(header: &ByteRecord, name: &str) -> Result<([usize; 9], Option<TimeUnit>), ReadError> {
    let error = |problem: String| ReadError::Header {
        file: name.to_owned(),
        line: header.position().map_or(1, csv::Position::line),
        problem,
        valid: COLUMNS.join(","),
    };
    let (mut order, mut unit) = ([None; 9], None);
    for (index, field) in header.iter().enumerate() {
        // Spreadsheets write a byte order mark.
        let field = field.strip_prefix(b"\xef\xbb\xbf").unwrap_or(field);
        let Some((column, unit_of_column)) = column_of(field) else {
            return Err(error(format!("has an unknown column {}", quote(field))));
        };
        unit = unit.or(unit_of_column);
        if order[column].replace(index).is_some() {
            return Err(error(format!("has the column {} twice", COLUMNS[column])));
        }
    }
    let mut found = [0; 9];
    for (column, place) in order.iter().enumerate() {
        found[column] = place.ok_or_else(|| error(format!("lacks the column {}", COLUMNS[column])))?;
    }
    Ok((found, unit))
}

/// The numbers of a row; the first, its time, is read on its own.
fn row(record: &ByteRecord, order: &[usize; 9], name: &str, line: u64) -> Result<[f64; 9], ReadError> {
    if record.len() != COLUMNS.len() {
        let problem = RowProblem::ColumnCount { found: record.len(), expected: COLUMNS.len() };
        return Err(ReadError::Row { file: name.to_owned(), line, problem });
    }
    let mut values = [0.0; 9];
    for (column, value) in values.iter_mut().enumerate().skip(1) {
        *value = parse_number(&record[order[column]])
            .map_err(|problem| value_error(name, line, column, problem))?;
    }
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
