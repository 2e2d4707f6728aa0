//! The table `sources` of an entity: each name must refer to a number that a component gives, and values outside the
//! range are reported.

use serde::Deserialize;
use serde_json::Value;
use toml::Spanned;
use toml::de::DeValue;

use crate::components::{Source, Sources};
use crate::document_value::DocumentValue;

/// Values of a component outside their sources' ranges, in one sentence.
///
/// # Errors
/// A name for which the component gives no number.
pub(super) fn doubt(
    sources: &Sources,
    component: &str,
    value: &Spanned<DeValue<'_>>,
) -> Result<Option<String>, String> {
    let Some(known) = sources.0.get(component) else { return Ok(None) };
    let value = Value::deserialize(&DocumentValue::from(value)).unwrap_or_default();
    let mut doubt = None;
    for (name, Source { from, range }) in known {
        let mut found = Vec::new();
        numbers(&value, name, &mut found);
        if found.is_empty() {
            return Err(format!("'{component}' gives no number '{name}' whose source this could be"));
        }
        let Some([low, high]) = *range else { continue };
        if let Some(found) = found.into_iter().find(|found| !(low..=high).contains(found)) {
            doubt = Some(format!(
                "'{component}' has a {name} of {found}, and it is known from {low} to {high}: {from}"
            ));
        }
    }
    Ok(doubt)
}

/// All numbers with a name, at any depth.
fn numbers(value: &Value, name: &str, found: &mut Vec<f64>) {
    for (key, value) in value.as_object().into_iter().flatten() {
        found.extend(value.as_f64().filter(|_| key == name));
        numbers(value, name, found);
    }
}
