//! The inspector: the entities of the scene, and the components of the selected one.

use std::time::{Duration, Instant};

use egui::Ui;
use serde_json::Value;
use trocar_scene::Entity;

use super::super::subject::{Request, Tune};
use super::super::view_state::SubjectView;
use super::tune::FIELD;
use super::value;

/// Interval at which values are refreshed: fast enough for a reader, and a mesh has many.
const READ_EVERY: Duration = Duration::from_millis(250);
/// Most entities in the list.
const LISTED_MAX: usize = 500;

/// The list of entities with the components of the selected one.
#[derive(Default)]
pub(in super::super) struct Inspector {
    filter: String,
    read: Option<(Entity, Instant, Value)>,
}

impl Inspector {
    pub(super) fn show(&mut self, ui: &mut Ui, subject_view: &mut SubjectView) {
        ui.strong("inspect");
        ui.horizontal(|ui| {
            ui.label("find");
            ui.add(egui::TextEdit::singleline(&mut self.filter).desired_width(FIELD));
        });
        let wanted = self.filter.to_lowercase();
        egui::ScrollArea::vertical().id_salt("entities").max_height(140.0).auto_shrink([false, true]).show(
            ui,
            |ui| {
                let scene = subject_view.scene.clone();
                let named = scene.entities().map(|entity| (entity, scene.name(entity)));
                let found = named.filter(|(_, name)| name.to_lowercase().contains(&wanted));
                for (entity, name) in found.take(LISTED_MAX) {
                    ui.selectable_value(&mut subject_view.selected, Some(entity), name);
                }
            },
        );
        let Some(entity) = subject_view.selected else {
            self.read = None;
            ui.weak("double click something in the scene");
            return;
        };
        self.refresh(entity, subject_view);
        let Some((_, _, Value::Object(components))) = &mut self.read else { return };
        let name = subject_view.scene.name(entity);
        ui.horizontal(|ui| {
            ui.heading(&name);
            if ui.small_button("×").clicked() {
                subject_view.selected = None;
            }
        });
        let editable = subject_view.subject.state().abilities.tune;
        egui::ScrollArea::vertical().id_salt("components").auto_shrink(false).show(ui, |ui| {
            for (component, row) in components {
                let path = format!("{name}.{component}");
                if let Some((field, value)) = value::show(ui, component, row, &path, editable) {
                    subject_view.subject.request(Request::Tune(Tune::Set(vec![(field, value)])));
                }
            }
        });
    }

    fn refresh(&mut self, entity: Entity, subject_view: &SubjectView) {
        let fresh = |(of, since, _): &(Entity, Instant, Value)| *of == entity && since.elapsed() < READ_EVERY;
        if !self.read.as_ref().is_some_and(fresh) {
            self.read = Some((entity, Instant::now(), subject_view.scene.entity_json(entity)));
        }
    }
}
