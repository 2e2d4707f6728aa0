//! Removed volume under refinement of the lattice, of the mesh and of the step.

use nalgebra::Point3;
use trocar_simulator::electrosurgery::{
    Electrode, Electrosurgery, LatticeConfig, Mode, ThermalMaterial, Tissue,
};

use crate::support::heated_tissue::{TIP, assert_balanced, block, liver_block, membrane, rest, stroke};

/// Volume ablated by a coagulating tip: the mean over positions within a cell \[mm³\].
fn ablated(places: usize, [power, seconds, depth]: [f64; 3], spacing: f64, dt: f64) -> f64 {
    // Evenly over a quarter of a cell of 0.5 mm; the other quarters are mirror images.
    const PLACES: [[f64; 2]; 4] = [[0.03, 0.16], [0.22, 0.09], [0.09, 0.03], [0.16, 0.22]];
    let volumes = PLACES[..places].iter().map(|[x, y]| {
        let mut heat = liver_block(spacing, ThermalMaterial::default());
        let tip_in_rest = Point3::new(x * 1e-3, y * 1e-3, -depth);
        let tip = Electrode { tip_in_rest, power, mode: Mode::Coagulate, ..TIP };
        let steps = (seconds / dt).round() as u32;
        let volume: f64 = (0..steps).map(|_| heat.step(dt, &[tip]).expect("a step").removed_volume).sum();
        assert_balanced(&heat, 1e-9);
        volume * 1e9
    });
    volumes.sum::<f64>() / places as f64
}

/// Craters of two to four cells' depth. Of 40 W in 2 s cells of 0.125 mm give 2.5 mm³.
#[test]
fn what_a_coagulating_tip_ablates_depends_neither_on_the_step_nor_on_the_lattice_however_deep_the_crater() {
    for tip in [[20.0, 4.0, 0.0], [40.0, 2.0, 0.0], [40.0, 2.0, 0.6e-3], [60.0, 3.0, 0.0]] {
        let alike = |other: f64, reference: f64, what: &str| {
            assert!(reference > 1.5, "{tip:?}: {reference} mm³");
            assert!((other / reference - 1.0).abs() < 0.1, "{tip:?}, {what}: {other}, not {reference} mm³");
        };
        // On a finer lattice the position within a cell matters less.
        alike(ablated(2, tip, 0.25e-3, 0.01), ablated(4, tip, 0.5e-3, 0.01), "cells of 0.25 mm");
        let reference = ablated(1, tip, 0.5e-3, 0.01);
        alike(ablated(1, tip, 0.5e-3, 0.1), reference, "steps of 0.1 s");
        alike(ablated(1, tip, 0.5e-3, 0.001), reference, "steps of 1 ms");
    }
}

/// Removed volume of the lattice and of the mesh \[mm³\].
#[derive(Clone, Copy, Debug)]
struct Gone {
    cells: f64,
    elements: f64,
}

fn gone(heat: &Electrosurgery, volume_of: impl Fn(usize) -> f64, cells: f64) -> Gone {
    assert_balanced(heat, 1e-9);
    let removed = heat.removed().iter().enumerate().filter(|(_, removed)| **removed);
    Gone { cells: cells * 1e9, elements: removed.map(|(element, _)| volume_of(element)).sum::<f64>() * 1e9 }
}

fn of_organ(mesh: f64, spacing: f64, dt: f64, mode: Mode) -> Gone {
    let cells = [18e-3, 18e-3, 9e-3].map(|size: f64| (size / mesh).round() as u32);
    let (positions, tets) = block(cells, mesh);
    let tissue = Tissue::Volume { positions: &positions, tets: &tets };
    let lattice = LatticeConfig { spacing, ..LatticeConfig::default() };
    let mut heat = Electrosurgery::new(&tissue, ThermalMaterial::default(), lattice).expect("tissue");
    let volume = match mode {
        Mode::Cut => stroke(&mut heat, dt, 1.0, TIP),
        Mode::Coagulate => rest(&mut heat, dt, 3.0, Electrode { mode, power: 60.0, ..TIP }),
    };
    gone(&heat, |_| mesh.powi(3) / 6.0, volume)
}

fn of_fold(mesh: f64, spacing: f64, dt: f64, mode: Mode) -> Gone {
    let thickness = 1e-3;
    let (positions, triangles) = membrane((12e-3 / mesh).round() as u32, mesh);
    let tissue = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness };
    let lattice = LatticeConfig { spacing, ..LatticeConfig::default() };
    let mut heat = Electrosurgery::new(&tissue, ThermalMaterial::default(), lattice).expect("tissue");
    let volume = match mode {
        Mode::Cut => stroke(&mut heat, dt, 1.0, TIP),
        Mode::Coagulate => rest(&mut heat, dt, 2.0, Electrode { mode, power: 40.0, ..TIP }),
    };
    gone(&heat, |_| mesh * mesh / 2.0 * thickness, volume)
}

#[test]
fn what_goes_does_not_depend_on_the_mesh() {
    type Of = fn(f64, f64, f64, Mode) -> Gone;
    for (what, of, mesh) in [("an organ", of_organ as Of, 1e-3), ("a membrane", of_fold as Of, 0.5e-3)] {
        for mode in [Mode::Cut, Mode::Coagulate] {
            let reference = of(mesh, 0.5e-3, 0.01, mode);
            assert!(reference.cells > 1.0, "{what} {mode:?}: {reference:?}");
            for (other, spacing, dt) in [
                (mesh / 2.0, 0.5e-3, 0.01),
                (mesh, 0.5e-3, 0.001),
                (mesh, 0.5e-3, 0.1),
                (mesh, 0.25e-3, 0.01),
            ] {
                let now = of(other, spacing, dt, mode);
                for (now, reference) in [(now.cells, reference.cells), (now.elements, reference.elements)] {
                    let off = (now / reference - 1.0).abs();
                    assert!(
                        off < 0.1,
                        "{what} {mode:?}, edges of {other} m, cells of {spacing} m, {dt} s: {now}, not {reference} mm³"
                    );
                }
            }
        }
    }
}
