//! `trocar mesh`: what a mesh file holds and how good it is, a picture of it, and the mended one.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueHint};
use serde_json::{Value, json};
use trocar::app::App;
use trocar::summary::{Exit, SCHEMA};
use trocar_scene::mesh::inspect::{Inspection, MendedMesh, inspect, mend};
use trocar_scene::mesh::write::written;
use trocar_scene::mesh::{Limits, MeshFile, SurfaceFile, TetFile, length, read_mesh, unit};
use trocar_scene::output_file::Claim;
use trocar_scene::{
    Commands, EntityAllocator, Name, Pose, SimTime, Store, SurfaceMesh, VertexPositions, VisualMaterial,
};
use trocar_viewer::{Layout, OffscreenRenderer, Picture, Quality, View};

use crate::args::picture::size;
use crate::failure::Failure;
use crate::output::{self, replace};

/// Longest side of a mesh in its picture \[m\].
const SHOWN: f64 = 0.12;

/// `trocar mesh`.
#[derive(Debug, Args)]
pub struct MeshArgs {
    /// The file: obj, stl, ply, gltf, glb, vtp, msh, vtk or vtu
    #[arg(value_hint = ValueHint::FilePath)]
    pub file: PathBuf,
    /// Metres per unit of the file, as `scale` in a scenario
    #[arg(long, allow_negative_numbers = true, default_value_t = 1.0, value_parser = scale)]
    pub scale: f64,
    /// Mend it as `repair = true` in a scenario would, and write it to the file of `--out`
    #[arg(long, requires = "out")]
    pub repair: bool,
    /// Distance within which vertices become one, in metres [default: a millionth of the box of a surface, 0 of a volume]
    #[arg(long, allow_negative_numbers = true, value_name = "METRES", value_parser = weld)]
    pub weld: Option<f64>,
    /// Where the mended mesh goes, in metres: obj, stl or ply for a surface, msh or vtk for a volume
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, requires = "repair")]
    pub out: Option<PathBuf>,
    /// Overwrite the files of `--out` and `--picture` when they are there
    #[arg(long)]
    pub force: bool,
    /// Picture (PNG); `-` is stdout
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub picture: Option<PathBuf>,
    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "800x600", value_parser = size)]
    pub size: (u32, u32),
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

fn scale(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (1e-9..=1e9).contains(&value) => Ok(value),
        _ => Err("a number from 1e-9 to 1e9 is expected".to_owned()),
    }
}

fn weld(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=0.01).contains(&value) => Ok(value),
        _ => Err("a number of metres from 0 to 0.01 is expected".to_owned()),
    }
}

/// What was written.
struct Written {
    file: PathBuf,
    done: String,
    left: Vec<String>,
}

/// Inspects a file, and mends and draws it when that is asked for.
pub fn mesh(app: &App, args: &MeshArgs) -> Result<Exit, Failure> {
    match inspected(app, args) {
        Err(failure) if args.json => {
            let object = json!({ "schema": SCHEMA, "file": args.file, "error": failure.message });
            output::print_json(&object)?;
            Err(failure)
        }
        done => done,
    }
}

fn inspected(app: &App, args: &MeshArgs) -> Result<Exit, Failure> {
    let read = read_mesh(&args.file, &Limits::default()).map_err(Failure::invalid)?;
    let facts = inspect(&read, args.scale, args.weld);
    let stdout_is_taken = output::takes_stdout(args.json, [args.out.as_deref(), args.picture.as_deref()])?;
    let out = args.out.as_deref().map(|out| take_out(out, args)).transpose()?;
    let picture = match &args.picture {
        Some(file) => {
            Picture::check_name(file)?;
            let claim = Claim::take(file, replace(args.force))?;
            Some((claim, draw(app, &read, &facts, args.scale, args.size)?))
        }
        None => None,
    };
    let mended = out.map(|out| write_mended(&read, out, args)).transpose()?;
    if let Some((claim, picture)) = picture {
        claim.write(&picture.png()?)?;
    }
    if args.json {
        output::print_json(&object(args, &facts, mended.as_ref())?)?;
    } else if stdout_is_taken {
        output::tell(&text(args, &facts, mended.as_ref()));
    } else {
        output::print_text(&text(args, &facts, mended.as_ref()))?;
    }
    // What repair leaves is refused by a scenario that needs a solid.
    let is_left = mended.is_some_and(|mended| !mended.left.is_empty());
    Ok(if is_left { Exit::Failed } else { Exit::Ok })
}

/// Takes the place of the mended mesh, which is never the file that is read.
fn take_out(out: &Path, args: &MeshArgs) -> Result<Claim, Failure> {
    let same = |path: &Path| path.canonicalize().ok();
    if out.exists() && same(out) == same(&args.file) {
        return Err(Failure::usage(format!(
            "{}: --out must be another file than the one read",
            out.display()
        )));
    }
    Ok(Claim::take(out, replace(args.force))?)
}

fn write_mended(read: &MeshFile, claim: Claim, args: &MeshArgs) -> Result<Written, Failure> {
    let out = claim.file().to_owned();
    let at = |error: String| Failure::invalid(format!("{}: {error}", args.file.display()));
    let (mesh, done) = mend(read, args.scale, args.weld).map_err(at)?;
    let extension = out.extension().map(|text| text.to_string_lossy().into_owned()).unwrap_or_default();
    let bytes =
        written(&mesh, &extension).map_err(|error| Failure::usage(format!("{}: {error}", out.display())))?;
    claim.write(&bytes)?;
    let again = match mesh {
        MendedMesh::Surface(surface) => MeshFile::Surface(SurfaceFile { surface, ..SurfaceFile::default() }),
        MendedMesh::Volume(volume) => MeshFile::Volume(TetFile { volume, ..TetFile::default() }),
    };
    let left = inspect(&again, 1.0, args.weld).defects;
    Ok(Written { file: out, done, left })
}

/// Draws the surface, or the boundary of the volume, in the size of a hand.
fn draw(
    app: &App,
    read: &MeshFile,
    facts: &Inspection,
    scale: f64,
    (width, height): (u32, u32),
) -> Result<Picture, Failure> {
    let (positions, triangles) = match read {
        MeshFile::Surface(read) => (&read.surface.positions, read.surface.triangles.clone()),
        MeshFile::Volume(read) => (&read.volume.positions, read.volume.boundary_triangles()),
    };
    let extent = facts.size_m.iter().copied().fold(0.0, f64::max);
    let factor = if extent > 0.0 { SHOWN / extent } else { 1.0 };
    let middle = [0, 1, 2].map(|k| 0.5 * (facts.min_m[k] + facts.max_m[k]));
    let shown = positions.iter().map(|p| {
        let mut point = *p;
        (0..3).for_each(|k| point[k] = (p[k] * scale - middle[k]) * factor);
        point
    });
    let registry = app.registry().clone();
    let mut commands = Commands::new(registry.clone(), EntityAllocator::new(0, 0));
    let entity = commands.spawn();
    commands.put(entity, Name("mesh".into()));
    commands.put(entity, Pose::default());
    commands.put(entity, VertexPositions { positions: Arc::new(shown.collect()) });
    commands.put(entity, SurfaceMesh { triangles: Arc::new(triangles) });
    let base_color = [0.72, 0.48, 0.42, 1.0];
    commands.put(entity, VisualMaterial { base_color, roughness: 0.5, ..VisualMaterial::default() });
    commands.seal();
    let mut store = Store::new(registry);
    store.apply(&mut commands, SimTime::ZERO);
    let mut renderer = OffscreenRenderer::new(None)?;
    renderer.quality = Quality::FINE;
    let scene = store.view();
    let view = View::default_of(scene, Some(f64::from(width) / f64::from(height)));
    Ok(renderer.picture(scene, &view, &Layout::Mono, [width, height])?)
}

fn object(args: &MeshArgs, facts: &Inspection, mended: Option<&Written>) -> Result<Value, Failure> {
    let mut object = json!({
        "schema": SCHEMA,
        "file": args.file,
        "scale": args.scale,
        "picture": args.picture,
        "written": mended.map(|mended| json!({
            "file": mended.file, "done": mended.done, "left": mended.left,
        })),
        "error": null,
    });
    let facts = serde_json::to_value(facts).map_err(Failure::internal)?;
    if let (Some(object), Value::Object(facts)) = (object.as_object_mut(), facts) {
        object.extend(facts);
    }
    Ok(object)
}

fn text(args: &MeshArgs, facts: &Inspection, mended: Option<&Written>) -> String {
    let mut rows: Vec<(&str, String)> = Vec::new();
    let counts = match facts.kind {
        "volume" => format!(
            "{} tetrahedra, {} nodes, {} triangles at the boundary",
            facts.tetrahedra, facts.vertices, facts.triangles
        ),
        _ => format!("{} triangles, {} vertices", facts.triangles, facts.vertices),
    };
    rows.push((facts.kind, counts));
    if facts.unused_vertices > 0 {
        rows.push(("unused", format!("{} vertices that nothing uses", facts.unused_vertices)));
    }
    let sides: Vec<String> = facts.size_m.iter().map(|side| length(*side)).collect();
    let [x, y, z] = facts.min_m;
    let unit = unit(args.scale).map_or_else(|| format!("{} m", args.scale), |unit| format!("the {unit}"));
    rows.push(("box", format!("{}, from ({x}, {y}, {z}) m; the unit is {unit}", sides.join(" × "))));
    rows.extend(facts.unit_doubt.iter().map(|doubt| ("size", doubt.clone())));
    rows.push(("area", format!("{:.4e} m²", facts.area_m2)));
    rows.push((
        "volume",
        facts.volume_m3.map_or("none: it is not closed".into(), |volume| format!("{volume:.4e} m³")),
    ));
    let yes = |yes: bool| if yes { "yes" } else { "no" };
    rows.push(("closed", yes(facts.closed).into()));
    let oriented = match (facts.kind, facts.inside_out) {
        (_, 0) => yes(facts.oriented).to_owned(),
        ("volume", count) => format!("{count} inverted tetrahedra"),
        (_, count) => format!("{count} shells inside out"),
    };
    rows.push(("oriented", oriented));
    rows.push(("pieces", facts.pieces.to_string()));
    if let [_, _, ..] = facts.shells.as_slice() {
        rows.extend(facts.shells.iter().take(8).map(|shell| {
            let inside = shell.volume_m3.map_or("open".into(), |volume| format!("{volume:.4e} m³"));
            ("shell", format!("{} triangles from {}: {inside}", shell.triangles, shell.first))
        }));
    }
    if let Some(quality) = &facts.quality {
        rows.push((
            "shapes",
            format!(
                "mean ratio {:.3} at least, {:.3} in the mean; angles {:.1}° to {:.1}°; edges {} to {}",
                quality.mean_ratio_min,
                quality.mean_ratio_mean,
                quality.dihedral_min_deg,
                quality.dihedral_max_deg,
                length(quality.edge_min_m),
                length(quality.edge_max_m)
            ),
        ));
        rows.extend(quality.worst.iter().map(|worst| {
            let ([least, most], [x, y, z]) = (worst.dihedral_deg, worst.at_m);
            let place = format!("at ({x:.5}, {y:.5}, {z:.5}) m");
            let shape = format!("mean ratio {:.3}, angles {least:.1}° to {most:.1}°", worst.mean_ratio);
            ("worst", format!("tetrahedron {} {place}: {shape}", worst.number))
        }));
    }
    rows.extend(facts.regions.iter().map(|region| {
        ("region", format!("{}: {} tetrahedra, {:.4e} m³", region.name, region.tetrahedra, region.volume_m3))
    }));
    rows.extend(facts.notes.iter().map(|note| ("note", note.clone())));
    rows.extend(facts.defects.iter().map(|defect| ("defect", defect.clone())));
    rows.extend(facts.repair.iter().map(|repair| ("repair", repair.clone())));
    if facts.defects.is_empty() {
        rows.push(("defects", "none: it can be a solid".into()));
    }
    if let Some(mended) = mended {
        rows.push(("written", format!("{}: {}", mended.file.display(), mended.done)));
        rows.extend(mended.left.iter().map(|left| ("left", left.clone())));
    }
    rows.extend(args.picture.iter().map(|file| ("picture", file.display().to_string())));
    let lines: Vec<String> = rows.iter().map(|(what, told)| format!("  {what:<9}{told}")).collect();
    format!("{}\n{}", args.file.display(), lines.join("\n"))
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;
    use trocar_scene::mesh::EXTENSIONS;
    use trocar_scene::mesh::write::{SURFACE_OUTPUTS, VOLUME_OUTPUTS};

    use super::*;
    use crate::args::Cli;

    #[test]
    fn the_help_names_what_is_read_and_written() {
        let mut help = Cli::command();
        let text = help.find_subcommand_mut("mesh").expect("a command").render_long_help().to_string();
        let lists = [EXTENSIONS, SURFACE_OUTPUTS, VOLUME_OUTPUTS];
        for extension in lists.iter().flat_map(|list| list.split(", ")) {
            assert!(text.contains(extension), "{extension} is missing in {text}");
        }
    }

    #[test]
    fn numbers_are_checked() {
        assert_eq!((scale("0.001"), weld("0")), (Ok(0.001), Ok(0.0)));
        for wrong in ["0", "-1", "nan", "1e10", "x"] {
            assert!(scale(wrong).is_err(), "{wrong}");
        }
        for wrong in ["-1", "nan", "1", "x"] {
            assert!(weld(wrong).is_err(), "{wrong}");
        }
    }
}
