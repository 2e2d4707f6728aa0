//! The timeline of a recording.

use egui::{Color32, Pos2, Rect, Sense, Stroke, Ui, Vec2};
use trocar_scene::SimTime;

use super::super::keys::Action;
use super::super::subject::{PlayState, Request};
use super::super::view_state::SubjectView;
use super::icons::{Icon, button};
use super::{BAD, Wishes, clock, request_all, toggle_play};

/// A seek bar from the beginning to the end, with marks at events.
pub(super) fn show(ui: &mut Ui, subject_views: &mut [SubjectView], wishes: &mut Wishes) {
    let Some(first) = subject_views.first_mut() else { return };
    let state = first.subject.state();
    let now = first.subject.now();
    let length = subject_views
        .iter_mut()
        .filter_map(|subject_view| subject_view.subject.state().length)
        .max()
        .unwrap_or_default();
    ui.horizontal(|ui| {
        let (icon, name) = match state.play_state {
            PlayState::Running => (Icon::Pause, "pause (Space)"),
            PlayState::Paused | PlayState::Over => (Icon::Play, "go on (Space)"),
        };
        if button(ui, icon, name).clicked() {
            toggle_play(subject_views);
        }
        if button(ui, Icon::Start, "from the beginning (Backspace)").clicked() {
            request_all(subject_views, &Request::Reset);
        }
        let mut looped = state.looped;
        if ui.toggle_value(&mut looped, "loop").on_hover_text("L: begin anew at the end").changed() {
            wishes.0.push(Action::Loop);
        }
        ui.monospace(format!("{} / {}", clock(now.as_secs_f64()), clock(length.as_secs_f64())));
        let width = ui.available_width().max(40.0);
        let (rect, response) = ui.allocate_exact_size(Vec2::new(width, 22.0), Sense::click_and_drag());
        let seconds = length.as_secs_f64().max(1e-9);
        let place = |time: SimTime| {
            rect.left() + (time.as_secs_f64() / seconds).clamp(0.0, 1.0) as f32 * rect.width()
        };
        let painter = ui.painter();
        let line = Rect::from_center_size(rect.center(), Vec2::new(rect.width(), 6.0));
        painter.rect_filled(line, 3.0, ui.visuals().extreme_bg_color);
        let done = Rect::from_min_max(line.min, Pos2::new(place(now), line.max.y));
        painter.rect_filled(done, 3.0, ui.visuals().selection.bg_fill);
        for subject_view in subject_views.iter_mut() {
            for mark in &subject_view.subject.state().marks {
                let color = if mark.bad { BAD } else { Color32::from_gray(190) };
                painter.vline(place(mark.time), rect.y_range(), Stroke::new(1.5, color));
            }
        }
        painter.circle_filled(Pos2::new(place(now), rect.center().y), 7.0, Color32::WHITE);
        let Some(at) = response.hover_pos().or(response.interact_pointer_pos()) else { return };
        let share = f64::from(((at.x - rect.left()) / rect.width()).clamp(0.0, 1.0));
        let pointed = SimTime::from_secs_f64(share * seconds);
        if (response.dragged() || response.clicked() || response.drag_started()) && state.abilities.seek {
            request_all(subject_views, &Request::Seek(pointed));
        }
        let close = |time: SimTime| (place(time) - at.x).abs() < 5.0;
        let mut text = clock(pointed.as_secs_f64());
        for subject_view in subject_views.iter_mut() {
            for mark in subject_view.subject.state().marks.iter().filter(|mark| close(mark.time)).take(6) {
                text.push_str(&format!("\n{}  {}", clock(mark.time.as_secs_f64()), mark.what));
            }
        }
        response.on_hover_text_at_pointer(text);
    });
}
