//! Edits values in the text of a scenario in place: comments, order and all other text are preserved.

use serde_json::Value;
use thiserror::Error;
use toml_edit::{Array, DocumentMut, InlineTable, Item};

use super::field::{Field, matches};

/// Why a value cannot be written into a scenario.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum DocumentError {
    /// The text is not valid TOML.
    #[error("the scenario cannot be read: {0}")]
    Syntax(String),
    /// The entity was created at run time.
    #[error("'{0}': the scenario has no such entity")]
    NoEntity(String),
    /// The component was added at run time.
    #[error("'{field}': the scenario gives '{entity}' no '{component}'")]
    NoComponent {
        /// The field.
        field: String,
        /// The entity.
        entity: String,
        /// The component.
        component: &'static str,
    },
    /// No such key.
    #[error("'{text}': {reason}")]
    NoKey {
        /// The text that was asked for.
        text: String,
        /// The valid keys.
        reason: String,
    },
}

/// A scenario's text under edit.
pub struct ScenarioText {
    document: DocumentMut,
}

/// Arrays of tables whose tables have a name.
const NAMED: [&str; 2] = ["controller", "hand"];
/// What a scenario has beside entities, as far as it can be set.
pub(super) const BESIDE_ENTITIES: [&str; 5] = ["gravity", "controller", "hand", "task", "network"];

impl ScenarioText {
    /// Parses a text.
    ///
    /// # Errors
    /// When it is not valid TOML.
    pub fn parse(text: &str) -> Result<Self, DocumentError> {
        let document =
            text.parse::<DocumentMut>().map_err(|error| DocumentError::Syntax(error.message().to_owned()))?;
        Ok(Self { document })
    }

    /// The edited text.
    pub fn text(&self) -> String {
        self.document.to_string()
    }

    /// Writes the value of a field; `row` is the whole component with the new value. A key that the file leaves to its
    /// default is added.
    ///
    /// # Errors
    /// When the scenario does not have the entity or the component.
    pub fn set_field(&mut self, field: &Field, row: &Value) -> Result<(), DocumentError> {
        let entity = self
            .named("entity", &field.entity_name)
            .ok_or_else(|| DocumentError::NoEntity(field.entity_name.clone()))?;
        let component = child(entity, field.component).ok_or_else(|| DocumentError::NoComponent {
            field: field.to_string(),
            entity: field.entity_name.clone(),
            component: field.component,
        })?;
        put(component, &field.path, row)
            .map_err(|reason| DocumentError::NoKey { text: field.to_string(), reason })
    }

    /// Writes a value outside components: `gravity.2`, `controller.engine.rate_hz`, `hand.left.renderer.stiffness`,
    /// `task.weights.cutoff_secs`, `network.reflector.round_trip_secs`. A `*` stands for any letters of a name.
    ///
    /// # Errors
    /// When there is no such key; the error lists the valid ones.
    pub fn set_key(&mut self, text: &str, value: &Value) -> Result<(), DocumentError> {
        let no_key = |reason: String| DocumentError::NoKey { text: text.to_owned(), reason };
        let parts: Vec<String> = text.split('.').map(str::to_owned).collect();
        let (root, path) = parts.split_first().ok_or_else(|| no_key("nothing is named".into()))?;
        match root.as_str() {
            "gravity" => {
                let gravity = self.document.entry("gravity").or_insert_with(|| {
                    Item::Value(toml_edit::Value::Array([0.0, 0.0, -9.81].into_iter().collect::<Array>()))
                });
                put_new(gravity, path, value).map_err(no_key)
            }
            table @ ("task" | "network") => {
                let table = self.document.entry(table).or_insert_with(toml_edit::table);
                put_new(table, path, value).map_err(no_key)
            }
            array if NAMED.contains(&array) => {
                let array = array.to_owned();
                // The longest name wins, as with entities.
                for split in (1..path.len()).rev() {
                    let pattern = path[..split].join(".");
                    let names: Vec<String> =
                        self.names(&array).into_iter().filter(|name| matches(&pattern, name)).collect();
                    for name in &names {
                        if let Some(table) = self.named(&array, name) {
                            put_new(table, &path[split..], value).map_err(no_key)?;
                        }
                    }
                    if !names.is_empty() {
                        return Ok(());
                    }
                }
                let known = self.names(&array).join(", ");
                Err(no_key(format!("{array}.NAME.KEY is expected; there are: {known}")))
            }
            _ => Err(no_key(format!(
                "no entity is called like that, and beside entities there are: {}",
                BESIDE_ENTITIES.join(", ")
            ))),
        }
    }

    /// Names of the tables in an array of tables.
    fn names(&self, array: &str) -> Vec<String> {
        let items = self.document.get(array);
        let name = |index: usize| Some(items?.get(index)?.get("name")?.as_str()?.to_owned());
        (0..).map_while(name).collect()
    }

    /// The table of that name in an array of tables.
    fn named(&mut self, array: &str, name: &str) -> Option<&mut Item> {
        let index = self.names(array).iter().position(|known| known == name)?;
        self.document.get_mut(array)?.get_mut(index)
    }
}

/// Writes the leaf of `row` at `path` into `item`, which holds the keys of the same component that the file states.
fn put(item: &mut Item, path: &[String], row: &Value) -> Result<(), String> {
    let Some((step, rest)) = path.split_first() else { return replace(item, row) };
    let below = match row {
        Value::Object(map) => map.get(step.as_str()),
        Value::Array(items) => step.parse::<usize>().ok().and_then(|index| items.get(index)),
        _ => None,
    };
    let below = below.ok_or_else(|| format!("there is no '{step}'"))?;
    if let Some(child) = child(item, step) {
        return put(child, rest, below);
    }
    insert(item, step, to_toml(below)?)
}

/// Writes a value below `item`; missing tables are created.
fn put_new(item: &mut Item, path: &[String], value: &Value) -> Result<(), String> {
    let Some((step, rest)) = path.split_first() else { return replace(item, value) };
    if child(item, step).is_none() {
        let new =
            if rest.is_empty() { to_toml(value)? } else { toml_edit::Value::InlineTable(InlineTable::new()) };
        insert(item, step, new)?;
    }
    match child(item, step) {
        Some(below) => put_new(below, rest, value),
        None => Err(format!("there is no '{step}'")),
    }
}

/// The child of an item, without creating it.
fn child<'a>(item: &'a mut Item, step: &str) -> Option<&'a mut Item> {
    if item.is_array() {
        return item.get_mut(step.parse::<usize>().ok()?);
    }
    item.get(step).filter(|below| !below.is_none())?;
    item.get_mut(step)
}

/// Adds a key to a table.
fn insert(item: &mut Item, step: &str, mut value: toml_edit::Value) -> Result<(), String> {
    if step.is_empty() {
        return Err("a key is missing".to_owned());
    }
    match item {
        Item::Table(table) => {
            table.insert(step, Item::Value(value));
        }
        Item::Value(toml_edit::Value::InlineTable(table)) => {
            // The space before the closing brace belongs to the last value.
            if let Some((_, last)) = table.iter_mut().last() {
                let end = last.decor().suffix().cloned().unwrap_or_default();
                last.decor_mut().set_suffix("");
                value.decor_mut().set_prefix(" ");
                value.decor_mut().set_suffix(end);
            }
            table.insert(step, value);
        }
        _ => return Err(format!("there is no '{step}'")),
    }
    Ok(())
}

/// Replaces a value, keeping the spaces and the comment around it.
fn replace(item: &mut Item, value: &Value) -> Result<(), String> {
    let Item::Value(old) = item else { return Err("it is a table, not a single value".to_owned()) };
    let mut new = to_toml(value)?;
    if let (toml_edit::Value::Float(_), toml_edit::Value::Integer(whole)) = (&*old, &new) {
        new = (*whole.value() as f64).into();
    }
    *new.decor_mut() = old.decor().clone();
    *old = new;
    Ok(())
}

fn to_toml(value: &Value) -> Result<toml_edit::Value, String> {
    Ok(match value {
        Value::Null => return Err("a scenario has no way to say that something is absent".to_owned()),
        Value::Bool(flag) => (*flag).into(),
        Value::Number(number) => match (number.as_i64(), number.as_f64()) {
            (Some(whole), _) => whole.into(),
            (None, Some(float)) if float.is_finite() => float.into(),
            _ => return Err(format!("{number} is out of range")),
        },
        Value::String(text) => text.as_str().into(),
        Value::Array(items) => items.iter().map(to_toml).collect::<Result<Array, _>>()?.into(),
        Value::Object(map) => {
            let mut table = InlineTable::new();
            // Null values are left out.
            for (key, value) in map.iter().filter(|(_, value)| !value.is_null()) {
                table.insert(key, to_toml(value)?);
            }
            table.into()
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use proptest::sample::select;
    use serde_json::json;
    use trocar_scene::Entity;

    const TEXT: &str = "\
# A ring.
schema = 1
name = \"a\"

[[entity]]
name = \"ring\"          # the only one
rigid_body = { motion = \"dynamic\", mass = 0.005 }  # 5 g
[entity.pose]
translation = [0.0, 1.0, 2.0] # here

[[controller]]
name = \"engine.main\"
kind = \"rapier\"
rate_hz = 500
";

    fn field(component: &'static str, path: &str) -> Field {
        let path = path.split('.').filter(|step| !step.is_empty()).map(str::to_owned).collect();
        Field { entity: Entity::new(0, 0, 1), entity_name: "ring".into(), component, path }
    }

    #[test]
    fn values_change_and_everything_else_stays() {
        let mut text = ScenarioText::parse(TEXT).unwrap();
        text.set_field(&field("rigid_body", "mass"), &json!({ "mass": 0.25, "motion": "x" })).unwrap();
        text.set_field(&field("pose", "translation.1"), &json!({ "translation": [9.0, 7.5, 9.0] })).unwrap();
        text.set_field(&field("rigid_body", "friction"), &json!({ "friction": 0.75, "mass": 9.0 })).unwrap();
        text.set_field(&field("pose", "rotation.3"), &json!({ "rotation": [0.0, 0.0, 0.0, 1.0] })).unwrap();
        text.set_key("controller.engine.main.rate_hz", &json!(250)).unwrap();
        text.set_key("controller.engine.*.params.floor_height", &json!(-0.5)).unwrap();
        text.set_key("gravity.2", &json!(-1)).unwrap();
        text.set_key("task.weights.cutoff_secs", &json!(120.5)).unwrap();
        text.set_key("network.reflector.loss", &json!(0.25)).unwrap();
        let expected = TEXT
            .replace("mass = 0.005 }", "mass = 0.25, friction = 0.75 }")
            .replace("[0.0, 1.0, 2.0] # here", "[0.0, 7.5, 2.0] # here\nrotation = [0.0, 0.0, 0.0, 1.0]")
            .replace("rate_hz = 500\n", "rate_hz = 250\nparams = { floor_height = -0.5 }\n");
        let changed = text.text();
        for line in expected.lines() {
            assert!(changed.contains(line), "'{line}' is missing in\n{changed}");
        }
        let value: toml::Value = toml::from_str(&changed).unwrap();
        assert_eq!(value["gravity"][2].as_float(), Some(-1.0));
        assert_eq!(value["task"]["weights"]["cutoff_secs"].as_float(), Some(120.5));
        assert_eq!(value["network"]["reflector"]["loss"].as_float(), Some(0.25));
    }

    #[test]
    fn what_the_scenario_does_not_have_is_named() {
        let mut text = ScenarioText::parse(TEXT).unwrap();
        let before = text.text();
        let stranger = Field { entity_name: "cube".into(), ..field("pose", "translation.0") };
        assert!(text.set_field(&stranger, &json!({})).unwrap_err().to_string().contains("'cube'"));
        let gone = text.set_field(&field("port", "x"), &json!({ "x": 1 })).unwrap_err();
        assert!(gone.to_string().contains("gives 'ring' no 'port'"));
        for (key, says) in [
            ("controller.x.rate_hz", "there are: engine.main"),
            ("hand.left.device", "there are: "),
            ("entity.ring.mass", "gravity, controller, hand, task, network"),
            ("gravity.7", "no '7'"),
            ("gravity", "ok"),
        ] {
            match text.set_key(key, &json!(1)) {
                Err(error) => assert!(error.to_string().contains(says), "{error}"),
                // Only the scenario's reader knows whether gravity may be a number.
                Ok(()) => assert_eq!(says, "ok", "{key}"),
            }
        }
        assert!(before.starts_with("# A ring."));
        assert!(ScenarioText::parse("a = [").is_err());
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(1_000) })]

        #[test]
        fn any_key_leaves_a_document(
            root in select(vec!["gravity", "task", "network", "controller.engine.main", "controller.*", "hand", "entity", ""]),
            rest in prop_oneof!["[a-z0-9.*]{0,12}", "\\PC{0,12}"],
            value in select(vec![json!(1), json!(-0.5), json!(true), json!("a \"b\" \n"), json!(null)]),
        ) {
            let mut text = ScenarioText::parse(TEXT).unwrap();
            let _ = text.set_key(&format!("{root}.{rest}"), &value);
            prop_assert!(toml::from_str::<toml::Table>(&text.text()).is_ok(), "{}", text.text());
        }
    }
}
