//! A row for a value of a component, editable where it is a number.

use egui::{RichText, Ui};
use serde_json::Value;

/// Longer lists are shown by their length only.
const ITEMS_MAX: usize = 16;

/// A row for one value below `path`; returns the edited value, if any.
pub(super) fn show(
    ui: &mut Ui,
    name: &str,
    value: &mut Value,
    path: &str,
    editable: bool,
) -> Option<(String, Value)> {
    match value {
        Value::Object(map) => nested(ui, name, path, |ui| {
            map.iter_mut().fold(None, |changed, (key, value)| {
                show(ui, key, value, &format!("{path}.{key}"), editable).or(changed)
            })
        }),
        Value::Array(items) if items.len() > ITEMS_MAX => {
            leaf(ui, name, |ui| drop(ui.weak(format!("{} items", items.len()))));
            None
        }
        Value::Array(items)
            if !items.is_empty() && items.iter().all(Value::is_number) && items.len() <= 4 =>
        {
            let mut changed = None;
            leaf(ui, name, |ui| {
                for (index, item) in items.iter_mut().enumerate() {
                    if number(ui, item, editable) {
                        changed = Some((format!("{path}.{index}"), item.clone()));
                    }
                }
            });
            changed
        }
        Value::Array(items) => nested(ui, name, path, |ui| {
            items.iter_mut().enumerate().fold(None, |changed, (index, value)| {
                show(ui, &index.to_string(), value, &format!("{path}.{index}"), editable).or(changed)
            })
        }),
        leaf_value => {
            let mut changed = false;
            leaf(ui, name, |ui| changed = single(ui, leaf_value, editable));
            changed.then(|| (path.to_owned(), leaf_value.clone()))
        }
    }
}

fn nested<T>(ui: &mut Ui, name: &str, path: &str, rows: impl FnOnce(&mut Ui) -> Option<T>) -> Option<T> {
    egui::CollapsingHeader::new(name).id_salt(path).show(ui, rows).body_returned.flatten()
}

fn leaf(ui: &mut Ui, name: &str, value: impl FnOnce(&mut Ui)) {
    ui.horizontal(|ui| {
        ui.label(name);
        value(ui);
    });
}

/// One value; returns whether it was changed.
pub(super) fn single(ui: &mut Ui, value: &mut Value, editable: bool) -> bool {
    match value {
        Value::Number(_) => number(ui, value, editable),
        Value::Bool(on) => ui.add_enabled(editable, egui::Checkbox::without_text(on)).changed(),
        Value::String(text) => {
            ui.label(RichText::new(text.as_str()).monospace());
            false
        }
        Value::Null => {
            ui.weak("none");
            false
        }
        other => {
            ui.label(RichText::new(other.to_string()).monospace());
            false
        }
    }
}

/// A number that dragging changes in proportion; returns whether it was changed.
fn number(ui: &mut Ui, value: &mut Value, editable: bool) -> bool {
    if let Some(mut whole) = value.as_i64().filter(|_| !value.is_f64()) {
        let changed = ui.add_enabled(editable, egui::DragValue::new(&mut whole)).changed();
        if changed {
            *value = whole.into();
        }
        return changed;
    }
    let Some(mut real) = value.as_f64() else { return false };
    let speed = (real.abs() * 0.005).max(1e-6);
    let shown = egui::DragValue::new(&mut real).speed(speed).custom_formatter(|value, _| readable(value));
    let changed = ui.add_enabled(editable, shown).changed();
    if changed && real.is_finite() {
        *value = real.into();
        return true;
    }
    false
}

/// Five digits, without trailing zeros.
pub(super) fn readable(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let size = value.abs().log10().floor();
    if !(-4.0..6.0).contains(&size) {
        return format!("{value:.3e}");
    }
    let text = format!("{value:.*}", (4.0 - size).max(0.0) as usize);
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

#[cfg(test)]
mod tests {
    use super::readable;

    #[test]
    fn numbers_are_as_long_as_they_say_something() {
        let texts = [0.0, 1.0, -0.25, 800.0, 1234.567, 0.012345678, 1.2e-7, 3.4e9].map(readable);
        assert_eq!(texts, ["0", "1", "-0.25", "800", "1234.6", "0.012346", "1.200e-7", "3.400e9"]);
    }
}
