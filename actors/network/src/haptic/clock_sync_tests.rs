use trocar_scene::random::SplitMix64;

use super::*;

/// A path between two stations, and the other station's clock. Delays \[ms\].
#[derive(Clone, Copy)]
struct Path {
    there: f64,
    back: f64,
    /// Each datagram takes up to so much longer.
    jitter: f64,
    /// From one datagram to the next, at either station.
    every: f64,
    loss: f64,
    skew: f64,
    /// What their clock shows when ours shows 0 \[ms\].
    offset: f64,
}

const PATH: Path =
    Path { there: 75.0, back: 75.0, jitter: 10.0, every: 1.0, loss: 0.0, skew: 100e-6, offset: 3.6e6 };

/// Two stations on a path, each with its estimate of the other.
struct Pair {
    path: Path,
    random: SplitMix64,
    ours: ClockSync,
    theirs: ClockSync,
    /// Under way there and back: due \[ms\] on our clock, sent at, echo.
    way: [Vec<(f64, SimTime, Option<ClockEcho>)>; 2],
    /// How long their clock has stood in all \[ms\].
    stopped: f64,
    time: f64,
}

impl Pair {
    fn new(path: Path) -> Self {
        let (ours, theirs) = (ClockSync::default(), ClockSync::default());
        let way = [Vec::new(), Vec::new()];
        Self { path, random: SplitMix64::new(11), ours, theirs, way, stopped: 0.0, time: 0.0 }
    }

    fn clocks(&self, ms: f64) -> [SimTime; 2] {
        let there = self.path.offset + ms * (1.0 + self.path.skew) - self.stopped;
        [ms, there].map(|ms| SimTime::from_secs_f64(ms * 1e-3))
    }

    /// Error of our estimate \[ms\].
    fn error(&self) -> f64 {
        let [now, there] = self.clocks(self.time);
        let estimated = self.ours.to_remote(now, now).expect("an echo has come");
        difference(estimated, there) as f64 * 1e-6
    }

    /// Runs until `until` \[ms\], and calls `each` after each step.
    fn run(&mut self, until: f64, mut each: impl FnMut(&Self)) {
        while self.time < until {
            self.time += self.path.every;
            let clocks = self.clocks(self.time);
            let echoes = [self.ours.echo(clocks[0]), self.theirs.echo(clocks[1])];
            for (side, delay) in [self.path.there, self.path.back].into_iter().enumerate() {
                let late = delay + self.path.jitter * self.random.unit();
                if self.random.unit() >= self.path.loss {
                    self.way[side].push((self.time + late, clocks[side], echoes[side]));
                }
            }
            for side in [0, 1] {
                let (mut due, rest): (Vec<_>, Vec<_>) =
                    self.way[side].drain(..).partition(|(due, ..)| *due <= self.time);
                self.way[side] = rest;
                due.sort_by(|a, b| a.0.total_cmp(&b.0));
                for (at, sent_at, echo) in due {
                    let now = self.clocks(at)[1 - side];
                    let end = if side == 0 { &mut self.theirs } else { &mut self.ours };
                    end.received(sent_at, echo, now);
                }
            }
            each(self);
        }
    }
}

/// The greatest error \[ms\] from 5 s on for a minute.
fn worst(path: Path) -> f64 {
    let mut pair = Pair::new(path);
    pair.run(5_000.0, |_| {});
    let mut worst = 0.0_f64;
    pair.run(60_000.0, |pair| worst = worst.max(pair.error().abs()));
    assert_eq!((pair.ours.resets(), pair.ours.refused()), (0, 0));
    let skew = pair.ours.skew().expect("a minute is enough");
    assert!((skew - path.skew).abs() < 20e-6, "{skew}");
    worst
}

#[test]
fn with_skew_and_jitter_the_offset_is_right_to_a_millisecond() {
    for skew in [-100e-6, 0.0, 100e-6] {
        let error = worst(Path { skew, every: 4.0, ..PATH });
        assert!(error < 0.5, "{error} ms at {skew}");
    }
}

#[test]
fn at_the_rate_of_heartbeats_and_with_loss_it_is_right_to_a_millisecond() {
    let error = worst(Path { every: 20.0, loss: 0.2, jitter: 20.0, ..PATH });
    assert!(error < 1.0, "{error} ms");
}

#[test]
fn an_asymmetric_path_costs_half_its_asymmetry_and_no_more() {
    let error = worst(Path { there: 40.0, back: 110.0, every: 4.0, ..PATH });
    assert!((34.5..36.0).contains(&error), "{error} ms");
}

#[test]
fn a_clock_that_was_set_an_hour_apart_is_as_good_as_any() {
    let errors = [0.0, 3.6e6, 7.2e6].map(|offset| worst(Path { offset, every: 20.0, ..PATH }));
    assert!(errors.iter().all(|error| (error - errors[0]).abs() < 1e-3), "{errors:?}");
}

#[test]
fn a_queue_of_ten_seconds_on_the_way_back_is_not_taken_for_an_offset() {
    let mut pair = Pair::new(Path { every: 4.0, ..PATH });
    pair.run(10_000.0, |_| {});
    pair.path.back += 300.0;
    let mut worst = 0.0_f64;
    pair.run(20_000.0, |pair| worst = worst.max(pair.error().abs()));
    assert!(worst < 1.0, "{worst} ms");
    let round_trip = pair.ours.round_trip().expect("echoes").as_secs_f64();
    assert!((0.44..0.48).contains(&round_trip), "{round_trip}");
    let least = pair.ours.round_trip_min().expect("echoes").as_secs_f64();
    assert!((0.149..0.155).contains(&least), "{least}");
}

#[test]
fn a_clock_that_stood_still_is_noticed_and_measured_anew() {
    let mut pair = Pair::new(Path { every: 4.0, ..PATH });
    pair.run(10_000.0, |_| {});
    pair.stopped = 2_000.0;
    pair.run(11_000.0, |_| {});
    assert!(pair.ours.resets() >= 1);
    // What was under way while the clock stood may count for a while.
    pair.run(14_000.0, |_| {});
    assert!(pair.error().abs() < 2.0, "{} ms", pair.error());
}

#[test]
fn round_trip_jitter_and_delay_are_those_of_the_path() {
    let mut pair = Pair::new(Path { jitter: 4.0, every: 10.0, ..PATH });
    pair.run(10_000.0, |_| {});
    let millis = |time: SimTime| time.as_secs_f64() * 1e3;
    let round_trip = millis(pair.ours.round_trip().expect("echoes"));
    assert!((150.0..158.0).contains(&round_trip), "{round_trip}");
    // The mean difference of two numbers that are uniform over 4 ms is 4 / 3.
    let jitter = millis(pair.ours.jitter());
    assert!((0.7..2.2).contains(&jitter), "{jitter}");
    let [now, there] = pair.clocks(pair.time);
    let sent_at = SimTime(there.as_nanos() - 80_000_000);
    let delay = millis(pair.ours.delay(sent_at, now).expect("echoes"));
    assert!((delay - 80.0).abs() < 1.0, "{delay}");
    let transit = pair.ours.received(SimTime(there.as_nanos() - 120_000_000), None, now);
    assert!((44.0..46.5).contains(&millis(transit.queueing)), "{transit:?}");
    assert!((millis(transit.delay.expect("echoes")) - 120.0).abs() < 1.0, "{transit:?}");
}

#[test]
fn nothing_is_known_before_the_first_echo_but_how_long_the_queues_are() {
    let mut clock = ClockSync::default();
    let ms = SimTime::from_millis;
    assert_eq!(clock.echo(ms(1)), None);
    assert_eq!(clock.received(ms(5_000), None, ms(10)), Transit::default());
    let transit = clock.received(ms(5_010), None, ms(27));
    assert_eq!(transit, Transit { queueing: ms(7), delay: None, round_trip: None });
    assert_eq!((clock.offset(ms(30)), clock.round_trip(), clock.skew()), (None, None, None));
    assert_eq!(clock.echo(ms(30)), Some(ClockEcho { sent_at: ms(5_010), held: ms(3) }));
    // One that was overtaken is not what is echoed.
    clock.received(ms(5_005), None, ms(31));
    assert_eq!(clock.echo(ms(32)), Some(ClockEcho { sent_at: ms(5_010), held: ms(5) }));
}

#[test]
fn an_echo_that_cannot_be_is_refused_and_counted() {
    let mut clock = ClockSync::default();
    let ms = SimTime::from_millis;
    let echo = |sent_at, held| Some(ClockEcho { sent_at, held });
    assert_eq!(clock.received(ms(1), echo(ms(101), ms(0)), ms(100)).round_trip, None);
    assert_eq!(clock.received(ms(2), echo(ms(50), ms(51)), ms(100)).round_trip, None);
    assert_eq!((clock.refused(), clock.offset(ms(100))), (2, None));
    assert_eq!(clock.received(ms(3), echo(ms(50), ms(20)), ms(100)).round_trip, Some(ms(30)));
    assert_eq!(clock.received(ms(4), echo(ms(50), ms(21)), ms(101)).round_trip, None, "it is known");
}

proptest::proptest! {
    #[test]
    fn times_at_the_ends_of_their_range_do_no_harm(
        times in proptest::collection::vec((proptest::num::u64::ANY, 0..4_u8, 0..4_u8), 1..60),
    ) {
        let mut clock = ClockSync::default();
        let edge = |time: u64, edge: u8| SimTime([time, 0, u64::MAX, time % 1_000_000_000][edge as usize]);
        let mut now = SimTime::ZERO;
        for (time, one, other) in times {
            now = now.max(edge(time.rotate_left(17), other));
            let echo = ClockEcho { sent_at: edge(time.rotate_left(5), other), held: edge(!time, one) };
            clock.received(edge(time, one), Some(echo), now);
            if let Some(local) = clock.to_local(edge(time, other), now) {
                clock.to_remote(local, now);
            }
            clock.echo(now);
            assert!(clock.skew().is_none_or(|skew| skew.abs() <= SKEW_MAX));
        }
    }
}
