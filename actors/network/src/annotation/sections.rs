//! Strokes in sections: what is drawn goes on in the last one, so that a long stroke is not sent again with each place.

use std::sync::Arc;

use trocar_scene::{MentorStroke, SECTION_PLACES_MAX, Signature, SurfacePlace};

/// How a stroke looks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Look {
    pub(super) colour: [u8; 3],
    /// \[m\].
    pub(super) width: f32,
}

/// Appends places to a stroke: `None` for one that is not there, where the ribbon is interrupted. Returns the sections that
/// changed or are new, in order; the first one is `last` if something was appended to it.
pub(super) fn extend(
    last: Option<&MentorStroke>,
    (stroke, look): (u32, Look),
    by: &Signature,
    places: impl IntoIterator<Item = Option<SurfacePlace>>,
) -> Vec<MentorStroke> {
    let mut changed: Vec<MentorStroke> = Vec::new();
    let fresh = |section: u16, places: Vec<SurfacePlace>| MentorStroke {
        by: by.clone(),
        stroke,
        section,
        colour: look.colour,
        width: look.width,
        places: Arc::new(places),
        gaps: Vec::new(),
    };
    let looks_so = |section: &&MentorStroke| section.colour == look.colour && section.width == look.width;
    let mut is_joined = last.is_some_and(|section| looks_so(&section));
    for place in places {
        let Some(place) = place else {
            is_joined = false;
            continue;
        };
        let open = match changed.last() {
            Some(section) => Some(section),
            None => last.filter(looks_so),
        };
        match open {
            Some(section) if section.places.len() < SECTION_PLACES_MAX => {
                if changed.is_empty() {
                    changed.extend(last.map(|section| MentorStroke { by: by.clone(), ..section.clone() }));
                }
                if let Some(section) = changed.last_mut() {
                    if !is_joined {
                        section.gaps.push(section.places.len() as u16);
                    }
                    Arc::make_mut(&mut section.places).push(place);
                }
            }
            full => {
                // The ribbon goes on from where the section before ends.
                let end = full.and_then(|section| section.places.last().copied()).filter(|_| is_joined);
                let number = changed.last().or(last).map_or(0, |section| section.section.saturating_add(1));
                changed.push(fresh(number, end.into_iter().chain([place]).collect()));
            }
        }
        is_joined = true;
    }
    changed
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use trocar_scene::{Component, Entity, SimTime, SurfacePoint};

    use super::*;

    const LOOK: Look = Look { colour: [200, 30, 20], width: 0.002 };

    fn by() -> Signature {
        Signature { station: 3, name: "Ana".to_owned(), at: SimTime::ZERO }
    }

    fn place(number: u32) -> SurfacePlace {
        let on = SurfacePoint::Triangle { corners: [number, 1, 2], barycentric: [1.0, 0.0, 0.0] };
        SurfacePlace { entity: Entity::new(0, 0, 1), on }
    }

    fn number(place: &SurfacePlace) -> u32 {
        match place.on {
            SurfacePoint::Triangle { corners, .. } => corners[0],
            _ => panic!("a triangle"),
        }
    }

    #[test]
    fn another_colour_begins_another_section_without_a_ribbon_to_it() {
        let first = extend(None, (1, LOOK), &by(), [Some(place(10)), Some(place(11))]);
        let other = Look { colour: [0, 0, 255], ..LOOK };
        let second = extend(first.last(), (1, other), &by(), [Some(place(12))]);
        assert_eq!((first.len(), second.len(), second[0].section), (1, 1, 1));
        assert_eq!(second[0].places.iter().map(number).collect::<Vec<_>>(), [12]);
    }

    proptest! {
        /// However a stroke is cut into notes, its sections show the same runs.
        #[test]
        fn the_runs_of_a_stroke_are_those_of_its_places(
            notes in prop::collection::vec(prop::collection::vec(prop::bool::weighted(0.9), 1..80), 1..8),
        ) {
            let mut sections: Vec<MentorStroke> = Vec::new();
            let (mut expected, mut run, mut next) = (Vec::new(), Vec::new(), 0_u32);
            for note in notes {
                let places: Vec<_> = (next..).zip(&note).map(|(at, kept)| kept.then(|| place(at))).collect();
                // What a note loses at its end is no gap: the next one is joined to what is left.
                let end = note.iter().rposition(|kept| *kept).map_or(0, |last| last + 1);
                for place in &places[..end] {
                    match place {
                        Some(place) => run.push(number(place)),
                        None => expected.push(std::mem::take(&mut run)),
                    }
                }
                next += note.len() as u32;
                let changed = extend(sections.last(), (7, LOOK), &by(), places);
                if changed.first().is_some_and(|first| sections.last().is_some_and(|last| last.section == first.section)) {
                    sections.pop();
                }
                sections.extend(changed);
            }
            expected.push(run);
            expected.retain(|run| !run.is_empty());
            let mut drawn: Vec<Vec<u32>> = Vec::new();
            for (index, section) in sections.iter().enumerate() {
                prop_assert_eq!((section.check(), section.section), (Ok(()), index as u16));
                for run in section.runs() {
                    let numbers: Vec<u32> = run.iter().map(number).collect();
                    match drawn.last_mut() {
                        // The place that two sections share.
                        Some(before) if before.last() == numbers.first() => before.extend(&numbers[1..]),
                        _ => drawn.push(numbers),
                    }
                }
            }
            prop_assert_eq!(drawn, expected);
        }
    }
}
