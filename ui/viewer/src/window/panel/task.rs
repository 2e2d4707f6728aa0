//! The exercise and the patient in numbers.

use egui::{RichText, Ui};
use trocar_scene::{Snapshot, TaskState, VitalSigns};

use super::{BAD, GOOD, clock};

/// Phase, progress, time, score, errors; vital signs if there is a patient with some.
pub(super) fn show(ui: &mut Ui, scene: &Snapshot) {
    if let Some((_, task)) = scene.iter::<TaskState>().next() {
        ui.separator();
        ui.horizontal(|ui| {
            ui.strong(&task.task);
            ui.label(RichText::new(clock(task.seconds)).monospace());
        });
        if task.steps > 0 {
            let share = task.done as f32 / task.steps as f32;
            ui.add(egui::ProgressBar::new(share).text(format!("{} of {}", task.done, task.steps)));
        }
        if task.over {
            let (text, color) = if task.completed { ("completed", GOOD) } else { ("not completed", BAD) };
            ui.label(RichText::new(text).color(color));
        } else {
            ui.label(&task.phase);
        }
        if let Some(score) = task.score {
            ui.label(format!("score {score:.1} / 100")).on_hover_text(task.score_kind().words());
        }
        if !task.errors.is_empty() {
            let title = format!("{} errors", task.errors.len());
            egui::CollapsingHeader::new(RichText::new(title).color(BAD)).show(ui, |ui| {
                for error in task.errors.iter().rev().take(50) {
                    // A sentence names quantities by their own names.
                    let is_sentence = error.kind.contains(' ');
                    let kind = if is_sentence { error.kind.clone() } else { error.kind.replace('_', " ") };
                    ui.label(format!("{}  {kind}", clock(error.at_secs)));
                }
            });
        }
    }
    for (_, signs) in scene.iter::<VitalSigns>() {
        ui.separator();
        egui::Grid::new("vital signs").show(ui, |ui| {
            let mut row = |name: &str, value: String| {
                ui.label(name);
                ui.label(RichText::new(value).monospace());
                ui.end_row();
            };
            row("heart rate", format!("{:.0} /min", signs.heart_rate));
            row("arterial pressure", format!("{:.0} mmHg", signs.arterial_pressure / 133.322));
            row("oxygen saturation", format!("{:.0} %", signs.oxygen_saturation * 100.0));
            row("blood lost", format!("{:.0} ml", signs.blood_loss * 1e6));
        });
    }
}
