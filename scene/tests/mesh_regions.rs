//! Regions of volumes: physical groups and cell arrays become a component, through repair and splitting.

use crate::support as common;
use crate::support::tet_box;
use crate::support::vtk_xml::{styles, write_vtu};
use trocar_scene::mesh::TetData;
use trocar_scene::{TetMesh, TetRegions};

/// The elements and regions of a volume in a file.
fn loaded(name: &str, bytes: &[u8], options: &str) -> Result<(Vec<[u32; 4]>, Option<TetRegions>), String> {
    let (store, organ) = common::load_organ(name, bytes, options)?;
    let view = store.view();
    let tets = view.get::<TetMesh>(organ).expect("elements").tets.to_vec();
    Ok((tets, view.get::<TetRegions>(organ).cloned()))
}

/// The name of each element's region; the files of Gmsh call group 7 "liver".
fn names(regions: &TetRegions) -> Vec<&str> {
    let name = |&region: &u16| match regions.names[usize::from(region)].as_str() {
        "liver" => "7",
        name => name,
    };
    regions.of_tet.iter().map(name).collect()
}

fn expected(volume: &TetData) -> Vec<String> {
    volume.tags.iter().map(i32::to_string).collect()
}

#[test]
fn regions_of_every_format_become_a_component() {
    let volume = tet_box(2);
    let mut files = vec![
        ("a.msh", common::write_gmsh_2(&volume, None)),
        ("b.msh", common::write_gmsh_2(&volume, Some(common::Order::Big))),
        ("c.vtk", common::write_vtk(&volume, false, 3)),
        ("d.vtk", common::write_vtk(&volume, true, 5)),
    ];
    files.extend(styles().into_iter().map(|style| ("e.vtu", write_vtu(&volume, style))));
    for (name, bytes) in files {
        let (tets, regions) = loaded(name, &bytes, "").unwrap_or_else(|error| panic!("{error}"));
        let regions = regions.unwrap_or_else(|| panic!("{name}: no regions"));
        assert_eq!((tets.len(), regions.names.len()), (48, 2), "{name}");
        assert_eq!(names(&regions), expected(&volume), "{name}");
    }
    // Grouped by their region in the file.
    for order in [None, Some(common::Order::Little)] {
        let (_, regions) = loaded("a.msh", &common::write_gmsh_4(&volume, order), "").expect("a volume");
        let regions = regions.expect("regions");
        assert_eq!(names(&regions).iter().filter(|name| **name == "7").count(), 24);
    }
}

#[test]
fn names_of_physical_groups_are_kept_and_those_of_surfaces_are_not_taken_for_them() {
    let mut text = String::from_utf8(common::write_gmsh_2(&tet_box(2), None)).expect("text");
    let names_section = "$PhysicalNames\n4\n2 7 \"capsule\"\n3 7 \"soft tissue\"\n3 9 \"nodule\"\n3 11 \"unused\"\n\
        $EndPhysicalNames\n";
    text = text.replacen("$Nodes", &format!("{names_section}$Nodes"), 1);
    let (_, regions) = loaded("a.msh", text.as_bytes(), "").expect("a volume");
    assert_eq!(regions.expect("regions").names.to_vec(), ["soft tissue", "nodule"]);
}

#[test]
fn regions_stay_with_their_elements_through_a_repair() {
    let mut volume = tet_box(2);
    let twice = volume.tets[5];
    volume.tets.insert(0, twice);
    volume.tags.insert(0, 11);
    volume.tets[20].swap(0, 1);
    let refused = loaded("a.msh", &common::write_gmsh_2(&volume, None), "").expect_err("twice");
    assert!(refused.contains("the same corners"), "{refused}");
    let (tets, regions) =
        loaded("a.msh", &common::write_gmsh_2(&volume, None), ", repair = true").expect("mended");
    let regions = regions.expect("regions");
    assert_eq!((tets.len(), regions.of_tet.len()), (48, 48));
    // Of the equal ones the first stays, with its own region.
    let mut wanted = expected(&volume);
    wanted.remove(6);
    assert_eq!(names(&regions), wanted);
}

#[test]
fn a_split_hexahedron_gives_its_region_to_all_of_its_tetrahedra() {
    let text = "# vtk DataFile Version 3.0\nt\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 12 float\n\
        0 0 0 .1 0 0 .2 0 0 0 .1 0 .1 .1 0 .2 .1 0 0 0 .1 .1 0 .1 .2 0 .1 0 .1 .1 .1 .1 .1 .2 .1 .1\n\
        CELLS 2 18\n8 0 1 4 3 6 7 10 9\n8 1 2 5 4 7 8 11 10\nCELL_TYPES 2\n12 12\n\
        CELL_DATA 2\nSCALARS quality float 1\nLOOKUP_TABLE default\n1 1\nSCALARS MaterialIDs int\nLOOKUP_TABLE default\n4 3\n";
    let (tets, regions) = loaded("a.vtk", text.as_bytes(), "").expect("a volume");
    let regions = regions.expect("regions");
    assert_eq!(
        (tets.len(), names(&regions)[..6].to_vec(), names(&regions)[6..].to_vec()),
        (12, vec!["4"; 6], vec!["3"; 6])
    );
    let cut = text.replace("4 3\n", "4\n");
    let refused = loaded("a.vtk", cut.as_bytes(), "").expect_err("a region is missing");
    assert!(refused.contains("a region is expected"), "{refused}");
    // Data that tells no regions does not matter, whole or not.
    let (_, none) = loaded("a.vtk", cut.replace("MaterialIDs", "stress").as_bytes(), "").expect("a volume");
    assert_eq!(none, None);
}
