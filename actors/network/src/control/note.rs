//! Telementoring: what stations show one another in the scene, and the hand-over of an instrument.

use serde::{Deserialize, Serialize};
use trocar_scene::{Entity, SimTime};

use super::message_error::MessageError;
use super::plain_text::PlainText;
use crate::ticket::Role;

/// Most places of a stroke in one note; a longer stroke continues in the next note.
pub const STROKE_PLACES_MAX: usize = 256;
/// Greatest width of a stroke \[m\].
pub const STROKE_WIDTH_MAX: f32 = 0.05;
/// How far the sum of barycentric coordinates may be from one, and each of them below zero.
const BARYCENTRIC_TOLERANCE: f32 = 1e-3;

/// A place on a surface that moves with it: it sticks to the tissue, whatever the tissue does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SurfacePlace {
    /// The body.
    pub entity: Entity,
    /// Triangle of its surface mesh.
    pub triangle: u32,
    /// Weights of the triangle's vertices: each 0 to 1, with the sum 1.
    pub barycentric: [f32; 3],
}

impl SurfacePlace {
    fn is_valid(&self) -> bool {
        // A comparison with NaN is false, so that NaN is refused.
        let is_inside =
            |weight: &f32| *weight >= -BARYCENTRIC_TOLERANCE && *weight <= 1.0 + BARYCENTRIC_TOLERANCE;
        let sum: f32 = self.barycentric.iter().sum();
        self.barycentric.iter().all(is_inside) && (sum - 1.0).abs() <= BARYCENTRIC_TOLERANCE
    }
}

/// A note, with who and when. The host fills in both, so that no station speaks for another one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Note {
    /// The station.
    pub station: u16,
    /// When it reached the host, by the host's session clock.
    pub at: SimTime,
    /// What it shows.
    pub what: NoteKind,
}

/// What a station shows the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub enum NoteKind {
    /// Where it points now; `None` ends that.
    Pointer(Option<SurfacePlace>),
    /// Part of a stroke.
    Stroke {
        /// Number of the stroke at its station; parts of the same number are joined.
        stroke: u32,
        /// Red, green, blue.
        colour: [u8; 3],
        /// Width \[m\], up to [`STROKE_WIDTH_MAX`].
        width: f32,
        /// 1 to [`STROKE_PLACES_MAX`] places, in order.
        places: Vec<SurfacePlace>,
    },
    /// A stroke is taken away.
    Erase {
        /// Its number at its station.
        stroke: u32,
    },
    /// A label is put or changed.
    Label {
        /// Number of the label at its station.
        label: u32,
        /// Where.
        place: SurfacePlace,
        /// Its text.
        text: PlainText,
    },
    /// A label is taken away.
    Unlabel {
        /// Its number at its station.
        label: u32,
    },
    /// The pictures of all stations stand still, or no longer. Hands and forces are not touched by it.
    Freeze(bool),
    /// A step of handing an instrument over.
    TakeOver {
        /// Number of the hand.
        hand: u8,
        /// The step.
        step: TakeOver,
    },
}

/// The steps of a hand-over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum TakeOver {
    /// A mentor asks for the instrument.
    Ask,
    /// Who serves it agrees.
    Accept,
    /// Who serves it does not agree.
    Decline,
    /// It goes back: the mentor gives it, or its own station takes it.
    Return,
}

impl NoteKind {
    /// Whether a station of this role may send it.
    pub fn is_allowed_to(&self, role: Role) -> bool {
        match self {
            Self::TakeOver { step: TakeOver::Ask, .. } => role.may_take_over(),
            Self::TakeOver { .. } => role.may_operate(),
            _ => role.may_annotate(),
        }
    }

    /// What it is, for people.
    pub fn name(&self) -> &'static str {
        match self {
            Self::Pointer(_) => "point",
            Self::Stroke { .. } => "draw a stroke",
            Self::Erase { .. } => "erase a stroke",
            Self::Label { .. } => "put a label",
            Self::Unlabel { .. } => "take a label away",
            Self::Freeze(_) => "freeze the picture",
            Self::TakeOver { step: TakeOver::Ask, .. } => "take over an instrument",
            Self::TakeOver { .. } => "hand an instrument over",
        }
    }

    /// Whether all sizes and numbers are within their limits.
    ///
    /// # Errors
    /// [`MessageError::Limit`] and [`MessageError::Number`].
    pub fn check(&self) -> Result<(), MessageError> {
        let places = match self {
            Self::Pointer(place) => place.as_slice(),
            Self::Stroke { width, places, .. } => {
                if !(*width > 0.0 && *width <= STROKE_WIDTH_MAX) {
                    return Err(MessageError::Number("width of a stroke"));
                }
                if places.is_empty() {
                    return Err(MessageError::Number("count of the places of a stroke"));
                }
                MessageError::limit("places of a stroke", places.len(), STROKE_PLACES_MAX)?;
                places
            }
            Self::Label { place, .. } => std::slice::from_ref(place),
            Self::Erase { .. } | Self::Unlabel { .. } | Self::Freeze(_) | Self::TakeOver { .. } => &[],
        };
        let are_valid = places.iter().all(SurfacePlace::is_valid);
        if are_valid { Ok(()) } else { Err(MessageError::Number("place on a surface")) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn place(barycentric: [f32; 3]) -> SurfacePlace {
        SurfacePlace { entity: Entity::new(0, 0, 7), triangle: 3, barycentric }
    }

    #[test]
    fn a_place_outside_its_triangle_or_without_number_is_refused() {
        assert_eq!(NoteKind::Pointer(Some(place([0.2, 0.3, 0.5]))).check(), Ok(()));
        for weights in [[f32::NAN, 0.5, 0.5], [0.5, 0.5, 0.5], [-1.0, 1.0, 1.0], [f32::INFINITY, 0.0, 0.0]] {
            assert!(NoteKind::Pointer(Some(place(weights))).check().is_err(), "{weights:?}");
        }
    }

    #[test]
    fn strokes_are_bounded_in_length_and_width() {
        let stroke = |count: usize, width| NoteKind::Stroke {
            stroke: 1,
            colour: [255, 0, 0],
            width,
            places: vec![place([1.0, 0.0, 0.0]); count],
        };
        assert_eq!(stroke(STROKE_PLACES_MAX, 0.001).check(), Ok(()));
        for bad in
            [stroke(0, 0.001), stroke(STROKE_PLACES_MAX + 1, 0.001), stroke(1, f32::NAN), stroke(1, 0.0)]
        {
            assert!(bad.check().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn only_a_mentor_asks_for_an_instrument_and_a_watcher_shows_nothing() {
        let ask = NoteKind::TakeOver { hand: 0, step: TakeOver::Ask };
        let back = NoteKind::TakeOver { hand: 0, step: TakeOver::Return };
        let rights =
            Role::ALL.map(|role| [&ask, &back, &NoteKind::Freeze(true)].map(|note| note.is_allowed_to(role)));
        assert_eq!(rights, [[false; 3], [false, true, true], [true; 3]]);
    }
}
