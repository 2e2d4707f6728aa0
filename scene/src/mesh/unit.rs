//! The likely unit of a mesh whose size is not plausible in metres.

/// Smallest plausible extent of a mesh \[m\].
pub const EXTENT_MIN: f64 = 5e-4;
/// Largest plausible extent of tissue \[m\].
pub const TISSUE_EXTENT_MAX: f64 = 1.0;
/// Largest plausible extent of anything else, such as a table \[m\].
pub const EXTENT_MAX: f64 = 5.0;

/// Other scales of a file, from the likeliest, with the units they mean. A volume in metres that was scaled as if it were
/// in millimetres is a thousand times too small.
const FACTORS: [f64; 5] = [1e-3, 1e-2, 1e-6, 1e3, 1e2];

/// What is doubtful about the size of a mesh, and the scale that is likely meant: `extent` is the longest side of its box
/// after the file was multiplied by `scale` \[m\]. `None` when the size is plausible.
#[must_use]
pub fn doubt_of_size(extent: f64, scale: f64, extent_max: f64) -> Option<String> {
    if extent <= 0.0 || extent.is_nan() || (EXTENT_MIN..=extent_max).contains(&extent) {
        return None;
    }
    // Of organs and instruments; the plausible range of what was read is wider than that.
    let likely = |factor: &f64| (5e-3..=extent_max.min(TISSUE_EXTENT_MAX)).contains(&(extent * factor));
    let mut found = FACTORS.into_iter().filter(likely);
    let size = format!("it is {} across, which is not plausible", length(extent));
    let of = |factor: f64| {
        let other = rounded(scale * factor);
        (unit(other), format!("scale = {other} makes it {}", length(extent * factor)))
    };
    Some(match found.next().map(of) {
        None => format!("{size}: 'scale' gives the metres per unit of its file"),
        Some((None, remedy)) => format!("{size}: {remedy}"),
        Some((Some(unit), remedy)) => {
            let second = found
                .next()
                .map(of)
                .and_then(|(unit, remedy)| Some(format!("; were it the {}: {remedy}", unit?)));
            format!("{size}: its unit is likely the {unit}: {remedy}{}", second.unwrap_or_default())
        }
    })
}

/// The name of a unit by its length \[m\].
#[must_use]
pub fn unit(metres: f64) -> Option<&'static str> {
    let units = [(1.0, "metre"), (1e-2, "centimetre"), (1e-3, "millimetre"), (1e-6, "micrometre")];
    units.into_iter().find(|(length, _)| (metres / length - 1.0).abs() < 1e-9).map(|(_, name)| name)
}

/// Without the last digits, which come from multiplying.
fn rounded(scale: f64) -> f64 {
    format!("{scale:.9e}").parse().unwrap_or(scale)
}

/// A length in a readable unit.
#[must_use]
pub fn length(metres: f64) -> String {
    let (value, unit) = match metres.abs() {
        0.0 => (metres, "m"),
        x if x < 1e-3 => (metres * 1e6, "µm"),
        x if x < 1.0 => (metres * 1e3, "mm"),
        x if x < 1e3 => (metres, "m"),
        _ => (metres * 1e-3, "km"),
    };
    let digits = if value.abs() >= 100.0 {
        0
    } else if value.abs() >= 10.0 {
        1
    } else {
        2
    };
    let text = format!("{value:.digits$}");
    let text = if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
    format!("{text} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_likely_unit_is_named_with_its_scale() {
        let told = doubt_of_size(40.0, 1.0, TISSUE_EXTENT_MAX).expect("40 m");
        assert!(
            told.contains("40 m across") && told.contains("likely the millimetre: scale = 0.001"),
            "{told}"
        );
        assert!(told.contains("makes it 40 mm") && told.contains("the centimetre"), "{told}");
        let told = doubt_of_size(200.0, 1.0, EXTENT_MAX).expect("a liver in millimetres");
        assert!(told.contains("likely the millimetre") && !told.contains("centimetre"), "{told}");
        let told = doubt_of_size(40_000.0, 1.0, TISSUE_EXTENT_MAX).expect("40 km");
        assert!(told.contains("40 km") && told.contains("micrometre: scale = 0.000001"), "{told}");
        // In metres already, and scaled all the same.
        let told = doubt_of_size(0.00004, 0.001, TISSUE_EXTENT_MAX).expect("40 µm");
        assert!(
            told.contains("40 µm") && told.contains("likely the metre: scale = 1 makes it 40 mm"),
            "{told}"
        );
        let told = doubt_of_size(1e9, 1.0, TISSUE_EXTENT_MAX).expect("a planet");
        assert!(told.contains("'scale'"), "{told}");
    }

    #[test]
    fn plausible_sizes_are_not_doubted() {
        for extent in [0.0, 0.0005, 0.001, 0.04, 0.3, 1.0] {
            assert_eq!(doubt_of_size(extent, 1.0, TISSUE_EXTENT_MAX), None);
        }
        assert_eq!(doubt_of_size(2.0, 1.0, EXTENT_MAX), None);
        assert!(doubt_of_size(2.0, 1.0, TISSUE_EXTENT_MAX).is_some());
    }
}
