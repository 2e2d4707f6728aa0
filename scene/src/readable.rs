//! Text for people: numbers with few digits, SI prefixes, groups of three; and which characters are no text.
//!
//! ```
//! use trocar_scene::readable::{number, quantity};
//!
//! assert_eq!(quantity(1.4538053161607363e-7, "s").to_string(), "0.145 µs");
//! assert_eq!(quantity(8000.0, "Pa").to_string(), "8,000 Pa");
//! assert_eq!(number(137_571.0).to_string(), "137,571");
//! ```

use std::fmt;

/// Units that take a prefix, also in front of a quotient, such as `N/m`.
const PREFIXED: [&str; 9] = ["s", "m", "g", "N", "Pa", "Hz", "J", "W", "V"];
/// Prefixes of small quantities: the smallest magnitude written with each, its factor, and its letter.
const SMALL: [(f64, f64, &str); 4] = [(0.1, 1.0, ""), (1e-4, 1e3, "m"), (1e-7, 1e6, "µ"), (1e-10, 1e9, "n")];
/// The same of large ones: below 100,000 thousands are told apart by commas.
const LARGE: [(f64, f64, &str); 3] = [(1e9, 1e-9, "G"), (1e6, 1e-6, "M"), (1e5, 1e-3, "k")];
/// Magnitudes without a prefix that are written in digits.
const IN_DIGITS: std::ops::Range<f64> = 1e-4..1e9;
/// Longest text of a number that is repeated as it was given.
const GIVEN_MAX: usize = 12;
/// Significant digits of what is not a whole number.
const DIGITS: i32 = 3;

/// A number with its unit, as text for people.
#[derive(Clone, Copy, Debug)]
pub struct Quantity<'a> {
    value: f64,
    unit: &'a str,
}

/// A number with a unit: `20 ms` for 0.02 s.
#[must_use]
pub fn quantity(value: f64, unit: &str) -> Quantity<'_> {
    Quantity { value, unit }
}

/// A number without a unit: `137,571`, `0.125`.
#[must_use]
pub fn number(value: f64) -> Quantity<'static> {
    Quantity { value, unit: "" }
}

impl fmt::Display for Quantity<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Masses are told in grams below 100 g: a prefix never comes in front of another one.
        let (value, unit) = match self.unit {
            "kg" if self.value.abs() < 0.1 && self.value != 0.0 => (self.value * 1e3, "g"),
            unit => (self.value, unit),
        };
        let (factor, prefix) = prefix(value.abs(), unit);
        f.write_str(&digits(value * factor))?;
        if unit.is_empty() { Ok(()) } else { write!(f, " {prefix}{unit}") }
    }
}

/// A number as it was given, with all its digits, where those are few; a tiny or huge one as a power of ten.
#[must_use]
pub fn given(value: f64) -> String {
    let text = value.to_string();
    let is_tiny = value != 0.0 && value.abs() < IN_DIGITS.start;
    if is_tiny || text.len() > GIVEN_MAX { format!("{value:e}") } else { text }
}

/// Whether a character is shown nowhere, or changes how its neighbours are shown. Texts from outside must not have one:
/// it could make a text look like another one.
#[must_use]
pub fn is_hidden(character: char) -> bool {
    matches!(character, '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2060}'..='\u{206f}' | '\u{feff}')
        || character.is_control()
}

/// Factor and letter of the prefix for this magnitude.
fn prefix(magnitude: f64, unit: &str) -> (f64, &'static str) {
    let first = unit.split(['/', '·']).next().unwrap_or_default();
    if !PREFIXED.contains(&first) || magnitude == 0.0 || !magnitude.is_finite() {
        return (1.0, "");
    }
    let fitting = LARGE.iter().chain(&SMALL).find(|(from, ..)| magnitude >= *from);
    fitting.map_or((1.0, ""), |&(_, factor, prefix)| (factor, prefix))
}

/// Three significant digits, or all of a whole number.
fn digits(value: f64) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 {
        return "0".to_owned();
    }
    if !value.is_finite() {
        return value.to_string();
    }
    if !IN_DIGITS.contains(&magnitude) {
        let text = format!("{value:.2e}");
        let (digits, power) = text.split_once('e').unwrap_or((&text, "0"));
        return format!("{}e{power}", without_zeros(digits));
    }
    let decimals = (DIGITS - 1 - magnitude.log10().floor() as i32).clamp(0, 8) as usize;
    let text = format!("{value:.decimals$}");
    let text = without_zeros(&text);
    let (whole, part) = text.split_at(text.find('.').unwrap_or(text.len()));
    format!("{}{part}", grouped(whole))
}

/// Without zeros at the end of its decimals.
fn without_zeros(text: &str) -> &str {
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { text }
}

/// Groups of three digits: `137,571`.
fn grouped(whole: &str) -> String {
    let (sign, digits) = whole.split_at(usize::from(whole.starts_with('-')));
    let mut text = sign.to_owned();
    for (index, digit) in digits.chars().enumerate() {
        if index > 0 && (digits.len() - index) % 3 == 0 {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantities_have_few_digits_and_the_prefix_that_fits() {
        let cases = [
            (0.02, "s", "20 ms"),
            (1.4538053161607363e-7, "s", "0.145 µs"),
            (3.2e-9, "s", "3.2 ns"),
            (0.5, "s", "0.5 s"),
            (61.27, "s", "61.3 s"),
            (0.0015, "m", "1.5 mm"),
            (2.0, "m/s", "2 m/s"),
            (0.01, "m/s", "10 mm/s"),
            (1000.0, "N/m", "1,000 N/m"),
            (8000.0, "Pa", "8,000 Pa"),
            (250_000.0, "Pa", "250 kPa"),
            (1.5e6, "Pa", "1.5 MPa"),
            (0.005, "kg", "5 g"),
            (2e-6, "kg", "2 mg"),
            (12.0, "kg", "12 kg"),
            (-0.02, "s", "-20 ms"),
            (0.0, "N", "0 N"),
            (4e-5, "m³", "4e-5 m³"),
            (f64::INFINITY, "s", "inf s"),
        ];
        for (value, unit, text) in cases {
            assert_eq!(quantity(value, unit).to_string(), text, "{value:?} {unit}");
        }
    }

    #[test]
    fn what_was_given_is_repeated_and_extremes_are_powers_of_ten() {
        for (value, text) in [
            (0.1, "0.1"),
            (1.0001, "1.0001"),
            (-60.0, "-60"),
            (5e-9, "5e-9"),
            (1e300, "1e300"),
            (0.0, "0"),
            (0.0001, "0.0001"),
        ] {
            assert_eq!(given(value), text);
        }
    }

    #[test]
    fn counts_have_groups_of_three_digits() {
        let cases = [
            (0.0, "0"),
            (200.0, "200"),
            (999.0, "999"),
            (1000.0, "1,000"),
            (137_571.0, "137,571"),
            (12_345_678.0, "12,345,678"),
            (-1234.0, "-1,234"),
            (1.0 / 3.0, "0.333"),
            (1e30, "1e30"),
            (2.5e-6, "2.5e-6"),
            (-1.25e-7, "-1.25e-7"),
            (f64::NAN, "NaN"),
        ];
        for (value, text) in cases {
            assert_eq!(number(value).to_string(), text);
        }
    }
}
