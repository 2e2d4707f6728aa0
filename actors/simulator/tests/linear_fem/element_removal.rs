//! Removal of elements with a corrected inverse, and the cache of inverses.

#[allow(dead_code)] // every test uses another part
use crate::support::beam;
use nalgebra::{Point3, Vector3};
use trocar_dynamics::elasticity::Alteration;
use trocar_dynamics::tet_mesh::{TetMesh, Volume};
use trocar_simulator::linear_fem::{
    Attachment, Cache, Hold, Limits, LinearFem, LinearFemError, Load, Origin, REMOVED_MAX, patch,
};

fn body(mesh: TetMesh, fixed: &[u32]) -> LinearFem {
    LinearFem::new(mesh, &beam::material(), fixed, &Limits::default(), &mut |_| true).expect("a body")
}

/// A notch in the top of the beam, like that burned by a hook: elements that touch a box.
fn notch(mesh: &TetMesh) -> Vec<u32> {
    let inside = |at: &Point3<f64>| (0.038..0.046).contains(&at.x) && at.z > 0.0145;
    let tets = mesh.tets().iter().enumerate();
    let middle = |tet: &[u32; 4]| {
        Point3::from(tet.iter().map(|&n| mesh.rest()[n as usize].coords).sum::<Vector3<f64>>() / 4.0)
    };
    tets.filter(|(_, tet)| inside(&middle(tet))).map(|(index, _)| index as u32).collect()
}

#[test]
fn without_elements_the_corrected_inverse_is_the_new_one() {
    let mesh = beam::mesh([20, 4, 4]);
    let wall = beam::nodes_at(&mesh, 0.0);
    let gone = notch(&mesh);
    assert!((8..=REMOVED_MAX).contains(&gone.len()), "{}", gone.len());
    let grasp = patch(mesh.rest(), mesh.surface(), &Point3::new(0.09, 0.01, 0.02), 0.006).expect("a patch");
    let target = Vector3::new(0.0, 0.0004, 0.002);
    let deep = mesh.locate(&Point3::new(0.02, 0.011, 0.009)).expect("inside");
    let needle = Attachment::barycentric(mesh.tets()[deep.0], deep.1, Hold::Point);
    let weights = [(beam::nodes_at(&mesh, 0.1)[3], 1.0)];
    let load = Load { weights: &weights, force: Vector3::new(0.001, -0.002, 0.001) };
    let forces = |fem: &mut LinearFem, load: Load<'_>| -> Vec<Vector3<f64>> {
        fem.solve(&[load]).expect("solved").reactions.iter().map(|r| r.force).collect()
    };

    let mut fem = body(mesh.clone(), &wall);
    let weight: Vec<_> = mesh.lumped_masses(50.0).iter().map(|m| Vector3::z() * (-9.81 * m)).collect();
    fem.set_dead_load(&weight).expect("forces");
    let handle = fem.hold(Attachment { weights: grasp.clone(), hold: Hold::Point }).expect("held");
    fem.hold(needle.clone()).expect("held");
    fem.set_target(handle, target).expect("held");
    let whole = forces(&mut fem, load);
    fem.remove(&gone).expect("they are there");
    let served = forces(&mut fem, load);

    // The control: the notch has an effect.
    assert!((served[0] - whole[0]).norm() > 0.02 * whole[0].norm(), "{} {}", served[0], whole[0]);
    // The job's computation: a mesh without these elements; unused nodes are held.
    let mut volume = Volume::new(&mesh);
    volume.remove(&gone).expect("they are there");
    let (notched, nodes) = volume.mesh().expect("something is left");
    let number = |node: u32| nodes.binary_search(&node).expect("it is left") as u32;
    let renamed = |weights: &[(u32, f64)]| weights.iter().map(|&(node, w)| (number(node), w)).collect();
    let fixed: Vec<u32> = wall.iter().map(|&node| number(node)).collect();
    let mut fresh = body(notched, &fixed);
    fresh
        .set_dead_load(&nodes.iter().map(|&node| weight[node as usize]).collect::<Vec<_>>())
        .expect("forces");
    let other = fresh.hold(Attachment { weights: renamed(&grasp), hold: Hold::Point }).expect("held");
    fresh.hold(Attachment { weights: renamed(&needle.weights), hold: Hold::Point }).expect("held");
    fresh.set_target(other, target).expect("held");
    let loaded: Vec<_> = renamed(&weights);
    let new = forces(&mut fresh, Load { weights: &loaded, ..load });
    for (served, new) in served.iter().zip(&new) {
        let jump = (served - new).norm() / new.norm();
        assert!(jump < 0.05, "the force jumps by {jump}: {served} {new}");
        // Exact apart from the remnant and the rounding of the stored inverse.
        assert!(jump < 1e-3, "{jump}");
    }
    // And so do the surface and the inside.
    let (mut a, mut b) = (Vec::new(), Vec::new());
    fem.displacements(&mut a);
    fresh.displacements(&mut b);
    let tip = beam::nodes_at(&mesh, 0.1)[0] as usize;
    let same = b[number(tip as u32) as usize];
    assert!((a[tip] - same).norm() < 1e-3 * same.norm(), "{} {same}", a[tip]);
    fem.surface_displacements(&mut b);
    let place = fem.compliance().nodes().binary_search(&(tip as u32)).expect("on the surface");
    assert!((a[tip] - b[place]).norm() < 1e-4 * a[tip].norm(), "{} {}", a[tip], b[place]);

    // A restart removes them again.
    let mut again = body(mesh, &wall);
    again.restore(&fem.state()).expect("its own state");
    assert_eq!(forces(&mut again, load), forces(&mut fem, load));
}

#[test]
fn what_cannot_be_taken_out_is_refused() {
    let mesh = beam::mesh([10, 2, 2]);
    let wall = beam::nodes_at(&mesh, 0.0);
    let tets = mesh.tets().len();
    let mut fem = body(mesh, &wall);
    assert_eq!(fem.remove(&[tets as u32]), Err(LinearFemError::NoElement { tet: tets as u32, tets }));
    fem.remove(&[100]).expect("it is there");
    assert_eq!(fem.remove(&[100]), Err(LinearFemError::NoElement { tet: 100, tets }));
    let many: Vec<u32> = (120..120 + REMOVED_MAX as u32).collect();
    assert_eq!(fem.remove(&many), Err(LinearFemError::TooManyRemoved));
    assert_eq!(fem.removed().len(), REMOVED_MAX);
}

#[test]
fn an_inverse_is_computed_once_and_a_damaged_one_again() {
    let folder = std::env::temp_dir().join(format!("trocar-compliance-{}", std::process::id()));
    let cache = Cache::new(&folder);
    let mesh = beam::mesh([8, 2, 2]);
    let wall = beam::nodes_at(&mesh, 0.0);
    let (material, limits) = (beam::material(), Limits::default());
    let get = || {
        let body = cache.body(mesh.clone(), &material, &wall, &limits, &mut |_| true).expect("a body");
        (body.0.compliance().clone(), body.1)
    };
    let (first, origin) = get();
    assert_eq!(origin, Origin::Kept);
    assert_eq!(get(), (first.clone(), Origin::Read));
    let file = cache.file(&mesh, &material, &wall);
    let mut bytes = std::fs::read(&file).expect("it is there");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    std::fs::write(&file, &bytes).expect("room");
    assert_eq!(get(), (first.clone(), Origin::Kept));
    assert_eq!(get().1, Origin::Read);
    let files = std::fs::read_dir(&folder).expect("a folder").count();
    assert_eq!(files, 1, "nothing is left beside it");
    std::fs::remove_dir_all(&folder).expect("its own folder");
    // Where no folder can be created, there still is a body.
    let nowhere = Cache::new(&file.join("below a file that is none"));
    std::fs::write(&folder, b"in its way").expect("room");
    let (body, origin) =
        nowhere.body(mesh.clone(), &material, &wall, &limits, &mut |_| true).expect("a body");
    assert!(matches!(origin, Origin::NotKept(_)));
    assert_eq!(body.compliance(), &first);
    std::fs::remove_file(&folder).expect("its own file");
}

#[test]
fn the_inverse_of_what_it_has_become_takes_over_without_a_jump() {
    let mesh = beam::mesh([20, 4, 4]);
    let wall = beam::nodes_at(&mesh, 0.0);
    let gone = notch(&mesh);
    let grasp = patch(mesh.rest(), mesh.surface(), &Point3::new(0.09, 0.01, 0.02), 0.006).expect("a patch");
    let felt = |fem: &mut LinearFem| {
        let handle = fem.hold(Attachment { weights: grasp.clone(), hold: Hold::Point }).expect("held");
        fem.set_target(handle, Vector3::new(0.0, 0.0004, 0.002)).expect("held");
        let force = fem.solve(&[]).expect("solved").reactions[0].force;
        fem.release(handle).expect("held");
        force
    };
    let altered = |alterations: &[Alteration]| {
        let limits = Limits::default();
        LinearFem::altered(mesh.clone(), &beam::material(), alterations, &wall, &limits, &mut |_| true)
    };
    let mut serving = body(mesh.clone(), &wall);
    let whole = felt(&mut serving);
    serving.remove(&gone).expect("they are there");
    let served = felt(&mut serving);
    let mut alterations = vec![Alteration::NONE; mesh.tets().len()];
    gone.iter().for_each(|&tet| alterations[tet as usize] = Alteration::GONE);
    let mut new = altered(&alterations).expect("a body");
    let taken_over = felt(&mut new);
    let jump = (taken_over - served).norm() / served.norm();
    assert!(jump < 1e-4, "a jump of {jump} of the force");
    // The control: the notch has an effect.
    assert!((served - whole).norm() > 100.0 * (taken_over - served).norm(), "{whole} {served}");
    // The bottom of the notch can be touched now, and removed elements cannot be removed again.
    assert!(new.compliance().nodes().iter().any(|node| !mesh.surface_nodes().contains(node)));
    assert!(matches!(new.remove(&gone[..1]), Err(LinearFemError::NoElement { .. })));
    // Later removals apply to the new inverse, too.
    let (first, second) = gone.split_at(gone.len() / 2);
    let mut half = vec![Alteration::NONE; mesh.tets().len()];
    first.iter().for_each(|&tet| half[tet as usize] = Alteration::GONE);
    let mut half = altered(&half).expect("a body");
    half.remove(second).expect("they are there");
    assert!((felt(&mut half) - served).norm() < 1e-4 * served.norm());
    assert!(altered(&alterations[1..]).is_err());
    alterations[3].length = f64::NAN;
    assert!(matches!(altered(&alterations), Err(LinearFemError::Alteration { tet: 3 })));
}

#[test]
fn what_is_coagulated_is_stiffer_and_draws_together() {
    let mesh = beam::mesh([20, 4, 4]);
    let wall = beam::nodes_at(&mesh, 0.0);
    let altered = |stiffness: f64, length: f64| {
        let all = vec![Alteration { stiffness, length }; mesh.tets().len()];
        let limits = Limits::default();
        LinearFem::altered(mesh.clone(), &beam::material(), &all, &wall, &limits, &mut |_| true)
            .expect("a body")
    };
    // Shrunk by a tenth, whatever the stiffness; not where it is held.
    for stiffness in [1.0, 5.0] {
        let mut moved = Vec::new();
        altered(stiffness, 0.9).displacements(&mut moved);
        let free: Vec<_> = (0..mesh.rest().len()).filter(|&node| mesh.rest()[node].x > 0.04).collect();
        let (near, far) = (beam::nodes_at(&mesh, 0.05)[0] as usize, beam::nodes_at(&mesh, 0.1)[0] as usize);
        let strain = (moved[far].x - moved[near].x) / 0.05;
        assert!((strain + 0.1).abs() < 1e-4, "{strain}");
        assert!(free.iter().all(|&node| moved[node].norm() < 0.012));
    }
    let (mut soft, mut stiff) = (altered(1.0, 1.0), altered(5.0, 1.0));
    let felt = |fem: &mut LinearFem| {
        let handle = fem.hold(Attachment::node(beam::nodes_at(&mesh, 0.1)[0], Hold::Point)).expect("held");
        fem.set_target(handle, Vector3::new(0.0, 0.0, 0.001)).expect("held");
        fem.solve(&[]).expect("solved").reactions[0].force
    };
    let (soft, stiff) = (felt(&mut soft), felt(&mut stiff));
    assert!((stiff - soft * 5.0).norm() < 1e-4 * stiff.norm(), "{stiff} {soft}");
}
