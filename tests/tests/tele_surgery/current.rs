//! Jaws and current over the path: what the slave grasps, cuts and burns comes a round trip after the surgeon's wish.

use trocar::session::Session;
use trocar_scene::{
    Activation, DeviceState, EnergyPedal, Entity, Hand, Measured, PressTarget, SimTime, SlaveOrder,
    SlaveState, Snapshot, Teleoperation,
};

use super::{PATH, over, starting, steps};

/// Down onto the liver, and a second of coagulation; the jaws open meanwhile.
const BURN: &str = "
    { seconds = 0.8, to = [-0.030, 0.040, 0.070] },
    { seconds = 0.5, to = [-0.030, 0.040, 0.053] },
    { seconds = 0.4 },
    { seconds = 1.0, level = 1.0, mode = \"coagulate\", jaws = 0.3 },
    { seconds = 1.0, level = 0.0 },
";

/// When something is seen first, in steps of a millisecond; `None` within five seconds.
fn first(session: &mut Session, mut is_seen: impl FnMut(&Snapshot) -> bool) -> Option<f64> {
    (0..5_000).find_map(|_| {
        session.step(SimTime::from_millis(1));
        is_seen(&session.snapshot()).then(|| session.now().as_secs_f64())
    })
}

fn the_hand(session: &mut Session) -> (Entity, Entity) {
    let scene = session.snapshot();
    let (hand, row) = scene.iter::<Hand>().next().expect("a hand");
    (hand, row.instrument)
}

fn heat(scene: &Snapshot) -> f64 {
    let values = scene.iter::<Measured>().filter_map(|(_, row)| row.values.get("liver.heat_supplied_j"));
    values.copied().sum()
}

fn is_on(scene: &Snapshot, instrument: Entity) -> bool {
    scene.get::<Activation>(instrument).is_some_and(|asked| asked.level > 0.0)
}

#[test]
fn the_liver_burns_a_round_trip_after_the_pedal_and_stops_a_round_trip_after_its_release() {
    let mut session = starting(&[steps(BURN), over("varies = false", 0.15)]);
    let (hand, instrument) = the_hand(&mut session);
    let presses = move |scene: &Snapshot| scene.get::<PressTarget>(hand).is_some_and(|press| press.coagulate);
    let pressed = first(&mut session, presses).expect("the foot goes down");
    assert!(!is_on(&session.snapshot(), instrument) && heat(&session.snapshot()) == 0.0);
    let on = first(&mut session, |scene| is_on(scene, instrument)).expect("the current comes");
    // The path, and the drivers and controllers on the way: 1 kHz, and 200 Hz at the end.
    assert!((PATH..PATH + 0.010).contains(&(on - pressed)), "{} s", on - pressed);
    let burns = first(&mut session, |scene| heat(scene) > 0.0).expect("heat flows");
    assert!((PATH..PATH + 0.025).contains(&(burns - pressed)), "{} s", burns - pressed);
    let told = session.snapshot().get::<Teleoperation>(hand).cloned().expect("it is told");
    assert_eq!(told.pedals, EnergyPedal::Coagulate);
    assert!(told.words().contains("following, coagulating"), "{}", told.words());
    let released = first(&mut session, |scene| !presses(scene)).expect("the foot goes up");
    let off = first(&mut session, |scene| !is_on(scene, instrument)).expect("the current goes");
    assert!((PATH..PATH + 0.010).contains(&(off - released)), "{} s", off - released);
    // 30 W for a second, of what gets from the tip into the tissue.
    let supplied = heat(&session.snapshot());
    assert!((5.0..30.5).contains(&supplied), "{supplied} J");
    session.step(SimTime::from_millis(300));
    assert!(heat(&session.snapshot()) - supplied < 0.5, "and stays off");
}

#[test]
fn jaws_close_a_round_trip_after_the_fingers() {
    let close = "{ seconds = 0.5 }, { seconds = 0.2, jaws = 0.7 }, { seconds = 1.0 },";
    let opens = |round_trip_secs| {
        let mut session = starting(&[steps(close), over("varies = false", round_trip_secs)]);
        let (hand, _) = the_hand(&mut session);
        let is_open =
            |scene: &Snapshot| scene.get::<DeviceState>(hand).is_some_and(|state| state.gripper > 0.35);
        first(&mut session, is_open).expect("they open")
    };
    let later = opens(0.15) - opens(0.05);
    assert!((later - 0.1).abs() < 0.002, "{later} s");
}

#[test]
fn an_emergency_stop_switches_the_current_off_at_once_and_its_end_does_not_switch_it_on() {
    let long = "
        { seconds = 0.6 },
        { seconds = 1.5, level = 1.0 },
        { seconds = 0.5, level = 0.0 },
        { seconds = 2.0, level = 1.0 },
    ";
    let mut session = starting(&[steps(long), over("varies = false", 0.15)]);
    let (hand, instrument) = the_hand(&mut session);
    first(&mut session, |scene| is_on(scene, instrument)).expect("the current comes");
    session.step(SimTime::from_millis(100));
    session.apply(|out| out.put(hand, SlaveOrder { stop: true })).expect("it is written");
    session.step(SimTime::from_millis(20));
    assert!(!is_on(&session.snapshot(), instrument), "at once, not a round trip later");
    let told = session.snapshot().get::<Teleoperation>(hand).cloned().expect("it is told");
    assert_eq!(
        (told.state, told.pedals, told.figures.stops),
        (SlaveState::Stopped, EnergyPedal::Released, 1)
    );
    session.apply(|out| out.put(hand, SlaveOrder { stop: false })).expect("it is written");
    session.step(SimTime::from_millis(400));
    assert!(!is_on(&session.snapshot(), instrument), "the foot has been down all the while");
    first(&mut session, |scene| is_on(scene, instrument)).expect("it is pressed again");
    let pressed_again = 0.6 + 1.5 + 0.5 + PATH;
    let now = session.now().as_secs_f64();
    assert!((pressed_again..pressed_again + 0.02).contains(&now), "{now} s");
}

#[test]
fn bursts_of_losses_below_a_hundred_milliseconds_leave_the_current_on_and_longer_ones_do_not() {
    let long = "{ seconds = 0.6 }, { seconds = 20.0, level = 1.0 },";
    let figures = |burst: &str| {
        let path = format!("varies = false\nloss = 0.2\nburst = {burst}");
        let mut session = starting(&[steps(long), over(&path, 0.15)]);
        let (hand, _) = the_hand(&mut session);
        session.step(SimTime::from_millis(5_000));
        session.snapshot().get::<Teleoperation>(hand).cloned().expect("it is told").figures
    };
    let short = figures("5.0");
    assert!(short.silences == 0 && (4.2..4.26).contains(&short.energised), "{short:?}");
    // The foot never goes up, so that after a silence nothing comes.
    let long = figures("200.0");
    assert!(long.silences > 0 && long.energised < 3.0, "{long:?}");
}
