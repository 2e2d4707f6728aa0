//! The list of keys.

use egui::{Context, RichText, Ui};

use super::super::keys::{KEYS, MOUSE, name};

/// Shows the list over the scene; `open` becomes false when the user closes it.
pub(super) fn show(ctx: &Context, open: &mut bool, player: &[(String, String)]) {
    egui::Window::new("keys").open(open).anchor(egui::Align2::CENTER_CENTER, [0.0, 0.0]).show(ctx, |ui| {
        egui::ScrollArea::vertical().max_height(520.0).show(ui, |ui| {
            // Whoever plays looks for these first.
            if !player.is_empty() {
                ui.strong("with the instruments in hand");
                table(ui, "player", player.iter().map(|(key, about)| (key.clone(), about.as_str())));
                ui.label(RichText::new("F-keys and Ctrl+… stay the window's").weak());
                ui.separator();
                ui.strong("of the window");
            }
            let keys = KEYS.iter().map(|(chord, _, about)| (name(chord), *about));
            table(ui, "keys", keys);
            ui.separator();
            table(ui, "mouse", MOUSE.iter().map(|(what, about)| ((*what).to_owned(), *about)));
        });
    });
}

fn table<'a>(ui: &mut Ui, id: &str, rows: impl Iterator<Item = (String, &'a str)>) {
    egui::Grid::new(id).num_columns(2).striped(true).show(ui, |ui| {
        for (key, about) in rows {
            ui.label(RichText::new(key).monospace().strong());
            ui.label(about);
            ui.end_row();
        }
    });
}
