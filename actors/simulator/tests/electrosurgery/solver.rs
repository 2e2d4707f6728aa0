//! Electrosurgery as a whole: energy balance, removed volume, the two cases of the framework's paper, and restarts.

use crate::support::heated_tissue::{TIP, assert_balanced, block, liver_block, membrane, rest, stroke};
use nalgebra::Point3;
use proptest::prelude::*;
use trocar_simulator::electrosurgery::{
    BODY, Electrode, Electrosurgery, HeatStepError, LatticeConfig, Mode, ThermalMaterial, Tissue,
};

#[test]
fn thirty_watts_remove_at_most_fifteen_cubic_millimetres_a_second_and_about_half_of_that() {
    let mut heat = liver_block(0.5e-3, ThermalMaterial::default());
    let rate = stroke(&mut heat, 0.01, 1.0, TIP) * 1e9;
    assert!(rate < 15.0, "{rate} mm³/s");
    let power = heat.ledger().supplied;
    assert!((5.0..=30.0).contains(&rate), "{rate} mm³/s of {power} W");
    // Share of the absorbed heat used by the cut itself.
    let taken = rate * (0.24064 + 1.70471) / power;
    assert!((0.4..1.0).contains(&taken), "{rate} mm³/s of {power} W: {taken}");
    assert_balanced(&heat, 1e-9);
}

#[test]
fn without_latent_heat_tissue_goes_several_times_too_easily() {
    let simple = ThermalMaterial { has_latent_heat: false, ..ThermalMaterial::default() };
    let weak = Electrode { power: 10.0, ..TIP };
    let simple = stroke(&mut liver_block(0.5e-3, simple), 0.01, 1.0, weak);
    let with_latent_heat = stroke(&mut liver_block(0.5e-3, ThermalMaterial::default()), 0.01, 1.0, weak);
    assert!(simple > 4.0 * with_latent_heat, "{simple} {with_latent_heat}");
}

#[test]
fn what_goes_depends_neither_on_the_step_nor_on_the_lattice() {
    // When coagulating, more of the heat stays: with a tip at rest.
    let spray = Electrode { mode: Mode::Coagulate, power: 60.0, ..TIP };
    let run = |tip: Electrode, spacing: f64, dt: f64| {
        let mut heat = liver_block(spacing, ThermalMaterial::default());
        let volume = match tip.mode {
            Mode::Cut => stroke(&mut heat, dt, 1.0, tip),
            Mode::Coagulate => rest(&mut heat, dt, 3.0, tip),
        };
        assert_balanced(&heat, 1e-9);
        volume * 1e9
    };
    for (tip, others) in [
        (TIP, &[(0.5e-3, 0.001), (0.5e-3, 0.1), (0.25e-3, 0.01)][..]),
        (spray, &[(0.5e-3, 0.001), (0.5e-3, 0.1), (0.25e-3, 0.01)]),
    ] {
        let reference = run(tip, 0.5e-3, 0.01);
        assert!(reference > 4.0, "{reference} mm³");
        for &(spacing, dt) in others {
            let (volume, mode) = (run(tip, spacing, dt), tip.mode);
            assert!(
                (volume / reference - 1.0).abs() < 0.1,
                "{mode:?}, {spacing} m, {dt} s: {volume}, not {reference} mm³"
            );
        }
    }
}

#[test]
fn the_deeper_a_tip_is_pressed_the_more_of_it_is_in_contact_and_the_wider_its_heat_is_spread() {
    let pressed = |z: f64| {
        let mut heat = liver_block(0.25e-3, ThermalMaterial::default());
        let tip = Electrode { tip_in_rest: Point3::new(0.1e-3, 0.1e-3, z), mode: Mode::Coagulate, ..TIP };
        let report = heat.step(0.002, &[tip]).expect("a step");
        assert!((29.9..=30.0).contains(&report.absorbed), "all of the power: {} W", report.absorbed);
        (report.contact_area, report.hottest)
    };
    let radius = TIP.contact_radius();
    let (touching, deep) = (pressed(radius), pressed(0.0));
    assert!(touching.0 < 0.6e-6 && deep.0 == 1e-6, "{touching:?} {deep:?}");
    assert!(touching.1 - BODY > 1.3 * (deep.1 - BODY), "{touching:?} {deep:?}");
}

/// Components of the remaining mesh, connected by edges.
fn parts(triangles: &[[u32; 3]], removed: &[bool]) -> Vec<usize> {
    let left: Vec<usize> = (0..triangles.len()).filter(|triangle| !removed[*triangle]).collect();
    let mut label: Vec<usize> = (0..triangles.len()).collect();
    loop {
        let mut has_changed = false;
        for &a in &left {
            for &b in &left {
                let common = triangles[a].iter().filter(|vertex| triangles[b].contains(vertex)).count();
                if common == 2 && label[b] < label[a] {
                    (label[a], has_changed) = (label[b], true);
                }
            }
        }
        if !has_changed {
            break;
        }
    }
    let mut sizes = Vec::new();
    for root in &left {
        let size = left.iter().filter(|triangle| label[**triangle] == *root).count();
        sizes.extend((size > 0).then_some(size));
    }
    sizes
}

#[test]
fn a_membrane_is_cut_through() {
    let (positions, triangles) = membrane(16, 1e-3);
    let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 0.8e-3 };
    let mut heat =
        Electrosurgery::new(&tissue, ThermalMaterial::default(), LatticeConfig::default()).expect("tissue");
    let mut told = Vec::new();
    // Across the whole of it at 5 mm/s.
    for step in 0..360 {
        let x = -9e-3 + 5e-3 * f64::from(step) * 0.01;
        let tip = Electrode { tip_in_rest: Point3::new(x, 0.2e-3, 0.2e-3), ..TIP };
        heat.step(0.01, &[tip]).expect("a step");
        told.extend_from_slice(heat.removed_in_step());
    }
    let removed = heat.removed();
    assert_eq!(told.len(), removed.iter().filter(|removed| **removed).count(), "each is told once");
    let sizes = parts(&triangles, removed);
    assert_eq!(sizes.len(), 2, "two halves: {sizes:?}");
    assert!(told.len() < triangles.len() / 4, "a cut, no hole: {} of {}", told.len(), triangles.len());
    assert_balanced(&heat, 1e-9);
}

#[test]
fn a_massive_organ_gets_a_crater_with_char() {
    let (positions, tets) = block([16, 16, 8], 1e-3);
    let tissue = Tissue::Volume { positions: &positions, tets: &tets };
    let mut heat =
        Electrosurgery::new(&tissue, ThermalMaterial::default(), LatticeConfig::default()).expect("tissue");
    let spray = Electrode { mode: Mode::Coagulate, power: 40.0, ..TIP };
    let (mut smoke, mut steam) = (0.0, 0.0);
    for _ in 0..300 {
        let report = heat.step(0.01, &[spray]).expect("a step");
        smoke += report.smoke_rate * 0.01;
        steam += report.steam_rate * 0.01;
    }
    let removed: Vec<usize> = (0..tets.len()).filter(|tet| heat.removed()[*tet]).collect();
    assert!(!removed.is_empty() && removed.len() < tets.len() / 20, "{}", removed.len());
    let deepest =
        removed.iter().flat_map(|tet| tets[*tet]).map(|v| positions[v as usize].z).fold(0.0, f64::min);
    assert!((-4e-3..=-1e-3).contains(&deepest), "a crater, no hole: {deepest}");
    let charred: Vec<_> = heat.cells().filter(|cell| cell.is_charred && !cell.is_removed).collect();
    let coagulated = heat.cells().filter(|cell| cell.damage >= 1.0 && !cell.is_removed).count();
    assert!(!charred.is_empty() && coagulated > 5 * charred.len(), "{} {coagulated}", charred.len());
    let (cells, area) = heat.char();
    assert!(cells == charred.len() && area > 1e-6 && area < 6.0 * 0.25e-6 * cells as f64, "{cells} {area}");
    // Char lines the crater: most of it has removed tissue next to it.
    let gone: Vec<_> = heat.cells().filter(|cell| cell.is_removed).map(|cell| cell.middle_in_rest).collect();
    let lining =
        charred.iter().filter(|cell| gone.iter().any(|other| (other - cell.middle_in_rest).norm() < 1.01e-3));
    assert!(lining.count() * 4 > charred.len() * 3);
    // The wall is stiffer and shorter; far away nothing has changed.
    let factors: Vec<_> = (0..tets.len() as u32).map(|tet| heat.factors(tet)).collect();
    assert!(
        factors.iter().any(|factors| factors.stiffness > 5.0 && factors.length < 0.85 && !factors.is_removed)
    );
    assert!(factors.iter().filter(|f| f.stiffness == 1.0 && f.length == 1.0).count() > tets.len() / 2);
    assert!(smoke > 0.0 && steam > 0.0);
    let corner = heat.vertex(0).expect("a vertex");
    assert!((corner.0 - BODY).abs() < 0.01 && corner.1 == 0.0);
    let top = (0..positions.len() as u32).filter_map(|v| heat.vertex(v)).map(|at| at.0).fold(0.0, f64::max);
    assert!(top > 95.0, "vertices at the crater are hot: {top}");
    assert_balanced(&heat, 1e-9);
}

/// The scenario `cautery` on its liver: 4 s of cutting, then coagulation.
#[test]
fn what_a_cut_leaves_chars_when_the_hook_is_switched_to_coagulate() {
    let burned = |after: Mode, seconds: u32| {
        let (positions, tets) = block([16, 16, 6], 2e-3);
        let tissue = Tissue::Volume { positions: &positions, tets: &tets };
        let mut heat = Electrosurgery::new(&tissue, ThermalMaterial::default(), LatticeConfig::default())
            .expect("tissue");
        for step in 0..400 + 100 * seconds {
            let z = 0.5e-3 - 6.5e-3 * (f64::from(step) / 400.0).min(1.0);
            let mode = if step < 400 { Mode::Cut } else { after };
            heat.step(0.01, &[Electrode { tip_in_rest: Point3::new(0.0, 0.0, z), mode, ..TIP }])
                .expect("a step");
        }
        assert_balanced(&heat, 1e-9);
        heat.char()
    };
    assert_eq!(burned(Mode::Cut, 3), (0, 0.0), "what is cut bursts");
    let (cells, area) = burned(Mode::Coagulate, 3);
    assert!(cells > 0 && area > 2e-6, "{cells} cells, {area} m²");
    // Cells of 0.25 mm give 15.1 mm³ and 21 mm².
    let (cells, area) = burned(Mode::Coagulate, 6);
    let volume = LatticeConfig::default().spacing.powi(3) * cells as f64;
    assert!(
        (volume * 1e9 / 15.1 - 1.0).abs() < 0.1 && (area * 1e6 / 21.0 - 1.0).abs() < 0.1,
        "{cells} {area}"
    );
}

#[test]
fn where_tissue_is_coagulated_no_blood_cools_it_and_elsewhere_it_does() {
    let cooled_after = |material: ThermalMaterial| {
        let mut heat = liver_block(0.5e-3, material);
        for _ in 0..100 {
            heat.step(0.01, &[Electrode { power: 5.0, mode: Mode::Coagulate, ..TIP }]).expect("a step");
        }
        let before = heat.ledger().perfusion;
        for _ in 0..100 {
            heat.step(0.1, &[]).expect("a step");
        }
        assert_balanced(&heat, 1e-9);
        heat.ledger().perfusion - before
    };
    let usual = ThermalMaterial::default();
    // Perfusion that never stops.
    let mut endless = usual;
    endless.damage.frequency = 0.0;
    let (stops, never) = (cooled_after(usual), cooled_after(endless));
    assert!(stops > 0.0 && never > 1.2 * stops, "{stops} {never}");
}

#[test]
fn a_burn_that_the_tip_has_left_goes_on_cooling_and_the_lattice_is_given_back() {
    let mut heat = liver_block(0.5e-3, ThermalMaterial::default());
    stroke(&mut heat, 0.01, 0.5, TIP);
    let removed = heat.cells().filter(|cell| cell.is_removed).count();
    let far = Electrode { tip_in_rest: Point3::new(8e-3, 8e-3, 0.0), power: 0.0, ..TIP };
    let mut active = u32::MAX;
    for _ in 0..600 {
        active = heat.step(0.5, &[far]).expect("a step").active_blocks;
    }
    assert_eq!(active, 0);
    let hottest = heat.cells().filter(|cell| !cell.is_removed).map(|cell| cell.celsius).fold(0.0, f64::max);
    assert!(hottest < 38.0, "{hottest}");
    assert_eq!(heat.cells().filter(|cell| cell.is_removed).count(), removed, "the crater stays");
    assert_balanced(&heat, 1e-9);
}

#[test]
fn a_state_goes_on_bit_for_bit() {
    let (positions, tets) = block([6, 6, 4], 3e-3);
    let tissue = Tissue::Volume { positions: &positions, tets: &tets };
    let (material, lattice) = (ThermalMaterial::default(), LatticeConfig::default());
    let mut heat = Electrosurgery::new(&tissue, material, lattice).expect("tissue");
    stroke(&mut heat, 0.01, 0.3, TIP);
    let text = serde_json::to_string(&heat.state()).expect("a state");
    let state = serde_json::from_str(&text).expect("a state");
    let mut restored = Electrosurgery::restore(&tissue, material, lattice, &state).expect("its state");
    assert_eq!(restored.state(), heat.state());
    for heat in [&mut heat, &mut restored] {
        stroke(heat, 0.01, 0.4, Electrode { mode: Mode::Coagulate, ..TIP });
    }
    assert_eq!(restored.state(), heat.state());
    assert_eq!(restored.removed(), heat.removed());
    let mut wrong = state.clone();
    wrong.celsius[3] = f64::NAN;
    let error = Electrosurgery::restore(&tissue, material, lattice, &wrong).expect_err("not a temperature");
    assert_eq!(error.to_string(), "state: celsius: value 3 is NaN, -273.15 to 100000 is valid");
}

#[test]
fn a_step_that_is_refused_changes_nothing() {
    let mut heat = liver_block(0.5e-3, ThermalMaterial::default());
    stroke(&mut heat, 0.01, 0.1, TIP);
    let before = heat.state();
    let nowhere = Electrode { tip_in_rest: Point3::new(f64::NAN, 0.0, 0.0), ..TIP };
    let endless = Electrode { power: f64::INFINITY, ..TIP };
    for (dt, electrodes) in [
        (0.01, vec![nowhere]),
        (0.01, vec![endless]),
        (f64::NAN, vec![]),
        (2.0, vec![]),
        (0.01, vec![TIP; 17]),
    ] {
        heat.step(dt, &electrodes).expect_err("no such step");
        assert_eq!(heat.state(), before);
    }
    let needle = Electrode { contact_area: 1e-8, power: 500.0, ..TIP };
    let fine = LatticeConfig { spacing: 0.05e-3, ..LatticeConfig::default() };
    let (positions, tets) = block([1, 1, 1], 1e-3);
    let tissue = Tissue::Volume { positions: &positions, tets: &tets };
    let mut heat = Electrosurgery::new(&tissue, ThermalMaterial::default(), fine).expect("tissue");
    let error = heat.step(1.0, &[needle]).expect_err("too strong");
    assert!(matches!(error, HeatStepError::TooStrong { .. }), "{error}");
    assert_eq!(heat.ledger().supplied, 0.0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10))]
    #[test]
    fn whatever_is_done_heat_in_is_heat_stored_and_heat_gone(
        strokes in prop::collection::vec(
            (-9e-3..9e-3_f64, -9e-3..9e-3_f64, -2e-3..1e-3_f64, 0.0..80.0_f64, any::<bool>(), 0.3e-6..4e-6_f64, 0.001..0.05_f64),
            1..8,
        ),
        has_latent_heat in any::<bool>(),
        blocks_max in 4..200_usize,
    ) {
        let (positions, tets) = block([6, 6, 4], 3e-3);
        let material = ThermalMaterial { has_latent_heat, ..ThermalMaterial::default() };
        let lattice = LatticeConfig { blocks_max, ..LatticeConfig::default() };
        let tissue = Tissue::Volume { positions: &positions, tets: &tets };
        let mut heat = Electrosurgery::new(&tissue, material, lattice).expect("tissue");
        heat.hold(0, Some(30.0));
        for (x, y, z, power, is_cut, contact_area, dt) in strokes {
            let mode = if is_cut { Mode::Cut } else { Mode::Coagulate };
            let tip = Electrode { tip_in_rest: Point3::new(x, y, z), power, mode, contact_area };
            for _ in 0..12 {
                let report = heat.step(dt, &[tip]).expect("a step");
                prop_assert!(report.absorbed <= power * (1.0 + 1e-12));
                let ledger = heat.ledger();
                let missing = ledger.missing(heat.stored()).abs();
                prop_assert!(missing <= 1e-9 * (ledger.supplied + 1.0), "{} J of {:?}", missing, ledger);
            }
        }
        for cell in heat.cells() {
            prop_assert!(cell.celsius.is_finite() && cell.celsius > 0.0 && (0.0..=1.0).contains(&cell.water));
            prop_assert!(cell.is_removed || cell.water == 0.0 || cell.celsius < 100.5, "{:?}", cell);
        }
    }
}
