//! The protocol between `trocar tune` and a running session: a JSON object per line, one answer per request.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Longest line \[bytes\].
pub const LINE_BYTES_MAX: usize = 1 << 20;

/// A request to a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "do", deny_unknown_fields)]
pub enum Request {
    /// List fields with their values.
    List {
        /// An entity, a component of it, or a field; `*` stands for any letters.
        pattern: String,
    },
    /// Set single fields.
    Set {
        /// Fields and values.
        values: Vec<(String, Value)>,
    },
    /// Switch to a set of values.
    Use {
        /// Its name, or `base`.
        set: String,
    },
    /// Store the tuned values as a set.
    Keep {
        /// Its name.
        set: String,
    },
    /// Report the tuned fields and the sets.
    Status {},
    /// Write the tuned values into the scenario.
    Save {
        /// A new file instead of the scenario's own; an absolute path.
        file: Option<PathBuf>,
    },
    /// Return all sets, as the text of a file for `--tuning`.
    Sets {},
}

/// A session's answer.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reply {
    /// The error; nothing was done then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// Name of the scenario.
    pub scenario: String,
    /// The folder in which the session was started.
    #[serde(default)]
    pub folder: PathBuf,
    /// Time of the session \[s\].
    pub session_secs: f64,
    /// The set in use; `None` after single fields were set.
    pub in_use: Option<String>,
    /// The names of all sets.
    pub sets: Vec<String>,
    /// Fields.
    pub fields: Vec<FieldRow>,
    /// The file that was written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// The requested text.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// Values that could not be saved, in words.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}

/// A field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldRow {
    /// ENTITY.COMPONENT.FIELD.
    pub field: String,
    /// Its value.
    pub value: Value,
    /// Its value before this change, or before it was first tuned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<Value>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_question_is_one_line_of_json() {
        let set = Request::Set { values: vec![("a.b.c".into(), 0.5.into())] };
        let line = serde_json::to_string(&set).unwrap();
        assert_eq!(line, r#"{"do":"set","values":[["a.b.c",0.5]]}"#);
        assert_eq!(serde_json::from_str::<Request>(&line).unwrap(), set);
        assert_eq!(serde_json::from_str::<Request>(r#"{"do":"status"}"#).unwrap(), Request::Status {});
        assert!(serde_json::from_str::<Request>(r#"{"do":"status","x":1}"#).is_err());
    }
}
