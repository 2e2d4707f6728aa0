use nalgebra::Vector3;

use super::*;

const MS: fn(u64) -> SimTime = SimTime::from_millis;

fn force(newtons: f64) -> [HandSample; 1] {
    let mut sample = HandSample::unknown(0);
    sample.wrench.force = Vector3::new(newtons, 0.0, 0.0);
    [sample]
}

fn sender(config: &SenderConfig) -> HapticSender {
    HapticSender::new(config)
}

/// A tick after which the datagram goes, if there is one.
fn tick(sender: &mut HapticSender, samples: &[HandSample], now: SimTime) -> Option<SendReason> {
    let outgoing = sender.tick(samples, &ClockSync::default(), now)?;
    sender.sent(samples, now);
    Some(outgoing.reason)
}

#[test]
fn without_a_deadband_each_period_has_its_datagram() {
    for top in Rate::ALL {
        let mut sender = sender(&SenderConfig { top, deadband: None });
        // Ticks with a jitter of a tenth of a millisecond.
        let times = (0..5_000_u64).map(|tick| SimTime::from_micros(1_000 * tick + 37 * tick % 100));
        times.for_each(|now| {
            tick(&mut sender, &force(1.0), now);
        });
        let (sent, expected) = (sender.counts().sent(), 5 * u64::from(top.hz()));
        assert!(sent.abs_diff(expected) <= expected / 100 + 1, "{sent} of {expected}");
    }
}

#[test]
fn a_hand_at_rest_sends_heartbeats_only() {
    let mut sender = sender(&SenderConfig::default());
    assert_eq!(tick(&mut sender, &force(1.0), MS(0)), Some(SendReason::Discrete), "the first");
    assert_eq!(tick(&mut sender, &force(1.0), MS(1)), Some(SendReason::Deadband), "it may be lost");
    let sent: Vec<u64> = (2..=210)
        .filter(|ms| {
            tick(&mut sender, &force(1.05), MS(*ms))
                .inspect(|why| assert_eq!(*why, SendReason::Heartbeat))
                .is_some()
        })
        .collect();
    assert!(sent.iter().copied().eq((1..=10).map(|beat| 20 * beat + 1)), "{sent:?}");
}

#[test]
fn heartbeats_come_closer_as_more_is_lost() {
    let beats = [0.0, 0.001, 0.02, 0.2, 0.5].map(|loss| heartbeat(loss, SimTime::ZERO));
    assert_eq!((beats[0], beats[1]), (HEARTBEAT, HEARTBEAT));
    assert!(beats.is_sorted_by(|a, b| a >= b));
    for (loss, beat) in [(0.02, beats[2]), (0.2, beats[3])] {
        let fit = (HEARD_WITHIN.as_secs_f64() / beat.as_secs_f64()).round() as i32;
        assert!(f64::powi(loss, fit) <= UNHEARD && f64::powi(loss, fit - 1) > UNHEARD);
    }
    assert!(beats[3] >= MS(7) && beats[3] < MS(8), "{}", beats[3]);
}

#[test]
fn a_change_that_is_noticed_goes_at_the_next_tick_and_another_does_not() {
    let mut sender = sender(&SenderConfig::default());
    tick(&mut sender, &force(1.0), MS(0));
    tick(&mut sender, &force(1.0), MS(1));
    assert_eq!(tick(&mut sender, &force(1.09), MS(2)), None);
    assert_eq!(tick(&mut sender, &force(1.11), MS(3)), Some(SendReason::Deadband));
    assert_eq!(tick(&mut sender, &force(1.12), MS(4)), None);
}

#[test]
fn a_button_goes_at_once_on_every_rung() {
    let mut sender = sender(&SenderConfig { top: Rate::Hz60, ..SenderConfig::default() });
    let mut hand = force(1.0);
    tick(&mut sender, &hand, MS(0));
    hand[0].wrench.force.x = 5.0;
    assert_eq!(tick(&mut sender, &hand, MS(1)), None, "a force waits for its period");
    hand[0].state.buttons = 2;
    assert_eq!(tick(&mut sender, &hand, MS(2)), Some(SendReason::Discrete));
    assert_eq!(tick(&mut sender, &hand, MS(3)), None);
}

#[test]
fn what_cannot_go_is_not_queued_and_the_newest_goes_instead() {
    let mut sender = sender(&SenderConfig { deadband: None, ..SenderConfig::default() });
    let clock = ClockSync::default();
    for ms in 0..100 {
        assert!(sender.tick(&force(ms as f64), &clock, MS(ms)).is_some());
        sender.blocked();
    }
    assert_eq!((sender.counts().blocked, sender.counts().sent()), (100, 0));
    assert_eq!(tick(&mut sender, &force(100.0), MS(100)), Some(SendReason::Discrete));
    // A tick that comes two seconds late sends one, and then at its pace.
    assert!(tick(&mut sender, &force(1.0), MS(2_100)).is_some());
    assert_eq!(tick(&mut sender, &force(1.0), MS(2_100)), None);
    assert!(tick(&mut sender, &force(1.0), MS(2_101)).is_some());
}

#[test]
fn the_echo_is_of_the_newest_datagram_and_says_how_long_it_was_held() {
    let mut sender = sender(&SenderConfig::default());
    let mut clock = ClockSync::default();
    clock.received(MS(7_000), None, MS(10));
    let outgoing = sender.tick(&force(0.0), &clock, MS(12)).expect("the first");
    assert_eq!(outgoing.echo, Some(ClockEcho { sent_at: MS(7_000), held: MS(2) }));
}

#[test]
fn a_deadband_that_is_not_valid_is_off() {
    let deadband = Some(Deadband { weber: f64::NAN, ..Deadband::default() });
    let mut sender = sender(&SenderConfig { deadband, ..SenderConfig::default() });
    tick(&mut sender, &force(0.0), MS(0));
    assert_eq!(tick(&mut sender, &force(0.0), MS(1)), Some(SendReason::Period));
}
