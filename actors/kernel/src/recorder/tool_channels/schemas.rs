//! JSON schemas of the messages. Those of well-known types have the fields that their users look for. Each field has one
//! type: a field without a value is left out, since viewers know no null.

use serde_json::{Value, json};

pub(super) const TRANSFORMS: &str = "foxglove.FrameTransforms";
pub(super) const SCENE: &str = "foxglove.SceneUpdate";
pub(super) const EVENT: &str = "trocar.Event";
pub(super) const HAND: &str = "trocar.Hand";
pub(super) const TASK: &str = "trocar.Task";
pub(super) const PHASE: &str = "trocar.TaskPhase";
pub(super) const MEASURED: &str = "trocar.Measured";

/// An object of which every field is there.
fn object(title: &str, fields: &[(&str, Value)]) -> Value {
    object_with(title, fields, &[])
}

/// An object of which every field is there but for some that have no value at times.
fn object_with(title: &str, fields: &[(&str, Value)], optional: &[&str]) -> Value {
    let required = fields.iter().map(|(name, _)| *name).filter(|name| !optional.contains(name));
    let properties = fields.iter().map(|(name, field)| ((*name).to_owned(), field.clone()));
    json!({
        "title": title,
        "type": "object",
        "properties": Value::Object(properties.collect()),
        "required": required.collect::<Vec<_>>()
    })
}

/// The same with a description, which tells units and frames.
fn described(text: &str, mut schema: Value) -> Value {
    schema["description"] = text.into();
    schema
}

fn list(items: Value) -> Value {
    json!({"type": "array", "items": items})
}

fn text() -> Value {
    json!({"type": "string"})
}

fn number(text: &str) -> Value {
    json!({"type": "number", "description": text})
}

/// One of some whole numbers, each with its name.
fn choice(title: &str, names: &[&str]) -> Value {
    let one = |(number, name): (usize, &&str)| json!({"title": name, "const": number});
    json!({"title": title, "oneOf": names.iter().enumerate().map(one).collect::<Vec<_>>()})
}

fn whole(text: &str) -> Value {
    json!({"type": "integer", "minimum": 0, "description": text})
}

fn yes_or_no() -> Value {
    json!({"type": "boolean"})
}

fn numbers(title: &str, names: &[&str]) -> Value {
    let fields: Vec<_> = names.iter().map(|name| (*name, json!({"type": "number"}))).collect();
    object(title, &fields)
}

fn vector() -> Value {
    numbers("foxglove.Vector3", &["x", "y", "z"])
}

fn pose() -> Value {
    let orientation = numbers("foxglove.Quaternion", &["x", "y", "z", "w"]);
    object("foxglove.Pose", &[("position", vector()), ("orientation", orientation)])
}

fn color() -> Value {
    numbers("foxglove.Color", &["r", "g", "b", "a"])
}

/// A time, or a duration.
fn seconds(title: &str) -> Value {
    json!({
        "title": title,
        "type": "object",
        "properties": {
            "sec": {"type": "integer"},
            "nsec": {"type": "integer", "minimum": 0, "maximum": 999_999_999}
        }
    })
}

/// Names of quantities and their values.
fn quantities(text: &str) -> Value {
    json!({"type": "object", "additionalProperties": {"type": "number"}, "description": text})
}

pub(super) fn transforms() -> Value {
    let transform = object(
        "foxglove.FrameTransform",
        &[
            ("timestamp", seconds("time")),
            ("parent_frame_id", text()),
            ("child_frame_id", text()),
            ("translation", vector()),
            ("rotation", numbers("foxglove.Quaternion", &["x", "y", "z", "w"])),
        ],
    );
    described(
        "Poses as frames: lengths in metres, rotations as unit quaternions.",
        object(TRANSFORMS, &[("transforms", list(transform))]),
    )
}

pub(super) fn event() -> Value {
    object_with(
        EVENT,
        &[
            ("name", text()),
            ("subject", text()),
            ("object", described("what else it concerns, if anything", text())),
            ("value", number("a number that belongs to the event")),
            ("at_secs", number("when [s]")),
        ],
        &["object"],
    )
}

pub(super) fn hand() -> Value {
    object_with(
        HAND,
        &[
            ("hand", text()),
            ("side", json!({"type": "string", "enum": ["left", "right"]})),
            ("instrument", text()),
            ("applied", described("force that the driver rendered, in the device's axes [N]", vector())),
            ("applied_norm", number("its magnitude [N]")),
            ("commanded", described("force that was commanded, in the device's axes [N]", vector())),
            ("commanded_norm", number("its magnitude [N]")),
            ("gripper", number("opening of the device's gripper [rad]")),
            ("jaw", number("full opening of the instrument's jaws, if it has any [rad]")),
            ("buttons", whole("one bit per button")),
            ("connected", yes_or_no()),
        ],
        &["jaw"],
    )
}

pub(super) fn task() -> Value {
    let metrics = json!({
        "type": "object",
        "additionalProperties": quantities("name and value"),
        "description": "at the end: of each hand, or of the outcome"
    });
    object_with(
        TASK,
        &[
            ("exercise", text()),
            ("task", text()),
            ("phase", text()),
            ("done", whole("steps that are done")),
            ("steps", whole("steps in all")),
            ("seconds", number("on the exercise's own clock [s]")),
            ("score", number("0 to 100, once the exercise is over; not clinically validated")),
            ("score_kind", text()),
            ("errors", whole("errors so far")),
            ("last_error", described("the kind of the last error, if any", text())),
            ("over", yes_or_no()),
            ("completed", yes_or_no()),
            ("cut_off", yes_or_no()),
            ("metrics", metrics),
        ],
        &["score", "last_error"],
    )
}

pub(super) fn phase() -> Value {
    object_with(
        PHASE,
        &[
            ("exercise", text()),
            ("task", text()),
            ("phase", described("the phase that begins", text())),
            ("before", described("the phase that ends, if there was one", text())),
            ("done", whole("steps that are done")),
            ("seconds", number("on the exercise's own clock [s]")),
        ],
        &["before"],
    )
}

pub(super) fn measured() -> Value {
    object(
        MEASURED,
        &[("controller", text()), ("values", quantities("in SI units, the unit at the end of the name"))],
    )
}

pub(super) fn scene() -> Value {
    let index = json!({"type": "integer", "minimum": 0});
    let sized = |title| object(title, &[("pose", pose()), ("size", vector()), ("color", color())]);
    let cylinder = object(
        "foxglove.CylinderPrimitive",
        &[
            ("pose", pose()),
            ("size", vector()),
            ("bottom_scale", number("of the face at -z")),
            ("top_scale", number("of the face at +z")),
            ("color", color()),
        ],
    );
    let points = || {
        [
            ("pose", pose()),
            ("points", list(numbers("foxglove.Point3", &["x", "y", "z"]))),
            ("color", color()),
            ("colors", list(color())),
            ("indices", list(index.clone())),
        ]
    };
    let line = [
        ("type", choice("foxglove.LineType", &["LINE_STRIP", "LINE_LOOP", "LINE_LIST"])),
        ("thickness", number("[m]")),
        ("scale_invariant", yes_or_no()),
    ];
    let line = object("foxglove.LinePrimitive", &[&line[..], &points()].concat());
    // Kinds of primitives that no recording has: viewers look for their lists all the same.
    let none = |title: &str| list(json!({"title": title, "type": "object"}));
    let pair = object("foxglove.KeyValuePair", &[("key", text()), ("value", text())]);
    let entity = object(
        "foxglove.SceneEntity",
        &[
            ("timestamp", seconds("time")),
            ("frame_id", described("a frame of /tf", text())),
            ("id", text()),
            ("lifetime", seconds("duration")),
            ("frame_locked", yes_or_no()),
            ("metadata", list(pair)),
            ("arrows", none("foxglove.ArrowPrimitive")),
            ("cubes", list(sized("foxglove.CubePrimitive"))),
            ("spheres", list(sized("foxglove.SpherePrimitive"))),
            ("cylinders", list(cylinder)),
            ("lines", list(line)),
            ("triangles", list(object("foxglove.TriangleListPrimitive", &points()))),
            ("texts", none("foxglove.TextPrimitive")),
            ("models", none("foxglove.ModelPrimitive")),
        ],
    );
    let kind = choice("foxglove.SceneEntityDeletionType", &["MATCHING_ID", "ALL"]);
    let deletion = object(
        "foxglove.SceneEntityDeletion",
        &[("timestamp", seconds("time")), ("type", kind), ("id", text())],
    );
    object(SCENE, &[("deletions", list(deletion)), ("entities", list(entity))])
}
