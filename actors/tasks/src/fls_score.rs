//! FLS-style score: cutoff time minus time minus penalties, normalised to 0–100.
//!
//! The form is that of the MISTELS/FLS programme (Derossis et al. 1998, "Development of a model for training
//! and evaluation of laparoscopic skills"; Fraser et al. 2003). Its official coefficients are not public:
//! the weights come from the scenario, and no clinical validity is claimed.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Weights of the score. All times and penalties in seconds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct FlsWeights {
    /// Reaching this time scores 0 \[s\].
    pub cutoff_secs: f64,
    /// The time that scores 100 without a penalty \[s\].
    pub perfect_secs: f64,
    /// Penalty per percent of the objects that were lost out of view \[s\].
    pub secs_per_percent_lost: f64,
    /// Further penalties per error kind \[s\]; unlisted kinds only cost time.
    pub secs_per_error: BTreeMap<String, f64>,
}

impl Default for FlsWeights {
    fn default() -> Self {
        Self {
            cutoff_secs: 300.0,
            perfect_secs: 0.0,
            secs_per_percent_lost: 1.0,
            secs_per_error: BTreeMap::new(),
        }
    }
}

/// Why weights are invalid.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FlsWeightsError {
    /// A number is negative or not finite.
    #[error("score weight {name} is {value}; it must be a finite number, 0 or above")]
    OutOfRange {
        /// Which weight.
        name: String,
        /// Its value.
        value: f64,
    },
    /// The perfect time is not before the cutoff.
    #[error("perfect_secs ({perfect_secs} s) must lie below cutoff_secs ({cutoff_secs} s)")]
    NoRange {
        /// The time that scores 100 \[s\].
        perfect_secs: f64,
        /// The time that scores 0 \[s\].
        cutoff_secs: f64,
    },
}

impl FlsWeights {
    /// Refuses invalid weights.
    ///
    /// # Errors
    /// Names the weight.
    pub fn validate(&self) -> Result<(), FlsWeightsError> {
        let fixed = [
            ("cutoff_secs", self.cutoff_secs),
            ("perfect_secs", self.perfect_secs),
            ("secs_per_percent_lost", self.secs_per_percent_lost),
        ];
        let listed = self.secs_per_error.iter().map(|(kind, value)| (kind.as_str(), *value));
        for (name, value) in fixed.into_iter().chain(listed) {
            if !(value.is_finite() && value >= 0.0) {
                return Err(FlsWeightsError::OutOfRange { name: name.to_string(), value });
            }
        }
        if self.perfect_secs >= self.cutoff_secs {
            return Err(FlsWeightsError::NoRange {
                perfect_secs: self.perfect_secs,
                cutoff_secs: self.cutoff_secs,
            });
        }
        Ok(())
    }

    /// Whether `seconds` reach the cutoff.
    pub fn cuts_off(&self, seconds: f64) -> bool {
        seconds >= self.cutoff_secs
    }

    /// The score, 0–100, of a finished exercise that took `seconds` \[s\], with `lost` of `objects` lost out of
    /// view and the given errors by kind.
    ///
    /// `100 · (cutoff − seconds − penalty) / (cutoff − perfect)`, clamped; 0 from the cutoff on.
    pub fn score<'a>(
        &self,
        seconds: f64,
        lost: u32,
        objects: u32,
        errors: impl IntoIterator<Item = &'a str>,
    ) -> f64 {
        if self.cuts_off(seconds) || !seconds.is_finite() {
            return 0.0;
        }
        let percent_lost = if objects == 0 { 0.0 } else { 100.0 * f64::from(lost) / f64::from(objects) };
        let listed: f64 = errors.into_iter().filter_map(|kind| self.secs_per_error.get(kind)).sum();
        let penalty = percent_lost * self.secs_per_percent_lost + listed;
        let left = self.cutoff_secs - seconds - penalty;
        (100.0 * left / (self.cutoff_secs - self.perfect_secs)).clamp(0.0, 100.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_closed_form_is_met() {
        let weights = FlsWeights::default();
        assert_eq!(weights.validate(), Ok(()));
        assert!((weights.score(48.0, 0, 6, []) - 84.0).abs() < 1e-12);
        // One of six lost: 16.67 % cost 16.67 s.
        assert!((weights.score(48.0, 1, 6, []) - (252.0 - 100.0 / 6.0) / 3.0).abs() < 1e-12);
        assert_eq!(weights.score(299.0, 6, 6, []), 0.0);
    }

    #[test]
    fn reaching_the_cutoff_scores_zero() {
        let weights = FlsWeights { perfect_secs: 48.0, ..FlsWeights::default() };
        assert_eq!(weights.score(300.0, 0, 6, []), 0.0);
        assert_eq!(weights.score(f64::NAN, 0, 6, []), 0.0);
        assert!(weights.score(299.9, 0, 6, []) > 0.0);
        assert_eq!(weights.score(48.0, 0, 6, []), 100.0);
        assert_eq!(weights.score(10.0, 0, 6, []), 100.0);
    }

    #[test]
    fn only_listed_errors_cost_more_than_their_time() {
        let mut weights = FlsWeights::default();
        weights.secs_per_error.insert("wrong_hand".into(), 15.0);
        let clean = weights.score(100.0, 0, 6, []);
        assert_eq!(weights.score(100.0, 0, 6, ["drop_in_view"]), clean);
        assert!((clean - weights.score(100.0, 0, 6, ["wrong_hand", "wrong_hand"]) - 10.0).abs() < 1e-12);
    }

    #[test]
    fn weights_that_make_no_score_are_named() {
        let negative = FlsWeights { secs_per_percent_lost: -1.0, ..FlsWeights::default() };
        assert!(negative.validate().unwrap_err().to_string().contains("secs_per_percent_lost"));
        let inverted = FlsWeights { perfect_secs: 300.0, ..FlsWeights::default() };
        assert!(matches!(inverted.validate(), Err(FlsWeightsError::NoRange { .. })));
        let mut listed = FlsWeights::default();
        listed.secs_per_error.insert("drop_in_view".into(), f64::INFINITY);
        assert!(listed.validate().unwrap_err().to_string().contains("drop_in_view"));
    }

    proptest! {
        #[test]
        fn slower_or_worse_never_scores_more(
            seconds in 0.0..400.0f64, more in 0.0..50.0f64, lost in 0u32..6,
        ) {
            let weights = FlsWeights::default();
            let base = weights.score(seconds, lost, 6, []);
            prop_assert!((0.0..=100.0).contains(&base));
            prop_assert!(weights.score(seconds + more, lost, 6, []) <= base);
            prop_assert!(weights.score(seconds, lost + 1, 6, []) <= base);
        }
    }
}
