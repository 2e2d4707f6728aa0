//! Which way closed surfaces face: shells, cavities, bodies in bodies, and what a scenario makes of them.

use crate::support as common;
use trocar_scene::confined_path::Assets;
use trocar_scene::mesh::{SurfaceData, repaired_surface, shells, validate_surface};
use trocar_scene::{MeshRemarks, MeshRepaired, Registry, Scenario, SurfaceMesh, VertexPositions, shapes};

/// A torus about a place, of a size, facing outwards or inwards.
fn body(center: [f64; 3], size: f64, outwards: bool) -> SurfaceData {
    let sphere = shapes::surface_of(
        &trocar_scene::Shape::Sphere { radius: size },
        &shapes::Detail { segments: 12, fine_segments: 4 },
    );
    let mut surface = sphere.expect("a sphere");
    surface.positions.iter_mut().for_each(|p| p.coords += nalgebra::Vector3::from(center));
    (surface.normals, surface.uvs) = (None, None);
    if !outwards {
        surface.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    surface
}

/// Middle, radius, and whether it faces outwards.
type Body = ([f64; 3], f64, bool);

fn joined(bodies: &[Body]) -> SurfaceData {
    let mut all = SurfaceData::default();
    bodies.iter().for_each(|&(center, size, outwards)| all.append(&body(center, size, outwards)));
    all
}

const O: [f64; 3] = [0.0; 3];
const AWAY: [f64; 3] = [9.0, 0.0, 0.0];

/// Shells from outside to inside, how many are inside out, and which way each faces after a repair.
#[test]
fn a_shell_is_inside_out_when_it_leaves_less_than_nothing_inside() {
    let cases: [(&str, &[Body], usize, &[bool]); 9] = [
        ("a body", &[(O, 2.0, true)], 0, &[true]),
        ("a body inside out", &[(O, 2.0, false)], 1, &[true]),
        ("a body with a cavity", &[(O, 2.0, true), (O, 1.0, false)], 0, &[true, false]),
        ("the same inside out", &[(O, 2.0, false), (O, 1.0, true)], 1, &[true, false]),
        ("a body in a body", &[(O, 2.0, true), (O, 1.0, true)], 0, &[true, true]),
        ("both inside out", &[(O, 2.0, false), (O, 1.0, false)], 2, &[true, true]),
        ("two apart, one of them inside out", &[(O, 2.0, true), (AWAY, 1.0, false)], 1, &[true, true]),
        ("a stone in a cavity", &[(O, 3.0, true), (O, 2.0, false), (O, 1.0, true)], 0, &[true, false, true]),
        (
            "the stone inside out",
            &[(O, 3.0, true), (O, 2.0, false), (O, 1.0, false)],
            1,
            &[true, false, true],
        ),
    ];
    for (name, bodies, wrong, after) in cases {
        let surface = joined(bodies);
        let found = shells(&surface);
        assert_eq!(found.shells.len(), bodies.len(), "{name}");
        for (shell, &(_, _, outwards)) in found.shells.iter().zip(bodies) {
            assert!(shell.closed && shell.oriented && (shell.volume > 0.0) == outwards, "{name}");
        }
        assert_eq!(validate_surface(&surface).inside_out.count, wrong, "{name}");
        let (mended, repairs) = repaired_surface(&surface, 0.0);
        let facing: Vec<bool> = shells(&mended).shells.iter().map(|shell| shell.volume > 0.0).collect();
        assert_eq!(facing, after, "{name}: {repairs}");
        assert_eq!(validate_surface(&mended).inside_out.count, 0, "{name}");
        assert_eq!(
            repaired_surface(&mended, 0.0),
            (mended.clone(), Default::default()),
            "{name}: not idempotent"
        );
    }
}

/// What a scenario makes of a surface: the volume, what was mended, what is worth knowing.
fn loaded(surface: &SurfaceData, options: &str) -> Result<(f64, Option<String>, Vec<String>), String> {
    let options = format!(", scale = 0.01{options}");
    let (store, organ) = common::load_organ("x.obj", &common::write_obj(surface), &options)?;
    let view = store.view();
    let positions = view.get::<VertexPositions>(organ).expect("vertices").positions.to_vec();
    let triangles = view.get::<SurfaceMesh>(organ).expect("triangles").triangles.to_vec();
    let volume = SurfaceData { positions, triangles, ..SurfaceData::default() }.volume();
    let told = view.get::<MeshRepaired>(organ).map(|repaired| repaired.what.clone());
    let remarks = view.get::<MeshRemarks>(organ).map(|remarks| remarks.remarks.clone());
    Ok((volume, told, remarks.unwrap_or_default()))
}

#[test]
fn a_scenario_refuses_a_solid_that_is_inside_out_and_repair_turns_it_and_says_so() {
    let right = body(O, 2.0, true);
    let turned = body(O, 2.0, false);
    let (volume, told, remarks) = loaded(&right, "").expect("a body");
    assert!(volume > 0.0 && told.is_none() && remarks.is_empty(), "{told:?} {remarks:?}");
    let refused = loaded(&turned, "").expect_err("inside out");
    let text = String::from_utf8(common::write_obj(&turned)).expect("text");
    let first = text.lines().position(|line| line.starts_with("f ")).map_or(0, |line| line + 1);
    let first = format!("(line {first})");
    for part in [
        "s.toml:5:17",
        "x.obj",
        "1 closed shell is inside out",
        &first,
        "'repair = true' mends it",
        "manifold",
    ] {
        assert!(refused.contains(part), "'{part}' is missing in '{refused}'");
    }
    let (mended, told, _) = loaded(&turned, ", repair = true").expect("turned");
    assert!((mended / volume - 1.0).abs() < 1e-12, "{mended} m³ of {volume}");
    let told = told.expect("it says what it did");
    assert!(told.contains(&format!("{} triangles were turned", right.triangles.len())), "{told}");
    // A wall that is seen from inside.
    for require in ["manifold", "any"] {
        let (volume, told, _) = loaded(&turned, &format!(", require = \"{require}\"")).expect("as it is");
        assert!(volume < 0.0 && told.is_none());
    }
}

#[test]
fn a_skin_that_falls_apart_is_remarked_where_it_is_not_refused_and_welded_on_demand() {
    let whole = body(O, 2.0, true);
    let mut apart = SurfaceData::default();
    for t in 0..whole.triangles.len() {
        let first = apart.positions.len() as u32;
        apart.positions.extend(whole.corners(t));
        apart.triangles.push([first, first + 1, first + 2]);
    }
    let refused = loaded(&apart, "").expect_err("open");
    let first = "from vertex 1 at (";
    for part in ["open edges", first, "'repair = true' mends it", "were welded"] {
        assert!(refused.contains(part), "'{part}' is missing in '{refused}'");
    }
    let (_, _, remarks) = loaded(&apart, ", require = \"any\"").expect("anything goes");
    assert!(remarks[0].contains("falls apart") && remarks[0].contains("'repair = true'"), "{remarks:?}");
    for require in ["solid", "manifold", "any"] {
        let (volume, told, remarks) =
            loaded(&apart, &format!(", repair = true, require = \"{require}\"")).expect(require);
        assert!(volume > 0.0 && told.expect("told").contains("welded") && remarks.is_empty());
    }
    let weld = loaded(&whole, ", weld = 0.001").expect_err("weld without repair");
    assert!(weld.contains("weld") && weld.contains("repair = true"), "{weld}");
    let coarse =
        loaded(&whole, ", repair = true, weld = 0.01, require = \"any\"").expect("a coarse tolerance");
    assert!(coarse.1.expect("told").contains("welded"));
}

#[test]
fn a_hole_stays_a_hole_and_is_told_with_its_place() {
    let mut open = body(O, 2.0, true);
    open.triangles.pop();
    let refused = loaded(&open, ", repair = true").expect_err("a hole");
    assert!(refused.contains("'repair' cannot mend it") && refused.contains("3 open edges"), "{refused}");
    let refused = loaded(&open, "").expect_err("a hole");
    assert!(refused.contains("'repair = true' would leave: 3 open edges"), "{refused}");
    assert!(loaded(&open, ", require = \"manifold\"").is_ok());
}

#[test]
fn an_implausible_size_is_remarked_with_the_likely_unit() {
    let (_, _, remarks) = loaded(&body(O, 2.0, true).scaled(1000.0), "").expect("40 m");
    assert!(remarks[0].contains("40 m across") && remarks[0].contains("scale = 0.00001"), "{remarks:?}");
    let (_, _, remarks) = loaded(&body(O, 2.0, true), "").expect("40 mm");
    assert!(remarks.is_empty(), "{remarks:?}");
}

#[test]
fn a_mesh_beside_the_scenario_is_read_when_its_folder_is_allowed_and_textures_are_not() {
    let registry = Registry::standard();
    let folder = tempfile::tempdir().expect("a folder");
    for below in ["meshes", "scenes"] {
        std::fs::create_dir(folder.path().join(below)).expect("a folder");
    }
    std::fs::write(folder.path().join("meshes/x.obj"), common::write_obj(&body(O, 0.02, true)))
        .expect("a file");
    let file = folder.path().join("scenes/s.toml");
    let write = |more: &str| {
        let mesh = "mesh = { file = \"../meshes/x.obj\" }";
        let text = format!("schema = 1\nname = \"s\"\n[[entity]]\nname = \"organ\"\n{mesh}\n{more}");
        std::fs::write(&file, text).expect("a file");
    };
    write("");
    let refused = Scenario::load(&file, &registry).expect_err("outside").to_string();
    assert!(refused.contains("s.toml:5:") && refused.contains("'--assets DIR'"), "{refused}");
    let allowed = Assets::new(&[folder.path().join("meshes")]).expect("a folder");
    assert!(Scenario::load_with(&file, &registry, &allowed).is_ok());
    write("visual_material = { color_map = { file = \"../meshes/x.png\" } }\n");
    assert!(Scenario::load_with(&file, &registry, &allowed).is_err());
}
