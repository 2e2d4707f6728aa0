//! A rigid frictionless sphere on a half-space: Hertz's contact force, on meshes refined at the contact.

use nalgebra::{Point3, Vector3};
use trocar_dynamics::elasticity::Elastic;
use trocar_dynamics::tet_mesh::{BoxCells, MeshRules, TetMesh, box_cells, refined};
use trocar_simulator::linear_fem::{Attachment, Hold, Limits, LinearFem};

const RADIUS: f64 = 5e-3;
/// Half the side of the block, and its depth \[m\]: 45 contact radii, so that its walls have an influence of less than
/// 2 %.
const REACH: f64 = 0.1;

/// A block whose edges are at most `edge` \[m\] under the contact, and grow by `growth` \[m/m\] with the distance from
/// it.
fn block(edge: f64, growth: f64) -> TetMesh {
    let grid = BoxCells {
        cells: [4, 4, 2],
        size: Vector3::new(2.0 * REACH, 2.0 * REACH, REACH),
        origin: Point3::new(-REACH, -REACH, -REACH),
    };
    let (nodes, tets) = box_cells(&grid);
    let longest = |at: &Point3<f64>| edge + growth * (at.coords.norm() - 2.4e-3).max(0.0);
    let (nodes, tets) = refined(&nodes, &tets, longest, 60_000).expect("not that many");
    TetMesh::new(&nodes, &tets, &MeshRules::default()).expect("a sound mesh")
}

/// Forces at 0.5 and 1 mm, relative to Hertz's.
fn over_hertz(edge: f64, growth: f64, poisson: f64) -> [f64; 2] {
    let mesh = block(edge, growth);
    let material = Elastic::new(1e4, poisson).expect("a material");
    let rest = mesh.rest().to_vec();
    let top = |at: &Point3<f64>| at.z > -1e-9 && at.x.abs().max(at.y.abs()) < REACH - 1e-9;
    let fixed: Vec<u32> =
        mesh.surface_nodes().iter().copied().filter(|&node| !top(&rest[node as usize])).collect();
    let mut fem = LinearFem::new(mesh, &material, &fixed, &Limits::default(), &mut |_| true).expect("a body");
    let down = -Vector3::z_axis();
    let contacts: Vec<_> = (0..rest.len() as u32)
        .filter(|&node| top(&rest[node as usize]) && rest[node as usize].coords.norm() < 2.3e-3)
        .map(|node| {
            let at = rest[node as usize];
            let handle = fem.hold(Attachment::node(node, Hold::AtLeast(down))).expect("room");
            (handle, (at.x.powi(2) + at.y.powi(2)) / (2.0 * RADIUS))
        })
        .collect();
    let mut press = |depth: f64| {
        for (handle, gap) in &contacts {
            fem.set_target(*handle, down.into_inner() * (depth - gap)).expect("it is held");
        }
        let solution = fem.solve(&[]).expect("it settles");
        assert!(solution.reactions.iter().all(|reaction| reaction.force.z <= 0.0), "contacts do not pull");
        -solution.reactions.iter().map(|reaction| reaction.force.z).sum::<f64>()
    };
    // The contact grows, and shrinks again.
    let forces = [press(0.5e-3), press(1e-3), press(0.5e-3)];
    assert!((forces[2] / forces[0] - 1.0).abs() < 1e-6, "the way does not matter: {forces:?}");
    let hertz = |depth: f64| 4e4 / 3.0 / (1.0 - poisson.powi(2)) * RADIUS.sqrt() * depth.powf(1.5);
    [forces[0] / hertz(0.5e-3), forces[1] / hertz(1e-3)]
}

#[test]
fn the_force_of_a_rigid_sphere_is_that_of_hertz() {
    // 0.01321746 and 0.03738463 N at ν 0.45. The excess stiffness of linear elements comes less from those under the
    // sphere than from those around it: edges that grow by 0.4 of the distance leave 5 and 7 %.
    let fine = over_hertz(0.6e-3, 0.4, 0.45);
    // The control: the same under the sphere, but edges that grow by the distance itself.
    let steep = over_hertz(0.6e-3, 1.0, 0.45);
    for (fine, steep) in fine.into_iter().zip(steep) {
        assert!(fine > 1.0 && fine < 1.08, "{fine} of Hertz");
        assert!(steep - 1.0 > 1.5 * (fine - 1.0), "{steep} of Hertz, and {fine}");
    }
}
