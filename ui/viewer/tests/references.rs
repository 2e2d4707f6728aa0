//! Pictures beside committed ones: each map, each way in which views share a picture, each thing that is shown over a
//! scene, every scenario. How alike they have to be, and that this is close enough to see what went wrong.

use crate::support::gallery;
use crate::support::perceptual;
use crate::support::reference;
use std::path::{Path, PathBuf};

use crate::support::gallery::{Case, SIZE, TISSUE, TOUCHING};
use crate::support::perceptual::{Difference, Limits};
use trocar_scene::{RegistryBuilder, Scenario};
use trocar_viewer::{Picture, View};

/// Draws what is to be drawn beside its reference, and tells of all that differs.
fn check(cases: &[Case]) {
    let differ: Vec<String> = cases
        .iter()
        .filter_map(|case| {
            let (picture, drawn_by) = case.draw();
            reference::check(&case.name, &picture, &drawn_by).err()
        })
        .collect();
    assert!(differ.is_empty(), "{}", differ.join("\n"));
}

#[test]
fn maps_of_materials_look_as_they_did_alone_and_together() {
    let folder = tempfile::tempdir().expect("a folder");
    check(&gallery::materials(folder.path().to_owned()));
}

#[test]
fn views_share_a_picture_as_they_did() {
    check(&gallery::layouts());
}

#[test]
fn bodies_threads_and_shadows_look_as_they_did() {
    check(&gallery::bodies());
}

#[test]
fn what_is_shown_over_a_scene_looks_as_it_did() {
    check(&gallery::overlays());
}

#[test]
fn every_scenario_looks_as_it_did() {
    check(&scenarios());
}

/// Every scenario of the repository as it begins, through its first camera.
fn scenarios() -> Vec<Case> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenarios");
    let entries = std::fs::read_dir(&folder).expect("the scenarios");
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "toml"));
    files.sort();
    assert!(!files.is_empty());
    let mut builder = RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).expect("names are free");
    trocar_simulator::controller::register(&mut builder).expect("names are free");
    let registry = builder.build();
    let case = |file: &PathBuf| {
        let scenario = Scenario::load(file, &registry).unwrap_or_else(|error| panic!("{error}"));
        let scene = scenario.spawn(&registry).unwrap_or_else(|error| panic!("{error}")).snapshot();
        let view = View::default_of(&scene, Some(f64::from(SIZE[0]) / f64::from(SIZE[1])));
        let name = format!("scenario-{}", scenario.name);
        Case { folder: Some(folder.clone()), ..Case::new(&name, scene, view) }
    };
    files.iter().map(case).collect()
}

#[test]
fn every_reference_is_drawn_by_somebody() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut drawn: Vec<String> = [
        gallery::materials(folder.path().to_owned()),
        gallery::layouts(),
        gallery::bodies(),
        gallery::overlays(),
        scenarios(),
    ]
    .into_iter()
    .flatten()
    .map(|case| case.name)
    .collect();
    drawn.sort();
    assert_eq!(reference::names(), drawn);
    let bytes = |name: &String| {
        std::fs::metadata(reference::folder().join(format!("{name}.png"))).expect("a file").len()
    };
    assert!(drawn.iter().map(bytes).sum::<u64>() < 2 << 20, "references are to stay small");
}

/// What of two pictures is beyond the limits.
fn beyond(a: &Case, b: &Case) -> Option<String> {
    let limits = Limits::default();
    let difference = Difference::between(&a.draw().0, &b.draw().0).expect("one size");
    eprintln!("{} against {}: {}", a.name, b.name, difference.describe(&limits));
    difference.beyond(&limits)
}

#[test]
fn a_texture_that_moves_by_one_pixel_is_seen() {
    let (colour, normal, together) = {
        let mut cases = gallery::materials(tempfile::tempdir().expect("a folder").path().to_owned());
        let mut take = |name: &str| {
            let index = cases.iter().position(|case| case.name == name).expect("a case");
            cases.swap_remove(index)
        };
        (take("map-colour"), take("map-normal"), gallery::of_material("map-together", gallery::together()))
    };
    // Of the middle of the picture: what a pixel covers there, in texture space.
    let pixel = {
        let (origin, direction) = colour.view.ray([0.5, 0.5]);
        let depth = -origin.z / direction.z;
        2.0 * (0.5 * colour.view.lens.field_of_view).tan() * depth / f64::from(colour.size[1]) / TISSUE
    };
    assert!((0.002..0.02).contains(&pixel), "{pixel}");
    for case in [colour, normal, together] {
        let material = case
            .scene
            .iter::<trocar_scene::VisualMaterial>()
            .next()
            .map(|(_, material)| material.clone())
            .expect("a material");
        for shift in [[pixel, 0.0], [0.0, pixel]] {
            let moved = gallery::of_tissue("moved", material.clone(), shift, false);
            assert!(beyond(&case, &moved).is_some(), "{} {shift:?}", case.name);
        }
    }
}

#[test]
fn another_roughness_is_seen() {
    let with = |roughness| {
        let material = trocar_scene::VisualMaterial { roughness, ..gallery::bare() };
        gallery::of_material("roughness", material)
    };
    assert!(beyond(&with(0.45), &with(0.5)).is_some());
    assert!(beyond(&with(0.45), &with(0.45)).is_none());
}

#[test]
fn a_shadow_that_is_missing_is_seen() {
    assert!(beyond(&gallery::shadow(true), &gallery::shadow(false)).is_some());
}

#[test]
fn each_single_red_triangle_that_is_missing_is_seen() {
    let all = gallery::touching(&TOUCHING);
    for missing in TOUCHING {
        let fewer: Vec<_> = TOUCHING.into_iter().filter(|triangle| *triangle != missing).collect();
        assert!(beyond(&all, &gallery::touching(&fewer)).is_some(), "{missing}");
    }
}

/// Each channel of each pixel moved by `step`, up or down by a generator of Marsaglia ("Xorshift RNGs", 2003).
fn noisy(picture: &Picture, step: u8, mut state: u32) -> Picture {
    let mut up = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        state & 1 == 0
    };
    let mut noisy = picture.clone();
    for part in noisy.color.iter_mut().flat_map(|pixel| pixel[..3].iter_mut()) {
        *part = if up() { part.saturating_add(step) } else { part.saturating_sub(step) };
    }
    noisy
}

#[test]
fn what_rasterisers_round_differently_is_not_a_difference() {
    let limits = Limits::default();
    let same = |a: &Picture, b: &Picture| Difference::between(a, b).expect("one size").beyond(&limits);
    let mut cases = gallery::bodies();
    cases.extend(gallery::layouts());
    for case in &cases {
        let (picture, _) = case.draw();
        assert_eq!(same(&picture, &picture), None);
        assert_eq!(same(&picture, &noisy(&picture, 1, 7)), None, "{}", case.name);
        // All of it one step brighter.
        let mut brighter = picture.clone();
        brighter
            .color
            .iter_mut()
            .flat_map(|pixel| pixel[..3].iter_mut())
            .for_each(|part| *part = part.saturating_add(1));
        assert_eq!(same(&picture, &brighter), None, "{}", case.name);
        assert!(same(&picture, &noisy(&picture, 12, 7)).is_some(), "{}", case.name);
        // Every corner a 256th of a pixel off, which is how finely rasterisers place them.
        let mut moved = case.clone();
        for (shift, side) in moved.view.lens.shift.iter_mut().zip(case.size) {
            *shift += 2.0 / f64::from(side) / 256.0;
        }
        assert_eq!(beyond(case, &moved), None, "{}", case.name);
    }
}

#[test]
fn a_picture_that_differs_is_written_with_what_to_do_about_it() {
    let folder = tempfile::tempdir().expect("a folder");
    let (kept, scratch) = (folder.path().join("kept"), folder.path().join("scratch"));
    let seen = Picture { width: 32, height: 24, color: vec![[120, 60, 40, 255]; 32 * 24] };
    let check =
        |seen: &Picture, accept| reference::check_in(&kept, &scratch, "tissue", seen, "a pencil", accept);
    let told = check(&seen, false).expect_err("there is none");
    assert!(told.contains("no reference") && told.contains("TROCAR_REFERENCES=accept"), "{told}");
    assert!(scratch.join("references/tissue.png").is_file());
    check(&seen, true).expect("accepted");
    check(&seen, false).expect("the same");
    let mut other = seen.clone();
    other.color[32 * 12..32 * 14].fill([20, 60, 200, 255]);
    let told = check(&other, false).expect_err("another one");
    assert!(told.contains("of 768 pixels differ") && told.contains("drawn by a pencil"), "{told}");
    let difference =
        image::open(scratch.join("references/tissue.difference.png")).expect("a picture").into_rgb8();
    let is_red = |y| difference.get_pixel(16, y).0 == [255, 0, 0];
    assert!(is_red(12) && is_red(13) && !is_red(1) && !is_red(22));
    let wider = Picture { width: 64, height: 12, ..seen.clone() };
    let told = check(&wider, false).expect_err("another size");
    assert!(told.contains("64 × 12") && told.contains("32 × 24"), "{told}");
}

#[test]
fn colours_have_the_coordinates_of_their_definition() {
    // Lindbloom's calculator, sRGB under D65.
    for (srgb, expected) in [
        ([255, 255, 255], [100.0, 0.0, 0.0]),
        ([0, 0, 0], [0.0, 0.0, 0.0]),
        ([255, 0, 0], [53.2408, 80.0925, 67.2032]),
        ([0, 0, 255], [32.2970, 79.1875, -107.8602]),
        ([119, 119, 119], [50.0344, 0.0, 0.0]),
    ] {
        let lab = perceptual::lab(srgb);
        let off = lab.iter().zip(expected).map(|(a, b): (&f64, f64)| (a - b).abs()).fold(0.0, f64::max);
        assert!(off < 0.02, "{srgb:?}: {lab:?}");
    }
}
