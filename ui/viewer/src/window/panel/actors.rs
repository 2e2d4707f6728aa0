//! The supervisor tree: each actor's rate and health, and its supervisor's strategy.

use egui::{RichText, Ui};

use super::super::subject::Actor;
use super::super::view_state::SubjectView;
use super::{BAD, GOOD, POOR};

const HEAD: [&str; 10] = [
    "actor",
    "health",
    "target Hz",
    "achieved Hz",
    "in time",
    "late p50 µs",
    "p99",
    "step p50 µs",
    "p99",
    "missed · restarts",
];

/// One table per subject.
pub(super) fn show(ui: &mut Ui, subject_views: &mut [SubjectView]) {
    egui::ScrollArea::both().auto_shrink(false).show(ui, |ui| {
        for (index, subject_view) in subject_views.iter_mut().enumerate() {
            let state = subject_view.subject.state();
            if state.actors.is_empty() {
                ui.label(format!("{}: nobody acts", subject_view.subject.title()));
                continue;
            }
            egui::Grid::new(("actors", index)).striped(true).show(ui, |ui| {
                for head in HEAD {
                    ui.label(RichText::new(head).weak());
                }
                ui.end_row();
                state.actors.iter().for_each(|actor| row(ui, actor));
            });
        }
    });
}

fn row(ui: &mut Ui, actor: &Actor) {
    ui.horizontal(|ui| {
        ui.add_space(14.0 * actor.depth as f32);
        match &actor.supervises {
            Some(how) => {
                ui.strong(&actor.name);
                ui.label(RichText::new(how).weak());
            }
            None => drop(ui.label(&actor.name)),
        }
    });
    let color = match actor.health.as_str() {
        "healthy" => GOOD,
        "starting" | "late" | "restarting" => POOR,
        _ => BAD,
    };
    ui.label(RichText::new(&actor.health).color(color));
    let number = |value: f64| RichText::new(short(value)).monospace();
    match actor.hz {
        Some([target, achieved]) => {
            ui.label(number(target));
            let kept = if achieved < 0.95 * target { POOR } else { GOOD };
            ui.label(number(achieved).color(kept));
            ui.label(RichText::new(format!("{:.2} %", actor.on_time * 100.0)).monospace());
            for value in actor.late_us.iter().chain(&actor.step_us) {
                ui.label(number(*value));
            }
        }
        None => (0..7).for_each(|_| drop(ui.label(""))),
    }
    if actor.supervises.is_some() {
        ui.end_row();
        return;
    }
    let text = RichText::new(format!("{} · {}", actor.missed, actor.restarts)).monospace();
    ui.label(if actor.restarts > 0 { text.color(POOR) } else { text });
    ui.end_row();
}

/// Three significant digits.
fn short(value: f64) -> String {
    match value.abs() {
        v if v >= 100.0 || v == 0.0 => format!("{value:.0}"),
        v if v >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}
