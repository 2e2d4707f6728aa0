//! The whole grid of cuts right through volumes, of which `cut_through.rs` is a sample.

use crate::support::blade::block;
use crate::support::cut_cases::{
    bent, beside, crosses, deforms, goes_on_anyhow, in_planes, meshes, partly, through_nodes,
    turns_about_itself, twice,
};

/// Planes by cells of 10 and 5 mm and by ticks.
#[test]
fn sixty_planes_cells_and_ticks() {
    for cell in [0.01, 0.005] {
        for ticks in [1, 2, 7, 50, 200] {
            in_planes(&format!("{cell} m"), &block(cell), ticks, 0..60, [0.97, 1.12]);
        }
    }
}

#[test]
fn every_way_of_going_on() {
    for cell in [0.01, 0.005] {
        for ticks in [5, 50, 200] {
            goes_on_anyhow(&block(cell), ticks, 0..if cell < 0.01 { 15 } else { 40 });
        }
    }
}

#[test]
fn turns_about_a_point_of_the_blade_by_cells_and_ticks() {
    for (cell, seeds) in [(0.01, 0..20), (0.005, 0..6)] {
        for ticks in [3, 6, 20, 70] {
            turns_about_itself(&block(cell), ticks, seeds.clone());
        }
    }
    for (name, mesh) in meshes(0.008) {
        if name != "random points" {
            turns_about_itself(&mesh, 10, 0..8);
        }
    }
}

#[test]
fn planes_at_and_beside_nodes() {
    for cell in [0.01, 0.005] {
        for off in [0.0, 1e-12, 1e-9, 1e-6, 1e-4, 1e-2, 0.1, 0.3, 0.5] {
            for ticks in [1, 8, 50] {
                through_nodes(cell, off, ticks);
            }
        }
    }
}

#[test]
fn two_cuts_by_angle_and_by_distance() {
    for cell in [0.01, 0.005] {
        for ticks in [1, 7, 50] {
            for degrees in [20.0, 30.0, 45.0, 60.0, 75.0, 90.0] {
                crosses(cell, ticks, degrees, 0..20);
            }
            for cells in [0.5, 0.7, 1.0, 1.3, 2.0] {
                beside(cell, ticks, cells, 0..20);
            }
            twice(cell, ticks, 0..20);
            partly(cell, ticks, 0..20);
        }
    }
}

#[test]
fn bends_by_radius() {
    for cell in [0.01, 0.005] {
        for ticks in [20, 60, 200] {
            for radius in [0.1, 0.05, 0.03] {
                bent(cell, ticks, radius, 0..12);
            }
        }
    }
}

#[test]
fn moving_tissue_by_strain() {
    for cell in [0.01, 0.005] {
        for ticks in [7, 50] {
            for strain in [0.05, 0.2, 0.4] {
                deforms(cell, ticks, strain, 0..30);
            }
        }
    }
}

#[test]
fn other_meshes_by_size() {
    for edge in [0.012, 0.008, 0.005] {
        for (name, mesh) in meshes(edge) {
            // The hull of random points is ragged: some planes rightly cut a tip off it as well.
            let seeds = if name == "random points" { 0..12 } else { 0..40 };
            for ticks in [1, 7, 50] {
                in_planes(name, &mesh, ticks, seeds.clone(), [0.97, 1.3]);
            }
        }
    }
}
