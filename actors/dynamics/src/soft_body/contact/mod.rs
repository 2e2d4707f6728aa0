//! Contacts of soft bodies that detectors find: tracked from tick to tick, and answered for both bodies.

pub(crate) mod bodies;
mod borne;
pub(crate) mod penalty;
pub(crate) mod rigid;
pub(crate) mod tracking;

pub use borne::{BearingFeature, BorneContact, RigidJoint};
pub use rigid::{AppliedTotals, ImpulseTotals, RigidContacts};
pub use tracking::{ContactSums, Feature, PersistentContact, SoftContacts};
