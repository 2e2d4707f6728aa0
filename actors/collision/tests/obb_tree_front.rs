//! The front that two trees keep from one question to the next against a descent from the roots: the same pairs, whatever
//! moves, turns, jumps, rests, deforms or is cut in between.

use crate::support;
use crate::support::Mesh;
use crate::support::surfaces::{KINDS, deformed, surface};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use proptest::prelude::*;
use trocar_collision::Surface;
use trocar_collision::obb_tree::{ObbTree, TouchingPair, TreeFront, TreeQuery};
use trocar_test_support::allocations::peak_of;

fn built(mesh: &Mesh) -> ObbTree {
    ObbTree::build(&Surface::new(&mesh.vertices, &mesh.triangles).expect("a surface"))
}

fn scaled(mesh: &Mesh, scale: f64) -> Mesh {
    let vertices = mesh.vertices.iter().map(|vertex| vertex * scale).collect();
    Mesh { vertices, triangles: mesh.triangles.clone() }
}

/// By a descent from the roots, in the order of numbers.
fn anew(query: &mut TreeQuery, a: &ObbTree, b: &ObbTree, pose: &Isometry3<f64>) -> Vec<TouchingPair> {
    let mut pairs = query.all_contacts(a, b, pose).to_vec();
    pairs.sort_unstable_by_key(|pair| pair.triangles);
    pairs
}

/// What happens before a question.
#[derive(Clone, Debug)]
enum Deed {
    /// Shift of the size of the surfaces, and turn \[rad\].
    Move([f64; 3], [f64; 3]),
    Rest,
    /// To and fro around the place: what comes near has been there.
    Sway(f64),
    Deform(usize, f64, u64),
    Cut(usize),
    /// The same surface built anew, as after a loss.
    Rebuild(usize),
    Copy(usize),
}

fn deed() -> impl Strategy<Value = Deed> {
    let small = || [-0.01..0.01_f64, -0.01..0.01, -0.01..0.01];
    let large = || [-0.8..0.8_f64, -0.8..0.8, -0.8..0.8];
    prop_oneof![
        8 => (small(), small()).prop_map(|(shift, turn)| Deed::Move(shift, turn)),
        2 => (large(), large()).prop_map(|(shift, turn)| Deed::Move(shift, turn)),
        2 => Just(Deed::Rest),
        3 => (0.0..0.05_f64).prop_map(Deed::Sway),
        3 => (0..2_usize, 0.0..0.1_f64, 0..9_u64).prop_map(|(which, amount, seed)| Deed::Deform(which, amount, seed)),
        1 => (0..2_usize).prop_map(Deed::Cut),
        1 => (0..2_usize).prop_map(Deed::Rebuild),
        1 => (0..2_usize).prop_map(Deed::Copy),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]
    #[test]
    fn the_front_finds_what_a_descent_from_the_roots_finds(
        kinds in [0..KINDS.len(), 0..KINDS.len()],
        seeds in [0..1_000_u64, 0..1_000],
        scale in prop_oneof![Just(1.0), Just(0.05), Just(1e-3)],
        second_scale in prop_oneof![4 => Just(1.0), 1 => Just(0.03), 1 => Just(20.0)],
        deeds in prop::collection::vec(deed(), 1..25),
    ) {
        let scales = [scale, scale * second_scale];
        let rests = [0, 1].map(|side| surface(KINDS[kinds[side]], seeds[side]));
        let mut meshes = [0, 1].map(|side| scaled(&rests[side], scales[side]));
        let mut trees = meshes.each_ref().map(built);
        let (mut front, mut query) = (TreeFront::new(), TreeQuery::new());
        let (mut pose, mut sway) = (Isometry3::<f64>::identity(), 1.0);
        for deed in deeds {
            let rests_now = matches!(deed, Deed::Rest);
            match deed {
                Deed::Rest => {}
                Deed::Move(shift, turn) => {
                    let shift = Translation3::from(Vector3::from(shift) * scale);
                    let turn = UnitQuaternion::from_scaled_axis(Vector3::from(turn));
                    pose = Isometry3::from_parts(shift * pose.translation, turn * pose.rotation);
                }
                Deed::Sway(by) => {
                    pose.translation.vector.x += sway * by * scale;
                    sway = -sway;
                }
                Deed::Deform(side, amount, seed) => {
                    if meshes[side].vertices.len() == rests[side].vertices.len() {
                        let bent = deformed(&rests[side], amount, seed);
                        meshes[side].vertices = bent.iter().map(|vertex| vertex * scales[side]).collect();
                        trees[side].refit(&meshes[side].vertices).expect("as many vertices");
                    }
                }
                Deed::Cut(side) => {
                    let mut number = 0;
                    meshes[side].triangles.retain(|_| { number += 1; number % 5 != 0 });
                    trees[side] = built(&meshes[side]);
                }
                Deed::Rebuild(side) => trees[side] = built(&meshes[side]),
                Deed::Copy(side) => trees[side] = trees[side].clone(),
            }
            let known = front.pairs().to_vec();
            let asked = front.cost().asked > 0;
            let wanted = anew(&mut query, &trees[0], &trees[1], &pose);
            prop_assert_eq!(front.all_contacts(&trees[0], &trees[1], &pose), &wanted[..]);
            if front.rested() {
                prop_assert_eq!(front.pairs(), &known[..]);
            } else {
                let empty = trees.iter().any(ObbTree::is_empty);
                prop_assert!(!(rests_now && asked) || empty || front.cost().anew > 0);
            }
        }
    }
}

/// A tenth of an edge per step, as between the ticks of a detector.
fn slides(step: u32) -> Isometry3<f64> {
    let time = f64::from(step) * 0.05;
    let shift = Translation3::new(0.004 * time.sin(), 0.003 * time.cos(), 1.9 + 0.004 * (0.7 * time).sin());
    Isometry3::from_parts(
        shift,
        UnitQuaternion::from_euler_angles(0.002 * time.sin(), 0.0, 0.003 * time.cos()),
    )
}

#[test]
fn a_slow_motion_asks_again_of_few_pairs_only_and_a_jump_begins_anew() {
    let mesh = support::mesh("1k");
    let (a, mut b) = (built(&mesh), built(&mesh));
    let (mut front, mut query) = (TreeFront::new(), TreeQuery::new());
    let mut touching = 0;
    for step in 0..400 {
        let wanted = anew(&mut query, &a, &b, &slides(step));
        assert_eq!(front.all_contacts(&a, &b, &slides(step)), wanted, "step {step}");
        touching += wanted.len();
    }
    assert!(touching > 4_000, "they touch: {touching}");
    let cost = *front.cost();
    assert!(cost.anew <= 8, "{cost:?}");
    assert!(cost.expired < 400 * 60, "{cost:?}");
    front.all_contacts(&a, &b, &Isometry3::translation(0.0, 0.0, 0.3));
    assert_eq!(front.cost().anew, cost.anew + 1, "after a jump");
    front.all_contacts(&a, &b, &Isometry3::translation(0.0, 0.0, 0.3));
    assert!(front.rested());
    // A refit to where everything is already moves nothing; to the next number, something.
    let mut vertices = mesh.vertices.clone();
    b.refit(&vertices).expect("as many vertices");
    front.all_contacts(&a, &b, &Isometry3::translation(0.0, 0.0, 0.3));
    assert!(front.rested());
    vertices[5].x = vertices[5].x.next_up();
    b.refit(&vertices).expect("as many vertices");
    front.all_contacts(&a, &b, &Isometry3::translation(0.0, 0.0, 0.3));
    assert!(!front.rested());
    // Another surface with the same numbers is another surface.
    let shrunk = built(&scaled(&mesh, 0.5));
    let there = Isometry3::translation(0.0, 0.0, 0.3);
    assert_eq!(front.all_contacts(&a, &shrunk, &there), anew(&mut query, &a, &shrunk, &there));
    assert!(!front.rested());
}

#[test]
fn a_warmed_front_allocates_nothing() {
    let mesh = support::mesh("1k");
    let (a, mut b) = (built(&mesh), built(&mesh));
    let bent = [deformed(&mesh, 0.01, 1), mesh.vertices.clone()];
    let mut front = TreeFront::new();
    let mut go = || {
        let mut found = 0;
        for step in 0..300_u32 {
            b.refit(&bent[step as usize % 2]).expect("as many vertices");
            found += front.all_contacts(&a, &b, &slides(step)).len();
        }
        found
    };
    let found = go();
    assert!(found > 1_000, "{found}");
    go();
    let (again, bytes) = peak_of(go);
    assert_eq!((again, bytes), (found, 0));
}
