//! Invalid data freezes only the body concerned, at its last valid state and with a reason; the others continue, and a
//! restart keeps it frozen.

use std::sync::Arc;

use crate::support::freezing::{Build, GRAVITY, positions, two};
use crate::support::stage::{Stage, context, scene};
use nalgebra::{Point3, Vector3};
use trocar_dynamics::picking::{HeldVertex, Pick, Picks};
use trocar_dynamics::rigid_bodies::RigidBodiesController;
use trocar_dynamics::soft_body::grasp::Grips;
use trocar_scene::{
    Activation, BuildContext, Burn, Controller, ControllerError, Frozen, HeatFrozen, Pose, RestPositions,
    SimTime, Store, SurfaceMesh, Temperature, Velocity, VertexPositions, VertexVelocities,
};
use trocar_simulator::controller::{
    DynamicFemController, ElectrosurgeryController, HeatState, LinearFemController, MassSpringController,
    SutureController, SutureMemory, ThreadController, XpbdController,
};
use trocar_simulator::electrosurgery::ElectrosurgeryState;
use trocar_simulator::impulse_world::{ImpulseWorld, RigidSettings};

/// Checks that 'bad' is frozen, with a reason, while 'good' moves; before and after a restart.
fn stands_still<C: Controller>(stage: &mut Stage<C>, build: Build<C>, says: &str) {
    let frozen = stage.get::<Frozen>("bad");
    assert!(frozen.reason.contains(says), "'{says}' is missing in '{}'", frozen.reason);
    let at = positions(stage, "bad");
    for _ in 0..2 {
        let before = positions(stage, "good");
        (0..3).for_each(|_| stage.tick());
        assert_eq!(positions(stage, "bad"), at);
        assert_ne!(positions(stage, "good"), before, "the other goes on");
        assert!(!stage.has::<Frozen>("good"));
        assert_eq!(stage.measured("bad.frozen"), 1.0);
        assert_eq!(stage.measured("good.frozen"), 0.0);
        stage.rebuild(build);
    }
    assert_eq!(stage.get::<Frozen>("bad"), frozen, "the first reason stays");
}

/// A velocity beyond the limit is written for the first vertex, and a restart reads it.
fn too_fast<C: Controller>(text: &str, hz: f64, build: Build<C>, says: &str) {
    let mut stage = Stage::new(scene(text), hz, build);
    (0..3).for_each(|_| stage.tick());
    assert!(!stage.has::<Frozen>("bad"), "{}", stage.get::<Frozen>("bad").reason);
    let mut velocities = stage.get::<VertexVelocities>("bad").velocities.to_vec();
    velocities[0] = Vector3::new(1e200, -1e200, 1e200);
    stage.put("bad", VertexVelocities { velocities: Arc::new(velocities) });
    let good = positions(&stage, "bad");
    stage.rebuild(build);
    stage.tick();
    assert_eq!(positions(&stage, "bad"), good, "its last good state");
    stands_still(&mut stage, build, says);
}

/// The first elements of 'bad' have no volume: rejected on a first start, frozen on a restart.
fn collapse<C: Controller>(stage: &mut Stage<C>, build: Build<C>) {
    let mut rest = positions(stage, "bad");
    let first = rest[0];
    rest.iter_mut().take(8).for_each(|at| *at = first);
    stage.put("bad", RestPositions { positions: Arc::new(rest) });
    let context = context(&stage.store, SimTime::ZERO, 1);
    let refused = build(&context).err().expect("a mistake of whoever wrote it").to_string();
    assert!(refused.contains("'bad'"), "{refused}");
    stage.rebuild(build);
    stage.tick();
}

const BLOCK: &str = "block = { size = [0.02, 0.02, 0.02], cells = [2, 2, 2] }";

fn dynamic_fem(context: &BuildContext<'_>) -> Result<DynamicFemController, ControllerError> {
    DynamicFemController::new(GRAVITY, context)
}
fn xpbd(context: &BuildContext<'_>) -> Result<XpbdController, ControllerError> {
    XpbdController::new(GRAVITY, context)
}
fn mass_spring(context: &BuildContext<'_>) -> Result<MassSpringController, ControllerError> {
    MassSpringController::new(GRAVITY, context)
}
fn thread(context: &BuildContext<'_>) -> Result<ThreadController, ControllerError> {
    ThreadController::new(GRAVITY, None, context)
}

const XPBD: &str =
    "xpbd = { matter = { volume = { young_modulus = 5000.0, poisson_ratio = 0.3, density = 1060.0 } } }";

#[test]
fn a_soft_body_that_is_too_fast_stops_alone() {
    too_fast(
        &two(BLOCK, "dynamic_fem = {}"),
        100.0,
        dynamic_fem,
        "node 0 to a position that is not a finite number",
    );
    too_fast(&two(BLOCK, XPBD), 200.0, xpbd, "node");
    let cloth = "sheet = { size = [0.02, 0.02], cells = [4, 4] }";
    too_fast(&two(cloth, "mass_spring = { method = \"implicit\" }"), 200.0, mass_spring, "node");
    too_fast(
        &two(cloth, "mass_spring = { method = \"explicit\", lag = 1e-5 }"),
        200.0,
        mass_spring,
        "node 0",
    );
}

/// Two cloths that fall onto the tip of a rod each; 'bad' is so stiff in contact that a step of 2 ms would be unstable
/// and needs more substeps than allowed.
#[test]
fn explicit_springs_for_which_a_step_has_become_too_large_stop_alone_in_that_step() {
    let cloth = |name: &str, x: f64, stiffness: f64| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [{x}, 0.0, 0.0] }}\n\
             mesh = {{ sheet = {{ size = [0.02, 0.02], cells = [4, 4] }} }}\n\
             mass_spring = {{ method = \"explicit\", lag = 1e-5, contact_stiffness = {stiffness:e} }}\n\
             [[entity]]\nname = \"rod.{name}\"\npose = {{ translation = [{x}, 0.0, -0.004] }}\n\
             instrument = {{ kind = \"probe\", shaft_length = 0.1, shaft_radius = 0.003, jaw_length = 0.004, jaws = 0 }}\n"
        )
    };
    let text = cloth("good", 0.0, 200.0) + &cloth("bad", 0.1, 1e6);
    let mut stage = Stage::new(scene(&text), 500.0, mass_spring as Build<_>);
    let mut before = positions(&stage, "bad");
    for tick in 0.. {
        stage.tick();
        if stage.has::<Frozen>("bad") {
            break;
        }
        assert!(tick < 100, "it has fallen onto the rod by then");
        before = positions(&stage, "bad");
    }
    assert!(before.iter().all(|at| at.z < -1e-5), "it fell until then");
    assert_eq!(positions(&stage, "bad"), before, "its last good state");
    assert_eq!(stage.get::<Frozen>("bad").since, stage.now());
    stands_still(&mut stage, mass_spring, "at most 200 are taken");
    let mut pressed = 0.0_f64;
    for _ in 0..50 {
        stage.tick();
        pressed = pressed.max(stage.measured("good.contact_force_n"));
    }
    assert!(pressed > 0.0 && !stage.has::<Frozen>("good"), "the other falls onto its rod");
}

/// A sheet whose largest safe step is known: 200 of them are the longest step that it takes.
#[test]
fn explicit_springs_that_no_step_can_take_are_refused_at_the_start_by_name() {
    let gauze = |more: &str| {
        format!(
            "[[entity]]\nname = \"gauze\"\nmesh = {{ sheet = {{ size = [0.02, 0.012], cells = [20, 12] }} }}\n\
             mass_spring = {{ {more} }}\n"
        )
    };
    let build = |store: &Store, period: f64, epoch: u32| {
        let period = SimTime::from_secs_f64(period);
        mass_spring(&BuildContext { period, ..context(store, SimTime::ZERO, epoch) })
    };
    let mut stage = Stage::new(scene(&gauze("lag = 1e-5")), 10_000.0, mass_spring as Build<_>);
    stage.tick();
    let safe = stage.measured("gauze.safe_step_s");
    let store = scene(&gauze("lag = 1e-5"));
    assert!(build(&store, 199.9 * safe, 1).is_ok());
    let told = build(&store, 200.1 * safe, 1).err().expect("201 parts").to_string();
    for part in
        ["'gauze': a step of", "takes 201 parts of", "at most 200", "method = \"implicit\"", "'lag'", "cells"]
    {
        assert!(told.contains(part), "'{part}' is not in: {told}");
    }
    assert!(build(&scene(&gauze("method = \"implicit\"")), 200.1 * safe, 1).is_ok());
    // In a session that runs, springs that have become too stiff are frozen.
    assert!(build(&store, 200.1 * safe, 2).is_ok());
}

#[test]
fn a_soft_body_whose_elements_have_lost_their_volume_is_refused_at_the_start_and_frozen_later() {
    let mut stage = Stage::new(scene(&two(BLOCK, "dynamic_fem = {}")), 100.0, dynamic_fem as Build<_>);
    (0..3).for_each(|_| stage.tick());
    collapse(&mut stage, dynamic_fem);
    stands_still(&mut stage, dynamic_fem, "defects");
    let mut stage = Stage::new(scene(&two(BLOCK, XPBD)), 200.0, xpbd as Build<_>);
    (0..3).for_each(|_| stage.tick());
    collapse(&mut stage, xpbd);
    stands_still(&mut stage, xpbd, "tetrahedron");
}

#[test]
fn a_linear_organ_whose_elements_have_lost_their_volume_is_frozen_and_the_other_answers() {
    fn build(context: &BuildContext<'_>) -> Result<LinearFemController, ControllerError> {
        LinearFemController::new(Vector3::zeros(), None, context)
    }
    let held = "linear_fem = {}\n\
                anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] } }] }";
    let mut stage = Stage::new(scene(&two(BLOCK, held)), 60.0, build as Build<_>);
    (0..3).for_each(|_| stage.tick());
    collapse(&mut stage, build);
    for _ in 0..2 {
        (0..3).for_each(|_| stage.tick());
        let frozen = stage.get::<Frozen>("bad");
        assert!(frozen.reason.contains("defects") && frozen.reason.contains("'bad'"), "{}", frozen.reason);
        assert!(!stage.has::<Frozen>("good"));
        let told = (stage.measured("bad.frozen"), stage.measured("good.precomputed_share"));
        assert_eq!(told, (1.0, 1.0), "the other is there");
        stage.rebuild(build);
    }
}

/// A grasper that holds 'bad' jumps to a position at which forces overflow, as after a tracker failure.
#[test]
fn a_linear_organ_of_which_a_step_makes_no_number_is_frozen_in_that_step_and_the_other_answers() {
    fn build(context: &BuildContext<'_>) -> Result<LinearFemController, ControllerError> {
        LinearFemController::new(Vector3::zeros(), None, context)
    }
    let organ = |name: &str, x: f64| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [{x}, 0.0, 0.0] }}\nmesh = {{ {BLOCK} }}\nlinear_fem = {{}}\n\
             anchors = {{ regions = [{{ box = {{ min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0099] }} }}] }}\n"
        )
    };
    let tool = |name: &str, kind: &str, x: f64| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [{x}, 0.0, 0.03], rotation = [1.0, 0.0, 0.0, 0.0] }}\n\
             instrument = {{ kind = \"{kind}\", shaft_length = 0.1, shaft_radius = 0.003, jaw_length = 0.01 }}\n"
        )
    };
    let text = organ("good", 0.1)
        + &organ("bad", 0.0)
        + &tool("probe", "probe", 0.1)
        + &tool("grasper", "grasper", 0.0);
    let mut stage = Stage::new(scene(&text), 60.0, build as Build<_>);
    // It holds the upper face of 'bad', a centimetre and more away: the grasp is rigid.
    let (top, at) = (positions(&stage, "bad"), stage.get::<Pose>("grasper"));
    let instrument_from_world = at.isometry().inverse();
    let is_up = |vertex: u32| top[vertex as usize].z > 0.0099;
    let triangles: Vec<u32> = (0..)
        .zip(stage.get::<SurfaceMesh>("bad").triangles.iter())
        .filter(|(_, corners)| corners.iter().all(|corner| is_up(*corner)))
        .map(|(triangle, _)| triangle)
        .collect();
    let vertices = (0..top.len() as u32)
        .filter(|vertex| is_up(*vertex))
        .map(|vertex| HeldVertex { vertex, in_instrument: instrument_from_world * top[vertex as usize] })
        .collect();
    let instrument = stage.entity("grasper").to_bits();
    let picks = Picks { picks: vec![Pick { instrument, triangles, vertices }], shut: Vec::new() };
    stage.put("bad", Grips { picks });
    stage.rebuild(build);
    (0..3).for_each(|_| stage.tick());
    stage.put("grasper", Pose { translation: at.translation + Vector3::new(0.0, 0.0, 0.002), ..at });
    stage.tick();
    assert!(!stage.has::<Frozen>("bad"), "{}", stage.get::<Frozen>("bad").reason);
    assert!(stage.measured("bad.contact_force_n") > 0.01, "it is drawn by two millimetres");
    let good = positions(&stage, "bad");
    stage.put("grasper", Pose { translation: Vector3::new(0.0, 0.0, 1.7e308), ..at });
    stage.tick();
    let frozen = stage.get::<Frozen>("bad");
    assert!(frozen.reason.contains("finite"), "{}", frozen.reason);
    assert_eq!(
        (frozen.since, positions(&stage, "bad")),
        (stage.now(), good.clone()),
        "in that step, as it was"
    );
    for depth in [0.002, 0.0025] {
        let put = |stage: &mut Stage<LinearFemController>, z: f64| {
            let pose = Pose { translation: Vector3::new(0.1, 0.0, z), ..at };
            stage.put("probe", pose);
            (0..3).for_each(|_| stage.tick());
        };
        put(&mut stage, 0.010 - depth);
        assert!(stage.measured("good.contact_force_n") > 0.0, "the other answers");
        assert!(!stage.has::<Frozen>("good"));
        assert_eq!((stage.measured("bad.frozen"), stage.measured("good.frozen")), (1.0, 0.0));
        assert_eq!((stage.get::<Frozen>("bad"), positions(&stage, "bad")), (frozen.clone(), good.clone()));
        stage.rebuild(build);
        put(&mut stage, 0.03);
    }
}

#[test]
fn a_thread_that_is_too_fast_stops_alone() {
    let line = "line = { length = 0.02, segments = 10, radius = 0.00015 }";
    too_fast(&two(line, "thread = { suture = \"silk2_0\" }"), 500.0, thread, "a number is not finite");
}

#[test]
fn a_rigid_body_that_spins_too_fast_or_has_no_volume_stops_alone() {
    fn build(context: &BuildContext<'_>) -> Result<RigidBodiesController<ImpulseWorld>, ControllerError> {
        RigidBodiesController::new(context, RigidSettings { floor_height: None, ..RigidSettings::default() })
            .map_err(|error| ControllerError::Scene(error.to_string()))
    }
    let text = [("good", 0.0), ("bad", 0.1)].map(|(name, x)| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [{x}, 0.0, 0.0] }}\n\
             mesh = {{ block = {{ size = [0.02, 0.02, 0.02], cells = [1, 1, 1] }} }}\n\
             rigid_body = {{ motion = \"dynamic\", mass = 0.1 }}\nvelocity = {{}}\n"
        )
    });
    for no_volume in [false, true] {
        let mut stage = Stage::new(scene(&text.concat()), 250.0, build as Build<_>);
        (0..3).for_each(|_| stage.tick());
        assert!(!stage.has::<Frozen>("bad"), "{}", stage.get::<Frozen>("bad").reason);
        if no_volume {
            let flat = positions(&stage, "bad").iter().map(|at| Point3::new(at.x, at.y, 0.0)).collect();
            stage.put("bad", VertexPositions { positions: Arc::new(flat) });
        } else {
            stage.put(
                "bad",
                Velocity { linear: Vector3::zeros(), angular: Vector3::new(1e200, -1e200, 1e200) },
            );
        }
        let at = stage.get::<Pose>("bad");
        stage.rebuild(build);
        for _ in 0..2 {
            let before = stage.get::<Pose>("good");
            (0..3).for_each(|_| stage.tick());
            let frozen = stage.get::<Frozen>("bad").reason;
            assert!(frozen.contains(if no_volume { "volume" } else { "not finite" }), "{frozen}");
            assert_eq!(stage.get::<Pose>("bad"), at, "its last good state");
            assert_eq!(stage.get::<Velocity>("bad"), Velocity::default());
            assert!(stage.get::<Pose>("good").translation.z < before.translation.z, "the other falls on");
            assert!(!stage.has::<Frozen>("good"));
            stage.rebuild(build);
        }
    }
}

/// A needle over a pad.
const SEWN: &str = r#"
[[entity]]
name = "bad"
mesh = { block = { size = [0.024, 0.020, 0.012], cells = [4, 4, 2] } }
sewn = {}
anchors = { regions = [{ box = { min = [-1.0, -1.0, -1.0], max = [1.0, 1.0, -0.0059] } }] }
[[entity]]
name = "needle"
pose = { translation = [0.0, 0.0, 0.02] }
mesh = { line = { length = 0.03, segments = 3, radius = 0.0003 } }
needle = { thread_length = 0.03 }
"#;

fn suture(context: &BuildContext<'_>) -> Result<SutureController, ControllerError> {
    SutureController::new(GRAVITY, context)
}

/// Needle and tissue are frozen with a reason, and the controller keeps publishing it; before and after a restart.
fn sewing_stands_still(stage: &mut Stage<SutureController>, says: &str) {
    let at = ["needle", "bad"].map(|name| positions(stage, name));
    for _ in 0..2 {
        (0..3).for_each(|_| stage.tick());
        for (name, at) in ["needle", "bad"].iter().zip(&at) {
            let frozen = stage.get::<Frozen>(name);
            assert!(frozen.reason.contains(says), "'{says}' is missing in '{}'", frozen.reason);
            assert_eq!(&positions(stage, name), at);
        }
        assert_eq!(stage.measured("needle.frozen"), 1.0);
        stage.rebuild(suture);
    }
}

#[test]
fn a_needle_that_is_too_fast_stands_still_with_what_it_sews() {
    let mut stage = Stage::new(scene(SEWN), 500.0, suture as Build<_>);
    (0..3).for_each(|_| stage.tick());
    assert!(!stage.has::<Frozen>("needle"));
    let mut memory = stage.get::<SutureMemory>("needle");
    let state = memory.state.as_mut().expect("a state");
    state.needle.momentum = Vector3::new(1e200, -1e200, 1e200);
    stage.put("needle", memory);
    stage.rebuild(suture);
    stage.tick();
    sewing_stands_still(&mut stage, "no step from 0 s on");
}

#[test]
fn tissue_that_has_lost_its_volume_is_refused_at_the_start_and_frozen_with_its_needle_later() {
    let mut stage = Stage::new(scene(SEWN), 500.0, suture as Build<_>);
    (0..3).for_each(|_| stage.tick());
    collapse(&mut stage, suture);
    sewing_stands_still(&mut stage, "'bad'");
}

#[test]
fn heat_of_a_body_that_somebody_else_moves_stands_still_in_the_scene() {
    let build: Build<_> = ElectrosurgeryController::new;
    let mut stage = Stage::new(scene(&two(BLOCK, &format!("cauterised = {{}}\n{XPBD}"))), 100.0, build);
    stage.tick();
    assert!(!stage.has::<HeatFrozen>("bad"));
    collapse(&mut stage, build);
    for _ in 0..2 {
        (0..3).for_each(|_| stage.tick());
        assert!(!stage.has::<Frozen>("bad"), "whoever moves it says that");
        assert!(stage.get::<HeatFrozen>("bad").reason.contains("'bad'"));
        assert!(!stage.has::<HeatFrozen>("good"));
        assert_eq!((stage.measured("bad.heat_frozen"), stage.measured("good.heat_frozen")), (1.0, 0.0));
        stage.rebuild(build);
    }
    // A freeze known only from before a restart persists, although nothing is wrong with the body now.
    stage.put("good", HeatFrozen { reason: "a step too large".into(), since: stage.now() });
    stage.rebuild(build);
    stage.tick();
    assert_eq!(stage.measured("good.heat_frozen"), 1.0);
}

/// Two livers 10 cm apart, owned by another controller, with a hook in 'good' and some in 'bad'.
fn hooked(fine: &str, hooks: usize, power: f64, area: f64) -> Stage<ElectrosurgeryController> {
    let liver = |name: &str, x: f64, cauterised: &str| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [{x}, 0.0, 0.0] }}\nmesh = {{ {BLOCK} }}\n{XPBD}\n\
             cauterised = {{ {cauterised} }}\n"
        )
    };
    let hook = |name: &str, x: f64, power: f64, area: f64| {
        format!(
            "[[entity]]\nname = \"{name}\"\npose = {{ translation = [{x}, 0.0, 0.01] }}\n\
             instrument = {{ kind = \"hook_cautery\", shaft_length = 0.1, shaft_radius = 0.002, jaw_length = 0.004, jaws = 0 }}\n\
             electrode = {{ power = {power}, contact_area = {area} }}\n"
        )
    };
    let many: String = (0..hooks).map(|index| hook(&format!("hook.{index}"), 0.0, power, area)).collect();
    let good = liver("good", 0.1, "") + &hook("hook.good", 0.1, 10.0, 1e-6);
    let mut stage =
        Stage::new(scene(&(liver("bad", 0.0, fine) + &good + &many)), 100.0, ElectrosurgeryController::new);
    // A state is saved every tenth time.
    (0..10).for_each(|_| stage.tick());
    assert!(!stage.has::<HeatFrozen>("bad"), "{}", stage.get::<HeatFrozen>("bad").reason);
    let names = (0..hooks).map(|index| format!("hook.{index}")).chain(["hook.good".into()]);
    for name in names {
        stage.put(&name, Activation { level: 1.0, since: stage.now(), mode: None });
    }
    stage
}

/// On cells of 0.05 mm 400 W through a needle's point; more tips in one place than a step allows. (The scene itself
/// rejects a non-finite power, and invalid temperatures are detected when they are read.)
#[test]
fn heat_that_a_step_cannot_take_stops_alone_at_its_last_good_state_and_the_other_burns_on() {
    for (fine, hooks, power, area, says) in
        [("spacing = 5e-5", 1, 400.0, 1e-8, "parts for this power"), ("", 17, 1.0, 1e-6, "17 electrodes")]
    {
        let mut stage = hooked(fine, hooks, power, area);
        let before =
            (stage.get::<Temperature>("bad"), stage.get::<Burn>("bad"), stage.get::<HeatState>("bad").state);
        stage.tick();
        // In that very step, with a reason.
        let frozen = stage.get::<HeatFrozen>("bad");
        assert!(frozen.reason.contains(says), "'{says}' is missing in '{}'", frozen.reason);
        assert_eq!(frozen.since, stage.now());
        assert!(!stage.has::<Frozen>("bad"), "whoever moves it goes on");
        for _ in 0..2 {
            let supplied = stage.measured("good.heat_supplied_j");
            (0..20).for_each(|_| stage.tick());
            assert!(stage.measured("good.heat_supplied_j") > supplied, "the other burns on: {says}");
            assert!(stage.measured("good.heat_missing_share") < 0.01);
            assert!(!stage.has::<HeatFrozen>("good"), "{}", stage.get::<HeatFrozen>("good").reason);
            let told = (stage.measured("bad.heat_frozen"), stage.measured("good.heat_frozen"));
            assert_eq!(told, (1.0, 0.0));
            let now = (stage.get::<Temperature>("bad"), stage.get::<Burn>("bad"));
            assert_eq!(now, (before.0.clone(), before.1.clone()));
            assert_eq!(stage.get::<HeatFrozen>("bad"), frozen, "the first reason stays");
            stage.rebuild(ElectrosurgeryController::new);
        }
        assert_eq!(stage.get::<HeatState>("bad").state.ledger, before.2.ledger, "nothing was booked");
    }
}

/// Invalid numbers are written to the saved state of heat: every measure would become infinite, and the scene would
/// lose the controller's outputs.
#[test]
fn heat_that_no_tissue_has_is_refused_at_the_start_and_frozen_later_and_the_other_burns_on() {
    let build: Build<_> = ElectrosurgeryController::new;
    type Spoil = fn(&mut ElectrosurgeryState);
    let spoilt: [(Spoil, Option<&str>); 4] = [
        (|state| state.celsius[0] = 1e300, Some("celsius: value 0 is 1e300, -273.15 to 100000 is valid")),
        (
            |state| state.blocks[0].excess[5] = -1e300,
            Some("excess: value 5 is -1e300, -100000 to 100000 is valid"),
        ),
        (|state| state.ledger.steam = 1e300, Some("ledger: value 2 is 1e300")),
        // The control: too hot, but still a valid temperature.
        (|state| state.celsius[0] = 300.0, None),
    ];
    for (spoil, says) in spoilt {
        let mut stage = hooked("", 1, 10.0, 1e-6);
        (0..10).for_each(|_| stage.tick());
        let mut heat = stage.get::<HeatState>("bad");
        spoil(Arc::make_mut(&mut heat.state));
        stage.put("bad", heat.clone());
        let (celsius, burn) = (stage.get::<Temperature>("bad"), stage.get::<Burn>("bad"));
        let context = context(&stage.store, SimTime::ZERO, 1);
        let refused = build(&context).err().map(|error| error.to_string());
        let Some(says) = says else {
            assert_eq!(refused, None);
            continue;
        };
        let refused = refused.expect("a mistake of whoever wrote it");
        assert!(refused.contains("'bad'") && refused.contains(says), "'{says}' is missing in '{refused}'");
        stage.rebuild(build);
        stage.tick();
        let frozen = stage.get::<HeatFrozen>("bad");
        assert!(frozen.reason.contains("'bad'") && frozen.reason.contains(says), "{}", frozen.reason);
        for _ in 0..2 {
            let supplied = stage.measured("good.heat_supplied_j");
            (0..10).for_each(|_| stage.tick());
            assert!(stage.measured("good.heat_supplied_j") > supplied, "the other burns on: {says}");
            assert!(!stage.has::<HeatFrozen>("good") && !stage.has::<Frozen>("bad"));
            let told = (stage.measured("bad.heat_frozen"), stage.measured("good.heat_frozen"));
            assert_eq!(told, (1.0, 0.0));
            assert_eq!(
                (stage.get::<Temperature>("bad"), stage.get::<Burn>("bad")),
                (celsius.clone(), burn.clone())
            );
            assert_eq!(stage.get::<HeatState>("bad").state, heat.state);
            assert_eq!(stage.get::<HeatFrozen>("bad"), frozen, "the first reason stays");
            stage.rebuild(build);
        }
    }
}
