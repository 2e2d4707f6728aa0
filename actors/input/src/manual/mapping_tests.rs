use super::*;
use proptest::prelude::*;
use trocar_scene::Entity;
use trocar_scene::kinematics::fulcrum::{Fulcrum, PortFriction};
use trocar_scene::kinematics::registration::Registration;

const PORT: Vector3<f64> = Vector3::new(-0.10, -0.09, 0.17);
const WORKSPACE: Vector3<f64> = Vector3::new(0.160, 0.120, 0.070);
const SHAFT: f64 = 0.33;

/// The left hand of the peg transfer.
fn rig() -> HandRig {
    let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -std::f64::consts::FRAC_PI_2);
    let place = Isometry3::from_parts(Vector3::new(-0.159, -0.165, 0.287).into(), down);
    HandRig {
        registration: Registration::new(place, 1.25).unwrap(),
        coupling: InstrumentCoupling::Fulcrum(
            Fulcrum::new(PORT, SHAFT, [0.02, 0.30], PortFriction::NONE).unwrap(),
        ),
        instrument: Entity::new(0, 1, 1),
        port: None,
        jaw_angle_max: 0.9,
    }
}

/// Before the boards, looking down at them.
fn view() -> PersonView {
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -2.5);
    PersonView { world_from_view: Pose::new(Vector3::new(0.0, -0.14, 0.20), rotation), field_of_view: 1.05 }
}

/// Image coordinates (right, down) in image heights, and the depth \[m\].
fn picture(point: &Vector3<f64>, view: &PersonView) -> (f64, f64, f64) {
    let seen = view.world_from_view.isometry().inverse_transform_point(&Point3::from(*point));
    let height = 2.0 * (0.5 * view.field_of_view).tan();
    (seen.x / seen.z / height, seen.y / seen.z / height, seen.z)
}

fn at_home(rig: &HandRig) -> ManualHand {
    let tip = rig.tip_in_world(&Isometry3::identity(), &-Vector3::z());
    ManualHand::at(&tip, 0.0, 0.4, PersonHand::default())
}

fn asked(moved: [f64; 3], rolled: f64) -> PersonHand {
    PersonHand { moved, rolled, ..PersonHand::default() }
}

/// Sends input and waits until the hand arrives, with a perfectly following tip.
fn settle(hand: &mut ManualHand, wish: &PersonHand, rig: &HandRig, limits: &HandLimits) {
    let reach = HandKinematics { rig, workspace: WORKSPACE };
    let actual = hand.tip_in_world.position;
    hand.ask(wish, Some(&view()), &actual, &reach, limits);
    for _ in 0..300 {
        hand.advance(0.01, limits);
    }
}

#[test]
fn the_tip_moves_in_the_picture_as_the_pointer_does_and_the_wheel_keeps_its_picture() {
    let (rig, limits) = (rig(), HandLimits::default());
    let mut hand = at_home(&rig);
    let (x, y, depth) = picture(&hand.tip_in_world.position, &view());
    settle(&mut hand, &asked([0.05, 0.03, 0.0], 0.0), &rig, &limits);
    let (moved_x, moved_y, same) = picture(&hand.tip_in_world.position, &view());
    assert!((moved_x - x - 0.05).abs() < 1e-9 && (moved_y - y - 0.03).abs() < 1e-9, "{moved_x} {moved_y}");
    assert!((same - depth).abs() < 1e-9);
    settle(&mut hand, &asked([0.05, 0.03, 0.06], 0.0), &rig, &limits);
    let (still_x, still_y, deeper) = picture(&hand.tip_in_world.position, &view());
    assert!((still_x - moved_x).abs() < 1e-9 && (still_y - moved_y).abs() < 1e-9);
    assert!((deeper / same - 0.06_f64.exp()).abs() < 1e-9, "{deeper} {same}");
}

#[test]
fn the_handle_goes_where_the_fulcrum_brings_the_tip_to_its_goal_with_the_roll_asked_for() {
    let (rig, limits) = (rig(), HandLimits::default());
    let mut hand = at_home(&rig);
    let before = rig.tip_in_world(&Isometry3::identity(), &-Vector3::z());
    settle(&mut hand, &asked([0.06, -0.04, 0.03], 0.8), &rig, &limits);
    let place = hand.place(&HandKinematics { rig: &rig, workspace: WORKSPACE });
    let tip = rig.tip_in_world(&place.handle_in_device, &-Vector3::z());
    assert!((tip.translation.vector - hand.goal_in_world).norm() < 1e-9);
    let (axis_before, axis) = (before.rotation * Vector3::z(), tip.rotation * Vector3::z());
    let unrolled = minimal_rotation(&axis_before, &axis) * before.rotation;
    let roll = unrolled.inverse() * tip.rotation;
    assert!((roll.scaled_axis() - Vector3::new(0.0, 0.0, 0.8)).norm() < 1e-6, "{:?}", roll.scaled_axis());
}

#[test]
fn what_is_pressed_against_something_gets_no_farther_and_comes_back_at_once() {
    let (rig, limits) = (rig(), HandLimits::default());
    let reach = HandKinematics { rig: &rig, workspace: WORKSPACE };
    let mut hand = at_home(&rig);
    let stuck = hand.tip_in_world.position;
    let mut wish = PersonHand::default();
    for _ in 0..50 {
        wish.moved[1] += 0.02;
        hand.ask(&wish, Some(&view()), &stuck, &reach, &limits);
        hand.advance(0.01, &limits);
        assert!((hand.goal_in_world - stuck).norm() <= limits.lead_max + 1e-12);
    }
    let far = (hand.goal_in_world - stuck).norm();
    assert!(far > 0.9 * limits.lead_max);
    wish.moved[1] -= 0.05;
    hand.ask(&wish, Some(&view()), &stuck, &reach, &limits);
    assert!(
        (hand.goal_in_world - stuck).norm() < far - 0.005,
        "what was pushed in vain is not pulled back first"
    );
}

#[test]
fn a_hand_that_nobody_asks_keeps_still() {
    let rig = rig();
    let reach = HandKinematics { rig: &rig, workspace: WORKSPACE };
    let mut hand = at_home(&rig);
    settle(&mut hand, &asked([0.05, 0.0, 0.0], 0.3), &rig, &HandLimits::default());
    let before = hand.place(&reach);
    // The tip is pushed away; its goal does not follow.
    let pushed = hand.tip_in_world.position + Vector3::x() * 0.1;
    let seen = hand.seen;
    for _ in 0..100 {
        hand.ask(&seen, Some(&view()), &pushed, &reach, &HandLimits::default());
        hand.advance(0.01, &HandLimits::default());
    }
    let after = hand.place(&reach);
    let drift = after.handle_in_device.translation.vector - before.handle_in_device.translation.vector;
    assert!(drift.norm() < 1e-12 && (after.gripper - before.gripper).abs() < 1e-9);
}

#[test]
fn limits_that_make_no_sense_are_refused_by_name() {
    assert!(HandLimits::default().check().is_ok());
    let error = HandLimits { speed_max: f64::NAN, ..HandLimits::default() }.check().unwrap_err();
    assert!(error.contains("speed_max = NaN is out of range (0.001 to 2)"), "{error}");
}

fn wish() -> impl Strategy<Value = PersonHand> {
    (prop::array::uniform3(-2.0..2.0f64), -9.0..9.0f64, prop::option::of(0.0..1.0f64))
        .prop_map(|(moved, rolled, opening)| PersonHand { moved, rolled, opening, ..PersonHand::default() })
}

proptest! {
    #[test]
    fn whatever_is_asked_the_handle_stays_in_its_workspace_the_tip_in_its_port_and_nothing_is_thrown(
        wishes in prop::collection::vec((wish(), 1..20u32), 1..15),
    ) {
        let (rig, limits) = (rig(), HandLimits::default());
        let reach = HandKinematics { rig: &rig, workspace: WORKSPACE };
        let mut hand = at_home(&rig);
        let mut before = hand.tip_in_world.position;
        for (wish, ticks) in wishes {
            for _ in 0..ticks {
                let actual = hand.tip_in_world.position;
                hand.ask(&wish, Some(&view()), &actual, &reach, &limits);
                hand.advance(0.01, &limits);
                let tip = hand.tip_in_world.position;
                prop_assert!((tip - before).norm() <= 0.01 * limits.speed_max * (1.0 + 1e-9));
                before = tip;
                let place = hand.place(&reach);
                let handle = place.handle_in_device.translation.vector;
                prop_assert!(handle.iter().zip(WORKSPACE.iter()).all(|(x, size)| x.abs() <= 0.5 * size + 1e-12));
                let inside = rig.tip_in_world(&place.handle_in_device, &-Vector3::z());
                let insertion = (inside.translation.vector - PORT).norm();
                prop_assert!((0.02 - 1e-9..=0.30 + 1e-9).contains(&insertion), "{insertion}");
                prop_assert!((0.0..=0.9).contains(&place.gripper));
                prop_assert!(hand.roll.position.x.abs() <= limits.roll_max + 1e-9);
            }
        }
    }

    #[test]
    fn a_motion_in_parts_is_the_motion_in_one(
        parts in prop::collection::vec(prop::array::uniform3(-0.05..0.05f64).prop_map(Vector3::from), 1..10),
    ) {
        let start = Vector3::new(-0.03, 0.0, 0.03);
        let whole = moved_in_picture(&start, &parts.iter().sum(), &view(), 1.0);
        let divided = parts.iter().fold(start, |point, part| moved_in_picture(&point, part, &view(), 1.0));
        prop_assert!((whole - divided).norm() < 1e-12);
    }
}
