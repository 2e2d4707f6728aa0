//! `mesh = { organ = … }`, `{ sheet = … }`, `{ tube = … }`, `{ block = … }` and `{ line = … }` at an entity: generated
//! meshes, so that a scenario of soft bodies needs no file.

use std::ops::RangeInclusive;
use std::sync::Arc;

use schemars::JsonSchema;
use serde::Deserialize;
use toml::Spanned;
use toml::de::DeValue;

use super::document::Table;
use super::error::ScenarioError;
use super::mesh_source::{LoadedMesh, from_surface, from_tets};
use crate::components::{LineMesh, VertexPositions};
use crate::organs::{self, Organ};

/// Keys, exactly one of which a table has.
pub(super) const MADE: [&str; 5] = ["organ", "sheet", "tube", "block", "line"];
/// Keys allowed with `organ`.
pub(super) const ORGAN_KEYS: [&str; 5] = ["organ", "edge", "levels", "wall", "scale"];
/// Range and default of the length of an organ's edges \[m\], and of the levels by which they grow inside.
pub(super) const EDGE: (RangeInclusive<f64>, f64) = (1e-4..=0.1, 0.01);
pub(super) const LEVELS: (RangeInclusive<f64>, f64) = (0.0..=4.0, 2.0);

/// A rectangle in the xy plane about the origin.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Sheet {
    /// Lengths of its sides \[m\].
    size: [f64; 2],
    /// Squares along each.
    cells: [u32; 2],
}

/// A tube without lids along z about the origin: a surface, or a wall of tetrahedra.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Tube {
    /// Radius, of a wall the outer one \[m\].
    radius: f64,
    /// Length \[m\].
    length: f64,
    /// Cells around, and along.
    cells: [u32; 2],
    /// Thickness of its wall \[m\]; without, it is a surface.
    #[serde(default)]
    wall: Option<f64>,
    /// Cells across the wall; default 2.
    #[serde(default)]
    layers: Option<u32>,
}

/// A box about the origin, of tetrahedra.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Block {
    /// Lengths of its edges \[m\].
    size: [f64; 3],
    /// Cubes along each.
    cells: [u32; 3],
}

/// A straight thread along x about the origin.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct Line {
    /// Length \[m\].
    length: f64,
    /// Its segments.
    segments: u32,
    /// Radius of the thread \[m\].
    radius: f64,
}

/// Generates the mesh of the table with the key `key`, one of [`MADE`].
pub(super) fn load(table: &Table, key: &str, value: &Spanned<DeValue>) -> Result<LoadedMesh, ScenarioError> {
    let span = table.get(key).map_or(value.span(), Spanned::span);
    let refused = |error: organs::OrganError| table.error(span.clone(), key, error.to_string());
    let missing = || table.wrong_type(key, value, "a table");
    let count = |number: u32| number as usize;
    if key == "organ" {
        table.only(&ORGAN_KEYS)?;
        let organ = table.value::<Organ>(key)?.ok_or_else(missing)?;
        let edge = table.number("edge", EDGE.0, "1e-4 to 0.1 m")?.unwrap_or(EDGE.1);
        let valid = "a whole number from 0 to 4";
        let levels = table.number("levels", LEVELS.0, valid)?.unwrap_or(LEVELS.1);
        if levels.fract() != 0.0 {
            let span = table.get("levels").map_or(value.span(), Spanned::span);
            return Err(table.error(span, "levels", format!("{levels} is not {valid}")));
        }
        let wall = table.number("wall", 1e-4..=0.1, "1e-4 to 0.1 m")?;
        let scale = table.number("scale", 0.01..=100.0, "0.01 to 100")?.unwrap_or(1.0);
        // Edges and walls are those of the scaled organ.
        let body = organs::Implicit { wall: wall.map(|wall| wall / scale), ..organ.implicit() };
        let volume = organs::tetrahedra(&body, edge / scale, levels as u8).map_err(refused)?;
        return Ok(from_tets(volume.scaled(scale)));
    }
    table.only(&[key])?;
    match key {
        "sheet" => {
            let Sheet { size, cells } = table.value(key)?.ok_or_else(missing)?;
            Ok(from_surface(organs::sheet(size, cells.map(count)).map_err(refused)?))
        }
        "tube" => {
            let Tube { radius, length, cells: [around, along], wall, layers } =
                table.value(key)?.ok_or_else(missing)?;
            if let Some(wall) = wall {
                let cells = [around, along, layers.unwrap_or(2)].map(count);
                return Ok(from_tets(organs::pipe(radius, wall, length, cells).map_err(refused)?));
            }
            let tube = organs::tube(radius, length, count(around), count(along));
            Ok(from_surface(tube.map_err(refused)?))
        }
        "block" => {
            let Block { size, cells } = table.value(key)?.ok_or_else(missing)?;
            Ok(from_tets(organs::block(size, cells.map(count)).map_err(refused)?))
        }
        _ => {
            let Line { length, segments, radius } = table.value(key)?.ok_or_else(missing)?;
            if !(1e-5..=0.1).contains(&radius) {
                let reason = format!("radius: {radius} is out of range (1e-5 to 0.1 m)");
                return Err(table.error(span, key, reason));
            }
            let (positions, segments) = organs::line(length, count(segments)).map_err(refused)?;
            Ok(LoadedMesh {
                positions: VertexPositions { positions: Arc::new(positions) },
                line: Some(LineMesh { segments: Arc::new(segments), radius }),
                ..LoadedMesh::default()
            })
        }
    }
}
