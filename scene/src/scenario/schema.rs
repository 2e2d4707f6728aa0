//! The JSON schema (draft 2020-12) of scenario files, for editors and for `trocar schema`.

use serde_json::{Map, Value, json};

use super::{CONTROLLERS_MAX, ENTITIES_MAX, HANDS_MAX, SCHEMA_VERSION, mesh_source, procedural_mesh};
use crate::registry::Registry;

/// The schema of scenario files with the components of this registry.
pub fn json_schema(registry: &Registry) -> Value {
    let mut definitions = Map::new();
    let mut components = Map::new();
    for (_, entry) in registry.iter() {
        let Some(schema) = (entry.schema)() else { continue };
        hoist(entry.name, schema, &mut definitions);
        components.insert(entry.name.to_owned(), json!({ "$ref": format!("#/$defs/{}", entry.name) }));
    }
    components.insert(
        "mesh".into(),
        json!({ "oneOf": (MESHES.map(|name| json!({ "$ref": format!("#/$defs/mesh_{name}") }))) }),
    );
    definitions.insert("mesh_file".into(), mesh_file());
    definitions.insert("mesh_shape".into(), mesh_shape());
    definitions.insert("mesh_organ".into(), mesh_organ());
    for (key, of, description) in [
        (
            "sheet",
            schema_of::<procedural_mesh::Sheet>(),
            "A rectangle in the xy plane, with texture coordinates.",
        ),
        ("tube", schema_of::<procedural_mesh::Tube>(), "A tube without lids along z."),
        ("block", schema_of::<procedural_mesh::Block>(), "A box of tetrahedra."),
        (
            "line",
            schema_of::<procedural_mesh::Line>(),
            "A straight thread along x: vertex_positions and line_mesh.",
        ),
    ] {
        definitions.insert(format!("mesh_{key}"), mesh_grid(key, of, description));
    }
    definitions.insert("identifier".into(), identifier());
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Trocar scenario",
        "description": "A scene, the controllers that act on it, the hands, and the exercise. SI units.",
        "type": "object",
        "additionalProperties": false,
        "required": ["schema", "name"],
        "properties": {
            "schema": { "description": "Version of the format.", "const": SCHEMA_VERSION },
            "name": { "description": "Short name of the scenario.", "$ref": "#/$defs/identifier" },
            "title": { "description": "One line for people; the name by default.", "type": "string" },
            "description": { "description": "What the scenario is about.", "type": "string", "default": "" },
            "gravity": {
                "description": "Acceleration of gravity in world [m/s²].",
                "type": "array", "minItems": 3, "maxItems": 3,
                "items": { "type": "number", "minimum": -100, "maximum": 100 },
                "default": [0.0, 0.0, -9.81],
            },
            "entity": {
                "description": "What exists. Entities are numbered in the order of the file.",
                "type": "array", "maxItems": ENTITIES_MAX,
                "items": {
                    "description": "An entity: a name, and components by their names.",
                    "type": "object", "required": ["name"], "additionalProperties": false,
                    "properties": components,
                },
            },
            "controller": {
                "description": "Who acts, each at a rate of its own.",
                "type": "array", "maxItems": CONTROLLERS_MAX, "items": controller(),
            },
            "hand": {
                "description": "Which devices the hands hold.",
                "type": "array", "maxItems": HANDS_MAX, "items": hand(),
            },
            "task": { "description": "Parameters of the exercise.", "type": "object" },
            "network": { "description": "How stations share the scene.", "type": "object" },
        },
        "$defs": definitions,
    })
}

fn controller() -> Value {
    json!({
        "type": "object", "required": ["name", "kind", "rate_hz"], "additionalProperties": false,
        "properties": {
            "name": { "description": "Name of the writer, such as haptics.left.", "$ref": "#/$defs/identifier" },
            "kind": { "description": "Which controller it is.", "$ref": "#/$defs/identifier" },
            "rate_hz": {
                "description": "Ticks per second [Hz].", "type": "number", "minimum": 1, "maximum": 10000,
            },
            "params": { "description": "Parameters of that kind of controller.", "type": "object" },
        },
    })
}

fn hand() -> Value {
    json!({
        "type": "object", "required": ["name"], "additionalProperties": false,
        "properties": {
            "name": {
                "description": "Name of the hand, as in --hand NAME=SPEC.", "$ref": "#/$defs/identifier",
            },
            "entity": {
                "description": "Name of the entity with the hand component; hand.NAME by default.",
                "$ref": "#/$defs/identifier",
            },
            "device": {
                "description": "Which device.", "type": "string", "minLength": 1, "maxLength": 1024,
                "default": "virtual",
            },
            "params": { "description": "Parameters of the device.", "type": "object" },
            "renderer": {
                "description": "Force renderer: its kind and parameters.", "type": "object",
            },
        },
    })
}

/// Possible sources of a mesh.
const MESHES: [&str; 7] = ["file", "shape", "organ", "sheet", "tube", "block", "line"];

fn mesh_file() -> Value {
    json!({
        "description": "A mesh file that becomes vertex_positions, surface_mesh and, for volumes, tet_mesh; with a radius its lines \
                        become line_mesh.",
        "type": "object", "required": ["file"], "additionalProperties": false,
        "properties": {
            "file": {
                "description": "Path below the folder of the scenario, or below one that --assets names: obj, stl, ply, gltf, glb, vtp \
                                (surfaces), msh, vtk or vtu (surfaces or volumes).",
                "type": "string",
            },
            "scale": {
                "description": "Metres per unit of the file.", "type": "number",
                "minimum": 1e-9, "maximum": 1e9, "default": 1.0,
            },
            "repair": {
                "description": "Mend it. A surface: weld vertices, drop triangles without area, repeated ones and fins, turn \
                                triangles and shells to face outwards. A volume: turn inverted tetrahedra, merge nodes at \
                                the same place, drop flat, sliver and repeated tetrahedra. What nothing uses is dropped. \
                                What was done is told; a hole stays a hole.",
                "type": "boolean", "default": false,
            },
            "weld": {
                "description": "Distance within which repair makes vertices or nodes one [m]; by default a millionth of the \
                                diagonal of a surface, and 0 for a volume.",
                "type": "number", "minimum": mesh_source::WELD.start(), "maximum": mesh_source::WELD.end(),
            },
            "require": {
                "description": "solid: closed, manifold, facing outwards, nothing degenerate or inverted; manifold: may be \
                                open or face inwards (surfaces) or be inverted (volumes); any: no requirement.",
                "enum": mesh_source::REQUIREMENTS, "default": mesh_source::REQUIREMENTS[0],
            },
            "radius": {
                "description": "Take the lines of an obj, msh, vtk, vtu or vtp file as a thread of this radius (m).",
                "type": "number", "minimum": 1e-6, "maximum": 1.0,
            },
        },
    })
}

fn mesh_shape() -> Value {
    json!({
        "description": "The surface of a shape, which becomes vertex_positions and surface_mesh.",
        "type": "object", "required": ["shape"], "additionalProperties": false,
        "properties": {
            "shape": { "$ref": "#/$defs/shape" },
            "segments": {
                "description": "Segments of a full circle.", "type": "integer",
                "minimum": 8, "maximum": 512, "default": 48,
            },
        },
    })
}

fn mesh_organ() -> Value {
    json!({
        "description": "An organ of graded tetrahedra, which becomes vertex_positions, surface_mesh and tet_mesh.",
        "type": "object", "required": ["organ"], "additionalProperties": false,
        "properties": {
            "organ": schema_of::<crate::organs::Organ>(),
            "edge": {
                "description": "Length of the lattice's edges at the surface [m].", "type": "number",
                "minimum": procedural_mesh::EDGE.0.start(), "maximum": procedural_mesh::EDGE.0.end(),
                "default": procedural_mesh::EDGE.1,
            },
            "levels": {
                "description": "How often the edges double inside.", "type": "integer",
                "minimum": 0, "maximum": 4, "default": 2,
            },
            "wall": {
                "description": "Thickness of the wall of a hollow one [m]; solid without.", "type": "number",
                "minimum": 1e-4, "maximum": 0.1,
            },
            "scale": {
                "description": "How much larger than an adult's.", "type": "number",
                "minimum": 0.01, "maximum": 100.0, "default": 1.0,
            },
        },
    })
}

/// A mesh generated from one table of numbers.
fn mesh_grid(key: &str, of: Value, description: &str) -> Value {
    json!({
        "description": description,
        "type": "object", "required": [key], "additionalProperties": false,
        "properties": { key: of },
    })
}

/// The schema of a type without definitions of its own.
fn schema_of<T: schemars::JsonSchema>() -> Value {
    let mut schema = schemars::schema_for!(T).to_value();
    rewrite("", &mut schema);
    if let Value::Object(object) = &mut schema {
        object.remove("$schema");
    }
    schema
}

fn identifier() -> Value {
    json!({ "type": "string", "pattern": "^[A-Za-z0-9_][A-Za-z0-9._-]{0,63}$" })
}

/// Moves a component's schema and its definitions to the top level.
fn hoist(component: &str, mut schema: Value, definitions: &mut Map<String, Value>) {
    rewrite(component, &mut schema);
    if let Value::Object(object) = &mut schema {
        object.remove("$schema");
        if let Some(Value::Object(inner)) = object.remove("$defs") {
            for (name, definition) in inner {
                definitions.insert(format!("{component}.{name}"), definition);
            }
        }
    }
    definitions.insert(component.to_owned(), schema);
}

/// References to own definitions get the component's prefix; escapes of the documentation are undone.
fn rewrite(component: &str, value: &mut Value) {
    match value {
        Value::Object(object) => {
            for (key, item) in object.iter_mut() {
                match (key.as_str(), item) {
                    ("$ref", Value::String(target)) => {
                        if let Some(name) = target.strip_prefix("#/$defs/") {
                            *target = format!("#/$defs/{component}.{name}");
                        } else if target == "#" {
                            *target = format!("#/$defs/{component}");
                        }
                    }
                    ("description", Value::String(text)) => {
                        *text = text.replace("\\[", "[").replace("\\]", "]");
                    }
                    (_, item) => rewrite(component, item),
                }
            }
        }
        Value::Array(items) => items.iter_mut().for_each(|item| rewrite(component, item)),
        _ => {}
    }
}
