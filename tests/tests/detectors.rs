//! Detectors on difficult bodies: an organ that folds onto itself, and surfaces that are replaced, invalid or removed
//! while every method queries them.

use std::sync::Arc;

use nalgebra::Point3;
use trocar::prelude::*;
use trocar_collision::primitive::triangles_overlap;
use trocar_scene::shapes;

const MS: SimTime = SimTime::from_millis(1);

fn found(scene: &Snapshot) -> Vec<Collision> {
    scene.iter::<CollisionList>().flat_map(|(_, list)| list.collisions.clone()).collect()
}

// ---- An organ that folds -----------------------------------------------------------------------------------------------

/// Rows along the sheet, and vertices across it.
const ROWS: u32 = 41;
const ACROSS: u32 = 5;
/// Half of the sheet's length, its half width, and how high the fold arches \[m\].
const HALF: f64 = 0.030;
const WIDTH: f64 = 0.008;
const ARCH: f64 = 0.010;

fn sheet() -> Vec<[u32; 3]> {
    let mut triangles = Vec::new();
    for row in 0..ROWS - 1 {
        for column in 0..ACROSS - 1 {
            let a = row * ACROSS + column;
            triangles.push([a, a + ACROSS, a + 1]);
            triangles.push([a + 1, a + ACROSS, a + ACROSS + 1]);
        }
    }
    triangles
}

/// One half lies flat; the other arches over it, and its end is at this depth below the flat half \[m\].
fn folded(beneath: f64) -> Vec<Point3<f64>> {
    let mut vertices = Vec::new();
    for row in 0..ROWS {
        let along = 2.0 * f64::from(row) / f64::from(ROWS - 1) - 1.0;
        for column in 0..ACROSS {
            let y = WIDTH * (2.0 * f64::from(column) / f64::from(ACROSS - 1) - 1.0);
            vertices.push(if along <= 0.0 {
                Point3::new(along * HALF, y, 0.0)
            } else {
                let z = 4.0 * ARCH * along * (1.0 - along) - beneath * along;
                // Not aligned with the rows, and slightly skewed.
                Point3::new(-0.77 * along * HALF, 0.9 * y + 0.001, z)
            });
        }
    }
    vertices
}

/// Folds the organ: its end sinks from 4 mm above the flat half to 4 mm below, and returns.
struct Folding(Entity);

fn beneath(time: SimTime) -> f64 {
    -0.004 * (std::f64::consts::TAU * time.as_secs_f64()).cos()
}

impl Controller for Folding {
    fn access(&self) -> Access {
        Access::new().writes::<VertexPositions>(EntitySet::Of(vec![self.0]))
    }
    fn tick(&mut self, tick: &Tick<'_>, _: &Snapshot, out: &mut Commands) -> Result<(), ControllerError> {
        let positions = Arc::new(folded(beneath(tick.time)));
        out.put(self.0, VertexPositions { positions });
        Ok(())
    }
}

#[test]
fn an_organ_that_folds_onto_itself_tells_where_it_meets_itself() {
    let app = App::new().controller_with("folding", |(): &(), context: &BuildContext<'_>| {
        Ok(Folding(context.scene.find("organ").expect("the scenario's")))
    });
    let text = r#"
schema = 1
name = "fold"
title = "Fold"
description = "A sheet folds onto itself."
gravity = [0.0, 0.0, -9.81]
[[entity]]
name = "organ"
pose = { translation = [0.1, -0.2, 0.3], rotation = [0.0, 0.6, 0.0, 0.8] }
mesh = { shape = { sphere = { radius = 0.01 } }, segments = 8 }
[[controller]]
name = "folding"
kind = "folding"
rate_hz = 100
[[controller]]
name = "trees"
kind = "obb-tree"
rate_hz = 200
params = { pairs = [["organ", "organ"]], stiffness = 300.0 }
"#;
    let scenario = app.scenario_from("fold.toml".as_ref(), text).expect("valid");
    let mut session = Session::builder().app(&app).open_scenario(&scenario).expect("opens");
    let organ = session.snapshot().find("organ").expect("the scenario's");
    let triangles = sheet();
    let mesh = SurfaceMesh { triangles: Arc::new(triangles.clone()) };
    let flat = VertexPositions { positions: Arc::new(folded(-0.004)) };
    session
        .apply(|out| {
            out.put(organ, mesh.clone());
            out.put(organ, flat.clone());
        })
        .expect("a sheet");
    let (mut apart, mut folds) = (0, 0);
    for _ in 0..30 {
        session.step(SimTime::from_millis(70));
        let scene = session.snapshot();
        let vertices = scene.get::<VertexPositions>(organ).expect("a mesh").positions.clone();
        let corners = |index: usize| triangles[index].map(|vertex| vertices[vertex as usize]);
        let mut expected = Vec::new();
        for a in 0..triangles.len() {
            for b in a + 1..triangles.len() {
                let adjacent = triangles[a].iter().any(|vertex| triangles[b].contains(vertex));
                if !adjacent && triangles_overlap(&corners(a), &corners(b)) {
                    expected.push([a as u32, b as u32]);
                }
            }
        }
        let contacts = found(&scene);
        let pair = |contact: &Collision| match (contact.primitive_a, contact.primitive_b) {
            (Primitive::Triangle(a), Primitive::Triangle(b)) => [a, b],
            other => panic!("{other:?}"),
        };
        let mut pairs: Vec<[u32; 2]> = contacts.iter().map(pair).collect();
        pairs.sort_unstable();
        assert_eq!(pairs, expected, "at {:?}", session.now());
        let world = scene.world_pose(organ);
        for contact in &contacts {
            assert_eq!((contact.a, contact.b, contact.method), (organ, organ, Detection::ObbTree));
            // The flat half is the first body: the normal pushes the other one up.
            let up = world.inverse_transform_vector(&contact.normal_in_world);
            assert!(up.z > 0.3 && (up.norm() - 1.0).abs() < 1e-9, "{up:?}");
            assert!((0.0..0.006).contains(&contact.depth), "{contact:?}");
            let middle = world.inverse_transform_point(&contact.middle_in_world());
            assert!(middle.z.abs() < 0.004, "it meets itself in the flat half: {middle:?}");
        }
        if expected.is_empty() { apart += 1 } else { folds += 1 }
    }
    assert!(apart > 6 && folds > 6, "{apart} times apart, {folds} times folded");
}

// ---- Surfaces in trouble -----------------------------------------------------------------------------------------------

/// Two copies of an organ with a stone inside and a shaft at its side, queried by every method.
fn ward() -> String {
    let mut text = String::from(
        r#"
schema = 1
name = "ward"
title = "Ward"
description = "Every method on two patients, one of which is in trouble."
gravity = [0.0, 0.0, -9.81]
"#,
    );
    for (side, y) in [("sick", 0.0), ("sound", 0.2)] {
        text += &format!(
            r#"
[[entity]]
name = "{side}.organ"
pose = {{ translation = [0.0, {y:?}, 0.0] }}
mesh = {{ shape = {{ sphere = {{ radius = 0.02 }} }}, segments = 16 }}
[[entity]]
name = "{side}.stone"
pose = {{ translation = [0.031, {y:?}, 0.001] }}
mesh = {{ shape = {{ sphere = {{ radius = 0.012 }} }}, segments = 12 }}
[[entity]]
name = "{side}.pebble"
pose = {{ translation = [0.0, {y:?}, -0.0327] }}
mesh = {{ shape = {{ sphere = {{ radius = 0.012 }} }}, segments = 12 }}
[[entity]]
name = "{side}.probe"
pose = {{ translation = [-0.021, {y:?}, 0.0], rotation = [1.0, 0.0, 0.0, 0.0] }}
[entity.instrument_target]
tip_in_world = {{ translation = [-0.021, {y:?}, 0.0], rotation = [1.0, 0.0, 0.0, 0.0] }}
[entity.instrument]
kind = "probe"
jaws = 0
shaft_length = 0.1
"#
        );
    }
    let both = r#"[["sick.organ", "sick.stone"], ["sound.organ", "sound.stone"]]"#;
    let near = r#"[["sick.organ", "sick.pebble"], ["sound.organ", "sound.pebble"]]"#;
    let shafts = r#"instruments = ["sick.probe", "sound.probe"], bodies = ["sick.organ", "sound.organ"]"#;
    let touch = r#"instruments = ["sick.probe", "sound.probe"], surfaces = ["sick.organ", "sound.organ"]"#;
    let rows = [
        ("trees", "obb-tree", format!("pairs = {both}")),
        ("itself", "obb-tree", r#"pairs = [["sick.organ", "sick.organ"]]"#.to_owned()),
        ("distances", "proximity", format!("pairs = {near}, margin = 0.002")),
        ("motions", "continuous", format!("pairs = {both}")),
        ("hash", "spherical-hash", r#"body = "sick.organ", others = ["sick.stone"]"#.to_owned()),
        (
            "hash.sound",
            "spherical-hash",
            r#"body = "sound.organ", others = ["sound.stone", "sick.stone"]"#.to_owned(),
        ),
        ("line", "dynamic-point", shafts.to_owned()),
        ("image", "z-buffer", shafts.to_owned()),
        ("touch", "finger-proxy", touch.to_owned()),
    ];
    for (name, kind, params) in rows {
        text += &format!(
            "[[controller]]\nname = \"{name}\"\nkind = \"{kind}\"\nrate_hz = 500\nparams = {{ {params} }}\n"
        );
    }
    text
}

/// Methods with a present contact of an entity, without `Continuous`, which keeps a contact while the other body stays
/// on the far side.
fn methods(scene: &Snapshot, entity: Entity) -> Vec<Detection> {
    let of = |contact: &Collision| {
        contact.method != Detection::Continuous && (contact.a == entity || contact.b == entity)
    };
    let mut methods: Vec<Detection> =
        found(scene).iter().filter(|contact| of(contact)).map(|contact| contact.method).collect();
    methods.sort_unstable();
    methods.dedup();
    methods
}

/// Methods that need no motion.
const AT_REST: [Detection; 6] = [
    Detection::ObbTree,
    Detection::Proximity,
    Detection::DynamicPoint,
    Detection::ZBuffer,
    Detection::SphericalHash,
    Detection::Proxy,
];

struct Ward {
    session: Session,
    sick: Entity,
    sound: Entity,
    /// Expected restarts of all detectors.
    restarts: u32,
}

impl Ward {
    fn open() -> Self {
        Self::with(FaultPlan::new(1))
    }

    fn with(faults: FaultPlan) -> Self {
        let app = App::new();
        let scenario = app.scenario_from("ward.toml".as_ref(), &ward()).expect("valid");
        let builder = Session::builder().app(&app).faults(faults);
        let mut session = builder.open_scenario(&scenario).expect("opens");
        session.step(SimTime::from_millis(20));
        let scene = session.snapshot();
        let [sick, sound] = ["sick.organ", "sound.organ"].map(|name| scene.find(name).expect("there"));
        assert_eq!((methods(&scene, sick), methods(&scene, sound)), (AT_REST.to_vec(), AT_REST.to_vec()));
        Self { session, sick, sound, restarts: 0 }
    }

    fn put(&mut self, vertices: Option<Vec<Point3<f64>>>, triangles: Option<Vec<[u32; 3]>>) {
        let sick = self.sick;
        self.session
            .apply(|out| {
                if let Some(triangles) = triangles {
                    out.put(sick, SurfaceMesh { triangles: Arc::new(triangles) });
                }
                if let Some(positions) = vertices {
                    out.put(sick, VertexPositions { positions: Arc::new(positions) });
                }
            })
            .expect("the Model takes it");
    }

    fn mesh(&mut self) -> (Vec<Point3<f64>>, Vec<[u32; 3]>) {
        let scene = self.session.snapshot();
        let vertices = scene.get::<VertexPositions>(self.sick).expect("a mesh").positions.to_vec();
        (vertices, scene.get::<SurfaceMesh>(self.sick).expect("a mesh").triangles.to_vec())
    }

    /// The contacts of the faulty organ a while later. No detector has died, and the intact organ is still detected.
    fn after(&mut self, what: &str) -> Vec<Detection> {
        for _ in 0..10 {
            self.session.step(MS);
            let scene = self.session.snapshot();
            assert_eq!(methods(&scene, self.sound), AT_REST, "{what}: the sound one");
        }
        for row in self.session.reports() {
            assert_eq!((row.restarts, row.rejected), (self.restarts, 0), "{what}: {}", row.name);
        }
        methods(&self.session.snapshot(), self.sick)
    }

    fn events(&mut self, name: &str) -> usize {
        self.session.snapshot().events().since(0).filter(|(_, event)| event.name == name).count()
    }
}

#[test]
fn a_mesh_that_is_replaced_in_mid_run_is_found_as_it_is_now() {
    let mut ward = Ward::open();
    for segments in [12, 40, 24] {
        let ball = shapes::sphere(0.02, segments, segments).expect("a ball");
        ward.put(Some(ball.positions), Some(ball.triangles));
        assert_eq!(ward.after("another ball"), AT_REST, "{segments} segments");
    }
    // Smaller than any contact distance; then restored.
    let (vertices, triangles) = ward.mesh();
    ward.put(Some(vertices.iter().map(|vertex| vertex * 0.3).collect()), None);
    assert_eq!(ward.after("shrunk"), []);
    ward.put(Some(vertices), Some(triangles));
    assert_eq!(ward.after("as it was"), AT_REST);
}

#[test]
fn corners_that_do_not_exist_make_a_body_absent_until_they_do() {
    let mut ward = Ward::open();
    let ball = shapes::sphere(0.02, 40, 40).expect("a ball");
    // Triangles first: their vertices follow later.
    ward.put(None, Some(ball.triangles));
    assert_eq!(ward.after("no such corners"), []);
    let told = ward.events("surface_unusable");
    assert!(told >= 8, "every detector says so, once: {told}");
    assert_eq!((ward.after("still none"), ward.events("surface_unusable")), (vec![], told));
    ward.put(Some(ball.positions), None);
    assert_eq!(ward.after("their vertices"), AT_REST);
    assert_eq!(ward.events("surface_usable"), told);
}

#[test]
fn vertices_that_are_no_numbers_never_reach_a_detector() {
    let mut ward = Ward::open();
    let (mut vertices, _) = ward.mesh();
    vertices[7].y = f64::NAN;
    let sick = ward.sick;
    let refused = ward.session.apply(|out| out.put(sick, VertexPositions { positions: Arc::new(vertices) }));
    assert!(refused.is_err_and(|error| error.to_string().contains("vertex_positions")));
    assert_eq!(ward.after("the write was refused"), AT_REST);
}

#[test]
fn degenerate_non_manifold_inverted_and_empty_surfaces_are_answered() {
    let mut ward = Ward::open();
    let (vertices, triangles) = ward.mesh();

    // Degenerate triangles among the others, also on a single point.
    let mut some = triangles.clone();
    some.extend(triangles.iter().take(40).map(|[a, b, _]| [*a, *b, *b]));
    some.push([3, 3, 3]);
    ward.put(None, Some(some));
    assert_eq!(ward.after("triangles without area"), AT_REST);

    // Non-manifold: every edge of a part of it has four triangles.
    let mut twice = triangles.clone();
    twice.extend_from_slice(&triangles[..triangles.len() / 2]);
    ward.put(None, Some(twice));
    let non_manifold = ward.after("edges of four triangles");
    assert!(non_manifold.contains(&Detection::Proximity) && non_manifold.contains(&Detection::DynamicPoint));

    // Inverted orientation: surfaces still touch, whichever side counts as inside.
    ward.put(None, Some(triangles.iter().map(|[a, b, c]| [*a, *c, *b]).collect()));
    let inverted = ward.after("inside out");
    for method in [Detection::ObbTree, Detection::Proximity, Detection::DynamicPoint] {
        assert!(inverted.contains(&method), "{inverted:?}");
    }

    // All vertices in one place; then no vertices.
    ward.put(Some(vec![Point3::new(0.0, 0.0, 0.5); vertices.len()]), None);
    // Triangles without a common vertex that meet in one place are in contact.
    assert_eq!(ward.after("one point"), [Detection::ObbTree]);
    ward.put(None, Some(Vec::new()));
    assert_eq!(ward.after("no triangles"), []);
    ward.put(Some(Vec::new()), None);
    assert_eq!(ward.after("no vertices"), []);
    // Finite but absurdly large: its contacts would hide the others.
    ward.put(Some(vertices.iter().map(|vertex| vertex * 1e150).collect()), Some(triangles.clone()));
    assert_eq!(ward.after("huge"), []);
    ward.put(Some(vertices), Some(triangles));
    assert_eq!(ward.after("as it was"), AT_REST);
}

#[test]
fn a_body_that_is_gone_is_waited_for_and_another_of_its_name_takes_its_place() {
    let mut ward = Ward::open();
    let sick = ward.sick;
    let mesh = ward.session.snapshot().get::<SurfaceMesh>(sick).expect("a mesh").clone();
    let vertices = ward.session.snapshot().get::<VertexPositions>(sick).expect("a mesh").clone();
    ward.session
        .apply(|out| {
            out.remove::<SurfaceMesh>(sick);
            out.remove::<Name>(sick);
        })
        .expect("removed");
    assert_eq!(ward.after("gone"), []);
    // A new entity of the same name replaces it, and is despawned again.
    let mut born = None;
    let put = |out: &mut Commands, born: &mut Option<Entity>| {
        let entity = out.spawn();
        out.put(entity, Name("sick.organ".into()));
        out.put(entity, Pose::at(0.0, 0.0, 0.0));
        out.put(entity, mesh.clone());
        out.put(entity, vertices.clone());
        *born = Some(entity);
    };
    ward.session.apply(|out| put(out, &mut born)).expect("born");
    let born = born.expect("an entity");
    ward.sick = born;
    assert_eq!(ward.after("born"), AT_REST);
    ward.session.apply(|out| out.despawn(born)).expect("despawned");
    assert_eq!(ward.after("despawned"), []);
}

#[test]
fn a_later_life_waits_for_a_body_that_is_gone() {
    // A killed first detector restarts those below it in the tree.
    let mut ward = Ward::with(FaultPlan::new(1).at(secs(0.05)).kill("trees"));
    let (vertices, triangles) = ward.mesh();
    let sick = ward.sick;
    ward.session.apply(|out| out.remove::<SurfaceMesh>(sick)).expect("removed");
    ward.session.step(SimTime::from_millis(100));
    ward.restarts = 1;
    assert_eq!(ward.after("gone when they began"), []);
    ward.put(Some(vertices), Some(triangles));
    assert_eq!(ward.after("back"), AT_REST);
}
