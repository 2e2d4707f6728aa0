//! Boxes, balls, regions by name: what refers to parts of a mesh that are not there is refused while the scenario is read.

use crate::support::{self, tet_box};
use trocar_scene::{Registry, Scenario};

/// The message about an entity with the box of `n` cells, 1 × 0.5 × 0.25 m, and these lines; none if it is read.
fn refusal(n: u32, lines: &str) -> Option<String> {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("a.vtk"), support::write_vtk(&tet_box(n), false, 3)).expect("a file");
    let file = folder.path().join("s.toml");
    let text = format!(
        "schema = 1\nname = \"s\"\n[[entity]]\nname = \"organ\"\nmesh = {{ file = \"a.vtk\" }}\n{lines}\n"
    );
    std::fs::write(&file, text).expect("a file");
    Scenario::load(&file, &Registry::standard()).err().map(|error| error.to_string())
}

const SPAN: &str = "the mesh spans [0, 0, 0] to [1, 0.5, 0.25] m in its own frame";

#[test]
fn anchors_that_hold_nothing_are_refused_with_the_box_of_the_mesh() {
    for (region, n, why) in [
        ("{ box = { min = [-1, -1, -1], max = [1, 1, -0.5] } }", 2, ""),
        ("{ box = { min = [0.1, 0.1, 0.01], max = [0.4, 0.2, 0.1] } }", 2, ""),
        ("{ box = { min = [0, 0, 0.1], max = [1, 1, -0.1] } }", 1, ", as its min is above its max along z"),
        ("{ ball = { center = [0.5, 0.25, 3.0], radius = 0.5 } }", 3, ""),
        ("{ ball = { center = [0.5, 0.25, 0.125], radius = 0.01 } }", 1, ""),
        ("{ ball = { center = [0, 0, 0], radius = -0.01 } }", 1, ", as its radius is below 0"),
    ] {
        let error = refusal(n, &format!("anchors = {{ regions = [{region}] }}")).expect(region);
        let count = (n + 1).pow(3);
        let expected = format!("entity 'organ', anchors: they hold none of {count} vertices{why}; {SPAN}");
        assert!(error.contains("s.toml:6:11: ") && error.ends_with(&expected), "{error}");
    }
}

#[test]
fn of_several_regions_the_one_that_holds_nothing_is_named() {
    let held = "{ box = { min = [0, 0, 0], max = [0, 1, 1] } }";
    let empty = "{ box = { min = [0, 0, 30], max = [0, 1, 40] } }";
    let error =
        refusal(2, &format!("anchors = {{ regions = [{held}, {empty}, {held}] }}")).expect("an empty region");
    assert!(error.ends_with(&format!("anchors: region 2 of 3 holds none of 27 vertices; {SPAN}")), "{error}");
}

#[test]
fn anchors_that_hold_one_vertex_are_taken_also_on_their_border() {
    for regions in [
        "{ box = { min = [1, 0.5, 0.25], max = [2, 2, 2] } }",
        "{ ball = { center = [0, 0, 0], radius = 0 } }",
        "",
    ] {
        assert_eq!(refusal(2, &format!("anchors = {{ regions = [{regions}] }}")), None, "{regions}");
    }
}

#[test]
fn vertices_that_a_scenario_lists_and_meshes_that_it_has_made_are_looked_at_too() {
    let read = |entity: &str| {
        let text = format!("schema = 1\nname = \"s\"\n[[entity]]\nname = \"gauze\"\n{entity}\n");
        let read = Scenario::parse(std::path::Path::new("s.toml"), &text, &Registry::standard());
        read.err().map(|error| error.to_string())
    };
    let anchors = |x: f64| {
        format!("anchors = {{ regions = [{{ box = {{ min = [{x}, -9, -9], max = [9, 9, 9] }} }}] }}")
    };
    for mesh in [
        "vertex_positions = { positions = [[0, 0, 0], [0.5, 0, 0], [0, 0.5, 0]] }",
        "mesh = { shape = { box = { half_extents = [0.5, 0.1, 0.1] } } }",
        "mesh = { sheet = { size = [1.0, 1.0], cells = [4, 4] } }",
    ] {
        let held = read(&format!("{mesh}\n{}", anchors(0.5)));
        assert_eq!(held, None, "{mesh}");
        let error = read(&format!("{mesh}\n{}", anchors(0.51))).expect(mesh);
        assert!(error.contains("anchors: they hold none of ") && error.contains("spans ["), "{error}");
    }
}
