//! JSON as strangers may send it, for property tests.

use proptest::prelude::*;
use serde_json::{Map, Value};

/// Names that payloads have.
const NAMES: [&str; 14] = [
    "based_on_secs",
    "buttons",
    "claim",
    "component",
    "entity",
    "events",
    "gripper",
    "name",
    "position",
    "put",
    "remove",
    "rotation",
    "sequence",
    "value",
];

/// One of them, or another one.
fn name() -> impl Strategy<Value = String> {
    prop_oneof![prop::sample::select(&NAMES[..]).prop_map(str::to_owned), "[a-zä\"\\\\]{0,8}"]
}

/// Any value, at most four deep.
pub fn any_value() -> impl Strategy<Value = Value> {
    let leaf = prop_oneof![
        Just(Value::Null),
        any::<bool>().prop_map(Value::from),
        // What is no number becomes null.
        any::<f64>().prop_map(Value::from),
        any::<u64>().prop_map(Value::from),
        any::<i64>().prop_map(Value::from),
        "[ -~]{0,20}".prop_map(Value::from),
        "[0-9a-f]{16}".prop_map(Value::from),
        Just(Value::from("ring.1")),
    ];
    leaf.prop_recursive(4, 48, 8, |inner| {
        let object = prop::collection::btree_map(name(), inner.clone(), 0..6);
        prop_oneof![
            prop::collection::vec(inner, 0..8).prop_map(Value::from),
            object.prop_map(|fields| Value::Object(fields.into_iter().collect::<Map<_, _>>())),
        ]
    })
}
