//! Components: plain serialisable types with a stable name, stored in columns.

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::finite;
use crate::soft_body::SoftAbilities;

/// How the recorder treats a component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordPolicy {
    /// Every change is recorded.
    Full,
    /// Derived from recorded state: neither recorded nor part of the state hash.
    Derived,
}

/// A type of data attached to entities.
///
/// Implement it for your own types (the paper's "specialise a class of the Model"); no other crate needs a change. Big
/// payloads belong in an `Arc`, so that copying a chunk of rows stays cheap.
pub trait Component: Clone + Send + Sync + Serialize + DeserializeOwned + 'static {
    /// Stable name in files, hashes and messages: lower case with underscores.
    const NAME: &'static str;
    /// Whether changes are recorded.
    const RECORD: RecordPolicy = RecordPolicy::Full;
    /// Abilities of a soft body that carries it, if it is the component of a soft-body method.
    const SOFT_BODY: Option<SoftAbilities> = None;
    /// For components that declare couplings: names of the bodies of other controllers to which its body gives
    /// impulses.
    const PARTNERS: Option<fn(&Self) -> Vec<&str>> = None;

    /// Refuses values that must never reach a snapshot. The default refuses non-finite numbers; an override should call
    /// [`finite::check`] as well.
    ///
    /// # Errors
    /// Names the invalid field.
    fn check(&self) -> Result<(), ComponentError> {
        finite::check(self)
    }

    /// Number of entries, for a shared list; shown in each writer's report.
    fn listed(&self) -> Option<u64> {
        None
    }

    /// JSON schema of the value in a scenario file, if it is allowed there.
    fn schema() -> Option<serde_json::Value> {
        None
    }
}

/// A value that the Model refuses.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum ComponentError {
    /// A NaN or an infinity.
    #[error("number {index} of the value is not finite")]
    NotFinite {
        /// Which number, counted in serialisation order from 0.
        index: usize,
    },
    /// A rotation whose quaternion is not of unit length.
    #[error("rotation is not normalised (length {norm})")]
    NotNormalised {
        /// Length of the quaternion.
        norm: f64,
    },
    /// Outside the field's range.
    #[error("{field}: {value} is out of range ({valid})")]
    OutOfRange {
        /// The field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be valid.
        valid: &'static str,
    },
    /// Could not be decoded or encoded.
    #[error("{0}")]
    Malformed(String),
}

impl ComponentError {
    /// `Ok` when `value` lies in `range`, with `valid` as the text of the range otherwise.
    ///
    /// # Errors
    /// [`ComponentError::OutOfRange`].
    pub fn range(
        field: &'static str,
        value: f64,
        range: impl std::ops::RangeBounds<f64>,
        valid: &'static str,
    ) -> Result<(), Self> {
        if range.contains(&value) { Ok(()) } else { Err(Self::OutOfRange { field, value, valid }) }
    }
}
