//! Components: plain serialisable types with a stable name, stored in columns.

use std::fmt;

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

use crate::entity_mesh::EntityMesh;
use crate::finite;
use crate::soft_body::SoftAbilities;

/// How a recording keeps the values of a component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RecordPolicy {
    /// Every value, to the last bit.
    Exact,
    /// The values at regular times, rounded.
    Sampled(Sampling),
    /// Derived from recorded state: not part of the state hash, and recorded only in the whole scenes of a recording.
    Derived,
}

/// When a recording takes the values of a component, and how it rounds them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// How often the values that have changed are taken \[Hz\].
    pub hz: f64,
    /// Largest error of each number with a fraction, in the unit of that number.
    pub tolerance: f64,
}

impl RecordPolicy {
    /// Values that are taken `hz` times a second, each number with a fraction within `tolerance`.
    pub const fn sampled(hz: f64, tolerance: f64) -> Self {
        Self::Sampled(Sampling { hz, tolerance })
    }
}

/// `exact`, `derived`, or rate and tolerance: `sampled 60 Hz ±2.5e-7`.
impl fmt::Display for RecordPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exact => f.write_str("exact"),
            Self::Sampled(Sampling { hz, tolerance }) => write!(f, "sampled {hz} Hz ±{tolerance:e}"),
            Self::Derived => f.write_str("derived"),
        }
    }
}

impl Sampling {
    /// The largest power of two to whose multiples numbers may be rounded, within the tolerance: sums and differences of
    /// its multiples are exact, so that they are stored as whole numbers.
    pub fn step(&self) -> f64 {
        let step = 2.0 * self.tolerance;
        // The exponent's bits alone: the largest power of two that is not above it.
        f64::from_bits(step.to_bits() & (0x7ff << 52))
    }
}

/// A type of data attached to entities.
///
/// Derive it for your own types (the paper's "specialise a class of the Model"); no other crate needs a change. Big
/// payloads belong in an `Arc`, so that copying a chunk of rows stays cheap.
///
/// ```
/// use schemars::JsonSchema;
/// use serde::{Deserialize, Serialize};
/// use trocar_scene::{Component, ComponentError};
///
/// /// How full the bag of an irrigator is.
/// #[derive(Clone, Debug, Serialize, Deserialize, JsonSchema, Component)]
/// #[component(name = "irrigation_bag", check = Self::ranges, schema)]
/// struct IrrigationBag {
///     /// Volume left \[m³\].
///     volume: f64,
/// }
///
/// impl IrrigationBag {
///     fn ranges(&self) -> Result<(), ComponentError> {
///         ComponentError::range("volume", self.volume, 0.0..=0.005, "0 to 0.005 m³")
///     }
/// }
///
/// assert_eq!(IrrigationBag::NAME, "irrigation_bag");
/// assert!(IrrigationBag { volume: f64::NAN }.check().is_err());
/// ```
///
/// The attribute's keys:
///
/// | Key | Meaning |
/// |---|---|
/// | `name = "…"` | [`NAME`](Self::NAME), a text or a constant; always needed |
/// | `check = path` | a `fn(&Self) -> Result<(), ComponentError>`, called after the check for finite numbers |
/// | `listed = path` | a `fn(&Self) -> u64` with the result of [`listed`](Self::listed) |
/// | `schema` | the value may stand in a scenario file; its schema is that of its `JsonSchema` |
/// | `record = …` | [`RECORD`](Self::RECORD) |
/// | `soft_body = …` | the abilities of [`SOFT_BODY`](Self::SOFT_BODY) |
/// | `partners = path` | the function of [`PARTNERS`](Self::PARTNERS) |
/// | `fits = path` | the function of [`FITS`](Self::FITS) |
/// | `lays = path` | the function of [`LAYS`](Self::LAYS) |
/// | `crate = path` | where `trocar_scene` is, for a crate that knows it by another name |
pub trait Component: Clone + Send + Sync + Serialize + DeserializeOwned + 'static {
    /// Stable name in files, hashes and messages: lower case with underscores.
    const NAME: &'static str;
    /// How a recording keeps its values.
    const RECORD: RecordPolicy = RecordPolicy::Exact;
    /// Abilities of a soft body that carries it, if it is the component of a soft-body method.
    const SOFT_BODY: Option<SoftAbilities> = None;
    /// For components that declare couplings: names of the bodies of other controllers to which its body gives
    /// impulses.
    const PARTNERS: Option<fn(&Self) -> Vec<&str>> = None;
    /// For components that refer to parts of the entity's mesh: refuses what refers to nothing. Called while a scenario
    /// is read, for entities that have a mesh.
    const FITS: Option<Fits<Self>> = None;
    /// For components that lay the vertices of the body themselves: where they are at rest \[m\], if they do.
    const LAYS: Option<Lays<Self>> = None;

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
    fn schema() -> Option<SchemaValue> {
        None
    }
}

/// Whether a component fits the mesh of its entity.
pub type Fits<T> = fn(&T, &EntityMesh<'_>) -> Result<(), ComponentError>;

/// Where a component lays the vertices of its body, if it does.
pub type Lays<T> = fn(&T) -> Option<Vec<Point3<f64>>>;

/// A schema, as [`Component::schema`] returns it.
pub use serde_json::Value as SchemaValue;

/// The JSON schema of a type.
#[must_use]
pub fn schema_of<T: JsonSchema>() -> SchemaValue {
    schemars::schema_for!(T).to_value()
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
    #[error("{field}: {} is out of range ({valid})", crate::readable::given(*value))]
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
