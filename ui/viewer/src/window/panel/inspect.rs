//! The inspector: the entities of the scene, and the components of the selected one.

use std::time::{Duration, Instant};

use egui::Ui;
use serde_json::Value;
use trocar_scene::Entity;

use super::super::subject::{Ask, Tune};
use super::super::view_state::Sight;
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
    pub(super) fn show(&mut self, ui: &mut Ui, sight: &mut Sight) {
        ui.strong("inspect");
        ui.horizontal(|ui| {
            ui.label("find");
            ui.add(egui::TextEdit::singleline(&mut self.filter).desired_width(FIELD));
        });
        let wanted = self.filter.to_lowercase();
        egui::ScrollArea::vertical().id_salt("entities").max_height(140.0).auto_shrink([false, true]).show(
            ui,
            |ui| {
                let scene = sight.scene.clone();
                let named = scene.entities().map(|entity| (entity, scene.name(entity)));
                let found = named.filter(|(_, name)| name.to_lowercase().contains(&wanted));
                for (entity, name) in found.take(LISTED_MAX) {
                    ui.selectable_value(&mut sight.selected, Some(entity), name);
                }
            },
        );
        let Some(entity) = sight.selected else {
            self.read = None;
            ui.weak("double click something in the scene");
            return;
        };
        self.refresh(entity, sight);
        let Some((_, _, Value::Object(components))) = &mut self.read else { return };
        let name = sight.scene.name(entity);
        ui.horizontal(|ui| {
            ui.heading(&name);
            if ui.small_button("×").clicked() {
                sight.selected = None;
            }
        });
        let editable = sight.subject.standing().abilities.tune;
        egui::ScrollArea::vertical().id_salt("components").auto_shrink(false).show(ui, |ui| {
            for (component, row) in components {
                let path = format!("{name}.{component}");
                if let Some((field, value)) = value::show(ui, component, row, &path, editable) {
                    sight.subject.ask(Ask::Tune(Tune::Set(vec![(field, value)])));
                }
            }
        });
    }

    fn refresh(&mut self, entity: Entity, sight: &Sight) {
        let fresh = |(of, since, _): &(Entity, Instant, Value)| *of == entity && since.elapsed() < READ_EVERY;
        if !self.read.as_ref().is_some_and(fresh) {
            self.read = Some((entity, Instant::now(), sight.scene.entity_json(entity)));
        }
    }
}
