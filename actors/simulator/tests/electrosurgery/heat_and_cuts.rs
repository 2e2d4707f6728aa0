//! Heat and cuts: no heat crosses a cut, neither on the lattice nor in the organ's mesh; existing heat is conserved.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::{Point3, Vector3};
use trocar_dynamics::tet_mesh::{BoxCells, NodeOrigin, box_cells};
use trocar_scene::{Activation, HeatFrozen, Pose, RestPositions, Temperature, TetMesh, VertexPositions};
use trocar_simulator::controller::ElectrosurgeryController;
use trocar_simulator::controller::cutting::volume::VolumeCuts;
use trocar_simulator::electrosurgery::{
    BODY, CutTissue, Electrode, Electrosurgery, LatticeConfig, Mode, ThermalMaterial, Tissue,
};

type Elements<const N: usize> = Vec<[u32; N]>;

/// A block of liver of 1 mm cells about the origin, its upper side at z = 0.
fn block() -> (Vec<Point3<f64>>, Elements<4>) {
    let size = Vector3::new(0.012, 0.008, 0.006);
    let origin = Point3::new(-0.006, -0.004, -0.006);
    box_cells(&BoxCells { cells: [12, 8, 6], size, origin })
}

/// A membrane of 1 mm squares about the origin.
fn membrane() -> (Vec<Point3<f64>>, Elements<3>) {
    let at = |i: u32, j: u32| i * 9 + j;
    let place = |i: u32, j: u32| Point3::new(f64::from(i) * 1e-3 - 6e-3, f64::from(j) * 1e-3 - 4e-3, 0.0);
    let positions = (0..=12).flat_map(|i| (0..=8).map(move |j| place(i, j))).collect();
    let cells = (0..12).flat_map(|i| (0..8).map(move |j| (i, j)));
    let triangles = cells.flat_map(|(i, j)| {
        [[at(i, j), at(i + 1, j), at(i + 1, j + 1)], [at(i, j), at(i + 1, j + 1), at(i, j + 1)]]
    });
    (positions, triangles.collect())
}

/// A mesh cut at x = 0 where `is_cut`: the part at x < 0 has its own vertices there.
struct CutMesh<const N: usize> {
    positions: Vec<Point3<f64>>,
    elements: Elements<N>,
    of: Vec<u32>,
    births: Vec<NodeOrigin>,
}

fn cut<const N: usize>(
    positions: &[Point3<f64>],
    elements: &[[u32; N]],
    is_cut: impl Fn(&Point3<f64>) -> bool,
) -> CutMesh<N> {
    let mut cut = CutMesh {
        positions: positions.to_vec(),
        elements: elements.to_vec(),
        of: (0..elements.len() as u32).collect(),
        births: Vec::new(),
    };
    let mut twins = vec![None; positions.len()];
    for (vertex, at) in (0..).zip(positions).filter(|(_, at)| at.x.abs() < 1e-9 && is_cut(at)) {
        twins[vertex as usize] = Some(cut.positions.len() as u32);
        cut.positions.push(*at);
        cut.births.push(NodeOrigin { of: [vertex; 2], share: 0.0 });
    }
    for element in &mut cut.elements {
        if element.iter().any(|vertex| positions[*vertex as usize].x < -1e-9) {
            element.iter_mut().for_each(|vertex| *vertex = twins[*vertex as usize].unwrap_or(*vertex));
        }
    }
    cut
}

impl CutMesh<4> {
    fn parted(&self) -> CutTissue<'_> {
        let tissue = Tissue::Volume { positions: &self.positions, tets: &self.elements };
        CutTissue { tissue, of: &self.of, births: &self.births }
    }

    /// Halves every element at the cut at its longest edge, as a blade's path may do.
    fn halved(mut self) -> Self {
        let near = |at: &Point3<f64>| at.x.abs() < 1.5e-3;
        let mut element = 0;
        while element < self.elements.len().min(6000) && self.births.len() < 2000 {
            let tet = self.elements[element];
            let corners = tet.map(|vertex| self.positions[vertex as usize]);
            let pairs = (0..4).flat_map(|a| (0..a).map(move |b| [b, a]));
            let length = |[a, b]: &[usize; 2]| (corners[*a] - corners[*b]).norm();
            let longest = pairs.max_by(|p, q| length(p).total_cmp(&length(q))).expect("six");
            let is_long = length(&longest) > 1.7e-3 && corners.iter().any(near);
            if is_long {
                let ends = longest.map(|corner| tet[corner]);
                let middle = self.positions.len() as u32;
                self.positions.push(nalgebra::center(&corners[longest[0]], &corners[longest[1]]));
                self.births.push(NodeOrigin { of: ends, share: 0.5 });
                // All that have the edge.
                for other in 0..self.elements.len() {
                    if ends.iter().all(|end| self.elements[other].contains(end)) {
                        let mut child = self.elements[other];
                        child.iter_mut().filter(|v| **v == ends[0]).for_each(|v| *v = middle);
                        self.elements[other].iter_mut().filter(|v| **v == ends[1]).for_each(|v| *v = middle);
                        self.elements.push(child);
                        self.of.push(self.of[other]);
                    }
                }
            } else {
                element += 1;
            }
        }
        self
    }
}

fn assert_balanced(heat: &Electrosurgery) {
    let ledger = heat.ledger();
    let missing = ledger.missing(heat.stored()).abs();
    assert!(missing <= 1e-9 * ledger.supplied.max(ledger.held.abs()), "{missing} J missing of {ledger:?}");
}

fn fresh(tissue: &Tissue<'_>) -> Electrosurgery {
    Electrosurgery::new(tissue, ThermalMaterial::default(), LatticeConfig::default()).expect("tissue")
}

/// A tip at x \[mm\], active for two seconds, followed by a pause.
fn burn(heat: &mut Electrosurgery, x: f64, seconds: f64) {
    let tip = Electrode {
        tip_in_rest: Point3::new(x * 1e-3, 0.1e-3, 0.0),
        power: 8.0,
        mode: Mode::Coagulate,
        contact_area: 0.3e-6,
    };
    for _ in 0..200 {
        heat.step(0.01, &[tip]).expect("a step");
    }
    for _ in 0..(seconds / 0.1) as u32 {
        heat.step(0.1, &[]).expect("a step");
    }
}

/// Hottest and coldest \[°C\] at x < 0, and the hottest elsewhere: of cells, and of vertices.
fn sides(heat: &Electrosurgery, cut: &[Point3<f64>], elements: &[impl AsRef<[u32]>]) -> [f64; 2] {
    let (mut left, mut right) = (f64::MIN, f64::MIN);
    let mut see = |is_left: bool, celsius: f64| {
        let side = if is_left { &mut left } else { &mut right };
        *side = side.max(celsius);
    };
    for cell in heat.cells().filter(|cell| !cell.is_removed) {
        see(cell.middle_in_rest.x < 0.0, cell.celsius);
    }
    for element in elements.iter().map(AsRef::as_ref) {
        let is_left = element.iter().any(|vertex| cut[*vertex as usize].x < -1e-9);
        element.iter().for_each(|vertex| see(is_left, heat.vertex(*vertex).expect("a vertex").0));
    }
    [left, right]
}

#[test]
fn a_cut_between_hot_and_cold_keeps_the_cold_side_cold() {
    let (positions, tets) = block();
    let first = Tissue::Volume { positions: &positions, tets: &tets };
    let all = |_: &Point3<f64>| true;
    for parted in [cut(&positions, &tets, all), cut(&positions, &tets, all).halved()] {
        let mut heat = fresh(&first);
        heat.part(&parted.parted()).expect("a parted block");
        burn(&mut heat, 3.0, 20.0);
        assert_balanced(&heat);
        let [left, right] = sides(&heat, &parted.positions, &parted.elements);
        assert!(right > BODY + 4.0, "{right} °C where it burned");
        assert!(
            (left - BODY).abs() < 1e-6,
            "{left} °C beyond the cut, with {} vertices",
            parted.positions.len()
        );
    }
    // The control.
    let mut heat = fresh(&first);
    burn(&mut heat, 3.0, 20.0);
    let [left, _] = sides(&heat, &positions, &tets);
    assert!(left > BODY + 2.0, "{left} °C without a cut");
}

#[test]
fn a_cut_membrane_keeps_its_cold_side_cold() {
    let (positions, triangles) = membrane();
    let first = Tissue::Membrane { positions: &positions, triangles: &triangles, thickness: 1e-3 };
    let parted = cut(&positions, &triangles, |_| true);
    let CutMesh { positions: places, elements, of, births } = &parted;
    let mut heat = fresh(&first);
    let tissue = Tissue::Membrane { positions: places, triangles: elements, thickness: 1e-3 };
    heat.part(&CutTissue { tissue, of, births }).expect("a parted membrane");
    burn(&mut heat, 3.0, 10.0);
    assert_balanced(&heat);
    let [left, right] = sides(&heat, places, elements);
    assert!(right > BODY + 4.0 && (left - BODY).abs() < 1e-6, "{left} and {right} °C");
    let mut heat = fresh(&first);
    burn(&mut heat, 3.0, 10.0);
    let [left, _] = sides(&heat, &positions, &triangles);
    assert!(left > BODY + 2.0, "{left} °C without a cut");
}

#[test]
fn what_is_warm_stays_so_when_it_is_cut_and_goes_on_from_a_state_to_the_bit() {
    let (positions, tets) = block();
    let first = Tissue::Volume { positions: &positions, tets: &tets };
    let (material, lattice) = (ThermalMaterial::default(), LatticeConfig::default());
    let mut heat = fresh(&first);
    burn(&mut heat, 0.3, 1.0);
    let (before, whole) = (heat.stored(), heat.state());
    // Half way through, then wholly, with elements halved.
    let half = cut(&positions, &tets, |at| at.z > -3.1e-3);
    heat.part(&half.parted()).expect("a parted block");
    assert!((heat.stored() / before - 1.0).abs() < 1e-12, "{} of {before} J", heat.stored());
    assert_balanced(&heat);
    let state = heat.state();
    let mut again = Electrosurgery::restore_parted(&first, Some(&half.parted()), material, lattice, &state)
        .expect("its state");
    for heat in [&mut heat, &mut again] {
        burn(heat, 0.3, 1.0);
    }
    assert_eq!(heat.state(), again.state());
    // A state from before the cut, restored with the cut known.
    let further = half.halved();
    let mut late = Electrosurgery::restore_parted(&first, Some(&further.parted()), material, lattice, &whole)
        .expect("an earlier state");
    assert!((late.stored() / before - 1.0).abs() < 1e-12, "{} of {before} J", late.stored());
    burn(&mut late, 0.3, 1.0);
    assert_balanced(&late);
    // Invalid input is rejected by name.
    let of = vec![99_999; further.of.len()];
    let wrong = CutTissue { of: &of, ..further.parted() };
    let error = late.part(&wrong).expect_err("no such element");
    assert!(error.to_string().starts_with("parted: a part of element 99999"), "{error}");
}

/// The controller, when another controller cuts the liver while it is heated.
#[test]
fn heat_follows_the_cuts_of_a_body_in_the_scene() {
    let text = "[[entity]]\nname = \"rod\"\npose = { translation = [0.0, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }\n\
                instrument = { kind = \"hook_cautery\", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.004, jaws = 0 }\n\
                electrode = { power = 8.0, contact_area = 3e-7, coagulates = true }\n\
                [[entity]]\nname = \"liver\"\nmesh = { block = { size = [0.012, 0.008, 0.006], cells = [12, 8, 6] } }\n\
                cauterised = {}\nxpbd = { matter = { volume = { young_modulus = 5000.0, poisson_ratio = 0.3, density = 1060.0 } } }\n";
    let farthest = |is_cut: bool| {
        let mut stage = Stage::new(scene(text), 50.0, ElectrosurgeryController::new);
        let positions = stage.get::<VertexPositions>("liver").positions.to_vec();
        let tets = stage.get::<TetMesh>("liver").tets.to_vec();
        let top = positions.iter().map(|at| at.z).fold(f64::MIN, f64::max);
        let rotation = nalgebra::Isometry3::rotation(Vector3::x() * std::f64::consts::PI);
        stage.put("rod", Pose { translation: Vector3::new(3e-3, 0.0, top), ..Pose::from(rotation) });
        let parted = cut(&positions, &tets, |_| true);
        stage.put("liver", RestPositions { positions: Arc::new(positions.clone()) });
        if is_cut {
            let cuts = VolumeCuts {
                births: Arc::new(parted.births.clone()),
                first: Arc::new(tets.clone()),
                ..VolumeCuts::default()
            };
            stage.put("liver", cuts);
            stage.put("liver", TetMesh { tets: Arc::new(parted.elements.clone()) });
            stage.put("liver", RestPositions { positions: Arc::new(parted.positions.clone()) });
            stage.put("liver", VertexPositions { positions: Arc::new(parted.positions.clone()) });
        }
        // Cuts are checked for in every tenth tick.
        (0..10).for_each(|_| stage.tick());
        stage.put("rod", Activation { level: 1.0, since: stage.now(), mode: None });
        for life in 0..2 {
            (0..50).for_each(|_| stage.tick());
            stage.put("rod", Activation { level: 0.0, since: stage.now(), mode: None });
            (0..500).for_each(|_| stage.tick());
            assert!(!stage.has::<HeatFrozen>("liver"));
            if life == 0 {
                stage.rebuild(ElectrosurgeryController::new);
            }
        }
        let celsius = stage.get::<Temperature>("liver").celsius;
        let now = if is_cut { &parted.positions } else { &positions };
        assert_eq!(celsius.len(), now.len());
        let left = now.iter().zip(celsius.iter()).filter(|(at, _)| at.x < -1e-9);
        left.map(|(_, celsius)| *celsius).fold(f64::MIN, f64::max)
    };
    let [cut, whole] = [true, false].map(farthest);
    assert!((cut - BODY).abs() < 1e-6, "{cut} °C beyond the cut");
    assert!(whole > BODY + 1.0, "{whole} °C without");
}
