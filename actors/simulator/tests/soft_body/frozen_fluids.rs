//! Invalid data of vessels, patients, smoke and liquids freezes only that one, with a reason; the others continue, and
//! a restart keeps it frozen.

use std::sync::Arc;

use crate::support::freezing::{Build, GRAVITY, positions, two};
use crate::support::stage::{Stage, scene};
use nalgebra::{Point3, Vector3};
use trocar_scene::{Activation, BuildContext, ControllerError, Frozen, OutOfValidity, VertexPositions};
use trocar_simulator::controller::{
    BleedingController, FluidController, LiquidState, Plume, SmokeController, VesselState,
    VitalSignsController,
};

fn fluid(context: &BuildContext<'_>) -> Result<FluidController, ControllerError> {
    FluidController::new(GRAVITY, context)
}
fn smoke(context: &BuildContext<'_>) -> Result<SmokeController, ControllerError> {
    SmokeController::new(GRAVITY, context)
}

#[test]
fn a_vessel_that_leaves_the_world_stops_bleeding_alone_and_the_patient_goes_on() {
    let build: Build<_> = BleedingController::new;
    let line = "line = { length = 0.03, segments = 6, radius = 0.001 }";
    let mut stage = Stage::new(scene(&two(line, "vessel = { injury = 0.5 }")), 100.0, build);
    (0..3).for_each(|_| stage.tick());
    let lost = stage.measured("bad.lost_m3");
    assert!(lost > 0.0);
    let mut vertices = positions(&stage, "bad");
    vertices[3].y = 1e300;
    stage.put("bad", VertexPositions { positions: Arc::new(vertices) });
    for _ in 0..2 {
        let before = stage.get::<VesselState>("good").bleeding.lost;
        (0..3).for_each(|_| stage.tick());
        assert!(stage.get::<Frozen>("bad").reason.contains("vertex 3"));
        let bad = stage.get::<VesselState>("bad");
        assert_eq!((bad.bleeding.lost, bad.rate), (lost, 0.0));
        assert!(bad.place.iter().all(|x| x.abs() < 1.0), "{}", bad.place);
        assert!(stage.get::<VesselState>("good").bleeding.lost > before);
        assert!(!stage.has::<Frozen>("good"));
        stage.rebuild(build);
    }
}

#[test]
fn a_patient_who_lost_what_nobody_has_stands_still_and_does_not_take_the_controller_along() {
    let vessel = "[[entity]]\nname = \"artery\"\nmesh = { line = { length = 0.03, segments = 6, radius = 0.001 } }\n\
                  vessel = { injury = 0.5 }\n[[entity]]\nname = \"patient\"\npatient = {}\n";
    let mut bleeding = Stage::new(scene(vessel), 100.0, BleedingController::new);
    bleeding.tick();
    let mut state = bleeding.get::<VesselState>("artery");
    let build: Build<_> = VitalSignsController::new;
    let mut stage = Stage::new(scene(vessel), 100.0, build);
    stage.put("artery", state.clone());
    stage.tick();
    assert!(!stage.has::<Frozen>("patient"));
    let pressure = stage.measured("patient.arterial_pressure_pa");
    state.bleeding.lost = 1e300;
    stage.put("artery", state);
    for _ in 0..2 {
        (0..3).for_each(|_| stage.tick());
        assert!(stage.get::<Frozen>("patient").reason.contains("'artery'"));
        assert_eq!(stage.measured("patient.arterial_pressure_pa"), pressure);
        stage.rebuild(build);
    }
}

#[test]
fn smoke_of_more_than_there_is_stands_still_and_names_who_gave_it_off() {
    let text = "[[entity]]\nname = \"cloud\"\nsmoke = {}\n[[entity]]\nname = \"fold\"\n";
    let mut stage = Stage::new(scene(text), 50.0, smoke as Build<_>);
    stage.put("fold", Plume { emitted: 1e-8, place: Point3::origin() });
    (0..3).for_each(|_| stage.tick());
    let puffs = stage.measured("cloud.puffs");
    assert!(puffs > 0.0 && !stage.has::<Frozen>("cloud"));
    stage.put("fold", Plume { emitted: 1e300, place: Point3::origin() });
    for _ in 0..2 {
        (0..3).for_each(|_| stage.tick());
        assert!(stage.get::<Frozen>("cloud").reason.contains("'fold'"));
        assert_eq!(stage.measured("cloud.puffs"), puffs);
        stage.rebuild(smoke);
    }
}

#[test]
fn liquid_that_is_too_fast_stands_still_as_it_was_and_nothing_more_comes() {
    let text = "[[entity]]\nname = \"blood\"\nliquid = { spacing = 0.002 }\n\
                [[entity]]\nname = \"tube\"\npose = {}\nirrigator = { rate = 1e-5, area = 2e-5 }\n";
    let mut stage = Stage::new(scene(text), 100.0, fluid as Build<_>);
    stage.put("tube", Activation { level: 1.0, ..Activation::default() });
    (0..10).for_each(|_| stage.tick());
    assert!(stage.measured("blood.particles") > 5.0);
    let mut state = stage.get::<LiquidState>("blood");
    let mut liquid = (*state.fluid).clone();
    liquid.velocities.iter_mut().for_each(|velocity| *velocity = Vector3::new(1e200, -1e200, 1e200));
    state.fluid = Arc::new(liquid);
    stage.put("blood", state.clone());
    stage.rebuild(fluid);
    for _ in 0..2 {
        (0..3).for_each(|_| stage.tick());
        let reason = stage.get::<Frozen>("blood").reason;
        assert!(reason.contains("position that is not finite"), "{reason}");
        assert_eq!(stage.measured("blood.frozen"), 1.0);
        let now = stage.get::<LiquidState>("blood");
        assert_eq!((&now.fluid, &now.spouts), (&state.fluid, &state.spouts), "its last good state");
        assert_eq!(stage.measured("blood.particles"), state.fluid.numbers.len() as f64);
        stage.rebuild(fluid);
    }
}

#[test]
fn a_wall_that_leaves_the_world_is_taken_where_it_was_and_the_liquid_goes_on() {
    let text = "[[entity]]\nname = \"blood\"\nliquid = { spacing = 0.002 }\n\
                [[entity]]\nname = \"floor\"\nmesh = { sheet = { size = [0.02, 0.02], cells = [2, 2] } }\nliquid_wall = {}\n";
    let mut stage = Stage::new(scene(text), 100.0, fluid as Build<_>);
    stage.tick();
    assert_eq!((stage.measured("blood.held_walls"), stage.has::<OutOfValidity>("blood")), (0.0, false));
    let sound = positions(&stage, "floor");
    let mut vertices = sound.clone();
    vertices[1].z = 1e300;
    stage.put("floor", VertexPositions { positions: Arc::new(vertices) });
    for _ in 0..2 {
        stage.tick();
        assert_eq!((stage.measured("blood.held_walls"), stage.measured("blood.frozen")), (1.0, 0.0));
        assert!(stage.get::<OutOfValidity>("blood").reason.contains("'floor'"));
        stage.rebuild(fluid);
    }
    stage.put("floor", VertexPositions { positions: Arc::new(sound) });
    stage.tick();
    assert_eq!(stage.measured("blood.held_walls"), 0.0);
}
