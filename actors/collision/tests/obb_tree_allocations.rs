//! A warmed query, and a refit, allocate nothing.

use crate::support::surfaces::deformed;
use crate::support::{mesh, poses};
use trocar_collision::Surface;
use trocar_collision::obb_tree::{ObbTree, TreeQuery};
use trocar_test_support::allocations::peak_of;

#[test]
fn what_was_asked_once_is_asked_again_without_allocating() {
    let mesh = mesh("1k");
    let bent = deformed(&mesh, 0.8, 1);
    let (build, bytes) =
        peak_of(|| ObbTree::build(&Surface::new(&mesh.vertices, &mesh.triangles).expect("a surface")));
    assert!(bytes > 10_000, "the allocator does not count");
    let mut tree = build;
    let other = tree.clone();
    let mut query = TreeQuery::new();
    let poses = poses();
    let mut ask_everything = || {
        let mut found = 0;
        tree.refit(&bent).expect("as many vertices");
        for pose in &poses {
            found += query.all_contacts(&tree, &other, pose).len();
            found += usize::from(query.first_contact(&tree, &other, pose, None).is_some());
            found += usize::from(query.distance(&tree, &other, pose, Some([3, 4])).is_some());
            found += usize::from(query.within(&tree, &other, pose, 0.1, None).is_some());
        }
        found + query.self_contacts(&tree).len()
    };
    let found = ask_everything();
    assert!(found > 1000);
    let (again, bytes) = peak_of(ask_everything);
    assert_eq!((again, bytes), (found, 0));
}
