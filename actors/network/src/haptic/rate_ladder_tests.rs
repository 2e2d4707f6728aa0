use trocar_kernel::faults::{LinkFaults, Message};

use super::*;
use crate::haptic::{ClockSync, LossMeter};
use crate::impairments::Impairments;

const MS: fn(u64) -> SimTime = SimTime::from_millis;

/// A datagram of two hands: number and when it was sent.
struct Letter(u64, SimTime);

impl Message for Letter {
    fn bytes(&self) -> usize {
        272
    }
    fn duplicate(&self) -> Option<Self> {
        None
    }
    fn through(self, _: &mut dyn FnMut(&mut [u8])) -> Option<Self> {
        None
    }
}

/// A sender on a ladder, a link, and a receiver whose reports come back after 75 ms.
struct Session {
    ladder: RateLadder,
    link: LinkFaults<Letter>,
    changes: Vec<RateChange>,
    sent: u64,
    due: SimTime,
    meter: LossMeter,
    clock: ClockSync,
    reports: std::collections::VecDeque<(SimTime, LinkReport)>,
    now: u64,
}

impl Session {
    fn new(path: &Impairments) -> Self {
        Self {
            ladder: RateLadder::default(),
            link: path.link(5),
            changes: Vec::new(),
            sent: 0,
            due: SimTime::ZERO,
            meter: LossMeter::default(),
            clock: ClockSync::default(),
            reports: Default::default(),
            now: 0,
        }
    }

    fn run(&mut self, secs: u64) {
        for ms in self.now..self.now + secs * 1_000 {
            let now = MS(ms);
            if now >= self.due {
                self.sent += 1;
                self.due = now + self.ladder.rate().period();
                self.link.send(now, Letter(self.sent, now));
            }
            while let Some(Letter(sequence, sent_at)) = self.link.due(now) {
                let queueing = self.clock.received(sent_at, None, now).queueing;
                self.meter.arrived(sequence, queueing);
            }
            self.reports.extend(self.meter.report(now).map(|report| (now + MS(75), report)));
            while let Some((_, report)) = self.reports.pop_front_if(|(due, _)| *due <= now) {
                self.changes.extend(self.ladder.report(&report, MS(150), now));
            }
            self.changes.extend(self.ladder.tick(now));
        }
        self.now += secs * 1_000;
    }

    fn rates(&self) -> Vec<u32> {
        self.changes.iter().map(|change| change.to.hz()).collect()
    }
}

fn path() -> Impairments {
    Impairments { delay: MS(75), jitter: MS(5), ..Impairments::default() }
}

#[test]
fn on_a_good_link_the_rate_stays_at_its_top() {
    for loss in [0.0, 0.01, 0.1] {
        let mut session = Session::new(&Impairments { loss, ..path() });
        session.run(60);
        assert_eq!((session.rates(), session.ladder.downs()), (vec![], 0), "{loss}");
    }
}

#[test]
fn a_loss_that_no_rate_cures_is_tolerated_after_one_descent() {
    let mut session = Session::new(&Impairments { loss: 0.33, ..path() });
    session.run(120);
    assert_eq!(session.rates(), [500, 250, 60, 1_000]);
    let back = session.changes.pop().expect("four");
    assert!(matches!(back.reason, RateReason::NotOurs(lost) if (0.2..0.5).contains(&lost)), "{back:?}");
    assert!(back.at < MS(10_000), "{back:?}");
    for change in &session.changes {
        assert!(matches!(change.reason, RateReason::Loss(lost) if (0.2..0.5).contains(&lost)), "{change:?}");
    }
    assert!(session.changes[0].at < MS(1_700), "{:?}", session.changes);
    // What is lost beyond it counts as before.
    session.changes.clear();
    session.link = Impairments { loss: 0.6, ..path() }.link(7);
    session.run(5);
    assert_eq!(session.rates(), [500, 250, 60]);
}

#[test]
fn a_link_that_is_too_narrow_for_the_lowest_rate_is_not_flooded() {
    // 16.3 kB/s are the least that comes.
    let narrow = Impairments { bytes_per_sec: Some(10e3), queue: MS(200), ..path() };
    let mut session = Session::new(&narrow);
    session.run(60);
    assert_eq!(session.rates(), [500, 250, 60]);
}

#[test]
fn a_queue_that_grows_for_two_seconds_leads_down_before_anything_is_lost() {
    // 272 kB/s come, 200 kB/s pass, and 60 s of it wait.
    let slow = Impairments { bytes_per_sec: Some(200e3), queue: MS(60_000), ..path() };
    let mut session = Session::new(&slow);
    session.run(4);
    assert_eq!(session.rates(), [500]);
    let change = session.changes[0];
    assert!((MS(2_000)..MS(3_500)).contains(&change.at), "{change:?}");
    assert!(matches!(change.reason, RateReason::Queue(grown) if grown > MS(100)), "{change:?}");
    session.run(4);
    assert_eq!((session.rates(), session.meter.lost()), (vec![500], 0), "half the rate fits");
}

#[test]
fn a_narrow_link_is_probed_less_and_less_often() {
    let narrow = Impairments { bytes_per_sec: Some(200e3), queue: MS(200), ..path() };
    let mut session = Session::new(&narrow);
    session.run(300);
    let ups: Vec<&RateChange> = session.changes.iter().filter(|change| change.to > change.from).collect();
    assert!((3..=8).contains(&ups.len()), "{:?}", session.changes);
    let pauses: Vec<SimTime> = ups
        .iter()
        .map(|change| match change.reason {
            RateReason::Quiet(quiet) => quiet,
            _ => panic!("{change:?}"),
        })
        .collect();
    assert!(
        pauses.is_sorted() && pauses[0] >= QUIET_MIN && pauses[pauses.len() - 1] >= MS(40_000),
        "{pauses:?}"
    );
    assert!(session.rates().iter().all(|hz| *hz >= 500), "half the rate fits: {:?}", session.rates());
    let lost = session.meter.lost() as f64 / session.meter.expected() as f64;
    assert!(lost < 0.03, "{lost}");
}

#[test]
fn after_a_bad_time_the_rate_climbs_back_a_rung_at_a_time() {
    let mut session = Session::new(&Impairments { loss: 0.5, ..path() });
    session.run(6);
    assert_eq!(session.ladder.rate(), Rate::Hz60);
    session.link = path().link(6);
    session.run(40);
    assert_eq!(session.rates(), [500, 250, 60, 250, 500, 1_000]);
    let ups: Vec<SimTime> = session.changes[3..].iter().map(|change| change.at).collect();
    assert!(ups.windows(2).all(|pair| pair[1].since(pair[0]) >= QUIET_MIN), "{ups:?}");
}

#[test]
fn a_path_that_becomes_longer_is_no_queue() {
    let mut session = Session::new(&path());
    session.run(5);
    session.link = Impairments { delay: MS(200), ..path() }.link(6);
    session.run(20);
    assert_eq!(session.rates(), [0; 0]);
}

#[test]
fn when_reports_cease_the_rate_goes_down_step_by_step() {
    let mut session = Session::new(&path());
    session.run(5);
    session.link = Impairments { loss: 1.0, ..path() }.link(6);
    // Reports still come from a receiver that hears nothing, and expect nothing.
    session.run(5);
    assert_eq!(session.rates(), [0; 0]);
    let mut ladder = session.ladder;
    assert_eq!(ladder.tick(MS(10_500)), None);
    let change = ladder.tick(MS(13_000)).expect("two seconds of silence");
    assert_eq!((change.to, change.reason), (Rate::Hz500, RateReason::NoReport));
    assert_eq!(ladder.tick(MS(13_500)), None);
    assert_eq!(ladder.tick(MS(15_000)).map(|change| change.to), Some(Rate::Hz250));
    assert_eq!(ladder.tick(MS(17_000)).map(|change| change.to), Some(Rate::Hz60));
    assert_eq!(ladder.tick(MS(19_000)), None, "there is none below");
}

#[test]
fn an_old_report_and_a_top_are_minded() {
    let mut ladder = RateLadder::new(Rate::Hz250);
    let report = |newest, received| LinkReport { newest, expected: 100, received, queueing_us: 0 };
    assert_eq!(ladder.report(&report(1_000, 100), MS(150), MS(0)), None);
    assert_eq!(ladder.report(&report(900, 0), MS(150), MS(10)), None, "it is old");
    for second in 1..60 {
        assert_eq!(ladder.report(&report(1_000 + 100 * second, 100), MS(150), MS(1_000 * second)), None);
    }
    assert_eq!(ladder.rate(), Rate::Hz250);
}
