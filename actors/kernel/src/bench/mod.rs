//! Kernel benchmarks, measured in interleaved blocks beside a floor of the same kind on the same machine: on a shared
//! machine the ratio to the floor is more meaningful than an absolute time.

mod access;
mod latency;
mod rates;
mod scene;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::live::LiveError;

pub use rates::{BareRates, bare_rates};

/// How long a suite may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// A few seconds: a functional check.
    Smoke,
    /// A minute or so: for figures to be reported.
    Full,
}

/// Whether smaller or larger values are better.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// The smaller, the better.
    Lower,
    /// The larger, the better.
    Higher,
}

impl Better {
    /// Whether `value` is on the good side of `bar`; NaN never is.
    pub fn holds(self, value: f64, bar: f64) -> bool {
        match self {
            Self::Lower => value <= bar,
            Self::Higher => value >= bar,
        }
    }
}

/// One measured figure.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
#[schemars(rename = "BenchResult")]
pub struct Row {
    /// What was measured.
    pub name: String,
    /// Median over the blocks, in `unit`.
    pub value: f64,
    /// Unit of `value` and `floor`.
    pub unit: String,
    /// Value of a bare loop of the same kind, in interleaved blocks.
    pub floor: Option<f64>,
    /// `value / floor`.
    pub ratio: Option<f64>,
    /// Bar for the ratio (or, without a floor, for the value); null for informative figures.
    pub bar: Option<f64>,
    /// Which side of the bar passes.
    pub better: Better,
    /// Whether the bar is met; true without a bar.
    pub holds: bool,
    /// (largest − smallest) / median of the blocks.
    pub spread: f64,
}

impl Row {
    /// A figure, (median, spread) as [`median_and_spread`] gives them, compared with a bar on the value itself.
    pub fn on_value(
        name: impl Into<String>,
        unit: impl Into<String>,
        (value, spread): (f64, f64),
        bar: Option<f64>,
        better: Better,
    ) -> Self {
        let holds = bar.is_none_or(|bar| better.holds(value, bar));
        let (name, unit) = (name.into(), unit.into());
        Self { name, value, unit, floor: None, ratio: None, bar, better, holds, spread }
    }

    /// A figure compared with a bar on its ratio to a floor measured beside it.
    pub fn on_ratio(
        name: impl Into<String>,
        unit: impl Into<String>,
        (value, spread): (f64, f64),
        floor: f64,
        bar: Option<f64>,
        better: Better,
    ) -> Self {
        let ratio = if floor != 0.0 { value / floor } else { f64::INFINITY };
        let holds = bar.is_none_or(|bar| better.holds(ratio, bar));
        let (name, unit) = (name.into(), unit.into());
        // JSON has no infinity: the ratio to a floor of zero is left unknown.
        let ratio = Some(ratio).filter(|ratio| ratio.is_finite());
        Self { name, value, unit, floor: Some(floor), ratio, bar, better, holds, spread }
    }
}

/// Median of several blocks, and (largest − smallest) / median; NaN and 0 for an empty slice.
pub fn median_and_spread(values: &[f64]) -> (f64, f64) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (Some(low), Some(high)) = (sorted.first(), sorted.last()) else { return (f64::NAN, 0.0) };
    let middle = sorted.len() / 2;
    let median =
        if sorted.len() % 2 == 1 { sorted[middle] } else { 0.5 * (sorted[middle - 1] + sorted[middle]) };
    (median, if median == 0.0 { 0.0 } else { (high - low) / median.abs() })
}

pub(crate) fn median(values: &[f64]) -> f64 {
    median_and_spread(values).0
}

/// Runs the whole suite.
///
/// # Errors
/// When a session does not start.
pub fn kernel(effort: Effort) -> Result<Vec<Row>, LiveError> {
    let mut rows = rates::two_hands(effort)?;
    rows.extend(rates::one_hand_at_10_khz(effort)?);
    rows.extend(access::get(effort));
    rows.extend(latency::write_to_visible(effort)?);
    rows.extend(latency::model_cpu(effort)?);
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_spreads_of_known_values() {
        assert_eq!(median_and_spread(&[4.0, 1.0, 2.0]), (2.0, 1.5));
        assert_eq!(median_and_spread(&[4.0, 1.0, 2.0, 3.0]).0, 2.5);
        assert_eq!(median_and_spread(&[0.0, 0.0]), (0.0, 0.0));
        assert!(median_and_spread(&[]).0.is_nan());
    }

    #[test]
    fn a_bar_holds_on_its_good_side_only() {
        let row = |value, better| Row::on_value("x", "ns", (value, 0.0), Some(60.0), better).holds;
        assert!(row(60.0, Better::Lower) && row(60.0, Better::Higher));
        assert!(row(12.0, Better::Lower) && !row(12.0, Better::Higher));
        assert!(!row(f64::NAN, Better::Lower) && !row(f64::NAN, Better::Higher));
        assert!(Row::on_value("x", "ns", (5.0, 0.0), None, Better::Lower).holds, "told, not judged");
    }

    #[test]
    fn a_ratio_is_held_against_the_bar_and_a_floor_of_nothing_gives_none() {
        let row = Row::on_ratio("x", "us", (30.0, 1.0), 25.0, Some(1.0), Better::Lower);
        assert_eq!(row.ratio, Some(1.2));
        assert!(!row.holds);
        let row = Row::on_ratio("x", "us", (30.0, 1.0), 0.0, Some(1.5), Better::Lower);
        assert_eq!((row.ratio, row.holds), (None, false));
    }
}
