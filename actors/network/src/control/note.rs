//! Telementoring: what stations show one another in the scene, and the hand-over of an instrument.

use serde::{Deserialize, Serialize};
use thiserror::Error;
use trocar_scene::{STROKE_WIDTH_MAX, SimTime, SurfacePlace};

use super::message_error::MessageError;
use super::plain_text::PlainText;
use crate::ticket::{PlainName, Role};

/// Most places of a stroke in one note; a longer stroke continues in the next note.
pub const STROKE_PLACES_MAX: usize = 256;

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
    /// All strokes and labels of a station are taken away; without a number those of all stations. What is not its own
    /// only the host clears.
    Clear {
        /// Number of the station.
        station: Option<u16>,
    },
}

/// Why a note is not shown. It goes over the wire.
#[derive(Clone, Debug, PartialEq, Eq, Error, Serialize, Deserialize)]
pub enum NoteRefusal {
    /// No place of it is on a surface of the host's scene.
    #[error("there is no such surface any more: it was cut, or is gone")]
    NoSurface,
    /// No room for the stroke.
    #[error("the strokes of the scene have {most} sections already; erase some")]
    StrokesFull {
        /// How many fit.
        most: u16,
    },
    /// No room for the label.
    #[error("the scene has {most} labels already; take one away")]
    LabelsFull {
        /// How many fit.
        most: u16,
    },
    /// A label without text.
    #[error("the label has no text")]
    NoText,
    /// Somebody has frozen the picture already.
    #[error("'{by}' has frozen the picture already")]
    Frozen {
        /// Name of the station.
        by: PlainText,
    },
    /// A station that is not the host wants to clear what others drew.
    #[error("a station clears its own strokes and labels; the host clears those of others")]
    NotOwn,
    /// The instrument is the station's own.
    #[error("the hand '{hand}' is served by this station itself, which need not ask for it")]
    OwnHand {
        /// Name of the hand.
        hand: PlainName,
    },
    /// Somebody else asks for it, or has it.
    #[error("the instrument of the hand '{hand}' is with '{by}', or asked for; wait until it is given back")]
    HandAsked {
        /// Name of the hand.
        hand: PlainName,
        /// Name of who asks, or has it.
        by: PlainText,
    },
    /// There is nothing to answer, or to give back.
    #[error("nobody asks for the instrument of the hand '{hand}', or has taken it over")]
    NotAsked {
        /// Name of the hand.
        hand: PlainName,
    },
    /// The station could not move it.
    #[error(
        "this station has no device for the hand '{hand}'; join with --hand {hand}=virtual, or another device"
    )]
    NoDevice {
        /// Name of the hand.
        hand: PlainName,
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
            Self::Clear { .. } => "clear strokes and labels",
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
            Self::Erase { .. }
            | Self::Unlabel { .. }
            | Self::Freeze(_)
            | Self::TakeOver { .. }
            | Self::Clear { .. } => &[],
        };
        let are_valid = places.iter().all(|place| place.check().is_ok());
        if are_valid { Ok(()) } else { Err(MessageError::Number("place on a surface")) }
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::{Entity, SurfacePoint};

    use super::*;
    use crate::control::TEXT_MAX;

    fn place(barycentric: [f32; 3]) -> SurfacePlace {
        let on = SurfacePoint::Triangle { corners: [u32::MAX, 1, u32::MAX - 1], barycentric };
        SurfacePlace { entity: Entity::new(u16::MAX, 0, 7), on }
    }

    fn on_body(point: [f32; 3], normal: [f32; 3]) -> SurfacePlace {
        SurfacePlace { entity: Entity::new(u16::MAX, 0, 7), on: SurfacePoint::Body { point, normal } }
    }

    fn stroke(count: usize, width: f32, place: SurfacePlace) -> NoteKind {
        NoteKind::Stroke { stroke: 1, colour: [255, 0, 0], width, places: vec![place; count] }
    }

    #[test]
    fn a_place_that_is_on_no_surface_is_refused_in_every_note_that_has_one() {
        assert_eq!(NoteKind::Pointer(Some(place([0.2, 0.3, 0.5]))).check(), Ok(()));
        for astray in [
            place([f32::NAN, 0.5, 0.5]),
            place([0.5, 0.5, 0.5]),
            on_body([0.0, 1e3, 0.0], [0.0, 0.0, 1.0]),
            on_body([0.0; 3], [f32::NAN, 0.0, 1.0]),
        ] {
            let label = NoteKind::Label { label: 1, place: astray, text: PlainText::new("cut") };
            for note in [NoteKind::Pointer(Some(astray)), stroke(1, 0.001, astray), label] {
                assert_eq!(note.check(), Err(MessageError::Number("place on a surface")), "{note:?}");
            }
        }
    }

    #[test]
    fn strokes_are_bounded_in_length_and_width() {
        let stroke = |count, width| stroke(count, width, place([1.0, 0.0, 0.0]));
        assert_eq!(stroke(STROKE_PLACES_MAX, 0.001).check(), Ok(()));
        for bad in
            [stroke(0, 0.001), stroke(STROKE_PLACES_MAX + 1, 0.001), stroke(1, f32::NAN), stroke(1, 0.0)]
        {
            assert!(bad.check().is_err(), "{bad:?}");
        }
    }

    #[test]
    fn the_longest_notes_are_short_messages() {
        let bytes = |what| {
            let note = Note { station: u16::MAX, at: SimTime(u64::MAX), what };
            postcard::to_stdvec(&note).expect("it encodes").len()
        };
        // Twelve bytes of weights, up to fifteen of vertices, or twenty-four of a point with its normal; and the entity.
        let triangle = bytes(stroke(STROKE_PLACES_MAX, 0.001, place([0.2, 0.3, 0.5])));
        let body = bytes(stroke(STROKE_PLACES_MAX, 0.001, on_body([0.1; 3], [0.0, 0.0, 1.0])));
        assert!(triangle.max(body) <= STROKE_PLACES_MAX * 38 + 64, "{triangle} {body}");
        let text = PlainText::new("x".repeat(TEXT_MAX));
        let label = bytes(NoteKind::Label { label: u32::MAX, place: place([0.2, 0.3, 0.5]), text });
        assert!(label <= TEXT_MAX + 64, "{label}");
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
