//! The desk: what the station's own person does becomes notes for the host, and what is refused is told to that person.

use std::collections::BTreeSet;
use std::fmt::Display;

use trocar_devices::Pedals;
use trocar_scene::{
    Access, Commands, DeviceState, Entity, EntitySet, Hand, HandOverStep, MentorAnswer, MentorDeed,
    MentorInput, PersonInput, SimTime, Snapshot, StationRole, SurfacePlace, TakeOverRequest, TakeOverStep,
};

use crate::control::{HandInfo, NoteKind, PlainText, Refusal, TakeOver};
use crate::hands_link::HOST;
use crate::ticket::Role;

/// Least time between two places of a pointer: 30 a second.
const POINT_EVERY: SimTime = SimTime::from_millis(34);
/// Deeds a second, and as many at once.
const DEEDS_PER_SEC: f64 = 30.0;
const DEEDS_AT_ONCE: f64 = 32.0;
/// How far a pedal has to be pressed to count.
const PEDAL_PRESSED: f64 = 0.5;

/// Who is at the desk.
#[derive(Clone, Copy, Debug)]
pub struct DeskOwner<'a> {
    /// Number of the station.
    pub station: u16,
    /// Its role; `None` for the host.
    pub role: Option<Role>,
    /// Whether the host hears it.
    pub is_heard: bool,
    /// The hands of the session.
    pub hands: &'a [HandInfo],
    /// At the host, what the pedals of its own devices say, by the numbers of their hands: there the scene shows the pedals of
    /// whoever has the hand. At a station the scene shows its own.
    pub pedals: &'a [(u8, Pedals)],
}

/// Reads the [`MentorInput`] of a station's own person and turns it into notes: each deed once, in order, and no more than
/// a link bears. It keeps in the scene what it has taken, so that one that is built anew goes on.
#[derive(Debug, Default)]
pub struct MentorDesk {
    answer: MentorAnswer,
    /// What the scene has of the answer.
    shown: Option<MentorAnswer>,
    /// Where the others were told that the person points; `None`: that is unknown.
    pointer: Option<Option<SurfacePlace>>,
    pointed_at: SimTime,
    allowance: f64,
    refilled_at: SimTime,
    /// Hands that this person has handed over, and whose pedal is released, so that pressing it takes them back.
    ready: BTreeSet<Entity>,
}

impl MentorDesk {
    /// Goes on where an earlier life stopped, whose answer is on the entity `me`.
    pub fn of(scene: &Snapshot, me: Entity) -> Self {
        let answer = scene.get::<MentorAnswer>(me).cloned().unwrap_or_default();
        Self { answer, allowance: DEEDS_AT_ONCE, refilled_at: scene.time(), ..Self::default() }
    }

    /// What its controller reads and writes.
    #[must_use]
    pub fn access(access: Access) -> Access {
        access
            .reads::<MentorInput>()
            .reads::<PersonInput>()
            .reads::<Hand>()
            .reads::<DeviceState>()
            .reads::<TakeOverRequest>()
            .writes::<MentorAnswer>(EntitySet::Own)
    }

    /// What is to be told to the host now.
    pub fn take(&mut self, now: SimTime, scene: &Snapshot, owner: &DeskOwner<'_>) -> Vec<NoteKind> {
        self.answer.station = owner.station;
        self.answer.role = owner.role.map(shown_role);
        self.answer.is_heard = owner.is_heard;
        let passed = now.since(self.refilled_at).as_secs_f64();
        self.allowance = (self.allowance + passed * DEEDS_PER_SEC).min(DEEDS_AT_ONCE);
        self.refilled_at = now;
        let input = MentorInput::of(scene, owner.station);
        let mut notes: Vec<NoteKind> = self.point(now, input, owner).into_iter().collect();
        if let Some(input) = input {
            self.take_deeds(now, input, owner, &mut notes);
        }
        self.take_back(scene, owner, &mut notes);
        notes
    }

    /// Something that the person has shown or asked for is refused.
    pub fn refuse(&mut self, now: SimTime, why: &dyn Display) {
        let text = PlainText::new(why.to_string());
        self.answer.refusals += 1;
        self.answer.refusal = text.as_str().to_owned();
        self.answer.refused_at = now;
    }

    /// Puts the answer into the scene, where it has changed.
    pub fn show(&mut self, me: Entity, out: &mut Commands) {
        if self.shown.as_ref() != Some(&self.answer) {
            out.put(me, self.answer.clone());
            self.shown = Some(self.answer.clone());
        }
    }

    fn point(
        &mut self,
        now: SimTime,
        input: Option<&MentorInput>,
        owner: &DeskOwner<'_>,
    ) -> Option<NoteKind> {
        if !owner.is_heard {
            self.pointer = None;
            return None;
        }
        let wish = input.and_then(|input| input.pointer);
        // Who has never pointed need not say so.
        let is_news = self.pointer != Some(wish) && (self.pointer.is_some() || wish.is_some());
        if !is_news || now.since(self.pointed_at) < POINT_EVERY {
            return None;
        }
        (self.pointer, self.pointed_at) = (Some(wish), now);
        self.allowed(now, NoteKind::Pointer(wish), owner)
    }

    fn take_deeds(
        &mut self,
        now: SimTime,
        input: &MentorInput,
        owner: &DeskOwner<'_>,
        notes: &mut Vec<NoteKind>,
    ) {
        if self.answer.source != input.source {
            (self.answer.source, self.answer.taken) = (input.source, 0);
        }
        for (number, deed) in (input.first..).zip(input.deeds.iter()) {
            if number <= self.answer.taken {
                continue;
            }
            if self.allowance < 1.0 {
                break;
            }
            self.allowance -= 1.0;
            self.answer.taken = number;
            // What is done while nobody hears it must not happen a minute later.
            if !owner.is_heard {
                self.refuse(now, &"the host does not hear this station now; what is shown reaches nobody");
                continue;
            }
            match note(deed, owner) {
                Ok(note) => notes.extend(self.allowed(now, note, owner)),
                Err(refusal) => self.refuse(now, &refusal),
            }
        }
    }

    /// Whoever has handed an instrument over takes it back by its pedal, once that has been released.
    fn take_back(&mut self, scene: &Snapshot, owner: &DeskOwner<'_>, notes: &mut Vec<NoteKind>) {
        for info in owner.hands {
            let is_lent = |request: &&TakeOverRequest| {
                let answered = request.answer.as_ref().map(|answer| answer.station);
                request.step == TakeOverStep::Accepted && answered == Some(owner.station)
            };
            if scene.get::<TakeOverRequest>(info.entity).filter(is_lent).is_none() {
                self.ready.remove(&info.entity);
            } else if !is_pressed(scene, info, owner) {
                self.ready.insert(info.entity);
            } else if self.ready.remove(&info.entity) && owner.is_heard {
                notes.push(NoteKind::TakeOver { hand: info.number, step: TakeOver::Return });
            }
        }
    }

    /// The note, if the role allows it: the host would count it as a breach of the rules.
    fn allowed(&mut self, now: SimTime, note: NoteKind, owner: &DeskOwner<'_>) -> Option<NoteKind> {
        match owner.role {
            Some(role) if !note.is_allowed_to(role) => {
                self.refuse(now, &Refusal::not_allowed(role, note.name()));
                None
            }
            _ => Some(note),
        }
    }
}

/// A deed as a note.
fn note(deed: &MentorDeed, owner: &DeskOwner<'_>) -> Result<NoteKind, Refusal> {
    Ok(match deed {
        MentorDeed::Draw { stroke, colour, width, places } => {
            let places = places.clone();
            NoteKind::Stroke { stroke: *stroke, colour: *colour, width: *width, places }
        }
        MentorDeed::Erase { stroke } => NoteKind::Erase { stroke: *stroke },
        MentorDeed::Clear { of_all } => NoteKind::Clear { station: (!of_all).then_some(owner.station) },
        MentorDeed::Label { label, place, text } => {
            NoteKind::Label { label: *label, place: *place, text: PlainText::new(text) }
        }
        MentorDeed::Freeze(freezes) => NoteKind::Freeze(*freezes),
        MentorDeed::HandOver { hand, step } => {
            let Some(info) = owner.hands.iter().find(|info| info.entity == *hand) else {
                let valid = owner.hands.iter().map(|info| info.name.clone()).collect();
                return Err(Refusal::HandUnknown { hand: PlainText::new(hand.to_string()), valid });
            };
            let step = match step {
                HandOverStep::Ask => TakeOver::Ask,
                HandOverStep::Accept => TakeOver::Accept,
                HandOverStep::Decline => TakeOver::Decline,
                HandOverStep::Return => TakeOver::Return,
            };
            NoteKind::TakeOver { hand: info.number, step }
        }
    })
}

/// A role, as the scene shows it.
pub(crate) fn shown_role(role: Role) -> StationRole {
    match role {
        Role::Operate => StationRole::Operate,
        Role::Mentor => StationRole::Mentor,
        Role::Watch => StationRole::Watch,
    }
}

/// Whether the station's own person presses the pedal of a hand: that of its device, or the key that stands for it.
fn is_pressed(scene: &Snapshot, info: &HandInfo, owner: &DeskOwner<'_>) -> bool {
    let pedals = if owner.station == HOST {
        owner.pedals.iter().find(|(number, _)| *number == info.number).map(|(_, pedals)| *pedals)
    } else {
        scene.get::<DeviceState>(info.entity).map(|state| Pedals::of(state.buttons))
    };
    if matches!(pedals, Some(Pedals::Energy | Pedals::Coagulate)) {
        return true;
    }
    let Some(hand) = scene.get::<Hand>(info.entity) else { return false };
    let mut own = scene.iter::<PersonInput>().filter(|(entity, _)| entity.station() == owner.station);
    own.any(|(_, input)| input.hand(hand.side).activation >= PEDAL_PRESSED)
}
