//! Heat on the lattice against closed forms: a drying front, the spread of a joule, a face held at a temperature, a needle
//! in tissue.

use crate::support::heated_tissue::block;
use nalgebra::{Point3, Vector3};
use trocar_simulator::electrosurgery::{
    BODY, Electrode, Electrosurgery, HeldPlane, LatticeConfig, Mode, ThermalMaterial, Tissue,
};

/// A block of cubes with a corner at the origin.
fn bar(cells: [u32; 3], spacing: f64) -> (Vec<Point3<f64>>, Vec<[u32; 4]>) {
    let (positions, tets) = block(cells, spacing);
    let [x, y, z] = cells.map(|count| f64::from(count) * spacing);
    let corner = Vector3::new(x / 2.0, y / 2.0, z);
    (positions.into_iter().map(|place| place + corner).collect(), tets)
}

fn error_function(x: f64) -> f64 {
    let steps = 400;
    let by = x / f64::from(steps);
    let sum: f64 = (0..steps).map(|step| (-((f64::from(step) + 0.5) * by).powi(2)).exp()).sum();
    sum * by * 2.0 / std::f64::consts::PI.sqrt()
}

fn heated(mesh: (&[Point3<f64>], &[[u32; 4]]), material: ThermalMaterial, spacing: f64) -> Electrosurgery {
    let tissue = Tissue::Volume { positions: mesh.0, tets: mesh.1 };
    Electrosurgery::new(&tissue, material, LatticeConfig { spacing, ..LatticeConfig::default() })
        .expect("tissue")
}

/// Half of the depth of the front over the root of the diffusivity of dried tissue times the time (Stefan 1891), where
/// `stefan` is the heat of dried tissue up to the face's temperature over the latent heat.
fn front(stefan: f64) -> f64 {
    let off = |x: f64| x * (x * x).exp() * error_function(x) - stefan / std::f64::consts::PI.sqrt();
    let (mut low, mut high) = (0.0, 2.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if off(middle) < 0.0 { low = middle } else { high = middle }
    }
    low
}

#[test]
fn a_drying_front_advances_as_stefans_whatever_the_cell_and_the_heat() {
    let material =
        ThermalMaterial { perfusion: 0.0, charring: 1e4, ablation: 1e4, ..ThermalMaterial::default() };
    let (positions, tets) = bar([6, 1, 1], 1e-3);
    for (spacing, celsius) in [(0.5e-3, 180.0), (0.5e-3, 350.0), (0.25e-3, 350.0)] {
        let mut heat = heated((&positions, &tets), material, spacing);
        // All of it is about to boil.
        for vertex in 0..positions.len() as u32 {
            assert!(heat.hold(vertex, Some(material.boiling)) && heat.hold(vertex, None));
        }
        assert!(heat.refine(&Point3::origin(), &Point3::new(5.9e-3, 0.9e-3, 0.9e-3)) > 0);
        assert!(heat.hold_planes(&[HeldPlane { axis: 0, at: 0.0, celsius }]));
        let ratio = front(material.dry_capacity() * (celsius - material.boiling) / material.latent());
        let diffusivity = material.dry_conductivity / material.dry_capacity();
        let mut time = 0.0;
        for depth in [1e-3, 1.7e-3] {
            let until = (depth / (2.0 * ratio)).powi(2) / diffusivity;
            let steps = ((until - time) / 0.5_f64).ceil();
            for _ in 0..steps as u32 {
                heat.step((until - time) / steps, &[]).expect("a step");
            }
            time = until;
            let dried: f64 = heat.cells().map(|cell| (1.0 - cell.water) * cell.volume).sum::<f64>() / 1e-6;
            assert!((dried / depth - 1.0).abs() < 0.01, "{spacing} m, {celsius} °C: {dried} m of {depth} m");
        }
        assert!(heat.ledger().missing(heat.stored()).abs() < 1e-9 * heat.ledger().held.abs());
    }
}

/// Mean square distance of the heat from a point \[m²\], and the heat \[J\].
fn spread(heat: &Electrosurgery, positions: &[Point3<f64>], from: &Point3<f64>) -> (f64, f64) {
    let capacity = heat.material().wet_capacity();
    let mesh = heat
        .mesh_heat()
        .zip(positions)
        .map(|((celsius, capacity), place)| (capacity * (celsius - BODY), *place));
    let cells = heat.cells().zip(heat.cell_excess());
    let cells = cells.map(|(cell, excess)| (capacity * cell.volume * excess, cell.middle_in_rest));
    let (square, all) = mesh.chain(cells).fold((0.0, 0.0), |(square, all), (joules, place)| {
        (square + joules * (place - from).norm_squared(), all + joules)
    });
    (square / all, all)
}

#[test]
fn a_joule_spreads_as_the_heat_equation_has_it_on_the_lattice_and_on_any_mesh() {
    let material = ThermalMaterial { perfusion: 0.0, ..ThermalMaterial::default() };
    let diffusivity = material.conductivity / material.wet_capacity();
    let (middle, joules) = (Point3::new(0.016, 0.016, 0.016), 0.05);
    for (mesh, cells) in [(4e-3, 8), (2e-3, 16)] {
        let (positions, tets) = bar([cells; 3], mesh);
        let mut heat = heated((&positions, &tets), material, 0.5e-3);
        for corner in 0..8 {
            let off = |bit: i32| 0.25e-3 * f64::from(2 * (corner >> bit & 1) - 1);
            let place = Point3::new(middle.x + off(0), middle.y + off(1), middle.z + off(2));
            assert!(heat.warm(&place, joules / 8.0));
        }
        let before = 3.0 * 0.25e-3_f64.powi(2);
        let (mut time, mut on_mesh) = (0.0, false);
        for until in [1.0, 3.0, 6.0, 10.0, 14.0] {
            while time < until - 1e-9 {
                let report = heat.step(0.1, &[]).expect("a step");
                on_mesh = report.active_blocks == 0;
                time += 0.1;
            }
            let (square, all) = spread(&heat, &positions, &middle);
            let wanted = before + 6.0 * diffusivity * time;
            assert!((all / joules - 1.0).abs() < 1e-6, "{all} J of {joules} J");
            assert!(
                (square / wanted - 1.0).abs() < 0.02,
                "mesh {mesh} m, {time} s: {square} m², not {wanted} m²"
            );
        }
        assert!(on_mesh, "all of it is on the mesh in the end");
    }
    let (positions, tets) = bar([2; 3], 2e-3);
    let mut heat = heated((&positions, &tets), material, 0.5e-3);
    assert!(!heat.warm(&Point3::new(0.1, 0.0, 0.0), 1.0) && !heat.warm(&Point3::origin(), f64::NAN));
    assert!(!heat.hold_planes(&[HeldPlane { axis: 3, at: 0.0, celsius: 50.0 }]));
}

#[test]
fn a_held_face_cools_the_lattice_as_the_error_function() {
    let material = ThermalMaterial { perfusion: 0.0, ..ThermalMaterial::default() };
    let diffusivity = material.conductivity / material.wet_capacity();
    let (positions, tets) = bar([12, 1, 1], 1e-3);
    for (spacing, by_plane, tolerance) in
        [(0.5e-3, false, 0.04), (0.25e-3, false, 0.01), (0.25e-3, true, 0.01)]
    {
        let mut heat = heated((&positions, &tets), material, spacing);
        let cells = (12e-3_f64 / spacing).round() as i32;
        let across = (1e-3_f64 / spacing).round() as i32;
        let at = |index: i32| (f64::from(index) + 0.5) * spacing;
        for (i, j, k) in
            (0..cells).flat_map(|i| (0..across).flat_map(move |j| (0..across).map(move |k| (i, j, k))))
        {
            assert!(
                heat.warm(
                    &Point3::new(at(i), at(j), at(k)),
                    20.0 * material.wet_capacity() * spacing.powi(3)
                )
            );
        }
        if by_plane {
            assert!(heat.hold_planes(&[HeldPlane { axis: 0, at: 0.0, celsius: BODY }]));
        } else {
            for (vertex, _) in (0..).zip(&positions).filter(|(_, place)| place.x == 0.0) {
                assert!(heat.hold(vertex, Some(BODY)));
                assert_eq!(heat.vertex(vertex).expect("a vertex").0, BODY);
            }
        }
        let seconds = 10.0;
        for _ in 0..100 {
            heat.step(seconds / 100.0, &[]).expect("a step");
        }
        for depth in [0.75e-3, 1.75e-3, 3.25e-3] {
            let near = heat.cells().filter(|cell| (cell.middle_in_rest.x - depth).abs() < 0.51 * spacing);
            let (sum, count) =
                near.fold((0.0, 0.0), |(sum, count), cell| (sum + cell.celsius - BODY, count + 1.0));
            let wanted = 20.0 * error_function(depth / (4.0 * diffusivity * seconds).sqrt());
            assert!(
                (sum / count / wanted - 1.0).abs() < tolerance,
                "{spacing} m, {depth} m deep: {} K, not {wanted} K",
                sum / count
            );
        }
        assert!(heat.ledger().held > 0.0 && heat.ledger().missing(heat.stored()).abs() < 1e-9);
    }
}

#[test]
fn a_needle_in_tissue_gives_all_of_its_power_wherever_it_is_in_a_cell() {
    let (positions, tets) = bar([6; 3], 2e-3);
    for (area, mode) in [(1e-8, Mode::Cut), (1e-7, Mode::Cut), (1e-7, Mode::Coagulate), (6e-7, Mode::Cut)] {
        let mut heat = heated((&positions, &tets), ThermalMaterial::default(), 0.5e-3);
        for place in 0..27 {
            let along = |axis: u32| 6e-3 + 0.25e-3 * f64::from(place / 3_i32.pow(axis) % 3);
            let tip_in_rest = Point3::new(along(0), along(1), along(2));
            let report = heat.step(1e-3, &[Electrode { tip_in_rest, power: 0.5, mode, contact_area: area }]);
            let absorbed = report.expect("a step").absorbed;
            assert!(
                (absorbed / 0.5 - 1.0).abs() < 1e-9,
                "{area} m², {mode:?}, at {tip_in_rest}: {absorbed} W of 0.5 W"
            );
        }
    }
}
