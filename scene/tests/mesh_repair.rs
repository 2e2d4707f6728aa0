//! Volumes of other people: one with bad elements is refused with a list of them, and mended when the scenario asks for it.

use crate::support as common;
use trocar_scene::mesh::{Defect, MeshRules, TetData, tet_defects, validate_tets};
use trocar_scene::{MeshRepaired, TetMesh, VertexPositions};

/// What a scenario makes of a volume in a file; `options` follow the file's name.
fn loaded(volume: &TetData, options: &str) -> Result<(TetData, Option<String>), String> {
    let (store, organ) = common::load_organ("x.vtk", &common::write_vtk(volume, true, 5), options)?;
    let view = store.view();
    let positions = view.get::<VertexPositions>(organ).expect("vertices").positions.to_vec();
    let tets = view.get::<TetMesh>(organ).expect("elements").tets.to_vec();
    let told = view.get::<MeshRepaired>(organ).map(|repaired| repaired.what.clone());
    Ok((TetData { positions, tets, tags: Vec::new() }, told))
}

/// A box with a defect, what the refusal says of it, and what was mended. The file has a triangle before the tetrahedra, and
/// numbers count cells as it does.
fn bad(kind: &str) -> (TetData, &'static str, &'static str) {
    let mut volume = common::tet_box(2);
    let count = volume.tets.len();
    match kind {
        "inverted" => {
            volume.tets[4].swap(0, 1);
            (volume, "tetrahedron 5 is inverted", "1 inverted element turned (5)")
        }
        "flat" => {
            let [a, b, ..] = volume.tets[0];
            let middle = nalgebra::center(&volume.positions[a as usize], &volume.positions[b as usize]);
            volume.positions.push(middle);
            let more = volume.positions.len() as u32 - 1;
            let [.., c, _] = volume.tets[0];
            volume.tets.push([a, b, c, more]);
            volume.tags.push(0);
            (volume, "is flat", "1 element dropped")
        }
        "repeated corner" => {
            let [a, b, c, _] = volume.tets[0];
            volume.tets.push([a, b, c, a]);
            volume.tags.push(0);
            (volume, "more than once", "1 element dropped")
        }
        "twice" => {
            volume.tets.push(volume.tets[3]);
            volume.tags.push(0);
            assert_eq!(count, 48);
            (volume, "tetrahedra 4 and 49 have the same corners", "1 element dropped")
        }
        other => panic!("no such defect: {other}"),
    }
}

#[test]
fn every_kind_of_bad_element_is_refused_by_its_number_and_mended_by_one_word() {
    let sound = common::tet_box(2);
    let (as_it_came, told) = loaded(&sound, ", repair = true").expect("a sound mesh");
    assert_eq!((as_it_came.tets.len(), told), (sound.tets.len(), None), "nothing to mend, nothing said");
    for kind in ["inverted", "flat", "repeated corner", "twice"] {
        let (volume, says, mended) = bad(kind);
        let refused = loaded(&volume, "").expect_err(kind);
        for part in ["s.toml:5:", "entity 'organ', mesh, file", "x.vtk", says, "repair = true"] {
            assert!(refused.contains(part), "{kind}: '{part}' is missing in '{refused}'");
        }
        let (repaired, told) = loaded(&volume, ", repair = true").expect(kind);
        let told = told.expect("it says what it did");
        assert!(told.contains(mended), "{kind}: {told}");
        assert_eq!(tet_defects(&repaired.positions, &repaired.tets, &MeshRules::default()), []);
        let (found, wanted) = (validate_tets(&repaired).volume, validate_tets(&sound).volume);
        assert!((found / wanted - 1.0).abs() < 1e-12, "{kind}: {found} m³ of {wanted}");
    }
}

#[test]
fn nodes_at_the_same_place_and_slivers_are_mended_too() {
    let mut volume = common::tet_box(2);
    let twin = volume.positions.len() as u32;
    volume.positions.push(volume.positions[volume.tets[0][0] as usize]);
    volume.tets[0][0] = twin;
    let [a, b, c, d] = volume.tets[7];
    let at = |node: u32| volume.positions[node as usize];
    // A hair out of a face that is of the boundary or not: it is dropped before that matters.
    let out = (at(b) - at(a)).cross(&(at(c) - at(a))).normalize() * (1e-4 * (at(d) - at(a)).norm());
    let near = nalgebra::Point3::from((at(a).coords + at(b).coords + at(c).coords) / 3.0) + out;
    volume.positions.push(near);
    volume.tets.push([a, b, c, twin + 1]);
    volume.tags.push(0);
    let found = tet_defects(&volume.positions, &volume.tets, &MeshRules::default());
    assert!(found.iter().any(|defect| matches!(defect, Defect::Coincident { .. })), "{found:?}");
    assert!(found.iter().any(|defect| matches!(defect, Defect::Sliver { tet: 48, .. })), "{found:?}");
    let (repaired, told) = loaded(&volume, ", repair = true").expect("can be mended");
    let told = told.expect("it says what it did");
    assert!(told.contains("1 node merged") && told.contains("1 element dropped"), "{told}");
    assert_eq!((repaired.tets.len(), repaired.positions.len()), (48, 27));
}

#[test]
fn what_cannot_be_mended_is_refused_with_it_and_a_list_is_bounded_and_hides_no_kind() {
    let mut volume = common::tet_box(2);
    // Another element on the inner side of a face of the first.
    let [a, b, c, d] = volume.tets[0];
    let at = |node: u32| volume.positions[node as usize].coords;
    let inside = nalgebra::Point3::from(0.25 * at(a) + 0.25 * at(b) + 0.25 * at(c) + 0.25 * at(d));
    volume.positions.push(inside);
    volume.tets.push([a, b, c, 27]);
    volume.tags.push(0);
    let refused = loaded(&volume, ", repair = true").expect_err("they overlap");
    assert!(refused.contains("'repair' cannot mend it"), "{refused}");

    let mut volume = common::tet_box(4);
    let [a, b, c, _] = volume.tets[0];
    volume.tets.iter_mut().skip(1).for_each(|tet| tet.swap(0, 1));
    volume.tets.push([a, b, c, a]);
    volume.tags.push(0);
    let refused = loaded(&volume, "").expect_err("nearly all are inverted");
    assert!(refused.len() < 4000, "{} characters", refused.len());
    let many = volume.tets.len() - 2;
    for part in [format!("and {} more of this kind", many - 4), "more than once".into()] {
        assert!(refused.contains(&part), "'{part}' is missing in '{refused}'");
    }
    let surface = loaded(&common::tet_box(2), ", repair = 3").expect_err("no truth");
    assert!(surface.contains("repair"), "{surface}");
}
