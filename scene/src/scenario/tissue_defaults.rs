//! Tissue defaults (`tissue = "liver"` at an entity): components that omit a parameter of the tissue get the measured
//! value, and values outside the published range are reported.

use serde::Deserialize;
use serde_json::Value;
use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::document_value::DocumentValue;
use crate::readable::quantity;
use crate::tissue::{TissueEntry, TissueParameter};

/// Table of components with the material of a volume; its parameters are not listed in their schema. Sheets and lines
/// have parameters of the same names per area and per length, which tissues do not define.
const VOLUME: &str = "volume";

/// The value of a component with its omitted parameters filled in; `text` is a scratch buffer.
pub(super) fn completed<'a>(
    tissue: &TissueEntry,
    schema: Option<&Value>,
    value: &Spanned<DeValue<'a>>,
    text: &'a mut String,
) -> Spanned<DeValue<'a>> {
    for TissueParameter { name, value, .. } in tissue.parameters {
        *text += &format!("{name} = {value:?}\n");
    }
    let mut value = value.clone();
    let Ok(known) = DeTable::parse(text) else { return value };
    if let DeValue::Table(table) = value.get_mut() {
        let has = |name: &str| schema.is_some_and(|schema| !schema["properties"][name].is_null());
        fill(table, known.get_ref(), &has);
    }
    value
}

fn fill<'a>(table: &mut DeTable<'a>, known: &DeTable<'a>, has: &dyn Fn(&str) -> bool) {
    for (name, value) in known {
        let is_open = !table.iter().any(|(key, _)| key.get_ref() == name.get_ref());
        if is_open && has(name.get_ref()) {
            table.insert(name.clone(), value.clone());
        }
    }
    for (key, value) in table.iter_mut() {
        let is_volume = key.get_ref() == VOLUME;
        if let DeValue::Table(inner) = value.get_mut() {
            let of_volume = |name: &str| ["young_modulus", "poisson_ratio", "density"].contains(&name);
            fill(inner, known, if is_volume { &of_volume } else { &|_| false });
        }
    }
}

/// Values of a component outside the measured ranges, in one sentence.
pub(super) fn doubt(tissue: &TissueEntry, component: &str, value: &Spanned<DeValue<'_>>) -> Option<String> {
    let value = Value::deserialize(&DocumentValue::from(value)).ok()?;
    let volumes = || value.as_object().into_iter().flatten().flat_map(|(_, inner)| inner.get(VOLUME));
    let (parameter, found) = outside(tissue, &value)
        .or_else(|| value.get(VOLUME).and_then(|of| outside(tissue, of)))
        .or_else(|| volumes().find_map(|of| outside(tissue, of)))?;
    let TissueParameter { name, unit, range: [low, high], source, .. } = parameter;
    Some(format!(
        "'{component}' has a {name} of {}; of {} it is known to be {} to {}: {source}",
        quantity(found, unit),
        tissue.name,
        quantity(*low, unit),
        quantity(*high, unit)
    ))
}

fn outside(tissue: &TissueEntry, value: &Value) -> Option<(&'static TissueParameter, f64)> {
    value.as_object()?.iter().find_map(|(key, value)| {
        let (parameter, found) = (tissue.parameter(key)?, value.as_f64()?);
        (!(parameter.range[0]..=parameter.range[1]).contains(&found)).then_some((parameter, found))
    })
}
