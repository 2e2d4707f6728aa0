//! Times as recordings write them: numbers of seconds, milliseconds, microseconds or nanoseconds of any clock, times of day,
//! and dates with times (ISO 8601).
//!
//! They are read to the nanosecond: a Unix time in seconds, held as a 64-bit float, is off by up to 120 ns.

use std::ops::Range;

use crate::reader::{RowProblem, parse_number, quote};

const SECOND: i64 = 1_000_000_000;
/// Latest time, and earliest below zero: 100 years, so that Unix times fit and nanoseconds do not overflow \[ns\].
const TIME_MAX: i64 = 3_200_000_000 * SECOND;
/// Unix times of these years in seconds: 2001 to 2100. No other clock shows so many seconds.
const UNIX_SECONDS: Range<f64> = 1.0e9..4.1e9;

/// Unit of times that are numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimeUnit {
    /// s
    Seconds,
    /// ms
    Milliseconds,
    /// µs
    Microseconds,
    /// ns
    Nanoseconds,
}

impl TimeUnit {
    /// All of them.
    pub const ALL: [Self; 4] = [Self::Seconds, Self::Milliseconds, Self::Microseconds, Self::Nanoseconds];

    /// Its symbol in names of columns and in the text of devices.
    #[must_use]
    pub fn symbol(self) -> &'static str {
        match self {
            Self::Seconds => "s",
            Self::Milliseconds => "ms",
            Self::Microseconds => "us",
            Self::Nanoseconds => "ns",
        }
    }

    fn ns(self) -> i64 {
        match self {
            Self::Seconds => SECOND,
            Self::Milliseconds => 1_000_000,
            Self::Microseconds => 1_000,
            Self::Nanoseconds => 1,
        }
    }

    /// The unit in which a number is a Unix time; seconds if it is none in any unit.
    fn of(value: f64) -> Self {
        let unit = |unit: &Self| UNIX_SECONDS.contains(&(value * unit.ns() as f64 / SECOND as f64));
        Self::ALL.into_iter().find(unit).unwrap_or(Self::Seconds)
    }
}

/// A time and the unit in which it was written; none for a time of day or a date.
pub struct Time {
    pub ns: i64,
    pub unit: Option<TimeUnit>,
}

/// Reads a time \[ns\]: a number of the unit, or of the unit in which it is a Unix time; else a time of day or a date.
///
/// # Errors
/// It is none of these, or out of range.
pub fn parse_time(field: &[u8], unit: Option<TimeUnit>) -> Result<Time, RowProblem> {
    let text = std::str::from_utf8(field).map(str::trim).unwrap_or_default();
    if let Some(ns) = date_and_time(text) {
        return in_range(ns, seconds(ns)).map(|ns| Time { ns, unit: None });
    }
    let not_a_time = |problem| match problem {
        RowProblem::NotANumber { .. } => RowProblem::NotATime { text: quote(field) },
        other => other,
    };
    let value = parse_number(field).map_err(not_a_time)?;
    let unit = unit.unwrap_or_else(|| TimeUnit::of(value));
    // Beyond what 64 bits hold the cast saturates, which is out of range, too.
    let ns = decimal(text, unit.ns()).unwrap_or_else(|| (value * unit.ns() as f64).round() as i64);
    let shown = value * unit.ns() as f64 / SECOND as f64;
    in_range(ns, shown).map(|ns| Time { ns, unit: Some(unit) })
}

fn in_range(ns: i64, shown: f64) -> Result<i64, RowProblem> {
    let valid = (-TIME_MAX..=TIME_MAX).contains(&ns);
    if valid { Ok(ns) } else { Err(out_of_range(shown, -seconds(TIME_MAX))) }
}

/// A time \[s\] that is earlier than valid ones, or later.
pub fn out_of_range(value: f64, min: f64) -> RowProblem {
    RowProblem::OutOfRange { value, min, max: seconds(TIME_MAX), unit: "s" }
}

/// For messages \[s\].
pub fn seconds(ns: i64) -> f64 {
    ns as f64 / SECOND as f64
}

/// A plain decimal number times a unit, rounded; none for other ways to write a number, and where it overflows.
fn decimal(text: &str, unit: i64) -> Option<i64> {
    let (negative, text) = match text.strip_prefix('-') {
        Some(rest) => (true, rest),
        None => (false, text.strip_prefix('+').unwrap_or(text)),
    };
    let (whole, fraction) = text.split_once('.').unwrap_or((text, ""));
    let all_digits = whole.bytes().chain(fraction.bytes()).all(|byte| byte.is_ascii_digit());
    if !all_digits || whole.is_empty() {
        return None;
    }
    // Ten digits hold a nanosecond of a second; the tenth rounds.
    let fraction = &fraction[..fraction.len().min(10)];
    let part: i64 = if fraction.is_empty() { 0 } else { fraction.parse().ok()? };
    let scale = 10_i128.pow(fraction.len() as u32);
    let part = (2 * i128::from(part) * i128::from(unit) + scale) / (2 * scale);
    let ns = whole.parse::<i64>().ok()?.checked_mul(unit)?.checked_add(i64::try_from(part).ok()?)?;
    Some(if negative { -ns } else { ns })
}

/// A number of two digits below a limit.
fn two_digits(text: &str, below: i64) -> Option<i64> {
    let plain = text.len() == 2 && text.bytes().all(|byte| byte.is_ascii_digit());
    text.parse().ok().filter(|number| plain && *number < below)
}

/// A date with a time, in nanoseconds since 1970 (UTC); or a time of day, since midnight.
fn date_and_time(text: &str) -> Option<i64> {
    let Some((date, time)) = text.split_once(['T', 't', ' ']) else { return time_of_day(text) };
    let (time, east) = match time.strip_suffix(['Z', 'z']) {
        Some(time) => (time, 0),
        None => match time.rfind(['+', '-']) {
            Some(at) => {
                let sign = if time[at..].starts_with('-') { -1 } else { 1 };
                (&time[..at], sign * zone(&time[at + 1..])?)
            }
            // Without a zone it is as good as UTC: only differences matter.
            None => (time, 0),
        },
    };
    let days = days_since_1970(date)?;
    (days * 86_400 - east * 60).checked_mul(SECOND)?.checked_add(time_of_day(time.trim())?)
}

/// `HH:MM`, `HH:MM:SS` or `HH:MM:SS.fraction`.
fn time_of_day(text: &str) -> Option<i64> {
    let (hours, rest) = text.split_once(':')?;
    let (minutes, secs) = rest.split_once(':').unwrap_or((rest, "0"));
    let secs = decimal(secs, SECOND).filter(|ns| (0..61 * SECOND).contains(ns))?;
    Some((two_digits(hours, 25)? * 3_600 + two_digits(minutes, 60)? * 60) * SECOND + secs)
}

/// Minutes to the east: `HH:MM`, `HHMM` or `HH`.
fn zone(text: &str) -> Option<i64> {
    let (hours, minutes) = match text.split_once(':') {
        Some(parts) => parts,
        None if text.is_ascii() && text.len() == 4 => text.split_at(2),
        None => (text, "00"),
    };
    Some(two_digits(hours, 15)? * 60 + two_digits(minutes, 60)?)
}

/// Days from 1970-01-01 to a date of the Gregorian calendar, `YYYY-MM-DD` or `YYYY/MM/DD`.
fn days_since_1970(date: &str) -> Option<i64> {
    let mut parts = date.split(['-', '/']);
    let (year, month, day) = (parts.next()?, parts.next()?, parts.next()?);
    if parts.next().is_some() || year.len() != 4 || !year.bytes().all(|byte| byte.is_ascii_digit()) {
        return None;
    }
    let (year, month, day): (i64, i64, i64) =
        (year.parse().ok()?, two_digits(month, 13)?, two_digits(day, 32)?);
    let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let lengths = [31, if leap { 29 } else { 28 }, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31];
    let before = usize::try_from(month - 1).ok()?;
    if !(1..=*lengths.get(before)?).contains(&day) {
        return None;
    }
    let leap_days = |year: i64| year / 4 - year / 100 + year / 400;
    let years = (year - 1970) * 365 + leap_days((year - 1).max(0)) - leap_days(1969);
    Some(years + lengths[..before].iter().sum::<i64>() + day - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ns(text: &str) -> i64 {
        parse_time(text.as_bytes(), None).map(|time| time.ns).expect(text)
    }

    #[test]
    fn one_instant_is_read_to_the_nanosecond_in_every_way_of_writing_it() {
        // 2023-11-14 22:13:20 UTC is Unix time 1,700,000,000 (`date -u -d @1700000000`).
        let instant = 1_700_000_000_123_456_789;
        for text in [
            "1700000000.123456789",
            "1700000000123.456789",
            "1700000000123456.789",
            "1700000000123456789",
            "2023-11-14T22:13:20.123456789Z",
            "2023-11-14 22:13:20.123456789",
            "2023/11/14 22:13:20.123456789",
            "2023-11-14T23:13:20.123456789+01:00",
            "2023-11-14T16:43:20.123456789-0530",
            "2023-11-15t07:13:20.123456789+09",
        ] {
            assert_eq!(ns(text), instant, "{text}");
        }
        for (date, unix) in [
            ("1970-01-01T00:00:00Z", 0),
            ("2000-02-29T12:00:00Z", 951_825_600),
            ("2024-02-29T00:00:00Z", 1_709_164_800),
            ("2026-12-31T23:59:60Z", 1_798_761_600),
            ("2038-01-19T03:14:07Z", 2_147_483_647),
        ] {
            assert_eq!(ns(date), unix * SECOND, "{date}");
        }
    }

    #[test]
    fn small_numbers_are_seconds_unless_the_unit_is_given() {
        for (text, expected) in
            [("0.01", 10_000_000), ("2", 2 * SECOND), ("1e-3", 1_000_000), ("-2.5", -5 * SECOND / 2)]
        {
            assert_eq!(ns(text), expected);
        }
        for (unit, expected) in
            TimeUnit::ALL.into_iter().zip([12 * SECOND + SECOND / 2, 12_500_000, 12_500, 13])
        {
            assert_eq!(parse_time(b"12.5", Some(unit)).map(|time| time.ns), Ok(expected), "{unit:?}");
        }
        assert_eq!(ns("14:05:00.250"), 50_700_250_000_000);
    }

    #[test]
    fn what_is_no_time_is_refused() {
        for text in
            ["", "soon", "2023-13-01T00:00:00Z", "2023-02-29T00:00:00Z", "24:61:00", "1:2:3", "2023-11-14"]
        {
            let problem = parse_time(text.as_bytes(), None).err();
            assert!(matches!(problem, Some(RowProblem::NotATime { .. })), "{text}: {problem:?}");
        }
        assert_eq!(parse_time(b"nan", None).err(), Some(RowProblem::NotFinite));
        for text in ["1e300", "-1e300", "3200000001e9", "2101-12-31T00:00:00Z"] {
            let problem = parse_time(text.as_bytes(), None).err();
            assert!(matches!(problem, Some(RowProblem::OutOfRange { .. })), "{text}: {problem:?}");
        }
    }
}
