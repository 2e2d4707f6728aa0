//! Whether a session kept up: which actors fell below a share of their rate, over the whole run or in any two seconds.
//!
//! A solver at half of its rate moves tissue in slow motion and lets go of what it should hold; a trainee at half of its
//! rate is clumsy. An exercise under such conditions says little about the trainee, so its score is marked as disturbed.
//! In virtual time every tick runs, however slow the machine is; there an actor falls behind only by an injected fault.

use std::collections::VecDeque;

use trocar_scene::SimTime;

use crate::summary::SlowActor;

/// Share of its ticks below which an actor was too slow.
pub const SHARE_MIN: f64 = 0.8;
/// Length of the spans that are judged by themselves, besides the whole run.
pub const SPAN: SimTime = SimTime::from_millis(2_000);
/// Time between two samples of the counts.
const SAMPLE_EVERY: SimTime = SimTime::from_millis(250);

/// Counts the ticks of each actor as a session goes on.
#[derive(Clone, Debug)]
pub struct RateWatch {
    /// Session time at the start.
    begin: SimTime,
    actors: Vec<Actor>,
    /// Session time of each sample in the last span, oldest first.
    times: VecDeque<SimTime>,
}

#[derive(Clone, Debug)]
struct Actor {
    name: String,
    rate_hz: f64,
    /// Time and ticks of the sample in which it was first at work: what it takes to start is not counted.
    first: Option<(SimTime, u64)>,
    last: (SimTime, u64),
    /// Ticks at each sample in the last span.
    ticks: VecDeque<u64>,
    /// Least share in a span, and the beginning of that span.
    worst: (f64, SimTime),
}

impl RateWatch {
    /// For a session that starts at the session time `begin`, and actors of these names and rates \[Hz\], in the order in
    /// which their ticks are told.
    pub fn new(begin: SimTime, actors: impl IntoIterator<Item = (String, f64)>) -> Self {
        let actors = actors.into_iter().map(|(name, rate_hz)| Actor {
            name,
            rate_hz,
            first: None,
            last: (begin, 0),
            ticks: VecDeque::new(),
            worst: (1.0, begin),
        });
        Self { begin, actors: actors.collect(), times: VecDeque::new() }
    }

    /// Takes in how many ticks each actor has run at `now`, the time of the session without its pauses.
    pub fn look(&mut self, now: SimTime, ticks: &[u64]) {
        if self.times.back().is_some_and(|last| now < *last + SAMPLE_EVERY) {
            return;
        }
        self.times.push_back(now);
        for (actor, ticks) in self.actors.iter_mut().zip(ticks) {
            actor.last = (now, *ticks);
            if actor.first.is_none() && *ticks > 0 {
                actor.first = Some(actor.last);
            }
            actor.ticks.push_back(*ticks);
        }
        // The oldest sample is the latest one that is a span old.
        while self.times.get(1).is_some_and(|second| *second + SPAN <= now) {
            self.times.pop_front();
            self.actors.iter_mut().for_each(|actor| {
                actor.ticks.pop_front();
            });
        }
        let Some(from) = self.times.front().copied().filter(|from| *from + SPAN <= now) else { return };
        for actor in &mut self.actors {
            let since_first = actor.first.is_some_and(|(first, _)| first <= from);
            if let (true, Some(before)) = (since_first, actor.ticks.front()) {
                let share = share(actor.rate_hz, (from, *before), actor.last);
                if share < actor.worst.0 {
                    actor.worst = (share, from);
                }
            }
        }
    }

    /// The actors that were too slow, the slowest first.
    pub fn slow(&self) -> Vec<SlowActor> {
        let mut slow: Vec<SlowActor> = self
            .actors
            .iter()
            .filter_map(|actor| {
                let whole = share(actor.rate_hz, actor.first?, actor.last);
                let (worst, at) = actor.worst;
                (whole.min(worst) < SHARE_MIN).then(|| SlowActor {
                    name: actor.name.clone(),
                    share: whole,
                    worst_share: worst.min(whole),
                    worst_at_secs: if worst < whole { at } else { self.begin }.as_secs_f64(),
                })
            })
            .collect();
        slow.sort_by(|a, b| a.worst_share.total_cmp(&b.worst_share));
        slow
    }
}

/// Share of the due ticks that ran between two samples of time and ticks; 1 for less than two due ticks.
fn share(rate_hz: f64, (from, before): (SimTime, u64), (to, after): (SimTime, u64)) -> f64 {
    let due = to.since(from).as_secs_f64() * rate_hz;
    // One tick more or less is a matter of phase.
    if due < 2.0 { 1.0 } else { ((after.saturating_sub(before) + 1) as f64 / due).min(1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Feeds ticks at `rate(t)` Hz for `secs`, looked at 50 times per second.
    fn watched(target_hz: f64, secs: f64, rate: impl Fn(f64) -> f64) -> Vec<SlowActor> {
        let mut watch = RateWatch::new(SimTime::ZERO, [("organs".to_owned(), target_hz)]);
        let mut ticks = 1.0;
        for look in 0..(secs * 50.0) as u64 {
            let now = look as f64 / 50.0;
            watch.look(SimTime::from_secs_f64(now), &[ticks as u64]);
            ticks += rate(now) / 50.0;
        }
        watch.slow()
    }

    #[test]
    fn who_keeps_its_rate_is_not_slow_at_any_rate() {
        for hz in [1.0, 20.0, 60.0, 100.0, 1_000.0] {
            assert_eq!(watched(hz, 20.0, |_| hz), [], "{hz} Hz");
            assert_eq!(watched(hz, 20.0, |_| 0.85 * hz), [], "{hz} Hz");
        }
    }

    #[test]
    fn who_falls_below_its_share_is_told_with_it() {
        for hz in [20.0, 100.0, 1_000.0] {
            let slow = watched(hz, 20.0, |_| 0.3 * hz);
            assert_eq!(slow.len(), 1, "{hz} Hz");
            assert!((slow[0].share - 0.3).abs() < 0.01 && slow[0].name == "organs", "{slow:?}");
        }
    }

    #[test]
    fn a_few_slow_seconds_in_a_long_exercise_are_told_with_their_time() {
        // Longer than a span and the time between two samples, so that a span lies in them.
        let slow = watched(100.0, 100.0, |now| if (40.0..42.5).contains(&now) { 10.0 } else { 100.0 });
        assert_eq!(slow.len(), 1);
        assert!(slow[0].share > 0.97, "{slow:?}");
        assert!((slow[0].worst_share - 0.1).abs() < 0.02, "{slow:?}");
        assert!((40.0..40.5).contains(&slow[0].worst_at_secs), "{slow:?}");
    }

    #[test]
    fn who_hangs_is_slow_although_no_tick_of_it_is_counted_as_missed() {
        let slow = watched(100.0, 10.0, |now| if now > 5.0 { 0.0 } else { 100.0 });
        assert!(slow[0].worst_share < 0.02, "{slow:?}");
    }

    #[test]
    fn what_it_takes_to_start_is_not_counted() {
        let mut watch = RateWatch::new(SimTime::ZERO, [("liver".to_owned(), 50.0)]);
        for look in 0..1_000_u64 {
            // It is built for five seconds.
            watch.look(SimTime::from_millis(20 * look), &[look.saturating_sub(250)]);
        }
        assert_eq!(watch.slow(), []);
    }
}
