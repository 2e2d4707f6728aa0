//! Dynamic finite elements against statics, vibration and closed forms; momentum and energy budgets; inverted elements;
//! restarts.

use crate::support::beam;
use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::dynamic_fem::{
    Config, Constitution, Contact, DynamicFem, DynamicFemState, Inputs, MassMatrix, Spring, StepError,
};

const BOTH: [Constitution; 2] = [Constitution::Corotational, Constitution::NeoHookean];

fn cube(cells: usize) -> TetMesh {
    let grid = BoxCells { cells: [cells; 3], size: Vector3::repeat(0.03), origin: Point3::origin() };
    let (nodes, tets) = box_cells(&grid);
    TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh")
}

fn beam_body(cells: [usize; 3], config: &Config) -> DynamicFem {
    let mesh = beam::mesh(cells);
    let fixed = beam::nodes_at(&mesh, 0.0);
    DynamicFem::new(mesh, &beam::material(), config, &fixed).expect("a body")
}

fn displacements(body: &DynamicFem) -> Vec<Vector3<f64>> {
    body.positions().iter().zip(body.mesh().rest()).map(|(now, rest)| now - rest).collect()
}

#[test]
fn under_a_small_load_it_comes_to_rest_where_linear_statics_says() {
    for constitution in BOTH {
        let config = Config { constitution, mass_damping: 30.0, tolerance: 1e-7, ..Config::default() };
        let mut body = beam_body([10, 2, 2], &config);
        // A thousandth of the reference load, in the linear range.
        let forces: Vec<_> = beam::end_traction(body.mesh())
            .into_iter()
            .enumerate()
            .map(|(node, force)| (node as u32, force * 1e-3))
            .collect();
        let inputs = Inputs { forces: &forces, ..Inputs::default() };
        for _ in 0..60 {
            let report = body.step(0.1, &inputs).expect("a step");
            assert!(report.solved, "{report:?}");
        }
        let found = beam::end_deflection(body.mesh(), &displacements(&body)) * 1e3;
        assert!((found / 1.306_239_43e-3 - 1.0).abs() < 1e-4, "{constitution:?}: {found}");
    }
}

/// Frequency \[Hz\] of a beam bent in a direction and released.
fn frequency(along: Vector3<f64>) -> f64 {
    // At a step of 0.2 ms backward Euler shifts a 4 Hz vibration by far less than 1 %.
    let config = Config { mass: MassMatrix::Consistent, tolerance: 1e-6, ..Config::default() };
    let mut body = beam_body([10, 2, 2], &config);
    let forces: Vec<_> = beam::end_traction(body.mesh())
        .into_iter()
        .enumerate()
        .map(|(node, force)| (node as u32, along * (force.z * 0.05)))
        .collect();
    for _ in 0..40 {
        body.step(0.5, &Inputs { forces: &forces, ..Inputs::default() }).expect("a step");
    }
    let still = DynamicFemState {
        positions: body.positions().to_vec(),
        velocities: vec![Vector3::zeros(); body.positions().len()],
        accelerations: vec![Vector3::zeros(); body.positions().len()],
        ..DynamicFemState::default()
    };
    body.restore(&still).expect("its own nodes");
    let end = beam::nodes_at(body.mesh(), 0.1);
    let deflection = |body: &DynamicFem| -> f64 {
        let all = displacements(body);
        end.iter().map(|&node| all[node as usize].dot(&along)).sum()
    };
    let dt = 2e-4;
    let mut crossings = Vec::new();
    let mut before = deflection(&body);
    for step in 1..1_700 {
        assert!(body.step(dt, &Inputs::default()).expect("a step").solved);
        let now = deflection(&body);
        if before * now < 0.0 {
            crossings.push((f64::from(step) - now / (now - before)) * dt);
        }
        before = now;
    }
    assert!(crossings.len() >= 3, "{crossings:?}");
    1.0 / (crossings[2] - crossings[0])
}

#[test]
fn it_vibrates_at_the_frequency_of_the_reference() {
    // The elements' diagonals make the square beam softer across one of its own than across the other.
    let ways = [Vector3::new(0.0, 1.0, 1.0), Vector3::new(0.0, 1.0, -1.0)];
    let [one, other] = ways.map(|way| frequency(way.normalize()));
    let lowest = one.min(other);
    assert!((lowest / 4.076_689_11 - 1.0).abs() < 0.01, "{one} and {other} Hz");
}

/// Stress \[Pa\] at the end of a block, E 1e4, ν 0.45, stretched along x with free sides: both ends have the lateral
/// stretch `across` of the closed form, the rest is solved for.
fn uniaxial_stress(constitution: Constitution, stretch: f64, across: f64) -> f64 {
    let elastic = Elastic::new(1e4, 0.45).expect("a material");
    let config = Config { constitution, mass_damping: 100.0, tolerance: 1e-10, ..Config::default() };
    let mesh = cube(3);
    let rest = mesh.rest().to_vec();
    let mut body = DynamicFem::new(mesh, &elastic, &config, &[]).expect("a body");
    let stretched = |at: &Point3<f64>| Point3::new(at.x * stretch, at.y * across, at.z * across);
    let prescribed: Vec<_> = (0..rest.len() as u32)
        .filter(|&node| rest[node as usize].x < 1e-9 || rest[node as usize].x > 0.03 - 1e-9)
        .map(|node| (node, stretched(&rest[node as usize])))
        .collect();
    let inputs = Inputs { prescribed: &prescribed, ..Inputs::default() };
    for _ in 0..40 {
        body.step(0.1, &inputs).expect("a step");
    }
    // No force on the sides: the displacement field is the uniform one prescribed at the ends.
    let apart = body.positions().iter().zip(&rest).map(|(now, rest)| (now - stretched(rest)).norm());
    assert!(apart.fold(0.0, f64::max) < 1e-6, "{constitution:?} {stretch}");
    let pull = body.reactions().iter().filter(|(node, _)| rest[*node as usize].x > 0.03 - 1e-9);
    pull.map(|(_, force)| force.x).sum::<f64>() / (0.03 * 0.03)
}

#[test]
fn a_neo_hookean_block_is_stretched_by_the_force_of_the_closed_form() {
    let elastic = Elastic::new(1e4, 0.45).expect("a material");
    for (stretch, expected) in [(0.7, -4339.388), (0.9, -1107.129), (1.1, 917.034)] {
        // Where the lateral stress is zero.
        let (mut low, mut high) = (0.5, 1.5);
        let (lambda, mu) = (elastic.lambda(), elastic.mu());
        for _ in 0..100 {
            let across: f64 = 0.5 * (low + high);
            let log = (stretch * across * across).ln();
            if mu * (across - across.recip()) + lambda * log / across > 0.0 {
                high = across
            } else {
                low = across
            }
        }
        let stress = uniaxial_stress(Constitution::NeoHookean, stretch, low);
        assert!((stress - expected).abs() < 1e-3 * expected.abs(), "{stretch}: {stress} Pa, not {expected}");
    }
}

#[test]
fn st_venant_kirchhoff_softens_under_pressure_as_its_closed_form_does() {
    // E (s³ − s)/2; laterally, Green's strain is −ν times the axial one.
    for (stretch, expected) in [(0.7_f64, -1785.0), (0.9, -855.0), (1.1, 1155.0)] {
        let across = (1.0 - 0.45 * (stretch * stretch - 1.0)).sqrt();
        let stress = uniaxial_stress(Constitution::StVenantKirchhoff, stretch, across);
        assert!((stress - expected).abs() < 1e-3 * expected.abs(), "{stretch}: {stress} Pa, not {expected}");
    }
}

#[test]
fn momentum_is_kept_and_energy_is_never_gained() {
    for (constitution, mass) in
        [(BOTH[0], MassMatrix::Lumped), (BOTH[1], MassMatrix::Lumped), (BOTH[0], MassMatrix::Consistent)]
    {
        let config = Config { constitution, mass, tolerance: 1e-9, ..Config::default() };
        let elastic = Elastic::new(1e4, 0.4).expect("a material");
        let mut body = DynamicFem::new(cube(3), &elastic, &config, &[]).expect("a body");
        // Squeezed, sheared, turning and flying.
        let mut state = body.state();
        for (at, velocity) in state.positions.iter_mut().zip(&mut state.velocities) {
            let out = at.coords - Vector3::repeat(0.015);
            *velocity = Vector3::new(0.1, 0.2, -0.1) + Vector3::new(0.0, 0.0, 20.0).cross(&out) + out * 10.0;
            at.x += 0.2 * out.y;
            at.z -= 0.15 * out.z;
        }
        body.restore(&state).expect("its own state");
        // Rows of the consistent mass add up to the lumped ones.
        let masses = body.mesh().lumped_masses(1000.0);
        let momentum = |body: &DynamicFem| -> Vector3<f64> {
            masses.iter().zip(body.velocities()).map(|(mass, velocity)| velocity * *mass).sum()
        };
        let (first, mut energy) = (momentum(&body), body.energies());
        for _ in 0..200 {
            let report = body.step(1e-3, &Inputs::default()).expect("a step");
            assert!(report.solved, "{report:?}");
            let now = body.energies();
            let (before, after) = (energy.kinetic + energy.elastic, now.kinetic + now.elastic);
            assert!(after <= before * (1.0 + 1e-9), "{constitution:?}: {before} J, then {after} J");
            energy = now;
        }
        assert!((momentum(&body) - first).norm() < 1e-7 * first.norm(), "{} {first}", momentum(&body));
    }
}

#[test]
fn what_falls_does_so_as_galileo_said_and_lands_on_the_floor() {
    let elastic = Elastic::new(2e4, 0.4).expect("a material");
    let config = Config { stiffness_damping: 2e-3, ..Config::default() };
    let mut body = DynamicFem::new(cube(2), &elastic, &config, &[]).expect("a body");
    let gravity = Vector3::new(0.0, 0.0, -9.81);
    for _ in 0..100 {
        body.step(1e-3, &Inputs { acceleration: gravity, ..Inputs::default() }).expect("a step");
    }
    // Backward Euler falls h g t/2 too far.
    let fallen = body.positions()[0].z - body.mesh().rest()[0].z;
    assert!((fallen + 9.81 * 0.1 * (0.1 + 1e-3) / 2.0).abs() < 1e-9, "{fallen}");
    let floor = -0.06;
    let contacts: Vec<_> = (0..27)
        .map(|node| Contact {
            weights: [(node, 1.0), (0, 0.0), (0, 0.0), (0, 0.0)],
            point: Point3::new(0.0, 0.0, floor),
            normal: Vector3::z(),
            stiffness: 500.0,
        })
        .collect();
    let inputs = Inputs { acceleration: gravity, contacts: &contacts, ..Inputs::default() };
    for _ in 0..1500 {
        let report = body.step(1e-3, &inputs).expect("a step");
        assert!(report.solved && report.inverted == 0, "{report:?}");
    }
    // The penalty forces of the nodes below the floor carry its weight.
    let below = body.positions().iter().map(|at| (floor - at.z).max(0.0)).sum::<f64>() * 500.0;
    let weight = 1000.0 * 0.03_f64.powi(3) * 9.81;
    assert!((below / weight - 1.0).abs() < 0.01, "{below} N, not {weight} N");
    assert!(body.energies().kinetic < 1e-9);
}

#[test]
fn a_spring_pulls_a_point_inside_an_element() {
    let config = Config { mass_damping: 20.0, tolerance: 1e-8, ..Config::default() };
    let mut body = beam_body([8, 2, 2], &config);
    let (tet, weights) = body.mesh().locate(&Point3::new(0.08, 0.012, 0.009)).expect("inside");
    let corners = body.mesh().tets()[tet];
    let weights: [(u32, f64); 4] = std::array::from_fn(|i| (corners[i], weights[i]));
    let target = Point3::new(0.08, 0.012, 0.019);
    let spring = Spring { weights, target, stiffness: 20.0 };
    for _ in 0..60 {
        body.step(0.1, &Inputs { springs: &[spring], ..Inputs::default() }).expect("a step");
    }
    let now: Vector3<f64> = weights.iter().map(|&(n, w)| body.positions()[n as usize].coords * w).sum();
    let pull = (target.coords - now) * 20.0;
    let held: Vector3<f64> = body.reactions().iter().map(|(_, force)| force).sum();
    assert!(pull.z > 0.01, "{pull}");
    assert!((pull + held).norm() < 1e-5 * pull.norm(), "the wall holds against it: {pull} {held}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]
    /// Nodes displaced randomly by up to a cell size: all elements recover. By up to half of it, the body recovers its
    /// shape, too (beyond, elements may wind twice around an edge without inversion).
    #[test]
    fn inverted_elements_recover(
        moves in prop_oneof![
            prop::collection::vec(-0.015..0.015_f64, 3 * 27),
            prop::collection::vec(-0.0075..0.0075_f64, 3 * 27),
        ],
        neo_hookean in any::<bool>(),
    ) {
        let constitution = BOTH[usize::from(neo_hookean)];
        let config = Config { constitution, mass_damping: 50.0, ..Config::default() };
        let elastic = Elastic::new(1e4, 0.4).expect("a material");
        let mesh = cube(2);
        let base: Vec<u32> =
            (0..27).filter(|&n| mesh.rest()[n as usize].z < 1e-9).collect();
        let mut body = DynamicFem::new(mesh, &elastic, &config, &base).expect("a body");
        let mut state = body.state();
        for (node, shift) in moves.chunks(3).enumerate() {
            if !base.contains(&(node as u32)) {
                state.positions[node] += Vector3::from_column_slice(shift);
            }
        }
        body.restore(&state).expect("its own nodes");
        let first = body.step(1e-3, &Inputs::default()).expect("a step");
        for _ in 0..60 {
            body.step(5e-2, &Inputs::default()).expect("a step");
        }
        let last = body.step(5e-2, &Inputs::default()).expect("a step");
        prop_assert_eq!(last.inverted, 0, "at first {}", first.inverted);
        let apart = displacements(&body).iter().map(|u| u.norm()).fold(0.0, f64::max);
        let thrown = moves.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        prop_assert!(thrown > 0.0075 || apart < 1e-4, "{} m from rest", apart);
    }
}

#[test]
fn a_body_that_is_collapsed_to_a_plane_recovers() {
    for constitution in BOTH {
        let config = Config { constitution, mass_damping: 50.0, ..Config::default() };
        let elastic = Elastic::new(1e4, 0.4).expect("a material");
        let mesh = cube(2);
        let base: Vec<u32> = (0..27).filter(|&n| mesh.rest()[n as usize].z < 1e-9).collect();
        let mut body = DynamicFem::new(mesh, &elastic, &config, &base).expect("a body");
        let mut state = body.state();
        // Mirrored through its base: all elements inverted.
        state.positions.iter_mut().for_each(|at| at.z *= -0.5);
        body.restore(&state).expect("its own nodes");
        let first = body.step(1e-4, &Inputs::default()).expect("a step");
        assert!(first.inverted > 0, "{first:?}");
        for _ in 0..200 {
            body.step(2e-2, &Inputs::default()).expect("a step");
        }
        let last = body.step(2e-2, &Inputs::default()).expect("a step");
        assert_eq!(last.inverted, 0, "{constitution:?} {last:?}");
    }
}

#[test]
fn a_restored_body_continues_bit_for_bit() {
    let config = Config { stiffness_damping: 1e-3, ..Config::default() };
    let make = || beam_body([8, 2, 2], &config);
    let mut body = make();
    let tip = beam::nodes_at(body.mesh(), 0.1);
    let floor = |node: u32| Contact {
        weights: [(node, 1.0), (0, 0.0), (0, 0.0), (0, 0.0)],
        point: Point3::new(0.0, 0.0, -0.004),
        normal: Vector3::z(),
        stiffness: 200.0,
    };
    let contacts: Vec<_> = tip.iter().map(|&node| floor(node)).collect();
    let drive = |body: &mut DynamicFem, step: usize| {
        let force = Vector3::new(0.0, 0.02, -0.05) * (step as f64 * 0.05).sin();
        let inputs = Inputs {
            acceleration: Vector3::new(0.0, 0.0, -9.81),
            forces: &[(tip[0], force)],
            contacts: &contacts,
            ..Inputs::default()
        };
        body.step(2e-3, &inputs).expect("a step")
    };
    let mut factorisations = 0;
    for step in 0..150 {
        factorisations += drive(&mut body, step).factorisations;
    }
    assert!(factorisations > 1, "the factor is not the first one");
    let state = body.state();
    let mut other = make();
    other.restore(&state).expect("its own state");
    for step in 150..300 {
        assert_eq!(drive(&mut body, step), drive(&mut other, step));
        assert_eq!(body.state(), other.state());
    }
}

#[test]
fn what_cannot_be_stepped_is_refused_and_changes_nothing() {
    let mut body = beam_body([4, 2, 2], &Config::default());
    let gravity = Inputs { acceleration: Vector3::new(0.0, 0.0, -9.81), ..Inputs::default() };
    body.step(1e-3, &gravity).expect("a step");
    let before = body.state();
    let nan = Vector3::repeat(f64::NAN);
    let wall = beam::nodes_at(body.mesh(), 0.0)[0];
    let tip = beam::nodes_at(body.mesh(), 0.1)[0];
    let huge = [(tip, Vector3::repeat(1e300))];
    let at = Point3::origin();
    for (dt, inputs) in [
        (0.0, gravity),
        (f64::NAN, gravity),
        (2.0, gravity),
        (1e-3, Inputs { acceleration: nan, ..gravity }),
        (1e-3, Inputs { forces: &[(tip, nan)], ..gravity }),
        (1e-3, Inputs { forces: &[(999, Vector3::x())], ..gravity }),
        (1e-3, Inputs { prescribed: &[(wall, at)], ..gravity }),
        (1e-3, Inputs { prescribed: &[(tip, at), (tip, at)], ..gravity }),
        (1e-3, Inputs { forces: &huge, ..gravity }),
    ] {
        let error = body.step(dt, &inputs).expect_err("refused");
        assert!(!error.to_string().is_empty());
        assert_eq!(body.state(), before, "{error}");
    }
    let error = body.step(1e-3, &Inputs { prescribed: &[(wall, at)], ..gravity });
    assert!(matches!(error, Err(StepError::Node { what: "prescribed node", index: 0, .. })));
    body.step(1e-3, &gravity).expect("and it goes on");
}
