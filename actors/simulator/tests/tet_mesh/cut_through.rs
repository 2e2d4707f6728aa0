//! A blade right through a volume leaves no bridge and no crumb, however it goes: in every plane, in any number of ticks,
//! along bent paths, through tissue that moves meanwhile. Here a sample; `cut_grid.rs` of the thorough tests is
//! the whole grid.

use crate::support::blade::{Bench, Cut, block, direction};
use crate::support::cut_cases::{
    bent, beside, crosses, deforms, goes_on_anyhow, in_planes, partly, through_nodes, turns_about_itself,
    twice,
};
use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

#[test]
fn a_blade_right_through_a_block_makes_two_pieces_in_every_plane() {
    for ticks in [1, 7, 50] {
        in_planes("10 mm", &block(0.01), ticks, 0..60, [0.97, 1.12]);
    }
    for (ticks, seeds) in [(1, 0..12), (7, 12..24), (50, 24..34)] {
        in_planes("5 mm", &block(0.005), ticks, seeds, [0.97, 1.12]);
    }
}

#[test]
fn two_pieces_come_of_a_blade_that_pauses_goes_back_and_forth_or_turns_on_its_way() {
    for (ticks, seeds) in [(5, 0..8), (50, 8..12), (200, 14..15)] {
        goes_on_anyhow(&block(0.01), ticks, seeds);
    }
}

#[test]
fn a_blade_that_turns_about_a_point_of_its_own_makes_two_pieces() {
    for (ticks, seeds) in [(3, 25..28), (6, 16..18), (20, 27..28)] {
        turns_about_itself(&block(0.01), ticks, seeds);
    }
    turns_about_itself(&block(0.005), 6, 16..17);
}

#[test]
fn a_plane_through_nodes_edges_and_faces_or_nearly_so_cuts_cleanly() {
    for off in [0.0, 1e-9, 1e-4, 0.5] {
        for ticks in [1, 8] {
            through_nodes(0.01, off, ticks);
        }
    }
}

#[test]
fn two_cuts_that_cross_make_four_pieces_and_two_beside_each_other_three() {
    for (ticks, seeds) in [(1, 0..6), (7, 6..10), (50, 10..12)] {
        for degrees in [20.0, 35.0, 60.0, 90.0] {
            crosses(0.01, ticks, degrees, seeds.clone());
        }
        for cells in [0.5, 1.0, 1.5] {
            beside(0.01, ticks, cells, seeds.clone());
        }
    }
}

#[test]
fn a_second_pass_along_a_cut_finds_nothing_to_cut() {
    for ticks in [1, 7, 50] {
        twice(0.01, ticks, 0..6);
    }
}

#[test]
fn a_blade_that_stops_inside_leaves_one_piece_with_a_slit_as_deep_as_it_came() {
    for ticks in [1, 7, 50] {
        partly(0.01, ticks, 0..8);
        partly(0.005, ticks, 8..10);
    }
}

#[test]
fn bent_twisted_and_kinked_paths_make_two_pieces() {
    for (ticks, seeds) in [(20, 0..4), (60, 4..6), (200, 8..9)] {
        for radius in [0.1, 0.05, 0.03] {
            bent(0.01, ticks, radius, seeds.clone());
        }
    }
}

#[test]
fn tissue_that_moves_and_stretches_under_the_blade_is_cut_through() {
    for strain in [0.05, 0.2, 0.4] {
        deforms(0.01, 7, strain, 0..8);
        deforms(0.01, 50, strain, 8..12);
    }
}

#[test]
fn meshes_of_organs_refined_ones_and_those_of_random_points_are_cut_through() {
    for (name, mesh) in crate::support::cut_cases::meshes(0.012) {
        for (ticks, seeds) in [(1, 0..6), (7, 6..10), (50, 10..12)] {
            in_planes(name, &mesh, ticks, seeds, [0.97, 1.3]);
        }
    }
}

#[test]
fn a_blade_at_rest_changes_nothing() {
    let mesh = block(0.01);
    let mut random = Pcg64Mcg::seed_from_u64(3);
    for _ in 0..10 {
        let cut = Cut::random(&mesh, &mut random);
        let mut bench = Bench::new(&mesh);
        bench.follow(20, |share| cut.blade(0.5 * share, 0.0));
        let (elements, opened, marks) = (bench.volume.left(), bench.opened, bench.slit.marks.len());
        let at = cut.blade(0.5, 0.0);
        for tick in 0..50 {
            // It trembles by less than the arithmetic can tell.
            let off = direction(&mut random) * 1e-16 * f64::from(tick % 3);
            bench.sweep(at.map(|end| end + off), at);
        }
        assert_eq!((bench.volume.left(), bench.opened, bench.slit.marks.len()), (elements, opened, marks));
    }
}
