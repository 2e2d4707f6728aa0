//! A JSON value written as a TOML document, so that one decoder serves both: each further decoder would be compiled
//! once more for each component.

use std::fmt::Write;

use serde_json::Value;

/// The key of the value in the document.
pub(crate) const KEY: &str = "value";

/// The document. Keys whose value is null are left out, which is how an absent value is written in TOML.
///
/// # Errors
/// When a list has a gap, for which TOML has no notation.
pub(crate) fn document(value: &Value) -> Result<String, &'static str> {
    let mut text = format!("{KEY} = ");
    write_value(value, &mut text)?;
    Ok(text)
}

fn write_value(value: &Value, out: &mut String) -> Result<(), &'static str> {
    match value {
        Value::Null => return Err("null has no place in a list"),
        Value::Bool(value) => out.push_str(if *value { "true" } else { "false" }),
        Value::Number(number) => write!(out, "{number}").map_err(|_| "a number cannot be written")?,
        Value::String(text) => write_string(text, out),
        Value::Array(items) => {
            out.push('[');
            for item in items {
                write_value(item, out)?;
                out.push(',');
            }
            out.push(']');
        }
        Value::Object(fields) => {
            let mut separator = "";
            out.push('{');
            for (key, value) in fields.iter().filter(|(_, value)| !value.is_null()) {
                out.push_str(separator);
                write_string(key, out);
                out.push('=');
                write_value(value, out)?;
                separator = ",";
            }
            out.push('}');
        }
    }
    Ok(())
}

fn write_string(text: &str, out: &mut String) {
    out.push('"');
    for letter in text.chars() {
        match letter {
            '"' | '\\' => out.extend(['\\', letter]),
            '\u{0}'..='\u{1f}' | '\u{7f}' => out.push_str(&format!("\\u{:04x}", u32::from(letter))),
            _ => out.push(letter),
        }
    }
    out.push('"');
}

#[cfg(test)]
mod tests {
    use serde::Deserialize;
    use serde_json::json;
    use toml::de::{DeTable, ValueDeserializer};

    use super::*;

    fn through_toml(value: &Value) -> Value {
        let text = document(value).expect("a document");
        let table = DeTable::parse(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
        Value::deserialize(ValueDeserializer::from(table.get_ref()[KEY].clone())).expect("a value")
    }

    #[test]
    fn every_json_value_without_gaps_comes_back() {
        let all_letters: String = (0..0x3000).filter_map(char::from_u32).collect();
        for value in [
            json!(true),
            json!(-3),
            json!(i64::MIN),
            json!(u64::MAX),
            json!([0.1, -1e-300, 1e21, f64::MAX, f64::MIN_POSITIVE, 2.0, -0.0]),
            json!(all_letters),
            json!({ "": { "a b": [], "\"": {} }, "ü.x": [[1], ["two", { "three": 3.5 }]] }),
        ] {
            assert_eq!(through_toml(&value), value);
        }
    }

    #[test]
    fn null_is_an_absent_key_and_no_item_of_a_list() {
        assert_eq!(
            through_toml(&json!({ "a": null, "b": { "c": null, "d": 1 } })),
            json!({ "b": { "d": 1 } })
        );
        assert_eq!(document(&json!([1, null])), Err("null has no place in a list"));
        assert!(document(&json!(null)).is_err());
    }
}
