//! Regions with a stiffness of their own: a column of two materials sinks under its weight as the closed form says, by
//! every method of volumes, and regions that the mesh does not have are named.

use std::sync::Arc;

use crate::support::stage::{Stage, context, scene};
use nalgebra::Vector3;
use trocar_scene::{
    BuildContext, Controller, ControllerError, SimTime, TetMesh, TetRegions, VertexPositions,
};
use trocar_simulator::controller::{
    DynamicFemController, MassSpringController, RegionMaterial, SoftRegions, XpbdController,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

/// A column of 40 mm that stands on its anchored lowest nodes.
fn column(material: &str) -> String {
    format!(
        "[[entity]]\nname = \"body\"\nmesh = {{ block = {{ size = [0.02, 0.02, 0.04], cells = [2, 2, 4] }} }}\n{material}\n\
         anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0199] }} }}] }}\n"
    )
}

/// The lower half is 'hard', the upper one 'soft'.
fn regions<C: Controller>(stage: &Stage<C>) -> TetRegions {
    let positions = stage.get::<VertexPositions>("body").positions;
    let middle = |tet: &[u32; 4]| tet.iter().map(|&v| positions[v as usize].z).sum::<f64>();
    let of_tet = stage.get::<TetMesh>("body").tets.iter().map(|tet| u16::from(middle(tet) < 0.0)).collect();
    TetRegions { names: Arc::new(vec!["soft".into(), "hard".into()]), of_tet: Arc::new(of_tet) }
}

fn materials(region: &str, young_modulus: f64) -> SoftRegions {
    SoftRegions([(region.to_owned(), RegionMaterial { young_modulus })].into())
}

/// How far the top sinks in a second and a half \[m\].
fn sink<C: Controller>(
    material: &str,
    hz: f64,
    hard: Option<f64>,
    build: fn(&BuildContext<'_>) -> Result<C, ControllerError>,
) -> f64 {
    let mut stage = Stage::new(scene(&column(material)), hz, build);
    if let Some(hard) = hard {
        let told = regions(&stage);
        stage.put("body", told);
        stage.put("body", materials("hard", hard));
        stage.rebuild(build);
    }
    (0..(1.5 * hz) as u32).for_each(|_| stage.tick());
    let positions = stage.get::<VertexPositions>("body").positions;
    let rest = scene(&column(material));
    let rest = rest.view().get::<VertexPositions>(stage.entity("body")).expect("vertices").positions.clone();
    let top: Vec<f64> =
        rest.iter().zip(positions.iter()).filter(|(r, _)| r.z > 0.0199).map(|(r, p)| r.z - p.z).collect();
    top.iter().sum::<f64>() / top.len() as f64
}

/// A column of height 2 h, of modulus E₁ below and E₂ above its middle, sinks under its weight by
/// ρ g h² (3 / (2 E₁) + 1 / (2 E₂)); where E₁ = 8 E₂, by 11/32 of what one of E₂ alone sinks.
#[test]
fn a_column_on_a_hard_lower_half_sinks_as_the_closed_form_says_by_every_method() {
    let elements = "dynamic_fem = { young_modulus = 20000.0, poisson_ratio = 0.0, density = 1000.0, mass_damping = 20.0 }";
    let fem = |context: &BuildContext<'_>| DynamicFemController::new(GRAVITY, context);
    let [alone, both] = [None, Some(160_000.0)].map(|hard| sink(elements, 100.0, hard, fem));
    let expected = 1000.0 * 9.81 * 0.04 * 0.04 / (2.0 * 20_000.0);
    assert!((alone / expected - 1.0).abs() < 0.03, "{alone} m, {expected} m by the closed form");
    assert!((both / (expected * 11.0 / 32.0) - 1.0).abs() < 0.03, "{both} m of {} m", expected * 11.0 / 32.0);

    let springs = "mass_spring = { method = \"implicit\", damping = 20.0, \
        springs = { volume = { young_modulus = 20000.0, density = 1000.0 } } }";
    let build = |context: &BuildContext<'_>| MassSpringController::new(GRAVITY, context);
    let [alone, both] = [None, Some(160_000.0)].map(|hard| sink(springs, 100.0, hard, build));
    assert!((both / alone / (11.0 / 32.0) - 1.0).abs() < 0.1, "springs: {both} m of {alone} m");

    let points = "xpbd = { damping = 20.0, matter = { volume = { young_modulus = 20000.0, poisson_ratio = 0.0, density = 1000.0 } } }";
    let build = |context: &BuildContext<'_>| XpbdController::new(GRAVITY, context);
    let [alone, both] = [None, Some(160_000.0)].map(|hard| sink(points, 500.0, hard, build));
    assert!((both / alone / (11.0 / 32.0) - 1.0).abs() < 0.1, "xpbd: {both} m of {alone} m");
}

#[test]
fn a_region_that_the_mesh_does_not_have_is_named_with_those_that_it_has() {
    let fem = |context: &BuildContext<'_>| DynamicFemController::new(GRAVITY, context);
    let mut stage = Stage::new(scene(&column("dynamic_fem = {}")), 100.0, fem);
    let refused = |stage: &Stage<DynamicFemController>| {
        let refused = fem(&context(&stage.store, SimTime::ZERO, 1)).err().expect("a mistake").to_string();
        assert!(refused.contains("'body'"), "{refused}");
        refused
    };
    stage.put("body", materials("nodule", 60_000.0));
    assert!(refused(&stage).contains("its mesh has none"));
    let told = regions(&stage);
    stage.put("body", told);
    let said = refused(&stage);
    assert!(said.contains("'nodule'") && said.contains("'soft', 'hard'"), "{said}");
}
