//! Blocks of tissue, needles and jaws that tests of sewing share.
#![allow(dead_code)] // every test uses another part

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use trocar_simulator::elasticity::Elastic;
use trocar_simulator::needle::{NeedleShape, NeedleState};
use trocar_simulator::suture::{Grip, Resistance, Suture, SutureState, Tissue};
use trocar_simulator::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::thread::{ThreadMaterial, ThreadState};

/// Young's modulus \[Pa\] of the blocks: soft tissue.
pub const YOUNG: f64 = 3e4;

/// A block, held below: nodes at its smallest z.
pub fn block(size: [f64; 3], cells: [usize; 3], origin: [f64; 3]) -> (TetMesh, Vec<u32>) {
    blocks(&[(size, cells, origin)])
}

/// Several blocks in one mesh, all held below.
pub fn blocks(boxes: &[([f64; 3], [usize; 3], [f64; 3])]) -> (TetMesh, Vec<u32>) {
    let (mut nodes, mut tets, mut fixed) = (Vec::new(), Vec::new(), Vec::new());
    for (size, cells, origin) in boxes {
        let grid = BoxCells { cells: *cells, size: (*size).into(), origin: (*origin).into() };
        let (more, own) = box_cells(&grid);
        let first = nodes.len() as u32;
        fixed.extend(
            (0..more.len() as u32).filter(|n| more[*n as usize].z < origin[2] + 1e-9).map(|n| n + first),
        );
        nodes.extend(more);
        tets.extend(own.iter().map(|tet| tet.map(|node| node + first)));
    }
    (TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh"), fixed)
}

pub fn elastic() -> Elastic {
    Elastic::new(YOUNG, 0.4).expect("a material")
}

pub fn tissue(block: (TetMesh, Vec<u32>)) -> Tissue {
    tissue_of(block, YOUNG)
}

/// Of another Young's modulus \[Pa\].
pub fn tissue_of((mesh, fixed): (TetMesh, Vec<u32>), young: f64) -> Tissue {
    Tissue::new(mesh, &Elastic::new(young, 0.4).expect("a material"), &fixed).expect("tissue")
}

/// 24 × 20 × 12 mm about the origin, its top at z = 0.
pub fn pad() -> (TetMesh, Vec<u32>) {
    block([0.024, 0.020, 0.012], [8, 6, 4], [-0.012, -0.010, -0.012])
}

/// All but straight: 40 mm, tip first.
pub fn straight() -> NeedleShape {
    NeedleShape { radius: 5.0, angle: 0.008, wire_radius: 3e-4, taper: 5e-3, density: 7900.0 }
}

/// `world_from_needle` that brings the tip to `tip` with its tangent along `ahead`, the arc's plane across `side`.
pub fn pose(
    shape: &NeedleShape,
    tip: Point3<f64>,
    ahead: Vector3<f64>,
    side: Vector3<f64>,
) -> Isometry3<f64> {
    let solid = shape.solid().expect("a needle");
    let (own, length) = (solid.tangent(shape.length()), shape.length());
    let z = Vector3::z();
    let from = nalgebra::Matrix3::from_columns(&[own, z.cross(&own), z]);
    let side = (side - ahead * ahead.dot(&side)).normalize();
    let to = nalgebra::Matrix3::from_columns(&[ahead, side.cross(&ahead), side]);
    let rotation =
        UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(to * from.transpose()));
    let translation = tip - rotation * solid.point(length);
    Isometry3::from_parts(Translation3::from(translation), rotation)
}

/// Jaws that give way by a tenth of a millimetre under ten newtons, and hold anything.
pub fn jaws(shape: &NeedleShape, along: f64, from: Isometry3<f64>, to: Isometry3<f64>) -> Grip {
    Grip {
        point: shape.solid().expect("a needle").point(along),
        from,
        to,
        stiffness: 1e5,
        turning_stiffness: 20.0,
        force_max: f64::INFINITY,
        torque_max: f64::INFINITY,
    }
}

/// A needle without a thread at rest.
pub fn bare(shape: &NeedleShape, at: &Isometry3<f64>, resistance: Resistance, tissue: Tissue) -> Suture {
    let state = SutureState::new(NeedleState::at_rest(at), None);
    Suture::new(shape, None, resistance, tissue, state).expect("a suture")
}

/// A needle with a straight thread of so many edges behind its tail.
pub fn threaded(
    shape: &NeedleShape,
    at: &Isometry3<f64>,
    edges: usize,
    edge: f64,
    resistance: Resistance,
    tissue: Tissue,
) -> Suture {
    let solid = shape.solid().expect("a needle");
    let (tail, back) = (at * solid.point(0.0), at * -solid.tangent(0.0));
    let points: Vec<_> = (0..=edges).map(|i| tail + back * (i as f64 * edge)).collect();
    let state = SutureState::new(NeedleState::at_rest(at), Some(ThreadState::at_rest(&points)));
    let material = Some(ThreadMaterial::silk_2_0());
    let mut suture = Suture::new(shape, material, resistance, tissue, state).expect("a suture");
    suture.swage();
    suture
}

/// Far below everything.
pub fn nowhere() -> Tissue {
    tissue(block([0.01, 0.01, 0.01], [1, 1, 1], [0.0, 0.0, -10.0]))
}
