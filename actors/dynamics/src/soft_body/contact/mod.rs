//! Contacts that detectors find of soft bodies: followed from tick to tick, and answered for both sides.

pub(crate) mod bodies;
pub(crate) mod penalty;
pub(crate) mod rigid;
pub(crate) mod tracking;

pub use rigid::{AppliedTotals, ImpulseTotals, RigidContacts};
pub use tracking::{ContactSums, Feature, PersistentContact, SoftContacts};
