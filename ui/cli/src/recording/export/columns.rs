//! Columns of a table: their names and types, found from the values.

use std::collections::BTreeMap;

use serde_json::Value;

/// What the cells of a column are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// No cell has a value.
    Nothing,
    /// Yes or no.
    Boolean,
    /// Whole numbers that take 64 bits with a sign.
    Whole,
    /// Other numbers.
    Number,
    /// Text, or JSON text of anything.
    Text,
}

impl Kind {
    fn of(value: &Value) -> Self {
        match value {
            Value::Null => Self::Nothing,
            Value::Bool(_) => Self::Boolean,
            Value::Number(number) if number.is_i64() => Self::Whole,
            Value::Number(number) if number.is_f64() => Self::Number,
            // Larger whole numbers would lose their last digits as numbers.
            Value::Number(_) | Value::String(_) | Value::Array(_) | Value::Object(_) => Self::Text,
        }
    }

    /// The kind that takes both.
    fn with(self, other: Self) -> Self {
        match (self, other) {
            (one, other) if one == other => one,
            (Self::Nothing, kind) | (kind, Self::Nothing) => kind,
            (Self::Whole, Self::Number) | (Self::Number, Self::Whole) => Self::Number,
            _ => Self::Text,
        }
    }
}

/// A cell.
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Cell {
    /// Nothing.
    #[default]
    Empty,
    /// Yes or no.
    Boolean(bool),
    /// A whole number.
    Whole(i64),
    /// A number.
    Number(f64),
    /// Text.
    Text(String),
}

impl Cell {
    /// A value in a column of that kind.
    pub fn new(value: &Value, kind: Kind) -> Self {
        match (kind, value) {
            (_, Value::Null) | (Kind::Nothing, _) => Self::Empty,
            (Kind::Boolean, value) => value.as_bool().map_or(Self::Empty, Self::Boolean),
            (Kind::Whole, value) => value.as_i64().map_or(Self::Empty, Self::Whole),
            (Kind::Number, value) => value.as_f64().map_or(Self::Empty, Self::Number),
            (Kind::Text, Value::String(text)) => Self::Text(text.clone()),
            (Kind::Text, value) => Self::Text(value.to_string()),
        }
    }
}

/// Columns in the order in which they were found.
#[derive(Clone, Debug, Default)]
pub struct Columns {
    columns: Vec<(String, Kind)>,
    places: BTreeMap<String, usize>,
}

impl Columns {
    /// Adds a column, or widens its kind.
    pub fn note(&mut self, name: &str, value: &Value) {
        self.widen(name, Kind::of(value));
    }

    /// The same without a value.
    pub fn widen(&mut self, name: &str, kind: Kind) {
        if let Some(place) = self.places.get(name) {
            let known = &mut self.columns[*place].1;
            *known = known.with(kind);
        } else {
            self.places.insert(name.to_owned(), self.columns.len());
            self.columns.push((name.to_owned(), kind));
        }
    }

    /// The place and the kind of a column.
    pub fn find(&self, name: &str) -> Option<(usize, Kind)> {
        let place = *self.places.get(name)?;
        Some((place, self.columns[place].1))
    }

    /// Names and kinds in order.
    pub fn list(&self) -> &[(String, Kind)] {
        &self.columns
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn a_column_takes_every_value_that_it_was_found_from() {
        let mut columns = Columns::default();
        for value in [json!(null), json!(3), json!(2.5)] {
            columns.note("number", &value);
        }
        for value in [json!(true), json!("x"), json!([1, 2])] {
            columns.note("mixed", &value);
        }
        columns.note("large", &json!(u64::MAX));
        columns.note("never", &json!(null));
        let kinds: Vec<Kind> = columns.list().iter().map(|(_, kind)| *kind).collect();
        assert_eq!(kinds, [Kind::Number, Kind::Text, Kind::Text, Kind::Nothing]);
        assert_eq!(Cell::new(&json!(3), Kind::Number), Cell::Number(3.0));
        assert_eq!(Cell::new(&json!([1, 2]), Kind::Text), Cell::Text("[1,2]".into()));
        assert_eq!(Cell::new(&json!("x"), Kind::Text), Cell::Text("x".into()));
        assert_eq!(Cell::new(&json!(u64::MAX), Kind::Text), Cell::Text(u64::MAX.to_string()));
        assert_eq!(Cell::new(&json!(null), Kind::Whole), Cell::Empty);
        assert_eq!(columns.find("mixed"), Some((1, Kind::Text)));
    }
}
