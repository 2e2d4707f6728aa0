//! What refers to parts of a body's mesh is held against it while the scenario is read: anchors of laid threads, pinned points,
//! regions by name.

use std::path::Path;

use trocar_scene::{RegistryBuilder, Scenario};

/// The message about an entity with these lines; none if it is read.
fn refusal(lines: &str) -> Option<String> {
    let mut builder = RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).expect("the standard components");
    trocar_simulator::controller::register(&mut builder).expect("and ours");
    let text = format!(
        "schema = 1\nname = \"s\"\n[[entity]]\nname = \"hook\"\n[[entity]]\nname = \"body\"\n{lines}\n"
    );
    Scenario::parse(Path::new("s.toml"), &text, &builder.build()).err().map(|error| error.to_string())
}

const BLOCK: &str = "mesh = { block = { size = [0.06, 0.05, 0.04], cells = [3, 3, 2] } }";

#[test]
fn anchors_of_a_thread_that_is_laid_are_held_against_its_own_nodes() {
    // The line mesh lies elsewhere: it is laid anew.
    let thread = |x: f64| {
        format!(
            "mesh = {{ line = {{ length = 0.02, segments = 8, radius = 1.5e-4 }} }}\n\
             thread = {{ laid = {{ through = {{ places = [[1.0, 0, 0], [1.0, 0.03, 0]] }} }} }}\n\
             anchors = {{ regions = [{{ ball = {{ center = [{x}, 0, 0], radius = 1e-3 }} }}] }}"
        )
    };
    assert_eq!(refusal(&thread(1.0)), None);
    let error = refusal(&thread(0.0)).expect("the thread is not there");
    assert!(error.contains("s.toml:9:") && error.contains("anchors: they hold none of "), "{error}");
    assert!(error.ends_with("the mesh spans [1, 0, 0] to [1, 0.03, 0] m in its own frame"), "{error}");
}

#[test]
fn pinned_points_outside_of_the_organ_are_refused_with_its_box() {
    let pinned = |z: f64| {
        format!(
            "{BLOCK}\npinned = {{ with = [{{ entity = \"hook\", points = [[0.01, 0.02, 0.0], [0.0, 0.0, {z}]] }}] }}"
        )
    };
    for z in [0.0, 0.0199, 0.02, -0.02, 0.025] {
        assert_eq!(refusal(&pinned(z)), None, "{z}");
    }
    for z in [0.07, -0.07, 12.0] {
        let error = refusal(&pinned(z)).expect("outside");
        let point =
            format!("pinned: the point [0, 0, {z}] for 'hook' is outside of the mesh; the mesh spans ");
        assert!(
            error.contains(&point) && error.contains("[-0.03, -0.025, -0.02] to [0.03, 0.025, 0.02] m"),
            "{error}"
        );
    }
}

#[test]
fn regions_of_a_mesh_that_has_none_are_refused_at_their_line() {
    let error =
        refusal(&format!("{BLOCK}\n[entity.soft_regions.nodule]\nyoung_modulus = 6e4")).expect("no regions");
    assert!(
        error.contains("s.toml:8:")
            && error.contains("soft_regions: its 'soft_regions' name regions, but its mesh has none"),
        "{error}"
    );
}
