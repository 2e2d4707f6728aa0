//! Fields by name: `ring.1.rigid_body.mass` is the field `mass` in the component `rigid_body` of the entity
//! `ring.1`.
//!
//! Names of entities contain dots, so a text is resolved against a scene: the longest matching entity name, then one of
//! its components, then keys and indices down to the value. A `*` in the entity's part stands for any letters:
//! `ring.*.rigid_body.mass` is the mass of every ring.

use std::collections::BTreeMap;
use std::fmt;

use serde_json::Value;
use thiserror::Error;
use trocar_scene::{Entity, Name, Snapshot};

/// Longest text that names a field.
pub const PATH_BYTES_MAX: usize = 512;

/// Longer arrays (vertices, temperatures) are listed as one value.
const LISTED_ITEMS_MAX: usize = 16;

/// A place in a component of an entity: a value, or a table or array of values.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Field {
    /// The entity.
    pub entity: Entity,
    /// Its name, or its number if it has none.
    pub entity_name: String,
    /// NAME of the component.
    pub component: &'static str,
    /// Keys and indices below the component; empty for a component that is itself a single value.
    pub path: Vec<String>,
}

impl fmt::Display for Field {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{}", self.entity_name, self.component)?;
        self.path.iter().try_for_each(|step| write!(f, ".{step}"))
    }
}

/// A text that names no field, or a value of the wrong type for it.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum FieldError {
    /// The text is too long.
    #[error("the name of a field has at most {PATH_BYTES_MAX} bytes")]
    TooLong,
    /// No component is named in it, or no entity before it.
    #[error(
        "'{text}': no entity is called like that; ENTITY.COMPONENT.FIELD is expected, and there are: {known}"
    )]
    NoEntity {
        /// The text that was asked for.
        text: String,
        /// Names of entities.
        known: String,
    },
    /// The entity has no such component.
    #[error("'{text}': {entity} has no component '{component}'; it has: {known}")]
    NoComponent {
        /// The text that was asked for.
        text: String,
        /// The entity.
        entity: String,
        /// The text at the component's place.
        component: String,
        /// Components of the entity.
        known: String,
    },
    /// The component has no such field.
    #[error("'{field}': there is no '{step}'; there are: {known}")]
    NoField {
        /// The existing part of the field, and the step that is missing.
        field: String,
        /// The step.
        step: String,
        /// The valid steps.
        known: String,
    },
    /// A table where a value is needed.
    #[error("'{field}' is no single value; below it there are: {known}")]
    NotAValue {
        /// The field.
        field: String,
        /// Keys below it.
        known: String,
    },
    /// A value of another type.
    #[error("'{field}' is {expected}, so '{found}' does not fit")]
    Kind {
        /// The field.
        field: String,
        /// Its type.
        expected: &'static str,
        /// The given value.
        found: String,
    },
}

/// The places in `scene` that `text` names, in the order of entities; never empty.
///
/// # Errors
/// [`FieldError`] with the valid alternatives.
pub fn find(scene: &Snapshot, text: &str) -> Result<Vec<Field>, FieldError> {
    if text.len() > PATH_BYTES_MAX {
        return Err(FieldError::TooLong);
    }
    let parts: Vec<&str> = text.split('.').collect();
    let mut refusal = None;
    // The longest name of an entity wins: entities may be called `hand` and `hand.left`.
    for split in (1..parts.len()).rev() {
        let entities = entities(scene, &parts[..split].join("."));
        let Some((first, _)) = entities.first() else { continue };
        let component = parts[split];
        let Ok(id) = scene.registry().by_name(component) else {
            refusal.get_or_insert_with(|| no_component(scene, text, *first, component));
            continue;
        };
        let path: Vec<String> = parts[split + 1..].iter().map(|step| (*step).to_owned()).collect();
        let name = scene.registry().entry(id).name;
        let mut found = Vec::new();
        for (entity, entity_name) in &entities {
            let Some(row) = scene.erased_column(id).row_json(*entity) else { continue };
            let field = Field {
                entity: *entity,
                entity_name: entity_name.clone(),
                component: name,
                path: path.clone(),
            };
            walk(&field, &row)?;
            found.push(field);
        }
        if !found.is_empty() {
            return Ok(found);
        }
        refusal.get_or_insert_with(|| no_component(scene, text, *first, component));
    }
    Err(refusal.unwrap_or_else(|| {
        let names: Vec<String> = scene.iter::<Name>().map(|(_, name)| name.0.clone()).collect();
        FieldError::NoEntity { text: text.to_owned(), known: shortened(&names) }
    }))
}

/// Every single value below `pattern`: an entity (or several), a component of it, a table in it, or a value.
///
/// # Errors
/// When the pattern names nothing.
pub fn list(scene: &Snapshot, pattern: &str) -> Result<Vec<(Field, Value)>, FieldError> {
    let whole = if pattern.len() <= PATH_BYTES_MAX { entities(scene, pattern) } else { Vec::new() };
    let roots = if whole.is_empty() { find(scene, pattern)? } else { components_of(scene, &whole) };
    let mut leaves = Vec::new();
    for root in roots {
        let value = read(scene, &root)?;
        expand(root, value, &mut leaves);
    }
    Ok(leaves)
}

/// The value at a field.
///
/// # Errors
/// When the entity or the component is gone, or the component now has another shape.
pub fn read(scene: &Snapshot, field: &Field) -> Result<Value, FieldError> {
    walk(field, &row(scene, field)?).cloned()
}

/// The value at a field of a whole component.
///
/// # Errors
/// When the component has another shape.
pub(super) fn read_row(field: &Field, row: &Value) -> Result<Value, FieldError> {
    walk(field, row).cloned()
}

/// The whole component that a field is in.
///
/// # Errors
/// When the entity or the component has gone.
pub fn row(scene: &Snapshot, field: &Field) -> Result<Value, FieldError> {
    let id = scene.registry().by_name(field.component).ok();
    let mut row = id
        .and_then(|id| scene.erased_column(id).row_json(field.entity))
        .ok_or_else(|| no_component(scene, &field.to_string(), field.entity, field.component))?;
    name_entities(scene, &mut row);
    Ok(row)
}

/// Replaces entity numbers by names, since numbers change with the next edit of the scenario.
fn name_entities(scene: &Snapshot, value: &mut Value) {
    match value {
        Value::String(text) => {
            let name = text.parse().ok().and_then(|entity| Some((entity, scene.get::<Name>(entity)?)));
            if let Some((entity, name)) = name
                && scene.find(&name.0) == Some(entity)
            {
                text.clone_from(&name.0);
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| name_entities(scene, item)),
        Value::Object(map) => map.values_mut().for_each(|item| name_entities(scene, item)),
        _ => {}
    }
}

/// The names that [`name_entities`] gives to entities, for [`with_entity_names`](trocar_scene::with_entity_names); if
/// several entities share a name, the first.
pub(super) fn names(scene: &Snapshot) -> BTreeMap<String, Entity> {
    let mut names = BTreeMap::new();
    for (entity, name) in scene.iter::<Name>() {
        names.entry(name.0.clone()).or_insert(entity);
    }
    names
}

/// Replaces the value at the field of a whole component and returns the old one.
///
/// # Errors
/// When its type differs from that of the old value; numbers without a fraction are valid whole numbers.
pub fn write(field: &Field, row: &mut Value, value: &Value) -> Result<Value, FieldError> {
    walk(field, row)?;
    let mut at = row;
    for step in &field.path {
        at = match at {
            Value::Object(map) => &mut map[step.as_str()],
            Value::Array(items) => &mut items[step.parse::<usize>().unwrap_or(0)],
            _ => unreachable!("the walk above has been there"),
        };
    }
    let fitted = fit(field, at, value)?;
    Ok(std::mem::replace(at, fitted))
}

/// Parses a value as a user types it: a number, `true` or `false`, or a word.
pub fn parse_value(text: &str) -> Value {
    let text = text.trim();
    match serde_json::from_str::<Value>(text) {
        Ok(value) if !value.is_object() && !value.is_array() => value,
        _ => match text.parse::<f64>().ok().and_then(serde_json::Number::from_f64) {
            Some(number) => Value::Number(number),
            None => Value::String(text.to_owned()),
        },
    }
}

/// Parses `FIELD=VALUE`.
///
/// # Errors
/// When there is no `=` in it, or one side is empty.
pub fn parse_assignment(text: &str) -> Result<(String, Value), String> {
    match text.split_once('=') {
        Some((field, value)) if !field.trim().is_empty() && !value.trim().is_empty() => {
            Ok((field.trim().to_owned(), parse_value(value)))
        }
        _ => Err("FIELD=VALUE is expected, such as ring.1.rigid_body.mass=0.01".to_owned()),
    }
}

fn fit(field: &Field, old: &Value, new: &Value) -> Result<Value, FieldError> {
    let wrong = |expected| FieldError::Kind {
        field: field.to_string(),
        expected,
        found: new.to_string().chars().take(60).collect(),
    };
    match (old, new) {
        (Value::Number(old), Value::Number(number)) if !old.is_f64() => match number.as_f64() {
            _ if !number.is_f64() => Ok(new.clone()),
            Some(whole) if whole.fract() == 0.0 && whole.abs() < 9e15 => Ok(Value::from(whole as i64)),
            _ => Err(wrong("a whole number")),
        },
        (Value::Number(_), Value::Number(number)) => {
            // A whole number is converted to the field's type, so that it reads back the same.
            number.as_f64().map(Value::from).ok_or_else(|| wrong("a number"))
        }
        (Value::Bool(_), Value::Bool(_)) | (Value::String(_), Value::String(_)) => Ok(new.clone()),
        // The old value is null; only the component knows which types are valid.
        (Value::Null, Value::Number(_) | Value::Bool(_) | Value::String(_)) => Ok(new.clone()),
        (Value::Number(_), _) => Err(wrong("a number")),
        (Value::Bool(_), _) => Err(wrong("true or false")),
        (Value::String(_), _) => Err(wrong("a word")),
        (Value::Null, _) => Err(wrong("a single value")),
        (Value::Object(_) | Value::Array(_), _) => {
            Err(FieldError::NotAValue { field: field.to_string(), known: keys(old) })
        }
    }
}

/// Follows the path of a field into its component.
fn walk<'a>(field: &Field, row: &'a Value) -> Result<&'a Value, FieldError> {
    let mut at = row;
    for step in &field.path {
        let next = match at {
            Value::Object(map) => map.get(step.as_str()),
            Value::Array(items) => step.parse::<usize>().ok().and_then(|index| items.get(index)),
            _ => None,
        };
        at = next.ok_or_else(|| FieldError::NoField {
            field: field.to_string(),
            step: step.clone(),
            known: keys(at),
        })?;
    }
    Ok(at)
}

fn expand(field: Field, value: Value, leaves: &mut Vec<(Field, Value)>) {
    let below = |step: String| {
        let mut field = field.clone();
        field.path.push(step);
        field
    };
    match value {
        Value::Object(map) => {
            map.into_iter().for_each(|(key, value)| expand(below(key), value, leaves));
        }
        Value::Array(items) if items.len() <= LISTED_ITEMS_MAX => {
            items
                .into_iter()
                .enumerate()
                .for_each(|(index, value)| expand(below(index.to_string()), value, leaves));
        }
        Value::Array(_) => {}
        value => leaves.push((field, value)),
    }
}

/// Entities whose name, or number, matches a pattern.
fn entities(scene: &Snapshot, pattern: &str) -> Vec<(Entity, String)> {
    let named = scene.iter::<Name>().filter(|(_, name)| matches(pattern, &name.0));
    let mut found: Vec<(Entity, String)> = named.map(|(entity, name)| (entity, name.0.clone())).collect();
    if found.is_empty()
        && let Ok(entity) = pattern.parse::<Entity>()
        && scene.contains(entity)
    {
        found.push((entity, scene.name(entity)));
    }
    found
}

/// Every component of these entities, entity by entity.
fn components_of(scene: &Snapshot, entities: &[(Entity, String)]) -> Vec<Field> {
    let wanted: BTreeMap<Entity, &String> = entities.iter().map(|(entity, name)| (*entity, name)).collect();
    let mut fields = Vec::new();
    for (id, entry) in scene.registry().iter() {
        scene.erased_column(id).for_each_entity(&mut |entity| {
            if let Some(name) = wanted.get(&entity) {
                let entity_name = (*name).clone();
                fields.push(Field { entity, entity_name, component: entry.name, path: Vec::new() });
            }
        });
    }
    fields.sort();
    fields
}

/// Whether a name matches a pattern in which `*` stands for any letters.
pub(super) fn matches(pattern: &str, name: &str) -> bool {
    let mut pieces = pattern.split('*');
    let Some(mut rest) = pieces.next().and_then(|first| name.strip_prefix(first)) else { return false };
    let pieces: Vec<&str> = pieces.collect();
    let Some((last, middle)) = pieces.split_last() else { return rest.is_empty() };
    for piece in middle {
        match rest.find(piece) {
            Some(at) => rest = &rest[at + piece.len()..],
            None => return false,
        }
    }
    rest.ends_with(last)
}

fn no_component(scene: &Snapshot, text: &str, entity: Entity, component: &str) -> FieldError {
    let known: Vec<&str> =
        components_of(scene, &[(entity, String::new())]).iter().map(|field| field.component).collect();
    FieldError::NoComponent {
        text: text.to_owned(),
        entity: scene.name(entity),
        component: component.to_owned(),
        known: known.join(", "),
    }
}

fn keys(value: &Value) -> String {
    match value {
        Value::Object(map) => map.keys().map(String::as_str).collect::<Vec<_>>().join(", "),
        Value::Array(items) if items.is_empty() => "nothing".to_owned(),
        Value::Array(items) => format!("0 to {}", items.len() - 1),
        _ => "nothing".to_owned(),
    }
}

fn shortened(names: &[String]) -> String {
    let shown = names.iter().take(40).map(String::as_str).collect::<Vec<_>>().join(", ");
    if names.len() > 40 { format!("{shown}, … ({} in all)", names.len()) } else { shown }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::App;
    use proptest::prelude::*;
    use proptest::sample::select;

    fn scene() -> Snapshot {
        let app = App::new();
        app.scenario("peg-transfer").unwrap().spawn(app.registry()).unwrap().snapshot()
    }

    fn refused(text: &str) -> String {
        find(&scene(), text).unwrap_err().to_string()
    }

    #[test]
    fn names_with_dots_components_and_indices_are_told_apart() {
        let scene = scene();
        let fields = find(&scene, "grasper.left.instrument.jaw_friction").unwrap();
        assert_eq!(fields.len(), 1);
        assert_eq!(fields[0].to_string(), "grasper.left.instrument.jaw_friction");
        assert_eq!(read(&scene, &fields[0]).unwrap(), 0.6);
        let nested = &find(&scene, "board.left.shape.peg_board.pegs.1.0").unwrap()[0];
        assert_eq!(read(&scene, nested).unwrap(), 0.0);
        // The entity `hand.left` has a component `hand`.
        assert_eq!(find(&scene, "hand.left.hand.scale").unwrap()[0].entity_name, "hand.left");
        // References are by name.
        let port = find(&scene, "grasper.left.instrument.port").unwrap().remove(0);
        assert_eq!(read(&scene, &port).unwrap(), "port.left");
    }

    #[test]
    fn a_star_names_several_entities() {
        let scene = scene();
        let masses = find(&scene, "ring.*.rigid_body.mass").unwrap();
        assert_eq!(masses.len(), 6);
        let all = list(&scene, "*").unwrap();
        assert!(all.len() > 200 && all.iter().all(|(_, value)| !value.is_object() && !value.is_array()));
        let one = list(&scene, "ring.1.rigid_body").unwrap();
        assert!(
            one.iter().any(|(field, value)| field.to_string() == "ring.1.rigid_body.mass" && *value == 0.005)
        );
        for (pattern, name, hit) in [
            ("ring.*", "ring.1", true),
            ("*.left", "hand.left", true),
            ("r*g.*1", "ring.11", true),
            ("ring.*", "board.left", false),
            ("ring", "ring.1", false),
            ("a*a", "a", false),
            ("**", "", true),
        ] {
            assert_eq!(matches(pattern, name), hit, "{pattern} {name}");
        }
    }

    #[test]
    fn what_is_not_there_is_said_with_what_is() {
        assert!(refused("rang.1.rigid_body.mass").contains("ring.1"));
        assert!(refused("ring.1.rigid_bod.mass").contains("it has: name, pose, rigid_body"));
        assert!(refused("ring.1.port.axial_damping").contains("ring.1 has no component 'port'"));
        assert!(refused("ring.1.rigid_body.mas").contains("there is no 'mas'; there are: angular_damping"));
        assert!(refused("ring.1.pose.translation.3").contains("0 to 2"));
        assert!(refused("ring.1.rigid_body.mass.x").contains("there are: nothing"));
        assert!(refused("").contains("ENTITY.COMPONENT.FIELD"));
        assert_eq!(find(&scene(), &"x".repeat(1000)), Err(FieldError::TooLong));
    }

    #[test]
    fn values_are_of_the_kind_that_they_replace() {
        let scene = scene();
        let set = |text: &str, value: &str| {
            let field = find(&scene, text).unwrap().remove(0);
            let mut row = row(&scene, &field).unwrap();
            write(&field, &mut row, &parse_value(value)).map(|_| walk(&field, &row).unwrap().clone())
        };
        assert_eq!(set("ring.1.rigid_body.mass", "1").unwrap(), Value::from(1.0));
        assert_eq!(set("grasper.left.instrument.jaws", "1.0").unwrap(), Value::from(1));
        assert_eq!(set("grasper.left.instrument.grasp_assist", "true").unwrap(), Value::Bool(true));
        assert_eq!(set("ring.1.rigid_body.motion", "kinematic").unwrap(), "kinematic");
        assert!(
            set("grasper.left.instrument.jaws", "1.5").unwrap_err().to_string().contains("a whole number")
        );
        assert!(set("ring.1.rigid_body.mass", "heavy").unwrap_err().to_string().contains("a number"));
        assert!(set("ring.1.rigid_body.mass", "NaN").unwrap_err().to_string().contains("NaN"));
        assert!(set("ring.1.pose.translation", "1").unwrap_err().to_string().contains("0 to 2"));
    }

    #[test]
    fn assignments_are_split_at_the_first_sign() {
        assert_eq!(parse_assignment("a.b.c = 1e-3"), Ok(("a.b.c".into(), Value::from(1e-3))));
        assert_eq!(parse_assignment("a=b=c"), Ok(("a".into(), Value::from("b=c"))));
        assert_eq!(parse_assignment("a=.5"), Ok(("a".into(), Value::from(0.5))));
        for wrong in ["a", "=1", "a=", " = "] {
            assert!(parse_assignment(wrong).is_err(), "{wrong}");
        }
    }

    /// Pieces of names, in any order, and other letters.
    fn name() -> impl Strategy<Value = String> {
        let piece = select(vec![
            "ring",
            "1",
            "*",
            "rigid_body",
            "mass",
            "pose",
            "translation",
            "0",
            "-1",
            "99999999999999999999",
            "",
            "shape",
            "torus",
            "grasper",
            "left",
            "instrument",
            "port",
            "0:0:5",
            "name",
            "task_state",
        ]);
        prop_oneof![
            4 => prop::collection::vec(piece, 0..8).prop_map(|pieces| pieces.join(".")),
            1 => "\\PC{0,40}",
        ]
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(2_000) })]

        #[test]
        fn any_text_names_a_field_or_is_refused(text in name(), value in "\\PC{0,12}") {
            thread_local!(static SCENE: Snapshot = scene());
            SCENE.with(|scene| {
                let _ = parse_assignment(&format!("{text}={value}"));
                match (find(scene, &text), list(scene, &text)) {
                    (Ok(fields), listed) => {
                        prop_assert!(!fields.is_empty() && listed.is_ok());
                        let mut row = row(scene, &fields[0]).unwrap();
                        let _ = write(&fields[0], &mut row, &parse_value(&value));
                    }
                    (Err(error), _) => prop_assert!(!error.to_string().is_empty()),
                }
                Ok(())
            })?;
        }
    }
}
