//! Telementoring: the pen, who shows what, requests for instruments, and what was refused.

use std::collections::BTreeMap;

use egui::{Color32, Context, Key, RichText, Sense, Stroke, Ui, Vec2};
use trocar_scene::{
    MentorAnswer, MentorDeed, MentorLabel, MentorPointer, MentorStroke, PictureFreeze, Side, Signature,
    Snapshot,
};

use super::super::keys::{Action, MentorKey, hint};
use super::super::mentor::{COLOURS, LabelEntry, Pen, askable, requested};
use super::{BAD, GOOD, POOR, Wishes};
use crate::overlay::annotations;

/// Side of a colour's button \[points\].
const SWATCH: f32 = 18.0;

/// Draws the section, in a session that others share.
pub(super) fn show(ui: &mut Ui, scene: &Snapshot, pen: &mut Pen, wishes: &mut Wishes) {
    let Some(answer) = MentorAnswer::of(scene).filter(|_| pen.is_shared) else { return };
    ui.separator();
    ui.strong("show the others");
    if answer.may_annotate() {
        tools(ui, scene, answer, pen, wishes);
    } else {
        let text = "this station watches: with the role 'watch' it may not point, draw, freeze, or take over";
        ui.label(RichText::new(text).color(POOR));
    }
    for (by, what) in shown(scene) {
        let [r, g, b, _] = annotations::color(by.0);
        ui.label(RichText::new(format!("{}: {what}", by.1)).color(Color32::from_rgb(r, g, b)));
    }
    hand_over(ui, scene, answer, pen, wishes);
    if !answer.is_heard {
        ui.label(RichText::new("the host does not hear this station now").color(BAD));
    }
    if !answer.refusal.is_empty() {
        let since = scene.time().since(answer.refused_at).as_secs_f64();
        ui.label(RichText::new(format!("refused {}: {}", ago(since), answer.refusal)).color(BAD));
    }
}

fn tools(ui: &mut Ui, scene: &Snapshot, answer: &MentorAnswer, pen: &mut Pen, wishes: &mut Wishes) {
    let mut wish = |key: MentorKey| wishes.0.push(Action::Mentor(key));
    ui.horizontal(|ui| {
        let text = if pen.is_on() { "drawing" } else { "draw" };
        if ui.selectable_label(pen.is_on(), text).on_hover_text(key_of(MentorKey::Pen)).clicked() {
            wish(MentorKey::Pen);
        }
        for (index, [r, g, b]) in COLOURS.into_iter().enumerate() {
            let (rect, response) = ui.allocate_exact_size(Vec2::splat(SWATCH), Sense::click());
            ui.painter().rect_filled(rect.shrink(2.0), 3.0, Color32::from_rgb(r, g, b));
            if pen.colour == index {
                let edge = Stroke::new(2.0, Color32::WHITE);
                ui.painter().rect_stroke(rect, 4.0, edge, egui::StrokeKind::Inside);
            }
            if response.clicked() {
                pen.colour = index;
            }
        }
    });
    ui.horizontal_wrapped(|ui| {
        let frozen = scene.iter::<PictureFreeze>().next().is_some();
        let buttons = [
            ("undo", MentorKey::EraseLast),
            ("clear", MentorKey::EraseAll),
            ("label", MentorKey::Label),
            (if frozen { "let it go on" } else { "freeze" }, MentorKey::Freeze),
        ];
        for (text, key) in buttons {
            if ui.button(text).on_hover_text(key_of(key)).clicked() {
                wish(key);
            }
        }
        if answer.role.is_none() {
            let about = "takes away what all stations have drawn and written";
            if ui.button("clear all").on_hover_text(about).clicked() {
                pen.clear(true);
            }
        }
    });
}

/// Requests for instruments, with what the person may do about them.
fn hand_over(ui: &mut Ui, scene: &Snapshot, answer: &MentorAnswer, pen: &mut Pen, wishes: &mut Wishes) {
    for request in requested(scene, answer) {
        let colour = if request.steps.is_empty() { POOR } else { GOOD };
        ui.label(RichText::new(&request.text).color(colour).strong());
        ui.horizontal(|ui| {
            for (step, words) in request.steps {
                if ui.button(words).clicked() {
                    pen.does(MentorDeed::HandOver { hand: request.hand, step });
                }
            }
        });
    }
    for (_, side, instrument) in askable(scene, answer) {
        let key = if side == Side::Left { MentorKey::AskLeft } else { MentorKey::AskRight };
        if ui.button(format!("ask for {instrument}")).on_hover_text(key_of(key)).clicked() {
            wishes.0.push(Action::Mentor(key));
        }
    }
}

fn key_of(key: MentorKey) -> String {
    hint(Action::Mentor(key))
}

/// What each person shows now, in words.
fn shown(scene: &Snapshot) -> Vec<((u16, String), String)> {
    #[derive(Default)]
    struct Shows {
        points: bool,
        strokes: std::collections::BTreeSet<u32>,
        labels: usize,
        froze: bool,
    }
    let mut all: BTreeMap<(u16, String), Shows> = BTreeMap::new();
    let key = |by: &Signature| (by.station, by.name.clone());
    for (_, pointer) in scene.iter::<MentorPointer>() {
        all.entry(key(&pointer.by)).or_default().points = true;
    }
    for (_, stroke) in scene.iter::<MentorStroke>() {
        all.entry(key(&stroke.by)).or_default().strokes.insert(stroke.stroke);
    }
    for (_, label) in scene.iter::<MentorLabel>() {
        all.entry(key(&label.by)).or_default().labels += 1;
    }
    for (_, freeze) in scene.iter::<PictureFreeze>() {
        all.entry(key(&freeze.by)).or_default().froze = true;
    }
    let count = |count: usize, what: &str| match count {
        0 => None,
        1 => Some(format!("1 {what}")),
        _ => Some(format!("{count} {what}s")),
    };
    let words = |shows: Shows| {
        let points = shows.points.then(|| "points".to_owned());
        let froze = shows.froze.then(|| "has frozen the picture".to_owned());
        let parts = [points, count(shows.strokes.len(), "stroke"), count(shows.labels, "label"), froze];
        parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
    };
    all.into_iter().map(|(by, shows)| (by, words(shows))).collect()
}

/// How long ago something was, for people.
fn ago(secs: f64) -> String {
    if secs < 60.0 { format!("{secs:.0} s ago") } else { format!("{:.0} min ago", secs / 60.0) }
}

/// What the window says over the scene: that the mouse draws, and the line for a label.
pub(super) fn over_the_scene(ctx: &Context, scene: &Snapshot, pen: &mut Pen) {
    if pen.is_on() {
        egui::Area::new(egui::Id::unique("drawing"))
            // Beside the panel at the left; what is said of pictures that lag is at the right.
            .anchor(egui::Align2::LEFT_BOTTOM, [252.0, -12.0])
            .interactable(false)
            .show(ctx, |ui| {
                egui::Frame::popup(ui.style()).show(ui, |ui| {
                    let [r, g, b] = COLOURS[pen.colour % COLOURS.len()];
                    ui.horizontal(|ui| {
                        ui.label(RichText::new("drawing").color(Color32::from_rgb(r, g, b)).strong());
                        ui.label("left button draws, right button and wheel lead the camera, F4 ends");
                    });
                });
            });
    }
    let station = MentorAnswer::of(scene).map_or(0, |answer| answer.station);
    let Some(entry) = &mut pen.label else { return };
    match label_line(ctx, entry) {
        Some(true) => pen.put_label(scene, station),
        Some(false) => pen.label = None,
        None => {}
    }
}

/// The line into which a label is written; whether it is to be put, once that is decided.
fn label_line(ctx: &Context, entry: &mut LabelEntry) -> Option<bool> {
    let mut decided = None;
    egui::Window::new("label")
        .collapsible(false)
        .resizable(false)
        .anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0])
        .show(ctx, |ui| {
            let line = egui::TextEdit::singleline(&mut entry.text).char_limit(60).desired_width(260.0);
            let response = ui.add(line.hint_text("what is here"));
            if !std::mem::replace(&mut entry.has_focus, true) {
                response.request_focus();
            }
            ui.label(RichText::new("Enter puts it, Esc does not").weak());
            let pressed = |key| ui.input(|input| input.key_pressed(key));
            if pressed(Key::Escape) {
                decided = Some(false);
            } else if pressed(Key::Enter) {
                decided = Some(true);
            }
        });
    decided
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use trocar_scene::{
        Commands, Entity, EntityAllocator, Registry, SimTime, StationRole, Store, SurfacePlace, SurfacePoint,
    };

    use super::super::tests::texts;
    use super::*;

    fn place() -> SurfacePlace {
        let on = SurfacePoint::Body { point: [0.0; 3], normal: [0.0, 0.0, 1.0] };
        SurfacePlace { entity: Entity::new(0, 0, 7), on }
    }

    fn scene(answer: MentorAnswer) -> Snapshot {
        let registry = Registry::standard();
        let mut store = Store::new(registry.clone());
        let mut out = Commands::new(registry, EntityAllocator::new(0, 0));
        let by = |station: u16| Signature { station, name: format!("Ana {station}"), at: SimTime::ZERO };
        for (stroke, section) in [(1, 0), (1, 1), (2, 0)] {
            let entity = out.spawn();
            let (colour, width, gaps) = ([1, 2, 3], 0.001, Vec::new());
            let places = Arc::new(vec![place()]);
            out.put(entity, MentorStroke { by: by(2), stroke, section, colour, width, places, gaps });
        }
        let [pointer, label, network] = [out.spawn(), out.spawn(), out.spawn()];
        out.put(pointer, MentorPointer { by: by(1), place: place() });
        out.put(label, MentorLabel { by: by(2), label: 1, place: place(), text: "here".to_owned() });
        out.put(network, answer);
        store.apply(&mut out, SimTime::from_millis(5_000));
        store.snapshot()
    }

    fn panel(scene: &Snapshot) -> String {
        let ctx = Context::default();
        let (mut pen, mut wishes, mut told) = (Pen::default(), Wishes::default(), String::new());
        pen.is_shared = true;
        for _ in 0..2 {
            let output = ctx.run_ui(egui::RawInput::default(), |ui| show(ui, scene, &mut pen, &mut wishes));
            told = texts(&output.shapes);
        }
        told
    }

    #[test]
    fn it_is_told_who_shows_what() {
        let all = shown(&scene(MentorAnswer::default()));
        let words: Vec<(u16, &str)> = all.iter().map(|((by, _), what)| (*by, what.as_str())).collect();
        assert_eq!(words, [(1, "points"), (2, "2 strokes, 1 label")]);
    }

    #[test]
    fn a_watcher_is_told_that_it_may_not_and_who_may_gets_the_tools() {
        let answer = MentorAnswer {
            station: 2,
            is_heard: true,
            refusals: 1,
            refusal: "no such surface".to_owned(),
            refused_at: SimTime::from_millis(2_000),
            ..MentorAnswer::default()
        };
        let of = |role| panel(&scene(MentorAnswer { role, ..answer.clone() }));
        let watch = of(Some(StationRole::Watch));
        assert!(watch.contains("role 'watch'") && !watch.contains("undo"), "{watch}");
        assert!(watch.contains("refused 3 s ago: no such surface"), "{watch}");
        let mentor = of(Some(StationRole::Mentor));
        assert!(mentor.contains("undo") && !mentor.contains("clear all"), "{mentor}");
        assert!(of(None).contains("clear all"));
        assert!(mentor.contains("Ana 2: 2 strokes, 1 label"), "{mentor}");
    }
}
