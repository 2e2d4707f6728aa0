//! Stiffness of a volume's regions, such as a hard nodule in soft tissue.
//!
//! The regions are those of the body's mesh ([`TetRegions`]). Each element is stiffer than the body by the ratio of the
//! moduli, which every method of volumes takes as it takes coagulation; what heat does multiplies it.

use std::collections::BTreeMap;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, Entity, Snapshot, TetRegions};

/// Materials of regions by their names. Other regions have the body's own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "soft_regions", check = Self::ranges, schema)]
#[serde(transparent)]
pub struct SoftRegions(pub BTreeMap<String, RegionMaterial>);

/// The material of a region. Density and Poisson's ratio are the body's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RegionMaterial {
    /// Young's modulus \[Pa\].
    pub young_modulus: f64,
}

impl SoftRegions {
    fn ranges(&self) -> Result<(), ComponentError> {
        let moduli = self.0.values().map(|region| region.young_modulus);
        moduli.into_iter().try_for_each(|modulus| {
            ComponentError::range("young_modulus", modulus, 1.0..=1e12, "1 to 1e12 Pa")
        })
    }
}

/// How many times as stiff as a body of this Young's modulus \[Pa\] each element of its first mesh is; empty when no
/// region has a material of its own.
///
/// # Errors
/// When a region is named that the mesh does not have, or the mesh has none.
pub(super) fn factors(scene: &Snapshot, entity: Entity, young_modulus: f64) -> Result<Arc<Vec<f64>>, String> {
    let Some(materials) = scene.get::<SoftRegions>(entity).filter(|materials| !materials.0.is_empty()) else {
        return Ok(Arc::default());
    };
    let Some(regions) = scene.get::<TetRegions>(entity) else {
        return Err("its 'soft_regions' name regions, but its mesh has none: they come from physical groups of a Gmsh \
                    file or a cell array of a VTK file"
            .into());
    };
    if let Some(unknown) = materials.0.keys().find(|name| !regions.names.contains(name)) {
        let names = regions.names.join("', '");
        return Err(format!("its 'soft_regions' name '{unknown}'; its mesh has: '{names}'"));
    }
    if young_modulus <= 0.0 {
        return Err("'soft_regions' are of volumes: it moves as something else".into());
    }
    let factor_of =
        |name: &String| materials.0.get(name).map_or(1.0, |material| material.young_modulus / young_modulus);
    let by_region: Vec<f64> = regions.names.iter().map(factor_of).collect();
    let factor = |region: &u16| by_region.get(usize::from(*region)).copied().unwrap_or(1.0);
    Ok(Arc::new(regions.of_tet.iter().map(factor).collect()))
}
