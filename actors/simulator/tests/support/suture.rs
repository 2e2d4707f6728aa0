//! Blocks of tissue, needles and jaws shared by suturing tests.
#![allow(dead_code)] // every test uses another part

use nalgebra::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells};
use trocar_simulator::suture::needle::{NeedleShape, NeedleState};
use trocar_simulator::suture::{Bite, ChannelPoint, Grip, Resistance, Suture, SutureState, Tissue};
use trocar_simulator::suture_thread::initial_shape::{self, Throws};
use trocar_simulator::suture_thread::{ThreadMaterial, ThreadState};

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

/// With another Young's modulus \[Pa\].
pub fn tissue_of((mesh, fixed): (TetMesh, Vec<u32>), young: f64) -> Tissue {
    Tissue::new(mesh, &Elastic::new(young, 0.4).expect("a material"), &fixed).expect("tissue")
}

/// 24 × 20 × 12 mm about the origin, its top at z = 0.
pub fn pad() -> (TetMesh, Vec<u32>) {
    block([0.024, 0.020, 0.012], [8, 6, 4], [-0.012, -0.010, -0.012])
}

/// Almost straight: 40 mm, tip first.
pub fn straight() -> NeedleShape {
    NeedleShape { radius: 5.0, angle: 0.008, wire_radius: 3e-4, taper: 5e-3, density: 7900.0 }
}

/// `world_from_needle` with the tip at `tip`, its tangent along `ahead`, and the normal of the arc's plane along
/// `side`.
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

/// Jaws with a compliance of a tenth of a millimetre per ten newtons, and without a force limit.
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

/// A needle without thread, at rest.
pub fn bare(shape: &NeedleShape, at: &Isometry3<f64>, resistance: Resistance, tissue: Tissue) -> Suture {
    let state = SutureState::new(NeedleState::at_rest(at), None);
    Suture::new(shape, None, resistance, tissue, state).expect("a suture")
}

/// A needle with a straight thread of this many edges behind its tail.
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

/// Far below everything else.
pub fn nowhere() -> Tissue {
    tissue(block([0.01, 0.01, 0.01], [1, 1, 1], [0.0, 0.0, -10.0]))
}

/// Young's modulus \[Pa\]: skin, 0.1 to 1 MPa.
pub const SKIN: f64 = 5e5;
/// Distance of entry and exit from the middle, and depth of the thread \[m\].
const HOLE: f64 = 4.5e-3;
const DEEP: f64 = 4e-3;

/// Two edges of a wound with 2 mm between them.
pub fn wound() -> (TetMesh, Vec<u32>) {
    blocks(&[
        ([0.008, 0.012, 0.010], [4, 6, 5], [-0.009, -0.006, -0.010]),
        ([0.008, 0.012, 0.010], [4, 6, 5], [0.001, -0.006, -0.010]),
    ])
}

/// Skin with a wound, and a thread that passes through both of its edges and is tied loosely over it by throws with
/// these half turns.
pub fn stitch(half_turns: &[i32], friction: f64) -> Suture {
    let tissue = tissue_of(wound(), SKIN);
    let resistance = Resistance::default();
    let material = ThreadMaterial { friction, ..ThreadMaterial::silk_2_0() };
    let height = 6e-3;
    let around = [[-HOLE, 0.0], [-HOLE + 1.5e-3, -DEEP], [HOLE - 1.5e-3, -DEEP], [HOLE, 0.0]]
        .map(|[x, z]| Point3::new(x, 0.3e-3, z - height));
    let nodes: Vec<_> = initial_shape::throws(&Throws {
        half_turns,
        around: &around,
        radius: material.radius,
        apart: 0.0,
        arm: 1.5e-3,
        ear: 12e-3,
        edges: [3.0 * material.radius, 1e-3],
    })
    .into_iter()
    .map(|point| point + Vector3::z() * height)
    .collect();
    let shape = NeedleShape::half_circle_26();
    let solid = shape.solid().expect("a needle");
    let mut state =
        SutureState::new(NeedleState::at_rest(&Isometry3::identity()), Some(ThreadState::at_rest(&nodes)));
    let back = (nodes[1] - nodes[0]).normalize();
    let turn = UnitQuaternion::rotation_between(&-solid.tangent(0.0), &back).expect("a turn");
    state.needle =
        NeedleState::at_rest(&Isometry3::from_parts((nodes[0] - turn * solid.point(0.0)).into(), turn));
    // Arc lengths at which the thread is in the tissue: below its top, and within one of the wound's edges.
    let mut arc = vec![0.0];
    for pair in nodes.windows(2) {
        arc.push(arc[arc.len() - 1] + (pair[1] - pair[0]).norm());
    }
    let at = |distance: f64| {
        let edge = arc.partition_point(|arc| *arc <= distance).clamp(1, nodes.len() - 1) - 1;
        nodes[edge] + (nodes[edge + 1] - nodes[edge]).normalize() * (distance - arc[edge])
    };
    let inside = |distance: &f64| {
        let point = at(*distance);
        point.z < 1e-6 && point.x.abs() > 1e-3 - 1e-6
    };
    let steps: Vec<f64> =
        (0..=(arc[arc.len() - 1] / 1e-5) as usize).map(|i| i as f64 * 1e-5).filter(inside).collect();
    let mut bites: Vec<[f64; 2]> = Vec::new();
    for step in steps {
        match bites.last_mut() {
            Some(bite) if step - bite[1] < 1.5e-5 => bite[1] = step,
            _ => bites.push([step, step]),
        }
    }
    assert_eq!(bites.len(), 2, "{bites:?}");
    for (number, [from, to]) in bites.iter().enumerate() {
        let count = ((to - from) / resistance.spacing).round() as usize;
        let places: Vec<_> = (0..=count)
            .map(|i| to - (to - from) * i as f64 / count as f64)
            .map(|distance| (tissue.locate(&at(distance)), -distance))
            .collect();
        let number = number as u32;
        state.channel.extend(places.iter().map(|(place, along)| ChannelPoint {
            place: *place,
            along: *along,
            stuck: *along,
            force: Vector3::zeros(),
            bite: number,
        }));
        let [entry, exit] =
            [places[0].0, places[count].0].map(|place| tissue.nearest(&tissue.at_rest(&place)));
        state.bites.push(Bite { number, entry, exit: Some(exit), entry_force: 0.0, exit_force: 0.0 });
        state.bites_so_far += 1;
    }
    state.channel.sort_by(|a, b| a.along.total_cmp(&b.along));
    let mut suture = Suture::new(&shape, Some(material), resistance, tissue, state).expect("a suture");
    suture.swage();
    suture
}
