//! Named sets of field values for comparison (A/B).

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};
use serde_json::Value;
use thiserror::Error;

use super::field::PATH_BYTES_MAX;

/// Version of the format that this code reads.
const SCHEMA_VERSION: u32 = 1;
/// Largest file of sets \[bytes\].
const FILE_BYTES_MAX: u64 = 1 << 20;
/// Most sets.
pub const SETS_MAX: usize = 64;
/// Most values in a set.
pub const VALUES_MAX: usize = 4096;

/// The reserved name for the untuned values.
pub const BASE: &str = "base";

/// Values by the names of their fields, in which `*` may stand in the entity's part.
pub type TuningSet = BTreeMap<String, Value>;

/// Sets of values by name. As a file:
///
/// ```toml
/// schema = 1
/// [sets.a]
/// "ring.*.rigid_body.mass" = 0.005
/// [sets.b]
/// "ring.*.rigid_body.mass" = 0.02
/// "grasper.*.instrument.jaw_friction" = 0.4
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TuningSets {
    schema: u32,
    #[serde(default)]
    sets: BTreeMap<String, TuningSet>,
}

/// Why the sets cannot be read or used.
#[derive(Debug, Error)]
pub enum SetsError {
    /// The file cannot be read.
    #[error("{file}: {source}")]
    Io {
        /// The file.
        file: String,
        /// Why.
        source: std::io::Error,
    },
    /// The file is wrong.
    #[error("{file}: {reason}")]
    Invalid {
        /// The file.
        file: String,
        /// What is wrong.
        reason: String,
    },
    /// No such set.
    #[error("there is no set '{name}'; there are: {known}")]
    Unknown {
        /// The name that was asked for.
        name: String,
        /// The valid names.
        known: String,
    },
    /// An invalid name for a set.
    #[error(
        "'{0}' is no name of a set: 1 to 32 lower-case letters, digits, '-' and '_', and not '{BASE}', which is \\
        what every field was before"
    )]
    Name(String),
    /// Too many sets or values.
    #[error("at most {SETS_MAX} sets of {VALUES_MAX} values can be kept")]
    Full,
}

impl TuningSets {
    /// Reads a file.
    ///
    /// # Errors
    /// Names the file and the place.
    pub fn read(file: &Path) -> Result<Self, SetsError> {
        use std::io::Read;
        let named = file.display().to_string();
        let io = |source| SetsError::Io { file: named.clone(), source };
        let mut text = String::new();
        std::fs::File::open(file)
            .and_then(|opened| opened.take(FILE_BYTES_MAX + 1).read_to_string(&mut text))
            .map_err(io)?;
        Self::parse(&text, &named)
    }

    /// Parses a text; `file` is its name in messages.
    ///
    /// # Errors
    /// Names the file and the place.
    pub fn parse(text: &str, file: &str) -> Result<Self, SetsError> {
        let invalid = |reason: String| SetsError::Invalid { file: file.to_owned(), reason };
        if text.len() as u64 > FILE_BYTES_MAX {
            return Err(invalid(format!("longer than {FILE_BYTES_MAX} bytes")));
        }
        let sets: Self = toml::from_str(text).map_err(|error| {
            let line = error.span().map(|span| 1 + text[..span.start.min(text.len())].matches('\n').count());
            let place = line.map_or_else(String::new, |line| format!("line {line}: "));
            invalid(format!("{place}{}", error.message().trim()))
        })?;
        if sets.schema != SCHEMA_VERSION {
            let found = sets.schema;
            return Err(invalid(format!("schema {found} is not known; this program reads {SCHEMA_VERSION}")));
        }
        if sets.sets.len() > SETS_MAX || sets.sets.values().any(|set| set.len() > VALUES_MAX) {
            return Err(invalid(SetsError::Full.to_string()));
        }
        for (name, set) in &sets.sets {
            check_name(name).map_err(|error| invalid(error.to_string()))?;
            for (field, value) in set {
                if field.len() > PATH_BYTES_MAX || value.is_object() || value.is_array() || value.is_null() {
                    let reason =
                        format!("set '{name}', '{field}': a number, true or false, or a word is expected");
                    return Err(invalid(reason));
                }
            }
        }
        Ok(sets)
    }

    /// The sets as the text of a file.
    pub fn text(&self) -> String {
        let whole = Self { schema: SCHEMA_VERSION, sets: self.sets.clone() };
        toml::to_string(&whole).unwrap_or_default()
    }

    /// The names of the sets.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.sets.keys().map(String::as_str)
    }

    /// The set of that name.
    ///
    /// # Errors
    /// [`SetsError::Unknown`] with the valid names.
    pub fn get(&self, name: &str) -> Result<&TuningSet, SetsError> {
        self.sets.get(name).ok_or_else(|| SetsError::Unknown {
            name: name.to_owned(),
            known: std::iter::once(BASE).chain(self.names()).collect::<Vec<_>>().join(", "),
        })
    }

    /// Stores a set, replacing an earlier one of that name.
    ///
    /// # Errors
    /// When the name is invalid, or there is no room.
    pub fn keep(&mut self, name: &str, set: TuningSet) -> Result<(), SetsError> {
        check_name(name)?;
        if set.len() > VALUES_MAX || (self.sets.len() >= SETS_MAX && !self.sets.contains_key(name)) {
            return Err(SetsError::Full);
        }
        self.sets.insert(name.to_owned(), set);
        Ok(())
    }
}

fn check_name(name: &str) -> Result<(), SetsError> {
    let valid = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-' || c == '_';
    if (1..=32).contains(&name.len()) && name.chars().all(valid) && name != BASE {
        Ok(())
    } else {
        Err(SetsError::Name(name.chars().take(60).collect()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const TEXT: &str = "schema = 1\n[sets.a]\n\"ring.*.rigid_body.mass\" = 0.005\n[sets.b]\nx = true\n";

    #[test]
    fn sets_come_from_a_text_and_go_back() {
        let sets = TuningSets::parse(TEXT, "t.toml").unwrap();
        assert_eq!(sets.names().collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(sets.get("a").unwrap()["ring.*.rigid_body.mass"], 0.005);
        assert_eq!(TuningSets::parse(&sets.text(), "t.toml").unwrap(), sets);
        assert!(sets.get("c").unwrap_err().to_string().contains("base, a, b"));
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place() {
        for (text, says) in [
            ("schema = 2", "schema 2"),
            ("schema = 1\nset = 3", "line 2: unknown field `set`"),
            ("schema = 1\n[sets.base]\nx = 1", "'base' is no name"),
            ("schema = 1\n[sets.A]\nx = 1", "'A' is no name"),
            ("schema = 1\n[sets.a]\nx = [1]", "set 'a', 'x'"),
            ("schema = 1\n[sets.a]\nx = ", "line 3"),
        ] {
            let error = TuningSets::parse(text, "t.toml").unwrap_err().to_string();
            assert!(error.contains(says) && error.contains("t.toml"), "{error}");
        }
    }

    #[test]
    fn what_is_kept_is_bounded() {
        let mut sets = TuningSets::default();
        for index in 0..SETS_MAX {
            sets.keep(&format!("s{index}"), TuningSet::new()).unwrap();
        }
        assert!(matches!(sets.keep("one-more", TuningSet::new()), Err(SetsError::Full)));
        sets.keep("s0", TuningSet::from([("x".to_owned(), Value::from(1))])).unwrap();
        assert!(matches!(sets.keep("base", TuningSet::new()), Err(SetsError::Name(_))));
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::with_cases(500) })]

        #[test]
        fn any_text_is_read_or_refused(at in 0..TEXT.len(), cut in 0usize..20, more in "\\PC{0,20}") {
            let end = (at + cut).min(TEXT.len());
            let text = format!("{}{more}{}", &TEXT[..at], &TEXT[end..]);
            match TuningSets::parse(&text, "t.toml") {
                Ok(sets) => prop_assert_eq!(TuningSets::parse(&sets.text(), "t.toml").unwrap(), sets),
                Err(error) => prop_assert!(error.to_string().starts_with("t.toml: ")),
            }
        }
    }
}
