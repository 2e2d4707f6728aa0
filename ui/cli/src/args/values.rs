//! Values on the command line that several commands take.

/// A hand and the device that it has.
pub fn hand(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, spec)) if !name.is_empty() && !spec.is_empty() => Ok((name.to_owned(), spec.to_owned())),
        _ => Err("NAME=SPEC is expected, such as left=virtual".to_owned()),
    }
}

/// A number of seconds.
pub fn positive(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && value > 0.0 && value <= 1e6 => Ok(value),
        _ => Err("a number of seconds above 0, at most 1e6, is expected".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn seconds_and_hands_are_checked() {
        assert_eq!(positive("0.5"), Ok(0.5));
        for wrong in ["0", "-1", "NaN", "inf", "1e7", "x"] {
            assert!(positive(wrong).is_err(), "{wrong}");
        }
        assert_eq!(hand("left=replay:a=b.csv"), Ok(("left".into(), "replay:a=b.csv".into())));
        assert!(hand("left").is_err() && hand("=virtual").is_err() && hand("left=").is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

        #[test]
        fn any_text_is_a_pair_or_a_number_or_refused(text in prop_oneof!["\\PC{0,30}", "[-+0-9.einfNa=]{0,12}"]) {
            if let Ok(secs) = positive(&text) {
                prop_assert!(secs > 0.0 && secs <= 1e6);
            }
            if let Ok((name, spec)) = hand(&text) {
                prop_assert_eq!(format!("{name}={spec}"), text);
            }
        }
    }
}
