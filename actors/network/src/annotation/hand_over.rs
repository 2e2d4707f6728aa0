//! The hand-over of an instrument, as steps: asked for, accepted or declined, given back.

use trocar_scene::{Signature, TakeOverRequest, TakeOverStep};

use crate::control::{HandInfo, NoteRefusal, PlainText, Refusal, TakeOver};
use crate::hands_link::HOST;

/// What becomes of the request for a hand's instrument after a step of `by`; `None`: there is none any longer. Who serves the
/// hand, the session changes: after a step that is [`TakeOverStep::Accepted`] it is who asked.
///
/// # Errors
/// [`Refusal`], in words.
pub(crate) fn after(
    request: Option<&TakeOverRequest>,
    step: TakeOver,
    by: Signature,
    is_host: bool,
    hand: &HandInfo,
) -> Result<Option<TakeOverRequest>, Refusal> {
    let name = || hand.name.clone();
    // One that was declined is over: it stays for who asked to see.
    let open = request.filter(|request| request.step != TakeOverStep::Declined);
    match step {
        TakeOver::Ask => {
            // A hand that nobody serves is the host's.
            if hand.station.unwrap_or(HOST) == by.station {
                return Err(NoteRefusal::OwnHand { hand: name() }.into());
            }
            if let Some(open) = open.filter(|open| open.by.station != by.station) {
                let by = PlainText::new(&open.by.name);
                return Err(NoteRefusal::HandAsked { hand: name(), by }.into());
            }
            Ok(Some(TakeOverRequest { by, step: TakeOverStep::Asked, answer: None }))
        }
        TakeOver::Accept | TakeOver::Decline => {
            let asked = open.filter(|open| open.step == TakeOverStep::Asked);
            let Some(asked) = asked else { return Err(NoteRefusal::NotAsked { hand: name() }.into()) };
            // A hand that nobody serves is the host's to give.
            let is_its_own = hand.station == Some(by.station);
            if !(is_host || is_its_own && by.station != asked.by.station) {
                return Err(Refusal::HandNotServed { hand: PlainText::new(hand.name.as_str()) });
            }
            let step = match step {
                TakeOver::Accept => TakeOverStep::Accepted,
                _ => TakeOverStep::Declined,
            };
            Ok(Some(TakeOverRequest { by: asked.by.clone(), step, answer: Some(by) }))
        }
        TakeOver::Return => {
            let Some(open) = request else { return Err(NoteRefusal::NotAsked { hand: name() }.into()) };
            let answered = open.answer.as_ref().map(|answer| answer.station);
            if is_host || by.station == open.by.station || answered == Some(by.station) {
                Ok(None)
            } else {
                Err(Refusal::HandNotServed { hand: PlainText::new(hand.name.as_str()) })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use trocar_scene::{Entity, SimTime};

    use super::*;

    const SURGEON: u16 = 5;
    const MENTOR: u16 = 6;
    const OTHER: u16 = 7;

    fn by(station: u16, at: u64) -> Signature {
        Signature { station, name: format!("station {station}"), at: SimTime::from_millis(at) }
    }

    fn hand(station: Option<u16>) -> HandInfo {
        HandInfo { number: 1, name: "right".parse().expect("a name"), entity: Entity::new(0, 0, 4), station }
    }

    struct Talk {
        request: Option<TakeOverRequest>,
        hand: HandInfo,
        now: u64,
    }

    impl Talk {
        fn say(&mut self, station: u16, step: TakeOver) -> Result<(), Refusal> {
            self.now += 1;
            let by = by(station, self.now);
            self.request = after(self.request.as_ref(), step, by, station == 0, &self.hand)?;
            Ok(())
        }
        fn step(&self) -> Option<TakeOverStep> {
            self.request.as_ref().map(|request| request.step)
        }
    }

    fn talk() -> Talk {
        Talk { request: None, hand: hand(Some(SURGEON)), now: 0 }
    }

    #[test]
    fn an_instrument_is_asked_for_handed_over_and_given_back() {
        let mut talk = talk();
        assert_eq!(talk.say(MENTOR, TakeOver::Ask), Ok(()));
        assert_eq!(talk.say(MENTOR, TakeOver::Ask), Ok(()), "again, with a newer time");
        assert_eq!(talk.request.as_ref().map(|request| request.by.at), Some(SimTime::from_millis(2)));
        assert_eq!(talk.say(SURGEON, TakeOver::Accept), Ok(()));
        let request = talk.request.clone().expect("it is there");
        assert_eq!((request.by.station, request.step), (MENTOR, TakeOverStep::Accepted));
        assert_eq!(request.answer, Some(by(SURGEON, 3)));
        talk.hand.station = Some(MENTOR);
        assert!(matches!(talk.say(OTHER, TakeOver::Return), Err(Refusal::HandNotServed { .. })));
        // Its own station takes it back; so could the mentor give it.
        assert_eq!(talk.say(SURGEON, TakeOver::Return), Ok(()));
        assert_eq!(talk.step(), None);
    }

    #[test]
    fn only_who_serves_the_hand_answers_or_the_host() {
        let mut talk = talk();
        talk.say(MENTOR, TakeOver::Ask).expect("it may");
        for station in [MENTOR, OTHER] {
            let refused = talk.say(station, TakeOver::Accept).expect_err("not its hand").to_string();
            assert!(refused.contains("'right' is not served by this station"), "{refused}");
        }
        assert_eq!(talk.say(SURGEON, TakeOver::Decline), Ok(()));
        assert_eq!(talk.step(), Some(TakeOverStep::Declined));
        let late = talk.say(SURGEON, TakeOver::Accept).expect_err("declined");
        assert!(matches!(late, Refusal::Note(NoteRefusal::NotAsked { .. })));
        // What was declined keeps nobody else from asking; and a hand that nobody serves is the host's.
        talk.hand.station = None;
        assert_eq!(talk.say(OTHER, TakeOver::Ask), Ok(()));
        assert!(talk.say(SURGEON, TakeOver::Accept).is_err());
        assert_eq!(talk.say(0, TakeOver::Accept), Ok(()));
        assert_eq!(talk.step(), Some(TakeOverStep::Accepted));
    }

    #[test]
    fn one_asks_at_a_time_and_nobody_for_a_hand_of_his_own() {
        let mut talk = talk();
        let own = talk.say(SURGEON, TakeOver::Ask).expect_err("its own").to_string();
        assert_eq!(own, "the hand 'right' is served by this station itself, which need not ask for it");
        assert!(talk.say(SURGEON, TakeOver::Return).is_err(), "nothing to give back");
        talk.say(MENTOR, TakeOver::Ask).expect("it may");
        let second = talk.say(OTHER, TakeOver::Ask).expect_err("asked for").to_string();
        assert!(second.contains("is with 'station 6', or asked for"), "{second}");
        // Who asks may think better of it.
        assert_eq!(talk.say(MENTOR, TakeOver::Return), Ok(()));
        assert_eq!(talk.say(OTHER, TakeOver::Ask), Ok(()));
    }
}
