use nalgebra::Vector3;
use proptest::prelude::*;
use trocar_scene::random::SplitMix64;

use super::*;

const MS: fn(u64) -> SimTime = SimTime::from_millis;

fn at_x(hand: u8, x: f64) -> HandSample {
    let mut sample = HandSample::unknown(hand);
    sample.state.pose_in_device.translation.vector = Vector3::new(x, 0.0, 0.0);
    sample
}

fn receiver(hands: &[u8]) -> HapticReceiver {
    HapticReceiver::new(hands).expect("valid")
}

fn x_of(receiver: &mut HapticReceiver, hand: u8, now: SimTime) -> f64 {
    receiver.read(hand, now).expect("arrived").sample.position_in_device().x
}

#[test]
fn the_newest_wins_and_a_late_one_is_counted_but_never_applied() {
    let mut receiver = receiver(&[0]);
    let mut arrive =
        |sequence: u64| receiver.receive(sequence, MS(sequence), None, &[at_x(0, sequence as f64)], MS(50));
    let orders = [3, 1, 2, 5, 5, 4].map(&mut arrive);
    use Order::{Late, Newest, Repeated};
    assert_eq!(orders, [Newest, Late, Late, Newest, Repeated, Late]);
    assert_eq!(x_of(&mut receiver, 0, MS(50)), 5.0);
    let counts = receiver.counts();
    assert_eq!((counts.received, counts.late, counts.duplicate, counts.lost), (5, 3, 1, 0));
    assert_eq!(counts.hands, HandCounts { applied: 2, superseded: 1, late: 3, held: 0 });
}

#[test]
fn each_hand_has_its_own_newest() {
    let mut receiver = receiver(&[0, 1]);
    receiver.receive(2, MS(2), None, &[at_x(0, 2.0), at_x(9, 2.0)], MS(5));
    receiver.receive(1, MS(1), None, &[at_x(0, 1.0), at_x(1, 1.0)], MS(6));
    assert_eq!((x_of(&mut receiver, 0, MS(6)), x_of(&mut receiver, 1, MS(6))), (2.0, 1.0));
    assert_eq!((receiver.counts().unknown, receiver.hand_counts(9)), (1, None));
    assert_eq!(receiver.read(9, MS(6)), None);
    assert_eq!(receiver.hand_counts(0).map(|counts| (counts.applied, counts.late)), Some((1, 1)));
}

#[test]
fn hands_that_do_not_fit_are_refused() {
    let many: Vec<u8> = (0..=HANDS_MAX as u8).collect();
    assert_eq!(HapticReceiver::new(&many).err(), Some(ReceiverError::TooMany(HANDS_MAX + 1)));
    assert_eq!(HapticReceiver::new(&[4, 2, 4]).err(), Some(ReceiverError::Twice(4)));
}

#[test]
fn between_datagrams_the_sample_is_held_and_ages() {
    let mut receiver = receiver(&[0]);
    // Their clock is at 10 s when ours is at 0, and the path takes 20 ms each way.
    let there = |ours: u64| MS(10_000 + ours);
    let echo = ClockEcho { sent_at: MS(60), held: MS(0) };
    let sample = HandSample { age_us: 1_500, ..at_x(0, 1.0) };
    receiver.receive(1, there(80), Some(echo), &[sample], MS(100));
    let first = receiver.read(0, MS(100)).expect("arrived");
    assert!(first.is_new && first.silence == SimTime::ZERO);
    assert_eq!(first.age, Some(SimTime::from_micros(21_500)), "20 ms on its way, and 1.5 ms before");
    let held = receiver.read(0, MS(115)).expect("arrived");
    assert!(!held.is_new && held.silence == MS(15) && held.sample == first.sample);
    assert_eq!(held.age, Some(SimTime::from_micros(36_500)));
    assert_eq!(receiver.counts().hands.held, 1);
}

#[test]
fn a_force_fades_with_silence_and_not_with_the_delay_of_the_path() {
    for (silence, factor) in [(0, 1.0), (50, 1.0), (75, 0.5), (90, 0.2), (100, 0.0), (5_000, 0.0)] {
        assert!((fade(MS(silence)) - factor).abs() < 1e-12, "{silence}");
    }
    let mut receiver = receiver(&[0]);
    // 500 ms on its way, each time.
    for sequence in 0..100 {
        let sent_at = MS(sequence * 20);
        let echo = ClockEcho { sent_at: MS(sequence * 20), held: SimTime::ZERO };
        let now = sent_at + MS(1_000);
        receiver.receive(sequence + 1, sent_at + MS(500), Some(echo), &[at_x(0, 0.0)], now);
        let read = receiver.read(0, now + MS(19)).expect("arrived");
        assert_eq!((read.fade, read.age), (1.0, Some(MS(519))));
    }
    let read = receiver.read(0, MS(99 * 20 + 1_075)).expect("arrived");
    assert!((read.fade - 0.5).abs() < 1e-12);
}

#[test]
fn late_datagrams_do_not_end_a_silence() {
    let mut receiver = receiver(&[0]);
    receiver.receive(100, MS(100), None, &[at_x(0, 0.0)], MS(100));
    (1..80).for_each(|sequence| {
        receiver.receive(sequence, MS(sequence), None, &[at_x(0, 1.0)], MS(100 + sequence));
    });
    assert_eq!(receiver.read(0, MS(200)).map(|read| (read.silence, read.fade)), Some((MS(100), 0.0)));
}

#[test]
fn of_a_backlog_of_two_seconds_one_pose_is_applied_and_it_is_fresh() {
    let mut receiver = receiver(&[0]);
    let path = SimTime::from_micros(500);
    // Our datagrams cross the path as well, so that theirs have something to echo.
    let tick = |receiver: &mut HapticReceiver, ms: u64, arrives: SimTime| {
        let sent_at = MS(ms);
        let echo = ClockEcho { sent_at: sent_at.since(MS(1)), held: SimTime::from_micros(500) };
        receiver.receive(ms, sent_at + MS(7_000), Some(echo), &[at_x(0, ms as f64)], arrives)
    };
    let mut reads = 0;
    for ms in 1..1_000 {
        tick(&mut receiver, ms, MS(ms) + path);
        reads += u64::from(receiver.read(0, MS(ms) + path).expect("arrived").is_new);
    }
    assert_eq!(reads, 999);
    let silent: Vec<bool> = (1_000..3_000).map(|ms| receiver.read(0, MS(ms)).expect("held").is_new).collect();
    assert!(!silent.contains(&true));
    let before = receiver.counts();
    (1_000..3_000).for_each(|ms| {
        tick(&mut receiver, ms, MS(3_000));
    });
    let fresh: Vec<RemoteHandSample> =
        (0..5).map(|ms| receiver.read(0, MS(3_000 + ms)).expect("arrived")).collect();
    assert_eq!(fresh.iter().filter(|read| read.is_new).count(), 1, "one pose is applied");
    assert_eq!(fresh[0].sample.position_in_device().x, 2_999.0);
    let age = fresh[0].age.expect("the clock is known");
    assert!(age <= MS(2) && age >= SimTime::from_micros(900), "{age}");
    assert_eq!(fresh[0].silence, SimTime::ZERO);
    let after = receiver.counts();
    assert_eq!(after.hands.superseded - before.hands.superseded, 1_999);
    assert_eq!((after.late, after.lost), (0, 0));
    assert_eq!(receiver.clock().resets(), 0, "a backlog is not a clock that was set");
}

#[test]
fn numbers_of_other_kinds_are_no_loss() {
    let mut receiver = receiver(&[0]);
    for sequence in 1..=100 {
        let sent_at = MS(sequence);
        if sequence % 3 == 0 {
            receiver.receive_other(sequence, sent_at, sent_at);
        } else {
            receiver.receive(sequence, sent_at, None, &[at_x(0, 0.0)], sent_at);
        }
    }
    let counts = receiver.counts();
    assert_eq!((counts.received, counts.lost, counts.hands.applied), (100, 0, 67));
}

proptest! {
    #[test]
    fn what_is_shown_never_goes_back(seed in 0_u64.., loss in 0.0..0.5_f64) {
        let mut random = SplitMix64::new(seed);
        let mut receiver = receiver(&[0]);
        let mut way: Vec<(u64, u64)> = (1..300).map(|number| (number + random.below(40), number)).collect();
        way.retain(|_| random.unit() >= loss);
        way.sort_unstable();
        let mut shown = 0.0;
        for (due, number) in way {
            receiver.receive(number, MS(number), None, &[at_x(0, number as f64)], MS(due));
            let x = x_of(&mut receiver, 0, MS(due));
            prop_assert!(x >= shown);
            shown = x;
        }
        let counts = receiver.counts();
        prop_assert_eq!(counts.received, counts.hands.applied + counts.hands.late);
    }
}
