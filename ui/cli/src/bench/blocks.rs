//! Figures of several blocks: median and spread.

/// Median, and (largest − smallest) / median; NaN of none.
pub fn median(values: &[f64]) -> (f64, f64) {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let (Some(low), Some(high)) = (sorted.first(), sorted.last()) else { return (f64::NAN, 0.0) };
    let middle = sorted.len() / 2;
    let median =
        if sorted.len() % 2 == 1 { sorted[middle] } else { 0.5 * (sorted[middle - 1] + sorted[middle]) };
    (median, if median == 0.0 { 0.0 } else { (high - low) / median.abs() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_spreads_of_known_values() {
        assert_eq!(median(&[4.0, 1.0, 2.0]), (2.0, 1.5));
        assert_eq!(median(&[1.0, 2.0]).0, 1.5);
        assert_eq!(median(&[0.0, 0.0]), (0.0, 0.0));
        assert!(median(&[]).0.is_nan());
    }
}
