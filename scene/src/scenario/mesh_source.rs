//! `mesh = { file = … }` at an entity: a mesh file as components.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector2;
use toml::Spanned;
use toml::de::DeValue;

use super::document::Table;
use super::error::ScenarioError;
use crate::commands::Commands;
use crate::components::{SurfaceMesh, TetMesh, TextureCoordinates, VertexPositions};
use crate::confined_path;
use crate::entity::Entity;
use crate::mesh::{
    Limits, MeshError, SURFACE_EXTENSIONS, SurfaceData, SurfacePolicy, TET_EXTENSIONS, TetData, TetPolicy,
    read_surface, read_tets, validate_surface, validate_tets,
};

/// Keys of the table.
pub(super) const KEYS: [&str; 4] = ["file", "scale", "flip_inverted", "require"];
/// Values of `require`.
pub(super) const REQUIREMENTS: [&str; 3] = ["solid", "manifold", "any"];
/// Components that a mesh file provides, and that may therefore not stand beside it.
pub(super) const PROVIDED: [&str; 4] =
    ["surface_mesh", "tet_mesh", "vertex_positions", "texture_coordinates"];

/// The components that a mesh file became. Payloads are shared.
#[derive(Clone, Debug)]
pub(super) struct LoadedMesh {
    positions: VertexPositions,
    surface: SurfaceMesh,
    tets: Option<TetMesh>,
    uv: Option<TextureCoordinates>,
}

impl LoadedMesh {
    pub fn put(&self, commands: &mut Commands, entity: Entity) {
        commands.put(entity, self.positions.clone());
        commands.put(entity, self.surface.clone());
        if let Some(tets) = &self.tets {
            commands.put(entity, tets.clone());
        }
        if let Some(uv) = &self.uv {
            commands.put(entity, uv.clone());
        }
    }
}

/// Reads the file that an entity's `mesh` table names. `table` is that table, `value` where it stands.
pub(super) fn load(
    folder: &Path,
    table: &Table,
    value: &Spanned<DeValue>,
) -> Result<LoadedMesh, ScenarioError> {
    table.only(&KEYS)?;
    table.require("file")?;
    let (relative, span) = table.string("file")?.unwrap_or(("", value.span()));
    let file =
        confined_path::below(folder, relative).map_err(|why| table.error(span.clone(), "file", why))?;
    let scale = table.number("scale", 1e-9..=1e9, "1e-9 to 1e9 metres per unit of the file")?.unwrap_or(1.0);
    let flip_inverted = table.value::<bool>("flip_inverted")?.unwrap_or(false);
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
    if listed(TET_EXTENSIONS) {
        let mut volume = read_tets(&file, &limits).map_err(refused)?.scaled(scale);
        if flip_inverted {
            volume.flip_inverted();
        }
        volume.compact();
        let policy = match require {
            "solid" => TetPolicy::SOLID,
            "manifold" => TetPolicy { no_inverted: false, ..TetPolicy::SOLID },
            _ => TetPolicy::ANY,
        };
        policy.require(&file, &validate_tets(&volume)).map_err(refused)?;
        Ok(from_tets(volume))
    } else if listed(SURFACE_EXTENSIONS) {
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

fn from_tets(volume: TetData) -> LoadedMesh {
    let boundary = volume.boundary_triangles();
    LoadedMesh {
        surface: SurfaceMesh { triangles: Arc::new(boundary) },
        tets: Some(TetMesh { tets: Arc::new(volume.tets) }),
        positions: VertexPositions { positions: Arc::new(volume.positions) },
        uv: None,
    }
}

fn from_surface(surface: SurfaceData) -> LoadedMesh {
    let uv = vertex_uvs(&surface).map(|uv| TextureCoordinates { uv: Arc::new(uv) });
    LoadedMesh {
        positions: VertexPositions { positions: Arc::new(surface.positions) },
        surface: SurfaceMesh { triangles: Arc::new(surface.triangles) },
        tets: None,
        uv,
    }
}

/// One texture coordinate per vertex; of a vertex on a seam the first that its triangles give.
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
