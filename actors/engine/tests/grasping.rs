//! Grasping by friction: what holds, what slips, what falls.

mod common;

use common::*;
use trocar_scene::components::{Instrument, Pose};

fn instrument(force: f64, friction: f64) -> Instrument {
    Instrument { jaw_force_max: force, jaw_friction: friction, ..Instrument::default() }
}

#[test]
fn friction_alone_lifts_and_holds_a_shaken_ring() {
    for (force, friction) in [(1.0, 0.3), (1.0, 0.6), (2.0, 0.6), (5.0, 0.5)] {
        let mut world = world();
        add_boards(&mut world);
        let ring = add_ring(&mut world, 0, Pose::at(-0.04, 0.0, TUBE_RADIUS), friction);
        let hand = grasp_ring(&mut world, LEFT, &instrument(force, friction), [-0.04, 0.0], 0.0005);
        let mut hands = [hand];
        let start = hand.tip;
        println!(
            "opening {:?} pads {:?}",
            world.grasper_state(LEFT).unwrap().opening,
            world.grasper(LEFT).unwrap().pad_force()
        );
        run(
            &mut world,
            &mut hands,
            0.5,
            |_, t, hand| {
                hand.tip.translation.vector.z = start.translation.vector.z + 0.03 * minimum_jerk(t, 0.5)
            },
            no_watch,
        );
        run(&mut world, &mut hands, 0.1, hold_still, no_watch);
        let held = world.relative_pose(LEFT, ring).unwrap();
        assert_eq!(world.grasper(LEFT).unwrap().hold().map(|hold| hold.held), Some(ring));
        let lifted = hands[0].tip;
        let mut slip: f64 = 0.0;
        let clock = std::time::Instant::now();
        run(
            &mut world,
            &mut hands,
            2.0,
            |_, t, hand| {
                let phase = std::f64::consts::TAU * 5.0 * t;
                hand.tip.translation.vector = lifted.translation.vector
                    + nalgebra::Vector3::new(0.005 * phase.sin(), 0.0, 0.005 * (1.0 - phase.cos()))
            },
            |world, _| {
                let now = world.relative_pose(LEFT, ring).unwrap();
                slip = slip.max((now.translation.vector - held.translation.vector).norm());
            },
        );
        let micros = clock.elapsed().as_secs_f64() * 1e6 / 2000.0;
        let penetration = world.statistics().penetration_max;
        println!(
            "{force} N, friction {friction}: ring at {:.1} mm, slip {:.3} mm, penetration {:.4} mm, {micros:.0} us/ms",
            world.pose(ring).unwrap().translation.z * 1e3,
            slip * 1e3,
            penetration * 1e3
        );
        assert!(world.pose(ring).unwrap().translation.z > 0.02);
        assert!(slip < 5e-4, "slipped by {slip} m");
        assert!(penetration < 1e-4, "penetration of {penetration} m");
    }
}
