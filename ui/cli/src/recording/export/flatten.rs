//! From a value to the cells of a row: fields by their dotted names, parts of lists by their numbers.

use std::collections::BTreeMap;

use serde_json::Value;

/// Longer lists of numbers, or of points, get a row for each of their entries.
pub const LONG: usize = 64;
/// Columns that every table may have: a field of that name gets another one.
const RESERVED: [&str; 3] = [TIME, ENTITY, INDEX];
/// The first columns of every table.
pub const TIME: &str = "time_secs";
pub const ENTITY: &str = "entity";
/// The number of an entry of a long list.
pub const INDEX: &str = "index";
/// Longer lists of anything else become one cell, with JSON text.
const VARIED: usize = 8;

/// What the lists of a component are like, by their names.
#[derive(Debug, Default)]
pub struct Lists {
    /// The longest of each, and whether all of its entries are numbers, or short lists of numbers.
    seen: BTreeMap<String, (usize, bool)>,
}

impl Lists {
    /// Notes all lists of a value.
    pub fn note(&mut self, value: &Value) {
        self.note_at(&mut String::new(), value);
    }

    fn note_at(&mut self, name: &mut String, value: &Value) {
        match value {
            Value::Object(fields) => {
                for (field, value) in fields {
                    below(name, field, |name| self.note_at(name, value));
                }
            }
            Value::Array(entries) => {
                let even = entries.iter().all(is_numeric);
                match self.seen.get_mut(name.as_str()) {
                    Some((longest, all_even)) => {
                        *longest = (*longest).max(entries.len());
                        *all_even &= even;
                    }
                    None => drop(self.seen.insert(name.clone(), (entries.len(), even))),
                }
                // Lists within a list that is one cell, or rows, do not matter.
                if !self.is_text(name) && !self.is_long(name) {
                    for (index, value) in entries.iter().enumerate() {
                        below(name, &index.to_string(), |name| self.note_at(name, value));
                    }
                }
            }
            _ => {}
        }
    }

    /// Whether the list gets rows.
    pub fn is_long(&self, name: &str) -> bool {
        self.seen.get(name).is_some_and(|(longest, even)| *even && *longest > LONG)
    }

    /// Whether there is a list that gets rows.
    pub fn any_long(&self) -> bool {
        self.seen.keys().any(|name| self.is_long(name))
    }

    /// Whether the list is one cell.
    pub fn is_text(&self, name: &str) -> bool {
        self.seen.get(name).is_some_and(|(longest, even)| !even && *longest > VARIED)
    }

    /// Visits the cells of a value by their names. Of lists that get rows, `long` is visited instead, with all entries.
    pub fn cells<'a>(
        &self,
        value: &'a Value,
        cell: &mut dyn FnMut(&str, &'a Value),
        long: &mut dyn FnMut(&str, &'a [Value]),
    ) {
        self.cells_at(&mut String::new(), value, cell, long);
    }

    fn cells_at<'a>(
        &self,
        name: &mut String,
        value: &'a Value,
        cell: &mut dyn FnMut(&str, &'a Value),
        long: &mut dyn FnMut(&str, &'a [Value]),
    ) {
        match value {
            Value::Object(fields) => {
                for (field, value) in fields {
                    below(name, field, |name| self.cells_at(name, value, cell, long));
                }
            }
            Value::Array(entries) if self.is_long(name) => long(name, entries),
            Value::Array(entries) if !self.is_text(name) => {
                for (index, value) in entries.iter().enumerate() {
                    below(name, &index.to_string(), |name| self.cells_at(name, value, cell, long));
                }
            }
            // A component that is one value has no name of a field.
            _ if name.is_empty() => cell("value", value),
            _ if RESERVED.contains(&name.as_str()) => cell(&format!("value.{name}"), value),
            _ => cell(name, value),
        }
    }
}

/// Visits the cells of an entry of a long list: itself, or its parts.
pub fn entry_cells<'a>(name: &str, entry: &'a Value, cell: &mut dyn FnMut(&str, &'a Value)) {
    let name = if name.is_empty() { "value" } else { name };
    match entry {
        Value::Array(parts) => {
            parts.iter().enumerate().for_each(|(index, part)| cell(&format!("{name}.{index}"), part));
        }
        _ => cell(name, entry),
    }
}

fn is_numeric(value: &Value) -> bool {
    match value {
        Value::Number(_) => true,
        Value::Array(parts) => parts.len() <= VARIED && parts.iter().all(Value::is_number),
        _ => false,
    }
}

/// Calls `with` with the name of a field below that of its parent.
fn below(name: &mut String, field: &str, with: impl FnOnce(&mut String)) {
    let length = name.len();
    if !name.is_empty() {
        name.push('.');
    }
    name.push_str(field);
    with(name);
    name.truncate(length);
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn flat(lists: &Lists, value: &Value) -> (Vec<String>, Vec<String>) {
        let (mut cells, mut long) = (Vec::new(), Vec::new());
        lists.cells(value, &mut |name, value| cells.push(format!("{name}={value}")), &mut |name, entries| {
            long.push(format!("{name}: {}", entries.len()))
        });
        (cells, long)
    }

    #[test]
    fn fields_and_parts_of_lists_have_dotted_names() {
        let value = json!({"a": {"x": 1.5, "list": [1, 2]}, "b": null, "planes": [null, {"n": [0.0, 1.0]}]});
        let mut lists = Lists::default();
        lists.note(&value);
        let (cells, long) = flat(&lists, &value);
        let wanted = [
            "a.list.0=1",
            "a.list.1=2",
            "a.x=1.5",
            "b=null",
            "planes.0=null",
            "planes.1.n.0=0.0",
            "planes.1.n.1=1.0",
        ];
        assert_eq!((cells, long), (wanted.map(str::to_owned).to_vec(), Vec::new()));
        assert_eq!(flat(&lists, &json!("name")).0, ["value=\"name\""]);
        assert_eq!(flat(&lists, &json!({"entity": 1})).0, ["value.entity=1"]);
    }

    #[test]
    fn long_lists_of_points_get_rows_and_long_lists_of_other_things_one_cell() {
        let value = json!({
            "points": vec![[0.5, 1.0, 2.0]; LONG + 1],
            "errors": vec![json!({"kind": "drop"}); VARIED + 1],
            "few": vec![1; LONG],
        });
        let mut lists = Lists::default();
        lists.note(&value);
        let (cells, long) = flat(&lists, &value);
        assert_eq!(long, ["points: 65"]);
        assert_eq!(cells.len(), LONG + 1);
        assert!(cells[0].starts_with("errors=[{\"kind\":\"drop\"},"));
        // A shorter one of the same name is treated alike.
        let short = json!({"points": [[0.5, 1.0, 2.0]], "errors": []});
        assert_eq!(flat(&lists, &short), (vec!["errors=[]".to_owned()], vec!["points: 1".to_owned()]));
        let mut parts = Vec::new();
        entry_cells("points", &short["points"][0], &mut |name, value| parts.push(format!("{name}={value}")));
        assert_eq!(parts, ["points.0=0.5", "points.1=1.0", "points.2=2.0"]);
    }
}
