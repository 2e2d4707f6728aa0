//! Two stations with a faulty link between: senders, receivers, clocks and ladders together.

use std::collections::VecDeque;

use nalgebra::Vector3;
use trocar_kernel::faults::{LinkFaults, Message};
use trocar_scene::SimTime;

use super::hand_motion_testing::hand_motion;
use super::*;
use crate::datagram::ClockEcho;
use crate::hand_sample::HandSample;
use crate::impairments::Impairments;

const MS: fn(u64) -> SimTime = SimTime::from_millis;

#[derive(Clone)]
struct Letter {
    sequence: u64,
    sent_at: SimTime,
    echo: Option<ClockEcho>,
    samples: Vec<HandSample>,
}

impl Message for Letter {
    fn bytes(&self) -> usize {
        52 + 28 + 100 * self.samples.len()
    }
    fn duplicate(&self) -> Option<Self> {
        Some(self.clone())
    }
    fn through(self, _: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        None
    }
}

struct Station {
    sender: HapticSender,
    receiver: HapticReceiver,
    sequence: u64,
    /// What its session clock shows when the test begins.
    clock: SimTime,
    /// The path from here.
    way: LinkFaults<Letter>,
    /// Reports from the other side, when they arrive.
    reports: VecDeque<(SimTime, LinkReport)>,
    /// When each datagram was to go, and arrived \[ms\].
    waited: Vec<u64>,
}

/// Two stations that send each other one hand each, at 1 kHz.
struct Channel {
    stations: [Station; 2],
    report_delay: SimTime,
}

impl Channel {
    fn new(path: &Impairments, config: &SenderConfig) -> Self {
        let station = |index: u64| Station {
            sender: HapticSender::new(config),
            receiver: HapticReceiver::new(&[0]).expect("one hand"),
            sequence: 0,
            clock: MS(500_000 * index),
            way: path.link(40 + index),
            reports: VecDeque::new(),
            waited: Vec::new(),
        };
        Self { stations: [station(0), station(1)], report_delay: path.delay }
    }

    /// A tick at `now` \[ms\]: both receive, then both send.
    fn tick(&mut self, now: u64, samples: [HandSample; 2]) {
        let now = MS(now);
        for here in [0, 1] {
            let there = 1 - here;
            while let Some(letter) = self.stations[there].way.due(now) {
                let sent_local = letter.sent_at.since(self.stations[there].clock);
                let Station { receiver, sender, clock, waited, .. } = &mut self.stations[here];
                let local = now + *clock;
                receiver.receive(letter.sequence, letter.sent_at, letter.echo, &letter.samples, local);
                if let Some(echo) = letter.echo {
                    sender.echoed(echo, receiver.clock(), local);
                }
                waited.push(now.since(sent_local).as_nanos() / 1_000_000);
            }
            let local = now + self.stations[here].clock;
            if let Some(report) = self.stations[here].receiver.report(local) {
                self.stations[there].reports.push_back((now + self.report_delay, report));
            }
            let Station { receiver, sender, reports, sequence, way, .. } = &mut self.stations[here];
            while let Some((_, report)) = reports.pop_front_if(|(due, _)| *due <= now) {
                sender.report(&report, receiver.clock(), local);
            }
            let samples = [samples[here]];
            if let Some(outgoing) = sender.tick(&samples, receiver.clock(), local) {
                *sequence += 1;
                let samples_sent = samples.to_vec();
                way.send(
                    now,
                    Letter {
                        sequence: *sequence,
                        sent_at: local,
                        echo: outgoing.echo,
                        samples: samples_sent,
                    },
                );
                sender.sent(&samples, local);
            }
        }
    }

    fn read(&mut self, station: usize, now: u64) -> Option<RemoteHandSample> {
        let Station { receiver, clock, .. } = &mut self.stations[station];
        receiver.read(0, MS(now) + *clock)
    }
}

/// A path of this round trip \[ms\] that loses this share.
fn path(round_trip: u64, loss: f64) -> Impairments {
    Impairments { delay: MS(round_trip / 2), loss, ..Impairments::default() }
}

fn force(newtons: f64) -> HandSample {
    let mut sample = HandSample::unknown(0);
    sample.wrench.force = Vector3::new(newtons, 0.0, 0.0);
    sample
}

#[test]
fn what_is_delivered_is_what_the_link_delivers_and_the_sender_adds_nothing() {
    for loss in [0.01, 0.2] {
        for deadband in [None, Some(Deadband::default())] {
            let config = SenderConfig { deadband, ..SenderConfig::default() };
            let mut channel = Channel::new(&path(150, loss), &config);
            let motion = hand_motion(0, 3, 20_000);
            (0..20_000).for_each(|ms| channel.tick(ms as u64, [motion[ms]; 2]));
            for station in [0, 1] {
                let link = channel.stations[1 - station].way.counts().lost as f64;
                let sent = channel.stations[1 - station].sequence as f64;
                let counts = channel.stations[station].receiver.counts();
                let under_way = channel.stations[1 - station].way.len() as f64;
                let delivered = counts.received as f64 / (sent - under_way);
                assert!((delivered - (1.0 - link / (sent - under_way))).abs() < 0.005, "{delivered}");
                assert!((delivered - (1.0 - loss)).abs() < 0.015, "{delivered} at {loss}");
                assert_eq!((counts.late, counts.duplicate), (0, 0));
                let waited = &channel.stations[station].waited;
                assert!(waited.iter().all(|waited| *waited == 75), "no queue but the path");
                assert_eq!(channel.stations[station].sender.counts().blocked, 0);
            }
        }
    }
}

#[test]
fn at_a_fifth_lost_the_ladder_goes_down_and_the_share_delivered_stays() {
    let mut channel =
        Channel::new(&path(150, 0.2), &SenderConfig { deadband: None, ..SenderConfig::default() });
    (0..30_000).for_each(|ms| channel.tick(ms, [force(1.0); 2]));
    let sent = channel.stations[0].sequence;
    let counts = channel.stations[1].receiver.counts();
    let delivered = counts.received as f64 / (sent - channel.stations[0].way.len() as u64) as f64;
    let of_link = 1.0 - channel.stations[0].way.counts().lost as f64 / sent as f64;
    assert!((delivered - of_link).abs() < 0.005, "{delivered} {of_link}");
    assert!(channel.stations[0].sender.ladder().downs() > 0 && sent < 25_000, "{sent}");
    assert!(channel.stations[1].waited.iter().all(|waited| *waited == 75));
}

/// What deadband coding saves and costs; errors in bands of the receiver's hand against the sender's, a
/// path's delay ago.
#[derive(Debug)]
struct Coding {
    /// Share of the 1,000 datagrams a second that was not sent.
    saved: f64,
    worst: f64,
    mean: f64,
    /// Share of the ticks with an error above one band.
    wrong: f64,
    /// Longest time with an error above one band \[ms\].
    recovery: u64,
    /// Least factor of the force.
    fade: f64,
}

fn coding(path: &Impairments, seed: u64, from: u64) -> Coding {
    let delay = path.delay.as_nanos() / 1_000_000;
    let mut channel = Channel::new(path, &SenderConfig::default());
    let motion = hand_motion(0, seed, 60_000);
    let deadband = Deadband::default();
    let (mut sum, mut worst, mut wrong, mut recovery, mut fade) = (0.0, 0.0_f64, 0_u64, 0, 1.0_f64);
    let (mut since, mut ticks) = (0, 0);
    for ms in 0..60_000 {
        channel.tick(ms, [motion[ms as usize]; 2]);
        // The first report is needed to know the loss.
        if ms < from {
            continue;
        }
        let read = channel.read(1, ms).expect("it has arrived");
        let bands = match deadband.deviation(&motion[(ms - delay) as usize], &read.sample) {
            Deviation::Bands(bands) => bands,
            Deviation::Discrete => 2.0,
        };
        ticks += 1;
        (sum, worst, fade) = (sum + bands, worst.max(bands), fade.min(read.fade));
        since = if bands > 1.0 + 1e-9 { since + 1 } else { 0 };
        wrong += u64::from(since > 0);
        recovery = recovery.max(since);
    }
    let saved = 1.0 - channel.stations[0].sequence as f64 / 60_000.0;
    Coding { saved, worst, mean: sum / ticks as f64, wrong: wrong as f64 / ticks as f64, recovery, fade }
}

fn check(coding: &Coding, saved: f64, wrong: f64, mean: f64) {
    assert!(coding.saved >= saved && coding.wrong <= wrong && coding.mean <= mean, "{coding:?}");
    assert!(coding.recovery <= 100, "{coding:?}");
}

#[test]
fn without_loss_deadband_coding_saves_four_fifths_and_is_never_wrong() {
    for (seed, round_trip) in [(1, 150), (2, 150), (3, 0), (4, 1_000)] {
        let coding = coding(&path(round_trip, 0.0), seed, 2_000);
        // A band is a tenth of what is true, so half a band is 5 %.
        check(&coding, 0.8, 0.0, 0.5);
        assert!(coding.worst <= 1.0 + 1e-9 && coding.fade == 1.0, "{coding:?}");
    }
}

#[test]
fn a_loss_of_two_percent_costs_a_hundredth_of_the_time() {
    for seed in [1, 2] {
        let coding = coding(&path(150, 0.02), seed, 2_000);
        check(&coding, 0.8, 0.02, 0.5);
        assert!(coding.fade == 1.0, "{coding:?}");
    }
}

#[test]
fn a_loss_of_a_fifth_costs_a_fortieth_of_the_time_and_some_of_the_saving() {
    for seed in [1, 2] {
        // Until then the ladder finds out that no rate cures the loss.
        let coding = coding(&path(150, 0.2), seed, 12_000);
        check(&coding, 0.74, 0.04, 0.5);
        assert!(coding.fade > 0.8, "{coding:?}");
    }
}

#[test]
fn resilience_is_what_keeps_errors_short() {
    // The same link and hand, but losses are never reported, so that the sender believes in a hundredth.
    let resilient = coding(&path(150, 0.15), 1, 2_000);
    let mut channel = Channel::new(&path(150, 0.15), &SenderConfig::default());
    channel.report_delay = MS(1_000_000);
    let motion = hand_motion(0, 1, 60_000);
    let mut wrong = 0;
    for ms in 0..60_000 {
        channel.tick(ms, [motion[ms as usize]; 2]);
        let Some(read) = channel.read(1, ms).filter(|_| ms >= 2_000) else { continue };
        wrong +=
            u64::from(Deadband::default().deviation(&motion[ms as usize - 75], &read.sample).is_noticed());
    }
    let naive = wrong as f64 / 58_000.0;
    assert!(naive > 2.0 * resilient.wrong, "{naive} {resilient:?}");
}

#[test]
fn a_newton_held_over_a_second_of_round_trip_does_not_ripple() {
    for loss in [0.0, 0.02] {
        let mut channel = Channel::new(&path(1_000, loss), &SenderConfig::default());
        let mut random = trocar_scene::random::SplitMix64::new(9);
        let (mut least, mut most) = (f64::INFINITY, 0.0_f64);
        for ms in 0..13_000 {
            // A force that is measured or computed is never quite constant.
            let newtons = 1.0 + 0.03 * (random.unit() - 0.5);
            channel.tick(ms, [force(newtons); 2]);
            if ms >= 3_000 {
                let read = channel.read(0, ms).expect("it has arrived");
                let felt = read.fade * read.sample.wrench.force.x;
                (least, most) = (least.min(felt), most.max(felt));
                assert!(read.age.is_some_and(|age| age >= MS(500) && age <= MS(560)), "{:?}", read.age);
            }
        }
        assert!(least > 0.95 && most - least <= 0.05, "{least} to {most} N");
        let sent = channel.stations[1].sequence;
        assert!(sent < 1_000, "{sent} datagrams in 13 s");
    }
}

#[test]
fn the_same_session_twice_has_the_same_bits() {
    let run = || {
        let mut channel = Channel::new(&path(150, 0.1), &SenderConfig::default());
        let motion = hand_motion(0, 5, 5_000);
        let reads: Vec<_> = (0..5_000)
            .map(|ms| {
                channel.tick(ms, [motion[ms as usize]; 2]);
                channel.read(1, ms)
            })
            .collect();
        (reads, channel.stations.map(|station| (station.sequence, station.receiver.counts())))
    };
    assert!(run() == run());
}

#[test]
fn a_path_that_was_silent_for_two_seconds_shows_one_fresh_pose() {
    let mut channel = Channel::new(&path(2, 0.0), &SenderConfig::default());
    let motion = hand_motion(0, 6, 10_000);
    let mut fresh = 0;
    for ms in 0..10_000_u64 {
        if (4_000..6_000).contains(&ms) {
            // The path holds everything back, and lets it go at once.
            let held = Impairments { delay: MS(6_000 - ms), ..Impairments::default() };
            held.orders(1).iter().for_each(|order| channel.stations[0].way.apply(order));
        } else if ms == 6_000 {
            path(2, 0.0).orders(1).iter().for_each(|order| channel.stations[0].way.apply(order));
        }
        channel.tick(ms, [motion[ms as usize]; 2]);
        let Some(read) = channel.read(1, ms) else { continue };
        if (4_110..6_000).contains(&ms) {
            assert_eq!((read.is_new, read.fade), (false, 0.0), "{ms}");
        } else if (6_000..6_005).contains(&ms) {
            fresh += u64::from(read.is_new && read.age.is_some_and(|age| age <= MS(2)));
        }
    }
    let counts = channel.stations[1].receiver.counts();
    assert!(fresh >= 1 && counts.hands.superseded > 100 && counts.lost == 0, "{fresh} {counts:?}");
}
