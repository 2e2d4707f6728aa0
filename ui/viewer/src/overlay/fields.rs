//! Scalar fields over surfaces: temperature, burns, and fields of simulators.

use std::sync::Arc;

use trocar_scene::{Burn, ScalarField, ScalarFields, Snapshot, Temperature};

use super::{Legend, Overlay, Overlays, Seen};
use crate::colormap::Colormap;
use crate::draw_list::DrawList;
use crate::edit_map::damage;

/// The mapping from a vertex's value to the displayed value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measure {
    /// The value itself.
    Value,
    /// From an Arrhenius integral to the denatured share of the protein \[%\].
    Denatured,
}

/// One number per vertex of an item.
#[derive(Clone, Debug)]
pub struct Field {
    /// Index in the draw list.
    pub item: usize,
    /// One value per vertex of the entity.
    pub values: Arc<Vec<f64>>,
    /// Mapping to the displayed value.
    pub measure: Measure,
    /// Ends of the scale.
    pub range: [f64; 2],
    /// Its colour map.
    pub colormap: Colormap,
}

impl Field {
    /// Position of a vertex on the scale, from 0 to 1; `None` for a vertex without a value.
    pub fn fraction(&self, vertex: u32) -> Option<f32> {
        let value = *self.values.get(vertex as usize)?;
        let value = match self.measure {
            Measure::Value => value,
            Measure::Denatured => 100.0 * f64::from(damage::denatured(value)),
        };
        let [low, high] = self.range;
        Some(((value - low) / (high - low)).clamp(0.0, 1.0) as f32)
    }

    /// Whether it shows the same values in the same way.
    pub fn is_like(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.values, &other.values)
            && self.measure == other.measure
            && self.range == other.range
            && self.colormap == other.colormap
    }
}

/// Collects a field of the drawn entities. An entity shows one field at a time: the first of temperature, burn and
/// field that it has.
pub(super) fn field(
    overlay: Overlay,
    overlays: &Overlays,
    scene: &Snapshot,
    draw_list: &DrawList,
    seen: &mut Seen,
) {
    match overlay {
        Overlay::Temperature => {
            let (range, colormap) = (ordered(overlays.celsius), Colormap::Inferno);
            for (item, entity) in free(draw_list, seen) {
                let Some(Temperature { celsius }) = scene.get(entity) else { continue };
                let values = Arc::clone(celsius);
                seen.fields.push(Field { item, values, measure: Measure::Value, range, colormap });
            }
            seen.legends.push(Legend::scale("temperature", "°C", range, colormap));
        }
        Overlay::Burn => {
            let (range, colormap) = ([0.0, 100.0], Colormap::Viridis);
            for (item, entity) in free(draw_list, seen) {
                let Some(Burn { omega }) = scene.get(entity) else { continue };
                let values = Arc::clone(omega);
                seen.fields.push(Field { item, values, measure: Measure::Denatured, range, colormap });
            }
            seen.legends.push(Legend::scale("denatured protein", "%", range, colormap));
        }
        _ => scalar_fields(overlays, scene, draw_list, seen),
    }
}

fn scalar_fields(overlays: &Overlays, scene: &Snapshot, draw_list: &DrawList, seen: &mut Seen) {
    let picked = |fields: &'_ ScalarFields| -> Option<ScalarField> {
        match &overlays.field {
            Some(name) => fields.get(name).cloned(),
            None => fields.fields.first().cloned(),
        }
    };
    let mut shown: Vec<(usize, ScalarField)> = Vec::new();
    for (item, entity) in free(draw_list, seen) {
        shown.extend(scene.get::<ScalarFields>(entity).and_then(picked).map(|field| (item, field)));
    }
    // Entities with the same quantity share its scale.
    let mut scales: Vec<(String, String, [f64; 2])> = Vec::new();
    for (_, field) in &shown {
        let own = field.range.unwrap_or_else(|| extent(&field.values));
        match scales.iter_mut().find(|(name, unit, _)| *name == field.name && *unit == field.unit) {
            Some((_, _, range)) => *range = [range[0].min(own[0]), range[1].max(own[1])],
            None => scales.push((field.name.clone(), field.unit.clone(), own)),
        }
    }
    let colormap = Colormap::Turbo;
    for (item, field) in shown {
        let scale = scales.iter().find(|(name, unit, _)| *name == field.name && *unit == field.unit);
        let range = ordered(scale.map_or([0.0, 1.0], |(_, _, range)| *range));
        seen.fields.push(Field { item, values: field.values, measure: Measure::Value, range, colormap });
    }
    for (name, unit, range) in scales {
        seen.legends.push(Legend::scale(&name, &unit, ordered(range), colormap));
    }
}

/// Items without a field so far, with their entities.
fn free(draw_list: &DrawList, seen: &Seen) -> Vec<(usize, trocar_scene::Entity)> {
    let taken: Vec<usize> = seen.fields.iter().map(|field| field.item).collect();
    let items = draw_list.items().iter().enumerate();
    items.filter(|(item, _)| !taken.contains(item)).map(|(item, drawn)| (item, drawn.entity)).collect()
}

fn extent(values: &[f64]) -> [f64; 2] {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if low <= high { [low, high] } else { [0.0, 1.0] }
}

/// The range, widened if it is empty.
fn ordered([low, high]: [f64; 2]) -> [f64; 2] {
    if high > low { [low, high] } else { [low, low + (low.abs() * 1e-6).max(1.0)] }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_value_is_where_it_belongs_on_the_scale() {
        let field = |measure, range| Field {
            item: 0,
            values: Arc::new(vec![37.0, 68.5, 500.0, 1.0]),
            measure,
            range,
            colormap: Colormap::Inferno,
        };
        let celsius = field(Measure::Value, [37.0, 100.0]);
        assert_eq!([0, 1, 2].map(|vertex| celsius.fraction(vertex)), [Some(0.0), Some(0.5), Some(1.0)]);
        assert_eq!(celsius.fraction(4), None);
        // Ω = 1: 63.2 % of the protein.
        let burn = field(Measure::Denatured, [0.0, 100.0]);
        assert!((burn.fraction(3).unwrap() - 0.632).abs() < 1e-3);
    }

    #[test]
    fn no_range_is_empty() {
        assert_eq!(ordered([2.0, 2.0]), [2.0, 3.0]);
        assert_eq!(ordered([1.0, 3.0]), [1.0, 3.0]);
        assert_eq!(extent(&[]), [0.0, 1.0]);
        assert_eq!(extent(&[3.0, -1.0]), [-1.0, 3.0]);
    }
}
