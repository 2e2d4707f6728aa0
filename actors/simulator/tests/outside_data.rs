//! Invalid data from other actors is rejected with a reason that names it, by every soft-body controller, and never
//! stops one: meshes with missing vertices, and saved states of another body.

use std::sync::Arc;

use crate::support::stage::{Stage, scene};
use nalgebra::{Point3, Vector3};
use trocar_dynamics::picking::{HeldVertex, Pick, Picks};
use trocar_dynamics::soft_body::contact::{ContactSums, Feature, PersistentContact, SoftContacts};
use trocar_dynamics::soft_body::grasp::Grips;
use trocar_dynamics::tet_mesh::NodeOrigin;
use trocar_scene::{
    BuildContext, Component, Controller, ControllerError, Entity, Frozen, HeatFrozen, LineMesh, SimTime,
    SurfaceMesh, TetMesh,
};
use trocar_simulator::controller::{
    CoagulatedElement, CoagulatedElements, DynamicFemController, ElectrosurgeryController,
    LinearFemController, MassSpringController, RemovedElements, ThreadController, VolumeCuts, XpbdController,
    XpbdGroups,
};

const GRAVITY: Vector3<f64> = Vector3::new(0.0, 0.0, -9.81);

fn springs(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(GRAVITY, context)
}

fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(GRAVITY, context)
}

fn fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(GRAVITY, context)
}

const BLOCK: &str = "block = { size = [0.02, 0.02, 0.02], cells = [2, 2, 2] }";
const SHEET: &str = "sheet = { size = [0.04, 0.04], cells = [4, 4] }";
const LINE: &str = "line = { length = 0.1, segments = 10, radius = 0.0005 }";
const OF_SPRINGS: &str = "mass_spring = { springs = { volume = { young_modulus = 2e4, density = 1000.0 } } }";
const OF_CLOTH: &str = "xpbd = { matter = { cloth = { membrane_stiffness = 60.0, bending_stiffness = 1e-6, \
                        density = 0.5 } }, cut = true }";

fn body(mesh: &str, kind: &str) -> String {
    format!("[[entity]]\nname = \"body\"\nmesh = {{ {mesh} }}\n{kind}\n")
}

/// With invalid data in the scene, a first start fails with the name of the body, and a restart freezes that body.
fn refused<C: Controller, T: Component>(
    text: &str,
    build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError>,
    written: T,
    says: &[&str],
) {
    let mut stage = Stage::new(scene(text), 1000.0, &build);
    stage.tick();
    stage.put("body", written);
    let context = BuildContext {
        scene: stage.store.view(),
        time: SimTime::ZERO,
        period: SimTime::from_millis(1),
        name: "controller",
        me: Entity::of_writer(0, 7),
        epoch: 1,
        seed: 1,
    };
    let error = build(&context).err().expect("it cannot be").to_string();
    for part in ["'body'"].iter().chain(says) {
        assert!(error.contains(part), "{}: '{part}' is missing in '{error}'", T::NAME);
    }
    stage.rebuild(&build);
    stage.tick();
    assert!(stage.has::<Frozen>("body") || stage.has::<HeatFrozen>("body"), "{}", T::NAME);
}

fn tets() -> TetMesh {
    TetMesh { tets: Arc::new(vec![[0, 1, 2, 3], [0, 1, 2, 4_000_000_000]]) }
}

fn triangles() -> SurfaceMesh {
    SurfaceMesh { triangles: Arc::new(vec![[0, 1, 2], [2, 1, 99]]) }
}

fn segments() -> LineMesh {
    LineMesh { segments: Arc::new(vec![[0, 1], [1, 11]]), radius: 0.0005 }
}

#[test]
fn elements_that_name_vertices_that_there_are_not_are_refused_by_every_controller() {
    let of_elements = |kind: &str| format!("({kind}) that name others: 1");
    let (tet, triangle, segment) =
        (of_elements("tetrahedron"), of_elements("triangle"), of_elements("segment"));
    let (tet, triangle, segment) = ([tet.as_str()], [triangle.as_str()], [segment.as_str()]);
    let line_of_springs = "mass_spring = { springs = { line = { axial_stiffness = 100.0, bending_stiffness = 1e-6, \
                           density = 0.01 } } }";
    let rod =
        "xpbd = { matter = { rod = { axial_stiffness = 100.0, bending_stiffness = 1e-6, density = 0.01 } } }";
    refused(&body(LINE, line_of_springs), springs, segments(), &segment);
    refused(&body(SHEET, "mass_spring = {}"), springs, triangles(), &triangle);
    refused(&body(BLOCK, OF_SPRINGS), springs, tets(), &tet);
    refused(&body(BLOCK, OF_SPRINGS), springs, triangles(), &triangle);
    refused(&body(LINE, rod), xpbd, segments(), &segment);
    refused(&body(SHEET, OF_CLOTH), xpbd, triangles(), &triangle);
    refused(&body(BLOCK, "xpbd = {}"), xpbd, tets(), &tet);
    refused(&body(BLOCK, "xpbd = {}"), xpbd, triangles(), &triangle);
    refused(&body(BLOCK, "dynamic_fem = {}"), fem, tets(), &tet);
    refused(&body(BLOCK, "dynamic_fem = {}"), fem, triangles(), &triangle);
    refused(
        &body(LINE, "thread = {}"),
        |context| ThreadController::new(GRAVITY, None, context),
        segments(),
        &segment,
    );
    let held = "linear_fem = {}\nanchors = { regions = [{ box = { min = [-1.0, -1.0, 0.0099], \
                max = [1.0, 1.0, 1.0] } }] }";
    refused(
        &body(BLOCK, held),
        |context| LinearFemController::new(Vector3::zeros(), None, context),
        tets(),
        &tet,
    );
    let cauterised = "cauterised = {}";
    let burns = |context: &BuildContext<'_>| ElectrosurgeryController::new(context);
    refused(&body(BLOCK, cauterised), burns, tets(), &tet);
}

#[test]
fn memories_of_another_body_are_refused() {
    let volume = body(BLOCK, "xpbd = { cut = true }");
    let births = |of: u32| VolumeCuts {
        births: Arc::new(vec![NodeOrigin { of: [of, 0], share: 0.5 }]),
        ..VolumeCuts::default()
    };
    refused(&volume, xpbd, births(26), &["node 26", "[26, 0]"]);
    refused(&volume, xpbd, births(9_999), &["node 26", "9999"]);
    let parts = |parts_of: Vec<u32>| VolumeCuts { parts_of: Arc::new(parts_of), ..VolumeCuts::default() };
    refused(&volume, xpbd, parts(vec![0; 9_999]), &["9999 parts of 48"]);
    refused(&volume, xpbd, parts(vec![47]), &["element 47", "0 to 46"]);
    let opened = VolumeCuts { opened: Arc::new(vec![(48, 0)]), ..VolumeCuts::default() };
    refused(&volume, xpbd, opened, &["48"]);
    let groups = |tets: Vec<u16>| XpbdGroups { tets: Arc::new(tets), ..XpbdGroups::default() };
    refused(&volume, xpbd, groups(vec![0; 48]), &["tetrahedrons in a group"]);
    refused(&volume, xpbd, groups(vec![0; 3]), &["3 groups for 48"]);
    refused(&volume, xpbd, groups((0..48).map(|k| 60_000 + k).collect()), &["beyond the last"]);
    for (vertex, triangle, says) in [(9_999, 0, "vertex 9999"), (0, 9_999, "9999")] {
        let held = HeldVertex { vertex, in_instrument: Point3::origin() };
        let pick = Pick { instrument: 7, triangles: vec![triangle], vertices: vec![held] };
        let grips = Grips { picks: Picks { picks: vec![pick], ..Picks::default() } };
        refused(&volume, xpbd, grips.clone(), &["grips", says]);
        refused(&body(SHEET, "mass_spring = {}"), springs, grips, &["grips", says]);
    }
}

/// External changes of missing elements are ignored; the rest applies.
#[test]
fn news_of_elements_that_there_are_not_change_nothing() {
    fn goes_on<C: Controller>(
        text: &str,
        build: impl Fn(&BuildContext<'_>) -> Result<C, ControllerError> + Copy,
        written: impl Component,
    ) {
        let mut stage = Stage::new(scene(text), 1000.0, build);
        stage.tick();
        stage.put("body", written);
        (0..3).for_each(|_| stage.tick());
        stage.rebuild(build);
        (0..3).for_each(|_| stage.tick());
        assert!(!stage.has::<Frozen>("body"), "{}", stage.get::<Frozen>("body").reason);
    }
    let coagulated = || {
        let of = |element| CoagulatedElement { element, stiffness: 2.0, length: 0.95 };
        CoagulatedElements { elements: Arc::new(vec![of(3), of(9_999), of(u32::MAX)]) }
    };
    let removed = || RemovedElements { elements: Arc::new(vec![5, 9_999, u32::MAX]) };
    let contacts = || {
        let held = |spots| PersistentContact {
            writer: Entity::new(0, 0, 9),
            other: Entity::new(0, 0, 8),
            spots,
            normal_in_world: Vector3::z(),
            seen: SimTime::ZERO,
            presses: true,
            is_in: true,
            slack: 0.0,
            drawn: Vector3::zeros(),
        };
        let spots = [
            [Feature::Vertex(9_999), Feature::Triangle(9_999)],
            [Feature::Triangle(0), Feature::Vertex(9_999)],
            [Feature::Between([0, 1, 9_999], [1.0, 0.0, 0.0]), Feature::InFrame(Point3::origin())],
        ];
        let sums = ContactSums { body: None, vertices: vec![3, 2, 1], sums: vec![Vector3::x()] };
        SoftContacts { contacts: spots.map(held).to_vec(), given: vec![sums], ..SoftContacts::default() }
    };
    for kind in ["xpbd = { cut = true }\ncauterised = {}", "dynamic_fem = {}\ncauterised = {}"] {
        let text = body(BLOCK, kind);
        if kind.starts_with("xpbd") {
            goes_on(&text, xpbd, coagulated());
            goes_on(&text, xpbd, removed());
            goes_on(&text, xpbd, contacts());
        } else {
            goes_on(&text, fem, coagulated());
            goes_on(&text, fem, removed());
        }
    }
    let text = body(BLOCK, &format!("{OF_SPRINGS}\ncauterised = {{}}"));
    goes_on(&text, springs, coagulated());
    goes_on(&text, springs, removed());
    goes_on(&text, springs, contacts());
    let text = body(SHEET, &format!("{OF_CLOTH}\ncauterised = {{ thickness = 0.001 }}"));
    goes_on(&text, xpbd, coagulated());
    goes_on(&text, xpbd, removed());
    goes_on(&text, xpbd, contacts());
}
