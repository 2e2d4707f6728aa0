//! What a mesh file holds, how good it is, and what repair would do: the facts of `trocar mesh FILE`, in SI units.

use nalgebra::Point3;
use serde::Serialize;

use super::data::{SurfaceData, TetData};
use super::file::{MeshFile, SurfaceFile, TetFile};
use super::shells::shells;
use super::surface_repair::{repaired_surface, weld_tolerance};
use super::tet_defects::{BadTets, Defect, MeshRules, mean_ratio, tet_defects};
use super::tet_repair::repaired_tets;
use super::unit::{EXTENT_MAX, TISSUE_EXTENT_MAX, doubt_of_size};
use super::validate::{SurfacePolicy, validate_surface};
use super::validate_tets::validate_tets;

/// How many of the worst elements are listed.
const WORST: usize = 5;
/// Shells that are listed one by one.
const SHELLS_MAX: usize = 100;

/// A mesh file, inspected.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Inspection {
    /// `surface` or `volume`.
    pub kind: &'static str,
    /// Vertices or nodes, those that nothing uses included.
    pub vertices: usize,
    /// Vertices that no element uses.
    pub unused_vertices: usize,
    /// Triangles; of a volume those of its boundary.
    pub triangles: usize,
    /// Tetrahedra; 0 of a surface.
    pub tetrahedra: usize,
    /// Smallest corner of the box \[m\].
    pub min_m: [f64; 3],
    /// Largest corner of the box \[m\].
    pub max_m: [f64; 3],
    /// Sides of the box \[m\].
    pub size_m: [f64; 3],
    /// What is doubtful about the size, with the likely unit.
    pub unit_doubt: Option<String>,
    /// Area of the surface or boundary \[m²\].
    pub area_m2: f64,
    /// Volume \[m³\]: of a surface by the divergence theorem, where it is closed.
    pub volume_m3: Option<f64>,
    /// Whether every edge has two triangles.
    pub closed: bool,
    /// Whether neighbouring triangles agree on their side.
    pub oriented: bool,
    /// Closed shells that are inside out.
    pub inside_out: usize,
    /// Pieces that are connected by edges (surfaces) or faces (volumes), in the order of the file.
    pub pieces: usize,
    /// The first of them, of surfaces.
    pub shells: Vec<ShellFacts>,
    /// What `require = "solid"` refuses; empty when nothing.
    pub defects: Vec<String>,
    /// What `repair = true` would do, or what it would leave.
    pub repair: Option<String>,
    /// Shapes of the tetrahedra.
    pub quality: Option<TetQuality>,
    /// Regions with their number of tetrahedra and volume.
    pub regions: Vec<RegionFacts>,
    /// What the reader took otherwise than it is written.
    pub notes: Vec<String>,
}

/// One shell of a surface.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShellFacts {
    /// Its first triangle, as the file numbers it.
    pub first: String,
    /// Number of triangles.
    pub triangles: usize,
    /// Whether it is closed.
    pub closed: bool,
    /// Area \[m²\].
    pub area_m2: f64,
    /// Volume \[m³\], negative when it faces inwards; of a closed one.
    pub volume_m3: Option<f64>,
}

/// Shapes of tetrahedra: a regular one has the mean ratio 1 and angles of 70.5°.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TetQuality {
    /// Least mean ratio (Liu, Joe 1994).
    pub mean_ratio_min: f64,
    /// Its mean over the elements.
    pub mean_ratio_mean: f64,
    /// Least angle between two faces \[°\].
    pub dihedral_min_deg: f64,
    /// Largest angle between two faces \[°\].
    pub dihedral_max_deg: f64,
    /// Shortest edge \[m\].
    pub edge_min_m: f64,
    /// Longest edge \[m\].
    pub edge_max_m: f64,
    /// The worst elements by mean ratio, as the file numbers them.
    pub worst: Vec<WorstTet>,
}

/// One of the worst tetrahedra.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WorstTet {
    /// Its number in the file.
    pub number: u64,
    /// Its mean ratio, negative when it is inverted.
    pub mean_ratio: f64,
    /// Its least and largest angle between two faces \[°\].
    pub dihedral_deg: [f64; 2],
    /// Its middle \[m\].
    pub at_m: [f64; 3],
}

/// One region of a volume.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RegionFacts {
    /// Its name, or number.
    pub name: String,
    /// Number of tetrahedra.
    pub tetrahedra: usize,
    /// Volume \[m³\].
    pub volume_m3: f64,
}

/// Inspects what a reader returned, every coordinate multiplied by `scale`; `weld` is the tolerance of repair \[m\].
#[must_use]
pub fn inspect(file: &MeshFile, scale: f64, weld: Option<f64>) -> Inspection {
    match file {
        MeshFile::Surface(read) => {
            let scaled = SurfaceFile { surface: read.surface.clone().scaled(scale), ..read.clone() };
            surface(&scaled, scale, weld)
        }
        MeshFile::Volume(read) => {
            let scaled = TetFile { volume: read.volume.clone().scaled(scale), ..read.clone() };
            volume(&scaled, scale, weld)
        }
    }
}

fn bounds(positions: &[Point3<f64>], used: impl Iterator<Item = u32>) -> (Point3<f64>, Point3<f64>) {
    let mut bounds: Option<(Point3<f64>, Point3<f64>)> = None;
    for vertex in used {
        let p = positions[vertex as usize];
        bounds = Some(bounds.map_or((p, p), |(min, max)| (min.inf(&p), max.sup(&p))));
    }
    bounds.unwrap_or_default()
}

fn surface(read: &SurfaceFile, scale: f64, weld: Option<f64>) -> Inspection {
    let surface = &read.surface;
    let report = validate_surface(surface);
    let found = shells(surface);
    let defect = SurfacePolicy::SOLID.refusal_of(&report, read);
    let repair = defect.is_some().then(|| {
        let weld = weld.unwrap_or_else(|| weld_tolerance(&surface.positions));
        let (mended, repairs) = repaired_surface(surface, weld);
        let left = SurfacePolicy::SOLID.require(std::path::Path::new(""), &validate_surface(&mended));
        let done = repairs.told(|triangle| read.triangle(triangle));
        match left {
            Ok(()) => format!("mends it: {done}"),
            Err(error) => format!("would leave{error}, after {done}"),
        }
    });
    let closed = report.is_closed();
    let (min, max) = bounds(&surface.positions, surface.triangles.iter().flatten().copied());
    let shells = found.shells.iter().take(SHELLS_MAX).map(|shell| ShellFacts {
        first: read.triangle(shell.first),
        triangles: shell.triangles,
        closed: shell.closed,
        area_m2: shell.area,
        volume_m3: shell.closed.then_some(shell.volume),
    });
    Inspection {
        kind: "surface",
        vertices: report.vertices,
        unused_vertices: report.unreferenced.count,
        triangles: report.triangles,
        tetrahedra: 0,
        min_m: min.into(),
        max_m: max.into(),
        size_m: (max - min).into(),
        unit_doubt: doubt_of_size((max - min).max(), scale, EXTENT_MAX),
        area_m2: surface.area(),
        volume_m3: closed.then(|| surface.volume()),
        closed,
        oriented: report.is_oriented(),
        inside_out: report.inside_out.count,
        pieces: report.components,
        shells: shells.collect(),
        defects: defect
            .into_iter()
            .flat_map(|all| all.split("; ").map(str::to_owned).collect::<Vec<_>>())
            .collect(),
        repair,
        quality: None,
        regions: Vec::new(),
        notes: read.notes.clone(),
    }
}

fn volume(read: &TetFile, scale: f64, weld: Option<f64>) -> Inspection {
    let volume = &read.volume;
    let report = validate_tets(volume);
    let mut rules = MeshRules::default();
    rules.coincident_within = weld.or(rules.coincident_within);
    let defects: Vec<Defect> = tet_defects(&volume.positions, &volume.tets, &rules)
        .into_iter()
        .filter(|defect| !matches!(defect, Defect::Unreferenced { .. }))
        .collect();
    let repair =
        (!defects.is_empty()).then(|| match repaired_tets(&volume.positions, &volume.tets, &rules) {
            Ok((.., repairs)) => format!("mends it: {}", read.told(&repairs)),
            Err(left) => format!("would leave: {}", read.in_its_numbers(left)),
        });
    let bad = read.in_its_numbers(BadTets { defects });
    let (boundary, _) = volume.boundary();
    let faces = validate_surface(&boundary);
    let (min, max) = bounds(&volume.positions, volume.tets.iter().flatten().copied());
    Inspection {
        kind: "volume",
        vertices: report.vertices,
        unused_vertices: report.unreferenced.count,
        triangles: boundary.triangles.len(),
        tetrahedra: report.tets,
        min_m: min.into(),
        max_m: max.into(),
        size_m: (max - min).into(),
        unit_doubt: doubt_of_size((max - min).max(), scale, TISSUE_EXTENT_MAX),
        area_m2: boundary.area(),
        volume_m3: Some(report.volume),
        closed: faces.is_closed(),
        oriented: report.inverted.count == 0,
        inside_out: report.inverted.count,
        pieces: report.components,
        shells: Vec::new(),
        defects: bad.by_kind(),
        repair,
        quality: quality(read),
        regions: regions(read),
        notes: read.notes.clone(),
    }
}

/// The angles between the faces of a tetrahedron, least and largest \[°\].
fn dihedral(volume: &TetData, tet: usize) -> [f64; 2] {
    let corners = volume.tets[tet].map(|v| volume.positions[v as usize]);
    let mut range = [180f64, 0f64];
    for i in 0..4 {
        for j in i + 1..4 {
            let rest: Vec<usize> = (0..4).filter(|&k| k != i && k != j).collect();
            let along = (corners[j] - corners[i]).try_normalize(0.0).unwrap_or_default();
            let across = |k: usize| {
                let to = corners[k] - corners[i];
                to - along * to.dot(&along)
            };
            let angle = across(rest[0]).angle(&across(rest[1])).to_degrees();
            range = [range[0].min(angle), range[1].max(angle)];
        }
    }
    range
}

fn quality(read: &TetFile) -> Option<TetQuality> {
    let volume = &read.volume;
    let ratios: Vec<f64> = volume.tets.iter().map(|tet| mean_ratio(&volume.positions, tet)).collect();
    let mut order: Vec<usize> = (0..ratios.len()).collect();
    order.sort_by(|&a, &b| ratios[a].total_cmp(&ratios[b]));
    let worst = order.iter().take(WORST).map(|&tet| {
        let sum: nalgebra::Vector3<f64> =
            volume.tets[tet].iter().map(|&v| volume.positions[v as usize].coords).sum();
        WorstTet {
            number: read.elements.get(tet).copied().unwrap_or(tet as u64),
            mean_ratio: ratios[tet],
            dihedral_deg: dihedral(volume, tet),
            at_m: (sum / 4.0).into(),
        }
    });
    let first = *order.first()?;
    let mut angles = [180f64, 0f64];
    let mut edges = [f64::INFINITY, 0f64];
    for tet in 0..volume.tets.len() {
        let [least, largest] = dihedral(volume, tet);
        angles = [angles[0].min(least), angles[1].max(largest)];
        let corners = volume.tets[tet].map(|v| volume.positions[v as usize]);
        for i in 0..4 {
            for j in i + 1..4 {
                let length = (corners[j] - corners[i]).norm();
                edges = [edges[0].min(length), edges[1].max(length)];
            }
        }
    }
    Some(TetQuality {
        mean_ratio_min: ratios[first],
        mean_ratio_mean: ratios.iter().sum::<f64>() / ratios.len() as f64,
        dihedral_min_deg: angles[0],
        dihedral_max_deg: angles[1],
        edge_min_m: edges[0],
        edge_max_m: edges[1],
        worst: worst.collect(),
    })
}

fn regions(read: &TetFile) -> Vec<RegionFacts> {
    if !read.has_regions {
        return Vec::new();
    }
    let mut of: std::collections::BTreeMap<i32, (usize, f64)> = std::collections::BTreeMap::new();
    for (tet, &tag) in read.volume.tags.iter().enumerate() {
        let entry = of.entry(tag).or_default();
        *entry = (entry.0 + 1, entry.1 + read.volume.tet_volume(tet));
    }
    of.into_iter()
        .map(|(tag, (tetrahedra, volume_m3))| {
            let name = read.region_names.get(&tag).cloned().unwrap_or_else(|| tag.to_string());
            RegionFacts { name, tetrahedra, volume_m3 }
        })
        .collect()
}

/// A surface or a volume that was mended, in metres.
#[derive(Clone, Debug, PartialEq)]
pub enum MendedMesh {
    /// Triangles.
    Surface(SurfaceData),
    /// Tetrahedra.
    Volume(TetData),
}

/// Mends what a reader returned, every coordinate multiplied by `scale`; the second value tells what was done.
///
/// # Errors
/// What repair leaves.
pub fn mend(file: &MeshFile, scale: f64, weld: Option<f64>) -> Result<(MendedMesh, String), String> {
    match file {
        MeshFile::Surface(read) => {
            let scaled = read.surface.clone().scaled(scale);
            let weld = weld.unwrap_or_else(|| weld_tolerance(&scaled.positions));
            let (mended, repairs) = repaired_surface(&scaled, weld);
            Ok((MendedMesh::Surface(mended), repairs.told(|triangle| read.triangle(triangle))))
        }
        MeshFile::Volume(read) => {
            let scaled = read.volume.clone().scaled(scale);
            let mut rules = MeshRules::default();
            rules.coincident_within = weld.or(rules.coincident_within);
            let (positions, tets, repairs) = repaired_tets(&scaled.positions, &scaled.tets, &rules)
                .map_err(|left| format!("repair would leave: {}", read.in_its_numbers(left)))?;
            let tag = |&tet: &u32| scaled.tags.get(tet as usize).copied().unwrap_or_default();
            let tags = repairs.kept_tets.iter().map(tag).collect();
            Ok((MendedMesh::Volume(TetData { positions, tets, tags }), read.told(&repairs)))
        }
    }
}
