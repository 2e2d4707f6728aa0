//! Telementoring: what stations show one another becomes part of the scene.
//!
//! A station sends a [`NoteKind`](crate::control::NoteKind), the host says who and when, and the [`AnnotationBoard`] turns
//! it into components: a pointer, sections of strokes, labels, a frozen picture, requests for instruments. From there on
//! they are replicated, recorded and drawn like everything else. The board runs at the host, as the only writer of those
//! components; it keeps nothing that it cannot read from a scene. What the station's own person does, a window writes into
//! the station's own scene; the [`MentorDesk`] turns it into notes, and tells that person what was refused.
//!
//! | what | whose | how long | limit |
//! |---|---|---|---|
//! | pointer | its station's | until it points no longer, or leaves | 1 a station |
//! | stroke | its station's; the host clears all | until erased, or cut away | [`SECTIONS_MAX`] sections of [`SECTION_PLACES_MAX`] places |
//! | label | its station's; the host clears all | until taken away, or cut away | [`LABELS_MAX`] |
//! | frozen picture | everybody's who may draw | until somebody lets it go on, or who froze it leaves | 1 |
//! | request for an instrument | who asks, who serves it, the host | until given back, or who asked is away | 1 a hand |
//!
//! [`SECTIONS_MAX`]: trocar_scene::SECTIONS_MAX
//! [`SECTION_PLACES_MAX`]: trocar_scene::SECTION_PLACES_MAX
//! [`LABELS_MAX`]: trocar_scene::LABELS_MAX

mod board;
#[cfg(test)]
mod board_tests;
mod desk;
#[cfg(test)]
mod desk_tests;
pub(crate) mod hand_over;
mod sections;

pub use board::{AnnotationBoard, Author};
pub(crate) use desk::shown_role;
pub use desk::{DeskOwner, MentorDesk};
