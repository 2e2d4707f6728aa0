//! The tuning panel: values changed while the session runs, compared as sets, and saved to the scenario.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use egui::{RichText, Ui};
use serde_json::Value;
use trocar_scene::{Name, Snapshot};

use super::super::subject::{Request, Tune};
use super::super::view_state::SubjectView;
use super::value;

/// Most search results.
const FOUND_MAX: usize = 60;
/// Interval at which the results' values are refreshed.
const READ_EVERY: Duration = Duration::from_millis(500);
/// Width of text fields, so that they do not widen the panel \[points\].
pub(super) const FIELD: f32 = 230.0;
/// Longer lists (of vertices) are not offered.
const ITEMS_MAX: usize = 16;

/// The search for fields, the changed fields, and the sets.
#[derive(Default)]
pub(in super::super) struct TuningPanel {
    find: String,
    found: Vec<(String, Value)>,
    read: Option<(String, Instant)>,
    keep_as: String,
    save_to: String,
}

impl TuningPanel {
    pub(super) fn show(&mut self, ui: &mut Ui, subject_view: &mut SubjectView) {
        let state = subject_view.subject.state();
        if !state.abilities.tune {
            return;
        }
        ui.strong("tune");
        ui.horizontal(|ui| {
            ui.label("find");
            let hint = "stiffness, ring.1 mass, …";
            ui.add(egui::TextEdit::singleline(&mut self.find).hint_text(hint).desired_width(FIELD));
        });
        let mut requested: Option<Tune> = None;
        if !self.find.trim().is_empty() {
            self.search(&subject_view.scene);
            egui::ScrollArea::vertical().id_salt("found").max_height(180.0).auto_shrink([false, true]).show(
                ui,
                |ui| {
                    for (field, found) in &mut self.found {
                        ui.horizontal(|ui| {
                            if value::single(ui, found, true) {
                                requested = Some(Tune::Set(vec![(field.clone(), found.clone())]));
                            }
                            ui.add(egui::Label::new(field.as_str()).truncate()).on_hover_text(field.as_str());
                        });
                    }
                },
            );
        }
        if !state.tuning.changed.is_empty() {
            ui.label(RichText::new("not as in the scenario:").weak());
            for (field, before, after) in state.tuning.changed.iter().take(FOUND_MAX) {
                let text = |value: &Value| value.as_f64().map_or(value.to_string(), value::readable);
                ui.label(format!("{field}  {} → {}", text(before), text(after)));
            }
        }
        ui.horizontal_wrapped(|ui| {
            let sets = state.tuning.sets.iter().map(String::as_str).filter(|set| *set != "base");
            for set in std::iter::once("base").chain(sets) {
                let used = state.tuning.in_use.as_deref() == Some(set);
                if ui.selectable_label(used, set).clicked() {
                    requested = Some(Tune::Use(set.to_owned()));
                }
            }
        });
        ui.horizontal(|ui| {
            ui.add(egui::TextEdit::singleline(&mut self.keep_as).hint_text("A").desired_width(60.0));
            if ui.button("keep as a set").clicked() {
                let name = if self.keep_as.is_empty() { "A" } else { self.keep_as.as_str() };
                requested = Some(Tune::Keep(name.to_owned()));
            }
        });
        ui.horizontal(|ui| {
            let hint = "the scenario's own file";
            ui.add(egui::TextEdit::singleline(&mut self.save_to).hint_text(hint).desired_width(140.0));
            if ui.button("save").clicked() {
                let file = (!self.save_to.is_empty()).then(|| PathBuf::from(&self.save_to));
                requested = Some(Tune::Save(file));
            }
        });
        if let Some(tune) = requested {
            subject_view.subject.request(Request::Tune(tune));
        }
    }

    /// Fields whose names contain every word.
    fn search(&mut self, scene: &Snapshot) {
        let fresh = |(text, since): &(String, Instant)| *text == self.find && since.elapsed() < READ_EVERY;
        if self.read.as_ref().is_some_and(fresh) {
            return;
        }
        self.read = Some((self.find.clone(), Instant::now()));
        self.found = fields(scene, &self.find);
    }
}

/// Numbers and switches of named entities whose paths contain every word of `find`.
fn fields(scene: &Snapshot, find: &str) -> Vec<(String, Value)> {
    let words: Vec<String> = find.split_whitespace().map(str::to_lowercase).collect();
    let mut found = Vec::new();
    for (entity, name) in scene.iter::<Name>() {
        collect(&name.0, scene.entity_json(entity), &words, &mut found);
        if found.len() >= FOUND_MAX {
            break;
        }
    }
    found
}

fn collect(path: &str, value: Value, words: &[String], found: &mut Vec<(String, Value)>) {
    match value {
        Value::Object(map) => {
            map.into_iter().for_each(|(key, value)| collect(&format!("{path}.{key}"), value, words, found));
        }
        Value::Array(items) if items.len() <= ITEMS_MAX => {
            let numbered = items.into_iter().enumerate();
            numbered.for_each(|(index, value)| collect(&format!("{path}.{index}"), value, words, found));
        }
        Value::Number(_) | Value::Bool(_) if found.len() < FOUND_MAX => {
            let lower = path.to_lowercase();
            if words.iter().all(|word| lower.contains(word.as_str())) {
                found.push((path.to_owned(), value));
            }
        }
        _ => {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_word_must_occur_and_long_lists_are_left_out() {
        let row = serde_json::json!({
            "rigid_body": { "mass": 0.005, "name": "x", "list": vec![0.0; 17] },
            "pose": { "translation": [1.0, 2.0, 3.0] },
        });
        let find = |words: &[&str]| {
            let words: Vec<String> = words.iter().map(|word| (*word).to_owned()).collect();
            let mut found = Vec::new();
            collect("ring.1", row.clone(), &words, &mut found);
            found.into_iter().map(|(path, _)| path).collect::<Vec<_>>()
        };
        assert_eq!(find(&["mass", "ring"]), ["ring.1.rigid_body.mass"]);
        assert_eq!(find(&["translation"]).len(), 3);
        assert!(find(&["list"]).is_empty() && find(&["ring", "nothing"]).is_empty());
    }
}
