//! What the repair of a surface keeps and what it brings about, on surfaces that were damaged at random.

use nalgebra::{Point3, Vector3};
use proptest::prelude::*;
use trocar_scene::mesh::{
    SurfaceData, SurfacePolicy, WELD_RELATIVE, repaired_surface, validate_surface, weld_tolerance,
};
use trocar_scene::shapes;

fn torus() -> SurfaceData {
    let mut torus = shapes::torus(0.06, 0.02, 12, 8).expect("a torus");
    torus.normals = None;
    torus
}

/// Damage of one kind to a closed surface.
#[derive(Clone, Copy, Debug)]
enum Damage {
    /// A corner of a triangle gets a vertex of its own, a hair from the old one.
    Unweld(usize, u8),
    /// A triangle is turned.
    Turn(usize),
    /// A triangle is there twice, possibly turned.
    Repeat(usize, bool),
    /// A triangle without area lies on an edge of another.
    Flat(usize),
    /// A vertex lies on an edge and both triangles beside it do not know of it but a flat one does.
    Middle(usize),
    /// A vertex that nothing uses.
    Unused,
}

fn damage() -> impl Strategy<Value = Damage> {
    let number = 0usize..10_000;
    prop_oneof![
        (number.clone(), 0u8..3).prop_map(|(t, k)| Damage::Unweld(t, k)),
        number.clone().prop_map(Damage::Turn),
        (number.clone(), any::<bool>()).prop_map(|(t, turned)| Damage::Repeat(t, turned)),
        number.clone().prop_map(Damage::Flat),
        number.prop_map(Damage::Middle),
        Just(Damage::Unused),
    ]
}

fn damaged(mut surface: SurfaceData, damages: &[Damage]) -> SurfaceData {
    let sound = surface.triangles.len();
    let add = |surface: &mut SurfaceData, triangle: [u32; 3], like: usize| {
        surface.triangles.push(triangle);
        if let Some(uvs) = &mut surface.uvs {
            uvs.push(uvs[like]);
        }
    };
    let mut split = std::collections::BTreeSet::new();
    for (n, damage) in damages.iter().enumerate() {
        match *damage {
            Damage::Unweld(t, k) => {
                let (t, k) = (t % sound, usize::from(k));
                let hair = Vector3::repeat(1e-9 * (1.0 + n as f64));
                let twin = surface.positions[surface.triangles[t][k] as usize] + hair;
                surface.positions.push(twin);
                surface.triangles[t][k] = surface.positions.len() as u32 - 1;
            }
            Damage::Turn(t) => surface.triangles[t % sound].swap(0, 1),
            Damage::Repeat(t, turned) => {
                // Of even ones, of which none is split.
                let t = t / 2 * 2;
                let mut copy = surface.triangles[t % sound];
                if turned {
                    copy.swap(0, 1);
                }
                add(&mut surface, copy, t % sound);
            }
            Damage::Flat(t) => {
                let [a, b, _] = surface.triangles[t % sound];
                add(&mut surface, [a, b, a], t % sound);
            }
            Damage::Middle(t) => {
                // Triangle a b c becomes m b c and a m c, and its edge a b stays with the neighbour and a flat a b m.
                let t = (t / 2 * 2 + 1) % sound;
                if !split.insert(t) {
                    continue;
                }
                let [a, b, c] = surface.triangles[t];
                let middle = nalgebra::center(&surface.positions[a as usize], &surface.positions[b as usize]);
                surface.positions.push(middle);
                let m = surface.positions.len() as u32 - 1;
                surface.triangles[t] = [m, b, c];
                add(&mut surface, [a, m, c], t);
                add(&mut surface, [a, b, m], t);
            }
            Damage::Unused => surface.positions.push(Point3::new(0.01 * n as f64, 0.0, 0.0)),
        }
    }
    surface
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// Volume and area are kept to the tolerance of welding, the surface is closed, manifold and faces outwards, every
    /// vertex is used, and a second repair does nothing.
    #[test]
    fn a_damaged_body_becomes_a_body_again(damages in prop::collection::vec(damage(), 0..24), inside_out in any::<bool>()) {
        let sound = torus();
        let mut surface = damaged(sound.clone(), &damages);
        if inside_out {
            surface.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        let (mended, repairs) = repaired_surface(&surface, 1e-6);
        let report = validate_surface(&mended);
        SurfacePolicy::SOLID.require(std::path::Path::new("x"), &report).map_err(|error| {
            TestCaseError::fail(format!("{error}, after {repairs}"))
        })?;
        prop_assert_eq!((report.unreferenced.count, report.components, report.euler_characteristic()), (0, 1, 0));
        prop_assert!((mended.volume() / sound.volume() - 1.0).abs() < 1e-5, "{} m³", mended.volume());
        prop_assert!((mended.area() / sound.area() - 1.0).abs() < 1e-5, "{} m²", mended.area());
        prop_assert_eq!(mended.uvs.as_ref().map(Vec::len), Some(mended.triangles.len()));
        let (again, nothing) = repaired_surface(&mended, 1e-6);
        prop_assert!(nothing.is_empty(), "{}", nothing);
        prop_assert_eq!(again, mended);
    }

    /// Vertices that are farther apart than the tolerance stay.
    #[test]
    fn nothing_is_welded_that_is_apart(exponent in -9.0..-3.0f64) {
        let tolerance = 10f64.powf(exponent);
        let mut surface = torus();
        let moved = surface.positions[0] + Vector3::x() * (1.01 * tolerance);
        surface.positions.push(moved);
        surface.triangles[0] = surface.triangles[0].map(|v| if v == 0 { surface.positions.len() as u32 - 1 } else { v });
        let (_, repairs) = repaired_surface(&surface, tolerance);
        prop_assert!(repairs.welded.is_empty(), "{:?}", repairs.welded);
        let (_, repairs) = repaired_surface(&surface, 1.02 * tolerance);
        let opened = surface.triangles[0].contains(&(surface.positions.len() as u32 - 1));
        prop_assert_eq!(repairs.welded.len(), usize::from(opened) + usize::from(!opened));
    }
}

#[test]
fn a_sound_surface_comes_back_as_it_is() {
    let sound = torus();
    let weld = weld_tolerance(&sound.positions);
    assert!((weld / WELD_RELATIVE - (0.16f64.powi(2) * 2.0 + 0.04f64.powi(2)).sqrt()).abs() < 1e-3, "{weld}");
    let (mended, repairs) = repaired_surface(&sound, weld);
    assert_eq!(mended, sound);
    assert!(repairs.is_empty());
    assert_eq!(repairs.to_string(), "nothing had to be mended");
}

#[test]
fn an_open_surface_keeps_its_rim_and_the_larger_part_of_it_its_side() {
    let mut open = torus();
    open.triangles.truncate(open.triangles.len() - 9);
    if let Some(uvs) = &mut open.uvs {
        uvs.truncate(open.triangles.len());
    }
    let rim = validate_surface(&open).boundary_edges.count;
    let mut turned = open.clone();
    turned.triangles.iter_mut().step_by(5).for_each(|t| t.swap(1, 2));
    let (mended, repairs) = repaired_surface(&turned, 1e-9);
    let report = validate_surface(&mended);
    assert_eq!((report.boundary_edges.count, report.misoriented_edges.count), (rim, 0));
    let count = turned.triangles.len().div_ceil(5);
    assert_eq!(repairs.turned, (0..count as u32).map(|k| 5 * k).collect::<Vec<_>>());
    assert!(repairs.to_string().contains(&format!("{count} triangles were turned (the first: triangle 0)")));
    for (one, other) in mended.triangles.iter().zip(&open.triangles) {
        let mut sorted = [*one, *other];
        sorted.iter_mut().for_each(|t| {
            let least = t.iter().enumerate().min_by_key(|(_, v)| **v).map_or(0, |(k, _)| k);
            t.rotate_left(least);
        });
        let same =
            |k: usize| mended.positions[sorted[0][k] as usize] == open.positions[sorted[1][k] as usize];
        assert!((0..3).all(same), "a triangle has another side than before");
    }
}

#[test]
fn a_fin_on_a_closed_body_is_dropped_and_sheets_that_meet_are_not() {
    let mut finned = torus();
    finned.uvs = None;
    let [a, b, _] = finned.triangles[7];
    let tip = finned.positions.len() as u32;
    finned.positions.extend([Point3::new(0.1, 0.0, 0.1), Point3::new(0.11, 0.0, 0.1)]);
    finned.triangles.extend([[a, b, tip], [b, tip + 1, tip]]);
    let (mended, repairs) = repaired_surface(&finned, 1e-9);
    assert_eq!(repairs.fins, [192, 193]);
    assert!(
        repairs.to_string().contains("2 triangles were dropped that stuck out of a closed body"),
        "{repairs}"
    );
    assert_eq!((mended.positions, mended.triangles), (torus().positions, torus().triangles));
    // Three sheets about one edge: none of them is the body.
    let mut sheets = SurfaceData::default();
    sheets
        .positions
        .extend([[0., 0., 0.], [0., 0., 1.], [1., 0., 0.], [-1., 1., 0.], [-1., -1., 0.]].map(Point3::from));
    sheets.triangles.extend([[0, 1, 2], [0, 1, 3], [0, 1, 4]]);
    assert!(repaired_surface(&sheets, 1e-9).1.fins.is_empty());
}

#[test]
fn a_moebius_band_cannot_be_oriented_and_is_refused() {
    let count = 12u32;
    let mut band = SurfaceData::default();
    for k in 0..count {
        let angle = std::f64::consts::TAU * f64::from(k) / f64::from(count);
        for side in [-1.0, 1.0] {
            let across = side * 0.2;
            let radius = 1.0 + across * (angle / 2.0).cos();
            band.positions.push(Point3::new(
                radius * angle.cos(),
                radius * angle.sin(),
                across * (angle / 2.0).sin(),
            ));
        }
    }
    for k in 0..count {
        let (a, b) = (2 * k, 2 * k + 1);
        // The last piece meets the first one with its sides exchanged.
        let (c, d) = if k + 1 == count { (1, 0) } else { (2 * k + 2, 2 * k + 3) };
        band.triangles.extend([[a, c, b], [b, c, d]]);
    }
    let (mended, _) = repaired_surface(&band, 1e-9);
    let policy = SurfacePolicy { closed: false, ..SurfacePolicy::SOLID };
    let refused =
        policy.require(std::path::Path::new("band"), &validate_surface(&mended)).expect_err("one side");
    assert!(refused.to_string().contains("opposite orientation"), "{refused}");
}
