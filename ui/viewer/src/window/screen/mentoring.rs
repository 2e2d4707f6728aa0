//! Telementoring in a window: mouse and keys lead the pen, and what it does is passed on to the subject.

use std::sync::Arc;
use std::time::Instant;

use egui::Pos2;
use trocar_scene::annotation::SurfaceHit;
use trocar_scene::{Hand, HandOverStep, MentorAnswer, MentorDeed, Side, Snapshot};
use winit::event::{ElementState, MouseButton, WindowEvent};

use super::super::events::LoopMessage;
use super::super::keys::MentorKey;
use super::super::mentor::{askable, requested};
use super::Screen;

/// Distance that the mouse moves between two looks at what is under it \[pixels\].
const LOOK: f32 = 2.0;

impl Screen<'_> {
    /// The pen follows the mouse; returns whether the event is the pen's alone.
    pub(super) fn lead_pen(&mut self, event: &WindowEvent, over: Option<usize>) -> bool {
        if !self.kept.pen.is_on() {
            return false;
        }
        match event {
            WindowEvent::CursorMoved { .. } => {
                let place = self.mouse.place();
                if self.looked_at.is_none_or(|before| before.distance(place) >= LOOK) {
                    self.looked_at = Some(place);
                    self.with_hit(over, place, |screen, hit, now| {
                        let Some((scene, station)) = screen.shown_by() else { return };
                        screen.kept.pen.hover(&scene, station, hit, now);
                    });
                    self.stale = true;
                }
                false
            }
            WindowEvent::MouseInput { state: ElementState::Pressed, button: MouseButton::Left, .. } => {
                if over.is_none() {
                    return false;
                }
                self.with_hit(over, self.mouse.place(), |screen, hit, now| {
                    let Some((scene, station)) = screen.shown_by() else { return };
                    screen.kept.pen.press(&scene, station, hit, now);
                });
                true
            }
            WindowEvent::MouseInput { state: ElementState::Released, button: MouseButton::Left, .. } => {
                self.kept.pen.release();
                false
            }
            WindowEvent::CursorLeft { .. } | WindowEvent::Focused(false) => {
                self.kept.pen.release();
                self.kept.pen.leave();
                false
            }
            _ => false,
        }
    }

    /// The first subject's scene, and the number of the station that the window is at.
    fn shown_by(&self) -> Option<(Arc<Snapshot>, u16)> {
        let scene = self.kept.subject_views.first()?.scene.clone();
        let station = MentorAnswer::of(&scene).map_or(0, |answer| answer.station);
        Some((scene, station))
    }

    /// What is under the mouse in the first subject.
    fn hit(&mut self, place: Pos2) -> Option<SurfaceHit> {
        let (index, at) = self.canvas.at(place)?;
        self.kept.subject_views.get_mut(index).filter(|_| index == 0)?.place_at(self.gpu, at)
    }

    fn with_hit(
        &mut self,
        over: Option<usize>,
        place: Pos2,
        then: impl FnOnce(&mut Self, Option<&SurfaceHit>, Instant),
    ) {
        let hit = over.and_then(|_| self.hit(place));
        then(self, hit.as_ref(), Instant::now());
    }

    /// Passes on what the person shows; called between two frames.
    pub(super) fn pass_pen_on(&mut self) {
        let Some(first) = self.kept.subject_views.first_mut() else { return };
        self.kept.pen.is_shared = first.subject.is_shared();
        let Some(answer) = MentorAnswer::of(&first.scene).filter(|_| self.kept.pen.is_shared) else {
            // Whom it would be shown to is gone.
            self.kept.pen.deeds().clear();
            return;
        };
        let refusals = answer.refusals;
        if refusals > self.heard_refusals.unwrap_or(refusals) {
            self.kept.panels.note(answer.refusal.clone(), true);
        }
        self.heard_refusals = Some(refusals);
        let pen = &mut self.kept.pen;
        pen.pass(Instant::now());
        let pointer = pen.take_pointer();
        first.subject.show(pointer, pen.deeds());
        if std::mem::take(&mut pen.is_full) {
            self.kept.panels.note("too much at once: some of it is not shown to the others".to_owned(), true);
        }
    }

    /// Does what a key, or a button of the panel, says.
    pub(super) fn mentor(&mut self, key: MentorKey) {
        let Some((scene, station)) = self.shown_by() else { return };
        let Some(answer) = MentorAnswer::of(&scene).cloned().filter(|_| self.kept.pen.is_shared) else {
            let text = "nobody shares this session: host it, or join one";
            return self.kept.panels.note(text.to_owned(), true);
        };
        let is_asking = matches!(key, MentorKey::AskLeft | MentorKey::AskRight);
        if is_asking && !answer.may_ask() {
            let text = "only a mentor's ticket, or the host, may ask for an instrument";
            return self.kept.panels.note(text.to_owned(), true);
        }
        if !answer.may_annotate() {
            let text = "the role 'watch' may not do this: ask the host for a mentor's ticket";
            return self.kept.panels.note(text.to_owned(), true);
        }
        match key {
            MentorKey::Pen => self.take_pen(!self.kept.pen.is_on()),
            MentorKey::EraseLast => self.kept.pen.erase_last(&scene, station),
            MentorKey::EraseAll => self.kept.pen.clear(false),
            MentorKey::Freeze => self.kept.pen.freeze(&scene),
            MentorKey::Label => match self.hit(self.mouse.place()) {
                Some(hit) => {
                    self.give_instruments_back();
                    self.kept.pen.begin_label(hit.place);
                }
                None => {
                    let text = "a label is put where the mouse is: move it over something, then Ctrl+L";
                    self.kept.panels.note(text.to_owned(), true);
                }
            },
            MentorKey::AskLeft => self.ask(Side::Left, &scene, &answer),
            MentorKey::AskRight => self.ask(Side::Right, &scene, &answer),
            MentorKey::Accept => self.answer(&[HandOverStep::Accept, HandOverStep::Return], &scene, &answer),
            MentorKey::Decline => self.answer(&[HandOverStep::Decline], &scene, &answer),
        }
    }

    /// Takes the pen up, and lays the instruments down for it; or the other way round.
    pub(super) fn take_pen(&mut self, is_on: bool) {
        self.kept.pen.set_on(is_on);
        self.looked_at = None;
        if is_on {
            self.give_instruments_back();
        } else if std::mem::take(&mut self.laid_down) {
            self.tell(LoopMessage::TakeHands(self.actor.window.id()));
        }
    }

    fn give_instruments_back(&mut self) {
        if self.kept.hands.taken {
            self.laid_down = self.kept.pen.is_on();
            self.tell(LoopMessage::GiveBackHands);
        }
    }

    /// Asks for the instrument of that side, or gives it back.
    fn ask(&mut self, side: Side, scene: &Snapshot, answer: &MentorAnswer) {
        let own = requested(scene, answer)
            .into_iter()
            .find(|row| row.side == Some(side) && row.is_own && row.may(HandOverStep::Return));
        let asked = askable(scene, answer).into_iter().find(|(_, of, _)| *of == side);
        let deed = match (own, asked) {
            (Some(row), _) => MentorDeed::HandOver { hand: row.hand, step: HandOverStep::Return },
            (None, Some((hand, ..))) => MentorDeed::HandOver { hand, step: HandOverStep::Ask },
            (None, None) => {
                let is_there = scene.iter::<Hand>().any(|(_, hand)| hand.side == side);
                let why = if is_there { "is yours, or asked for already" } else { "is not in this session" };
                let text = format!("the {} instrument {why}", side.as_str());
                return self.kept.panels.note(text, true);
            }
        };
        self.kept.pen.does(deed);
    }

    /// Answers the first request that can be answered so.
    fn answer(&mut self, steps: &[HandOverStep], scene: &Snapshot, answer: &MentorAnswer) {
        let rows = requested(scene, answer);
        let found = steps.iter().find_map(|step| {
            let row = rows.iter().find(|row| !row.is_own && row.may(*step))?;
            Some(MentorDeed::HandOver { hand: row.hand, step: *step })
        });
        match found {
            Some(deed) => self.kept.pen.does(deed),
            None => self.kept.panels.note("nobody asks for an instrument here".to_owned(), true),
        }
    }
}
