//! What `trocar tune` and a running session say to each other: a JSON object per line, one answer per question.

use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Longest line \[bytes\].
pub const LINE_BYTES_MAX: usize = 1 << 20;

/// What is asked of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", tag = "do", deny_unknown_fields)]
pub enum Request {
    /// Which fields there are, with their values.
    List {
        /// An entity, a component of it, or a field; `*` stands for any letters.
        pattern: String,
    },
    /// Single fields are set.
    Set {
        /// Fields and values.
        values: Vec<(String, Value)>,
    },
    /// A set of values is used.
    Use {
        /// Its name, or `base`.
        set: String,
    },
    /// What is tuned is kept as a set.
    Keep {
        /// Its name.
        set: String,
    },
    /// What is tuned, and which sets there are.
    Status {},
    /// What is tuned is written into the scenario.
    Save {
        /// A new file instead of the scenario's own; an absolute path.
        file: Option<PathBuf>,
    },
    /// All sets, as the text of a file for `--tuning`.
    Sets {},
}

/// What a session answers.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reply {
    /// What is wrong; nothing was done then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub error: Option<String>,
    /// Name of the scenario.
    pub scenario: String,
    /// Time of the session \[s\].
    pub session_secs: f64,
    /// The set in use; none when single fields were set since.
    pub in_use: Option<String>,
    /// The sets that there are.
    pub sets: Vec<String>,
    /// Fields.
    pub fields: Vec<FieldRow>,
    /// The file that was written.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub file: Option<PathBuf>,
    /// A text that was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub text: Option<String>,
    /// What could not be saved, in words.
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
    /// What it was before this, or before anybody tuned it.
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
