//! What the kernel costs, measured beside a floor of the same kind on the same machine in interleaved blocks:
//! on a shared machine an absolute time says little, a ratio to the floor says much.

mod access;
mod latency;
mod rates;
mod scene;

use serde::{Deserialize, Serialize};

use crate::live::LiveError;

pub use rates::{BareRates, bare_rates};

/// How long a suite may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// A few seconds: to see that it works.
    Smoke,
    /// A minute or so: for figures to be reported.
    Full,
}

/// One measured figure: a row of `results[]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// What was measured.
    pub name: String,
    /// Median over the blocks.
    pub value: f64,
    /// Unit of `value`.
    pub unit: String,
    /// The same measured on the floor, where there is one.
    pub floor: Option<f64>,
    /// `value / floor`.
    pub ratio: Option<f64>,
    /// What the ratio (or, without a floor, the value) has to reach.
    pub bar: Option<f64>,
    /// `lower` or `higher`.
    pub better: String,
    /// Whether it does; none without a bar.
    pub holds: Option<bool>,
    /// (largest − smallest) / median over the blocks.
    pub spread: f64,
}

/// Which way is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Better {
    Lower,
    Higher,
}

impl Row {
    /// The median of `blocks` against a bar on the value itself.
    pub(crate) fn on_value(name: &str, unit: &str, blocks: &[f64], bar: Option<f64>, better: Better) -> Self {
        let value = median(blocks);
        Self::finish(name, unit, value, None, bar, better, spread(blocks))
    }
    /// The median of `blocks` beside that of the floor's, against a bar on the ratio.
    pub(crate) fn on_ratio(
        name: &str,
        unit: &str,
        blocks: &[f64],
        floor: &[f64],
        bar: f64,
        better: Better,
    ) -> Self {
        let (value, floor) = (median(blocks), median(floor));
        Self::finish(name, unit, value, Some(floor), Some(bar), better, spread(blocks))
    }

    fn finish(
        name: &str,
        unit: &str,
        value: f64,
        floor: Option<f64>,
        bar: Option<f64>,
        better: Better,
        spread: f64,
    ) -> Self {
        let ratio = floor.filter(|floor| *floor != 0.0).map(|floor| value / floor);
        let judged = ratio.unwrap_or(value);
        let holds = bar.map(|bar| match better {
            Better::Lower => judged <= bar,
            Better::Higher => judged >= bar,
        });
        let better = match better {
            Better::Lower => "lower",
            Better::Higher => "higher",
        };
        Self {
            name: name.to_owned(),
            value,
            unit: unit.to_owned(),
            floor,
            ratio,
            bar,
            better: better.to_owned(),
            holds,
            spread,
        }
    }
}

pub(crate) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => 0.0,
        n if n % 2 == 1 => sorted[n / 2],
        n => (sorted[n / 2 - 1] + sorted[n / 2]) / 2.0,
    }
}

fn spread(values: &[f64]) -> f64 {
    let middle = median(values);
    let (low, high) = values.iter().fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(*v), high.max(*v)));
    if values.is_empty() || middle == 0.0 { 0.0 } else { (high - low) / middle.abs() }
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
    fn medians_and_spreads() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
        assert_eq!(median(&[]), 0.0);
        assert_eq!(spread(&[1.0, 2.0, 4.0]), 1.5);
    }

    #[test]
    fn a_bar_is_judged_on_the_ratio_where_there_is_a_floor() {
        let row = Row::on_ratio("a", "us", &[3.0], &[2.0], 1.5, Better::Lower);
        assert_eq!((row.ratio, row.holds), (Some(1.5), Some(true)));
        let row = Row::on_value("a", "1", &[0.98], Some(0.99), Better::Higher);
        assert_eq!((row.ratio, row.holds), (None, Some(false)));
        assert_eq!(Row::on_value("a", "ns", &[5.0], None, Better::Lower).holds, None);
    }
}
