//! Sutures by size and material, and by values of their own, as scenarios name them.

use std::f64::consts::TAU;
use std::path::Path;

use nalgebra::{Point3, Vector3};
use trocar_scene::Scenario;
use trocar_simulator::controller::{Suture, SutureOf, ThreadBody};
use trocar_simulator::suture_thread::suture_table::{SutureMaterial, SutureSize};
use trocar_simulator::suture_thread::{Hold, Load, Surroundings, Thread, ThreadMaterial};

/// The thread of a scenario with this text for its component.
fn read(component: &str, value: &str) -> Result<ThreadBody, String> {
    let mut builder = trocar_scene::RegistryBuilder::new();
    trocar_scene::components::register(&mut builder).expect("the standard components");
    trocar_simulator::controller::register(&mut builder).expect("and ours");
    let registry = builder.build();
    let text = format!("schema = 1\nname = \"s\"\n[[entity]]\nname = \"thread\"\n{component} = {value}\n");
    let scenario =
        Scenario::parse(Path::new("s.toml"), &text, &registry).map_err(|error| error.to_string())?;
    let store = scenario.spawn(&registry).map_err(|error| error.to_string())?;
    let entity = store.view().find("thread").expect("it is there");
    Ok(store.view().get::<ThreadBody>(entity).cloned().unwrap_or_default())
}

#[test]
fn every_size_of_every_material_is_read() {
    for (name, material) in
        ["silk", "polyglactin", "polyester", "polypropylene", "nylon"].into_iter().zip(SutureMaterial::ALL)
    {
        for size in SutureSize::ALL {
            let body = read(
                "thread",
                &format!("{{ suture = {{ size = \"{}\", material = \"{name}\" }} }}", size.name()),
            );
            let strand = body.expect(name).material();
            assert_eq!(strand, material.strand(size.radius()), "{name} {}", size.name());
            let [low, high] = size.diameters();
            assert!(low < strand.diameter() && strand.diameter() < high);
        }
    }
}

#[test]
fn the_thinnest_and_the_thickest_suture_bear_a_pull_with_the_strain_of_their_modulus() {
    for (material, size) in [
        (SutureMaterial::Polypropylene, SutureSize::S6_0),
        (SutureMaterial::Nylon, SutureSize::S2),
        (SutureMaterial::Silk, SutureSize::S3_0),
    ] {
        let strand = material.strand(size.radius());
        let nodes: Vec<_> = (0..11).map(|at| Point3::new(0.0, 0.0, -2e-3 * f64::from(at))).collect();
        let material = ThreadMaterial { drag: 300.0, ..strand };
        let mut thread = Thread::new(material, &nodes).expect("a thread");
        // A strain of 0.2 % by a force at the end.
        let force = Vector3::new(0.0, 0.0, -2e-3 * strand.axial_stiffness);
        let (holds, loads) = ([Hold::fixed(0, nodes[0])], [Load { node: 10, force }]);
        let around = Surroundings { holds: &holds, loads: &loads, ..Surroundings::default() };
        for _ in 0..400 {
            thread.step(1e-3, &around).expect("a step");
        }
        let ends = [thread.positions()[0], thread.positions()[10]];
        let strain = (ends[1] - ends[0]).norm() / 0.02 - 1.0;
        assert!((strain / 2e-3 - 1.0).abs() < 0.01, "{material:?} {size:?}: {strain}");
    }
}

#[test]
fn values_of_ones_own_replace_those_of_the_table() {
    let body = read(
        "thread",
        "{ suture = { size = \"4/0\", material = \"nylon\", friction = 0.3, bending_stiffness = 1e-9 } }",
    );
    let (strand, table) =
        (body.expect("a thread").material(), SutureMaterial::Nylon.strand(SutureSize::S4_0.radius()));
    assert_eq!((strand.friction, strand.bending_stiffness), (0.3, 1e-9));
    assert_eq!((strand.axial_stiffness, strand.radius), (table.axial_stiffness, table.radius));
    let all = "{ suture = { radius = 2e-4, mass_per_length = 1e-4, axial_stiffness = 900.0, bending_stiffness = 2e-8, \
               twisting_stiffness = 3e-8, friction = 0.1 } }";
    let strand = read("thread", all).expect("a thread").material();
    assert_eq!((strand.radius, strand.mass_per_length, strand.axial_stiffness), (2e-4, 1e-4, 900.0));
    assert_eq!((strand.bending_stiffness, strand.twisting_stiffness, strand.friction), (2e-8, 3e-8, 0.1));
}

#[test]
fn the_two_sutures_that_have_a_name_are_what_they_were() {
    let body = read("thread", "{ suture = \"silk2_0\" }").expect("a thread");
    assert_eq!(body.material(), ThreadMaterial::silk_2_0());
    assert_eq!(body, ThreadBody::default());
    let thick = read("thread", "{ suture = \"silk2\" }").expect("a thread").material();
    assert_eq!(thick.radius, 2.5e-4);
    assert!(
        (thick.axial_stiffness / 9_722.22 - 1.0).abs() < 1e-6
            && (thick.bending_stiffness / 2.700_6e-7 - 1.0).abs() < 1e-4
    );
}

#[test]
fn what_is_no_suture_is_refused_with_the_valid_choices() {
    for (suture, parts) in [
        ("\"silk3\"", &["silk2_0", "silk2", "size ="][..]),
        ("{ size = \"7-0\", material = \"silk\" }", &["7-0", "6-0", "5-0", "3-0"]),
        ("{ size = \"3-0\", material = \"gut\" }", &["gut", "silk", "polyglactin", "polypropylene", "nylon"]),
        ("{ material = \"silk\" }", &["'size' (6-0, 5-0, 4-0, 3-0, 2-0, 0, 1, 2) or 'radius' is missing"]),
        ("{ size = \"0\", radius = 1e-4, material = \"silk\" }", &["'size' and 'radius' exclude each other"]),
        ("{ size = \"0\" }", &["'mass_per_length' is missing", "silk, polyglactin"]),
        ("{ radius = 1.0, material = \"silk\" }", &["suture.radius: 1 is out of range (1e-5 to 0.005 m)"]),
        ("{ size = \"0\", material = \"silk\", colour = \"black\" }", &["colour", "friction"]),
        ("3", &["silk2_0"]),
    ] {
        for component in ["thread", "needle"] {
            let error = read(component, &format!("{{ suture = {suture} }}")).expect_err(suture);
            assert!(error.starts_with("s.toml:5:"), "{error}");
            for part in parts {
                assert!(error.contains(part), "{part} in {error}");
            }
        }
    }
}

#[test]
fn a_suture_survives_documents_and_binary() {
    let of = SutureOf {
        size: Some(SutureSize::S3_0),
        material: Some(SutureMaterial::Nylon),
        ..SutureOf::default()
    };
    for suture in [Suture::Silk2_0, Suture::Silk2, Suture::Of(of)] {
        let json = serde_json::to_value(suture).expect("JSON");
        assert_eq!(serde_json::from_value::<Suture>(json).expect("a suture"), suture);
        let bytes = postcard::to_stdvec(&suture).expect("bytes");
        assert_eq!(postcard::from_bytes::<Suture>(&bytes).expect("a suture"), suture);
    }
    // As before there were tables.
    assert_eq!(postcard::to_stdvec(&Suture::Silk2).expect("bytes"), [1]);
}

#[test]
fn diameters_are_those_of_the_pharmacopeia() {
    // Limits of USP <861> [mm], and the metric size: its tenths of a millimetre are where the limits begin.
    for (size, [low, high], metric) in [
        ("6-0", [0.070, 0.099], 0.7),
        ("5-0", [0.100, 0.149], 1.0),
        ("4-0", [0.150, 0.199], 1.5),
        ("3-0", [0.200, 0.249], 2.0),
        ("2-0", [0.300, 0.339], 3.0),
        ("0", [0.350, 0.399], 3.5),
        ("1", [0.400, 0.499], 4.0),
        ("2", [0.500, 0.599], 5.0),
    ] {
        let found = SutureSize::ALL.into_iter().find(|known| known.name() == size).expect(size);
        let [least, most] = found.diameters().map(|diameter| diameter * 1e3);
        assert!((least - low).abs() < 1e-12 && (most - high).abs() < 1e-12, "{size}");
        assert!((least - 0.1 * metric).abs() < 1e-12, "{size}");
        assert!((2e3 * found.radius() - (low + high) / 2.0).abs() < 1e-12, "{size}");
    }
    assert!(SutureSize::ALL.windows(2).all(|two| two[0].diameters()[1] < two[1].diameters()[0]));
}

#[test]
fn stiffnesses_are_those_of_a_round_rod_and_a_braid_bends_a_hundred_times_as_easily() {
    for material in SutureMaterial::ALL {
        for size in SutureSize::ALL {
            let strand = material.strand(size.radius());
            let modulus = material.young_modulus().0;
            // A strand as a body of rings: the sums over the section are A = Σ dA and I = Σ y² dA.
            let (rings, sectors) = (400, 400);
            let (mut area, mut second) = (0.0, 0.0);
            for ring in 0..rings {
                let at = (f64::from(ring) + 0.5) / f64::from(rings) * strand.radius;
                let width = strand.radius / f64::from(rings);
                for sector in 0..sectors {
                    let angle = (f64::from(sector) + 0.5) / f64::from(sectors) * TAU;
                    let piece = at * width * TAU / f64::from(sectors);
                    area += piece;
                    second += piece * (at * angle.sin()).powi(2);
                }
            }
            let near = |value: f64, expected: f64| (value / expected - 1.0).abs() < 1e-5;
            assert!(near(strand.axial_stiffness, modulus * area), "{material:?} {size:?}");
            assert!(near(strand.mass_per_length, material.density() * area));
            let share = if material.is_braided() { 0.01 } else { 1.0 };
            assert!(near(strand.bending_stiffness, share * modulus * second), "{material:?} {size:?}");
            // G J with G = E / (2 (1 + ν)) and J = 2 I.
            let shear = modulus / (2.0 * 1.4);
            assert!(near(strand.twisting_stiffness, shear * 2.0 * second), "{material:?} {size:?}");
        }
    }
    // 4-0 polypropylene of 0.1745 mm: E A = 59.8 N, E I = 1.138e-7 N·m².
    let strand = SutureMaterial::Polypropylene.strand(SutureSize::S4_0.radius());
    assert!((strand.axial_stiffness - 59.79).abs() < 0.01, "{strand:?}");
    assert!((strand.bending_stiffness - 1.1379e-7).abs() < 1e-11, "{strand:?}");
}
