//! Contacts of soft bodies that detectors find: tracked from tick to tick, and answered for both bodies.

pub(crate) mod bodies;
pub(crate) mod penalty;
pub(crate) mod rigid;
pub(crate) mod tracking;

pub use rigid::{AppliedTotals, ImpulseTotals, RigidContacts};
pub use tracking::{ContactSums, Feature, PersistentContact, SoftContacts};
