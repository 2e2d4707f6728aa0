//! `mesh = { file = … }` or `mesh = { shape = … }` at an entity: a mesh file, or the surface of a shape, as components;
//! other generated meshes are in [`procedural_mesh`].

use std::path::Path;
use std::sync::Arc;

use nalgebra::{Point3, Vector2};
use toml::Spanned;
use toml::de::DeValue;

use super::document::Table;
use super::error::ScenarioError;
use super::procedural_mesh;
use crate::commands::Commands;
use crate::components::{
    LineMesh, MeshRemarks, MeshRepaired, Shape, SurfaceMesh, TetMesh, TetRegions, TextureCoordinates,
    VertexPositions,
};
use crate::confined_path::Assets;
use crate::entity::Entity;
use crate::mesh::{
    BadTets, Defect, EXTENT_MAX, Limits, MeshError, MeshFile, MeshRules, SurfaceData, SurfaceFile,
    SurfacePolicy, TISSUE_EXTENT_MAX, TetData, TetFile, doubt_of_size, read_line, read_mesh,
    repaired_surface, repaired_tets, tet_defects, validate_surface, validate_tets, weld_tolerance,
};
use crate::shapes::{Detail, surface_of};

/// Keys of the table of a file, and of a shape.
pub(super) const KEYS: [&str; 6] = ["file", "scale", "repair", "weld", "require", "radius"];
pub(super) const SHAPE_KEYS: [&str; 2] = ["shape", "segments"];
/// Distance within which repair makes vertices one \[m\].
pub(super) const WELD: std::ops::RangeInclusive<f64> = 0.0..=0.01;
/// Values of `require`.
pub(super) const REQUIREMENTS: [&str; 3] = ["solid", "manifold", "any"];
/// Components provided by a mesh file, which the entity must therefore not declare itself.
pub(super) const PROVIDED: [&str; 6] =
    ["surface_mesh", "tet_mesh", "tet_regions", "line_mesh", "vertex_positions", "texture_coordinates"];

/// The components that a mesh file became. Payloads are shared.
#[derive(Clone, Debug, Default)]
pub(super) struct LoadedMesh {
    pub positions: VertexPositions,
    pub surface: Option<SurfaceMesh>,
    pub tets: Option<TetMesh>,
    pub regions: Option<TetRegions>,
    pub line: Option<LineMesh>,
    pub uv: Option<TextureCoordinates>,
    /// Repairs, if they were requested and necessary.
    pub repaired: Option<MeshRepaired>,
    /// What is worth knowing besides.
    pub remarks: Vec<String>,
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
        if let Some(regions) = &self.regions {
            commands.put(entity, regions.clone());
        }
        if !self.remarks.is_empty() {
            commands.put(entity, MeshRemarks { remarks: self.remarks.clone() });
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

/// Loads the mesh of an entity's `mesh` table. `table` is that table, `value` its position; `is_tissue` tells how large the
/// mesh may be before its unit is doubted.
pub(super) fn load(
    folder: &Path,
    assets: &Assets,
    table: &Table,
    value: &Spanned<DeValue>,
    is_tissue: bool,
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
    let (written, span) = table.string("file")?.unwrap_or(("", value.span()));
    let path = assets.find(folder, written).map_err(|why| table.error(span.clone(), "file", why))?;
    let scale = table.number("scale", 1e-9..=1e9, "1e-9 to 1e9 metres per unit of the file")?.unwrap_or(1.0);
    let repair = table.value::<bool>("repair")?.unwrap_or(false);
    let weld = table.number("weld", WELD, "0 to 0.01 m")?;
    if let Some(given) = table.get("weld").filter(|_| !repair) {
        return Err(table.error(given.span(), "weld", "is of 'repair = true', which is missing"));
    }
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
    let limits = Limits::default();
    let mut loaded = if let Some(radius) = table.number("radius", 1e-6..=1.0, "1e-6 to 1 m")? {
        // A given radius selects the lines of the file.
        for other in ["repair", "require"] {
            if let Some(given) = table.get(other) {
                let reason = "is of surfaces and volumes, 'radius' of lines";
                return Err(table.error(given.span(), other, reason));
            }
        }
        let mut line = read_line(&path, &limits).map_err(refused)?.scaled(scale);
        line.compact();
        LoadedMesh {
            positions: VertexPositions { positions: Arc::new(line.positions) },
            line: Some(LineMesh { segments: Arc::new(line.segments), radius }),
            ..LoadedMesh::default()
        }
    } else {
        let asked = Asked { path: &path, scale, repair, weld, require };
        match read_mesh(&path, &limits).map_err(refused)? {
            MeshFile::Surface(read) => asked.surface(read).map_err(refused)?,
            MeshFile::Volume(read) => asked.volume(read).map_err(refused)?,
        }
    };
    let extent_max = if is_tissue || loaded.tets.is_some() { TISSUE_EXTENT_MAX } else { EXTENT_MAX };
    loaded.remarks.extend(doubt_of_size(extent(&loaded.positions.positions), scale, extent_max));
    Ok(loaded)
}

/// The longest side of the box \[m\].
fn extent(positions: &[Point3<f64>]) -> f64 {
    let Some(first) = positions.first() else { return 0.0 };
    let (min, max) = positions.iter().fold((*first, *first), |(min, max), p| (min.inf(p), max.sup(p)));
    (max - min).max()
}

/// What a scenario asks for besides the file.
struct Asked<'a> {
    path: &'a Path,
    scale: f64,
    repair: bool,
    weld: Option<f64>,
    require: &'a str,
}

impl Asked<'_> {
    fn refuse(&self, reason: String) -> MeshError {
        MeshError::Refused { file: self.path.into(), reason }
    }

    fn surface(&self, mut read: SurfaceFile) -> Result<LoadedMesh, MeshError> {
        read.surface = std::mem::take(&mut read.surface).scaled(self.scale);
        let policy = match self.require {
            "solid" => SurfacePolicy::SOLID,
            "manifold" => SurfacePolicy { closed: false, outward: false, ..SurfacePolicy::SOLID },
            _ => SurfacePolicy::ANY,
        };
        let mend = || {
            let weld = self.weld.unwrap_or_else(|| weld_tolerance(&read.surface.positions));
            repaired_surface(&read.surface, weld)
        };
        let place = |triangle: usize| read.triangle(triangle);
        if self.repair {
            let (mended, repairs) = mend();
            // What is left has numbers of its own: places of the file would be wrong.
            policy.require(self.path, &validate_surface(&mended)).map_err(|error| {
                let MeshError::Refused { reason, .. } = error else { return error };
                self.refuse(format!("'repair' cannot mend it: {reason}, after {}", repairs.told(place)))
            })?;
            let told = (!repairs.is_empty()).then(|| MeshRepaired { what: repairs.told(place) });
            return Ok(LoadedMesh { repaired: told, remarks: read.notes.clone(), ..from_surface(mended) });
        }
        let report = validate_surface(&read.surface);
        if let Some(reason) = policy.refusal_of(&report, &read) {
            let (mended, repairs) = mend();
            let left = policy.require(self.path, &validate_surface(&mended));
            let remedy = match left {
                Ok(()) => format!("'repair = true' mends it: {}", repairs.told(place)),
                Err(MeshError::Refused { reason, .. }) => format!("'repair = true' would leave: {reason}"),
                Err(other) => other.to_string(),
            };
            let inner = match report.inside_out.count {
                0 => "",
                _ => "; 'require = \"manifold\"' takes it as a wall that is seen from inside",
            };
            return Err(self.refuse(format!("{reason}. {remedy}{inner}")));
        }
        let mut remarks = read.notes.clone();
        if report.boundary_edges.count > 0 {
            let (_, repairs) = mend();
            if !repairs.welded.is_empty() {
                let count = repairs.welded.len();
                remarks.push(format!(
                    "{count} of its vertices lie where others are, and it falls apart there: 'repair = true' welds them"
                ));
            }
        }
        Ok(LoadedMesh { remarks, ..from_surface(read.surface) })
    }

    fn volume(&self, mut read: TetFile) -> Result<LoadedMesh, MeshError> {
        read.volume = std::mem::take(&mut read.volume).scaled(self.scale);
        let rules = MeshRules::default();
        let rules = MeshRules { coincident_within: self.weld.or(rules.coincident_within), ..rules };
        let mend = || repaired_tets(&read.volume.positions, &read.volume.tets, &rules);
        let mut volume = read.volume.clone();
        let mut repaired = None;
        if self.repair {
            let (positions, tets, repairs) = mend().map_err(|bad| {
                self.refuse(format!("'repair' cannot mend it: {}", read.in_its_numbers(bad)))
            })?;
            let kept = repairs.kept_tets.iter();
            let tags = kept.map(|&tet| volume.tags.get(tet as usize).copied().unwrap_or_default()).collect();
            volume = TetData { positions, tets, tags };
            repaired = (!repairs.is_empty()).then(|| MeshRepaired { what: read.told(&repairs) });
        } else {
            let defects: Vec<Defect> = tet_defects(&volume.positions, &volume.tets, &rules)
                .into_iter()
                .filter(|defect| match defect {
                    Defect::Unreferenced { .. } => false,
                    Defect::Inverted { .. } => self.require == "solid",
                    _ => self.require != "any",
                })
                .collect();
            if !defects.is_empty() {
                let bad = read.in_its_numbers(BadTets { defects });
                let remedy = match mend() {
                    Ok((.., repairs)) => format!("'repair = true' mends it: {}", read.told(&repairs)),
                    Err(left) => format!("'repair = true' would leave: {}", read.in_its_numbers(left)),
                };
                return Err(self.refuse(format!("{bad}. {remedy}")));
            }
        }
        let mut remarks = read.notes.clone();
        let unused = volume.compact();
        if unused > 0 {
            remarks.push(format!("{unused} nodes that no tetrahedron uses were left out"));
        }
        let pieces = validate_tets(&volume).components;
        if pieces > 1 {
            remarks.push(format!("it is of {pieces} pieces that share no face"));
        }
        let regions = read.has_regions.then(|| regions_of(&volume, &read));
        Ok(LoadedMesh { repaired, remarks, regions, ..from_tets(volume) })
    }
}

/// The regions of a volume, which has those of a file in part or all, in the order of their numbers.
fn regions_of(volume: &TetData, read: &TetFile) -> TetRegions {
    let mut tags = volume.tags.clone();
    tags.sort_unstable();
    tags.dedup();
    tags.truncate(usize::from(u16::MAX));
    let name = |tag: &i32| read.region_names.get(tag).cloned().unwrap_or_else(|| tag.to_string());
    let of_tet = volume.tags.iter().map(|tag| tags.binary_search(tag).unwrap_or(0) as u16).collect();
    TetRegions { names: Arc::new(tags.iter().map(name).collect()), of_tet: Arc::new(of_tet) }
}

pub(super) fn from_tets(volume: TetData) -> LoadedMesh {
    let boundary = volume.boundary_triangles();
    LoadedMesh {
        surface: Some(SurfaceMesh { triangles: Arc::new(boundary) }),
        tets: Some(TetMesh { tets: Arc::new(volume.tets) }),
        positions: VertexPositions { positions: Arc::new(volume.positions) },
        ..LoadedMesh::default()
    }
}

pub(super) fn from_surface(surface: SurfaceData) -> LoadedMesh {
    let uv = vertex_uvs(&surface).map(|uv| TextureCoordinates { uv: Arc::new(uv) });
    LoadedMesh {
        positions: VertexPositions { positions: Arc::new(surface.positions) },
        surface: Some(SurfaceMesh { triangles: Arc::new(surface.triangles) }),
        uv,
        ..LoadedMesh::default()
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
