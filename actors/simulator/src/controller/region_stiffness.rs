//! Stiffness of a volume's regions, such as a hard nodule in soft tissue.
//!
//! The regions are those of the body's mesh ([`TetRegions`]). Each element is stiffer than the body by the ratio of the
//! moduli, which every method of volumes takes as it takes coagulation; what heat does multiplies it.

use std::collections::BTreeMap;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::{Component, ComponentError, Entity, EntityMesh, Snapshot, TetRegions};

/// Materials of regions by their names. Other regions have the body's own.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "soft_regions", check = Self::ranges, fits = Self::fits, schema)]
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
    fn fits(&self, mesh: &EntityMesh<'_>) -> Result<(), ComponentError> {
        if self.0.is_empty() {
            return Ok(());
        }
        self.are_of(mesh.regions).map_err(ComponentError::Malformed)
    }

    /// Whether a mesh has all of them.
    fn are_of(&self, regions: Option<&[String]>) -> Result<(), String> {
        let Some(regions) = regions else {
            return Err("its 'soft_regions' name regions, but its mesh has none: they come from physical groups of a \
                        Gmsh file or a cell array of a VTK file"
                .into());
        };
        match self.0.keys().find(|name| !regions.contains(name)) {
            None => Ok(()),
            Some(unknown) => {
                let names = regions.join("', '");
                Err(format!("its 'soft_regions' name '{unknown}'; its mesh has: '{names}'"))
            }
        }
    }

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
    let regions = scene.get::<TetRegions>(entity);
    materials.are_of(regions.map(|regions| &regions.names[..]))?;
    let Some(regions) = regions else { return Ok(Arc::default()) };
    if young_modulus <= 0.0 {
        return Err("'soft_regions' are of volumes: it moves as something else".into());
    }
    let factor_of =
        |name: &String| materials.0.get(name).map_or(1.0, |material| material.young_modulus / young_modulus);
    let by_region: Vec<f64> = regions.names.iter().map(factor_of).collect();
    let factor = |region: &u16| by_region.get(usize::from(*region)).copied().unwrap_or(1.0);
    Ok(Arc::new(regions.of_tet.iter().map(factor).collect()))
}
