//! The detection methods side by side: each finds its contacts, and the engine responds to them.

use nalgebra::Vector3;
use trocar::prelude::*;
use trocar_tests::edited;

const MS: SimTime = SimTime::from_millis(1);

fn gallery<'a>() -> trocar::open::SessionBuilder<'a> {
    Session::builder().seed(1)
}

fn place(scene: &Snapshot, name: &str) -> Vector3<f64> {
    scene.world_pose(scene.find(name).expect("an entity")).translation.vector
}

fn speed(scene: &Snapshot, name: &str) -> f64 {
    let stone = scene.find(name).expect("an entity");
    scene.get::<Velocity>(stone).copied().unwrap_or_default().linear.norm()
}

/// Methods with contacts in the scene.
fn methods(scene: &Snapshot) -> Vec<Detection> {
    let mut methods: Vec<Detection> = scene
        .iter::<CollisionList>()
        .flat_map(|(_, list)| list.collisions.iter().map(|collision| collision.method))
        .collect();
    methods.sort_unstable();
    methods.dedup();
    methods
}

#[test]
fn every_method_catches_its_stone_and_without_it_the_stone_falls_through() {
    let mut session = gallery().open("collision-gallery").expect("opens");
    let mut seen = Vec::new();
    while session.now() < SimTime::from_millis(2_000) {
        session.step(SimTime::from_millis(10));
        seen.extend(methods(&session.snapshot()));
    }
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(
        seen,
        [
            Detection::Engine,
            Detection::ObbTree,
            Detection::Proximity,
            Detection::DynamicPoint,
            Detection::ZBuffer,
            Detection::SphericalHash,
            Detection::Continuous,
            Detection::Proxy
        ]
    );
    let scene = session.snapshot();
    for stone in ["stone.engine", "stone.trees", "stone.hash"] {
        let at = place(&scene, stone);
        assert!((0.004..0.012).contains(&at.z), "{stone} lies in its ring: {at:?}");
        assert!(speed(&scene, stone) < 2e-3, "{stone} rests: {}", speed(&scene, stone));
    }
    let at = place(&scene, "stone.proximity");
    assert!((0.0140..0.0152).contains(&at.z), "it lies on its skin: {at:?}");
    assert!(speed(&scene, "stone.proximity") < 5e-3, "{}", speed(&scene, "stone.proximity"));
    let at = place(&scene, "stone.motion");
    assert!((0.0080..0.0112).contains(&at.z), "it lies on its sheet: {at:?}");
    assert!(speed(&scene, "stone.motion") < 5e-3, "{}", speed(&scene, "stone.motion"));
    // It hit the shaft beside its middle and was deflected.
    let thrown = place(&scene, "stone.shaft");
    assert!(thrown.x > 0.060 && thrown.z < -0.1, "{thrown:?}");
    let thrown = place(&scene, "stone.image");
    assert!(thrown.x < 0.040 && thrown.z < -0.1, "to the other side: {thrown:?}");

    // The left hand presses the organ: the list holds the force that it feels.
    let pressed = |scene: &Snapshot| {
        let hand = scene.find("hand.left").expect("an entity");
        scene.get::<DeviceState>(hand).map_or(0.0, |state| state.applied_force.norm())
    };
    let listed = scene.iter::<CollisionList>().flat_map(|(_, list)| &list.collisions);
    let listed: Vec<f64> = listed
        .filter(|contact| contact.method == Detection::Proxy)
        .map(|contact| contact.force_in_world.norm())
        .collect();
    let [listed] = listed[..] else { panic!("one contact: {listed:?}") };
    assert!(listed > 0.5 && (pressed(&scene) - listed).abs() < 0.02 * listed, "{} {listed}", pressed(&scene));
    let mut without = gallery().without("touch").open("collision-gallery").expect("opens");
    without.step(SimTime::from_millis(1_000));
    let sunk = without.snapshot();
    assert_eq!(pressed(&sunk), 0.0, "nobody else lets it feel the organ");
    let depth = |scene: &Snapshot| {
        let probe = scene.find("probe.left").expect("an entity");
        0.010 - scene.get::<InstrumentTarget>(probe).expect("a target").tip_in_world.translation.z
    };
    assert!(depth(&sunk) > depth(&scene) + 5e-4, "the hand sinks in: {} {}", depth(&sunk), depth(&scene));

    // A control for the engine's own detection: its stone has only a surface mesh, without a shape for the engine.
    let app = App::new();
    let shape = "translation = [-0.100, 0.0, 0.030] }\nshape = { sphere = { radius = 0.010 } }";
    let surface = "translation = [-0.100, 0.0, 0.030] }\nmesh = { shape = { sphere = { radius = 0.010 } } }";
    let blind = edited(&app, "collision-gallery", &[(shape, surface)]);
    let mut without = gallery().app(&app).open_scenario(&blind).expect("opens");
    without.step(SimTime::from_millis(350));
    let (with, fallen) = (place(&scene, "stone.engine"), place(&without.snapshot(), "stone.engine"));
    assert!(with.z > 0.0 && fallen.z < -0.1, "the engine: {with:?} {fallen:?}");

    let caught = [
        ("trees", "stone.trees"),
        ("distances", "stone.proximity"),
        ("hash", "stone.hash"),
        ("motions", "stone.motion"),
        ("line", "stone.shaft"),
        ("image", "stone.image"),
    ];
    for (controller, stone) in caught {
        let mut without = gallery().without(controller).open("collision-gallery").expect("opens");
        without.step(SimTime::from_millis(350));
        let scene = without.snapshot();
        let (with, fallen) = (place(&session.snapshot(), stone), place(&scene, stone));
        assert!((fallen - with).norm() > 0.01, "{controller}: {with:?} {fallen:?}");
        // Straight down, past all obstacles.
        let from = match stone {
            "stone.shaft" | "stone.image" => 0.045,
            "stone.motion" => 0.060,
            _ => 0.030,
        };
        assert!((fallen.z - (from - 0.5 * 9.81 * 0.35_f64.powi(2))).abs() < 0.01, "{controller}: {fallen:?}");
        for other in ["stone.trees", "stone.hash"].iter().filter(|other| **other != stone) {
            assert!(place(&scene, other).z > 0.0, "{controller} has nothing to do with {other}");
        }
    }
}

#[test]
fn a_detector_that_dies_takes_its_contacts_with_it_and_its_successor_finds_them_again() {
    let plan = FaultPlan::new(7).at(secs(1.5)).kill("trees").at(secs(1.6)).kill("engine");
    let mut session = gallery().faults(plan).open("collision-gallery").expect("opens");
    session.step(SimTime::from_millis(1_400));
    let before = place(&session.snapshot(), "stone.trees");
    let mut lowest = before.z;
    while session.now() < SimTime::from_millis(2_200) {
        session.step(MS);
        lowest = lowest.min(place(&session.snapshot(), "stone.trees").z);
    }
    assert!(before.z - lowest < 1e-3, "it hardly sinks meanwhile: {before:?} {lowest}");
    let after = place(&session.snapshot(), "stone.trees");
    assert!((after - before).norm() < 5e-4, "{before:?} {after:?}");
    let restarts: u32 = session.reports().iter().map(|row| row.restarts).sum();
    // Rest for one: with the first detector those below it in the tree restart, the engine last; then the engine once
    // more.
    assert_eq!(restarts, 9);
}

#[test]
fn each_method_reports_its_rate_its_cost_and_its_hits() {
    let mut session = gallery().open("collision-gallery").expect("opens");
    session.step(SimTime::from_millis(1_000));
    let reports = session.reports();
    for name in ["trees", "distances", "motions", "hash", "line", "image", "touch", "engine"] {
        let row = reports.iter().find(|row| row.name == name).expect("a row");
        let hits = row.hits.unwrap_or_else(|| panic!("{name} is a detector"));
        assert!(hits.max > 0 && hits.ticks > 0 && hits.mean > 0.0, "{name}: {hits:?}");
        assert!(
            hits.ticks <= row.scheduled && hits.now <= hits.max && hits.mean <= hits.max as f64,
            "{name}: {hits:?}"
        );
        assert!((row.achieved_hz - row.target_hz).abs() < 1.0, "{name}: {row:?}");
        assert!(row.step_us.p99 >= row.step_us.p50 && row.step_us.p50 > 0.0, "{name}: {row:?}");
    }
    for row in reports.iter().filter(|row| row.name.starts_with("haptics")) {
        assert_eq!(row.hits, None, "{} finds nothing", row.name);
    }
    // The detector's last list is in the scene.
    let scene = session.snapshot();
    let in_scene: u64 = scene.iter::<CollisionList>().map(|(_, list)| list.collisions.len() as u64).sum();
    let told: u64 = reports.iter().filter_map(|row| row.hits).map(|hits| hits.now).sum();
    assert_eq!(told, in_scene);
}

#[test]
fn the_same_seed_gives_the_same_contacts() {
    let hash = || {
        let mut session = gallery().open("collision-gallery").expect("opens");
        session.step(SimTime::from_millis(700));
        session.hash().expect("in virtual time").to_string()
    };
    assert_eq!(hash(), hash());
}
