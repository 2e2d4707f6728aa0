//! Blocks of ours and of a floor, interleaved, so that both see the same machine; medians and spreads.

/// Median and half the range between the quartiles.
pub fn median(values: &[f64]) -> (f64, f64) {
    let mut sorted: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    sorted.sort_by(f64::total_cmp);
    (quantile(&sorted, 0.5), 0.5 * (quantile(&sorted, 0.75) - quantile(&sorted, 0.25)))
}

/// A quantile of sorted values, interpolated; NaN of none.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return f64::NAN };
    let at = last as f64 * share;
    let (low, high) = (at.floor() as usize, at.ceil() as usize);
    sorted[low] + (at - at.floor()) * (sorted[high] - sorted[low])
}

/// Runs `count` blocks of each in turn; the values of both.
pub fn interleaved<E>(
    count: usize,
    mut ours: impl FnMut() -> Result<f64, E>,
    mut floor: impl FnMut() -> Result<f64, E>,
) -> Result<(Vec<f64>, Vec<f64>), E> {
    let (mut of_ours, mut of_floor) = (Vec::with_capacity(count), Vec::with_capacity(count));
    for block in 0..count {
        // Who goes first changes, so that a drift of the machine favours nobody.
        if block % 2 == 0 {
            of_ours.push(ours()?);
            of_floor.push(floor()?);
        } else {
            of_floor.push(floor()?);
            of_ours.push(ours()?);
        }
    }
    Ok((of_ours, of_floor))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_and_spreads_of_known_values() {
        assert_eq!(median(&[3.0, 1.0, 2.0, 5.0, 4.0]), (3.0, 1.0));
        assert_eq!(median(&[1.0, 2.0]).0, 1.5);
        assert!(median(&[]).0.is_nan());
    }

    #[test]
    fn blocks_alternate() {
        let order = std::cell::RefCell::new(String::new());
        let note = |what| {
            order.borrow_mut().push(what);
            Ok::<f64, ()>(0.0)
        };
        interleaved(3, || note('o'), || note('f')).unwrap();
        assert_eq!(*order.borrow(), "offoof");
    }
}
