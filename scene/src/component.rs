//! What can be stored in a column: any plain serialisable type with a stable name.

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
    /// Derived from recorded state: left out, and left out of the state hash.
    Derived,
}

/// A kind of data that entities can have.
///
/// Implement it for your own types (the paper's "specialise a class of the Model"); no other crate has to
/// know. Big payloads belong in an `Arc`, so that copying a chunk of rows stays cheap.
pub trait Component: Clone + Send + Sync + Serialize + DeserializeOwned + 'static {
    /// Stable name in files, hashes and messages: lower case with underscores.
    const NAME: &'static str;
    /// Whether changes are recorded.
    const RECORD: RecordPolicy = RecordPolicy::Full;
    /// What a soft body can do that carries it, if it is the component by which a method moves bodies.
    const SOFT_BODY: Option<SoftAbilities> = None;
    /// The names of bodies of other controllers to which a body that carries it gives impulses, if it is what says so.
    const PARTNERS: Option<fn(&Self) -> Vec<&str>> = None;

    /// Refuses values that must never reach a snapshot. The default walks the value and refuses numbers
    /// that are not finite; an override should call [`finite::check`] as well.
    ///
    /// # Errors
    /// Says which field is wrong.
    fn check(&self) -> Result<(), ComponentError> {
        finite::check(self)
    }

    /// How many things it lists, where it is a list that several writers fill: each writer's report tells it.
    fn listed(&self) -> Option<u64> {
        None
    }

    /// JSON schema of the value as it stands in a scenario file, if it may stand there.
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
    /// Outside of what the field allows.
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
