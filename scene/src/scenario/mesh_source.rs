//! `mesh = { file = … }` or `mesh = { shape = … }` at an entity: a mesh file, or the surface of a shape, as components;
//! other generated meshes are in [`procedural_mesh`].

use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector2;
use toml::Spanned;
use toml::de::DeValue;

use super::document::Table;
use super::error::ScenarioError;
use super::procedural_mesh;
use crate::commands::Commands;
use crate::components::{
    LineMesh, MeshRepaired, Shape, SurfaceMesh, TetMesh, TextureCoordinates, VertexPositions,
};
use crate::confined_path;
use crate::entity::Entity;
use crate::mesh::{
    BadTets, Limits, MeshError, MeshRules, Repairs, SURFACE_EXTENSIONS, SurfaceData, SurfacePolicy,
    TET_EXTENSIONS, TetData, TetPolicy, read_line, read_surface, read_tets, repaired_tets, tet_defects,
    validate_surface, validate_tets,
};
use crate::shapes::{Detail, surface_of};

/// Keys of the table of a file, and of a shape.
pub(super) const KEYS: [&str; 5] = ["file", "scale", "repair", "require", "radius"];
pub(super) const SHAPE_KEYS: [&str; 2] = ["shape", "segments"];
/// Values of `require`.
pub(super) const REQUIREMENTS: [&str; 3] = ["solid", "manifold", "any"];
/// Components provided by a mesh file, which the entity must therefore not declare itself.
pub(super) const PROVIDED: [&str; 5] =
    ["surface_mesh", "tet_mesh", "line_mesh", "vertex_positions", "texture_coordinates"];

/// The components that a mesh file became. Payloads are shared.
#[derive(Clone, Debug)]
pub(super) struct LoadedMesh {
    pub positions: VertexPositions,
    pub surface: Option<SurfaceMesh>,
    pub tets: Option<TetMesh>,
    pub line: Option<LineMesh>,
    pub uv: Option<TextureCoordinates>,
    /// Repairs, if they were requested and necessary.
    pub repaired: Option<MeshRepaired>,
}

impl LoadedMesh {
    pub fn put(&self, commands: &mut Commands, entity: Entity) {
        commands.put(entity, self.positions.clone());
        if let Some(surface) = &self.surface {
            commands.put(entity, surface.clone());
        }
        if let Some(line) = &self.line {
            commands.put(entity, line.clone());
        }
        if let Some(tets) = &self.tets {
            commands.put(entity, tets.clone());
        }
        if let Some(uv) = &self.uv {
            commands.put(entity, uv.clone());
        }
        if let Some(repaired) = &self.repaired {
            commands.put(entity, repaired.clone());
        }
    }
}

/// The surface of a shape with the requested tessellation, so that bodies with surface-based detection need no file.
fn shaped(table: &Table, value: &Spanned<DeValue>) -> Result<LoadedMesh, ScenarioError> {
    table.only(&SHAPE_KEYS)?;
    let span = table.get("shape").map_or(value.span(), Spanned::span);
    let Some(shape) = table.value::<Shape>("shape")? else {
        return Err(table.wrong_type("shape", value, "a shape"));
    };
    let default = Detail::default();
    let valid = "a whole number from 8 to 512";
    let segments = table.number("segments", 8.0..=512.0, valid)?.unwrap_or(default.segments as f64);
    if segments.fract() != 0.0 {
        let span = table.get("segments").map_or(value.span(), Spanned::span);
        return Err(table.error(span, "segments", format!("{segments} is not {valid}")));
    }
    let segments = segments as usize;
    let detail = Detail { segments, fine_segments: (segments / 4).max(3) };
    let surface =
        surface_of(&shape, &detail).map_err(|error| table.error(span, "shape", error.to_string()))?;
    Ok(from_surface(surface))
}

/// Loads the mesh of an entity's `mesh` table. `table` is that table, `value` its position.
pub(super) fn load(
    folder: &Path,
    table: &Table,
    value: &Spanned<DeValue>,
) -> Result<LoadedMesh, ScenarioError> {
    if table.get("shape").is_some() {
        return shaped(table, value);
    }
    if let Some(key) = procedural_mesh::MADE.into_iter().find(|key| table.get(key).is_some()) {
        return procedural_mesh::load(table, key, value);
    }
    table.only(&[&KEYS[..], &SHAPE_KEYS[..1], &procedural_mesh::MADE[..]].concat())?;
    if table.get("file").is_none() {
        let one_of = [&["file", "shape"], &procedural_mesh::MADE[..]].concat().join(", ");
        return Err(table.error(value.span(), "", format!("one of {one_of} is missing")));
    }
    let (relative, span) = table.string("file")?.unwrap_or(("", value.span()));
    let file =
        confined_path::below(folder, relative).map_err(|why| table.error(span.clone(), "file", why))?;
    let scale = table.number("scale", 1e-9..=1e9, "1e-9 to 1e9 metres per unit of the file")?.unwrap_or(1.0);
    let repair = table.value::<bool>("repair")?.unwrap_or(false);
    let require = table.string("require")?.map_or(REQUIREMENTS[0], |(text, _)| text);
    if !REQUIREMENTS.contains(&require) {
        let span = table.get("require").map_or(value.span(), Spanned::span);
        let reason = format!("'{}' is none of: {}", super::document::shown(require), REQUIREMENTS.join(", "));
        return Err(table.error(span, "require", reason));
    }
    let refused = |source: MeshError| {
        let (line, column) = table.source.line_and_column(span.start);
        let key = super::document::join(table.key, "file");
        ScenarioError::Mesh { file: table.source.file.clone(), line, column, key, source: Box::new(source) }
    };
    let extension = file.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let listed = |list: &str| list.split(", ").any(|known| known == extension);
    let limits = Limits::default();
    // A given radius selects the lines of the file.
    if let Some(radius) = table.number("radius", 1e-6..=1.0, "1e-6 to 1 m")? {
        for other in ["repair", "require"] {
            if let Some(given) = table.get(other) {
                return Err(table.error(
                    given.span(),
                    other,
                    "is of surfaces and volumes, 'radius' of lines",
                ));
            }
        }
        let mut line = read_line(&file, &limits).map_err(refused)?.scaled(scale);
        line.compact();
        return Ok(LoadedMesh {
            positions: VertexPositions { positions: Arc::new(line.positions) },
            surface: None,
            tets: None,
            line: Some(LineMesh { segments: Arc::new(line.segments), radius }),
            uv: None,
            repaired: None,
        });
    }
    if listed(TET_EXTENSIONS) {
        let volume = read_tets(&file, &limits).map_err(refused)?.scaled(scale);
        let because = |reason| MeshError::Refused { file: file.clone(), reason };
        let (volume, repairs) = if repair {
            mended(volume).map_err(|bad| refused(because(format!("'repair' cannot mend it: {bad}"))))?
        } else {
            let mut volume = volume;
            volume.compact();
            (volume, Repairs::default())
        };
        let policy = match require {
            "solid" => TetPolicy::SOLID,
            "manifold" => TetPolicy { no_inverted: false, ..TetPolicy::SOLID },
            _ => TetPolicy::ANY,
        };
        policy.require(&file, &validate_tets(&volume)).map_err(|error| {
            let MeshError::Refused { reason, .. } = error else { return refused(error) };
            refused(because(format!("{reason}. {}", listed_defects(&volume))))
        })?;
        let repaired = (!repairs.is_empty()).then(|| MeshRepaired { what: repairs.to_string() });
        Ok(LoadedMesh { repaired, ..from_tets(volume) })
    } else if listed(SURFACE_EXTENSIONS) {
        if repair {
            let span = table.get("repair").map_or(value.span(), Spanned::span);
            return Err(table.error(span, "repair", format!("is of volumes: {TET_EXTENSIONS}")));
        }
        let surface = read_surface(&file, &limits).map_err(refused)?.scaled(scale);
        let policy = match require {
            "solid" => SurfacePolicy::SOLID,
            "manifold" => SurfacePolicy { closed: false, ..SurfacePolicy::SOLID },
            _ => SurfacePolicy::ANY,
        };
        policy.require(&file, &validate_surface(&surface)).map_err(refused)?;
        Ok(from_surface(surface))
    } else {
        let reason = format!(
            "extension '{extension}' is none of: {SURFACE_EXTENSIONS} (surfaces), {TET_EXTENSIONS} (volumes)"
        );
        Err(table.error(span.clone(), "file", reason))
    }
}

/// A repaired volume, with the repairs.
fn mended(volume: TetData) -> Result<(TetData, Repairs), BadTets> {
    let (positions, tets, repairs) = repaired_tets(&volume.positions, &volume.tets, &MeshRules::default())?;
    let kept = repairs.kept_tets.iter();
    let tags = kept.map(|&tet| volume.tags.get(tet as usize).copied().unwrap_or_default()).collect();
    Ok((TetData { positions, tets, tags }, repairs))
}

/// Message with a volume's defects and advice. Unused points have already been removed.
fn listed_defects(volume: &TetData) -> String {
    let defects = tet_defects(&volume.positions, &volume.tets, &MeshRules::default());
    format!("In all {}. 'repair = true' turns, merges and drops what can be", BadTets { defects })
}

pub(super) fn from_tets(volume: TetData) -> LoadedMesh {
    let boundary = volume.boundary_triangles();
    LoadedMesh {
        surface: Some(SurfaceMesh { triangles: Arc::new(boundary) }),
        line: None,
        tets: Some(TetMesh { tets: Arc::new(volume.tets) }),
        positions: VertexPositions { positions: Arc::new(volume.positions) },
        uv: None,
        repaired: None,
    }
}

pub(super) fn from_surface(surface: SurfaceData) -> LoadedMesh {
    let uv = vertex_uvs(&surface).map(|uv| TextureCoordinates { uv: Arc::new(uv) });
    LoadedMesh {
        positions: VertexPositions { positions: Arc::new(surface.positions) },
        surface: Some(SurfaceMesh { triangles: Arc::new(surface.triangles) }),
        line: None,
        tets: None,
        uv,
        repaired: None,
    }
}

/// One texture coordinate per vertex; for a vertex on a seam the first one of its triangles.
fn vertex_uvs(surface: &SurfaceData) -> Option<Vec<Vector2<f64>>> {
    let corners = surface.uvs.as_ref()?;
    let mut uv: Vec<Option<Vector2<f64>>> = vec![None; surface.positions.len()];
    for (triangle, corners) in surface.triangles.iter().zip(corners) {
        for (&vertex, &corner) in triangle.iter().zip(corners) {
            uv[vertex as usize].get_or_insert(Vector2::from(corner));
        }
    }
    Some(uv.into_iter().map(Option::unwrap_or_default).collect())
}
