//! What the persons of a session show one another in the scene: a pointer, strokes and labels that stick to the tissue,
//! a frozen picture, and the hand-over of an instrument.
//!
//! Every one says who and when, so that a recording tells it too.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::components::surface_place::SurfacePlace;
use crate::readable::is_hidden;
use crate::time::SimTime;
use crate::{Component, ComponentError};

/// Most bytes of a name, in UTF-8.
pub const SIGNATURE_NAME_MAX: usize = 64;
/// Most bytes of a label's text, in UTF-8.
pub const LABEL_TEXT_MAX: usize = 256;
/// Most labels of a scene.
pub const LABELS_MAX: usize = 64;
/// Most places of one [`MentorStroke`]; a longer stroke has more sections.
pub const SECTION_PLACES_MAX: usize = 64;
/// Most [`MentorStroke`]s of a scene, all strokes and sections together.
pub const SECTIONS_MAX: usize = 512;
/// Greatest width of a stroke \[m\].
pub const STROKE_WIDTH_MAX: f32 = 0.05;

/// Who shows something, and when.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Signature {
    /// Number of the station.
    pub station: u16,
    /// Its name: 1 to [`SIGNATURE_NAME_MAX`] bytes on one line.
    pub name: String,
    /// When it reached the host, by the host's session clock.
    pub at: SimTime,
}

impl Signature {
    fn check(&self) -> Result<(), ComponentError> {
        check_text("name", &self.name, SIGNATURE_NAME_MAX)
    }
}

/// Refuses a text that is empty or too long, or that has characters which a display does not show as such.
pub(super) fn check_text(field: &'static str, text: &str, most: usize) -> Result<(), ComponentError> {
    if text.is_empty() || text.len() > most {
        let bytes = text.len();
        return Err(ComponentError::Malformed(format!("{field} has {bytes} bytes; 1 to {most} are valid")));
    }
    match text.chars().find(|character| is_hidden(*character)) {
        Some(hidden) => {
            let code = u32::from(hidden);
            Err(ComponentError::Malformed(format!(
                "{field} has the character U+{code:04X}, which is not shown"
            )))
        }
        None => Ok(()),
    }
}

/// Where a person points now.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mentor_pointer", check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct MentorPointer {
    /// Who points, and since when there.
    pub by: Signature,
    /// Where.
    pub place: SurfacePlace,
}

impl MentorPointer {
    fn validate(&self) -> Result<(), ComponentError> {
        self.by.check()?;
        self.place.check()
    }
}

/// A stroke on a surface, or a section of a long one: a ribbon through its places.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mentor_stroke", check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct MentorStroke {
    /// Who drew it, and when its last place came.
    pub by: Signature,
    /// Number of the stroke at its station.
    pub stroke: u32,
    /// Which section of the stroke it is, counted from 0. It begins where the one before ends.
    pub section: u16,
    /// Red, green, blue, as in a picture file (sRGB).
    pub colour: [u8; 3],
    /// Width \[m\]: above 0, at most [`STROKE_WIDTH_MAX`].
    pub width: f32,
    /// 1 to [`SECTION_PLACES_MAX`] places, in order.
    pub places: Arc<Vec<SurfacePlace>>,
    /// Indices of the places to which no ribbon leads from the one before: what was between them is cut away.
    /// Ascending, from 1.
    #[serde(default)]
    pub gaps: Vec<u16>,
}

impl MentorStroke {
    fn validate(&self) -> Result<(), ComponentError> {
        self.by.check()?;
        let width = f64::from(self.width);
        let most = f64::from(STROKE_WIDTH_MAX);
        ComponentError::range("width", width, f64::MIN_POSITIVE..=most, "above 0, at most 0.05 m")?;
        let count = self.places.len();
        let valid = "1 to 64";
        ComponentError::range("places (their number)", count as f64, 1.0..=SECTION_PLACES_MAX as f64, valid)?;
        self.places.iter().try_for_each(SurfacePlace::check)?;
        let are_ascending = self.gaps.is_sorted_by(|a, b| a < b);
        let are_inside = self.gaps.iter().all(|gap| (1..count).contains(&usize::from(*gap)));
        if are_ascending && are_inside {
            return Ok(());
        }
        Err(ComponentError::Malformed(
            "gaps are no ascending indices of the places after the first".to_owned(),
        ))
    }

    /// The runs of places that a ribbon connects, in order.
    pub fn runs(&self) -> impl Iterator<Item = &[SurfacePlace]> {
        let last = self.places.len();
        let bounds = std::iter::once(0).chain(self.gaps.iter().map(|gap| usize::from(*gap)));
        let ends = self.gaps.iter().map(|gap| usize::from(*gap)).chain(std::iter::once(last));
        bounds.zip(ends).map(|(from, to)| self.places.get(from..to).unwrap_or_default())
    }

    /// The stroke without the places that are no longer there; `None` if none is left.
    #[must_use]
    pub fn keeping(&self, mut is_there: impl FnMut(&SurfacePlace) -> bool) -> Option<Self> {
        let mut places = Vec::with_capacity(self.places.len());
        let mut gaps = Vec::new();
        for run in self.runs() {
            let mut is_joined = false;
            for place in run {
                let is_kept = is_there(place);
                if is_kept && !is_joined && !places.is_empty() {
                    gaps.push(places.len() as u16);
                }
                if is_kept {
                    places.push(*place);
                }
                is_joined = is_kept;
            }
        }
        (!places.is_empty()).then(|| Self { places: Arc::new(places), gaps, ..self.clone() })
    }
}

/// A text at a place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mentor_label", check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct MentorLabel {
    /// Who put it, and when.
    pub by: Signature,
    /// Number of the label at its station.
    pub label: u32,
    /// Where.
    pub place: SurfacePlace,
    /// Its text: 1 to [`LABEL_TEXT_MAX`] bytes on one line.
    pub text: String,
}

impl MentorLabel {
    fn validate(&self) -> Result<(), ComponentError> {
        self.by.check()?;
        self.place.check()?;
        check_text("text", &self.text, LABEL_TEXT_MAX)
    }
}

/// The pictures of all stations stand still. Hands, forces and the simulation go on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "picture_freeze", check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct PictureFreeze {
    /// Who froze them, and when.
    pub by: Signature,
}

impl PictureFreeze {
    fn validate(&self) -> Result<(), ComponentError> {
        self.by.check()
    }
}

/// Of a hand: somebody asks for its instrument, or has taken it over.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "take_over_request", check = Self::validate, schema)]
#[serde(deny_unknown_fields)]
pub struct TakeOverRequest {
    /// Who asks, and when.
    pub by: Signature,
    /// How far it is.
    pub step: TakeOverStep,
    /// Who agreed or declined, and when.
    pub answer: Option<Signature>,
}

/// How far the hand-over of an instrument is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum TakeOverStep {
    /// Somebody asks for it.
    Asked,
    /// Who served the hand agreed: it is with who asked.
    Accepted,
    /// Who serves the hand does not agree.
    Declined,
}

impl TakeOverRequest {
    fn validate(&self) -> Result<(), ComponentError> {
        self.by.check()?;
        if let Some(answer) = &self.answer {
            answer.check()?;
        }
        if (self.step == TakeOverStep::Asked) == self.answer.is_none() {
            return Ok(());
        }
        Err(ComponentError::Malformed(
            "an answer comes with 'accepted' and 'declined', and only then".to_owned(),
        ))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::components::surface_place::SurfacePoint;
    use crate::entity::Entity;

    fn by() -> Signature {
        Signature { station: 3, name: "Ana".to_owned(), at: SimTime::from_millis(5) }
    }

    fn place(vertex: u32) -> SurfacePlace {
        let on = SurfacePoint::Triangle { corners: [vertex, 1, 2], barycentric: [0.2, 0.3, 0.5] };
        SurfacePlace { entity: Entity::new(0, 0, 7), on }
    }

    fn stroke(count: u32) -> MentorStroke {
        MentorStroke {
            by: by(),
            stroke: 1,
            section: 0,
            colour: [255, 0, 0],
            width: 0.001,
            places: Arc::new((10..10 + count).map(place).collect()),
            gaps: Vec::new(),
        }
    }

    fn vertices(run: &[SurfacePlace]) -> Vec<u32> {
        let first = |place: &SurfacePlace| match place.on {
            SurfacePoint::Triangle { corners, .. } => corners[0],
            _ => 0,
        };
        run.iter().map(first).collect()
    }

    #[test]
    fn a_stroke_loses_what_is_cut_away_and_leaves_a_gap_there() {
        let lost = |stroke: &MentorStroke, lost: &[u32]| {
            stroke.keeping(|place| !lost.contains(&vertices(&[*place])[0]))
        };
        let parts = |stroke: &MentorStroke| stroke.runs().map(vertices).collect::<Vec<_>>();
        let whole = stroke(6);
        assert_eq!(parts(&whole), [vec![10, 11, 12, 13, 14, 15]]);
        let cut = lost(&whole, &[12]).expect("five are left");
        assert_eq!(parts(&cut), [vec![10, 11], vec![13, 14, 15]]);
        assert!(cut.check().is_ok());
        // A gap stays one when what is beside it goes as well, and none arises at the ends.
        let again = lost(&cut, &[10, 13, 15]).expect("two are left");
        assert_eq!(parts(&again), [vec![11], vec![14]]);
        let end = lost(&again, &[11]).expect("one is left");
        assert_eq!((parts(&end), end.gaps.len()), (vec![vec![14]], 0));
        assert_eq!(lost(&end, &[14]), None);
    }

    #[test]
    fn strokes_are_bounded_and_their_gaps_are_between_their_places() {
        assert!(stroke(SECTION_PLACES_MAX as u32).check().is_ok());
        let refused = |stroke: MentorStroke| stroke.check().expect_err("refused").to_string();
        assert!(refused(stroke(0)).contains("places"));
        assert!(refused(stroke(SECTION_PLACES_MAX as u32 + 1)).contains("places"));
        for width in [0.0, -0.001, 0.051, f32::NAN] {
            assert!(MentorStroke { width, ..stroke(2) }.check().is_err(), "{width}");
        }
        for gaps in [vec![0], vec![2], vec![1, 1], vec![u16::MAX]] {
            let text = refused(MentorStroke { gaps, ..stroke(2) });
            assert!(text.contains("gaps"), "{text}");
        }
    }

    #[test]
    fn texts_that_could_deceive_are_refused() {
        let label = |name: &str, text: &str| {
            let by = Signature { name: name.to_owned(), ..by() };
            MentorLabel { by, label: 1, place: place(0), text: text.to_owned() }.check()
        };
        assert!(label("Öztürk", "cut here").is_ok());
        assert!(label("Ana", &"x".repeat(LABEL_TEXT_MAX)).is_ok());
        for (name, text) in [
            ("", "cut"),
            ("Ana", ""),
            ("Ana", "a\nb"),
            ("A\u{202e}na", "cut"),
            (&"n".repeat(SIGNATURE_NAME_MAX + 1), "cut"),
            ("Ana", &"x".repeat(LABEL_TEXT_MAX + 1)),
        ] {
            assert!(label(name, text).is_err(), "{name:?} {text:?}");
        }
    }

    #[test]
    fn an_answer_comes_with_the_steps_that_are_answers() {
        let request = |step, answer| TakeOverRequest { by: by(), step, answer }.check().is_ok();
        assert!(request(TakeOverStep::Asked, None) && !request(TakeOverStep::Asked, Some(by())));
        assert!(request(TakeOverStep::Declined, Some(by())) && !request(TakeOverStep::Accepted, None));
    }
}
