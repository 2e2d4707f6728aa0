//! Requests for instruments, as the person at a window can answer them.

use trocar_scene::{
    Entity, Hand, HandOverStep, MentorAnswer, Side, Snapshot, Station, TakeOverRequest, TakeOverStep,
};

use crate::overlay::annotations::told;

/// A request, and what the person may do about it.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::window) struct Requested {
    /// The hand.
    pub(in crate::window) hand: Entity,
    /// Its side.
    pub(in crate::window) side: Option<Side>,
    /// In words.
    pub(in crate::window) text: String,
    /// Whether the person at the window has asked.
    pub(in crate::window) is_own: bool,
    /// What the person may do, with words for it.
    pub(in crate::window) steps: Vec<(HandOverStep, &'static str)>,
}

impl Requested {
    /// Whether the person may do that.
    pub(in crate::window) fn may(&self, step: HandOverStep) -> bool {
        self.steps.iter().any(|(known, _)| *known == step)
    }
}

/// The requests of a scene, for the person whose network answers so.
pub(in crate::window) fn requested(scene: &Snapshot, own: &MentorAnswer) -> Vec<Requested> {
    let rows = scene.iter::<TakeOverRequest>().map(|(hand, request)| {
        let is_own = request.by.station == own.station;
        let is_host = own.role.is_none();
        let has_answered = request.answer.as_ref().is_some_and(|answer| answer.station == own.station);
        let steps = match request.step {
            TakeOverStep::Asked if is_own => vec![(HandOverStep::Return, "ask no longer")],
            TakeOverStep::Asked if is_host || Station::serving(scene, hand) == own.station => {
                vec![(HandOverStep::Accept, "hand over"), (HandOverStep::Decline, "keep it")]
            }
            TakeOverStep::Accepted if is_own => vec![(HandOverStep::Return, "give it back")],
            TakeOverStep::Accepted if is_host || has_answered => {
                vec![(HandOverStep::Return, "take it back")]
            }
            TakeOverStep::Asked | TakeOverStep::Accepted | TakeOverStep::Declined => Vec::new(),
        };
        let side = scene.get::<Hand>(hand).map(|hand| hand.side);
        Requested { hand, side, text: told(scene, hand, request), is_own, steps }
    });
    rows.collect()
}

/// The hands whose instruments the person may ask for now, with the names of the instruments.
pub(in crate::window) fn askable(scene: &Snapshot, own: &MentorAnswer) -> Vec<(Entity, Side, String)> {
    if !own.may_ask() {
        return Vec::new();
    }
    let is_free = |hand: Entity| {
        let request = scene.get::<TakeOverRequest>(hand);
        request.is_none_or(|request| request.step == TakeOverStep::Declined)
            && Station::serving(scene, hand) != own.station
    };
    let hands = scene.iter::<Hand>().filter(|(entity, _)| is_free(*entity));
    hands.map(|(entity, hand)| (entity, hand.side, scene.name(hand.instrument))).collect()
}

#[cfg(test)]
mod tests {
    use trocar_scene::{
        Commands, EntityAllocator, Name, Pose, Registry, Signature, SimTime, StationRole, Store,
    };

    use super::*;

    const MENTOR: u16 = 2;
    const TRAINEE: u16 = 1;

    /// The left hand is served by the trainee, the right one by the host.
    fn scene(step: Option<TakeOverStep>) -> (Snapshot, Entity) {
        let registry = Registry::standard();
        let mut out = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
        let mut store = Store::new(registry);
        let [left, right, row, hook] = [out.spawn(), out.spawn(), out.spawn(), out.spawn()];
        let hand = |side| Hand { side, instrument: hook, world_from_device: Pose::default(), scale: 1.0 };
        out.put(hook, Name("hook".to_owned()));
        out.put(left, hand(Side::Left));
        out.put(left, Name("hand.left".to_owned()));
        out.put(right, hand(Side::Right));
        out.put(right, Name("hand.right".to_owned()));
        out.put(
            row,
            Station {
                number: TRAINEE,
                name: "Bo".to_owned(),
                role: StationRole::Operate,
                here: true,
                hands: vec!["left".to_owned()],
                protected: true,
                link: Default::default(),
            },
        );
        let by = |station| Signature { station, name: "Ana".to_owned(), at: SimTime::ZERO };
        if let Some(step) = step {
            let answer = (step != TakeOverStep::Asked).then(|| by(TRAINEE));
            out.put(left, TakeOverRequest { by: by(MENTOR), step, answer });
        }
        store.apply(&mut out, SimTime::ZERO);
        (store.snapshot(), left)
    }

    fn person(station: u16, role: Option<StationRole>) -> MentorAnswer {
        MentorAnswer { station, role, ..MentorAnswer::default() }
    }

    #[test]
    fn each_person_is_offered_what_its_part_is() {
        use HandOverStep::{Accept, Decline, Return};
        let mentor = person(MENTOR, Some(StationRole::Mentor));
        let trainee = person(TRAINEE, Some(StationRole::Operate));
        let other = person(7, Some(StationRole::Operate));
        let host = person(0, None);
        for (step, expected) in [
            (TakeOverStep::Asked, [vec![Return], vec![Accept, Decline], vec![], vec![Accept, Decline]]),
            (TakeOverStep::Accepted, [vec![Return], vec![Return], vec![], vec![Return]]),
            (TakeOverStep::Declined, [vec![], vec![], vec![], vec![]]),
        ] {
            let (scene, left) = scene(Some(step));
            for (person, expected) in [&mentor, &trainee, &other, &host].into_iter().zip(expected) {
                let rows = requested(&scene, person);
                assert_eq!((rows.len(), rows[0].hand, rows[0].side), (1, left, Some(Side::Left)));
                let steps: Vec<_> = rows[0].steps.iter().map(|(step, _)| *step).collect();
                assert_eq!(steps, expected, "{step:?} {person:?}");
                assert_eq!(rows[0].is_own, person.station == MENTOR);
            }
        }
    }

    #[test]
    fn who_may_ask_asks_for_what_others_serve() {
        let (scene, _) = scene(None);
        let sides = |person: &MentorAnswer| {
            askable(&scene, person).into_iter().map(|(_, side, _)| side).collect::<Vec<_>>()
        };
        assert_eq!(sides(&person(MENTOR, Some(StationRole::Mentor))), [Side::Left, Side::Right]);
        assert_eq!(sides(&person(0, None)), [Side::Left], "the right one is the host's own");
        assert!(sides(&person(MENTOR, Some(StationRole::Operate))).is_empty());
        let (asked, _) = super::tests::scene(Some(TakeOverStep::Asked));
        assert_eq!(askable(&asked, &person(MENTOR, Some(StationRole::Mentor))).len(), 1);
    }
}
