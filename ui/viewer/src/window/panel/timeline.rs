//! The timeline of a recording.

use egui::{Color32, Pos2, Rect, Sense, Stroke, Ui, Vec2};
use trocar_scene::SimTime;

use super::super::keys::Action;
use super::super::subject::{Ask, Course};
use super::super::view_state::Sight;
use super::{BAD, Wishes, ask_all, clock, toggle_course};

/// A seek bar from the beginning to the end, with marks at events.
pub(super) fn show(ui: &mut Ui, sights: &mut [Sight], wishes: &mut Wishes) {
    let Some(first) = sights.first_mut() else { return };
    let standing = first.subject.standing();
    let now = first.subject.now();
    let length =
        sights.iter_mut().filter_map(|sight| sight.subject.standing().length).max().unwrap_or_default();
    ui.horizontal(|ui| {
        let text = if standing.course == Course::Running { "⏸" } else { "▶" };
        if ui.button(text).on_hover_text("Space").clicked() {
            toggle_course(sights);
        }
        if ui.button("⏮").on_hover_text("Backspace").clicked() {
            ask_all(sights, &Ask::Reset);
        }
        let mut looped = standing.looped;
        if ui.toggle_value(&mut looped, "🔁").on_hover_text("L: begin anew at the end").changed() {
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
        for sight in sights.iter_mut() {
            for mark in &sight.subject.standing().marks {
                let color = if mark.bad { BAD } else { Color32::from_gray(190) };
                painter.vline(place(mark.time), rect.y_range(), Stroke::new(1.5, color));
            }
        }
        painter.circle_filled(Pos2::new(place(now), rect.center().y), 7.0, Color32::WHITE);
        let Some(at) = response.hover_pos().or(response.interact_pointer_pos()) else { return };
        let share = f64::from(((at.x - rect.left()) / rect.width()).clamp(0.0, 1.0));
        let pointed = SimTime::from_secs_f64(share * seconds);
        if (response.dragged() || response.clicked() || response.drag_started()) && standing.abilities.seek {
            ask_all(sights, &Ask::Seek(pointed));
        }
        let close = |time: SimTime| (place(time) - at.x).abs() < 5.0;
        let mut text = clock(pointed.as_secs_f64());
        for sight in sights.iter_mut() {
            for mark in sight.subject.standing().marks.iter().filter(|mark| close(mark.time)).take(6) {
                text.push_str(&format!("\n{}  {}", clock(mark.time.as_secs_f64()), mark.what));
            }
        }
        response.on_hover_text_at_pointer(text);
    });
}
