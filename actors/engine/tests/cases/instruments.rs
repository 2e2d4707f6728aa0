//! Every kind of instrument touches with its own end, where that is: what a straight shaft would miss is caught, carried and
//! pushed by the bend, the hook or the prongs that are there; and jaws take hold, of whatever kind they are.

use nalgebra::{Isometry3, Point3, Vector3};
use trocar_dynamics::instrument::state::InstrumentState;
use trocar_dynamics::rigid_world::World;
use trocar_scene::components::{Instrument, InstrumentKind, Motion, Pose, RigidBody, Shape, Velocity};
use trocar_scene::entity::Entity;
use trocar_scene::shapes::working_end;

use super::W;
use super::common::*;

const BALL: Entity = Entity::new(0, 0, 60);
const RADIUS: f64 = 0.003;

fn built(kind: InstrumentKind) -> Instrument {
    Instrument {
        kind,
        jaw_length: 0.03,
        jaw_width: 0.004,
        jaw_thickness: 0.002,
        jaws: if kind.has_jaws() { 2 } else { 0 },
        ..Instrument::default()
    }
}

/// All kinds that the framework knows by name.
const KINDS: [InstrumentKind; 11] = [
    InstrumentKind::Grasper,
    InstrumentKind::BluntDissector,
    InstrumentKind::SutureGrasper,
    InstrumentKind::NeedleDriver,
    InstrumentKind::Scissors,
    InstrumentKind::HookCautery,
    InstrumentKind::LoopApplier,
    InstrumentKind::KnotPusher,
    InstrumentKind::Retractor,
    InstrumentKind::BandPasser,
    InstrumentKind::Probe,
];

/// A level instrument: its +z is x in world, its +y is up.
fn level(tip: [f64; 3]) -> Isometry3<f64> {
    let turned = nalgebra::UnitQuaternion::from_basis_unchecked(&[Vector3::y(), Vector3::z(), Vector3::x()]);
    Isometry3::from_parts(Vector3::from(tip).into(), turned)
}

/// What falls onto a place of an instrument from straight above, and is looked at after a while: its height above the axis.
fn falls_on(instrument: &Instrument, tip: Isometry3<f64>, at: Point3<f64>) -> f64 {
    let mut world = world();
    let mut hand = TestHand::new(&mut world, LEFT, instrument, tip, 0.0);
    hand.jaw_angle = 0.0;
    let place = tip * at;
    let body = RigidBody { motion: Motion::Dynamic, mass: 0.001, friction: 0.5, ..RigidBody::default() };
    let pose = Pose::at(place.x, place.y, place.z + 0.008);
    world.insert_body(BALL, &body, &Shape::Sphere { radius: RADIUS }, &pose, &Velocity::default()).unwrap();
    // It meets the place after 30 ms, and is looked at before it has rolled off.
    run(&mut world, &mut [hand], 0.06, hold_still, no_watch);
    world.pose(BALL).unwrap().translation.z - place.z
}

/// Places of the end of each kind that are farthest from the axis, with how thick it is there.
fn farthest(instrument: &Instrument) -> Option<(Point3<f64>, f64)> {
    let ends = working_end(instrument);
    let places = ends.iter().flat_map(|rod| rod.axis.iter().map(|place| (*place, rod.radius)));
    places.max_by(|a, b| a.0.coords.xy().norm().total_cmp(&b.0.coords.xy().norm()))
}

#[test]
fn every_kind_touches_with_its_own_end_where_that_is() {
    for kind in KINDS {
        let instrument = built(kind);
        let tip = level([0.0, 0.0, 0.1]);
        let free = falls_on(&instrument, tip, Point3::new(0.03, 0.0, -0.01));
        assert!(free < -0.003, "{kind:?}: beside it the ball falls, to {free} m");
        let (place, thick) = farthest(&instrument).unwrap_or((
            Point3::new(0.0, 0.0, -0.5 * instrument.jaw_length),
            if kind.has_jaws() { 0.5 * instrument.jaw_width } else { instrument.shaft_radius },
        ));
        let height = falls_on(&instrument, tip, place);
        // Between jaws that touch at their tips first a ball sinks in somewhat.
        let least = if kind.has_jaws() { 0.0 } else { RADIUS + thick - 4e-4 };
        let is_met = height > least && height < RADIUS + thick + 4e-4;
        assert!(is_met, "{kind:?}: the ball is {height} m above {place}");
        // Where a straight shaft would have been.
        if place.coords.xy().norm() > 2.0 * instrument.shaft_radius {
            let straight = falls_on(&built(InstrumentKind::Probe), tip, place);
            assert!(straight < 0.0, "{kind:?}: a straight one misses it");
        }
    }
}

#[test]
fn bent_ends_do_not_fill_what_they_go_around() {
    // The bow of a retractor hangs down: what falls onto the middle of it passes where a straight rod would be. Between the
    // prongs of a knot pusher passes what is thinner than they are apart.
    let turned =
        nalgebra::UnitQuaternion::from_basis_unchecked(&[-Vector3::y(), -Vector3::z(), Vector3::x()]);
    let hanging = Isometry3::from_parts(Vector3::new(0.0, 0.0, 0.1).into(), turned);
    let wide = Instrument { jaw_width: 0.012, ..built(InstrumentKind::KnotPusher) };
    for (instrument, is_there) in [
        (built(InstrumentKind::Retractor), false),
        (wide, false),
        (built(InstrumentKind::Probe), true),
        (built(InstrumentKind::LoopApplier), true),
    ] {
        let height = falls_on(&instrument, hanging, Point3::new(0.0, 0.0, -0.015));
        assert_eq!(height > 0.0, is_there, "{:?}: {height} m", instrument.kind);
    }
}

#[test]
fn a_hook_draws_a_ring_along_that_a_straight_rod_passes_above() {
    let drawn = |kind: InstrumentKind| {
        let mut world = world();
        // On the floor.
        let ring = add_ring(&mut world, 0, Pose::at(0.0, 0.0, -0.05 + TUBE_RADIUS), 0.2);
        let instrument = Instrument { jaw_length: 0.02, ..built(kind) };
        // Level, and what is bent points down into the ring.
        let turned =
            nalgebra::UnitQuaternion::from_basis_unchecked(&[-Vector3::z(), Vector3::y(), Vector3::x()]);
        let place = |x: f64| Isometry3::from_parts(Vector3::new(x, 0.0, -0.0395).into(), turned);
        let mut hands = [TestHand::new(&mut world, LEFT, &instrument, place(0.0), 0.0)];
        run(
            &mut world,
            &mut hands,
            0.6,
            |_, t, hand| hand.tip = place(-0.02 * minimum_jerk(t, 0.5)),
            no_watch,
        );
        world.pose(ring).unwrap().translation.x
    };
    let (hook, straight) = (drawn(InstrumentKind::HookCautery), drawn(InstrumentKind::Probe));
    assert!(hook < -0.012, "{hook} m");
    assert!(straight.abs() < 1e-3, "{straight} m");
}

#[test]
fn jaws_of_every_kind_that_holds_take_a_ring_and_lift_it() {
    for kind in [
        InstrumentKind::Grasper,
        InstrumentKind::BluntDissector,
        InstrumentKind::SutureGrasper,
        InstrumentKind::NeedleDriver,
    ] {
        let instrument = Instrument { kind, ..Instrument::default() };
        let mut world = world();
        add_boards(&mut world);
        let ring = add_ring(&mut world, 0, Pose::at(-0.04, 0.0, TUBE_RADIUS), 0.5);
        let mut hands = [grasp_ring(&mut world, LEFT, &instrument, [-0.04, 0.0], 0.0005)];
        let start = hands[0].tip.translation.vector.z;
        run(
            &mut world,
            &mut hands,
            0.7,
            |_, t, hand| hand.tip.translation.vector.z = start + 0.03 * minimum_jerk(t, 0.5),
            no_watch,
        );
        assert_eq!(world.tool(LEFT).unwrap().hold.map(|hold| hold.held), Some(ring), "{kind:?}");
        let height = world.pose(ring).unwrap().translation.z;
        assert!(height > 0.025, "{kind:?}: {height} m");
    }
    let state = InstrumentState::default();
    for kind in KINDS.into_iter().filter(|kind| !kind.has_jaws()) {
        let mut world: W = world();
        world.insert_tool(LEFT, &Instrument { kind, ..Instrument::default() }, &state, None).unwrap();
        assert_eq!(world.tool(LEFT).unwrap().state.opening.angle, 0.0, "{kind:?} has none");
    }
}
