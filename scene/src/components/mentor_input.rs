//! What the person at a station shows the others, as a window writes it into the station's own scene, and what the
//! station's network answers.
//!
//! Deeds are numbered, and stay in the input until the answer says that they were taken. So a window never waits, a batch
//! that was dropped costs nothing, and whoever reads late or is built anew takes each deed once. Neither leaves the
//! station: the others get what the host has accepted of it.

use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::station::StationRole;
use super::surface_place::SurfacePlace;
use super::telementoring::{LABEL_TEXT_MAX, SECTION_PLACES_MAX, STROKE_WIDTH_MAX, check_text};
use crate::entity::Entity;
use crate::snapshot::Snapshot;
use crate::time::SimTime;
use crate::{Component, ComponentError, RecordPolicy};

/// Most deeds that wait to be taken. A window that has so many drops what the person does beyond them, and says so.
pub const MENTOR_DEEDS_MAX: usize = 32;
/// Most places of one part of a stroke.
pub const DRAWN_PLACES_MAX: usize = SECTION_PLACES_MAX;

/// What the person at a station shows the others, on the entity of whoever writes it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mentor_input", record = RecordPolicy::Derived, check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct MentorInput {
    /// Number of the input source. Under a new number deeds are counted from 1 anew.
    pub source: u32,
    /// Where the person points now; none: nowhere.
    pub pointer: Option<SurfacePlace>,
    /// Number of the first of the waiting deeds; the others follow it.
    pub first: u64,
    /// Deeds that wait to be taken, in order: at most [`MENTOR_DEEDS_MAX`].
    pub deeds: Arc<Vec<MentorDeed>>,
}

/// Something that a person does for the others to see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum MentorDeed {
    /// Draws part of a stroke; parts of the same number are joined.
    Draw {
        /// Number of the stroke at its station.
        stroke: u32,
        /// Red, green, blue, as in a picture file (sRGB).
        colour: [u8; 3],
        /// Width \[m\]: above 0, at most [`STROKE_WIDTH_MAX`].
        width: f32,
        /// 1 to [`DRAWN_PLACES_MAX`] places, in order.
        places: Vec<SurfacePlace>,
    },
    /// Takes a stroke away.
    Erase {
        /// Its number at its station.
        stroke: u32,
    },
    /// Takes all own strokes and labels away, at the host also those of others.
    Clear {
        /// Those of all stations.
        of_all: bool,
    },
    /// Puts a label, or changes it.
    Label {
        /// Its number at its station.
        label: u32,
        /// Where.
        place: SurfacePlace,
        /// Its text: 1 to [`LABEL_TEXT_MAX`] bytes on one line.
        text: String,
    },
    /// Freezes the pictures of all stations, or lets them go on.
    Freeze(bool),
    /// Hands an instrument over.
    HandOver {
        /// The hand.
        #[schemars(with = "String")]
        hand: Entity,
        /// The step.
        step: HandOverStep,
    },
}

/// What a person does to hand an instrument over.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum HandOverStep {
    /// Asks for it.
    Ask,
    /// Agrees.
    Accept,
    /// Does not agree.
    Decline,
    /// Gives it back, takes it back, or asks for it no longer.
    Return,
}

impl MentorInput {
    /// The input of the station's own person. Of several windows it is the newest source.
    pub fn of(scene: &Snapshot, station: u16) -> Option<&Self> {
        let own = scene.iter::<Self>().filter(|(entity, _)| entity.station() == station);
        own.max_by_key(|(entity, input)| (input.source, *entity)).map(|(_, input)| input)
    }

    /// Forgets the deeds that an answer says were taken. Answers to another source change nothing.
    pub fn forget_taken(&mut self, answer: &MentorAnswer) {
        if answer.source != self.source || answer.taken < self.first {
            return;
        }
        let count = (answer.taken - self.first).saturating_add(1).min(self.deeds.len() as u64);
        Arc::make_mut(&mut self.deeds).drain(..count as usize);
        self.first += count;
    }

    /// Adds a deed; `false` if too many wait.
    pub fn add(&mut self, deed: MentorDeed) -> bool {
        let has_room = self.deeds.len() < MENTOR_DEEDS_MAX;
        if has_room {
            Arc::make_mut(&mut self.deeds).push(deed);
        }
        has_room
    }

    fn validate(&self) -> Result<(), ComponentError> {
        let count = self.deeds.len() as f64;
        ComponentError::range("deeds (their number)", count, 0.0..=MENTOR_DEEDS_MAX as f64, "0 to 32")?;
        if self.first.checked_add(MENTOR_DEEDS_MAX as u64).is_none() {
            return Err(ComponentError::Malformed(format!("first is {}: no deed can follow", self.first)));
        }
        self.pointer.iter().try_for_each(SurfacePlace::check)?;
        self.deeds.iter().try_for_each(MentorDeed::validate)
    }
}

impl MentorDeed {
    fn validate(&self) -> Result<(), ComponentError> {
        match self {
            Self::Draw { width, places, .. } => {
                let most = f64::from(STROKE_WIDTH_MAX);
                let width = f64::from(*width);
                ComponentError::range("width", width, f64::MIN_POSITIVE..=most, "above 0, at most 0.05 m")?;
                let (count, most) = (places.len() as f64, DRAWN_PLACES_MAX as f64);
                ComponentError::range("places (their number)", count, 1.0..=most, "1 to 64")?;
                places.iter().try_for_each(SurfacePlace::check)
            }
            Self::Label { place, text, .. } => {
                place.check()?;
                check_text("text", text, LABEL_TEXT_MAX)
            }
            Self::Erase { .. } | Self::Clear { .. } | Self::Freeze(_) | Self::HandOver { .. } => Ok(()),
        }
    }
}

/// What the network of a station answers its own person, on the entity of the network's actor.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "mentor_answer", record = RecordPolicy::Derived, check = Self::validate, schema)]
#[serde(default, deny_unknown_fields)]
pub struct MentorAnswer {
    /// Number of the station; 0 is the host.
    pub station: u16,
    /// What the station may do; none: it is the host.
    pub role: Option<StationRole>,
    /// Whether the host hears it.
    pub is_heard: bool,
    /// The input source whose deeds are taken now.
    pub source: u32,
    /// Number of the last deed that was taken.
    pub taken: u64,
    /// How often something was refused.
    pub refusals: u64,
    /// Why, the last time: at most [`LABEL_TEXT_MAX`] bytes.
    pub refusal: String,
    /// When that was.
    pub refused_at: SimTime,
}

impl MentorAnswer {
    /// The answer of this station's network; none in a session without one.
    pub fn of(scene: &Snapshot) -> Option<&Self> {
        let all = scene.iter::<Self>();
        all.max_by_key(|(entity, _)| (entity.station(), *entity)).map(|(_, answer)| answer)
    }

    /// Whether the person may point, draw and freeze.
    pub fn may_annotate(&self) -> bool {
        self.role.is_none_or(|role| role != StationRole::Watch)
    }

    /// Whether the person may ask for the instrument of another one.
    pub fn may_ask(&self) -> bool {
        self.role.is_none_or(|role| role == StationRole::Mentor)
    }

    fn validate(&self) -> Result<(), ComponentError> {
        if self.refusal.is_empty() { Ok(()) } else { check_text("refusal", &self.refusal, LABEL_TEXT_MAX) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::components::surface_place::SurfacePoint;
    use crate::{Commands, EntityAllocator, Registry, Store};

    fn erase(stroke: u32) -> MentorDeed {
        MentorDeed::Erase { stroke }
    }

    fn taken(source: u32, taken: u64) -> MentorAnswer {
        MentorAnswer { source, taken, ..MentorAnswer::default() }
    }

    #[test]
    fn deeds_wait_until_they_are_taken_and_no_longer() {
        let mut input = MentorInput { source: 2, first: 1, ..MentorInput::default() };
        (0..5).for_each(|stroke| assert!(input.add(erase(stroke))));
        input.forget_taken(&taken(1, 9));
        input.forget_taken(&taken(2, 0));
        assert_eq!((input.first, input.deeds.len()), (1, 5), "of another source, or none yet");
        input.forget_taken(&taken(2, 3));
        assert_eq!((input.first, &input.deeds[..]), (4, &[erase(3), erase(4)][..]));
        input.forget_taken(&taken(2, 3));
        assert_eq!((input.first, input.deeds.len()), (4, 2));
        input.forget_taken(&taken(2, u64::MAX));
        assert_eq!((input.first, input.deeds.len()), (6, 0), "no more than there were");
    }

    #[test]
    fn the_input_is_bounded_and_what_is_beyond_is_refused_by_name() {
        let mut input = MentorInput::default();
        (0..MENTOR_DEEDS_MAX as u32).for_each(|stroke| assert!(input.add(erase(stroke))));
        assert!(!input.add(erase(99)) && input.check().is_ok());
        let refused = |deed: MentorDeed| {
            let input = MentorInput { deeds: Arc::new(vec![deed]), ..MentorInput::default() };
            input.check().expect_err("refused").to_string()
        };
        let place = SurfacePlace {
            entity: Entity::new(0, 0, 7),
            on: SurfacePoint::Triangle { corners: [0, 1, 2], barycentric: [0.2, 0.3, 0.5] },
        };
        let draw = |width, count| MentorDeed::Draw {
            stroke: 1,
            colour: [1, 2, 3],
            width,
            places: vec![place; count],
        };
        assert!(refused(draw(0.0, 1)).contains("width"));
        assert!(refused(draw(0.001, 0)).contains("places"));
        assert!(refused(draw(0.001, DRAWN_PLACES_MAX + 1)).contains("places"));
        let astray = SurfacePlace {
            on: SurfacePoint::Triangle { corners: [0, 1, 2], barycentric: [0.5, 0.5, 0.5] },
            ..place
        };
        let label = |place, text: &str| MentorDeed::Label { label: 1, place, text: text.to_owned() };
        assert!(refused(label(astray, "cut")).contains("barycentric"));
        assert!(refused(label(place, "a\nb")).contains("U+000A"));
        let input = MentorInput { first: u64::MAX, ..MentorInput::default() };
        assert!(input.check().is_err());
    }

    #[test]
    fn a_station_reads_its_own_person_and_of_two_windows_the_newer() {
        let registry = Registry::standard();
        let mut store = Store::new(registry.clone());
        for (station, source) in [(0, 9), (3, 1), (3, 4), (3, 2)] {
            let spawner = source as u16;
            let mut out = Commands::new(registry.clone(), EntityAllocator::new(station, spawner));
            let entity = out.spawn();
            out.put(entity, MentorInput { source, ..MentorInput::default() });
            out.seal();
            store.apply(&mut out, SimTime::ZERO);
        }
        let scene = store.snapshot();
        let source = |station| MentorInput::of(&scene, station).map(|input| input.source);
        assert_eq!([source(0), source(3), source(5)], [Some(9), Some(4), None]);
    }
}
